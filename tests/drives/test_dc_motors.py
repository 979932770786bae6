"""DC motors and servo amplifiers: from a motor command to voltage, and what MuJoCo's <dcmotor> makes of it."""

import math

import mujoco
import numpy as np
import pytest

from stage import ArgumentError, Stage
from stage.drives import drive_dispatch, stepper
from stage.drives.dc_motors import DC_MOTORS, DCMotor, Servo, find_dc_motor
from stage.drives.motors import Drive

EVERY = pytest.mark.parametrize("name", DC_MOTORS)


def filled(servo=None):
    rows = np.zeros(1, drive_dispatch.DRIVE)
    (servo or Servo()).fill_record(rows[0])
    return rows[0]


def shares(*values):
    return np.array([*values, *[0.0] * (stepper.SLICES - len(values))])


def rotor(motor, damping=0.0):
    """Make a MuJoCo model of the motor alone: a rotor, and the actuator that a stage fits."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="rotor")
    body.add_joint(name="x", type=mujoco.mjtJoint.mjJNT_HINGE, armature=motor.rotor_inertia, damping=damping)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.001, 0, 0], mass=1e-6, contype=0, conaffinity=0)
    actuator = spec.add_actuator(name="x", target="x", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_dcmotor([motor.torque_constant] * 2, motor.resistance)
    spec.option.timestep, spec.option.integrator = 2.5e-4, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = [0, 0, 0]
    model = spec.compile()
    return model, mujoco.MjData(model)


# --- the amplifier ---


def test_the_voltage_is_the_mean_command_times_the_bus_voltage():
    d = filled(Servo(bus_voltage=30.0))
    assert drive_dispatch.compute_effort(d, shares(1.0, 0.5, -0.25, 0.75), 4, 0.0, 0.0, 1e-4) == pytest.approx(15.0)
    assert drive_dispatch.compute_effort(d, shares(-1.0), 1, 0.0, 0.0, 1e-4) == -30.0
    assert drive_dispatch.compute_effort(d, shares(), 8, 0.0, 50.0, 1e-4) == 0.0


def test_the_voltage_does_not_hang_on_place_speed_or_what_was_before():
    d = filled()
    first = drive_dispatch.compute_effort(d, shares(0.3), 1, 0.0, 0.0, 1e-4)
    for theta, omega in ((1.0, 0.0), (-3.0, 400.0), (0.0, -900.0)):
        assert drive_dispatch.compute_effort(d, shares(0.3), 1, theta, omega, 1e-4) == first


@EVERY
def test_the_current_is_what_is_left_of_the_voltage_over_the_resistance(name):
    servo = Servo(name)
    d, m = filled(servo), servo.motor
    for share, omega in ((1.0, 0.0), (0.5, 120.0), (-0.2, 300.0)):
        v = drive_dispatch.compute_effort(d, shares(share), 1, 0.0, omega, 1e-4)
        assert d.current_a == pytest.approx((24.0 * share - m.torque_constant * omega) / m.resistance)
        assert drive_dispatch.compute_torque(d, v) == pytest.approx(m.torque_constant * d.current_a)
        assert drive_dispatch.compute_voltage(d, v) == v
    assert d.current_b == 0


def test_a_stepper_has_no_terminal_voltage_and_its_effort_is_its_torque():
    rows = np.zeros(1, drive_dispatch.DRIVE)
    Drive().fill_record(rows[0])
    assert drive_dispatch.compute_voltage(rows[0], 0.2) == 0.0
    assert drive_dispatch.compute_torque(rows[0], 0.2) == 0.2


def test_a_servo_powers_up_where_it_is_and_loses_no_steps():
    d = filled()
    drive_dispatch.power_up(d, 1234.0, 0.7)
    assert d.offset == 0.0
    assert drive_dispatch.make_rest_signal(d, 1234) == 0.0
    assert drive_dispatch.compute_lag(d, 2000, 0.0) == pytest.approx(2 * math.pi), "2000 counts are a turn"
    assert drive_dispatch.count_lost_steps(d, 1_000_000, 0.0) == 0


@EVERY
def test_an_amplifier_with_a_current_limit_never_gives_more(name):
    servo = Servo(name, current_limit=4.0)
    d, m = filled(servo), servo.motor
    for share, omega, amperes in ((1.0, 0.0, 4.0), (-1.0, 0.0, -4.0), (1.0, -200.0, 4.0), (-1.0, 300.0, -4.0)):
        v = drive_dispatch.compute_effort(d, shares(share), 1, 0.0, omega, 1e-4)
        assert d.current_a == amperes
        assert drive_dispatch.compute_torque(d, v) == pytest.approx(m.torque_constant * amperes)
        assert v == pytest.approx(m.resistance * amperes + m.torque_constant * omega)


def test_within_its_current_limit_an_amplifier_is_as_one_without():
    with_limit, without = filled(Servo(current_limit=5.0)), filled()
    for share, omega in ((0.4, 0.0), (1.0, 300.0), (-0.2, 77.0)):
        values = [drive_dispatch.compute_effort(d, shares(share), 1, 0.0, omega, 1e-4) for d in (with_limit, without)]
        assert values[0] == values[1]
        assert with_limit.current_a == without.current_a


def test_the_peak_torque_is_that_of_the_current_limit_where_it_is_less_than_stall():
    assert Servo("14204S004").peak_torque == pytest.approx(3.06e-2 * 96, rel=0.01), "96 A without a limit"
    assert Servo("14204S004", current_limit=10.0).peak_torque == pytest.approx(0.306)
    assert Servo("14204S004", current_limit=500.0).peak_torque == Servo("14204S004").peak_torque


def test_a_servo_says_where_its_current_limit_comes_from():
    assert Servo(current_limit=10.0, evidence={"current_limit": "data sheet of the amplifier"}).evidence == {
        "current_limit": "data sheet of the amplifier"
    }


@EVERY
def test_from_rest_a_servo_accelerates_by_its_current_limit(name):
    """Accelerate in a stage, whose <dcmotor> takes the back-EMF at the end of each step."""
    servo = Servo(name, current_limit=1.5)
    stage = Stage("xyz_servo", chips={"x": "hctl1100"}, drives={"x": servo}, visuals=False)
    x, model = stage.axes["x"], stage.model
    model.dof_frictionloss[:] = model.dof_damping[:] = 0.0
    x.chip.write(0x09, 100)  # full drive
    stage.run(0.01)
    first = stage.data.qvel[0]
    stage.run(0.02)
    force = 1.5 * servo.motor.torque_constant * abs(x.gear)
    assert abs(stage.data.qvel[0] - first) / 0.02 == pytest.approx(force / model.dof_M0[0], rel=2e-3)


@EVERY
def test_against_a_hard_stop_the_current_of_a_servo_is_its_limit(name):
    """Held, the rotor gains no speed; the torque that MuJoCo applies is that of the limit"""
    servo = Servo(name, current_limit=1.5)
    stage = Stage("xyz_servo", chips={"x": "hctl1100"}, drives={"x": servo}, visuals=False)
    x, model = stage.axes["x"], stage.model
    model.dof_frictionloss[:] = 0.0
    stage.place(x=x.travel[1])
    x.chip.write(0x09, 100)  # full drive
    stage.run(0.2)
    amperes = stage.data.actuator_force[x.plant.actuator] / servo.motor.torque_constant
    assert abs(amperes) == pytest.approx(1.5, rel=1e-3)


@EVERY
def test_a_rotor_that_a_blow_has_sped_up_brakes_with_no_more_than_the_limit(name):
    """At the next step, in which the rotor does not gain that speed again; a free rotor gains less than 4 % of the limit"""
    servo = Servo(name, current_limit=1.5)
    stage = Stage("xyz_servo", chips={"x": "hctl1100"}, drives={"x": servo}, visuals=False)
    x = stage.axes["x"]
    x.chip.write(0x09, 100)  # full drive
    for speed in (2000.0, -2000.0, -500.0):  # rad/s; the last by a push along the current
        stage.data.qvel[x.plant.dof] = speed / x.gear
        stage.run(0.00025)
        amperes = abs(stage.data.actuator_force[x.plant.actuator]) / servo.motor.torque_constant
        assert amperes == pytest.approx(1.5, rel=0.04)


# --- the motor, in MuJoCo ---


@EVERY
def test_stall_torque_is_that_of_the_formula_and_of_mujoco(name):
    m = DC_MOTORS[name]
    assert m.stall_torque == pytest.approx(m.torque_constant * m.nominal_voltage / m.resistance)
    assert Servo(name, bus_voltage=12.0).peak_torque == pytest.approx(m.stall_torque / 2)
    model, data = rotor(m)
    data.ctrl[0] = m.nominal_voltage
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[0] == pytest.approx(m.stall_torque)


@EVERY
def test_back_emf_takes_mujocos_torque_down_as_the_formula_says(name):
    m, d = DC_MOTORS[name], filled(Servo(name))
    model, data = rotor(m)
    for share, omega in ((1.0, 100.0), (0.4, -250.0), (-0.7, 77.0), (0.0, 300.0)):
        data.ctrl[0], data.qvel[0] = drive_dispatch.compute_effort(d, shares(share), 1, 0.0, omega, 1e-4), omega
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(drive_dispatch.compute_torque(d, data.ctrl[0]), rel=1e-12)


@EVERY
def test_the_no_load_speed_is_voltage_over_torque_constant(name):
    """And gets there with the mechanical time constant J R / K^2."""
    m = DC_MOTORS[name]
    model, data = rotor(m)
    data.ctrl[0] = m.nominal_voltage
    no_load, tau = m.nominal_voltage / m.torque_constant, m.rotor_inertia * m.resistance / m.torque_constant**2
    steps = round(tau / model.opt.timestep)
    mujoco.mj_step(model, data, steps)
    assert data.qvel[0] == pytest.approx(no_load * (1 - math.exp(-steps * model.opt.timestep / tau)), rel=0.02)
    mujoco.mj_step(model, data, 20 * steps)
    assert data.qvel[0] == pytest.approx(no_load, rel=1e-6)


@EVERY
def test_short_circuited_it_brakes(name):
    model, data = rotor(DC_MOTORS[name])
    data.qvel[0] = 100.0
    mujoco.mj_step(model, data)
    assert 0 < data.qvel[0] < 100.0


# --- presets and what is refused ---


@EVERY
def test_presets_say_where_their_values_come_from(name):
    m = DC_MOTORS[name]
    assert m.name == name
    assert set(m.evidence) == {"resistance", "torque_constant", "rotor_inertia", "continuous_torque", "nominal_voltage"}
    assert m.continuous_torque < m.stall_torque
    assert find_dc_motor(name) is m is find_dc_motor(m)


def test_a_servo_takes_a_motor_by_name_and_says_what_it_is():
    servo = Servo("9233S013", counts=4000)
    assert servo.motor is DC_MOTORS["9233S013"]
    assert servo.pulses_per_turn == 4000
    assert servo.title == "9233S013, encoder of 4000 counts"
    assert Drive().title == "17HS4401, 1/16 steps"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Servo("9233S031"), "Did you mean '9233S013'"),
        (lambda: Servo("17HS4401"), "unknown DC motor '17HS4401'"),
        (lambda: Servo(bus_voltage=0), "bus_voltage=0: give a number above 0, up to 400 V"),
        (lambda: Servo(bus_voltage=math.nan), "bus_voltage=nan"),
        (lambda: Servo(counts=3), "counts=3: an encoder has a whole number of counts a turn, 4 to 1,048,576"),
        (lambda: Servo(counts=2000.5), "counts=2000.5"),
        (lambda: Servo(counts=True), "counts=True"),
        (
            lambda: Servo(current_limit=-1),
            "current_limit=-1: give a number above 0, up to 1000 A, or None for an amplifier",
        ),
        (lambda: Servo(current_limit=math.inf), "current_limit=inf"),
        (lambda: DCMotor("mine", 0, 0.05, 1e-5, 0.1), "mine: resistance=0: give a number above 0, up to 1000 ohm"),
        (lambda: DCMotor("mine", 2, -0.05, 1e-5, 0.1), "mine: torque_constant=-0.05"),
        (lambda: DCMotor("mine", 2, 0.05, -1e-5, 0.1), "mine: rotor_inertia=-1e-05: give a number from 0"),
        (lambda: DCMotor("mine", 2, 0.05, 1e-5, "0.1"), "mine: continuous_torque='0.1'"),
        (lambda: DCMotor("mine", 2, 0.05, 1e-5, 0.1, 500), "mine: nominal_voltage=500"),
    ],
)
def test_what_no_motor_and_no_amplifier_has_is_refused_in_words(make, message):
    with pytest.raises(ArgumentError) as error:
        make()
    assert message in str(error.value)
