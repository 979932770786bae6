"""What firmware needs of an axis. A `Stage`'s axes are such, and so are those of a `Bench`."""

from __future__ import annotations

from typing import Any, Protocol

from stage.chips import Chip
from stage.chips.pcl240 import PCL240
from stage.errors import ArgumentError


class Axis(Protocol):
    """An axis as firmware sees it: a chip on a bus, and time. The rest is truth, for reports only."""

    @property
    def name(self) -> str:
        """Its name on the machine."""

    @property
    def chip(self) -> Chip:
        """Its chip."""

    @property
    def chip_axis(self) -> int:
        """Which axis of the chip it is."""

    @property
    def meters_per_pulse(self) -> float | None:
        """Metres per pulse (rad on a hinge); None without a carriage."""

    @property
    def time(self) -> float:
        """Simulated seconds."""

    def wait(self, seconds: float) -> None:
        """Let simulated time pass, for all axes of the machine."""

    @property
    def position(self) -> float | None:
        """Where the carriage is, m; None without one."""

    @property
    def commanded(self) -> float | None:
        """Where the pulses say that the carriage is, m; None without one."""

    @property
    def lost_steps(self) -> int | None:
        """Full steps lost; None without a motor."""


def check(axis: Any) -> type[PCL240]:
    """The class of the axis' chip; ArgumentError if `axis` is none, or its chip does not speak the language of the PCL-240
    family."""
    chip = getattr(axis, "chip", None)
    if not isinstance(chip, Chip):
        raise ArgumentError(f"{axis!r} is no axis: give stage.axes['x'], or Bench(x=PCL240K()).axes['x'].")
    if not isinstance(chip, PCL240):
        raise ArgumentError(
            f"axis {axis.name} has an {chip.MAP.chip}; these procedures speak to the PCL-240 family, stage.firmware.nova and "
            "stage.firmware.hctl1100 to others."
        )
    return type(chip)
