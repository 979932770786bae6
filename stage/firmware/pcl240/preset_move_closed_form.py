"""A preset move in closed form: how many pulses a row of registers has made by any time, as a fraction. Compiled.

An axis' registers are a row: R0 to R7, and on a chip with S-curves R14 and R15 after them. R6 in it is always the pulses left
when the ramp-down begins. Its course `c` holds what follows: ticks to the ramp-down, speed and phase there, ticks to the last
pulse.
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
    """Return the speed steps completed before a ramp of `unit` ticks per step, from speed `first` on, has gained `target` phase."""
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
    """Return the ticks after which a ramp that goes on at its last speed has gained `target` phase."""
    j = _count_speed_steps(target, unit, first, sign, max_steps)
    gained = unit * (first * j + sign * (j * (j - 1) // 2))
    return j * unit - (gained - target) // (first + sign * j)


@hot
def has_s_curve_ramps(r):
    """Return whether the row's ramps are S-curves."""
    return len(r) > 8 and not r[8] & LINEAR


@hot
def compute_double_span(r14, steps):
    """Return twice the speed steps of a curved end of a ramp of `steps`."""
    span = r14 & SPAN
    return steps if span == 0 or 2 * span > steps else 2 * span


@hot
def set_s_curve_registers(r, share):
    """Set R14 and R15 for ramps from R1 to R2, where the chip has them: `share` of the steps in each curved end, up and down
    alike, 0 for linear ramps, 0.5 for no linear part. Without FH correction: FH is the plan's."""
    if len(r) <= 8:
        return
    steps = r[2] - r[1]
    r[9] = max(1, int(np.rint(share * steps))) if 0.0 < share < 0.5 else 0
    r[8] = UNCORRECTED | (LINEAR if share == 0.0 else r[9])


@hot
def compute_ramp_stretch(r):
    """Return the factor by which the row's ramps last longer, and lose more, than linear ones at the same rate register: 1/2 to
    1."""
    steps = r[2] - r[1]
    return 0.5 + 0.5 * compute_double_span(r[8], steps) / steps if has_s_curve_ramps(r) and steps > 0 else 1.0


@hot
def compute_ramp_ticks(r, rate):
    """Return the ticks of a whole ramp with R4 or R5 = `rate`."""
    steps = r[2] - r[1]
    return 0.5 * (steps + compute_double_span(r[8], steps)) * rate if has_s_curve_ramps(r) else 1.0 * steps * rate


@hot
def _sum_square_roots(n):
    """Return 1 + sqrt 2 + ... + sqrt n, to a thousandth (Euler and Maclaurin)."""
    return np.sqrt(n) * (n / 1.5 + 0.5 + 1.0 / (24.0 * n)) - ZETA if n > 0 else 0.0


@hot
def _compute_mean_step_delay(a, rate):
    """Return the mean of what a and a + 2 rate lack to a multiple of 4, in quarters."""
    return 0.125 * (-a % 4 + -(a + 2 * rate) % 4)


@hot
def _compute_ramp_progress(steps, double, rate, t):
    """Return (speed steps taken, phase they have gained) `t` ticks after an S-curve ramp began. double: twice the span.

    The chip takes the k-th step at the first whole tick from t(k) on, see stage/chips/pcl240/ramp.py; where t(k) is a root, that
    is half a tick later in the mean.
    """
    span, total, x = 0.5 * double, 0.5 * (steps + double), t / rate
    a, b = double // 2, steps - (double + 1) // 2  # the last step of the first curved end, and of the linear part
    delay = _compute_mean_step_delay(rate * double, rate) if b > a else 0.0
    if x >= total:
        return steps, steps * t - 0.5 * rate * total * (steps + 1) - 0.5 * (a + steps - b) - delay * (b - a)
    if x <= span:
        j = int(x * x / span)
        return j, j * t - rate * np.sqrt(span) * _sum_square_roots(j) - 0.5 * j
    sums = rate * np.sqrt(span) * _sum_square_roots(a) + 0.5 * a
    j = min(max(int(2.0 * x - span), a), b)
    if x > 0.5 * steps:
        j = min(max(int(steps - (total - x) ** 2 / span), b), steps - 1)
    n = min(j, b) - a
    sums += n * (0.5 * rate * (span + a + 0.5 * (n + 1)) + delay)
    if j > b:
        left = _sum_square_roots(steps - b - 1) - _sum_square_roots(steps - j - 1)
        sums += (j - b) * (rate * total + 0.5) - rate * np.sqrt(span) * left
    return j, j * t - sums


@hot
def _compute_s_curve_state(fl, fh, r14, up, down, c0, c1, c2, t):
    """Return (speed, phase) of S-curve ramps `t` ticks after the start.

    The arguments are scalars of a row and its motion: arrays are slow to pass.
    """
    rising = t <= c0
    steps = fh - fl if rising else c1 - fl
    u = 1.0 * t if rising else 1.0 * (t - c0)
    if steps <= 0:
        return fl, c2 + u * fl
    rate = up if rising else down
    double = compute_double_span(r14, steps)
    j, gained = _compute_ramp_progress(steps, double, rate, u)
    if rising:
        return fl + j, u * fl + gained
    gained -= max(0.0, u - 0.5 * (steps + double) * rate)  # the mirror image: its first step at once, each one earlier
    return c1 - 1 - min(j, steps - 1), c2 + u * (c1 - 1) - gained


@hot
def _find_tick_at_phase(r, c, target, t):
    """Return the tick at which S-curve ramps have gained `target` phase: by Newton from `t` on, which is on the steep side of
    it."""
    for _ in range(60):
        speed, gained = _compute_s_curve_state(r[1], r[2], r[8], r[4], r[5], c[0], c[1], c[2], t)
        step = (target - gained) / speed
        t += step
        if abs(step) < TICK_TOLERANCE:
            break
    return int(np.ceil(t - TICK_TOLERANCE))


@hot
def _fill_curved_motion(r, c):
    """Fill `c` as `fill_motion` does, for S-curves: to about a tick."""
    d, fl, fh, m = r[0], r[1], r[2], 8192 * r[7]
    if fh > fl and r[6] > 0:
        point = (d - r[6] + 1) * m
        c[0] = 0 if r[6] > d else _find_tick_at_phase(r, c, point, point / fl)
        c[1] = _compute_s_curve_state(fl, fh, r[8], r[4], r[5], c[0], fh, 0, max(c[0] - 1.0, 0.0))[0]
        c[2] = int(compute_phase(r, c, 1.0 * c[0]))
    if c[0] == NEVER_TICKS or d * m <= c[2]:
        c[3] = _find_tick_at_phase(r, c, d * m, d * m / fl)
    else:
        c[3] = _find_tick_at_phase(r, c, d * m, c[0] + 1.0)


@exported(None, array_of("i8"), array_of("i8"))
def fill_motion(r, c):
    """Fill `c` from the row `r`: ticks to the ramp-down, speed and phase there, ticks to the last pulse."""
    d, fl, fh, up, down, m = r[0], r[1], r[2], r[4], r[5], 8192 * r[7]
    c[0], c[1], c[2] = NEVER_TICKS, fh, 0
    if has_s_curve_ramps(r):
        _fill_curved_motion(r, c)
        return
    if fh > fl and r[6] > 0:
        c[0] = 0 if r[6] > d else _find_ticks_to_phase((d - r[6] + 1) * m, up, fl, 1, fh - fl)
        c[1] = fl + min(fh - fl, max(c[0] - 1, 0) // up)
        c[2] = int(compute_phase(r, c, c[0]))
    if c[0] == NEVER_TICKS or d * m <= c[2]:
        c[3] = _find_ticks_to_phase(d * m, up, fl, 1, fh - fl)
    elif c[1] <= fl:
        c[3] = c[0] - (c[2] - d * m) // fl
    else:
        c[3] = c[0] + _find_ticks_to_phase(d * m - c[2], down, c[1] - 1, -1, c[1] - 1 - fl)


@hot
def compute_linear_phase(r, c, t):
    """Return `compute_phase` of linear ramps."""
    if t <= c[0]:
        j = min(r[2] - r[1], int(t / r[4]))
        return r[4] * (r[1] * j + j * (j - 1) // 2) + (t - j * r[4]) * (r[1] + j)
    u = t - c[0]
    if c[1] <= r[1]:
        return c[2] + u * r[1]
    j = min(c[1] - 1 - r[1], int(u / r[5]))
    return c[2] + r[5] * ((c[1] - 1) * j - j * (j - 1) // 2) + (u - j * r[5]) * (c[1] - 1 - j)


@hot
def compute_s_curve_phase(r, c, t):
    """Return `compute_phase` of S-curves."""
    return _compute_s_curve_state(r[1], r[2], r[8], r[4], r[5], c[0], c[1], c[2], t)[1]


@hot
def compute_phase(r, c, t):
    """Return the phase gained `t` ticks after the start (a fraction between ticks); 8192 R7 make a pulse."""
    return compute_s_curve_phase(r, c, t) if has_s_curve_ramps(r) else compute_linear_phase(r, c, t)


@hot
def count_pulses(r, c, t):
    """Return N: pulses made `t` ticks after the start, as a fraction."""
    return compute_phase(r, c, max(t, 0.0)) / (8192.0 * r[7])


@hot
def find_first_pulse_tick(r, c):
    """Return the ticks to the first pulse; c[0] may be NEVER."""
    m = 8192 * r[7]
    return (
        _find_tick_at_phase(r, c, m, m / r[1])
        if has_s_curve_ramps(r)
        else _find_ticks_to_phase(m, r[4], r[1], 1, r[2] - r[1])
    )
