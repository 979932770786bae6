"""Ranges of the numbers that a user or an agent chooses for a chip: registers, and other parameters of a program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stage.chips.register_map import RegisterMap
from stage.errors import ArgumentError


class ParameterRanges(NamedTuple):
    """Ranges of the numbers in a row of registers or of other parameters, by name.

    Attributes:
        ranges: Smallest and largest value of each number, in the order of the row.
        cubed: Numbers whose small values matter most; environments scale their actions by the third power.
    """

    ranges: dict[str, tuple[int, int]]
    cubed: tuple[str, ...] = ()

    def to_dict(self, row: Sequence[int] | np.ndarray) -> dict[str, int]:
        """Convert a row of numbers to a dict by name."""
        return {name: int(value) for name, value in zip(self.ranges, row, strict=True)}

    @property
    def low(self) -> list[int]:
        """Smallest value of each number."""
        return [low for low, _ in self.ranges.values()]


def get_register_range(register_map: RegisterMap, name: str) -> tuple[int, int]:
    """Return the range of values that a register accepts.

    Args:
        register_map: Register map of the chip.
        name: Name of the register.

    Returns:
        Smallest and largest value.

    Raises:
        ArgumentError: The register has no such range.
    """
    r = register_map.register(name)
    if not (least_and_most := r.tuned or r.legal):
        raise ArgumentError(f"{register_map.chip} {name} has no legal range to choose from.")
    return least_and_most
