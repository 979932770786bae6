"""Profile of the step timer, compiled: rates over time as segments of constant jerk, and the time of each step.

A ramp of T seconds changes the rate by dv with the acceleration a = (1 + 2 s) dv / T, where the share s of dv is curved at each
end: there the acceleration rises and falls with the jerk a^2 / (2 s dv). With s = 0 the ramp is linear. For every s a ramp covers
(v0 + v1) T / 2 steps, so a move that is too short for its drive rate reaches the same peak rate with every s.

Step k of a move comes when the profile has covered k - 1/2 steps: the count is never further than half a step from the profile.
"""

from __future__ import annotations

import math

from stage.chips.stepdir.state import CURVED, NEVER, RAMP_DOWN, RAMP_UP, RATE, START, to_clocks
from stage.native import greatest, hot

SOLVED_S = 1e-11
"""Seconds; the time of a step on a curve is computed up to this error."""
MAX_ITERATIONS = 60
MAX_PERIOD_S = 1e6
"""Seconds; a step that is further away does not come."""


@hot
def _add_segment(c, seconds, rate, acceleration, jerk):
    """Add a segment at the end of the profile, and move the end."""
    k = c.segments
    c.rate[k], c.acceleration[k], c.jerk[k] = rate, acceleration, jerk
    c.begin[k + 1] = c.begin[k] + seconds
    c.position[k + 1] = c.position[k] + seconds * (rate + seconds * (0.5 * acceleration + seconds * jerk / 6.0))
    c.rate[k + 1] = rate + seconds * (acceleration + 0.5 * seconds * jerk)
    c.acceleration[k + 1] = c.jerk[k + 1] = 0.0
    c.segments = k + 1


@hot
def _add_ramp(c, seconds, low, high):
    """Add a ramp from rate `low` to rate `high`, which may be the lower one."""
    change, share = high - low, 0.01 * c.reg[CURVED]
    if seconds <= 0.0 or change == 0.0:
        return
    acceleration = (1.0 + 2.0 * share) * change / seconds
    if share == 0.0:
        _add_segment(c, seconds, low, acceleration, 0.0)
        return
    curve = 2.0 * share * change / acceleration
    jerk = acceleration / curve
    _add_segment(c, curve, low, 0.0, jerk)
    if share < 0.5:
        _add_segment(c, seconds - 2.0 * curve, low + share * change, acceleration, 0.0)
    _add_segment(c, curve, high - share * change, acceleration, -jerk)


@hot
def _begin_profile(c):
    c.started, c.segment, c.segments = c.clock, 0, 0
    c.begin[0] = c.position[0] = c.acceleration[0] = c.jerk[0] = 0.0


@hot
def plan_move(c):
    """Plan the profile of a move of `c.events` steps, or of a run without end if that is 0."""
    _begin_profile(c)
    top = float(c.reg[RATE])
    low = float(c.reg[START]) if c.reg[START] < top else top
    up, down = 1e-6 * c.reg[RAMP_UP], 1e-6 * c.reg[RAMP_DOWN]
    if low == top:
        up = down = 0.0
    if c.events == 0:
        _add_ramp(c, up, low, top)
        c.rate[c.segments] = top
        c.profile_end = NEVER
        return
    n = float(c.events)
    if 0.5 * (low + top) * (up + down) > n:  # the ramps meet below the drive rate
        steepness = (top - low) / (up + down)
        peak = math.sqrt(low * low + 2.0 * n * steepness)
        up, down, top = up * (peak - low) / (top - low), down * (peak - low) / (top - low), peak
    _add_ramp(c, up, low, top)
    _add_segment(c, greatest(0.0, n - 0.5 * (low + top) * (up + down)) / top, top, 0.0, 0.0)
    _add_ramp(c, down, top, low)
    c.position[c.segments] = n
    c.profile_end = c.started + to_clocks(c, c.begin[c.segments])


@hot
def plan_stop(c):
    """Replace the rest of the profile by the ramp down from the present rate to START."""
    seconds, rate, position = float(c.clock - c.started) / c.hz, rate_now(c), position_now(c)
    top, low = float(c.reg[RATE]), float(c.reg[START])
    down = 1e-6 * c.reg[RAMP_DOWN] * (rate - low) / (top - low) if low < top else 0.0
    started = c.started
    _begin_profile(c)
    c.started = started
    c.begin[0], c.position[0] = seconds, position
    if rate > low:
        _add_ramp(c, down, rate, low)
    c.rate[c.segments] = low if rate > low else rate
    c.profile_end = c.started + to_clocks(c, c.begin[c.segments])


@hot
def _segment_now(c):
    """Return the segment of the present clock, and the seconds since its begin."""
    seconds = float(c.clock - c.started) / c.hz
    k = 0
    while k + 1 <= c.segments and c.begin[k + 1] <= seconds:
        k += 1
    return k, seconds - c.begin[k]


@hot
def rate_now(c):
    """Compute the rate of the profile at the present clock, steps of the longest axis per second."""
    k, s = _segment_now(c)
    return c.rate[k] + s * (c.acceleration[k] + 0.5 * s * c.jerk[k])


@hot
def position_now(c):
    """Compute the steps of the longest axis that the profile has covered at the present clock."""
    k, s = _segment_now(c)
    return c.position[k] + s * (c.rate[k] + s * (0.5 * c.acceleration[k] + s * c.jerk[k] / 6.0))


@hot
def ramp_now(c):
    """Return 1 while the rate of the profile rises, -1 while it falls, 0 while it is constant."""
    k, _ = _segment_now(c)
    slope = c.acceleration[k] if c.acceleration[k] != 0.0 else c.jerk[k]
    return 1 if slope > 0.0 else -1 if slope < 0.0 else 0


@hot
def _solve_line(distance, rate, acceleration):
    """Return the seconds in which a segment without jerk covers a distance; infinite if it does not."""
    root = math.sqrt(greatest(0.0, rate * rate + 2.0 * acceleration * distance))
    return 2.0 * distance / (rate + root) if rate + root > 0.0 else math.inf


@hot
def _solve_curve(distance, rate, acceleration, jerk, seconds):
    """Return the seconds in which a curved segment of a duration covers a distance: Newton's method between two bounds."""
    low, high = 0.0, seconds
    s = 0.5 * seconds
    for _ in range(MAX_ITERATIONS):
        error = s * (rate + s * (0.5 * acceleration + s * jerk / 6.0)) - distance
        if error > 0.0:
            high = s
        else:
            low = s
        slope = rate + s * (acceleration + 0.5 * s * jerk)
        better = s - error / slope if slope > 0.0 else low
        if not low < better < high:
            better = 0.5 * (low + high)
        if abs(better - s) < SOLVED_S:
            return better
        s = better
    return s


@hot
def find_step(c, target):
    """Return the clock at which the profile has covered `target` steps of the longest axis, or NEVER; `c.segment` moves there."""
    k = c.segment
    while k < c.segments and c.position[k + 1] < target:
        k += 1
    c.segment = k
    if k == c.segments and c.profile_end != NEVER:
        return NEVER
    distance = target - c.position[k]
    if c.jerk[k] == 0.0:
        seconds = _solve_line(distance, c.rate[k], c.acceleration[k])
    else:
        seconds = _solve_curve(distance, c.rate[k], c.acceleration[k], c.jerk[k], c.begin[k + 1] - c.begin[k])
    return c.started + to_clocks(c, c.begin[k] + seconds) if seconds < MAX_PERIOD_S else NEVER
