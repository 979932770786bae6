"""`Tries`: makes moves with any registers, many at once, and tells how each went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stage.sim.fleet import Fleet
from stage.sim.program import LOOK as LOOKS_AT
from stage.sim.program import WAIT, Program
from stage.tune.plans import Plan, Plans
from stage.tune.task import Case, Task

LOOK = 5e-4
"""s between two looks at the carriage: what a time is good for."""
LANES = 48


class Outcome(NamedTuple):
    """Of moves (plans, cases). arrived: s from the start command on, NaN where it did not; kept: all pulses made and no step lost
    (of a servo: arrived); beyond: m that it went too far at most."""

    arrived: np.ndarray
    kept: np.ndarray
    beyond: np.ndarray

    def good(self, task: Task, asked: np.ndarray) -> np.ndarray:
        """Kept, and where no more than the payload was carried (`asked`, of the cases), arrived without going too far."""
        there = ~np.isnan(self.arrived) & (self.beyond <= float(task.overshoot or 0.0))
        return self.kept & (there | ~asked)


class Tries:
    """A fleet of copies of a task's machine.

    workers: threads, and lanes, how many stages: the results do not depend on them. made: how many moves so far.
    """

    def __init__(self, task: Task, plans: Plans, workers: int | None = None, lanes: int = LANES):
        self.task, self.plans = task, plans
        self.fleet = Fleet([task.copy() for _ in range(lanes)], workers)
        self.index = task.stage.axes[task.axis].index
        self.start = task.stage.snapshot()
        self.made = 0

    def make(self, plans: Sequence[Plan], cases: Sequence[Case], limit: float) -> Outcome:
        """Each plan with each case. limit: s, how long to look."""
        pairs = [(plan, case) for plan in plans for case in cases]
        lanes = len(self.fleet)
        parts = [self._play(pairs[k : k + lanes], limit) for k in range(0, len(pairs), lanes)]
        self.made += len(pairs)
        return Outcome(*(np.concatenate(column).reshape(len(plans), len(cases)) for column in zip(*parts, strict=True)))

    def _play(self, pairs: Sequence[tuple[Plan, Case]], limit: float) -> tuple[np.ndarray, ...]:
        n, task = round(limit / LOOK), self.task
        goals = np.zeros(len(pairs))
        heads = []
        for k, (plan, case) in enumerate(pairs):
            stage = self.fleet.stages[k]
            stage.restore(self.start)
            goals[k] = task.begin(stage, case)
            program = Program()
            self.plans.write(program, plan, task.pulses * case.way)
            heads.append(program.ops)
        ops = np.zeros((len(self.fleet), max(map(len, heads)) + 2 * n, 4), np.int64)
        looks = np.tile([[WAIT, round(LOOK * 1e9), 0, 0], [LOOKS_AT, self.index, 0, 0]], (n, 1))
        for row, head in zip(ops, heads, strict=False):
            row[: len(head)] = head
            row[len(head) : len(head) + 2 * n] = looks
        played = self.fleet.play(ops)
        seen = np.stack([played.results[k, len(h) + 1 : len(h) + 2 * n : 2] for k, h in enumerate(heads)]) * 1e-12
        ways = np.array([case.way for _, case in pairs])
        axis = self.fleet.stages[0].axes[task.axis]
        error = (seen - goals[:, None]) * (ways * np.sign(axis.gear))[:, None]
        outside = np.abs(error) > task.within
        late = np.where(outside.any(axis=1), n - np.argmax(outside[:, ::-1], axis=1), 0)
        there = (n - late) * LOOK >= task.hold
        sound = ~played.diverged[: len(pairs)]
        truth = self.fleet.truth()[: len(pairs), self.index]
        stepped = (truth["pulses"] == task.pulses * ways) & (truth["lost_steps"] == 0)
        kept = sound & (there if axis.chip.SERVO else stepped)
        return np.where(there & sound, late * LOOK, np.nan), kept, np.maximum(np.nan_to_num(error).max(axis=1), 0.0)

    def close(self) -> None:
        self.fleet.close()

    def __enter__(self) -> Tries:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
