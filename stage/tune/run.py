"""`tune`: the formula, the search and the proof, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stage.arguments import told, whole_number
from stage.errors import ArgumentError, StageError
from stage.tune.formula import SAFETY
from stage.tune.looks import LOOK
from stage.tune.plans import Plan, Plans, plans_of
from stage.tune.proof import MOVES, gain, prove, spare
from stage.tune.result import Answer, Result
from stage.tune.search import Trial, horizon, optuna, search
from stage.tune.task import Task
from stage.tune.tries import Tries

WAYS = ("search", "formula")
CAREFUL = (1.0, 1.15, 1.3, 1.5, 2.0, 3.0)  # times the safety factor, until the formula keeps step
CANDIDATES = 8  # of a search, that are tried at once with moves that it has not seen; so many, and again, and
ROUNDS = 3  # again, until one passes all
MORE = 18  # cases of a trial that leads, beside those of every trial
GUARD = 1.25  # times the spare that was asked for is what the search keeps: the proof then finds less to object to
ANGLES = 2  # rotor angles of each payload, in a trial
SWINGING = (1.0, 4.0)  # times the time that a move takes by itself: what swings comes to rest late

Told = Callable[[str, float, float | None], None]
"""Progress: what is done, the part that is done, the best time so far, s."""


@told
def tune(
    task: Task,
    *,
    by: str = "search",
    trials: int = 200,
    seed: int = 0,
    workers: int | None = None,
    moves: int = MOVES,
    told: Told = lambda what, part, best: None,
) -> Result:
    """Find the registers of a move, and prove them.

    Args:
        by: "search", which begins at the formula; or "formula" alone, which needs no Optuna.
        trials: of the search. moves: of a proof. workers: threads; the result does not depend on them.
        told: is called as the work goes on.
    Raises ArgumentError: a payload that the motor does not move, a number out of range; StageError: Optuna is missing, or no
        registers keep step.
    """
    if by not in WAYS:
        raise ArgumentError(f"by={by!r}: search or formula.")
    whole_number("trials", trials, 1)
    whole_number("moves", moves, 1)
    if workers is not None:
        whole_number("workers", workers, 1)
    whole_number("seed", seed, 0)
    if by == "search":
        optuna()
    plans = plans_of(task)
    *streams, ladder = np.random.SeedSequence(seed).spawn(5)
    searched, leading, again, proved = (np.random.default_rng(s) for s in streams)
    with Tries(task, plans, workers) as tries:
        told("the formula", 0.0, None)
        safety, plan, limit = _formula(tries, plans, task.corners(searched, ANGLES))
        ranked: list[Trial] = []
        stopped = False
        if by == "search":
            ranked, stopped = search(
                tries, task.corners(searched, ANGLES, GUARD), task.drawn(leading, MORE, GUARD), limit, trials, seed, safety,
                lambda done, best: told(
                    "searching", min(done / trials, 1.0), best.worst if best is not None and not best.broken else None
                ),
            )  # fmt: skip
        told("the proof", 0.0, None)
        proof = task.drawn(proved, moves)
        answers = [_answer(tries, "formula", plan, proof, limit, ladder)]
        unseen = task.drawn(again, max(moves // 2, 1))
        failed = 0
        fine = [trial for trial in ranked if trial.plan is not None and not trial.broken]
        for k in range(0, min(len(fine), ROUNDS * CANDIDATES), CANDIDATES):
            some = fine[k : k + CANDIDATES]
            enough = horizon(max(trial.worst for trial in some), task.hold)
            held, out = _once_more(tries, [trial.plan for trial in some if trial.plan is not None], unseen, enough)
            failed += out
            for candidate in held:
                tried = _answer(tries, "search", candidate, proof, enough, ladder)
                if tried.holds:
                    answers.append(tried)
                    break
                failed += 1
            if len(answers) > 1:
                break
        by_formula = answers[0]
        if not by_formula.holds and len(answers) == 1:
            more = "let it search (--by search)" if by == "formula" else "search longer (--trials)"
            raise StageError(
                f"no registers are proved with up to {task.most:.3g} kg: a proof wants every move good. Of the formula's "
                f"{by_formula.proof.said()}. Ask for less payload or spare, give more room (--settle, --overshoot), or {more}."
            )
        won = "search" if len(answers) > 1 and _better(*answers) else "formula"
        told("the proof", 1.0, None)
        return Result(task, plans, tuple(answers), won, safety, by, len(ranked), stopped, failed, seed, tries.made)


def _formula(tries: Tries, plans: Plans, cases: Any) -> tuple[float, Plan, float]:
    """The formula's plan with the least safety factor that keeps step in these cases; and how long a move is looked at, s."""
    task = tries.task
    asked: Any = task.asked(cases)
    last: Exception | None = None
    for times in CAREFUL:
        try:
            plan = plans.formula(SAFETY * times)
        except ArgumentError as error:
            last = error
            break
        s = plan.speeds
        most = 2.0 * (task.pulses / s.drive + s.up + s.down) + 0.3 + task.hold
        for patience in SWINGING:
            outcome = tries.make([plan], cases, patience * most)
            if outcome.good(task, asked).all():
                worst = float(np.max(outcome.arrived[0, asked]))
                return SAFETY * times, plan, horizon(worst, task.hold)
            if not outcome.kept.all():
                break
    if last is not None and times == CAREFUL[0]:
        raise last
    most_said = f"even with a safety factor of {SAFETY * times:g}"
    if not outcome.kept.all():
        raise StageError(
            f"axis {task.axis} with up to {task.most:g} kg: the formula's registers lose steps, {most_said}. "
            f"{_carries(tries, plans, cases)}"
        )
    if np.isnan(outcome.arrived[0, asked]).any():
        raise StageError(
            f"axis {task.axis}: the formula's moves keep step, but do not come to rest within {task.length(task.within or 0.0)} of "
            f"the goal in {SWINGING[-1] * most:.2g} s, {most_said}: give more room, --settle (within=, hold=)."
        )
    beyond = round(float(outcome.beyond[0, asked].max()), 7)
    raise StageError(
        f"axis {task.axis}: the formula's moves keep step, but go {task.length(beyond)} beyond the goal, {most_said}: "
        "allow more, --overshoot (overshoot=)."
    )


def _carries(tries: Tries, plans: Plans, cases: Any) -> str:
    """The largest payload of all with which the formula's registers keep step, in words."""
    task = tries.task
    plan = plans.formula(SAFETY)
    s = plan.speeds
    loads = np.linspace(0.0, task.most, 9)
    tried = [c._replace(payload=float(kg)) for kg in loads for c in cases[:: max(len(cases) // 4, 1)][:4]]
    kept = tries.make([plan], tried, 2.0 * (task.pulses / s.drive + s.up + s.down) + 0.3 + task.hold).kept
    fine: np.ndarray = np.all(kept.reshape(len(loads), -1), axis=1)
    if not fine[0]:
        return "Nor do they keep step with nothing on it: another motor, supply or distance."
    return f"Up to {loads[int(np.argmin(fine)) - 1]:.2g} kg in all they keep step: take less payload or spare."


def _once_more(tries: Tries, plans: list[Plan], cases: Any, limit: float) -> tuple[list[Plan], int]:
    """Those of a search's answers that keep step in moves that it has not seen, the fastest first; and how many do not."""
    tried = zip(plans, prove(tries, plans, cases, limit), strict=True)
    held = [plan for plan, proof in sorted(tried, key=lambda pair: pair[1].mean) if proof.holds]
    return held, len(plans) - len(held)


def _better(formula: Answer, found: Answer) -> bool:
    """Whether a search's answer beats the formula's by more than the proof can tell apart."""
    if not formula.holds:
        return True
    saved, error = gain(formula.proof, found.proof)
    return saved - error > LOOK


def _answer(tries: Tries, name: str, plan: Plan, cases: Any, limit: float, seed: np.random.SeedSequence) -> Answer:
    """A plan with its proof: the moves, and if it passes these, payloads one above the other, at the same rotor angles for all."""
    proof = prove(tries, [plan], cases, limit)[0]
    kg, more = spare(tries, plan, limit, np.random.default_rng(seed)) if proof.holds else (0.0, False)
    return Answer(name, plan, proof, kg, more, proof.holds and kg >= float(tries.task.spare or 0.0))
