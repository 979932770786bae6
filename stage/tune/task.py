"""`Task`: what is wanted of an axis: one distance, with up to a payload, and what counts as arrived."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np

from stage import Stage
from stage.envs.task import find_carrier, find_judged_point
from stage.errors import ArgumentError, unknown
from stage.firmware.driver import driver_of
from stage.support.arguments import told_when_made
from stage.tune.machines import Machine, fit_machine
from stage.units import PLACES, SMALL

SPARE = 0.3
"""Default margin: payload to spare, in parts of the payload."""
HOLD = 0.05  # s
COUNTS = 10  # of a servo's encoder: within so many it has arrived
TWICE = 2.0  # `within`: how far beyond its goal a move may go
ROUNDING = 1e-9  # kg


class Case(NamedTuple):
    """One move to be tried.

    Attributes:
        payload: Mass on the axis, kg.
        beside: Where it begins, in pulses beside the usual place: the angle of the rotor.
        way: 1, or -1 towards minus.
        machine: Machine that makes it; None: the one of the task's stage.
    """

    payload: float
    beside: float
    way: int
    machine: Machine | None = None


@told_when_made
@dataclass(frozen=True)
class Task:
    """A move of one axis of a stage, to be made again and again, and back.

    Attributes:
        stage: the machine, at power-up; it is copied and never moved. axis: its name. pulses: of the move (of a servo counts);
            below 0 towards minus, which `way` then says.
        payload: kg, the most that it carries; less counts, too, down to nothing. spare: kg on top of it with which no step may be
            lost: the margin. None: 30 % of the payload; without a payload 30 % of what the axis itself moves.
        within, hold: arrived is who stays within so many m (rad) of the goal for so many s. None: a full step, or 10 counts of an
            encoder; 0.05 s.
        overshoot: m (rad) beyond the goal, at most. None: twice `within`, and any with judge_at.
        judge_at: site or body that the axis carries, whose place counts: a tool, a camera on a mast. None: the axis itself.
        payload_on: body or site that carries; None: site "work", if it rides on the axis, else what the axis moves.
        way: 1 or -1, of the bus cycles that are told; registers are tried both ways.
        point: of judge_at, as `Program.look` has it. carrier: the body that carries. moved: kg that the axis moves by itself.
            middle: of the room between the limit switches, m; moves lie around it.
    Raises ArgumentError: no such axis; a distance that it has no room for; a payload that is none.
    """

    stage: Stage
    axis: str
    pulses: int
    payload: float = 0.0
    spare: float | None = None
    within: float | None = None
    hold: float = HOLD
    overshoot: float | None = None
    judge_at: str | None = None
    payload_on: str | None = None
    way: int = field(init=False, default=1)
    point: int = field(init=False, default=0)
    carrier: str = field(init=False, default="")
    moved: float = field(init=False, default=0.0)
    middle: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        if self.axis not in self.stage.axes:
            raise unknown("axis", self.axis, self.stage.axes)
        axis: Any = self.stage.axes[self.axis]
        if axis.tandem:
            raise ArgumentError(
                f"axis {self.axis} drives one load with {' and '.join(axis.tandem)}: moved alone it loses steps, whatever its "
                "registers. Tune another axis, or try registers by lines of all of them: firmware.line."
            )

        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        if self.judge_at is not None:
            put("point", find_judged_point(self.stage, self.axis, self.judge_at)[1])
        put("carrier", self._carrier(axis))
        if not 0 <= self.payload < 1e6:
            raise ArgumentError(f"payload={self.payload!r} kg: 0 or more, and less than 1,000,000.")
        body = int(self.stage.model.jnt_bodyid[axis.joint])
        put("moved", float(self.stage.model.body_subtreemass[body]))
        if self.spare is None:
            put("spare", SPARE * (self.payload or self.moved))
        if not 0 <= float(self.spare or 0.0) < math.inf:
            raise ArgumentError(f"spare={self.spare!r} kg: 0 or more.")
        if self.within is None:
            put("within", (COUNTS if self.is_servo else axis.drive.microsteps) * axis.meters_per_pulse)
        if not (0 < float(self.within or 0.0) < math.inf and 0 < self.hold < math.inf):
            raise ArgumentError(f"within={self.within!r}, hold={self.hold!r}: both more than 0.")
        if self.overshoot is None:
            put("overshoot", TWICE * float(self.within or 0.0) if self.judge_at is None else math.inf)
        if not float(self.overshoot or 0.0) > 0:
            raise ArgumentError(f"overshoot={self.overshoot!r}: more than 0.")
        put("way", -1 if self.pulses < 0 else 1)
        put("pulses", abs(int(self.pulses)))
        low, high = room(axis)
        most = math.floor((high - low) / axis.meters_per_pulse) - self.turn
        if not 0 < self.pulses <= most:
            raise ArgumentError(
                f"a distance of {self.pulses} pulses: axis {self.axis} has room for 1 to {most} pulses between its limit switches "
                f"({PLACES[axis.unit].text(most * axis.meters_per_pulse, 'g')})."
            )
        put("middle", 0.5 * (low + high))

    @property
    def is_servo(self) -> bool:
        """Whether the axis' chip closes a position loop; its pulses are counts of an encoder then."""
        return driver_of(self.stage.axes[self.axis]).has_position_loop

    @property
    def turn(self) -> int:
        """Pulses of an electrical turn: moves begin anywhere within one, so that no rotor angle is the lucky one."""
        axis: Any = self.stage.axes[self.axis]
        return 4 * (1 if self.is_servo else axis.drive.microsteps)

    def _carrier(self, axis: Any) -> str:
        """That of `payload_on`; of the usual ones the first that rides on the axis."""
        named = find_carrier(self.stage, self.axis, self.payload_on)
        if self.payload_on is not None or rides(self.stage.model, named, axis.joint):
            return named
        model = self.stage.model
        return str(model.body(int(model.jnt_bodyid[axis.joint])).name)

    def length(self, metres: float) -> str:
        """A small length of the axis in words."""
        return SMALL[self.stage.axes[self.axis].unit].text(metres, "g")

    @property
    def signed(self) -> int:
        """Pulses of the move that is told, with their sign."""
        return self.way * self.pulses

    @property
    def carries(self) -> str:
        """What it carries, in words."""
        return f"with up to {self.payload:g} kg" if self.payload else "with nothing on it"

    @property
    def most(self) -> float:
        """kg, payload and spare."""
        return self.payload + float(self.spare or 0.0)

    def begin(self, stage: Stage, case: Case) -> float:
        """Bring a stage at power-up to where a move begins. Returns its goal, m."""
        axis = stage.axes[self.axis]
        fit_machine(axis, case.machine or self.machine, self.stage.model)
        stage.set_payload(case.payload, self.carrier)
        step = axis.meters_per_pulse * np.sign(axis.gear)
        way = step * self.pulses * case.way
        stage.place(**{self.axis: self.middle - 0.5 * way + case.beside * axis.meters_per_pulse})
        return float((axis.position if self.is_servo else axis.commanded) + way)

    @property
    def machine(self) -> Machine:
        """The machine of `stage` as it is."""
        axis: Any = self.stage.axes[self.axis]
        return Machine(replace(axis.drive, bus_voltage=axis.faults.bus_voltage), 1.0)

    def copy(self) -> Stage:
        """Another machine of the same kind."""
        return copy.deepcopy(self.stage)

    def corners(
        self, rng: np.random.Generator, angles: int, guard: float = 1.0, machines: Iterable[Machine] = ()
    ) -> list[Case]:
        """Combine nothing, the payload, the payload with `guard` times the spare with some rotor angles, both ways.

        The heaviest get the first of `machines`; where these end, the moves are those of the task's own machine.
        """
        loads = sorted({0.0, self.payload, self._loaded(guard)})
        first, n = rng.uniform(0, 1), angles * len(loads)
        places = [(first + k / n) % 1.0 - 0.5 for k in range(n)]
        cases = [
            Case(load, self.turn * places[j * len(loads) + k], 1 - 2 * (j % 2))
            for k, load in enumerate(loads)
            for j in range(angles)
        ]
        return _with_machines(cases[::-1], machines)[::-1]

    def drawn(
        self, rng: np.random.Generator, moves: int, guard: float = 1.0, machines: Iterable[Machine] = ()
    ) -> list[Case]:
        """Draw the moves of a proof: the corners' payloads and others in between, any rotor angle, both ways.

        Each is made by another of `machines`; where these end, by the task's own machine.
        """
        fixed = (0.0, self.payload, self._loaded(guard))
        loads = [fixed[k % 4] if k % 4 < 3 else float(rng.uniform(0, fixed[2])) for k in range(moves)]
        cases = [
            Case(load, self.turn * float(rng.uniform(-0.5, 0.5)), 1 - 2 * (k // 4 % 2)) for k, load in enumerate(loads)
        ]
        return _with_machines(cases, machines)

    def _loaded(self, guard: float) -> float:
        return self.payload + guard * float(self.spare or 0.0)

    def asked(self, cases: list[Case]) -> np.ndarray:
        """Which cases have no more than the payload: theirs is the time that counts."""
        return np.array([c.payload <= self.payload + ROUNDING for c in cases])


def _with_machines(cases: list[Case], machines: Iterable[Machine]) -> list[Case]:
    return [case._replace(machine=machine) for case, machine in zip_longest(cases, machines) if case is not None]


def rides(model: Any, body: str, joint: int) -> bool:
    """Whether a body is moved by a joint."""
    k, moved = int(model.body(body).id), int(model.jnt_bodyid[joint])
    while k not in (0, moved):
        k = int(model.body_parentid[k])
    return k == moved


def room(axis: Any) -> tuple[float, float]:
    """Between which places neither limit switch of an axis is on, m: its travel, less what the switches take."""
    low, high = axis.travel
    for s in axis.plant.switches:
        if s.pin == "el_plus":
            low, high = (low, min(high, s.touch)) if s.slope < 0 else (max(low, s.touch), high)
        elif s.pin == "el_minus":
            low, high = (max(low, s.touch), high) if s.slope > 0 else (low, min(high, s.touch))
    return low, high
