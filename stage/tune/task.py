"""The tuning task: the axis, the distance, the maximum payload, and the condition under which a move has arrived."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np

from stage import Stage
from stage.errors import ArgumentError, unknown_name_error
from stage.firmware.driver import get_driver
from stage.sim.payload_and_judged_point import find_judged_point, find_payload_body
from stage.support.argument_checks import explain_constructor
from stage.tune.machine_tolerances import Machine, fit_machine
from stage.units import DEVIATION_UNITS, POSITION_UNITS

DEFAULT_MARGIN_RATIO = 0.3
"""Default margin as a fraction of the payload."""
DEFAULT_HOLD_S = 0.05
SERVO_TOLERANCE_COUNTS = 10
OVERSHOOT_TOLERANCE_RATIO = 2.0  # default overshoot limit, as a multiple of the tolerance
PAYLOAD_ROUNDING_KG = 1e-9


class MoveCase(NamedTuple):
    """Conditions of one test move.

    Attributes:
        payload: Mass on the axis, kg.
        start_offset: Offset of the start position from the nominal one, pulses.
        direction: 1 or -1.
        machine: Machine that makes the move; None: that of the task's stage.
    """

    payload: float
    start_offset: float
    direction: int
    machine: Machine | None = None


@explain_constructor
@dataclass(frozen=True)
class Task:
    """A move that one axis of a stage repeats in both directions.

    Attributes:
        stage: Machine at power-up. It is copied and never moved.
        axis: Name of the axis.
        pulses: Distance in pulses (of a servo: encoder counts). A negative value sets `direction` to -1.
        payload: Maximum payload, kg. Smaller payloads are tested too, down to none.
        margin: Additional mass with which the axis must not lose a step, kg. Default: 30 % of the payload, or 30 % of the
            moving mass if there is no payload.
        tolerance: Largest distance from the goal that counts as arrived, m (rad). Default: one full step, or 10 encoder counts.
        hold: Time that the axis must stay within the tolerance, s.
        overshoot: Largest distance beyond the goal, m (rad). Default: twice the tolerance; unlimited with `judge_at`.
        judge_at: Site or body on the axis whose position is judged, such as a tool or a camera. Default: the axis itself.
        payload_on: Site or body that carries the payload. Default: site "work" if it rides on the axis, else the body that
            the axis moves.
        direction: 1 or -1: direction of the bus cycles in the result. Registers are tested in both directions.
        sample_point: Index of `judge_at` in the form that `Program.sample_position` takes; 0 for the axis itself.
        payload_body: Name of the body that carries the payload.
        moving_mass: Mass that the axis moves without a payload, kg.
        travel_center: Center between the limit switches, m (rad). Moves are centered there.

    Raises:
        ArgumentError: The axis does not exist or is part of a tandem, the distance does not fit between the limit switches,
            or a value is out of range.
    """

    stage: Stage
    axis: str
    pulses: int
    payload: float = 0.0
    margin: float | None = None
    tolerance: float | None = None
    hold: float = DEFAULT_HOLD_S
    overshoot: float | None = None
    judge_at: str | None = None
    payload_on: str | None = None
    direction: int = field(init=False, default=1)
    sample_point: int = field(init=False, default=0)
    payload_body: str = field(init=False, default="")
    moving_mass: float = field(init=False, default=0.0)
    travel_center: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        if self.axis not in self.stage.axes:
            raise unknown_name_error("axis", self.axis, self.stage.axes)
        axis: Any = self.stage.axes[self.axis]
        if axis.tandem:
            raise ArgumentError(
                f"axis {self.axis} drives one load with {' and '.join(axis.tandem)}: moved alone it loses steps, whatever its "
                "registers. Tune another axis, or try registers by lines of all of them: firmware.line."
            )

        def set_field(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        if self.judge_at is not None:
            set_field("sample_point", find_judged_point(self.stage, self.axis, self.judge_at)[1])
        set_field("payload_body", self._find_payload_body(axis))
        if not 0 <= self.payload < 1e6:
            raise ArgumentError(f"payload={self.payload!r} kg: 0 or more, and less than 1,000,000.")
        body = int(self.stage.model.jnt_bodyid[axis.joint])
        set_field("moving_mass", float(self.stage.model.body_subtreemass[body]))
        if self.margin is None:
            set_field("margin", DEFAULT_MARGIN_RATIO * (self.payload or self.moving_mass))
        if not 0 <= float(self.margin or 0.0) < math.inf:
            raise ArgumentError(f"margin={self.margin!r} kg: 0 or more.")
        if self.tolerance is None:
            pulses = SERVO_TOLERANCE_COUNTS if self.is_servo else axis.drive.microsteps
            set_field("tolerance", pulses * axis.meters_per_pulse)
        if not (0 < float(self.tolerance or 0.0) < math.inf and 0 < self.hold < math.inf):
            raise ArgumentError(f"tolerance={self.tolerance!r}, hold={self.hold!r}: both more than 0.")
        if self.overshoot is None:
            limit = OVERSHOOT_TOLERANCE_RATIO * float(self.tolerance or 0.0) if self.judge_at is None else math.inf
            set_field("overshoot", limit)
        if not float(self.overshoot or 0.0) > 0:
            raise ArgumentError(f"overshoot={self.overshoot!r}: more than 0.")
        set_field("direction", -1 if self.pulses < 0 else 1)
        set_field("pulses", abs(int(self.pulses)))
        low, high = compute_usable_travel(axis)
        max_pulses = math.floor((high - low) / axis.meters_per_pulse) - self.pulses_per_electrical_turn
        if not 0 < self.pulses <= max_pulses:
            raise ArgumentError(
                f"a distance of {self.pulses} pulses: axis {self.axis} has room for 1 to {max_pulses} pulses between its "
                f"limit switches ({POSITION_UNITS[axis.unit].format(max_pulses * axis.meters_per_pulse, 'g')})."
            )
        set_field("travel_center", 0.5 * (low + high))

    @property
    def is_servo(self) -> bool:
        """Whether the axis' chip closes a position loop; its pulses are counts of an encoder then."""
        return get_driver(self.stage.axes[self.axis]).has_position_loop

    @property
    def pulses_per_electrical_turn(self) -> int:
        """Pulses of one electrical turn.

        Start positions are spread over one turn, so that the result does not depend on a favorable rotor angle.
        """
        axis: Any = self.stage.axes[self.axis]
        return 4 * (1 if self.is_servo else axis.drive.microsteps)

    def _find_payload_body(self, axis: Any) -> str:
        """Return `payload_on`, or the default body if it rides on the axis, or the body that the axis moves."""
        default = find_payload_body(self.stage, self.axis, self.payload_on)
        if self.payload_on is not None or is_moved_by_joint(self.stage.model, default, axis.joint):
            return default
        model = self.stage.model
        return str(model.body(int(model.jnt_bodyid[axis.joint])).name)

    def format_length(self, metres: float) -> str:
        """Format a small length in the unit of the axis."""
        return DEVIATION_UNITS[self.stage.axes[self.axis].unit].format(metres, "g")

    @property
    def signed_pulses(self) -> int:
        """Pulses of the move, negative in the minus direction."""
        return self.direction * self.pulses

    @property
    def payload_text(self) -> str:
        """Payload in words, for headings."""
        return f"with up to {self.payload:g} kg" if self.payload else "with nothing on it"

    @property
    def payload_with_margin(self) -> float:
        """Payload plus margin, kg."""
        return self.payload + float(self.margin or 0.0)

    def place_at_start(self, stage: Stage, case: MoveCase) -> float:
        """Set the payload of a stage at power-up and place its axis at the start of a move.

        Args:
            stage: Copy of the task's stage.
            case: Conditions of the move.

        Returns:
            Goal of the move, m (rad).
        """
        axis = stage.axes[self.axis]
        fit_machine(axis, case.machine or self.machine, self.stage.model)
        stage.set_payload(case.payload, self.payload_body)
        step = axis.meters_per_pulse * np.sign(axis.gear)
        distance = step * self.pulses * case.direction
        start = self.travel_center - 0.5 * distance + case.start_offset * axis.meters_per_pulse
        stage.place(**{self.axis: start})
        return float((axis.position if self.is_servo else axis.commanded) + distance)

    @property
    def machine(self) -> Machine:
        """Machine of the task's own stage, within whose tolerances others are drawn."""
        axis: Any = self.stage.axes[self.axis]
        return Machine(replace(axis.drive, bus_voltage=axis.faults.bus_voltage), 1.0)

    def copy_stage(self) -> Stage:
        """Return a copy of the task's stage that shares no state with it."""
        return copy.deepcopy(self.stage)

    def build_corner_cases(
        self,
        rng: np.random.Generator,
        angles: int,
        payload_margin_factor: float = 1.0,
        machines: Iterable[Machine] = (),
    ) -> list[MoveCase]:
        """Combine the extreme payloads with evenly spaced rotor angles and both directions.

        Args:
            rng: Source of the first rotor angle.
            angles: Number of rotor angles for each payload.
            payload_margin_factor: Multiple of the margin in the heaviest payload.
            machines: Machines of the heaviest cases; where they end, the task's own machine makes the moves.

        Returns:
            Cases without a payload, with the payload, and with the payload and its margin.
        """
        payloads = sorted({0.0, self.payload, self._compute_payload_with_margin(payload_margin_factor)})
        first, n = rng.uniform(0, 1), angles * len(payloads)
        turns = [(first + k / n) % 1.0 - 0.5 for k in range(n)]
        cases = [
            MoveCase(payload, self.pulses_per_electrical_turn * turns[j * len(payloads) + k], 1 - 2 * (j % 2))
            for k, payload in enumerate(payloads)
            for j in range(angles)
        ]
        return _assign_machines(cases[::-1], machines)[::-1]

    def draw_cases(
        self, rng: np.random.Generator, moves: int, payload_margin_factor: float = 1.0, machines: Iterable[Machine] = ()
    ) -> list[MoveCase]:
        """Draw cases at random rotor angles in both directions.

        Args:
            rng: Source of the random numbers.
            moves: Number of cases.
            payload_margin_factor: Multiple of the margin in the heaviest payload.
            machines: Machines of the cases, one each; where they end, the task's own machine makes the moves.

        Returns:
            Cases, a quarter of them at each extreme payload and a quarter at random payloads in between.
        """
        corners = (0.0, self.payload, self._compute_payload_with_margin(payload_margin_factor))
        payloads = [corners[k % 4] if k % 4 < 3 else float(rng.uniform(0, corners[2])) for k in range(moves)]
        cases = [
            MoveCase(payload, self.pulses_per_electrical_turn * float(rng.uniform(-0.5, 0.5)), 1 - 2 * (k // 4 % 2))
            for k, payload in enumerate(payloads)
        ]
        return _assign_machines(cases, machines)

    def _compute_payload_with_margin(self, payload_margin_factor: float) -> float:
        """Return the payload plus a multiple of the margin, kg."""
        return self.payload + payload_margin_factor * float(self.margin or 0.0)

    def is_within_payload(self, cases: list[MoveCase]) -> np.ndarray:
        """Mark the cases whose payload does not exceed the task's payload.

        Args:
            cases: Conditions of the moves.

        Returns:
            Mask of the cases whose arrival times count.
        """
        return np.array([case.payload <= self.payload + PAYLOAD_ROUNDING_KG for case in cases])


def _assign_machines(cases: list[MoveCase], machines: Iterable[Machine]) -> list[MoveCase]:
    """Return the cases with the machines assigned in order; cases after the last machine keep the task's own."""
    return [case._replace(machine=machine) for case, machine in zip_longest(cases, machines) if case is not None]


def is_moved_by_joint(model: Any, body: str, joint: int) -> bool:
    """Check whether a joint moves a body.

    Args:
        model: MuJoCo model.
        body: Name of the body.
        joint: Index of the joint.

    Returns:
        True if the body belongs to the subtree that the joint moves.
    """
    k, moved_body = int(model.body(body).id), int(model.jnt_bodyid[joint])
    while k not in (0, moved_body):
        k = int(model.body_parentid[k])
    return k == moved_body


def compute_usable_travel(axis: Any) -> tuple[float, float]:
    """Return the lowest and the highest position at which no limit switch of an axis is on, m (rad)."""
    low, high = axis.travel
    for switch in axis.plant.switches:
        if switch.pin == "el_plus":
            low, high = (low, min(high, switch.touch)) if switch.slope < 0 else (max(low, switch.touch), high)
        elif switch.pin == "el_minus":
            low, high = (max(low, switch.touch), high) if switch.slope > 0 else (low, min(high, switch.touch))
    return low, high
