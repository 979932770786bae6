"""Players that learn nothing: the task's own formula, and random calls."""

from __future__ import annotations

from typing import Any

import numpy as np

from registerbench.arena.game_session import GameSession


def play_formula(session: GameSession) -> None:
    """Do what the tool `formula` proposes until the game is over; do nothing at a broken set-up, which has no formula."""
    while not session.over:
        answer = session.call("formula")
        if not answer.ok or not session.call("act", answer.data).ok:
            return


class RandomPlayer:
    """Player that draws arguments within their schema; at a broken set-up it draws an answer and a service."""

    name = "random"

    def __init__(self, seed: int = 0):
        self._rng = np.random.default_rng(seed)

    def __call__(self, session: GameSession) -> None:
        schemas = {t["name"]: t["parameters"] for t in session.tools}
        if "act" not in schemas:
            for name in ("answer", "service"):
                session.call(name, self._draw_arguments(schemas[name]))
            session.call("finish")
            return
        while not session.over:
            if not session.call("act", self._draw_arguments(schemas["act"])).ok:
                return

    def _draw_arguments(self, schema: dict[str, Any]) -> dict[str, Any]:
        """Draw a value for each argument of a tool within its JSON schema."""
        return {name: self._draw_value(schema["properties"][name]) for name in schema["required"]}

    def _draw_value(self, schema: dict[str, Any]) -> Any:
        """Draw a value within a JSON schema."""
        schema = schema.get("anyOf", [schema])[0]
        if "enum" in schema:
            return str(self._rng.choice(schema["enum"]))
        low, high = float(schema["minimum"]), float(schema["maximum"])
        return float(np.exp(self._rng.uniform(np.log(low), np.log(high))) if low > 0 else self._rng.uniform(low, high))
