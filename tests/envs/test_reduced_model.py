"""`reduced=True`: tasks of one axis without the physics of the other axes move as with the whole machine."""

import gymnasium
import mujoco
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError, ModelError
from stage.envs.machine_contexts import SPLITS
from stage.envs.reduced_model import reduce_model
from stage.sim import plant

IDS = {
    "stage/OneShotTuning-v1": {"proofs": 2},
    "stage/FewShotTuning-v1": {"tries": 2, "proofs": 2},
    "stage/RegisterTuning-v0": {"distances": (400, 800), "limit": 0.3},
    "stage/ServoTuning-v0": {"limit": 0.1, "rest": 0.02},
    "stage/DriftingHome-v1": {"reach": 0.004, "limit": 1.5},
    "stage/OriginReturn-v0": {"limit": 0.5},
}
N = 10  # stages


def make_vec(id_, n=N, **settings):
    return gymnasium.make_vec(id_, num_envs=n, vectorization_mode="vector_entry_point", **settings).unwrapped


def play_moves(envs, seed, actions):
    """Play a move on each stage, and return the lost steps and the end position of the axis in pulses."""
    envs.reset(seed=seed)
    task = envs.task_instance
    task.actions[...] = actions
    task.fleet.play(task.make_programs())
    truth = task.fleet.truth()[:, task.axis.index]
    return truth["lost_steps"].tolist(), truth["position"] / task.axis.meters_per_pulse


def check_moves(split, rounds, n=N, **settings):
    """Check that n random moves in each round lose the same steps and end within a pulse with the reduced model."""
    complete, reduced = (
        make_vec("stage/FewShotTuning-v1", n, split=split, reduced=on, **settings) for on in (False, True)
    )
    rng = np.random.default_rng(rounds)
    for seed in range(rounds):
        actions = rng.uniform(-1, 1, (n, 4)).astype(np.float32)
        (lost, ends), (other_lost, other_ends) = (
            play_moves(envs, 1000 * seed, actions) for envs in (complete, reduced)
        )
        assert lost == other_lost, seed
        assert np.abs(ends - other_ends).max() <= 1, seed
    assert list(reduced.stages[0].axes) == [settings.get("axis", "x")]
    assert len(complete.stages[0].axes) > 1


@pytest.mark.parametrize("split", SPLITS)
def test_random_moves_lose_the_same_steps_and_end_within_a_pulse(split):
    check_moves(split, 1, n=5)


@pytest.mark.parametrize("axis", ["y", "z"])
def test_the_axis_that_moves_can_be_any(axis):
    check_moves("train", 1, axis=axis, distances=(800, 3200))


@pytest.mark.slow
@pytest.mark.parametrize("split", SPLITS)
def test_a_thousand_random_moves_lose_the_same_steps_and_end_within_a_pulse(split):
    check_moves(split, 1000 // N)


@pytest.mark.parametrize("id_", IDS)
def test_every_task_of_one_axis_has_nearly_the_same_rewards_with_the_reduced_model(id_):
    rewards = []
    for on in (False, True):
        envs = make_vec(id_, 3, reduced=on, **IDS[id_])
        envs.reset(seed=2)
        envs.action_space.seed(2)
        rewards.append([envs.step(envs.action_space.sample())[1] for _ in range(2)])
    assert np.abs(np.subtract(*rewards)).max() < 0.02


def test_all_axes_are_simulated_by_default():
    envs = [make_vec("stage/OneShotTuning-v1", 2, **settings) for settings in ({}, {"reduced": False})]
    for e in envs:
        e.reset(seed=1)
    action = np.zeros((2, 4), np.float32)
    assert repr(envs[0].step(action)) == repr(envs[1].step(action))
    assert len(envs[0].stages[0].axes) == 3


def test_the_reduced_model_has_no_contacts_of_other_axes():
    model = reduce_model("xyz", "y").compile()
    assert [model.joint(k).name for k in range(model.njnt)] == ["y"]
    assert {model.sensor(k).name.split("_")[0] for k in range(model.nsensor)} == {"y"}
    pairs = {model.geom(int(model.pair_geom1[k])).name.split("_")[0] for k in range(model.npair)}
    assert pairs == {"y"}
    assert model.nu == 1


def test_joints_without_a_motor_stay():
    model = reduce_model("xy_mast", "x").compile()
    assert {model.joint(k).name for k in range(model.njnt)} == {"x", "camera_x", "camera_y"}


@pytest.mark.parametrize(
    ("model", "axis", "message"),
    [
        ("xyz", "w", "unknown axis 'w'"),
        ("gantry", "y", "drives its load together"),
        (plant.compile_spec(plant.open_spec("xy"), 0)[0], "x", "an MjModel stays"),
    ],
)
def test_a_model_that_cannot_be_reduced_is_refused(model, axis, message):
    with pytest.raises(ArgumentError, match=message):
        reduce_model(model, axis)


def test_a_model_that_needs_another_axis_says_so():
    spec = mujoco.MjSpec.from_string(plant.open_spec("xy").to_xml())
    spec.add_sensor(
        name="y_position", type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname="y"
    )
    with pytest.raises(ModelError, match="needs an axis other than x"):
        reduce_model(spec, "x")
