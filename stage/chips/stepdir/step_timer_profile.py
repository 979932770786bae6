"""Profile of the step timer, compiled: rates over time as segments of constant jerk, and the time of each step.

A ramp of T seconds changes the rate by dv with the acceleration a = (1 + 2 s) dv / T, where the share s of dv is curved at each
end: there the acceleration rises and falls with the jerk a^2 / (2 s dv). With s = 0 the ramp is linear. For every s a ramp covers
(v0 + v1) T / 2 steps, so a move that is too short for its drive rate reaches the same peak rate with every s.

Step k of a move comes when the profile has covered k - 1/2 steps: the count is never further than half a step from the profile.
"""

from __future__ import annotations

import math

from stage.chips.stepdir.state import CURVED, NEVER, RAMP_DOWN, RAMP_UP, RATE, START
from stage.chips.stepdir.step_edges import to_clocks
from stage.native import greatest, hot

TIME_TOLERANCE_S = 1e-11
"""Seconds; the time of a step on a curve is computed up to this error."""
MAX_ITERATIONS = 60
MAX_PERIOD_S = 1e6
"""Seconds; a step that is further away does not come."""


@hot
def _add_segment(chip, seconds, rate, acceleration, jerk):
    """Add a segment of constant jerk at the end of the profile, and move the end.

    Args:
        chip: State of the chip.
        seconds: Duration of the segment, s.
        rate: Rate at its start, steps of the longest axis per second.
        acceleration: Acceleration at its start, steps/s^2.
        jerk: Jerk, steps/s^3.
    """
    k = chip.segments
    chip.rate[k], chip.acceleration[k], chip.jerk[k] = rate, acceleration, jerk
    chip.begin[k + 1] = chip.begin[k] + seconds
    chip.position[k + 1] = chip.position[k] + seconds * (rate + seconds * (0.5 * acceleration + seconds * jerk / 6.0))
    chip.rate[k + 1] = rate + seconds * (acceleration + 0.5 * seconds * jerk)
    chip.acceleration[k + 1] = chip.jerk[k + 1] = 0.0
    chip.segments = k + 1


@hot
def _add_ramp(chip, seconds, begin_rate, end_rate):
    """Add a ramp from one rate to a higher or lower rate, steps per second, in a number of seconds."""
    change, share = end_rate - begin_rate, 0.01 * chip.reg[CURVED]
    if seconds <= 0.0 or change == 0.0:
        return
    acceleration = (1.0 + 2.0 * share) * change / seconds
    if share == 0.0:
        _add_segment(chip, seconds, begin_rate, acceleration, 0.0)
        return
    curve = 2.0 * share * change / acceleration
    jerk = acceleration / curve
    _add_segment(chip, curve, begin_rate, 0.0, jerk)
    if share < 0.5:
        _add_segment(chip, seconds - 2.0 * curve, begin_rate + share * change, acceleration, 0.0)
    _add_segment(chip, curve, end_rate - share * change, acceleration, -jerk)


@hot
def _begin_profile(chip):
    """Clear the profile, and begin it at the present clock."""
    chip.started, chip.segment, chip.segments = chip.clock, 0, 0
    chip.begin[0] = chip.position[0] = chip.acceleration[0] = chip.jerk[0] = 0.0


@hot
def plan_move(chip):
    """Plan the profile of a move of `chip.events` steps, or of a continuous move if that is 0."""
    _begin_profile(chip)
    top = float(chip.reg[RATE])
    low = float(chip.reg[START]) if chip.reg[START] < top else top
    up, down = 1e-6 * chip.reg[RAMP_UP], 1e-6 * chip.reg[RAMP_DOWN]
    if low == top:
        up = down = 0.0
    if chip.events == 0:
        _add_ramp(chip, up, low, top)
        chip.rate[chip.segments] = top
        chip.profile_end = NEVER
        return
    n = float(chip.events)
    if 0.5 * (low + top) * (up + down) > n:  # the ramps meet below the drive rate
        steepness = (top - low) / (up + down)
        peak = math.sqrt(low * low + 2.0 * n * steepness)
        up, down, top = up * (peak - low) / (top - low), down * (peak - low) / (top - low), peak
    _add_ramp(chip, up, low, top)
    _add_segment(chip, greatest(0.0, n - 0.5 * (low + top) * (up + down)) / top, top, 0.0, 0.0)
    _add_ramp(chip, down, top, low)
    chip.position[chip.segments] = n
    chip.profile_end = chip.started + to_clocks(chip, chip.begin[chip.segments])


@hot
def plan_stop(chip):
    """Replace the rest of the profile by the ramp down from the present rate to START."""
    seconds = float(chip.clock - chip.started) / chip.hz
    rate = compute_present_rate(chip)
    position = compute_present_position(chip)
    top, low = float(chip.reg[RATE]), float(chip.reg[START])
    down = 1e-6 * chip.reg[RAMP_DOWN] * (rate - low) / (top - low) if low < top else 0.0
    started = chip.started
    _begin_profile(chip)
    chip.started = started
    chip.begin[0], chip.position[0] = seconds, position
    if rate > low:
        _add_ramp(chip, down, rate, low)
    chip.rate[chip.segments] = low if rate > low else rate
    chip.profile_end = chip.started + to_clocks(chip, chip.begin[chip.segments])


@hot
def _find_present_segment(chip):
    """Return the index of the profile's segment at the present clock, and the seconds since its beginning."""
    seconds = float(chip.clock - chip.started) / chip.hz
    k = 0
    while k + 1 <= chip.segments and chip.begin[k + 1] <= seconds:
        k += 1
    return k, seconds - chip.begin[k]


@hot
def compute_present_rate(chip):
    """Compute the rate of the profile at the present clock, steps of the longest axis per second."""
    k, s = _find_present_segment(chip)
    return chip.rate[k] + s * (chip.acceleration[k] + 0.5 * s * chip.jerk[k])


@hot
def compute_present_position(chip):
    """Compute the steps of the longest axis that the profile has covered at the present clock."""
    k, s = _find_present_segment(chip)
    return chip.position[k] + s * (chip.rate[k] + s * (0.5 * chip.acceleration[k] + s * chip.jerk[k] / 6.0))


@hot
def find_present_ramp(chip):
    """Return 1 while the rate of the profile rises, -1 while it falls, 0 while it is constant."""
    k, _ = _find_present_segment(chip)
    slope = chip.acceleration[k] if chip.acceleration[k] != 0.0 else chip.jerk[k]
    return 1 if slope > 0.0 else -1 if slope < 0.0 else 0


@hot
def _compute_time_at_constant_acceleration(distance, rate, acceleration):
    """Return the seconds in which a segment without jerk covers a distance; infinite if it never does."""
    root = math.sqrt(greatest(0.0, rate * rate + 2.0 * acceleration * distance))
    return 2.0 * distance / (rate + root) if rate + root > 0.0 else math.inf


@hot
def _compute_time_at_constant_jerk(distance, rate, acceleration, jerk, seconds):
    """Return the seconds in which a segment of constant jerk covers a distance, by Newton's method between two bounds.

    Args:
        distance: Distance in steps, at most that of the whole segment.
        rate: Rate at the start of the segment, steps/s.
        acceleration: Acceleration at the start of the segment, steps/s^2.
        jerk: Jerk of the segment, steps/s^3.
        seconds: Duration of the segment, the upper bound.
    """
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
        if abs(better - s) < TIME_TOLERANCE_S:
            return better
        s = better
    return s


@hot
def find_time_of_step(chip, target):
    """Return the clock at which the profile has covered `target` steps of the longest axis, or NEVER. Updates `chip.segment`."""
    k = chip.segment
    while k < chip.segments and chip.position[k + 1] < target:
        k += 1
    chip.segment = k
    if k == chip.segments and chip.profile_end != NEVER:
        return NEVER
    distance = target - chip.position[k]
    if chip.jerk[k] == 0.0:
        seconds = _compute_time_at_constant_acceleration(distance, chip.rate[k], chip.acceleration[k])
    else:
        seconds = _compute_time_at_constant_jerk(
            distance, chip.rate[k], chip.acceleration[k], chip.jerk[k], chip.begin[k + 1] - chip.begin[k]
        )
    return chip.started + to_clocks(chip, chip.begin[k] + seconds) if seconds < MAX_PERIOD_S else NEVER
