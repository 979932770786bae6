"""What hot functions use in place of Python's own min, max and floor."""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.native.functions import hot


@hot
def floor(x: Any) -> Any:
    """The whole number at or below x, as a float: math.floor of numba goes by way of an integer, and no vector does."""
    return float(np.floor(x))


@hot
def least(a: Any, b: Any) -> Any:
    """min(a, b): numba types its own anew, and slowly, for every kind of argument."""
    return b if b < a else a


@hot
def greatest(a: Any, b: Any) -> Any:
    """max(a, b), see `least`."""
    return b if b > a else a
