"""What `reset(options=...)` gives in place of what would be drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stage.errors import ArgumentError


def given(
    options: Mapping[str, Any], name: str, drawn: float, ends: tuple[float, float]
) -> float | np.integer | np.floating:
    """A number of the options, by default what was drawn: from one end to the other, and whole where what is drawn is.

    Raises ArgumentError."""
    value, whole = options.get(name, drawn), isinstance(drawn, int)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float | np.integer | np.floating)
        or not ends[0] <= value <= ends[1]
        or (whole and value != int(value))
    ):
        raise ArgumentError(f"option {name}={value!r}: {'a whole number ' * whole}from {ends[0]} to {ends[1]}.")
    return value
