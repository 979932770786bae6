"""`Life`: the thread in which a session's stage lives: time passes in slices, orders are carried out between them. No page.

Time is cut into slices of SLICE seconds of real time at most; the stage's promise that cutting time changes nothing makes a
session's run that of the same program without one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from time import perf_counter
from typing import Any

from stage.errors import SimulationError, StageError
from stage.panel.admission import SHORTEST, Admission
from stage.panel.clock import BEHIND, FREE, SLICE, Clock
from stage.panel.past import Past
from stage.panel.queues import Abandoned, Queues
from stage.panel.travel import outside
from stage.panel.turns import Turns
from stage.panel.view import Views
from stage.sim.stage import Stage

LAST_LOOK = (
    0.1  # s of real time for which one looks on after a program has done something: those who look seldom see its end
)
MAX_BUS_CYCLE_NS = 50_000  # ns: what is shorter is a bus cycle, and nothing comes between the bytes of a number
ANOTHER = (
    "the stage had another motor then, and was another machine: time goes back no further than to where the motor was changed. "
    "Go back by less, or give the axis the motor that it had."
)


class Life:
    """Of a session, from now until `closed`. Whoever changes what it goes by rings.

    Attributes: program, taken, paused: as a Session's. trouble: why time stands still though nobody paused, or "". ending: the
    program is to end: it waits no more, and lets no time pass.
    """

    def __init__(self, stage: Stage, speed: float, paused: bool, program: str):
        if stage.loop.pace is not None:
            raise StageError("this stage has a session already: close that one first.")
        self.stage, self.program, self.taken = stage, program, False
        self.paused, self.closed, self.trouble = paused, False, ""
        self.ending = False
        self.clock = Clock(speed, stage.now)
        self.queues, self.turns, self.past, self.views = Queues(), Turns(), Past(), Views(stage, speed)
        self.admission = Admission(
            stage, self.clock, self.turns, lambda: self.paused, lambda: self.closed or self.ending or not self.program
        )
        self._hasty = self._jumped = False
        self._changed_at, self._looked_at = 0.0, stage.now
        self.wake = threading.Event()
        self.called = threading.Event()  # this thread, while a program has the stage
        self.thread = threading.Thread(target=self._live, name="pulsestage session", daemon=True)
        stage.loop.pace = self._until
        self.thread.start()

    # --- from any thread ---

    def ring(self) -> None:
        """Something has changed: whoever waits looks again."""
        self.wake.set()
        self.called.set()
        self.turns.ring()

    def restart_clock(self) -> None:
        """Whatever was late or early: it is now."""
        self.clock.restart(self.stage.now)

    # --- in this thread, for orders ---

    def at_once(self, run: Callable[..., Any], *given: Any) -> None:
        """Let time pass as fast as it goes, without orders between."""
        self._hasty = True
        try:
            run(*given)
        finally:
            self._hasty = False
            self.restart_clock()

    def back(self, goal: int, to_good: bool = False) -> float:
        """To the snapshot before `goal`, ns; the time that it is then, s. A machine that had another motor then is another,
        and there is no way back to it: StageError, or, `to_good`, to where this one begins."""
        stage = self.stage
        snapshot = self.past.before(goal)
        if snapshot is not None and snapshot.header != stage.header:
            if not to_good:
                raise StageError(ANOTHER)
            snapshot = self.past.oldest_of(stage.header)
        if snapshot is not None:
            self.go_to(lambda: stage.restore(snapshot))
        return stage.time

    def go_to(self, change: Callable[[], None]) -> None:
        """The stage is elsewhere in time after `change()`."""
        change()
        self._jumped, self.trouble = True, ""
        self.past.forget_after(self.stage.now)
        self.past.remember(self.stage)  # there is always a way back: to here, at least
        self.restart_clock()

    def publish(self) -> None:
        """What is there now becomes `view`. A carriage that has left its travel is trouble, however it came there."""
        stage, acting = self.stage, self.queues.acting
        if not self.trouble and (left := outside(stage)):
            self.trouble = left
        if self.trouble:
            self.queues.abandon()
        self.clock.measure(stage.now)
        self.views.publish(stage, self.clock.pace, acting.name if acting else "", self.trouble)

    # --- this thread ---

    def _live(self) -> None:
        try:
            while not self.closed:
                if self.program and not self.taken:
                    self._beside()
                elif self.turns.claim(BEHIND, self._is_over):
                    self._live_on()
        finally:
            self.stage.loop.pace = None
            self.turns.release()
            self.queues.end()

    def _is_over(self) -> bool:
        return self.closed

    def _live_on(self) -> None:
        """For as long as the stage is the session's."""
        self.restart_clock()
        while not self.closed and (self.taken or not self.program):
            self._carry_out()
            if self.queues.actions:
                self.restart_clock()
                self.queues.perform(self.stage, self.publish)
            elif self.paused or self.trouble:
                self._rest()
            else:
                self._run()
        if self.program:
            self.restart_clock()
            self.turns.release()

    def _beside(self) -> None:
        """A program has the stage: orders are carried out between what it does, and what it has done is seen."""
        self.called.wait(SLICE)
        self.called.clear()
        changed = perf_counter() if self.stage.now != self.views.at else self._changed_at
        self._changed_at, news = changed, perf_counter() - changed < LAST_LOOK
        if (self.queues.orders or news) and self.turns.claim(SLICE, self._is_over):
            try:
                self._carry_out()
                self.past.remember(self.stage)
                self.trouble = ""  # what there is, is the program's: looked at anew
                self.publish()
            finally:
                self.turns.release()

    def _run(self) -> None:
        """A slice without anybody's action. It ends early for an action, and where time has jumped: its end lies elsewhere then."""
        self._jumped = False
        try:
            self.stage.run(self.clock.piece)
        except SimulationError as error:
            self.trouble = str(error)
            self.publish()
        except Abandoned:
            pass

    def _until(self, until: int) -> int:
        """The stage's time is to go on to `until`, ns: how far it may go now, when it is due. See `Loop.pace`."""
        stage = self.stage
        if threading.current_thread() is not self.thread:
            wanted, until = until, self.admission.until(until) if self.program else until
            if self.ending and wanted - stage.now >= SHORTEST:
                raise Abandoned("the program ends.")
            if not (self.program or self.closed):
                raise StageError("this stage lives in a session: give it orders, session.do(...).")
            return until
        now = stage.now
        if self._hasty or until - now < (SHORTEST if self._has_just_looked(until) else MAX_BUS_CYCLE_NS):
            return until
        self.publish()
        while True:
            self._carry_out()
            if self.closed or self._over():
                raise Abandoned("stopped.")
            if not self.paused:
                break
            self._rest()
        self.past.remember(stage)
        self._looked_at = self._due(until)
        return self._looked_at

    def _has_just_looked(self, until: int) -> bool:
        """Tell whether an action may go on to `until` before orders are looked at; many short waits of a poll are a long one."""
        return self.queues.acting is None or 0 <= until - self._looked_at < SHORTEST

    def _due(self, until: int) -> int:
        """How far the stage may go towards `until`, when that is due; orders are carried out until then."""
        stage, clock, speed = self.stage, self.clock, self.clock.speed
        goal = clock.goal(stage.now, until, stage.state.dt)
        clock.early(goal, stage.now)  # where it is late it catches up, or gives up
        while speed != FREE and (early := clock.early(goal, stage.now)) > 0:
            self.wake.wait(early)
            self.wake.clear()
            self._carry_out()
            if self.paused or self.closed or speed != clock.speed or self._over():
                return stage.now  # nothing passes; asked again at once
        return max(goal, stage.now)

    def _over(self) -> bool:
        """Whether what lets time pass is to end where it is."""
        if self.queues.acting is not None:
            return self.queues.acting.abandoned
        return self._jumped or self.queues.actions or bool(self.trouble) or bool(self.program and not self.taken)

    def _rest(self) -> None:
        self.publish()
        self.wake.wait(0.5)
        self.wake.clear()

    def _carry_out(self) -> None:
        """The orders that have come."""
        if self.queues.carry_out(self.stage):
            self.publish()
