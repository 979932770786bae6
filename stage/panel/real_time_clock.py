"""`RealTimeClock`: pace simulated time against real time. The clock knows no stage: its methods take simulated times, in ns.

clock = RealTimeClock(1.0, stage.now)
goal = clock.plan_pacing_interval(stage.now, until, step)      how far to go next
clock.compute_seconds_until(goal, stage.now)                 real seconds until that is due
"""

from __future__ import annotations

from time import perf_counter

from stage.errors import ArgumentError

PACING_INTERVAL_S = 0.02  # real seconds between two checks for orders
MAX_COMPUTING_S = 0.01  # real seconds that a slice may compute: half of it, for machines with other work
MAX_LAG_S = 0.2  # real seconds that a stage may be late before it gives up catching up
MEASURING_TIME_S = 0.25  # real seconds over which the achieved speed is taken, at least
MAX_GROWTH = 2  # times the last slice: a short one tells little of how fast the machine is
MIN_SPEED, MAX_SPEED = 0.001, 1000.0
UNPACED_SPEED = float("inf")
"""Speed of a stage whose simulated time passes as fast as possible."""


class RealTimeClock:
    """Clock that compares simulated time with real time.

    Args:
        speed: Simulated seconds in a real second, MIN_SPEED to MAX_SPEED, or UNPACED_SPEED.
        now_ns: Simulated time, ns.

    Attributes:
        achieved_speed: Simulated seconds in a real second, measured recently; `speed` at first.
    """

    def __init__(self, speed: float, now_ns: int):
        self.speed = speed
        self.achieved_speed = self._speed
        self._ns_per_slice = PACING_INTERVAL_S * 1e9  # simulated ns that the machine can compute in a slice
        self.restart(now_ns)

    @property
    def speed(self) -> float:
        """Requested simulated seconds in a real second, or UNPACED_SPEED. Call `restart` after a change. Raises ArgumentError."""
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        if value != UNPACED_SPEED and not MIN_SPEED <= value <= MAX_SPEED:
            raise ArgumentError(
                f"speed={value!r}: {MIN_SPEED:g} to {MAX_SPEED:g} simulated seconds a second, or UNPACED_SPEED, as fast as it goes."
            )
        self._speed = float(value)

    @property
    def pacing_interval_s(self) -> float:
        """Simulated seconds that may pass before the caller has to ask the clock again."""
        return PACING_INTERVAL_S * (1.0 if self._speed == UNPACED_SPEED else self._speed)

    def restart(self, now_ns: int) -> None:
        """Restart at simulated time `now_ns`: this time is due now, whatever was late or early before."""
        self._real, self._simulated = perf_counter(), now_ns
        self._measured = (self._real, now_ns)
        self._slice_began: tuple[float, int] | None = None

    def plan_pacing_interval(self, now_ns: int, until_ns: int, min_ns: int, seconds: float = PACING_INTERVAL_S) -> int:
        """Return the simulated time, ns, at which the next slice of simulation is to end.

        Args:
            now_ns: Simulated time now, ns.
            until_ns: Simulated time that the caller wants to reach, ns.
            min_ns: Least length of the slice, ns.
            seconds: Length of the slice in real seconds. On a machine that cannot keep up, the slice is as long as can be
                computed in MAX_COMPUTING_S.
        """
        if self._slice_began is not None:
            (real, simulated), self._slice_began = self._slice_began, None
            if simulated < now_ns:
                measured = (now_ns - simulated) * MAX_COMPUTING_S / max(perf_counter() - real, 1e-9)
                self._ns_per_slice = min(measured, MAX_GROWTH * self._ns_per_slice)
        length = min(
            self.pacing_interval_s if self._speed == UNPACED_SPEED else seconds * self._speed, self._ns_per_slice * 1e-9
        )
        return min(until_ns, now_ns + max(round(length * 1e9), min_ns))

    def start_pacing_interval(self, now_ns: int) -> None:
        """Store that a slice begins at simulated time `now_ns`; the time that it takes limits the length of the next slice."""
        self._slice_began = perf_counter(), now_ns

    def compute_seconds_until(self, goal_ns: int, now_ns: int) -> float:
        """Return the real seconds until simulated time `goal_ns` is due; negative if it is late.

        The clock restarts if simulated time `now_ns`, is more than MAX_LAG_S behind, instead of trying to catch up.
        """
        if self._speed == UNPACED_SPEED:
            return 0.0
        left = self._real + (goal_ns - self._simulated) * 1e-9 / self._speed - perf_counter()
        if left < -MAX_LAG_S:
            self.restart(now_ns)
        return left

    def update_achieved_speed(self, now_ns: int) -> None:
        """Update `achieved_speed` at simulated time `now_ns`."""
        passed = perf_counter() - self._measured[0]
        if passed > MEASURING_TIME_S:
            self.achieved_speed = (now_ns - self._measured[1]) * 1e-9 / passed
            self._measured = (perf_counter(), now_ns)
