"""Tests of DriftingHome: origin returns on a drifting machine, and rewards for reports of faults."""

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError
from stage.envs import machine_contexts, machine_faults
from stage.envs.drifting_home import Config, make_action
from stage.envs.step_results import DIVERGENCE_REWARD

GOOD = make_action()
"""The action of the default rates, which approaches ORG from the plus side."""
BROKEN = Config.FAULTS


def make_env(**settings):
    return gymnasium.make(
        "stage/DriftingHome-v1",
        disable_env_checker=True,
        **{"model": "xy", "reduced": True, "reach": 0.004, "returns": 3, "limit": 1.5} | settings,
    ).unwrapped


@pytest.fixture(scope="module")
def env():
    return make_env()


def play_episode(env, policy, **reset):
    """Play an episode and return the sum of rewards and the infos."""
    env.reset(**{"seed": 1} | reset)
    total, infos, over = 0.0, [], False
    while not over:
        _, reward, finished, cut, info = env.step(policy())
        total, over = total + reward, finished or cut
        infos.append(info)
    return total, infos


def test_a_healthy_machine_returns_to_its_origin_repeatedly(env):
    total, infos = play_episode(env, env.scripted_action, options={"fault": "none"})
    assert len(infos) == env._task.config.returns
    assert all(info["home"] and abs(info["error"]) < 12 and not info["lost_steps"] for info in infos)
    assert infos[-1]["score"]["success"]
    assert infos[-1]["score"]["time"] == pytest.approx(np.mean([info["duration"] for info in infos]))
    assert total > -1
    assert sum(info["reward_parts"]["report"] for info in infos) == 0


@pytest.mark.parametrize("reach", [0.004, 0.02])
def test_the_reference_time_is_that_of_the_default_rates_at_any_reach(reach):
    env = make_env(reach=reach)
    _, infos = play_episode(env, lambda: GOOD, seed=4, options={"fault": "none"})
    assert all(info["start"] > env._task.origin for info in infos), "plus of ORG: one search and back"
    assert abs(infos[-1]["score"]["regret"]) < 0.1


def test_the_scripted_host_leaves_org_by_its_distance_beyond_it():
    env = make_env(reach=0.02, limit=3.0)
    leaves = []
    for start, away in ((-0.002, "unknown"), (-0.010, "distant"), (-0.002, "near")):
        if away == "unknown":
            env.reset(seed=2, options={"fault": "none", "start": env._task.origin + start})
        else:  # the next return begins here
            env._task.place[0] = env._task.origin + start
            env._task.away[0] = env._task.place[0] - env._task.last_end[0]
            env.stage.restore(env._task.start)
            env._task.apply_machine(0)
            env.stage.place(x=float(env._task.place[0]))
        action = env.scripted_action()
        leaves.append(9600 * ((action[3] + 1) / 2) ** 3)
        assert env.step(action)[4]["home"]
    unknown, distant, near = leaves
    assert unknown == pytest.approx(0.02 / env._task.per_pulse + 500, rel=0.01)
    assert distant == pytest.approx(0.010 / env._task.per_pulse + 500, rel=0.02)
    assert near == pytest.approx(0.002 / env._task.per_pulse + 500, rel=0.05)


@pytest.mark.parametrize(
    "fault", ["org closed", *(pytest.param(n, marks=pytest.mark.slow) for n in BROKEN if n != "org closed")]
)
def test_a_fault_shows_in_the_result_of_a_return_and_reporting_it_pays(env, fault):
    total, infos = play_episode(
        env, env.scripted_action, options={"fault": fault, "current": 0.6, "friction": 1.9, "payload": 4.0}
    )
    assert infos[-1]["reported"]
    assert not any(info["home"] for info in infos)
    assert len(infos) <= 3, "after one return that ran to an end limit, or two that failed"
    assert infos[-1]["reward_parts"]["report"] == 1
    assert infos[-1]["score"]["success"]
    assert infos[-1]["fault"] == machine_faults.FAULT_NAMES.index(fault)
    silent, infos = play_episode(
        env, lambda: GOOD, options={"fault": fault, "current": 0.6, "friction": 1.9, "payload": 4.0}
    )
    assert len(infos) == env._task.config.returns
    assert sum(info["reward_parts"]["report"] for info in infos) == pytest.approx(-1)
    assert not infos[-1]["score"]["success"]
    assert silent < total


def test_a_false_report_costs_more_than_going_on_and_dares_no_less_than_a_miss():
    """Check the price: it was 84 once, which no learner dared, and must still not end an episode at a bargain."""
    env = make_env(limit=1.5, settle=0.01)
    config = env._task.config
    reported, (info,) = play_episode(env, lambda: make_action(report=True), options={"fault": "none"})
    assert info["reported"]
    assert not info["score"]["success"]
    assert env.stage.time == 0, "and nothing was moved"
    assert reported == pytest.approx(-config.false_weight - config.returns * config.missed_weight)
    played, _ = play_episode(env, env.scripted_action, options={"fault": "none"})
    assert reported < played - 1
    later, infos = play_episode(env, iter([GOOD] * 2 + [make_action(report=True)]).__next__, options={"fault": "none"})
    assert infos[-1]["reward_parts"]["report"] == pytest.approx(-config.false_weight - config.missed_weight)
    assert later < played - 1, "nor is it a bargain at the end"


def test_no_episode_costs_as_much_as_a_divergence():
    """A divergence cost 10, and an episode of failed returns up to 84: to diverge was the cheap way out."""
    c = Config()
    worst = 4 * c.limit * c.time_weight + 64 * c.error_weight + c.missed_weight + 2 * c.damage_weight
    assert -c.returns * worst - c.unreported_weight > DIVERGENCE_REWARD
    assert -c.false_weight - c.returns * max(worst, c.missed_weight) > DIVERGENCE_REWARD


def test_a_limit_of_gymnasium_does_not_spare_the_price_of_silence():
    """The price of a fault that is not reported was due at the task's own end, before which TimeLimit ended the episode."""
    env = gymnasium.wrappers.TimeLimit(make_env(returns=3), 2)
    _, infos = play_episode(env, lambda: GOOD, options={"fault": "org closed"})
    assert len(infos) == 2
    assert [info["reward_parts"]["report"] for info in infos] == pytest.approx([-1 / 3] * 2)


def test_one_failed_return_does_not_prove_a_stuck_switch(env):
    """A return from the far side of ORG is refused as with a switch that is stuck closed."""
    text = []
    for fault in ("none", "org closed"):
        env.reset(seed=2, options={"fault": fault, "start": env._task.origin - 0.003})
        text.append(env.step(GOOD)[0][3:8].tolist())
    assert text[0] == text[1]
    env.reset(seed=2, options={"fault": "none", "start": env._task.origin - 0.003})
    assert env.step(make_action(leave=1500))[4]["home"]


def test_the_origin_drifts_and_the_counters_show_the_drift():
    env = make_env(limit=3.0, returns=6, walk=1e-4, noise=0.0, bounces=(0.0, 0.0))
    env.reset(seed=4, options={"fault": "none", "current": 0.8, "friction": 1.0})
    off, shifts = [], []
    at = [e.name for e in env.observation_features].index("last_off")
    for _ in range(3):
        shifts.append(env._task.shift[0, 1])
        off.append(env.step(make_action(leave=1500, approach=200))[0][at] * 64 * env._task.per_pulse)
    assert len(set(shifts)) == 3
    assert off[0] == 0
    assert np.allclose(off[1:], np.diff(shifts), atol=1.5e-5)
    assert np.abs(np.diff(shifts)).max() <= 1e-4 < np.abs(shifts).max(), "the distances add up"


def test_a_fault_ends_with_its_episode(env):
    model, axis = env.stage.model, env.stage.axes["x"]
    row, dof = axis.switches.find_index("org"), axis.plant.dof

    def read_machine():
        switch = env.stage.state.switch_table[row]
        return (
            switch["forced"],
            axis.faults.open_phases,
            axis.faults.bus_voltage,
            model.dof_frictionloss[dof],
            model.dof_solimp[dof].tolist(),
        )

    env.reset(seed=3, options={"fault": "none"})
    healthy = read_machine()
    for fault in BROKEN:
        env.reset(seed=3, options={"fault": fault})
        assert read_machine() != healthy
        env.reset(seed=3, options={"fault": "none"})
        assert read_machine() == healthy


def return_to(monkeypatch, env, pulses_off):
    """Make one scripted return of a healthy machine that ends `pulses_off` pulses away from the origin; return its info."""
    env.reset(seed=1, options={"fault": "none"})
    task, read_truth = env._task, env._task.fleet.truth

    def read_displaced_truth():
        truth = read_truth().copy()
        truth["position"] = task.origin + task.shift[0, 1] + pulses_off * task.per_pulse
        return truth

    monkeypatch.setattr(task.fleet, "truth", read_displaced_truth)
    return env.step(env.scripted_action())[4]


@pytest.mark.parametrize(("off", "missed"), [(-63, False), (63, False), (-65, True), (65, True)])
def test_a_return_far_from_the_origin_fails_although_the_chip_reports_success(env, monkeypatch, off, missed):
    info, config = return_to(monkeypatch, env, off), env._task.config
    assert info["home"]
    assert info["error"] == pytest.approx(off)
    assert info["reward_parts"]["missed"] == (-config.missed_weight if missed else 0)
    assert info["reward_parts"]["error"] == pytest.approx(-config.error_weight * min(abs(off), 64))


@pytest.mark.parametrize(("off", "success"), [(-13, False), (-11, True), (11, True), (13, False)])
def test_success_is_within_the_tolerance_on_either_side(monkeypatch, off, success):
    score = return_to(monkeypatch, make_env(returns=1), off)["score"]
    assert score["success"] == success
    assert np.isfinite(score["time"]) == success


def test_a_start_is_a_number_between_the_end_limits(env):
    for start in (0, -0.12, np.float32(-0.149)):
        env.reset(options={"start": start})
        assert env.stage.axes["x"].position == pytest.approx(start, abs=1e-6)
    for wrong in ("0", True, None, [0.0], -0.1491, np.nan):
        with pytest.raises(ArgumentError, match=r"option start=.*: m, from -0\.149 to 0\.149"):
            env.reset(options={"start": wrong})


def test_each_split_draws_its_listed_faults_and_mostly_healthy_machines():
    drawn = {}
    for split in ("train", "faults"):
        env = make_env(split=split)
        drawn[split] = [env.reset(seed=seed)[1]["fault"] for seed in range(24)]
        assert 9 <= drawn[split].count(0) <= 20
    names = {split: {machine_faults.FAULT_NAMES[k] for k in results if k} for split, results in drawn.items()}
    assert names["train"] == set(machine_contexts.SPLITS["train"]["faults"])
    assert names["faults"] == set(machine_contexts.SPLITS["faults"]["faults"]) & set(Config.FAULTS)
    assert not names["train"] & names["faults"]
    with pytest.raises(ArgumentError, match=r"faults 'org opn'.*Did you mean 'org open'"):
        Config(faults=("org opn",))
    with pytest.raises(ArgumentError, match="option fault 'rust'"):
        env.reset(options={"fault": "rust"})
    with pytest.raises(ArgumentError, match="faults=\\(\\): some of org open"):
        Config(faults=())


@pytest.mark.slow
@pytest.mark.parametrize("chip", ["PCL240MS", "MCX514"])
def test_the_same_policy_returns_with_every_chip(chip):
    env = make_env(chip=chip, returns=3)
    for seed in (1, 2):
        _, infos = play_episode(env, env.scripted_action, seed=seed, options={"fault": "none"})
        assert infos[-1]["score"]["success"], seed
    _, infos = play_episode(env, env.scripted_action, options={"fault": "org open"})
    assert infos[-1]["score"]["success"]
