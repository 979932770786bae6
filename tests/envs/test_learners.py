"""The learners of the benchmark: what a policy may know, masks that hold, and that they learn."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import bench
from stage.bench.around import Around


@pytest.fixture(autouse=True)
def baselines(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "scripts" / "baselines"))


@pytest.fixture
def memory():
    import few_shot_memory

    return few_shot_memory


def boldness(memory, w, *kept):
    """Of each try, after tries that kept step or did not."""
    rule, tried = memory.Rule(w), []
    for k in range(len(kept) + 1):
        if k:
            rule.see(np.array([kept[k - 1]]))
        tried.append(float(rule(np.array([0.5]))[0]))
    return tried


def test_a_policy_without_memory_does_the_same_whatever_its_tries_have_shown(memory):
    w = (0.2, 0.4, 0.8)
    assert boldness(memory, w, True, True) == boldness(memory, w, False, True)
    assert boldness(memory, w, True, True) == pytest.approx(np.exp([0.4, 0.5, 0.6]))


def test_a_policy_with_memory_goes_up_until_it_loses_steps_and_then_between(memory):
    w = (1.0, 0.0, 0.7, 0.2, 0.4, 0.25)
    assert boldness(memory, w, True, True) == pytest.approx(np.exp([1.0, 1.2, 1.4]))
    assert boldness(memory, w, False, False) == pytest.approx(np.exp([1.0, 0.6, 0.2]))
    assert boldness(memory, w, True, False, True) == pytest.approx(np.exp([1.0, 1.2, 1.05, 1.05 + 0.15 / 4]))
    assert boldness(memory, w, True, False, False)[3] == pytest.approx(np.exp(1.0 + 0.05 / 4))
    rule = memory.Rule(w)
    for kept in (True, False):  # the same try, once so and once so
        rule(np.zeros(1))
        rule.last[:] = 1.0
        rule.see(np.array([kept]))
    assert float(rule(np.zeros(1))[0]) == pytest.approx(np.exp(0.6)), "it was luck, and is forgotten"


def test_the_policy_of_the_bench_plays_as_the_one_that_learned(memory):
    w = [0.9, 0.1, 0.0, 0.3, 0.3, 0.5]
    settings = {"model": "xy", "distances": (400, 800), "proofs": 0, "settle": 0.01, "memory": "last"}
    envs = gymnasium.make_vec(
        memory.ID, 2, vectorization_mode="vector_entry_point", autoreset_mode="Disabled", **settings
    ).unwrapped
    total = memory.play(envs, np.array(w), 5)
    env = gymnasium.make(memory.ID, disable_env_checker=True, **settings).unwrapped
    policy = memory.Policy(w)
    for k in range(2):
        observation, info = env.reset(seed=5 + k)
        policy.reset(Around("few-shot", None, None, tuple(e.name for e in env.entries)))
        alone, over = 0.0, False
        while not over:
            observation, reward, over, _, info = env.step(policy(observation, info))
            alone += reward
        assert alone == pytest.approx(total[k])


@pytest.mark.slow
def test_cma_es_finds_a_bolder_policy_than_it_begins_with(memory, tmp_path, monkeypatch):
    pytest.importorskip("cmaes")
    memory.learn("none", 0, tmp_path, generations=5)
    rows = (tmp_path / "none-0.csv").read_text().splitlines()
    first, last = (float(rows[k].split(",")[3]) for k in (1, -1))
    assert last > first + 0.2
    memory.submit(tmp_path / "none-0.json", ["train"], tmp_path)
    entry = bench.read(tmp_path / "few-shot-train-es-none-0.bench")
    assert entry.cost["moves"] == 5 * memory.POPULATION * memory.MACHINES * memory.TRIES
    assert entry.scores["return"].mean() > 1.0


def test_axes_are_seen_by_their_role_and_macros_are_those_of_the_environment_again():
    pytest.importorskip("stable_baselines3")
    from bus_macros_turned import OF_AXES, Turn

    env = gymnasium.make("stage/BusMacros-v1", disable_env_checker=True, model="xy", level="axes").unwrapped
    names, macros = [e.name for e in env.entries], list(env.macros)
    turn, of_axes = Turn(names, len(macros)), names.index("used")

    def now(seen, mask):
        axis = turn.axis(seen[None])
        return axis, turn.seen(seen[None], axis)[0], turn.masks(mask[None], axis)[0]

    first, info = env.reset(seed=1, options={"targets": {"x": 16, "y": 16}})
    axis, x, x_mask = now(first, info["action_mask"])
    assert np.array_equal(x, first)
    assert np.array_equal(x_mask, info["action_mask"])
    second, *_, info = env.step(macros.index("select y"))
    axis, y, y_mask = now(second, info["action_mask"])
    assert axis.tolist() == [1]
    assert not np.array_equal(second[of_axes:], first[of_axes:])
    assert np.array_equal(y[: of_axes + 2 * len(OF_AXES)], x[: of_axes + 2 * len(OF_AXES)]), "y is now what x was"
    assert np.array_equal(y_mask, x_mask)
    other = len(macros) - 1
    assert [macros[k] for k in turn.back(np.array([0, other, other]), np.array([1, 0, 1]))] == [
        macros[0],
        "select y",
        "select x",
    ]


@pytest.mark.slow
def test_dqn_never_takes_a_macro_that_is_masked_and_learns_one_axis_in_a_minute(tmp_path):
    pytest.importorskip("sb3_contrib")
    import bus_macros_learners as learners

    learners.learn("dqn", 0, 0.6, "target", tmp_path)
    policy, rng = learners.Policy("dqn", tmp_path / "target-dqn-0.zip"), np.random.default_rng(0)
    env = gymnasium.make(learners.ID, disable_env_checker=True).unwrapped
    policy.reset(Around("bus", env.action_space, env.observation_space, tuple(e.name for e in env.entries)))
    masks = rng.integers(0, 2, (200, env.action_space.n))
    masks[:, 0] |= masks.sum(axis=1) == 0
    seen = rng.uniform(-1, 1, (200, env.observation_space.shape[0])).astype(np.float32)
    assert masks[np.arange(200), policy.choose(seen, masks)].all()
    entry = bench.play(policy, "bus-target", "train", episodes=24)
    assert entry.scores["success"].mean() > 0.5
