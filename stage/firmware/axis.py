"""The part of an axis that firmware needs. The axes of a `Stage` and of a `Bench` have it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from stage.chips import Chip
from stage.errors import ArgumentError


def is_sensor_inverted(axis: object, sensor: str) -> bool:
    """Return whether a sensor is of the other logic than that of the axis' chip after a reset, see `Chip.LOGIC`.

    Args:
        axis: Axis. That of a bench has no wiring, and none of its sensors is inverted.
        sensor: Switch ("org", "el_plus" ...) or index ("ez").

    Returns:
        Whether the sensor is inverted.
    """
    return sensor in getattr(axis, "wiring", {})


def has_positive_logic(axis: object, sensor: str) -> bool:
    """Return whether a sensor is of positive logic, high while it is on, for chips that take what is low as asserted."""
    return is_sensor_inverted(axis, sensor)


class Axis(Protocol):
    """An axis as firmware sees it: a chip on a bus, and time. The rest is the true state of the machine, for reports only."""

    @property
    def name(self) -> str:
        """Name on the machine."""

    @property
    def chip(self) -> Chip:
        """Chip that drives the axis."""

    @property
    def chip_axis(self) -> int:
        """Number of the axis on its chip."""

    @property
    def meters_per_pulse(self) -> float | None:
        """Metres per pulse (rad on a hinge); None without a carriage."""

    @property
    def time(self) -> float:
        """Simulated seconds."""

    def wait(self, seconds: float) -> None:
        """Let `seconds` of simulated time pass, for all axes of the machine."""

    @property
    def position(self) -> float | None:
        """Position of the carriage, m (rad on a hinge); None without one."""

    @property
    def commanded(self) -> float | None:
        """Position of the carriage according to the pulses, m (rad on a hinge); None without one."""

    @property
    def lost_steps(self) -> int | None:
        """Full steps lost; None without a motor."""


def check_origin(axis: Axis, others: Sequence[str] = ()) -> None:
    """Check that an origin return would end.

    Args:
        axis: Axis to check.
        others: Ways to home without an origin switch, for the message.

    Raises:
        ArgumentError: The chip has an input for the origin switch, and the axis has no such switch.
    """
    switches = getattr(axis, "switches", None)
    if switches is not None and axis.chip.wired("org") and "org" not in switches.as_dict():
        instead = f" Home by {' or '.join(others)}." if others else ""
        raise ArgumentError(
            f"axis {axis.name} has no origin switch, so its run would not end: give the model {axis.name}_org "
            f"(docs/models.md), or leave the axis out.{instead}"
        )


def check_direction(direction: int, meaning: str = "") -> None:
    """Raise ArgumentError for a direction that is neither 1 nor -1. `method` says what it is the direction of."""
    if direction not in (1, -1):
        raise ArgumentError(f"direction={direction!r}: +1 or -1{meaning}.")


def check_seconds(seconds: float) -> None:
    """Raise ArgumentError for a time that is not within 0 to 1e9 s."""
    if not 0 <= seconds < 1e9:
        raise ArgumentError(f"seconds={seconds!r}: time runs forward, by 0 to 1e9 s.")


class HasAxes(Protocol):
    """A machine: a Stage, a Bench."""

    @property
    def axes(self) -> Mapping[str, Axis]:
        """Axes by name."""


AxesByName = HasAxes | Mapping[str, Axis] | None
"""Where axes are found by name."""


def get_forward_direction(axis: Axis) -> int:
    """Return the direction of the pulses that move the carriage plus: -1 where the motor turns the other way round."""
    return -1 if getattr(axis, "gear", 1.0) < 0 else 1
