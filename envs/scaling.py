"""Scaling of numbers to the range of observations and actions, -1 to 1."""

from __future__ import annotations

from typing import Any

from stage.support import portable_math


def scale(values: Any, ends: Any) -> Any:
    """Scale numbers between two ends to -1 to 1.

    Args:
        values: A number or an array.
        ends: Least and largest value.
    """
    low, high = ends
    return (values - low) / max(high - low, 1e-9) * 2.0 - 1.0


def scale_log(values: Any, ends: Any) -> Any:
    """Scale numbers between two ends to -1 to 1 by their logarithm.

    Args:
        values: A number or an array, above 0.
        ends: Least and largest value.
    """
    return scale(portable_math.log(values), portable_math.log(ends))
