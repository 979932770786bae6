"""The records of a step: rows as Python values, and columns in the form of Gymnasium's vectors."""

import copy
import pickle

import numpy as np
import pytest

from stage.envs.observation_features import HOST, Feature
from stage.envs.step_results import DIVERGENCE_REWARD, StepResults, make_step_result_dtype


@pytest.fixture
def results():
    kinds = {"duration": float, "finished": bool, "lost_steps": int, "registers": int}
    info = [Feature(name, HOST, "", kind=kind) for name, kind in kinds.items()]
    created = StepResults(3, make_step_result_dtype(("time", "lost"), info, {"registers": (2,)}))
    created["parts"]["time"], created["parts"]["lost"] = [-1.0, -2.0, np.nan], [0.0, -5.0, 0.0]
    created["info"]["registers"] = [[1, 2], [3, 4], [5, 6]]
    created["terminated"] = [False, True, True]
    created.compute_rewards(np.array([False, False, True]))
    return created


def test_a_row_holds_python_numbers_and_copied_arrays(results):
    reward, terminated, truncated, info = results.read_row(1)
    assert (reward, terminated, truncated) == (-7.0, True, False)
    assert [type(info[name]) for name in ("duration", "finished", "lost_steps")] == [float, bool, int]
    assert info["reward_parts"] == {"time": -2.0, "lost": -5.0}
    assert info["cause"] == ""
    results["info"]["registers"] = 0
    assert info["registers"].tolist() == [3, 4]


@pytest.mark.parametrize("make_copy", [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))])
def test_a_copy_has_equal_rows_and_separate_memory(results, make_copy):
    copied = make_copy(results)
    results["parts"]["time"] = results["reward"] = 0.0
    reward, *_, info = copied.read_row(1)
    assert (reward, info["reward_parts"]["time"]) == (-7.0, -2.0)


def test_a_diverged_stage_is_truncated_with_only_its_divergence_cost(results):
    reward, terminated, truncated, info = results.read_row(2)
    assert (reward, terminated, truncated) == (DIVERGENCE_REWARD, False, True)
    assert info["reward_parts"] == {"time": 0.0, "lost": 0.0, "diverged": DIVERGENCE_REWARD}
    assert info["cause"] == "diverged"


def test_result_columns_are_masked_by_the_stages_that_took_part(results):
    active = np.array([True, False, True])
    info = results.read_columns(active)
    assert info["registers"].tolist() == [[1, 2], [0, 0], [5, 6]]
    assert info["cause"].tolist() == ["", None, "diverged"]
    assert info["reward_parts"]["time"].tolist() == [-1.0, 0.0, 0.0]
    assert info["reward_parts"]["diverged"].tolist() == [0.0, 0.0, DIVERGENCE_REWARD]
    for values in (info, info["reward_parts"]):
        masks = [values[name] for name in values if name.startswith("_")]
        assert len(masks) * 2 == len(values)
        assert all(mask.tolist() == active.tolist() for mask in masks)
    assert "diverged" not in results.read_columns(np.array([True, True, False]))["reward_parts"]
