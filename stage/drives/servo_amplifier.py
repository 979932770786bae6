"""DC servo amplifier and motor, compiled: from a motor command to the terminal voltage.

    i = (v - K w) / R        T = K i

MuJoCo's <dcmotor> computes the torque from the voltage. The inductance is neglected, because L / R is small compared with the
mechanical time constant J R / K^2 of a loaded axis. The logged current follows from the same formula.

An amplifier with a current limit lowers its voltage to the value at which the limit flows.
"""

from __future__ import annotations

from stage.native import hot


@hot
def compute_mean_voltage(drive, shares, n_slices, omega, gain=0.0):
    """Compute the mean terminal voltage over `n_slices` slices, V.

    MuJoCo uses the back-EMF at the end of the physics step. So the current limit is computed for the speed expected there: the
    rotor gains as much speed as in the step before, between nothing (a load that holds it) and what the torque at the limit gives
    to a free rotor.

    Args:
        drive: DRIVE record of a servo.
        shares: Motor command of each slice as a fraction of full drive, -1 to 1, shape (n_slices,).
        n_slices: Number of slices.
        omega: Speed of the rotor at the beginning, rad/s.
        gain: Speed that one newton meter adds in half of the slices, rad/s.
    """
    total = 0.0
    for k in range(n_slices):
        total += shares[k]
    v = drive.voltage * total / n_slices
    drive.current_a = (v - drive.torque_constant * omega) / drive.resistance
    if drive.current > 0.0 and abs(drive.current_a) > drive.current:
        drive.current_a = drive.current if drive.current_a > 0.0 else -drive.current
        max_gain = 2.0 * gain * drive.torque_constant * drive.current_a
        faster = omega - drive.back
        if faster * max_gain <= 0.0:
            faster = 0.0
        elif abs(faster) > abs(max_gain):
            faster = max_gain
        v = drive.torque_constant * (omega + faster) + drive.resistance * drive.current_a
    drive.back = omega
    return v
