"""The moves of a baseline as Stable-Baselines3 wants them. A move is an episode of one step."""

from __future__ import annotations

import gymnasium
import numpy as np
import torch

from registerbench.baselines.common import Moves
from stage.envs.sb3 import Adapter

torch.set_num_threads(1)  # the networks are small, and the stages need the processors

WORST, SCALE = -1.0, 5.0
"""A learner's reward: SCALE x the environment's, which is cut off at WORST, where steps were lost."""


class MovesVecEnv(Adapter):
    """`moves.lanes` environments; an action is a choice of `moves`, a reward is between SCALE x WORST and 0.

    Closing it leaves the environment to `moves`.
    """

    def __init__(self, moves: Moves):
        self.moves = moves
        super().__init__(moves.env.unwrapped, gymnasium.spaces.Box(-1.0, 1.0, (moves.size,), np.float32))

    def reset(self) -> np.ndarray:
        return self.moves.observation

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        rewards = SCALE * np.maximum(np.nan_to_num(self.moves.make(self._actions)), WORST)
        seen = self.moves.observation
        infos = [{"terminal_observation": row} for row in seen]
        return seen, rewards.astype(np.float32), np.ones(self.num_envs, bool), infos

    def close(self) -> None:
        pass
