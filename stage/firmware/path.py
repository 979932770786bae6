"""How far several axes' pulses stray from the straight line between start and end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stage.compiled import hot


class Deviation(NamedTuple):
    """The largest distance from the line, in pulses; the time (s) at which it occurs, and the counts then."""

    pulses: float
    time: float
    counts: tuple[int, ...]


@hot
def _furthest(axes, times, signs, line, counts, at):
    """Walk pulses in order of time; `axes[k]` made pulse k. Pulses at the same time count as one step of the path."""
    n = len(line)
    length2 = 0.0
    for j in range(n):
        length2 += line[j] * line[j]
    worst = 0.0
    when = 0.0
    for k in range(len(axes)):
        counts[axes[k]] += signs[k]
        if k + 1 < len(axes) and times[k + 1] == times[k]:
            continue
        dot = 0.0
        for j in range(n):
            dot += counts[j] * line[j]
        along = min(max(dot / length2, 0.0), 1.0)
        d2 = 0.0
        for j in range(n):
            e = counts[j] - along * line[j]
            d2 += e * e
        if d2 > worst:
            worst, when = d2, times[k]
            for j in range(n):
                at[j] = counts[j]
    return np.sqrt(worst), when


def path_deviation(pulses: Sequence[tuple[np.ndarray, np.ndarray]], distances: Sequence[int]) -> Deviation:
    """The largest distance of the point (n_1, n_2, ...) of pulse counts from the segment 0 to `distances`.

    pulses: for each axis (times in s, directions +1 or -1). Linear in the pulses but for a sort by time. A perfect pair of
    axes still strays by up to about a pulse: its path is a staircase.
    """
    axes = np.concatenate([np.full(len(t), k) for k, (t, _) in enumerate(pulses)])
    times = np.concatenate([np.asarray(t, float) for t, _ in pulses])
    signs = np.concatenate([np.asarray(s, np.int64) for _, s in pulses])
    order = np.argsort(times, kind="stable")
    at = np.zeros(len(distances))
    worst, when = _furthest(
        axes[order], times[order], signs[order], np.asarray(distances, float), np.zeros(len(distances)), at
    )
    return Deviation(float(worst), float(when), tuple(int(c) for c in at))
