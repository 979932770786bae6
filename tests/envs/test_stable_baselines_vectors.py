"""Tests of the vector for Stable-Baselines3 on a stand-in of its base class, so that they run without SB3."""

import copy
import importlib
import sys
from types import ModuleType

import gymnasium
import numpy as np
import pytest

import stage.envs
from stage import ArgumentError
from stage.envs.stage_env import StageVectorEnv

ID = "stage/RegisterTuning-v0"
SHORT = {"model": "xy", "moves": 2, "distances": (300, 900), "limit": 0.3, "settle": 0.01}
FEW = {"model": "xy", "distances": (300, 900), "tries": 1, "proofs": 0, "settle": 0.01}


class VecEnv:
    """A stand-in of stable_baselines3's VecEnv with what its subclasses need."""

    def __init__(self, num_envs, observation_space, action_space):
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self.reset_infos = [{} for _ in range(num_envs)]
        self._reset_seeds()
        self._reset_options()

    def _reset_seeds(self):
        self._seeds = [None] * self.num_envs

    def _reset_options(self):
        self._options = [{} for _ in range(self.num_envs)]

    def seed(self, seed):
        self._seeds = [seed + k for k in range(self.num_envs)]

    def set_options(self, options):
        self._options = copy.deepcopy(options if isinstance(options, list) else [options] * self.num_envs)

    def step(self, actions):
        self.step_async(actions)
        return self.step_wait()

    def _get_indices(self, indices):
        return range(self.num_envs) if indices is None else [indices] if isinstance(indices, int) else indices


@pytest.fixture
def sb3(monkeypatch):
    """The module `stable_baselines` loaded on the stand-in."""
    present = ModuleType("stable_baselines3.common.vec_env")
    present.VecEnv = VecEnv
    for name in ("stable_baselines3", "stable_baselines3.common"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, present.__name__, present)
    monkeypatch.setitem(sys.modules, "stage.envs.sb3", None)
    monkeypatch.delitem(sys.modules, "stage.envs.sb3")
    monkeypatch.delattr(stage.envs, "sb3", raising=False)
    return importlib.import_module("stage.envs.sb3")


def test_the_stand_in_has_the_attributes_of_the_class_of_stable_baselines():
    real = pytest.importorskip("stable_baselines3.common.vec_env", reason="extra rl is not installed")
    attributes = real.VecEnv.__init__.__code__.co_names
    assert {"_seeds", "_options"} <= set(attributes)
    assert set(vars(VecEnv(1, None, None))) <= {*attributes, "reset_infos"}


def make_single(seed, id_=ID, options=None, **settings):
    env = gymnasium.make(id_, disable_env_checker=True, **settings or SHORT).unwrapped
    return env, *env.reset(seed=seed, options=options)


def to_comparable(info):
    return {k: to_comparable(v) if isinstance(v, dict) else np.asarray(v).tolist() for k, v in info.items()}


def test_a_stable_baselines_vector_equals_single_environments_across_an_episode_end(sb3):
    envs = sb3.StageVecEnv(ID, 3, **SHORT)
    envs.seed(5)
    observed = envs.reset()
    ones = [make_single(5 + k) for k in range(3)]
    assert (observed == [one[1] for one in ones]).all()
    assert [to_comparable(info) for info in envs.reset_infos] == [to_comparable(one[2]) for one in ones]
    assert envs._seeds == [None] * 3, "a seed is for one reset"
    rng = np.random.default_rng(2)
    for step in (1, 2, 3):
        actions = rng.uniform(-1, 1, (3, *envs.action_space.shape)).astype(np.float32)
        observed, rewards, ends, infos = envs.step(actions)
        text = [one[0].step(action) for one, action in zip(ones, actions, strict=True)]
        assert rewards.dtype == np.float32
        assert rewards.tolist() == [np.float32(out[1]) for out in text]
        assert ends.tolist() == [step == 2] * 3
        for k, (info, out) in enumerate(zip(infos, text, strict=True)):
            last = info.pop("terminal_observation", None)
            assert info.pop("TimeLimit.truncated") is (step == 2), "the moves are up, and the task is not done"
            assert to_comparable(info) == to_comparable(out[4])
            if step == 2:
                assert (last == out[0]).all()
                started, reported = ones[k][0].reset()
                assert (observed[k] == started).all()
                assert to_comparable(envs.reset_infos[k]) == to_comparable(reported)
            else:
                assert last is None
                assert (observed[k] == out[0]).all()
    envs.close()


def test_a_terminated_episode_is_no_time_limit_to_stable_baselines(sb3):
    envs = sb3.StageVecEnv("stage/FewShotTuning-v1", 2, **FEW)
    envs.seed(1)
    envs.reset()
    *_, ends, infos = envs.step(np.zeros((2, 4), np.float32))
    assert ends.tolist() == [True, True]
    assert [info["TimeLimit.truncated"] for info in infos] == [False, False]
    assert all("score" in info and "final_info" not in info for info in infos)


def test_options_of_stable_baselines_are_for_each_environment_and_for_one_reset(sb3):
    envs = sb3.StageVecEnv(ID, 3, **SHORT)
    envs.seed(7)
    envs.set_options([{"distance": 400}, {"payload": 2.5}, {}])
    observed = envs.reset()
    ones = [make_single(7 + k, options=o) for k, o in enumerate(({"distance": 400}, {"payload": 2.5}, {}))]
    assert (observed == [one[1] for one in ones]).all()
    assert [to_comparable(info) for info in envs.reset_infos] == [to_comparable(one[2]) for one in ones]
    assert not any(envs._options)
    envs.reset()
    assert [info["distance"] for info in envs.reset_infos] == [one[0].reset()[1]["distance"] for one in ones]


def test_stable_baselines_gets_attributes_of_the_selected_environments(sb3):
    envs = sb3.StageVecEnv("stage/FewShotTuning-v1", 3, 1, **FEW)
    envs.seed(3)
    envs.reset()
    assert envs.get_attr("stage") == envs.envs.stages
    assert envs.get_attr("stage", [2, 0]) == [envs.envs.stages[2], envs.envs.stages[0]]
    assert envs.get_attr("action_space", 1) == [envs.envs.single_action_space]
    assert envs.get_attr("observation_space") == [envs.envs.single_observation_space] * 3
    assert envs.get_attr("num_envs", [0]) == [3]
    rows = envs.envs.scripted_action()
    assert np.array_equal(envs.env_method("scripted_action", indices=[2, 1]), rows[[2, 1]])
    assert np.array_equal(envs.env_method("scripted_action"), rows)
    assert envs.env_is_wrapped(object, indices=[0, 1]) == [False, False]
    assert (envs.num_envs, envs.action_space) == (3, envs.envs.single_action_space)
    assert envs.envs._task.fleet.threads == 1
    for method in ("action_masks", "reset", "close"):
        with pytest.raises(ArgumentError, match=f"env_method\\('{method}'\\).*no methods of their own"):
            envs.env_method(method)
    with pytest.raises(ArgumentError, match="set_attr\\('config'\\)"):
        envs.set_attr("config", 1)


def test_masks_are_rows_to_stable_baselines(sb3):
    envs = sb3.StageVecEnv("stage/BusMacros-v1", 2, model="xy", macros=3, level="move")
    envs.seed(3)
    envs.reset()
    assert np.array_equal(envs.env_method("action_masks"), envs.envs.action_masks())


@pytest.mark.parametrize(
    ("id_", "settings", "says"),
    [
        (ID, {"autoreset_mode": "NextStep"}, "autoreset_mode: SB3 wants"),
        ("stage/Nothing-v0", {}, "unknown environment 'stage/Nothing-v0'"),
        (ID, {**SHORT, "actions": "registers"}, "counts choices from 0.*use actions='box'"),
    ],
)
def test_settings_unsupported_by_stable_baselines_are_refused(sb3, id_, settings, says):
    with pytest.raises(ArgumentError, match=says):
        sb3.StageVecEnv(id_, 2, **settings)


def test_a_vector_of_another_package_is_refused(sb3, monkeypatch):
    def make_vec(id_, num_envs, **settings):
        created.append((id_, num_envs, settings))
        return gymnasium.vector.VectorEnv()

    created = []
    monkeypatch.setattr(gymnasium, "make_vec", make_vec)
    with pytest.raises(ArgumentError, match=r"'CartPole-v1' is no vector of stages\. Known: stage/RegisterTuning-v0"):
        sb3.StageVecEnv("CartPole-v1", 2, 4)
    kind = {"vectorization_mode": "vector_entry_point", "autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}
    assert created == [("CartPole-v1", 2, {"threads": 4, **kind})]


def test_closing_for_stable_baselines_closes_the_vector(sb3, monkeypatch):
    closed = []
    envs = sb3.StageVecEnv(ID, **SHORT)
    assert envs.num_envs == 1
    # what a lambda keeps alive would be closed by it as it goes, which ends the process: so no environment, its id
    monkeypatch.setattr(StageVectorEnv, "close", lambda self: closed.append(id(self)))
    envs.close()
    assert closed == [id(envs.envs)]


def test_actions_may_be_of_another_space_for_stable_baselines(sb3):
    vector = gymnasium.make_vec(ID, 1, vectorization_mode="vector_entry_point", **SHORT).unwrapped
    other = gymnasium.spaces.Discrete(3)
    assert sb3.VecEnvAdapter(vector, other).action_space is other
    assert sb3.VecEnvAdapter(vector).action_space is vector.single_action_space
