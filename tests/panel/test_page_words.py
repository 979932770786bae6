"""What a page writes and draws, without a browser."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage.panel.session import FREE

pytest.importorskip("nicegui")
from stage.panel import oscilloscope_page as chart
from stage.panel import page as transport


@pytest.mark.parametrize(
    ("paused", "speed", "pace", "says"),
    [
        (True, 1.0, 0.0, "stands still"), (False, 1.0, 0.96, "0.96 x"), (False, 1.0, 0.94, "0.94 x, cannot keep up"),
        (False, 2.0, 1.0, "1.00 x, cannot keep up"), (False, FREE, 0.5, "0.50 x"),
    ],
)  # fmt: skip
def test_a_stage_cannot_keep_up_where_it_lags_by_more_than_a_twentieth(paused, speed, pace, says):
    session = SimpleNamespace(paused=paused, speed=speed, view=SimpleNamespace(achieved_speed=pace))
    assert transport._pace(session) == says


def test_a_curve_is_sent_with_both_ends_of_what_is_level_and_six_digits():
    needed = chart._corners(np.array([0, 0, 0, 5, 5, 5, 2, 2.0]))
    assert np.flatnonzero(needed).tolist() == [0, 2, 3, 5, 6, 7]
    assert chart._significant(np.array([123_456.789, -0.04]), 9).tolist() == [123_457.0, 0.0]
    assert chart._significant(np.array([0.00123456789, 0.0]), 9).tolist() == [0.00123457, 0.0]
    assert chart._significant(np.zeros(2), 9).tolist() == [0.0, 0.0]


def test_a_carriage_that_rests_is_a_level_line_whatever_the_arithmetic_leaves(sampler):
    rests = {name: t for name, t in sampler.traces.items() if not t.pin}
    drawn = {name: chart._significant(np.array([-3e-10, 2e-10]), t.places).tolist() for name, t in rests.items()}
    assert set(map(str, drawn.values())) == {"[0.0, 0.0]"}
    micron = chart._significant(np.array([40.0, 40.001]), rests["x/position"].places)
    assert np.diff(micron) == pytest.approx(0.001)
