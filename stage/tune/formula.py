"""The data sheet formula: how fast a motor can move a load, computed from data sheets and drawings without a trial.

1. Inertia at the motor: carriages, payload, and rotor and screw through the lead. Friction comes from the data sheet of the
   guides; weight counts where the axis is not level.
2. Available thrust at a rate: the pull-out torque of motor and drive, converted by the screw and divided by the safety factor.
   Motor makers recommend 1.5 to 2 for open loop.
3. Ramps: for a top rate, constant acceleration uses the thrust available at that rate. Deceleration also uses friction. The top
   rate is the one that gives the shortest move. No ramp is shorter than MIN_RAMP_SWINGS natural periods of the rotor in its
   field, because a shorter one would swing the rotor out of it.
4. Start rate (FL): one eighth of the pull-in rate with this load. That rate follows from the bare rotor's by the square root of
   the inertia ratio (motor makers' rule). One half would be enough to start; but a move also ends with a stop from FL, which
   makes the rotor swing, and one half saves only 10 ms.

A DC motor has its stall torque less its back-EMF in place of the pull-out torque. It starts from rest and has no swing limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import mujoco
import numpy as np

from stage.drives.dynamometer import compute_closed_form_torque, compute_natural_frequency, find_pull_in_rate
from stage.drives.motors import Drive
from stage.errors import ArgumentError
from stage.firmware import Axis, Profile
from stage.firmware.driver import Speeds, get_driver
from stage.support import portable_math
from stage.support.argument_checks import explain_arguments

SAFETY_FACTOR = 1.5
START_RATE_RATIO = 0.125  # start rate (FL) as a fraction of the pull-in rate
MIN_RAMP_SWINGS = 4
MIN_RAMP_S = 1e-3
CONSTANT_RATE_RATIO = 1.05  # drive rate to start rate of a move without ramps: chips compute ramps from the difference
SPEED_SAMPLES = 2_000
MAX_ROTOR_SPEED_RAD_S = 1_256.637  # 12,000 rpm, above any supported motor


class FormulaChoice(NamedTuple):
    """Parameters that make the formula's move more careful; see `compute_speeds`."""

    safety_factor: float = SAFETY_FACTOR
    rate_ratio: float = 1.0


@dataclass(frozen=True)
class Load:
    """The load of a drive, referred to the carriage. On a hinge, read kg m^2, N m and rad for kg, N and m.

    Attributes:
        mass: Moving mass with rotor and screw, kg.
        friction: Coulomb friction, N.
        damping: Viscous friction, N s/m.
        drive: Stepper drive or DC drive of the axis.
        pulses_per_metre: Pulses of one metre of travel.
        gear: Rotor angle of one metre of travel, rad/m.
        weight: Force of gravity along the axis, N.
        weight_per_kg: Force of gravity along the axis for each kg of payload, N/kg.
    """

    mass: float
    friction: float
    damping: float
    drive: Any
    pulses_per_metre: float
    gear: float
    weight: float = 0.0
    weight_per_kg: float = 0.0

    @classmethod
    def from_axis(cls, axis: Any) -> Load:
        """Compute the load of an axis from its model, including the current payload."""
        stage = axis.stage
        model = stage.model
        body, dof = int(model.jnt_bodyid[axis.joint]), int(model.jnt_dofadr[axis.joint])
        carried_mass = float(model.body_subtreemass[body])
        friction, damping = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
        weight_per_kg = 0.0
        inertia = carried_mass
        if axis.unit == "m":
            weight_per_kg = abs(float(np.dot(model.opt.gravity, stage.data.xaxis[axis.joint])))
        else:
            column, unit_vector = np.zeros(model.nv), np.zeros(model.nv)
            unit_vector[dof] = 1.0
            mujoco.mj_mulM(model, stage.data, column, unit_vector)
            inertia = float(column[dof]) - float(model.dof_armature[dof])
        mass = inertia + float(model.dof_armature[dof])
        weight_per_kg = weight_per_kg if weight_per_kg > 1e-9 else 0.0
        pulses_per_metre = 1 / axis.meters_per_pulse
        weight = weight_per_kg * carried_mass
        return cls(mass, friction, damping, axis.drive, pulses_per_metre, abs(axis.gear), weight, weight_per_kg)

    def add_mass(self, kg: float) -> Load:
        """Return the load with additional mass."""
        return replace(self, mass=self.mass + kg, weight=self.weight + kg * self.weight_per_kg)

    @property
    def is_stepper(self) -> bool:
        """True for a stepper, False for a DC motor."""
        return isinstance(self.drive, Drive)

    def compute_max_thrust(self, speed: np.ndarray) -> np.ndarray:
        """Return the largest thrust of the motor at the carriage in N, at speeds in m/s, less its core loss."""
        if not self.is_stepper:
            motor, bus_voltage = self.drive.motor, self.drive.bus_voltage
            back_emf = motor.torque_constant * speed * self.gear
            thrust = np.maximum(bus_voltage - back_emf, 0.0) * motor.torque_constant / motor.resistance * self.gear
            limit = self.drive.current_limit
            return thrust if limit is None else np.minimum(thrust, limit * motor.torque_constant * self.gear)
        rpm = speed * self.gear * 60 / (2 * np.pi)
        return (
            compute_closed_form_torque(self.drive.motor, self.drive.bus_voltage, self.drive.amplitude, rpm) * self.gear
        )

    @property
    def inertia_at_rotor(self) -> float:
        """Inertia referred to the rotor, kg m^2."""
        return self.mass / self.gear**2

    @property
    def pull_in_rate(self) -> float:
        """Pull-in rate with this load, pps: f / sqrt(J / J rotor)."""
        unloaded = measure_unloaded_pull_in(self.drive)
        return unloaded / float(np.sqrt(self.inertia_at_rotor / self.drive.motor.rotor_inertia))


@explain_arguments
def compute_top_speed(axis: Axis) -> float:
    """Compute the highest speed of an axis: that of its chip, or of its motor against friction and weight.

    Args:
        axis: Axis of a Stage.

    Returns:
        The speed, m/s (rad/s for a rotary axis).
    """
    load = Load.from_axis(axis)
    top = get_driver(axis).max_rate / load.pulses_per_metre
    speeds = np.linspace(0.0, min(top, MAX_ROTOR_SPEED_RAD_S / load.gear), SPEED_SAMPLES + 1)[1:]
    reached = speeds[load.compute_max_thrust(speeds) > load.friction + load.damping * speeds + load.weight]
    return float(reached[-1] if len(reached) else speeds[0])


@cache
def measure_unloaded_pull_in(drive: Drive) -> float:
    """Measure the pull-in rate of the bare rotor on the dynamometer of stage.drives, pps.

    For a real motor it is in the data sheet.
    """
    return find_pull_in_rate(drive, drive.motor.rotor_inertia)


def compute_speeds(load: Load, pulses: int, safety_factor: float = SAFETY_FACTOR, rate_ratio: float = 1.0) -> Speeds:
    """Compute the fastest move that uses at most 1 / safety_factor of the available thrust.

    A stepper's move that is too short for ramps runs at the start rate.

    Args:
        load: Load of the drive.
        pulses: Distance.
        safety_factor: Ratio of the available thrust to the thrust used.
        rate_ratio: Ratio of all rates to those of the fastest move, whose ramps it lengthens by its inverse. Where gravity leaves
            too little thrust for a larger safety factor, a slower move needs less.

    Returns:
        Start rate, drive rate and ramps.

    Raises:
        ArgumentError: The move is too short or the motor is too weak.
    """
    distance = pulses / load.pulses_per_metre
    start = START_RATE_RATIO * load.pull_in_rate / load.pulses_per_metre if load.is_stepper else 0.0
    max_speed = MAX_ROTOR_SPEED_RAD_S / load.gear
    top = portable_math.geomspace(start * 1.01 or max_speed * 1e-4, max_speed, 4000)
    thrust, friction = load.compute_max_thrust(top) / safety_factor, load.friction + load.damping * top
    swing_limit = np.full(len(top), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):  # beyond the speed at which the motor has no torque left
        if load.is_stepper:
            swing_limit = (top - start) * compute_natural_frequency(load.drive, load.inertia_at_rotor) / MIN_RAMP_SWINGS
        net_thrust = thrust - load.weight  # the move must work in both directions
        acceleration, deceleration = (
            np.minimum(force / load.mass, swing_limit) for force in (net_thrust - friction, net_thrust + friction)
        )
        ramp_distance = (top**2 - start**2) / 2 * (1 / acceleration + 1 / deceleration)
        duration = (top - start) * (1 / acceleration + 1 / deceleration) + (distance - ramp_distance) / top
    is_strong = (acceleration > 0) & (deceleration > 0)
    feasible = is_strong & (ramp_distance <= distance)
    drive_pps, start_pps = top * load.pulses_per_metre, start * load.pulses_per_metre
    if not feasible.any() and load.is_stepper and is_strong[0]:
        start_pps *= rate_ratio
        return Speeds(float(start_pps), float(start_pps * CONSTANT_RATE_RATIO), MIN_RAMP_S, MIN_RAMP_S)
    if not feasible.any():
        raise ArgumentError(
            f"{pulses} pulses with a safety factor of {safety_factor}: too short a move, or too weak a motor."
        )
    k = int(np.argmin(np.where(feasible, duration, np.inf)))
    up, down = float((top[k] - start) / acceleration[k]), float((top[k] - start) / deceleration[k])
    return Speeds(float(start_pps * rate_ratio), float(drive_pps[k] * rate_ratio), up / rate_ratio, down / rate_ratio)


def plan_profile(load: Load, pulses: int, safety_factor: float = SAFETY_FACTOR) -> Profile:
    """Plan the shortest move of `pulses` that uses 1 / safety_factor of the pull-out thrust. Raises as `compute_speeds`."""
    s = compute_speeds(load, pulses, safety_factor)
    return Profile.of(s.start, s.drive, s.drive, accel=s.up, decel=s.down)


def compute_registers(
    axis: Any, pulses: int, safety_factor: float = SAFETY_FACTOR, s_curve: bool | None = None
) -> dict[str, int]:
    """Compute the registers of the axis' chip for the shortest move of `pulses`, by that chip's data sheet.

    Args:
        axis: Axis of a stage, with the payload that it carries now.
        pulses: Length of the move.
        safety_factor: Pull-out thrust over the thrust that the move uses.
        s_curve: Ramp by S-curves; None leaves that to the chip's driver.

    Returns:
        Values by the names of the registers; of a PCL-240 R1 to R7.

    Raises:
        ArgumentError: No move of this length is possible.
    """
    p = plan_profile(Load.from_axis(axis), pulses, safety_factor)
    return get_driver(axis).compute_move_registers(p.fl, p.fh1, p.get_accel_time(), p.get_decel_time(), pulses, s_curve)
