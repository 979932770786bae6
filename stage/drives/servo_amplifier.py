"""DC servo amplifier and motor, compiled: a motor command in, terminal voltage out.

    i = (v - K w) / R        T = K i

MuJoCo's <dcmotor> makes the torque from the voltage. The inductance is left out: L / R is little beside the mechanical time
constant J R / K^2 of a loaded axis. The current that is logged is that of the same formula.

An amplifier with a current limit lowers its voltage to the one at which the limit flows.
"""

from __future__ import annotations

from stage.native import hot


@hot
def compute_mean_voltage(drive, shares, n_slices, omega, gain=0.0):
    """Compute the mean terminal voltage, V, over n slices.

    MuJoCo takes the back-EMF at the end of the step. A current limit holds for the speed by then, if the rotor gains as much as in
    the step before: nothing against a load that holds it, and at most what the torque of the limit gives to a free one.

    Args:
        drive: DRIVE record of a servo.
        shares: (n,), the motor command of each slice as a share of full drive, -1 to 1.
        n_slices: Number of slices.
        omega: Speed of the rotor at the beginning, rad/s.
        gain: Speed that a newton metre adds in half of the n slices, rad/s.
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
