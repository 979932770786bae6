"""Scores at the end of an episode: the same names in every task, in one environment and in a vector."""

import gymnasium
import numpy as np
import pytest

import stage.envs
from stage.envs.step_results import SCORE

TASKS = {
    "stage/FewShotTuning-v1": {"model": "xy", "distances": (400, 900), "tries": 2, "proofs": 1, "settle": 0.01},
    "stage/OneShotTuning-v1": {"model": "xy", "distances": (400, 900), "proofs": 1, "settle": 0.01},
    "stage/SynchronizedLine-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "rest": 0.01, "limit": 0.5},
    "stage/DriftingHome-v1": {"model": "xy", "returns": 2, "limit": 0.1, "settle": 0.01},
    "stage/BusMacros-v1": {"model": "xy", "level": "move", "macros": 6},
}
"""The tasks of the benchmark with settings for short episodes."""


def test_the_tasks_tested_here_are_all_of_the_benchmark():
    assert set(TASKS) == {id_ for id_ in stage.envs.IDS if id_.endswith("-v1")}


@pytest.mark.parametrize("id_", TASKS)
def test_a_score_is_reported_only_at_the_end_with_the_same_names_in_every_task(id_):
    envs = gymnasium.make_vec(id_, num_envs=2, vectorization_mode="vector_entry_point", **TASKS[id_]).unwrapped
    envs.reset(seed=1)
    scores, steps = {}, 0
    while len(scores) < 2:
        steps += 1
        *_, terminated, truncated, info = envs.step(envs.scripted_action())
        over = terminated | truncated
        assert info.get("_score", np.zeros(2, bool)).tolist() == over.tolist()
        for k in np.flatnonzero(over):
            scores.setdefault(k, {name: info["score"][name][k] for name in SCORE.names} | {"steps": steps})
    env = gymnasium.make(id_, disable_env_checker=True, **TASKS[id_]).unwrapped
    env.reset(seed=1)
    over = False
    while not over:
        *_, finished, cut, info = env.step(env.scripted_action())
        over = finished or cut
        assert ("score" in info) == over
    assert info["score"] == {name: scores[0][name] for name in SCORE.names}
    assert {type(v) for v in info["score"].values()} == {bool, float, int}
    for score in scores.values():
        assert score["success"] == np.isfinite(score["time"]) == np.isfinite(score["regret"])
        assert score["moves"] >= 1
        assert score["lost_steps"] >= 0 <= score["limits"]
    assert scores[0]["moves"] == scores[0]["steps"]


def test_without_truth_an_info_contains_no_score():
    env = gymnasium.make(
        "stage/OneShotTuning-v1", disable_env_checker=True, truth=False, **TASKS["stage/OneShotTuning-v1"]
    )
    env.reset(seed=1)
    *_, terminated, _, info = env.step(env.unwrapped.scripted_action())
    assert terminated
    assert "score" not in info


@pytest.mark.usefixtures("elsewhere")
def test_a_diverged_episode_scores_no_success():
    env = gymnasium.make(
        "stage/OneShotTuning-v1", disable_env_checker=True, **TASKS["stage/OneShotTuning-v1"]
    ).unwrapped
    env.reset(seed=1)
    env.stage.data.qfrc_applied[:] = 1e30
    *_, info = env.step(env.scripted_action())
    assert info["cause"] == "diverged"
    assert (info["score"]["success"], info["score"]["time"], info["score"]["regret"]) == (False, np.inf, np.inf)
