"""Emulated motion-control chips, register for register.

    from stage.chips import PCL240K, PCL240MK, PCL240MS, MCX514, MCX512, MCX501, MCX314AS, MCX304, MCX302, MCX312
    from stage.chips import HCTL1100, STEPDIR

A family consists of a register map (data), a state record and a compiled core; chip.py has what all families share. A family is
loaded when one of its chips is first needed. Chips depend neither on MuJoCo nor on each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stage.chips import contract_check
from stage.chips.chip import Chip, ChipAxis, Snapshot
from stage.chips.registry import Registry
from stage.chips.write_diagnostics import Diagnostic
from stage.errors import ArgumentError, unknown_name_error

if TYPE_CHECKING:
    from stage.chips.hctl1100 import HCTL1100
    from stage.chips.nova import MCX302, MCX304, MCX312, MCX314AS, MCX501, MCX512, MCX514
    from stage.chips.pcl240 import PCL240K, PCL240MK, PCL240MS
    from stage.chips.stepdir import STEPDIR

FAMILIES: dict[str, tuple[str, ...]] = {
    "pcl240": ("PCL240K", "PCL240MK", "PCL240MS"),
    "nova": ("MCX514", "MCX512", "MCX501", "MCX314AS", "MCX304", "MCX302", "MCX312"),
    "hctl1100": ("HCTL1100",),
    "stepdir": ("STEPDIR",),
}
"""The classes of each family, by its package; stages keep the families in this order."""


CHIPS = Registry(FAMILIES, __name__)
"""Every chip by class name, also those of other packages that are installed, see `Registry`."""


def __getattr__(name: str) -> Any:
    if name in CHIPS.built_in:
        return CHIPS[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def chip_class(chip: str | type[Chip]) -> type[Chip]:
    """Return a chip class.

    Args:
        chip: The class itself, or its name in any case, with or without hyphens.

    Raises:
        ArgumentError: The name is unknown (the message has near misses), or the class is no chip.
        LoadError: The chip of another package cannot be imported.
    """
    if not isinstance(chip, str):
        if not (isinstance(chip, type) and issubclass(chip, Chip)):
            raise ArgumentError(f"chip {chip!r}: give a chip class or its name: {', '.join(CHIPS)}.")
        contract_check.check_chip_class(chip, Chip, check_methods=False)
        return chip
    if chip not in CHIPS:
        raise unknown_name_error("chip", chip.upper(), CHIPS)
    CHIPS.warn_of_name_conflict(chip)
    return CHIPS[chip]


__all__ = [
    "CHIPS",
    "HCTL1100",
    "MCX302",
    "MCX304",
    "MCX312",
    "MCX314AS",
    "MCX501",
    "MCX512",
    "MCX514",
    "PCL240K",
    "PCL240MK",
    "PCL240MS",
    "STEPDIR",
    "Chip",
    "ChipAxis",
    "Diagnostic",
    "Snapshot",
    "chip_class",
]
