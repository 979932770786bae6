"""Tests of every environment: the rules of Gymnasium, equal episodes for equal seeds, vectors equal to their parts."""

import copy
import gc
import pickle
import warnings
from itertools import cycle, product

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from support.examples import FIXED

import stage.envs
from stage import ArgumentError

ALL_IDS = list(stage.envs.IDS)
OTHER_CHIPS = [
    "stage/RegisterTuning-v0 MCX304", "stage/RegisterBus-v0 MCX514", "stage/OriginReturn-v0 MCX514",
    "stage/SynchronizedMove-v0 MCX514", "stage/SynchronizedMove-v0 MCX302",
]  # fmt: skip
"""Chip families other than the default: an id and a chip."""
BRIEF = ["stage/RegisterBus-v0", "stage/OriginReturn-v0"]
"""The ids of the everyday suite where many share a property; `make test-slow` takes all."""
SETTINGS = {
    "stage/RegisterTuning-v0": {"model": "xy", "moves": 2, "distances": (400, 1600), "limit": 0.5, "settle": 0.01},
    "stage/RegisterBus-v0": {"model": "xy", "cycles": 4, "bus_cycle": 1e-3, "waits": (1e-3, 1e-2)},
    "stage/OriginReturn-v0": {"model": "xy", "returns": 2, "limit": 0.1, "settle": 0.01},
    "stage/SynchronizedMove-v0": {"model": "xy", "distances": (1000, 2000)},
    "stage/ServoTuning-v0": {"distances": (100, 400), "limit": 0.2, "rest": 0.02},
    "stage/FewShotTuning-v1": {"model": "xy", "distances": (400, 900), "tries": 2, "proofs": 2, "settle": 0.01},
    "stage/OneShotTuning-v1": {"model": "xy", "distances": (400, 900), "proofs": 2, "settle": 0.01},
    "stage/SynchronizedLine-v1": {"model": "xy", "distances": (300, 900), "proofs": 1, "rest": 0.01, "limit": 0.5},
    "stage/DriftingHome-v1": {"model": "xy", "returns": 2, "limit": 0.1, "settle": 0.01},
    "stage/BusMacros-v1": {"model": "xy", "macros": 3, "settle": 0.001, "bus_cycle": 1e-3},
}
"""Settings that make an episode short."""
ONE_STEP = ("stage/OneShotTuning-v1", "stage/SynchronizedLine-v1")
"""Environments whose episodes always have one step."""

pytestmark = pytest.mark.filterwarnings("error")


def mark_slow_unless_brief(every, brief):
    """Return the parameters, with those not in `brief` marked slow."""
    return [id_ if id_ in brief else pytest.param(id_, marks=pytest.mark.slow) for id_ in every]


@pytest.fixture(params=mark_slow_unless_brief(ALL_IDS, BRIEF), ids=lambda id_: id_.split("/")[1])
def id_(request):
    return request.param


@pytest.fixture(
    params=mark_slow_unless_brief([*ALL_IDS, *OTHER_CHIPS], [*BRIEF, OTHER_CHIPS[0]]), ids=lambda id_: id_.split("/")[1]
)
def any_(request):
    """An environment id, or an id and a chip."""
    return request.param


def _settings(id_, settings):
    name, _, chip = id_.partition(" ")
    return name, SETTINGS.get(name, {}) | ({"chip": chip} if chip else {}) | settings


def make_env(id_, **settings):
    name, settings = _settings(id_, settings)
    return gymnasium.make(name, disable_env_checker=True, **settings).unwrapped


def make_vec(id_, n, **settings):
    name, settings = _settings(id_, settings)
    return gymnasium.make_vec(name, num_envs=n, vectorization_mode="vector_entry_point", **settings)


def play_episode(env, seed, actions=6):
    """Play `actions` actions from a reset, across episode ends, and return every result."""
    text = [env.reset(seed=seed)]
    env.action_space.seed(seed)
    for _ in range(actions):
        out = env.step(env.action_space.sample())
        text.append(out)
        if out[2] or out[3]:
            text.append(env.reset())
    return text


def choose_timed_action(any_, action):
    """Return an action that takes time: macro 0 for BusMacros, no report for DriftingHome, else the given action."""
    if any_ == "stage/BusMacros-v1":
        return np.zeros_like(action)
    if any_ == "stage/DriftingHome-v1":
        action[..., 5] = -1.0
    return action


def is_identical(a, b):
    """Return whether two nested values are equal to the bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(is_identical(a[k], b[k]) for k in a)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(is_identical, a, b))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    return type(a) is type(b) and a == b


@pytest.mark.parametrize(
    "any_", mark_slow_unless_brief([*ALL_IDS, *OTHER_CHIPS], ALL_IDS), ids=lambda id_: id_.split("/")[1]
)
def test_the_environment_checker_of_gymnasium_passes(any_):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make_env(any_), skip_render_check=True)


def test_the_environment_checker_of_stable_baselines3_passes(id_):
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="extra rl is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(make_env(id_), skip_render_check=True)


def test_equal_seeds_give_equal_episodes(any_):
    one, other = make_env(any_), make_env(any_)
    first = play_episode(one, 7)
    assert is_identical(first, play_episode(other, 7))
    assert is_identical(first, play_episode(one, 7)), "and again, after another episode, of which nothing is left"
    assert not is_identical(first, play_episode(other, 8))


def test_a_pickled_environment_continues_as_the_first(any_):
    env = make_env(any_)
    env.reset(seed=3)
    env.action_space.seed(3)
    env.step(env.action_space.sample())
    replica = pickle.loads(pickle.dumps(env))
    for _ in range(2):
        action = env.action_space.sample()
        if env._over:
            assert is_identical(env.reset(), replica.reset())
        assert is_identical(env.step(action), replica.step(action))


BRIEFLY = [  # every chip in every mode on every number of threads: `make test-slow`
    *(pytest.param(id_, mode, 2) for id_ in BRIEF for mode in AutoresetMode),
    *(
        pytest.param(id_, AutoresetMode.NEXT_STEP, threads)
        for id_, threads in zip(ALL_IDS, cycle((1, 2)), strict=False)
    ),
    *(pytest.param(id_, AutoresetMode.SAME_STEP, 2) for id_ in OTHER_CHIPS[1:3]),
]
LONG = [
    pytest.param(*case, marks=pytest.mark.slow)
    for case in product([*ALL_IDS, *OTHER_CHIPS], AutoresetMode, (1, 2))
    if case not in [brief.values for brief in BRIEFLY]
]


@pytest.mark.parametrize(("any_", "mode", "threads"), [*BRIEFLY, *LONG])
def test_a_vector_gives_the_same_bits_as_single_environments(any_, mode, threads):
    n, steps = 2 if FIXED else 3, 5
    vector, parts = make_vec(any_, n, threads=threads, autoreset_mode=mode), [make_env(any_) for _ in range(n)]
    observed, infos = vector.reset(seed=11)
    for k, env in enumerate(parts):
        observation, info = env.reset(seed=11 + k)
        assert is_identical(observed[k], observation)
        assert is_identical(stage.envs.stage_env.extract_info(infos, k), info)
    vector.action_space.seed(11)
    over = np.zeros(n, bool)
    for _ in range(steps):
        if mode == AutoresetMode.DISABLED and over.any():
            observed, _ = vector.reset(options={"reset_mask": over})
            for k in np.flatnonzero(over):
                assert is_identical(observed[k], parts[k].reset()[0])
            over[:] = False
        actions = vector.action_space.sample()
        observed, rewards, terminated, truncated, infos = vector.step(actions)
        assert observed.dtype == vector.observation_space.dtype
        for k, env in enumerate(parts):
            if over[k] and mode == AutoresetMode.NEXT_STEP:
                expected = *env.reset(), 0.0
                got = observed[k], stage.envs.stage_env.extract_info(infos, k), float(rewards[k])
            else:
                observation, reward, finished, cut, info = env.step(actions[k])
                assert (finished, cut) == (terminated[k], truncated[k])
                if mode == AutoresetMode.SAME_STEP and (finished or cut):
                    assert is_identical(infos["final_obs"][k], observation)
                    assert is_identical(stage.envs.stage_env.extract_info(infos["final_info"], k), info)
                    observation, info = env.reset()
                    got = stage.envs.stage_env.extract_info({n: v for n, v in infos.items() if "final" not in n}, k)
                else:
                    got = stage.envs.stage_env.extract_info(infos, k)
                expected = observation, info, reward
                got = observed[k], got, float(rewards[k])
            assert is_identical(got, expected), (k, got, expected)
        over = (terminated | truncated) & (mode != AutoresetMode.SAME_STEP)


def test_each_environment_of_a_vector_accepts_a_seed():
    vector, one = make_vec("stage/OriginReturn-v0", 2), make_env("stage/OriginReturn-v0")
    observed, _ = vector.reset(seed=[5, 3])
    for row, seed in zip(observed, (5, 3), strict=True):
        assert is_identical(row, one.reset(seed=seed)[0])
    for seeds in ([5], [1, 2, 3]):
        with pytest.raises(
            ArgumentError, match=f"{len(seeds)} seeds for 2 environments: one each, one for all, or None"
        ):
            vector.reset(seed=seeds)


def test_a_new_episode_in_a_vector_reports_its_reset_info_while_others_continue(id_):
    if id_ in ONE_STEP:
        pytest.skip("episodes of one step all end together")
    longer = {"moves": 3} if id_ == "stage/SynchronizedMove-v0" else {}
    vector = make_vec(id_, 2, **longer)
    vector.reset(seed=13)
    vector.action_space.seed(13)
    over = np.zeros(2, bool)
    vector.step(choose_timed_action(id_, vector.action_space.sample()))
    vector.reset(options={"reset_mask": np.array([True, False])})
    while over.tolist() != [False, True]:
        assert not over[0], "the first began later"
        _, _, terminated, truncated, _ = vector.step(choose_timed_action(id_, vector.action_space.sample()))
        over = terminated | truncated
    infos = vector.step(choose_timed_action(id_, vector.action_space.sample()))[4]
    assert is_identical(stage.envs.stage_env.extract_info(infos, 1), vector.unwrapped._task.make_reset_info(1))
    assert "reward_parts" in stage.envs.stage_env.extract_info(infos, 0)


def test_invalid_actions_are_refused_with_their_value(id_):
    env = make_env(id_)
    env.reset(seed=1)
    space = env.action_space
    good = space.sample()
    for bad in (
        None,
        "x",
        [],
        np.zeros(99),
        good.astype(complex),
        np.full(space.shape, np.nan),
        np.full(space.shape, 1e12),
    ):
        with pytest.raises(ArgumentError, match=r"is not in (Box|MultiDiscrete|Discrete)"):
            env.step(bad)
    vector = make_vec(id_, 2)
    vector.reset(seed=1)
    with pytest.raises(ArgumentError, match="is not in"):
        vector.step(good)


def test_a_refused_action_changes_nothing(any_):
    env, other = make_env(any_), make_env(any_)
    for e in (env, other):
        e.reset(seed=5)
    action = env.action_space.sample()
    with pytest.raises(ArgumentError, match="is not in"):
        env.step(np.full_like(action, 120) if action.dtype.kind == "f" else np.full_like(action, 1 << 40))
    assert is_identical(env.step(action), other.step(action))


def test_the_values_that_a_step_returned_do_not_change_later(id_):
    env, vector = make_env(id_), make_vec(id_, 2)
    for e in (env, vector):
        e.reset(seed=6)
        e.action_space.seed(6)
        text = e.step(e.action_space.sample())
        saved = copy.deepcopy(text)
        if np.any(text[2] | text[3]):
            e.reset()
        e.step(e.action_space.sample())
        assert is_identical(list(text), list(saved))


def test_a_step_after_the_end_requests_a_reset(id_):
    env = make_env(id_)
    with pytest.raises(ArgumentError, match="call reset"):
        env.step(env.action_space.sample())


def test_unknown_settings_and_options_are_named_in_the_error(id_):
    with pytest.raises(ArgumentError, match="setting 'colour'"):
        make_env(id_, colour="red")
    with pytest.raises(ArgumentError, match="reset option 'colour'"):
        make_env(id_).reset(options={"colour": "red"})
    with pytest.raises(ArgumentError, match="reset option 'colour'"):
        make_vec(id_, 2).reset(options={"colour": "red"})
    with pytest.raises(ArgumentError, match="render mode 'ansi'"), pytest.warns(UserWarning, match="render_mode"):
        make_env(id_, render_mode="ansi")
    for mask in ([True, False], np.zeros(2, bool), np.ones(3, bool), np.ones(2)):
        with pytest.raises(ArgumentError, match="reset_mask"):
            make_vec(id_, 2).reset(options={"reset_mask": mask})


def test_an_unknown_setting_raises_a_type_error_that_lists_all_settings(id_):
    for maker, custom in ((make_env, "render_every"), (lambda id_, **s: make_vec(id_, 2, **s), "threads")):
        with pytest.raises(TypeError, match=r"unexpected keyword argument 'colour': .* Known: ") as results:
            maker(id_, colour="red")
        assert isinstance(results.value, ArgumentError)
        assert custom in str(results.value)
    gc.collect()  # Gymnasium closes a vector that was never made: an error in that would be a warning here


def test_invalid_options_and_seeds_are_refused_with_an_explanation(id_):
    env, vector = make_env(id_), make_vec(id_, 2)
    for e, maximum in ((env, "None, or a dict with any of: "), (vector, "reset_mask")):
        for options in (3, "x", [1]):
            with pytest.raises(ArgumentError, match="options=") as results:
                e.reset(options=options)
            assert maximum in str(results.value)
    for seed in (1.5, "ab", [1.0, 2], {1: 2}):
        with pytest.raises(
            ArgumentError, match=r"seed=.*: a whole number, None, or one of them for each environment\."
        ):
            vector.reset(seed=seed)
    assert is_identical(vector.reset(seed=np.array([5, 6]))[0], vector.reset(seed=np.int64(5))[0])


@pytest.mark.usefixtures("elsewhere")
def test_a_diverging_stage_ends_only_the_episode_of_its_environment(any_):
    vector, calm = make_vec(any_, 3), make_vec(any_, 3)
    observed, _ = vector.reset(seed=5)
    calm.reset(seed=5)
    vector.stages[1].data.qfrc_applied[:] = 1e30
    vector.action_space.seed(5)
    actions = choose_timed_action(any_, vector.action_space.sample())
    for _ in range(3):
        last = observed[1].copy()
        observed, rewards, terminated, truncated, infos = vector.step(actions)
        expected = calm.step(actions)
        if truncated[1]:
            break
    assert truncated[1]
    assert infos["cause"][1] == "diverged"
    assert infos["reward_parts"]["diverged"][1] == rewards[1] == stage.envs.stage_env.DIVERGENCE_REWARD
    assert is_identical(observed[1], last), "nothing of it is observed"
    assert np.isfinite(observed).all()
    for k in (0, 2):
        assert is_identical(observed[k], expected[0][k])
        assert rewards[k] == expected[1][k]
    assert infos["cause"][0] == ""
    finished = terminated | truncated
    vector.stages[1].data.qfrc_applied[:] = 0.0
    again, *_, infos = vector.step(actions)
    assert np.isfinite(again).all(), "it starts anew"
    assert is_identical(stage.envs.stage_env.extract_info(infos, 1), vector.unwrapped._task.make_reset_info(1))
    assert vector.stages[1].time == 0, "and waits for its first action"
    if not finished[0]:  # else it begins anew, too
        assert stage.envs.stage_env.extract_info(infos, 0)["cause"] == ""


@pytest.mark.usefixtures("elsewhere")
def test_after_an_episode_that_diverged_a_reset_observes_the_new_one(any_):
    env, fresh = make_env(any_), make_env(any_)
    env.reset(seed=1)
    env.stage.data.qfrc_applied[:] = 1e30
    env.action_space.seed(1)
    action = choose_timed_action(any_, env.action_space.sample())
    for _ in range(3):
        *_, truncated, info = env.step(action)
        if truncated:
            break
    assert info["cause"] == "diverged"
    env.stage.data.qfrc_applied[:] = 0.0
    assert is_identical(env.reset(seed=2), fresh.reset(seed=2))


def test_the_parts_of_the_reward_add_up_to_the_reward(any_):
    env = make_env(any_)
    for step in play_episode(env, 21)[1:]:
        if len(step) == 5:
            assert sum(step[4]["reward_parts"].values()) == pytest.approx(step[1], abs=1e-12)


def test_closing_writes_the_recording_of_an_episode_that_continues(tmp_path):
    env = make_env("stage/RegisterBus-v0", record=str(tmp_path / "{}.rrd"))
    env.reset(seed=1)
    env.step(env.action_space.sample())
    assert not list(tmp_path.iterdir())
    env.close()
    assert [file.name for file in tmp_path.iterdir()] == ["0.rrd"]


@pytest.mark.parametrize(
    "any_", mark_slow_unless_brief([*ALL_IDS, OTHER_CHIPS[0]], BRIEF[1:]), ids=lambda id_: id_.split("/")[1]
)
def test_an_episode_can_be_recorded(any_, tmp_path):
    env, basic = make_env(any_, record=str(tmp_path / "run" / "{}.rrd")), make_env(any_)
    assert is_identical(play_episode(env, 2, 3), play_episode(basic, 2, 3)), "a recording changes nothing"
    env.close()
    files = sorted((tmp_path / "run").iterdir())
    assert files[0].name == "0.rrd"
    assert all(f.stat().st_size > 1000 for f in files)


def test_unsupported_vector_settings_and_calls_are_explained():
    bus = "stage/RegisterBus-v0"
    for n in (0, -1, 1.5):
        with pytest.raises(ArgumentError, match=f"num_envs={n}: a whole number, 1 or more"):
            stage.envs.stage_env.StageVectorEnv(n)
    with pytest.raises(ArgumentError, match="does not render"):
        stage.envs.stage_env.StageVectorEnv(1, render_mode="rgb_array")
    vector = make_vec(bus, 2, cycles=1, autoreset_mode=AutoresetMode.DISABLED)
    for seeds in ([1], [1, 2, 3]):
        with pytest.raises(ArgumentError, match=f"{len(seeds)} seeds for 2 environments"):
            vector.reset(seed=seeds)
    vector.action_space.seed(1)
    action = vector.action_space.sample()
    with pytest.raises(ArgumentError, match="the episode of environment 0 is over: reset it first"):
        vector.step(action)
    vector.reset(seed=[4, None])
    assert vector.step(action)[3].all()
    vector.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ArgumentError, match="the episode of environment 1 is over"):
        vector.step(action)


def test_a_vector_continues_its_random_numbers_unless_it_is_seeded_again():
    bus = "stage/RegisterBus-v0"
    vector, parts = make_vec(bus, 2), [make_env(bus) for _ in range(2)]
    firsts = []
    for seed, seeds in ((None, (None, None)), (3, (3, 4)), (None, (None, None)), ([None, 9], (None, 9))):
        observed, _ = vector.reset(seed=seed)
        if seed is not None or firsts:
            for k, env in enumerate(parts):
                assert is_identical(env.reset(seed=seeds[k])[0], observed[k]), (seed, k)
            firsts.append(observed)
    assert not is_identical(firsts[0], firsts[1])
    vector.reset(seed=3)
    masked, _ = vector.reset(seed=5, options={"reset_mask": np.array([False, True])})
    assert is_identical(masked[0], firsts[0][0]), "the other stays as it was"
    assert is_identical(masked[1], parts[1].reset(seed=6)[0])


def test_recordings_are_numbered_by_episode(tmp_path):
    env = make_env("stage/RegisterBus-v0", record=str(tmp_path / "a" / "{}-{}.rrd"))
    for seed in range(3):
        env.reset(seed=seed)
        env.step(env.action_space.sample())
    assert sorted(file.name for file in (tmp_path / "a").iterdir()) == ["0-0.rrd", "1-1.rrd"]
    env.close()
    env.close()
    assert sorted(file.name for file in (tmp_path / "a").iterdir()) == ["0-0.rrd", "1-1.rrd", "2-2.rrd"]
