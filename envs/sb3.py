"""Adapter of the vector environments for Stable-Baselines3 (extra `rl`).

    from stage.envs.sb3 import StageVecEnv
    from stable_baselines3 import PPO

    envs = StageVecEnv("stage/RegisterTuning-v0", 16, payloads=(0.0, 5.0))
    PPO("MlpPolicy", envs, n_steps=8).learn(1024)

All stages are stepped in compiled code on threads, to the bits that SB3's own DummyVecEnv of as many scalar environments gives: see
docs/rl_libraries.md.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from stage.envs import IDS
from stage.envs.stage_env import StageVectorEnv, extract_info
from stage.errors import ArgumentError, unknown_name_error

PER_STAGE_METHODS = ("action_masks", "scripted_action")
"""Methods of vectors that return a row for each stage."""


class VecEnvAdapter(VecEnv):
    """Base of StageVecEnv: the part of SB3's VecEnv that is the same for all vector environments of stages.

    Args:
        envs: Vector environment, which is closed with the adapter.
        action_space: Action space that SB3 sees; default: that of one environment.
    """

    def __init__(self, envs: StageVectorEnv, action_space: gymnasium.Space | None = None):
        self.envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, action_space or envs.single_action_space)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute once for each environment. "stage" is each environment's own; all others are those of the vector.

        Args:
            attr_name: Name of the attribute.
            indices: Indices of the environments; default: all.
        """
        whose = self._get_indices(indices)
        if attr_name == "stage":
            return [self.envs.stages[k] for k in whose]
        of = {"observation_space": "single_observation_space", "action_space": "single_action_space"}
        value = getattr(self.envs, of.get(attr_name, attr_name))
        return [value for _ in whose]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse to change an attribute: raise ArgumentError, because settings of a vector are fixed when it is made."""
        raise ArgumentError(f"set_attr({attr_name!r}): the stages of a vector have their settings from its start.")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector, one of PER_STAGE_METHODS, and return its row for each environment."""
        if method_name in PER_STAGE_METHODS and hasattr(self.envs, method_name):
            rows = getattr(self.envs, method_name)(*args, **kwargs)
            return [rows[k] for k in self._get_indices(indices)]
        raise ArgumentError(
            f"env_method({method_name!r}): the stages of a vector have no methods of their own. Use `envs`, the vector "
            "environment, or DummyVecEnv with scalar ones."
        )

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each environment: the environments of a vector have no wrappers."""
        return [False for _ in self._get_indices(indices)]


class StageVecEnv(VecEnvAdapter):
    """Vector environment for Stable-Baselines3, made from an environment id.

    At the end of an episode, infos[k] is its last info with "terminal_observation" and "TimeLimit.truncated" (truncated and
    not terminated: SB3 then adds the value of the last observation), and reset_infos[k] is the info of the new episode.
    After `seed(s)`, `reset()` starts environment k as a scalar environment starts with the seed s + k.

    Args:
        id_: Id of the environment, such as "stage/RegisterTuning-v0".
        num_envs: Number of stages.
        threads: Number of threads; default: one for each processor.
        **settings: Settings of the environment.

    Raises:
        ArgumentError: SB3 cannot choose the actions: a MultiDiscrete that does not begin at 0 (actions="registers").
    """

    envs: StageVectorEnv
    reset_infos: list[dict[str, Any]]

    def __init__(self, id_: str, num_envs: int = 1, threads: int | None = None, **settings: Any):
        if "autoreset_mode" in settings:
            raise ArgumentError("autoreset_mode: SB3 wants finished episodes reset in the same step; leave it out.")
        if id_ not in IDS and id_ not in gymnasium.registry:
            raise unknown_name_error("environment", id_, IDS)
        kind: Any = {"vectorization_mode": "vector_entry_point", "autoreset_mode": AutoresetMode.SAME_STEP}
        envs = gymnasium.make_vec(id_, num_envs, threads=threads, **kind, **settings).unwrapped
        if not isinstance(envs, StageVectorEnv):
            raise ArgumentError(f"{id_!r} is no vector of stages. Known: {', '.join(IDS)}.")
        if np.any(getattr(envs.single_action_space, "start", 0)):
            raise ArgumentError(
                f"Stable-Baselines3 counts choices from 0, and {envs.single_action_space} does not: use actions='box'."
            )
        super().__init__(envs)

    def reset(self) -> np.ndarray:
        infos: dict[str, Any] = {}
        if any(self._options):  # SB3 has options for each environment; a reset of the vector has one set of options
            for k, options in enumerate(self._options):
                mask = np.arange(self.num_envs) == k
                observations, infos = self.envs.reset(seed=self._seeds, options={**options, "reset_mask": mask})
                self.reset_infos[k] = extract_info(infos, k)
        else:
            observations, infos = self.envs.reset(seed=self._seeds)
            self.reset_infos = [extract_info(infos, k) for k in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        ends, merged = terminated | truncated, []
        for k in range(self.num_envs):
            info = extract_info(infos, k)
            if ends[k]:
                last, final = info.pop("final_obs"), info.pop("final_info")
                self.reset_infos[k], info = info, {**final, "terminal_observation": last}
            merged.append(info | {"TimeLimit.truncated": bool(truncated[k] and not terminated[k])})
        return observations, rewards.astype(np.float32), ends, merged
