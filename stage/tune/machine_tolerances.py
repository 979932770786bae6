"""Random machines within the tolerances of motor, power supply and guides of an axis.

    spreads = find_spreads(axis)                                ranges of the values, with their evidence
    machines = draw_machines(axis, np.random.default_rng(0), 96)
    fit_machine(stage.axes["x"], machines[0], model)            model: the unchanged MjModel, for the friction

The tolerances of a motor are in its evidence (`stage.drives.motors`). `DEFAULT_SPREADS` has the ranges that no data sheet states.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from stage.drives.dc_motors import Servo
from stage.drives.motor_tolerances import estimate_tolerances, vary_motor
from stage.drives.motors import MAX_BUS_VOLTAGE, Drive, read_tolerance
from stage.sim.motor_replacement import vary_drive
from stage.support import portable_math


class Spread(NamedTuple):
    """Range from which a value of a machine is drawn with uniform probability.

    Attributes:
        low: Least value.
        high: Greatest value.
        unit: Unit of both.
        logarithmic: Whether the logarithm of the value, and not the value itself, is uniformly distributed.
        evidence: Letter of `stage.drives.motors.EVIDENCE`, and the source of the range.
    """

    low: float
    high: float
    unit: str
    logarithmic: bool
    evidence: str

    def scale(self, value: float, tolerance: float | None = None, evidence: str = "") -> Spread:
        """Return the range of a value from this range of factors. A stated tolerance replaces the factors."""
        if tolerance is not None:
            return self._replace(low=(1 - tolerance) * value, high=(1 + tolerance) * value, evidence=evidence)
        return self._replace(low=self.low * value, high=self.high * value)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a random value from the range."""
        if self.logarithmic:
            return float(portable_math.exp(rng.uniform(*portable_math.log((self.low, self.high)))))
        return float(rng.uniform(self.low, self.high))

    def __str__(self) -> str:
        return f"{self.low:.3g} to {self.high:.3g} {self.unit}"


DEFAULT_SPREADS = {
    "resistance": Spread(0.9, 1.1, "ohm", False, "I: +-10 %, as the data sheet of the 17HS19-2004S1 states"),
    "friction": Spread(0.5, 2.0, "times the model's", True, "I: preload, grease, seals and wear of guides and screw"),
    "supply": Spread(0.95, 1.05, "V", False, "I: +-5 %, line, load and cable of a regulated supply"),
}
"""Ranges where neither a data sheet nor the user states one, as factors of the model's value. Those of core loss and inductance are
in `stage.drives.motor_tolerances`."""
VALUE_UNITS = {"core loss": "N m s/rad", "inductance": "H"} | {
    name: spread.unit for name, spread in DEFAULT_SPREADS.items()
}


class Machine(NamedTuple):
    """One possible machine of an axis within the tolerances.

    Attributes:
        drive: Drive of the machine, with its motor.
        friction: Friction as a factor of the model's friction.
    """

    drive: Drive | Servo
    friction: float

    @property
    def values(self) -> dict[str, float]:
        """Values of the machine in SI units, by the names of their spreads."""
        drive = self.drive
        found = {"resistance": drive.motor.resistance, "friction": self.friction, "supply": drive.bus_voltage}
        if isinstance(drive, Drive):
            found |= {"core loss": drive.motor.core_loss_damping, "inductance": drive.motor.phase_inductance}
        return {name: found[name] for name in VALUE_UNITS if name in found}

    def __str__(self) -> str:
        return ", ".join(f"{name} {value:.3g} {VALUE_UNITS[name]}" for name, value in self.values.items())


def find_spreads(axis: Any) -> dict[str, Spread]:
    """Find the range of each uncertain value of an axis' machine, by the names of `VALUE_UNITS`.

    A servo has no core loss and no inductance. A core loss that the model itself states has no range either.

    Raises:
        ArgumentError: A tolerance of 100 % or more in the evidence of the motor.
    """
    motor, spreads = axis.drive.motor, {}
    if isinstance(axis.drive, Drive):
        if axis.stage.model.actuator_damping[axis.plant.actuator] == motor.core_loss_damping:
            low, high, evidence = estimate_tolerances(motor)["core_loss_damping"]
            spreads["core loss"] = Spread(low, high, VALUE_UNITS["core loss"], low > 0, evidence)
        low, high, evidence = estimate_tolerances(motor)["inductance"]
        spreads["inductance"] = Spread(low, high, VALUE_UNITS["inductance"], False, evidence)
    tolerance, stated = read_tolerance(motor, "resistance"), motor.evidence.get("resistance", "")
    spreads["resistance"] = DEFAULT_SPREADS["resistance"].scale(motor.resistance, tolerance, stated)
    spreads["friction"], supply = DEFAULT_SPREADS["friction"], DEFAULT_SPREADS["supply"].scale(axis.faults.bus_voltage)
    spreads["supply"] = supply._replace(high=min(supply.high, MAX_BUS_VOLTAGE))
    return spreads


def draw_machines(axis: Any, rng: np.random.Generator, count: int) -> list[Machine]:
    """Draw random machines of an axis. Each value comes from its own range, independently of the others."""
    spreads = find_spreads(axis)
    return [
        _build_machine(axis.drive, {name: spread.draw(rng) for name, spread in spreads.items()}) for _ in range(count)
    ]


def _build_machine(drive: Drive | Servo, values: dict[str, float]) -> Machine:
    """Build the machine that has these values."""
    motor: Any = replace(drive.motor, resistance=values["resistance"])
    if isinstance(drive, Drive):
        motor = vary_motor(motor, values.get("core loss"), values["inductance"])
    return Machine(replace(drive, motor=motor, bus_voltage=values["supply"]), values["friction"])


def fit_machine(axis: Any, machine: Machine, model: Any) -> None:
    """Give an axis the motor, supply and friction of a machine.

    Args:
        axis: Axis of the stage to change.
        machine: Machine within the tolerances.
        model: Unchanged MjModel, whose friction and damping are multiplied by the machine's factor.
    """
    vary_drive(axis, machine.drive)
    here, dof = axis.stage.model, axis.plant.dof
    here.dof_frictionloss[dof] = model.dof_frictionloss[dof] * machine.friction
    here.dof_damping[dof] = model.dof_damping[dof] * machine.friction
