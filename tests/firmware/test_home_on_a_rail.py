"""firmware.home of chips without ORG input of their own, on a carriage that never slips: a failed search is never told as home."""

import pytest

from stage import Stage, faults, firmware
from stage.chips import MCX302, MCX304, MCX314AS
from stage.firmware import Bench

PASSES_INDEX = {"stop2": (-100, -90)}


@pytest.mark.parametrize(
    ("switches", "at", "ended", "place"),
    [
        ({"stop1": (None, 0)}, 500, "ORG", 0),
        ({"stop1": (None, 0), **PASSES_INDEX}, 500, "EZ", -90),
        ({"stop1": (None, 5000), "lmt_plus": (3000, None)}, 0, "EL+", 3000),  # ORG is stuck: there is no way out of it
        ({"stop1": (None, 0), "lmt_minus": (None, -5)}, 500, "EL-", -5),  # the limit before any index pulse
        ({"stop1": (None, 0), "stop2": (None, 10)}, 500, "HOME", 0),  # EZ is stuck: RR2 HOME
        ({"stop1": (None, 0), "lmt_minus": (None, 0)}, 500, "ORG", 0),  # ORG and EL- share an edge
        ({"stop1": (None, 0), "lmt_minus": (None, 0)}, -5, "ORG", 0),
        ({"stop1": (None, 0), "lmt_minus": (None, 10)}, 500, "EL-", 10),  # ORG begins behind the limit
    ],
)
@pytest.mark.parametrize("chip", [MCX302, MCX304])
def test_a_failed_home_search_reports_its_stop_reason(chip, switches, at, ended, place):
    """firmware.home(axis) with an ORG that is stuck said "ORG" at the end limit"""
    bench = Bench(chip())
    bench.add_rail("x", at=at, **switches)
    x = bench.axes["x"]
    report = firmware.home(x, index="stop2" in switches or switches.get("lmt_minus") == (None, -5))
    assert (report.stopped_by, x.rail_position, report.ok) == (ended, place, ended in ("ORG", "EZ"))


@pytest.mark.parametrize("chip", [MCX304, MCX314AS])
def test_an_endless_search_back_from_a_limit_stops_with_the_name_of_the_limit(chip):
    """The axis stands where ORG ends before the limit does: on its way out the chip sees no ORG any more."""
    bench = Bench(chip())
    bench.add_rail("x", at=0, stop1=(None, 0), lmt_minus=(None, 10))
    report = firmware.home(bench.axes["x"], timeout=5)
    assert (report.stopped_by, report.ok) == ("EL-", False)
    assert 0 < bench.axes["x"].rail_position <= 10
    assert not bench.axes["x"].chip.busy()


@pytest.mark.parametrize("chip", [MCX304, MCX314AS])
def test_a_contact_bounce_of_2_ms_moves_home_by_at_most_one_pulse(chip):
    """The search without its input filter took a bounce of the edge at which it had left ORG, 25 um away."""
    stage = Stage("xy", chips=chip, visuals=False)
    x, found = stage.axes["x"], []
    for broken in (False, True):
        stage.place(x=-0.119)
        if broken:
            faults.bounce(x, "org", 2e-3)
        assert firmware.home(x).stopped_by == "ORG"
        found.append(x.position)
    assert found[1] == pytest.approx(found[0], abs=4e-6)
