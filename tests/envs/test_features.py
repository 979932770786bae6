"""Every entry of infos and observations is declared as host or truth, and truth is left out on request."""

from importlib import import_module
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import stage.envs
from stage import ArgumentError
from stage.envs import observation_features
from stage.envs.stage_env import extract_info

SHORT = {
    "stage/RegisterTuning-v0": {"model": "xy", "moves": 1, "distances": (300, 900), "limit": 0.3, "settle": 0.01},
    "stage/RegisterBus-v0": {"model": "xy", "cycles": 1, "chip": "MCX514", "split": "train"},
    "stage/OriginReturn-v0": {"model": "xy", "returns": 1, "limit": 0.02, "settle": 0.01},
    "stage/SynchronizedMove-v0": {"model": "xy", "distances": (300, 900), "limit": 0.3},
    "stage/ServoTuning-v0": {"limit": 0.05, "rest": 0.01, "moves": 1},
    "stage/FewShotTuning-v1": {"model": "xy", "distances": (300, 900), "tries": 1, "proofs": 1, "settle": 0.01},
    "stage/OneShotTuning-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "settle": 0.01},
    "stage/SynchronizedLine-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "rest": 0.01, "limit": 0.5},
    "stage/DriftingHome-v1": {"model": "xy", "returns": 1, "limit": 0.1, "settle": 0.01},
    "stage/BusMacros-v1": {"model": "xy", "macros": 1},
}
ALL_IDS = list(stage.envs.IDS)


def make_env(id_, **settings):
    return gymnasium.make(id_, disable_env_checker=True, **SHORT[id_] | settings).unwrapped


def list_reported_names(env):
    """Return the observations and the names of the infos of a reset and a step."""
    first, info = env.reset(seed=4)
    env.action_space.seed(4)
    then, *_, after = env.step(env.action_space.sample())
    return np.array([first, then]), {*info, *after}


def get_environment_class(id_):
    module, name = stage.envs.IDS[id_].split(":")
    return getattr(import_module(f"stage.envs.{module}"), name)


@pytest.mark.parametrize("id_", ALL_IDS)
def test_observations_and_infos_match_the_declared_table_with_and_without_truth(id_):
    task, observed, names = get_environment_class(id_), {}, {}
    for truth in (True, "info", False):
        env = make_env(id_, truth=truth)
        observed[truth], names[truth] = list_reported_names(env)
        assert len(env.observation_features) == env.observation_space.shape[0] == observed[truth].shape[1]
    every = {e.name: e.who for e in (*task.INFO, *observation_features.EVERY_STEP_FEATURES)}
    assert names[True] == names["info"] == set(every)
    assert names[False] == {name for name, who in every.items() if who == observation_features.HOST}
    full = make_env(id_, truth=True)
    host = [e.who == observation_features.HOST for e in full.observation_features]
    assert not all(host)
    assert not any(e.who == observation_features.TRUTH for e in make_env(id_, truth=False).observation_features)
    assert np.array_equal(observed[True][:, host], observed[False])
    assert np.array_equal(observed["info"], observed[False])


@pytest.mark.parametrize("id_", ALL_IDS[:2])
def test_a_vector_without_truth_reports_the_same_entries_as_one_environment(id_):
    envs = gymnasium.make_vec(id_, num_envs=2, vectorization_mode="vector_entry_point", truth=False, **SHORT[id_])
    env = make_env(id_, truth=False)
    observed, infos = envs.reset(seed=4)
    first, info = env.reset(seed=4)
    assert np.array_equal(observed[0], first)
    assert extract_info(infos, 0).keys() == info.keys()
    envs.action_space.seed(4)
    actions = envs.action_space.sample()
    (*_, infos), (*_, info) = envs.step(actions), env.step(actions[0])
    assert extract_info(infos, 0).keys() == info.keys()
    assert "reward_parts" not in infos


@pytest.mark.parametrize("id_", ["stage/RegisterTuning-v0", "stage/OriginReturn-v0"])
def test_two_loads_that_a_host_cannot_distinguish_are_reported_alike(id_):
    """The chip emits the same pulses in the same time in a gentle move with 0 and with 8 kg."""
    text = {}
    for truth in (True, False):
        for payload in (0.0, 8.0):
            settings = {"limit": 2.0, "distances": (800, 900)} if "Tuning" in id_ else {}
            env = make_env(id_, truth=truth, **settings)
            out = [env.reset(seed=1, options={"payload": payload})]
            if "Tuning" in id_:
                rates = {"R1": 50, "R2": 80, "R4": 900, "R5": 900, "R6": 50, "R7": 30}
                out.append(env.step(env._task.registers.to_action(rates)))
                assert out[-1][-1]["finished"]
            text[truth, payload] = repr([(o[0].tolist(), o[-1]) for o in out])
    assert text[False, 0.0] == text[False, 8.0]
    assert text[True, 0.0] != text[True, 8.0]


def test_a_host_with_an_encoder_observes_integer_counts():
    env = make_env("stage/ServoTuning-v0", limit=0.2)
    env.reset(seed=2)
    info = env.step(env._task.registers.to_action({"R22": 64, "R20": 229, "R21": 64, "R0F": 64}))[4]
    assert [info[name] % 1 for name in ("overshoot", "unrest", "error")] == [0, 0, 0]


def test_each_chip_and_axis_has_its_entries_in_the_observation():
    env = make_env("stage/RegisterBus-v0", model="xyz", chip="MCX302", truth=True, split=None)
    names = [e.name for e in env.observation_features]
    axis = ["target", "place", "velocity", "lost", "error"]
    chip = ["status"] * 16 + ["words"] * 7 + ["ages"] * 8
    assert names == [*chip, *axis, *axis, *chip, *axis, "value", "was_read", "time", "actions"]
    line = [e.name for e in make_env("stage/SynchronizedMove-v0").observation_features]
    assert line[:7] == ["rate", "distance", "ahead", "more_ahead", "earlier", "shorter", "distance"]


def test_the_truth_setting_accepts_three_values():
    for wrong in ("all", 1, None, [True]):
        with pytest.raises(ArgumentError, match=r"truth=.*True .* 'info' .* or False"):
            make_env("stage/RegisterTuning-v0", truth=wrong)


def test_the_documented_table_matches_the_declared_entries():
    saved = (Path(__file__).parents[2] / "docs" / "envs_features.md").read_text()
    assert saved == observation_features.format_features_page(), (
        "python -m stage.envs.observation_features > docs/envs_features.md"
    )
