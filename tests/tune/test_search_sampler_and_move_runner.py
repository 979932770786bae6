"""Leading trials and the sampler of a search, the error if the formula fails, and the fleet of a move runner."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.chips import PCL240K
from stage.firmware.driver import Speeds
from stage.tune import MoveCase, Task, search, tuning
from stage.tune.formula import SAFETY_FACTOR
from stage.tune.move_runner import MoveOutcomes, MoveRunner
from stage.tune.register_planners import MovePlan, create_planner

CASES = [MoveCase((0.0, 2.0, 2.6)[k % 3], 1.0 + k, 1 - 2 * (k % 2)) for k in range(8)] + [MoveCase(2.6, 9.0, 1)]


@pytest.fixture(scope="module")
def task():
    return Task(Stage("xy", chips=PCL240K, visuals=False), "x", pulses=400, payload=2.0, hold=0.02)


class UniformStudy:
    """Study that suggests 0 for every parameter of every trial."""

    def __init__(self):
        self.number, self.enqueue_trial, self.tell = -1, lambda values: None, lambda trial, value: None

    def ask(self):
        self.number += 1
        return SimpleNamespace(number=self.number, suggest_float=lambda *_: 0.0, set_constraint=lambda *_: None)


def test_a_trial_that_only_equals_the_best_gets_no_further_cases(task, monkeypatch):
    sizes = []

    def run_recorded_moves(plans, cases, limit):
        sizes.append((len(plans), len(cases)))
        shape = len(plans), len(cases)
        return MoveOutcomes(np.full(shape, 0.25), np.ones(shape, bool), np.zeros(shape))

    monkeypatch.setattr(search, "_create_study", lambda seed: UniformStudy())
    runner = SimpleNamespace(task=task, planner=create_planner(task), run_moves=run_recorded_moves)
    search.search_registers(runner, CASES[:2], CASES[2:5], 0.5, 16, seed=1)
    assert sizes == [(8, 2), (8, 3), (8, 2)], (
        "only the first eight are better than all before; the next eight equal them"
    )


def test_the_sampler_draws_16_trials_at_random_and_logs_only_warnings():
    optuna = pytest.importorskip("optuna")
    verbosity = optuna.logging.get_verbosity()
    try:
        optuna.logging.set_verbosity(optuna.logging.DEBUG)
        sampler = search._create_study(7).sampler
        assert optuna.logging.get_verbosity() == optuna.logging.WARNING
    finally:
        optuna.logging.set_verbosity(verbosity)
    assert (sampler._n_startup_trials, sampler._multivariate) == (16, True)
    assert sampler._rng.rng.random_sample() == np.random.RandomState(7).random_sample(), "the seed is the search's own"


@pytest.mark.parametrize(
    ("maximum", "message"),
    [
        (2.0, "Up to 2 kg in all they keep step: take less payload or spare."),
        (0.0, "Up to 0 kg in all"),
        (-1.0, "Nor do they keep step with nothing on it"),
    ],
)
def test_the_largest_payload_of_the_formula_is_one_of_nine_with_four_cases_each(task, maximum, message):
    requested = []

    def run_moves_up_to_maximum(plans, cases, limit):
        requested.append(([plan.registers for plan in plans], cases, limit))
        return MoveOutcomes(*(np.array([[c.payload <= maximum for c in cases]]) for _ in range(3)))

    plans = SimpleNamespace(
        build_formula_plan=lambda safety: MovePlan({"safety": safety}, Speeds(1000.0, 4000.0, 0.1, 0.2))
    )
    assert tuning._describe_largest_payload(
        SimpleNamespace(task=task, run_moves=run_moves_up_to_maximum), plans, CASES
    ).startswith(message)
    ((registers, cases, limit),) = requested
    assert registers == [{"safety": SAFETY_FACTOR}]
    assert limit == pytest.approx(2 * (400 / 4000 + 0.1 + 0.2) + 0.3 + 0.02)
    assert [c.payload for c in cases] == pytest.approx(np.repeat(np.linspace(0.0, task.payload_with_margin, 9), 4))
    assert [(c.start_offset, c.direction) for c in cases[4:8]] == [(c.start_offset, c.direction) for c in CASES[:8:2]]


def test_a_runner_closes_its_fleet_at_its_end_and_when_interrupted(task, monkeypatch):
    closed = []
    created = MoveRunner(task, create_planner(task), 1, fleet_size=1)
    monkeypatch.setattr(created.fleet, "close", lambda: closed.append("closed"))
    with created as entered:
        assert entered is created
    assert closed == ["closed"]
    with pytest.raises(KeyboardInterrupt), created:
        raise KeyboardInterrupt
    assert closed == ["closed"] * 2


def test_the_fleet_has_one_stage_for_each_lane_and_one_thread_for_each_worker(task):
    runner = MoveRunner(task, create_planner(task), 2, fleet_size=3)
    assert (len(runner.fleet), runner.fleet.threads) == (3, 2)
    assert len({id(stage) for stage in runner.fleet.stages} | {id(task.stage)}) == 4
    runner.close()
