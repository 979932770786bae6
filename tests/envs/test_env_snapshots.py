"""Snapshots of environments: an episode continues from one to the bit, in any environment and any number of times."""

import pickle

import gymnasium
import numpy as np
import pytest

import stage.envs
from stage import ArgumentError, StageError

SHORT = {
    "stage/RegisterTuning-v0": {"model": "xy", "moves": 3, "distances": (300, 900), "limit": 0.3, "settle": 0.01},
    "stage/RegisterBus-v0": {"model": "xy", "cycles": 8, "waits": (1e-3, 1e-2), "time_limit": 0.5, "truth": True},
    "stage/OriginReturn-v0": {"model": "xy", "returns": 3, "limit": 0.1, "settle": 0.01, "drift": 2e-4},
    "stage/SynchronizedMove-v0": {"model": "xy", "distances": (300, 900), "moves": 3, "limit": 0.3},
    "stage/ServoTuning-v0": {"limit": 0.05, "rest": 0.01, "moves": 3},
    "stage/FewShotTuning-v1": {"model": "xy", "distances": (300, 900), "tries": 3, "proofs": 1, "settle": 0.01},
    "stage/OneShotTuning-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "settle": 0.01},
    "stage/SynchronizedLine-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "rest": 0.01, "limit": 0.5},
    "stage/DriftingHome-v1": {"model": "xy", "returns": 3, "limit": 0.1, "settle": 0.01},
    "stage/BusMacros-v1": {"model": "xy", "macros": 3},
}

BRIEF = (
    "stage/RegisterBus-v0",
    "stage/OriginReturn-v0",
    "stage/FewShotTuning-v1",
    "stage/BusMacros-v1",
    "stage/DriftingHome-v1",
)
"""The cases of the everyday suite: bus cycles, an equipped machine, several attempts, macros, a fault."""


def make_env(id_, **settings):
    return gymnasium.make(id_, disable_env_checker=True, **SHORT[id_] | settings).unwrapped


def make_vector(id_, n, **settings):
    return gymnasium.make_vec(
        id_, num_envs=n, vectorization_mode="vector_entry_point", **SHORT[id_] | settings
    ).unwrapped


def to_comparable(text):
    """Convert the results of an environment to values that compare by ==."""
    if isinstance(text, dict):
        return {k: to_comparable(v) for k, v in text.items()}
    if isinstance(text, tuple | list):
        return [to_comparable(v) for v in text]
    return (text.dtype.str, text.tolist()) if isinstance(text, np.ndarray) else text


def play_episode(env, actions):
    """Play the actions, across the end of an episode and the draws of the next, and return all results."""
    text = []
    for action in actions:
        if env._over:
            text.append(to_comparable(env.reset()))
        text.append(to_comparable(env.step(action)))
    return text


@pytest.mark.parametrize("id_", [*BRIEF, *(pytest.param(k, marks=pytest.mark.slow) for k in SHORT if k not in BRIEF)])
def test_an_episode_continues_from_a_snapshot_to_the_bit(id_):
    assert set(SHORT) == set(stage.envs.IDS)
    env, other = make_env(id_), make_env(id_)
    env.reset(seed=5)
    env.action_space.seed(5)
    actions = [env.action_space.sample() for _ in range(4)]
    env.step(actions[0])
    saved = env.snapshot()
    expected = play_episode(env, actions[1:])
    env.step(actions[0]) if not env._over else env.reset(seed=99)
    env.restore(saved)
    assert play_episode(env, actions[1:]) == expected, "in the environment itself, which has gone elsewhere"
    other.restore(pickle.loads(pickle.dumps(saved)))
    assert play_episode(other, actions[1:]) == expected, "in another, which was never reset"
    assert other.np_random_seed == env.np_random_seed


@pytest.mark.parametrize("id_", ["stage/RegisterBus-v0", "stage/RegisterTuning-v0"])
def test_a_vector_continues_from_a_snapshot_to_the_bit(id_):
    envs, other = make_vector(id_, 2), make_vector(id_, 2, threads=1)
    envs.reset(seed=5)
    envs.action_space.seed(5)
    actions = [envs.action_space.sample() for _ in range(3)]
    envs.step(actions[0])
    saved = envs.snapshot()
    expected = [to_comparable(envs.step(a)) for a in actions[1:]]
    other.restore(saved)
    assert [to_comparable(other.step(a)) for a in actions[1:]] == expected


def read_task_state(task):
    """Return the state that a task has of its stages."""
    return {
        name: value.copy()
        for name, value in vars(task).items()
        if isinstance(value, np.ndarray) and value.shape[:1] == (task.n,) and not name.startswith("_")
    }


@pytest.mark.parametrize("id_", SHORT)
def test_a_snapshot_contains_everything_that_a_reset_draws_or_clears(id_):
    env = make_env(id_)
    env.reset(seed=5)
    env.action_space.seed(5)
    env.step(env.action_space.sample())
    saved, before, result = env.snapshot(), read_task_state(env._task), env._task.results.rows.tobytes()
    env.reset(seed=6)
    env._task.results.rows[:] = np.zeros((), env._task.results.rows.dtype)
    changed = [name for name, value in read_task_state(env._task).items() if value.tobytes() != before[name].tobytes()]
    assert "observations" in changed
    env.restore(saved)
    again = read_task_state(env._task)
    assert env._task.results.rows.tobytes() == result
    assert [name for name in changed if again[name].tobytes() != before[name].tobytes()] == []


def test_a_vector_that_continues_from_a_snapshot_draws_its_next_episodes_from_it_too():
    id_ = "stage/FewShotTuning-v1"
    first = make_vector(id_, 2)
    first.reset(seed=5)
    saved, drawn_next = first.snapshot(), []
    for _ in range(2):
        other = make_vector(id_, 2)
        other.restore(saved)
        drawn_next.append(to_comparable(other.reset()))
    assert drawn_next[0] == drawn_next[1] == to_comparable(first.reset())


def test_a_search_that_restores_snapshots_gets_the_predicted_reward():
    """The search of the documentation tries each candidate from the same snapshot and then plays the best."""
    env, plainly = make_env("stage/RegisterTuning-v0"), make_env("stage/RegisterTuning-v0")
    for e in (env, plainly):
        e.reset(seed=8)
    env.action_space.seed(8)
    candidates, saved, foreseen = [env.action_space.sample() for _ in range(3)], env.snapshot(), []
    for action in candidates:
        env.restore(saved)
        foreseen.append(env.step(action)[1])
    env.restore(saved)
    best = candidates[int(np.argmax(foreseen))]
    assert to_comparable(env.step(best)) == to_comparable(plainly.step(best))
    assert env.step(best)[1] != max(foreseen), "the next move is another"


def test_a_vector_gives_no_snapshot_before_each_of_its_stages_has_an_episode():
    envs = make_vector("stage/RegisterTuning-v0", 2)
    envs.reset(seed=1, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ArgumentError, match=r"no episode .*call reset\(\) first"):
        envs.snapshot()
    envs.reset(options={"reset_mask": np.array([False, True])})
    envs.restore(envs.snapshot())


def test_a_snapshot_of_another_environment_is_refused_and_changes_nothing(tmp_path):
    id_ = "stage/RegisterBus-v0"
    env = make_env(id_)
    with pytest.raises(ArgumentError, match=r"no episode .*call reset\(\) first"):
        env.snapshot()
    env.reset(seed=1)
    saved = env.snapshot()
    with pytest.raises(ArgumentError, match=r"another's: setting lost_weight: 0\.05 there, 0\.5 here"):
        make_env(id_, lost_weight=0.5).restore(saved)
    with pytest.raises(ArgumentError, match="another's: environment: RegisterBus there, RegisterTuning here"):
        make_env("stage/RegisterTuning-v0").restore(saved)
    with pytest.raises(ArgumentError, match="another's: stages: 1 there, 2 here"):
        make_vector(id_, 2).restore(saved)
    with pytest.raises(ArgumentError, match="snapshot of a stage cannot be restored into an environment"):
        env.restore(env.stage.snapshot())
    damaged = env.snapshot()
    object.__setattr__(damaged, "state", damaged.state[:-1] + b"\x00")
    with pytest.raises(ArgumentError, match="damaged"):
        env.restore(damaged)
    recorded = make_env(id_, record=str(tmp_path / "{}.rrd"))
    recorded.reset(seed=1)
    with pytest.raises(StageError, match="without record="):
        recorded.restore(recorded.snapshot())
    with pytest.raises(ArgumentError, match="call reset"):
        make_vector(id_, 2).snapshot()
