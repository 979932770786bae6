"""Numbers and words of the page: texts of forms become SI units, and what a page writes and draws."""

from math import radians
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("nicegui")
from stage import Stage
from stage.panel import oscilloscope_page as chart
from stage.panel.fault_controls import compute_user_push_limit
from stage.panel.page import Toolbar, format_readout
from stage.panel.session import UNPACED_SPEED
from stage.panel.stage_thread import describe_escape


@pytest.mark.parametrize(
    ("paused", "speed", "pace", "says"),
    [
        (True, 1.0, 0.0, "stands still"), (False, 1.0, 0.96, "0.96 x"), (False, 1.0, 0.94, "0.94 x, cannot keep up"),
        (False, 2.0, 1.0, "1.00 x, cannot keep up"), (False, UNPACED_SPEED, 0.5, "0.50 x"),
    ],
)  # fmt: skip
def test_a_stage_cannot_keep_up_where_it_lags_by_more_than_a_twentieth(paused, speed, pace, says):
    session = SimpleNamespace(paused=paused, speed=speed, view=SimpleNamespace(achieved_speed=pace))
    assert Toolbar._describe_pace(SimpleNamespace(_session=session)) == says


def test_a_curve_is_sent_with_both_ends_of_what_is_level_and_six_digits():
    needed = chart._mark_needed_points(np.array([0, 0, 0, 5, 5, 5, 2, 2.0]))
    assert np.flatnonzero(needed).tolist() == [0, 2, 3, 5, 6, 7]
    assert chart._round_to_significant_digits(np.array([123_456.789, -0.04]), 9).tolist() == [123_457.0, 0.0]
    assert chart._round_to_significant_digits(np.array([0.00123456789, 0.0]), 9).tolist() == [0.00123457, 0.0]
    assert chart._round_to_significant_digits(np.zeros(2), 9).tolist() == [0.0, 0.0]


def test_a_carriage_that_rests_is_a_level_line_whatever_the_arithmetic_leaves(sampler):
    rests = {name: t for name, t in sampler.traces.items() if not t.pin}
    drawn = {
        name: chart._round_to_significant_digits(np.array([-3e-10, 2e-10]), t.places).tolist()
        for name, t in rests.items()
    }
    assert set(map(str, drawn.values())) == {"[0.0, 0.0]"}
    micron = chart._round_to_significant_digits(np.array([40.0, 40.001]), rests["x/position"].places)
    assert np.diff(micron) == pytest.approx(0.001)


def test_a_position_is_shown_in_the_unit_of_its_axis():
    assert format_readout("m", 0.0123456, 0.0125, -4) == ("12.3456 mm", "12.5000 mm", "0.1544 mm", "-4")
    rotated = format_readout("rad", radians(-30), radians(-30.5), 0)
    assert rotated == ("-30.0000 deg", "-30.5000 deg", "-0.5000 deg", "0")


def test_a_carriage_is_out_of_its_travel_beyond_a_tenth_of_it_on_either_side():
    stage = Stage("xya", visuals=False)
    for name in ("x", "y"):
        axis = stage.axes[name]
        low, high = axis.travel
        for at, out in (
            (low - 0.099 * (high - low), False), (low - 0.101 * (high - low), True),
            (high + 0.099 * (high - low), False), (high + 0.101 * (high - low), True), (0.0, False),
        ):  # fmt: skip
            stage.data.qpos[axis.plant.qpos] = at
            assert bool(describe_escape(stage)) == out
            assert describe_escape(stage).startswith(f"{name} is out of its travel") == out
    stage.data.qpos[stage.axes["a"].plant.qpos] = 1e3
    assert describe_escape(stage) == "", "a table turns without end"
    x = stage.axes["x"]
    assert compute_user_push_limit(x) == pytest.approx(2 * x.drive.peak_torque * abs(x.gear))
    assert np.isfinite(compute_user_push_limit(x))
