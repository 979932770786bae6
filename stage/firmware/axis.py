"""`Axis`: the interface of an axis for firmware. The axes of a `Stage` and of a `Bench` implement it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from stage.chips import Chip
from stage.errors import ArgumentError


def is_sensor_inverted(axis: object, sensor: str) -> bool:
    """Return whether the logic of a sensor is opposite to the logic of the chip after a reset, see `Chip.LOGIC`.

    Args:
        axis: Axis of a stage or a bench. A bench has no wiring, so none of its sensors is inverted.
        sensor: Switch ("org", "el_plus" ...) or index ("ez").

    Returns:
        Whether the sensor is inverted.
    """
    return sensor in getattr(axis, "wiring", {})


def has_positive_logic(axis: object, sensor: str) -> bool:
    """Return whether a sensor has positive logic (its signal is high while it is on), for chips with active-low inputs."""
    return is_sensor_inverted(axis, sensor)


class Axis(Protocol):
    """Interface of an axis for firmware: a chip on a bus, and time.

    The properties `position`, `commanded` and `lost_steps` are the true state of the machine, which a host cannot see. Only
    reports use them.
    """

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
        """Meters per pulse (rad on a hinge); None without a carriage."""

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
        """Position of the carriage according to the pulses, m (rad on a hinge); None without a carriage."""

    @property
    def lost_steps(self) -> int | None:
        """Full steps lost; None without a motor."""


def check_origin(axis: Axis, others: Sequence[str] = ()) -> None:
    """Check that the axis has an origin switch if its chip has an input for one, so that an origin return can end.

    Args:
        axis: Axis to check.
        others: Homing methods without an origin switch, for the message.

    Raises:
        ArgumentError: The chip has an input for the origin switch, and the axis has no such switch.
    """
    switches = getattr(axis, "switches", None)
    if switches is not None and axis.chip.find_switch_input("org") and "org" not in switches.as_dict():
        instead = f" Home by {' or '.join(others)}." if others else ""
        raise ArgumentError(
            f"axis {axis.name} has no origin switch, so its run would not end: give the model {axis.name}_org "
            f"(docs/models.md), or leave the axis out.{instead}"
        )


def check_direction(direction: int, meaning: str = "") -> None:
    """Raise ArgumentError for a direction that is neither 1 nor -1. `meaning` completes the message."""
    if direction not in (1, -1):
        raise ArgumentError(f"direction={direction!r}: +1 or -1{meaning}.")


def check_seconds(seconds: float) -> None:
    """Raise ArgumentError for a time that is not within 0 to 1e9 s."""
    if not 0 <= seconds < 1e9:
        raise ArgumentError(f"seconds={seconds!r}: time runs forward, by 0 to 1e9 s.")


class HasAxes(Protocol):
    """Machine with axes by name: a Stage or a Bench."""

    @property
    def axes(self) -> Mapping[str, Axis]:
        """Axes by name."""


AxesByName = HasAxes | Mapping[str, Axis] | None
"""Stage, bench or mapping in which a procedure finds axes by their names; None if the caller passes the axes themselves."""


def get_forward_direction(axis: Axis) -> int:
    """Return the direction of the pulses that move the carriage towards plus: -1 if the motor turns the opposite way."""
    return -1 if getattr(axis, "gear", 1.0) < 0 else 1
