"""`Session`: a stage that runs in real time and takes orders meanwhile. The panel's page uses it, and programs may.

This module draws no page.

    with Session(Stage("xy")) as session:
        session.do(lambda stage: stage.axes["x"].chip.write(0, 0x11))      an order, between two slices of time; returns its result
        session.act("home x", lambda stage: firmware.home(stage.axes["x"]))  an action, which lets time pass; orders go on meanwhile
        session.paused = True
        session.go_back(2.0)                                                 to two seconds ago, by a snapshot
        session.view                                                         view of the stage after the last slice

Session(stage, program="mine") leaves the stage to a program. The program uses the stage from its own threads, in real time and
otherwise as without a session: only the program lets time pass,
so its run has the same bits as without a session. `suspend_program()`
makes the program wait at its next use of the stage; the session then lets time pass. `resume_program()` lets the program go on.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Self

from stage.errors import ArgumentError, StageError
from stage.firmware import procedures
from stage.panel.real_time_clock import UNPACED_SPEED
from stage.panel.stage_thread import MAX_UNPACED_NS, ActionStopped, StageThread, StageView
from stage.sim.stage import Snapshot, Stage

RECOVERY_S = 0.5  # simulated seconds to go back from trouble
ANOTHER_MACHINE = (
    "the stage had another motor then, and was another machine: time goes back no further than to where the motor was changed. "
    "Go back by less, or give the axis the motor that it had."
)


class Session(StageThread):
    """Stage in real time, see `StageThread`. While the session is open, only the threads of its program may also use the stage.

    Attributes:
        program: Name of the program that drives the stage, for people; "": no program drives it.
        program_suspended: Whether the program waits, or will wait at its next use of the stage.
    """

    # --- time ---

    @property
    def speed(self) -> float:
        """Requested simulated seconds in a real second: MIN_SPEED to MAX_SPEED of stage.panel.real_time_clock, or FREE."""
        return self._clock.speed

    @speed.setter
    def speed(self, value: float) -> None:
        self._clock.speed = value
        self._restart_clock()
        self._notify_all()

    @property
    def paused(self) -> bool:
        """True if time stands still. Bus cycles take their simulated time also during a pause."""
        return self._paused

    @paused.setter
    def paused(self, value: bool) -> None:
        self._paused = bool(value)
        if not value:
            self._trouble = ""
            self._restart_clock()
        self._notify_all()

    def run_physics_steps(self, n: int = 1) -> None:
        """Pause, and let `n` physics steps pass."""
        self.paused = True
        self.do(lambda stage: self.run_unpaced(stage.step, n))

    def go_back(self, seconds: float) -> float:
        """Stop all actions, and restore the snapshot before a number of simulated seconds ago, or the oldest snapshot.

        Args:
            seconds: Simulated seconds, 0 or more.

        Returns:
            The simulated time after that, s.

        Raises:
            ArgumentError: `seconds` is negative.
            StageError: A recording is under way, or the stage had another motor then.
        """
        if not seconds >= 0:
            raise ArgumentError(f"go_back({seconds!r}): seconds, 0 or more.")
        self.stop_actions()
        return self.do(lambda stage: self._restore_before(stage.now - round(seconds * 1e9)))

    def recover(self) -> float:
        """Restore the state of RECOVERY_S ago after a divergence, and pause, so that the user can remove the cause.

        Returns:
            The simulated time after that, s.
        """
        self.paused = True
        self.stop_actions()
        return self.do(lambda stage: self._restore_before(stage.now - round(RECOVERY_S * 1e9), to_this_machine=True))

    def reset(self) -> None:
        """Reset the stage to power-up. Raises StageError during a recording."""
        self.stop_actions()
        self.do(lambda stage: self._change_and_restart(stage.reset))

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot. Raises the errors of `Stage.restore`."""
        self.stop_actions()
        self.do(lambda stage: self._change_and_restart(lambda: stage.restore(snapshot)))

    @property
    def history_s(self) -> float:
        """Simulated seconds by which the session can go back now."""
        oldest = self._history.oldest
        return 0.0 if oldest is None else (self.stage.now - oldest) * 1e-9

    def _restore_before(self, goal: int, to_this_machine: bool = False) -> float:
        """Restore the latest snapshot before `goal`, ns, and return its time, s.

        With another motor, the stage was another machine, whose snapshots it cannot restore. The method then raises StageError, or
        with `to_this_machine` restores the oldest snapshot of the present machine.
        """
        stage = self.stage
        snapshot = self._history.find_latest_before(goal)
        if snapshot is not None and snapshot.header != stage.header:
            if not to_this_machine:
                raise StageError(ANOTHER_MACHINE)
            snapshot = self._history.find_oldest_of(stage.header)
        if snapshot is not None:
            self._change_and_restart(lambda: stage.restore(snapshot))
        return stage.time

    def _change_and_restart(self, change: Callable[[], None]) -> None:
        """Make a change after which the stage has another time or state, and restart the clock and the history."""
        change()
        self._jumped, self._trouble = True, ""
        self._polled_at = self.stage.now
        self._history.forget_after(self.stage.now)
        self._history.take_snapshot_if_due(self.stage)  # there is always a way back: to this moment, at least
        self._restart_clock()

    # --- motion ---

    def stop(self, at_once: bool = False) -> Future[None]:
        """Stop all actions, and bring all axes to rest at the same time.

        Args:
            at_once: Whether the axes stop without ramps.

        Returns:
            Future that is done when all axes rest.
        """
        self.stop_actions()

        def stop_all(stage: Stage) -> None:
            def stop_axis(axis: Any) -> Callable[[Stage], None]:
                return lambda stage: procedures.stop(axis, at_once)

            first, *others = [stop_axis(axis) for axis in stage.axes.values()]
            waiting = [self.post(order) for order in others]  # carried out while the first waits for rest
            first(stage)
            self._carry_out_orders()
            for future in waiting:
                future.result()

        return self.act("stop", stop_all)

    # --- the program ---

    def suspend_program(self) -> None:
        """Make the program wait at its next use of the stage, and let the session drive the stage."""
        self.program_suspended = bool(self.program)
        self._update_reservation()

    def resume_program(self) -> None:
        """Stop all actions of the session, and let the program drive the stage again."""
        self.stop_actions()
        self.program_suspended = False
        self._update_reservation()

    def end_program(self) -> None:
        """Make each wait of the program raise ActionStopped in its thread. Signal handlers may call this method."""
        self._ending = True
        self.resume_program()

    def detach_program(self) -> None:
        """Drive the stage without the program from now on, because the program has ended.

        Call this method in the program's thread, or after the end of that thread.
        """
        self.lock.release_all()
        self.program, self.program_suspended = "", False
        self._update_reservation()

    @property
    def program_waits(self) -> bool:
        """True if the program is suspended and waits for the stage."""
        return self.program_suspended and self.lock.has_waiting

    @property
    def catch_up_interval_s(self) -> float:
        """Simulated seconds after which a program has to call `catch_up` again."""
        return self._clock.pacing_interval_s

    def catch_up(self) -> None:
        """Wait until real time has caught up with simulated time; wait longer while time is paused or the program is suspended.

        A program calls this method if a board, and not the stage, lets time pass.
        """
        with suppress(StageError), self.lock:  # refused: the program was dismissed while it waited
            self._pace_in_program(self.stage.now + MAX_UNPACED_NS, seconds=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


__all__ = ["UNPACED_SPEED", "ActionStopped", "Session", "StageView"]
