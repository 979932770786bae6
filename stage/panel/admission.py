"""`Admission`: lets a program's thread let time pass: in real time, not while somebody has the stage or has paused. No page."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from stage.panel.clock import FREE, SLICE

if TYPE_CHECKING:
    from stage.panel.clock import Clock
    from stage.panel.turns import Turns
    from stage.sim.stage import Stage

SHORTEST = 1_000_000  # ns: what is shorter, a bus cycle, does not wait for real time
PATIENCE = 0.5  # s between looks at whether something has changed


class Admission:
    """Of one stage. paused, over: whether time stands still; whether the program need not wait any more."""

    def __init__(self, stage: Stage, clock: Clock, turns: Turns, paused: Callable[[], bool], over: Callable[[], bool]):
        self._stage, self._clock, self._turns = stage, clock, turns
        self._paused, self._over = paused, over

    def until(self, until: int, ahead: float = SLICE) -> int:
        """The stage's time is to go on to `until`, ns: how far it may go now, when that is due. ahead: real seconds that it may go
        at a time. In the program's thread: nothing but waiting happens here."""
        self._turns.admit()
        if until - self._stage.now < SHORTEST:
            return until
        while not self._over():
            now = self._stage.now
            if now >= until:  # somebody else has let so much time pass
                return until
            if self._paused():
                self._turns.rest(PATIENCE)
                continue
            speed = self._clock.speed
            goal = self._clock.goal(now, until, self._stage.state.dt if ahead else 0, ahead)
            early = self._clock.early(goal, now)
            if speed == FREE or early <= 0:
                return goal
            self._turns.rest(min(early, PATIENCE))
        return until
