"""The vector environment as Stable-Baselines3 wants it. A move is an episode of one step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from common import Moves
from stable_baselines3.common.vec_env import VecEnv

torch.set_num_threads(1)  # the networks are small, and the stages need the processors


WORST, SCALE = (
    -1.0,
    5.0,
)  # a learner's reward: SCALE x the environment's, which is cut off at WORST, where steps were lost


class MovesVecEnv(VecEnv):
    """`moves.lanes` environments; an action is a choice of `moves`, a reward is between SCALE x WORST and 0."""

    def __init__(self, moves: Moves):
        self.moves = moves
        box = gymnasium.spaces.Box(-1.0, 1.0, (moves.size,), np.float32)
        super().__init__(moves.lanes, moves.env.single_observation_space, box)

    def reset(self) -> np.ndarray:
        return self.moves.observation

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        rewards = SCALE * np.maximum(np.nan_to_num(self.moves.make(self._actions)), WORST)
        seen = self.moves.observation
        infos = [{"terminal_observation": row} for row in seen]
        return seen, rewards.astype(np.float32), np.ones(self.num_envs, bool), infos

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> Sequence[bool]:
        return [False] * self.num_envs
