"""Proof of a plan: moves of machines that the search has not seen, and the additional payload that these machines carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stage.tune.machine_tolerances import Machine
from stage.tune.move_runner import MoveRunner
from stage.tune.position_sampler import SAMPLE_INTERVAL_S
from stage.tune.register_planners import MovePlan
from stage.tune.task import MoveCase

DEFAULT_PROOF_MOVES = 96
PAYLOADS_PER_ROUND = 8  # payloads that are tested at once
ANGLES_PER_PAYLOAD = 6
MAX_MARGIN_FACTOR = 4  # heaviest tested payload, in margins; one of the steps is exactly the margin


@dataclass(frozen=True)
class Proof:
    """Results of the moves of one plan. Each move is made by another machine.

    Attributes:
        move_count: Number of moves.
        good_count: Number of moves that kept step and, up to the task's payload, arrived without excessive overshoot.
        arrival_times: Arrival times with up to the task's payload, s; NaN where a move did not arrive. All plans use the same
            order.
        max_overshoot: Largest distance beyond the goal, m.
        lost_step_count: Number of moves that did not keep step.
        failed: Indices of the moves that were not good.
    """

    move_count: int
    good_count: int
    arrival_times: np.ndarray
    max_overshoot: float
    lost_step_count: int = 0
    failed: tuple[int, ...] = ()

    def describe(self) -> str:
        """Describe in words how the moves ended."""
        unsettled = self.move_count - self.good_count - self.lost_step_count
        counts = {
            "were good": self.good_count,
            "did not keep step": self.lost_step_count,
            "did not come to rest at the goal": unsettled,
        }
        return f"{self.move_count} machines " + ", ".join(f"{n} {text}" for text, n in counts.items() if n)

    @property
    def is_passed(self) -> bool:
        """True if all moves kept step and those with up to the task's payload arrived without excessive overshoot."""
        return self.good_count == self.move_count

    @property
    def mean_time(self) -> float:
        """Mean arrival time of the proof's moves with up to the task's payload, s."""
        return float(np.mean(self.arrival_times))

    @property
    def max_time(self) -> float:
        """Longest arrival time of the proof's moves with up to the task's payload, s."""
        return float(np.max(self.arrival_times))


def prove_plans(
    runner: MoveRunner, plans: Sequence[MovePlan], cases: Sequence[MoveCase], time_limit: float
) -> list[Proof]:
    """Run the same moves with each plan.

    Args:
        runner: Runner of the task.
        plans: Plans to prove.
        cases: Cases that the search has not seen.
        time_limit: Observed time of a move, s.

    Returns:
        A proof for each plan.
    """
    outcomes = runner.run_moves(plans, cases, time_limit)
    within_payload = runner.task.is_within_payload(list(cases))
    good = outcomes.find_passed_moves(runner.task, within_payload)
    return [
        Proof(
            len(cases),
            int(good[k].sum()),
            outcomes.arrival_times[k][within_payload],
            float(outcomes.overshoots[k][within_payload].max()),
            int((~outcomes.in_step[k]).sum()),
            tuple(np.flatnonzero(~good[k]).tolist()),
        )
        for k in range(len(plans))
    ]


def measure_spare_payload(
    runner: MoveRunner,
    plan: MovePlan,
    time_limit: float,
    rng: np.random.Generator,
    machines: Sequence[Machine | None] = (None,) * ANGLES_PER_PAYLOAD,
) -> tuple[float, bool]:
    """Measure how much more than the payload a plan carries before it first loses a step.

    The first round covers the full range of payloads, the second one the step in which the first failure occurred.

    Args:
        runner: Runner of the task.
        plan: Plan to test.
        time_limit: Observed time of a move, s.
        rng: Source of the rotor angles.
        machines: Machines that make the moves with each payload; None: that of the task.

    Returns:
        Spare payload in kg, and True if nothing heavier was tested, so that the value is a lower bound.
    """
    task = runner.task
    low, high = 0.0, MAX_MARGIN_FACTOR * float(task.margin or 0.1 * (task.payload + task.moving_mass))
    for _ in range(2):
        spare_payloads = low + (high - low) / PAYLOADS_PER_ROUND * np.arange(1, PAYLOADS_PER_ROUND + 1)
        offsets = rng.uniform(-0.5, 0.5, (PAYLOADS_PER_ROUND, ANGLES_PER_PAYLOAD)) * task.pulses_per_electrical_turn
        cases = [
            MoveCase(task.payload + float(kg), float(offset), 1 - 2 * (j % 2), machine)
            for kg, row in zip(spare_payloads, offsets, strict=True)
            for j, (offset, machine) in enumerate(zip(row, machines, strict=True))
        ]
        in_step = runner.run_moves([plan], cases, time_limit).in_step
        passed = in_step.reshape(PAYLOADS_PER_ROUND, ANGLES_PER_PAYLOAD).all(axis=1)
        if passed.all():
            return high, low == 0.0
        first = int(np.argmin(passed))
        low, high = (low if first == 0 else float(spare_payloads[first - 1])), float(spare_payloads[first])
    return low, False


def compute_time_saved(formula: Proof, search: Proof) -> tuple[float, float]:
    """Compute how much faster the search's plan is than the formula's.

    Args:
        formula: Proof of the formula's plan.
        search: Proof of the search's plan, from the same moves.

    Returns:
        Mean time saved and twice its standard error, s.
    """
    saved = formula.arrival_times - search.arrival_times
    if len(saved) < 2:
        return float(np.mean(saved)), SAMPLE_INTERVAL_S
    return float(np.mean(saved)), float(2 * np.std(saved, ddof=1) / np.sqrt(len(saved)))
