"""DC servo amplifier and motor, compiled: a motor command in, terminal voltage out.

    i = (v - K w) / R        T = K i

MuJoCo's <dcmotor> makes the torque from the voltage. The inductance is left out: L / R is little beside the mechanical time
constant J R / K^2 of a loaded axis. The current that is logged is that of the same formula.
"""

from __future__ import annotations

from stage.native import hot


@hot
def voltage(d, shares, n, omega):
    """Mean terminal voltage, V, over n slices; shares: (n,), the motor command of each as a share of full drive, -1 to 1."""
    total = 0.0
    for k in range(n):
        total += shares[k]
    v = d.voltage * total / n
    d.current_a = (v - d.torque_constant * omega) / d.resistance
    return v
