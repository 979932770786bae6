"""The tuning procedure: formula, search and proof, one after the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError, StageError
from stage.support.argument_checks import check_integer, explain_arguments
from stage.tune.formula import SAFETY_FACTOR, FormulaChoice
from stage.tune.machine_tolerances import Machine, draw_machines
from stage.tune.move_runner import MoveRunner
from stage.tune.position_sampler import SAMPLE_INTERVAL_S
from stage.tune.proof import ANGLES_PER_PAYLOAD as SPARE_MACHINE_COUNT
from stage.tune.proof import DEFAULT_PROOF_MOVES, Proof, compute_time_saved, measure_spare_payload, prove_plans
from stage.tune.register_planners import MovePlan, MovePlanner, create_planner
from stage.tune.result import Answer, TuningResult
from stage.tune.search import Trial, compute_time_limit, import_optuna, search_registers
from stage.tune.task import MoveCase, Task

METHODS = ("search", "formula")
SAFETY_MULTIPLIERS = (1.0, 1.15, 1.3, 1.5, 2.0, 3.0)  # raise the safety factor until the formula keeps step
RATE_RATIOS = (0.7, 0.5, 0.35, 0.2, 0.1)  # then slow the move down, where gravity leaves no thrust for a larger factor
FORMULA_CHOICES = (
    *(FormulaChoice(SAFETY_FACTOR * multiplier, 1.0) for multiplier in SAFETY_MULTIPLIERS),
    *(FormulaChoice(SAFETY_FACTOR, ratio) for ratio in RATE_RATIOS),
)
"""Choices in the order in which they are tried, the fastest first."""
SLOWEST_CHOICES_TEXT = (
    f"even with a safety factor of {SAFETY_FACTOR * SAFETY_MULTIPLIERS[-1]:g}, or at {RATE_RATIOS[-1]:g} of the rates"
)
CANDIDATES_PER_ROUND = 8  # search results that are tested together with unseen moves
MAX_CANDIDATE_ROUNDS = 3
MAX_HARD_CASES = 6  # cases in which most of the failed trials failed: the others must pass them
MACHINE_POOL_SIZE = 4 * DEFAULT_PROOF_MOVES  # machines of which the weakest make the moves of the search
LEADER_CASE_COUNT = 18  # further cases for a trial that leads
SEARCH_PAYLOAD_MARGIN_FACTOR = (
    1.25  # the search keeps more than the margin, so that fewer of its results fail the proof
)
ANGLES_PER_PAYLOAD = 2  # rotor angles of each payload in a trial
SETTLING_TIME_FACTORS = (1.0, 4.0)  # multiples of the move's own duration: a swinging load settles late

ProgressCallback = Callable[[str, float, float | None], None]
"""Callback with the current phase, the completed fraction, and the best arrival time so far in s."""


@explain_arguments
def tune(
    task: Task,
    *,
    by: str = "search",
    trials: int = 200,
    seed: int = 0,
    workers: int | None = None,
    moves: int = DEFAULT_PROOF_MOVES,
    on_progress: ProgressCallback = lambda phase, fraction, best: None,
) -> TuningResult:
    """Find and prove the registers of a move.

    Args:
        task: Move to tune.
        by: "search", which starts from the formula, or "formula" alone, which does not need Optuna.
        trials: Number of trials of the search.
        seed: Seed of all random choices.
        workers: Number of threads. The result does not depend on it.
        moves: Number of moves of a proof, each by a machine that is drawn from the evidence (machines.py).
        on_progress: Called as the work proceeds.

    Returns:
        Proved registers of the formula and, if one passed the proof, of the search.

    Raises:
        ArgumentError: The motor cannot move the payload, or a number is out of range.
        StageError: Optuna is missing, or no registers keep step.
    """
    if by not in METHODS:
        raise ArgumentError(f"by={by!r}: search or formula.")
    check_integer("trials", trials, 1)
    check_integer("moves", moves, 1)
    if workers is not None:
        check_integer("workers", workers, 1)
    check_integer("seed", seed, 0)
    if by == "search":
        import_optuna()
    planner = create_planner(task)
    cases = _draw_cases(planner, seed, moves)
    with MoveRunner(task, planner, workers) as runner:
        on_progress("the formula", 0.0, None)
        choice, time_limit, formula_answer = _prove_formula(runner, planner, cases)
        answers, ranked, rejected, interrupted = [formula_answer], list[Trial](), 0, False
        if by == "search":
            ranked, interrupted = search_registers(
                runner, cases.search, cases.leading, time_limit, trials, seed, choice,
                lambda done, best: on_progress(
                    "searching",
                    min(done / trials, 1.0),
                    best.max_time if best is not None and not best.failed_moves else None,
                ),
            )  # fmt: skip
        on_progress("the proof", 0.0, None)
        best_answer, rejected = _prove_best(runner, ranked, cases)
        if best_answer is not None:
            answers.append(best_answer)
        elif not formula_answer.is_proved:
            advice = "let it search (--by search)" if by == "formula" else "search longer (--trials)"
            raise StageError(
                f"no registers are proved with up to {task.payload_with_margin:.3g} kg: a proof wants every drawn machine to be "
                f"good. Of the formula's {formula_answer.proof.describe()}."
                f"{_describe_strongest_failure(planner, cases.proof, formula_answer.proof)} "
                f"Ask for less payload or spare, give more room (--settle, --overshoot), or {advice}."
            )
        selected = "search" if best_answer is not None and _is_faster(*answers) else "formula"
        on_progress("the proof", 1.0, None)
        return TuningResult(
            task, planner, tuple(answers), selected, choice.safety_factor, by, len(ranked), interrupted, rejected, seed,
            runner.move_count, tuple(cases.proof),
        )  # fmt: skip


class ProofCases(NamedTuple):
    """All cases of one tuning, drawn before it begins.

    Attributes:
        formula: Cases that the formula's registers must pass, with the machines that have the least thrust.
        search: Cases of each trial, with such machines and more than the margin.
        leading: Further cases for a trial that would be the best so far.
        unseen: Cases for the best trials before their proof.
        proof: Cases of the proof, each with another machine.
        spare: Seed of the cases that measure the spare payload, and their machines: the weakest ones of the proof.
    """

    formula: list[MoveCase]
    search: list[MoveCase]
    leading: list[MoveCase]
    unseen: list[MoveCase]
    proof: list[MoveCase]
    spare: tuple[np.random.SeedSequence, list[Machine]]


def _draw_cases(planner: MovePlanner, seed: int, moves: int) -> ProofCases:
    """Draw the cases of a tuning and the machines that make the moves."""
    task, axis = planner.task, planner.axis
    *seeds, spare_seed, machine_seed = np.random.SeedSequence(seed).spawn(6)
    trial_rng, leader_rng, candidate_rng, proof_rng = (np.random.default_rng(s) for s in seeds)
    unseen_count = max(moves // 4, 1)
    draw = partial(draw_machines, axis, np.random.default_rng(machine_seed))
    weak, proving = sorted(draw(MACHINE_POOL_SIZE), key=planner.compute_thrust_left), draw(moves)
    weakest = sorted(proving, key=planner.compute_thrust_left)
    return ProofCases(
        task.build_corner_cases(trial_rng, ANGLES_PER_PAYLOAD, 1.0, weak),
        task.build_corner_cases(trial_rng, ANGLES_PER_PAYLOAD, SEARCH_PAYLOAD_MARGIN_FACTOR, weak),
        task.draw_cases(leader_rng, LEADER_CASE_COUNT, SEARCH_PAYLOAD_MARGIN_FACTOR, draw(LEADER_CASE_COUNT)),
        task.draw_cases(candidate_rng, unseen_count, 1.0, draw(unseen_count)),
        task.draw_cases(proof_rng, moves, 1.0, proving),
        (spare_seed, [weakest[k % moves] for k in range(SPARE_MACHINE_COUNT)]),
    )


def _prove_formula(runner: MoveRunner, planner: MovePlanner, cases: ProofCases) -> tuple[FormulaChoice, float, Answer]:
    """Make the formula's plan more careful until its registers pass the proof.

    Returns:
        Choice, time limit of the moves in s, and the answer, which is not proved if no choice suffices.
    """
    tested, proved = list(cases.formula), None
    while True:
        try:
            choice, plan, time_limit = _find_first_passing_formula_plan(runner, planner, tested)
        except StageError:
            if proved is None:
                raise
            return proved
        proved = choice, time_limit, _prove_answer(runner, "formula", plan, cases, time_limit)
        failed = [cases.proof[k] for k in proved[2].proof.failed]
        if not set(failed) - set(tested):
            return proved
        tested += failed


def _prove_best(runner: MoveRunner, ranked: Sequence[Trial], cases: ProofCases) -> tuple[Answer | None, int]:
    """Find the fastest trial of the search that passes the proof, and the number of faster ones that do not.

    The best trials are proved eight at a time. If all eight fail, the remaining trials must first pass the cases that these have
    failed.
    """
    left = [trial for trial in ranked if trial.plan is not None and not trial.failed_moves]
    rejected = 0
    for _ in range(MAX_CANDIDATE_ROUNDS):
        candidates, left = left[:CANDIDATES_PER_ROUND], left[CANDIDATES_PER_ROUND:]
        if not candidates:
            break
        time_limit = compute_time_limit(max(trial.max_time for trial in candidates), runner.task.hold)
        plans = [trial.plan for trial in candidates if trial.plan is not None]
        proofs = prove_plans(runner, plans, cases.unseen, time_limit)
        hard = [cases.unseen[k] for proof in proofs for k in proof.failed]
        for plan, proof in sorted(zip(plans, proofs, strict=True), key=lambda pair: pair[1].mean_time):
            if proof.is_passed:
                answer = _prove_answer(runner, "search", plan, cases, time_limit)
                if answer.is_proved:
                    return answer, rejected
                hard += [cases.proof[k] for k in answer.proof.failed]
            rejected += 1
        passing = _select_passing_trials(runner, left, [case for case, _ in Counter(hard).most_common(MAX_HARD_CASES)])
        left, rejected = passing, rejected + len(left) - len(passing)
    return None, rejected


def _select_passing_trials(runner: MoveRunner, trials: Sequence[Trial], cases: Sequence[MoveCase]) -> list[Trial]:
    """Return the trials whose plans pass these cases."""
    if not trials or not cases:
        return list(trials)
    time_limit = compute_time_limit(max(trial.max_time for trial in trials), runner.task.hold)
    outcomes = runner.run_moves([trial.plan for trial in trials if trial.plan is not None], cases, time_limit)
    good = outcomes.find_passed_moves(runner.task, runner.task.is_within_payload(list(cases)))
    return [trial for trial, passes in zip(trials, good, strict=True) if passes.all()]


def _describe_strongest_failure(planner: MovePlanner, cases: Sequence[MoveCase], proof: Proof) -> str:
    """Describe the machine with the most thrust among those that failed in a proof. The sentence begins with a space."""
    failed = [machine for k in proof.failed if (machine := cases[k].machine) is not None]
    if not failed:
        return ""
    return f" The strongest of those that failed has {max(failed, key=planner.compute_thrust_left)}."


def _estimate_time_limit(task: Task, plan: MovePlan) -> float:
    """Estimate generously how long a move takes, s."""
    speeds = plan.speeds
    return 2.0 * (task.pulses / speeds.drive + speeds.up + speeds.down) + 0.3 + task.hold


def _find_first_passing_formula_plan(
    runner: MoveRunner, planner: MovePlanner, cases: Any
) -> tuple[FormulaChoice, MovePlan, float]:
    """Find the first of FORMULA_CHOICES with which the formula's plan passes all cases.

    Args:
        runner: Runner of the task.
        planner: Planner of the task.
        cases: Cases to pass.

    Returns:
        Choice, plan, and time limit of its moves in s.

    Raises:
        ArgumentError: The motor is too weak for the formula.
        StageError: The moves lose steps, do not settle, or overshoot with every choice.
    """
    task = runner.task
    within_payload: Any = task.is_within_payload(cases)
    outcomes: Any = None
    for choice in FORMULA_CHOICES:
        try:
            plan = planner.build_formula_plan(*choice)
        except ArgumentError:
            if outcomes is None:
                raise
            continue
        time_limit = _estimate_time_limit(task, plan)
        for factor in SETTLING_TIME_FACTORS:
            outcomes = runner.run_moves([plan], cases, factor * time_limit)
            if outcomes.find_passed_moves(task, within_payload).all():
                max_time = float(np.max(outcomes.arrival_times[0, within_payload]))
                return choice, plan, compute_time_limit(max_time, task.hold)
            if not outcomes.in_step.all():
                break
    if not outcomes.in_step.all():
        raise StageError(
            f"axis {task.axis} with up to {task.payload_with_margin:g} kg: the formula's registers lose steps, "
            f"{SLOWEST_CHOICES_TEXT}. "
            f"{_describe_largest_payload(runner, planner, cases)}"
        )
    if np.isnan(outcomes.arrival_times[0, within_payload]).any():
        tolerance = task.format_length(task.tolerance or 0.0)
        raise StageError(
            f"axis {task.axis}: the formula's moves keep step, but do not come to rest within {tolerance} of the goal in "
            f"{SETTLING_TIME_FACTORS[-1] * time_limit:.2g} s, {SLOWEST_CHOICES_TEXT}: give more room, --settle (tolerance=, hold=)."
        )
    overshoot = round(float(outcomes.overshoots[0, within_payload].max()), 7)
    raise StageError(
        f"axis {task.axis}: the formula's moves keep step, but go {task.format_length(overshoot)} beyond the goal, "
        f"{SLOWEST_CHOICES_TEXT}: allow more, --overshoot (overshoot=)."
    )


def _describe_largest_payload(runner: MoveRunner, planner: MovePlanner, cases: Any) -> str:
    """Describe the largest payload with which the formula's registers keep step."""
    task = runner.task
    plan = planner.build_formula_plan(SAFETY_FACTOR)
    payloads = np.linspace(0.0, task.payload_with_margin, 9)
    few_cases = cases[:: max(len(cases) // 4, 1)][:4]
    load_cases = [case._replace(payload=float(kg)) for kg in payloads for case in few_cases]
    in_step = runner.run_moves([plan], load_cases, _estimate_time_limit(task, plan)).in_step
    passed: np.ndarray = np.all(in_step.reshape(len(payloads), -1), axis=1)
    if not passed[0]:
        return "Nor do they keep step with nothing on it: another motor, supply or distance."
    return f"Up to {payloads[int(np.argmin(passed)) - 1]:.2g} kg in all they keep step: take less payload or spare."


def _is_faster(formula: Answer, search: Answer) -> bool:
    """Check whether the search beats the formula by more than the proof can resolve."""
    if not formula.is_proved:
        return True
    saved, error = compute_time_saved(formula.proof, search.proof)
    return saved - error > SAMPLE_INTERVAL_S


def _prove_answer(runner: MoveRunner, name: str, plan: MovePlan, cases: ProofCases, time_limit: float) -> Answer:
    """Prove a plan and, if all moves pass, measure its spare payload. All plans get the same rotor angles from one seed."""
    proof = prove_plans(runner, [plan], cases.proof, time_limit)[0]
    seed, machines = cases.spare
    spare, is_lower_bound = 0.0, False
    if proof.is_passed:
        spare, is_lower_bound = measure_spare_payload(runner, plan, time_limit, np.random.default_rng(seed), machines)
    is_proved = proof.is_passed and spare >= float(runner.task.margin or 0.0)
    return Answer(name, plan, proof, spare, is_lower_bound, is_proved)
