"""Replacements for Python's min, max and floor in compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.native.hot_functions import hot


@hot
def floor(x: Any) -> Any:
    """Return the whole number at or below x, as a float: numba's math.floor makes an integer first, and no vector instruction."""
    return float(np.floor(x))


@hot
def least(a: Any, b: Any) -> Any:
    """Return the lesser of two values: numba types its own min again, and slowly, for every kind of argument."""
    return b if b < a else a


@hot
def greatest(a: Any, b: Any) -> Any:
    """Return the greater of two values, see `least`."""
    return b if b > a else a
