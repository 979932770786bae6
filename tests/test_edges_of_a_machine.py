"""Promises of stages where two things stand at once, and at the ends of what is allowed."""

import copy
import pickle

import numpy as np
import pytest

from stage import ArgumentError, Fleet, Program, RunTimeout, Stage, faults, firmware
from stage.chips import HCTL1100, MCX514, PCL240K
from stage.sim import plant


@pytest.fixture
def stage(xy):
    return xy


@pytest.fixture(scope="module")
def mirrored():
    """Stage whose screw of x has a left-hand thread."""
    spec = plant.open_spec("xy")
    next(a for a in spec.actuators if a.name == "x").gear[0] *= -1
    return Stage(spec, visuals=False)


def test_a_pickled_fleet_keeps_its_threads(stage):
    fleet = Fleet([stage, copy.deepcopy(stage)], threads=1)
    assert pickle.loads(pickle.dumps(fleet)).threads == 1


def test_a_program_may_have_the_maximum_limit(stage):
    """until_stopped of axes at rest, 1e9 s at most"""
    assert Fleet([stage]).play([Program().until_stopped([0, 1], 1e9)]).results[0, 0] >= 0


def test_a_payload_in_place_of_another_weighs_what_it_weighs_alone(stage):
    replica, body = copy.deepcopy(stage), stage.model.site("work").bodyid[0]
    separate = replica.model.body_mass[body]
    replica.set_payload(1.0)
    replica.set_payload(2.5)
    assert replica.model.body_mass[body] == separate + 2.5
    replica.set_payload(0.0)
    assert replica.model.body_mass[body] == separate


def test_a_copy_has_a_separate_payload(stage):
    first = copy.deepcopy(stage)
    first.set_payload(1.0)
    copy.copy(first).set_payload(3.0)
    assert first.payload() == 1.0


def test_a_copy_has_separate_faults(stage):
    first = copy.deepcopy(stage)
    replica = copy.deepcopy(first)
    faults.phase_open(replica.axes["x"], "a")
    assert (first.faults, len(replica.faults)) == ((), 1)


def test_a_switch_that_is_stuck_twice_is_stuck_as_first_once_the_second_fault_is_cleared(stage):
    x = stage.axes["x"]
    with faults.switch_stuck(x, "org", True):
        with faults.switch_stuck(x, "org", False):
            assert not x.switches.org
        assert x.switches.org


def test_a_jam_holds_on_a_left_hand_thread(mirrored):
    mirrored.reset()
    x = mirrored.axes["x"]
    start = x.position
    with faults.jam(x):
        report = firmware.move(x, 1e-3)
    assert report.lost_steps
    assert x.position == pytest.approx(start, abs=1e-4)


def test_where_the_pulses_say_a_left_hand_carriage_is_has_the_sign_of_its_move(mirrored):
    mirrored.reset()
    x = mirrored.axes["x"]
    start = x.position
    with faults.jam(x, 1e4):
        firmware.move(x, 1e-3)
        assert x.commanded - start == pytest.approx(1e-3, abs=1e-4)


@pytest.mark.parametrize("speed", [0.02, -0.02, None])
def test_a_left_hand_carriage_jogs_in_the_direction_of_its_speeds_sign(mirrored, speed):
    mirrored.reset()
    x = mirrored.axes["x"]
    start = x.position
    firmware.jog(x, 0.05, speed)
    assert np.sign(x.position - start) == (1 if speed is None else np.sign(speed))


def test_a_recording_has_the_commanded_place_of_a_left_hand_carriage_too(mirrored):
    mirrored.reset()
    x = mirrored.axes["x"]
    start = x.position
    with faults.jam(x, 1e4), mirrored.record() as recording:
        firmware.move(x, 1e-3)
    assert recording.column("x/commanded")[-1] - start == pytest.approx(1e-3, abs=1e-4)
    assert recording.column("x/position")[-1] == pytest.approx(start, abs=1e-4)


def test_a_step_of_none_stays(stage):
    stage.run(1e-4)
    before = stage.now
    stage.step()
    at_end = stage.now
    stage.step(0)
    assert before < stage.now == at_end


def test_a_condition_is_looked_at_no_later_than_its_timeout(stage):
    with pytest.raises(RunTimeout):
        stage.run_until(lambda: False, 2.5e-3, poll=1e-3)
    assert stage.now == 2_500_000


def test_carriages_may_be_placed_at_both_ends_of_their_travel(stage):
    for end in stage.axes["x"].travel:
        stage.place(x=end)
        assert stage.axes["x"].position == pytest.approx(end, abs=1e-5)


def test_a_device_that_comes_on_the_bus_later_leaves_power_up_where_it_was(stage):
    delayed = copy.deepcopy(stage)
    delayed.run(1e-3)
    delayed.attach_device("a latch", [np.zeros(1)])
    delayed.reset()
    assert delayed.now == stage.now


def test_supplies_that_fall_together_return_each_to_its_former_value(stage):
    replica = copy.deepcopy(stage)
    with faults.bus_voltage(replica.axes["y"], 36.0):
        separate = [axis.faults.bus_voltage for axis in replica.axes.values()]
        with faults.bus_voltage(replica, 12.0):
            assert [float(axis.read_drive()[0].voltage) for axis in replica.axes.values()] == [12.0, 12.0]
        assert [float(axis.read_drive()[0].voltage) for axis in replica.axes.values()] == separate == [24.0, 36.0]


def test_a_delayed_start_is_over_when_the_cpu_is_called_away(stage):
    replica, observed = copy.deepcopy(stage), []
    faults.start_skew(replica.axes["x"], 0.01)

    def pace(until):
        if until - replica.now > 5_000_000:
            observed.append(replica.faults)
        return until

    replica.loop.pace = pace
    firmware.move(replica.axes["x"], pulses=100)
    assert observed[0] == ()


@pytest.mark.parametrize("name", ["x", "y"])
def test_a_stuck_switch_of_any_axis_is_stuck_in_a_state_that_knew_nothing_of_it(stage, name):
    replica = copy.deepcopy(stage)
    free, axis = replica.snapshot(), replica.axes[name]
    with faults.switch_stuck(axis, "org", True):
        replica.restore(free)
        assert axis.switches.as_dict() == {pin: pin == "org" for pin in axis.switches.as_dict()}
        assert axis.pins.org


def test_models_that_differ_where_a_switch_trips_are_other_machines(stage):
    """A snapshot of a stage is refused by one whose vane of ORG is longer; colours differ in nothing."""
    spec = plant.open_spec("xy")
    vane = next(g for g in spec.geoms if g.name == "y_org_vane")
    vane.rgba = [1.0, 0.0, 0.0, 1.0]
    Stage(spec, visuals=False).restore(stage.snapshot())
    vane.size = vane.size * 1.01
    with pytest.raises(ArgumentError, match="mechanics of the model"):
        Stage(spec, visuals=False).restore(stage.snapshot())


def test_the_load_of_a_left_hand_motor_has_the_sign_of_its_pulses(mirrored):
    mirrored.reset()
    x, y = (mirrored.axes[name] for name in "xy")
    for axis in (x, y):
        mirrored.data.qfrc_applied[axis.plant.dof] = -100.0
    mirrored.run(0.2)
    mirrored.data.qfrc_applied[:] = 0.0
    assert (x.gear < 0, y.gear > 0) == (True, True)
    assert y.load_angle > 0.1, "pushed back, a rotor is behind its pulses"
    assert x.load_angle < -0.1, "and one that turns the other way is ahead of them"
    assert abs(x.load_angle) == pytest.approx(abs(y.load_angle), rel=0.2)
    assert x.position < 0 > y.position


def test_a_clock_is_for_chips_by_class_or_name_and_a_function_sets_another():
    created = Stage(
        "xy", chips={"x": "pcl240k", "y": lambda: PCL240K(clock_hz=3_000_000)}, clock=2_000_000, visuals=False
    )
    assert [axis.chip.clock_hz for axis in created.axes.values()] == [2_000_000, 3_000_000]


def test_one_chip_serves_as_many_axes_as_it_has_and_no_more():
    chip = MCX514()
    created = Stage("xyz", chips=dict.fromkeys("xyz", chip), visuals=False)
    assert [(axis.chip is chip, axis.chip_axis) for axis in created.axes.values()] == [(True, 0), (True, 1), (True, 2)]
    alone = PCL240K()
    with pytest.raises(ArgumentError, match=r"chips for axis y: .* has no axis left that is free"):
        Stage("xy", chips=dict.fromkeys("xy", alone), visuals=False)
    with pytest.raises(ArgumentError, match=r"chips for axis y: .* has no axis left that is free"):
        Stage("xy", chips={"x": lambda: alone, "y": lambda: alone}, visuals=False)
    assert not alone.attached


def test_a_servo_has_the_motor_of_the_argument_else_of_the_name_else_of_the_actuator():
    spec = plant.open_spec("xyz_servo")
    named = {t.name: t for t in spec.texts}
    named["y_motor"].data = "14203S010"
    named["z_motor"].name = "of_nobody"
    separate = next(a for a in spec.actuators if a.name == "z")
    separate.set_to_dcmotor([0.04, 0.04], 2.5)
    axes = Stage(spec, chips=HCTL1100, drives={"x": "14204S004"}, visuals=False).axes
    assert [axes[n].drive.motor.name for n in "xyz"] == ["14204S004", "14203S010", "that of axis z"]
    motor = axes["z"].drive.motor
    assert (motor.torque_constant, motor.resistance) == (0.04, 2.5)
    assert motor.continuous_torque == 0.04, "that of 1 A"
