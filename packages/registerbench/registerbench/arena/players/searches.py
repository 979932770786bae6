"""Players that search within an episode of several tries: one rate at a time, and Optuna as a user of tools.

A try is judged by what a host knows: it kept step by the encoder, and took so long. Where a task has one try there is nothing to
search, and they do what the formula does; so they do in tasks whose actions are no numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from registerbench.arena.players.simple import formula
from registerbench.arena.table import Table
from stage.support.extras import need

NUMBERS = ("start", "drive", "up", "down")
FASTER = {"drive": 1.15, "up": 0.85, "down": 0.85, "start": 1.2}
"""By how much each is changed at first, towards a shorter move."""
SPAN = 2.0  # Optuna draws from the formula's number / SPAN to times SPAN


def _has_several_tries(table: Table) -> bool:
    """Return whether an episode is several tries at a move."""
    act = next((t for t in table.tools if t["name"] == "act"), None)
    return act is not None and tuple(act["parameters"]["properties"]) == NUMBERS and table.name.startswith("few-shot")


def _cost(answer: Any) -> float:
    """Return the cost of a try: its seconds, or more than any time where it lost step by the encoder."""
    info, observation = answer.data["info"], answer.data["observation"]
    kept = [k for k, made in zip(observation["kept"], observation["tried"], strict=True) if made > 0][-1]
    return float(info["duration"]) if kept > 0 else 10.0 * float(info["usual"])


def _limits(table: Table) -> dict[str, tuple[float, float]]:
    act = next(t for t in table.tools if t["name"] == "act")
    return {name: (p["minimum"], p["maximum"]) for name, p in act["parameters"]["properties"].items()}


def coordinate(table: Table) -> None:
    """Change one rate or ramp at a time, from the formula on: further as long as it pays, else half the step back."""
    if not _has_several_tries(table):
        formula(table)
        return
    limits, steps, turn = _limits(table), dict(FASTER), list(FASTER)
    best = table.call("formula").data
    answer = table.call("act", best)
    cost = _cost(answer)
    while not table.over:
        name = turn[0]
        wanted = {**best, name: float(np.clip(best[name] * steps[name], *limits[name]))}
        answer = table.call("act", wanted)
        if not answer.ok:
            return
        if (now := _cost(answer)) < cost:
            best, cost = wanted, now
        else:
            steps[name] = float(np.sqrt(steps[name]))
        turn.append(turn.pop(0))


def optuna(table: Table) -> None:
    """Optuna's TPE around the formula, which it tries first."""
    if not _has_several_tries(table):
        formula(table)
        return
    library = need("optuna", "the player optuna")
    library.logging.set_verbosity(library.logging.WARNING)
    first, limits = table.call("formula").data, _limits(table)
    sampler = library.samplers.TPESampler(seed=sum(table.name.encode()), n_startup_trials=3)
    study = library.create_study(sampler=sampler)
    study.enqueue_trial(first)
    while not table.over:
        trial = study.ask()
        wanted = {}
        for name in NUMBERS:
            low, high = (float(np.clip(first[name] * f, *limits[name])) for f in (1 / SPAN, SPAN))
            wanted[name] = trial.suggest_float(name, low, high, log=True)
        answer = table.call("act", wanted)
        if not answer.ok:
            return
        study.tell(trial, _cost(answer))
