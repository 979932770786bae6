"""Registers with which one axis follows another along a line. Compiled; `plan` is the face of it.

Between two speed steps a chip's pulses are a straight line in time, so its count is known in closed form, as a fraction N(t).
Against a leader that makes d pulses, a follower that makes rho d (rho <= 1) errs by

    E(t) = N(t + lead) - rho N_leader(t)        in the follower's pulses; lead: how much earlier it was started

Counts are whole: n = floor(N), so n - rho n_leader lies between E - 1 and E + rho. A follower for which E stays within
0 to 1 - rho strays no further than a perfect one does, whose first pulse is a whole pulse late; and by as much as E is
above 0 before that pulse, it strays less. `accelerations` and `decelerations` look for it over every multiplier R7.
"""

from __future__ import annotations

import numpy as np

from stage.chips.pcl240 import core
from stage.compiled import hot

KEPT = 24  # accelerations that are tried with every deceleration
BEST = 4  # followers returned
RAMP_POINTS = 8
NEVER = 1 << 60
SPREAD_WEIGHT = 0.02  # prefers a flat E among equals
DRIFT_WEIGHT = 0.1  # and an exact ratio, by the pulses that it would drift
TAIL_WEIGHT = 3.0  # pulses at FL after the ramp-down, of which a follower with another FL makes another number
RATIO_WEIGHT = 1.0  # a ratio error of 1 % has to buy a hundredth of a pulse


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
def course(r, c):
    """Fill `c` from the registers `r`: ticks to the ramp-down, speed and phase there, ticks to the last pulse."""
    d, fl, fh, up, down, m = r[0], r[1], r[2], r[4], r[5], 8192 * r[7]
    c[0], c[1], c[2] = NEVER, fh, 0
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
def phase(r, c, t):
    """Phase gained `t` ticks after the start (a fraction between ticks); 8192 R7 make a pulse."""
    if t <= c[0]:
        j = min(r[2] - r[1], int(t / r[4]))
        return r[4] * (r[1] * j + j * (j - 1) // 2) + (t - j * r[4]) * (r[1] + j)
    u = t - c[0]
    if c[1] <= r[1]:
        return c[2] + u * r[1]
    j = min(c[1] - 1 - r[1], int(u / r[5]))
    return c[2] + r[5] * ((c[1] - 1) * j - j * (j - 1) // 2) + (u - j * r[5]) * (c[1] - 1 - j)


@hot
def count(r, c, t):
    """N: pulses made `t` ticks after the start, as a fraction."""
    return phase(r, c, max(t, 0.0)) / (8192.0 * r[7])


@hot
def _stray(lead, rho, leader, c, hz_leader, r, own, hz, t, lo, hi):
    """Widen lo..hi by E at `t` s. Until the follower's first pulse only its running ahead counts."""
    n = count(r, own, (t + lead) * hz)
    e = n - rho * count(leader, c, t * hz_leader)
    return (min(lo, e) if n >= 1.0 else lo), max(hi, e)


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
def _rise(leader, c, hz_leader, r, own, hz, lead, rho):
    """lo and hi of E from the start to the leader's ramp-down."""
    course(r, own)
    own[0] = NEVER  # its own ramp-down is not chosen yet
    lo, hi = 1.0, count(r, own, lead * hz)
    top = (leader[2] - leader[1]) * leader[4] / hz_leader
    if top > 0:
        for k in range(1, RAMP_POINTS + 1):
            lo, hi = _stray(lead, rho, leader, c, hz_leader, r, own, hz, top * k / RAMP_POINTS, lo, hi)
    first = _ticks_to(8192 * r[7], r[4], r[1], 1, r[2] - r[1]) / hz - lead
    end = min(c[0], c[3]) / hz_leader
    for t in (first + 1e-12, (r[2] - r[1]) * r[4] / hz - lead, end):
        if 0 <= t <= end:
            lo, hi = _stray(lead, rho, leader, c, hz_leader, r, own, hz, t, lo, hi)
    return lo, hi


@hot
def _fall(leader, c, hz_leader, r, own, hz, lead, rho, lo, hi):
    """As _rise, from the leader's ramp-down, or its own, to the first last pulse."""
    course(r, own)
    end = min(c[3] / hz_leader, own[3] / hz - lead)
    begin = c[0] / hz_leader
    length = (leader[2] - leader[1]) * leader[5] / hz_leader
    for k in range(RAMP_POINTS + 1):
        t = begin + length * k / RAMP_POINTS
        if t <= end:
            lo, hi = _stray(lead, rho, leader, c, hz_leader, r, own, hz, t, lo, hi)
    for t in (own[0] / hz - lead, own[0] / hz - lead + (r[2] - r[1]) * r[5] / hz, end):
        if t <= end:
            lo, hi = _stray(lead, rho, leader, c, hz_leader, r, own, hz, t, lo, hi)
    return lo, hi


@hot
def accelerations(leader, hz_leader, d, hz, lead, scores, kept):
    """Choose R1, R2, R4 and R7 of a follower of `d` pulses: for each multiplier the nearest FH, R4 by the slope, and R1 by
    the pulses lost in the ramp. Fills `kept` (R0..R7), best first, and `scores`. leader: R0..R7."""
    c = np.zeros(4, np.int64)
    course(leader, c)
    rho = d / leader[0]
    step0 = hz_leader / (8192.0 * leader[7])
    fh, gain = rho * leader[2] * step0, leader[2] - leader[1]
    slope = rho * step0 * hz_leader / leader[4]
    rise = gain * leader[4] / hz_leader
    lag = rho * gain * (gain + 1) * leader[4] / (16384.0 * leader[7])
    fall_lag = lag * leader[5] / leader[4]
    end = min(c[0], c[3]) / hz_leader
    middle = 0.5 * (rise + end)
    r, own = np.zeros(8, np.int64), np.zeros(4, np.int64)
    r[0] = d
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
            lo, hi = _rise(leader, c, hz_leader, r, own, hz, lead, rho)
            _keep(scores, kept, _score(lo, hi, rho, penalty), r)
            continue
        nominal = int(np.rint(hz * step / slope))
        needed = nominal * leader[5] / leader[4]  # R5
        if needed > 16383:  # its ramp-down would be too short
            penalty += fall_lag * (1.0 - 16383 / needed)
        # FH (t + lead) - lost = rho N_leader(t) + ahead
        lost = high * step * (middle + lead) - fh * middle + lag
        last = 0
        for shift in range(-3, 4):
            r4 = min(max(nominal + shift, 2), 16383)
            if r4 == last:
                continue
            last = r[4] = r[5] = r4
            tried = -1
            for ahead in (min(0.5 * (1.0 - rho), 0.25 * lag), 0.0):
                gained = int(0.5 * (np.sqrt(1.0 + 4.0 * max(lost - ahead, 0.0) * 16384.0 * r7 / r4) - 1.0))
                for k in (gained, gained + 1):
                    if k <= tried:
                        continue
                    tried = k
                    r[1] = max(high - k, 1)
                    tail = TAIL_WEIGHT * abs(r[1] * step / (leader[1] * step0) - rho)
                    if floor + tail < scores[-1]:
                        lo, hi = _rise(leader, c, hz_leader, r, own, hz, lead, rho)
                        _keep(scores, kept, _score(lo, hi, rho, penalty) + tail, r)


@hot
def decelerations(leader, hz_leader, hz, lead, kept, scores, best):
    """Choose R5 and R6 for each of the `kept`. Fills `best`, best first, and `scores`: about the largest distance from the
    line, in the follower's pulses."""
    c, own = np.zeros(4, np.int64), np.zeros(4, np.int64)
    course(leader, c)
    scores[:] = 1e18
    best[:] = 0
    begin = c[0] / hz_leader
    for row in range(len(kept)):
        r = kept[row].copy()
        d = r[0]
        if d == 0:
            continue
        rho = d / leader[0]
        error = abs(r[2] * hz * leader[7] / (rho * leader[2] * hz_leader * r[7]) - 1.0)
        penalty = RATIO_WEIGHT * error + DRIFT_WEIGHT * error * d
        rise_lo, rise_hi = _rise(leader, c, hz_leader, r, own, hz, lead, rho)
        if r[2] == r[1]:
            lo, hi = _fall(leader, c, hz_leader, r, own, hz, lead, rho, rise_lo, rise_hi)
            _keep(scores, best, _score(lo, hi, rho, penalty), r)
            continue
        nominal = int(np.rint(hz / (8192.0 * r[7]) * leader[5] * hz * 8192 * leader[7] / (rho * hz_leader * hz_leader)))
        made = int(count(r, own, (begin + lead) * hz))
        last = 0
        for shift in range(-3, 4):
            r5 = min(max(nominal + shift, 2), 16383)
            if r5 == last:
                continue
            last = r[5] = r5
            for k in range(-1, 3):
                r[6] = min(max(d - made - k + 1, 1), d, 0xFFFFF)
                lo, hi = _fall(leader, c, hz_leader, r, own, hz, lead, rho, rise_lo, rise_hi)
                _keep(scores, best, _score(lo, hi, rho, penalty), r)


@hot
def estimate(leader, hz_leader, r, hz, lead):
    """About the largest distance of a follower with registers `r` from the line, in its pulses."""
    c, own = np.zeros(4, np.int64), np.zeros(4, np.int64)
    course(leader, c)
    rho = r[0] / leader[0]
    lo, hi = _rise(leader, c, hz_leader, r, own, hz, lead, rho)
    lo, hi = _fall(leader, c, hz_leader, r, own, hz, lead, rho, lo, hi)
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
def play(rows, r, out):
    """Pulses of a chip that makes a preset move with registers `r`, by its own core; rows: one cleared STATE record."""
    chip = rows[0]
    core.reset(chip)
    for k in range(8):
        chip.reg[k] = r[k]
    chip.clock = 0
    core.write(rows, 0, 0, 0x44)
    core.write(rows, 0, 0, 0x15 if r[2] > r[1] else 0x11)
    return core.trace(rows, 0, NEVER >> 16, out)


def run(r: np.ndarray) -> np.ndarray:
    """Ticks from the start to each pulse (int64), by an emulated chip with registers `r` (R0..R7)."""
    out = np.empty(int(r[0]), core.PULSE)
    play(np.zeros(1, core.STATE), np.asarray(r, np.int64), out)
    return out["clock"].copy()
