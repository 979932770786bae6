"""One lost full step counts in either direction, and no state of an episode leaks into the next."""

import gymnasium
import numpy as np
import pytest

import stage.envs

LOSSES = {
    "stage/OriginReturn-v0": (
        {"model": "xy", "returns": 2, "limit": 0.05, "settle": 0.01, "lost_weight": 3.5},
        "lost",
        -3.5,
    ),
    "stage/SynchronizedMove-v0": (
        {"model": "xy", "distances": (300, 900), "moves": 2, "lost_weight": 3.5},
        "lost",
        -3.5,
    ),
    "stage/RegisterTuning-v0": (
        {"model": "xy", "distances": (300, 900), "limit": 0.3, "lost_weight": 3.5},
        "lost",
        -3.5,
    ),
    "stage/DriftingHome-v1": ({"model": "xy", "limit": 0.05, "damage_weight": 3.5}, "damage", -3.5),
    "stage/FewShotTuning-v1": (
        {"model": "xy", "distances": (300, 900), "proofs": 0, "damage_weight": 3.5},
        "damage",
        -3.5,
    ),
    "stage/SynchronizedLine-v1": (
        {"model": "xy", "distances": (300, 900), "proofs": 0, "damage_weight": 3.5},
        "damage",
        -3.5,
    ),
}


def make_env(id_, **settings):
    return gymnasium.make(id_, disable_env_checker=True, **settings).unwrapped


@pytest.mark.parametrize("id_", LOSSES)
@pytest.mark.parametrize("lost", [0, 1, -1])
def test_one_full_step_lost_in_either_direction_costs_as_losing_steps_does(id_, lost, monkeypatch):
    settings, part, costs = LOSSES[id_]
    assert id_ in stage.envs.IDS
    env = make_env(id_, **settings)
    env.reset(seed=3)
    task, real = env._task, env._task.fleet.truth
    axis = getattr(task, "axis", None) or task.axes[1]

    def truth():
        matches = real()
        matches["lost_steps"] = 0
        if played:
            matches["lost_steps"][:, axis.index] = lost
        return matches

    played, play = [], task.fleet.play
    monkeypatch.setattr(task.fleet, "play", lambda programs: (played.append(1), play(programs))[1])
    monkeypatch.setattr(task.fleet, "truth", truth)
    action = env.scripted_action() if id_.endswith("v1") else np.zeros(env.action_space.shape, np.float32)
    *_, info = env.step(action)
    assert info["reward_parts"][part] == (costs if lost else 0.0)
    assert np.abs(info["lost_steps"]).sum() == abs(lost)


SHORT = {
    "stage/RegisterTuning-v0": {"model": "xy", "moves": 3, "distances": (300, 900), "limit": 0.3, "settle": 0.01},
    "stage/RegisterBus-v0": {"model": "xy", "cycles": 8, "waits": (1e-3, 1e-2), "time_limit": 0.5, "truth": True},
    "stage/OriginReturn-v0": {"model": "xy", "returns": 3, "limit": 0.3, "settle": 0.01, "drift": 2e-4, "leave": 300},
    "stage/SynchronizedMove-v0": {"model": "xy", "distances": (300, 900), "moves": 3, "limit": 0.3},
    "stage/ServoTuning-v0": {"limit": 0.05, "rest": 0.01, "moves": 3},
    "stage/FewShotTuning-v1": {"model": "xy", "distances": (300, 900), "tries": 3, "proofs": 1, "settle": 0.01},
    "stage/OneShotTuning-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "settle": 0.01},
    "stage/SynchronizedLine-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "rest": 0.01, "limit": 0.5},
    "stage/DriftingHome-v1": {
        "model": "xy",
        "returns": 3,
        "limit": 0.3,
        "reach": 0.002,
        "settle": 0.01,
        "healthy": 1.0,
    },
    "stage/BusMacros-v1": {"model": "xy", "macros": 9},
}


def play_episode(env, seed, **options):
    """Play the first steps of an episode with the scripted host or the middle action; return the results."""
    text = [*env.reset(seed=seed, options=options)]
    for _ in range(3):
        try:
            action = env.scripted_action()
        except stage.ArgumentError:
            action = np.zeros(env.action_space.shape, env.action_space.dtype)
        out = env.step(action)
        text += out
        if out[2] or out[3]:
            break
    return repr([part.tolist() if isinstance(part, np.ndarray) else part for part in text])


@pytest.mark.parametrize("id_", SHORT)
def test_no_state_of_an_episode_leaks_into_the_next(id_):
    """The records of a task are filled with arbitrary values before an episode begins."""
    assert set(SHORT) == set(stage.envs.IDS)
    env, fresh = make_env(id_, **SHORT[id_]), make_env(id_, **SHORT[id_])
    options = {"start": 5e-4} if id_ in ("stage/OriginReturn-v0", "stage/DriftingHome-v1") else {}
    env.reset(seed=9)
    task = env._task
    for name in ("steps", *task.STATE):
        array = getattr(task, name)
        for part in array.dtype.names or [...]:
            array[part] = {"b": True, "f": 3.25}.get(array[part].dtype.kind, -5)
    task.results.rows[:] = np.zeros((), task.results.rows.dtype)
    task.results["cause"] = 1
    assert play_episode(env, 4, **options) == play_episode(fresh, 4, **options)


def test_the_spread_of_returns_is_of_one_episode_and_none_after_its_first():
    env = make_env("stage/OriginReturn-v0", model="xy", returns=2, drift=4e-4)
    start = env._task.origin + 2e-3
    spreads = []
    for seed, returns in ((1, 2), (2, 1)):
        env.reset(seed=seed, options={"start": start})
        for k in range(returns):
            if k:
                env._task._draw_move(0, {"start": start})
            usual = {"R1": 50, "R2": 800, "R4": 983, "approach": 20, "leave": 0, "back_off": 200, "sd": 1}
            *_, info = env.step(env.register_box.to_action(usual))
            assert info["home"]
            spreads.append(info["spread"])
    assert spreads[0] == spreads[2] == 0
    assert spreads[1] > 0


@pytest.mark.parametrize(
    ("id_", "name", "same"),
    [
        ("stage/BusMacros-v1", "axes", (("y", "x"), ["y", "x"], "yx")),
        ("stage/BusMacros-v1", "grid", ((16, 64), [16, 64], [16.0, 64.0], np.array([16, 64]))),
        ("stage/SynchronizedMove-v0", "axes", (("y", "x"), ["y", "x"], "yx")),
        ("stage/SynchronizedLine-v1", "axes", (("y", "x"), ["y", "x"], "yx")),
    ],
)
def test_a_list_or_letters_are_the_same_setting_and_snapshots_of_both_are_each_other_s(id_, name, same):
    envs = [make_env(id_, model="xy", **{name: value}) for value in same]
    envs[0].reset(seed=1)
    saved = envs[0].snapshot()
    for env in envs:
        assert getattr(env.config, name) == same[0]
        assert all(type(part) is type(same[0][0]) for part in getattr(env.config, name))
        env.restore(saved)


@pytest.mark.parametrize("rate", [3333.0, 4500.0, 7777.7])
def test_a_rate_that_is_fixed_is_that_rate_to_the_last_bit(rate):
    env = make_env("stage/SynchronizedMove-v0", model="xy", distances=(300, 900), rate=rate)
    for seed in range(3):
        assert env.reset(seed=seed)[1]["rate"] == rate


def test_a_fault_reported_before_any_return_takes_the_time_of_the_formula():
    env = make_env("stage/DriftingHome-v1", model="xy", returns=3, limit=0.1)
    for seed, start in ((1, 0.02), (2, 0.05)):
        env.reset(seed=seed, options={"fault": "jam", "start": start})
        task = env._task
        _, _, terminated, _, info = env.step(np.ones(6, np.float32))
        score = info["score"]
        assert terminated
        assert (score["success"], score["regret"], score["moves"]) == (True, 0.0, 1)
        distance = abs(start - task.origin) / task.per_pulse
        assert score["time"] == pytest.approx(distance / 8000 + 0.1 + 200 * (1 / 1000 + 1 / 400) + 3 * 0.05)
