"""`Tries`: makes moves with any registers, many at once, and tells how each went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stage.sim.fleet import Fleet
from stage.sim.program import Program
from stage.tune.looks import LOOK, Looks
from stage.tune.plans import Plan, Plans
from stage.tune.task import Case, Task

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
        self.looks = Looks(task)
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
        n, task, looks = round(limit / LOOK), self.task, self.looks
        goals, heads = [], []
        for stage, (plan, case) in zip(self.fleet.stages, pairs, strict=False):
            stage.restore(self.start)
            goals.append(looks.begin(stage, case))
            program = Program()
            self.plans.write(program, plan, task.pulses * case.way)
            heads.append(program.ops)
        tail = looks.ops(n)
        ops = np.zeros((len(self.fleet), max(map(len, heads)) + len(tail), 4), np.int64)
        for row, head in zip(ops, heads, strict=False):
            row[: len(head)] = head
            row[len(head) : len(head) + len(tail)] = tail
        played = self.fleet.play(ops)
        seen = np.stack([played.results[k, len(h) : len(h) + len(tail)] for k, h in enumerate(heads)])
        distance, beyond = looks.errors(seen, np.array(goals))
        ways = np.array([case.way for _, case in pairs])
        outside = distance > float(task.within or 0.0)
        late = np.where(outside.any(axis=1), n - np.argmax(outside[:, ::-1], axis=1), 0)
        there = (n - late) * LOOK >= task.hold
        sound = ~played.diverged[: len(pairs)]
        truth = self.fleet.truth()[: len(pairs), self.index]
        stepped = (truth["pulses"] == task.pulses * ways) & (truth["lost_steps"] == 0)
        kept = sound & (there if task.is_servo else stepped)
        return np.where(there & sound, late * LOOK, np.nan), kept, np.maximum(np.nan_to_num(beyond).max(axis=1), 0.0)

    def close(self) -> None:
        self.fleet.close()

    def __enter__(self) -> Tries:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
