"""Observations and macros of `stage/BusMacros-v1` for learners: axes by their role instead of their name, and easier episodes.

roles = AxisRoles([entry.name for entry in envs.observation_features], envs.single_action_space.n)
axis = roles.find_selected_axis(observation)    index of the selected axis, (n,)
roles.reorder_observation(observation, axis)    features of the selected axis first
roles.reorder_masks(masks, axis)                the same order for the masks of the last macros, which select an axis
roles.restore_macros(macros, axis)              converts macros back to those of the environment

A host treats all axes alike, so a learner can apply what it has learned on one axis to each of them.
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
"""Shares of easier episodes by level: (their level, index of the easier target of one axis or None) -> share.

Index 0 is a target at the present position, 1 a target at the origin.
"""


class AxisRoles:
    """Conversion between the axes of BusMacros in their fixed order and in an order that begins with the selected axis.

    Args:
        names: Names of the features of an observation.
        macros: Number of macros.
    """

    def __init__(self, names: Sequence[str], macros: int):
        self.axes, self.at, self.macros = list(names).count("used"), list(names).index("used"), macros
        self.per = macros - self.axes

    def find_selected_axis(self, observation: np.ndarray) -> np.ndarray:
        """Return the index of the selected axis in each observation, (n,)."""
        return self._get_axis_features(observation)[:, :, AXIS_FEATURES.index("selected")].argmax(axis=1)

    def reorder_observation(self, observation: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Return observations in which the features of the selected axis come first.

        Args:
            observation: Observations, (n, features).
            axis: Index of the selected axis, (n,).
        """
        out, size = observation.copy(), len(AXIS_FEATURES) * self.axes
        rolled = np.take_along_axis(
            self._get_axis_features(observation), self._list_axes_from_selected(axis)[:, :, None], axis=1
        )
        out[:, self.at : self.at + size] = rolled.reshape(len(observation), size)
        return out

    def reorder_masks(self, masks: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Return action masks in which the macros that select an axis are in the order of the reordered axes.

        Args:
            masks: Action masks, (n, macros).
            axis: Index of the selected axis, (n,).
        """
        out = masks.copy()
        out[:, self.per :] = np.take_along_axis(masks[:, self.per :], self._list_axes_from_selected(axis), axis=1)
        return out

    def restore_macros(self, macros: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Convert macros of the reordered axes to those of the environment.

        Args:
            macros: Indices of macros, (n,).
            axis: Index of the selected axis, (n,).
        """
        return np.where(macros < self.per, macros, self.per + (macros - self.per + axis) % self.axes)

    def _get_axis_features(self, observation: np.ndarray) -> np.ndarray:
        return observation[:, self.at : self.at + len(AXIS_FEATURES) * self.axes].reshape(
            len(observation), self.axes, len(AXIS_FEATURES)
        )

    def _list_axes_from_selected(self, axis: np.ndarray) -> np.ndarray:
        """Return the axes of each row, the selected one first."""
        return (axis[:, None] + np.arange(self.axes)) % self.axes


class AxisRolesVecEnv(VecEnvWrapper):
    """Wrapper of a StageVecEnv of BusMacros that orders the axes by their role.

    Args:
        envs: The environments.
        append_mask: Whether the action mask is appended to the observation.
    """

    def __init__(self, envs: Any, append_mask: bool):
        self.axis_roles, self.append_mask = (
            AxisRoles([e.name for e in envs.envs.observation_features], envs.action_space.n),
            append_mask,
        )
        size = envs.observation_space.shape[0] + (envs.action_space.n if append_mask else 0)
        super().__init__(envs, gymnasium.spaces.Box(-1.0, 1.0, (size,), np.float32))
        self.selected = np.zeros(envs.num_envs, np.int64)

    def _reorder(self, observation: np.ndarray, masks: np.ndarray) -> np.ndarray:
        axis = self.axis_roles.find_selected_axis(observation)
        out = self.axis_roles.reorder_observation(observation, axis)
        return (
            np.concatenate([out, self.axis_roles.reorder_masks(masks, axis).astype(np.float32)], axis=1)
            if self.append_mask
            else out
        )

    def _select_axis_and_reorder(self, observation: np.ndarray) -> np.ndarray:
        self.selected = self.axis_roles.find_selected_axis(observation)
        return self._reorder(observation, self.venv.envs.action_masks())  # type: ignore[attr-defined]

    def reset(self) -> np.ndarray:
        return self._select_axis_and_reorder(self.venv.reset())

    def step_async(self, actions: np.ndarray) -> None:
        self.venv.step_async(self.axis_roles.restore_macros(np.asarray(actions), self.selected))

    def step_wait(self) -> Any:
        observation, rewards, ends, infos = self.venv.step_wait()
        for k in np.flatnonzero(ends):
            last, mask = infos[k]["terminal_observation"], np.asarray(infos[k]["action_mask"])
            infos[k]["terminal_observation"] = self._reorder(last[None], mask[None])[0]
        return self._select_axis_and_reorder(observation), rewards, ends, infos

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        if method_name != "action_masks":
            return self.venv.env_method(method_name, *args, indices=indices, **kwargs)
        return list(self.axis_roles.reorder_masks(self.venv.envs.action_masks(), self.selected))  # type: ignore[attr-defined]


class MixedLevelsVecEnv(VecEnvWrapper):
    """Wrapper that mixes easier episodes into those of a level, with the shares of EASIER.

    Args:
        envs: Environments of the level.
        level: Name of the level.
        seed: Seed of the draws.
    """

    def __init__(self, envs: Any, level: str, seed: int):
        super().__init__(envs)
        self.rng, self.names = np.random.default_rng(seed), envs.envs.task_instance.config.axes
        self.shares = EASIER[level]

    def reset(self) -> np.ndarray:
        return self.venv.reset()

    def draw_options(self) -> dict[str, Any] | None:
        """Draw the options of the next episode; None stands for an episode of the level itself."""
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
            if options := self.draw_options():
                which = np.arange(self.num_envs) == k
                observation[k] = self.venv.envs.reset(options={**options, "reset_mask": which})[0][k]  # type: ignore[attr-defined]
        return observation, rewards, ends, infos
