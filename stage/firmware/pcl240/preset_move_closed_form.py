"""A preset move in closed form: the number of pulses, as a fraction, that a row of registers has made at any time. Compiled.

The registers of an axis are a row: R0 to R7, and on a chip with S-curves also R14 and R15. R6 in a row is always the number of
pulses left when the ramp-down begins. The *motion* of a row has what follows from the row: ticks to the ramp-down, speed and
phase there, ticks to the last pulse. A tick is a clock of the chip. The phase is the sum of the speeds over the ticks; 8192 R7 of
it make a pulse.
"""

from __future__ import annotations

import numpy as np

from stage.chips.pcl240.state import LINEAR, SPAN, UNCORRECTED
from stage.native import array_of, exported, hot

NEVER_TICKS = 1 << 60
ZETA = 0.2078862249773546  # -zeta(-1/2), of the sum of square roots
TICK_TOLERANCE = 1e-2


@hot
def _count_speed_steps(target, unit, first, sign, max_steps):
    """Return the number of speed steps that a ramp completes before its phase, the sum of its speeds, has grown by `target`.

    Args:
        target: Growth of the phase, speed steps times ticks.
        unit: Ticks per speed step.
        first: Speed at the begin of the ramp, speed steps.
        sign: 1 for a ramp up, -1 for a ramp down.
        max_steps: Number of speed steps of the whole ramp.
    """
    b = first - 0.5 * sign
    root = b * b + 2.0 * sign * (target / unit)
    j = max_steps if root < 0 else min(max_steps, max(0, int((np.sqrt(root) - b) * sign)))
    while j > 0 and unit * (first * j + sign * (j * (j - 1) // 2)) >= target:
        j -= 1
    while j < max_steps and unit * (first * (j + 1) + sign * ((j + 1) * j // 2)) < target:
        j += 1
    return j


@hot
def _find_ticks_to_phase(target, unit, first, sign, max_steps):
    """Return the ticks after which the phase of a ramp has grown by `target`, at constant speed after the last step of the ramp.

    The arguments are those of `_count_speed_steps`.
    """
    j = _count_speed_steps(target, unit, first, sign, max_steps)
    gained = unit * (first * j + sign * (j * (j - 1) // 2))
    return j * unit - (gained - target) // (first + sign * j)


@hot
def has_s_curve_ramps(row):
    """Return whether the ramps of a preset move, given by its row of registers, are S-curves."""
    return len(row) > 8 and not row[8] & LINEAR


@hot
def compute_twice_curved_end_steps(r14, steps):
    """Return twice the number of speed steps in a curved end of an S-curve ramp of `steps` speed steps."""
    span = r14 & SPAN
    return steps if span == 0 or 2 * span > steps else 2 * span


@hot
def set_s_curve_registers(row, share):
    """Set R14 and R15 of a row for ramps from R1 to R2, linear or S-curves, if the chip has these registers; without FH correction.

    Args:
        row: Row of registers.
        share: Fraction of the speed steps in each curved end: 0 for linear ramps, 0.5 for no linear part.
    """
    if len(row) <= 8:
        return
    steps = row[2] - row[1]
    row[9] = max(1, int(np.rint(share * steps))) if 0.0 < share < 0.5 else 0
    row[8] = UNCORRECTED | (LINEAR if share == 0.0 else row[9])


@hot
def compute_ramp_stretch(row):
    """Return how much longer the row's ramps are, and how many more pulses they lose, than linear ones at the same R4: 1/2 to 1."""
    steps = row[2] - row[1]
    return (
        0.5 + 0.5 * compute_twice_curved_end_steps(row[8], steps) / steps
        if has_s_curve_ramps(row) and steps > 0
        else 1.0
    )


@hot
def compute_ramp_ticks(row, rate_register):
    """Return the ticks of a whole ramp of a preset move. `rate_register` is its acceleration rate: the value of R4 or R5."""
    steps = row[2] - row[1]
    return (
        0.5 * (steps + compute_twice_curved_end_steps(row[8], steps)) * rate_register
        if has_s_curve_ramps(row)
        else 1.0 * steps * rate_register
    )


@hot
def _sum_square_roots(count):
    """Return the sum of the square roots of 1 to `count`, to a thousandth, by the formula of Euler and Maclaurin."""
    return np.sqrt(count) * (count / 1.5 + 0.5 + 1.0 / (24.0 * count)) - ZETA if count > 0 else 0.0


@hot
def _compute_mean_step_delay(ticks, rate):
    """Return the mean of the ticks by which `ticks` and `ticks` + 2 rate fall short of a multiple of 4, in quarter ticks."""
    return 0.125 * (-ticks % 4 + -(ticks + 2 * rate) % 4)


@hot
def _compute_ramp_progress(steps, twice_curved_end_steps, rate, ticks):
    """Compute the progress of an S-curve ramp, `ticks` after its begin.

    The chip takes the k-th step at the first whole tick from t(k) on, see stage/chips/pcl240/ramp.py. If t(k) is a square root,
    that is half a tick later on average.

    Args:
        steps: Speed steps of the ramp.
        twice_curved_end_steps: Twice the speed steps of a curved end.
        rate: R4 or R5.
        ticks: Ticks since the begin of the ramp.

    Returns:
        Speed steps taken, and the phase that they have gained.
    """
    span, total, x = 0.5 * twice_curved_end_steps, 0.5 * (steps + twice_curved_end_steps), ticks / rate
    # the last step of the first curved end, and of the linear part
    a, b = twice_curved_end_steps // 2, steps - (twice_curved_end_steps + 1) // 2
    delay = _compute_mean_step_delay(rate * twice_curved_end_steps, rate) if b > a else 0.0
    if x >= total:
        return steps, steps * ticks - 0.5 * rate * total * (steps + 1) - 0.5 * (a + steps - b) - delay * (b - a)
    if x <= span:
        j = int(x * x / span)
        return j, j * ticks - rate * np.sqrt(span) * _sum_square_roots(j) - 0.5 * j
    sums = rate * np.sqrt(span) * _sum_square_roots(a) + 0.5 * a
    j = min(max(int(2.0 * x - span), a), b)
    if x > 0.5 * steps:
        j = min(max(int(steps - (total - x) ** 2 / span), b), steps - 1)
    n = min(j, b) - a
    sums += n * (0.5 * rate * (span + a + 0.5 * (n + 1)) + delay)
    if j > b:
        left = _sum_square_roots(steps - b - 1) - _sum_square_roots(steps - j - 1)
        sums += (j - b) * (rate * total + 0.5) - rate * np.sqrt(span) * left
    return j, j * ticks - sums


@hot
def _compute_s_curve_state(fl, fh, r14, up, down, ramp_down_tick, ramp_down_speed, ramp_down_phase, ticks):
    """Compute the speed and the phase of a move with S-curve ramps, `ticks` after its start.

    The arguments are single values of a row and its motion, because passing arrays is slow.
    """
    rising = ticks <= ramp_down_tick
    steps = fh - fl if rising else ramp_down_speed - fl
    u = 1.0 * ticks if rising else 1.0 * (ticks - ramp_down_tick)
    if steps <= 0:
        return fl, ramp_down_phase + u * fl
    rate = up if rising else down
    twice_curved_end_steps = compute_twice_curved_end_steps(r14, steps)
    j, gained = _compute_ramp_progress(steps, twice_curved_end_steps, rate, u)
    if rising:
        return fl + j, u * fl + gained
    # the mirror image: its first step at once, each one earlier
    gained -= max(0.0, u - 0.5 * (steps + twice_curved_end_steps) * rate)
    return ramp_down_speed - 1 - min(j, steps - 1), ramp_down_phase + u * (ramp_down_speed - 1) - gained


@hot
def _find_tick_at_phase(row, motion, target, tick):
    """Return the tick at which the phase of a move with S-curve ramps has grown by `target`.

    Newton's method starts at `tick`, which must be on the steep side of the result.
    """
    for _ in range(60):
        speed, gained = _compute_s_curve_state(
            row[1], row[2], row[8], row[4], row[5], motion[0], motion[1], motion[2], tick
        )
        step = (target - gained) / speed
        tick += step
        if abs(step) < TICK_TOLERANCE:
            break
    return int(np.ceil(tick - TICK_TOLERANCE))


@hot
def _fill_curved_motion(row, motion):
    """Fill the motion of a row with S-curve ramps as `fill_motion` does, exact to about a tick."""
    d, fl, fh, m = row[0], row[1], row[2], 8192 * row[7]
    if fh > fl and row[6] > 0:
        point = (d - row[6] + 1) * m
        motion[0] = 0 if row[6] > d else _find_tick_at_phase(row, motion, point, point / fl)
        motion[1] = _compute_s_curve_state(fl, fh, row[8], row[4], row[5], motion[0], fh, 0, max(motion[0] - 1.0, 0.0))[
            0
        ]
        motion[2] = int(compute_phase(row, motion, 1.0 * motion[0]))
    if motion[0] == NEVER_TICKS or d * m <= motion[2]:
        motion[3] = _find_tick_at_phase(row, motion, d * m, d * m / fl)
    else:
        motion[3] = _find_tick_at_phase(row, motion, d * m, motion[0] + 1.0)


@exported(None, array_of("i8"), array_of("i8"))
def fill_motion(row, motion):
    """Compute the motion that a row of registers produces, see the module docstring.

    Args:
        row: Registers R0 to R7 of an axis; on a chip with S-curves also R14 and R15.
        motion: Array to fill with four numbers: ticks (clocks of the chip) from the start to the ramp-down, speed and phase at the
            ramp-down, ticks from the start to the last pulse. The phase is the sum of the speeds over the ticks.
    """
    d, fl, fh, up, down, m = row[0], row[1], row[2], row[4], row[5], 8192 * row[7]
    motion[0], motion[1], motion[2] = NEVER_TICKS, fh, 0
    if has_s_curve_ramps(row):
        _fill_curved_motion(row, motion)
        return
    if fh > fl and row[6] > 0:
        motion[0] = 0 if row[6] > d else _find_ticks_to_phase((d - row[6] + 1) * m, up, fl, 1, fh - fl)
        motion[1] = fl + min(fh - fl, max(motion[0] - 1, 0) // up)
        motion[2] = int(compute_phase(row, motion, motion[0]))
    if motion[0] == NEVER_TICKS or d * m <= motion[2]:
        motion[3] = _find_ticks_to_phase(d * m, up, fl, 1, fh - fl)
    elif motion[1] <= fl:
        motion[3] = motion[0] - (motion[2] - d * m) // fl
    else:
        motion[3] = motion[0] + _find_ticks_to_phase(d * m - motion[2], down, motion[1] - 1, -1, motion[1] - 1 - fl)


@hot
def compute_linear_phase(row, motion, ticks):
    """Compute the phase of a move with linear ramps, as `compute_phase` does."""
    if ticks <= motion[0]:
        j = min(row[2] - row[1], int(ticks / row[4]))
        return row[4] * (row[1] * j + j * (j - 1) // 2) + (ticks - j * row[4]) * (row[1] + j)
    u = ticks - motion[0]
    if motion[1] <= row[1]:
        return motion[2] + u * row[1]
    j = min(motion[1] - 1 - row[1], int(u / row[5]))
    return motion[2] + row[5] * ((motion[1] - 1) * j - j * (j - 1) // 2) + (u - j * row[5]) * (motion[1] - 1 - j)


@hot
def compute_s_curve_phase(row, motion, ticks):
    """Compute the phase of a move with S-curve ramps, as `compute_phase` does."""
    return _compute_s_curve_state(row[1], row[2], row[8], row[4], row[5], motion[0], motion[1], motion[2], ticks)[1]


@hot
def compute_phase(row, motion, ticks):
    """Return the phase of a preset move, the sum of its speeds over the ticks, `ticks` after its start; a fraction is possible."""
    return (
        compute_s_curve_phase(row, motion, ticks)
        if has_s_curve_ramps(row)
        else compute_linear_phase(row, motion, ticks)
    )


@hot
def count_pulses(row, motion, ticks):
    """Return the number of pulses, as a fraction, that a preset move has made `ticks` reference clocks after its start."""
    return compute_phase(row, motion, max(ticks, 0.0)) / (8192.0 * row[7])


@hot
def find_first_pulse_tick(row, motion):
    """Return the ticks from the start of a preset move to its first pulse. The ramp-down of `motion` may be NEVER_TICKS."""
    m = 8192 * row[7]
    return (
        _find_tick_at_phase(row, motion, m, m / row[1])
        if has_s_curve_ramps(row)
        else _find_ticks_to_phase(m, row[4], row[1], 1, row[2] - row[1])
    )
