"""Search for faster registers: Optuna varies rates and ramps around the formula and minimizes the arrival time.

Trials run in batches of a fixed size, and the measurements of a trial do not depend on its neighbors. A seed therefore gives
the same search with any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError
from stage.support.extras import import_extra
from stage.tune.formula import FormulaChoice
from stage.tune.move_runner import MoveRunner
from stage.tune.position_sampler import SAMPLE_INTERVAL_S
from stage.tune.register_planners import MovePlan, MovePlanner
from stage.tune.task import MoveCase

BATCH_SIZE = 8
INITIAL_SAFETY_RATIOS = (0.9, 0.8, 0.7)  # parts of the formula's safety factor for the first trials
TIME_LIMIT_FACTOR = 1.3


def compute_time_limit(max_time: float, hold: float) -> float:
    """Compute how long to observe moves that should be about as fast as a known one.

    Args:
        max_time: Longest arrival time of the known plan, s.
        hold: Time that a move must stay at its goal, s.

    Returns:
        Time limit in whole sample intervals, s.
    """
    return float(np.ceil((TIME_LIMIT_FACTOR * max_time + hold) / SAMPLE_INTERVAL_S) * SAMPLE_INTERVAL_S)


class Trial(NamedTuple):
    """Result of one trial of the search.

    Attributes:
        number: Number that Optuna gave it.
        plan: Plan, or None if the values do not fit the chip's registers.
        max_time: Longest arrival time within the payload, s.
        failed_moves: Number of moves that lost steps, did not arrive or overshot. Without a plan, more than all moves.
    """

    number: int
    plan: MovePlan | None
    max_time: float
    failed_moves: int


def import_optuna() -> Any:
    """Import Optuna.

    Raises:
        ExtraMissing: Optuna is not installed. The message says how to install it.
    """
    optuna = import_extra("optuna", "the search", "; or leave it at the formula: --by formula")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def search_registers(
    runner: MoveRunner,
    cases: Sequence[MoveCase],
    leader_cases: Sequence[MoveCase],
    time_limit: float,
    trials: int,
    seed: int,
    choice: FormulaChoice = FormulaChoice(),  # noqa: B008 (immutable)
    on_progress: Callable[[int, Trial | None], None] = lambda done, best: None,
) -> tuple[list[Trial], bool]:
    """Search for the plan with the shortest arrival time of which no move fails.

    Args:
        runner: Runner of the task.
        cases: Cases of every trial.
        leader_cases: Further cases for trials that would be the best so far, because a few cases also pass by luck.
        time_limit: Observed time of a move, s. It shrinks as the best trial gets faster.
        trials: Number of trials.
        seed: Seed of the sampler.
        choice: Choice of the formula's plan at the center of the search.
        on_progress: Called after each batch with the number of trials and the best trial so far.

    Returns:
        Trials with the best one first, and whether Ctrl-C ended the search early.
    """
    study = _create_study(seed)
    planner: MovePlanner = runner.planner
    center = planner.compute_speeds(*choice)
    study.enqueue_trial({})
    for shape in planner.ramp_shapes:
        study.enqueue_trial(_build_trial_parameters(planner, {}, shape))
        for ratio in INITIAL_SAFETY_RATIOS:
            faster = planner.compute_speeds(choice.safety_factor * ratio, choice.rate_ratio)
            study.enqueue_trial(_build_trial_parameters(planner, planner.find_parameters(center, faster), shape))
    finished: list[Trial] = []
    best_time = float("inf")
    interrupted = False
    try:
        while len(finished) < trials:
            batch = [study.ask() for _ in range(min(BATCH_SIZE, trials - len(finished)))]
            time_limit = min(time_limit, compute_time_limit(best_time, runner.task.hold))
            results = _measure_plans(
                runner, [_suggest_plan(planner, trial, center) for trial in batch], cases, time_limit
            )
            leaders = [k for k, trial in enumerate(results) if not trial.failed_moves and trial.max_time < best_time]
            leader_plans = [results[k].plan for k in leaders] if leader_cases else []
            retests = _measure_plans(runner, leader_plans, leader_cases, time_limit)
            for k, retest in zip(leaders, retests, strict=False):
                results[k] = retest._replace(max_time=max(results[k].max_time, retest.max_time))
            for trial, result in zip(batch, results, strict=True):
                trial.set_constraint("broken", result.failed_moves)
                study.tell(trial, result.max_time)
                finished.append(result._replace(number=trial.number))
            best_time = min([best_time, *(result.max_time for result in results if not result.failed_moves)])
            on_progress(len(finished), _rank_trials(finished)[0])
    except KeyboardInterrupt:
        interrupted = True
    return _rank_trials(finished), interrupted


def _measure_plans(
    runner: MoveRunner, plans: Sequence[MovePlan | None], cases: Sequence[MoveCase], time_limit: float
) -> list[Trial]:
    """Run a trial of each plan. A plan of None, which the chip cannot execute, counts as having more failures than any other."""
    possible = [plan for plan in plans if plan is not None]
    within_payload = runner.task.is_within_payload(list(cases))
    measured: list[Trial] = []
    if possible:
        outcomes = runner.run_moves(possible, cases, time_limit)
        failures = (~outcomes.find_passed_moves(runner.task, within_payload)).sum(axis=1)
        times = np.where(np.isnan(outcomes.arrival_times), 1.5 * time_limit, outcomes.arrival_times)
        max_times = times[:, within_payload].max(axis=1)
        measured = [
            Trial(0, plan, float(time), int(failed))
            for plan, time, failed in zip(possible, max_times, failures, strict=True)
        ]
    remaining = iter(measured)
    return [Trial(0, None, 2 * time_limit, 1 + len(cases)) if plan is None else next(remaining) for plan in plans]


def _create_study(seed: int) -> Any:
    """Create the Optuna study of a search."""
    optuna = import_optuna()
    sampler = optuna.samplers.TPESampler(n_startup_trials=16, multivariate=True, seed=seed)
    return optuna.create_study(sampler=sampler)


def _build_trial_parameters(planner: MovePlanner, values: dict[str, float], shape: str) -> dict[str, Any]:
    """Return all parameters of an Optuna trial, with the ramp shape if the chip offers a choice."""
    parameters: dict[str, Any] = {name: values.get(name, 0.0) for name in planner.parameter_names}
    return parameters | ({"shape": shape} if len(planner.ramp_shapes) > 1 else {})


def _suggest_plan(planner: MovePlanner, trial: Any, center: Any) -> MovePlan | None:
    """Build the plan that Optuna suggests, or return None if it does not fit the chip's registers."""
    values = {name: trial.suggest_float(name, -1.0, 1.0) for name in planner.parameter_names}
    shapes = planner.ramp_shapes
    shape = trial.suggest_categorical("shape", shapes) if len(shapes) > 1 else shapes[0]
    try:
        return planner.build_plan(center, values, shape)
    except ArgumentError:
        return None


def _rank_trials(trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials in the order of failed moves, then of arrival time."""
    return sorted(trials, key=lambda trial: (trial.failed_moves, trial.max_time, trial.number))
