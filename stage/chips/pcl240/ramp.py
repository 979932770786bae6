"""Ramps of the PCL-240 family, step 3 of a tick: the speed to reach, and the tick of the next speed step; compiled.

A linear ramp takes a step every R4 or R5 clocks; one down is over, and FDOWN falls, R5 - 1 clocks after its last step. An S-curve
ramp of K steps with curved ends of S steps each takes its k-th step at t(k) clocks after its start, and is over at T:

    rate sqrt(k S)                    k <= S            from rest: the acceleration grows with time
    rate (S + k) / 2                  S < k <= K - S    linear
    T - rate sqrt((K - k) S)          K - S < k         the first part, mirrored;  T = (K + 2 S) rate / 2

in exact integers, for 2 S and 2 T are whole. All this is the normative model's section 7.
"""

from __future__ import annotations

import math

from stage.chips.pcl240 import state
from stage.native import greatest, hot

NEVER = 1 << 40


@hot
def read_selected_speed(c):
    """Return the speed that the operating mode selects, or the corrected FH in its place."""
    if c.speed_select == c.corrected_select and c.speed_select:
        return c.corrected_speed
    if c.speed_select == state.FH1:
        return c.reg[2]
    if c.speed_select == state.FH2:
        return c.reg[3]
    return c.reg[1]


@hot
def is_slowed_by_sd(c):
    """Return whether SD is enabled and the SD switch of the direction is asserted."""
    return c.sd_enable and c.active_inputs & (state.SD_MINUS if c.minus else state.SD_PLUS)


@hot
def is_ramp_down_automatic(c):
    """Return whether the automatic ramp-down point is in force, in place of R0 < R6."""
    return c.automatic_ramp_down and c.preset and c.uses_ramps and not c.automatic_off


@hot
def compute_ramp_down_margin(c):
    """Compute the number of pulses by which R0 is above the automatic ramp-down point."""
    offset = c.reg[6]
    if offset & c.offset_sign_bit:
        offset -= 2 * c.offset_sign_bit
    return c.reg[0] - c.rise_pulses - offset


@hot
def find_goal_speed(c):
    """Return the speed to which a ramp leads: FL or the selected speed."""
    if c.stopping or c.ramp_down_due or c.passed_org or is_slowed_by_sd(c):
        return c.reg[1]
    if c.preset and c.reg[0] < c.reg[6] and not is_ramp_down_automatic(c):
        return c.reg[1]
    return read_selected_speed(c)


@hot
def _compute_integer_root(x):
    """Return the integer part of a square root, x < 2^62."""
    r = int(math.sqrt(float(x)))
    while r * r > x:
        r -= 1
    while (r + 1) * (r + 1) <= x:
        r += 1
    return r


@hot
def correct_fh(c):
    """Correct FH at the start of a preset run: a distance too short to reach FH gets a lower top speed.

    Source: data sheet MS, 3-4. The automatic ramp-down decelerates at R4, so R4 replaces R5. With s = R14 + R15, m = max(R14, R15):

        pulses for a trapezoid       (R2^2 - R1^2) R4 / (8192 R7)    or  (R1 + R2) (R2 - R1 + s) R4 / (16384 R7)
        pulses for a linear part     (R1 + m) (s + 2 m) R4 / (8192 R7)
        revised R2                   sqrt(8192 R0 R7 / R4 + R1^2)    or  (-s + sqrt((s - 2 R1)^2 + 65536 R0 R7 / R4)) / 2
    """
    low, high, rate = c.reg[1], read_selected_speed(c), c.reg[4]
    if (
        not (
            c.s_curves
            and is_ramp_down_automatic(c)
            and (c.speed_select == state.FH1 or c.speed_select == state.FH2)
            and rate
        )
        or c.reg[state.R14] & state.UNCORRECTED
    ):
        return
    product = c.reg[0] * c.multiplier
    a, b = c.reg[state.R14] & state.SPAN, c.reg[state.R15] & state.SPAN
    s, m = a + b, greatest(a, b)
    linear = c.reg[state.R14] & state.LINEAR or a == 0 or b == 0 or 2 * m >= high - low
    if product * 16384 > ((high + low) * (high - low) * 2 if linear else (low + high) * (high - low + s)) * rate:
        return
    if linear or product * 8192 <= (low + m) * (s + 2 * m) * rate:
        c.corrected_speed = _compute_integer_root(8192 * product // rate + low * low)
    else:
        c.corrected_speed = (_compute_integer_root((s - 2 * low) ** 2 + 65536 * product // rate) - s) // 2
    c.corrected_select = c.speed_select


@hot
def _compute_curve_time(c, k):
    """Compute the first whole clock at or after t(k). rate^2 K S stays below 2^60."""
    double = c.twice_span
    if 2 * k <= double:
        square = c.ramp_rate * c.ramp_rate * k * double  # of t(k), twice
        return _compute_integer_root((square + 1) // 2 - 1) + 1
    if 2 * k <= 2 * c.ramp_steps - double:
        return (c.ramp_rate * (double + 2 * k) + 3) // 4
    total = (c.ramp_steps + double) * c.ramp_rate  # twice T
    return (total - _compute_integer_root(2 * c.ramp_rate * c.ramp_rate * (c.ramp_steps - k) * double) + 1) // 2


@hot
def _start_ramp(c, goal, direction):
    """Start a ramp.

    Args:
        c: State of the chip.
        goal: Speed at its end, speed steps.
        direction: 1 up, -1 down.
    """
    c.ramp_direction, c.ramp_clocks, c.ramp_goal = direction, 0, goal
    c.curved_ramp = 1 if c.s_curves and not c.reg[state.R14] & state.LINEAR else 0
    if c.curved_ramp:
        c.ramp_steps = abs(goal - c.speed)
        c.ramp_step = 0
        c.rate_register = 4 if direction > 0 or c.ramp_down_due else 5
        c.ramp_rate, c.twice_span = c.reg[c.rate_register], _compute_twice_span(c)
        schedule_next_step(c)


@hot
def _compute_twice_span(c):
    """Compute 2 S from R14 or R15 as they are now."""
    span = c.reg[state.R14 if c.ramp_direction > 0 else state.R15] & state.SPAN
    return c.ramp_steps if span == 0 or 2 * span > c.ramp_steps else 2 * span


@hot
def read_linear_rate(c, direction):
    """Return the rate of a linear ramp: R4 or R5; after the automatic ramp-down point R4 in both directions."""
    return c.reg[4] if direction > 0 or c.ramp_down_due else c.reg[5]


@hot
def schedule_next_step(c):
    """Find when the S-curve takes its next step: upwards the k-th step at t(k), downwards a clock after t(k - 1)."""
    c.next_step_time = NEVER if c.ramp_rate < 2 else _compute_step_time(c, c.ramp_step + 1)


@hot
def _compute_step_time(c, k):
    """Compute the clock of the ramp at which its k-th step comes."""
    if c.ramp_direction > 0:
        return _compute_curve_time(c, k)
    return 1 + (_compute_curve_time(c, k - 1) if k > 1 else 0)


@hot
def finish_step(c):
    """Finish a step of the S-curve, and schedule the next one.

    Registers that a host has revised since the last step act from here on. The clock of the ramp becomes the one at which a
    ramp with the new values from its start would take this very step.
    """
    c.ramp_step += 1
    double = _compute_twice_span(c)
    if c.reg[c.rate_register] != c.ramp_rate or double != c.twice_span:
        c.ramp_rate, c.twice_span = c.reg[c.rate_register], double
        if c.ramp_rate:
            c.ramp_clocks = _compute_step_time(c, c.ramp_step)
    if c.ramp_step < c.ramp_steps:
        schedule_next_step(c)


@hot
def _compute_fdown_tail(c):
    """Compute for how many clocks FDOWN stays asserted after the last step of a ramp down."""
    if not c.curved_ramp:
        return read_linear_rate(c, -1) - 1
    return ((c.ramp_steps + c.twice_span) * c.ramp_rate + 1) // 2 - c.ramp_clocks if c.ramp_rate else 0


@hot
def count_ticks_to_step(c, goal):
    """Count the ticks up to the next one in which step 3 may change something.

    Args:
        c: State of the chip.
        goal: Speed to which the ramp leads.
    """
    speed = c.speed
    if not c.uses_ramps:
        return 1 if speed != read_selected_speed(c) or c.speed_rising else NEVER
    if c.speed_rising != (1 if goal > speed else 0) or (c.stopping and speed <= c.reg[1]):
        return 1
    if not c.ramp_down_due and is_ramp_down_automatic(c) and compute_ramp_down_margin(c) <= 0:
        return 1
    if speed == goal:
        return c.fdown_end - c.clock if c.clock < c.fdown_end else NEVER
    if c.ramp_direction != (1 if speed < goal else -1):
        return 1
    if c.curved_ramp:
        return greatest(1, c.next_step_time - c.ramp_clocks) if c.ramp_goal == goal else 1
    rate = read_linear_rate(c, c.ramp_direction)
    return greatest(1, rate - c.ramp_clocks) if rate >= 2 else NEVER


@hot
def update_speed(c):
    """Update the speed: step 3 of a tick."""
    c.speed_rising = 0
    if not c.uses_ramps:
        c.speed = read_selected_speed(c)
        c.ramp_direction = c.fdown_end = 0
        return
    if not c.ramp_down_due and is_ramp_down_automatic(c) and compute_ramp_down_margin(c) <= 0:
        c.ramp_down_due = 1
    goal = find_goal_speed(c)
    if c.speed == goal:
        c.ramp_direction = 0
    else:
        direction = 1 if c.speed < goal else -1
        c.speed_rising = 1 if direction > 0 else 0
        c.fdown_end = 0
        first = c.ramp_direction != direction or (c.curved_ramp and c.ramp_goal != goal)
        if first:
            _start_ramp(c, goal, direction)
        c.ramp_clocks += 1
        if c.curved_ramp:
            if c.ramp_clocks >= c.next_step_time:
                c.speed += direction
                finish_step(c)
        else:
            rate = read_linear_rate(c, direction)
            if rate >= 2 and (c.ramp_clocks >= rate or (first and direction < 0)):
                c.speed += direction
                c.ramp_clocks = 0
        if direction < 0 and c.speed == goal:
            c.fdown_end = c.clock + _compute_fdown_tail(c)
    if c.stopping and c.speed <= c.reg[1]:
        state.stop_run(c)
