"""Search for registers with which one axis follows another along a line. Compiled; `line_plan.plan` uses it.

Between two speed steps a chip's pulses are a straight line in time, so its count is known in closed form, as a fraction N(t).
A follower makes the share rho (`rate_share`, at most 1) of the leader's pulses. Its error is

    E(t) = N(t + lead) - rho N_leader(t)        in the follower's pulses; lead: how much earlier it was started

Counts are whole: n = floor(N), so n - rho n_leader lies between E - 1 and E + rho. A follower whose E stays within
0 to 1 - rho strays no further than a perfect one, whose first pulse is a whole pulse late. A follower whose E is above 0 before
that pulse strays less, by as much. `fit_accelerations` and `fit_decelerations` look for such followers with every multiplier R7.

The registers of an axis are a row: R0 to R7, and on a chip with S-curves also R14 and R15. R6 in a row is always the number of
pulses left when the ramp-down begins; with the automatic ramp-down point the chip gets the equivalent offset
(`emulated_preset_move.compute_ramp_down_offset`).
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
RAMP_END_POINTS = 3  # points: ends of the follower's ramps
SPREAD_WEIGHT = 0.02  # prefers a flat E among equals
DRIFT_WEIGHT = 0.1  # and an exact ratio, by the pulses that it would drift
TAIL_WEIGHT = 3.0  # pulses at FL after the ramp-down, of which a follower with another FL makes another number
RATIO_WEIGHT = 1.0  # a ratio error of 1 % has to buy a hundredth of a pulse


ROW_TYPE = array_of("i8")
DEMAND_POINTS = RAMP_POINTS + 1 + RAMP_END_POINTS
WORK_DTYPE = record(
    [
        ("leader_clock_hz", "i8"),
        ("clock_hz", "i8"),
        ("lead", "f8"),
        ("rate_share", "f8"),
        ("leader_motion", "i8", (4,)),
        ("motion", "i8", (4,)),
        ("row", "i8", (10,)),
        ("up", "f8", (2, DEMAND_POINTS)),
        ("down", "f8", (2, DEMAND_POINTS)),
    ]
)
"""Memory of a search: clocks, lead, rate share, motions of the leader and of the tried follower, the row of the follower, and the
ramps that the leader demands (see `_fill_demanded_ramp`)."""


@hot
def _begin_search(leader, leader_clock_hz, clock_hz, lead, rate_share, work):
    """Store in `work` the arguments of a search, the motion of the leader, and the ramps that it demands."""
    work.leader_clock_hz, work.clock_hz, work.lead, work.rate_share = leader_clock_hz, clock_hz, lead, rate_share
    fill_motion(leader, work.leader_motion)
    _fill_demanded_ramp(leader, work, 0.0, compute_ramp_ticks(leader, leader[4]), work.up)
    begin = work.leader_motion[0] / leader_clock_hz
    _fill_demanded_ramp(leader, work, begin, compute_ramp_ticks(leader, leader[5]), work.down)


@hot
def _fill_demanded_ramp(leader, work, begin, ticks, out):
    """Fill `out` with points of a leader's ramp that the follower has to match.

    Row 0 gets the times, s, and row 1 the pulses that the follower should have made by then. RAMP_POINTS + 1 columns are filled;
    the RAMP_END_POINTS columns after them stay free for further times.
    """
    length = ticks / work.leader_clock_hz
    for k in range(RAMP_POINTS + 1):
        _set_demanded_point(leader, work, begin + length * k / RAMP_POINTS, out, k)


@hot
def _set_demanded_point(leader, work, time, out, column):
    """Fill column `column` of `out` with a time, s, and the pulses that the follower should have made by then."""
    out[0, column] = time
    out[1, column] = work.rate_share * count_pulses(leader, work.leader_motion, time * work.leader_clock_hz)


@hot
def _widen_error_range(demanded, row, work, end, low_error, high_error):
    """Widen the range of the line error E, pulses, by its values at the demanded points up to the time `end`, s.

    Before the follower's first pulse only a positive E counts.
    """
    bent, m = has_s_curve_ramps(row), 8192.0 * row[7]
    motion, clock_hz, lead = work.motion, work.clock_hz, work.lead
    for k in range(demanded.shape[1]):
        if demanded[0, k] <= end:
            ticks = max((demanded[0, k] + lead) * clock_hz, 0.0)
            n = (compute_s_curve_phase(row, motion, ticks) if bent else compute_linear_phase(row, motion, ticks)) / m
            e = n - demanded[1, k]
            if n >= 1.0:
                low_error = min(low_error, e)
            high_error = max(high_error, e)
    return low_error, high_error


@hot
def _find_error_range_before_ramp_down(leader, row, work):
    """Return the smallest and the largest line error E, pulses, from the start to the leader's ramp-down."""
    motion = work.motion
    motion[0] = NEVER_TICKS  # its own ramp-down is not chosen yet
    end = min(work.leader_motion[0], work.leader_motion[3]) / work.leader_clock_hz
    k = RAMP_POINTS + 1
    for time in (
        find_first_pulse_tick(row, motion) / work.clock_hz - work.lead + 1e-12,
        compute_ramp_ticks(row, row[4]) / work.clock_hz - work.lead,
        end,
    ):
        _set_demanded_point(leader, work, time if 0 <= time <= end else 0.0, work.up, k)
        k += 1
    return _widen_error_range(work.up, row, work, np.inf, 1.0, 0.0)


@hot
def _widen_error_range_after_ramp_down(leader, row, work, low_error, high_error):
    """Widen the range of the line error E by its values from the first ramp-down to the first end of an axis."""
    motion = work.motion
    fill_motion(row, motion)
    end = min(work.leader_motion[3] / work.leader_clock_hz, motion[3] / work.clock_hz - work.lead)
    begin = motion[0] / work.clock_hz - work.lead
    k = RAMP_POINTS + 1
    for time in (begin, begin + compute_ramp_ticks(row, row[5]) / work.clock_hz, end):
        _set_demanded_point(leader, work, min(time, end), work.down, k)
        k += 1
    return _widen_error_range(work.down, row, work, end, low_error, high_error)


@hot
def _compute_score(error_range, rate_share, penalty):
    """Return the score of a follower of a line: about its largest distance from the line, plus a penalty. Smaller is better."""
    low_error, high_error = error_range
    return max(1.0 - low_error, high_error + rate_share) + SPREAD_WEIGHT * abs(high_error - low_error) + penalty


@hot
def _copy_row(source, target):
    """Copy the registers of one row into another row."""
    for k in range(len(target)):
        target[k] = source[k]


@hot
def _insert_candidate(scores, candidates, score, row):
    """Insert a row of registers into `candidates`, best first, if its score is better than that of the last one."""
    k = len(scores) - 1
    if score >= scores[k]:
        return
    while k > 0 and scores[k - 1] > score:
        scores[k] = scores[k - 1]
        _copy_row(candidates[k - 1], candidates[k])
        k -= 1
    scores[k] = score
    _copy_row(row, candidates[k])


@exported(None, ROW_TYPE, "i8", "i8", "i8", "f8", "f8", "i8", "i8", array_of("f8"), array_of("i8", 2), WORK_DTYPE)
def fit_accelerations(
    leader, leader_clock_hz, pulses, clock_hz, lead, curve_share, max_rate, only_r7, scores, candidates, work
):
    """Choose R1, R2, R4 and R7 of a follower, so that its ramp up matches that of the leader of a line.

    For every multiplier, R2 is the nearest FH, R4 follows from the slope, and R1 from the pulses lost in the ramp.

    Args:
        leader: Row of the leader.
        leader_clock_hz: Reference clock of the leader's chip, Hz.
        pulses: Pulses of the follower.
        clock_hz: Reference clock of the follower's chip, Hz.
        lead: Seconds by which the follower is started earlier.
        curve_share: Fraction of the speed steps in each curved end of a ramp, see `set_s_curve_registers`.
        max_rate: Largest R4.
        only_r7: The only possible R7; 0 for any.
        scores: Array that is filled with the scores of the candidates.
        candidates: Array that is filled with rows, best first.
        work: WORK_DTYPE record, overwritten.
    """
    row, rate_share = work.row[: candidates.shape[1]], pulses / leader[0]
    _begin_search(leader, leader_clock_hz, clock_hz, lead, rate_share, work)
    step0 = leader_clock_hz / (8192.0 * leader[7])
    fh, gain = rate_share * leader[2] * step0, leader[2] - leader[1]
    slope = rate_share * step0 * leader_clock_hz / leader[4]
    rise = compute_ramp_ticks(leader, leader[4]) / leader_clock_hz
    lag = rate_share * gain * (gain + 1) * leader[4] * compute_ramp_stretch(leader) / (16384.0 * leader[7])
    fall_lag = lag * leader[5] / leader[4]
    end = min(work.leader_motion[0], work.leader_motion[3]) / leader_clock_hz
    middle = 0.5 * (rise + end)
    row[:] = 0
    row[0] = pulses
    scores[:] = 1e18
    candidates[:] = 0
    for r7 in range(only_r7 if only_r7 else 1023, only_r7 - 1 if only_r7 else 1, -1):
        step = clock_hz / (8192.0 * r7)
        high = max(1, int(np.rint(fh / step)))
        drift = (high * step - fh) * (end - rise)
        penalty = RATIO_WEIGHT * abs(high * step / fh - 1.0) + DRIFT_WEIGHT * abs(drift)
        floor = 0.5 * (1.0 + rate_share + abs(drift)) + penalty  # no score is below
        if high > 8191 or floor > scores[-1]:
            continue
        row[2] = row[3] = high
        row[7] = r7
        if gain == 0 or high == 1:
            row[1], row[4], row[5] = high, 2, 2
            set_s_curve_registers(row, curve_share)
            error_range = _find_error_range_before_ramp_down(leader, row, work)
            _insert_candidate(scores, candidates, _compute_score(error_range, rate_share, penalty), row)
            continue
        row[1] = max(high - max(int(np.rint(high * gain / leader[2])), 1), 1)
        set_s_curve_registers(row, curve_share)
        stretched = compute_ramp_stretch(row)
        nominal = int(np.rint(clock_hz * step / slope * (compute_ramp_stretch(leader) / stretched)))
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
            last = row[4] = row[5] = r4
            tried = -1
            for ahead in (min(0.5 * (1.0 - rate_share), 0.25 * lag), 0.0):
                area = max(lost - ahead, 0.0) * 16384.0 * r7 / r4 / stretched
                gained = int(0.5 * (np.sqrt(1.0 + 4.0 * area) - 1.0))
                for k in (gained, gained + 1):
                    if k <= tried:
                        continue
                    tried = k
                    row[1] = max(high - k, 1)
                    tail = TAIL_WEIGHT * abs(row[1] * step / (leader[1] * step0) - rate_share)
                    if floor + tail < scores[-1]:
                        set_s_curve_registers(row, curve_share)
                        error_range = _find_error_range_before_ramp_down(leader, row, work)
                        score = _compute_score(error_range, rate_share, penalty) + tail
                        _insert_candidate(scores, candidates, score, row)


@exported(
    None, ROW_TYPE, "i8", "i8", "f8", "i8", "i8", "i8", array_of("i8", 2), array_of("f8"), array_of("i8", 2), WORK_DTYPE
)
def fit_decelerations(
    leader, leader_clock_hz, clock_hz, lead, automatic, max_rate, max_point, candidates, scores, best, work
):
    """Choose R5 and R6 for each of the candidates of `fit_accelerations`.

    Args:
        leader: Row of the leader.
        leader_clock_hz: Reference clock of the leader's chip, Hz.
        clock_hz: Reference clock of the follower's chip, Hz.
        lead: Seconds by which the follower is started earlier.
        automatic: Whether R5 is R4.
        max_rate: Largest R5.
        max_point: Largest R6.
        candidates: Rows of `fit_accelerations`.
        scores: Array that is filled with scores, about the largest distance from the line, in the follower's pulses.
        best: Array that is filled with rows, best first.
        work: Room to work in.
    """
    row, rate_share = work.row[: candidates.shape[1]], candidates[0, 0] / leader[0]
    _begin_search(leader, leader_clock_hz, clock_hz, lead, rate_share, work)
    scores[:] = 1e18
    best[:] = 0
    begin = work.leader_motion[0] / leader_clock_hz
    for index in range(len(candidates)):
        _copy_row(candidates[index], row)
        pulses = row[0]
        if pulses == 0:
            continue
        error = abs(row[2] * clock_hz * leader[7] / (rate_share * leader[2] * leader_clock_hz * row[7]) - 1.0)
        penalty = RATIO_WEIGHT * error + DRIFT_WEIGHT * error * pulses
        low_error, high_error = _find_error_range_before_ramp_down(leader, row, work)
        if row[2] == row[1]:
            error_range = _widen_error_range_after_ramp_down(leader, row, work, low_error, high_error)
            _insert_candidate(scores, best, _compute_score(error_range, rate_share, penalty), row)
            continue
        step = clock_hz / (8192.0 * row[7])
        slope = step * leader[5] * clock_hz * 8192 * leader[7] / (rate_share * leader_clock_hz * leader_clock_hz)
        nominal = int(np.rint(slope * (compute_ramp_stretch(leader) / compute_ramp_stretch(row))))
        pulses_made = int(count_pulses(row, work.motion, (begin + lead) * clock_hz))
        last = 0
        for shift in range(-3, 4):
            r5 = row[4] if automatic else min(max(nominal + shift, 2), max_rate)
            if r5 == last:
                continue
            last = row[5] = r5
            for k in range(-1, 3):
                row[6] = min(max(pulses - pulses_made - k + 1, 1), pulses, max_point)
                error_range = _widen_error_range_after_ramp_down(leader, row, work, low_error, high_error)
                _insert_candidate(scores, best, _compute_score(error_range, rate_share, penalty), row)


@exported("f8", ROW_TYPE, "i8", ROW_TYPE, "i8", "f8", WORK_DTYPE)
def estimate_follower_error(leader, leader_clock_hz, row, clock_hz, lead, work):
    """Estimate the largest distance of a follower from the straight line, in the follower's pulses.

    Args:
        leader: Row of the leader.
        leader_clock_hz: Reference clock of the leader's chip, Hz.
        row: Row of the follower.
        clock_hz: Reference clock of the follower's chip, Hz.
        lead: Seconds by which the follower is started earlier.
        work: Room to work in.
    """
    rate_share = row[0] / leader[0]
    _begin_search(leader, leader_clock_hz, clock_hz, lead, rate_share, work)
    low_error, high_error = _find_error_range_before_ramp_down(leader, row, work)
    low_error, high_error = _widen_error_range_after_ramp_down(leader, row, work, low_error, high_error)
    return max(1.0 - low_error, high_error + rate_share)


@hot
def compute_rate_misfit(
    leader_speed, leader_r7, leader_clock_hz, rate_share, clock_hz, min_speed, accepted_error, only_r7
):
    """Return the smallest relative error with which a follower makes its share of the leader's rate.

    Args:
        leader_speed: FH of the leader, speed steps.
        leader_r7: R7 of the leader.
        leader_clock_hz: Reference clock of the leader's chip, Hz.
        rate_share: Follower's share of the leader's rate.
        clock_hz: Reference clock of the follower's chip, Hz.
        min_speed: Smallest FH of the follower, speed steps.
        accepted_error: Error below which the search ends.
        only_r7: The only possible R7, -1 for `leader_r7`; 0 for any.
    """
    ratio = rate_share * leader_speed * leader_clock_hz / (leader_r7 * clock_hz)
    best = 1.0
    one = int(leader_r7) if only_r7 < 0 else only_r7
    for own_r7 in range(one if one else 2, one + 1 if one else 1024):
        exact = ratio * own_r7
        if exact > 8191.5:
            break
        if exact >= min_speed:
            best = min(best, abs(np.rint(exact) / exact - 1.0))
            if best < accepted_error:
                break
    return best


@exported(None, array_of("f8"), ROW_TYPE, "i8", "f8", "i8", "f8", "f8", "i8", array_of("f8"))
def compute_rate_misfits(
    leader_speeds, leader_r7s, leader_clock_hz, rate_share, clock_hz, min_speed, accepted_error, only_r7, misfits
):
    """Compute `compute_rate_misfit` for many leaders, and store each result in `misfits` if it is larger than the entry there."""
    for k in range(len(misfits)):
        misfit = compute_rate_misfit(
            leader_speeds[k], leader_r7s[k], leader_clock_hz, rate_share, clock_hz, min_speed, accepted_error, only_r7
        )
        misfits[k] = max(misfits[k], misfit)
