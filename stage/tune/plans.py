"""`Plan`: the registers of a move; `Plans`: how they are made, by the formula or from the numbers that a search chooses.

Two kinds, by what the chip drives: `Ramps` of pulse rates for steppers, `Loops` for servos, filter and trapezoid. Both use the
chip through its driver only (stage/firmware/driver.py).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError, StageError
from stage.firmware.driver import Speeds, driver_of
from stage.sim.program import Operations
from stage.support import portable
from stage.tune.formula import SAFETY, Load, speeds
from stage.tune.machines import Machine
from stage.tune.task import Task, rides

FARTHEST = {"start": 3.0, "drive": 1.5, "up": 1.7, "down": 1.7}
"""From 1 / so many times what the formula says to so many times."""
FILTER = 4.0  # of gains and sample times, in the same way
SLOWER = 40  # times a tenth longer may a ramp be than the formula's, for a chip that has none as short
QUARTER = 0.25  # of the range, to both sides, of a number that may be 0


class Plan(NamedTuple):
    """registers: by name, as the driver takes them; speeds: that they are to give."""

    registers: dict[str, int]
    speeds: Speeds


class Plans(ABC):
    """What can be chosen for a task. knobs: the names of the numbers from -1 to 1 that make a plan; all 0 are the formula's."""

    knobs: tuple[str, ...]
    shapes: tuple[str, ...] = ("linear",)
    """Of ramps, where there is a choice."""

    def __init__(self, task: Task):
        self.task = task
        self.axis: Any = task.stage.axes[task.axis]
        self.driver = driver_of(self.axis)
        self.bare = Load.of(self.axis)
        self._top: np.ndarray | None = None

    def load(self, payload: float) -> Load:
        """With so many kg on it, where these ride on the axis."""
        return self.bare.heavier(payload if rides(self.axis.stage.model, self.task.carrier, self.axis.joint) else 0.0)

    def compute_thrust_left(self, machine: Machine) -> float:
        """Compute the force that a machine has left over friction at the top rate of the formula, N (N m on a hinge)."""
        if self._top is None:
            self._top = np.array([self.speeds(SAFETY).drive / self.bare.per_metre])
        load, more = replace(self.bare, drive=machine.drive), machine.friction
        return float((load.thrust(self._top) - more * (load.friction + load.damping * self._top))[0])

    def speeds(self, safety: float, payload: float | None = None) -> Speeds:
        """The formula's. Raises ArgumentError, with the most that can be moved."""
        kg = self.task.payload if payload is None else payload
        try:
            return speeds(self.load(kg), self.task.pulses, safety)
        except ArgumentError as error:
            hint = self._most(safety) if kg else "Another motor, supply or distance."
            raise ArgumentError(f"{kg:g} kg on axis {self.task.axis}: {error} {hint}") from None

    def _most(self, safety: float) -> str:
        """The most that the formula can move, in words."""
        low, high = 0.0, self.task.most
        try:
            speeds(self.load(0.0), self.task.pulses, safety)
        except ArgumentError:
            return "Nor does it with nothing on it: another motor, supply or distance."
        for _ in range(20):
            middle = 0.5 * (low + high)
            try:
                speeds(self.load(middle), self.task.pulses, safety)
                low = middle
            except ArgumentError:
                high = middle
        return f"Up to {low:.2g} kg it works."

    @abstractmethod
    def plan(self, speeds: Speeds, values: Mapping[str, float], shape: str) -> Plan:
        """The plan of these numbers around the formula's speeds. Raises ArgumentError for what the chip cannot."""

    @abstractmethod
    def write(self, program: Operations, plan: Plan, pulses: int) -> None:
        """From power-up to the start of the move: bus cycles."""

    def formula(self, safety: float = SAFETY) -> Plan:
        """The engineer's plan."""
        return self.plan(self.speeds(safety), {}, "linear")

    def towards(self, middle: Speeds, wanted: Speeds) -> dict[str, float]:
        """The numbers that lead from one pair of speeds to others, as far as they may."""
        found = {}
        for name, most in FARTHEST.items():
            a, b = getattr(middle, name), getattr(wanted, name)
            if name in self.knobs and a > 0 and b > 0:
                found[name] = float(np.clip(portable.log(b / a) / portable.log(most), -1, 1))
        return found


class Ramps(Plans):
    """Of a stepper: start and drive rate, both ramps, and what a driver says that may be trimmed beside them."""

    def __init__(self, task: Task):
        super().__init__(task)
        try:
            self.driver.tuned_by(True)
            self.shapes = ("linear", "s_curve")
        except ArgumentError:
            pass
        self.trims: dict[str, float] = dict(self.driver.TRIMS)
        both = self.driver.formula(1e3, 1e4, 0.1, 0.1, task.pulses, False)
        one_way = self.driver.formula(1e3, 1e4, 0.1, 0.08, task.pulses, False)
        self.both = both == one_way  # one ramp for both ways
        self.knobs = (*("start", "drive", "up"), *(() if self.both else ("down",)), *self.trims)

    def speeds(self, safety: float, payload: float | None = None) -> Speeds:
        """The formula's, with ramps as slow as the chip's registers need them."""
        wanted = made = super().speeds(safety, payload)
        for _ in range(SLOWER):
            try:
                self.plan(made, {}, "linear")
                return made
            except ArgumentError:
                made = made._replace(up=1.1 * made.up, down=1.1 * made.down)
        self.plan(wanted, {}, "linear")
        return wanted

    def plan(self, speeds: Speeds, values: Mapping[str, float], shape: str) -> Plan:
        start, drive, up, down = (
            getattr(speeds, name) * most ** values.get(name, 0.0) for name, most in FARTHEST.items()
        )
        start = min(start, drive)
        longer = (drive - start) / (speeds.drive - speeds.start) if speeds.drive > speeds.start else 1.0
        up, down = max(up * longer, 1e-3), max(down * longer, 1e-3)
        if self.both:
            down = up  # the formula's are the longer ones: friction helps to brake
        made = self.driver.formula(start, drive, up, down, self.task.pulses, shape == "s_curve")
        for name, most in self.trims.items():
            made[name] = round(made[name] * most ** values.get(name, 0.0))
        for name in self.driver.tuned_by(shape == "s_curve"):
            self.axis.chip.MAP.checked(name, made[name])
        return Plan(made, Speeds(start, drive, up, down, shape == "s_curve"))

    def write(self, program: Operations, plan: Plan, pulses: int) -> None:
        self.driver.write_move(program, plan.registers, pulses)


class Loops(Plans):
    """Of a servo: its filter and sample time, and the rates of a trapezoid."""

    def __init__(self, task: Task):
        super().__init__(task)
        self.choices = self.driver.filter_choices(True).ranges
        self.knobs = ("drive", "up", *self.choices)

    def plan(self, speeds: Speeds, values: Mapping[str, float], shape: str) -> Plan:
        drive, up = (getattr(speeds, name) * FARTHEST[name] ** values.get(name, 0.0) for name in ("drive", "up"))
        middle = self._filter()
        made = {}
        for name, (low, high) in self.choices.items():
            by = values.get(name, 0.0)
            value = middle[name] * FILTER**by if low > 0 else middle[name] + by * QUARTER * (high - low)
            made[name] = int(np.clip(round(value), low, high))
        return Plan(made, Speeds(0.0, drive, up, up))

    def _filter(self) -> dict[str, int]:
        if not hasattr(self, "_middle"):
            stage = self.task.copy()
            stage.set_payload(self.task.payload, self.task.carrier)
            self._middle = driver_of(stage.axes[self.task.axis]).filter_formula()
        return self._middle

    def speeds(self, safety: float, payload: float | None = None) -> Speeds:
        made = super().speeds(safety, payload)
        ramp = max(made.up, made.down)
        return made._replace(up=ramp, down=ramp)

    def write(self, program: Operations, plan: Plan, pulses: int) -> None:
        s = plan.speeds
        self.driver.write_servo_move(program, plan.registers, pulses, (s.drive, s.drive / s.up))


def plans_of(task: Task) -> Plans:
    """Of the kind that the axis' chip needs. Raises StageError where its driver writes no such moves."""
    axis: Any = task.stage.axes[task.axis]
    try:
        return Loops(task) if task.is_servo else Ramps(task)
    except NotImplementedError as error:
        raise StageError(f"a {axis.chip.MAP.chip} has no moves to tune: {error}") from error
