"""Fewer points for the same line: what a plot needs of a series."""

from __future__ import annotations

import numpy as np

from stage.native import array_of, exported


@exported(None, array_of("f8"), array_of("f8"), "f8", array_of("?"))
def mark_needed_samples(t, v, tolerance, keep):
    """Mark in `keep` (bool) samples such that straight lines between them pass within `tolerance` of every other.

    First and last are always kept, and so is everything when nothing is straight. One pass: a cone of slopes from the
    last kept sample, narrowed by each sample that it must pass.
    """
    n = len(t)
    if n == 0:
        return
    keep[:] = False
    keep[0] = keep[n - 1] = True
    a = 0
    low, high = -np.inf, np.inf
    for k in range(1, n):
        d = t[k] - t[a]
        slope = (v[k] - v[a]) / d
        if not low <= slope <= high:
            a = k - 1
            keep[a] = True
            d = t[k] - t[a]
            low, high = -np.inf, np.inf
        low = max(low, (v[k] - tolerance - v[a]) / d)
        high = min(high, (v[k] + tolerance - v[a]) / d)
