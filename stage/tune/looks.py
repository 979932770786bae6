"""`Looks`: where a move is judged, at the axis or at a point that it carries, and how far that is from its goal."""

from __future__ import annotations

import numpy as np

from stage import Stage
from stage.sim.program import LOOK as LOOKS_AT
from stage.sim.program import WAIT
from stage.tune.task import Case, Task

LOOK = 5e-4
"""s between two looks: what a time is good for."""


class Looks:
    """Of a task. each: operations of one look, the wait before it among them."""

    def __init__(self, task: Task):
        self.task, self.axis = task, task.stage.axes[task.axis]
        self.each = 4 if task.point else 2

    def ops(self, n: int) -> np.ndarray:
        """So many looks, as operations of a program."""
        index, point = self.axis.index, self.task.point
        looks = [[LOOKS_AT, index, point, k] for k in range(self.each - 1)]
        return np.tile([[WAIT, round(LOOK * 1e9), 0, 0], *looks], (n, 1))

    def begin(self, stage: Stage, case: Case) -> np.ndarray:
        """Bring a stage to where a move begins. Returns (2, 1 or 3): the goal of what is looked at, and the way there, m."""
        task, axis = self.task, self.axis
        way = np.sign(axis.gear) * axis.meters_per_pulse * task.pulses * case.way
        if not task.point:
            return np.array([[task.begin(stage, case)], [way]])
        task.begin(stage, case)
        start = stage.axes[task.axis].position
        stage.place(**{task.axis: start + way})
        goal = self._at(stage)
        task.begin(stage, case)
        return np.stack([goal, goal - self._at(stage)])

    def _at(self, stage: Stage) -> np.ndarray:
        k = self.task.point
        return np.array(stage.data.site_xpos[k - 1] if k > 0 else stage.data.xpos[-k])

    def errors(self, results: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of each look of each move (moves, looks): m from the goal in any direction, and m beyond it (negative before it).

        results: of the operations of `ops`, (moves, ...); goals: of `begin`, (moves, 2, ...).
        """
        moves = len(results)
        seen = results.reshape(moves, -1, self.each)[:, :, 1:] * 1e-12
        off = seen - goals[:, None, 0]
        ways = goals[:, 1] / np.linalg.norm(goals[:, 1], axis=1, keepdims=True)
        return np.linalg.norm(off, axis=2), np.einsum("mlk,mk->ml", off, ways)
