"""ServoTuning: the registers reach the chip, physics answers, and the engineer's design settles sooner than a reset's values."""

import gymnasium
import numpy as np
import pytest
from support.mirrored import mirrored

import stage.envs  # noqa: F401
from stage import ArgumentError

pytestmark = pytest.mark.filterwarnings("error")
GOOD = {"R22": 0x40, "R20": 0xE5, "R21": 0x40, "R0F": 0x40}


def make_env(**settings):
    return gymnasium.make("stage/ServoTuning-v0", disable_env_checker=True, **settings).unwrapped


def make_one_move(values, distance=200, payload=0.0, **settings):
    """Make one move with these registers and return the environment, the reward and the info."""
    env = make_env(**settings)
    env.reset(seed=1, options={"distance": distance, "payload": payload})
    _, reward, _, _, info = env.step(env._task.registers.to_action(values))
    return env, reward, info


def test_the_registers_selected_are_those_in_the_chip():
    env = make_env()
    env.reset(seed=1)
    env._task.prepare_next_step = lambda: None
    values = {"R22": 77, "R20": 200, "R21": 31, "R0F": 90}
    info = env.step(env._task.registers.to_action(values))[4]
    holding = env.stage.axes["x"].chip.values()
    assert {n: holding[n] for n in ("R22", "R20", "R21")} == {"R22": 77, "R20": 200, "R21": 31}
    assert int(env.stage.axes["x"].chip.state["period"]) == 90
    assert list(info["registers"]) == list(values.values())


@pytest.mark.parametrize("motion", ["step", "trapezoid"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_good_filter_settles_and_the_carriage_is_at_its_goal(motion, axis):
    env = make_env(motion=motion, axis=axis, distances=(100, 4000))
    env.reset(seed=1, options={"distance": 1000, "payload": 0.0})
    env._task.prepare_next_step = lambda: None
    before = env.stage.axes[axis].position
    _, reward, _, _, info = env.step(env._task.registers.to_action(GOOD))
    assert info["finished"]
    assert 0.01 < info["settled"] < 0.4
    assert abs(info["error"]) <= 3
    assert env.stage.axes[axis].position - before == pytest.approx(1000 * 5e-6, abs=5 * 5e-6)
    assert reward == pytest.approx(sum(info["reward_parts"].values()))


def test_the_duration_of_a_trapezoid_is_independent_of_the_sample_timer():
    """4000 counts at 40,000 counts/s and 400,000 counts/s2: triangle, 0.2 s."""
    for t in (0x1F, 0x40, 0x60):
        _, _, info = make_one_move(GOOD | {"R0F": t, "R22": 0x30}, 4000, motion="trapezoid", distances=(100, 4000))
        assert info["settled"] == pytest.approx(0.2, abs=0.04), t


def test_an_excessive_gain_oscillates_and_costs():
    _, good, _ = make_one_move(GOOD)
    _, bad, info = make_one_move({"R22": 0xFF, "R20": 0x00, "R21": 0x00, "R0F": 0xFF})
    assert info["unrest"] > 50
    assert not info["finished"]
    assert info["reward_parts"]["limit"] == -1.0
    assert bad < good - 1.0


def test_an_insufficient_gain_misses_the_goal_and_costs():
    _, _, info = make_one_move({"R22": 1, "R20": 0xFF, "R21": 0xFF, "R0F": 0x40}, 50)
    assert not info["finished"]
    assert info["settled"] == 0.5


def test_a_heavier_load_overshoots_more_with_the_same_filter():
    _, _, light = make_one_move(GOOD, 400, 0.0)
    _, _, heavy = make_one_move(GOOD, 400, 10.0)
    assert heavy["overshoot"] > light["overshoot"]


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"motion": "jump"}, "unknown motion"), ({"axis": "w"}, "unknown axis"), ({"rest": 1.0}, "a part of limit"),
        ({"distances": (10, 10_000_000)}, "has room for"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(settings, text):
    with pytest.raises(ArgumentError, match=text):
        make_env(**settings)
    env = make_env()
    with pytest.raises(ArgumentError, match="option distance=1"):
        env.reset(options={"distance": 1})


def test_distances_and_payloads_are_drawn_within_their_ranges():
    env = make_env(distances=(60, 90), payloads=(1.0, 2.0))
    drawn = [env.reset(seed=k)[1] for k in range(20)]
    assert all(60 <= d["distance"] <= 90 and 1.0 <= d["payload"] <= 2.0 for d in drawn)
    assert len({d["distance"] for d in drawn}) > 5
    assert np.isfinite([d["payload"] for d in drawn]).all()


def judge_samples(monkeypatch, samples, rest=None, distance=100, **settings):
    """Judge a move from samples of its distance to the goal (counts); return reward parts, info and observation."""
    env = make_env(limit=0.02, rest=0.005, distances=(50, 500), **settings)
    env.reset(seed=1, options={"distance": distance})
    task = env._task
    count, goal = env.stage.axes["x"].meters_per_pulse, float(task.goal[0])
    real, (low, high) = task.fleet.play, rest or (samples[-1], samples[-1])

    def play(programs):
        played = real(programs)
        played.results[0, task.first + 1 :: 2] = np.rint(1e12 * count * (goal + np.array(samples)))
        played.extremes[0, task.axis.plant.qpos] = count * (goal + low), count * (goal + high)
        return played

    monkeypatch.setattr(task.fleet, "play", play)
    observation, *_, info = env.step(np.zeros(4, np.float32))
    return info["reward_parts"], info, observation


def test_a_servo_has_settled_from_the_last_sample_outside_the_deadband_on(monkeypatch):
    for samples, settled in (([90] * 5 + [2] * 15, 5), ([2] * 20, 0), ([90] * 3 + [1] * 3 + [-4] * 4 + [0] * 10, 10)):
        parts, info, _ = judge_samples(monkeypatch, samples)
        assert (info["finished"], parts["limit"]) == (True, 0)
        assert info["settled"] == -parts["time"] == pytest.approx(settled * 1e-3)
    for samples, rest in (([90] * 5 + [2] * 15, (-4, 2)), ([90] * 5 + [2] * 15, (0, 4)), ([90] * 19 + [4], (0, 0))):
        parts, info, _ = judge_samples(monkeypatch, samples, rest, limit_weight=2.5)
        assert (info["finished"], info["settled"], parts["limit"]) == (False, 0.02, -2.5)


def test_overshoot_counts_in_shares_of_the_distance_and_unrest_up_to_a_thousand_counts(monkeypatch):
    weights = {"overshoot_weight": 0.5, "unrest_weight": 0.25}
    for over, rest, distance, costs in (
        (25, (-10, 40), 100, (0.25, 0.5)),
        (0, (0, 0), 100, (0.01, 0.0)),
        (300, (-700, 800), 200, (1.0, 10.0)),
    ):
        parts, info, observed = judge_samples(monkeypatch, [-90] * 4 + [over] * 6 + [1] * 10, rest, distance, **weights)
        assert (-2 * parts["overshoot"], -4 * parts["unrest"]) == pytest.approx(costs, abs=1e-6)
        assert (info["overshoot"], info["unrest"], info["error"]) == (max(over, 1), rest[1] - rest[0], -1)
        shares = max(over, 1) / (max(over, 1) + 10), (rest[1] - rest[0]) / (rest[1] - rest[0] + 10)
        assert observed[3:5] == pytest.approx(shares, abs=1e-5)


def test_a_rest_is_shorter_than_the_move_it_ends():
    with pytest.raises(ArgumentError, match=r"rest=0\.1: a part of limit=0\.1"):
        make_env(limit=0.1, rest=0.1)


def test_a_left_handed_screw_reaches_the_same_goal(tmp_path):
    """The gear of axis x is -628.3185307; the goal stays on the commanded side."""
    env, _, info = make_one_move(GOOD, 1000, model=mirrored(tmp_path, "xyz_servo"), distances=(100, 4000))
    assert env.stage.axes["x"].gear < 0
    assert info["finished"]
    assert abs(info["error"]) <= 3
