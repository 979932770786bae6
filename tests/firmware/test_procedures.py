"""One driver a family: move, home, line, jog and stop with every chip, in physical units, with the same report."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stage import ArgumentError, Drive, RunTimeout, Stage, StageError, faults, firmware
from stage.chips import CHIPS, HCTL1100, MCX304, MCX312, MCX501, MCX514, PCL240K, PCL240MK, PCL240MS, STEPDIR
from stage.firmware import Bench
from stage.firmware.driver import (
    SETTLING_TIME_S,
    Driver,
    ImmediateOperations,
    Speeds,
    get_default_speeds,
    get_driver,
    get_driver_class,
    wait_until_stopped,
)
from stage.firmware.move_report import ProcedureObserver
from stage.firmware.procedures import move_at_two_rates, parse_speeds
from stage.firmware.stop_reasons import UNWANTED_REASONS
from stage.sim import plant

EVERY = list(CHIPS.built_in)
STEPPING = [name for name in EVERY if not CHIPS[name].SERVO]
NEAR = 25e-6  # m: following error at rest, of a stepper under friction and of a servo within its deadband


@pytest.fixture(scope="module")
def stages():
    return {name: Stage("xy", chips=name, visuals=False) for name in EVERY}


@pytest.fixture
def stage(stages, request):
    stages[request.param].reset()
    return stages[request.param]


each = pytest.mark.parametrize("stage", EVERY, indirect=True)


@each
def test_a_move_in_meters_reaches_and_reports_its_position(stage):
    """firmware.move(axis, 10e-3)"""
    x = stage.axes["x"]
    report = firmware.move(x, 6e-3, speed=0.05, accel=0.1)
    assert report.ok
    assert (report.axis, report.unit, report.lost_steps) == ("x", "m", 0)
    assert report.pulses == report.asked == round(6e-3 / x.meters_per_pulse)
    assert report.position == pytest.approx(6e-3, abs=NEAR)
    assert report.position == pytest.approx(x.position)
    assert report.peak_rate <= 0.05 / x.meters_per_pulse * 1.05
    assert 6e-3 / 0.05 <= report.duration < 0.5
    assert "x: done, stopped by" in str(report)
    back = firmware.move(x, pulses=-report.pulses, speed=0.05, accel=0.1)
    assert back.ok
    assert back.pulses == -report.pulses
    assert x.position == pytest.approx(0, abs=NEAR)
    assert stage.chips[0].diagnostics == []


@each
def test_each_homing_method_of_a_chip_calls_its_driver_with_or_without_the_index(stage, monkeypatch):
    """firmware.home(axis, by="index"); stage home x --by index"""
    axis, calls = stage.axes["x"], []
    driver = get_driver(axis)
    monkeypatch.setattr(
        type(driver), "home", lambda self, direction, speeds, index, timeout: calls.append((direction, index, timeout))
    )
    for by in driver.list_homing_methods():
        firmware.home(axis, 1, by=by, timeout=9.0)
    assert calls == [(1, False, 9.0), (1, True, 9.0)][: 1 if type(axis.chip) in (PCL240K, STEPDIR) else 2]
    firmware.home(axis, 1, by=driver.list_homing_methods()[-1], index=len(calls) == 2)
    with pytest.raises(ArgumentError, match=r"home by 'nose': an? \w+ cannot; it homes by switch"):
        firmware.home(axis, by="nose")
    with pytest.raises(ArgumentError, match="give one of the two"):
        firmware.home(axis, by="switch", index=True)


@each
def test_home_ends_at_the_origin(stage):
    """firmware.home(axis)"""
    x = stage.axes["x"]
    touch = next(s.touch for s in x.plant.switches if s.pin == "org")
    stage.place(x=touch + 4e-3)
    report = firmware.home(x, speed=0.03)
    assert report.stopped_by == "ORG"
    assert report.asked is None
    assert x.position == pytest.approx(touch, abs=60e-6)
    stage.place(x=touch - 2e-3)  # beyond it
    assert firmware.home(x, speed=0.03).stopped_by == "ORG"
    assert x.position == pytest.approx(touch, abs=60e-6)


@each
def test_homing_that_meets_the_end_limit_instead_of_org_reports_it(stage):
    """with faults.vane_missing(x, "org"): firmware.home(x)"""
    x = stage.axes["x"]
    touch = {s.pin: s.touch for s in x.plant.switches}
    stage.place(x=touch["org"] + 4e-3)
    with faults.vane_missing(x, "org"):
        report = firmware.home(x, speed=0.05)
    assert report.stopped_by == "EL-"
    assert not report.ok
    assert x.position == pytest.approx(touch["el_minus"], abs=1e-3)
    assert x.time < 15, "long before it gives up, after 60 s"


@pytest.mark.parametrize(("stage", "name"), [("MCX304", "x"), ("MCX302", "y")], indirect=["stage"])
def test_homing_may_begin_on_an_end_limit(stage, name):
    """stage.place(x=-0.1505); firmware.home(x)"""
    axis = stage.axes[name]
    touch = {s.pin: s.touch for s in axis.plant.switches}
    stage.place(**{name: touch["el_minus"] - 5e-4})
    assert firmware.home(axis, speed=0.1).stopped_by == "ORG"
    assert axis.position == pytest.approx(touch["org"], abs=60e-6)


@each
def test_a_move_is_started_first_and_awaited_later(stage):
    """driver.start(6400, Speeds()); driver.wait(5.0)"""
    x, samples = stage.axes["x"], []
    driver = get_driver(x)
    driver.start(6400, Speeds(drive=20_000))
    x.wait(0.02)
    assert x.chip.busy(x.chip_axis)
    assert driver.wait(5.0, lambda: samples.append(x.time)) == driver.DONE_REASON
    assert len(samples) > 10
    assert not x.chip.busy(x.chip_axis)
    x.wait(0.1)
    assert x.position == pytest.approx(6400 * x.meters_per_pulse, abs=NEAR)
    driver.start(6400, Speeds(drive=20_000))
    x.wait(0.1)
    with faults.switch_stuck(x, "el_plus", True):
        assert driver.wait(5.0) == "EL+"


@pytest.mark.parametrize("name", STEPPING)
def test_a_driver_reports_the_stop_reason_of_its_last_run_only_after_the_stop(name):
    """driver.start(-300, Speeds()); driver.wait(5.0); driver.start_continuous_move(1, Speeds()); driver.read_stop_reason()"""
    x = Bench(x=CHIPS[name]()).axes["x"]
    driver = get_driver(x)
    driver.start(-300, Speeds())
    assert driver.read_stop_reason() == ""
    assert driver.wait(5.0) == driver.DONE_REASON
    assert x.chip.net(0) == -300
    driver.start_continuous_move(1, Speeds())
    x.wait(0.05)
    assert (driver.is_running(), driver.read_stop_reason()) == (True, "")
    driver.halt()
    assert not driver.is_running()
    assert driver.read_stop_reason() != driver.DONE_REASON


@pytest.mark.parametrize("stage", STEPPING, indirect=True)
def test_ramps_last_the_requested_time(stage):
    """firmware.move(x, pulses=8000, accel=0.2)"""
    x = stage.axes["x"]
    report = firmware.move(x, pulses=8000, accel=0.2)
    assert report.ok
    began, top = (np.flatnonzero(report.rates > share * report.rates.max())[0] for share in (0, 0.999))
    assert report.waveforms.seconds[top] - report.waveforms.seconds[began] == pytest.approx(0.2, rel=0.03)


@each
def test_a_chip_without_a_second_rate_moves_at_the_higher_one(stage):
    x = stage.axes["x"]
    report = move_at_two_rates(
        x, pulses=16_000, speed=Speeds(drive=10_000, up=0.05, down=0.05).with_second_rate(20_000), dwell=0.1
    )
    assert report.ok
    assert report.peak_rate == pytest.approx(20_000, rel=0.05)
    at_first = np.diff(report.waveforms.seconds)[np.abs(report.rates[:-1] - 10_000) < 50].sum()
    assert at_first > 0.1 if x.chip.MAP.chip.startswith("PCL240") else at_first < 0.01


@each
def test_jog_runs_for_the_requested_time_and_stops_with_a_ramp(stage):
    x = stage.axes["x"]
    report = firmware.jog(x, 0.3, -0.02, accel=0.05)
    assert report.stopped_by == "decelerating stop"
    assert -0.02 * 0.36 < report.position < -0.02 * 0.2
    assert report.peak_rate == pytest.approx(0.02 / x.meters_per_pulse, rel=0.08)
    before = x.position
    stage.run(0.05)
    assert x.position == pytest.approx(before, abs=NEAR), "it stands"


@pytest.mark.parametrize("name", STEPPING)
def test_a_jog_runs_in_the_plus_direction_by_default_and_one_of_0_s_makes_at_most_one_pulse(name):
    """firmware.jog(axis, 0.05)"""
    x = Bench(x=CHIPS[name]()).axes["x"]
    assert 300 < firmware.jog(x, 0.05).pulses < 400
    report = firmware.jog(x, 0)
    assert (report.stopped_by, report.asked, report.ok) == ("decelerating stop", None, True)
    assert report.pulses <= 1


@pytest.mark.parametrize(("name", "least", "maximum"), [("MCX304", 20, 160_000), ("MCX514", 1, 8_000_000)])
def test_a_nova_chip_moves_at_every_speed_of_its_stated_range_and_at_no_other(name, least, maximum):
    """firmware.move(axis, pulses=3, speed=..., start_speed=...) at the bounds"""
    driver = get_driver(Bench(x=CHIPS[name]()).axes["x"])
    for start, drive in [(least, least), (least, 1000), (1000, 1000), (1000, maximum)]:
        assert driver.move(3, Speeds(start, drive)).ok
    for start, drive, message in [
        (least * 0.99, 1000, f"start speed {least * 0.99:g} pps: .* makes {least:g} to {maximum:g} pps"),
        (1000, maximum * 1.01, f"drive speed {maximum * 1.01:g} pps"),
        (1001, 1000, "start speed 1001 pps is above the drive speed 1000"),
    ]:
        with pytest.raises(ArgumentError, match=message.replace("+", r"\+")):
            driver.move(3, Speeds(start, drive))


@pytest.mark.parametrize("stage", ["MCX304", "MCX514"], indirect=True)
def test_a_line_of_nova_axes_refuses_impossible_lines_and_reports_stop_reasons(stage):
    """firmware.line({"x": 6e-3, "y": 2e-3}, stage) of axes that move, too fast, without time, onto a limit"""
    x, y = stage.axes["x"], stage.axes["y"]
    get_driver(y).start_continuous_move(1, Speeds())
    stage.run(0.01)
    with pytest.raises(StageError, match="axis y is moving"):
        firmware.line({"x": 1e-3, "y": 1e-3}, stage)
    firmware.stop(y)
    with pytest.raises(ArgumentError, match=r"drive speed .* pps: up to .* here"):
        firmware.line({"x": 1e-3, "y": 1e-3}, stage, speed=60)
    with pytest.raises(ArgumentError, match=r"start speed 3.2e\+203 pps is above the drive speed"):
        firmware.line({"x": 1e-3, "y": 1e-3}, stage, start_speed=1e198)
    started = {a.name: a.chip.net(a.chip_axis) for a in (x, y)}
    with pytest.raises(RunTimeout) as caught:
        firmware.line({x: 6e-3, y: 2e-3}, timeout=0.05)
    reports = caught.value.reports
    assert {n: r.stopped_by for n, r in reports.items()} == {"x": "timeout", "y": "timeout"}
    assert all(0 < stage.axes[n].chip.net(stage.axes[n].chip_axis) - started[n] < r.asked for n, r in reports.items())
    stage.reset()
    with faults.switch_stuck(x, "el_plus", True):
        report = firmware.line({"x": 6e-3, "y": 2e-3}, stage)
    assert not report.ok
    assert report.axes["x"].stopped_by == "EL+"


@each
def test_stop_ends_a_run_and_the_axis_can_move_again(stage):
    for at_once in (False, True):
        x = stage.axes["x"]
        driver = get_driver(x)
        driver.start_continuous_move(1, Speeds(500, 4000, 0.05, 0.05))
        stage.run(0.1)
        with pytest.raises(StageError, match="axis x is moving"):
            firmware.move(x, 1e-3)
        started = x.position
        firmware.stop(x, at_once)
        if stage.chips[0].SERVO:
            stood = x.position
            stage.run(0.02)
            assert x.position == pytest.approx(stood, abs=60e-6), "a servo has come to rest when stop returns"
        assert x.position - started < 0.004
        stage.run(0.3)
        rest = x.position
        stage.run(0.05)
        assert x.position == pytest.approx(rest, abs=NEAR)
        assert firmware.move(x, -2e-3).ok, "and can be moved again"


@pytest.mark.parametrize("name", STEPPING)
def test_a_stop_at_once_makes_no_more_pulses_and_one_with_a_ramp_does(name):
    """firmware.stop(axis, at_once=True)"""
    for direction in (1, -1):
        more = []
        for at_once in (True, False):
            x = Bench(x=CHIPS[name]()).axes["x"]
            get_driver(x).start_continuous_move(direction, Speeds(500, 4000, 0.05, 0.05))
            x.wait(0.1)
            before = x.chip.net(x.chip_axis)
            firmware.stop(x, at_once)
            more.append(direction * (x.chip.net(x.chip_axis) - before))
        assert more[0] <= 1
        assert 50 < more[1] < 200


@pytest.mark.parametrize("stage", ["HCTL1100"], indirect=True)
def test_a_servo_stopped_at_once_holds_where_it_is_and_one_with_a_ramp_slows_down(stage):
    """firmware.stop(axis, at_once=True)"""
    direction = []
    for at_once in (True, False):
        stage.reset()
        x = stage.axes["x"]
        get_driver(x).start_continuous_move(1, Speeds(500, 20_000, 0.05, 0.05))
        x.wait(0.1)
        before = x.position
        firmware.stop(x, at_once)
        direction.append(x.position - before)
    assert abs(direction[0]) < 0.2e-3
    assert direction[1] > 1e-3


@pytest.mark.parametrize("stage", [name for name in STEPPING if name.startswith("MCX")], indirect=True)
def test_the_drawing_of_a_run_has_the_command_that_stopped_it(stage):
    """firmware.jog(axis, 0.1, 0.02).plot()"""
    x = stage.axes["x"]
    report = firmware.jog(x, 0.05, 0.02, accel=0.2)
    notes = get_driver(x).PATTERN_CLASS(report).make_annotations(report.waveforms.seconds - report.began)
    assert [note.words for note in notes if "decelerating stop" in note.words] == ["X decelerating stop"]


@each
def test_a_line_stays_near_the_straight_line(stage):
    """firmware.line({"x": 20e-3, "y": -7.5e-3}, stage.axes)"""
    if isinstance(stage.chips[0], MCX501):
        with pytest.raises(ArgumentError, match="axes x, y are on several MCX501"):
            firmware.line({"x": 6e-3, "y": -2.25e-3}, stage.axes, speed=0.04)
        return
    report = firmware.line({"x": 6e-3, "y": -2.25e-3}, stage.axes, speed=0.04)
    assert report.ok
    assert stage.axes["x"].position == pytest.approx(6e-3, abs=NEAR)
    assert stage.axes["y"].position == pytest.approx(-2.25e-3, abs=NEAR)
    assert report.deviation.pulses < (6 if stage.chips[0].SERVO else 1.5)
    assert report.carriage_deviation < 60e-6
    assert {n: r.pulses for n, r in report.axes.items()} == report.distances
    assert math.isclose(report.distances["y"] / report.distances["x"], -0.375, abs_tol=1e-3)


def test_the_speed_of_a_line_is_that_of_its_longest_axis_in_both_directions():
    """firmware.line({"x": -6e-3, "y": 3e-3}, stage, speed=0.02), x with 16 microsteps, y with 8"""
    stage = Stage("xy", drives={"x": Drive(microsteps=16), "y": Drive(microsteps=8)}, visuals=False)
    report = firmware.line({"x": -6e-3, "y": 3e-3}, stage, speed=0.02)
    assert report.axes["x"].peak_rate * stage.axes["x"].meters_per_pulse == pytest.approx(0.02, rel=0.01)


@each
def test_an_end_limit_is_reported_by_name(stage):
    x = stage.axes["x"]
    touch = next(s.touch for s in x.plant.switches if s.pin == "el_plus")
    stage.place(x=touch - 3e-3)
    report = firmware.move(x, 6e-3, speed=0.02)
    assert report.stopped_by == "EL+"
    assert not report.ok
    assert "NOT as asked, stopped by EL+" in str(report)
    assert firmware.move(x, -5e-3, speed=0.02).ok, "the way back is free"


@pytest.mark.parametrize("stage", ["HCTL1100"], indirect=True)
def test_a_line_of_servos_that_meets_a_limit_reports_it(stage):
    """firmware.line({"x": 6e-3, "y": 2e-3}, stage.axes), 2 mm before the end limit of x"""
    touch = next(s.touch for s in stage.axes["x"].plant.switches if s.pin == "el_plus")
    stage.place(x=touch - 2e-3)
    report = firmware.line({"x": 6e-3, "y": 2e-3}, stage.axes, speed=0.04)
    assert not report.ok
    assert report.axes["x"].stopped_by == "EL+"
    assert report.axes["y"].stopped_by != "EL+"


@pytest.mark.parametrize("stage", [name for name in STEPPING if CHIPS[name].AXES > 1], indirect=True)
@pytest.mark.parametrize("pulses", [5_000_000_000, -5_000_000_000, 10**24, int(1e300)], ids="{:.0e}".format)
def test_a_line_longer_than_the_chip_counts_is_refused_and_nothing_moves(stage, pulses):
    """5e9 pulses are 705,032,704 and a carry in 32 bits"""
    for also in (16, 0):
        with pytest.raises(ArgumentError):
            firmware.line({"x": pulses, "y": also}, stage, pulses=True)
    assert not any(a.chip.net(a.chip_axis) for a in stage.axes.values())
    assert stage.axes["x"].chip.diagnostics == []


@pytest.mark.parametrize("stage", ["MCX514", "MCX512", "MCX312", "MCX314AS"], indirect=True)
def test_a_line_whose_finish_point_exceeds_its_register_is_refused(stage):
    """3e9 pulses are -1,294,967,296 in a signed register of 32 bits: the other way"""
    with pytest.raises(ArgumentError, match=r"2147483646|2147483647 to each side"):
        firmware.line({"x": 3_000_000_000, "y": 16}, stage, pulses=True)
    assert not any(a.chip.net(a.chip_axis) for a in stage.axes.values())


@pytest.mark.parametrize("stage", ["HCTL1100"], indirect=True)
def test_a_line_of_servos_beyond_the_position_register_or_the_time_limit_is_refused(stage):
    for distance in (42.0, -42.0, 1e18, 1e300):  # m; 24 bits are 8,388,608 counts of 5 um to each side: 41.9 m
        with pytest.raises(ArgumentError, match="from -8388608 to 8388607"):
            firmware.line({"x": distance, "y": 1e-3}, stage)
    for rate in ({"speed": 1e-9}, {"speed": 1e-300}, {"accel": 1e300}):
        with pytest.raises(ArgumentError, match="up to 5200 s"):
            firmware.line({"x": 1e-3}, stage, **rate)
    assert stage.axes["x"].position == pytest.approx(0, abs=1e-9)
    assert firmware.line({"x": 1e-3}, stage).ok


@pytest.mark.parametrize("stage", ["HCTL1100", "MCX514", "MCX512"], indirect=True)
def test_an_axis_that_never_starts_because_of_a_limit_of_the_line_was_stopped_by_another_axis(stage):
    stage.place(x=0.1505)
    report = firmware.line({"x": 6e-3, "y": 2e-3}, stage)
    assert {n: r.stopped_by for n, r in report.axes.items()} == {"x": "EL+", "y": "another axis"}


@each
def test_a_jog_onto_an_end_limit_reports_it(stage):
    x = stage.axes["x"]
    touch = {s.pin: s.touch for s in x.plant.switches}
    stage.place(x=touch["el_plus"] - 2e-3)
    assert firmware.jog(x, 0.5, 0.02).stopped_by == "EL+"
    stage.place(x=touch["el_minus"] + 2e-3)
    with faults.vane_missing(x, "org"):
        assert firmware.jog(x, 0.5, -0.02).stopped_by == "EL-"


@pytest.mark.parametrize("direction", [1, -1])
def test_a_servo_jogs_across_its_home_switch(direction):
    """After a home the axis stands on ORG, whose pin STOP ends integral velocity mode."""
    stage = Stage("xy", chips=HCTL1100, visuals=False)
    x = stage.axes["x"]
    touch = next(s.touch for s in x.plant.switches if s.pin == "org")
    for place in (touch - 2e-3, touch - direction * 2e-3):
        stage.reset()
        stage.place(x=place)
        report = firmware.jog(x, 0.2, direction * 0.02)
        assert report.ok
        assert report.stopped_by == "decelerating stop"
        assert x.position - place == pytest.approx(direction * 0.2 * 0.02, abs=0.3e-3), (
            "a ramp up and the same ramp down"
        )
    assert not x.chip.diagnostics


def test_a_servo_jogs_a_rotary_table_past_its_home_switch():
    stage = Stage("xya", chips=HCTL1100, visuals=False)
    report = firmware.jog(stage.axes["a"], 2.0, 4.0)
    assert report.ok
    assert report.position == pytest.approx(8.0, rel=0.02), "rad, more than a turn; a speed is whole counts a sample"


@pytest.mark.parametrize("met", UNWANTED_REASONS)
def test_an_unintended_stop_reason_is_marked_in_the_report(met):
    x = Bench(x=PCL240K()).axes["x"]
    with ProcedureObserver(x, "run") as p:
        report = p.make_report(met)
    assert not report.ok
    assert (report.began, report.average_rate, report.peak_rate) == (0, 0, 0), "nothing ran"
    assert f"NOT as asked, stopped by {met}" in str(report)
    assert {"EL+", "EL-", "ALARM", "EMG", "timeout"} <= set(UNWANTED_REASONS)


def test_a_move_that_an_emergency_stop_ends_is_not_ok():
    x = Bench(x=MCX514()).axes["x"]
    driver = get_driver(x)
    driver.start_continuous_move(1, Speeds())
    x.wait(0.05)
    x.chip.pins.emg = True
    x.wait(0.01)
    assert not driver.is_running()
    assert driver.read_stop_reason() == "EMG"
    x.chip.pins.emg = False
    assert driver.read_stop_reason() == "EMG", "it has ended the drive, whatever it is now"


@each
def test_invalid_arguments_of_procedures_are_refused_before_the_first_bus_cycle(stage):
    x, now = stage.axes["x"], stage.time
    for how, message in [
        ({"distance": 1e-3, "pulses": 3}, "give one of the two"),
        ({}, "give one of the two"),
        ({"distance": math.nan}, "meters"),
        ({"pulses": 1.5}, "whole number"),
        ({"pulses": math.inf}, "whole number"),
        ({"pulses": 100, "speed": math.inf}, "speed=inf"),
        ({"pulses": 100, "speed": 0}, "speed=0"),
        ({"pulses": 100, "accel": -1}, "accel=-1"),
        ({"pulses": 0}, "pulses=0"),
    ]:
        with pytest.raises(ArgumentError, match=message):
            firmware.move(x, **how)
    with pytest.raises(ArgumentError, match="direction=0"):
        firmware.home(x, 0)
    for seconds in (-1, 1e9, math.nan):
        with pytest.raises(ArgumentError, match=f"seconds={seconds}"):
            firmware.jog(x, seconds)
    with pytest.raises(ArgumentError, match="no distances: give at least one axis a distance"):
        firmware.line({}, stage)
    for still in ({"x": 0, "y": 0}, {"y": 0}):
        with pytest.raises(ArgumentError, match="nothing moves; give at least one axis pulses to make"):
            firmware.line(still, stage)
    with pytest.raises(ArgumentError, match="unknown axis"):
        firmware.line({"q": 1e-3}, stage)
    with pytest.raises(ArgumentError, match=r"axis 'x' is given twice"):
        firmware.line({"x": 1e-3, x: 1e-3}, stage)
    with pytest.raises(ArgumentError, match=r"axis 'b' is given twice"):
        firmware.line({"a": 1e-3, "b": 1e-3}, {"a": x, "b": x})
    with pytest.raises(ArgumentError, match=r"axis 'x' is given twice"):
        firmware.line({x: 1e-3, Bench(PCL240K()).axes["x"]: 1e-3})
    assert stage.time == now


@pytest.mark.parametrize("name", STEPPING)
def test_chips_on_a_bench_move_by_pulses_and_have_no_metres(name):
    x = Bench(x=CHIPS[name]()).axes["x"]
    report = firmware.move(x, pulses=-1200)
    assert (report.pulses, report.position, report.lost_steps) == (-1200, None, None)
    with pytest.raises(ArgumentError, match="no metres"):
        firmware.move(x, 1e-3)


def test_axes_with_different_chips_draw_no_line():
    stage = Stage("xy", chips={"x": PCL240K, "y": MCX304}, visuals=False)
    with pytest.raises(ArgumentError, match="draw no line together"):
        firmware.line({"x": 1e-3, "y": 1e-3}, stage)


@each
@pytest.mark.parametrize("distances", [{"x": 3e-3, "y": 0}, {"x": 0, "y": -2e-3}, {"y": 2e-3}])
def test_an_axis_with_a_distance_of_0_stays_at_rest_on_a_line(stage, distances):
    """firmware.line({"x": 3e-3, "y": 0}, stage)"""
    moving = next(name for name, distance in distances.items() if distance)
    report = firmware.line(distances, stage, speed=0.04)
    assert report.ok
    assert report.distances == {moving: round(distances[moving] / stage.axes[moving].meters_per_pulse)}
    assert {n: r.pulses for n, r in report.axes.items()} == report.distances
    assert [a.position for a in stage.axes.values()] == pytest.approx(
        [distances.get(name, 0) for name in stage.axes], abs=NEAR
    )
    assert report.carriage_deviation < NEAR
    assert stage.chips[0].diagnostics == []
    assert firmware.line({name: -distance for name, distance in distances.items()}, stage, speed=0.04).ok


@pytest.mark.parametrize("distances", [{"x": 6e-3, "y": 0, "z": 0}, {"x": 6e-3, "y": -2e-3, "z": 0}])
def test_a_servo_at_rest_on_a_line_holds_its_load(distances):
    """A z axis whose chip has just been reset: without a control mode it falls 10 mm while x moves."""
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    begin = stage.axes["z"].position
    assert firmware.line(distances, stage).ok
    assert stage.axes["z"].position == pytest.approx(begin, abs=0.1e-3)


def test_axes_of_a_gantry_move_alone_and_together_with_a_third_axis_at_rest():
    """gantry: y and w carry one beam; x moves on it."""
    for chip in (MCX514, MCX304, HCTL1100):
        stage = Stage("gantry", chips=chip, visuals=False)
        begin = {name: axis.position for name, axis in stage.axes.items()}
        for distances in ({"x": 0, "y": 3e-3, "w": 3e-3}, {"x": 5e-3, "y": 0, "w": 0}):
            assert firmware.line(distances, stage).ok
        moved = {name: axis.position - begin[name] for name, axis in stage.axes.items()}
        assert moved == pytest.approx({"x": 5e-3, "y": 3e-3, "w": 3e-3}, abs=2 * NEAR)


def test_the_timeout_error_of_a_move_has_its_report():
    x = Bench(x=MCX304()).axes["x"]
    with pytest.raises(RunTimeout, match=r"still drives after 0\.100 s") as caught:
        firmware.move(x, pulses=100_000, timeout=0.1)
    assert 0 < caught.value.report.pulses < 100_000
    assert caught.value.report.stopped_by == "timeout"


def test_s_curves_are_refused_by_chips_without_them():
    for chip in (PCL240K, HCTL1100):
        x = Stage("xy", chips=chip, visuals=False).axes["x"]
        with pytest.raises(ArgumentError):
            firmware.move(x, 1e-3, s_curve=True)
    x = Bench(x=MCX304()).axes["x"]
    straight, curved = (firmware.move(x, pulses=8000, s_curve=s) for s in (False, True))
    early = [r.rates[np.searchsorted(r.waveforms.seconds, r.began + 0.02)] for r in (straight, curved)]
    assert early[0] == pytest.approx(1000 + 15_000 * 0.02 / 0.15, rel=0.05)
    assert early[1] == pytest.approx(1000 + 15_000 * 2 * (0.02 / 0.15) ** 2, rel=0.1), "the acceleration begins at 0"
    assert curved.pulses == straight.pulses == 8000


@pytest.mark.parametrize("sign", [1, -1])
def test_a_report_says_lost_steps_in_full_steps_and_in_pulses_in_both_directions(sign):
    x = Stage("xyz", chips="pcl240k", drives=Drive("17HS4401", microsteps=8), visuals=False).axes["x"]
    report = firmware.move(x, sign * 20e-3, speed=0.9, accel=1e-3)
    lost = abs(report.lost_steps)
    assert lost > 100
    assert report.lost_pulses == 8 * report.lost_steps
    assert report.lost_steps * sign > 0, "the number keeps its sign: commanded minus true"
    assert f", {lost} full steps ({8 * lost} pulses) lost" in str(report), "the text says how many"


def test_a_carriage_beyond_its_pulses_is_reported_as_such():
    report = replace(firmware.move(Stage("xy", visuals=False).axes["x"], 1e-3), lost_steps=-12, lost_pulses=-192)
    assert "12 full steps (192 pulses) too far" in str(report)
    assert "0 full steps lost" in str(replace(report, lost_steps=0, lost_pulses=0))


@pytest.mark.parametrize("chip", [PCL240K, MCX304])
def test_a_report_does_not_count_steps_lost_before_its_move(chip):
    x = Stage("xy", chips=chip, visuals=False).axes["x"]
    with faults.jam(x, 1e4):
        lost = firmware.move(x, 1e-3, accel=0.02).lost_steps
    later = firmware.move(x, 1e-3, accel=0.02)
    assert lost == x.lost_steps != 0
    assert (later.lost_steps, later.ok) == (0, True)


@pytest.mark.parametrize("chip", [MCX514, MCX304, MCX312, PCL240MS])
def test_an_s_curve_move_without_ramps_has_constant_speed(chip):
    """speed = start_speed"""
    x = Stage("xy", chips=chip, visuals=False).axes["x"]
    report = firmware.move(x, pulses=60, speed=0.01, start_speed=0.01, s_curve=True)
    assert (report.pulses, report.ok) == (60, True)
    assert report.peak_rate == pytest.approx(0.01 / x.meters_per_pulse, rel=0.02)


@pytest.mark.parametrize("name", EVERY)
def test_the_class_of_a_chip_determines_its_driver(name):
    assert get_driver_class(CHIPS[name]).__module__.startswith("stage.firmware.")


@each
def test_reports_of_every_chip_are_drawn(stage, tmp_path):
    report = firmware.move(stage.axes["x"], 3e-3)
    assert report.plot(tmp_path / "a.png") is not None
    assert (tmp_path / "a.png").stat().st_size > 10_000
    pattern = get_driver_class(type(stage.axes["x"].chip)).PATTERN_CLASS(report)
    t = report.waveforms.seconds - report.began
    notes = pattern.make_annotations(t)
    assert any(not n.event for n in notes), "the start command"
    assert notes[-1].event, "why it stopped"
    assert pattern.list_lanes()


def test_the_drawing_of_a_line_names_its_interpolation_and_omits_register_writes():
    """firmware.line({"x": 3e-3, "y": 1e-3}, stage.axes).axes["x"].plot()"""
    axes = Stage("xy", chips=MCX514, visuals=False).axes
    report = firmware.line({"x": 3e-3, "y": 1e-3}, axes).axes["x"]
    words = [
        n.words
        for n in get_driver(axes["x"]).PATTERN_CLASS(report).make_annotations(report.waveforms.seconds - report.began)
    ]
    assert "2-axis linear interpolation" in words
    assert not [w for w in words if "write" in w]


def test_a_servo_on_an_end_limit_reports_it_and_moves_out_of_it():
    """firmware.move(axis, 3e-3), standing on EL+"""
    x = Stage("xy", chips=HCTL1100, visuals=False).axes["x"]
    firmware.move(x, 0.2, speed=0.3)
    report = firmware.move(x, 3e-3)
    assert (report.ok, report.stopped_by, report.pulses, report.asked) == (False, "EL+", 0, 600)
    assert firmware.move(x, -3e-3).ok


@each
def test_a_fraction_of_a_pulse_is_refused(stage):
    """firmware.move(axis, pulses=100.5)"""
    with pytest.raises(ArgumentError, match=r"pulses=100\.5"):
        firmware.move(stage.axes["x"], pulses=100.5)
    assert stage.axes["x"].position == 0


def test_missing_speeds_have_defaults_and_ramps_keep_their_slopes():
    """Speeds(1000, 16000, 0.1, 0.2).with_second_rate(32000); firmware.move(x, speed=..., accel=0.1) below the usual start"""
    arguments = Speeds(1000.0, 16_000.0, 0.1, 0.2, True)
    assert arguments.with_second_rate(32_000.0) == Speeds(1000.0, 16_000.0, 0.2, 0.4, True, 32_000.0)
    assert (
        get_default_speeds(SimpleNamespace(MICROSTEPS=0))
        == get_default_speeds(SimpleNamespace(MICROSTEPS=16))
        == Speeds()
    )
    assert get_default_speeds(SimpleNamespace(MICROSTEPS=256)) == Speeds(16_000.0, 256_000.0)
    axis = SimpleNamespace(chip=PCL240K(), meters_per_pulse=1e-3, name="x")
    for values, expected in (
        ((None, None, 0.1, 0.2, False), Speeds(1000.0, 16_000.0, 0.1, 0.2)),
        ((0.5, None, 0.1, None, True), Speeds(500.0, 500.0, 0.1, 0.1, True)),
        ((4.0, None, 0.1, 0.3, False), Speeds(1000.0, 4000.0, 0.1, 0.3)),
        ((4.0, 0.25, 0.1, 0.3, False), Speeds(250.0, 4000.0, 0.1, 0.3)),
    ):
        options = dict(zip(("speed", "start_speed", "accel", "decel", "s_curve"), values, strict=True))
        assert parse_speeds(axis, options)[:5] == pytest.approx(expected[:5])
        assert parse_speeds(axis, {"speed": expected}) is expected
        in_pulses = {name: v and v * 1000 if "speed" in name else v for name, v in options.items()}
        assert parse_speeds(axis, in_pulses, in_pulses=True)[:5] == pytest.approx(expected[:5])


@pytest.mark.parametrize(("timeout", "polls"), [(0.0105, 11), (1.0, 639), (10.0, 5139), (1e4, 280_400)])
def test_a_wait_ends_at_its_time_and_polls_more_slowly_up_to_every_two_milliseconds(timeout, polls):
    """Every 1 ms at first, from 0.2 s on every 200th of what has passed (139 looks), and from 0.4 s on every 2 ms. Beyond 100 s
    (50,139 looks) it is every 50,000th of what has passed: 50,000 ln(100) = 230,259 looks more at 10,000 s."""

    class Clock:
        time, name, chip_axis, waits = 0.0, "x", 0, 0
        chip = SimpleNamespace(busy=lambda k: True, explain_missing_current=lambda k: "")

        def wait(self, seconds):
            self.time += seconds
            self.waits += 1

    clock = Clock()
    with pytest.raises(RunTimeout, match=rf"axis x still drives after {timeout:.3f} s"):
        wait_until_stopped([clock], timeout)
    assert clock.time == pytest.approx(timeout, abs=2e-6)
    assert clock.waits == pytest.approx(polls, abs=2, rel=1e-4)


@pytest.mark.parametrize("name", STEPPING)
def test_a_wait_returns_within_two_milliseconds_of_the_end_of_a_long_move(name):
    """driver.start(4000, speeds); driver.wait(60.0); firmware.move(axis, pulses=-4000)"""
    x = Bench(x=CHIPS[name]()).axes["x"]
    driver, slow = get_driver(x), Speeds(500, 500)
    driver.start(4000, slow)
    begin = x.time
    driver.wait(60.0)
    assert 0 <= x.time - begin - 4000 / 500 < 2.2e-3 + 1 / 500
    report = driver.move(-4000, slow)
    assert 0 <= x.time - begin - 2 * 4000 / 500 < 2 * 2.2e-3 + 2 / 500 + SETTLING_TIME_S + report.began


def test_an_index_search_without_an_origin_switch_is_refused():
    spec = plant.open_spec("xy")
    spec.delete(next(s for s in spec.sensors if s.name == "x_org"))
    spec.add_text(name="x_unfitted", data="org")
    x = Stage(spec, chips=MCX514, visuals=False).axes["x"]
    for arguments in ({"by": "index"}, {"by": "switch"}, {"index": True}, {}):
        with pytest.raises(ArgumentError, match="axis x has no origin switch"):
            firmware.home(x, **arguments)
    assert x.stage.now == 0


@pytest.mark.parametrize("arguments", [{}, {"by": "switch"}, {"index": True}])
def test_home_passes_its_timeout_to_the_driver(arguments):
    x = Stage("xy", chips=PCL240MK, visuals=False).axes["x"]
    with pytest.raises(RunTimeout, match=r"after 0\.020 s"):
        firmware.home(x, timeout=0.02, **arguments)


def test_ctrl_c_has_the_reports_of_all_axes_that_are_watched():
    bench = Bench(PCL240K(), PCL240K())
    x, y = bench.axes.values()
    with pytest.raises(KeyboardInterrupt) as caught, ProcedureObserver(x, "outer"), ProcedureObserver(y, "inner"):
        raise KeyboardInterrupt
    assert [(r.procedure, r.axis, r.stopped_by) for r in caught.value.reports] == [
        ("outer", "x", "Ctrl-C"),
        ("inner", "y", "Ctrl-C"),
    ]


def test_immediate_operations_are_counted():
    bench = Bench(PCL240K())
    now = ImmediateOperations(bench.axes["x"])
    assert len(now.write(0, 0, 0x08).wait(1e-3).until_stopped([0], 1.0)) == 3
    assert bench.time >= 1e-3


def test_a_run_after_a_move_ends_at_a_limit_and_not_at_the_pulses_of_the_move():
    """driver.start(100, Speeds()); driver.run(-1, Speeds()) into the end limit, with R0 = 0 since the move"""
    bench = Bench(PCL240K())
    driver = get_driver(bench.axes["x"])
    for direction, limit in ((-1, "EL-"), (1, "EL+")):
        driver.start(100 * direction, Speeds())
        assert driver.wait(5.0) == driver.DONE_REASON
        driver.start_continuous_move(direction, Speeds())
        setattr(bench.axes["x"].pins, limit.lower().replace("+", "_plus").replace("-", "_minus"), True)
        bench.wait(0.5)
        assert driver.read_stop_reason() == limit


@pytest.mark.parametrize(("direction", "limit"), [(-1, "EL-"), (1, "EL+")])
@pytest.mark.parametrize("name", STEPPING)
def test_a_move_onto_an_end_limit_names_the_limit(name, direction, limit):
    bench = Bench(x=CHIPS[name]())
    driver = get_driver(bench.axes["x"])
    driver.start(direction * 5000, Speeds())
    bench.wait(0.05)
    switch = "el_plus" if direction > 0 else "el_minus"
    setattr(bench.axes["x"].pins, CHIPS[name].WIRING.get(switch, switch), True)
    assert driver.wait(5.0) == limit


def test_a_line_of_a_pcl240_has_both_requested_ramps():
    bench = Bench(PCL240K(), PCL240K())
    drivers = {name: get_driver(axis) for name, axis in bench.axes.items()}
    plan = type(drivers["x"]).move_line(drivers, {"x": 6000, "y": -3000}, Speeds(1000, 8000, 0.1, 0.2)).plan
    for axis in plan.axes.values():
        assert axis.registers["R5"] == pytest.approx(2 * axis.registers["R4"], rel=0.01)


@pytest.mark.parametrize("hz", [4_915_200, 2_000_000])
def test_the_formula_computes_registers_for_the_clock_of_the_chip(hz):
    x = Bench(PCL240MK(clock_hz=hz)).axes["x"]
    registers = get_driver(x).compute_move_registers(500, 8000, 0.1, 0.2, 4000)
    step = hz / (8192 * registers["R7"])
    assert registers["R1"] * step == pytest.approx(500, rel=1e-3)
    assert registers["R2"] * step == pytest.approx(8000, rel=1e-3)
    ramps = [(registers["R2"] - registers["R1"]) * registers[name] / hz for name in ("R4", "R5")]
    assert ramps == pytest.approx([0.1, 0.2], rel=0.01)


@each
@pytest.mark.parametrize("timeout", [math.nan, -1, -1e-9])
def test_an_invalid_timeout_is_refused_before_the_first_bus_cycle(stage, timeout):
    """firmware.home(axis, timeout=float("nan")), where there is no ORG: it never ended"""
    x = stage.axes["x"]
    calls = [
        lambda: firmware.move(x, 1e-3, timeout=timeout), lambda: firmware.home(x, timeout=timeout),
        lambda: firmware.line({"x": 1e-3, "y": 1e-3}, stage, timeout=timeout),
        lambda: firmware.square_gantry(*stage.axes.values(), timeout=timeout),
    ]  # fmt: skip
    if type(x.chip).__name__.startswith("PCL240"):
        calls += [
            lambda: firmware.preset_move(x, 100, timeout=timeout), lambda: firmware.origin_return(x, timeout=timeout),
            lambda: firmware.interrupted_move(x, 100, after=0.01, pause=0.01, timeout=timeout),
            lambda: firmware.external_count(x, 10, timeout=timeout),
            lambda: firmware.synchronized_move({"x": 100, "y": 100}, stage, timeout=timeout),
        ]  # fmt: skip
    for call in calls:
        with pytest.raises(ArgumentError, match=r"timeout=.*: must be 0 s or more; float\('inf'\) waits for ever\."):
            call()
    assert stage.now == 0


@pytest.mark.parametrize("stage", [name for name in EVERY if name != "MCX501"], indirect=True)
def test_a_line_ends_at_its_timeout(stage):
    """firmware.line({"x": 6e-3, "y": 2e-3}, stage, timeout=0.05) with an HCTL-1100: it was drawn to its end"""
    with pytest.raises(RunTimeout) as caught:
        firmware.line({"x": 6e-3, "y": 2e-3}, stage, timeout=0.05)
    assert {r.stopped_by for r in caught.value.reports.values()} == {"timeout"}
    assert stage.time < 0.2
    assert stage.axes["x"].position < 6e-3


EXTRAS = ({"constant": True}, {"automatic": True}, {"second": 20_000.0}, {"approach": 300.0}, {"s_curve": 0.3})


@pytest.mark.parametrize("extra", EXTRAS, ids=lambda extra: next(iter(extra)))
@pytest.mark.parametrize("chip", [MCX514, MCX304, HCTL1100])
def test_a_family_refuses_the_options_of_another(chip, extra):
    x = firmware.Bench(x=chip()).axes["x"]
    with pytest.raises(ArgumentError, match=rf"{next(iter(extra))}=.* Leave|leave it out"):
        firmware.move(x, pulses=8000, speed=Speeds(**extra))
    with pytest.raises(ArgumentError, match="eave it out"):
        parse_speeds(x, extra, in_pulses=True)
    assert parse_speeds(x, {"automatic": False}) == get_default_speeds(x.chip)._replace(automatic=False)


def test_a_pcl240_obeys_the_options_of_its_family():
    """constant speed, a second rate, the chip's own ramp-down point, one approach of ORG, an index pulse"""
    x = Stage("xy", chips=PCL240MK, visuals=False).axes["x"]
    assert get_driver(x).get_default_second_rate(10_000.0) == 20_000.0
    assert get_driver(x).get_default_second_rate(2e6) == pytest.approx(
        8191 * 4_915_200 / (8192 * 2)
    )  # the data sheet, equation 4
    assert "FH2 20000.0 pps" in get_driver(x).describe_speeds(Speeds(second=20_000.0))
    flat = firmware.move(x, pulses=800, speed=Speeds(1000, 4000, constant=True))
    assert flat.procedure == "constant-speed preset move"
    assert set(np.unique(flat.rates.round(-2))) == {0.0, 4000.0}
    for automatic in (True, False):
        firmware.move(x, pulses=8000, speed=Speeds(automatic=automatic))
        assert (get_driver(x).read_register("R6") == 2) == automatic
    returns = []
    for approach in (0.0, None):
        x.stage.place(x=0.02)
        returns.append(firmware.home(x, speed=Speeds(approach=approach)))
    once, twice = returns
    assert once.stopped_by == twice.stopped_by == "ORG"
    assert twice.duration > once.duration + 0.3
    with pytest.raises(ArgumentError, match=r"index=17: .* at index pulse 1 to 16"):
        firmware.home(x, index=17)
    with pytest.raises(ArgumentError, match=r"index=2: .* at index pulse 1 after"):
        firmware.home(firmware.Bench(x=MCX514()).axes["x"], index=2)


def test_each_method_that_no_other_thread_may_interrupt_is_a_method_of_the_driver():
    assert [name for name in Driver.EXCLUSIVE_METHODS if not callable(getattr(Driver, name, None))] == []
