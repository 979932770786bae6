"""Elementary functions whose bits do not depend on the processor: `log`, `log1p`, `exp`, `cbrt`, `power` of numbers and arrays.

NumPy has several implementations of these functions, and uses the fastest one for the processor. Those for AVX-512 round the last
place differently, so an entry of the benchmark would not have the same bits on all processors. The functions of this module call
the C library instead. Its results are the same on all processors with fused multiplication: every x86-64 of the last ten years.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np


def _make_elementwise(function: Callable[[float], float]) -> Callable[[Any], Any]:
    """Return a function that applies `function` to a number, or to each element of an array."""

    def call(x: Any) -> Any:
        values = np.asarray(x, np.float64)
        return np.array([function(v) for v in values.ravel().tolist()], np.float64).reshape(values.shape)[()]

    return call


def _log(v: float) -> float:
    """Return the natural logarithm of a number; -inf for 0 and NaN for negative numbers, as NumPy does."""
    if v > 0:
        return math.log(v)
    return -math.inf if v == 0 else math.nan


def _log1p(v: float) -> float:
    """Return the natural logarithm of 1 + v; -inf and NaN where NumPy returns these."""
    if v > -1:
        return math.log1p(v)
    return -math.inf if v == -1 else math.nan


def _exp(v: float) -> float:
    """Return e to the power of v; infinity instead of an overflow error."""
    try:
        return math.exp(v)
    except OverflowError:
        return math.inf


log, log1p, exp, cbrt = (
    _make_elementwise(_log),
    _make_elementwise(_log1p),
    _make_elementwise(_exp),
    _make_elementwise(math.cbrt),
)


def power(x: Any, exponent: Any) -> Any:
    """Compute x ** exponent for x of at least 0."""
    base, exponents = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(exponent, np.float64))
    pairs = zip(base.ravel().tolist(), exponents.ravel().tolist(), strict=True)
    return np.array([math.pow(v, e) for v, e in pairs], np.float64).reshape(base.shape)[()]


def geomspace(first: float, last: float, count: int) -> np.ndarray:
    """Return `count` numbers from `first` to `last`, evenly spaced on a logarithmic scale, as numpy.geomspace does."""
    values = power(10.0, np.linspace(math.log10(first), math.log10(last), count))
    values[0], values[-1] = first, last
    return values
