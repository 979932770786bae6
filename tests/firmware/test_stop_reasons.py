"""A report names what has stopped an axis: by the chip's journal, and by no guess from what is left over."""

import math

import pytest

from stage import Stage, faults, firmware
from stage.chips import CHIPS, MCX314AS, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.firmware import Bench, Profile
from stage.firmware.driver import Speeds, get_driver, get_driver_class
from stage.firmware.nova.chip_port import ChipPort
from stage.firmware.pcl240 import chip_port

BLIP_S = 20e-6  # less than the time between two looks of a host, more than a reference clock
SLOW = Profile.of(fl=200, fh1=400)
FIRST = ["MCX302", "MCX304", "MCX312", "MCX314AS"]
NOVA = [*FIRST, "MCX501", "MCX512", "MCX514"]


def bench(chip=PCL240K):
    return Bench(x=chip()).axes["x"]


def pulse_pin(x, name, when, length=BLIP_S):
    """Assert an input of a bench's chip from `when` on, for `length` seconds."""
    for seconds, level in ((when, True), (when + length, False)):
        x._bench.at(x.time + seconds, lambda level=level: setattr(x.chip.axes[0].pins, name, level))


def write_at(x, seconds, address, value):
    x._bench.at(x.time + seconds, lambda: x.chip.write(address, value))


@pytest.mark.parametrize("chip", [PCL240K, PCL240MS])
@pytest.mark.parametrize("fl", [2000, 4000])
@pytest.mark.parametrize("degrees", [10, 31, 40, 59])
def test_a_hinge_that_rings_off_its_origin_switch_is_home(chip, fl, degrees):
    """stage home a --model xya --constant --fl 4000 --from 40deg: the axis has no end limits"""
    a = Stage("xya", chips=chip, visuals=False).axes["a"]
    a.stage.place(a=math.radians(degrees))
    report = firmware.origin_return(a, -1, Profile.of(fl=fl, fh1=8000, chip=chip), high_speed=False)
    assert (report.stopped_by, report.ok) == ("ORG", True)
    assert report.position == pytest.approx(0.0, abs=1.5 * a.meters_per_pulse)


@pytest.mark.parametrize(("direction", "pin"), [(1, "el_plus"), (-1, "el_minus")])
def test_a_limit_released_before_the_next_poll_is_the_stop_reason(direction, pin):
    x, limit = bench(), {"el_plus": "EL+", "el_minus": "EL-"}[pin]
    pulse_pin(x, pin, 0.1)
    assert firmware.preset_move(x, direction * 20_000).stopped_by == limit
    pulse_pin(x, pin, 0.1)
    assert firmware.continuous_move(x, 0.3, direction).stopped_by == limit
    pulse_pin(x, pin, 0.1)
    assert firmware.dual_rate_move(x, direction * 40_000).stopped_by == limit
    pulse_pin(x, pin, 0.1)
    assert firmware.move(x, pulses=direction * 20_000).stopped_by == limit
    pulse_pin(x, pin, 0.1)
    assert firmware.line({x: direction * 20_000}, pulses=True).axes["x"].stopped_by == limit
    driver = get_driver(x)
    pulse_pin(x, pin, 0.1)
    driver.start(direction * 20_000, Speeds())
    assert driver.wait(5.0) == driver.read_stop_reason() == limit


def test_an_origin_switch_released_before_the_next_poll_is_the_stop_reason():
    x = bench()
    for _ in range(2):  # the fast approach, then the slow one, whose pulse is low for 1.25 ms
        pulse_pin(x, "org", 0.2)
        report = firmware.origin_return(x, -1, SLOW, high_speed=False, slow_approach=False)
        assert (report.stopped_by, report.ok) == ("ORG", True)


def test_an_index_pulse_that_ends_before_the_next_poll_is_the_stop_reason():
    x = bench(PCL240MK)
    x._bench.at(0.1, lambda: setattr(x.chip.pins, "org", True))
    pulse_pin(x, "ez", 0.2)
    report = firmware.origin_return(x, -1, SLOW, high_speed=False, slow_approach=False, ez=1)
    assert report.stopped_by == "EZ"


@pytest.mark.parametrize(
    ("command", "reason"),
    [(chip_port.RESET, "reset command"), (chip_port.SLOW_DOWN["FH1"], "decelerating stop")],
)
def test_a_stop_command_of_the_host_is_the_stop_reason(command, reason):
    x = bench()
    write_at(x, 0.2, 0, command)
    report = firmware.preset_move(x, 50_000)
    assert (report.stopped_by, report.ok) == (reason, False)
    write_at(x, 0.2, 0, command)
    assert firmware.jog(x, 0.5).stopped_by == reason
    driver = get_driver(x)
    driver.start_continuous_move(1, Speeds())
    x.wait(0.2)
    get_driver(x).halt(at_once=command == chip_port.RESET)
    assert driver.read_stop_reason() == reason


def test_a_stop_at_the_last_pulse_does_not_change_the_stop_reason():
    x = bench()
    firmware.preset_move(x, 500, SLOW)
    x.chip.write(0, chip_port.RESET)
    assert get_driver(x).read_stop_reason() == "R0 = 0"


def test_an_active_limit_stops_moves_into_it_but_not_out_of_it():
    x = bench()
    x.chip.pins.el_plus = True
    report = firmware.preset_move(x, 300)
    assert (report.stopped_by, report.pulses) == ("EL+", 0)
    assert firmware.preset_move(x, -300).stopped_by == "R0 = 0"


def test_a_move_whose_start_command_was_lost_names_no_limit():
    """faults.lost_write: the chip stands, R0 is not 0, and no limit is on"""
    stage = Stage("xy", visuals=False)
    x = stage.axes["x"]
    with faults.lost_write(x, 0, chip_port.RAMP_START_COMMANDS["FH1"]):
        report = firmware.preset_move(x, 300)
    driver = get_driver(x)
    with faults.lost_write(x, 0, chip_port.RAMP_START_COMMANDS["FH1"]):
        driver.start(300, Speeds())
    assert driver.wait(1.0) == "unknown"
    assert (report.stopped_by, report.pulses, report.ok) == ("unknown", 0, False)


def test_a_driver_that_has_started_nothing_names_no_limit():
    for direction in (1, -1):
        x = bench()
        assert get_driver(x).read_stop_reason() == ""
        other = get_driver(x)
        other.start(direction * 300, Speeds())
        other.wait(5.0)
        assert get_driver(x).read_stop_reason() == "R0 = 0"


def test_a_deleted_driver_leaves_no_open_journal():
    x = bench()
    driver = get_driver(x)
    driver.start_continuous_move(1, Speeds())
    assert x.chip.open_journal is not None
    del driver
    assert x.chip.open_journal is None


@pytest.mark.parametrize("name", [n for n in CHIPS.built_in if n.startswith("PCL")])
def test_an_origin_switch_that_is_never_released_is_not_home(name):
    """ORG is asserted again when the axis has backed off: a switch whose contact is loose"""
    x = bench(CHIPS[name])
    x.chip.pins.org = True
    x._bench.at(0.2, lambda: setattr(x.chip.pins, "org", False))
    x._bench.at(0.3, lambda: setattr(x.chip.pins, "org", True))
    report = firmware.origin_return(x, -1, SLOW, high_speed=False)
    assert (report.stopped_by, report.ok) == ("HOME", False)


@pytest.mark.parametrize("name", NOVA)
def test_a_host_that_stops_a_nova_drive_is_the_reason(name):
    x = bench(CHIPS[name])
    driver, chip = get_driver(x), x.chip
    stop = 1 << 8 | chip.MAP.command(driver.SLOW_DOWN).code
    write_at(x, 0.1, 0, stop)
    report = firmware.move(x, pulses=9000)
    assert (report.stopped_by, report.ok) == ("stop command", False)
    assert 0 < report.pulses < 9000
    write_at(x, 0.1, 0, stop)
    assert firmware.line({x: 9000}, pulses=True).axes["x"].stopped_by == "stop command"
    write_at(x, 0.1, 0, stop)
    assert firmware.jog(x, 0.5).stopped_by == "stop command"
    driver.start(9000, Speeds())
    write_at(x, 0.1, 0, stop)
    assert driver.wait(5.0) == "unknown", "nobody has kept a journal"


@pytest.mark.parametrize("name", FIRST)
@pytest.mark.parametrize("direction", [1, -1])
def test_a_software_limit_that_ends_a_nova_drive_is_the_reason(name, direction):
    """WR2 SLMT+ and SLMT-, at 500 pulses: the drive slows down there"""
    x = bench(CHIPS[name])
    port, limit = ChipPort(x), "SLMT+" if direction > 0 else "SLMT-"
    port.write_parameters(CP=500, CM=-500)
    port.write_mode_words(WR2=x.chip.MAP.mask("WR2", "SLMT+") | x.chip.MAP.mask("WR2", "SLMT-"))
    report = firmware.move(x, pulses=4000 * direction)
    assert (report.stopped_by, report.ok) == (limit, False)
    assert firmware.move(x, pulses=-100 * direction).stopped_by == "all pulses", (
        "beyond the limit still, and on its way back"
    )
    jogged = get_driver(x)
    jogged.start_continuous_move(direction, Speeds())
    assert not jogged.is_running()
    assert jogged.explain_end(False) == limit


@pytest.mark.parametrize("chip", [MCX514, MCX314AS])
def test_all_axes_of_an_interpolation_name_the_limit_that_ended_it(chip):
    stage = Stage("xy", chips=chip, visuals=False)
    with faults.switch_stuck(stage.axes["x"], "el_plus", True):
        report = firmware.line({"x": 6e-3, "y": 2e-3}, stage)
    assert {n: r.stopped_by for n, r in report.axes.items()} == {"x": "EL+", "y": "another axis"}
    assert not any(r.ok for r in report.axes.values())


@pytest.mark.parametrize(("limited", "other"), [("x", "y"), ("y", "x")])
@pytest.mark.parametrize("chip", ["PCL240K", "MCX304", "MCX302", "HCTL1100"])
def test_a_limit_that_ends_one_axis_of_a_line_slows_the_others_down(chip, limited, other):
    """Chips that draw a line each for itself: the rest of it is not the line that was asked for."""
    stage = Stage("xy", chips=chip, visuals=False)
    edge = next(s.touch for s in stage.axes[limited].plant.switches if s.pin == "el_plus")
    speed, accel, before = 20e-3, 0.1, 3e-3
    stage.place(**{limited: edge - before})
    report = firmware.line({limited: 9e-3, other: -9e-3}, stage, speed=speed, accel=accel)
    reasons = {name: r.stopped_by for name, r in report.axes.items()}
    assert reasons == {limited: "EL+", other: "decelerating stop" if chip == "PCL240K" else "another axis"}
    assert not any(r.ok for r in report.axes.values())
    stopped = before + 0.5 * speed * accel
    assert -stage.axes[other].position == pytest.approx(stopped, abs=0.2e-3), "a ramp down from where the limit was met"
    assert firmware.move(stage.axes[other], 1e-3).ok, "and it is at rest, and moves again"


def test_each_other_axis_of_a_line_that_a_limit_ends_gets_one_stop_command(monkeypatch):
    """Three axes that come to rest one after the other: all of them say what has ended them."""
    stage = Stage("xyz", chips="mcx304", visuals=False)
    slowed, slow_down = [], get_driver_class(type(stage.axes["x"].chip)).slow_down
    monkeypatch.setattr(
        get_driver_class(type(stage.axes["x"].chip)),
        "slow_down",
        lambda driver: (slowed.append(driver.axis.name), slow_down(driver)),
    )
    edge = next(s.touch for s in stage.axes["x"].plant.switches if s.pin == "el_plus")
    stage.place(x=edge - 3e-3)
    report = firmware.line({"x": 9e-3, "y": 9e-3, "z": 0.1e-3}, stage, speed=20e-3, accel=0.3)
    assert sorted(slowed) == ["y", "z"]
    assert {n: r.stopped_by for n, r in report.axes.items()} == {"x": "EL+", "y": "another axis", "z": "another axis"}


def test_a_home_search_that_a_host_stops_is_not_ok():
    """DRVFBRK while an MCX514 searches ORG"""
    x = bench(MCX514)
    write_at(x, 0.2, 0, 1 << 8 | MCX514.MAP.command("DRVFBRK").code)
    report = firmware.home(x, timeout=2.0)
    assert report.stopped_by not in get_driver(x).HOME_REASONS
    assert not report.ok
