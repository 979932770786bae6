"""Search for the registers of an a:b move: those of the leader, which is the longest axis, and of its followers.

Several R7 and FH make the rate of the leader. The search first tries those for which the followers' registers come closest to their
share of this rate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from stage.chips import PCL240K
from stage.chips.pcl240 import PCL240
from stage.errors import ArgumentError
from stage.firmware.pcl240 import follower_register_search
from stage.firmware.pcl240.preset_move_closed_form import compute_ramp_stretch, set_s_curve_registers

LONG_MOVE_PULSES = 500_000  # pulses
LEADERS, LEADERS_LONG = 6, 60  # tried; more for a long move, in which small errors of the ratio add up
SHIFTS, SHIFTS_LONG = 4, 12  # speed steps around the given rate
RATE_ERROR = 2e-3
EXACT_RATIO_DRIFT_PULSES = 1e-6  # pulses of drift over the move: an exact ratio
ACCEPTED_DRIFT_PULSES = 0.05  # pulses that the ratio may cost a follower before another leader is preferred
SUFFICIENT_SCORE = 1.03  # a follower's score, about its largest distance in its pulses: search no further
MAX_SCORE_FOR_TAIL_VARIATION = 1.5  # not a matter of the tail
TAILS = (5, 8, 11, 14, 4, 6, 9)  # pulses at FL after the ramp-down; first the data sheet's R6 = Psd + 5
TAIL_SECONDS, TAIL_SHARE = 0.02, 0.05  # what a longer one may cost: seconds, or a share of the move

_LEGAL = {r.name: r.legal or (0, r.mask) for r in PCL240K.MAP.registers}
MIN_R7, MAX_R7 = _LEGAL["R7"]  # of the whole family
MAX_SPEED = _LEGAL["R2"][1]


class RegisterRanges(NamedTuple):
    """Ranges of the registers of a PCL-240 chip.

    Attributes:
        rate: Largest R4 and R5.
        point: Largest ramp-down point.
        row: Number of registers in a row.
    """

    rate: int
    point: int
    row: int

    @classmethod
    def from_chip(cls, chip: type[PCL240], automatic: bool) -> RegisterRanges:
        """Return the ranges of the registers of a PCL-240 chip.

        Args:
            chip: Class of the chip.
            automatic: Whether the chip finds the ramp-down point. R6 is then an offset, so the point may be as large as R0.
        """
        legal = {r.name: r.legal or (0, r.mask) for r in chip.MAP.registers}
        return cls(legal["R4"][1], legal["R0" if automatic else "R6"][1], 10 if chip.S_CURVES else 8)


class MainAxisMove(NamedTuple):
    """Requested move of the leader, the longest axis of a line.

    Attributes:
        length: Pulses.
        fh: FH, pps.
        fl: FL, pps.
        up: Time of the ramp up, s.
        down: Time of the ramp down, s.
        share: Fraction of the speed steps in each curved end of the ramps of all axes: 0 for linear ramps, 0.5 for ramps without a
            linear part.
        automatic: Whether the chips find the ramp-down point.
        multiplier: The only possible R7; 0 for any.
    """

    length: int
    fh: float
    fl: float
    up: float
    down: float
    share: float = 0.0
    automatic: bool = False
    multiplier: int = 0


LEADER_MULTIPLIER = -1
"""Value of `FollowerMove.multiplier` that stands for the R7 of the leader, which the search chooses."""


class FollowerMove(NamedTuple):
    """Requested move of a follower, an axis of a line other than the longest one.

    Attributes:
        pulses: Pulses, unsigned.
        clock_hz: Reference clock of its chip, Hz.
        widths: Ranges of its registers.
        lead: Seconds by which it is started before the leader.
        multiplier: The only possible R7, or LEADER_MULTIPLIER; 0 for any.
    """

    pulses: int
    clock_hz: int
    widths: RegisterRanges
    lead: float
    multiplier: int = 0


class Candidates(NamedTuple):
    """Best rows of registers for a follower, and a score for each: about its largest distance from the line in the follower's
    pulses."""

    registers: np.ndarray
    scores: np.ndarray


def search_registers(
    move: MainAxisMove, clock_hz: int, ranges: RegisterRanges, followers: Mapping[str, FollowerMove]
) -> tuple[np.ndarray, dict[str, Candidates]]:
    """Choose rows of registers (see follower_register_search.py) for the leader and its followers.

    The search ends at the first rows that are as close to the line as possible; otherwise it returns the best of all.

    Args:
        move: Move of the longest axis.
        clock_hz: Reference clock of the leader's chip, Hz.
        ranges: Ranges of its registers.
        followers: Moves of the other axes by name.

    Returns:
        Row of the leader, and the best rows of each follower.

    Raises:
        ArgumentError: No registers make the ramps.
    """
    best: tuple[np.ndarray, dict[str, Candidates]] | None = None
    least, work = np.inf, np.zeros(1, follower_register_search.WORK_DTYPE)
    for bare in _list_leaders(move, clock_hz, ranges, followers):
        rises: dict[str, np.ndarray] = {}
        for leader in _vary_tail_lengths(bare, clock_hz, ranges.point):
            candidates = {}
            for name, (d, own_hz, (rate, point, size), lead, multiplier) in followers.items():
                only = int(leader[7]) if multiplier == LEADER_MULTIPLIER else multiplier
                if name not in rises:
                    rises[name] = np.zeros((follower_register_search.MAX_CANDIDATES, size), np.int64)
                    scores = np.empty(follower_register_search.MAX_CANDIDATES)
                    follower_register_search.fit_accelerations(
                        leader, clock_hz, d, own_hz, lead, move.share, rate, only, scores, rises[name], work
                    )
                candidates[name] = Candidates(
                    np.zeros((follower_register_search.MAX_BEST_ROWS, size), np.int64),
                    np.empty(follower_register_search.MAX_BEST_ROWS),
                )
                follower_register_search.fit_decelerations(
                    leader, clock_hz, own_hz, lead, move.automatic, rate, point, rises[name],
                    candidates[name].scores, candidates[name].registers, work,
                )  # fmt: skip
            worst = max((k.scores[0] for k in candidates.values()), default=0.0)
            if worst < least:
                least, best = worst, (leader, candidates)
            if worst <= SUFFICIENT_SCORE:
                return leader, candidates
            if worst > MAX_SCORE_FOR_TAIL_VARIATION:
                break
    if best is None:
        raise ArgumentError(f"{move.length} pulses leave no room for ramps of {move.up:.3g} and {move.down:.3g} s.")
    return best


def _list_leaders(
    move: MainAxisMove, clock_hz: int, ranges: RegisterRanges, followers: Mapping[str, FollowerMove]
) -> list[np.ndarray]:
    """List rows of registers for the leader (longest axis) of a line, with R6 = 0, the most promising first.

    R7 and FH may be any that make the rate within 0.2 %. The order depends on how well the followers can make their shares of the
    rate.
    """
    finest = min(MAX_R7, int(clock_hz * MAX_SPEED / (8192 * move.fh) + 1e-9))
    tried, max_shift = (LEADERS_LONG, SHIFTS_LONG) if move.length > LONG_MOVE_PULSES else (LEADERS, SHIFTS)
    grids, shifts = np.arange(max(MIN_R7, finest // 16), finest + 1), np.arange(-max_shift, max_shift + 1)
    if move.multiplier:
        grids = np.array([move.multiplier])
    r7, shift = np.tile(grids, len(shifts)), np.repeat(shifts, len(grids))
    step = clock_hz / (8192.0 * r7)
    high = np.rint(move.fh / step) + shift
    low = np.clip(np.rint(move.fl / step), 1, MAX_SPEED)
    error = np.abs(high * step / move.fh - 1)
    fits = (high >= 1) & (high <= MAX_SPEED)
    if move.up == 0.0:
        low, up, down = high, np.full(len(r7), 2.0), np.full(len(r7), 2.0)
    else:
        gain = compute_equivalent_linear_steps(np.maximum(high - low, 1), move.share)
        up, down = np.rint(move.up * clock_hz / gain), np.rint(move.down * clock_hz / gain)
        fits &= (high > low) & (np.minimum(up, down) >= 2) & (np.maximum(up, down) <= ranges.rate)
        error += np.abs(up * gain / clock_hz / move.up - 1) / 8 + np.abs(down * gain / clock_hz / move.down - 1) / 8
        if not fits.any():
            _refuse_ramp(move, clock_hz, ranges.rate, step, high, low)
    pick = np.flatnonzero(fits & (error <= max(RATE_ERROR, 1.01 * float(error[fits].min()))))
    pick = pick[np.argsort(np.abs(shift[pick]), kind="stable")]
    off = np.zeros(len(pick))
    for d, own_hz, _, _, multiplier in followers.values():
        misfit, share, accepted = np.zeros(len(pick)), d / move.length, EXACT_RATIO_DRIFT_PULSES / d
        least = min(100.0, share * move.fh * 8192 * MAX_R7 / own_hz / 2)
        follower_register_search.compute_rate_misfits(
            high[pick], r7[pick], clock_hz, share, own_hz, least, accepted, multiplier, misfit
        )
        off = np.maximum(off, misfit * d)
    best = pick[np.argsort(np.maximum(off, ACCEPTED_DRIFT_PULSES) + error[pick], kind="stable")]
    unshifted = pick[shift[pick] == 0]
    spread = unshifted[np.linspace(len(unshifted) - 1, 0, tried // 2).astype(int)] if len(unshifted) else unshifted
    zero = np.zeros(len(r7))
    rest = [zero] * (ranges.row - 8)
    table = np.stack([zero + move.length, low, high, high, up, down, zero, r7, *rest], axis=1).astype(np.int64)
    rows = [table[k] for k in dict.fromkeys([*best[: tried // 2], *spread])]
    for row in rows:
        set_s_curve_registers(row, move.share)
    return rows


def compute_equivalent_linear_steps(steps: Any, share: float) -> Any:
    """Return the speed steps of a linear ramp that takes as long as a ramp with curved ends.

    Args:
        steps: Speed steps of the ramp with curved ends.
        share: Fraction of the steps in each curved end.
    """
    if not 0 < share < 0.5:
        return steps
    span = np.maximum(np.rint(share * steps), 1)
    return np.minimum(steps / 2 + span, steps)


def _refuse_ramp(
    move: MainAxisMove, clock_hz: int, max_rate: int, step: np.ndarray, high: np.ndarray, low: np.ndarray
) -> None:
    """Raise ArgumentError for ramps that no R7 can make; the message states the possible range."""
    gain = compute_equivalent_linear_steps((high - low)[high > low], move.share)
    if not len(gain):
        raise ArgumentError(
            f"fl={move.fl:g} and rate={move.fh:g} pps are within one speed step ({step.min():.3g} pps): make them "
            f"equal for constant speed, or move them apart."
        )
    min_seconds, max_seconds = 2 * gain.min() / clock_hz, max_rate * gain.max() / clock_hz
    for name, register, value in (("accel", "R4", move.up), ("decel", "R5", move.down)):
        if not min_seconds <= value <= max_seconds:
            raise ArgumentError(
                f"{name}={value:.4g} s from {move.fl:g} to {move.fh:g} pps would need {register} outside 2 to {max_rate}. "
                f"In reach are {min_seconds:.3g} to {max_seconds:.4g} s."
            )
    raise ArgumentError(
        f"accel={move.up:.4g} s and decel={move.down:.4g} s differ too much: no R7 keeps both R4 and R5 within 2 to {max_rate}."
    )


def _vary_tail_lengths(leader: np.ndarray, clock_hz: int, max_rate: int) -> Iterator[np.ndarray]:
    """Yield the leader's row with several values of R6, because some lengths of its last part at FL suit the followers better."""
    if leader[2] == leader[1]:
        yield leader
        return
    gain = int(leader[2] - leader[1])
    rise, fall = (
        leader[k] * (leader[1] * gain + gain * (gain - 1) / 2) / (8192 * leader[7]) * compute_ramp_stretch(leader)
        for k in (4, 5)
    )
    fl, fh = (leader[k] * clock_hz / (8192 * leader[7]) for k in (1, 2))
    patience = max(TAIL_SECONDS, TAIL_SHARE * leader[0] / fh)
    for tail in TAILS:
        r6 = int(np.ceil(fall)) + tail
        if (tail - TAILS[0]) / fl > patience:
            continue
        if r6 > max_rate:
            raise ArgumentError(
                f"the ramp-down takes {fall:.0f} pulses, and R6 counts to {max_rate}: shorten decel or lower the rate."
            )
        if r6 + (rise if tail > TAILS[0] else 0) <= leader[0]:  # a longer one must leave the ramp-up its pulses
            with_point = leader.copy()
            with_point[6] = r6
            yield with_point
