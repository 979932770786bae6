"""Planners turn normalized search parameters into chip registers.

All parameters at 0 give the plan of the data sheet formula; -1 and 1 are the ends of the search range. `StepperPlanner`
chooses pulse rates and ramps, `ServoPlanner` chooses filter and trapezoid. Both access the chip only through its driver
(stage/firmware/driver.py).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError, StageError
from stage.firmware.driver import Speeds, get_driver
from stage.sim.program import Operations
from stage.support import portable_math
from stage.tune.formula import MIN_RAMP_S, SAFETY_FACTOR, Load, compute_speeds
from stage.tune.machine_tolerances import Machine
from stage.tune.task import Task, is_moved_by_joint

MAX_SPEED_FACTORS = {"start": 3.0, "drive": 1.5, "up": 1.7, "down": 1.7}
"""Search range of each field of `Speeds`: from 1 / factor to factor times the formula's value."""
MAX_FILTER_FACTOR = 4.0  # the same for servo gains and sample times
MAX_RAMP_EXTENSIONS = 40  # number of 10 % extensions of the ramps until they fit the chip's registers
ZERO_BASED_RANGE_FRACTION = 0.25  # search range to either side of a filter value that may be 0, in parts of its range


class MovePlan(NamedTuple):
    """Register values of a move and the speeds they produce.

    Attributes:
        registers: Values by register name, as the driver takes them.
        speeds: Intended rates and ramps.
    """

    registers: dict[str, int]
    speeds: Speeds


class MovePlanner(ABC):
    """Base class of the planners for one task.

    Attributes:
        parameter_names: Names of the search parameters, each from -1 to 1. All at 0 give the formula's plan.
        ramp_shapes: Ramp shapes that the chip supports.
    """

    parameter_names: tuple[str, ...]
    ramp_shapes: tuple[str, ...] = ("linear",)

    def __init__(self, task: Task):
        self.task = task
        self.axis: Any = task.stage.axes[task.axis]
        self.driver = get_driver(self.axis)
        self.unloaded = Load.from_axis(self.axis)
        self._top_speed: np.ndarray | None = None

    def build_load(self, payload: float) -> Load:
        """Return the load of the drive with a payload in kg. A payload that the axis does not move changes nothing."""
        on_axis = is_moved_by_joint(self.axis.stage.model, self.task.payload_body, self.axis.joint)
        return self.unloaded.add_mass(payload if on_axis else 0.0)

    def compute_thrust_left(self, machine: Machine) -> float:
        """Compute the force that the motor of a machine has in addition to friction at the formula's top rate, N (N m on a
        hinge)."""
        if self._top_speed is None:
            self._top_speed = np.array([self.compute_speeds(SAFETY_FACTOR).drive / self.unloaded.pulses_per_metre])
        load, top = replace(self.unloaded, drive=machine.drive), self._top_speed
        friction = machine.friction * (load.friction + load.damping * top)
        return float((load.compute_max_thrust(top) - friction)[0])

    def compute_speeds(self, safety_factor: float, rate_ratio: float = 1.0) -> Speeds:
        """Compute the speeds of the data sheet formula.

        Args:
            safety_factor: Ratio of the available thrust to the thrust used.
            rate_ratio: Ratio of all rates to those of the fastest move.

        Returns:
            Rates and ramps of the fastest move.

        Raises:
            ArgumentError: The drive cannot move the payload. The message names the largest payload that it can move.
        """
        kg = self.task.payload
        try:
            return compute_speeds(self.build_load(kg), self.task.pulses, safety_factor, rate_ratio)
        except ArgumentError as error:
            hint = self._describe_max_payload(safety_factor) if kg else "Another motor, supply or distance."
            raise ArgumentError(f"{kg:g} kg on axis {self.task.axis}: {error} {hint}") from None

    def _describe_max_payload(self, safety_factor: float) -> str:
        """Find the largest payload that the formula accepts, by bisection, and describe it in words."""
        low, high = 0.0, self.task.payload_with_margin
        try:
            compute_speeds(self.build_load(0.0), self.task.pulses, safety_factor)
        except ArgumentError:
            return "Nor does it with nothing on it: another motor, supply or distance."
        for _ in range(20):
            middle = 0.5 * (low + high)
            try:
                compute_speeds(self.build_load(middle), self.task.pulses, safety_factor)
                low = middle
            except ArgumentError:
                high = middle
        return f"Up to {low:.2g} kg it works."

    @abstractmethod
    def build_plan(self, center: Speeds, parameters: Mapping[str, float], shape: str) -> MovePlan:
        """Build the plan of a set of parameters.

        Args:
            center: Speeds at which all parameters are 0.
            parameters: Values from -1 to 1 by parameter name; a missing one is 0.
            shape: One of `ramp_shapes`.

        Returns:
            Registers and speeds.

        Raises:
            ArgumentError: A value does not fit its register.
        """

    @abstractmethod
    def write_move(self, program: Operations, plan: MovePlan, pulses: int) -> None:
        """Append the bus cycles from power-up to the start of the move.

        Args:
            program: Program to extend.
            plan: Plan of the move.
            pulses: Signed distance.
        """

    def build_formula_plan(self, safety_factor: float = SAFETY_FACTOR, rate_ratio: float = 1.0) -> MovePlan:
        """Build the plan of the data sheet formula; see `compute_speeds`."""
        return self.build_plan(self.compute_speeds(safety_factor, rate_ratio), {}, "linear")

    def find_parameters(self, center: Speeds, target: Speeds) -> dict[str, float]:
        """Return the parameters that lead from one set of speeds to another, clipped to the search range.

        Args:
            center: Speeds at which all parameters are 0.
            target: Speeds to reach.

        Returns:
            Values by parameter name. Fields that are 0 in either set are left out.
        """
        parameters = {}
        for name, max_factor in MAX_SPEED_FACTORS.items():
            a, b = getattr(center, name), getattr(target, name)
            if name in self.parameter_names and a > 0 and b > 0:
                parameters[name] = float(np.clip(portable_math.log(b / a) / portable_math.log(max_factor), -1, 1))
        return parameters


class StepperPlanner(MovePlanner):
    """Planner of start rate, drive rate, ramps and the registers that a driver lists in TRIM_FACTORS.

    Attributes:
        trim_factors: Search range of each of those registers, as a factor.
        has_single_ramp: True if the chip has one rate for acceleration and deceleration.
    """

    def __init__(self, task: Task):
        super().__init__(task)
        try:
            self.driver.list_move_registers(True)
            self.ramp_shapes = ("linear", "s_curve")
        except ArgumentError:
            pass
        self.trim_factors: dict[str, float] = dict(self.driver.TRIM_FACTORS)
        # A chip with one ramp ignores the deceleration: different ramps give the same registers.
        equal_ramps = self.driver.compute_move_registers(1e3, 1e4, 0.1, 0.1, task.pulses, False)
        unequal_ramps = self.driver.compute_move_registers(1e3, 1e4, 0.1, 0.08, task.pulses, False)
        self.has_single_ramp = equal_ramps == unequal_ramps
        ramps = ("up",) if self.has_single_ramp else ("up", "down")
        self.parameter_names = ("start", "drive", *ramps, *self.trim_factors)

    def compute_speeds(self, safety_factor: float, rate_ratio: float = 1.0) -> Speeds:
        """Compute the speeds of the formula, with ramps long enough for the chip's registers. See `MovePlanner`."""
        target = speeds = super().compute_speeds(safety_factor, rate_ratio)
        for _ in range(MAX_RAMP_EXTENSIONS):
            try:
                self.build_plan(speeds, {}, "linear")
                return speeds
            except ArgumentError:
                speeds = speeds._replace(up=1.1 * speeds.up, down=1.1 * speeds.down)
        self.build_plan(target, {}, "linear")
        return target

    def build_plan(self, center: Speeds, parameters: Mapping[str, float], shape: str) -> MovePlan:
        """Build the plan of a stepper, see `MovePlanner.build_plan`."""
        start, drive, up, down = (
            getattr(center, name) * max_factor ** parameters.get(name, 0.0)
            for name, max_factor in MAX_SPEED_FACTORS.items()
        )
        start = min(start, drive)
        # The parameters of the ramps change the acceleration: a wider range of rates takes longer.
        stretch = (drive - start) / (center.drive - center.start) if center.drive > center.start else 1.0
        up, down = max(up * stretch, MIN_RAMP_S), max(down * stretch, MIN_RAMP_S)
        if self.has_single_ramp:
            down = up  # the formula accelerates more slowly than it brakes, because friction helps to brake
        registers = self.driver.compute_move_registers(start, drive, up, down, self.task.pulses, shape == "s_curve")
        for name, max_factor in self.trim_factors.items():
            registers[name] = round(registers[name] * max_factor ** parameters.get(name, 0.0))
        for name in self.driver.list_move_registers(shape == "s_curve"):
            self.axis.chip.MAP.check_value(name, registers[name])
        return MovePlan(registers, Speeds(start, drive, up, down, shape == "s_curve"))

    def write_move(self, program: Operations, plan: MovePlan, pulses: int) -> None:
        """Write the bus cycles of a stepper's move, see `MovePlanner.write_move`."""
        self.driver.write_move(program, plan.registers, pulses)


class ServoPlanner(MovePlanner):
    """Planner of filter, sample time and trapezoid of a servo.

    Attributes:
        filter_ranges: Lowest and highest value of each filter register.
    """

    def __init__(self, task: Task):
        super().__init__(task)
        self.filter_ranges = self.driver.get_filter_ranges(True).ranges
        self.parameter_names = ("drive", "up", *self.filter_ranges)

    def build_plan(self, center: Speeds, parameters: Mapping[str, float], shape: str) -> MovePlan:
        """Build the plan of a servo, see `MovePlanner.build_plan`."""
        drive, up = (
            getattr(center, name) * MAX_SPEED_FACTORS[name] ** parameters.get(name, 0.0) for name in ("drive", "up")
        )
        default_filter = self._compute_filter()
        registers = {}
        for name, (low, high) in self.filter_ranges.items():
            parameter = parameters.get(name, 0.0)
            if low > 0:
                value = default_filter[name] * MAX_FILTER_FACTOR**parameter
            else:
                value = default_filter[name] + parameter * ZERO_BASED_RANGE_FRACTION * (high - low)
            registers[name] = int(np.clip(round(value), low, high))
        return MovePlan(registers, Speeds(0.0, drive, up, up))

    def _compute_filter(self) -> dict[str, int]:
        """Compute the formula's filter for the full payload. The result is cached."""
        if not hasattr(self, "_filter"):
            stage = self.task.copy_stage()
            stage.set_payload(self.task.payload, self.task.payload_body)
            self._filter = get_driver(stage.axes[self.task.axis]).compute_filter()
        return self._filter

    def compute_speeds(self, safety_factor: float, rate_ratio: float = 1.0) -> Speeds:
        """Compute the speeds of the formula, with the longer of both ramps. See `MovePlanner`."""
        speeds = super().compute_speeds(safety_factor, rate_ratio)
        ramp = max(speeds.up, speeds.down)
        return speeds._replace(up=ramp, down=ramp)

    def write_move(self, program: Operations, plan: MovePlan, pulses: int) -> None:
        """Write the bus cycles of a servo's move, see `MovePlanner.write_move`."""
        speeds = plan.speeds
        self.driver.write_servo_move(program, plan.registers, pulses, (speeds.drive, speeds.drive / speeds.up))


def create_planner(task: Task) -> MovePlanner:
    """Create the planner that fits the chip of the axis.

    Raises:
        StageError: The driver of the chip cannot write such moves.
    """
    axis: Any = task.stage.axes[task.axis]
    try:
        return ServoPlanner(task) if task.is_servo else StepperPlanner(task)
    except NotImplementedError as error:
        raise StageError(f"a {axis.chip.MAP.chip} has no moves to tune: {error}") from error
