"""BusMacros: each action is a macro of bus cycles, masked where it has no effect; levels go up to two axes."""

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError
from stage.envs.bus_macros import LEVELS, MAX_PULSES_BEFORE_ORIGIN, Config
from stage.sim import program_player

FULL = 120 * 0.01 + 30.0 * 0.05
"""The cost that an episode can still incur at its begin."""


def make_env(**settings):
    return gymnasium.make("stage/BusMacros-v1", disable_env_checker=True, **{"model": "xy"} | settings).unwrapped


@pytest.fixture(scope="module")
def env():
    return make_env()


def play_macros(env, *names):
    """Play the named macros and return the result of each step."""
    return [env.step(env.macros.index(name)) for name in names]


def judge_other_truth(monkeypatch, task, change_truth):
    """Let the steps of a task of one stage be judged by the true states that `change_truth` has changed."""

    def run_step():
        task.CORE.play_actions.c(task._address, 0, 1)
        program_player.inspect_axes(task.fleet.handles, 0, 1, task._truth)
        change_truth(task._truth)
        task.CORE.judge_steps.c(task._address, 0, 1, 0)
        return False

    monkeypatch.setattr(task, "run_step", run_step)


def play_episode(env, policy, **reset):
    """Play an episode and return the sum of rewards, the number of steps and the last info."""
    total, steps, over = 0.0, 0, False
    env.reset(**{"seed": 1} | reset)
    while not over:
        _, reward, finished, cut, info = env.step(policy())
        total, steps, over = total + reward, steps + 1, finished or cut
    return total, steps, info


@pytest.mark.parametrize(
    ("level", "targets"),
    [
        ("move", {"x": 256}),
        ("move", {"x": -256}),
        ("target", {"x": 112}),
        ("target", {"x": -112}),
        ("axes", {"x": -96, "y": 64}),
    ],
)
def test_the_largest_macros_first_reach_the_target_in_both_directions(env, level, targets):
    total, steps, info = play_episode(env, env.scripted_action, options={"level": level, "targets": targets})
    assert info["score"]["success"]
    assert info["score"]["moves"] == steps
    assert info["score"]["time"] == info["elapsed"]
    assert info["score"]["lost_steps"] == info["score"]["limits"] == 0
    assert np.isfinite(info["score"]["regret"])
    assert total > 4.9


@pytest.mark.parametrize(
    "chip", ["PCL240K", "STEPDIR", *(pytest.param(c, marks=pytest.mark.slow) for c in ("PCL240MS", "MCX514"))]
)
def test_from_an_unknown_position_a_policy_must_return_to_the_origin_first(chip):
    env = make_env(chip=chip, axes=("x",))
    sides = set()
    for seed in (0, 1, 2, 8):
        env.reset(seed=seed, options={"targets": {"x": 320}})
        started = env._task.axis_states[0, 0]
        assert not started["known"]
        sides.add(bool(started["org"]))
        _, _, info = play_episode(env, env.scripted_action, seed=seed, options={"targets": {"x": 320}})
        assert info["score"]["success"], seed
        assert abs(env.stage.axes["x"].position - env._task.origin[0]) / env.stage.axes[
            "x"
        ].meters_per_pulse == pytest.approx(320, abs=16)
    assert sides == {True, False}, "before ORG and on it"


def test_an_origin_return_fails_on_the_origin_switch_and_succeeds_after_leaving_it(env):
    for seed in range(20):
        env.reset(seed=seed)
        if env._task.axis_states[0, 0]["org"] and env.stage.axes["x"].position < env._task.origin[0] - 500 * 3.125e-6:
            break
    play_macros(env, "home")
    assert not env._task.axis_states[0, 0]["known"], "the backing off is too short"
    play_macros(env, "rates usual", f"distance {env._task.config.grid[-1]}", "plus", "wait", "read", "home")
    assert env._task.axis_states[0, 0]["known"]
    assert env._task.config.grid[-1] > MAX_PULSES_BEFORE_ORIGIN


def test_a_macro_without_effect_is_masked_and_does_nothing_when_played(env):
    _, info = env.reset(seed=3, options={"level": "target"})
    names, allowed = np.array(env.macros), info["action_mask"]
    assert allowed.dtype == np.int8
    assert not any(name.startswith("select") for name in names[allowed != 0]), "x is alone"
    assert {"plus", "minus", "home", "wait", "read"} & set(names[allowed != 0]) == set()
    before = env.stage.time
    ((_, reward, *_, info),) = play_macros(env, "plus")
    assert info["masked"]
    parts = info["reward_parts"]
    assert parts["cost"] == -0.01
    assert parts["failed"] == pytest.approx(-(119 * 0.01 + 30.0 * 0.05)), "what a failure would cost yet"
    assert reward == pytest.approx(parts["cost"] + parts["failed"])
    assert env.stage.time == before
    *_, (*_, info) = play_macros(env, "rates usual", "distance 16", "plus")
    assert not info["masked"]
    assert set(names[info["action_mask"] != 0]) == {"wait", "read"}
    assert np.array_equal(env.action_masks(), info["action_mask"] != 0)
    *_, (*_, info) = play_macros(env, "wait", "read")
    assert "read" not in names[info["action_mask"] != 0]


def test_every_mask_allows_a_macro_and_a_vector_stacks_the_masks():
    envs = gymnasium.make_vec(
        "stage/BusMacros-v1", num_envs=3, vectorization_mode="vector_entry_point", model="xy", mixed=True
    )
    _, info = envs.reset(seed=2)
    rng = np.random.default_rng(0)
    for _ in range(30):
        masks = envs.unwrapped.action_masks()
        assert masks.any(axis=1).all()
        assert np.array_equal(masks, info["action_mask"] != 0)
        *_, info = envs.step(np.array([rng.choice(np.flatnonzero(row)) for row in masks]))
        if info.get("_score", np.zeros(1)).any():
            break
    assert len(set(info["level"])) > 1
    with pytest.raises(ArgumentError, match="is not in MultiDiscrete"):
        envs.step(np.full(3, 99))


@pytest.mark.parametrize("action", [-1, 14, 1 << 70, np.int64(14), np.array(14), True, 0.0])
def test_an_action_that_is_no_macro_is_refused_before_anything_happens(env, action):
    env.reset(seed=1)
    before = env.stage.time, env._task.steps.tolist()
    with pytest.raises(ArgumentError, match="is not in Discrete"):
        env.step(action)
    assert (env.stage.time, env._task.steps.tolist()) == before


@pytest.mark.parametrize("chip", ["PCL240K", "MCX514"])
def test_macros_played_by_python_give_the_same_bits(chip):
    """Python plays the stages with a journal; both decode an origin return."""
    settings = {"num_envs": 2, "vectorization_mode": "vector_entry_point", "model": "xy", "chip": chip}
    journaled, compiled = (gymnasium.make_vec("stage/BusMacros-v1", **settings).unwrapped for _ in range(2))
    journal = journaled.stages[1].axes["x"].chip.journal()
    for envs in (journaled, compiled):
        envs.reset(seed=0)
    rng, macros = np.random.default_rng(1), list(compiled.macros)
    for k in range(12):
        actions = np.array([rng.choice(np.flatnonzero(row)) for row in compiled.action_masks()])
        if k == 0:
            actions[:] = macros.index("home")
        first, second = journaled.step(actions), compiled.step(actions)
        assert repr(first) == repr(second), actions
    assert journal.entries


def test_an_end_limit_counts_as_damage_once_until_the_axis_leaves_it(env):
    env.reset(seed=1, options={"level": "move"})
    x = env.stage.axes["x"]
    near = next(s.touch for s in x.plant.switches if s.pin == "el_plus")
    env.stage.place(x=near - 100 * x.meters_per_pulse)
    reported = play_macros(env, "rates gentle", "distance 1024", "plus", "wait", "read")
    assert x.switches.el_plus
    assert x.lost_steps == 0
    assert sum(info["reward_parts"]["damage"] for *_, info in reported) == -0.5


def test_stable_baselines_reads_the_action_masks():
    sb3 = pytest.importorskip("stage.envs.sb3", reason="extra rl is not installed")
    envs = sb3.StageVecEnv("stage/BusMacros-v1", 2, model="xy")
    envs.seed(1)
    envs.reset()
    rows = envs.env_method("action_masks")
    assert [row.tolist() for row in rows] == envs.envs.action_masks().tolist()
    assert envs.has_attr("action_masks")


def test_giving_up_early_costs_no_less_than_failing_at_the_end():
    """A host repeats masked actions, or loses a step at once, which ends an episode below the level "origin"."""
    env = make_env(level="target")
    idle = env.macros.index("home")
    spun, steps, info = play_episode(env, lambda: idle)
    assert steps == 120
    assert info["score"]["time"] == info["score"]["regret"] == np.inf
    assert spun == pytest.approx(-FULL, abs=1e-9)
    crash = iter(["rates bold", "distance 1024", "plus"])
    lost, steps, info = play_episode(
        env,
        lambda: env.macros.index(next(crash, "wait")),
        options={"current": 0.6, "payload": 5.0, "targets": {"x": 16}},
    )
    assert steps < 120
    assert info["score"]["lost_steps"] > 0
    assert lost < spun - 0.4, "damage, and farther away"


def test_an_observation_changes_only_after_the_host_has_read_the_chip(env):
    env.reset(seed=4, options={"level": "target", "targets": {"x": 512}})
    names = [e.name for e in env.observation_features]
    left = names.index("left")
    observed = [out[0][left] for out in play_macros(env, "rates usual", "distance 256", "plus", "wait", "read")]
    assert len(set(observed[:4])) == 1
    assert observed[4] == pytest.approx(observed[0] / 2)
    assert not any(e.who == "truth" for e in env.observation_features)


def test_invalid_levels_targets_and_grids_are_refused(env):
    for options, text in (
        ({"level": 4}, "option level=4: 0 to 3, or move"), ({"targets": {"x": 1 << 20}}, "option targets="),
        ({"targets": {"q": 16}}, "axis 'q'"), ({"level": 3, "targets": {"x": -16}}, "1 to 2720"),
    ):  # fmt: skip
        with pytest.raises(ArgumentError, match=text):
            env.reset(options=options)
    for settings, text in (
        ({"grid": (64, 16)}, "grid="),
        ({"grid": (8, 16)}, "beyond the tolerance"),
        ({"level": "x"}, "level"),
    ):
        with pytest.raises(ArgumentError, match=text):
            Config(**settings)
    with pytest.raises(ArgumentError, match="no stepper's slide"):
        make_env(chip="HCTL1100", model="xyz_servo")
    assert Config().level == LEVELS[-1]


AT_GOAL = {"off": (0, 0), "rest": (0, 0), "busy": (0, 0), "known": (1, 1), "lost": (0, 0)}


@pytest.mark.parametrize(
    ("level", "how", "success"),
    [
        ("axes", {}, True),
        ("axes", {"off": (15, -15), "rest": (7, -7)}, True),
        ("axes", {"off": (17, 0)}, False),
        ("axes", {"off": (0, -17)}, False),
        ("axes", {"rest": (0, 9)}, False),
        ("axes", {"rest": (-9, 0)}, False),
        ("axes", {"busy": (0, 1)}, False),
        ("axes", {"known": (0, 1)}, False),
        ("axes", {"lost": (0, 4)}, False),
        ("target", {"off": (0, 500), "busy": (0, 1), "lost": (0, 4)}, True),
        ("origin", {"lost": (4, -8)}, True),
    ],
)
def test_success_needs_every_condition_on_every_axis_that_takes_part(env, monkeypatch, level, how, success):
    """The cases: pulses off the target, rest position off, still driving, origin known, full steps lost."""
    env.reset(seed=1, options={"level": level})
    task, created = env._task, AT_GOAL | how
    task.axis_states["known"][0] = created["known"]

    def change_truth(results):
        for a, index in enumerate(task.index):
            goal = task.axis_states[0, a]["goal"]
            results["position"][0, index] = goal + created["off"][a] * task.per_pulse[a]
            results["commanded"][0, index] = (
                goal + created["rest"][a] * task.per_pulse[a] + created["lost"][a] * task.full_step[a]
            )
            results["busy"][0, index], results["lost_steps"][0, index] = created["busy"][a], created["lost"][a]

    judge_other_truth(monkeypatch, task, change_truth)
    info = play_macros(env, "rates usual")[0][4]
    assert info["success"] == success


def test_only_the_first_lost_step_of_an_episode_costs(env, monkeypatch):
    env.reset(seed=1, options={"level": "origin"})
    task, lost = env._task, iter([(0, 4), (0, 8), (0, 0), (12, 0)])

    def change_truth(results):
        results["lost_steps"][0, task.index] = next(lost)

    judge_other_truth(monkeypatch, task, change_truth)
    steps = play_macros(env, "rates usual", "rates bold", "rates usual", "rates bold")
    assert [s[4]["reward_parts"]["damage"] for s in steps] == [-0.5, 0, 0, 0]
    assert [s[4]["lost_steps"] for s in steps] == [4, 8, 0, 12]
    assert task.axis_states["lost"][0].tolist() == [12, 8], "the most of each"


def test_a_wait_cut_short_by_patience_leaves_the_axis_running():
    env = make_env(level="move", patience=0.01)
    env.reset(seed=1, options={"targets": {"x": 1024}})
    observed = play_macros(env, "rates gentle", "distance 1024", "plus", "wait")
    running = [e.name for e in env.observation_features].index("running")
    assert [s[0][running] for s in observed] == [0, 0, 1, 1]
    over = False
    while not over:
        observation, _, over, _, info = play_macros(env, "wait")[0]
        assert over or observation[running]
    assert info["success"]
