"""Emulated motion-control chips, register for register. They know neither MuJoCo nor each other.

    from stage.chips import PCL240K, PCL240MK, PCL240MS, MCX514, MCX304, MCX302, MCX312, HCTL1100

A family is a register map (data), a state record and a compiled core; see chip.py for what they share.
"""

from stage.chips.chip import Chip, ChipAxis, Diagnostic, Snapshot
from stage.chips.hctl1100 import HCTL1100
from stage.chips.nova import MCX302, MCX304, MCX312, MCX514
from stage.chips.pcl240 import PCL240K, PCL240MK, PCL240MS
from stage.errors import ArgumentError, unknown

CHIPS: dict[str, type[Chip]] = {
    cls.__name__: cls for cls in (PCL240K, PCL240MK, PCL240MS, MCX514, MCX304, MCX302, MCX312, HCTL1100)
}
"""Every chip by class name."""


def chip_class(chip: str | type[Chip]) -> type[Chip]:
    """A chip class, by itself or by its name in any case, with or without hyphens. Raises ArgumentError with near misses."""
    if isinstance(chip, str):
        if (key := chip.upper().replace("-", "")) not in CHIPS:
            raise unknown("chip", chip, CHIPS)
        return CHIPS[key]
    if not (isinstance(chip, type) and issubclass(chip, Chip)):
        raise ArgumentError(f"chip {chip!r}: give a chip class or its name: {', '.join(CHIPS)}.")
    return chip


__all__ = [
    "CHIPS",
    "HCTL1100",
    "MCX302",
    "MCX304",
    "MCX312",
    "MCX514",
    "PCL240K",
    "PCL240MK",
    "PCL240MS",
    "Chip",
    "ChipAxis",
    "Diagnostic",
    "Snapshot",
    "chip_class",
]
