"""`Toolbox`: the tools of one stage, and every call of them.

    box = Toolbox(Stage("xy"), mode="host", budget=Budget(moves=20, seconds=60))
    answer = box.call("write_register", {"axis": "x", "name": "R1", "value": "1F4h"})
    answer.ok, answer.text, answer.data

Mode "host": an agent sees what a host on the bus can see: what it reads there, what it wrote, its clock. Mode "truth" adds what
only the simulation knows, and hands that break and mend the machine.

A call never raises: what is wrong is said in the answer, with what is allowed, and the stage stays as it was; only the time that
passed and the bus cycles that were made until then stay.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stage.agents import bus, motion, pictures, states, truth
from stage.agents.budget import Budget, Meter, Spent
from stage.agents.calls import Calls
from stage.agents.fields import shown
from stage.agents.notes import Notes
from stage.agents.tool import Answer, Tool
from stage.errors import ArgumentError, StageError
from stage.firmware.driver import Driver, driver_of
from stage.panel.stage_observer import Trace
from stage.sim.axis import Axis
from stage.sim.stage import Stage
from stage.support.arguments import told, told_when_made

MODES = ("host", "truth")


@told_when_made
class Toolbox(Calls):
    """The tools of a stage, for one agent. One call at a time; others wait.

    Args:
        stage: it belongs to the toolbox from now on.
        mode: "host" or "truth".
        budget: what may be used; Budget() for no limit.
        snapshots: the agent may put the stage back to where it was.
        patience: s of real time that a call may take; None for any.
        more: tools beside the usual ones.
    Raises ArgumentError.

    Attributes: tools, by name; meter: what is used; report: of the last procedure, None before; recordings: who keeps some, or
        None; notes: diagnostics, one a chip; traces: the bus in words, one a chip.
    """

    def __init__(
        self,
        stage: Stage,
        mode: str = "host",
        budget: Budget | None = None,
        *,
        snapshots: bool = True,
        patience: float | None = None,
        more: Iterable[Tool] = (),
    ):
        if not isinstance(stage, Stage):
            raise ArgumentError(f"stage={shown(stage)}: give a Stage, for example Stage('xy').")
        if mode not in MODES:
            raise ArgumentError(f"mode={mode!r}: {' or '.join(MODES)}.")
        if budget is not None and not isinstance(budget, Budget):
            raise ArgumentError(
                f"budget={shown(budget)}: give Budget(moves=20, seconds=60.0, cycles=100_000), or None."
            )
        super().__init__()
        self.stage, self.mode = stage, mode
        self.meter = Meter(stage, budget or Budget(), patience)
        self.axes = tuple(stage.axes)
        self.report: Any = None
        self.recordings: Any = None
        self._drivers: dict[str, Driver] = {}
        self.notes = tuple(Notes(chip, mode == "host") for chip in stage.chips)
        self.traces = tuple(Trace(chip, losses=mode == "truth") for chip in stage.chips)
        self.motion = motion.Motion(self)
        groups = [bus.tools(self), self.motion.tools(), pictures.tools(self)]
        groups += [states.tools(self)] if snapshots else []
        groups += [truth.tools(self)] if mode == "truth" else []
        self.tools = {t.name: t for group in groups for t in group} | {t.name: t for t in more}

    # --- calls ---

    @told
    def act(self, tool: Tool, values: dict[str, Any]) -> Any:
        """Do it, and count. A move that is refused before it has begun is none."""
        self.meter.begin()
        cycles = self.meter.cycles
        try:
            if tool.moves:
                self.meter.move()
            return tool.act(**values)
        except ArgumentError:
            if tool.moves and self.meter.cycles == cycles:
                self.meter.undo_move()
            raise
        finally:
            self.meter.end()
            for trace in self.traces:
                trace.look()
            if self.recordings is not None:
                self.recordings.bound()

    def failed(self, error: StageError) -> Answer:
        """With the report so far of a move that took too long, and with what is left of a budget that is spent."""
        data: dict[str, Any] = {"error": str(error)}
        if isinstance(error, Spent):
            data["left"] = self.meter.left()
        report = getattr(error, "report", None)
        if report is not None:
            self.report = report
            data["report"] = motion.told(report, self.mode)
        return Answer(False, data)

    def interrupt(self) -> None:
        self.meter.over = True

    def cancel(self) -> None:
        self.meter.cancelled = True

    def end(self) -> None:
        for trace in self.traces:
            trace.close()
        for notes in self.notes:
            notes.close()

    # --- for the tools ---

    def axis(self, name: str) -> Axis:
        """By its name."""
        return self.stage.axes[name]

    def driver(self, name: str) -> Driver:
        """Of an axis: the same from call to call, for it remembers what it wrote."""
        axis = self.axis(name)
        if name not in self._drivers:
            self._drivers[name] = driver_of(axis)
        return self._drivers[name]

    def forget(self) -> None:
        """The stage is in another state than the calls have brought it to."""
        self._drivers.clear()
        self.motion.drop()
        for trace in self.traces:
            trace.begin_again()
