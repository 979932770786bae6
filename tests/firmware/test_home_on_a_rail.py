"""firmware.home of chips without ORG input of their own, on a carriage that never slips: a failed search is never told as home."""

import pytest

from stage import firmware
from stage.chips import MCX302, MCX304
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
    ],
)
@pytest.mark.parametrize("chip", [MCX302, MCX304])
def test_a_home_search_that_failed_says_what_ended_it(chip, switches, at, ended, place):
    """firmware.home(axis) with an ORG that is stuck said "ORG" at the end limit"""
    bench = Bench(chip())
    bench.rail("x", at=at, **switches)
    x = bench.axes["x"]
    report = firmware.home(x, index=ended not in ("ORG", "EL+"))
    assert (report.stopped_by, x.place, report.ok) == (ended, place, ended in ("ORG", "EZ"))
