"""`ToolContext`: what the tools of an agent share: the stage, its host drivers, the budget, diagnostics and bus traces."""

from __future__ import annotations

from typing import Any

from stage.agents.budget import Budget, BudgetMeter
from stage.agents.host_diagnostics import HostDiagnostics
from stage.agents.tool_arguments import argument, choice
from stage.firmware.driver import Driver, get_driver
from stage.panel.stage_observer import BusTrace
from stage.sim.axis import Axis
from stage.sim.stage import Stage


class ToolContext:
    """Stage that an agent drives, with what its tools share.

    Attributes:
        stage: The stage; only the tools may use it from now on.
        mode: "host" or "truth".
        meter: Counter of what the agent has used of its budget.
        axes: Names of the axes.
        report: Report of the last procedure; None before the first.
        diagnostics: Diagnostics of each chip.
        traces: Bus trace of each chip, in words.
    """

    def __init__(self, stage: Stage, mode: str, budget: Budget, patience: float | None):
        self.stage, self.mode = stage, mode
        self.meter = BudgetMeter(stage, budget, patience)
        self.axes = tuple(stage.axes)
        self.report: Any = None
        self._drivers: dict[str, Driver] = {}
        self.diagnostics = tuple(HostDiagnostics(chip, mode == "host") for chip in stage.chips)
        self.traces = tuple(BusTrace(chip, losses=mode == "truth") for chip in stage.chips)

    @property
    def axis_argument(self) -> tuple[Any, Any]:
        """Tool argument for the name of an axis; optional on a stage with one axis."""
        if len(self.axes) == 1:
            return argument(choice(self.axes), "Name of the axis.", self.axes[0])
        return argument(choice(self.axes), "Name of the axis.")

    @property
    def time_s(self) -> float:
        """Simulated time in seconds, to the nanosecond."""
        return round(self.stage.time, 9)

    def get_axis(self, name: str) -> Axis:
        """Return the axis with this name."""
        return self.stage.axes[name]

    def get_driver(self, name: str) -> Driver:
        """Return the host driver of an axis, the same one for each call because it stores what it has written."""
        axis = self.get_axis(name)
        if name not in self._drivers:
            self._drivers[name] = get_driver(axis)
        return self._drivers[name]

    def get_trace(self, axis: str) -> BusTrace:
        """Return the bus trace of the chip of an axis."""
        return self.traces[self.stage.chips.index(self.get_axis(axis).chip)]

    def drop_cached_state(self) -> None:
        """Drop the drivers and restart the bus traces, because a snapshot or a reset has changed the state of the stage."""
        self._drivers.clear()
        for trace in self.traces:
            trace.restart()
