"""`tune`: the formula, the search and the proof, one after the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError, StageError
from stage.support.arguments import told, whole_number
from stage.tune.formula import SAFETY
from stage.tune.looks import LOOK
from stage.tune.machines import Machine, draw_machines
from stage.tune.plans import Plan, Plans, plans_of
from stage.tune.proof import ANGLES as LADDER_MACHINES
from stage.tune.proof import MOVES, Proof, gain, prove, spare
from stage.tune.result import Answer, Result
from stage.tune.search import Trial, horizon, optuna, search
from stage.tune.task import Case, Task
from stage.tune.tries import Tries

WAYS = ("search", "formula")
CAREFUL = (1.0, 1.15, 1.3, 1.5, 2.0, 3.0)  # times the safety factor, until the formula keeps step
CANDIDATES = 8  # of a search, that are tried at once with moves that it has not seen; so many, and again, and
ROUNDS = 3  # again, until one passes all
HARD = 6  # moves in which most of those that failed did so: the others must be good in them
POOL = 4 * MOVES  # machines of which the weakest make the moves of the search
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
        trials: of the search. moves: of a proof, each by a machine that is drawn from the evidence (machines.py). workers: threads;
            the result does not depend on them.
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
    cases = _draw_cases(plans, seed, moves)
    with Tries(task, plans, workers) as tries:
        told("the formula", 0.0, None)
        safety, limit, by_formula = _prove_formula(tries, plans, cases)
        answers, ranked, failed, stopped = [by_formula], list[Trial](), 0, False
        if by == "search":
            ranked, stopped = search(
                tries, cases.search, cases.leading, limit, trials, seed, safety,
                lambda done, best: told(
                    "searching", min(done / trials, 1.0), best.worst if best is not None and not best.broken else None
                ),
            )  # fmt: skip
        told("the proof", 0.0, None)
        best, failed = _prove_best(tries, ranked, cases)
        if best is not None:
            answers.append(best)
        elif not by_formula.holds:
            more = "let it search (--by search)" if by == "formula" else "search longer (--trials)"
            raise StageError(
                f"no registers are proved with up to {task.most:.3g} kg: a proof wants every drawn machine to be good. Of the "
                f"formula's {by_formula.proof.said()}.{_describe_failed(plans, cases.proof, by_formula.proof)} "
                f"Ask for less payload or spare, give more room (--settle, --overshoot), or {more}."
            )
        won = "search" if best is not None and _better(*answers) else "formula"
        told("the proof", 1.0, None)
        return Result(
            task,
            plans,
            tuple(answers),
            won,
            safety,
            by,
            len(ranked),
            stopped,
            failed,
            seed,
            tries.made,
            tuple(cases.proof),
        )


class Cases(NamedTuple):
    """The moves of a run, all drawn before it begins.

    Attributes:
        formula: Moves that the formula's registers must keep, by machines that are hardly able to.
        search: Moves of each trial, likewise, with more than the spare.
        leading: Further moves of a trial that would be the best so far.
        unseen: Moves of the best trials, before the proof.
        proof: Moves of the proof, each by another machine.
        ladder: Seed of the moves with payloads one above the other, and the machines that make them, the weakest of the proof.
    """

    formula: list[Case]
    search: list[Case]
    leading: list[Case]
    unseen: list[Case]
    proof: list[Case]
    ladder: tuple[np.random.SeedSequence, list[Machine]]


def _draw_cases(plans: Plans, seed: int, moves: int) -> Cases:
    """Draw the moves of a run and the machines that make them."""
    task, axis = plans.task, plans.axis
    *streams, ladder, machines = np.random.SeedSequence(seed).spawn(6)
    searched, leading, again, proved = (np.random.default_rng(s) for s in streams)
    few = max(moves // 4, 1)
    draw = partial(draw_machines, axis, np.random.default_rng(machines))
    weak, proving = sorted(draw(POOL), key=plans.compute_thrust_left), draw(moves)
    weakest = sorted(proving, key=plans.compute_thrust_left)
    return Cases(
        task.corners(searched, ANGLES, 1.0, weak),
        task.corners(searched, ANGLES, GUARD, weak),
        task.drawn(leading, MORE, GUARD, draw(MORE)),
        task.drawn(again, few, 1.0, draw(few)),
        task.drawn(proved, moves, 1.0, proving),
        (ladder, [weakest[k % moves] for k in range(LADDER_MACHINES)]),
    )


def _prove_formula(tries: Tries, plans: Plans, cases: Cases) -> tuple[float, float, Answer]:
    """Raise the formula's safety factor until its registers pass the proof. Returns the factor, how long moves are looked at (s),
    and the answer; it does not hold where no factor helps."""
    tried, proved = list(cases.formula), None
    while True:
        try:
            safety, plan, limit = _formula(tries, plans, tried)
        except StageError:
            if proved is None:
                raise
            return proved
        proved = safety, limit, _answer(tries, "formula", plan, cases, limit)
        failed = [cases.proof[k] for k in proved[2].proof.failed]
        if not set(failed) - set(tried):
            return proved
        tried += failed


def _prove_best(tries: Tries, ranked: Sequence[Trial], cases: Cases) -> tuple[Answer | None, int]:
    """Find the fastest of a search's trials that passes the proof; and how many faster ones do not.

    The best are proved eight at a time. Where all of these fail, those of the others remain that keep step in the moves which they
    failed.
    """
    left = [trial for trial in ranked if trial.plan is not None and not trial.broken]
    out = 0
    for _ in range(ROUNDS):
        some, left = left[:CANDIDATES], left[CANDIDATES:]
        if not some:
            break
        enough = horizon(max(trial.worst for trial in some), tries.task.hold)
        plans = [trial.plan for trial in some if trial.plan is not None]
        proofs = prove(tries, plans, cases.unseen, enough)
        hard = [cases.unseen[k] for proof in proofs for k in proof.failed]
        for plan, proof in sorted(zip(plans, proofs, strict=True), key=lambda pair: pair[1].mean):
            if proof.holds:
                answer = _answer(tries, "search", plan, cases, enough)
                if answer.holds:
                    return answer, out
                hard += [cases.proof[k] for k in answer.proof.failed]
            out += 1
        passing = _select(tries, left, [case for case, _ in Counter(hard).most_common(HARD)])
        left, out = passing, out + len(left) - len(passing)
    return None, out


def _select(tries: Tries, trials: Sequence[Trial], cases: Sequence[Case]) -> list[Trial]:
    """Select the trials whose moves are good in these cases, too."""
    if not trials or not cases:
        return list(trials)
    limit = horizon(max(trial.worst for trial in trials), tries.task.hold)
    outcome = tries.make([trial.plan for trial in trials if trial.plan is not None], cases, limit)
    good = outcome.good(tries.task, tries.task.asked(list(cases)))
    return [trial for trial, passes in zip(trials, good, strict=True) if passes.all()]


def _describe_failed(plans: Plans, cases: Sequence[Case], proof: Proof) -> str:
    """Describe, of the machines that failed in a proof, the one with the most thrust, in a sentence with a blank before it."""
    failed = [machine for k in proof.failed if (machine := cases[k].machine) is not None]
    if not failed:
        return ""
    return f" The strongest of those that failed has {max(failed, key=plans.compute_thrust_left)}."


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


def _better(formula: Answer, found: Answer) -> bool:
    """Whether a search's answer beats the formula's by more than the proof can tell apart."""
    if not formula.holds:
        return True
    saved, error = gain(formula.proof, found.proof)
    return saved - error > LOOK


def _answer(tries: Tries, name: str, plan: Plan, cases: Cases, limit: float) -> Answer:
    """Prove a plan: the moves of the proof, and if it passes these, payloads one above the other, at the same angles for all."""
    proof = prove(tries, [plan], cases.proof, limit)[0]
    seed, machines = cases.ladder
    kg, more = spare(tries, plan, limit, np.random.default_rng(seed), machines) if proof.holds else (0.0, False)
    return Answer(name, plan, proof, kg, more, proof.holds and kg >= float(tries.task.spare or 0.0))
