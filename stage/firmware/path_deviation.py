"""Deviation of the pulses of several axes from the straight line between start and end.

    compute_path_deviation([x.trace(n), y.trace(n)], (20_000, -7_500))

The path consists of the points (n_1, n_2, ...) of pulse counts. It moves in whole pulses, so even perfect axes stray: with rates
exactly in ratio and a common start, the first pulse of the slower axis comes a whole pulse late (`compute_staircase_deviation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from stage.chips.journal import Journal
from stage.errors import ArgumentError
from stage.native import array_of, exported, hot

REPLAY_CHUNK_TICKS = 1 << 24  # ticks replayed at a time
ROUNDING_TOLERANCE = 1e-12  # relative, and pulses squared: rounding


class PathDeviation(NamedTuple):
    """Largest distance of a path of axes from the straight line, in pulses.

    Attributes:
        pulses: The distance, pulses.
        time: Time of the distance, in the unit of the times that the caller passed.
        counts: Pulse counts of the axes at that time.
    """

    pulses: float
    time: float
    counts: tuple[int, ...]


@hot
def _find_next_pulse_time(times, ends, cursor):
    """Return the time of the next pulse of any axis of the path; infinity if there is none."""
    t = np.inf
    for k in range(len(cursor)):
        if cursor[k] < ends[k] and times[cursor[k]] < t:
            t = times[cursor[k]]
    return t


@exported("f8", *[array_of(t) for t in ("f8", "i1", "i8", "i8", "f8", "f8", "i8", "f8")])
def _find_worst_deviation(times, signs, starts, ends, line, counts, cursor, worst_time):
    """Return the largest distance of the pulse counts from the line, and write its time to when[0].

    The pulses of axis k are times[starts[k]:ends[k]]. Pulses at the same time count as one step. `counts` (zeros) and `cursor` (a
    copy of `starts`) are work arrays.
    """
    n = len(line)
    length2 = 0.0
    for k in range(n):
        length2 += line[k] * line[k]
    worst = worst_time[0] = 0.0
    while True:
        t = _find_next_pulse_time(times, ends, cursor)
        if t == np.inf:
            break
        dot = 0.0
        for k in range(n):
            while cursor[k] < ends[k] and times[cursor[k]] == t:
                counts[k] += signs[cursor[k]]
                cursor[k] += 1
            dot += counts[k] * line[k]
        along = min(max(dot / length2, 0.0), 1.0) if length2 else 0.0
        d2 = 0.0
        for k in range(n):
            d2 += (counts[k] - along * line[k]) ** 2
        if d2 > worst + ROUNDING_TOLERANCE * (1.0 + worst):
            worst, worst_time[0] = d2, t
    return np.sqrt(worst)


def _pack_pulses(pulses: Sequence[Any], distances: Sequence[int], clock_hz: Any) -> tuple[np.ndarray, ...]:
    """Return the arguments of `_find_worst_deviation` for these pulses. Raises ArgumentError as `compute_path_deviation`."""
    if len(pulses) != len(distances) or not len(pulses):
        raise ArgumentError(f"{len(pulses)} axes of pulses and {len(distances)} distances: give one distance an axis.")
    hz = [clock_hz] * len(pulses) if clock_hz is None or np.isscalar(clock_hz) else list(clock_hz)
    times, signs = [], []
    for item, rate in zip(pulses, hz, strict=True):
        trace = isinstance(item, np.ndarray) and item.dtype.names
        t, s = (item["clock"], item["direction"]) if trace else item
        t = np.asarray(t, np.float64)
        s = np.broadcast_to(np.asarray(s, np.int8), t.shape)
        if len(t) > 1 and (np.diff(t) < 0).any():
            raise ArgumentError("an axis' pulses are out of order: give each axis' times from first to last.")
        times.append(t if rate is None else t / rate)
        signs.append(s)
    ends = np.cumsum([len(t) for t in times])
    starts = ends - [len(t) for t in times]
    return np.concatenate(times), np.concatenate(signs), starts, ends, np.asarray(distances, np.float64)


def compute_path_deviation(pulses: Sequence[Any], distances: Sequence[int], clock_hz: Any = None) -> PathDeviation:
    """Compute the largest distance of the point of pulse counts from the segment between 0 and `distances`, exact at every pulse.

    The computing time is linear in the number of pulses. Pulses at the same time count as one step.

    Args:
        pulses: For each axis the result of `chip.trace`, or (times, directions +1 or -1); times ascend.
        distances: Signed pulses of the line for each axis.
        clock_hz: Clock that converts ticks to seconds, one number or one for each axis, Hz; None keeps the times as they are.

    Returns:
        The largest distance, its time and the counts at that time.

    Raises:
        ArgumentError: Times do not ascend, or the number of axes differs from the number of distances.
    """
    times, signs, starts, ends, line = _pack_pulses(pulses, distances, clock_hz)
    worst_time = np.zeros(1)
    worst = _find_worst_deviation(times, signs, starts, ends, line, np.zeros(len(line)), starts.copy(), worst_time)
    when = worst_time[0]
    counts_made = (np.searchsorted(times[a:b], when, side="right") for a, b in zip(starts, ends, strict=True))
    counts = tuple(int(signs[a : a + k].sum(dtype=np.int64)) for a, k in zip(starts, counts_made, strict=True))
    if worst == 0.0:
        counts = (0,) * len(counts)
    return PathDeviation(float(worst), float(when), counts)


def compute_path_points(pulses: Sequence[Any], clock_hz: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of the path: the counts (n_1, n_2, ...) at the origin and after every step.

    Args:
        pulses: Pulses of the axes, as for `compute_path_deviation`.
        clock_hz: Clock of the times, as for `compute_path_deviation`.

    Returns:
        Times (n,) and counts (n, axes).
    """
    times, signs, starts, ends, _ = _pack_pulses(pulses, [1] * len(pulses), clock_hz)
    order = np.argsort(times, kind="stable")
    steps = np.zeros((len(times), len(starts)), np.int64)
    for k, (a, b) in enumerate(zip(starts, ends, strict=True)):
        steps[a:b, k] = signs[a:b]
    at = np.cumsum(steps[order], axis=0)
    last = np.append(np.diff(times[order]) > 0, True)[: len(times)]
    origin = np.zeros((1, len(starts)), np.int64)
    return np.append(0.0, times[order][last]), np.concatenate([origin, at[last]])


def compute_staircase_deviation(distances: Sequence[int]) -> float:
    """Compute the deviation of perfect axes, which start at the same time and have constant rates exactly in ratio, pulses."""
    perfect = [(np.arange(1, abs(d) + 1) / max(abs(d), 1), np.sign(d)) for d in distances]
    return compute_path_deviation(perfect, distances).pulses


def replay_pulses(journal: Journal) -> np.ndarray:
    """Replay the pulses that a chip made while a journal was open; for a servo, each count of its command.

    Args:
        journal: Journal of the chip.

    Returns:
        Records like those of `chip.trace`; `clock` counts from the beginning of the journal.
    """
    core = journal.chip.CORE
    if journal.chip.SERVO:
        return _list_command_counts(journal)
    rows = np.frombuffer(bytearray(journal.start_state.tobytes()), core.STATE)
    clock = rows["clock"]
    begin = int(clock[0])
    parts = [np.empty(0, core.PULSE)]

    def replay_until(until: int) -> None:
        while clock[0] < until:
            to = min(until, int(clock[0]) + REPLAY_CHUNK_TICKS)
            out = np.zeros(core.advance(rows.copy(), to), core.PULSE)
            core.trace_pulses.c(rows.ctypes.data, to, out.ctypes.data, len(out))
            parts.append(out)

    for e in journal.entries:
        replay_until(e.clock)
        e.apply(core, rows)
    replay_until(journal.end_clock)
    pulses = np.concatenate(parts)
    pulses["clock"] -= begin
    return pulses


def _list_command_counts(journal: Journal) -> np.ndarray:
    """Return a record for each count by which a servo's command position moved, like the pulses of other chips."""
    edges = journal.replay_waveforms().edges
    steps = np.diff(edges["net"])
    at = np.repeat(np.arange(1, len(edges)), np.abs(steps))
    counts = np.zeros(len(at), journal.chip.CORE.PULSE)
    counts["clock"] = edges["clock"][at] - edges["clock"][0]
    counts["axis"], counts["direction"] = journal.axis, np.sign(steps[at - 1])
    return counts
