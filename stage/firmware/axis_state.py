"""`AxisState`: what an axis does at one moment, without bus cycles, for any thread: motion, counter, switches and true position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stage.firmware.axis import Axis, get_forward_direction
from stage.firmware.axis_actions import find_action
from stage.firmware.driver import get_driver


@dataclass(frozen=True)
class AxisState:
    """State of an axis at one moment.

    Attributes:
        axis: Name of the axis.
        time: Simulated time, s.
        action: Name of the action under way: "move", "home", "jog" or "stop"; "" if there is none.
        is_moving: Whether an action is under way or the chip changes the commanded position; the same for every family. A
            carriage that still settles is not moving.
        speed: Commanded speed of the carriage, m/s (rad/s), negative towards minus; None without a carriage.
        pulses: Net pulses since power-up; of a servo, counts of the command position.
        counter: Value of the controller's own position counter; None if the chip has none.
        position: True position of the carriage, m (rad on a hinge); None without a carriage.
        commanded: Position according to the pulses, m (rad on a hinge); None without a carriage.
        lost_steps: Full steps lost; None without a motor.
        switches: Level of every switch fitted, by its pin.
        missing_current: Why the motor has no current, for example "ENABLE is not asserted"; "" if it has.
    """

    axis: str
    time: float
    action: str
    is_moving: bool
    speed: float | None
    pulses: int
    counter: int | None
    position: float | None
    commanded: float | None
    lost_steps: int | None
    switches: Mapping[str, bool]
    missing_current: str


def read_axis_state(axis: Axis) -> AxisState:
    """Read what an axis does now. No bus cycle is made, no time passes, and any thread may call this function.

    While another thread lets time pass, the state is that of a moment between two runs of compiled code.

    Args:
        axis: Axis of a Stage or a Bench.

    Raises:
        ArgumentError: `axis` is no axis, or the family of its chip has no driver.
    """
    loop = getattr(getattr(axis, "stage", None), "loop", None)
    return _read_state(axis) if loop is None else loop.read_between_runs(lambda: _read_state(axis))


def _read_state(axis: Any) -> AxisState:
    """Read the state at a moment at which no compiled code runs."""
    driver, action, switches = get_driver(axis), find_action(axis), getattr(axis, "switches", None)
    unit = axis.meters_per_pulse
    return AxisState(
        axis.name, axis.time, "" if action is None else action.name, action is not None or driver.is_moving,
        None if unit is None else get_forward_direction(axis) * driver.commanded_rate * unit,
        axis.chip.net(axis.chip_axis), driver.peek_position_counter(), axis.position, axis.commanded, axis.lost_steps,
        {} if switches is None else switches.as_dict(), axis.chip.explain_missing_current(axis.chip_axis),
    )  # fmt: skip
