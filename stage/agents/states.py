"""Tools that put the stage back: snapshot, restore, branch. What a budget has spent stays spent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stage.agents.fields import TEXT, Field, chosen
from stage.agents.tool import Tool
from stage.errors import ArgumentError, StageError
from stage.sim.snapshot import Snapshot

if TYPE_CHECKING:
    from stage.agents.toolbox import Toolbox

MOST = 16  # of each kind
LONG = 64  # characters of a name
MAIN = "main"


def tools(box: Toolbox) -> list[Tool]:
    """Of a toolbox."""
    made = States(box)
    name = Field("name", TEXT, "of your own", True)
    return [
        Tool("snapshot", "Keep the state of the whole stage under a name: physics, chips, drives, time.", made.snapshot, (name,)),
        Tool("restore", "Put the stage back to a snapshot, or to \"power-up\". The budget stays as it is.", made.restore, (name,)),
        Tool(
            "branch",
            "Go to a branch: a new name begins one with the state of now, a known one goes on where it was left.",
            made.branch, (name,),
        ),
    ]  # fmt: skip


class States:
    """Acts for the tools."""

    def __init__(self, box: Toolbox):
        self._box = box
        self._kept: dict[str, tuple[Snapshot, Any]] = {"power-up": (box.stage.snapshot(), None)}
        self._branches: dict[str, tuple[Snapshot, Any]] = {}
        self._on = MAIN

    def snapshot(self, name: str) -> dict[str, Any]:
        self._check(name, self._kept)
        if name == "power-up":
            raise ArgumentError('"power-up" is the state that the session began with; choose another name.')
        self._kept[name] = self._now()
        return {"snapshot": name, "time_s": round(self._box.stage.time, 9), "kept": list(self._kept)}

    def restore(self, name: str) -> dict[str, Any]:
        self._put(self._kept[chosen("snapshot", name, tuple(self._kept))])
        return {"restored": name, "time_s": round(self._box.stage.time, 9)}

    def branch(self, name: str) -> dict[str, Any]:
        self._check(name, {**self._branches, self._on: None})
        if name != self._on:
            self._branches[self._on] = self._now()
            if name in self._branches:
                self._put(self._branches.pop(name))
            self._on = name
        return {"branch": self._on, "others": list(self._branches), "time_s": round(self._box.stage.time, 9)}

    def _now(self) -> tuple[Snapshot, Any]:
        return self._box.stage.snapshot(), self._box.report

    def _put(self, kept: tuple[Snapshot, Any]) -> None:
        snapshot, report = kept
        self._box.motion.drop()
        self._box.stage.restore(snapshot)
        self._box.report = report
        self._box.forget()

    def _check(self, name: str, known: Any) -> None:
        if not name.strip() or len(name) > LONG or not name.isprintable():
            raise ArgumentError(f"name: 1 to {LONG} printable characters.")
        if name not in known and len(known) >= MOST:
            raise StageError(f"{MOST} are kept already: {', '.join(known)}. Use one of these names again.")
