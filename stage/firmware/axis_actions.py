"""`AxisAction`: a move, homing, jog or stop that has begun, and goes on while simulated time passes.

    action = firmware.begin_move(stage.axes["x"], 20e-3)
    other = firmware.begin_home(stage.axes["y"])
    while not (action.is_done and other.is_done):
        stage.run(0.01)
    print(action.report)

The blocking procedures are the same code: `move` runs in the caller's thread what `begin_move` runs as an action. An axis has one
action at a time; `begin_stop` replaces it. An action keeps its stage, and a thread, until it has ended: cancel actions of a stage
that nobody uses any more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stage.errors import ArgumentError, RunTimeout, StageError
from stage.firmware.axis import Axis
from stage.sim.procedure_threads import ProcedureSchedule, ProcedureThread

POLL_INTERVAL_S = 1e-3


class AxisAction:
    """Procedure of an axis under way, which goes on whenever simulated time passes. `begin_action` makes it.

    Attributes:
        axis: Axis that moves.
        name: "move", "home", "jog" or "stop".
    """

    def __init__(self, axis: Axis, thread: ProcedureThread):
        self.axis, self.name, self._thread = axis, thread.name, thread

    @property
    def is_done(self) -> bool:
        """True if the action has ended: complete, with an error, or cancelled."""
        return self._thread.is_done

    @property
    def was_cancelled(self) -> bool:
        """True if `cancel`, a stop or a loaded state has ended the action before its own end."""
        return self._thread.was_cancelled

    @property
    def report(self) -> Any:
        """Report of the procedure; None before its end, after an error, and for a stop."""
        return self._thread.result

    @property
    def error(self) -> BaseException | None:
        """Error with which the procedure has ended, or None. A RunTimeout has the attribute `report`."""
        return self._thread.error

    def wait(self, timeout: float | None = None) -> Any:
        """Let simulated time pass until the action has ended.

        Args:
            timeout: Simulated seconds to wait; None: no limit other than that of the procedure itself.

        Returns:
            The report; None after a cancel or a stop.

        Raises:
            RunTimeout: The action still goes on after `timeout`.
            StageError: The error of the procedure.
        """
        begin = self.axis.time
        while not self.is_done:
            if timeout is not None and not self.axis.time - begin < timeout:
                raise RunTimeout(f"{self.name} of axis {self.axis.name} still goes on after {timeout:g} s.")
            self.axis.wait(POLL_INTERVAL_S)
        if self.error is not None:
            raise self.error
        return self.report

    def cancel(self) -> None:
        """End the action where it waits. The chip continues what it does: `begin_stop` also brings the axis to rest."""
        self._thread.cancel()

    def __repr__(self) -> str:
        state = "done" if self.is_done else "under way"
        return f"<AxisAction {self.name} of {self.axis.name}, {state}>"


def find_action(axis: Axis) -> AxisAction | None:
    """Return the action of an axis that is under way, or None."""
    schedule = get_schedule(axis)
    thread = None if schedule is None else schedule.find(axis.name)
    return None if thread is None else AxisAction(axis, thread)


def begin_action(axis: Axis, name: str, procedure: Callable[[], Any]) -> AxisAction:
    """Begin a procedure of an axis, up to its first wait.

    Args:
        axis: Axis that the procedure moves. It has no action under way.
        name: Name of the procedure, for people.
        procedure: Blocking function that makes bus cycles and lets time pass.

    Raises:
        ArgumentError: The axis belongs neither to a stage nor to a bench.
        StageError: The axis has an action under way.
        Exception: An error of the procedure before its first wait, for example an ArgumentError.
    """
    check_no_action(axis)
    schedule = get_schedule(axis)
    if schedule is None:
        raise ArgumentError(
            f"axis {axis.name} is of no stage and no bench, so nothing can go on while its time passes."
        )
    thread = schedule.begin(axis.name, name, procedure, round(axis.time * 1e9))
    if thread.error is not None:
        raise thread.error
    return AxisAction(axis, thread)


def check_no_action(axis: Axis) -> None:
    """Raise StageError if the axis has an action under way, unless the action itself calls this function."""
    if (other := _find_other_action(axis)) is not None:
        raise StageError(
            f"axis {axis.name} has an action under way: {other.name}. Wait until it is done, or end it by "
            "firmware.begin_stop(axis) or firmware.stop(axis)."
        )


def cancel_action(axis: Axis) -> None:
    """Cancel the action of an axis, if one is under way and does not call this function itself."""
    if (other := _find_other_action(axis)) is not None:
        other.cancel()


def get_schedule(axis: Axis) -> ProcedureSchedule | None:
    """Return the procedures under way on the machine of an axis; None for an axis of neither a stage nor a bench."""
    return getattr(axis, "procedures", None)


def _find_other_action(axis: Axis) -> ProcedureThread | None:
    """Return the procedure of the axis that is under way, unless it calls this function itself."""
    schedule = get_schedule(axis)
    under_way = None if schedule is None else schedule.find(axis.name)
    return under_way if schedule is not None and under_way is not schedule.running else None
