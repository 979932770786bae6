"""`RealTimePace`: hold a run back to wall-clock time, and measure how far it lags behind."""

from __future__ import annotations

import time


class RealTimePace:
    """Pace of a run at which a simulated second takes a second of wall-clock time.

    Attributes:
        lag_s: Seconds by which simulated time was behind wall-clock time at the last `wait`; 0 if it was ahead.
        largest_lag_s: The largest of these so far.
    """

    SLICE_NS = 5_000_000
    """Simulated time between two calls of `wait`."""

    def __init__(self) -> None:
        self._begin: tuple[float, int] | None = None
        self.lag_s = self.largest_lag_s = 0.0

    def start(self, now: int) -> None:
        """Begin at the time `now` of the stage, ns, unless the run has begun."""
        if self._begin is None:
            self._begin = time.perf_counter(), now

    def wait(self, now: int) -> None:
        """Sleep until wall-clock time has reached the time `now` of the stage, ns."""
        begin, first = self._begin or (time.perf_counter(), now)
        ahead = (now - first) * 1e-9 - (time.perf_counter() - begin)
        self.lag_s = max(-ahead, 0.0)
        self.largest_lag_s = max(self.largest_lag_s, self.lag_s)
        if ahead > 0:
            time.sleep(ahead)
