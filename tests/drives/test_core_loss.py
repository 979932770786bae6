"""Core loss of a stepper motor: iron loss and eddy currents as a resistance across the back-EMF, on the bench and in a stage."""

import copy
import math
import pickle
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stage import ArgumentError, ModelError, Stage
from stage.chips import PCL240K
from stage.drives import stepper
from stage.drives.dynamometer import (
    compute_closed_form_torque,
    compute_mean_counts,
    compute_torque_bound,
    count_slices,
    simulate_motor,
    simulate_pull_out,
)
from stage.drives.motors import Drive, Motor
from stage.sim import faults
from stage.tune.formula import Load

LOSSLESS = Motor("lossless", 2.0, 1.6, 3.0e-3, 0.56, 0.0, 82e-7)
LOSSY = replace(LOSSLESS, name="lossy", core_loss_resistance=50.0)
KM = 0.56 / (math.sqrt(2) * 2.0)  # N m/A
DAMPING = KM**2 / 50.0  # N m s/rad
RPM = np.array([100.0, 600.0, 1200.0, 2000.0])
W = RPM * 2 * math.pi / 60  # rad/s
SINE = {"microsteps": 256, "mode": "sine"}


def test_the_damping_of_a_core_loss_is_km_squared_over_its_resistance():
    assert LOSSY.core_loss_damping == pytest.approx(DAMPING, rel=1e-12)
    assert LOSSLESS.core_loss_damping == 0.0


def test_current_lost_in_each_phase_brakes_like_a_constant_damping_at_any_angle():
    """Simscape's block takes e / Rm off each phase current before the torque."""
    angle, speed, ia, ib = 1.234, 70.0, 0.8, -1.1
    for theta in np.linspace(0, 2 * math.pi / 50, 9) + angle:
        s, c = math.sin(50 * theta), math.cos(50 * theta)
        block = -KM * (ia + KM * speed * s / 50.0) * s + KM * (ib - KM * speed * c / 50.0) * c
        assert block == pytest.approx(KM * (ib * c - ia * s) - LOSSY.core_loss_damping * speed, rel=1e-12)


@pytest.mark.parametrize("curve", [compute_closed_form_torque, compute_torque_bound])
def test_closed_forms_are_less_by_the_loss_and_never_negative(curve):
    lossless, lossy = curve(LOSSLESS, 24, 2.0, RPM), curve(LOSSY, 24, 2.0, RPM)
    assert lossy == pytest.approx(np.maximum(lossless - DAMPING * W, 0), rel=1e-12)
    assert curve(replace(LOSSLESS, core_loss_resistance=1.0), 24, 2.0, RPM)[-1] == 0.0


def test_the_bench_finds_the_closed_form_less_the_loss():
    assert simulate_pull_out(Drive(LOSSY, **SINE), RPM[:3]) == pytest.approx(
        compute_closed_form_torque(LOSSY, 24, 2.0, RPM[:3]), rel=0.01
    )


def test_a_motor_that_its_core_loss_alone_holds_back_has_no_pull_out_torque():
    assert simulate_pull_out(Drive(LOSSY, **SINE), [3000]) == 0.0
    assert simulate_pull_out(Drive(LOSSLESS, **SINE), [3000]) > 0.05


@cache
def pull_out_by_ode(motor, volts, current, speed, sine):
    """Pull-out torque, N m, of the two phases as SciPy integrates them at a constant speed, rad/s; the best of all load angles.

    Each phase current loses e / Rm before it makes torque. The drive is a sinusoidal voltage, or keeps a sinusoidal current as
    far as its voltage goes.
    """
    km, r, inductance, rm = motor.torque_constant, motor.resistance, motor.inductance, motor.core_loss_resistance
    lead = np.linspace(0.5, math.pi, 65)
    turn = 50 * speed  # electrical rad/s
    period, unit = 2 * math.pi / turn, np.array([[1.0], [1j]])  # phase b is a quarter turn behind

    def wave(t, ahead):
        return (np.exp(1j * (turn * t + ahead)) * np.conj(unit)).real

    def back_emf(t):
        return km * speed * wave(t, math.pi / 2) * np.ones_like(lead)

    def slope(t, currents):
        i = currents.reshape(2, -1)
        if sine:
            v = volts * wave(t, lead + math.pi / 2)
        else:
            rate = current * turn * wave(t, lead + math.pi / 2)
            v = r * i + back_emf(t) + inductance * (rate + 3e5 * (current * wave(t, lead) - i))
            v = np.clip(v, -volts, volts)
        return ((v - r * i - back_emf(t)) / inductance).ravel()

    start = current * wave(0.0, lead)
    settled = 10 if not sine else max(10, math.ceil(8 * inductance / r / period))
    times = np.linspace(settled * period, (settled + 1) * period, 241)
    solution = solve_ivp(
        slope, (0, times[-1]), start.ravel(), "RK45", times, rtol=1e-5, atol=1e-6, max_step=period / 100
    )
    i = solution.y.reshape(2, -1, len(times))
    torque = np.zeros((len(lead), len(times)))
    for k, t in enumerate(times):
        torque[:, k] = ((i[:, :, k] - back_emf(t) / rm) * back_emf(t)).sum(axis=0) / speed
    mean = torque[:, :-1].mean(axis=1)
    best = int(np.argmax(mean))
    assert 0 < best < len(lead) - 1
    a, b, c = mean[best - 1 : best + 2]
    return b + (a - c) ** 2 / (8 * (2 * b - a - c))


@pytest.mark.parametrize(
    ("rpm", "sine"), [(1500, True), pytest.param(900, False, marks=pytest.mark.slow), (1500, False)]
)
def test_an_independent_solver_finds_the_pull_out_torque_of_the_bench(rpm, sine):
    expected = pull_out_by_ode(LOSSY, 24.0, 2.0, rpm * 2 * math.pi / 60, sine)
    simulated = simulate_pull_out(Drive(LOSSY, **(SINE if sine else {"microsteps": 64})), [rpm])[0]
    print(rpm, sine, simulated, expected)
    assert simulated == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(
    ("rpm", "mode"), [pytest.param(600, "chopper", marks=pytest.mark.slow), (1500, "chopper"), (1500, "sine")]
)
def test_the_windows_of_a_stage_have_the_pull_out_torque_of_an_independent_solver(rpm, mode):
    """At a constant speed, the best of all load angles, over 4 ms in windows of eight slices: whole electrical turns."""
    speed, slice_s, means = rpm * 2 * math.pi / 60, 31.25e-6, []
    drive = Drive(LOSSY, microsteps=64, mode=mode)
    for lead in np.linspace(1.4, 3.8, 13):
        rows = np.zeros(1, stepper.DRIVE)
        drive.fill_record(rows[0])
        torques = []
        for k in range(64):
            middle = speed * 8 * slice_s * (k + 0.5)
            times = 8 * slice_s * k + slice_s * (np.arange(8) + 0.5)
            counts = (50 * speed * times + lead) / drive.per_pulse
            torques.append(stepper.compute_mean_torque(rows[0], counts, 8, middle, speed, slice_s))
        means.append(np.mean(torques[-16:]))
    a, b, c = means[np.argmax(means) - 1 : np.argmax(means) + 2]
    best = b + (a - c) ** 2 / (8 * (2 * b - a - c))
    expected = pull_out_by_ode(LOSSY, 24.0, 2.0, speed, mode == "sine")
    print(rpm, mode, best, expected + DAMPING * speed)
    assert best == pytest.approx(expected + DAMPING * speed, rel=4e-3)


def test_torque_of_the_field_in_step_is_the_load_and_the_core_loss():
    """Energy balance of a turning motor: the power of the field goes into the brake and the core."""
    drive, speed, load = Drive(LOSSY, 64), 600 * 2 * math.pi / 60, 0.1
    counts = compute_mean_counts(np.full(count_slices(0.6), speed / (2 * math.pi) * drive.pulses_per_turn))
    trace = simulate_motor(drive, counts, 10 * LOSSY.rotor_inertia, load, 0.0, 0.02, start_speed=speed)[
        count_slices(0.4) :
    ]
    assert trace["omega"].mean() == pytest.approx(speed, rel=1e-4)
    assert trace["torque"].mean() == pytest.approx(load + DAMPING * speed, rel=5e-3)


# --- in a stage ---


def stage_with(motor, model="xyz", **drives):
    return Stage(model, chips=PCL240K, drives=drives or motor, visuals=False)


def test_each_axis_has_the_loss_of_its_motor_and_a_joint_without_a_drive_has_none():
    stage = Stage("xyz", chips={"x": PCL240K, "y": PCL240K}, drives={"x": LOSSY, "y": LOSSLESS}, visuals=False)
    assert stage.model.actuator_damping == pytest.approx([DAMPING, 0, 0])
    for a in "xyz":
        stage.data.qvel[stage.model.joint(a).dofadr[0]] = 0.1
    stage.step()
    gear = stage.axes["x"].gear
    passive = stage.data.qfrc_passive + stage.model.dof_damping * stage.data.qvel
    assert passive == pytest.approx([-DAMPING * gear**2 * stage.data.qvel[0], 0, 0], rel=0.05, abs=0.1)


def test_the_loss_changes_nothing_that_mujoco_derives_from_inertia():
    lossless, lossy = (stage_with(m).model for m in (LOSSLESS, LOSSY))
    for field in ("dof_armature", "dof_M0", "dof_invweight0", "body_invweight0", "dof_damping"):
        assert np.array_equal(getattr(lossless, field), getattr(lossy, field)), field


def test_another_motor_brings_its_loss_and_takes_it_away_again():
    stage = stage_with(LOSSLESS)
    built = stage_with(None, x=LOSSY, y=LOSSLESS, z=LOSSLESS)
    x, before = stage.axes["x"], stage.snapshot().state.tobytes()
    with faults.motor(x, LOSSY):
        for replica in (stage, copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))):
            assert np.array_equal(replica.model.actuator_damping, built.model.actuator_damping)
            replica.data.qvel[0] = 0.1
            replica.step()
            assert replica.data.qfrc_passive[0] < -0.99 * DAMPING * x.gear**2 * 0.09
        stage.reset()
        assert stage.snapshot().state.tobytes() == built.snapshot().state.tobytes()
    stage.reset()
    assert not stage.model.actuator_damping.any()
    assert stage.snapshot().state.tobytes() == before


def test_a_model_that_states_the_damping_of_an_actuator_keeps_it():
    from stage.sim import plant

    spec = plant.open_spec("xyz")
    next(a for a in spec.actuators if a.name == "x").damping = [1e-4, 0, 0]
    stage = Stage(spec, chips=PCL240K, drives=LOSSY, visuals=False)
    assert stage.model.actuator_damping[:2] == pytest.approx([1e-4, DAMPING])
    with faults.motor(stage.axes["x"], "17HS4401"):
        assert stage.model.actuator_damping[0] == 1e-4


@pytest.mark.parametrize("damping", [-1e-4, 0.1, math.inf, math.nan])
def test_a_model_whose_actuator_has_a_damping_that_no_motor_has_is_refused(damping):
    from stage.sim import plant

    spec = plant.open_spec("xy")
    next(a for a in spec.actuators if a.name == "x").damping = [damping, 0, 0]
    with pytest.raises(ModelError) as error:
        Stage(spec, chips=PCL240K, drives=LOSSY, visuals=False)
    assert str(error.value).startswith(
        f"axis x: its actuator has a damping of {damping:g} N m s/rad, and the core loss of lossy"
    )
    assert "from 0 up to 0.0891: " in str(error.value)


def test_a_model_that_switches_dampers_off_is_refused_before_it_drops_a_loss():
    """<flag damper="disable"/>: MuJoCo then leaves out the damping of actuators, too."""
    from stage.sim import plant

    spec = plant.open_spec("xy")
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_DAMPER
    with pytest.raises(ModelError) as error:
        Stage(spec, chips=PCL240K, drives={"y": LOSSY, "x": LOSSLESS}, visuals=False)
    assert str(error.value) == (
        'the model has <flag damper="disable"/>, which would drop the core loss of the motor on axis y: remove it and write '
        'damping="0" at joints that have none, or give a motor with core_loss_resistance=None.'
    )
    stage = Stage(spec, chips=PCL240K, drives=LOSSLESS, visuals=False)
    before = stage.snapshot().state.tobytes()
    with pytest.raises(ModelError, match="core loss of the motor on axis x: "):
        faults.motor(stage.axes["x"], LOSSY)
    assert stage.snapshot().state.tobytes() == before
    assert not stage.model.actuator_damping.any()


def test_the_formula_has_the_thrust_less_the_loss_and_friction_without_it():
    lossless, lossy = (Load.from_axis(stage_with(m).axes["x"]) for m in (LOSSLESS, LOSSY))
    speed = np.array([0.0, 0.05, 0.1])
    assert lossy.compute_max_thrust(speed) == pytest.approx(
        lossless.compute_max_thrust(speed) - DAMPING * lossy.gear**2 * speed
    )
    assert lossy.damping == lossless.damping


@pytest.mark.parametrize("bad", [-1.0, 0.0, 0.1, math.inf, math.nan, "47", True])
def test_a_negative_or_infinite_loss_is_refused_in_one_sentence(bad):
    with pytest.raises(ArgumentError) as error:
        replace(LOSSLESS, core_loss_resistance=bad)
    assert str(error.value) == (
        f"lossless: core_loss_resistance={bad!r}: give a number above 0.43984, up to 1e+06 ohm, or None for a motor without core "
        "loss."
    ).replace("0.43984", f"{KM**2 * 2 * math.pi / 0.56:g}")


def test_an_effective_inductance_takes_the_place_of_the_data_sheet_s():
    effective = replace(LOSSLESS, effective_inductance=4.0e-3)
    assert (effective.inductance, effective.phase_inductance, LOSSLESS.phase_inductance) == (3.0e-3, 4.0e-3, 3.0e-3)
    assert compute_closed_form_torque(effective, 24, 2.0, RPM) == pytest.approx(
        compute_closed_form_torque(replace(LOSSLESS, inductance=4.0e-3), 24, 2.0, RPM)
    )
    with pytest.raises(ArgumentError, match="effective_inductance=-1: give a number above 0, up to 1 H"):
        replace(LOSSLESS, effective_inductance=-1)
