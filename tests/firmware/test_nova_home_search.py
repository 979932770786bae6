"""The automatic home search of an MCX514 with the switches of the stage."""

import pytest
from support.covers import covers

from stage import ArgumentError, RunTimeout, Stage
from stage.chips import MCX304, MCX514
from stage.firmware.nova.home_search import home_search

EDGE = 6e-6  # m: home is so near the edge of ORG, two pulses
PULSE = 3.125e-6


def make_stage(model="xy", **places):
    stage = Stage(model, chips=MCX514, visuals=False)
    stage.place(**places)
    return stage


def find_switch_edge(axis, pin="org"):
    return next(s.touch for s in axis.plant.switches if s.pin == pin)


@covers("MCX514", "H1M", "H2M", "HV", "HMSRC", "R2CLR", "RR3P0")
@pytest.mark.parametrize("offset", [0.009, 0.0003, -0.0002, -0.0015], ids=["before", "just before", "on", "beyond"])
@pytest.mark.parametrize("name", ["x", "y", "z"])
def test_home_is_at_the_edge_of_org_from_any_start(name, offset):
    stage = make_stage("xyz" if name == "z" else "xy")
    axis = stage.axes[name]
    stage.place(**{name: find_switch_edge(axis) + offset})
    report = home_search(axis)[name]
    assert report.ok
    assert report.position == pytest.approx(find_switch_edge(axis), abs=EDGE)
    assert report.position == axis.position
    assert axis.switches.org
    assert axis.lost_steps == 0
    assert stage.chips[0].values()["RR0"] == 0
    states = [state for _, state in report.states]
    expected = {3, 6} if offset > 0.0001 else {15}
    assert expected <= set(states)
    assert states[-2:] == [20, 0]
    assert not stage.chips[0].diagnostics


def test_an_axis_on_its_end_limit_backs_out_and_finds_home():
    """Half a millimetre beyond ORG, the limit ahead of it: the search begins by backing out."""
    stage = make_stage()
    x = stage.axes["x"]
    stage.place(x=find_switch_edge(x, "el_minus") - 1e-4)
    assert x.switches.el_minus
    report = home_search(x, home_speed=4_000)["x"]
    assert report.ok
    assert report.position == pytest.approx(find_switch_edge(x), abs=60e-6), "HV is ten times as high"


def test_one_command_homes_all_axes_at_the_same_time():
    stage = make_stage("xyz", x=-0.1, y=-0.066, z=-0.0142)
    reports = home_search(*stage.axes.values())
    for name, report in reports.items():
        assert report.ok
        assert report.position == pytest.approx(find_switch_edge(stage.axes[name]), abs=EDGE)
    assert stage.time < 1.05 * max(r.seconds for r in reports.values())
    assert "home found" in str(reports["x"])
    assert "step 2: waits for the signal" in str(reports["x"])


def test_home_is_the_same_pulse_from_any_start():
    places = []
    for direction in (0.004, 0.0052, -0.0004, 0.0111):
        stage = make_stage()
        stage.place(x=find_switch_edge(stage.axes["x"]) + direction)
        places.append(home_search(stage.axes["x"])["x"].position)
    assert max(places) - min(places) < 1.5 * PULSE


@pytest.mark.parametrize("pulses", [800, -300])
def test_the_search_moves_by_the_offset_and_clears_the_counters(pulses):
    stage = make_stage(x=-0.115)
    x = stage.axes["x"]
    report = home_search(x, offset=pulses)["x"]
    assert report.ok
    assert 36 in [state for _, state in report.states]
    stage.run(0.1)
    assert x.position == pytest.approx(find_switch_edge(x) + pulses * PULSE, abs=2 * EDGE)
    chip = stage.chips[0]
    chip.write(0, 0x130)
    assert chip.read(6) == chip.read(7) == 0


def test_the_search_ends_at_an_index_pulse_after_org():
    stage = make_stage(x=-0.115)
    x = stage.axes["x"]
    report = home_search(x, index=True)["x"]
    assert report.ok
    assert 28 in [state for _, state in report.states]
    assert x.pins.stop2
    assert find_switch_edge(x) - 3200 * PULSE < report.position < find_switch_edge(x)


def test_a_switch_that_never_trips_is_an_error_and_no_home():
    stage = make_stage("xyz")
    z = stage.axes["z"]
    stage.place(z=find_switch_edge(z) + 0.001)
    z.switches.stick("org", False)
    stage.step(2)
    report = home_search(z, home_speed=8_000)["z"]
    assert not report.ok
    assert report.errors == ("HLMT+",)
    assert [state for _, state in report.states][-2:] == [11, 0], "back from the limit ahead, up to the other one"
    assert "NOT found" in str(report)


def test_invalid_arguments_and_chips_without_a_home_search_are_refused():
    stage = make_stage()
    x = stage.axes["x"]
    for invalid, message in (({"direction": 0}, "-1 or 1"), ({"timer": 0.05}, "one of"), ({"speed": 0}, "DV")):
        with pytest.raises(ArgumentError, match=message):
            home_search(x, **invalid)
    with pytest.raises(ArgumentError, match="one MCX514"):
        home_search()
    with pytest.raises(ArgumentError, match="no MCX514"):
        home_search(Stage("xyz", chips=MCX304, visuals=False).axes["x"])


def test_a_search_beyond_its_timeout_is_stopped_with_an_error():
    stage = make_stage()
    with pytest.raises(RunTimeout, match="still searched home"):
        home_search(stage.axes["x"], timeout=0.05)
    assert not stage.chips[0].busy(0)
