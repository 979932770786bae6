"""Players that learn nothing: the task's own rule, and chance."""

from __future__ import annotations

from typing import Any

import numpy as np

from registerbench.arena.table import Table


def formula(table: Table) -> None:
    """Ask for the formula, and do it, until the game is over. At a broken set-up, which has none, it does nothing."""
    while not table.over:
        said = table.call("formula")
        if not said.ok or not table.call("act", said.data).ok:
            return


class Random:
    """Arguments by chance, within what the schema allows. At a broken set-up: an answer and some work by chance."""

    name = "random"

    def __init__(self, seed: int = 0):
        self._rng = np.random.default_rng(seed)

    def __call__(self, table: Table) -> None:
        schemas = {t["name"]: t["parameters"] for t in table.tools}
        if "act" not in schemas:
            for name in ("answer", "service"):
                table.call(name, self._drawn(schemas[name]))
            table.call("finish")
            return
        while not table.over:
            if not table.call("act", self._drawn(schemas["act"])).ok:
                return

    def _drawn(self, schema: dict[str, Any]) -> dict[str, Any]:
        return {name: self._one(schema["properties"][name]) for name in schema["required"]}

    def _one(self, schema: dict[str, Any]) -> Any:
        schema = schema.get("anyOf", [schema])[0]
        if "enum" in schema:
            return str(self._rng.choice(schema["enum"]))
        low, high = float(schema["minimum"]), float(schema["maximum"])
        return float(np.exp(self._rng.uniform(np.log(low), np.log(high))) if low > 0 else self._rng.uniform(low, high))
