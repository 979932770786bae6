"""A snapshot is of the stage as whoever looks sees it: under power, and of one thread."""

import mujoco
import numpy as np
import pytest

from stage import Stage, StageError


@pytest.fixture
def xy():
    return Stage("xy", visuals=False)


def test_a_snapshot_of_a_stage_whose_data_were_cleared_is_of_power_up(xy):
    before = xy.snapshot().state
    xy.run(0.01)
    mujoco.mj_resetData(xy.model, xy.data)
    assert np.array_equal(xy.snapshot().state, before)


def test_a_snapshot_of_a_stage_that_another_runs_is_refused(xy):
    with xy.loop.claim(), pytest.raises(StageError, match="in use"):
        xy.snapshot()
    assert xy.snapshot().state is not None
