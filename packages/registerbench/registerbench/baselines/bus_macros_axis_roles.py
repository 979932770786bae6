"""What a learner on `stage/BusMacros-v1` sees and says: axes by their role, not by their name; the mask behind; easier episodes.

turn = Turn([entry.name for entry in envs.observation_features], envs.single_action_space.n)
axis = turn.axis(seen)                     which axis is selected, (n,)
turn.seen(seen, axis)                      what is seen of each axis, that of the selected one first
turn.masks(masks, axis)                    likewise the macros that select one: the last ones
turn.back(macros, axis)                    macros of the environment again

To a host all axes are alike: what it has learned of one it can do with each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper

AXIS_FEATURES = ("used", "selected", "moves", "arrived")
EASIER: dict[str, dict[tuple[str, int | None], float]] = {
    "target": {("move", None): 0.5},
    "axes": {("axes", 0): 0.4, ("axes", 64): 0.1, ("target", None): 0.1},
    "origin": {("axes", None): 0.2, ("axes", 0): 0.1, ("origin", 1): 0.3},
}
"""Of a level the shares of other episodes: their level, and how near one axis has its target: 0, there; 1, at its origin."""


class AxisRoles:
    def __init__(self, names: Sequence[str], macros: int):
        self.axes, self.at, self.macros = list(names).count("used"), list(names).index("used"), macros
        self.per = macros - self.axes

    def find_selected_axis(self, observation: np.ndarray) -> np.ndarray:
        return self._of_axes(observation)[:, :, AXIS_FEATURES.index("selected")].argmax(axis=1)

    def reorder_observation(self, observation: np.ndarray, axis: np.ndarray) -> np.ndarray:
        out, size = observation.copy(), len(AXIS_FEATURES) * self.axes
        rolled = np.take_along_axis(self._of_axes(observation), self._order(axis)[:, :, None], axis=1)
        out[:, self.at : self.at + size] = rolled.reshape(len(observation), size)
        return out

    def reorder_masks(self, masks: np.ndarray, axis: np.ndarray) -> np.ndarray:
        out = masks.copy()
        out[:, self.per :] = np.take_along_axis(masks[:, self.per :], self._order(axis), axis=1)
        return out

    def restore_macros(self, macros: np.ndarray, axis: np.ndarray) -> np.ndarray:
        return np.where(macros < self.per, macros, self.per + (macros - self.per + axis) % self.axes)

    def _of_axes(self, observation: np.ndarray) -> np.ndarray:
        return observation[:, self.at : self.at + len(AXIS_FEATURES) * self.axes].reshape(
            len(observation), self.axes, len(AXIS_FEATURES)
        )

    def _order(self, axis: np.ndarray) -> np.ndarray:
        """Return the axes of each row, the selected one first."""
        return (axis[:, None] + np.arange(self.axes)) % self.axes


class AxisRolesVecEnv(VecEnvWrapper):
    """A StageVecEnv of BusMacros, with axes by their role. behind: the mask is part of what is seen, at the end."""

    def __init__(self, envs: Any, append_mask: bool):
        self.turn, self.append_mask = (
            AxisRoles([e.name for e in envs.envs.observation_features], envs.action_space.n),
            append_mask,
        )
        size = envs.observation_space.shape[0] + (envs.action_space.n if append_mask else 0)
        super().__init__(envs, gymnasium.spaces.Box(-1.0, 1.0, (size,), np.float32))
        self.selected = np.zeros(envs.num_envs, np.int64)

    def _turned(self, observation: np.ndarray, masks: np.ndarray) -> np.ndarray:
        axis = self.turn.find_selected_axis(observation)
        out = self.turn.reorder_observation(observation, axis)
        return (
            np.concatenate([out, self.turn.reorder_masks(masks, axis).astype(np.float32)], axis=1)
            if self.append_mask
            else out
        )

    def _now(self, observation: np.ndarray) -> np.ndarray:
        self.selected = self.turn.find_selected_axis(observation)
        return self._turned(observation, self.venv.envs.action_masks())  # type: ignore[attr-defined]

    def reset(self) -> np.ndarray:
        return self._now(self.venv.reset())

    def step_async(self, actions: np.ndarray) -> None:
        self.venv.step_async(self.turn.restore_macros(np.asarray(actions), self.selected))

    def step_wait(self) -> Any:
        observation, rewards, ends, infos = self.venv.step_wait()
        for k in np.flatnonzero(ends):
            last, mask = infos[k]["terminal_observation"], np.asarray(infos[k]["action_mask"])
            infos[k]["terminal_observation"] = self._turned(last[None], mask[None])[0]
        return self._now(observation), rewards, ends, infos

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        if method_name != "action_masks":
            return self.venv.env_method(method_name, *args, indices=indices, **kwargs)
        return list(self.turn.reorder_masks(self.venv.envs.action_masks(), self.selected))  # type: ignore[attr-defined]


class MixedLevelsVecEnv(VecEnvWrapper):
    """Episodes of a level with easier ones among them, by EASIER."""

    def __init__(self, envs: Any, level: str, seed: int):
        super().__init__(envs)
        self.rng, self.names = np.random.default_rng(seed), envs.envs.task_instance.config.axes
        self.shares = EASIER[level]

    def reset(self) -> np.ndarray:
        return self.venv.reset()

    def options(self) -> dict[str, Any] | None:
        """Return the options of the next episode; None: one of the level itself."""
        at = self.rng.random()
        for (level, near), share in self.shares.items():
            at -= share
            if at < 0:
                return {"level": level} | (
                    {"targets": {str(self.rng.choice(self.names)): near}} if near is not None else {}
                )
        return None

    def step_wait(self) -> Any:
        observation, rewards, ends, infos = self.venv.step_wait()
        for k in np.flatnonzero(ends):
            if options := self.options():
                which = np.arange(self.num_envs) == k
                observation[k] = self.venv.envs.reset(options={**options, "reset_mask": which})[0][k]  # type: ignore[attr-defined]
        return observation, rewards, ends, infos
