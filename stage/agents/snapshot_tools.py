"""Tools that restore earlier states of the stage: snapshot, restore, branch. They do not restore the budget."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from stage.agents.tool import Tool
from stage.agents.tool_arguments import Text, argument, choose
from stage.agents.tool_context import ToolContext
from stage.errors import ArgumentError, StageError
from stage.sim.stage_snapshot import Snapshot

MAX_SNAPSHOTS = 16  # and as many branches
MAX_NAME_CHARACTERS = 64
MAIN_BRANCH = "main"
POWER_UP = "power-up"


class SnapshotTools:
    """Tools that save and restore states of a stage."""

    def __init__(self, context: ToolContext):
        self._context = context
        self._snapshots: dict[str, tuple[Snapshot, Any]] = {POWER_UP: self._take_snapshot()}
        self._branches: dict[str, tuple[Snapshot, Any]] = {}
        self._branch = MAIN_BRANCH

    def list_tools(self) -> list[Tool]:
        """List the tools."""
        name = {"name": argument(Text, "A name of your own.")}
        return [Tool.from_method(act, name) for act in (self.snapshot, self.restore, self.branch)]

    def snapshot(self, name: str) -> dict[str, Any]:
        """Save the state of the whole stage under a name: physics, chips, drives, time."""
        _check_snapshot_name(name, self._snapshots)
        if name == POWER_UP:
            raise ArgumentError(f'"{POWER_UP}" is the state with which the session began; choose another name.')
        self._snapshots[name] = self._take_snapshot()
        return {"snapshot": name, "time_s": self._context.time_s, "kept": list(self._snapshots)}

    def restore(self, name: str) -> dict[str, Any]:
        """Put the stage back to a snapshot, or to "power-up". The budget stays as it is."""
        self._restore_state(*self._snapshots[choose("snapshot", name, tuple(self._snapshots))])
        return {"restored": name, "time_s": self._context.time_s}

    def branch(self, name: str) -> dict[str, Any]:
        """Switch to a branch: a new name begins one here; a known one continues where you left it."""
        _check_snapshot_name(name, {*self._branches, self._branch})
        if name != self._branch:
            self._branches[self._branch] = self._take_snapshot()
            if name in self._branches:
                self._restore_state(*self._branches.pop(name))
            self._branch = name
        return {"branch": name, "others": list(self._branches), "time_s": self._context.time_s}

    def _take_snapshot(self) -> tuple[Snapshot, Any]:
        """Return a snapshot of the stage with the report of the last move."""
        return self._context.stage.snapshot(), self._context.report

    def _restore_state(self, snapshot: Snapshot, report: Any) -> None:
        self._context.stage.restore(snapshot)
        self._context.report = report
        self._context.drop_cached_state()


def _check_snapshot_name(name: str, known: Collection[str]) -> None:
    """Raise an error if a new snapshot cannot have this name, or if there are too many snapshots."""
    if not name.strip() or len(name) > MAX_NAME_CHARACTERS or not name.isprintable():
        raise ArgumentError(f"name: 1 to {MAX_NAME_CHARACTERS} printable characters.")
    if name not in known and len(known) >= MAX_SNAPSHOTS:
        raise StageError(f"There are {MAX_SNAPSHOTS} already: {', '.join(known)}. Use one of these names again.")
