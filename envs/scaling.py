"""Scaling of numbers to the range of observations and actions, -1 to 1."""

from __future__ import annotations

from typing import Any

from stage.support import portable_math


def scale_linear(values: Any, ends: Any) -> Any:
    """Scale numbers linearly so that the ends of a range become -1 and 1.

    Args:
        values: Number or array.
        ends: Smallest and largest value of the range.
    """
    low, high = ends
    return (values - low) / max(high - low, 1e-9) * 2.0 - 1.0


def scale_log(values: Any, ends: Any) -> Any:
    """Scale the logarithms of numbers so that the ends of a range become -1 and 1.

    Args:
        values: Number or array, above 0.
        ends: Smallest and largest value of the range.
    """
    return scale_linear(portable_math.log(values), portable_math.log(ends))
