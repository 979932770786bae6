"""The step timer's profile, slowly: rates from the definition of a ramp, positions by quadrature, times by bisection.

A ramp changes the rate from v0 to v1 in T seconds. The share `s` of the change is curved at each end: there the acceleration grows
or falls linearly in time, and between the curves it is constant. Written from docs/step_dir.md, not from the product.
"""

from __future__ import annotations

from numpy.polynomial.legendre import leggauss

NODES, WEIGHTS = leggauss(4)


def ramp_shape(x: float, s: float) -> float:
    """Return the share of the rate's change that is done after the share x of the ramp's time."""
    if x <= 0 or x >= 1:
        return min(max(x, 0.0), 1.0)
    if s == 0:
        return x
    if x > 0.5:
        return 1 - ramp_shape(1 - x, s)
    slope = 1 + 2 * s  # of the straight part, so that both curves and it add up to 1
    curve = 2 * s / slope  # time of a curve: the mean acceleration there is half of the straight part's
    return s * (x / curve) ** 2 if x < curve else s + slope * (x - curve)


class Profile:
    """Rates of a move of `steps` steps.

    Args:
        steps: Steps of the longest axis.
        start: Rate at both ends, pps.
        rate: Drive rate, pps.
        up: Time of the ramp up to `rate`, s.
        down: Time of the ramp down, s.
        s: Share of the speed change that is curved at each end of a ramp.
    """

    def __init__(self, steps: int, start: float, rate: float, up: float, down: float, s: float):
        start = min(start, rate)
        if start == rate:
            up = down = 0.0
        if (start + rate) / 2 * (up + down) > steps:  # the ramps keep their mean acceleration and meet at a lower rate
            low, high = start, rate
            for _ in range(200):
                peak = (low + high) / 2
                needed = (start + peak) / 2 * (up + down) * (peak - start) / (rate - start)
                low, high = (peak, high) if needed < steps else (low, peak)
            shrink = (peak - start) / (rate - start)
            up, down, rate = up * shrink, down * shrink, peak
        constant = max(0.0, (steps - (start + rate) / 2 * (up + down)) / rate)
        self.start, self.rate, self.up, self.down, self.s = start, rate, up, down, s
        self.seconds = up + constant + down
        curve_up, curve_down = (time * (2 * s / (1 + 2 * s)) for time in (up, down))
        fall = up + constant
        self.breaks = sorted(
            {0.0, curve_up, up / 2, up - curve_up, up, fall, fall + curve_down, fall + down / 2,
             fall + down - curve_down, self.seconds}
        )  # fmt: skip
        self.positions = [0.0]
        for a, b in zip(self.breaks, self.breaks[1:], strict=False):
            self.positions.append(self.positions[-1] + self._integrate(a, b))

    def rate_at(self, t: float) -> float:
        """Return the rate at t seconds, pps."""
        if t < self.up:
            return self.start + (self.rate - self.start) * ramp_shape(t / self.up, self.s)
        if t > self.seconds - self.down:
            return self.start + (self.rate - self.start) * ramp_shape((self.seconds - t) / self.down, self.s)
        return self.rate

    def _integrate(self, a: float, b: float) -> float:
        half, middle = (b - a) / 2, (a + b) / 2
        return half * sum(w * self.rate_at(middle + half * x) for x, w in zip(NODES, WEIGHTS, strict=True))

    def time_of(self, position: float) -> float:
        """Return the seconds at which the profile has covered a position."""
        k = max(i for i, p in enumerate(self.positions[:-1]) if p <= position)
        low, high = self.breaks[k], self.breaks[k + 1]
        for _ in range(80):
            middle = (low + high) / 2
            if self.positions[k] + self._integrate(self.breaks[k], middle) < position:
                low = middle
            else:
                high = middle
        return high

    def step_times(self, numbers: list[int]) -> list[float]:
        """Return the seconds at which steps come: step n when n - 1/2 steps are covered."""
        return [self.time_of(n - 0.5) for n in numbers]


def spread_steps(steps: int, events: int) -> list[int]:
    """Return the numbers of the events, from 1 on, at which an axis steps: Bresenham's rule, one event after the other."""
    error, numbers = events // 2, []
    for event in range(1, events + 1):
        error += steps
        if error >= events:
            error -= events
            numbers.append(event)
    return numbers
