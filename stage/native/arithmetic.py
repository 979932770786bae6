"""Replacements for Python's min, max and floor in compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.native.hot_functions import hot


@hot
def floor(x: Any) -> Any:
    """Return the largest whole number that is not above x, as a float.

    numba's math.floor converts to an integer first, and does not use a vector instruction.
    """
    return float(np.floor(x))


@hot
def least(a: Any, b: Any) -> Any:
    """Return the lesser of two values. numba's own min takes longer to compile, because each kind of argument is typed anew."""
    return b if b < a else a


@hot
def greatest(a: Any, b: Any) -> Any:
    """Return the greater of two values. numba's own max takes longer to compile, because each kind of argument is typed anew."""
    return b if b > a else a
