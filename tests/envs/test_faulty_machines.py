"""Faults of hidden machines: every task holds some back from training, and they change only the machine."""

from importlib import import_module

import gymnasium
import numpy as np
import pytest

import stage.envs
from stage import ArgumentError, Stage
from stage.drives import stepper
from stage.envs import machine_contexts, machine_faults
from stage.envs.few_shot import make_action

SHORT = {
    "stage/FewShotTuning-v1": {"distances": (1600, 2000), "tries": 2, "proofs": 1, "settle": 0.01},
    "stage/OneShotTuning-v1": {"distances": (1600, 2000), "proofs": 1, "settle": 0.01},
    "stage/SynchronizedLine-v1": {"distances": (300, 900), "proofs": 1, "rest": 0.01},
    "stage/DriftingHome-v1": {"returns": 2, "limit": 1.0, "settle": 0.01},
    "stage/BusMacros-v1": {"level": "axes"},
}
HEALTHY = {"payload": 1.0, "friction": 1.0, "supply": 1.0, "current": 0.8, "loss": 1.0, "inductance": 1.0}


def make_env(id_, **settings):
    return gymnasium.make(id_, disable_env_checker=True, **{"model": "xy", **SHORT[id_]} | settings).unwrapped


def faults(id_):
    return import_module(f"stage.envs.{stage.envs.IDS[id_].split(':')[0]}").Config.FAULTS


@pytest.mark.parametrize("id_", SHORT)
def test_the_split_faults_differs_from_train_only_in_its_faults(id_):
    train, test = make_env(id_), make_env(id_, split="faults")
    observed = {name: set() for name in ("train", "faults")}
    for seed in range(40 if id_ == "stage/DriftingHome-v1" else 16):
        (first, a), (second, b) = (env.reset(seed=seed) for env in (train, test))
        observed["train"].add(machine_faults.FAULT_NAMES[a.pop("fault")])
        observed["faults"].add(machine_faults.FAULT_NAMES[b.pop("fault")])
        assert str(a) == str(b), "what the machine is beside its fault"
        reported = 1 if id_ == "stage/DriftingHome-v1" else 0  # there ORG is the first, and it may be stuck
        assert np.array_equal(first[reported:], second[reported:]), "nobody is told"
    known = set(machine_contexts.SPLITS["faults"]["faults"]) & set(faults(id_))
    assert observed["faults"] - {"none"} == known
    assert not (observed["train"] & observed["faults"]) - {"none"}
    assert id_ == "stage/DriftingHome-v1" or (observed["train"] == {"none"} and "none" not in observed["faults"])


@pytest.mark.parametrize("fault", machine_faults.HAMPERING_FAULTS)
def test_a_hampered_machine_loses_steps_in_fast_moves_and_makes_moderate_ones(fault):
    env = make_env("stage/FewShotTuning-v1", proofs=0)
    moves = {"brisk": make_action(1500, 96_000, 0.025, 0.025), "usual": make_action(1000, 16_000, 0.15, 0.15)}
    saved = {}
    for name in ("none", fault):
        env.reset(seed=1, options={**HEALTHY, "fault": name, "distance": 2000})
        for what, action in moves.items():
            *_, info = env.step(action)
            saved[name, what] = info["kept"]
            assert machine_faults.FAULT_NAMES[info["fault"]] == name
    assert saved == {("none", "brisk"): True, ("none", "usual"): True, (fault, "brisk"): False, (fault, "usual"): True}


def test_the_overload_fault_adds_to_the_payload_and_to_the_margin_of_a_proof():
    env = make_env("stage/FewShotTuning-v1", payload_on="y")
    env.reset(seed=1, options={**HEALTHY, "fault": "overload"})
    task, stage = env._task, env.stage
    assert stage.payload("y") == pytest.approx(1.0 + 12.0)
    for more, kg in ((0.5, 13.5), (0.0, 13.0)):
        task.apply_machine_to(stage, 0, more)
        assert stage.payload("y") == pytest.approx(kg)


def test_a_fault_of_a_two_axis_machine_acts_on_one_axis_that_takes_part():
    env = make_env("stage/BusMacros-v1", split="faults")
    dofs = [env.stage.axes[name].plant.dof for name in ("x", "y")]
    hit = []
    for level, n in (("axes", 12), ("target", 6)):
        for seed in range(n):
            env.reset(seed=seed, options={"fault": "none", "level": level})
            healthy = env.stage.model.dof_frictionloss[dofs].copy()
            env.reset(seed=seed, options={"fault": "binding", "level": level})
            hit.append((env.stage.model.dof_frictionloss[dofs] > healthy).tolist())
            assert sum(hit[-1]) == 1
    assert {tuple(h) for h in hit[:12]} == {(True, False), (False, True)}
    assert {tuple(h) for h in hit[12:]} == {(True, False)}


def test_a_bouncing_origin_switch_still_permits_an_origin_return():
    env = make_env("stage/BusMacros-v1", level="origin", axes=("x",))
    for fault in ("none", "bounce"):
        _, info = env.reset(seed=3, options={**HEALTHY, "fault": fault, "targets": {"x": 64}})
        switch = env.stage.state.switch_table[env.stage.axes["x"].switches.find_index("org")]
        assert switch["bounce"] == (1_000_000 if fault == "bounce" else 0)
        over = False
        while not over:
            *_, finished, cut, info = env.step(env.scripted_action())
            over = finished or cut
        assert info["score"]["success"]


def test_a_fault_of_an_episode_leaves_earlier_faults_in_place():
    machine = Stage("xy", visuals=False)
    x = machine.axes["x"]
    x.faults.open_phases = stepper.B
    faults_of_x = machine_faults.FaultyAxis.from_stage(machine, "x")
    faults_of_x.apply(machine, "phase open")
    assert x.faults.open_phases == stepper.A | stepper.B
    faults_of_x.apply(machine, "none")
    assert x.faults.open_phases == stepper.B


def test_an_unknown_fault_is_named_in_the_error():
    with pytest.raises(ArgumentError, match="unknown fault of this task, in faults, 'jam'"):
        make_env("stage/BusMacros-v1", faults=("jam",))
    with pytest.raises(ArgumentError, match="unknown option fault 'org open'"):
        make_env("stage/FewShotTuning-v1").reset(options={"fault": "org open"})
    with pytest.raises(ArgumentError, match=r"faults=\(\): some of binding, sag, overload; or say healthy=1.0"):
        make_env("stage/FewShotTuning-v1", faults=())
    env = make_env("stage/OneShotTuning-v1", faults=("sag",), healthy=0.5)
    drawn = [env.reset(seed=seed)[1]["fault"] for seed in range(16)]
    assert {machine_faults.FAULT_NAMES[k] for k in drawn} == {"none", "sag"}
    assert 4 <= drawn.count(0) <= 12
