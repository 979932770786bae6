"""Baselines that do not learn: the table of all tasks, hosts that search within an episode, the engineer of a servo."""

import sys

import numpy as np
import pytest

import stage.envs
from registerbench.baselines import few_shot_memory_gain, servo_formula, task_table
from stage import Stage, StageError
from stage.chips import HCTL1100
from stage.envs import machine_contexts


def test_the_table_of_all_tasks_is_of_complete_episodes_and_names_its_splits(monkeypatch):
    monkeypatch.setattr(task_table, "LANES", 2)
    assert set(task_table.TASKS.values()) == {id_ for id_ in stage.envs.IDS if id_.endswith("-v1")}
    assert {task_table.list_splits(id_) for id_ in task_table.TASKS.values()} == {tuple(machine_contexts.SPLITS)}
    totals, score = task_table.play_episodes("stage/BusMacros-v1", "scripted", 3, model="xy", level="move", macros=6)
    assert len(totals) == 3
    assert score["success"].all()
    assert "| 3 of 3 |" in task_table.format_row("BusMacros", "train", "scripted", totals, score)


@pytest.mark.slow
def test_on_machines_that_differ_a_host_that_remembers_is_better_than_one_that_does_not():
    fixed, _ = few_shot_memory_gain.play_host(
        few_shot_memory_gain.make_fixed_host(3.4), "weak", 16, few_shot_memory_gain.TEST
    )
    search, times = few_shot_memory_gain.play_host(
        few_shot_memory_gain.make_searching_host(3.4 / few_shot_memory_gain.STEP), "weak", 16, few_shot_memory_gain.TEST
    )
    assert (
        few_shot_memory_gain.compute_interval(search, statistic=np.mean)[0]
        > few_shot_memory_gain.compute_interval(fixed, statistic=np.mean)[1]
    )
    assert np.isfinite(times).mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 10.0])
def test_the_engineers_design_has_its_margin_and_settles_sooner_than_after_a_reset(payload):
    pytest.importorskip("control", reason="extra servo is not installed")
    machine = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    machine.set_payload(payload)
    loop = servo_formula.ServoLoop.from_axis(
        machine.axes["x"], servo_formula.FilterTuning(pole=servo_formula.DEFAULT_POLE)
    )
    created = servo_formula.design_filter(loop)
    assert created.phase_margin == pytest.approx(
        servo_formula.PHASE_MARGIN_DEGREES, abs=servo_formula.MAX_MARGIN_LOSS_DEGREES
    )
    assert created.gain_margin > 2
    assert abs(servo_formula.replace(loop, tuning=created.tuning).poles).max() < 1
    after_reset = {"R22": 0x40, "R20": 0xE5, "R21": 0x40, "R0F": 0x40}
    designed = servo_formula.measure_moves(payload, servo_formula.design_registers(machine.axes["x"]), moves=1)
    assert designed["reward"] > servo_formula.measure_moves(payload, after_reset, moves=1)["reward"]


def test_without_python_control_the_baseline_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(StageError, match=r"pip install -e '\.\[servo\]'"):
        servo_formula.import_control()
