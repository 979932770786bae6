"""`Toolbox`: the tools of one stage, with the calls of one agent.

    box = Toolbox(Stage("xy"), mode="host", budget=Budget(moves=20, seconds=60))
    answer = box.call("write_register", {"axis": "x", "name": "R1", "value": "1F4h"})
    answer.ok, answer.text, answer.data

In mode "host", an agent sees what a host on the bus can see: what it reads there, what it has written, and its clock. Mode "truth"
adds what only the simulation knows, and tools that change the machine.

Errors of a call do not raise: the answer says what is wrong and what is allowed. The stage then keeps its state, except for the
time and the bus cycles that have passed until the error.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stage.agents.budget import Budget, BudgetExhaustedError
from stage.agents.bus_tools import MODES, BusTools
from stage.agents.motion_tools import MotionTools, describe_report
from stage.agents.picture_tool import make_picture_tool
from stage.agents.recording_tools import StageRecorderTools
from stage.agents.snapshot_tools import SnapshotTools
from stage.agents.tool import Answer, Tool, ToolSet
from stage.agents.tool_arguments import format_value
from stage.agents.tool_context import ToolContext
from stage.agents.truth_tools import TruthTools
from stage.errors import ArgumentError, StageError
from stage.sim.stage import Stage
from stage.support.argument_checks import explain_arguments, explain_constructor


@explain_constructor
class Toolbox(ToolContext, ToolSet):
    """Tools of a stage for one agent. One call runs at a time; others wait.

    Args:
        stage: The stage; only the toolbox may use it from now on.
        mode: "host" or "truth".
        budget: Limits of what the agent may use; None: no limits.
        snapshots: Whether the agent may restore earlier states of the stage.
        patience: Longest real time that a call may take, s; None: no limit.
        folder: Folder for the files of `save_recording` in mode "truth"; None: no such tool.
        more: Tools in addition to the usual ones.

    Attributes:
        tools: Tools by name.
        recordings: Recording tools, which hold the last recording.

    Raises:
        ArgumentError: An argument has another type or value.
    """

    def __init__(
        self,
        stage: Stage,
        mode: str = "host",
        budget: Budget | None = None,
        *,
        snapshots: bool = True,
        patience: float | None = None,
        folder: str | None = None,
        more: Iterable[Tool] = (),
    ):
        if not isinstance(stage, Stage):
            raise ArgumentError(f"stage={format_value(stage)}: give a Stage, for example Stage('xy').")
        if mode not in MODES:
            raise ArgumentError(f"mode={mode!r} should be {' or '.join(MODES)}.")
        if not isinstance(budget, Budget | None):
            raise ArgumentError(
                f"budget={format_value(budget)}: give Budget(moves=20, seconds=60.0, cycles=100_000), or None."
            )
        ToolContext.__init__(self, stage, mode, budget or Budget(), patience)
        self.motion, self.recordings = MotionTools(self), StageRecorderTools(self, folder)
        tools = [*BusTools(self, self.motion).list_tools(), *self.motion.list_tools(), make_picture_tool(self)]
        tools += SnapshotTools(self).list_tools() if snapshots else []
        tools += TruthTools(self).list_tools() if mode == "truth" else []
        ToolSet.__init__(self, [*tools, *self.recordings.list_tools(), *more])

    @explain_arguments
    def act(self, tool: Tool, values: dict[str, Any]) -> Any:
        """Run a tool, and count what it uses. A move that is refused before its first bus cycle does not count."""
        self.meter.begin_call()
        cycles = self.meter.cycles
        try:
            if tool.moves:
                self.meter.count_move()
            return tool.act(**values)
        except ArgumentError:
            if tool.moves and self.meter.cycles == cycles:
                self.meter.moves -= 1
            raise
        finally:
            self.meter.end_call()
            for trace in self.traces:
                trace.add_new_entries()
            self.recordings.enforce_duration_limit()

    def describe_failure(self, error: StageError) -> Answer:
        """Return the answer of a call that has raised an error.

        The answer contains the rest of the budget if that is spent, and the report so far of a move that took too long.
        """
        data: dict[str, Any] = {"error": str(error)}
        if isinstance(error, BudgetExhaustedError):
            data["left"] = self.meter.list_remaining()
        report = getattr(error, "report", None)
        if report is not None:
            self.report = report
            data["report"] = describe_report(report, self.mode)
        return Answer(False, data)

    def request_session_end(self) -> None:
        self.meter.session_ended = True

    def cancel_call(self) -> None:
        self.meter.call_cancelled = True

    def release(self) -> None:
        self.recordings.end_session_recording()
        for trace, diagnostics in zip(self.traces, self.diagnostics, strict=True):
            trace.close()
            diagnostics.close()

    def drop_cached_state(self) -> None:
        super().drop_cached_state()
        self.motion.stop_watching_all()
