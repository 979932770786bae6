"""Snapshots of environments: an episode goes on from one to the bit, here or in another, as often as wanted."""

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
"""Those of every day: bus cycles, an equipped machine, several tries, macros, a fault."""


def make(id_, **settings):
    return gymnasium.make(id_, disable_env_checker=True, **SHORT[id_] | settings).unwrapped


def vector(id_, n, **settings):
    return gymnasium.make_vec(
        id_, num_envs=n, vectorization_mode="vector_entry_point", **SHORT[id_] | settings
    ).unwrapped


def basic(text):
    """All that an environment says, as what compares by ==."""
    if isinstance(text, dict):
        return {k: basic(v) for k, v in text.items()}
    if isinstance(text, tuple | list):
        return [basic(v) for v in text]
    return (text.dtype.str, text.tolist()) if isinstance(text, np.ndarray) else text


def play_episode(env, actions):
    """What so many steps say, over the end of an episode and the next one's draws."""
    text = []
    for action in actions:
        if env._over:
            text.append(basic(env.reset()))
        text.append(basic(env.step(action)))
    return text


@pytest.mark.parametrize("id_", [*BRIEF, *(pytest.param(k, marks=pytest.mark.slow) for k in SHORT if k not in BRIEF)])
def test_an_episode_continues_from_a_snapshot_to_the_bit(id_):
    assert set(SHORT) == set(stage.envs.IDS)
    env, other = make(id_), make(id_)
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
    envs, other = vector(id_, 2), vector(id_, 2, threads=1)
    envs.reset(seed=5)
    envs.action_space.seed(5)
    actions = [envs.action_space.sample() for _ in range(3)]
    envs.step(actions[0])
    saved = envs.snapshot()
    expected = [basic(envs.step(a)) for a in actions[1:]]
    other.restore(saved)
    assert [basic(other.step(a)) for a in actions[1:]] == expected


def drawn(task):
    """Return the state that a task has of its stages."""
    return {
        name: value.copy()
        for name, value in vars(task).items()
        if isinstance(value, np.ndarray) and value.shape[:1] == (task.n,) and not name.startswith("_")
    }


@pytest.mark.parametrize("id_", SHORT)
def test_what_a_reset_draws_or_clears_is_saved_by_a_snapshot(id_):
    env = make(id_)
    env.reset(seed=5)
    env.action_space.seed(5)
    env.step(env.action_space.sample())
    saved, before, result = env.snapshot(), drawn(env._task), env._task.results.rows.tobytes()
    env.reset(seed=6)
    env._task.results.rows[:] = np.zeros((), env._task.results.rows.dtype)
    changed = [name for name, value in drawn(env._task).items() if value.tobytes() != before[name].tobytes()]
    assert "observations" in changed
    env.restore(saved)
    again = drawn(env._task)
    assert env._task.results.rows.tobytes() == result
    assert [name for name in changed if again[name].tobytes() != before[name].tobytes()] == []


def test_a_vector_that_continues_from_a_snapshot_draws_its_next_episodes_from_it_too():
    id_ = "stage/FewShotTuning-v1"
    first = vector(id_, 2)
    first.reset(seed=5)
    saved, drawn_next = first.snapshot(), []
    for _ in range(2):
        other = vector(id_, 2)
        other.restore(saved)
        drawn_next.append(basic(other.reset()))
    assert drawn_next[0] == drawn_next[1] == basic(first.reset())


def test_a_search_plans_ahead_and_then_acts_as_if_it_had_not():
    """The use on the page: each candidate from the same moment, then the best of them, with the reward that was foreseen."""
    env, plainly = make("stage/RegisterTuning-v0"), make("stage/RegisterTuning-v0")
    for e in (env, plainly):
        e.reset(seed=8)
    env.action_space.seed(8)
    candidates, saved, foreseen = [env.action_space.sample() for _ in range(3)], env.snapshot(), []
    for action in candidates:
        env.restore(saved)
        foreseen.append(env.step(action)[1])
    env.restore(saved)
    best = candidates[int(np.argmax(foreseen))]
    assert basic(env.step(best)) == basic(plainly.step(best))
    assert env.step(best)[1] != max(foreseen), "the next move is another"


def test_a_vector_gives_no_snapshot_before_each_of_its_stages_has_an_episode():
    envs = vector("stage/RegisterTuning-v0", 2)
    envs.reset(seed=1, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ArgumentError, match=r"no episode .*call reset\(\) first"):
        envs.snapshot()
    envs.reset(options={"reset_mask": np.array([False, True])})
    envs.restore(envs.snapshot())


def test_a_snapshot_that_does_not_belong_here_is_refused_and_changes_nothing(tmp_path):
    id_ = "stage/RegisterBus-v0"
    env = make(id_)
    with pytest.raises(ArgumentError, match=r"no episode .*call reset\(\) first"):
        env.snapshot()
    env.reset(seed=1)
    saved = env.snapshot()
    with pytest.raises(ArgumentError, match=r"another's: setting lost_weight: 0\.05 there, 0\.5 here"):
        make(id_, lost_weight=0.5).restore(saved)
    with pytest.raises(ArgumentError, match="another's: environment: RegisterBus there, RegisterTuning here"):
        make("stage/RegisterTuning-v0").restore(saved)
    with pytest.raises(ArgumentError, match="another's: stages: 1 there, 2 here"):
        vector(id_, 2).restore(saved)
    with pytest.raises(ArgumentError, match="snapshot of a stage cannot be restored into an environment"):
        env.restore(env.stage.snapshot())
    damaged = env.snapshot()
    object.__setattr__(damaged, "state", damaged.state[:-1] + b"\x00")
    with pytest.raises(ArgumentError, match="damaged"):
        env.restore(damaged)
    recorded = make(id_, record=str(tmp_path / "{}.rrd"))
    recorded.reset(seed=1)
    with pytest.raises(StageError, match="without record="):
        recorded.restore(recorded.snapshot())
    with pytest.raises(ArgumentError, match="call reset"):
        vector(id_, 2).snapshot()
