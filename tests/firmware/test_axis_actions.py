"""Moves, homings, jogs and stops that begin at once and go on while time passes: several axes, every family, other threads."""

import math
import threading
from itertools import pairwise

import pytest

from stage import ArgumentError, RunTimeout, Stage, firmware
from stage.chips import PCL240MK
from stage.errors import StageError
from stage.firmware import Bench
from stage.firmware.driver import get_driver
from stage.panel.real_time_clock import UNPACED_SPEED
from stage.panel.session import Session

MACHINES = {
    "PCL240K": "xyz", "PCL240MK": "xyz", "MCX304": "xyz", "MCX514": "xyz", "HCTL1100": "xyz_servo", "STEPDIR": "xyz",
}  # fmt: skip


@pytest.fixture(scope="module")
def machines():
    return {chips: Stage(model, chips=chips, visuals=False) for chips, model in MACHINES.items()}


@pytest.fixture(params=MACHINES)
def stage(request, machines):
    machines[request.param].reset()
    return machines[request.param]


def run_until_done(stage, *actions, limit=30.0):
    """Let time pass until all actions are done, and raise the first error."""
    end = stage.time + limit
    while not all(action.is_done for action in actions):
        assert stage.time < end, actions
        stage.run(0.02)
    for action in actions:
        if action.error is not None:
            raise action.error


def test_three_axes_move_simultaneously(stage):
    distances = {"x": 20e-3, "y": -12e-3, "z": 4e-3}
    actions = [firmware.begin_move(stage.axes[n], d, speed=40e-3, accel=0.1) for n, d in distances.items()]
    run_until_done(stage, *actions)
    assert stage.time < 20 / 40 + 0.1 + 0.2, "one after the other they would take 0.9 s and three ramps"
    for (name, distance), action in zip(distances.items(), actions, strict=True):
        axis = stage.axes[name]
        assert abs(axis.position - distance) < 30e-6
        assert action.report.ok
        assert action.report.axis == name


def test_two_axes_home_at_once_while_a_third_one_moves_by_a_blocking_call(stage):
    for name in "xy":
        stage.place(**{name: -0.11 if name == "x" else -0.06})
    actions = [firmware.begin_home(stage.axes[n], speed=30e-3, accel=0.1) for n in "xy"]
    report = firmware.move(stage.axes["z"], 5e-3, speed=20e-3)
    assert report.ok
    run_until_done(stage, *actions)
    for action in actions:
        assert action.report.stopped_by == "ORG"
        place = action.axis.switches.list_trip_positions()["org"]
        assert abs(action.axis.position - place) < 60e-6


def test_a_stop_in_a_homing_brings_the_axis_to_rest_and_leaves_the_others_alone(stage):
    first, second = (firmware.begin_home(stage.axes[n], speed=20e-3, accel=0.05) for n in "xz")
    stage.run(0.6)
    x = stage.axes["x"]
    assert firmware.read_axis_state(x).is_moving
    stop = firmware.begin_stop(x)
    run_until_done(stage, stop)
    assert first.was_cancelled
    assert first.report is None
    assert not firmware.read_axis_state(x).is_moving
    assert x.position > -0.1, "it was far from its origin"
    before = x.position
    run_until_done(stage, second)
    assert second.report.stopped_by == "ORG"
    assert abs(x.position - before) < 1e-4
    assert firmware.move(x, 1e-3).ok, "after the stop the axis obeys as before"


def test_a_jog_runs_until_its_limit_switch_and_its_report_names_it(stage):
    stage.place(x=-0.13)
    jog = firmware.begin_jog(stage.axes["x"], -30e-3)
    run_until_done(stage, jog)
    assert jog.report.stopped_by == "EL-"
    trip = stage.axes["x"].switches.list_trip_positions()["el_minus"]
    assert abs(stage.axes["x"].position - trip) < 1e-3


def test_a_second_action_of_an_axis_is_refused_and_the_first_one_continues(stage):
    x = stage.axes["x"]
    action = firmware.begin_move(x, 10e-3)
    for call in (firmware.begin_move, firmware.move):
        with pytest.raises(StageError, match="axis x has an action under way: move"):
            call(x, 1e-3)
    assert firmware.find_action(x).name == "move"
    assert action.wait().ok
    assert firmware.find_action(x) is None


def test_a_wrong_argument_is_refused_before_anything_moves(stage):
    x = stage.axes["x"]
    with pytest.raises(ArgumentError, match="speed"):
        firmware.begin_move(x, 1e-3, speed=-1.0)
    with pytest.raises(ArgumentError, match="distance"):
        firmware.begin_move(x, math.nan)
    assert firmware.find_action(x) is None
    assert not firmware.read_axis_state(x).is_moving


def test_an_action_makes_the_same_move_as_the_blocking_call_bit_by_bit(stage):
    x = stage.axes["x"]
    by_call = firmware.move(x, 7e-3)
    stage.reset()
    by_action = firmware.begin_move(x, 7e-3).wait()
    assert (by_action.pulses, by_action.duration, by_action.position) == (
        by_call.pulses,
        by_call.duration,
        by_call.position,
    )


def test_runs_with_actions_repeat_bit_by_bit(stage):
    def run():
        stage.reset()
        actions = [firmware.begin_move(stage.axes[n], d) for n, d in (("x", 5e-3), ("y", -3e-3))]
        run_until_done(stage, *actions)
        return stage.snapshot().state.tobytes()

    assert run() == run()


def test_the_counter_of_the_controller_counts_and_can_be_set(stage):
    x = stage.axes["x"]
    driver = get_driver(x)
    if not driver.can_set_position_counter:
        with pytest.raises(ArgumentError, match=r"no position counter|cannot be set"):
            driver.write_position_counter(5)
        return
    firmware.move(x, pulses=640)
    driver.write_position_counter(-5_000)
    position = x.position
    assert driver.read_position_counter() == pytest.approx(-5_000, abs=1)
    report = firmware.move(x, pulses=320)
    assert driver.read_position_counter() == pytest.approx(-4_680, abs=3)
    assert x.position - position == pytest.approx(report.pulses * x.meters_per_pulse, abs=30e-6)
    with pytest.raises(ArgumentError, match="whole numbers from"):
        driver.write_position_counter(1 << 40)


def test_a_servo_that_cruises_in_a_velocity_mode_is_moving():
    stage = Stage("xyz_servo", chips="HCTL1100", visuals=False)
    x = stage.axes["x"]
    driver = get_driver(x)
    port = driver.prepare()
    from stage.firmware.hctl1100.moves import start_integral_velocity_mode

    start_integral_velocity_mode(port, 2_000, 100_000)
    stage.run(0.2)
    assert not x.chip.busy(0), "no trapezoid is in progress"
    assert driver.is_moving
    assert firmware.read_axis_state(x).speed == pytest.approx(2_000 * x.meters_per_pulse, rel=0.1)
    firmware.begin_stop(x).wait()
    assert not driver.is_moving


def test_another_thread_reads_states_while_this_one_lets_time_pass(stage):
    x, states, stop = stage.axes["x"], [], threading.Event()

    def observe():
        while not stop.is_set():
            states.append(firmware.read_axis_state(x))

    thread = threading.Thread(target=observe)
    action = firmware.begin_move(x, 10e-3, speed=20e-3)
    thread.start()
    try:
        while not action.is_done:
            stage.run(0.05)
    finally:
        stop.set()
        thread.join()
    times = [state.time for state in states]
    assert times == sorted(times)
    assert len(states) > 10
    assert all(-1e-3 < state.commanded < 11e-3 for state in states)
    steps = [b.pulses - a.pulses for a, b in pairwise(states)]
    assert min(steps) >= 0, "the pulses of a move towards plus never decrease"


def test_actions_go_on_in_a_session_and_orders_begin_and_stop_them(stage):
    with Session(stage, speed=UNPACED_SPEED) as session:
        x = session.do(lambda stage: stage.axes["x"])
        action = session.do(lambda stage: firmware.begin_jog(x, 20e-3))
        session.act("wait", lambda stage: stage.run(0.3)).result(30)
        assert firmware.read_axis_state(x).is_moving
        stop = session.do(lambda stage: firmware.begin_stop(x))
        session.act("wait", lambda stage: stage.run_until(lambda: stop.is_done, 5.0)).result(30)
        assert action.was_cancelled
        assert not firmware.read_axis_state(x).is_moving


def test_a_loaded_state_ends_the_actions(stage):
    before = stage.snapshot()
    action = firmware.begin_move(stage.axes["x"], 10e-3)
    stage.run(0.1)
    stage.restore(before)
    stage.run(0.01)
    assert action.is_done
    assert action.was_cancelled
    assert firmware.find_action(stage.axes["x"]) is None


def test_a_move_that_takes_too_long_ends_with_its_error_and_report():
    bench = Bench(x=PCL240MK())
    action = firmware.begin_move(bench.axes["x"], pulses=100_000, timeout=0.1)
    bench.wait(0.2)
    assert isinstance(action.error, RunTimeout)
    assert action.error.report.stopped_by == "timeout"
    with pytest.raises(RunTimeout):
        action.wait()


def test_waiting_for_an_action_has_a_separate_time_limit():
    bench = Bench(x=PCL240MK())
    action = firmware.begin_move(bench.axes["x"], pulses=100_000)
    with pytest.raises(RunTimeout, match=r"move of axis x still goes on after 0.1 s"):
        action.wait(0.1)
    assert not action.is_done
    action.cancel()


def test_no_thread_is_left_when_actions_are_done():
    before = threading.active_count()
    bench = Bench(x=PCL240MK(), y=PCL240MK())
    actions = [firmware.begin_move(axis, pulses=500) for axis in bench.axes.values()]
    for action in actions:
        action.wait()
    assert threading.active_count() == before


def test_the_top_rate_of_a_chip_is_a_rate_that_it_accepts(stage):
    x = stage.axes["x"]
    driver = get_driver(x)
    top = driver.max_rate * x.meters_per_pulse
    firmware.begin_jog(x, 0.999 * top, accel=0.5).cancel()
    with pytest.raises(ArgumentError):
        firmware.begin_jog(x, 1.01 * top, accel=0.5)
