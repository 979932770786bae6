"""Players that search for good rates over the attempts of an episode: coordinate search, and Optuna.

They judge an attempt by what a host can observe: whether the encoder shows lost steps, and how long the move took. In tasks
with one attempt, or whose actions are not rates, they do what the formula does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from registerbench.arena.game_session import GameSession
from registerbench.arena.players.formula_and_random import play_formula
from stage.support.extras import import_extra

MOVE_ARGUMENTS = ("start", "drive", "up", "down")
FASTER_FACTORS = {"drive": 1.15, "up": 0.85, "down": 0.85, "start": 1.2}
"""Factor by which each argument is first changed, towards a shorter move."""
SEARCH_SPAN = 2.0  # Optuna searches from 1 / 2 to 2 times the value of the formula


def _has_several_attempts(session: GameSession) -> bool:
    """Return whether an episode consists of several attempts at a move."""
    act = next((t for t in session.tools if t["name"] == "act"), None)
    return (
        act is not None
        and tuple(act["parameters"]["properties"]) == MOVE_ARGUMENTS
        and session.name.startswith("few-shot")
    )


def _compute_cost(answer: Any) -> float:
    """Return the cost of an attempt: its seconds, or ten times the usual seconds if the encoder shows lost steps."""
    info, observation = answer.data["info"], answer.data["observation"]
    shown_in_step = [k for k, is_made in zip(observation["kept"], observation["tried"], strict=True) if is_made > 0][-1]
    return float(info["duration"]) if shown_in_step > 0 else 10.0 * float(info["usual"])


def _get_argument_limits(session: GameSession) -> dict[str, tuple[float, float]]:
    """Return the minimum and maximum of each argument of `act`."""
    act = next(t for t in session.tools if t["name"] == "act")
    return {name: (p["minimum"], p["maximum"]) for name, p in act["parameters"]["properties"].items()}


def search_by_coordinate(session: GameSession) -> None:
    """Search one rate or ramp at a time, beginning at the formula: a step further while it pays, then smaller steps."""
    if not _has_several_attempts(session):
        play_formula(session)
        return
    limits, steps, turn = _get_argument_limits(session), dict(FASTER_FACTORS), list(FASTER_FACTORS)
    best = session.call("formula").data
    answer = session.call("act", best)
    cost = _compute_cost(answer)
    while not session.over:
        name = turn[0]
        wanted = {**best, name: float(np.clip(best[name] * steps[name], *limits[name]))}
        answer = session.call("act", wanted)
        if not answer.ok:
            return
        if (now := _compute_cost(answer)) < cost:
            best, cost = wanted, now
        else:
            steps[name] = float(np.sqrt(steps[name]))
        turn.append(turn.pop(0))


def search_by_optuna(session: GameSession) -> None:
    """Search by Optuna's tree-structured Parzen estimator (TPE) around the formula, which is its first attempt."""
    if not _has_several_attempts(session):
        play_formula(session)
        return
    library = import_extra("optuna", "the player optuna")
    library.logging.set_verbosity(library.logging.WARNING)
    first, limits = session.call("formula").data, _get_argument_limits(session)
    sampler = library.samplers.TPESampler(seed=sum(session.name.encode()), n_startup_trials=3)
    study = library.create_study(sampler=sampler)
    study.enqueue_trial(first)
    while not session.over:
        trial = study.ask()
        wanted = {}
        for name in MOVE_ARGUMENTS:
            low, high = (float(np.clip(first[name] * f, *limits[name])) for f in (1 / SEARCH_SPAN, SEARCH_SPAN))
            wanted[name] = trial.suggest_float(name, low, high, log=True)
        answer = session.call("act", wanted)
        if not answer.ok:
            return
        study.tell(trial, _compute_cost(answer))
