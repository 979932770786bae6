"""Model of a servo axis with an HCTL-1100 as a linear sampled system, computed from the data of the machine without measurements.

    loop = ServoLoop.from_axis(port.axis, tuning)
    error = loop.compute_following_error(command)       counts, sample by sample; command: counts
    tuning = design_filter(loop)                        gain and zero by frequency response

The plant is a DC motor that drives a mass; its voltage is constant during a sample:

    m dv/dt = F u - (d + back-EMF) v - friction      G(s) = gain / s (1 + tau s)

Its transfer function in z is exact. The model omits rounding, saturation, the physics step and play. Coulomb friction is constant
while the axis moves in one direction, so the model treats it as an input. `compute_following_error` needs SciPy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stage.chips.hctl1100.motor_port import FULL_DRIVE
from stage.errors import StageError
from stage.firmware.hctl1100.moves import FilterTuning
from stage.support.extras import import_extra

PHASE_MARGIN_DEGREES = 60.0  # degrees
MAX_RATTLE = 48.0  # units of motor command for one count
DEFAULT_POLE = 64  # as after a reset; the pole is at -1/4
MIN_CROSSOVER_RATIO = 0.9  # of the highest crossover, from which on a zero is as good
CANDIDATE_ZEROS = range(64, 256)


@dataclass(frozen=True)
class ServoLoop:
    """Model of a servo axis: its plant (motor, load and encoder) and the filter of its HCTL-1100.

    Attributes:
        gain: Speed per unit of motor command, counts/s, without friction.
        tau: Time constant of the plant, s.
        friction: Friction in units of motor command.
        tuning: Filter and sample timer.
        clock_hz: Reference clock of the chip, Hz.
    """

    gain: float
    tau: float
    friction: float
    tuning: FilterTuning
    clock_hz: int = 2_000_000

    @classmethod
    def from_axis(cls, axis: Any, tuning: FilterTuning) -> ServoLoop:
        """Compute the model of a stage's axis from its present masses, friction, motor and encoder.

        Args:
            axis: Axis of a stage.
            tuning: Filter and sample timer.
        """
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
        """Sample time of the HCTL-1100, s."""
        return 16 * (self.tuning.timer + 1) / self.clock_hz

    @property
    def plant(self) -> tuple[np.ndarray, np.ndarray]:
        """Transfer function from motor command to counts: numerator and denominator in z, the highest power first."""
        h, tau = self.sample, self.tau
        p = math.exp(-h / tau)
        first, second = h - tau * (1 - p), tau * (1 - p) - h * p
        return self.gain * np.array([first, second]), np.convolve([1.0, -1.0], [1.0, -p])

    @property
    def filter(self) -> tuple[np.ndarray, np.ndarray]:
        """Transfer function D(z) of the HCTL-1100's filter, from counts to motor command."""
        t = self.tuning
        return t.gain / 4 * np.array([1.0, -t.zero / 256]), np.array([1.0, t.pole / 256])

    @property
    def poles(self) -> np.ndarray:
        """Poles of the closed servo loop, in z."""
        return np.roots(self._compute_characteristic_polynomial())

    def _compute_characteristic_polynomial(self) -> np.ndarray:
        """Return the characteristic polynomial of the closed loop in z, the highest power first."""
        (b, a), (n, d) = self.plant, self.filter
        return np.polyadd(np.convolve(a, d), np.convolve(b, n))

    def compute_following_error(self, command: np.ndarray) -> np.ndarray:
        """Compute command minus position at each sample for an axis that was at rest before.

        Args:
            command: Command positions at each sample, counts (n,).

        Returns:
            Errors, counts (n,).

        Raises:
            ExtraMissing: SciPy is not installed.
        """
        lfilter = import_extra("scipy.signal", "the prediction").lfilter
        (b, a), (_, d) = self.plant, self.filter
        command = np.asarray(command, float)
        velocity_sign = np.sign(np.diff(command, prepend=command[0]))
        closed = self._compute_characteristic_polynomial()
        b = np.concatenate([[0.0], b])  # as long as a: one sample late
        by_command = lfilter(np.convolve(a, d), closed, command - command[0])
        return by_command + lfilter(np.convolve(b, d), closed, self.friction * velocity_sign)


def design_filter(loop: ServoLoop, margin: float = PHASE_MARGIN_DEGREES, rattle: float = MAX_RATTLE) -> FilterTuning:
    """Design the gain and the zero of the filter for this plant by frequency response; pole and T stay as they are.

    For every possible zero, the function computes the highest crossover frequency with a phase margin of `margin` degrees, and its
    gain. Among the zeros with nearly the highest crossover frequency it chooses the lowest one, which is the stiffest at rest.

    Args:
        loop: Plant and filter.
        margin: Phase margin, degrees.
        rattle: Largest change of the motor command after one count of the encoder, units of motor command. It limits the gain,
            because a fast filter turns each count of a coarse encoder into a jerk.

    Returns:
        The filter.

    Raises:
        StageError: No zero reaches the margin.
    """
    candidates = []
    omega = np.geomspace(1.0, 0.9 * np.pi / loop.sample, 2000)
    z = np.exp(1j * omega * loop.sample)
    plant = np.polyval(loop.plant[0], z) / np.polyval(loop.plant[1], z)
    for zero in CANDIDATE_ZEROS:
        unit = replace(loop, tuning=replace(loop.tuning, gain=4, zero=zero))  # K/4 = 1
        response = plant * np.polyval(unit.filter[0], z) / np.polyval(unit.filter[1], z)
        phase = np.degrees(np.unwrap(np.angle(response))) + 180
        phase -= 360 * np.round(phase[0] / 360)
        enough = np.flatnonzero((phase >= margin) & (1 / np.abs(response) <= rattle) & (4 / np.abs(response) <= 0xFF))
        if len(enough):
            k = enough[-1]
            gain = max(round(4 / float(np.abs(response[k]))), 1)
            candidates.append((omega[k], replace(loop.tuning, gain=gain, zero=zero)))
    if not candidates:
        raise StageError(f"no zero gives a phase margin of {margin:g} degrees with a gain that the chip holds.")
    highest = max(crossover for crossover, _ in candidates)
    return next(tuning for crossover, tuning in candidates if crossover > MIN_CROSSOVER_RATIO * highest)
