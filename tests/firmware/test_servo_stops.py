"""A servo axis that is stopped in the middle of a trapezoid, of which no register may be written, and one that is not at rest."""

import math
import random
import time

import numpy as np
import pytest

from stage import RunTimeout, Stage, StageError, firmware
from stage.chips import HCTL1100
from stage.firmware.driver import Speeds, get_driver
from stage.firmware.hctl1100.driver import Hctl1100Driver
from stage.firmware.hctl1100.moves import FilterTuning, run_in_proportional_velocity_mode, set_up_servo
from stage.panel.session import UNPACED_SPEED, Session

COUNT = 5e-6  # m
SAMPLE = 16 * 65 / 2e6  # s
SAMPLES = 6  # samples until a stop knows how fast the profile is


@pytest.fixture(scope="module")
def shared_stage():
    return Stage("xyz_servo", chips=HCTL1100, visuals=False)


@pytest.fixture
def stage(shared_stage):
    shared_stage.reset()
    return shared_stage


def braking_distance(speed, speeds):
    """Counts of a ramp from `speed` (counts/s) to rest, by the acceleration that the chip's registers hold."""
    acceleration = round(speeds.drive / speeds.up * SAMPLE**2 * 256) / 256 / SAMPLE**2
    return speed**2 / (2 * acceleration)


def commanded_speed(axis):
    """Counts/s of the profile, by two places of the command 10 samples apart."""
    before = axis.chip.net()
    axis.stage.run(10 * SAMPLE)
    return abs(axis.chip.net() - before) / (10 * SAMPLE)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("name", ["x", "z"])
@pytest.mark.parametrize("seconds", [0.06, 0.3, 0.55], ids=["speeding up", "at its speed", "slowing down"])
def test_a_stop_slows_a_trapezoid_down_with_its_ramp(stage, name, seconds, direction):
    """driver.start(5000, speeds); firmware.stop(axis)"""
    axis, speeds = stage.axes[name], Speeds(drive=10_000, up=0.1)
    driver = get_driver(axis)
    driver.start(direction * 5000, speeds)
    stage.run(seconds)
    speed, net = commanded_speed(axis), axis.chip.net()
    assert speed > 2000
    with stage.record(every=1e-3) as recording:
        firmware.stop(axis)
    shared_stage = direction * (axis.chip.net() - net)
    expected, change = braking_distance(speed, speeds), 20 * SAMPLE * speeds.drive / speeds.up
    assert (
        braking_distance(max(speed - change, 0), speeds) - SAMPLES
        < shared_stage
        < braking_distance(speed + change, speeds) + SAMPLES * speed * SAMPLE
    ), f"{expected:.0f} counts from {speed:.0f} counts/s"
    error = recording.columns[f"{name}/following_error"] / COUNT
    assert np.ptp(error) < 60, "no jerk"
    assert not axis.chip.busy()
    assert axis.position == pytest.approx(axis.commanded, abs=10 * COUNT)
    at = axis.position
    stage.run(0.2)
    assert axis.position == pytest.approx(at, abs=10 * COUNT)
    assert not axis.chip.diagnostics, "no data of a profile that runs"
    assert firmware.move(axis, pulses=-direction * 500).ok


def test_stops_at_any_moment_of_any_trapezoid_end_before_its_end_and_write_no_data_of_it(stage):
    seed = random.randrange(2**32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    x = stage.axes["x"]
    for _ in range(12):
        stage.reset()
        counts, drive = rng.randrange(1, 12_000), 10 ** rng.uniform(3.4, 4.7)
        up = drive / 10 ** rng.uniform(4.2, 5.7)
        direction = rng.choice((1, -1))
        driver = get_driver(x)
        driver.start(direction * counts, Speeds(drive=drive, up=up))
        begin = x.chip.net()
        stage.run(rng.uniform(0, 1.2 * (counts / drive + up)))
        message, at = f"{counts} counts at {drive:.0f}, {up:.3f} s, stopped at {stage.time:.4f} s", x.chip.net()
        firmware.stop(x)
        assert direction * at <= direction * x.chip.net() <= direction * begin + counts, message
        assert x.chip.values()["R00"] == 0, message
        assert not x.chip.diagnostics, message


def test_a_sample_too_short_for_commands_stops_at_once(stage, monkeypatch):
    """T = 0Fh is legal for a trapezoid, and leaves no time to write in."""
    monkeypatch.setattr(Hctl1100Driver, "tuning", FilterTuning(timer=0x0F))
    x = stage.axes["x"]
    get_driver(x).start(8000, Speeds(drive=20_000, up=0.05))
    stage.run(0.1)
    at = x.position
    firmware.stop(x)
    assert x.position - at < 1e-3
    assert not x.chip.busy()
    assert not x.chip.diagnostics


def test_a_stop_at_once_holds_a_trapezoid_where_it_is(stage):
    x = stage.axes["x"]
    get_driver(x).start(12_000, Speeds(drive=10_000))
    stage.run(0.4)
    at = x.position
    firmware.stop(x, at_once=True)
    assert abs(x.position - at) < 0.2e-3


def test_a_stop_ends_proportional_velocity(stage):
    x = stage.axes["x"]
    port = set_up_servo(x)
    port.set_control_mode("proportional velocity")
    port.wait_for_safe_part_of_sample("proportional velocity")
    port.write_quantities(proportional_velocity=6 * 16)
    stage.run(0.2)
    with pytest.raises(StageError, match="axis x is moving"):
        firmware.move(x, 1e-3)
    firmware.stop(x)
    at = x.position
    assert at > 1e-3
    stage.run(0.1)
    assert x.position == pytest.approx(at, abs=10 * COUNT)
    assert run_in_proportional_velocity_mode(port, 8000, seconds=0.05).ended == ""


STARTS = {
    "start": lambda axis: get_driver(axis).start(-500, Speeds()),
    "move": lambda axis: firmware.move(axis, -1e-3),
    "jog": lambda axis: firmware.jog(axis, 0.1, -0.02),
    "run": lambda axis: get_driver(axis).start_continuous_move(-1, Speeds()),
    "home": lambda axis: firmware.home(axis),
    "line": lambda axis: firmware.line({"x": 1e-3, "y": 1e-3}, axis.stage),
}


@pytest.mark.parametrize("call", STARTS)
def test_a_moving_axis_refuses_other_procedures_and_continues(stage, call):
    """driver.start(4000, speeds); driver.start(-500, speeds)"""
    x = stage.axes["x"]
    driver = get_driver(x)
    driver.start(4000, Speeds(drive=10_000))
    stage.run(0.1)
    with pytest.raises(StageError, match=r"axis x is moving: wait until it stops, or firmware\.stop"):
        STARTS[call](x)
    assert driver.is_running()
    assert driver.wait(3.0) == driver.DONE_REASON
    assert not driver.is_running()
    stage.run(0.1)
    assert x.position == pytest.approx(4000 * COUNT, abs=10 * COUNT)
    assert not x.chip.diagnostics


@pytest.mark.parametrize("call", STARTS)
def test_a_running_axis_refuses_other_procedures_and_continues(stage, call):
    """driver.run(1, speeds); firmware.move(axis, -1e-3)"""
    x = stage.axes["x"]
    driver = get_driver(x)
    driver.start_continuous_move(1, Speeds(drive=10_000))
    stage.run(0.2)
    with pytest.raises(StageError, match="axis x is moving"):
        STARTS[call](x)
    assert driver.is_running()
    assert commanded_speed(x) == pytest.approx(10_000, rel=0.08)
    driver.halt()
    assert not driver.is_running()
    assert firmware.move(x, -1e-3).ok


def test_a_wait_that_is_too_short_leaves_the_move_as_it_is(stage):
    """driver.wait(0.01)"""
    x = stage.axes["x"]
    driver = get_driver(x)
    driver.start(4000, Speeds(drive=10_000))
    for _ in range(2):
        with pytest.raises(RunTimeout, match=r"axis x still drives after 0\.010 s"):
            driver.wait(0.01)
    assert driver.wait(3.0) == driver.DONE_REASON
    stage.run(0.1)
    assert x.position == pytest.approx(4000 * COUNT, abs=10 * COUNT)


def test_the_panel_stops_a_move_of_a_servo_with_its_ramp():
    """session.act("move x", ...); the panel's stop"""
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    x = stage.axes["x"]
    with Session(stage, speed=UNPACED_SPEED, paused=True) as session:
        move = session.act("move x", lambda stage: firmware.move(x, pulses=24_000, speed=0.05))
        session.paused = False
        begin = time.monotonic()
        while session.view.time < 0.3:
            assert time.monotonic() - begin < 20
            time.sleep(1e-3)
        session.stop_actions()
        at = session.act("stop", lambda stage: (x.position, firmware.stop(stage.axes["x"]))).result(20)[0]
        assert isinstance(move.exception(20), StageError)
        session.paused = True
        ramp = braking_distance(10_000, Speeds(drive=10_000)) * COUNT
        assert 0.7 * ramp < x.position - at < 1.2 * ramp
        assert math.isclose(x.position, x.commanded, abs_tol=10 * COUNT)
