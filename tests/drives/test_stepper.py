"""What a believable stepper does: the five behaviours of the drive model, and the exactness of its arithmetic."""

import math

import numpy as np
import pytest

from stage.drives import dynamometer, stepper
from stage.drives.motors import MOTORS, Drive, Motor, motor
from stage.errors import ArgumentError

SMOOTH = Motor("smooth 17HS4401", 1.7, 1.5, 2.8e-3, 0.40, 0.0, 54e-7)
RPM = [300, 900, 1200, 1500, 2000]


def test_the_closed_form_gives_the_known_curve():
    assert dynamometer.closed_form(MOTORS["17HS4401"], 24, 1.7, np.array(RPM)) == pytest.approx(
        [0.283, 0.278, 0.209, 0.168, 0.126], abs=6e-4
    )


def test_pull_out_torque_of_an_ideal_sine_drive_follows_the_closed_form_within_3_percent():
    measured = dynamometer.pull_out(Drive(SMOOTH, mode="sine"), RPM)
    assert measured == pytest.approx(dynamometer.closed_form(SMOOTH, 24, 1.7, np.array(RPM)), rel=0.03)


def test_a_chopper_reaches_between_v_and_4_over_pi_v():
    rpm = np.array([300, 600, 1200, 1500, 2000, 2400])
    measured = dynamometer.pull_out(Drive(SMOOTH), rpm)
    assert (measured > 0.97 * dynamometer.closed_form(SMOOTH, 24, 1.7, rpm)).all()
    assert (measured < 1.03 * dynamometer.closed_form(SMOOTH, 4 / math.pi * 24, 1.7, rpm)).all()


@pytest.mark.parametrize("times", [1, 3])
def test_the_small_angle_frequency_is_the_root_of_stiffness_over_inertia(times):
    inertia = SMOOTH.rotor_inertia * times
    stiffness = SMOOTH.rotor_teeth * SMOOTH.torque_constant * SMOOTH.rated_current
    assert dynamometer.natural_frequency(Drive(SMOOTH), inertia) == pytest.approx(
        math.sqrt(stiffness / inertia) / 2 / math.pi, rel=0.02
    )


def test_an_unloaded_17hs4401_rings_near_300_hz():
    m = MOTORS["17HS4401"]
    assert dynamometer.natural_frequency(Drive(m), m.rotor_inertia) == pytest.approx(300, rel=0.05)


def test_full_steps_shake_the_rotor_at_its_natural_frequency_and_microsteps_hardly_do():
    inertia = 2 * SMOOTH.rotor_inertia
    natural = dynamometer.natural_frequency(Drive(SMOOTH), inertia)
    rates = np.array([natural, 3.1 * natural])
    full = dynamometer.speed_ripple(Drive(SMOOTH, microsteps=1), rates, inertia)
    fine = dynamometer.speed_ripple(Drive(SMOOTH, microsteps=16), rates * 16, inertia)
    assert full[0] > 3 * full[1], "resonance"
    assert fine[0] < full[0] / 5


def test_a_rotor_slips_by_whole_multiples_of_four_full_steps():
    seen = set()
    for rate in np.linspace(20_000, 60_000, 9):
        lost = dynamometer.lost_in_start(Drive(), rate, 4 * MOTORS["17HS4401"].rotor_inertia)
        seen.add(lost)
        assert lost % 4 == 0
    assert any(seen), "some of these starts must fail"


def test_pull_in_is_below_pull_out_and_falls_with_inertia():
    drive, j = Drive(), MOTORS["17HS4401"].rotor_inertia
    rates = [dynamometer.pull_in(drive, j * k) for k in (1, 2, 4, 8)]
    assert rates == sorted(rates, reverse=True)
    assert rates[0] > 1.5 * rates[-1]
    rpm = rates[0] / drive.pulses_per_turn * 60
    assert dynamometer.pull_out(drive, [rpm])[0] > 0.1, "at that speed a running motor still has torque to spare"


def test_a_start_at_high_fl_fails_where_a_ramp_succeeds():
    drive, j = Drive(), 5 * MOTORS["17HS4401"].rotor_inertia
    rate = 1.5 * dynamometer.pull_in(drive, j)
    assert dynamometer.lost_in_start(drive, rate, j) > 0
    assert dynamometer.lost_in_start(drive, rate, j, accel=60_000) == 0


def test_missed_steps_never_repair_themselves():
    """After a stall the rotor holds four steps (or more) behind, however long one waits."""
    rows = np.zeros(1, stepper.STEPPER)
    Drive().fill(rows[0])
    d = rows[0]
    stepper.align(d, 0.0, 0.0)
    turn = 2 * math.pi / d.teeth
    theta, omega, inertia, h = -turn * 1.1, 0.0, 54e-7, 15.625e-6
    for _ in range(20_000):
        omega += h / inertia * (stepper.torque(d, 0.0, theta, omega, h) - 2e-3 * omega)
        theta += h * omega
    assert theta == pytest.approx(-turn, abs=turn * 0.01)
    assert stepper.lost_steps(d, 0.0, theta) == 4


def test_align_makes_no_jump():
    rng_seed = np.random.SeedSequence().entropy
    print("seed", rng_seed)
    rows = np.zeros(1, stepper.STEPPER)
    Drive().fill(rows[0])
    for theta in np.random.default_rng(rng_seed).uniform(-100, 100, 50):
        stepper.align(rows[0], 1234.0, theta)
        assert abs(stepper.load_angle(rows[0], 1234.0, theta)) <= rows[0].per_pulse / 2 + 1e-9


def test_the_current_follows_the_exact_exponential():
    """Against a thousand times finer Euler integration of L di/dt = v - R i - e, for a phase at full voltage."""
    rows = np.zeros(1, stepper.STEPPER)
    Drive(SMOOTH).fill(rows[0])
    d = rows[0]
    d.current_a, d.current_b, h, omega, theta = -1.7, 0.0, 31.25e-6, 100.0, 0.2
    stepper.torque(d, 0.0, theta, omega, h)
    i, e = -1.7, -SMOOTH.torque_constant * omega * math.sin(50 * theta)
    for _ in range(1000):
        i += h / 1000 / SMOOTH.inductance * (24 - SMOOTH.resistance * i - e)
    assert d.current_a == pytest.approx(i, rel=1e-4)


def test_energy_is_conserved_at_steady_speed():
    """Electrical power in = copper loss + mechanical power, over whole electrical turns."""
    rows = np.zeros(1, stepper.STEPPER)
    Drive(SMOOTH).fill(rows[0])
    d, h, omega = rows[0], 5e-6, 40.0
    m, lag = SMOOTH, 0.6
    stepper.align(d, 0.0, 0.0)
    copper = mechanical = electrical = 0.0
    turns = round(2 * math.pi / 50 / omega / h)
    for k in range(20 * turns):
        theta = omega * h * (k + 0.5)
        a, b = d.current_a, d.current_b
        count = (50 * theta + lag) / d.per_pulse
        torque = stepper.torque(d, count, theta, omega, h)
        if k < 10 * turns:
            continue
        ia, ib = (a + d.current_a) / 2, (b + d.current_b) / 2
        ea, eb = -m.torque_constant * omega * math.sin(50 * theta), m.torque_constant * omega * math.cos(50 * theta)
        va = m.resistance * ia + m.inductance * (d.current_a - a) / h + ea
        vb = m.resistance * ib + m.inductance * (d.current_b - b) / h + eb
        electrical += (va * ia + vb * ib) * h
        copper += m.resistance * (ia**2 + ib**2) * h
        mechanical += torque * omega * h
    assert mechanical > 0
    assert electrical == pytest.approx(copper + mechanical, rel=1e-3)


def test_motors_are_those_of_the_data_sheets():
    table = {
        "17HS4401": (1.7, 1.5, 2.8e-3, 0.40, 0.166),
        "17HS19-2004S1": (2.0, 1.4, 3.0e-3, 0.59, 0.209),
        "17HS15-1504S": (1.5, 2.3, 4.4e-3, 0.45, 0.212),
        "SS2422-5041": (1.0, 5.4, 2.9e-3, 0.186, 0.132),
    }
    assert set(MOTORS) == set(table)
    for name, (current, resistance, inductance, holding, km) in table.items():
        m = motor(name)
        assert (m.rated_current, m.resistance, m.inductance, m.holding_torque) == (
            current,
            resistance,
            inductance,
            holding,
        )
        assert m.torque_constant == pytest.approx(km, abs=6e-4)
        assert all(why.startswith("inferred") for why in m.evidence.values())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: motor("17HS4410"), "Did you mean '17HS4401'"),
        (lambda: Drive(microsteps=0), "1 to 256"),
        (lambda: Drive(bus_voltage=-3), "bus_voltage"),
        (lambda: Drive(current=99), "17HS4401 takes"),
        (lambda: Drive(mode="chooper"), "Did you mean 'chopper'"),
    ],
)
def test_bad_drives_are_refused_with_what_is_allowed(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()
