"""`Session`: a stage in real time that takes orders while it runs. The panel's page talks to it, and programs may. No page.

    with Session(Stage("xy")) as session:
        session.do(lambda stage: stage.axes["x"].chip.write(0, 0x11))      between two slices of time; returns what it returns
        session.act("home x", lambda stage: firmware.home(stage.axes["x"]))  for as long as it takes; orders go on meanwhile
        session.paused = True
        session.go_back(2.0)                                                 to two seconds ago, by a snapshot
        session.view                                                         view of the stage after the last slice

Session(stage, program="mine") leaves the stage to a program: it drives from its own threads as it would without a session, in
real time, and time passes by it alone, so its run is bit for bit that without a session. `take_over()` makes it wait at its next
use of the stage, and time passes as if there were no program; `give_back()` lets it go on.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Self

from stage.errors import ArgumentError, StageError
from stage.firmware import procedures
from stage.panel.real_time_clock import FREE
from stage.panel.stage_thread import MAX_UNPACED_NS, ActionStopped, StageThread, StageView
from stage.sim.stage import Snapshot, Stage

RECOVERY_S = 0.5  # simulated seconds to go back from trouble
ANOTHER_MACHINE = (
    "the stage had another motor then, and was another machine: time goes back no further than to where the motor was changed. "
    "Go back by less, or give the axis the motor that it had."
)


class Session(StageThread):
    """Stage in real time, see `StageThread`. While the session is open only the threads of its program may use the stage as well.

    Attributes:
        program: Name of the program that drives, for people; "": the session has the stage alone.
        program_suspended: Whether the program waits, or will at its next use of the stage.
    """

    # --- time ---

    @property
    def speed(self) -> float:
        """Simulated seconds in a real second, MIN_SPEED to MAX_SPEED of stage.panel.real_time_clock, or FREE."""
        return self._clock.speed

    @speed.setter
    def speed(self, value: float) -> None:
        self._clock.speed = value
        self._restart_clock()
        self._notify_all()

    @property
    def paused(self) -> bool:
        """State of time: it stands still. Bus cycles take their time all the same."""
        return self._paused

    @paused.setter
    def paused(self, value: bool) -> None:
        self._paused = bool(value)
        if not value:
            self._trouble = ""
            self._restart_clock()
        self._notify_all()

    def single_step(self, n: int = 1) -> None:
        """Pause, and let `n` physics steps pass."""
        self.paused = True
        self.do(lambda stage: self.run_unpaced(stage.step, n))

    def go_back(self, seconds: float) -> float:
        """Go back to the snapshot before so many simulated seconds ago, as far as the session remembers.

        Actions are stopped.

        Args:
            seconds: 0 or more.

        Returns:
            The time that it is then, s.

        Raises:
            ArgumentError: A negative number of seconds.
            StageError: A recording goes on, or the stage had another motor then.
        """
        if not seconds >= 0:
            raise ArgumentError(f"go_back({seconds!r}): seconds, 0 or more.")
        self.stop_actions()
        return self.do(lambda stage: self._restore_before(stage.now - round(seconds * 1e9)))

    def recover(self) -> float:
        """Go back to RECOVERY_S ago, after a divergence, and pause until somebody has removed the cause. Return the time, s."""
        self.paused = True
        self.stop_actions()
        return self.do(lambda stage: self._restore_before(stage.now - round(RECOVERY_S * 1e9), to_this_machine=True))

    def reset(self) -> None:
        """Go to power-up. Raises StageError while a recording goes on."""
        self.stop_actions()
        self.do(lambda stage: self._jump(stage.reset))

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from a snapshot. Raises as `Stage.restore`."""
        self.stop_actions()
        self.do(lambda stage: self._jump(lambda: stage.restore(snapshot)))

    @property
    def history_s(self) -> float:
        """Simulated seconds that the session can go back now."""
        oldest = self._history.oldest
        return 0.0 if oldest is None else (self.stage.now - oldest) * 1e-9

    def _restore_before(self, goal: int, to_this_machine: bool = False) -> float:
        """Restore the snapshot before `goal`, ns, and return its time, s.

        With another motor the machine was another one, and there is no way back to it: StageError, or, `to_this_machine`, to where
        this one begins.
        """
        stage = self.stage
        snapshot = self._history.find_before(goal)
        if snapshot is not None and snapshot.header != stage.header:
            if not to_this_machine:
                raise StageError(ANOTHER_MACHINE)
            snapshot = self._history.find_oldest_of(stage.header)
        if snapshot is not None:
            self._jump(lambda: stage.restore(snapshot))
        return stage.time

    def _jump(self, change: Callable[[], None]) -> None:
        """Make a change after which the stage is elsewhere in time."""
        change()
        self._jumped, self._trouble = True, ""
        self._polled_at = self.stage.now
        self._history.forget_after(self.stage.now)
        self._history.remember(self.stage)  # there is always a way back: to this moment, at least
        self._restart_clock()

    # --- motion ---

    def stop(self, at_once: bool = False) -> Future[None]:
        """Stop all actions, and bring all axes to rest at the same time.

        Args:
            at_once: Without a ramp.

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

    def take_over(self) -> None:
        """Make the program wait at its next use of the stage, and drive the stage from the session."""
        self.program_suspended = bool(self.program)
        self._reserve()

    def give_back(self) -> None:
        """Stop all actions and let the program drive again."""
        self.stop_actions()
        self.program_suspended = False
        self._reserve()

    def end_program(self) -> None:
        """Make every wait of the program raise ActionStopped in its thread. Signal handlers may call it."""
        self._ending = True
        self.give_back()

    def dismiss_program(self) -> None:
        """Drive the stage alone from now on: the program has ended. Call it from the program's thread, or after its end."""
        self.lock.release_all()
        self.program, self.program_suspended = "", False
        self._reserve()

    @property
    def program_waits(self) -> bool:
        """State of a suspended program: it waits for the stage."""
        return self.program_suspended and self.lock.has_waiting

    @property
    def slice_s(self) -> float:
        """Simulated seconds between two `catch_up` of a program."""
        return self._clock.slice_s

    def catch_up(self) -> None:
        """Wait until real time has caught up, and while time is paused or the program suspended.

        For a program that lets time pass by a board and not by the stage.
        """
        with suppress(StageError), self.lock:  # refused: the program was dismissed while it waited
            self._pace_program(self.stage.now + MAX_UNPACED_NS, seconds=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


__all__ = ["FREE", "ActionStopped", "Session", "StageView"]
