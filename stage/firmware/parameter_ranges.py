"""The numbers that can be chosen for a chip: registers within their legal ranges, and the other parameters of a program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stage.chips.register_map import RegisterMap
from stage.errors import ArgumentError


class ParameterRanges(NamedTuple):
    """Numbers by name, in order: (least, most). cubed: those of which small values matter most."""

    ranges: dict[str, tuple[int, int]]
    cubed: tuple[str, ...] = ()

    def to_dict(self, row: Sequence[int] | np.ndarray) -> dict[str, int]:
        """Return one row of numbers by name."""
        return {name: int(value) for name, value in zip(self.ranges, row, strict=True)}

    @property
    def low(self) -> list[int]:
        """Smallest value of each number."""
        return [low for low, _ in self.ranges.values()]


def get_register_range(register_map: RegisterMap, name: str) -> tuple[int, int]:
    """Return the range of a register that numbers are chosen from.

    Args:
        map_: Register map of the chip.
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
