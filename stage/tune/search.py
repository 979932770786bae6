"""The search: Optuna chooses rates and ramps around the formula's; least time until arrived, no step lost with the margin.

Trials are made in batches of a fixed size, and what a trial measures does not depend on who else runs: so a seed gives the same
search, whatever the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError
from stage.support.extras import need
from stage.tune.formula import SAFETY
from stage.tune.looks import LOOK
from stage.tune.plans import Plan, Plans
from stage.tune.task import Case
from stage.tune.tries import Tries

BATCH = 8
BOLDER = (0.9, 0.8, 0.7)  # of the formula's safety factor: tried first


PATIENCE = 1.3


def horizon(worst: float, hold: float) -> float:
    """s, how long moves are looked at that are to be about as fast as one that takes `worst` s: PATIENCE times that."""
    return float(np.ceil((PATIENCE * worst + hold) / LOOK) * LOOK)


class Trial(NamedTuple):
    """One that was made. worst: s, the longest of the moves with up to the payload; broken: moves that lost steps, did not
    arrive or went too far, and more where the chip cannot make them at all."""

    number: int
    plan: Plan | None
    worst: float
    broken: int


def optuna() -> Any:
    """Optuna. Raises ExtraMissing that says how to get it."""
    optuna = need("optuna", "the search", "; or leave it at the formula: --by formula")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def search(
    tries: Tries,
    cases: Sequence[Case],
    more: Sequence[Case],
    limit: float,
    trials: int,
    seed: int,
    safety: float = SAFETY,
    told: Callable[[int, Trial | None], None] = lambda done, best: None,
) -> tuple[list[Trial], bool]:
    """Make so many trials, of each the same cases. Returns the trials, the best first, and whether Ctrl-C has ended it early.

    more: further cases for those alone that would be the best so far: few cases let through what keeps step by luck.
    limit: s, how long a move is looked at, and less as the best gets faster; what takes longer has not arrived. told: called after
    each batch with the number of trials and the best so far.
    """
    study = _study(seed)
    plans: Plans = tries.plans
    middle = plans.speeds(safety)
    study.enqueue_trial({})
    for shape in plans.shapes:
        study.enqueue_trial(_named(plans, {}, shape))
        for part in BOLDER:
            study.enqueue_trial(_named(plans, plans.towards(middle, plans.speeds(safety * part)), shape))
    made: list[Trial] = []
    best = float("inf")
    stopped = False
    try:
        while len(made) < trials:
            batch = [study.ask() for _ in range(min(BATCH, trials - len(made)))]
            limit = min(limit, horizon(best, tries.task.hold))
            found = _measured(tries, [_plan(plans, trial, middle) for trial in batch], cases, limit)
            leading = [k for k, trial in enumerate(found) if not trial.broken and trial.worst < best]
            once_more = _measured(tries, [found[k].plan for k in leading] if more else [], more, limit)
            for k, again in zip(leading, once_more, strict=False):
                found[k] = again._replace(worst=max(found[k].worst, again.worst))
            for trial, one in zip(batch, found, strict=True):
                trial.set_constraint("broken", one.broken)
                study.tell(trial, one.worst)
                made.append(one._replace(number=trial.number))
            best = min([best, *(one.worst for one in found if not one.broken)])
            told(len(made), _ranked(made)[0])
    except KeyboardInterrupt:
        stopped = True
    return _ranked(made), stopped


def _measured(tries: Tries, plans: Sequence[Plan | None], cases: Sequence[Case], limit: float) -> list[Trial]:
    """A trial of each plan; None is one that the chip cannot make."""
    real = [plan for plan in plans if plan is not None]
    asked = tries.task.asked(list(cases))
    made: list[Trial] = []
    if real:
        outcome = tries.make(real, cases, limit)
        broken = (~outcome.good(tries.task, asked)).sum(axis=1)
        times = np.where(np.isnan(outcome.arrived), 1.5 * limit, outcome.arrived)[:, asked].max(axis=1)
        made = [Trial(0, plan, float(t), int(b)) for plan, t, b in zip(real, times, broken, strict=True)]
    left = iter(made)
    return [Trial(0, None, 2 * limit, 1 + len(cases)) if plan is None else next(left) for plan in plans]


def _study(seed: int) -> Any:
    library = optuna()
    sampler = library.samplers.TPESampler(n_startup_trials=16, multivariate=True, seed=seed)
    return library.create_study(sampler=sampler)


def _named(plans: Plans, values: dict[str, float], shape: str) -> dict[str, Any]:
    """Values as an Optuna trial has them: all of them, and the shape where there is a choice."""
    return {name: values.get(name, 0.0) for name in plans.knobs} | ({"shape": shape} if len(plans.shapes) > 1 else {})


def _plan(plans: Plans, trial: Any, middle: Any) -> Plan | None:
    values = {name: trial.suggest_float(name, -1.0, 1.0) for name in plans.knobs}
    shape = trial.suggest_categorical("shape", plans.shapes) if len(plans.shapes) > 1 else plans.shapes[0]
    try:
        return plans.plan(middle, values, shape)
    except ArgumentError:
        return None


def _ranked(made: Sequence[Trial]) -> list[Trial]:
    return sorted(made, key=lambda trial: (trial.broken, trial.worst, trial.number))
