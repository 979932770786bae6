"""A servo axis with an HCTL-1100 as a linear sampled system, from the data of the machine alone, without a measurement.

    loop = Loop.of(port.axis, tuning)
    error = loop.following_error(command)       counts, sample by sample; command: counts

The plant is a DC motor with a mass on it, its voltage held for a sample:

    m dv/dt = F u - (d + back-EMF) v - friction      G(s) = gain / s (1 + tau s)

and its transfer function in z is exact. What is left out: rounding, saturation, the physics step, play. Coulomb friction is a
constant force as long as an axis moves one way; there it is an input of the model. `following_error` needs scipy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage.chips.hctl1100.motor import FULL_DRIVE
from stage.errors import StageError
from stage.firmware.hctl1100.moves import Tuning


@dataclass(frozen=True)
class Loop:
    """Plant and filter. gain: counts/s per unit of motor command at rest's end; tau: s; friction: units of motor command;
    sample: s."""

    gain: float
    tau: float
    friction: float
    tuning: Tuning
    clock_hz: int = 2_000_000

    @classmethod
    def of(cls, axis: Any, tuning: Tuning) -> Loop:
        """From the machine's drawings, the model of a stage's axis: masses with what they carry now, friction, motor, encoder."""
        model, drive = axis.stage.model, axis.drive
        dof = int(model.jnt_dofadr[axis.joint])
        body = int(model.jnt_bodyid[axis.joint])
        mass = float(model.body_subtreemass[body] + model.dof_armature[dof])
        motor, gear = drive.motor, abs(axis.gear)
        per_command = drive.bus_voltage / FULL_DRIVE * motor.torque_constant / motor.resistance * gear  # N
        drag = float(model.dof_damping[dof]) + motor.torque_constant**2 / motor.resistance * gear**2  # N s/m
        friction = float(model.dof_frictionloss[dof]) / per_command
        return cls(per_command / drag / axis.meters_per_pulse, mass / drag, friction, tuning, axis.chip.clock_hz)

    @property
    def sample(self) -> float:
        """s."""
        return 16 * (self.tuning.timer + 1) / self.clock_hz

    @property
    def plant(self) -> tuple[np.ndarray, np.ndarray]:
        """Motor command to counts: numerator and denominator in z, the highest power first."""
        h, tau = self.sample, self.tau
        p = math.exp(-h / tau)
        first, second = h - tau * (1 - p), tau * (1 - p) - h * p
        return self.gain * np.array([first, second]), np.convolve([1.0, -1.0], [1.0, -p])

    @property
    def filter(self) -> tuple[np.ndarray, np.ndarray]:
        """D(z): counts to motor command."""
        t = self.tuning
        return t.gain / 4 * np.array([1.0, -t.zero / 256]), np.array([1.0, t.pole / 256])

    @property
    def poles(self) -> np.ndarray:
        """Of the closed loop, in z."""
        return np.roots(self._characteristic())

    def _characteristic(self) -> np.ndarray:
        (b, a), (n, d) = self.plant, self.filter
        return np.polyadd(np.convolve(a, d), np.convolve(b, n))

    def following_error(self, command: np.ndarray) -> np.ndarray:
        """Command minus position at each sample, counts, of an axis at rest before; command: (n,) counts at each sample.

        Raises StageError where scipy is missing.
        """
        try:
            from scipy.signal import lfilter
        except ImportError as error:
            raise StageError("the prediction needs scipy: pip install 'pulsestage[servo]'.") from error
        (b, a), (_, d) = self.plant, self.filter
        command = np.asarray(command, float)
        way = np.sign(np.diff(command, prepend=command[0]))
        closed = self._characteristic()
        b = np.concatenate([[0.0], b])  # as long as a: one sample late
        by_command = lfilter(np.convolve(a, d), closed, command - command[0])
        return by_command + lfilter(np.convolve(b, d), closed, self.friction * way)
