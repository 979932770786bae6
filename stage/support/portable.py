"""Logarithms and the like whose bits do not depend on the processor: `log`, `log1p`, `exp`, `cbrt`, `power` of numbers and arrays.

NumPy has several forms of these and takes the fastest that the processor has. Those for AVX-512 round other than those without, in
the last place, and an entry of the bench is then no longer equal bit for bit. The C library's, which these are, have one form for
every processor with fused multiplication, which all x86-64 of the last ten years have.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np


def _each(function: Callable[[float], float]) -> Callable[[Any], Any]:
    def call(x: Any) -> Any:
        values = np.asarray(x, np.float64)
        return np.array([function(v) for v in values.ravel().tolist()], np.float64).reshape(values.shape)[()]

    return call


def _log(v: float) -> float:
    if v > 0:
        return math.log(v)
    return -math.inf if v == 0 else math.nan


def _log1p(v: float) -> float:
    if v > -1:
        return math.log1p(v)
    return -math.inf if v == -1 else math.nan


def _exp(v: float) -> float:
    try:
        return math.exp(v)
    except OverflowError:
        return math.inf


log, log1p, exp, cbrt = _each(_log), _each(_log1p), _each(_exp), _each(math.cbrt)


def power(x: Any, exponent: Any) -> Any:
    """Return x ** exponent, for numbers from 0 up."""
    base, exponents = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(exponent, np.float64))
    pairs = zip(base.ravel().tolist(), exponents.ravel().tolist(), strict=True)
    return np.array([math.pow(v, e) for v, e in pairs], np.float64).reshape(base.shape)[()]


def geomspace(first: float, last: float, n: int) -> np.ndarray:
    """Return `n` numbers from `first` to `last`, evenly spaced on a logarithmic scale, as numpy.geomspace does."""
    values = power(10.0, np.linspace(math.log10(first), math.log10(last), n))
    values[0], values[-1] = first, last
    return values
