"""What surrounds a search: who leads it, its sampler, what is said where nothing keeps step, and that nothing is left running."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.chips import PCL240K
from stage.firmware.driver import Speeds
from stage.tune import MoveCase, Task, search, tuning
from stage.tune.formula import SAFETY_FACTOR
from stage.tune.move_runner import MoveOutcomes, MoveRunner
from stage.tune.planners import MovePlan, create_planner

CASES = [MoveCase((0.0, 2.0, 2.6)[k % 3], 1.0 + k, 1 - 2 * (k % 2)) for k in range(8)] + [MoveCase(2.6, 9.0, 1)]


@pytest.fixture(scope="module")
def task():
    return Task(Stage("xy", chips=PCL240K, visuals=False), "x", pulses=400, payload=2.0, hold=0.02)


class Study:
    """Draws the same of everybody, and has no other opinion."""

    def __init__(self):
        self.number, self.enqueue_trial, self.tell = -1, lambda values: None, lambda trial, value: None

    def ask(self):
        self.number += 1
        return SimpleNamespace(number=self.number, suggest_float=lambda *_: 0.0, set_constraint=lambda *_: None)


def test_who_is_as_good_as_the_best_does_not_lead_and_gets_no_further_cases(task, monkeypatch):
    sizes = []

    def make(plans, cases, limit):
        sizes.append((len(plans), len(cases)))
        shape = len(plans), len(cases)
        return MoveOutcomes(np.full(shape, 0.25), np.ones(shape, bool), np.zeros(shape))

    monkeypatch.setattr(search, "_create_study", lambda seed: Study())
    tries = SimpleNamespace(task=task, planner=create_planner(task), run_moves=make)
    search.search_registers(tries, CASES[:2], CASES[2:5], 0.5, 16, seed=1)
    assert sizes == [(8, 2), (8, 3), (8, 2)], "the first eight lead nobody, the next eight are as good"


def test_a_search_draws_sixteen_trials_before_its_sampler_has_an_opinion_and_says_no_more_than_warnings():
    optuna = pytest.importorskip("optuna")
    was = optuna.logging.get_verbosity()
    try:
        optuna.logging.set_verbosity(optuna.logging.DEBUG)
        sampler = search._create_study(7).sampler
        assert optuna.logging.get_verbosity() == optuna.logging.WARNING
    finally:
        optuna.logging.set_verbosity(was)
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
def test_the_largest_payload_of_the_formula_is_found_among_nine_with_four_cases_each(task, maximum, message):
    requested = []

    def make(plans, cases, limit):
        requested.append(([plan.registers for plan in plans], cases, limit))
        return MoveOutcomes(*(np.array([[c.payload <= maximum for c in cases]]) for _ in range(3)))

    plans = SimpleNamespace(
        build_formula_plan=lambda safety: MovePlan({"safety": safety}, Speeds(1000.0, 4000.0, 0.1, 0.2))
    )
    assert tuning._describe_largest_payload(SimpleNamespace(task=task, run_moves=make), plans, CASES).startswith(
        message
    )
    ((registers, cases, limit),) = requested
    assert registers == [{"safety": SAFETY_FACTOR}]
    assert limit == pytest.approx(2 * (400 / 4000 + 0.1 + 0.2) + 0.3 + 0.02)
    assert [c.payload for c in cases] == pytest.approx(np.repeat(np.linspace(0.0, task.max_payload, 9), 4))
    assert [(c.start_offset, c.direction) for c in cases[4:8]] == [(c.start_offset, c.direction) for c in CASES[:8:2]]


def test_a_finished_or_interrupted_runner_has_closed_its_fleet(task, monkeypatch):
    closed = []
    made = MoveRunner(task, create_planner(task), 1, fleet_size=1)
    monkeypatch.setattr(made.fleet, "close", lambda: closed.append("closed"))
    with made as tries:
        assert tries is made
    assert closed == ["closed"]
    with pytest.raises(KeyboardInterrupt), made:
        raise KeyboardInterrupt
    assert closed == ["closed"] * 2


def test_the_fleet_has_one_stage_for_each_lane_and_one_thread_for_each_worker(task):
    made = MoveRunner(task, create_planner(task), 2, fleet_size=3)
    assert (len(made.fleet), made.fleet.threads) == (3, 2)
    assert len({id(stage) for stage in made.fleet.stages} | {id(task.stage)}) == 4
    made.close()
