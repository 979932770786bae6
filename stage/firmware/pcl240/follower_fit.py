"""Registers with which one axis follows another along a line. Compiled; `plan` is the face of it.

Between two speed steps a chip's pulses are a straight line in time, so its count is known in closed form, as a fraction N(t).
Against a leader that makes d pulses, a follower that makes rho d (rho <= 1) errs by

    E(t) = N(t + lead) - rho N_leader(t)        in the follower's pulses; lead: how much earlier it was started

Counts are whole: n = floor(N), so n - rho n_leader lies between E - 1 and E + rho. A follower for which E stays within
0 to 1 - rho strays no further than a perfect one does, whose first pulse is a whole pulse late; and by as much as E is
above 0 before that pulse, it strays less. `fit_accelerations` and `fit_decelerations` look for it over every multiplier R7.

An axis' registers are a row: R0 to R7, and on a chip with S-curves R14 and R15 after them. R6 in it is always the pulses left
when the ramp-down begins; with the automatic ramp-down point the chip gets the equivalent offset (`row_emulation.compute_offset`).
"""

from __future__ import annotations

import numpy as np

from stage.firmware.pcl240.preset_move_closed_form import (
    NEVER_TICKS,
    compute_linear_phase,
    compute_ramp_stretch,
    compute_ramp_ticks,
    compute_s_curve_phase,
    count_pulses,
    fill_motion,
    find_first_pulse_tick,
    has_s_curve_ramps,
    set_s_curve_registers,
)
from stage.native import array_of, exported, hot, record

MAX_CANDIDATES = 24  # accelerations that are tried with every deceleration
MAX_BEST_ROWS = 4  # followers returned
RAMP_POINTS = 8
EXTRA_POINTS = 3  # points: ends of the follower's ramps
SPREAD_WEIGHT = 0.02  # prefers a flat E among equals
DRIFT_WEIGHT = 0.1  # and an exact ratio, by the pulses that it would drift
TAIL_WEIGHT = 3.0  # pulses at FL after the ramp-down, of which a follower with another FL makes another number
RATIO_WEIGHT = 1.0  # a ratio error of 1 % has to buy a hundredth of a pulse


ROW_TYPE = array_of("i8")
DEMAND_POINTS = RAMP_POINTS + 1 + EXTRA_POINTS
WORK_DTYPE = record(
    [
        ("leader", "i8", (4,)),
        ("own", "i8", (4,)),
        ("row", "i8", (10,)),
        ("up", "f8", (2, DEMAND_POINTS)),
        ("down", "f8", (2, DEMAND_POINTS)),
    ]
)
"""Scratch memory: motions of the leader and of the tried follower, the row of the follower, and the ramps that the leader demands
(see `_fill_demanded_ramp`)."""


@hot
def _widen_error_range(due, r, own, hz, lead, end, lo, hi):
    """Widen lo..hi by E at the times of `due` up to `end`. Until the follower's first pulse only its running ahead counts."""
    bent, m = has_s_curve_ramps(r), 8192.0 * r[7]
    for k in range(due.shape[1]):
        if due[0, k] <= end:
            t = max((due[0, k] + lead) * hz, 0.0)
            n = (compute_s_curve_phase(r, own, t) if bent else compute_linear_phase(r, own, t)) / m
            e = n - due[1, k]
            if n >= 1.0:
                lo = min(lo, e)
            hi = max(hi, e)
    return lo, hi


@hot
def _compute_follower_score(lo, hi, rho, penalty):
    """Return the score of a follower, about its largest distance from the line; smaller is better."""
    return max(1.0 - lo, hi + rho) + SPREAD_WEIGHT * abs(hi - lo) + penalty


@hot
def _copy_row(source, target):
    """Copy a row."""
    for k in range(len(target)):
        target[k] = source[k]


@hot
def _insert_candidate(scores, candidates, score, r):
    """Insert `r` into `candidates`, best first, if it is good enough."""
    k = len(scores) - 1
    if score >= scores[k]:
        return
    while k > 0 and scores[k - 1] > score:
        scores[k] = scores[k - 1]
        _copy_row(candidates[k - 1], candidates[k])
        k -= 1
    scores[k] = score
    _copy_row(r, candidates[k])


@hot
def _fill_demanded_ramp(leader, c, hz_leader, rho, begin, ticks, out):
    """Fill `out` (POINTS columns) with a ramp of the leader in parts: times in s (row 0), and what the follower shall have made by
    then (row 1); MORE times have room after them."""
    length = ticks / hz_leader
    for k in range(RAMP_POINTS + 1):
        _set_demanded_point(leader, c, hz_leader, rho, begin + length * k / RAMP_POINTS, out, k)


@hot
def _set_demanded_point(leader, c, hz_leader, rho, t, out, k):
    """Fill column `k` of `out` with a time, s, and the pulses that the follower should have made by then."""
    out[0, k] = t
    out[1, k] = rho * count_pulses(leader, c, t * hz_leader)


@hot
def _fill_demanded_ramp_up(leader, c, hz_leader, rho, out):
    """Fill `out` with the leader's ramp-up, see `_fill_demanded_ramp`."""
    _fill_demanded_ramp(leader, c, hz_leader, rho, 0.0, compute_ramp_ticks(leader, leader[4]), out)


@hot
def _fill_demanded_ramp_down(leader, c, hz_leader, rho, out):
    """Fill `out` with the leader's ramp-down, see `_fill_demanded_ramp`."""
    _fill_demanded_ramp(leader, c, hz_leader, rho, c[0] / hz_leader, compute_ramp_ticks(leader, leader[5]), out)


@hot
def _find_error_range_before_ramp_down(leader, c, hz_leader, due, r, own, hz, lead, rho):
    """Return the smallest and the largest E from the start to the leader's ramp-down. due: of the ramp-up."""
    own[0] = NEVER_TICKS  # its own ramp-down is not chosen yet
    end = min(c[0], c[3]) / hz_leader
    k = RAMP_POINTS + 1
    for t in (find_first_pulse_tick(r, own) / hz - lead + 1e-12, compute_ramp_ticks(r, r[4]) / hz - lead, end):
        _set_demanded_point(leader, c, hz_leader, rho, t if 0 <= t <= end else 0.0, due, k)
        k += 1
    return _widen_error_range(due, r, own, hz, lead, np.inf, 1.0, 0.0)


@hot
def _widen_error_range_after_ramp_down(leader, c, hz_leader, due, r, own, hz, lead, rho, lo, hi):
    """Widen lo and hi by E from the leader's ramp-down, or the follower's, to the first last pulse. due: of the ramp-down."""
    fill_motion(r, own)
    end = min(c[3] / hz_leader, own[3] / hz - lead)
    k = RAMP_POINTS + 1
    for t in (own[0] / hz - lead, own[0] / hz - lead + compute_ramp_ticks(r, r[5]) / hz, end):
        _set_demanded_point(leader, c, hz_leader, rho, min(t, end), due, k)
        k += 1
    return _widen_error_range(due, r, own, hz, lead, end, lo, hi)


@exported(None, ROW_TYPE, "i8", "i8", "i8", "f8", "f8", "i8", "i8", array_of("f8"), array_of("i8", 2), WORK_DTYPE)
def fit_accelerations(leader, hz_leader, d, hz, lead, share, max_rate, only, scores, candidates, work):
    """Choose R1, R2, R4 and R7 of a follower.

    For every multiplier: the nearest FH, R4 by the slope, and R1 by the pulses lost in the ramp.

    Args:
        leader: Row of the leader.
        hz_leader: Reference clock of the leader's chip, Hz.
        d: Pulses of the follower.
        hz: Reference clock of the follower's chip, Hz.
        lead: Seconds by which the follower is started earlier.
        share: Share of the speed steps in each curved end of a ramp, see `set_s_curve_registers`.
        max_rate: Largest R4.
        only: The one R7 that is possible; 0 for any.
        scores: Array that is filled with the scores of the candidates.
        candidates: Array that is filled with rows, best first.
        work: Room to work in.
    """
    c, own, r, up = work.leader, work.own, work.row[: candidates.shape[1]], work.up
    fill_motion(leader, c)
    rho = d / leader[0]
    step0 = hz_leader / (8192.0 * leader[7])
    fh, gain = rho * leader[2] * step0, leader[2] - leader[1]
    slope = rho * step0 * hz_leader / leader[4]
    rise = compute_ramp_ticks(leader, leader[4]) / hz_leader
    lag = rho * gain * (gain + 1) * leader[4] * compute_ramp_stretch(leader) / (16384.0 * leader[7])
    fall_lag = lag * leader[5] / leader[4]
    end = min(c[0], c[3]) / hz_leader
    middle = 0.5 * (rise + end)
    r[:] = 0
    r[0] = d
    _fill_demanded_ramp_up(leader, c, hz_leader, rho, up)
    scores[:] = 1e18
    candidates[:] = 0
    for r7 in range(only if only else 1023, only - 1 if only else 1, -1):
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
            set_s_curve_registers(r, share)
            lo, hi = _find_error_range_before_ramp_down(leader, c, hz_leader, up, r, own, hz, lead, rho)
            _insert_candidate(scores, candidates, _compute_follower_score(lo, hi, rho, penalty), r)
            continue
        r[1] = max(high - max(int(np.rint(high * gain / leader[2])), 1), 1)
        set_s_curve_registers(r, share)
        stretched = compute_ramp_stretch(r)
        nominal = int(np.rint(hz * step / slope * (compute_ramp_stretch(leader) / stretched)))
        needed = nominal * leader[5] / leader[4]  # R5
        if needed > max_rate:  # its ramp-down would be too short
            penalty += fall_lag * (1.0 - max_rate / needed)
        # FH (t + lead) - lost = rho N_leader(t) + ahead
        lost = high * step * (middle + lead) - fh * middle + lag
        last = 0
        for shift in range(-3, 4):
            r4 = min(max(nominal + shift, 2), max_rate)
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
                        set_s_curve_registers(r, share)
                        lo, hi = _find_error_range_before_ramp_down(leader, c, hz_leader, up, r, own, hz, lead, rho)
                        _insert_candidate(scores, candidates, _compute_follower_score(lo, hi, rho, penalty) + tail, r)


@exported(
    None, ROW_TYPE, "i8", "i8", "f8", "i8", "i8", "i8", array_of("i8", 2), array_of("f8"), array_of("i8", 2), WORK_DTYPE
)
def fit_decelerations(leader, hz_leader, hz, lead, automatic, max_rate, max_point, candidates, scores, best, work):
    """Choose R5 and R6 for each of the candidates of `fit_accelerations`.

    Args:
        leader: Row of the leader.
        hz_leader: Reference clock of the leader's chip, Hz.
        hz: Reference clock of the follower's chip, Hz.
        lead: Seconds by which the follower is started earlier.
        automatic: Whether R5 is R4.
        max_rate: Largest R5.
        max_point: Largest R6.
        candidates: Rows of `fit_accelerations`.
        scores: Array that is filled with scores, about the largest distance from the line, in the follower's pulses.
        best: Array that is filled with rows, best first.
        work: Room to work in.
    """
    c, own, r, up, down = work.leader, work.own, work.row[: candidates.shape[1]], work.up, work.down
    fill_motion(leader, c)
    scores[:] = 1e18
    best[:] = 0
    begin = c[0] / hz_leader
    rho = candidates[0, 0] / leader[0]
    _fill_demanded_ramp_up(leader, c, hz_leader, rho, up)
    _fill_demanded_ramp_down(leader, c, hz_leader, rho, down)
    for row in range(len(candidates)):
        _copy_row(candidates[row], r)
        d = r[0]
        if d == 0:
            continue
        error = abs(r[2] * hz * leader[7] / (rho * leader[2] * hz_leader * r[7]) - 1.0)
        penalty = RATIO_WEIGHT * error + DRIFT_WEIGHT * error * d
        rise_lo, rise_hi = _find_error_range_before_ramp_down(leader, c, hz_leader, up, r, own, hz, lead, rho)
        if r[2] == r[1]:
            lo, hi = _widen_error_range_after_ramp_down(
                leader, c, hz_leader, down, r, own, hz, lead, rho, rise_lo, rise_hi
            )
            _insert_candidate(scores, best, _compute_follower_score(lo, hi, rho, penalty), r)
            continue
        slope = hz / (8192.0 * r[7]) * leader[5] * hz * 8192 * leader[7] / (rho * hz_leader * hz_leader)
        nominal = int(np.rint(slope * (compute_ramp_stretch(leader) / compute_ramp_stretch(r))))
        pulses_made = int(count_pulses(r, own, (begin + lead) * hz))
        last = 0
        for shift in range(-3, 4):
            r5 = r[4] if automatic else min(max(nominal + shift, 2), max_rate)
            if r5 == last:
                continue
            last = r[5] = r5
            for k in range(-1, 3):
                r[6] = min(max(d - pulses_made - k + 1, 1), d, max_point)
                lo, hi = _widen_error_range_after_ramp_down(
                    leader, c, hz_leader, down, r, own, hz, lead, rho, rise_lo, rise_hi
                )
                _insert_candidate(scores, best, _compute_follower_score(lo, hi, rho, penalty), r)


@exported("f8", ROW_TYPE, "i8", ROW_TYPE, "i8", "f8", WORK_DTYPE)
def estimate_line_distance(leader, hz_leader, r, hz, lead, work):
    """Estimate the largest distance of a follower from the line, in its pulses.

    Args:
        leader: Row of the leader.
        hz_leader: Reference clock of the leader's chip, Hz.
        r: Row of the follower.
        hz: Reference clock of the follower's chip, Hz.
        lead: Seconds by which the follower is started earlier.
        work: Room to work in.
    """
    c, own, up, down = work.leader, work.own, work.up, work.down
    fill_motion(leader, c)
    rho = r[0] / leader[0]
    _fill_demanded_ramp_up(leader, c, hz_leader, rho, up)
    _fill_demanded_ramp_down(leader, c, hz_leader, rho, down)
    lo, hi = _find_error_range_before_ramp_down(leader, c, hz_leader, up, r, own, hz, lead, rho)
    lo, hi = _widen_error_range_after_ramp_down(leader, c, hz_leader, down, r, own, hz, lead, rho, lo, hi)
    return max(1.0 - lo, hi + rho)


@hot
def compute_rate_misfit(high, r7, hz_leader, rho, hz, least, enough, only):
    """Return the smallest relative error with which a follower makes its share of the leader's rate.

    Args:
        high: FH of the leader, speed steps.
        r7: R7 of the leader.
        hz_leader: Reference clock of the leader's chip, Hz.
        rho: Share of the leader's rate.
        hz: Reference clock of the follower's chip, Hz.
        least: Smallest FH of the follower, speed steps.
        enough: Error below which the search ends.
        only: The one R7 that is possible, -1 for `r7`; 0 for any.
    """
    ratio = rho * high * hz_leader / (r7 * hz)
    best = 1.0
    one = int(r7) if only < 0 else only
    for own in range(one if one else 2, one + 1 if one else 1024):
        exact = ratio * own
        if exact > 8191.5:
            break
        if exact >= least:
            best = min(best, abs(np.rint(exact) / exact - 1.0))
            if best < enough:
                break
    return best


@exported(None, array_of("f8"), ROW_TYPE, "i8", "f8", "i8", "f8", "f8", "i8", array_of("f8"))
def compute_rate_misfits(highs, r7s, hz_leader, rho, hz, least, enough, only, out):
    """Raise `out` to the `compute_rate_misfit` of many leaders."""
    for k in range(len(out)):
        out[k] = max(out[k], compute_rate_misfit(highs[k], r7s[k], hz_leader, rho, hz, least, enough, only))
