"""Two-phase hybrid stepper and its microstepping drive, compiled: pulses in, torque out.

    L di/dt = v - R i - e      e_a = -Km w sin(Nr th)   e_b = Km w cos(Nr th)
    T = Km (i_b cos(Nr th) - i_a sin(Nr th)) - Td sin(4 Nr th)

Over a slice of h seconds the rotor's speed is constant and so, nearly, is e: the phase current follows the exact
exponential i(h) = i + (v - e - R i) / R (1 - exp(-h R / L)). The drive's targets are I cos(phi), I sin(phi) with phi advancing
(pi / 2) / microsteps a pulse.

CHOPPER holds each phase on its target wherever +-V reaches within the slice, else at full voltage: a fixed-frequency chopper
without ripple. SINE is the ideal drive of the closed form min(T_V, T_I): an ideal current source of amplitude I up to the
speed where T_V falls below T_I, an ideal voltage source of amplitude V above. (No drive that is bound by both limits at once
reaches that corner: see dynamometer.compute_torque_bound.)

Equations: the two-phase model of drives.md (Simscape Electrical "Stepper Motor").
"""

from __future__ import annotations

import math

import numpy as np

from stage.drives.trig import SMALL_ANGLE_RAD, add_angles, compute_sincos, compute_sincos_of_small_angle
from stage.native import allocate_on_stack, greatest, hot, least, record

CHOPPER, SINE, SERVO = range(3)  # modes
A, B = 1, 2  # phases
SLICES = 8  # that the engine cuts a physics step into; mean_torque counts on 8
SLICE_END_OFFSETS = np.array([-3.0, -2.0, -1.0, -1.0, 1.0, 2.0, 3.0, 4.0])
"""Ends of the slices, in slices from the middle of the window; -1: it ends in the middle, see `_compute_target_angles`."""
MIDDLE_SLICE = SLICES // 2 - 1  # the slice that ends in the middle of a window

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
"""One motor and drive, SI units, or a SERVO: see servo_amplifier.py; `per_pulse` is then the rotor's angle a count of the
encoder, `teeth` 1, `current` the amplifier's current limit, 0 for none, and `back` the speed of the rotor at the step before,
rad/s. `teeth`: rotor teeth Nr; `per_pulse`: electrical radians a pulse; `open`: the phases that are open, A + B; whoever sets a
parameter sets `slice` to 0."""
SIN, COS, WAVES = range(3)
"""What `compute_mean_torque` keeps of each slice: sine and cosine of an angle."""


@hot
def compute_load_angle(drive, count, theta):
    """Return commanded minus rotor angle, electrical radians, not wrapped.

    Args:
        drive: DRIVE record.
        count: Pulses.
        theta: Rotor angle, rad.
    """
    return drive.offset + drive.per_pulse * count - theta * drive.teeth


@hot
def to_rotor_angle(drive, angle):
    """Convert an angle of the stepper motor from electrical to rotor radians."""
    return angle / drive.teeth


@hot
def count_lost_steps(drive, count, theta):
    """Return the full steps by which the rotor lags its pulses: 4 for each electrical turn slipped."""
    return 4 * int(math.floor(compute_load_angle(drive, count, theta) / (2.0 * math.pi) + 0.5))


@hot
def power_up(drive, count, theta):
    """Power up without a jump: put the field on the microstep nearest to the rotor, with the currents at their targets.

    This is a simplification: a real drive powers up on its home microstep and pulls the rotor there, by up to two full
    steps.
    """
    drive.offset = math.floor(theta * drive.teeth / drive.per_pulse + 0.5) * drive.per_pulse - drive.per_pulse * count
    phi = drive.offset + drive.per_pulse * count
    s, c = compute_sincos(phi)
    drive.current_a, drive.current_b = drive.current * c, drive.current * s


@hot
def _compute_slice_constants(drive, slice_s):
    """Compute the constants of the currents' differential equation for a slice of `slice_s` seconds.

    Returns:
        Fraction of a current that is left at the end of the slice, the current that the bus voltage adds, and the current that the
        back-EMF takes for each rad/s.
    """
    drive.slice = slice_s
    drive.keep = math.exp(-slice_s * drive.resistance / drive.inductance)
    drive.reach = (1.0 - drive.keep) * drive.voltage / drive.resistance
    drive.back = (1.0 - drive.keep) * drive.torque_constant / drive.resistance


@hot
def _compute_voltage_limited_torque(drive, omega):
    """Return T_V: the largest torque that a voltage source of amplitude V sustains at a speed (spec/drives.md, 1)."""
    x = drive.teeth * omega * drive.inductance
    z2 = drive.resistance * drive.resistance + x * x
    return drive.torque_constant * (
        drive.voltage / math.sqrt(z2) - drive.torque_constant * abs(omega) * drive.resistance / z2
    )


@hot
def _can_follow_sine(drive, omega):
    """Return whether the bus voltage of a sine drive keeps the currents at their targets at this speed."""
    return drive.mode == SINE and _compute_voltage_limited_torque(drive, omega) >= drive.torque_constant * drive.current


@hot
def _advance_slice(drive, current_a, current_b, cos_target, sin_target, sin_rotor, cos_rotor, omega, sine_held):
    """Compute the currents at the end of a slice, and their means over the slice.

    The mean of a current is that of its values at both ends, which is exact to h R / (12 L) of the change.

    Args:
        drive: DRIVE record.
        current_a: Current of phase A at the beginning, A.
        current_b: Current of phase B at the beginning, A.
        cos_target: Cosine of the commanded electrical angle.
        sin_target: Sine of the commanded electrical angle.
        sin_rotor: Sine of the rotor's electrical angle.
        cos_rotor: Cosine of the rotor's electrical angle.
        omega: Speed of the rotor, rad/s.
        sine_held: Result of `_can_follow_sine`.
    """
    push = drive.back * omega
    ia, ib = drive.current * cos_target, drive.current * sin_target
    if drive.mode == CHOPPER:  # on target if a voltage within the bus takes it there, else as far as it gets
        ia = least(
            greatest(ia, current_a * drive.keep + (push * sin_rotor - drive.reach)),
            current_a * drive.keep + (push * sin_rotor + drive.reach),
        )
        ib = least(
            greatest(ib, current_b * drive.keep - (push * cos_rotor + drive.reach)),
            current_b * drive.keep - (push * cos_rotor - drive.reach),
        )
    elif sine_held:
        current_a, current_b = ia, ib
    else:
        ia = current_a * drive.keep + (push * sin_rotor + drive.reach * cos_target)
        ib = current_b * drive.keep - (push * cos_rotor - drive.reach * sin_target)
    return ia, ib, 0.5 * (current_a + ia), 0.5 * (current_b + ib)


@hot
def _compute_target_angles(drive, waves, counts, n_slices, turn, omega):
    """Write the angle from the rotor to the target of the currents at the end of each slice into `waves`.

    An entry is the sine and cosine of that angle, relative to the angle of the slice that ends in the middle of the window. The
    entry of that slice itself is sine and cosine of `turn`.

    Returns:
        Whether these angles are small and the bus voltage takes the currents from target to target.
    """
    per_pulse, middle = drive.per_pulse, counts[MIDDLE_SLICE]
    allowed = drive.reach - abs(drive.back * omega) - drive.current * (1.0 - drive.keep)
    outside = False
    for k in range(n_slices):
        angle = per_pulse * (counts[k] - middle) - turn * SLICE_END_OFFSETS[k]
        outside |= abs(angle) > SMALL_ANGLE_RAD
        waves[SIN, k], waves[COS, k] = compute_sincos_of_small_angle(angle)
    for k in range(1, n_slices):
        outside |= drive.current * per_pulse * abs(counts[k] - counts[k - 1]) > allowed
    return not outside


@hot
def _advance_on_targets(
    drive, waves, sin_rotor, cos_rotor, sin_target, cos_target, sin_half_turn, cos_half_turn, omega
):
    """Advance the currents of a chopper that reaches its target in every slice, so that slices do not depend on each other.

    Args:
        drive: DRIVE record.
        waves: Sines and cosines of the targets, as `_compute_target_angles` leaves them.
        sin_rotor: Sine of the rotor's phase in the middle of the window.
        cos_rotor: Cosine of the rotor's phase in the middle of the window.
        sin_target: Sine of the target at the end of the slice that ends in the middle of the window.
        cos_target: Cosine of that target.
        sin_half_turn: Sine of the angle by which the rotor turns in half of the window.
        cos_half_turn: Cosine of that angle.
        omega: Speed of the rotor, rad/s.

    Returns:
        Sum over the slices of the current across the rotor, which makes torque, A; sum of that along the rotor, times the distance
        from the middle in slices, A; whether the first target is reached. Otherwise nothing has changed.
    """
    x, y, current = waves[SIN], waves[COS], drive.current
    target_s, target_c = current * x[0], current * y[0]
    sin_target, cos_target = add_angles(sin_target, cos_target, -sin_rotor, cos_rotor)
    # the currents at the beginning, as the rotor sees them then and at the end of the first slice
    across, along = add_angles(drive.current_b, drive.current_a, -sin_rotor, cos_rotor)
    across, along = add_angles(across, along, sin_half_turn, cos_half_turn)
    then_s, then_c = add_angles(across, along, -x[MIDDLE_SLICE], y[MIDDLE_SLICE])
    target_s, target_c = add_angles(target_s, target_c, sin_target, cos_target)
    change_s, change_c = target_s - drive.keep * then_s, target_c - drive.keep * then_c
    reach = drive.reach - abs(drive.back * omega)
    if change_s * change_s + change_c * change_c > reach * reach:
        return 0.0, 0.0, False
    sum_s = ((x[0] + x[6]) + (x[1] + x[5])) + ((x[2] + x[4]) + 0.5 * x[7])
    sum_c = ((y[0] + y[6]) + (y[1] + y[5])) + ((y[2] + y[4]) + 0.5 * y[7]) + 1.0
    moment_s = (3.0 * (x[6] - x[0]) + 2.0 * (x[5] - x[1])) + (x[4] - x[2]) + 2.0 * x[7]
    moment_c = (3.0 * (y[6] - y[0]) + 2.0 * (y[5] - y[1])) + (y[4] - y[2]) + 2.0 * y[7]
    last_s, last_c = add_angles(x[7], y[7], sin_target, cos_target)
    last_s, last_c = add_angles(last_s, last_c, sin_half_turn, cos_half_turn)
    last_s, last_c = add_angles(last_s, last_c, sin_rotor, cos_rotor)
    drive.current_a, drive.current_b = current * last_c, current * last_s
    total = current * (sum_s * cos_target + sum_c * sin_target) + 0.5 * across
    return total, current * (moment_c * cos_target - moment_s * sin_target) - 2.0 * along, True


@hot
def _advance_by_slices(drive, waves, counts, n_slices, sin_rotor, cos_rotor, sin_turn, cos_turn, omega, half_turn):
    """Advance the currents slice by slice, for every kind of drive and bus voltage; see `_advance_on_targets`.

    An open phase carries no current, whatever the drive commands.

    Args:
        drive: DRIVE record.
        waves: Gets the sine and cosine of the target of each slice.
        counts: Pulses commanded at each slice.
        n_slices: Number of slices.
        sin_rotor: Sine of the rotor's phase at the beginning of the window.
        cos_rotor: Cosine of the rotor's phase at the beginning of the window.
        sin_turn: Sine of the angle by which the rotor turns in each slice.
        cos_turn: Cosine of that angle.
        omega: Speed of the rotor, rad/s.
        half_turn: Electrical radians by which the rotor turns in half a slice.
    """
    for k in range(n_slices):
        waves[SIN, k], waves[COS, k] = compute_sincos(drive.offset + drive.per_pulse * counts[k])
    a, b, opened = drive.current_a, drive.current_b, drive.open
    hs, hc = compute_sincos(half_turn)
    sine_held = _can_follow_sine(drive, omega)
    total = tilt = 0.0
    if not sine_held:
        total, tilt = 0.5 * (b * cos_rotor - a * sin_rotor), -0.5 * (SLICES // 2) * (a * cos_rotor + b * sin_rotor)
    for k in range(n_slices):
        middle_s, middle_c = add_angles(sin_rotor, cos_rotor, hs, hc)
        a, b, _, _ = _advance_slice(drive, a, b, waves[COS, k], waves[SIN, k], middle_s, middle_c, omega, sine_held)
        if opened & A:
            a = 0.0
        if opened & B:
            b = 0.0
        sin_rotor, cos_rotor = add_angles(sin_rotor, cos_rotor, sin_turn, cos_turn)
        if sine_held:  # the currents are those of the middle of the slice, where the mean count belongs
            total += b * middle_c - a * middle_s
            tilt += (k + 0.5 - SLICES // 2) * (a * middle_c + b * middle_s)
            continue
        weight = 0.5 if k == n_slices - 1 else 1.0
        total += weight * (b * cos_rotor - a * sin_rotor)
        tilt += weight * (k + 1 - SLICES // 2) * (a * cos_rotor + b * sin_rotor)
    drive.current_a, drive.current_b = a, b
    return total, tilt


@hot
def compute_mean_torque(drive, counts, n_slices, theta, omega, slice_s, gain=0.0):
    """Advance the currents by a window of SLICES slices, and return the mean torque on the rotor, N m.

    The mean is that of the torques at the ends of the slices, with half weight for the first and the last; it is exact for
    everything that is periodic in an electrical turn. The speed of a leapfrog is half a window old. Torque along a path with that
    speed would come
    late and feed in enough energy for a rotor without friction to run away. So the path gets the speed of its middle: T = T(omega +
    gain T), solved with the slope of T, which is small. The currents get the back-EMF of omega.

    Args:
        drive: DRIVE record of a stepper.
        counts: Commanded pulses, mean over each slice, shape (SLICES,).
        n_slices: SLICES, as a number that the compiler does not know. With a constant it would unroll the loops instead of
            vectorizing them.
        theta: Rotor angle in the middle of the window, rad.
        omega: Speed of the rotor half a window earlier, rad/s.
        slice_s: Length of a slice, s.
        gain: Speed that one newton meter adds in half of the window, rad/s.
    """
    if drive.slice != slice_s:
        _compute_slice_constants(drive, slice_s)
    waves = allocate_on_stack(WAVES, SLICES)
    s, c = compute_sincos(theta * drive.teeth)
    psi_s, psi_c = compute_sincos(drive.offset + drive.per_pulse * counts[MIDDLE_SLICE])
    turn = omega * slice_s * drive.teeth
    on_target = (
        drive.mode == CHOPPER
        and drive.open == 0
        and _compute_target_angles(drive, waves, counts, n_slices, turn, omega)
    )
    if on_target:
        s1, c1 = waves[SIN, MIDDLE_SLICE], waves[COS, MIDDLE_SLICE]
    else:
        s1, c1 = compute_sincos(turn)
    s2, c2 = add_angles(s1, c1, s1, c1)
    s4, c4 = add_angles(s2, c2, s2, c2)
    s8, c8 = add_angles(s4, c4, s4, c4)
    total = tilt = 0.0
    if on_target:
        total, tilt, on_target = _advance_on_targets(drive, waves, s, c, psi_s, psi_c, s4, c4, omega)
    if not on_target:
        begin_s, begin_c = add_angles(s, c, -s4, c4)
        total, tilt = _advance_by_slices(drive, waves, counts, n_slices, begin_s, begin_c, s1, c1, omega, 0.5 * turn)
    # of SLICES angles in equal steps the mean sine is that of the middle times c2 c4 c8
    detent = drive.detent * 4.0 * s * c * (c * c - s * s)
    constant = drive.torque_constant / SLICES
    torque = constant * total - detent * c2 * c4 * c8
    slope = 2.0 * detent * (s2 * c4 * c8 + 2.0 * c2 * s4 * c8 + 4.0 * c2 * c4 * s8) - constant * tilt
    return torque / (1.0 - least(greatest(gain * slope * slice_s * drive.teeth, -0.5), 0.5))


@hot
def compute_slice_torque(drive, count, theta, omega, slice_s):
    """Advance the currents by one slice, and return the mean torque, N m. For test benches, on which no phase is open.

    Args:
        drive: DRIVE record.
        count: Commanded pulses, mean over the slice.
        theta: Rotor angle in the middle of the slice, rad.
        omega: Speed of the rotor, rad/s.
        slice_s: Length of the slice, s.
    """
    if drive.slice != slice_s:
        _compute_slice_constants(drive, slice_s)
    tb, ta = compute_sincos(drive.offset + drive.per_pulse * count)
    s, c = compute_sincos(theta * drive.teeth)
    sine_held = _can_follow_sine(drive, omega)
    drive.current_a, drive.current_b, mean_a, mean_b = _advance_slice(
        drive, drive.current_a, drive.current_b, ta, tb, s, c, omega, sine_held
    )
    return drive.torque_constant * (mean_b * c - mean_a * s) - drive.detent * 4.0 * s * c * (c * c - s * s)
