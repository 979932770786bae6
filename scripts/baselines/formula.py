"""The engineer's answer: registers from data sheets, without a single trial.

python scripts/baselines/formula.py --payload 10

1. Mass that the motor feels: carriages, payload, and rotor and screw through the lead. Friction from the guides' data sheet.
2. Thrust that the motor has at a rate: its pull-out torque (spec of motor and drive, V and I) by the screw, and no more of it than
   1 / SAFETY, as motor makers advise for open loop (1.5 to 2).
3. For a top rate, constant acceleration uses that thrust up at the top; deceleration, where friction helps, too. The top rate is
   the one that makes the move shortest.
   But no ramp is shorter than SWINGS periods of the rotor in its field, which would swing out of it.
4. FL: an eighth of the rate at which the motor starts at once. The bare rotor's from its data sheet, by the root of the inertias
   for the load (motor makers' rule). Half of it would do to start; but a move also ends
   by stopping from FL at once, which swings, and half of it saves only 10 ms.
5. Rates and times into R1, R2, R4, R5, R7, R6 by the chip's data sheet (`firmware.Profile`); of other families into their own
   registers (`stage.firmware.driver`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from stage.drives.dynamometer import closed_form, natural_frequency, pull_in
from stage.drives.motors import Drive
from stage.errors import ArgumentError
from stage.firmware import Profile
from stage.firmware.driver import driver_of
from stage.sim.stage import Axis

if TYPE_CHECKING:
    from common import Moves

SAFETY = 1.5
START = 0.125  # FL in parts of the pull-in rate
SWINGS = 4  # natural periods of a ramp, at least
FACTORS = np.arange(2.0, 0.99, -0.05)  # safety factors that `boldest` tries


@dataclass(frozen=True)
class Load:
    """What a drive moves, seen at the carriage of a horizontal axis: kg with rotor and screw, N, N s/m; pulses and rotor
    radians a metre."""

    mass: float
    friction: float
    damping: float
    drive: Drive
    per_metre: float
    gear: float

    @classmethod
    def of(cls, axis: Axis) -> Load:
        """From the machine's drawings: the model."""
        model = axis.stage.model
        body, dof = int(model.jnt_bodyid[axis.joint]), int(model.jnt_dofadr[axis.joint])
        mass = float(model.body_subtreemass[body] + model.dof_armature[dof])
        friction, damping = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
        return cls(mass, friction, damping, axis.drive, 1 / axis.meters_per_pulse, abs(axis.gear))

    def thrust(self, speed: np.ndarray) -> np.ndarray:
        """N at the carriage with which the motor pulls out, at m/s."""
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
    """A motor's data sheet gives it; ours are measured on the bench of stage.drives."""
    return pull_in(drive, drive.motor.rotor_inertia)


def profile(load: Load, pulses: int, safety: float = SAFETY) -> Profile:
    """The shortest move of `pulses` that uses 1 / safety of the pull-out thrust. Raises ArgumentError where there is none."""
    way, low = pulses / load.per_metre, START * load.pull_in / load.per_metre
    top = np.geomspace(low * 1.01, 2.0, 4000)
    thrust, friction = load.thrust(top) / safety, load.friction + load.damping * top
    with np.errstate(divide="ignore"):
        gentle = (top - low) * natural_frequency(load.drive, load.inertia) / SWINGS
        up, down = (np.minimum(f / load.mass, gentle) for f in (thrust - friction, thrust + friction))
        ramps = (top**2 - low**2) / 2 * (1 / up + 1 / down)
        seconds = (top - low) * (1 / up + 1 / down) + (way - ramps) / top
    fits = (up > 0) & (ramps <= way)
    if not fits.any():
        raise ArgumentError(f"{pulses} pulses with a safety factor of {safety}: too short a move, or too weak a motor.")
    k = int(np.argmin(np.where(fits, seconds, np.inf)))
    rate, fl = top[k] * load.per_metre, low * load.per_metre
    return Profile.of(fl, rate, rate, accel=(top[k] - low) / up[k], decel=(top[k] - low) / down[k])


def registers(axis: Axis, pulses: int, safety: float = SAFETY, s_curve: bool | None = None) -> dict[str, int]:
    """The registers of the axis' chip for a move of `pulses`; of a PCL-240 R1 to R7."""
    p = profile(Load.of(axis), pulses, safety)
    return driver_of(axis).formula(p.fl, p.fh1, p.accel(), p.decel(), pulses, s_curve)


class Knobs:
    """The formula's answer as the middle of a search: factors on its rates and accelerations, and on the ramp-down point.

    A chip without R6 finds its ramp-down point itself, and has one acceleration for both ramps.
    """

    RANGES = (3.0, 1.3, 1.7, 1.7, 1.06)  # FL, FH, acceleration, deceleration, R6: from 1 / so much to so much

    def __init__(self, axis: Axis, pulses: int):
        self.pulses, self.middle, self.driver = pulses, profile(Load.of(axis), pulses), driver_of(axis)
        self.ranges = self.RANGES if "R6" in self.driver.tuned_by(s_curve=False) else self.RANGES[:3]

    def registers(self, knobs: np.ndarray) -> dict[str, int]:
        """Registers of as many numbers from -1 to 1 as there are `ranges`; all 0 are the formula's."""
        fl, fh, up, *others = np.array(self.ranges) ** np.asarray(knobs, float)
        down, point = others or (up, 1.0)
        m = self.middle
        low, high = m.fl * fl, m.fh1 * fh
        low = min(low, high)
        longer = (high - low) / (m.fh1 - m.fl)
        ramps = (max(ramp * longer / factor, 1e-3) for ramp, factor in ((m.accel(), up), (m.decel(), down)))
        made = self.driver.formula(low, high, *ramps, self.pulses, s_curve=False)
        return {**made, "R6": min(round(made["R6"] * point), 0xFFFFF)} if others else made


def search(moves: Moves, seed: int = 0, safety: float = SAFETY) -> None:
    """One move."""
    moves.make_actions(moves.registers.to_action(registers(moves.axis, moves.distance, safety, s_curve=False))[None])


def boldest(moves: Moves, seed: int = 0) -> None:
    """An engineer with a machine to try it on: the same formula with one safety factor after the other."""
    for factor in FACTORS:
        search(moves, safety=float(factor))


def main() -> None:
    from common import Moves, arguments, told

    parser = arguments(__doc__, searches=False)
    parser.add_argument("--safety", type=float, default=SAFETY, help="pull-out thrust over the thrust used")
    args = parser.parse_args()
    with Moves(args.payload, 1, "registers", args.distance, lanes=1, chip=args.chip) as moves:
        load = Load.of(moves.axis)
        print(f"moves {load.mass:.2f} kg, rotor and screw included; pull-in {load.pull_in:.0f} pps")
        print(profile(load, args.distance, args.safety))
        search(moves, safety=args.safety)
    print(told(moves.log, moves.registers.names, args.payload, args.distance, args.chip))


if __name__ == "__main__":
    main()
