"""Ramps of the PCL-240 family: the speed that a ramp is to reach, and the clock of its next speed step; compiled.

A linear ramp takes a speed step every R4 or R5 clocks. A ramp down is over, and FDOWN falls, R5 - 1 clocks after its last speed
step. An S-curve ramp of K speed steps with curved ends of S speed steps each takes its k-th speed step t(k) clocks after its
start, and is over at T:

    rate sqrt(k S)                    k <= S            from rest: the acceleration grows with time
    rate (S + k) / 2                  S < k <= K - S    linear
    T - rate sqrt((K - k) S)          K - S < k         the first part, mirrored;  T = (K + 2 S) rate / 2

These are exact integers, because 2 S and 2 T are integers. Source: the normative model, section 7.
"""

from __future__ import annotations

import math

from stage.chips.pcl240 import state
from stage.native import greatest, hot

NEVER = 1 << 40


@hot
def read_selected_speed(chip):
    """Return the speed that the start command selects, or the corrected FH in its place."""
    if chip.speed_select == chip.corrected_select and chip.speed_select:
        return chip.corrected_speed
    if chip.speed_select == state.FH1:
        return chip.reg[2]
    if chip.speed_select == state.FH2:
        return chip.reg[3]
    return chip.reg[1]


@hot
def is_slowed_by_sd(chip):
    """Return whether the input SD is enabled and the slow-down switch of the move's direction is asserted."""
    return chip.sd_enable and chip.active_inputs & (state.SD_MINUS if chip.minus else state.SD_PLUS)


@hot
def is_ramp_down_automatic(chip):
    """Return whether the automatic ramp-down point is in force, in place of R0 < R6."""
    return chip.automatic_ramp_down and chip.preset and chip.uses_ramps and not chip.automatic_off


@hot
def compute_ramp_down_margin(chip):
    """Compute the number of pulses by which R0 is above the automatic ramp-down point."""
    offset = chip.reg[6]
    if offset & chip.offset_sign_bit:
        offset -= 2 * chip.offset_sign_bit
    return chip.reg[0] - chip.rise_pulses - offset


@hot
def find_goal_speed(chip):
    """Return the speed to which a ramp of the PCL-240 leads: FL or the selected speed."""
    if chip.stopping or chip.ramp_down_due or chip.passed_org or is_slowed_by_sd(chip):
        return chip.reg[1]
    if chip.preset and chip.reg[0] < chip.reg[6] and not is_ramp_down_automatic(chip):
        return chip.reg[1]
    return read_selected_speed(chip)


@hot
def _compute_integer_root(number):
    """Return the integer part of the square root of `number`, which is below 2^62."""
    r = int(math.sqrt(float(number)))
    while r * r > number:
        r -= 1
    while (r + 1) * (r + 1) <= number:
        r += 1
    return r


@hot
def correct_fh(chip):
    """Correct FH at the start of a preset run: a distance too short to reach FH gets a lower top speed.

    Source: data sheet MS, 3-4. The automatic ramp-down decelerates at R4, so R4 replaces R5. With s = R14 + R15, m = max(R14, R15):

        pulses for a trapezoid       (R2^2 - R1^2) R4 / (8192 R7)    or  (R1 + R2) (R2 - R1 + s) R4 / (16384 R7)
        pulses for a linear part     (R1 + m) (s + 2 m) R4 / (8192 R7)
        revised R2                   sqrt(8192 R0 R7 / R4 + R1^2)    or  (-s + sqrt((s - 2 R1)^2 + 65536 R0 R7 / R4)) / 2
    """
    low, high, rate = chip.reg[1], read_selected_speed(chip), chip.reg[4]
    if (
        not (
            chip.s_curves
            and is_ramp_down_automatic(chip)
            and (chip.speed_select == state.FH1 or chip.speed_select == state.FH2)
            and rate
        )
        or chip.reg[state.R14] & state.UNCORRECTED
    ):
        return
    product = chip.reg[0] * chip.multiplier
    a, b = chip.reg[state.R14] & state.SPAN, chip.reg[state.R15] & state.SPAN
    s, m = a + b, greatest(a, b)
    linear = chip.reg[state.R14] & state.LINEAR or a == 0 or b == 0 or 2 * m >= high - low
    if product * 16384 > ((high + low) * (high - low) * 2 if linear else (low + high) * (high - low + s)) * rate:
        return
    if linear or product * 8192 <= (low + m) * (s + 2 * m) * rate:
        chip.corrected_speed = _compute_integer_root(8192 * product // rate + low * low)
    else:
        chip.corrected_speed = (_compute_integer_root((s - 2 * low) ** 2 + 65536 * product // rate) - s) // 2
    chip.corrected_select = chip.speed_select


@hot
def _compute_curve_time(chip, step_index):
    """Compute the first whole clock of an S-curve ramp at or after its step `step_index`, t(k) of this module's formulas."""
    double = chip.twice_span
    if 2 * step_index <= double:
        square = chip.ramp_rate * chip.ramp_rate * step_index * double  # of t(k), twice
        return _compute_integer_root((square + 1) // 2 - 1) + 1
    if 2 * step_index <= 2 * chip.ramp_steps - double:
        return (chip.ramp_rate * (double + 2 * step_index) + 3) // 4
    total = (chip.ramp_steps + double) * chip.ramp_rate  # twice T
    return (
        total - _compute_integer_root(2 * chip.ramp_rate * chip.ramp_rate * (chip.ramp_steps - step_index) * double) + 1
    ) // 2


@hot
def _start_ramp(chip, goal_speed, direction):
    """Start a ramp of the PCL-240 to another speed.

    Args:
        chip: State of the chip.
        goal_speed: Speed at the end of the ramp, speed steps.
        direction: 1 up, -1 down.
    """
    chip.ramp_direction, chip.ramp_clocks, chip.ramp_goal = direction, 0, goal_speed
    chip.curved_ramp = 1 if chip.s_curves and not chip.reg[state.R14] & state.LINEAR else 0
    if chip.curved_ramp:
        chip.ramp_steps = abs(goal_speed - chip.speed)
        chip.ramp_step = 0
        chip.rate_register = 4 if direction > 0 or chip.ramp_down_due else 5
        chip.ramp_rate, chip.twice_span = chip.reg[chip.rate_register], _compute_twice_curved_end_steps(chip)
        schedule_next_step(chip)


@hot
def _compute_twice_curved_end_steps(chip):
    """Compute 2 S, twice the steps of a curved end, from the present value of R14 or R15."""
    span = chip.reg[state.R14 if chip.ramp_direction > 0 else state.R15] & state.SPAN
    return chip.ramp_steps if span == 0 or 2 * span > chip.ramp_steps else 2 * span


@hot
def read_linear_rate(chip, direction):
    """Return the rate of a linear ramp: R4 or R5; after the automatic ramp-down point R4 in both directions."""
    return chip.reg[4] if direction > 0 or chip.ramp_down_due else chip.reg[5]


@hot
def schedule_next_step(chip):
    """Schedule the next speed step of an S-curve: step k at t(k) of a ramp up, and one clock after t(k - 1) of a ramp down."""
    chip.next_step_time = NEVER if chip.ramp_rate < 2 else _compute_step_time(chip, chip.ramp_step + 1)


@hot
def _compute_step_time(chip, step_index):
    """Compute the clock, counted from the start of the ramp, at which speed step `step_index` of an S-curve comes."""
    if chip.ramp_direction > 0:
        return _compute_curve_time(chip, step_index)
    return 1 + (_compute_curve_time(chip, step_index - 1) if step_index > 1 else 0)


@hot
def finish_step(chip):
    """Finish a speed step of an S-curve ramp, and schedule the next one.

    New values that a host has written to the ramp's registers since the last step take effect now: the clock of the ramp is set to
    that at which a ramp with these values from its start would take the same step.
    """
    chip.ramp_step += 1
    double = _compute_twice_curved_end_steps(chip)
    if chip.reg[chip.rate_register] != chip.ramp_rate or double != chip.twice_span:
        chip.ramp_rate, chip.twice_span = chip.reg[chip.rate_register], double
        if chip.ramp_rate:
            chip.ramp_clocks = _compute_step_time(chip, chip.ramp_step)
    if chip.ramp_step < chip.ramp_steps:
        schedule_next_step(chip)


@hot
def _compute_fdown_tail(chip):
    """Compute for how many clocks FDOWN stays asserted after the last step of a ramp down."""
    if not chip.curved_ramp:
        return read_linear_rate(chip, -1) - 1
    return ((chip.ramp_steps + chip.twice_span) * chip.ramp_rate + 1) // 2 - chip.ramp_clocks if chip.ramp_rate else 0


@hot
def count_clocks_to_speed_step(chip, goal_speed):
    """Count the clocks up to the next one in which `update_speed` may change the state.

    Args:
        chip: State of the chip.
        goal_speed: Speed to which the ramp leads.
    """
    speed = chip.speed
    if not chip.uses_ramps:
        return 1 if speed != read_selected_speed(chip) or chip.speed_rising else NEVER
    if chip.speed_rising != (1 if goal_speed > speed else 0) or (chip.stopping and speed <= chip.reg[1]):
        return 1
    if not chip.ramp_down_due and is_ramp_down_automatic(chip) and compute_ramp_down_margin(chip) <= 0:
        return 1
    if speed == goal_speed:
        return chip.fdown_end - chip.clock if chip.clock < chip.fdown_end else NEVER
    if chip.ramp_direction != (1 if speed < goal_speed else -1):
        return 1
    if chip.curved_ramp:
        return greatest(1, chip.next_step_time - chip.ramp_clocks) if chip.ramp_goal == goal_speed else 1
    rate = read_linear_rate(chip, chip.ramp_direction)
    return greatest(1, rate - chip.ramp_clocks) if rate >= 2 else NEVER


@hot
def update_speed(chip):
    """Update the speed of a ramp at this clock. This is the third part of each clock in the normative model."""
    chip.speed_rising = 0
    if not chip.uses_ramps:
        chip.speed = read_selected_speed(chip)
        chip.ramp_direction = chip.fdown_end = 0
        return
    if not chip.ramp_down_due and is_ramp_down_automatic(chip) and compute_ramp_down_margin(chip) <= 0:
        chip.ramp_down_due = 1
    goal = find_goal_speed(chip)
    if chip.speed == goal:
        chip.ramp_direction = 0
    else:
        direction = 1 if chip.speed < goal else -1
        chip.speed_rising = 1 if direction > 0 else 0
        chip.fdown_end = 0
        first = chip.ramp_direction != direction or (chip.curved_ramp and chip.ramp_goal != goal)
        if first:
            _start_ramp(chip, goal, direction)
        chip.ramp_clocks += 1
        if chip.curved_ramp:
            if chip.ramp_clocks >= chip.next_step_time:
                chip.speed += direction
                finish_step(chip)
        else:
            rate = read_linear_rate(chip, direction)
            if rate >= 2 and (chip.ramp_clocks >= rate or (first and direction < 0)):
                chip.speed += direction
                chip.ramp_clocks = 0
        if direction < 0 and chip.speed == goal:
            chip.fdown_end = chip.clock + _compute_fdown_tail(chip)
    if chip.stopping and chip.speed <= chip.reg[1]:
        state.stop_run(chip)
