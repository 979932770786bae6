"""What hot functions use in place of Python's own min and max."""

from __future__ import annotations

from typing import Any

from stage.native.functions import hot


@hot
def least(a: Any, b: Any) -> Any:
    """min(a, b): numba types its own anew, and slowly, for every kind of argument."""
    return b if b < a else a


@hot
def greatest(a: Any, b: Any) -> Any:
    """max(a, b), see `least`."""
    return b if b > a else a
