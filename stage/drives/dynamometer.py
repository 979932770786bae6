"""A test bench for motor and drive without a stage: a rotor, an inertia, a brake.

The bench integrates by leapfrog in slices of 15.6 us, twice as fine as the stage's engine, with the same compiled drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from stage.compiled import hot
from stage.drives import stepper
from stage.drives.motors import Drive, Motor

H = 15.625e-6
SETTLE, RAMP = 0.15, 6.0  # s: running free, then the brake comes on slowly
SLIP = math.pi  # electrical radians from which a rotor does not come back


class PullOut(NamedTuple):
    """A pull-out curve: rpm (n,), measured torque of the drive and of an ideal sine drive, and the closed forms at V
    and 4/pi V (what a saturated chopper can reach); N m."""

    rpm: np.ndarray
    chopper: np.ndarray
    sine: np.ndarray
    ideal: np.ndarray
    ideal_saturated: np.ndarray

    def __str__(self) -> str:
        head = f"{'rpm':>6}{'pps, full step':>16}{'measured':>10}{'sine drive':>12}{'closed form':>13}{'at 4/pi V':>11}   N m"
        rows = [
            f"{r:>6.0f}{r / 60 * 200:>16.0f}{c:>10.3f}{s:>12.3f}{i:>13.3f}{j:>11.3f}"
            for r, c, s, i, j in zip(*self, strict=True)
        ]
        return "\n".join([head, *rows])


def closed_form(motor: Motor, volts: float, current: float, rpm: np.ndarray | float) -> np.ndarray:
    """Pull-out torque of a voltage-limited sine drive, N m: min(T_V, T_I) of drives.md, 1; never below 0.

    Z = sqrt(R^2 + (Nr w L)^2), T_V = Km (V / Z - Km w R / Z^2), T_I = Km I.
    """
    w = np.asarray(rpm, float) * 2 * math.pi / 60
    km, r = motor.torque_constant, motor.resistance
    z = np.hypot(r, motor.rotor_teeth * w * motor.inductance)
    return np.clip(np.minimum(km * (volts / z - km * w * r / z**2), km * current), 0, None)


@hot
def _pull_out(d, rate, inertia, ramp, most):
    """Torque at which the rotor slips. The flywheel's damper pulls towards the commanded speed, so it takes no torque."""
    omega0 = rate * d.per_pulse / d.teeth
    damping = 2.0 * 0.15 * math.sqrt(d.teeth * d.torque_constant * d.current * inertia)
    theta, omega, count, load = 0.0, omega0, 0.0, 0.0
    stepper.align(d, 0.0, 0.0)
    t = 0.0
    while True:
        count = rate * t
        force = stepper.torque(d, count + 0.5 * rate * H, theta + 0.5 * omega * H, omega, H)
        omega += H / inertia * (force - load - damping * (omega - omega0))
        theta += H * omega
        t += H
        if t > SETTLE:
            load = (t - SETTLE) / ramp * most
        angle = stepper.load_angle(d, rate * t, theta)
        if angle > SLIP or load > 1.3 * most:
            return load


@hot
def _slips(d, rate, inertia, seconds, accel, damping, load):
    """Full steps lost by a start from rest: to `rate` at once (accel = 0) or at `accel` pps/s; a stiff friction `load`."""
    theta, omega, t, count = 0.0, 0.0, 0.0, 0.0
    stepper.align(d, 0.0, 0.0)
    while t < seconds:
        now = rate if accel == 0.0 else min(rate, 1000.0 + accel * t)
        force = stepper.torque(d, count + 0.5 * now * H, theta + 0.5 * omega * H, omega, H)
        drag = damping * omega
        if omega != 0.0 or abs(force) > load:
            drag += load if omega > 0.0 or (omega == 0.0 and force > 0.0) else -load
        else:
            drag = force
        omega += H / inertia * (force - drag)
        theta += H * omega
        count += now * H
        t += H
    return stepper.lost_steps(d, count, theta)


@hot
def _ring(d, inertia, out):
    """Rotor angles, one a slice, after it was turned by a tenth of a full step and let go."""
    stepper.align(d, 0.0, 0.0)
    theta, omega = 0.1 * 2.0 * math.pi / d.teeth / 4.0, 0.0
    for k in range(len(out)):
        omega += H / inertia * stepper.torque(d, 0.0, theta, omega, H)
        theta += H * omega
        out[k] = theta


@hot
def _ripple(d, rate, inertia, damping, seconds):
    """Largest deviation of the rotor's speed from the commanded, rad/s, in the last third of a run at pulses as they come."""
    step = d.per_pulse / d.teeth
    omega0 = rate * step
    theta, omega, t, worst = 0.0, omega0, 0.0, 0.0
    stepper.align(d, 0.0, 0.0)
    while t < seconds:
        count = math.floor(rate * t)
        omega += H / inertia * (stepper.torque(d, count, theta, omega, H) - damping * omega)
        theta += H * omega
        t += H
        if t > seconds * 2.0 / 3.0:
            worst = max(worst, abs(omega - omega0))
    return worst


def _record(drive: Drive) -> np.ndarray:
    rows = np.zeros(1, stepper.STEPPER)
    drive.fill(rows[0])
    return rows


@hot
def _call_pull_out(rows, rate, inertia, ramp, most):
    return _pull_out(rows[0], rate, inertia, ramp, most)


@hot
def _call_slips(rows, rate, inertia, seconds, accel, damping, load):
    return _slips(rows[0], rate, inertia, seconds, accel, damping, load)


@hot
def _call_ring(rows, inertia, out):
    _ring(rows[0], inertia, out)


@hot
def _call_ripple(rows, rate, inertia, damping, seconds):
    return _ripple(rows[0], rate, inertia, damping, seconds)


def pull_out(drive: Drive, rpm: Sequence[float] | np.ndarray, ramp: float = RAMP) -> np.ndarray:
    """Pull-out torque at each speed, N m, found by braking a synchronous rotor until it slips.

    The bench carries ten rotor inertias and a damper that turns with the commanded speed, so that resonance does not throw the
    rotor out before its torque is spent.
    """
    rows = _record(drive)
    most = 1.1 * drive.motor.torque_constant * rows[0].current + drive.motor.detent_torque
    out = np.zeros(len(rpm))
    for k, r in enumerate(rpm):
        rate = float(r) / 60 * drive.pulses_per_turn
        out[k] = min(_call_pull_out(rows, rate, 10 * drive.motor.rotor_inertia, ramp, most), most)
    return out


def pull_in(drive: Drive, inertia: float, load: float = 0.0, damping: float = 2e-4) -> float:
    """The highest pulse rate, pps, at which a motor with `inertia` (kg m^2, rotor included) starts without losing a step.

    load: friction torque N m; damping: N m s/rad.
    """
    rows = _record(drive)
    low, high = 0.0, 4000.0 * drive.microsteps
    while high - low > 5.0 * drive.microsteps:
        middle = 0.5 * (low + high)
        lost = _call_slips(rows, middle, inertia, 0.6, 0.0, damping, load)
        low, high = (middle, high) if lost == 0 else (low, middle)
    return low


def lost_in_start(drive: Drive, rate: float, inertia: float, accel: float = 0.0, damping: float = 2e-4) -> int:
    """Full steps lost by a start to `rate` pps: at once, or ramped at `accel` pps/s from 1000 pps."""
    seconds = 0.6 + (rate / accel if accel else 0.0)
    return int(_call_slips(_record(drive), rate, inertia, seconds, accel, damping, 0.0))


def natural_frequency(drive: Drive, inertia: float, seconds: float = 0.1) -> float:
    """Small-angle frequency, Hz, of the rotor about a detent, from its zero crossings after a small push."""
    out = np.zeros(int(seconds / H))
    _call_ring(_record(drive), inertia, out)
    up = np.flatnonzero((out[:-1] < 0) & (out[1:] >= 0))
    crossings = up + out[up] / (out[up] - out[up + 1])
    return float((len(crossings) - 1) / ((crossings[-1] - crossings[0]) * H))


def speed_ripple(drive: Drive, rates: Sequence[float], inertia: float, damping: float = 2e-4) -> np.ndarray:
    """Speed ripple, rad/s, at each pulse rate: it peaks where the steps excite the natural frequency."""
    rows = _record(drive)
    return np.array([_call_ripple(rows, float(r), inertia, damping, 0.6) for r in rates])


def pull_out_table(
    drive: Drive, rpm: Sequence[float] | None = None, progress: Callable[[float], None] | None = None
) -> PullOut:
    """Everything that the pull-out picture shows. rpm: default 50 to 2400."""
    speeds = np.asarray(rpm if rpm is not None else np.r_[50, 150:2401:75], float)
    current = drive.current or drive.motor.rated_current
    smooth = Motor(**{**vars(drive.motor), "detent_torque": 0.0})
    sine = Drive(smooth, drive.microsteps, drive.bus_voltage, drive.current, "sine")
    measured, ideal_drive = np.zeros(len(speeds)), np.zeros(len(speeds))
    for k, r in enumerate(speeds):
        measured[k], ideal_drive[k] = pull_out(drive, [r])[0], pull_out(sine, [r])[0]
        if progress:
            progress((k + 1) / len(speeds))
    v = drive.bus_voltage
    return PullOut(
        speeds, measured, ideal_drive,
        closed_form(drive.motor, v, current, speeds), closed_form(drive.motor, 4 / math.pi * v, current, speeds),
    )  # fmt: skip
