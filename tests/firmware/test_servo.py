"""Servo procedures on the stage: set-up, steps, trapezoids, velocity modes, home."""

from dataclasses import replace

import numpy as np
import pytest

from stage import ArgumentError, RunTimeout, Stage
from stage.chips import HCTL1100
from stage.chips.hctl1100.maps import NUMBERS
from stage.firmware.driver import Speeds
from stage.firmware.hctl1100.chip_port import INIT, PROFILE, ChipPort
from stage.firmware.hctl1100.driver import _compute_line_command_positions
from stage.firmware.hctl1100.homing import home_servo, leave_limit
from stage.firmware.hctl1100.moves import (
    FilterTuning,
    move_by_step,
    move_by_trapezoid,
    run_in_integral_velocity_mode,
    run_in_proportional_velocity_mode,
    set_up_servo,
)
from stage.firmware.hctl1100.servo_loop_model import ServoLoop

COUNT = 5e-6  # m
DEADBAND = 3


@pytest.fixture
def stage():
    return Stage("xyz_servo", chips=HCTL1100, visuals=False)


def find_switch_edge(axis, pin="org"):
    return next(s.touch for s in axis.plant.switches if s.pin == pin)


def test_a_port_is_for_hctl1100s_only():
    with pytest.raises(ArgumentError, match="no HCTL1100"):
        ChipPort(Stage("xyz", visuals=False).axes["x"])


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_is_written_byte_by_byte_high_first_up_to_both_ends_of_its_range(stage, name):
    x = stage.axes["x"]
    port, word = ChipPort(x), NUMBERS[name]
    n = len(word.addresses)
    for value in (word.minimum, word.maximum):
        journal = x.chip.journal()
        port.write_quantities(**{name: value})
        journal.close()
        expected = zip(word.addresses, (value % 256**n).to_bytes(n, "big"), strict=True)
        assert [(e.a, e.b) for e in journal.entries] == list(expected)
        assert port.t == (value if name == "timer" else 0x40)
    for value in (word.minimum - 1, word.maximum + 1):
        with pytest.raises(ArgumentError, match=f"from {word.minimum} to {word.maximum}"):
            port.write_quantities(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("gain", 256), ("timer", -1), ("maximum_velocity", 128), ("final_position", 1 << 23), ("zero", 0.5)],
)
def test_a_value_beyond_its_register_is_refused_before_the_first_bus_cycle(stage, name, value):
    port = ChipPort(stage.axes["x"])
    with pytest.raises(ArgumentError, match=f"{name}={value}"):
        port.write_quantities(pole=1, **{name: value})
    with pytest.raises(ArgumentError, match="nothing to load"):
        port.write_quantities(poles=1)
    assert stage.time == 0
    assert port.chip.values()["R21"] == 0x40


def test_a_port_writes_and_reads_complete_numbers(stage):
    port = ChipPort(stage.axes["x"])
    port.write_quantities(
        command_position=-70_000,
        final_position=1_234_567,
        acceleration=0x123,
        proportional_velocity=-18,
        preset_position=-9,
    )
    values = port.chip.values()
    assert port.read_command_position() == -70_000
    assert port.read_position() == -9
    assert [values[f"R{a:02X}"] for a in (0x2B, 0x2A, 0x29)] == [0x12, 0xD6, 0x87]
    assert [values[f"R{a:02X}"] for a in (0x27, 0x26, 0x24, 0x23)] == [0x01, 0x23, 0xFF, 0xEE]


def test_set_up_loads_the_filter_and_holds_the_present_position(stage):
    stage.place(x=0.02)
    before = stage.axes["x"].position
    port = set_up_servo(stage.axes["x"], FilterTuning(gain=0x30, zero=0xE0, pole=0x20, timer=0x3F))
    stage.run(0.2)
    values = port.chip.values()
    assert [values[n] for n in ("R22", "R20", "R21")] == [0x30, 0xE0, 0x20]
    assert port.sample == 16 * 0x40 / 2e6
    assert not port.read_status() & INIT
    assert stage.axes["x"].position == pytest.approx(before, abs=2 * COUNT)
    assert not port.chip.diagnostics


def test_an_error_equal_to_the_deadband_is_accepted(stage):
    port = set_up_servo(stage.axes["x"])
    move_by_step(port, 200)
    while (error := port.read_command_position() - port.read_position()) == 0:  # it oscillates by a count
        stage.run(0.001)
    report = move_by_step(port, 0, deadband=abs(error), timeout=0.1)
    assert report.ok
    assert report.settled < 1e-4, "from the first poll on"


@pytest.mark.parametrize("name", ["x", "y"])
@pytest.mark.parametrize("counts", [1, 50, -400])
def test_a_step_settles_within_its_deadband(stage, name, counts):
    port = set_up_servo(stage.axes[name])
    stage.run(0.05)
    before = port.read_position()
    report = move_by_step(port, counts, deadband=DEADBAND)
    assert report.ok
    assert abs(report.error) <= DEADBAND
    assert abs(port.read_position() - before - counts) <= 2 * DEADBAND
    assert 0 <= report.settled < 0.2
    assert not port.chip.diagnostics, "no command in the unsafe part of a sample"


def test_a_step_settles_when_it_stays_within_its_deadband(stage):
    """A loaded axis swings: leaving the deadband begins the wait anew."""
    stage.set_payload(10.0)
    port = set_up_servo(stage.axes["x"])
    goal = stage.axes["x"].position + 400 * COUNT
    with stage.record(every=0.25e-3) as recording:
        begin = stage.time
        report = move_by_step(port, 400, deadband=DEADBAND)
    error = np.abs(recording.columns["x/position"] - goal) / COUNT
    time = recording.columns["time"] - begin
    outside = time[error > DEADBAND + 0.5]
    assert np.diff(outside).max() > 2e-3, "it was in and out again"
    assert report.settled == pytest.approx(outside[-1], abs=3e-3)


@pytest.mark.parametrize("name", ["x", "y"])
@pytest.mark.parametrize("counts", [2_000, -12_000])
def test_a_trapezoid_shows_the_profile_flag_and_ends_within_its_deadband(stage, name, counts):
    port = set_up_servo(stage.axes[name])
    before, rates = port.read_command_position(), {"velocity": 40_000, "acceleration": 400_000}
    stage.run(0.05)
    report = move_by_trapezoid(port, counts, **rates, deadband=DEADBAND)
    assert report.ok
    assert not port.read_status() & PROFILE
    assert port.read_command_position() - before == counts
    assert abs(port.read_position() - before - counts) <= DEADBAND
    v, a = report.velocity, report.acceleration
    assert v == pytest.approx(40_000, rel=0.03), "whole counts a sample"
    assert a == pytest.approx(400_000, rel=0.03)
    ramp = min(v / a, np.sqrt(abs(counts) / a))
    expected = 2 * ramp + max(abs(counts) / v - v / a, 0)
    assert report.profile == pytest.approx(expected, abs=5e-3)
    assert not port.chip.diagnostics


def test_a_move_that_ends_outside_its_deadband_is_not_ok(stage):
    report = move_by_step(set_up_servo(stage.axes["x"]), 200, deadband=DEADBAND)
    assert report.ok
    for error in (DEADBAND, -DEADBAND):
        assert replace(report, error=error).ok
        assert not replace(report, error=2 * error).ok
    assert not replace(report, limited=True).ok


def test_rates_beyond_the_registers_at_this_sample_time_are_refused(stage):
    port = set_up_servo(stage.axes["x"])
    for rates in ({"velocity": 1e6}, {"velocity": 100}, {"acceleration": 1}, {"acceleration": 1e9}):
        with pytest.raises(ArgumentError, match="Choose another rate, or another T"):
            move_by_trapezoid(port, 100, **rates)
    for rate in (127.4, -127.4):  # counts a sample; whole ones are held
        assert run_in_integral_velocity_mode(port, rate / port.sample, seconds=0.02).asked == pytest.approx(
            rate / port.sample, rel=0.01
        )
        for beyond in (1.02 * rate, 0.001 * rate):
            with pytest.raises(ArgumentError, match=r"in the register of integral_velocity .* 1 to 127"):
                run_in_integral_velocity_mode(port, beyond / port.sample)


def test_an_unknown_mode_is_refused(stage):
    with pytest.raises(ArgumentError, match="unknown control mode 'trapezium'"):
        set_up_servo(stage.axes["x"]).set_control_mode("trapezium")


@pytest.mark.parametrize("rate", [float("nan"), float("inf")])
def test_rates_that_are_not_finite_are_refused(stage, rate):
    port = set_up_servo(stage.axes["x"])
    with pytest.raises(ArgumentError, match="counts/s are 0 in the register"):
        move_by_trapezoid(port, 100, velocity=rate)
    with pytest.raises(ArgumentError, match="counts/s2 are 0 in the register"):
        move_by_trapezoid(port, 100, acceleration=rate)


def test_a_port_that_never_finds_the_safe_part_of_a_sample_raises_an_error(stage):
    """T cannot be read back: a second port takes it to be as after a reset."""
    set_up_servo(stage.axes["x"], FilterTuning(timer=0))
    with pytest.raises(ArgumentError, match="T cannot be read back"):
        ChipPort(stage.axes["x"]).write_command_position(5)


def test_a_deadband_that_the_loop_cannot_hold_ends_in_a_timeout_with_the_motor_off(stage):
    """Gravity on Z: a filter without integral keeps an error."""
    port = set_up_servo(stage.axes["z"], FilterTuning(gain=2))
    with pytest.raises(RunTimeout, match="rest within 0 counts"):
        move_by_step(port, 10, deadband=0, timeout=0.2)
    assert port.read_status() & INIT


@pytest.mark.parametrize("rate", [20_000, -6_000])
def test_integral_velocity_reaches_its_rate_and_stops_in_position_control(stage, rate):
    port = set_up_servo(stage.axes["x"])
    report = run_in_integral_velocity_mode(port, rate, seconds=0.2)
    assert report.asked == pytest.approx(rate, rel=0.08), "whole counts a sample"
    assert report.reached == pytest.approx(report.asked, rel=0.01)
    assert report.ended == ""
    stage.run(0.1)
    assert abs(port.read_command_position() - port.read_position()) <= DEADBAND
    assert not port.chip.diagnostics


@pytest.mark.parametrize("rate", [20_000, -6_000])
def test_proportional_velocity_falls_short_by_the_share_of_drag_and_friction(stage, rate):
    """K/4 (command - velocity) = motor command, and that holds the velocity against drag and friction."""
    tuning = FilterTuning(gain=0x80)
    port = set_up_servo(stage.axes["x"], tuning)
    report = run_in_proportional_velocity_mode(port, rate, seconds=0.4)
    loop = ServoLoop.from_axis(stage.axes["x"], tuning)
    per = tuning.gain / 4 * port.sample  # motor command for one count/s
    offset = np.sign(rate)
    expected = (per * report.asked - offset * loop.friction) * loop.gain / (1 + per * loop.gain)
    assert report.reached == pytest.approx(expected, rel=0.05)
    assert abs(report.reached) < abs(report.asked)
    at = stage.axes["x"].position
    stage.run(0.1)
    assert stage.axes["x"].position == pytest.approx(at, abs=DEADBAND * COUNT)
    assert not port.chip.diagnostics


def test_stop_brakes_integral_velocity_only(stage):
    port = set_up_servo(stage.axes["x"])
    stage.axes["x"].switches.stick("org", True)
    report = run_in_integral_velocity_mode(port, 8_000, seconds=0.2)
    assert report.ended == "STOP"
    assert abs(report.reached) < 100
    assert "ended by STOP" in str(report)
    assert move_by_trapezoid(port, 500).ok
    assert run_in_proportional_velocity_mode(port, 8_000, seconds=0.2).reached > 6_000


def test_a_limit_ends_a_run_at_a_velocity(stage):
    port = set_up_servo(stage.axes["x"])
    stage.axes["x"].switches.stick("el_plus", True)
    assert run_in_integral_velocity_mode(port, 8_000, seconds=0.1).ended == "LIMIT"
    assert port.read_status() & INIT, "and is left so"
    stage.axes["x"].switches.stick("el_plus", None)
    port = set_up_servo(stage.axes["x"], FilterTuning(gain=0x80))
    stage.axes["x"].switches.stick("el_plus", True)
    report = run_in_proportional_velocity_mode(port, 8_000, seconds=0.1)
    assert (report.ended, abs(report.reached) < 100) == ("LIMIT", True)
    assert port.read_status() & INIT


def test_a_limit_ends_a_trapezoid_in_init_idle(stage):
    port = set_up_servo(stage.axes["x"])
    stage.axes["x"].switches.stick("el_plus", True)
    report = move_by_trapezoid(port, 4_000)
    assert report.limited
    assert not report.ok
    assert "LIMIT" in str(report)
    assert port.read_status() & INIT
    with pytest.raises(ArgumentError, match="stands on a limit switch"):
        set_up_servo(stage.axes["x"])


def test_an_axis_leaves_its_limit_switch_by_the_motor_command_of_the_host(stage):
    x = stage.axes["x"]
    stage.place(x=find_switch_edge(x, "el_plus") + 1e-4)
    assert x.switches.el_plus
    port = ChipPort(x)
    leave_limit(port, -1)
    stage.run(0.1)
    assert not x.switches.el_plus
    assert not port.read_status() & INIT
    assert abs(port.read_command_position() - port.read_position()) <= 2 * DEADBAND


# --- home ---


@pytest.mark.parametrize("offset", [0.009, 0.0003, -0.0002], ids=["before", "just before", "on"])
@pytest.mark.parametrize(("name", "sag"), [("x", DEADBAND), ("y", DEADBAND), ("z", 8)])
def test_home_is_at_the_index_pulse_from_any_start(stage, name, sag, offset):
    axis = stage.axes[name]
    stage.place(**{name: find_switch_edge(axis) + offset})
    report = home_servo(set_up_servo(axis), deadband=sag)
    port = ChipPort(axis)
    stage.run(0.1)
    assert abs(port.read_position()) <= sag
    revolutions = axis.position * axis.gear / (2 * np.pi) - axis.plant.index
    assert abs(revolutions - round(revolutions)) * 2000 == pytest.approx(10, abs=sag), "the rim of a pulse of 20 counts"
    assert -1.2 * 2000 < report.index - report.switch < 0
    assert not [d for d in port.chip.diagnostics if "computed" in d.message]


def test_repeated_homings_end_at_the_same_position(stage):
    axis, positions = stage.axes["x"], []
    for k in range(4):
        stage.place(x=find_switch_edge(axis) + 0.002 + 0.00037 * k)
        home_servo(set_up_servo(axis))
        stage.run(0.1)
        positions.append(axis.position)
    assert np.ptp(positions) <= 3 * COUNT


def test_home_without_an_index_pulse_is_at_the_switch(stage):
    axis = stage.axes["x"]
    stage.place(x=find_switch_edge(axis) + 0.002)
    report = home_servo(set_up_servo(axis), index=False)
    assert report.index is None
    assert axis.position == pytest.approx(find_switch_edge(axis), abs=30e-6)


def test_a_home_search_that_meets_a_limit_ends_in_a_timeout(stage):
    axis = stage.axes["x"]
    port = set_up_servo(axis)
    axis.switches.stick("el_minus", True)
    stage.run(1e-3)
    axis.switches.stick("el_minus", None)
    with pytest.raises(RunTimeout, match="the home switch did not come"):
        home_servo(port, timeout=0.2)
    assert port.read_status() & INIT
    with pytest.raises(ArgumentError, match=r"\+1 or -1"):
        home_servo(port, direction=0)


def test_a_home_search_without_an_index_pulse_raises_an_error_with_the_motor_off(stage):
    """home(port, turn=400): an encoder of fewer counts than that of the stage, whose index pulse is farther away"""
    port = set_up_servo(stage.axes["x"])
    with pytest.raises(
        RunTimeout, match="x: no index pulse within 480 counts of the home switch; it is in Init/Idle now"
    ):
        home_servo(port, turn=400)
    assert port.read_status() & INIT


def test_a_line_has_at_most_the_highest_rate_of_the_chip():
    """firmware.line({"x": 2e-3, "y": 1e-3}, stage.axes, speed=...), 127 counts a sample"""
    sample = 1 / 1024
    rows = _compute_line_command_positions([2000, 1000], Speeds(0, 127 / sample, 0.05, 0.05), sample)
    assert rows[-1].tolist() == [2000, 1000]
    with pytest.raises(ArgumentError, match="more than 0, up to 130048 counts/s at this sample time"):
        _compute_line_command_positions([2000, 1000], Speeds(0, 128 / sample, 0.05, 0.05), sample)
