"""a:b moves on chips and on the stage: straight to two pulses, exact to the count, started by real bus cycles."""

import random
from types import SimpleNamespace

import numpy as np
import pytest
from support.examples import SEED, assert_axes_are_named, scaled

from stage import ArgumentError, RunTimeout, Stage
from stage.chips import PCL240K
from stage.firmware import Bench, plan, synchronized_move
from stage.firmware.synchronized_report import CarriageDeviationMeter


def bench(names="xy", **options):
    return Bench(**{n: PCL240K() for n in names}, **options)


def test_random_pairs_stay_within_two_pulses_of_their_line():
    seed = SEED
    print("seed", seed)
    rng = random.Random(seed)
    distance = []
    for _ in range(scaled(10)):
        distances = {n: rng.choice((-1, 1)) * rng.randint(100, 30_000) for n in "xy"}
        chips = bench()
        report = synchronized_move(distances, chips)
        distance.append(report.deviation.pulses)
        assert report.ok
        for n, d in distances.items():
            assert report.axes[n].pulses == d
            assert report.axes[n].stopped_by == "R0 = 0"
            assert chips.axes[n].chip.diagnostics == []
    print(f"median {np.median(distance):.3f}, 95 % {np.percentile(distance, 95):.3f}, largest {max(distance):.3f}")
    assert np.median(distance) <= 1
    assert np.percentile(distance, 95) <= 1.1
    assert max(distance) <= 2


def test_three_axes_share_a_line():
    seed = SEED
    print("seed", seed)
    rng = random.Random(seed)
    for _ in range(scaled(4)):
        distances = {n: rng.choice((-1, 1)) * rng.randint(100, 30_000) for n in "xyz"}
        report = synchronized_move(distances, bench("xyz"))
        assert {n: r.pulses for n, r in report.axes.items()} == distances
        assert report.deviation.pulses <= 2


def test_extreme_ratios_stay_on_the_line():
    for distances in ({"x": 50_000, "y": 20}, {"x": -3, "y": 30_000}, {"x": 50_000, "y": 49_999}):
        report = synchronized_move(distances, bench())
        assert report.ok
        assert report.deviation.pulses <= 1.2


def test_fast_moves_and_unequal_ramps_stay_on_the_line():
    report = synchronized_move({"x": 60_000, "y": 25_000}, bench(), rate=200_000, fl=3000, accel=0.1, decel=0.04)
    assert report.deviation.pulses <= 2
    assert report.axes["x"].peak_rate == pytest.approx(200_000, rel=2e-3)


def test_the_deviation_of_millions_of_pulses_is_the_estimated_one():
    report = synchronized_move({"x": 1_500_000, "y": -912_345}, bench(), rate=100_000)
    assert report.ok
    assert not report.plan.exact
    assert report.deviation.pulses < report.plan.deviation + 0.1


def test_a_single_axis_moves_by_itself():
    report = synchronized_move({"x": -1234}, bench())
    assert report.axes["x"].pulses == -1234
    assert (report.deviation.pulses, report.skew, report.finish) == (0, 0, 0)


def test_an_axis_with_distance_zero_stays_still():
    chips = bench()
    report = synchronized_move({"x": 300, "y": 0}, chips)
    assert list(report.axes) == ["x"]
    assert chips.axes["y"].chip.values()["R7"] == 0


def test_axes_start_one_bus_cycle_after_the_other_and_stop_at_the_same_time():
    report = synchronized_move({"x": 12_000, "y": 5_000, "z": 800}, bench("xyz", bus_cycle=4e-6))
    assert report.plan.bus_delay == pytest.approx(4e-6)
    assert report.skew == pytest.approx(8e-6)
    last = [clocks[-1] for clocks, _ in report.paths.values()]
    assert 0 < report.finish == pytest.approx(max(last) - min(last))
    assert report.finish < 2.1 / report.plan.axes["z"].fl
    text = str(report)
    assert "first starts 8.0 us apart" in text
    assert "pulses from the line at most" in text


def test_the_deviation_grows_with_the_delay_between_starts():
    blind = plan({"x": 20_000, "y": 16_000}, rate=40_000)  # reckons with starts at once
    distance = []
    for cycle in (0.0, 2e-5, 1e-4, 5e-4):
        report = synchronized_move(blind, bench(bus_cycle=cycle))
        assert report.skew == pytest.approx(cycle)
        assert report.plan.bus_delay == pytest.approx(cycle), "of this bus"
        assert report.deviation.pulses == pytest.approx(blind.with_bus_delay(cycle).deviation, abs=0.02)
        assert report.deviation.pulses == pytest.approx(report.plan.deviation, abs=0.02)
        distance.append(report.deviation.pulses)
    assert distance == sorted(distance)
    slow_axis_ahead = 32_000 * 5e-4
    assert distance[-1] == pytest.approx(slow_axis_ahead * 20_000 / np.hypot(20_000, 16_000), abs=1.5)


def test_a_plan_compensates_a_known_bus_delay():
    distances = {"x": 20_000, "y": 16_000}
    blind = synchronized_move(plan(distances, rate=40_000), bench(bus_cycle=1e-4)).deviation.pulses
    aware = synchronized_move(distances, bench(bus_cycle=1e-4), rate=40_000).deviation.pulses
    assert aware < 0.5 * blind


def test_repeated_moves_are_equal_bit_for_bit():
    one, two = (synchronized_move({"x": 7000, "y": -3210}, bench()) for _ in range(2))
    assert one.plan == two.plan
    assert one.deviation == two.deviation
    for n in one.paths:
        assert (one.paths[n][0] == two.paths[n][0]).all()


@pytest.fixture(scope="module")
def stage():
    return Stage("xyz", chips=PCL240K, visuals=False)


def test_on_the_stage_carriages_follow_the_line(stage):
    stage.reset()
    report = synchronized_move({"x": 20_000, "y": -7_500}, stage.axes)
    assert report.ok
    assert report.deviation.pulses == pytest.approx(report.plan.deviation, abs=0.02)
    assert 0 < report.carriage_deviation < 1e-4
    assert stage.time > report.plan.seconds + 0.04, "it looks where the carriages came to rest"
    for n, d in (("x", 20_000), ("y", -7_500)):
        axis = stage.axes[n]
        assert report.axes[n].lost_steps == 0
        moved = report.axes[n].position - report.axes[n].start
        assert moved == pytest.approx(d * axis.meters_per_pulse, abs=5e-5)


def test_axes_are_accepted_by_name_or_as_objects(stage):
    stage.reset()
    x, y = stage.axes["x"], stage.axes["y"]
    for call in (
        lambda: synchronized_move({"x": 640, "y": 320}, stage),
        lambda: synchronized_move({x: 640, y: 320}),
        lambda: synchronized_move({"a": 640, "b": 320}, {"a": x, "b": y}),
        lambda: synchronized_move(plan({"x": 640, "y": 320}), stage),
    ):
        assert [r.pulses for r in call().axes.values()] == [640, 320]


def test_an_end_limit_stops_the_other_axes_too():
    chips = bench()
    chips.at(0.2, lambda: setattr(chips.axes["y"].chip.pins, "el_minus", True))
    report = synchronized_move({"x": 20_000, "y": -9_000}, chips)
    assert not report.ok
    assert report.axes["y"].stopped_by == "EL-"
    assert report.axes["x"].stopped_by == "decelerating stop"
    assert 0 < report.axes["x"].pulses < 20_000
    assert "NOT as asked" in str(report)
    assert report.seconds == report.plan.seconds, "what was planned"
    stops = {n: [s.code for s in r.statements if s.kind == "command"].count("1D") for n, r in report.axes.items()}
    assert stops == {"x": 1, "y": 0}, "told once, and only who still runs"


def test_an_axis_that_completes_its_pulses_is_ok_although_another_met_a_limit():
    """x meets its limit in its last pulses, when y has as good as ended: y is given a decelerating stop or is not, by chance."""
    for limit in range(19_985, 20_000, 2):
        chips = bench()
        chips.add_rail("x", el_plus=(limit, None))
        report = synchronized_move({"x": 20_000, "y": 400}, chips)
        assert report.axes["x"].stopped_by == "EL+"
        y = report.axes["y"]
        assert (y.pulses == 400) == (y.stopped_by == "R0 = 0"), limit


def test_the_timeout_error_of_a_synchronized_move_states_the_remaining_pulses():
    with pytest.raises(
        RunTimeout, match=r"after 0.100 s axes still operate; pulses left: \{'y': \d+, 'x': \d+\}"
    ) as caught:
        synchronized_move({"x": 20_000, "y": 9_000}, bench(), timeout=0.1)
    assert 0 < caught.value.reports["x"].pulses < 20_000


def test_a_synchronized_move_ends_at_its_timeout():
    """synchronized_move({"x": 200_000, "y": 30_000}, bench, timeout=0.01): it is looked at every 0.06 s"""
    b = bench()
    with pytest.raises(RunTimeout):
        synchronized_move({"x": 200_000, "y": 30_000}, b, timeout=0.01)
    assert b.axes["x"].time < 0.012


def test_the_plot_of_a_synchronized_move_states_its_deviation(tmp_path):
    pytest.importorskip("matplotlib")
    for names, distances in (("x", (90,)), ("xy", (900, -400)), ("xyz", (4000, 300, -2000))):
        report = synchronized_move(dict(zip(names, distances, strict=True)), bench(names))
        figure = report.plot(tmp_path / f"{names}.png", title="a line")
        assert_axes_are_named(figure)
        distance, reported = report.deviation, [ax.get_title(loc="right") for ax in figure.axes]
        assert f"at most {distance.pulses:.2f} pulses from the line, after {distance.time * 1000:,.4g} ms" in reported
        assert (tmp_path / f"{names}.png").stat().st_size > 20_000


def test_the_error_of_an_unknown_axis_proposes_similar_names(stage):
    with pytest.raises(ArgumentError, match=r"unknown axis 'xx'. Did you mean 'x'\? Known: x, y, z"):
        synchronized_move({"xx": 100, "y": 100}, stage)


def test_axis_names_need_a_stage_or_mapping():
    with pytest.raises(
        ArgumentError, match=r"axis 'x': say where it is: synchronized_move\(\{'x': ...\}, stage.axes\)"
    ):
        synchronized_move({"x": 100})


def test_a_duplicate_axis_is_refused():
    chips = bench()
    with pytest.raises(ArgumentError, match="given twice"):
        synchronized_move({"x": 100, chips.axes["x"]: 50}, chips)


def test_a_key_that_is_no_axis_is_refused():
    with pytest.raises(ArgumentError, match="is no axis"):
        synchronized_move({5: 100})


def test_a_procedure_on_a_moving_axis_is_refused_and_the_axis_continues():
    chips = bench()
    port = chips.axes["x"].chip
    for number, value in ((0, 200), (7, 1), (1, 100)):  # R0 = 5 * 256, R7 = 256, R1 = 100
        port.write(0, 0x80 | number)
        port.write(1 if number == 1 else 2, value)
    port.write(0, 0x44)
    port.write(0, 0x10)
    with pytest.raises(ArgumentError, match="axis x is moving"):
        synchronized_move({"x": 100, "y": 50}, chips)
    assert port.read(0) & 0x40


def test_a_plan_for_another_clock_is_refused():
    with pytest.raises(ArgumentError, match="the plan is for a chip at 1000000 Hz"):
        synchronized_move(plan({"x": 100}, rate=2000, clock_hz=1_000_000), bench())


def test_a_refused_move_writes_nothing_to_the_chips():
    chips = bench()
    before = [a.chip.snapshot() for a in chips.axes.values()]
    with pytest.raises(ArgumentError):
        synchronized_move({"x": 100_000, "y": 300}, chips, accel=25)
    assert [a.chip.snapshot() for a in chips.axes.values()] == before
    assert chips.time == 0


def test_a_carriage_beyond_an_end_of_its_line_deviates_by_its_distance_from_that_end():
    """A line of 3 mm and 4 mm; 1 mm before its beginning, beside its middle, and 2 mm beyond its end"""
    x, y = (SimpleNamespace(position=0.0, meters_per_pulse=1e-6, gear=gear, unit="m") for gear in (5.0, -5.0))
    for place, distance in (
        ((-0.6e-3, 0.8e-3), 1e-3),
        ((1.5e-3 + 0.4e-3, -2e-3 + 0.3e-3), 0.5e-3),
        ((4.2e-3, -5.6e-3), 2e-3),
    ):
        x.position = y.position = 0.0
        carriages = CarriageDeviationMeter({"x": x, "y": y}, {"x": 3000, "y": 4000})
        x.position, y.position = place
        carriages.measure()
        assert carriages.worst == pytest.approx(distance)
    y.unit = "rad"
    assert CarriageDeviationMeter({"x": x, "y": y}, {"x": 3000, "y": 4000}).worst is None
