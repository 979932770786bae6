"""Emulated motion-control chips, register for register. They know neither MuJoCo nor each other.

    from stage.chips import PCL240K, PCL240MK, PCL240MS, MCX514, MCX304, MCX302, MCX312, HCTL1100

A family is a register map (data), a state record and a compiled core; see chip.py for what they share. It is loaded when one of its
chips is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from stage.chips.chip import Chip, ChipAxis, Diagnostic, Snapshot
from stage.errors import ArgumentError, unknown

if TYPE_CHECKING:
    from stage.chips.hctl1100 import HCTL1100
    from stage.chips.nova import MCX302, MCX304, MCX312, MCX514
    from stage.chips.pcl240 import PCL240K, PCL240MK, PCL240MS

FAMILIES: dict[str, tuple[str, ...]] = {
    "pcl240": ("PCL240K", "PCL240MK", "PCL240MS"),
    "nova": ("MCX514", "MCX304", "MCX302", "MCX312"),
    "hctl1100": ("HCTL1100",),
}
"""The classes of each family, by its package; stages keep the families in this order."""


class _Chips(MutableMapping[str, type[Chip]]):
    """Chip classes by name; of those not loaded yet, the package."""

    def __init__(self, families: dict[str, tuple[str, ...]]):
        self._found: dict[str, Any] = {name: family for family, names in families.items() for name in names}

    def __getitem__(self, name: str) -> type[Chip]:
        found = self._found[name]
        if isinstance(found, str):
            found = self._found[name] = getattr(import_module(f"{__name__}.{found}"), name)
        return found

    def __contains__(self, name: object) -> bool:
        return name in self._found

    def __setitem__(self, name: str, chip: type[Chip]) -> None:
        self._found[name] = chip

    def __delitem__(self, name: str) -> None:
        del self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


CHIPS: MutableMapping[str, type[Chip]] = _Chips(FAMILIES)
"""Every chip by class name."""


def __getattr__(name: str) -> Any:
    if name in CHIPS:
        return CHIPS[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def chip_class(chip: str | type[Chip]) -> type[Chip]:
    """A chip class, by itself or by its name in any case, with or without hyphens. Raises ArgumentError with near misses."""
    if isinstance(chip, str):
        if (key := chip.upper().replace("-", "")) not in CHIPS:
            raise unknown("chip", key, CHIPS)
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
