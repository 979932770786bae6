"""Tests of the learners of the benchmark: observations, action masks and learning progress."""

import dataclasses

import gymnasium
import numpy as np
import pytest

import registerbench
import stage.envs  # noqa: F401
from registerbench.benchmark_tasks import CARDS
from registerbench.policies import PolicyContext


@pytest.fixture
def policies():
    from registerbench.baselines import parametric_policies as policies

    return policies


NAMES = ("distance", "kept")


def compute_speed_factors(policies, kind, w, *saved):
    """Return the logarithm of the speed factor of each attempt, after attempts that kept step (True) or did not."""
    policy, tried = kind(w, NAMES), []
    usual = policies.compute_scaled_actions(np.ones(1))[0, 2]
    per = (policies.compute_scaled_actions(np.full(1, np.e))[0, 2] - usual).item()
    for k in range(len(saved) + 1):
        observed = np.array([[0.5, float(saved[k - 1]) if k else 0.0]])
        tried.append((policy(observed)[0, 2] - usual) / per)
    return pytest.approx(tried, abs=1e-5)


def test_a_policy_without_memory_ignores_the_results_of_its_attempts(policies):
    w = (0.2, 0.4, 0.8)
    assert compute_speed_factors(policies, policies.ScheduledPolicy, w, True, True) == [0.4, 0.5, 0.6]
    assert compute_speed_factors(policies, policies.ScheduledPolicy, w, False, True) == [0.4, 0.5, 0.6]


def test_a_policy_with_memory_grows_bolder_until_it_loses_steps_and_then_bisects(policies):
    kind, w = policies.RememberingPolicy, (0.6, 0.0, 0.2, 0.25, 0.1)
    assert compute_speed_factors(policies, kind, w, True, True) == [0.6, 0.8, 1.0]
    assert compute_speed_factors(policies, kind, w, False, False) == [0.6, 0.2, -0.2]
    assert compute_speed_factors(policies, kind, w, True, False, True) == [0.6, 0.8, 0.65, 0.65 + 0.15 / 4]
    assert compute_speed_factors(policies, kind, w, *[True] * 7) == [0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 1.7], (
        "back at last"
    )
    policy = kind(w, NAMES)
    for observed in (0.0, 1.0, 0.0):  # the same try, once so and once so
        policy(np.array([[0.5, observed]]))
        policy.last[:] = 0.5
    assert not np.isfinite(policy.fastest_success), "it was luck, and is forgotten"
    assert policy.last == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("task", "player"),
    [("few-shot-wide", "es with memory"), ("one-shot", "es"), ("line", "es"), ("home", "es")],
)
def test_the_shipped_policy_plays_like_the_trained_one(policies, task, player):
    from registerbench.baselines import parametric_policy_learners as learners

    kind = policies.PARAMETRIC_POLICIES[task, player]
    w = np.array(kind.INITIAL_NUMBERS) + 0.1
    envs = learners.make_training_envs(task, 2, **learners.CHEAPER_SETTINGS.get(task, {}))
    total, _, steps = learners.play_policy(envs, kind, w, 5)
    envs.close()
    card, policy = CARDS[task], learners.ParametricPolicyPlayer(kind, w.tolist())
    selected = {"memory": "last"} if "memory" in card.choices else {}
    env = gymnasium.make(
        card.id, disable_env_checker=True, **{**card.settings, **selected, **learners.CHEAPER_SETTINGS.get(task, {})}
    ).unwrapped
    created = 0
    for k in range(2):
        observation, info = env.reset(seed=5 + k)
        policy.reset(PolicyContext(task, None, None, tuple(e.name for e in env.observation_features)))
        alone, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, info = env.step(policy(observation, info))
            alone, over, created = alone + reward, terminated or truncated, created + 1
        assert alone == pytest.approx(total[k])
    assert created == steps


@pytest.mark.slow
def test_cma_es_finds_a_bolder_policy_than_it_begins_with(tmp_path):
    pytest.importorskip("cmaes")
    from registerbench.baselines import parametric_policy_learners as learners

    learners.learn("few-shot", 0, tmp_path, machines=16)
    path = tmp_path / "few-shot_es-without-memory-0.csv"
    points = [r.split(",") for r in path.read_text().splitlines()[1:]]
    first, last = ([float(r[3]) for r in points if r[0] == points[k][0]] for k in (0, -1))
    assert len(first) == len(last) == learners.EPISODES
    assert np.mean(last) > np.mean(first) + 0.2
    learners.submit(path.with_suffix(".json"), ["train"], tmp_path)
    entry = registerbench.read_entry(tmp_path / "few-shot-train-es-without-memory-0.bench")
    assert entry.cost["moves"] == float(points[-1][0])
    assert entry.scores["return"][: learners.EPISODES] == pytest.approx(last, abs=1e-3), "the curve's end is the entry"


def test_a_rule_earns_the_tabulated_rewards_of_its_attempts(policies):
    from registerbench.baselines.outcomes_by_speed_factor import SPEED_FACTORS, OutcomesBySpeedFactor

    edge = np.array([2.0, 4.0])
    saved = SPEED_FACTORS[:, None] < edge
    worth = np.where(saved, np.log(SPEED_FACTORS)[:, None], 0.0)
    table = OutcomesBySpeedFactor(saved, saved, worth, np.zeros(2), False, 0, 0.05)
    at = table.find_nearest_rows(np.log([1.9, 2.1, 3.9]))
    assert saved[at].tolist() == [[True, True], [False, True], [False, True]]
    best = table.sum_rewards(np.array([at[0], at[2], at[1]])[:, None])
    assert best == pytest.approx([worth[at[0], 0] - 2 * 0.05, worth[at[2], 1]])
    answer = dataclasses.replace(table, last_attempt_counts=True)
    assert answer.sum_rewards(np.array([at[2], at[1]])[:, None]) == pytest.approx([-2 * 0.05, worth[at[1], 1]])
    w = policies.RememberingPolicy.INITIAL_NUMBERS
    closed_in, blind = (
        answer.play_policy(kind, kind.INITIAL_NUMBERS)
        for kind in (policies.RememberingPolicy, policies.ScheduledPolicy)
    )
    assert (closed_in > np.log(edge) - 0.2 - 5 * 0.05).all(), (
        "close to each machine's edge, after five tries that were lost"
    )
    assert blind[0] == blind[1] < closed_in[1], "the same for both"
    assert (
        table.select_first_machines(1).play_policy(policies.RememberingPolicy, w)
        == table.play_policy(policies.RememberingPolicy, w)[:1]
    )


def test_axes_are_ordered_by_their_role_and_macros_are_those_of_the_environment_again():
    pytest.importorskip("stable_baselines3")
    from registerbench.baselines.bus_macros_role_order import AXIS_FEATURES, AxisRoles

    env = gymnasium.make("stage/BusMacros-v1", disable_env_checker=True, model="xy", level="axes").unwrapped
    names, macros = [e.name for e in env.observation_features], list(env.macros)
    turn, of_axes = AxisRoles(names, len(macros)), names.index("used")

    def now(observed, mask):
        axis = turn.find_selected_axis(observed[None])
        return axis, turn.reorder_observation(observed[None], axis)[0], turn.reorder_masks(mask[None], axis)[0]

    first, info = env.reset(seed=1, options={"targets": {"x": 16, "y": 16}})
    axis, x, x_mask = now(first, info["action_mask"])
    assert np.array_equal(x, first)
    assert np.array_equal(x_mask, info["action_mask"])
    second, *_, info = env.step(macros.index("select y"))
    axis, y, y_mask = now(second, info["action_mask"])
    assert axis.tolist() == [1]
    assert not np.array_equal(second[of_axes:], first[of_axes:])
    assert np.array_equal(y[: of_axes + 2 * len(AXIS_FEATURES)], x[: of_axes + 2 * len(AXIS_FEATURES)]), (
        "y is now what x was"
    )
    assert np.array_equal(y_mask, x_mask)
    other = len(macros) - 1
    assert [macros[k] for k in turn.restore_macros(np.array([0, other, other]), np.array([1, 0, 1]))] == [
        macros[0],
        "select y",
        "select x",
    ]


def test_the_progress_reward_of_an_axis_is_independent_of_a_second_axis():
    pytest.importorskip("sb3_contrib")
    from registerbench.baselines import bus_macros_learners as learners

    def progress(level, **targets):
        weight = learners.PROGRESS_WEIGHTS[level]
        env = gymnasium.make(learners.ID, disable_env_checker=True, level=level, progress_weight=weight).unwrapped
        env.reset(seed=1, options={"targets": targets})
        text = ("rates usual", "distance 1024", "plus", "wait")
        return sum(env.step(env.macros.index(m))[-1]["reward_parts"]["progress"] for m in text)

    alone = progress("target", x=2048)
    assert alone > 0.1
    assert progress("axes", x=2048, y=0) == pytest.approx(alone, abs=1e-3)


def test_a_stopped_learner_reports_its_saved_file_and_the_exit_code_of_a_signal(capsys):
    from registerbench.baselines import exit_on_interrupt

    with pytest.raises(SystemExit) as stopped, exit_on_interrupt("two runs are kept."):
        raise KeyboardInterrupt
    assert stopped.value.code == 130
    assert "two runs are kept." in capsys.readouterr().err


@pytest.mark.slow
def test_dqn_never_takes_a_macro_that_is_masked_and_learns_one_axis_in_a_minute(tmp_path):
    pytest.importorskip("sb3_contrib")
    from registerbench.baselines import bus_macros_learners as learners

    learners.learn("dqn", 0, 0.3, "target", tmp_path)
    policy, rng = learners.MacroPolicy.load(tmp_path / "target-dqn-0.zip"), np.random.default_rng(0)
    env = gymnasium.make(learners.ID, disable_env_checker=True).unwrapped
    policy.reset(
        PolicyContext("bus", env.action_space, env.observation_space, tuple(e.name for e in env.observation_features))
    )
    masks = rng.integers(0, 2, (200, env.action_space.n))
    masks[:, 0] |= masks.sum(axis=1) == 0
    observed = rng.uniform(-1, 1, (200, env.observation_space.shape[0])).astype(np.float32)
    assert masks[np.arange(200), policy.choose_macros(observed, masks)].all()
    entry = registerbench.play(policy, "bus-target", "train", episodes=24)
    assert entry.scores["success"].mean() > 0.8
