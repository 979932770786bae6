"""Test bench for a motor and its drive without a stage: a rotor with an inertia and a brake.

    trace = simulate_motor(drive, compute_mean_counts(rates), inertia=...)       one run with the values of every slice
    simulate_pull_out(drive, rpm), find_pull_in_rate(drive, inertia), measure_swing_frequency(drive, inertia),
    sweep_resonance(drive, rates)

A compiled loop integrates the motion by the same leapfrog as the engine of a stage, with the same compiled drive, in slices of
15.625 us (half of the engine's). Pulses come whole, as from a chip. Nothing is random: equal calls give equal bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from stage.drives import stepper
from stage.drives.motors import Drive, Motor, check_in_range, find_motor
from stage.errors import ArgumentError
from stage.native import array_of, exported, greatest, hot, least, record

SLICE_S = 15.625e-6
BRAKE_ONSET_S, BRAKE_HOLD_S = 0.3, 0.3  # s: the brake's onset, and how long it then holds
SLIP_ANGLE_RAD = math.pi  # electrical radians from which a braked rotor does not come back
ROTORS_SIDE_BY_SIDE = 4  # that a processor works on at the same time; more are hardly faster
DEFAULT_DAMPING_N_M_S = 2e-4  # N m s/rad: bearings and grease of a small axis

TRACE = record([(name, "f8") for name in "count theta omega torque current_a current_b".split()])
"""One slice: mean commanded pulses, rotor angle (rad) at its middle, speed (rad/s), motor torque (N m), currents (A)."""

Floats = Sequence[float] | np.ndarray


class PullOutCurve(NamedTuple):
    """Pull-out curve: the largest torque at each speed with which a motor keeps step.

    Attributes:
        rpm: Speeds, (n,).
        chopper, sine: Torque simulated with the drive and with an ideal sine drive, N m, (n,).
        ideal, ideal_saturated: Closed forms at V and at 4/pi V (all that a saturated chopper can reach), N m, (n,).
        bound_by_both: Closed form of a sine drive bound by V and I at once, N m, (n,).
        steps_per_turn: Full steps of a turn.
    """

    rpm: np.ndarray
    chopper: np.ndarray
    sine: np.ndarray
    ideal: np.ndarray
    ideal_saturated: np.ndarray
    bound_by_both: np.ndarray
    steps_per_turn: int = 200

    def __str__(self) -> str:
        head = f"{'rpm':>6}{'pps, full step':>16}{'simulated':>11}{'sine drive':>12}{'closed form':>13}{'at 4/pi V':>11}   N m"
        rows = [
            f"{r:>6.0f}{r / 60 * self.steps_per_turn:>16.0f}{c:>11.3f}{s:>12.3f}{i:>13.3f}{j:>11.3f}"
            for r, c, s, i, j in zip(*self[:5], strict=True)
        ]
        return "\n".join([head, *rows])


def compute_closed_form_torque(motor: Motor | str, volts: float, current: float, rpm: Floats | float) -> np.ndarray:
    """Compute the pull-out torque of an ideal sine drive, N m, in closed form: min(T_V, T_I) - b w, at least 0 (spec/drives.md, 1).

    Z = sqrt(R^2 + (Nr w L)^2), T_V = Km (V / Z - Km w R / Z^2), T_I = Km I; b is the motor's core loss.

    Args:
        motor: Motor or name of a preset.
        volts: Supply voltage V.
        current: Amplitude I of the phase currents, A.
        rpm: Speeds, a number or an array; the result has the same shape.
    """
    motor, w = find_motor(motor), np.asarray(rpm, float) * 2 * math.pi / 60
    km, r = motor.torque_constant, motor.resistance
    z = np.hypot(r, motor.rotor_teeth * w * motor.phase_inductance)
    return np.clip(
        np.minimum(km * (volts / z - km * w * r / z**2), km * current) - motor.core_loss_damping * w, 0, None
    )


def compute_torque_bound(motor: Motor | str, volts: float, current: float, rpm: Floats | float) -> np.ndarray:
    """Compute the largest torque of sinusoidal currents that respect both limits at once, |i| <= current and |v| <= volts, N m.

    The motor's core loss is subtracted. In rotor coordinates the back-EMF E = Km w is real, v = Z i + E with Z = R + j Nr w L, and
    the torque is Km Re i. The currents that V allows fill the circle of radius V / |Z| around -E / Z. Its rightmost point is T_V;
    where that
    point needs more than `current`, the best current is at the intersection of the two circles. Near its corner, the closed form
    min(T_V, T_I) is larger.

    Args:
        motor: Motor or name of a preset.
        volts: Supply voltage V.
        current: Amplitude of the phase currents, A.
        rpm: Speeds, a number or an array; the result has the same shape.
    """
    motor, w = find_motor(motor), np.asarray(rpm, float) * 2 * math.pi / 60
    z = motor.resistance + 1j * motor.rotor_teeth * w * motor.phase_inductance
    centre, radius = -motor.torque_constant * w / z, volts / np.abs(z)
    rated_fits = np.abs(current - centre) <= radius  # all of the current on the torque axis
    voltage_fits = np.abs(centre + radius) <= current
    distance = np.maximum(np.abs(centre), 1e-12)
    along = (current**2 - radius**2 + distance**2) / (2 * distance)
    across = np.sqrt(np.maximum(current**2 - along**2, 0))
    crossing = ((along + np.array([[1j], [-1j]]) * across.ravel()) * (centre / distance).ravel()).real.max(0)
    best = np.where(rated_fits, current, np.where(voltage_fits, (centre + radius).real, crossing.reshape(w.shape)))
    return np.maximum(motor.torque_constant * best - motor.core_loss_damping * w, 0)


def compute_natural_frequency(drive: Drive, inertia: float, half_step: bool = False) -> float:
    """Compute the natural frequency of small swings of the rotor at rest, Hz: sqrt(stiffness / inertia) / 2 pi.

    The stiffness is Nr (Km I + 4 Td) on a full step, where the detent torque adds to it, and Nr (Km I - 4 Td) on a half
    step, where it subtracts (spec/drives.md, 2).

    Args:
        drive: Drive with its motor.
        inertia: kg m^2, rotor included.
        half_step: Whether the rotor stands on a half step.

    Raises:
        ArgumentError: The inertia is not above 0.
    """
    _check_inertia(drive, inertia)
    m = drive.motor
    detent = 4 * drive.detent_torque * (-1 if half_step else 1)
    return math.sqrt(m.rotor_teeth * (m.torque_constant * drive.amplitude + detent) / inertia) / 2 / math.pi


def _check_inertia(drive: Drive, inertia: float) -> None:
    """Raise ArgumentError for an inertia that is not above 0."""
    if not 0 < inertia < math.inf:
        raise ArgumentError(
            f"inertia={inertia!r}: give kg m^2 above 0; the rotor alone has {drive.motor.rotor_inertia:g}."
        )


@hot
def _compute_next_speed(omega, torque, friction, inertia, damping):
    """Return the speed of a rotor after a slice, rad/s. Friction can stop a rotor but never turns it.

    Args:
        omega: Speed at the beginning of the slice, rad/s.
        torque: Torque on the rotor without that of friction and damping, N m.
        friction: Friction, N m.
        inertia: Moment of inertia, kg m^2.
        damping: Damping, N m s/rad.
    """
    push, brake = omega + SLICE_S / inertia * torque, SLICE_S / inertia * friction
    push = greatest(push - brake, 0.0) if push > 0.0 else least(push + brake, 0.0)
    return push / (1.0 + SLICE_S / inertia * damping)


@exported(None, stepper.DRIVE, array_of("f8"), array_of("f8"), *["f8"] * 5, array_of(TRACE))
def _simulate_motor(drive, counts, load, inertia, frame_damping, flywheel_damping, theta, omega, trace):
    """Integrate the rotor's motion by leapfrog, and write the values of each slice into `trace`.

    The torque of a slice acts at the rotor's angle in the middle of the slice.
    """
    flywheel_speed = omega
    stepper.power_up(drive, counts[0], drive.per_pulse * counts[0] / drive.teeth)
    for k in range(len(counts)):
        force = stepper.compute_slice_torque(drive, counts[k], theta, omega, SLICE_S)
        row = trace[k]
        row.count, row.theta, row.omega, row.torque = counts[k], theta, omega, force
        row.current_a, row.current_b = drive.current_a, drive.current_b
        omega = _compute_next_speed(
            omega, force + flywheel_damping * flywheel_speed, load[k], inertia, frame_damping + flywheel_damping
        )
        theta += SLICE_S * omega


BRAKED_ROTOR = record([(name, "f8") for name in "load start_speed theta omega".split()] + [("in_step", "i8")])
"""A rotor in a run of several: brake (N m), speed of its flywheel (rad/s), angle (rad), speed (rad/s), 1 until it slips."""


@exported(None, array_of(BRAKED_ROTOR), array_of(stepper.DRIVE), array_of("f8", 2), array_of("f8"), "f8", "f8")
def _brake_rotors(rotors, drives, counts, onset, inertia, flywheel_damping):
    """Run rotors that start in step, each until it slips, and write into `in_step` which of them never do.

    The motion is that of `_simulate_motor` without damping relative to the frame. Each slice depends on the one before it; with
    several rotors side by side, the processor works on one while it waits for the results of another.

    Args:
        rotors: BRAKED_ROTOR records with `load` and `start_speed`, shape (n,).
        drives: DRIVE records, shape (n,).
        counts: Commanded pulses, mean over each slice, shape (slices, n).
        onset: Share of the load in each slice, shape (slices,).
        inertia: Moment of inertia, kg m^2.
        flywheel_damping: Damping relative to the flywheel, N m s/rad.
    """
    for j in range(len(rotors)):
        rotor, drive = rotors[j], drives[j]
        rotor.theta, rotor.omega, rotor.in_step = drive.per_pulse * counts[0, j] / drive.teeth, rotor.start_speed, 1
        stepper.power_up(drive, counts[0, j], rotor.theta)
    for k in range(len(onset)):
        for j in range(len(rotors)):
            rotor, drive = rotors[j], drives[j]
            if rotor.in_step == 0:
                continue
            if not abs(drive.per_pulse * counts[k, j] - drive.teeth * rotor.theta) < SLIP_ANGLE_RAD:
                rotor.in_step = 0
                continue
            force = stepper.compute_slice_torque(drive, counts[k, j], rotor.theta, rotor.omega, SLICE_S)
            torque = force + flywheel_damping * rotor.start_speed
            rotor.omega = _compute_next_speed(rotor.omega, torque, rotor.load * onset[k], inertia, flywheel_damping)
            rotor.theta += SLICE_S * rotor.omega


def count_slices(seconds: float) -> int:
    """Return the number of slices in a time, s."""
    return round(seconds / SLICE_S)


def compute_mean_counts(rates: Floats) -> np.ndarray:
    """Compute the mean commanded count of each slice, shape (n,), for a chip that makes whole pulses.

    The mean over a slice is exact for the staircase of pulses. The average of the counts at both ends of a slice would beat with
    the pulse rate.

    Args:
        rates: Pulse rate in each slice, pps, shape (n,).
    """
    # a sum that falls short of a pulse
    edges = np.concatenate([[0.0], np.cumsum(np.asarray(rates, float) * SLICE_S)]) + 1e-6
    first_pulse = np.floor(edges[:-1])
    run, last_pulse = edges[1:] - first_pulse, np.floor(edges[1:]) - first_pulse
    area = last_pulse * (run - 0.5 * (last_pulse + 1))  # under the staircase, from the slice's first whole pulse on
    moved = np.diff(edges)
    return first_pulse + np.divide(area, moved, out=np.zeros_like(area), where=moved != 0)


def simulate_motor(
    drive: Drive,
    counts: Floats,
    inertia: float,
    load: Floats | float = 0.0,
    frame_damping: float = DEFAULT_DAMPING_N_M_S,
    flywheel_damping: float = 0.0,
    start_angle: float | None = None,
    start_speed: float = 0.0,
) -> np.ndarray:
    """Run a motor with a given waveform of commanded pulses. The drive starts on counts[0].

    Args:
        drive: Drive with its motor.
        counts: Commanded pulses, mean over each slice, shape (n,).
        inertia: Moment of inertia with that of the rotor, kg m^2.
        load: Friction, N m, a number or an array of shape (n,).
        frame_damping: Damping relative to the frame, N m s/rad, in addition to the motor's core loss.
        flywheel_damping: Damping relative to a flywheel that always turns at the starting speed, N m s/rad. It takes no torque
            from a rotor that keeps this speed.
        start_angle: Rotor angle at the start, rad; default: on counts[0].
        start_speed: Speed at the start, rad/s.

    Returns:
        TRACE records, shape (n,).

    Raises:
        ArgumentError: An inertia that is not above 0, friction below 0, or no counts.
    """
    _check_inertia(drive, inertia)
    waveform = np.array(counts, float)
    if waveform.ndim != 1 or not len(waveform):
        raise ArgumentError(
            f"counts of shape {waveform.shape}: give one pulse count a slice, for example pulses(rates)."
        )
    if np.shape(load) not in ((), waveform.shape):
        raise ArgumentError(f"load of shape {np.shape(load)}: give one number, or {len(waveform)}, one a slice.")
    if not (np.min(load) >= 0 and frame_damping >= 0 and flywheel_damping >= 0):
        raise ArgumentError(
            f"load={load!r}, frame_damping={frame_damping!r}, flywheel_damping={flywheel_damping!r}: friction takes power: "
            "give 0 or more."
        )
    rows = np.zeros(1, stepper.DRIVE)
    drive.fill_record(rows[0])
    trace = np.zeros(len(waveform), TRACE)
    brake = np.array(np.broadcast_to(np.asarray(load, float), waveform.shape))
    start = drive.per_pulse * waveform[0] / drive.motor.rotor_teeth if start_angle is None else start_angle
    frame_damping = float(frame_damping) + drive.motor.core_loss_damping
    inertia, flywheel_damping, start, start_speed = map(float, (inertia, flywheel_damping, start, start_speed))
    _simulate_motor(rows, waveform, brake, inertia, frame_damping, flywheel_damping, start, start_speed, trace)
    return trace


def compute_load_angle(drive: Drive, trace: np.ndarray) -> np.ndarray:
    """Return the commanded minus the rotor angle at each slice of a trace, electrical radians, not wrapped, shape (n,).

    Args:
        drive: Drive of the trace.
        trace: TRACE records, shape (n,).
    """
    return drive.per_pulse * trace["count"] - drive.motor.rotor_teeth * trace["theta"]


def count_lost_steps(drive: Drive, trace: np.ndarray) -> int:
    """Return the full steps by which the rotor lags at the end of a trace.

    Args:
        drive: Drive of the trace.
        trace: TRACE records, shape (n,).
    """
    rows = np.zeros(1, stepper.DRIVE)
    drive.fill_record(rows[0])
    return int(stepper.count_lost_steps(rows[0], float(trace["count"][-1]), float(trace["theta"][-1])))


def _check_speeds(rpm: Floats) -> np.ndarray:
    """Return the speeds as an array. Raises ArgumentError for speeds that are not above 0."""
    speeds = np.atleast_1d(np.asarray(rpm, float))
    if not ((speeds > 0) & (speeds <= 20_000)).all():
        raise ArgumentError(f"rpm={rpm!r}: a brake needs turning rotors: give speeds above 0, up to 20000 rpm.")
    return speeds


def _compute_damping(drive: Drive, inertia: float, ratio: float) -> float:
    """Return the damping, N m s/rad, that is `ratio` times the critical damping of the rotor's swing about its field."""
    check_in_range("damping_ratio", ratio, 0, 10, "times critical", zero_allowed=True)
    return 2 * ratio * inertia * 2 * math.pi * compute_natural_frequency(replace(drive, detent=0.0), inertia)


def _split_core_loss(drive: Drive) -> tuple[Drive, float]:
    """Return the drive with a motor without core loss, and the damping of that core loss, N m s/rad.

    At a commanded speed w0 the loss b w equals a brake of b w0 and a damper b that turns at w0. In this form the brake comes on
    smoothly like any other load, and does not hit a rotor that starts in step without a load angle.
    """
    loss = drive.motor.core_loss_damping
    return (replace(drive, motor=replace(drive.motor, core_loss_resistance=None)) if loss else drive), loss


def simulate_pull_out(
    drive: Drive, rpm: Floats, inertia: float | None = None, damping_ratio: float = 0.15
) -> np.ndarray:
    """Simulate the pull-out torque at each speed, N m, shape (n,): the largest friction with which a rotor keeps up.

    The result is 0 if the rotor slips without friction. As on a real bench, it does not include the torque against the motor's
    core loss. The rotor starts in step; the brake comes on smoothly over BRAKE_ONSET_S and holds for BRAKE_HOLD_S. A bisection
    finds the torque to
    1/4000 of the holding torque. (A brake that grows until the rotor slips would read high, because it grows on while the rotor
    slowly falls out of step.)

    Args:
        drive: Drive with its motor.
        rpm: Speeds, shape (n,).
        inertia: Moment of inertia with that of the rotor, kg m^2; default: ten rotors.
        damping_ratio: Ratio to the critical damping, of a damper that turns at the commanded speed and takes no torque. The
            defaults keep resonance from throwing the rotor out of step early; `sweep_resonance` shows the effect of less damping.

    Raises:
        ArgumentError: Speeds that are not above 0.
    """
    inertia = 10 * drive.motor.rotor_inertia if inertia is None else inertia
    drive, loss = _split_core_loss(drive)
    flywheel_damping = _compute_damping(drive, inertia, damping_ratio) + loss
    onset = 0.5 - 0.5 * np.cos(
        math.pi * np.minimum(np.arange(count_slices(BRAKE_ONSET_S + BRAKE_HOLD_S)) * SLICE_S / BRAKE_ONSET_S, 1)
    )
    speeds = _check_speeds(rpm)
    if not len(speeds):
        return np.zeros(0)
    rotors = np.zeros(len(speeds), BRAKED_ROTOR)
    rotors["start_speed"] = speeds * 2 * math.pi / 60
    waveforms = [compute_mean_counts(np.full(len(onset), speed / 60 * drive.pulses_per_turn)) for speed in speeds]
    counts = np.stack(waveforms, axis=1)

    def keep_up(loads: np.ndarray) -> np.ndarray:
        """Return which rotors keep up with these loads, shape (n,)."""
        drives = np.zeros(len(speeds), stepper.DRIVE)
        for row in drives:
            drive.fill_record(row)
        rotors["load"] = loads
        _brake_rotors(rotors, drives, counts, onset, inertia, flywheel_damping)
        return rotors["in_step"] == 1

    low = np.zeros(len(speeds))
    high = np.full(len(speeds), 1.2 * (drive.motor.torque_constant * drive.amplitude + drive.detent_torque))
    runs_unloaded = keep_up(low)
    for _ in range(12):
        middle = 0.5 * (low + high)
        is_in_step = keep_up(middle)
        low, high = np.where(is_in_step, middle, low), np.where(is_in_step, high, middle)
    return np.where(runs_unloaded, np.maximum(low - loss * rotors["start_speed"], 0.0), 0.0)


def count_steps_lost_in_start(
    drive: Drive,
    rate: float,
    inertia: float,
    accel: float = 0.0,
    load: float = 0.0,
    frame_damping: float = DEFAULT_DAMPING_N_M_S,
) -> int:
    """Count the full steps lost by a start from rest, 0.4 s after the rate is reached.

    Args:
        drive: Drive with its motor.
        rate: Pulse rate, pps.
        inertia: kg m^2, rotor included.
        accel: Ramp from 0, pps/s; 0: at once.
        load: Friction, N m.
        frame_damping: Damping, N m s/rad.

    Raises:
        ArgumentError: A rate or a ramp is out of range.
    """
    if not (0 < rate <= 1e7 and 0 <= accel < math.inf):
        raise ArgumentError(
            f"rate={rate!r}, accel={accel!r}: give a rate above 0 up to 1e7 pps, and pps/s from 0 (at once) on."
        )
    time = np.arange(count_slices(0.4 + (rate / accel if accel else 0.0))) * SLICE_S
    rates = np.minimum(accel * time, rate) if accel else np.full(len(time), float(rate))
    return count_lost_steps(drive, simulate_motor(drive, compute_mean_counts(rates), inertia, load, frame_damping))


def find_pull_in_rate(
    drive: Drive, inertia: float, load: float = 0.0, frame_damping: float = DEFAULT_DAMPING_N_M_S
) -> float:
    """Find the pull-in rate, pps: the highest rate at which a motor starts at once, from rest, without losing a step. 0 if no rate
    does.

    The search raises the rate from 50 full steps a second in steps of 3 % until a start fails, and then bisects to 0.2 %.

    Args:
        drive: Drive with its motor.
        inertia: Moment of inertia with that of the rotor, kg m^2.
        load: Friction, N m.
        frame_damping: Damping, N m s/rad.
    """
    low, high = 0.0, 50.0 * drive.microsteps
    while count_steps_lost_in_start(drive, high, inertia, 0.0, load, frame_damping) == 0:
        low, high = high, 1.03 * high
        if high > 20_000 * drive.microsteps:
            return low
    while low and high > 1.002 * low:
        middle = 0.5 * (low + high)
        keeps_step = count_steps_lost_in_start(drive, middle, inertia, 0.0, load, frame_damping) == 0
        low, high = (middle, high) if keeps_step else (low, middle)
    return low


def measure_swing_frequency(drive: Drive, inertia: float, microstep: int = 0, frame_damping: float = 0.0) -> float:
    """Simulate a rotor that is released 1/40 full step away from a microstep, and return the frequency of its swing, Hz.

    The frequency is the mean over the zero crossings of the swing.

    Args:
        drive: Drive with its motor.
        inertia: Moment of inertia with that of the rotor, kg m^2.
        microstep: Microstep on which the drive stands.
        frame_damping: Damping, N m s/rad.

    Raises:
        ArgumentError: The rotor does not swing twice.
    """
    aside = math.pi / 2 / 40 / drive.motor.rotor_teeth
    rest = drive.per_pulse * microstep / drive.motor.rotor_teeth
    # between full steps the detent pulls the rest away from the microstep: let a well damped rotor find it
    calm = 0.5 * math.sqrt(drive.motor.rotor_teeth * drive.motor.holding_torque * inertia)
    standing = np.full(count_slices(0.3), float(microstep))
    rest = float(simulate_motor(drive, standing, inertia, frame_damping=calm, start_angle=rest)["theta"][-1])
    swinging = standing[: count_slices(0.1)]
    swing = simulate_motor(drive, swinging, inertia, frame_damping=frame_damping, start_angle=rest + aside)
    out = swing["theta"] - rest
    up = np.flatnonzero((out[:-1] < 0) & (out[1:] >= 0))
    if len(up) < 2:
        raise ArgumentError(
            f"inertia={inertia!r}, frame_damping={frame_damping!r}: the rotor does not ring twice in 0.1 s; give less."
        )
    crossings = up + out[up] / (out[up] - out[up + 1])
    return float((len(crossings) - 1) / ((crossings[-1] - crossings[0]) * SLICE_S))


class Resonance(NamedTuple):
    """Pull-out torque and speed ripple at a series of step rates, as `sweep_resonance` measures them.

    Attributes:
        rate: Full steps per second, shape (n,).
        torque: Pull-out torque at each rate, N m.
        ripple: Root mean square of the speed ripple without load, rad/s.
    """

    rate: np.ndarray
    torque: np.ndarray
    ripple: np.ndarray


def sweep_resonance(
    drive: Drive, rates: Floats, inertia: float | None = None, damping_ratio: float = 0.06
) -> Resonance:
    """Simulate pull-out torque and speed ripple of a nearly bare rotor at a series of step rates.

    A full-step drive excites the rotor at the step rate. Near the natural frequency the rotor loses torque, down to 0 where it
    falls out of step without load.

    Args:
        drive: Drive with its motor.
        rates: Full steps per second, shape (n,).
        inertia: Moment of inertia with that of the rotor, kg m^2; default: the bare rotor.
        damping_ratio: Ratio to the critical damping, as in `simulate_pull_out`.
    """
    rate = np.atleast_1d(np.asarray(rates, float))
    inertia = drive.motor.rotor_inertia if inertia is None else inertia
    rpm = rate / drive.motor.steps_per_turn * 60
    lossless, loss = _split_core_loss(drive)
    flywheel_damping = _compute_damping(drive, inertia, damping_ratio) + loss
    ripple = np.zeros(len(rate))
    for k, speed in enumerate(_check_speeds(rpm)):
        counts = compute_mean_counts(np.full(count_slices(0.4), speed / 60 * drive.pulses_per_turn))
        omega = speed * 2 * math.pi / 60
        free = simulate_motor(lossless, counts, inertia, loss * omega, 0.0, flywheel_damping, start_speed=omega)[
            "omega"
        ][count_slices(0.2) :]
        ripple[k] = math.sqrt(float(np.mean((free - omega) ** 2)))
    return Resonance(rate, simulate_pull_out(drive, rpm, inertia, damping_ratio), ripple)


def tabulate_pull_out(
    drive: Drive, rpm: Floats | None = None, progress: Callable[[float], None] | None = None
) -> PullOutCurve:
    """Compute all curves of a pull-out plot. `print` shows the result as a table.

    The ideal sine drive has 256 microsteps and no detent torque.

    Args:
        drive: Drive with its motor.
        rpm: Speeds, shape (n,); default: 50 to 2400.
        progress: Function that is called with the completed fraction.
    """
    speeds = _check_speeds(rpm if rpm is not None else np.r_[50, 150:2401:75])
    sine = replace(drive, mode="sine", microsteps=256, detent=0.0)
    simulated, ideal_drive = np.zeros(len(speeds)), np.zeros(len(speeds))
    for first in range(0, len(speeds), ROTORS_SIDE_BY_SIDE):
        group = slice(first, first + ROTORS_SIDE_BY_SIDE)
        simulated[group] = simulate_pull_out(drive, speeds[group])
        ideal_drive[group] = simulate_pull_out(sine, speeds[group])
        if progress:
            progress(min(first + ROTORS_SIDE_BY_SIDE, len(speeds)) / len(speeds))
    m, v, i = drive.motor, drive.bus_voltage, drive.amplitude
    return PullOutCurve(
        speeds, simulated, ideal_drive,
        compute_closed_form_torque(m, v, i, speeds), compute_closed_form_torque(m, 4 / math.pi * v, i, speeds),
        compute_torque_bound(m, v, i, speeds), m.steps_per_turn,
    )  # fmt: skip
