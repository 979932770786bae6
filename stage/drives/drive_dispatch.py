"""Functions that every drive offers to the engine. Each calls the stepper or the servo amplifier, as the DRIVE record's `mode`
says.

A stepper's chip commands pulses, a servo's chip the counts of its encoder: both are angles of the rotor. The quantity that goes to
the actuator, the drive's *effort*, is the torque of a stepper and the terminal voltage of a DC motor.
"""

from __future__ import annotations

from stage.drives import servo_amplifier, stepper
from stage.drives.stepper import DRIVE, SERVO
from stage.native import exported, hot

__all__ = [
    "DRIVE",
    "SERVO",
    "power_up",
    "make_rest_signal",
    "compute_lag",
    "compute_effort",
    "compute_load_angle",
    "count_lost_steps",
    "compute_torque",
    "compute_torque_change",
    "compute_voltage",
]


@hot
def compute_effort(drive, signal, n_slices, theta, omega, slice_s, gain=0.0):
    """Compute the mean effort over `n_slices` slices, N m or V.

    Args:
        drive: DRIVE record.
        signal: Output of the chip in each slice, shape (n_slices,): mean pulses so far, or shares of full drive.
        n_slices: Number of slices.
        theta: Rotor angle in the middle of the first slice, rad.
        omega: Speed of the rotor, rad/s.
        slice_s: Length of a slice, s.
        gain: Speed that one newton meter adds in half of the slices, rad/s.
    """
    if drive.mode == SERVO:
        return servo_amplifier.compute_mean_voltage(drive, signal, n_slices, omega, gain)
    return stepper.compute_mean_torque(drive, signal, n_slices, theta, omega, slice_s, gain)


@hot
def compute_torque(drive, effort):
    """Return the torque of the motor, N m, while `effort` acts on its actuator."""
    return drive.torque_constant * drive.current_a if drive.mode == SERVO else effort


@hot
def compute_torque_change(drive, effort_change, speed_change):
    """Return the change of the motor's torque, N m, that results from a change of effort and a change of speed, rad/s."""
    if drive.mode == SERVO:
        return drive.torque_constant * (effort_change - drive.torque_constant * speed_change) / drive.resistance
    return effort_change


@hot
def compute_voltage(drive, effort):
    """Return the terminal voltage of a DC motor, V; 0 for a stepper, because each of its phases has its own voltage."""
    return effort if drive.mode == SERVO else 0.0


@hot
def power_up(drive, count, theta):
    """Power up a stepper drive, see `stepper.power_up`. A servo does not change, because its encoder keeps the count."""
    if drive.mode != SERVO:
        stepper.power_up(drive, count, theta)


@hot
def make_rest_signal(drive, count):
    """Return the signal of `compute_effort` with which the motor stays at rest: the present count for a stepper, 0 for a servo."""
    return 0.0 if drive.mode == SERVO else float(count)


@exported("f8", DRIVE, "f8", "f8")
def compute_load_angle(drive, count, theta):
    """Return the commanded minus the actual rotor angle: electrical radians for a stepper, plain radians for a servo."""
    return stepper.compute_load_angle(drive, count, theta)


@exported("f8", DRIVE, "f8", "f8")
def compute_lag(drive, count, theta):
    """Return the commanded minus the actual rotor angle, mechanical radians."""
    return stepper.to_rotor_angle(drive, stepper.compute_load_angle(drive, count, theta))


@exported("i8", DRIVE, "f8", "f8")
def count_lost_steps(drive, count, theta):
    """Return the number of full steps by which the rotor of a stepper lags; 0 for a servo."""
    return 0 if drive.mode == SERVO else stepper.count_lost_steps(drive, count, theta)
