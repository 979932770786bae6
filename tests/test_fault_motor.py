"""Promises of `faults.motor`: another motor on an axis of a stage that is built."""

import copy
import pickle

import mujoco
import numpy as np
import pytest
from support.programs import start_preset

from stage import ArgumentError, Drive, Stage, firmware, models
from stage.chips import HCTL1100, PCL240K
from stage.drives.motors import MOTORS, Motor
from stage.sim import faults

SMALL = "SS2422-5041"


@pytest.fixture(scope="module")
def fresh():
    return Stage("xyz", chips=PCL240K, visuals=False)


@pytest.fixture
def xyz(fresh):
    fresh.reset()
    yield fresh
    assert fresh.faults == (), "a test left a fault behind"


def get_state_bits(stage):
    return stage.snapshot().state.tobytes()


def move_fast(axis):
    """A move that asks for more than the small motor has."""
    return firmware.move(axis, distance=0.02, speed=0.1, accel=0.01)


def test_a_motor_that_is_too_small_loses_steps_until_the_fault_is_cleared(xyz):
    x = xyz.axes["x"]
    move_fast(x)
    assert x.lost_steps == 0
    as_it_was = get_state_bits(xyz)
    with faults.motor(x, SMALL) as fault:
        assert xyz.faults == (fault.text,) == (f"axis x: motor {SMALL} in place of 17HS4401",)
        xyz.reset()
        move_fast(x)
        assert x.lost_steps > 100
    xyz.reset()
    move_fast(x)
    assert get_state_bits(xyz) == as_it_was


@pytest.mark.parametrize(("model", "chip", "name"), [("xyz", PCL240K, SMALL), ("xyz_servo", HCTL1100, "14204S004")])
def test_power_up_is_that_of_a_stage_built_with_the_motor(model, chip, name):
    built = Stage(model, chips=chip, drives={"x": name}, visuals=False)
    stage = Stage(model, chips=chip, visuals=False)
    faults.motor(stage.axes["x"], name)
    stage.reset()
    assert get_state_bits(stage) == get_state_bits(built)
    for field in ("dof_armature", "dof_M0", "dof_invweight0", "actuator_gainprm"):
        assert np.array_equal(getattr(stage.model, field), getattr(built.model, field))


FITTED = "dof_armature", "dof_M0", "dof_invweight0", "body_invweight0", "actuator_damping", "actuator_acc0"


@pytest.mark.parametrize("later", ["17HS19-2004S1", SMALL, "17HS4401"])
@pytest.mark.parametrize("by_a_fault", [False, True])
def test_the_model_of_a_stage_takes_another_motor_as_its_file_does(later, by_a_fault):
    """Stage(stage.model, drives=...): the rotor and the core loss of the former stage's motor are gone."""
    first = Stage("xyz", drives={"x": SMALL if by_a_fault else "17HS19-2004S1"}, visuals=False)
    if by_a_fault:
        faults.motor(first.axes["x"], "17HS19-2004S1")
    again, expected = (Stage(source, drives={"x": later}, visuals=False) for source in (first.model, "xyz"))
    for name in FITTED:
        np.testing.assert_allclose(getattr(again.model, name), getattr(expected.model, name), rtol=1e-12, err_msg=name)


def test_a_damping_of_the_model_itself_survives_another_stage_with_another_motor():
    spec = mujoco.MjSpec.from_file(f"{models.__path__[0]}/xyz.xml")
    spec.actuator("x").damping[0] = 5e-4
    first = Stage(spec, drives={"x": "17HS19-2004S1"}, visuals=False)
    again = Stage(first.model, drives={"x": SMALL})
    assert [float(s.model.actuator_damping[0]) for s in (first, again)] == [5e-4, 5e-4]


@pytest.mark.parametrize("model", ["xyz", "xy", "gantry"])
def test_mending_all_motors_restores_the_model_to_the_bit(model):
    stage = Stage(model, chips=PCL240K, visuals=False)
    before = {name: np.array(getattr(stage.model, name)) for name in FITTED}
    for axis in stage.axes.values():
        first, second = (faults.motor(axis, name) for name in ("17HS19-2004S1", SMALL))
        first.clear()
        second.clear()
    for name, values in before.items():
        assert np.array_equal(getattr(stage.model, name), values), name


def test_a_user_defined_armature_survives_another_motor(xyz):
    x, armature = xyz.axes["x"], xyz.model.dof_armature
    dof, as_built = x.plant.dof, armature.copy()
    rotors = [MOTORS[name].rotor_inertia * x.gear**2 for name in ("17HS4401", SMALL)]
    armature[dof] += 2.0
    with faults.motor(x, SMALL):
        assert armature[dof] == pytest.approx(as_built[dof] + 2.0 + rotors[1] - rotors[0])
    assert armature[dof] == pytest.approx(as_built[dof] + 2.0)
    armature[:] = as_built


def test_a_change_amid_a_move_makes_no_jump_and_no_other_axis_sees_it(xyz):
    x, y = xyz.axes["x"], xyz.axes["y"]
    for axis in (x, y):
        start_preset(axis.chip, 10_000)
    xyz.run(0.3001234)
    before = x.position, x.load_angle, y.position, y.load_angle
    with faults.motor(x, SMALL):
        assert (x.position, x.load_angle, y.position, y.load_angle) == before
        xyz.run(0.1)
        assert x.position == pytest.approx(y.position, rel=1e-3)
        assert x.lost_steps == 0


def test_a_snapshot_of_another_motor_is_refused_until_that_motor_is_back(xyz):
    x, before = xyz.axes["x"], xyz.snapshot()
    with faults.motor(x, SMALL):
        between, now = xyz.snapshot(), get_state_bits(xyz)
        with pytest.raises(ArgumentError, match=f"drive of axis x: 17HS4401, .* there, {SMALL}, .* here"):
            xyz.restore(before)
        assert get_state_bits(xyz) == now
        xyz.restore(between)
    with pytest.raises(ArgumentError, match=f"drive of axis x: {SMALL}, .* there, 17HS4401"):
        xyz.restore(between)
    xyz.restore(before)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_copies_have_it_and_go_on_bit_for_bit(xyz, copied):
    with faults.motor(xyz.axes["x"], SMALL):
        replica = copied(xyz)
        assert replica.faults == xyz.faults
        assert replica.axes["x"].drive == Drive(SMALL)
        for stage in (xyz, replica):
            move_fast(stage.axes["x"])
        assert get_state_bits(replica) == get_state_bits(xyz)
        for stage in (xyz, replica):
            stage.reset()
        assert get_state_bits(replica) == get_state_bits(xyz)


def test_a_supply_that_fell_and_a_load_stay_what_they_are(xyz):
    x = xyz.axes["x"]
    xyz.set_payload(1.0)
    with faults.bus_voltage(x, 12.0), faults.motor(x, SMALL):
        assert (x.faults.bus_voltage, float(x.read_drive()[0].voltage)) == (12.0, 12.0)
        assert xyz.payload() == 1.0
    xyz.set_payload(0.0)


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("23HS22", "motor of axis x"),
        ("14204S004", "motor of axis x"),
        ("17HS4401", "axis x has it already"),
        (Motor("fine", 1.5, 2.3, 4e-3, 0.45, 0.02, 5e-6, 400), "400 steps a turn"),
    ],
)
def test_a_motor_that_does_not_fit_is_refused_and_nothing_has_changed(xyz, argument, message):
    before = get_state_bits(xyz), xyz.header, xyz.model.dof_armature.tolist()
    with pytest.raises(ArgumentError, match=message):
        faults.motor(xyz.axes["x"], argument)
    assert (get_state_bits(xyz), xyz.header, xyz.model.dof_armature.tolist()) == before


def test_every_preset_can_take_the_place_of_every_other(xyz):
    for name in MOTORS:
        if name != xyz.axes["z"].drive.motor.name:
            with faults.motor(xyz.axes["z"], name):
                assert xyz.axes["z"].drive.motor is MOTORS[name]


def test_a_stage_with_a_device_on_its_bus_has_it_in_its_snapshots_with_any_motor(xyz):
    stage = copy.deepcopy(xyz)
    stage.attach_device("a latch", [np.zeros(3, np.uint8)])
    device = stage.header.parts[-1]
    assert "a latch" in device[1]
    with faults.motor(stage.axes["x"], SMALL):
        assert stage.header.parts[-1] == device
        stage.restore(stage.snapshot())
        stage.reset()


@pytest.mark.parametrize("name", [SMALL, "17HS19-2004S1"])
def test_the_currents_follow_the_resistance_and_inductance_of_the_new_motor(xyz, name):
    """Check the decay and the gain of a current per slice, which depend on resistance and inductance."""
    x = xyz.axes["x"]
    start_preset(x.chip, 10_000)
    xyz.run(0.05)
    old, new = x.drive.motor, MOTORS[name]
    record = xyz.state.drives[x.index]

    def check(motor):
        xyz.run(0.001)
        keep = np.exp(-float(record["slice"]) * motor.resistance / motor.inductance)
        assert float(record["keep"]) == pytest.approx(keep, rel=1e-12)
        assert float(record["reach"]) == pytest.approx((1 - keep) * x.faults.bus_voltage / motor.resistance, rel=1e-12)

    check(old)
    with faults.motor(x, name):
        check(new)
    check(old)
