"""SynchronizedLine: a line on a hidden machine is judged by path, time, vibration and a proof."""

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError
from stage.envs.synchronized_line import Config, SynchronizedLine

SHORT = {"model": "xy", "distances": (600, 2000), "proofs": 2, "rest": 0.02}


def make_env(**settings):
    return gymnasium.make("stage/SynchronizedLine-v1", disable_env_checker=True, **SHORT | settings).unwrapped


@pytest.fixture(scope="module")
def env():
    return make_env()


def encode_line(env, rate=16_000.0, ramp=0.15, **corrections):
    """Encode a rate, a ramp and corrections {axis: six numbers} as an action."""
    action = env._task.make_action(rate, ramp)[0]
    for axis, values in corrections.items():
        at = 2 + 6 * env._task.config.axes.index(axis)
        action[at : at + 6] = values
    return action


def test_what_was_gained_and_holds_is_the_logarithm_of_the_cost_saved(env):
    env.reset(seed=1)
    _, reward, over, _, info = env.step(encode_line(env, 8000))
    assert over
    assert info["rate"] == pytest.approx(8000, rel=1e-4)
    c = env._task.config
    cost = info["duration"] + c.path_weight * info["deviation"]
    cost += (c.carriage_weight * info["carriage_deviation"] + c.vibration_weight * info["vibration"]) / 1e-4
    assert info["proved"] == info["score"]["time"] == pytest.approx(cost)
    assert reward == pytest.approx(np.log(2 * info["usual"] / info["proved"]))
    assert info["score"]["success"]


def test_corrections_that_bend_the_line_cost_path(env):
    costs = []
    for corrections in ({}, {"y": (0, 1, 0, 0, 0, 0)}):
        env.reset(seed=2, options={"distances": {"x": 2000, "y": -1100}})
        info = env.step(encode_line(env, **corrections))[4]
        costs.append((info["deviation"], info["proved"]))
    assert costs[1][0] > costs[0][0] + 0.5
    assert costs[1][1] > costs[0][1]


def test_a_line_that_fails_with_the_margin_gains_nothing():
    env = make_env(margin=300.0)
    env.reset(seed=1, options={"current": 0.6})
    _, reward, _, _, info = env.step(encode_line(env, 20_000, 0.03))
    assert not info["lost_steps"].any()
    assert info["proved"] == info["score"]["time"] == np.inf
    assert reward == pytest.approx(0)


def test_a_line_that_loses_steps_is_damage(env):
    env.reset(seed=1, options={"current": 0.6, "payload": 5.0, "distances": {"x": 2000, "y": -1900}})
    _, reward, _, _, info = env.step(encode_line(env, 60_000, 0.01))
    assert info["score"]["lost_steps"] == np.abs(info["lost_steps"]).sum() > 0
    assert reward == -0.05


def test_rotor_angles_differ_between_the_move_and_its_proof(env):
    places = set()
    for seed in range(4):
        env.reset(seed=seed)
        places |= set(env._task.angles[0].tolist())
        env.step(encode_line(env, 8000))
        places |= set(env._task.angles[0].tolist())
    assert len(places) == 16


@pytest.mark.parametrize(
    ("axes", "chip"),
    [
        (("x", "y", "z"), "PCL240K"),
        (("x", "y"), "MCX514"),
        pytest.param(("x", "y", "z"), "MCX304", marks=pytest.mark.slow),
    ],
)
def test_one_policy_acts_through_every_chip_and_in_three_axes(axes, chip):
    env = make_env(model="xyz", axes=axes, chip=chip, proofs=1)
    assert env.action_space.shape == (2 + 6 * len(axes),)
    env.reset(seed=3)
    info = env.step(env.scripted_action())[4]
    assert info["finished"]
    assert info["deviation"] < 5
    env.action_space.seed(1)
    for seed in range(2):
        env.reset(seed=seed)
        env.step(env.action_space.sample())


def test_the_engineers_action_is_the_rate_and_the_ramp_of_the_formula(env):
    env.reset(seed=5)
    rate, ramp, seconds = env._task.formula[0]
    info = env.step(env.scripted_action())[4]
    assert info["rate"] == pytest.approx(rate, rel=1e-5)
    assert info["ramp"] == pytest.approx(ramp, rel=1e-5)
    assert info["duration"] == pytest.approx(seconds, rel=0.1)


def test_invalid_settings_of_a_line_are_refused():
    for settings, text in (
        ({"moves": 2}, "moves=2: one here"),
        ({"actions": "box"}, "actions='box'"),
        ({"ramps": (0.0, 1.0)}, "ramps="),
    ):
        with pytest.raises(ArgumentError, match=text):
            Config(**settings)
    with pytest.raises(ArgumentError, match=r"axis of model xy_mast 'z'"):
        SynchronizedLine(1, Config(split="mast", axes=("x", "z")))
