"""The engineer's answer: how fast a stepper may go, from data sheets and drawings, without a trial.

1. Mass that the motor feels: carriages, payload, and rotor and screw through the lead. Friction from the guides' data sheet, weight
   where the axis is not level.
2. Thrust that the motor has at a rate: its pull-out torque (spec of motor and drive, V and I, less the motor's core loss) by the
   screw, and no more of it than 1 / SAFETY, as motor makers advise for open loop (1.5 to 2).
3. For a top rate, constant acceleration uses that thrust up at the top; deceleration, where friction helps, too. The top rate is
   the one that makes the move shortest.
   But no ramp is shorter than SWINGS periods of the rotor in its field, which would swing out of it.
4. FL: an eighth of the rate at which the motor starts at once. The bare rotor's from its data sheet, by the root of the inertias
   for the load (motor makers' rule). Half of it would do to start; but a move also ends
   by stopping from FL at once, which swings, and half of it saves only 10 ms.

A DC motor has its stall torque less its back-EMF in place of the pull-out torque, starts from rest, and has no field to swing in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import mujoco
import numpy as np

from stage.drives.dynamometer import closed_form, natural_frequency, pull_in
from stage.drives.motors import Drive
from stage.errors import ArgumentError
from stage.firmware import Profile
from stage.firmware.driver import Speeds, driver_of
from stage.support import portable

SAFETY = 1.5
START = 0.125  # FL in parts of the pull-in rate
SWINGS = 4  # natural periods of a ramp, at least
FASTEST = 1_256.637  # rad/s of a rotor: 12,000 rpm, above any motor here


@dataclass(frozen=True)
class Load:
    """What a drive moves, seen at the carriage: kg with rotor and screw, N, N s/m; pulses and rotor radians a metre.

    weight: N along the axis, of one that is not level. On a hinge kg m^2, N m, and radians for metres.
    """

    mass: float
    friction: float
    damping: float
    drive: Any
    per_metre: float
    gear: float
    weight: float = 0.0
    slope: float = 0.0
    """Weight a kg, N."""

    @classmethod
    def of(cls, axis: Any) -> Load:
        """From the machine's drawings: the model, with what it carries now."""
        stage = axis.stage
        model = stage.model
        body, dof = int(model.jnt_bodyid[axis.joint]), int(model.jnt_dofadr[axis.joint])
        carried = float(model.body_subtreemass[body])
        friction, damping = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
        slope = 0.0
        inertia = carried
        if axis.unit == "m":
            slope = abs(float(np.dot(model.opt.gravity, stage.data.xaxis[axis.joint])))
        else:
            whole, one = np.zeros(model.nv), np.zeros(model.nv)
            one[dof] = 1.0
            mujoco.mj_mulM(model, stage.data, whole, one)
            inertia = float(whole[dof]) - float(model.dof_armature[dof])
        mass = inertia + float(model.dof_armature[dof])
        slope = slope if slope > 1e-9 else 0.0
        per = 1 / axis.meters_per_pulse
        return cls(mass, friction, damping, axis.drive, per, abs(axis.gear), slope * carried, slope)

    def heavier(self, kg: float) -> Load:
        """With so much more on it."""
        return replace(self, mass=self.mass + kg, weight=self.weight + kg * self.slope)

    @property
    def stepper(self) -> bool:
        return isinstance(self.drive, Drive)

    def thrust(self, speed: np.ndarray) -> np.ndarray:
        """Compute the force at the carriage that the motor has at most, N, at speeds in m/s; its core loss is taken off."""
        if not self.stepper:
            motor, volts = self.drive.motor, self.drive.bus_voltage
            back = motor.torque_constant * speed * self.gear
            thrust = np.maximum(volts - back, 0.0) * motor.torque_constant / motor.resistance * self.gear
            limit = self.drive.current_limit
            return thrust if limit is None else np.minimum(thrust, limit * motor.torque_constant * self.gear)
        rpm = speed * self.gear * 60 / (2 * np.pi)
        return closed_form(self.drive.motor, self.drive.bus_voltage, self.drive.amplitude, rpm) * self.gear

    @property
    def inertia(self) -> float:
        """kg m^2 at the rotor."""
        return self.mass / self.gear**2

    @property
    def pull_in(self) -> float:
        """pps at which the motor starts at once with this load: f / sqrt(J / J rotor)."""
        return bare_pull_in(self.drive) / float(np.sqrt(self.inertia / self.drive.motor.rotor_inertia))


@cache
def bare_pull_in(drive: Drive) -> float:
    """A motor's data sheet gives it; ours are simulated on the bench of stage.drives."""
    return pull_in(drive, drive.motor.rotor_inertia)


def speeds(load: Load, pulses: int, safety: float = SAFETY) -> Speeds:
    """The shortest move of `pulses` that uses 1 / safety of the thrust. Raises ArgumentError where there is none."""
    way = pulses / load.per_metre
    low = START * load.pull_in / load.per_metre if load.stepper else 0.0
    fastest = FASTEST / load.gear
    top = portable.geomspace(low * 1.01 or fastest * 1e-4, fastest, 4000)
    thrust, friction = load.thrust(top) / safety, load.friction + load.damping * top
    gentle = np.full(len(top), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):  # beyond the speed where the motor has no torque left
        if load.stepper:
            gentle = (top - low) * natural_frequency(load.drive, load.inertia) / SWINGS
        free = thrust - load.weight  # it goes both ways
        up, down = (np.minimum(f / load.mass, gentle) for f in (free - friction, free + friction))
        ramps = (top**2 - low**2) / 2 * (1 / up + 1 / down)
        seconds = (top - low) * (1 / up + 1 / down) + (way - ramps) / top
    fits = (up > 0) & (down > 0) & (ramps <= way)
    if not fits.any():
        raise ArgumentError(f"{pulses} pulses with a safety factor of {safety}: too short a move, or too weak a motor.")
    k = int(np.argmin(np.where(fits, seconds, np.inf)))
    rate, fl = top[k] * load.per_metre, low * load.per_metre
    return Speeds(float(fl), float(rate), float((top[k] - low) / up[k]), float((top[k] - low) / down[k]))


def plan_profile(load: Load, pulses: int, safety: float = SAFETY) -> Profile:
    """Plan the shortest move of `pulses` that uses 1 / safety of the pull-out thrust. Raises ArgumentError where there is none."""
    s = speeds(load, pulses, safety)
    return Profile.of(s.start, s.drive, s.drive, accel=s.up, decel=s.down)


def compute_registers(axis: Any, pulses: int, safety: float = SAFETY, s_curve: bool | None = None) -> dict[str, int]:
    """Compute the registers of the axis' chip for the shortest move of `pulses`, by that chip's data sheet.

    Args:
        axis: Axis of a stage, with the payload that it carries now.
        pulses: Length of the move.
        safety: Pull-out thrust over the thrust that the move uses.
        s_curve: Ramp by S-curves; None leaves that to the chip's driver.

    Returns:
        Values by the names of the registers; of a PCL-240 R1 to R7.

    Raises:
        ArgumentError: No move of this length is possible.
    """
    p = plan_profile(Load.of(axis), pulses, safety)
    return driver_of(axis).formula(p.fl, p.fh1, p.accel(), p.decel(), pulses, s_curve)
