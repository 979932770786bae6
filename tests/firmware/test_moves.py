"""Procedures by bus cycles only: on chips alone, and on the stage."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stage import ArgumentError, RunTimeout, Stage, firmware
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.firmware import Bench, Profile
from stage.firmware.move_report import ProcedureObserver
from stage.firmware.pcl240 import chip_port


@pytest.fixture
def x():
    return Bench(x=PCL240K()).axes["x"]


@pytest.fixture(scope="module")
def stage():
    return Stage("xyz", chips=PCL240K, visuals=False)


@pytest.fixture
def xyz(stage):
    stage.reset()
    return stage


def phases(report):
    """The order of chip phases of a move, for example ['fup', 'fkeep', 'fdown']."""
    observed = []
    waveform = report.waveforms
    pins = {name: waveform.pin(name) for name in ("fup", "fkeep", "fdown")}
    running = ~waveform.pin("hold")
    for k in range(len(running)):
        now = next(name for name, pin in pins.items() if pin[k]) if running[k] else None
        if now and (not observed or observed[-1] != now):
            observed.append(now)
    return observed


@pytest.mark.parametrize("pulses", [1, 2, 37, -37, 1000, -5000, 60_000])
@pytest.mark.parametrize("high_speed", [True, False])
def test_a_preset_move_makes_exactly_its_pulses(x, pulses, high_speed):
    profile = Profile.of(fl=1000, fh1=8000, accel=0.1)
    report = firmware.preset_move(x, pulses, profile, high_speed=high_speed)
    assert report.pulses == pulses
    assert report.residual == 0
    assert report.stopped_by == "R0 = 0"
    assert report.ok
    assert x.chip.diagnostics == []


def test_a_long_move_is_a_trapezoid_and_a_short_one_a_triangle(x):
    profile = Profile.of(fl=500, fh1=16_000, accel=0.2)
    long = firmware.preset_move(x, 20_000, profile)
    assert phases(long) == ["fup", "fkeep", "fdown", "fkeep"]
    assert long.peak_rate == pytest.approx(profile.fh1)
    short = firmware.preset_move(x, 1000, profile)
    assert phases(short)[:2] == ["fup", "fdown"]
    assert profile.fl < short.peak_rate < profile.fh1


def test_the_duration_of_a_move_is_its_running_time(x):
    """firmware.preset_move(x, 3, high_speed=False): the chip is busy from the start command to the end of the last pulse"""
    report = firmware.preset_move(x, 3, high_speed=False)
    waveform = report.waveforms
    start, end = (waveform.seconds[1:][np.diff(waveform.running.astype(int)) == direction] for direction in (1, -1))
    assert report.duration == pytest.approx(end[0] - start[0], abs=1e-9)
    assert report.duration > 3 / Profile.of().fh1


def test_constant_speed_has_no_ramps(x):
    report = firmware.preset_move(x, 500, Profile.of(fh1=2000), high_speed=False)
    assert phases(report) == ["fkeep"]


@pytest.mark.parametrize(
    ("options", "why"),
    [({}, "decelerating stop"), ({"immediate": True}, "reset command"), ({"high_speed": False}, "reset command")],
)
def test_a_continuous_move_stops_by_the_requested_command(x, options, why):
    report = firmware.continuous_move(x, 0.3, -1, **options)
    assert report.stopped_by == why
    assert report.pulses < 0
    assert report.asked is None


def test_a_dual_rate_move_ramps_between_its_rates_in_order(x):
    profile = Profile.of(fl=1000, fh1=8000, fh2=16_000, accel=0.1)
    report = firmware.dual_rate_move(x, 12_000, profile, rates=("FL", "FH1", "FH2", "FH1"), dwell=0.1)
    assert report.ok
    assert phases(report) == ["fkeep", "fup", "fkeep", "fup", "fkeep", "fdown", "fkeep", "fdown", "fkeep"]
    assert report.peak_rate == pytest.approx(profile.fh2)


def test_a_speed_change_move_reaches_every_rate_of_its_list(x):
    rates = [4000, 9000, 6000, 12_000, 3000]
    report = firmware.speed_change_move(x, 8000, rates, Profile.of(fl=1000, fh1=8000), dwell=0.1)
    assert report.ok
    e = report.waveforms.edges
    is_constant_rate = report.waveforms.pin("fkeep") & ~report.waveforms.pin("hold")
    observed = {round(float(r)) for r in (e["rate"] * report.waveforms.clock_hz)[is_constant_rate]}
    for rate in rates:
        assert any(abs(s - rate) < 0.02 * rate for s in observed), (rate, observed)


def test_an_interrupted_move_resumes_its_residual_pulses(x):
    report = firmware.interrupted_move(x, 10_000, after=0.2, pause=0.1)
    assert report.ok
    assert report.pulses == 10_000
    assert report.waveforms.pin("irq").any(), "/INT at the interruption"
    assert phases(report).count("fup") == 2


def test_external_pulses_count_the_counter_down(x):
    report = firmware.external_count(x, 50, rate=2000)
    assert report.stopped_by == "R0 = 0"
    assert report.duration == pytest.approx(50 / 2000, rel=0.1)
    silent = firmware.external_count(x, 50, source=lambda axis: axis.wait(0.01), timeout=0.1)
    assert silent.stopped_by == "reset command"


def test_an_end_limit_is_the_reported_stop_reason(x):
    x._bench.at(x.time + 0.2, lambda: setattr(x.chip.pins, "el_plus", True))
    report = firmware.preset_move(x, 50_000)
    assert report.stopped_by == "EL+"
    assert not report.ok
    assert report.residual == 50_000 - report.pulses


def test_the_listing_describes_every_written_byte(x):
    listing = firmware.preset_move(x, 1000).listing()
    for words in ("reset command", "R0 <- 1000", "control mode: preset", "start, ramp to FH1"):
        assert words in listing


def test_the_plot_of_a_report_is_written_to_a_file(x, tmp_path):
    path = tmp_path / "move.png"
    firmware.dual_rate_move(x, 20_000).plot(str(path))
    assert path.stat().st_size > 20_000


def test_the_counter_is_read_consistently_across_a_borrow(x):
    """The Q & A's remedy: every value read lies between the true ones before and after."""
    port = firmware.ChipPort(x)
    port.write_registers(R0=0x020100, R1=8191, R2=8191, R7=2)
    port.write_command(0x11)
    for _ in range(300):
        before = x.chip.values()["R0"]
        read = port.read_counter()
        assert x.chip.values()["R0"] <= read <= before


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda a: firmware.preset_move(a, 0), "1 to 16777215"),
        (lambda a: firmware.preset_move(a, 1 << 24), "1 to 16777215"),
        (lambda a: firmware.preset_move(a, 1.5), "1 to 16777215"),
        (lambda a: firmware.preset_move(a, 10, profile={}), "give a Profile"),
        (lambda a: firmware.preset_move("x", 10), "is no axis"),
        (lambda a: firmware.dual_rate_move(a, 100, rates=("FH3",)), "FL, FH1 and FH2"),
        (lambda a: Profile(0, 1, 1, 2, 2, 2), r"R1 .FL speed. cannot be 0: .* from 1 to 8191"),
        (lambda a: Profile(1, 1, 1, 1, 2, 2), r"R4 .acceleration rate. cannot be 1: .* from 2 to 16383"),
        (lambda a: Profile(1, 1, 1, 2, 2, 1024), r"R7 .* from 2 to 1023"),
        (lambda a: Profile.of(fh1=1e7), "makes up to"),
        (lambda a: Profile.of(accel=-1), "accel=-1"),
        (
            lambda a: firmware.preset_move(a, 10, down_point=1 << 20),
            r"R6 .ramping-down point. cannot be 1048576: .* 1048575",
        ),
        (lambda a: firmware.preset_move(a, float("nan")), "1 to 16777215"),
        (lambda a: firmware.continuous_move(a, -1), "time runs forward"),
        (lambda a: firmware.continuous_move(a, 1, 0), "direction=0"),
        (lambda a: firmware.interrupted_move(a, 10, after=-1), "time runs forward"),
        (lambda a: firmware.external_count(a, -5), "external pulses are counted from 1 on"),
        (lambda a: firmware.external_count(a, 5, rate=1e9), "sampled by the clock"),
        (lambda a: firmware.external_count(a, 5, source=[1, 2]), "a function of the axis, or a generator"),
        (lambda a: firmware.ChipPort(a).write_register("R9", 1), "unknown PCL240K register 'R9'"),
    ],
)
def test_errors_of_invalid_arguments_name_the_value_and_the_range(x, call, message):
    before = x.chip.snapshot()
    with pytest.raises(ArgumentError, match=message):
        call(x)
    assert x.chip.snapshot() == before


def test_a_move_that_cannot_end_in_time_says_what_the_chip_was_doing(x):
    with pytest.raises(RunTimeout, match=r"still operates after .* R0 = "):
        firmware.preset_move(x, 100_000, timeout=0.1)


@pytest.mark.parametrize("rates", [(500, 9000, 20_000, 0.1), (123.4, 4567.8, 9876.5, 0.33), (1, 100, 245_000, 2.0)])
def test_a_profile_reaches_the_requested_rates_within_2_percent(rates):
    fl, fh1, fh2, accel = rates
    p = Profile.of(fl=fl, fh1=fh1, fh2=fh2, accel=accel)
    if fl >= 100:
        assert p.fl == pytest.approx(fl, rel=0.02)
        assert p.fh1 == pytest.approx(fh1, rel=0.02)
        assert p.get_accel_time(fh2=True) == pytest.approx(accel, rel=0.02)
    assert p.fh2 == pytest.approx(fh2, rel=0.05)


def test_a_continuous_move_onto_an_end_limit_reports_the_limit(x):
    x.chip.pins.el_minus = True
    report = firmware.continuous_move(x, 0.1, -1)
    assert (report.stopped_by, report.pulses) == ("EL-", 0)
    assert not report.ok
    assert report.writes()[-1][1] == "15", "and is given no stop"
    assert firmware.continuous_move(x, 0.1, +1).ok


def test_sd_slows_a_move_that_allows_it_and_no_other(x):
    x.chip.pins.sd_plus = True
    profile = Profile.of(fl=1000, fh1=8000, accel=0.1)
    assert firmware.preset_move(x, 500, profile, slow_down=True).peak_rate == pytest.approx(profile.fl)
    assert firmware.preset_move(x, 5000, profile).peak_rate == pytest.approx(profile.fh1)


@pytest.mark.parametrize("high_speed", [True, False])
def test_the_stop_raises_an_interrupt_on_request(x, high_speed):
    report = firmware.preset_move(x, 200, high_speed=high_speed, interrupt=True)
    irq, hold = report.waveforms.pin("irq"), report.waveforms.pin("hold")
    assert irq[-1]
    assert not (irq & ~hold).any(), "not before it has stopped"
    assert not firmware.preset_move(x, 200).waveforms.pin("irq")[-1]


def test_an_interruption_after_the_end_of_a_move_writes_nothing(x):
    report = firmware.interrupted_move(x, 100, after=0.5)
    assert report.ok
    assert [code for t, code, _ in report.writes() if t >= 0] == ["15"]


@pytest.mark.parametrize(("fh2", "stop"), [(False, "3D"), (True, "3F")])
def test_an_interruption_slows_down_from_the_rate_of_the_move(x, fh2, stop):
    report = firmware.interrupted_move(x, 10_000, after=0.2, pause=0.05, fh2=fh2)
    commands = [code for t, code, _ in report.writes() if t >= 0]
    assert stop in commands
    assert report.pulses == 10_000


@pytest.mark.parametrize(("fh2", "pulses"), [(False, -4200), (True, -8300)])
def test_a_short_rest_of_an_interrupted_s_curve_move_ramps_by_a_lower_s_curve(fh2, pulses):
    """firmware.interrupted_move(axis, 3000, profile.with_ramp_shape(True)): too few pulses are left for FH1"""
    profile = Profile.of(fl=500, fh1=8000, accel=0.2, chip=PCL240MS).with_ramp_shape(True, fh2)
    report = firmware.interrupted_move(Bench(x=PCL240MS()).axes["x"], pulses, profile, after=0.42, pause=0.05, fh2=fh2)
    assert (report.pulses, report.stopped_by, report.ok) == (pulses, "R0 = 0", True)
    speed = report.waveforms.edges["speed"]
    again = np.flatnonzero((speed[1:] > 0) & (speed[:-1] == 0)) + 1
    first, rest = speed[again[0] : again[1]], speed[again[1] :]
    assert profile.R1 < rest.max() < first.max() == profile.get_high_speed(fh2)
    assert rest[rest > 0][-1] == profile.R1


@pytest.mark.parametrize("chip", [PCL240K, PCL240MK, PCL240MS])
@pytest.mark.parametrize("fh2", [False, True])
@pytest.mark.parametrize("pulses", [2400, -4000, 9000])
@pytest.mark.parametrize("after", [0.2, 0.31])
def test_the_rest_of_an_interrupted_move_gets_the_ramp_down_point_for_its_pulses(chip, fh2, pulses, after):
    """R0 keeps the residual pulses (section 4, R0). R6 for them: Psd + 5 (section 4, R6), or R0 R5 / (R4 + R5) of a triangular
    drive (Q & A), for with R6 > R0 the ramping-up does not occur. The registers and R0 are read on the pins and the bus."""
    profile = Profile.of(fl=500, fh1=8000, fh2=12_000, accel=0.25, decel=0.1)
    report = firmware.interrupted_move(Bench(x=chip()).axes["x"], pulses, profile, fh2=fh2, after=after, pause=0.05)
    assert (report.pulses, report.stopped_by) == (pulses, "R0 = 0")
    edges, hold = report.waveforms.edges, report.waveforms.pin("hold")
    starts = np.flatnonzero(hold[:-1] & ~hold[1:]) + 1
    assert len(starts) == 2, "the start of the move, and that of its rest"
    r0, speed = int(edges["counter"][starts[1]]), edges["speed"][starts[1] :]
    assert 0 < r0 < abs(pulses)
    down_points = [int(word) for *_, meaning in report.writes() for word in re.findall(r"^R6 <- (\d+)", meaning)]
    fh, r1, r4, r5, r7 = (profile.R3 if fh2 else profile.R2), profile.R1, profile.R4, profile.R5, profile.R7
    squares = fh * fh - r1 * r1
    if r0 < squares * (r4 + r5) / (16384 * r7):
        assert r0 * r5 / (r4 + r5) <= down_points[-1] <= r0 * r5 / (r4 + r5) + 3, "triangular"
        assert r1 < speed.max() < fh
    else:
        assert down_points[-1] == squares * r5 // (16384 * r7) + 5
        assert speed.max() == fh
    assert speed[speed > 0][-1] == r1, "it ends at FL"


@pytest.mark.parametrize("rate", [2000.0, 5000.0, 12_000.0])
def test_external_pulses_faster_than_fl_end_the_run_by_their_count(x, rate):
    """More of them come while the last pulse is completed, and R0 goes on below 0."""
    report = firmware.external_count(x, 6, rate=rate)
    assert (report.stopped_by, report.ok) == ("R0 = 0", True)


def test_a_generator_can_supply_the_external_pulses(x):
    def encoder():
        for _ in range(30):
            x.chip.pins.extp = True
            x.wait(1e-4)
            x.chip.pins.extp = False
            x.wait(2e-4)
            yield

    report = firmware.external_count(x, 20, source=encoder())
    assert (report.stopped_by, report.residual) == ("R0 = 0", 0)
    too_few = firmware.external_count(x, 40, source=encoder())
    assert (too_few.stopped_by, too_few.residual) == ("reset command", 10)
    timed_out = firmware.external_count(x, 1000, rate=100, timeout=0.2)
    assert timed_out.stopped_by == "timeout"
    assert not timed_out.ok


def test_the_average_rate_counts_pulses_of_both_directions(x):
    with ProcedureObserver(x, "to and fro") as watched:
        for pulses in (3000, -1000):
            firmware.preset_move(x, pulses, Profile.of(fl=1000, fh1=8000, accel=0.1))
        report = watched.make_report("R0 = 0")
    assert report.pulses == 2000
    assert report.average_rate == pytest.approx(4000 / report.duration)


def test_a_report_says_rates_and_bytes(x):
    report = firmware.preset_move(x, 3000, Profile.of(fl=1000, fh1=8000, accel=0.1))
    assert report.average_rate == pytest.approx(3000 / report.duration)
    assert "average" in str(report)
    started = [(t, code) for t, code, _ in report.writes() if code == "15"]
    assert started == [(0.0, "15")], "times are from the first start"
    assert ("80 00 0B B8", "R0 <- 3000 (down counter: pulses left)") in [w[1:] for w in report.writes()]


def test_a_profile_for_another_clock_is_refused():
    x = Bench(PCL240K(clock_hz=9_830_400)).axes["x"]
    with pytest.raises(ArgumentError, match="for a chip at 4915200 Hz, axis x's runs at 9830400 Hz"):
        firmware.preset_move(x, 10, Profile.of())
    report = firmware.preset_move(x, 4000, Profile.of(fh1=8000, clock_hz=9_830_400))
    assert report.ok
    assert report.peak_rate == pytest.approx(8000, rel=1e-3)


def test_on_the_stage_a_move_within_the_limits_loses_no_step_and_ends_at_its_distance(xyz):
    for axis in xyz.axes.values():
        report = firmware.preset_move(axis, 6400)
        assert report.ok
        assert report.lost_steps == 0
        assert report.position - report.start == pytest.approx(0.020, abs=2e-5)


def test_a_report_does_not_count_steps_that_were_lost_before_its_move(xyz):
    x = xyz.axes["x"]
    xyz.data.qpos[x.plant.qpos] += 16 * 16 * x.meters_per_pulse
    xyz.run(0.05)
    assert x.lost_steps == -16
    assert firmware.preset_move(x, 300).lost_steps == 0
    assert firmware.move(x, pulses=-300).lost_steps == 0


def test_a_move_above_pull_out_reports_its_lost_steps_and_an_origin_return_finds_home_again(xyz):
    x = xyz.axes["x"]
    firmware.origin_return(x)
    home = x.position
    report = firmware.preset_move(x, 32_000, Profile.of(fh1=120_000, accel=0.05))
    assert report.pulses == 32_000, "the chip does not notice lost steps"
    assert not report.ok
    assert report.lost_steps > 0
    assert report.lost_steps % 4 == 0
    assert report.position - report.start == pytest.approx(0.1 - report.lost_steps * 0.01 / 200, abs=1e-4)
    assert x.lost_steps == report.lost_steps, "they stay lost"
    again = firmware.origin_return(x)
    assert again.stopped_by == "ORG"
    assert x.position == pytest.approx(home, abs=x.meters_per_pulse)


def test_an_end_limit_stops_within_one_pulse_and_allows_moves_back(xyz):
    x = xyz.axes["x"]
    xyz.place(x=0.149)
    slow = Profile.of(fl=500, fh1=1000)
    report = firmware.preset_move(x, 2000, slow)
    waveform = report.waveforms
    reached = waveform.edges["net"][np.argmax(waveform.pin("el_plus"))]
    assert report.stopped_by == "EL+"
    assert waveform.edges["net"][-1] == reached, "no pulse begins after the switch"
    assert report.position == pytest.approx(0.150, abs=3 * x.meters_per_pulse)
    on = firmware.preset_move(x, 10, slow)
    assert (on.pulses, on.stopped_by) == (0, "EL+")
    assert firmware.preset_move(x, -320, slow).ok


def test_on_the_stage_a_start_above_pull_in_loses_steps_where_a_ramp_does_not(xyz):
    x = xyz.axes["x"]
    steep = firmware.preset_move(x, 16_000, Profile.of(fl=60_000, fh1=60_000), high_speed=False)
    assert steep.lost_steps > 0
    xyz.reset()
    assert firmware.preset_move(x, 16_000, Profile.of(fl=1000, fh1=60_000, fh2=60_000, accel=0.2)).ok


def test_on_the_stage_moves_of_every_kind_return_without_a_lost_step(xyz):
    x = xyz.axes["x"]
    begin = x.position
    done = [
        firmware.dual_rate_move(x, 14_000),
        firmware.speed_change_move(x, 8000, [8000, 16_000, 4000]),
        firmware.curved_ramp_move(x, -12_000, [(4000, 0.1), (12_000, 0.15), (16_000, 0.1)]),
        firmware.interrupted_move(x, -10_000, after=0.2, pause=0.1),
    ]
    assert all(r.ok for r in done), [str(r) for r in done]
    x.wait(0.1)
    assert x.position == pytest.approx(begin, abs=2e-5)


@pytest.mark.parametrize(("direction", "limit"), [(1, "EL+"), (-1, "EL-")])
def test_a_move_that_ends_on_org_is_not_reported_as_stopped_by_org(direction, limit):
    x = Bench(x=PCL240K()).axes["x"]
    x.chip.pins.org = True
    assert firmware.preset_move(x, direction * 300).stopped_by == "R0 = 0"
    setattr(x.chip.pins, "el_plus" if direction > 0 else "el_minus", True)
    assert firmware.preset_move(x, direction * 300).stopped_by == limit


@pytest.mark.parametrize("kind", [PCL240MK, PCL240MS])
def test_the_chip_finds_the_ramp_down_point_only_with_equal_ramps_and_without_sd(kind):
    """The automatic point assumes a ramp down with R4, and is wrong after SD has slowed the axis."""

    def uses_automatic_point(profile=None, **options):
        report = firmware.preset_move(Bench(x=kind()).axes["x"], 4000, profile, **options)
        assert report.ok
        modes = [int(s.code, 16) for s in report.statements if s.kind == "command" and int(s.code, 16) >> 6 == 1]
        return {bool(mode & chip_port.AUTOMATIC) for mode in modes}

    even, uneven = (Profile.of(fh1=8000, accel=0.1, decel=decel, chip=kind) for decel in (0.1, 0.15))
    assert uses_automatic_point(even) == {True}
    assert uses_automatic_point(even, slow_down=True) == uses_automatic_point(uneven) == {False}
    assert uses_automatic_point(even, down_point=900) == {False}
    assert uses_automatic_point(even, slow_down=True, automatic=True) == {True}, "an explicit request wins"


def test_a_counter_is_printed_as_negative_only_after_it_has_passed_0(x):
    report = firmware.preset_move(x, 10)
    overrun = replace(report, asked=-12_000_000, residual=11_999_990)
    assert "(24-bit counter" not in str(overrun)
    assert "R0 12000001 (24-bit counter: -4777215)" in str(replace(overrun, residual=12_000_001))
    assert "R0 8388608;" in str(replace(overrun, asked=10, residual=1 << 23))


def test_a_move_that_loses_steps_is_not_ok(x):
    report = replace(firmware.preset_move(x, 10), lost_steps=4)
    assert (report.pulses, report.asked, report.ok) == (10, 10, False)
    assert replace(report, lost_steps=0).ok
