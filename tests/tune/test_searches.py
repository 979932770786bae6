"""First trials, ranking and time limits of a search, with moves whose outcomes the tests define."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.chips import PCL240K, PCL240MS
from stage.errors import ArgumentError
from stage.tune import MoveCase, Task
from stage.tune.formula import FormulaChoice
from stage.tune.move_runner import MoveOutcomes
from stage.tune.register_planners import create_planner
from stage.tune.search import compute_time_limit, search_registers

LIMIT = 0.5
CASES = [MoveCase(0.0, 0.0, 1), MoveCase(2.0, 0.0, -1)]

pytest.importorskip("optuna")


class NumberedRunner:
    """Move runner whose outcomes the test defines.

    `outcome_of(number of the plan, case)` returns the arrival time in seconds and whether the move keeps step.
    """

    def __init__(self, outcome_of, chip=PCL240K):
        self.task = Task(Stage("xy", chips=chip, visuals=False), "x", pulses=400, payload=2.0, hold=0.02)
        self.planner, self.outcome_of, self.plans, self.sizes, self.limits = (
            create_planner(self.task),
            outcome_of,
            [],
            [],
            [],
        )

    def run_moves(self, plans, cases, limit):
        first = len(self.plans)
        self.plans += plans
        self.sizes.append((len(plans), len(cases)))
        self.limits.append(limit)
        outcomes = np.array([[self.outcome_of(first + k, case) for case in cases] for k in range(len(plans))], float)
        return MoveOutcomes(
            np.where(outcomes[..., 0] <= limit, outcomes[..., 0], np.nan),
            outcomes[..., 1] != 0,
            np.zeros(outcomes.shape[:2]),
        )

    def search(self, trials, further_cases=(), **settings):
        return search_registers(self, CASES, further_cases, LIMIT, trials, seed=1, **settings)[0]


@pytest.mark.parametrize("chip", [PCL240K, PCL240MS])
def test_the_first_trials_are_the_formula_and_bolder_safety_factors_with_each_ramp_shape(chip):
    runner = NumberedRunner(lambda k, case: (0.3, True), chip)
    runner.search(9, choice=FormulaChoice(2.0))
    shapes = runner.planner.ramp_shapes
    wanted = [runner.planner.compute_speeds(2.0 * part).drive for _ in shapes for part in (1.0, 0.9, 0.8, 0.7)]
    speeds = [plan.speeds for plan in runner.plans[1:]]  # the sampler has drawn one before them
    assert [s.drive for s in speeds[: len(wanted)]] == pytest.approx(wanted, rel=1e-6)
    assert [s.s_curve for s in speeds[: len(wanted)]] == [name == "s_curve" for name in shapes for _ in range(4)]


def test_the_requested_number_of_trials_runs_in_batches_of_eight_with_unique_numbers():
    runner, received = NumberedRunner(lambda k, case: (0.3, True)), []
    ranked = runner.search(19, on_progress=lambda done, best: received.append((done, best.number)))
    assert runner.sizes == [(8, 2), (8, 2), (3, 2)]
    assert [trial.number for trial in ranked] == list(range(19)), "the first of equal trials is the best"
    assert received == [(8, 0), (16, 0), (19, 0)]


def test_trials_that_lose_steps_rank_last():
    runner = NumberedRunner(lambda k, case: (0.01, False) if k < 4 else (0.3, True))
    ranked = runner.search(16)
    assert runner.limits == [LIMIT, min(LIMIT, compute_time_limit(0.3, 0.02))]
    assert [trial.failed_moves for trial in ranked] == [0] * 12 + [2] * 4
    assert [trial.number for trial in ranked] == [*range(4, 16), *range(4)]


def test_a_leading_trial_that_loses_steps_in_one_further_case_counts_as_failed():
    further_cases = [MoveCase(0.0, 5.0, 1), MoveCase(2.0, 5.0, -1), MoveCase(2.0, 7.0, 1)]
    runner = NumberedRunner(lambda k, case: (0.2, case.start_offset != 7.0))
    ranked = runner.search(3, further_cases)
    assert runner.sizes == [(3, 2), (3, 3)], "all three would lead, and run the further cases"
    assert [(trial.max_time, trial.failed_moves) for trial in ranked] == [(0.2, 1)] * 3


def test_a_trial_that_the_chip_refuses_ranks_below_all_others():
    runner = NumberedRunner(lambda k, case: (0.2, False))
    real, requested_values = runner.planner.build_plan, []

    def build_plan(speeds, values, shape):
        requested_values.append(values)
        if len(requested_values) > 8:  # the formula has requested those before
            raise ArgumentError("too steep.")
        return real(speeds, values, shape)

    runner.planner = SimpleNamespace(
        build_plan=build_plan,
        compute_speeds=runner.planner.compute_speeds,
        ramp_shapes=runner.planner.ramp_shapes,
        parameter_names=runner.planner.parameter_names,
        find_parameters=runner.planner.find_parameters,
    )
    ranked = runner.search(16)
    possible = [trial for trial in ranked if trial.plan is not None]
    impossible = [trial for trial in ranked if trial.plan is None]
    assert ranked == [*possible, *impossible]
    assert impossible
    assert {(trial.max_time, trial.failed_moves) for trial in impossible} == {(2 * LIMIT, 1 + len(CASES))}
    assert {trial.failed_moves for trial in possible} == {len(CASES)}


def test_trials_draw_their_parameters_from_minus_one_to_one(monkeypatch):
    runner, drawn = NumberedRunner(lambda k, case: (0.3, True)), []
    build_plan = runner.planner.build_plan

    def build_recorded_plan(center, parameters, shape):
        drawn.extend(parameters.values())
        return build_plan(center, parameters, shape)

    monkeypatch.setattr(runner.planner, "build_plan", build_recorded_plan)
    runner.search(48)
    assert -1.0 <= min(drawn) < -0.9
    assert 0.9 < max(drawn) <= 1.0
