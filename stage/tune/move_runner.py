"""Runs test moves with any registers on many copies of the machine at once, and measures each move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stage.sim.fleet import Fleet
from stage.sim.program import Program
from stage.tune.position_sampler import SAMPLE_INTERVAL_S, PositionSampler
from stage.tune.register_planners import MovePlan, MovePlanner
from stage.tune.task import MoveCase, Task

DEFAULT_FLEET_SIZE = 48


class MoveOutcomes(NamedTuple):
    """Measurements of test moves, each an array of shape (plans, cases).

    Attributes:
        arrival_times: Time from the start command until arrival, s; NaN where the move did not arrive.
        in_step: True where all pulses were made and no step was lost (of a servo: where the move arrived).
        overshoots: Largest distance beyond the goal, m.
    """

    arrival_times: np.ndarray
    in_step: np.ndarray
    overshoots: np.ndarray

    def find_passed_moves(self, task: Task, within_payload: np.ndarray) -> np.ndarray:
        """Return which moves kept step and, unless their payload includes the margin, arrived without excessive overshoot.

        Args:
            task: Task with the overshoot limit.
            within_payload: Mask of the cases without additional mass, which must arrive; the others must only keep step.

        Returns:
            Mask (plans, cases).
        """
        arrived = ~np.isnan(self.arrival_times) & (self.overshoots <= float(task.overshoot or 0.0))
        return self.in_step & (arrived | ~within_payload)


class MoveRunner:
    """Runner of test moves on a fleet of copies of the task's machine.

    The results depend neither on the size of the fleet nor on the number of threads.

    Attributes:
        move_count: Number of moves run so far.
    """

    def __init__(
        self, task: Task, planner: MovePlanner, workers: int | None = None, fleet_size: int = DEFAULT_FLEET_SIZE
    ):
        self.task, self.planner = task, planner
        self.fleet = Fleet([task.copy_stage() for _ in range(fleet_size)], workers)
        self.sampler = PositionSampler(task)
        self.axis_index = task.stage.axes[task.axis].index
        self.power_up_state = task.stage.snapshot()
        self.move_count = 0

    def run_moves(self, plans: Sequence[MovePlan], cases: Sequence[MoveCase], time_limit: float) -> MoveOutcomes:
        """Run each plan in each case.

        Args:
            plans: Plans to test.
            cases: Conditions of the moves.
            time_limit: Observed time after the start command, s.

        Returns:
            Measurements, (plans, cases).
        """
        pairs = [(plan, case) for plan in plans for case in cases]
        size = len(self.fleet)
        batches = [self._run_batch(pairs[k : k + size], time_limit) for k in range(0, len(pairs), size)]
        self.move_count += len(pairs)
        shape = len(plans), len(cases)
        return MoveOutcomes(*(np.concatenate(column).reshape(shape) for column in zip(*batches, strict=True)))

    def _run_batch(self, pairs: Sequence[tuple[MovePlan, MoveCase]], time_limit: float) -> tuple[np.ndarray, ...]:
        """Run at most one move on each stage of the fleet."""
        samples, task, sampler = round(time_limit / SAMPLE_INTERVAL_S), self.task, self.sampler
        goals, move_ops = [], []
        for stage, (plan, case) in zip(self.fleet.stages, pairs, strict=False):
            stage.restore(self.power_up_state)
            goals.append(sampler.place_at_start(stage, case))
            program = Program()
            self.planner.write_move(program, plan, task.pulses * case.direction)
            move_ops.append(program.ops)
        sample_ops = sampler.build_ops(samples)
        ops = np.zeros((len(self.fleet), max(map(len, move_ops)) + len(sample_ops), 4), np.int64)
        for row, head in zip(ops, move_ops, strict=False):
            row[: len(head)] = head
            row[len(head) : len(head) + len(sample_ops)] = sample_ops
        played = self.fleet.play(ops)
        results = np.stack([played.results[k, len(h) : len(h) + len(sample_ops)] for k, h in enumerate(move_ops)])
        distances, overshoots = sampler.compute_errors(results, np.array(goals))
        directions = np.array([case.direction for _, case in pairs])
        outside = distances > float(task.tolerance or 0.0)
        # Samples until the position stays within the tolerance.
        arrival = np.where(outside.any(axis=1), samples - np.argmax(outside[:, ::-1], axis=1), 0)
        settled = (samples - arrival) * SAMPLE_INTERVAL_S >= task.hold
        converged = ~played.diverged[: len(pairs)]
        truth = self.fleet.truth()[: len(pairs), self.axis_index]
        all_steps_made = (truth["pulses"] == task.pulses * directions) & (truth["lost_steps"] == 0)
        return (
            np.where(settled & converged, arrival * SAMPLE_INTERVAL_S, np.nan),
            converged & (settled if task.is_servo else all_steps_made),
            np.maximum(np.nan_to_num(overshoots).max(axis=1), 0.0),
        )

    def close(self) -> None:
        """Release the threads of the fleet that makes the test moves."""
        self.fleet.close()

    def __enter__(self) -> MoveRunner:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
