"""RegisterTuning there and back: every second stage moves the other way. No agent plays it, answers are tested by it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stage.envs.base import StageVectorEnv
from stage.envs.register_tuning import RegisterTuning


class BothWays(RegisterTuning):
    """Distances of odd stages are negative."""

    def _draw(self, k: int, options: Mapping[str, Any]) -> None:
        super()._draw(k, options)
        if k % 2:
            self.distance[k] *= -1
            self.stages[k].restore(self.start)
            self.equip(k)
            self.stages[k].place(**{self.config.axis: self.starts.begin(float(self.distance[k]), float(self.angle[k]))})

    def observed(self) -> np.ndarray:
        there_and_back = self.distance
        self.distance = np.abs(there_and_back)
        seen = super().observed()
        self.distance = there_and_back
        return seen


class BothWaysVectorEnv(StageVectorEnv):
    task = BothWays
