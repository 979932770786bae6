"""`Clock`: a stage's time against real time. No page, and no stage: times of the stage are given, in ns.

clock = Clock(1.0, stage.now)
clock.goal(stage.now, until, step)    how far it may go next; clock.early(goal): real s until that is due
"""

from __future__ import annotations

from time import perf_counter

from stage.errors import ArgumentError

SLICE = 0.02  # s of real time that pass at a time
BEHIND = 0.2  # s of real time by which a stage may be late before it gives up catching up
MEASURED = 0.25  # s of real time over which a pace is taken, at least
SLOWEST, FASTEST = 0.001, 1000.0
FREE = float("inf")


class Clock:
    """Attributes: pace: simulated seconds a real second of late, `speed` where it keeps up."""

    def __init__(self, speed: float, now: int):
        self.speed = speed
        self.pace = self._speed
        self.restart(now)

    @property
    def speed(self) -> float:
        """Simulated seconds a real second, SLOWEST to FASTEST, or FREE. Whoever changes it begins anew: `restart`."""
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        if value != FREE and not SLOWEST <= value <= FASTEST:
            raise ArgumentError(
                f"speed={value!r}: {SLOWEST:g} to {FASTEST:g} simulated seconds a second, or FREE, as fast as it goes."
            )
        self._speed = float(value)

    @property
    def piece(self) -> float:
        """Simulated seconds of a slice."""
        return SLICE * (1.0 if self._speed == FREE else self._speed)

    def restart(self, now: int) -> None:
        """It is `now`: nothing is late, nothing is early."""
        self._real, self._simulated = perf_counter(), now
        self._measured = (self._real, now)

    def goal(self, now: int, until: int, least: int, ahead: float = SLICE) -> int:
        """How far to go towards `until`: what passes in `ahead` real seconds, `least` ns at least."""
        if self._speed == FREE:
            return min(until, now + round(SLICE * 1e9))
        return min(until, now + max(round(ahead * self._speed * 1e9), least))

    def early(self, goal: int, now: int) -> float:
        """Real seconds until `goal` is due, negative where that was before. Where it was long before, what is lost is given up."""
        if self._speed == FREE:
            return 0.0
        early = self._until(goal)
        if early < -BEHIND:
            self.restart(now)
        return early

    def _until(self, goal: int) -> float:
        return self._real + (goal - self._simulated) * 1e-9 / self._speed - perf_counter()

    def measure(self, now: int) -> None:
        """Look at the time, for `pace`."""
        passed = perf_counter() - self._measured[0]
        if passed > MEASURED:
            self.pace = (now - self._measured[1]) * 1e-9 / passed
            self._measured = (perf_counter(), now)
