"""Two-phase hybrid stepper and its microstepping drive, compiled: pulses in, torque out.

    L di/dt = v - R i - e      e_a = -Km w sin(Nr th)   e_b = Km w cos(Nr th)
    T = Km (i_b cos(Nr th) - i_a sin(Nr th)) - Td sin(4 Nr th)

Over a slice of h seconds the rotor's speed is constant and so, nearly, is e: the phase current follows the exact
exponential i(h) = i + (v - e - R i) / R (1 - exp(-h R / L)). The drive's targets are I cos(phi), I sin(phi) with phi advancing
(pi / 2) / microsteps a pulse.

CHOPPER holds each phase on its target wherever +-V reaches within the slice, else at full voltage: a fixed-frequency chopper
without ripple. SINE is the ideal drive of the closed form min(T_V, T_I): an ideal current source of amplitude I up to the
speed where T_V falls below T_I, an ideal voltage source of amplitude V above. (No drive that is bound by both limits at once
reaches that corner: see dynamometer.bound_by_both.)

Equations: the two-phase model of drives.md (Simscape Electrical "Stepper Motor").
"""

from __future__ import annotations

import math

from stage.compiled import hot, record

CHOPPER, SINE = 0, 1

STEPPER = record(
    [
        (name, "f8")
        for name in (
            "resistance inductance torque_constant detent current voltage teeth per_pulse "  # what it is
            "offset current_a current_b slice decay"  # where it is; slice and decay cache 1 - exp(-h R / L)
        ).split()
    ]
    + [("mode", "i8")]
)
"""One motor and drive, SI units. `teeth`: rotor teeth Nr; `per_pulse`: electrical radians a pulse."""


@hot
def load_angle(d, count, theta):
    """Commanded minus rotor angle, electrical radians, not wrapped. count: pulses; theta: rotor angle, rad."""
    return d.offset + d.per_pulse * count - theta * d.teeth


@hot
def mechanical(d, angle):
    """Electrical to rotor radians."""
    return angle / d.teeth


@hot
def lost_steps(d, count, theta):
    """Full steps by which the rotor is behind its pulses: 4 for each electrical turn slipped."""
    return 4 * int(math.floor(load_angle(d, count, theta) / (2.0 * math.pi) + 0.5))


@hot
def align(d, count, theta):
    """Power up without a jump: put the field on the microstep nearest to the rotor, currents settled.

    A choice: a real drive powers up on its home microstep and pulls the rotor there, by up to two full steps. The
    currents are the targets, as if switched on long ago.
    """
    d.offset = math.floor(theta * d.teeth / d.per_pulse + 0.5) * d.per_pulse - d.per_pulse * count
    phi = d.offset + d.per_pulse * count
    d.current_a, d.current_b = d.current * math.cos(phi), d.current * math.sin(phi)


@hot
def _toward(i, target, v, e, r, decay):
    """The current after a slice: its target if a voltage within +-v takes it there, else as far as it gets."""
    low = i + ((-v - e) / r - i) * decay
    high = i + ((v - e) / r - i) * decay
    return min(max(target, low), high)


@hot
def _pull_out_voltage(d, omega):
    """T_V: the most that a voltage source of amplitude V holds at a speed (drives.md, 1)."""
    x = d.teeth * omega * d.inductance
    z2 = d.resistance * d.resistance + x * x
    return d.torque_constant * (d.voltage / math.sqrt(z2) - d.torque_constant * abs(omega) * d.resistance / z2)


@hot
def torque(d, count, theta, omega, h):
    """Advance the currents by h seconds; returns the mean torque on the rotor, N m.

    d: a STEPPER record. count: commanded pulses, mean over the slice; theta, omega: rotor angle (rad) and speed (rad/s) at its
    middle. The mean of a current is that of its ends, exact but for h R / (12 L) of its change.
    """
    if d.slice != h:
        d.slice = h
        d.decay = 1.0 - math.exp(-h * d.resistance / d.inductance)
    phi = d.offset + d.per_pulse * count
    alpha = theta * d.teeth
    s, c = math.sin(alpha), math.cos(alpha)
    ea, eb = -d.torque_constant * omega * s, d.torque_constant * omega * c
    ta, tb = d.current * math.cos(phi), d.current * math.sin(phi)
    a, b = d.current_a, d.current_b
    r = d.resistance
    if d.mode == CHOPPER:
        d.current_a = _toward(a, ta, d.voltage, ea, r, d.decay)
        d.current_b = _toward(b, tb, d.voltage, eb, r, d.decay)
    elif _pull_out_voltage(d, omega) >= d.torque_constant * d.current:
        d.current_a, d.current_b = ta, tb
        a, b = ta, tb
    else:
        scale = d.voltage / d.current
        d.current_a = a + ((ta * scale - ea) / r - a) * d.decay
        d.current_b = b + ((tb * scale - eb) / r - b) * d.decay
    ia, ib = 0.5 * (a + d.current_a), 0.5 * (b + d.current_b)
    return d.torque_constant * (ib * c - ia * s) - d.detent * 4.0 * s * c * (c * c - s * s)
