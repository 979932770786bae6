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

from stage.drives.trig import sincos
from stage.native import greatest, hot, least, record, room

CHOPPER, SINE, SERVO = range(3)  # modes
A, B = 1, 2  # phases
SLICES = 8  # that the engine cuts a physics step into
ENDS = SLICES + 1

DRIVE = record(
    [
        (name, "f8")
        for name in (
            "resistance inductance torque_constant detent current voltage teeth per_pulse "  # what it is
            "offset current_a current_b "  # where it is
            "slice keep reach back"  # of a slice of so many seconds: see torque()
        ).split()
    ]
    + [("mode", "i8"), ("open", "i8")]
)
"""One motor and drive, SI units, or a SERVO: see servo.py; `per_pulse` is then the rotor's angle a count of the encoder, `teeth` 1,
`current` the amplifier's current limit, 0 for none.
`teeth`: rotor teeth Nr; `per_pulse`: electrical radians a pulse; `open`: the phases that are
open, A + B; whoever sets a parameter sets `slice` to 0."""
SIN, COS, CURRENT_A, CURRENT_B, ROTOR_SIN, ROTOR_COS, TORQUE, WAYS = range(8)
"""What `mean_torque` knows of each slice: the commanded phase; the currents' targets, after the currents at the beginning; the
rotor's phase; the torque."""


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
    s, c = sincos(phi)
    d.current_a, d.current_b = d.current * c, d.current * s


@hot
def _prepare(d, h):
    """What a slice of h seconds leaves of a current, what the bus voltage adds, and what back-EMF takes a (rad/s)."""
    d.slice = h
    d.keep = math.exp(-h * d.resistance / d.inductance)
    d.reach = (1.0 - d.keep) * d.voltage / d.resistance
    d.back = (1.0 - d.keep) * d.torque_constant / d.resistance


@hot
def _pull_out_voltage(d, omega):
    """T_V: the most that a voltage source of amplitude V holds at a speed (drives.md, 1)."""
    x = d.teeth * omega * d.inductance
    z2 = d.resistance * d.resistance + x * x
    return d.torque_constant * (d.voltage / math.sqrt(z2) - d.torque_constant * abs(omega) * d.resistance / z2)


@hot
def _slice(d, a, b, ta, tb, s, c, omega):
    """The currents at the end of a slice that they begin as a, b, and their means.

    ta, tb: cosine and sine of the commanded phase; s, c: sine and cosine of the rotor's. The mean of a current is that of its
    ends, exact but for h R / (12 L) of its change.
    """
    push = d.back * omega
    ia, ib = d.current * ta, d.current * tb
    if d.mode == CHOPPER:  # on target if a voltage within the bus takes it there, else as far as it gets
        ia = least(greatest(ia, a * d.keep + (push * s - d.reach)), a * d.keep + (push * s + d.reach))
        ib = least(greatest(ib, b * d.keep - (push * c + d.reach)), b * d.keep - (push * c - d.reach))
    elif _pull_out_voltage(d, omega) < d.torque_constant * d.current:
        ia = a * d.keep + (push * s + d.reach * ta)
        ib = b * d.keep - (push * c - d.reach * tb)
    else:
        a, b = ia, ib
    return ia, ib, 0.5 * (a + ia), 0.5 * (b + ib)


@hot
def _torque(constant, detent, ia, ib, s, c):
    return constant * (ib * c - ia * s) - detent * 4.0 * s * c * (c * c - s * s)


@hot
def _along(d, ways, n, theta, pace, omega, h):
    """n slices of h seconds, of a rotor that turns at `pace` and whose back-EMF is that of `omega`: the mean torque and the last
    currents. theta: in the middle of the first. An open phase carries no current, whatever the drive wants."""
    s, c = sincos(theta * d.teeth)
    turn_s, turn_c = sincos(pace * h * d.teeth)  # the rotor turns by as much in every slice
    a, b, opened = d.current_a, d.current_b, d.open
    total = 0.0
    for k in range(n):
        a, b, mean_a, mean_b = _slice(d, a, b, ways[COS, k], ways[SIN, k], s, c, omega)
        if opened & A:
            a = mean_a = 0.0
        if opened & B:
            b = mean_b = 0.0
        total += _torque(d.torque_constant, d.detent, mean_a, mean_b, s, c)
        s, c = s * turn_c + c * turn_s, c * turn_c - s * turn_s
    return total / n, a, b


@hot
def _along_within_reach(d, ways, n, theta, pace, omega, h):
    """`_along` of a CHOPPER whose bus voltage takes both currents to their targets in every slice: no slice then waits for the one
    before, to the same bits. Returns as well whether it was so; otherwise the torque means nothing."""
    s, c = sincos(theta * d.teeth)
    turn_s, turn_c = sincos(pace * h * d.teeth)
    for k in range(n):
        ways[ROTOR_SIN, k], ways[ROTOR_COS, k] = s, c
        s, c = s * turn_c + c * turn_s, c * turn_c - s * turn_s
    keep, reach, push = d.keep, d.reach, d.back * omega
    constant, detent, outside = d.torque_constant, d.detent, 0
    for k in range(n):
        s, c = ways[ROTOR_SIN, k], ways[ROTOR_COS, k]
        before_a, before_b, a, b = (
            ways[CURRENT_A, k],
            ways[CURRENT_B, k],
            ways[CURRENT_A, k + 1],
            ways[CURRENT_B, k + 1],
        )
        low_a, high_a = before_a * keep + (push * s - reach), before_a * keep + (push * s + reach)
        low_b, high_b = before_b * keep - (push * c + reach), before_b * keep - (push * c - reach)
        outside |= (a < low_a) | (high_a < a) | (b < low_b) | (high_b < b)
        mean_a, mean_b = 0.5 * (before_a + a), 0.5 * (before_b + b)
        ways[TORQUE, k] = _torque(constant, detent, mean_a, mean_b, s, c)
    total = 0.0
    for k in range(n):
        total += ways[TORQUE, k]
    return total / n, outside == 0


@hot
def mean_torque(d, counts, n, theta, omega, h, gain=0.0):
    """Advance the currents by n slices of h seconds at constant speed; returns the mean torque on the rotor, N m.

    d: a DRIVE record. counts: (n,), n up to SLICES: commanded pulses, mean over each slice; theta: rotor angle (rad) in the
    middle of the first; omega: rad/s. gain: rad/s that a newton metre adds to the speed in half of the n slices.

    A leapfrog's speed is half a window old. The mean of a torque along a path of that speed comes late and feeds energy in,
    enough for a rotor without friction to run away. So the path gets the speed of its middle, by the torque of a first try.
    """
    if d.slice != h:
        _prepare(d, h)
    ways = room(WAYS, ENDS)
    offset, per_pulse, current = d.offset, d.per_pulse, d.current
    for k in range(n):
        s, c = sincos(offset + per_pulse * counts[k])
        ways[SIN, k], ways[COS, k] = s, c
        ways[CURRENT_A, k + 1], ways[CURRENT_B, k + 1] = current * c, current * s
    ways[CURRENT_A, 0], ways[CURRENT_B, 0] = d.current_a, d.current_b
    a, b, torque = ways[CURRENT_A, n], ways[CURRENT_B, n], 0.0
    within = d.mode == CHOPPER and d.open == 0
    if within:
        torque, within = _along_within_reach(d, ways, n, theta, omega, omega, h)
    if not within:
        torque, a, b = _along(d, ways, n, theta, omega, omega, h)
    if gain != 0.0:
        more = gain * torque
        theta -= 0.5 * (n - 1) * h * more
        pace = omega + more
        if within:
            torque, within = _along_within_reach(d, ways, n, theta, pace, omega, h)
        if not within:
            torque, a, b = _along(d, ways, n, theta, pace, omega, h)
    d.current_a, d.current_b = a, b
    return torque


@hot
def torque(d, count, theta, omega, h):
    """`mean_torque` of one slice; for benches, where no phase is open."""
    if d.slice != h:
        _prepare(d, h)
    tb, ta = sincos(d.offset + d.per_pulse * count)
    s, c = sincos(theta * d.teeth)
    d.current_a, d.current_b, mean_a, mean_b = _slice(d, d.current_a, d.current_b, ta, tb, s, c, omega)
    return _torque(d.torque_constant, d.detent, mean_a, mean_b, s, c)
