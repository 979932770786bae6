"""Origin return on chips alone: a carriage that never slips, switches in pulses; every start place, every fault."""

import numpy as np
import pytest
from support.examples import SEED, scaled

from stage import ArgumentError, RunTimeout, firmware
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.firmware import Bench, ChipPort, Profile

P = Profile.of(fl=1000, fh1=16_000, accel=0.1)
LOW, HIGH = -3200, 20_000
SWITCHES = {
    "el_minus": (None, LOW),
    "sd_minus": (None, 6400),
    "org": (None, 0),
    "sd_plus": (HIGH - 6400, None),
    "el_plus": (HIGH, None),
}


def make_axis_at(place, chip=PCL240K, **switches):
    bench = Bench(chip())
    bench.add_rail("x", at=place, **(SWITCHES | switches))
    return bench.axes["x"]


@pytest.mark.parametrize("high_speed", [True, False])
@pytest.mark.parametrize(
    "place", [LOW - 50, LOW, LOW + 1, -1000, -1, 0, 1, 150, 6399, 6400, 6401, 12_000, HIGH, HIGH + 20]
)
def test_a_return_ends_on_the_same_pulse_from_any_start(place, high_speed):
    x = make_axis_at(place)
    report = firmware.origin_return(x, -1, P, high_speed=high_speed)
    assert report.stopped_by == "ORG"
    assert report.ok
    assert x.rail_position == 0
    assert report.pulses == -place
    assert x.chip.diagnostics == []


def test_a_return_ends_on_the_same_pulse_from_random_starts_at_random_speeds():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for _ in range(scaled(5)):
        x = make_axis_at(int(rng.integers(LOW, HIGH + 1)))
        fl = rng.uniform(300, 2000)
        speeds = Profile.of(fl=fl, fh1=rng.uniform(fl, 40_000), accel=rng.uniform(0.01, 0.3))
        report = firmware.origin_return(x, -1, speeds, back_off=int(rng.integers(1, 500)))
        assert (report.stopped_by, x.rail_position) == ("ORG", 0)


def test_a_return_in_the_plus_direction_mirrors_one_in_the_minus_direction():
    mirrored = {"el_plus": (3200, None), "sd_plus": (-6400, None), "org": (0, None), "el_minus": (None, -20_000)}
    bench = Bench(PCL240K())
    for place in (-15_000, -200, 0, 3200):
        bench.add_rail("x", at=place, **mirrored)
        report = firmware.origin_return(bench.axes["x"], +1, P)
        assert (report.stopped_by, bench.axes["x"].rail_position) == ("ORG", 0)
    bench.add_rail("x", at=0, **mirrored | {"org": (None, None)})
    report = firmware.origin_return(bench.axes["x"], +1, P)
    assert (report.stopped_by, bench.axes["x"].rail_position, report.ok) == ("EL-", -20_000, False)


@pytest.mark.parametrize("chip", [PCL240MK, PCL240MS])
@pytest.mark.parametrize("ez", [1, 16])
def test_an_end_limit_before_the_index_pulse_is_not_reported_as_origin(ez, chip):
    """firmware.origin_return(axis, -1, ez=1) of an encoder without index pulses"""
    x = make_axis_at(3000, chip=chip)
    report = firmware.origin_return(x, -1, P, ez=ez, approach=500)
    assert (report.stopped_by, x.rail_position, report.ok) == ("EL-", LOW, False)
    assert x.chip.values()["R1"] == round(500 / P.rate_per_speed_step), "the speed of the approach, as on every chip"


def test_the_approach_is_at_most_fl_and_at_least_one_speed_step():
    """firmware.origin_return(axis, -1, P, approach=1e4)"""
    for approach, r1 in [
        (0.4 * P.rate_per_speed_step, 1),
        (500, round(500 / P.rate_per_speed_step)),
        (1e4, P.R1),
        (P.rate_per_speed_step * 8191, P.R1),
    ]:
        x = make_axis_at(30)
        report = firmware.origin_return(x, -1, P, approach=approach, back_off=3)
        assert (report.stopped_by, x.rail_position) == ("ORG", 0)
        assert report.waveforms.edges["speed"][report.waveforms.running][-1] == r1


def test_sd_slows_the_return_to_fl_before_org():
    waveform = firmware.origin_return(make_axis_at(12_000), -1, P, slow_approach=False).waveforms
    org = np.flatnonzero(waveform.pin("org"))[0]
    assert waveform.edges["speed"][org] == P.R1
    assert waveform.pin("fdown").any()


@pytest.mark.parametrize("high_speed", [True, False])
def test_a_return_without_org_ends_on_the_end_limit_and_reports_it(high_speed):
    x = make_axis_at(5000, org=(1, 0))
    report = firmware.origin_return(x, -1, P, high_speed=high_speed)
    assert report.stopped_by == "EL-"
    assert not report.ok
    assert x.rail_position == LOW


def test_an_org_switch_that_is_never_released_is_not_the_origin():
    x = make_axis_at(5000, org=(None, None))
    report = firmware.origin_return(x, -1, P)
    assert report.stopped_by == "EL+", "it went to look where ORG ends"
    assert not report.ok
    assert x.rail_position == HIGH


@pytest.mark.parametrize("high_speed", [True, False])
def test_a_carriage_that_releases_org_during_a_poll_is_home(monkeypatch, high_speed):
    """The carriage rings, or the contact bounces: the first status byte after each stop has no ORG, later ones do."""
    status_read, operating, missed = ChipPort.read_status, False, []

    def status(port):
        nonlocal operating
        observed = status_read(port)
        stops, operating = operating and not observed.operating, observed.operating
        if stops and observed.org:
            missed.append(observed)
            observed = observed._replace(org=False)
        return observed

    monkeypatch.setattr(ChipPort, "read_status", status)
    x = make_axis_at(12_000)
    report = firmware.origin_return(x, -1, P, high_speed=high_speed)
    assert (report.stopped_by, x.rail_position, len(missed)) == ("ORG", 0, 2)


def test_an_axis_without_any_switch_times_out_with_a_report():
    x = Bench(PCL240K()).axes["x"]
    with pytest.raises(RunTimeout) as caught:
        firmware.origin_return(x, -1, P, timeout=0.5)
    assert caught.value.report.procedure == "origin return"
    assert caught.value.report.stopped_by == "timeout"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"direction": 0}, r"direction=0: \+1 or -1"),
        ({"back_off": 0}, "pulses=0"),
        ({"approach": 0}, "approach=0"),
        ({"approach": 1e9}, "approach=1000000000.0 pps"),
    ],
)
def test_invalid_arguments_of_an_origin_return_are_refused_before_the_first_bus_cycle(options, message):
    x = make_axis_at(100)
    with pytest.raises(ArgumentError, match=message):
        firmware.origin_return(x, **options)
    assert x.time == 0.0


@pytest.mark.parametrize(
    ("approach", "speed"), [(1500.0, P.R1), (400.0, round(400 / P.rate_per_speed_step)), (0.01, 1)]
)
def test_the_last_approach_has_its_rate_but_at_most_fl(approach, speed):
    """firmware.origin_return(x, -1, P, approach=1500.0) with FL = 1000 pps"""
    x = make_axis_at(300)
    if approach < 1:
        x = make_axis_at(-3)
        report = firmware.origin_return(x, -1, P, approach=approach, back_off=1, timeout=500.0)
    else:
        report = firmware.origin_return(x, -1, P, approach=approach)
    assert (report.stopped_by, x.rail_position) == ("ORG", 0)
    assert x.chip.values()["R1"] == speed
