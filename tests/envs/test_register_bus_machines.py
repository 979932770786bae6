"""RegisterBus on hidden machines: what a split draws, what the host sees of it, and its score."""

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError
from stage.envs import machine_contexts
from stage.envs.register_bus import READ, WAIT, Config
from stage.envs.stage_env import extract_info

ID = "stage/RegisterBus-v0"
HIDDEN = {"split": "train", "model": "xy", "axes": ("x",)}
MACHINE = {
    "payload": 3.0,
    "friction": 1.5,
    "supply": 0.9,
    "current": 0.8,
    "loss": 1.2,
    "inductance": 1.1,
    "switch": 0.25,
}


def make_env(**settings):
    return gymnasium.make(ID, disable_env_checker=True, **{**HIDDEN, **settings}).unwrapped


def play_scripted(env, **reset):
    """Play an episode with the scripted host; return the sum of rewards and the last info."""
    env.reset(**{"seed": 1, **reset})
    total, is_over = 0.0, False
    while not is_over:
        _, reward, terminated, truncated, info = env.step(env.scripted_action())
        total, is_over = total + reward, terminated or truncated
    return total, info


def test_the_machine_of_an_episode_is_applied_and_only_info_names_it():
    env = make_env()
    host = make_env(truth=False)
    observation, info = env.reset(seed=2, options=MACHINE)
    assert {name: info[name] for name in MACHINE} == MACHINE
    assert info["fault"] == 0
    axis, stage_ = env.stage.axes["x"], env.stage
    assert stage_.payload("y") == 3.0
    nominal = env.task_instance.machines[0]
    assert stage_.model.dof_frictionloss[axis.plant.dof] == pytest.approx(1.5 * nominal.friction)
    assert stage_.state.drives[axis.index].current == pytest.approx(0.8 * nominal.current)
    hidden_observation, hidden_info = host.reset(seed=2, options=MACHINE)
    assert np.array_equal(observation, hidden_observation)
    assert set(hidden_info) == {"target"}
    informed = make_env(truth=True)
    count = len(machine_contexts.OBSERVATION_FEATURES)
    first, _ = informed.reset(seed=2, options=MACHINE)
    assert [feature.name for feature in informed.observation_features[-count:]] == [
        f.name for f in machine_contexts.OBSERVATION_FEATURES
    ]
    assert first[-count:].tolist() == pytest.approx(informed.task_instance.machine_features[0].tolist())
    later, *_ = informed.step(np.array([READ, 0, 0, 0]))
    assert np.array_equal(first[-count:], later[-count:]), "the machine stays the same"


def test_other_seeds_and_splits_have_other_machines():
    env, heavy = make_env(), make_env(split="heavy")
    payloads = [env.reset(seed=seed)[1]["payload"] for seed in (1, 2, 1)]
    assert payloads[0] == payloads[2] != payloads[1]
    assert 5 <= heavy.reset(seed=1)[1]["payload"] <= 10
    nova = gymnasium.make(ID, disable_env_checker=True, split="nova", axes=("x",)).unwrapped
    assert type(nova.stage.axes["x"].chip).__name__ == "MCX514"


def test_a_weak_machine_loses_steps_where_a_strong_one_does_not():
    """The same bus cycles decide nothing by themselves: the hidden machine does."""
    strong = {**MACHINE, "payload": 0.0, "friction": 0.5, "supply": 1.1, "current": 1.0}
    weak = {**MACHINE, "payload": 5.0, "friction": 2.0, "supply": 0.7, "current": 0.1}
    env = make_env(currents=(0.1, 1.0), frictions=(0.5, 40.0))
    for machine, success in ((strong, True), ({**weak, "friction": 40.0}, False)):
        total, info = play_scripted(env, options={**machine, "target": {"x": 2000}})
        assert info["success"] == info["score"]["success"] == success
        assert (info["score"]["lost_steps"] == 0) == success
        assert (total > 9) == success
        assert np.isfinite(info["score"]["time"]) == success


def test_the_score_has_time_regret_and_moves():
    _, info = play_scripted(make_env(), options={"target": {"x": 2000}})
    score = info["score"]
    assert score["time"] == info["elapsed"]
    usual = score["time"] / np.exp(score["regret"])
    assert usual == pytest.approx(2000 / 8000 + 0.05 * 7 / 8, rel=0.05), "2000 pulses at 8000 pps, and the ramps"
    env = make_env(time_limit=0.3)
    env.reset(seed=1)
    for k in range(1, 4):
        *_, truncated, info = env.step(np.array([WAIT + 3, 0, 0, 0]))
        assert ("score" in info) == truncated == (k == 3)
    assert info["score"] == {
        "success": False, "time": np.inf, "regret": np.inf, "moves": 3, "lost_steps": 0, "limits": 0,
    }  # fmt: skip


def test_hits_of_end_limits_count():
    env = make_env(distances=(400, 4000))
    limit = env.task_instance.limits[0, 1]
    near = limit - 300 * env.task_instance.per_pulse[0]
    _, info = play_scripted(env, options={"start": {"x": float(near)}, "target": {"x": 200}})
    assert info["score"]["limits"] == 0
    env.reset(seed=1, options={"start": {"x": float(near)}, "target": {"x": -400}})
    env.task_instance.axis_states["target"][0] = (
        2000  # the scripted host now moves towards the limit, away from its goal
    )
    over = False
    while not over:
        *_, terminated, over, info = env.step(env.scripted_action())
        over = over or terminated
    assert info["score"]["limits"] >= 1


@pytest.mark.parametrize("split", ["train", "faults"])
def test_a_vector_on_hidden_machines_is_equal_to_single_environments_bit_for_bit(split):
    settings = {**HIDDEN, "split": split, "axes": ("x", "y"), "truth": True, "time_limit": 1.5}
    n = 3
    envs = gymnasium.make_vec(
        ID, n, vectorization_mode="vector_entry_point", autoreset_mode="Disabled", threads=2, **settings
    ).unwrapped
    single = [gymnasium.make(ID, disable_env_checker=True, **settings).unwrapped for _ in range(n)]
    observations, infos = envs.reset(seed=5)
    for k, env in enumerate(single):
        observation, info = env.reset(seed=5 + k)
        assert np.array_equal(observation, observations[k])
        assert str(extract_info(infos, k)) == str(info)
    for _ in range(40):
        actions = envs.scripted_action()
        assert np.array_equal(actions, [env.scripted_action() for env in single])
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        for k, env in enumerate(single):
            observation, reward, is_terminated, is_truncated, info = env.step(actions[k])
            assert (observation.tobytes(), reward) == (observations[k].tobytes(), rewards[k])
            assert (is_terminated, is_truncated) == (terminated[k], truncated[k])
            assert info.get("score") == (extract_info(infos, k).get("score") if is_terminated or is_truncated else None)
        if (terminated | truncated).any():
            break
    envs.close()


def test_a_snapshot_has_the_hidden_machine():
    env, other = make_env(), make_env()
    env.reset(seed=3)
    for _ in range(10):
        env.step(env.scripted_action())
    snapshot = env.snapshot()
    expected = [env.step(env.scripted_action())[:2] for _ in range(30)]
    other.reset(seed=9)
    other.restore(snapshot)
    for observation, reward in expected:
        again, same, *_ = other.step(other.scripted_action())
        assert (again.tobytes(), same) == (observation.tobytes(), reward)


def test_without_a_split_the_machine_is_that_of_the_model():
    env = gymnasium.make(ID, disable_env_checker=True, model="xy", axes=("x",)).unwrapped
    _, info = env.reset(seed=1)
    assert set(info) == {"target"}
    assert env.stage.payload("y") == 0
    with pytest.raises(ArgumentError, match="without a split"):
        env.reset(options={"payload": 1.0})
    with pytest.raises(ArgumentError, match="only with a split"):
        Config(payloads=(0.0, 1.0))
    with pytest.raises(ArgumentError, match="steppers"):
        make_env(model="xyz_servo", chip="HCTL1100")


def test_the_scripted_host_is_of_moves_of_steppers():
    with pytest.raises(ArgumentError, match="goal 'position'"):
        make_env(goal="home").scripted_action()
