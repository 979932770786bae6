"""Registers with which one axis follows another along a line. Compiled; `plan` is the face of it.

Between two speed steps a chip's pulses are a straight line in time, so its count is known in closed form, as a fraction N(t).
Against a leader that makes d pulses, a follower that makes rho d (rho <= 1) errs by

    E(t) = N(t + lead) - rho N_leader(t)        in the follower's pulses; lead: how much earlier it was started

Counts are whole: n = floor(N), so n - rho n_leader lies between E - 1 and E + rho. A follower for which E stays within
0 to 1 - rho strays no further than a perfect one does, whose first pulse is a whole pulse late; and by as much as E is
above 0 before that pulse, it strays less. `accelerations` and `decelerations` look for it over every multiplier R7.

An axis' registers are a row: R0 to R7, and on a chip with S-curves R14 and R15 after them. R6 in it is always the pulses left
when the ramp-down begins; with the automatic ramp-down point the chip gets the offset that comes to the same (`offset`).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from stage.chips.pcl240 import PCL240, PCL240K, core
from stage.chips.pcl240.state import LINEAR, R14, R15, SPAN, UNCORRECTED
from stage.compiled import hot

KEPT = 24  # accelerations that are tried with every deceleration
BEST = 4  # followers returned
RAMP_POINTS = 8
MORE = 3  # points: ends of the follower's ramps
NEVER = 1 << 60
SPREAD_WEIGHT = 0.02  # prefers a flat E among equals
DRIFT_WEIGHT = 0.1  # and an exact ratio, by the pulses that it would drift
TAIL_WEIGHT = 3.0  # pulses at FL after the ramp-down, of which a follower with another FL makes another number
RATIO_WEIGHT = 1.0  # a ratio error of 1 % has to buy a hundredth of a pulse
ZETA = 0.2078862249773546  # -zeta(-1/2), of the sum of square roots
A_TICK = 1e-2


@hot
def _steps(target, unit, first, way, most):
    """The speed steps completed before a ramp of `unit` ticks a step, from speed `first` on, has gained `target` phase."""
    b = first - 0.5 * way
    root = b * b + 2.0 * way * (target / unit)
    j = most if root < 0 else min(most, max(0, int((np.sqrt(root) - b) * way)))
    while j > 0 and unit * (first * j + way * (j * (j - 1) // 2)) >= target:
        j -= 1
    while j < most and unit * (first * (j + 1) + way * ((j + 1) * j // 2)) < target:
        j += 1
    return j


@hot
def _ticks_to(target, unit, first, way, most):
    """Ticks after which a ramp that goes on at its last speed has gained `target` phase."""
    j = _steps(target, unit, first, way, most)
    gained = unit * (first * j + way * (j * (j - 1) // 2))
    return j * unit - (gained - target) // (first + way * j)


@hot
def curved(r):
    """The row's ramps are S-curves."""
    return len(r) > 8 and not r[8] & LINEAR


@hot
def twice_span(r14, steps):
    """Twice the speed steps of a curved end of a ramp of `steps`."""
    span = r14 & SPAN
    return steps if span == 0 or 2 * span > steps else 2 * span


@hot
def bend(r, share):
    """Set R14 and R15 for ramps from R1 to R2, where the chip has them: `share` of the steps in each curved end, up and down
    alike, 0 for linear ramps, 0.5 for no linear part. Without FH correction: FH is the plan's."""
    if len(r) <= 8:
        return
    steps = r[2] - r[1]
    r[9] = max(1, int(np.rint(share * steps))) if 0.0 < share < 0.5 else 0
    r[8] = UNCORRECTED | (LINEAR if share == 0.0 else r[9])


@hot
def stretch(r):
    """The row's ramps last and lose so many times what linear ones at the same rate register do: 1/2 to 1."""
    steps = r[2] - r[1]
    return 0.5 + 0.5 * twice_span(r[8], steps) / steps if curved(r) and steps > 0 else 1.0


@hot
def ramp_ticks(r, rate):
    """Ticks of a whole ramp with R4 or R5 = `rate`."""
    steps = r[2] - r[1]
    return 0.5 * (steps + twice_span(r[8], steps)) * rate if curved(r) else 1.0 * steps * rate


@hot
def _roots(n):
    """1 + sqrt 2 + ... + sqrt n, to a thousandth (Euler and Maclaurin)."""
    return np.sqrt(n) * (n / 1.5 + 0.5 + 1.0 / (24.0 * n)) - ZETA if n > 0 else 0.0


@hot
def _late(a, rate):
    """Mean of what a and a + 2 rate lack to a multiple of 4, in quarters."""
    return 0.125 * (-a % 4 + -(a + 2 * rate) % 4)


@hot
def _curve(steps, double, rate, t):
    """(speed steps taken, phase they have gained) `t` ticks after an S-curve ramp began. double: twice the span.

    The chip takes the k-th step at the first whole tick from t(k) on, see stage/chips/pcl240/ramp.py; where t(k) is a root,
    that is half a tick later in the mean.
    """
    span, total, x = 0.5 * double, 0.5 * (steps + double), t / rate
    a, b = double // 2, steps - (double + 1) // 2  # the last step of the first curved end, and of the linear part
    late = _late(rate * double, rate) if b > a else 0.0
    if x >= total:
        return steps, steps * t - 0.5 * rate * total * (steps + 1) - 0.5 * (a + steps - b) - late * (b - a)
    if x <= span:
        j = int(x * x / span)
        return j, j * t - rate * np.sqrt(span) * _roots(j) - 0.5 * j
    sums = rate * np.sqrt(span) * _roots(a) + 0.5 * a
    j = min(max(int(2.0 * x - span), a), b)
    if x > 0.5 * steps:
        j = min(max(int(steps - (total - x) ** 2 / span), b), steps - 1)
    n = min(j, b) - a
    sums += n * (0.5 * rate * (span + a + 0.5 * (n + 1)) + late)
    if j > b:
        left = _roots(steps - b - 1) - _roots(steps - j - 1)
        sums += (j - b) * (rate * total + 0.5) - rate * np.sqrt(span) * left
    return j, j * t - sums


@hot
def _state(fl, fh, r14, up, down, c0, c1, c2, t):
    """(speed, phase) of S-curve ramps `t` ticks after the start. Scalars of a row and its course: arrays are slow to pass."""
    rising = t <= c0
    steps = fh - fl if rising else c1 - fl
    u = 1.0 * t if rising else 1.0 * (t - c0)
    if steps <= 0:
        return fl, c2 + u * fl
    rate = up if rising else down
    double = twice_span(r14, steps)
    j, gained = _curve(steps, double, rate, u)
    if rising:
        return fl + j, u * fl + gained
    gained -= max(0.0, u - 0.5 * (steps + double) * rate)  # the mirror image: its first step at once, each one earlier
    return c1 - 1 - min(j, steps - 1), c2 + u * (c1 - 1) - gained


@hot
def _tick_at(r, c, target, t):
    """The tick at which S-curve ramps have gained `target` phase: by Newton from `t` on, which is on the steep side of it."""
    for _ in range(60):
        speed, made = _state(r[1], r[2], r[8], r[4], r[5], c[0], c[1], c[2], t)
        step = (target - made) / speed
        t += step
        if abs(step) < A_TICK:
            break
    return int(np.ceil(t - A_TICK))


@hot
def _curved_course(r, c):
    """As `course`, for S-curves: to about a tick."""
    d, fl, fh, m = r[0], r[1], r[2], 8192 * r[7]
    if fh > fl and r[6] > 0:
        point = (d - r[6] + 1) * m
        c[0] = 0 if r[6] > d else _tick_at(r, c, point, point / fl)
        c[1] = _state(fl, fh, r[8], r[4], r[5], c[0], fh, 0, max(c[0] - 1.0, 0.0))[0]
        c[2] = int(phase(r, c, 1.0 * c[0]))
    if c[0] == NEVER or d * m <= c[2]:
        c[3] = _tick_at(r, c, d * m, d * m / fl)
    else:
        c[3] = _tick_at(r, c, d * m, c[0] + 1.0)


@hot
def course(r, c):
    """Fill `c` from the row `r`: ticks to the ramp-down, speed and phase there, ticks to the last pulse."""
    d, fl, fh, up, down, m = r[0], r[1], r[2], r[4], r[5], 8192 * r[7]
    c[0], c[1], c[2] = NEVER, fh, 0
    if curved(r):
        _curved_course(r, c)
        return
    if fh > fl and r[6] > 0:
        c[0] = 0 if r[6] > d else _ticks_to((d - r[6] + 1) * m, up, fl, 1, fh - fl)
        c[1] = fl + min(fh - fl, max(c[0] - 1, 0) // up)
        c[2] = int(phase(r, c, c[0]))
    if c[0] == NEVER or d * m <= c[2]:
        c[3] = _ticks_to(d * m, up, fl, 1, fh - fl)
    elif c[1] <= fl:
        c[3] = c[0] - (c[2] - d * m) // fl
    else:
        c[3] = c[0] + _ticks_to(d * m - c[2], down, c[1] - 1, -1, c[1] - 1 - fl)


@hot
def _linear_phase(r, c, t):
    if t <= c[0]:
        j = min(r[2] - r[1], int(t / r[4]))
        return r[4] * (r[1] * j + j * (j - 1) // 2) + (t - j * r[4]) * (r[1] + j)
    u = t - c[0]
    if c[1] <= r[1]:
        return c[2] + u * r[1]
    j = min(c[1] - 1 - r[1], int(u / r[5]))
    return c[2] + r[5] * ((c[1] - 1) * j - j * (j - 1) // 2) + (u - j * r[5]) * (c[1] - 1 - j)


@hot
def _curved_phase(r, c, t):
    return _state(r[1], r[2], r[8], r[4], r[5], c[0], c[1], c[2], t)[1]


@hot
def phase(r, c, t):
    """Phase gained `t` ticks after the start (a fraction between ticks); 8192 R7 make a pulse."""
    return _curved_phase(r, c, t) if curved(r) else _linear_phase(r, c, t)


@hot
def count(r, c, t):
    """N: pulses made `t` ticks after the start, as a fraction."""
    return phase(r, c, max(t, 0.0)) / (8192.0 * r[7])


@hot
def first_pulse(r, c):
    """Ticks to the first pulse; c[0] may be NEVER."""
    m = 8192 * r[7]
    return _tick_at(r, c, m, m / r[1]) if curved(r) else _ticks_to(m, r[4], r[1], 1, r[2] - r[1])


@hot
def _widen(due, r, own, hz, lead, end, lo, hi):
    """Widen lo..hi by E at the times of `due` up to `end`. Until the follower's first pulse only its running ahead counts."""
    bent, m = curved(r), 8192.0 * r[7]
    for k in range(due.shape[1]):
        if due[0, k] <= end:
            t = max((due[0, k] + lead) * hz, 0.0)
            n = (_curved_phase(r, own, t) if bent else _linear_phase(r, own, t)) / m
            e = n - due[1, k]
            if n >= 1.0:
                lo = min(lo, e)
            hi = max(hi, e)
    return lo, hi


@hot
def _score(lo, hi, rho, penalty):
    return max(1.0 - lo, hi + rho) + SPREAD_WEIGHT * abs(hi - lo) + penalty


@hot
def _keep(scores, kept, score, r):
    """Insert `r` into `kept`, best first, if it is good enough."""
    k = len(scores) - 1
    if score >= scores[k]:
        return
    while k > 0 and scores[k - 1] > score:
        scores[k] = scores[k - 1]
        kept[k] = kept[k - 1]
        k -= 1
    scores[k] = score
    kept[k] = r


@hot
def _due(leader, c, hz_leader, rho, begin, ticks):
    """A ramp of the leader in parts: times in s (row 0), and what the follower shall have made by then (row 1); with room for
    MORE times."""
    out = np.zeros((2, RAMP_POINTS + 1 + MORE))
    length = ticks / hz_leader
    for k in range(RAMP_POINTS + 1):
        _demand(leader, c, hz_leader, rho, begin + length * k / RAMP_POINTS, out, k)
    return out


@hot
def _demand(leader, c, hz_leader, rho, t, out, k):
    out[0, k] = t
    out[1, k] = rho * count(leader, c, t * hz_leader)


@hot
def _due_up(leader, c, hz_leader, rho):
    return _due(leader, c, hz_leader, rho, 0.0, ramp_ticks(leader, leader[4]))


@hot
def _due_down(leader, c, hz_leader, rho):
    return _due(leader, c, hz_leader, rho, c[0] / hz_leader, ramp_ticks(leader, leader[5]))


@hot
def _rise(leader, c, hz_leader, due, r, own, hz, lead, rho):
    """lo and hi of E from the start to the leader's ramp-down. due: of the ramp-up."""
    own[0] = NEVER  # its own ramp-down is not chosen yet
    end = min(c[0], c[3]) / hz_leader
    k = RAMP_POINTS + 1
    for t in (first_pulse(r, own) / hz - lead + 1e-12, ramp_ticks(r, r[4]) / hz - lead, end):
        _demand(leader, c, hz_leader, rho, t if 0 <= t <= end else 0.0, due, k)
        k += 1
    return _widen(due, r, own, hz, lead, np.inf, 1.0, 0.0)


@hot
def _fall(leader, c, hz_leader, due, r, own, hz, lead, rho, lo, hi):
    """As _rise, from the leader's ramp-down, or its own, to the first last pulse. due: of the ramp-down."""
    course(r, own)
    end = min(c[3] / hz_leader, own[3] / hz - lead)
    k = RAMP_POINTS + 1
    for t in (own[0] / hz - lead, own[0] / hz - lead + ramp_ticks(r, r[5]) / hz, end):
        _demand(leader, c, hz_leader, rho, min(t, end), due, k)
        k += 1
    return _widen(due, r, own, hz, lead, end, lo, hi)


@hot
def accelerations(leader, hz_leader, d, hz, lead, share, most, scores, kept):
    """Choose R1, R2, R4 and R7 of a follower of `d` pulses: for each multiplier the nearest FH, R4 by the slope, and R1 by
    the pulses lost in the ramp. Fills `kept` (rows), best first, and `scores`. leader: its row. share: of the steps in each
    end of an S-curve, see `bend`. most: the largest R4."""
    c = np.zeros(4, np.int64)
    course(leader, c)
    rho = d / leader[0]
    step0 = hz_leader / (8192.0 * leader[7])
    fh, gain = rho * leader[2] * step0, leader[2] - leader[1]
    slope = rho * step0 * hz_leader / leader[4]
    rise = ramp_ticks(leader, leader[4]) / hz_leader
    lag = rho * gain * (gain + 1) * leader[4] * stretch(leader) / (16384.0 * leader[7])
    fall_lag = lag * leader[5] / leader[4]
    end = min(c[0], c[3]) / hz_leader
    middle = 0.5 * (rise + end)
    r, own = np.zeros(kept.shape[1], np.int64), np.zeros(4, np.int64)
    r[0] = d
    up = _due_up(leader, c, hz_leader, rho)
    scores[:] = 1e18
    kept[:] = 0
    for r7 in range(1023, 1, -1):
        step = hz / (8192.0 * r7)
        high = max(1, int(np.rint(fh / step)))
        drift = (high * step - fh) * (end - rise)
        penalty = RATIO_WEIGHT * abs(high * step / fh - 1.0) + DRIFT_WEIGHT * abs(drift)
        floor = 0.5 * (1.0 + rho + abs(drift)) + penalty  # no score is below
        if high > 8191 or floor > scores[-1]:
            continue
        r[2] = r[3] = high
        r[7] = r7
        if gain == 0 or high == 1:
            r[1], r[4], r[5] = high, 2, 2
            bend(r, share)
            lo, hi = _rise(leader, c, hz_leader, up, r, own, hz, lead, rho)
            _keep(scores, kept, _score(lo, hi, rho, penalty), r)
            continue
        r[1] = max(high - max(int(np.rint(high * gain / leader[2])), 1), 1)
        bend(r, share)
        stretched = stretch(r)
        nominal = int(np.rint(hz * step / slope * (stretch(leader) / stretched)))
        needed = nominal * leader[5] / leader[4]  # R5
        if needed > most:  # its ramp-down would be too short
            penalty += fall_lag * (1.0 - most / needed)
        # FH (t + lead) - lost = rho N_leader(t) + ahead
        lost = high * step * (middle + lead) - fh * middle + lag
        last = 0
        for shift in range(-3, 4):
            r4 = min(max(nominal + shift, 2), most)
            if r4 == last:
                continue
            last = r[4] = r[5] = r4
            tried = -1
            for ahead in (min(0.5 * (1.0 - rho), 0.25 * lag), 0.0):
                area = max(lost - ahead, 0.0) * 16384.0 * r7 / r4 / stretched
                gained = int(0.5 * (np.sqrt(1.0 + 4.0 * area) - 1.0))
                for k in (gained, gained + 1):
                    if k <= tried:
                        continue
                    tried = k
                    r[1] = max(high - k, 1)
                    tail = TAIL_WEIGHT * abs(r[1] * step / (leader[1] * step0) - rho)
                    if floor + tail < scores[-1]:
                        bend(r, share)
                        lo, hi = _rise(leader, c, hz_leader, up, r, own, hz, lead, rho)
                        _keep(scores, kept, _score(lo, hi, rho, penalty) + tail, r)


@hot
def decelerations(leader, hz_leader, hz, lead, automatic, most, point_most, kept, scores, best):
    """Choose R5 and R6 for each of the `kept`. Fills `best`, best first, and `scores`: about the largest distance from the
    line, in the follower's pulses. automatic: R5 is R4. most, point_most: the largest R5 and R6."""
    c, own = np.zeros(4, np.int64), np.zeros(4, np.int64)
    course(leader, c)
    scores[:] = 1e18
    best[:] = 0
    begin = c[0] / hz_leader
    rho = kept[0, 0] / leader[0]
    up, down = _due_up(leader, c, hz_leader, rho), _due_down(leader, c, hz_leader, rho)
    for row in range(len(kept)):
        r = kept[row].copy()
        d = r[0]
        if d == 0:
            continue
        error = abs(r[2] * hz * leader[7] / (rho * leader[2] * hz_leader * r[7]) - 1.0)
        penalty = RATIO_WEIGHT * error + DRIFT_WEIGHT * error * d
        rise_lo, rise_hi = _rise(leader, c, hz_leader, up, r, own, hz, lead, rho)
        if r[2] == r[1]:
            lo, hi = _fall(leader, c, hz_leader, down, r, own, hz, lead, rho, rise_lo, rise_hi)
            _keep(scores, best, _score(lo, hi, rho, penalty), r)
            continue
        slope = hz / (8192.0 * r[7]) * leader[5] * hz * 8192 * leader[7] / (rho * hz_leader * hz_leader)
        nominal = int(np.rint(slope * (stretch(leader) / stretch(r))))
        made = int(count(r, own, (begin + lead) * hz))
        last = 0
        for shift in range(-3, 4):
            r5 = r[4] if automatic else min(max(nominal + shift, 2), most)
            if r5 == last:
                continue
            last = r[5] = r5
            for k in range(-1, 3):
                r[6] = min(max(d - made - k + 1, 1), d, point_most)
                lo, hi = _fall(leader, c, hz_leader, down, r, own, hz, lead, rho, rise_lo, rise_hi)
                _keep(scores, best, _score(lo, hi, rho, penalty), r)


@hot
def estimate(leader, hz_leader, r, hz, lead):
    """About the largest distance of a follower with row `r` from the line, in its pulses."""
    c, own = np.zeros(4, np.int64), np.zeros(4, np.int64)
    course(leader, c)
    rho = r[0] / leader[0]
    up, down = _due_up(leader, c, hz_leader, rho), _due_down(leader, c, hz_leader, rho)
    lo, hi = _rise(leader, c, hz_leader, up, r, own, hz, lead, rho)
    lo, hi = _fall(leader, c, hz_leader, down, r, own, hz, lead, rho, lo, hi)
    return max(1.0 - lo, hi + rho)


@hot
def misfit(high, r7, hz_leader, rho, hz, least, enough):
    """The smallest relative error, or one below `enough`, with which registers of at least `least` make rho times the rate
    of `high` at `r7`."""
    ratio = rho * high * hz_leader / (r7 * hz)
    best = 1.0
    for own in range(2, 1024):
        exact = ratio * own
        if exact > 8191.5:
            break
        if exact >= least:
            best = min(best, abs(np.rint(exact) / exact - 1.0))
            if best < enough:
                break
    return best


@hot
def misfits(highs, r7s, hz_leader, rho, hz, least, enough, out):
    """`misfit` for many leaders; raises `out` to it."""
    for k in range(len(out)):
        out[k] = max(out[k], misfit(highs[k], r7s[k], hz_leader, rho, hz, least, enough))


@hot
def start(rows, r, automatic, r6):
    """Start the chip in `rows` on a preset move with row `r` but R6 = `r6`. automatic: by the automatic ramp-down point."""
    chip = rows[0]
    for k in range(8):
        chip.reg[k] = r[k]
    if len(r) > 8:
        chip.reg[R14], chip.reg[R15] = r[8], r[9]
    chip.reg[6] = r6 & chip.mask[6] if automatic else r6
    core.write(rows, 0, 0, 0x54 if automatic else 0x44)
    core.write(rows, 0, 0, 0x15 if r[2] > r[1] else 0x11)


@hot
def play(rows, r, automatic, r6, out):
    """Fill `out` with the pulses of such a move."""
    start(rows, r, automatic, r6)
    return core.trace(rows, 0, NEVER >> 16, out)


@hot
def risen(rows, r):
    """Pulses that the chip in `rows` counts in the ramp-up of row `r`."""
    start(rows, r, False, r[6])
    core.advance(rows, 0, NEVER >> 16)
    return rows[0].risen


@cache
def _powered_up(chip: Any) -> bytes:
    return chip().snapshot().record


def _fresh(chip: Any) -> np.ndarray:
    """The record of a chip just powered up, to play with."""
    return np.frombuffer(bytearray(_powered_up(chip)), core.STATE)


def offset(r: np.ndarray, chip: type[PCL240]) -> int:
    """R6 that makes the automatic ramp-down come at the same pulse as without it (normative model, section 7): the one begins
    once R0 <= pulses of the ramp-up + offset, the other once R0 < R6."""
    return int(r[6]) - 1 - int(risen(_fresh(chip), r))


def run(r: np.ndarray, chip: type[PCL240] = PCL240K, automatic: bool = False) -> np.ndarray:
    """Ticks from the start to each pulse (int64), by an emulated `chip` with row `r`."""
    r = np.asarray(r, np.int64)
    out = np.empty(int(r[0]), core.PULSE)
    play(_fresh(chip), r, automatic, offset(r, chip) if automatic else int(r[6]), out)
    return out["clock"].copy()
