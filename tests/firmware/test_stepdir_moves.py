"""Moves of STEP/DIR axes by a host without firmware, and pulses that a host makes itself, on a stage."""

import copy

import numpy as np
import pytest

from stage import Drive, Stage, firmware
from stage.errors import ArgumentError, RunTimeout, StageError
from stage.firmware.driver import Speeds, get_driver
from stage.testing import assert_no_lost_steps
from stage.testing.assertions import read_pulse_rate


@pytest.fixture(scope="module")
def home_snapshot():
    stage = Stage("xyz", chips="stepdir", visuals=False)
    return stage, stage.snapshot()


@pytest.fixture
def stage(home_snapshot):
    stage, snapshot = home_snapshot
    stage.restore(snapshot)
    return stage


def test_a_move_takes_the_carriage_to_the_distance_and_loses_no_step(stage):
    x = stage.axes["x"]
    report = firmware.move(x, 0.03, speed=0.05, s_curve=True)
    assert (report.ok, report.pulses, report.stopped_by, report.lost_steps) == (True, 9600, "all steps", 0)
    assert x.position == pytest.approx(0.03, abs=5e-6)
    assert report.peak_rate == pytest.approx(16_000, rel=0.01)


def test_the_duration_of_a_move_ends_with_its_profile(stage):
    """3,200 steps at 12,000 pps with ramps of 0.1 s from 2,000 pps: 2 x 700 steps on the ramps, 1,800 between them."""
    ramps = {"start_speed": 2000 * 3.125e-6, "speed": 12_000 * 3.125e-6, "accel": 0.1, "decel": 0.1}
    report = firmware.move(stage.axes["x"], pulses=3200, **ramps)
    assert report.duration == pytest.approx(0.2 + 1800 / 12_000, abs=0.5e-3)
    assert report.average_rate == pytest.approx(3200 / 0.35, rel=2e-3)
    assert report.rates[-1] == 0
    home = firmware.home(stage.axes["x"])
    assert home.rates[-1] == 0


def test_a_power_stage_that_is_disabled_is_named_as_the_cause():
    stage = Stage("xyz", chips="stepdir", drives="drv8825", visuals=False)
    x = stage.axes["x"]
    x.chip.pins.enable = False
    assert "the motor has no current: ENABLE is not asserted" in str(firmware.move(x, pulses=100))
    with pytest.raises(RunTimeout, match="The motor of x has no current: ENABLE is not asserted"):
        firmware.home(x, timeout=0.5)
    firmware.stop(x, at_once=True)
    x.chip.pins.enable = True
    assert "current" not in str(firmware.move(x, pulses=100))


def test_a_return_to_an_index_pulse_that_no_axis_has_is_refused(stage):
    with pytest.raises(ArgumentError, match="a STEPDIR ends at ORG, index=0; it has no input for index pulses"):
        firmware.home(stage.axes["x"], index=1)


def test_a_step_of_a_host_after_a_move_shows_a_rate_again(stage):
    chip = stage.axes["x"].chip
    firmware.move(stage.axes["x"], pulses=100)
    assert read_pulse_rate(stage.axes["x"]) == 0
    for _ in range(2):
        chip.pins.step = True
        stage.run(5e-6)
        chip.pins.step = False
        stage.run(995e-6)
    assert read_pulse_rate(stage.axes["x"]) == pytest.approx(1000)


def test_pulses_that_python_makes_on_the_lines_move_the_carriage(stage):
    x = stage.axes["x"]
    for _ in range(200):
        x.chip.pins.step = True
        stage.run(5e-6)
        x.chip.pins.step = False
        stage.run(245e-6)
    stage.run(0.1)
    assert x.chip.net() == 200
    assert x.position == pytest.approx(200 * 3.125e-6, abs=4e-6)


def test_a_return_to_the_origin_ends_at_its_switch_from_either_side_of_the_travel(stage):
    for place in (-0.1, 0.08, -0.12):
        stage.place(x=place)
        report = firmware.home(stage.axes["x"])
        assert report.stopped_by == "ORG"
        assert stage.axes["x"].position == pytest.approx(-0.12, abs=2e-5)


def test_a_line_keeps_within_a_step_of_its_ratio_and_ends_together(stage):
    report = firmware.line({"x": 0.03, "y": -0.0101, "z": 0.0007}, stage)
    assert report.ok
    assert report.deviation.pulses < 1.3
    assert {name: axis.pulses for name, axis in report.axes.items()} == {"x": 9600, "y": -3232, "z": 224}
    assert [stage.axes[name].lost_steps for name in "xyz"] == [0, 0, 0]


def test_a_line_that_an_end_limit_stops_ends_on_all_axes(stage):
    stage.place(x=0.145)
    report = firmware.line({"x": 0.02, "y": 0.02}, stage, speed=0.02)
    assert not report.ok
    assert {name: axis.stopped_by for name, axis in report.axes.items()} == {"x": "EL+", "y": "another axis"}


def test_a_jog_stops_with_the_ramp_down_and_a_stop_ends_a_run(stage):
    y = stage.axes["y"]
    assert firmware.jog(y, 0.2, -0.02).stopped_by == "decelerating stop"
    assert y.position < -0.003
    driver = get_driver(y)
    driver.start_continuous_move(1, Speeds())
    stage.run(0.05)
    with pytest.raises(StageError, match="axis y is moving"):
        firmware.move(y, 0.01)
    firmware.stop(y, at_once=True)
    assert not y.chip.busy()


def test_a_snapshot_in_the_middle_of_a_pulse_continues_to_the_same_bits(stage):
    get_driver(stage.axes["x"]).start(2000, Speeds())
    stage.run(0.0123456)
    other = copy.deepcopy(stage)
    for s in (stage, other):
        s.run(0.3)
    assert np.array_equal(stage.data.qpos, other.data.qpos)
    chip, other_chip = (s.axes["x"].chip for s in (stage, other))
    assert chip.state.tobytes() == other_chip.state.tobytes()
    assert chip.net() == 2000


def test_without_enable_the_motor_has_no_current_and_steps_are_lost():
    stage = Stage("xyz", chips="stepdir", drives="a4988", visuals=False)
    x = stage.axes["x"]
    x.chip.pins.enable = False
    report = firmware.move(x, 0.01)
    assert report.pulses == 3200
    assert report.lost_steps == 200
    with pytest.raises(AssertionError, match="ENABLE is not asserted"):
        assert_no_lost_steps(stage)


def test_edges_that_are_too_fast_for_the_power_stage_have_a_diagnostic_and_are_lost_by_choice():
    fast = Speeds(start=1_000, drive=200_000, up=1.0, down=1.0)
    for drops_edges in (False, True):
        drive = Drive(power_stage="drv8825", microsteps=32, drops_edges=drops_edges)
        stage = Stage("xyz", chips="stepdir", drives={"x": drive}, visuals=False)
        x = stage.axes["x"]
        x.chip.write(*x.chip.register_cycles("HIGH", 1_500)[0])
        report = firmware.move(x, pulses=2_000, speed=fast)
        assert [d.key for d in x.chip.diagnostics] == ["step-high-time"]
        assert report.pulses == (0 if drops_edges else 2_000)


def test_rates_that_the_step_timer_does_not_make_are_refused(stage):
    x = stage.axes["x"]
    with pytest.raises(ArgumentError, match=r"speed of 300000 pps: the step timer makes 1 to 200,000"):
        firmware.move(x, pulses=10, speed=Speeds(drive=300_000))
    with pytest.raises(ArgumentError, match="ramps lead up"):
        firmware.move(x, pulses=10, speed=Speeds(start=2_000, drive=1_000))
    with pytest.raises(ArgumentError, match="index"):
        firmware.home(x, index=1)
    assert not x.chip.busy()


def test_waveforms_show_the_lines_that_firmware_would_drive(stage, tmp_path):
    with stage.record() as recording:
        firmware.move(stage.axes["x"], pulses=-20)
    recording.to_vcd(tmp_path / "lines.vcd")
    text = (tmp_path / "lines.vcd").read_text()
    code = next(line.split()[3] for line in text.splitlines() if line.startswith("$var") and line.split()[4] == "STEP")
    assert text.count(f"\n1{code}\n") == 20
