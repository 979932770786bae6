"""The arithmetic of the drive: against slow independent integration, against energy, against itself."""

import itertools
import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import scaled

from stage.drives import stepper
from stage.drives.dynamometer import compute_mean_counts, simulate_motor
from stage.drives.motors import MOTORS, Drive

MOTOR = MOTORS["17HS4401"]
SMOOTH = Drive(detent=0.0)
H = 31.25e-6  # the engine's slice
RATED = MOTOR.torque_constant * MOTOR.rated_current  # N m


def record(drive):
    rows = np.zeros(1, stepper.DRIVE)
    drive.fill_record(rows[0])
    stepper.power_up(rows[0], 0.0, 0.0)
    return rows[0]


def rpm(value):
    return value * 2 * math.pi / 60


def test_a_slice_at_full_voltage_is_the_exact_solution_of_the_phase():
    """Against Runge-Kutta of L di/dt = v - R i - e in 64 pieces, for starts and speeds that keep the phase at full voltage."""
    for start, omega, theta in [(-1.7, 0.0, 0.0), (-1.7, 100.0, 0.013), (-0.5, -80.0, 0.04), (0.3, 200.0, -0.021)]:
        d = record(SMOOTH)
        d.current_a = start
        stepper.compute_slice_torque(d, 0.0, theta, omega, H)
        e = -MOTOR.torque_constant * omega * math.sin(50 * theta)

        def slope(i, e=e):
            return (24 - MOTOR.resistance * i - e) / MOTOR.inductance

        i, h = start, H / 64
        for _ in range(64):
            k1 = slope(i)
            k2 = slope(i + h / 2 * k1)
            k3 = slope(i + h / 2 * k2)
            i += h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(i + h * k3))
        assert i < 1.7, "still on its way"
        assert d.current_a == pytest.approx(i, rel=1e-12)


@pytest.mark.parametrize("revolutions_per_second", [-12.0, 0.5, 3.0, 12.0])
@pytest.mark.parametrize("angle", [-1.2, 0.0, 0.3, 1.5])
def test_a_sine_drive_with_enough_voltage_makes_the_torque_of_its_load_angle_at_any_speed(
    revolutions_per_second, angle
):
    """The current follows the pulses without delay, so the torque is K I sin(load angle)."""
    d = record(Drive(detent=0.0, mode="sine"))
    omega, theta = 2 * math.pi * revolutions_per_second, 0.4
    middles = (np.arange(stepper.SLICES) + 0.5 - stepper.SLICES / 2) * H
    counts = ((theta + omega * middles) * d.teeth + angle - d.offset) / d.per_pulse
    torque = stepper.compute_mean_torque(d, counts, stepper.SLICES, theta, omega, H)
    assert torque == pytest.approx(RATED * math.sin(angle), abs=1e-9 * RATED)


def compute_angles_and_phases(speed, lag, h, seconds):
    """Return rotor angle and commanded phase in the middle of each slice, at a constant speed (rad/s) and load angle."""
    theta = speed * h * (np.arange(round(seconds / h)) + 0.5)
    return theta, 50 * theta + lag


def reference(drive, speed, lag, seconds, pieces):
    """Mean torque over the second half, by plain Euler of both phases in slices of H / pieces; the chopper tries in each
    to reach its target with the voltage that it needs, as far as the bus goes."""
    m, v, h = drive.motor, drive.bus_voltage, H / pieces
    km, current = m.torque_constant, np.array([drive.amplitude, 0.0])
    thetas, phis = compute_angles_and_phases(speed, lag, h, seconds)
    torques = np.zeros(len(thetas))
    for k, (theta, phi) in enumerate(zip(thetas, phis, strict=True)):
        wave = np.array([math.cos(phi), math.sin(phi)])
        teeth = np.array([-math.sin(50 * theta), math.cos(50 * theta)])
        e = km * speed * teeth
        if drive.mode == "sine":
            voltage = v * wave
        else:
            voltage = np.clip(m.resistance * current + e + m.inductance * (drive.amplitude * wave - current) / h, -v, v)
        torques[k] = km * current @ teeth
        current = current + h / m.inductance * (voltage - m.resistance * current - e)
    return torques[len(torques) // 2 :].mean()


def simulated(drive, speed, lag, seconds, h=H):
    d = record(drive)
    thetas, phis = compute_angles_and_phases(speed, lag, h, seconds)
    torques = [stepper.compute_slice_torque(d, p / d.per_pulse, t, speed, h) for t, p in zip(thetas, phis, strict=True)]
    return np.mean(torques[len(torques) // 2 :])


@pytest.mark.parametrize("speed", [1200, 1500, 2000])
@pytest.mark.parametrize("lag", [1.6, 2.4, 3.0])
def test_the_sine_drive_agrees_with_a_fine_independent_integration(speed, lag):
    drive, seconds = Drive(detent=0.0, mode="sine"), 4 / (speed / 60 * 50)  # whole electrical turns
    slow = reference(drive, rpm(speed), lag, seconds, 40)
    assert simulated(drive, rpm(speed), lag, seconds) == pytest.approx(slow, abs=0.01 * RATED)


DAILY = [(1200, 1.6), (1500, 2.4), (2000, 3.0)]  # each speed, each lag


@pytest.mark.parametrize(
    ("speed", "lag"),
    [
        case if case in DAILY else pytest.param(*case, marks=pytest.mark.slow)
        for case in itertools.product((1200, 1500, 2000), (1.6, 2.4, 3.0))
    ],
)
def test_a_chopper_agrees_as_well_but_for_a_command_that_acts_half_a_slice_later(speed, lag):
    """The target of a slice's middle is reached at its end: a shift of the load angle, not a loss of torque."""
    seconds = 8 / (speed / 60 * 50)
    delayed = reference(SMOOTH, rpm(speed), lag - 50 * rpm(speed) * H / 2, seconds, 20)
    assert simulated(SMOOTH, rpm(speed), lag, seconds) == pytest.approx(delayed, abs=0.055 * RATED)
    h = H / 8
    delayed = reference(SMOOTH, rpm(speed), lag - 50 * rpm(speed) * h / 2, seconds, 40)
    assert simulated(SMOOTH, rpm(speed), lag, seconds, h) == pytest.approx(delayed, abs=0.01 * RATED)


def test_power_from_the_bus_is_copper_loss_plus_mechanical_power_plus_the_change_of_the_field():
    """Use sine mode above the corner speed, where the voltages are V cos(phi) and V sin(phi)."""
    drive, speed = Drive(detent=0.0, mode="sine"), rpm(1500)
    d = record(drive)
    electrical = copper = mechanical = 0.0
    field = -MOTOR.inductance / 2 * (d.current_a**2 + d.current_b**2)
    h = H / 8
    for theta, phi in zip(*compute_angles_and_phases(speed, 2.6, h, 0.01), strict=True):
        a, b = d.current_a, d.current_b
        mechanical += stepper.compute_slice_torque(d, phi / d.per_pulse, theta, speed, h) * speed * h
        ia, ib = (a + d.current_a) / 2, (b + d.current_b) / 2
        electrical += 24 * (math.cos(phi) * ia + math.sin(phi) * ib) * h
        copper += MOTOR.resistance * (ia**2 + ib**2) * h
    field += MOTOR.inductance / 2 * (d.current_a**2 + d.current_b**2)
    assert mechanical > 0.05
    assert electrical == pytest.approx(copper + mechanical + field, rel=1e-3)


@pytest.mark.parametrize("speed", [0, 300, 900, 2000])
def test_a_chopper_never_uses_more_than_the_bus_voltage_nor_more_than_the_set_current(speed):
    d = record(SMOOTH)
    km, r, inductance = MOTOR.torque_constant, MOTOR.resistance, MOTOR.inductance
    decay = 1 - math.exp(-H * r / inductance)
    for theta, phi in zip(*compute_angles_and_phases(rpm(speed), 1.5, H, 0.02), strict=True):
        before = np.array([d.current_a, d.current_b])
        stepper.compute_slice_torque(d, phi / d.per_pulse, theta, rpm(speed), H)
        after = np.array([d.current_a, d.current_b])
        e = km * rpm(speed) * np.array([-math.sin(50 * theta), math.cos(50 * theta)])
        assert (abs(e + r * (before + (after - before) / decay)) <= 24 * (1 + 1e-9)).all()
        assert (abs(after) <= 1.7 * (1 + 1e-9)).all() or speed == 2000  # there the back-EMF alone exceeds the bus


def test_at_rest_the_torque_over_angle_is_a_sine_and_four_detents():
    d = record(Drive())
    for theta in np.linspace(-0.06, 0.06, 25):
        for _ in range(3):
            torque = stepper.compute_slice_torque(d, 0.0, theta, 0.0, H)
        assert torque == pytest.approx(
            -MOTOR.torque_constant * 1.7 * math.sin(50 * theta) - 0.022 * math.sin(200 * theta)
        )


@given(st.floats(-500, 500), st.integers(-1_000_000, 1_000_000), st.sampled_from([1, 2, 16, 256]))
@settings(max_examples=scaled(20), deadline=None)
def test_powering_up_puts_the_field_on_the_nearest_microstep_without_a_jump(theta, count, microsteps):
    d = record(Drive(microsteps=microsteps))
    stepper.power_up(d, float(count), theta)
    angle = stepper.compute_load_angle(d, float(count), theta)
    field = (50 * theta + angle) / d.per_pulse
    assert abs(angle) <= d.per_pulse / 2 + 1e-6
    assert field == pytest.approx(round(field), abs=1e-4)
    assert stepper.count_lost_steps(d, float(count), theta) == 0
    assert math.hypot(d.current_a, d.current_b) == pytest.approx(1.7)


@given(st.integers(-1000, 1000), st.floats(-0.49, 0.49))
@settings(max_examples=scaled(20), deadline=None)
def test_lost_steps_counts_four_for_each_tooth_that_the_rotor_lags(teeth, rest):
    d = record(Drive())
    lost = stepper.count_lost_steps(d, 0.0, -(teeth + rest) * 2 * math.pi / 50)
    assert isinstance(lost, int)
    assert lost == 4 * teeth


def test_a_slice_of_another_length_has_new_constants():
    a, b = record(SMOOTH), record(SMOOTH)
    stepper.compute_slice_torque(a, 0.0, 0.0, 0.0, H)
    for d in (a, b):
        d.current_a = -1.7
        stepper.compute_slice_torque(d, 0.0, 0.0, 0.0, H / 3)
    assert a.current_a == b.current_a


def test_the_same_inputs_give_the_same_bits():
    counts = compute_mean_counts(np.full(3000, 40_000.0))
    first, second = (simulate_motor(Drive(), counts, MOTOR.rotor_inertia) for _ in range(2))
    assert first.tobytes() == second.tobytes()


UNCOMPILED = """
import json, sys
import numpy as np
from stage.drives import dynamometer, motors, pull_out_plot, stepper
from stage.native import COMPILED
runs = [
    dynamometer.simulate_motor(motors.Drive(mode=mode), dynamometer.compute_mean_counts(np.full(300, 30_000.0)), 54e-7, 0.05)
    for mode in ("chopper", "sine")
]
heavy = [m for m in ("mujoco", "matplotlib", "stage.chips", "stage.sim.engine") if m in sys.modules]
print(json.dumps([COMPILED, heavy, [r[name].tolist() for r in runs for name in r.dtype.names]]))
"""


def test_uncompiled_the_drive_says_the_same_and_it_needs_neither_mujoco_nor_chips_nor_matplotlib():
    out = subprocess.run(
        [sys.executable, "-c", UNCOMPILED],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    compiled, heavy, columns = json.loads(out)
    assert (compiled, heavy) == (False, [])
    runs = [
        simulate_motor(Drive(mode=mode), compute_mean_counts(np.full(300, 30_000.0)), 54e-7, 0.05)
        for mode in ("chopper", "sine")
    ]
    expected_columns = [r[name] for r in runs for name in r.dtype.names]
    assert np.allclose(columns, expected_columns, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("mode", ["chopper", "sine"])
@pytest.mark.parametrize("speed", [3.0, -40.0, 250.0])
def test_a_window_has_the_currents_of_its_slices_one_by_one_and_the_mean_of_the_torques_at_their_ends(mode, speed):
    """At speeds where currents are held, and where the back-EMF does not let them; held sine currents are those of middles."""
    one, many, n = record(Drive(mode=mode)), record(Drive(mode=mode)), stepper.SLICES
    counts, begin = 40.0 + 0.37 * np.arange(n), 0.2
    currents = [one.current_a + 1j * one.current_b]
    for k, count in enumerate(counts):
        stepper.compute_slice_torque(one, count, begin + (k + 0.5) * speed * H, speed, H)
        currents.append(one.current_a + 1j * one.current_b)
    teeth = 50 * (begin + np.arange(n + 1) * speed * H)
    torque = MOTOR.torque_constant * (np.array(currents) * np.exp(-1j * teeth)).imag
    detent = 0.022 * np.sin(200 * (begin + (np.arange(n) + 0.5) * speed * H))
    expected = (torque.sum() - 0.5 * (torque[0] + torque[-1])) / n - detent.mean()
    if mode == "sine" and abs(speed) < 100:
        expected = (
            MOTOR.torque_constant * (np.array(currents[1:]) * np.exp(-0.5j * (teeth[1:] + teeth[:-1]))).imag.mean()
            - detent.mean()
        )
    mean = stepper.compute_mean_torque(many, counts, n, begin + 0.5 * n * speed * H, speed, H)
    assert mean == pytest.approx(expected, rel=1e-11)
    assert (many.current_a, many.current_b) == pytest.approx((one.current_a, one.current_b), rel=1e-11)


@pytest.mark.parametrize(
    "drive", [Drive(detent=0.03), Drive(detent=0.03, mode="sine"), Drive(detent=0.03, microsteps=1)]
)
@pytest.mark.parametrize("lag", [-1.2, 0.4, 2.0])
def test_the_path_through_a_window_has_the_speed_that_its_torque_causes(drive, lag):
    """T = T(omega + gain T), solved here by trying again and again; back-EMF is that of omega, as the currents do not change."""
    gain, n, omega = 125e-6 / 80e-7, stepper.SLICES, 30.0
    counts = np.full(n, 7.0)

    def mean(torque):
        d = record(drive)
        middle = (counts[0] * d.per_pulse - lag) / d.teeth
        d.current_a, d.current_b = 1.7 * math.cos(7 * d.per_pulse), 1.7 * math.sin(7 * d.per_pulse)
        ends, middles = (
            d.teeth * (middle + (omega + gain * torque) * H * (np.arange(m) - (m - 1) / 2)) for m in (n + 1, n)
        )
        latched = RATED * np.sin(7 * d.per_pulse - ends)
        latched = (latched.sum() - 0.5 * (latched[0] + latched[-1])) / n - 0.03 * np.sin(4 * middles).mean()
        return latched, stepper.compute_mean_torque(d, counts, n, middle, omega, H, gain)

    torque = 0.0
    for _ in range(20):
        torque, result = mean(torque)
    first = mean(0.0)[0]
    assert abs(torque - first) > 1e-4 * RATED, "the second look matters"
    print(result, torque, first)
    assert result == pytest.approx(torque, abs=5e-4 * RATED)


def test_a_drive_without_current_and_detent_makes_no_torque_and_an_open_phase_carries_no_current():
    d = record(Drive(detent=0.0))
    d.current = d.current_a = d.current_b = 0.0
    assert stepper.compute_mean_torque(d, np.full(8, 3.0), 8, 0.01, 20.0, H, 15.0) == 0.0
    d = record(Drive())
    d.open = stepper.A
    stepper.compute_mean_torque(d, np.full(8, 3.0), 8, 0.01, 20.0, H, 15.0)
    assert d.current_a == 0.0 != d.current_b
