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

import threading
from collections.abc import Iterable
from typing import Any

from stage.agents import bus, motion, pictures, states, truth
from stage.agents.budget import Budget, Meter, Spent
from stage.agents.fields import chosen, shown
from stage.agents.notes import Notes
from stage.agents.tool import Answer, Picture, Tool
from stage.errors import ArgumentError, RunTimeout, StageError
from stage.firmware.driver import Driver, driver_of
from stage.panel.trace import Trace
from stage.sim.axis import Axis
from stage.sim.stage import Stage

MODES = ("host", "truth")


class Toolbox:
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
        self.stage, self.mode = stage, mode
        self.meter = Meter(stage, budget or Budget(), patience)
        self.axes = tuple(stage.axes)
        self.report: Any = None
        self.recordings: Any = None
        self.calls = 0
        self._lock, self._closed = threading.Lock(), ""
        self._drivers: dict[str, Driver] = {}
        self.notes = tuple(Notes(chip, mode == "host") for chip in stage.chips)
        self.traces = tuple(Trace(chip, losses=mode == "truth") for chip in stage.chips)
        self.motion = motion.Motion(self)
        groups = [bus.tools(self), self.motion.tools(), pictures.tools(self)]
        groups += [states.tools(self)] if snapshots else []
        groups += [truth.tools(self)] if mode == "truth" else []
        self.tools: dict[str, Tool] = {t.name: t for group in groups for t in group} | {t.name: t for t in more}

    # --- calls ---

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Make a call. Never raises."""
        with self._lock:
            self.calls += 1
            try:
                return self._call(name, arguments)
            except RunTimeout as error:
                return self._failed(error, getattr(error, "report", None))
            except Spent as error:
                return Answer(False, {"error": str(error), "left": self.meter.left()})
            except StageError as error:
                return self._failed(error)
            except (MemoryError, RecursionError) as error:
                return Answer(
                    False, {"error": f"{name}: this call asks for too much ({type(error).__name__}): ask for less."}
                )
            except Exception as error:
                return Answer(
                    False,
                    {
                        "error": f"{shown(name)}: PulseStage itself has failed ({type(error).__name__}: {shown(str(error))}). The "
                        "session goes on; please report what was called."
                    },
                )

    def _call(self, name: Any, arguments: Any) -> Answer:
        if self._closed:
            raise StageError(self._closed)
        if not isinstance(name, str):
            known = ", ".join(self.tools)
            raise ArgumentError(f"a tool is called by its name, and {shown(name)} was given. Known: {known}.")
        tool = self.tools.get(name) or self.tools[chosen("tool", name, tuple(self.tools))]
        values = tool.values(arguments)
        self.meter.begin()
        cycles = self.meter.cycles
        try:
            if tool.moves:
                self.meter.move()
            made = tool.act(**values)
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
        if isinstance(made, Picture):
            return Answer(True, {"text": made.said}, made.png)
        return Answer(True, {"text": made} if isinstance(made, str) else dict(made))

    def _failed(self, error: StageError, report: Any = None) -> Answer:
        data: dict[str, Any] = {"error": str(error)}
        if report is not None:
            self.report = report
            data["report"] = motion.told(report, self.mode)
        return Answer(False, data)

    def interrupt(self) -> None:
        """From another thread: a call that is being made ends soon, in words."""
        self.meter.over = True

    def close(
        self, why: str = "this session has ended: its stage is gone. Open a new session, which begins at power-up."
    ) -> None:
        """End: every call from now on says why. Safe to call twice."""
        with self._lock:
            if not self._closed:
                self._closed = why
                for trace in self.traces:
                    trace.close()
                for notes in self.notes:
                    notes.close()

    @property
    def closed(self) -> bool:
        """It has ended."""
        return bool(self._closed)

    # --- for the tools ---

    def axis(self, name: str) -> Axis:
        """By its name."""
        return self.stage.axes[name]

    def driver(self, name: str) -> Driver:
        """Of an axis: the same from call to call, for it remembers what it wrote."""
        if name not in self._drivers:
            self._drivers[name] = driver_of(self.axis(name))
        return self._drivers[name]

    def forget(self) -> None:
        """The stage is in another state than the calls have brought it to."""
        self._drivers.clear()
        self.motion.drop()
        for trace in self.traces:
            trace.begin_again()
