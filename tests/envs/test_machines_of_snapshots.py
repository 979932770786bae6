"""A snapshot of an environment contains its machine: payload, friction, drive, switches and faults."""

import gymnasium
import numpy as np
import pytest

import stage.envs
from stage import ArgumentError
from stage.chips import MCX514

SHORT = {
    "stage/RegisterTuning-v0": {"model": "xy", "moves": 3, "distances": (300, 900), "limit": 0.3, "settle": 0.01},
    "stage/OriginReturn-v0": {"model": "xy", "returns": 3, "limit": 0.05, "settle": 0.01, "drift": 4e-4},
    "stage/ServoTuning-v0": {"limit": 0.05, "rest": 0.01, "moves": 3},
    "stage/FewShotTuning-v1": {"model": "xy", "distances": (300, 900), "tries": 3, "split": "faults", "healthy": 0.0},
    "stage/OneShotTuning-v1": {"model": "xy", "distances": (300, 900), "split": "faults", "healthy": 0.0},
    "stage/SynchronizedLine-v1": {"model": "xy", "distances": (300, 900), "split": "faults", "healthy": 0.0},
    "stage/DriftingHome-v1": {"model": "xy", "healthy": 0.0, "walk": 1e-3, "bounces": (1e-3, 2e-3)},
    "stage/BusMacros-v1": {"model": "xy", "split": "faults", "healthy": 0.0},
}


def make_env(id_):
    return gymnasium.make(id_, disable_env_checker=True, **SHORT[id_]).unwrapped


def read_machine(stage_):
    """Read every parameter of a machine that an environment may draw."""
    model, state = stage_.model, stage_.state
    arrays = {
        name: getattr(model, name)
        for name in (
            "body_mass",
            "dof_frictionloss",
            "dof_damping",
            "actuator_damping",
            "dof_solref",
            "dof_solimp",
            "geom_pos",
            "body_inertia",
        )
    }
    arrays |= {f"switch {name}": state.switch_table[name] for name in ("forced", "bounce", "toggles")}
    arrays |= {f"drive {name}": state.drives[name] for name in ("voltage", "current", "inductance")}
    return {name: array.tolist() for name, array in arrays.items()} | {
        a.name: (a.faults.bus_voltage, a.faults.open_phases, a.position, a.commanded) for a in stage_.axes.values()
    }


@pytest.mark.parametrize("id_", SHORT)
@pytest.mark.parametrize("seed", [1, 4])
def test_restoring_a_snapshot_restores_its_machine_in_any_environment(id_, seed):
    assert id_ in stage.envs.IDS
    env, other = make_env(id_), make_env(id_)
    env.reset(seed=seed)
    if env.action_space.shape:
        env.step(np.zeros(env.action_space.shape, np.float32))  # the next return, try or move is drawn
    drawn = read_machine(env.stage)
    saved = env.snapshot()
    other.reset(seed=seed + 1)
    if drawn == read_machine(other.stage):
        pytest.fail("both drew the same machine, and nothing is shown")
    other.restore(saved)
    assert read_machine(other.stage) == drawn
    env.reset(seed=seed + 2)
    env.restore(saved)
    assert read_machine(env.stage) == drawn


@pytest.mark.parametrize("id_", ["stage/RegisterTuning-v0", "stage/FewShotTuning-v1"])
def test_a_chip_by_name_or_by_class_is_one_environment_to_snapshots(id_):
    more = {**SHORT[id_], "moves": 3} if id_.endswith("v0") else SHORT[id_]
    envs = [
        gymnasium.make(id_, disable_env_checker=True, **{**more, "chip": chip}).unwrapped
        for chip in ("mcx514", "MCX514", MCX514)
    ]
    envs[0].reset(seed=2)
    saved = envs[0].snapshot()
    for env in envs:
        env.restore(saved)
    with pytest.raises(ArgumentError, match="setting chip: 'MCX514' there, 'PCL240K' here"):
        gymnasium.make(id_, disable_env_checker=True, **{**more, "chip": "PCL240K"}).unwrapped.restore(saved)
