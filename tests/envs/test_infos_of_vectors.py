"""Infos of a vector in which one stage begins an episode while another continues."""

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage.envs.stage_env import _merge_info_columns, extract_info

SHORT = {
    "stage/RegisterTuning-v0": {"model": "xy", "moves": 2, "distances": (300, 900), "limit": 0.3, "settle": 0.01},
    "stage/FewShotTuning-v1": {"model": "xy", "tries": 2, "distances": (300, 900), "proofs": 0, "settle": 0.01},
    "stage/SynchronizedMove-v0": {"model": "xy", "moves": 2, "distances": (300, 900)},
}


@pytest.mark.parametrize("id_", SHORT)
def test_an_info_entry_of_both_reset_and_step_is_reported_for_both_stages(id_):
    kind = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "NextStep"}
    envs = gymnasium.make_vec(id_, 2, **kind, **SHORT[id_]).unwrapped
    actions = np.zeros(envs.action_space.shape, np.float32)
    envs.reset(seed=3)
    envs.step(actions)
    envs.reset(options={"reset_mask": np.array([True, False])})  # the first is a step behind from now on
    *_, finished, cut, _ = envs.step(actions)
    assert (finished | cut).tolist() == [False, True]
    *_, infos = envs.step(actions)
    continuing, begins = (extract_info(infos, k) for k in (0, 1))
    named = "distances" if "distances" in begins else "distance"
    assert np.array_equal(begins[named], envs._task.make_reset_info(1)[named])
    assert set(begins) == set(envs._task.make_reset_info(1)), "of a beginning what a reset tells, and no more"
    assert set(begins) < set(continuing)
    assert infos[f"_{named}"].tolist() == [True, True]
    assert infos["_cause"].tolist() == [True, False]


def test_info_columns_of_the_same_name_are_joined():
    second, others = np.array([False, True, False]), np.array([True, False, True])
    infos = {"a": np.array([0, 5, 0]), "_a": second, "b": np.array([0, 7, 0]), "_b": second}
    columns = {"a": np.array([3, 0, 4]), "_a": others.copy(), "c": np.array([1, 0, 2]), "_c": others}
    _merge_info_columns(infos, columns)
    assert {name: array.tolist() for name, array in infos.items()} == {
        "a": [3, 5, 4], "_a": [True] * 3, "b": [0, 7, 0], "_b": second.tolist(), "c": [1, 0, 2], "_c": others.tolist(),
    }  # fmt: skip
