"""Thinning of a plotted line: mark the samples that the line needs."""

from __future__ import annotations

import numpy as np

from stage.native import array_of, exported


@exported(None, array_of("f8"), array_of("f8"), "f8", array_of("?"))
def mark_needed_samples(time, value, tolerance, keep):
    """Mark samples such that straight lines between them pass within `tolerance` of all other samples.

    The first and the last sample are always marked. The function works in one pass: it keeps a cone of slopes from the last marked
    sample, and each further sample that the line must pass narrows the cone.

    Args:
        time: Times of the samples.
        value: Values of the samples.
        tolerance: Largest distance of a sample from the line, in the unit of the values.
        keep: Booleans, filled: whether the sample is needed.
    """
    n = len(time)
    if n == 0:
        return
    keep[:] = False
    keep[0] = keep[n - 1] = True
    a = 0
    low, high = -np.inf, np.inf
    for k in range(1, n):
        d = time[k] - time[a]
        slope = (value[k] - value[a]) / d
        if not low <= slope <= high:
            a = k - 1
            keep[a] = True
            d = time[k] - time[a]
            low, high = -np.inf, np.inf
        low = max(low, (value[k] - tolerance - value[a]) / d)
        high = min(high, (value[k] + tolerance - value[a]) / d)
