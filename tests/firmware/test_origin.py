"""Origin return: from anywhere, at any speed, to the same place."""

import numpy as np
import pytest
from support.examples import SEED

from stage import ArgumentError, Stage, firmware
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.firmware import ChipPort


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", chips=PCL240K, visuals=False)


@pytest.fixture(scope="module")
def z_stage():
    return Stage("xyz", chips=PCL240K, visuals=False)


def find_origins(stage, name, runs, **options):
    """Make origin returns from random starts at random speeds, and return their final positions in pulses.

    Fewer than 100 runs start near ORG.
    """
    print("seed", SEED)
    rng = np.random.default_rng([SEED, ord(name)])
    axis, places = stage.axes[name], []
    touch = {s.pin: s.touch for s in axis.plant.switches}
    low, high = touch["el_minus"], touch["el_plus"] if runs >= 100 else touch["org"] + 0.05
    for _ in range(runs):
        stage.reset()
        stage.place(**{name: rng.uniform(low + 5e-4, high - 5e-4)})
        profile = firmware.Profile.of(
            fl=rng.uniform(600, 1800), fh1=rng.uniform(8000, 30_000), accel=rng.uniform(0.05, 0.2)
        )
        report = firmware.origin_return(axis, profile=profile, **options)
        assert report.stopped_by == ("EZ" if "ez" in options else "ORG")
        assert report.lost_steps == 0
        places.append(report.position / axis.meters_per_pulse)
    return np.array(places)


HUNDRED = [pytest.param(name, 100, marks=pytest.mark.slow) for name in "xyz"]


@pytest.mark.parametrize(("name", "runs"), [("x", 3), ("y", 2), ("z", 2), *HUNDRED])
def test_returns_from_random_places_end_within_one_pulse_of_each_other(stage, z_stage, name, runs):
    places = find_origins(z_stage if name == "z" else stage, name, runs)
    assert np.ptp(places) <= 2.0, "+-1 pulse about one place"
    print(f"{name}: spread {np.ptp(places):.2f} pulses over {runs} returns")


def test_without_the_slow_approach_the_spread_is_larger(stage):
    fast = find_origins(stage, "x", 3, slow_approach=False)
    slow = find_origins(stage, "x", 3)
    print(f"spread {np.ptp(fast):.2f} pulses without slow approach, {np.ptp(slow):.2f} with it")
    assert np.ptp(fast) > np.ptp(slow)
    assert np.ptp(fast) < 20


@pytest.mark.parametrize("place", [-0.1255, -0.1205, -0.1199, -0.1499, 0.0, 0.1499, -0.1501, 0.1501])
def test_an_origin_return_succeeds_from_any_start_on_or_between_the_switches(stage, place):
    stage.reset()
    stage.place(x=place)
    x = stage.axes["x"]
    report = firmware.origin_return(x)
    assert report.stopped_by == "ORG"
    assert report.position == pytest.approx(-0.120, abs=3 * x.meters_per_pulse)


def test_a_constant_speed_return_needs_no_sd(stage):
    stage.reset()
    stage.place(y=-0.06)
    report = firmware.origin_return(stage.axes["y"], high_speed=False)
    assert report.stopped_by == "ORG"
    assert not report.waveforms.pin("fup").any()


def test_a_constant_speed_return_writes_no_decelerating_stop(stage):
    stage.reset()
    stage.place(y={s.pin: s.touch for s in stage.axes["y"].plant.switches}["org"] - 1e-4)
    assert stage.axes["y"].switches.org
    profile = firmware.Profile.of(fl=4000, fh1=8000)
    report = firmware.origin_return(stage.axes["y"], profile=profile, high_speed=False, slow_approach=False)
    assert report.stopped_by == "ORG"
    assert not [code for _, code, _ in report.writes() if code in ("1D", "1F")]


def test_sd_slows_the_axis_to_fl_before_org_stops_it(stage):
    stage.reset()
    stage.place(x=-0.08)
    waveform = firmware.origin_return(stage.axes["x"]).waveforms
    org = np.flatnonzero(waveform.pin("org"))[0]
    sd = np.flatnonzero(waveform.pin("sd_minus"))[0]
    speed = waveform.edges["speed"]
    assert speed[sd] == speed.max()
    assert speed[org] == firmware.Profile.of().R1


def test_a_return_without_org_ends_at_the_limit_and_reports_it(stage):
    stage.reset()
    x = stage.axes["x"]
    stage.place(x=-0.10)
    x.switches.stick("org", False)
    try:
        report = firmware.origin_return(x)
    finally:
        x.switches.stick("org", None)
    assert report.stopped_by == "EL-"
    assert report.position == pytest.approx(-0.150, abs=1e-4)


@pytest.fixture(scope="module")
def stage_with_ez_chips():
    return Stage("xy", chips={"x": PCL240MS, "y": PCL240MK}, visuals=False)


@pytest.fixture(scope="module")
def z_stage_with_ez_chips():
    return Stage("xyz", chips=PCL240MS, visuals=False)


FAST = {"approach": 1600.0, "profile": firmware.Profile.of(fl=1800)}  # to an index pulse, which takes any speed


def find_index_positions(axis):
    """Joint positions of the first index pulses below ORG: their rims nearer to plus, m."""
    org = next(s.touch for s in axis.plant.switches if s.pin == "org")
    lead = 2 * np.pi / axis.gear
    first = org - (org / lead - axis.plant.index) % 1.0 * lead
    return [first - k * lead + 0.005 * lead for k in range(3)]


@pytest.mark.parametrize(("name", "ez"), [("x", 1), ("x", 2), ("y", 2), ("z", 3)])
def test_the_origin_return_ends_at_the_requested_index_pulse(stage_with_ez_chips, z_stage_with_ez_chips, name, ez):
    stage = z_stage_with_ez_chips if name == "z" else stage_with_ez_chips
    stage.reset()
    axis = stage.axes[name]
    stage.place(**{name: find_index_positions(axis)[0] + 0.03})
    report = firmware.origin_return(axis, ez=ez, **({} if ez == 1 else FAST))
    assert report.stopped_by == "EZ"
    stage.run(0.1)  # the carriage still swings by half a pulse when the report is made
    assert axis.position == pytest.approx(find_index_positions(axis)[ez - 1], abs=2 * axis.meters_per_pulse)
    assert ChipPort(axis).read_position() == 0, "the position counter starts at the origin"
    assert axis.chip.diagnostics == []


@pytest.mark.parametrize(("name", "runs"), [("x", 3), ("z", 2), *HUNDRED])
def test_returns_to_an_index_pulse_end_at_the_same_pulse(stage_with_ez_chips, z_stage_with_ez_chips, name, runs):
    places = find_origins(
        z_stage_with_ez_chips if name == "z" else stage_with_ez_chips, name, runs, ez=1 if runs < 100 else 2
    )
    print(f"{name}: spread {np.ptp(places):.2f} pulses over {runs} returns")
    assert np.ptp(places) <= 1.0


def test_a_switch_that_drifts_moves_the_origin_with_org_and_not_with_ez(stage_with_ez_chips):
    x, shift = stage_with_ez_chips.axes["x"], 0.0004
    beam = stage_with_ez_chips.model.geom("x_org_switch").pos
    ends = {}
    for ez in (None, 1):
        ends[ez] = []
        for direction in (0.0, shift, -shift):
            stage_with_ez_chips.reset()
            stage_with_ez_chips.place(x=-0.11)
            beam[0] += direction
            ends[ez].append(firmware.origin_return(x, ez=ez, **(FAST if ez else {})).position)
            beam[0] -= direction
    assert np.ptp(ends[None]) == pytest.approx(2 * shift, abs=1e-5)
    assert np.ptp(ends[1]) < x.meters_per_pulse


def test_a_fast_return_to_ez_slows_down_between_org_and_the_index(stage_with_ez_chips):
    stage_with_ez_chips.reset()
    x = stage_with_ez_chips.axes["x"]
    stage_with_ez_chips.place(x=-0.09)
    report = firmware.origin_return(x, ez=3, slow_approach=False)
    assert report.stopped_by == "EZ"
    assert report.position == pytest.approx(find_index_positions(x)[2], abs=10 * x.meters_per_pulse)


def test_a_return_without_an_index_pulse_ends_at_the_limit_and_reports_it(stage_with_ez_chips):
    stage_with_ez_chips.reset()
    stage_with_ez_chips.place(x=-0.11)
    report = firmware.origin_return(stage_with_ez_chips.axes["x"], ez=16, **FAST)
    assert report.stopped_by == "EL-"
    assert not report.ok


def test_an_index_pulse_number_that_the_chip_cannot_count_is_refused(stage, stage_with_ez_chips):
    with pytest.raises(ArgumentError, match=r"PCL240K does not count EZ: a PCL240MK or PCL240MS does"):
        firmware.origin_return(stage.axes["x"], ez=1)
    for ez in (0, 17, 1.5):
        with pytest.raises(ArgumentError, match="1st to 16th"):
            firmware.origin_return(stage_with_ez_chips.axes["x"], ez=ez)
