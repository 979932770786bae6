"""What a search tries first, which of its trials leads, and how long it looks, with moves that go as they are told to here."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.chips import PCL240K, PCL240MS
from stage.errors import ArgumentError
from stage.tune import MoveCase, Task
from stage.tune.move_runner import MoveOutcomes
from stage.tune.planners import create_planner
from stage.tune.search import compute_time_limit, search_registers

LIMIT = 0.5
CASES = [MoveCase(0.0, 0.0, 1), MoveCase(2.0, 0.0, -1)]

pytest.importorskip("optuna")


class Told:
    """goes(number of the plan, case) -> (s, kept)."""

    def __init__(self, goes, chip=PCL240K):
        self.task = Task(Stage("xy", chips=chip, visuals=False), "x", pulses=400, payload=2.0, hold=0.02)
        self.planner, self.goes, self.made, self.sizes, self.limits = create_planner(self.task), goes, [], [], []

    def run_moves(self, plans, cases, limit):
        first = len(self.made)
        self.made += plans
        self.sizes.append((len(plans), len(cases)))
        self.limits.append(limit)
        went = np.array([[self.goes(first + k, case) for case in cases] for k in range(len(plans))], float)
        return MoveOutcomes(
            np.where(went[..., 0] <= limit, went[..., 0], np.nan), went[..., 1] != 0, np.zeros(went.shape[:2])
        )

    def search(self, trials, more=(), **how):
        return search_registers(self, CASES, more, LIMIT, trials, seed=1, **how)[0]


@pytest.mark.parametrize("chip", [PCL240K, PCL240MS])
def test_the_formula_is_tried_first_and_then_bolder_ones_with_each_shape(chip):
    told = Told(lambda k, case: (0.3, True), chip)
    told.search(9, safety_factor=2.0)
    shapes = told.planner.ramp_shapes
    wanted = [told.planner.compute_speeds(2.0 * part).drive for _ in shapes for part in (1.0, 0.9, 0.8, 0.7)]
    made = [plan.speeds for plan in told.made[1:]]  # one is drawn before them
    assert [s.drive for s in made[: len(wanted)]] == pytest.approx(wanted, rel=1e-6)
    assert [s.s_curve for s in made[: len(wanted)]] == [name == "s_curve" for name in shapes for _ in range(4)]


def test_the_requested_number_of_trials_runs_in_batches_of_eight_with_unique_numbers():
    told, received = Told(lambda k, case: (0.3, True)), []
    ranked = told.search(19, on_progress=lambda done, best: received.append((done, best.number)))
    assert told.sizes == [(8, 2), (8, 2), (3, 2)]
    assert [trial.number for trial in ranked] == list(range(19)), "of equals the first is the best"
    assert received == [(8, 0), (16, 0), (19, 0)]


def test_a_trial_without_registers_ranks_last():
    broken = Told(lambda k, case: (0.01, False) if k < 4 else (0.3, True))
    ranked = broken.search(16)
    assert broken.limits == [LIMIT, min(LIMIT, compute_time_limit(0.3, 0.02))]
    assert [trial.failed_moves for trial in ranked] == [0] * 12 + [2] * 4
    assert [trial.number for trial in ranked] == [*range(4, 16), *range(4)]


def test_one_case_of_more_that_breaks_is_a_trial_that_broke():
    more = [MoveCase(0.0, 5.0, 1), MoveCase(2.0, 5.0, -1), MoveCase(2.0, 7.0, 1)]
    told = Told(lambda k, case: (0.2, case.start_offset != 7.0))
    ranked = told.search(3, more)
    assert told.sizes == [(3, 2), (3, 3)], "all three would lead, and are made with further cases"
    assert [(trial.max_time, trial.failed_moves) for trial in ranked] == [(0.2, 1)] * 3


def test_what_the_chip_cannot_make_is_worse_than_all_that_it_can():
    told = Told(lambda k, case: (0.2, False))
    real, requested = told.planner.build_plan, []

    def plan(speeds, values, shape):
        requested.append(values)
        if len(requested) > 8:  # those before are asked for by the formula
            raise ArgumentError("too steep.")
        return real(speeds, values, shape)

    told.planner = SimpleNamespace(
        build_plan=plan,
        compute_speeds=told.planner.compute_speeds,
        ramp_shapes=told.planner.ramp_shapes,
        parameter_names=told.planner.parameter_names,
        find_parameters=told.planner.find_parameters,
    )
    ranked = told.search(16)
    made = [trial for trial in ranked if trial.plan is not None]
    none = [trial for trial in ranked if trial.plan is None]
    assert ranked == [*made, *none]
    assert none
    assert {(trial.max_time, trial.failed_moves) for trial in none} == {(2 * LIMIT, 1 + len(CASES))}
    assert {trial.failed_moves for trial in made} == {len(CASES)}


def test_trials_draw_their_parameters_from_minus_one_to_one(monkeypatch):
    told, drawn = Told(lambda k, case: (0.3, True)), []
    build_plan = told.planner.build_plan

    def build_recorded_plan(center, parameters, shape):
        drawn.extend(parameters.values())
        return build_plan(center, parameters, shape)

    monkeypatch.setattr(told.planner, "build_plan", build_recorded_plan)
    told.search(48)
    assert -1.0 <= min(drawn) < -0.9
    assert 0.9 < max(drawn) <= 1.0
