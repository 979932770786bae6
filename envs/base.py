"""What the environments share. A `Task` holds the rules of one for n stages at once; `StageEnv` and `StageVectorEnv` are its
scalar and vector faces, so that both give the same bits.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from stage import Stage
from stage.errors import ArgumentError, unknown
from stage.fleet import Fleet, Played, Program

DIVERGED = -10.0  # reward of a step in which the simulation diverged
RENDER_MODES = ("rgb_array", "human")
WIDTH, HEIGHT = 640, 480


@dataclass(frozen=True)
class Outcome:
    """Of one step, for every stage: named parts of the reward, whose sum it is; ends of episodes; numbers and words for `info`."""

    parts: Mapping[str, np.ndarray]
    terminated: np.ndarray
    truncated: np.ndarray
    info: Mapping[str, np.ndarray] = field(default_factory=dict)


ConfigT = TypeVar("ConfigT")


class Task(ABC, Generic[ConfigT]):
    """The rules of an environment, for n stages at once.

    A subclass sets `Config` (a frozen dataclass of its settings), makes the two spaces, and writes `stage`, `begin`,
    `programs`, `outcome` and `observe`. Arrays have the stage as their first index. Elementwise arithmetic only, so that
    a stage's numbers do not depend on how many there are.
    """

    Config: ClassVar[type]
    OPTIONS: ClassVar[tuple[str, ...]] = ()
    """What `reset(options=...)` takes."""
    RESTARTS: ClassVar[bool] = False
    """Every step begins at power-up, made ready by `renew`; a recording then holds one step."""
    action_space: gymnasium.Space
    observation_space: gymnasium.Space

    def __init__(self, n: int, config: ConfigT, threads: int | None = None, visuals: bool = False):
        self.n, self.config = n, config
        first = self.stage(visuals)
        self.stages = [first, *(copy.deepcopy(first) for _ in range(n - 1))]
        self.fleet = Fleet(self.stages, threads)
        self.start = first.snapshot()
        self.rngs = [np.random.default_rng(0)] * n
        self.steps = np.zeros(n, np.int64)
        self.prepare()

    @abstractmethod
    def stage(self, visuals: bool) -> Stage:
        """One stage, at power-up."""

    @abstractmethod
    def prepare(self) -> None:
        """Make the spaces and the arrays of what is drawn for each stage."""

    @abstractmethod
    def begin(self, k: int, options: Mapping[str, Any]) -> None:
        """A new episode on stage k, drawn from self.rngs[k]. The stage is at power-up (its payload is as it was)."""

    @abstractmethod
    def programs(self, actions: np.ndarray, active: np.ndarray) -> Sequence[Program] | np.ndarray:
        """What the host does on each stage for these actions; of stages that are not `active` it does not count."""

    @abstractmethod
    def outcome(self, actions: np.ndarray, played: Played, truth: np.ndarray, active: np.ndarray) -> Outcome:
        """The result of the step that was just played."""

    @abstractmethod
    def observe(self, truth: np.ndarray) -> np.ndarray:
        """Every stage's observation, (n, ...)."""

    def renew(self, active: np.ndarray) -> None:
        """Make the active stages ready for their next step, after the last has been judged."""

    def describe(self, k: int) -> dict[str, Any]:
        """`info` of a reset of stage k."""
        return {}

    # --- the rest is the same for all ---

    def restart(self, k: int, options: Mapping[str, Any]) -> None:
        self.stages[k].restore(self.start)
        self.steps[k] = 0
        self.begin(k, options)

    def act(self, actions: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, Outcome]:
        """Play the actions on the active stages. Returns (rewards, outcome)."""
        if not active.any():
            never = np.zeros(self.n, bool)
            return np.zeros(self.n), Outcome({}, never, never.copy(), {})
        programs = self.programs(actions, active)
        if isinstance(programs, np.ndarray):
            programs[~active] = 0
        else:
            programs = [p if on else Program() for p, on in zip(programs, active, strict=True)]
        played = self.fleet.play(programs)
        self.steps += active
        bad = played.diverged & active
        with np.errstate(invalid="ignore", over="ignore"):
            out = self.outcome(actions, played, self.fleet.truth(), active)
        parts = {name: np.where(bad, 0.0, v) for name, v in out.parts.items()}
        if bad.any():
            parts["diverged"] = np.where(bad, DIVERGED, 0.0)
        cause = np.where(bad, "diverged", "").astype(object)
        outcome = Outcome(parts, out.terminated & ~bad, out.truncated | bad, {**out.info, "cause": cause})
        rewards = np.zeros(self.n)
        for part in parts.values():
            rewards += part
        return rewards, outcome


def check_choice(config: Any, name: str, known: Sequence[str]) -> None:
    """ArgumentError if a setting is none of the words known."""
    if getattr(config, name) not in known:
        raise unknown(name, getattr(config, name), known)


def check_range(config: Any, name: str, least: float) -> None:
    """ArgumentError if a setting is no (least, most) from `least` up."""
    low, high = getattr(config, name)
    if not least <= low <= high:
        raise ArgumentError(f"{name}={getattr(config, name)!r}: (least, most), from {least} up.")


def check_positive(config: Any, *names: str) -> None:
    """ArgumentError if one of the settings is not more than 0."""
    for name in names:
        if not getattr(config, name) > 0:
            raise ArgumentError(f"{name}={getattr(config, name)!r}: more than 0.")


def configured(task: type[Task], settings: Mapping[str, Any]) -> Any:
    """The task's Config of these settings; ArgumentError for one that it does not have."""
    known = [f.name for f in fields(task.Config)]
    for name in settings:
        if name not in known:
            raise unknown(f"{task.__name__} setting", name, known)
    return task.Config(**settings)


def checked(space: gymnasium.Space, action: Any) -> np.ndarray:
    """The action as an array of the space's type; ArgumentError names the space and the value."""
    try:
        given = np.asarray(action)
        kinds = "iu" if np.issubdtype(space.dtype, np.integer) else "iuf"
        value = given.astype(space.dtype) if given.dtype.kind in kinds else given
        if given.dtype.kind in kinds and given.shape == space.shape and space.contains(value):
            return value
    except (TypeError, ValueError, OverflowError):
        pass
    raise ArgumentError(f"action {action!r} is not in {space}: give an array of shape {space.shape}, {space.dtype}.")


def _options(task: type[Task], options: Mapping[str, Any] | None) -> dict[str, Any]:
    for name in options or {}:
        if name not in task.OPTIONS:
            raise unknown(f"{task.__name__} reset option", name, task.OPTIONS)
    return dict(options or {})


class StageEnv(gymnasium.Env):
    """One stage under a task.

    Args:
        render_mode: "rgb_array" or "human" (needs GL), or None. camera: of the model.
        record: a file name for rerun recordings, with {} for the number of the episode, or of the step where each begins at
            power-up: "run/{}.rrd".
        threads: does not matter for one stage. Other settings are those of the task's Config.
    """

    task: ClassVar[type[Task]]
    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": 30}

    def __init__(
        self, render_mode: str | None = None, camera: str = "overview", record: str | None = None, **settings: Any
    ):
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise unknown("render mode", render_mode, RENDER_MODES)
        self.render_mode, self._camera, self._record = render_mode, camera, record
        self._task = self.task(
            1, configured(self.task, settings), 1, visuals=render_mode is not None or record is not None
        )
        self.action_space, self.observation_space = self._task.action_space, self._task.observation_space
        self._over = True
        self._viewer: Any = None
        self._recording: Any = None
        self._episode = 0

    @property
    def stage(self) -> Stage:
        """The stage itself, for whoever wants to look."""
        return self._task.stages[0]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        options = _options(self.task, options)
        self._save_recording()
        self._task.rngs[0] = self.np_random
        self._task.restart(0, options)
        self._over = False
        self._start_recording()
        if self.render_mode == "human":
            self.render()
        self._last = self._task.observe(self._task.fleet.truth())
        return self._last[0].copy(), self._task.describe(0)

    def step(self, action: Any):
        if self._over:
            raise ArgumentError("the episode is over: call reset() first.")
        value = checked(self.action_space, action)
        rewards, out = self._task.act(value[None], np.ones(1, bool))
        diverged = out.info["cause"][0] == "diverged"
        if self.task.RESTARTS:
            self._save_recording()
        if not diverged:
            self._task.renew(np.ones(1, bool))
        if self.task.RESTARTS:
            self._start_recording()
        observation = self._task.observe(self._task.fleet.truth())
        if diverged:
            observation = self._last
        self._last = observation
        self._over = bool(out.terminated[0] or out.truncated[0])
        if self.render_mode == "human":
            self.render()
        info = {name: _plain(v[0]) for name, v in out.info.items()}
        info["reward_parts"] = {name: float(v[0]) for name, v in out.parts.items()}
        return observation[0].copy(), float(rewards[0]), bool(out.terminated[0]), bool(out.truncated[0]), info

    def render(self):
        if self.render_mode is None:
            return None
        if self._viewer is None:
            from stage.envs.rendering import viewer

            self._viewer = viewer(self.stage, self.render_mode, self._camera, WIDTH, HEIGHT)
        return self._viewer.frame()

    def close(self) -> None:
        self._save_recording()
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _start_recording(self) -> None:
        if self._record is not None:
            self._recording = self.stage.record()

    def _save_recording(self) -> None:
        if self._recording is not None:
            self._recording.close()
            path = Path(str(self._record).replace("{}", str(self._episode)))
            path.parent.mkdir(parents=True, exist_ok=True)
            self._recording.save(path)
            self._recording = None
            self._episode += 1

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_viewer": None, "_recording": None}


class StageVectorEnv(VectorEnv):
    """Many stages under a task, on threads, without the GIL: the same bits as as many scalar environments.

    Args:
        num_envs: how many. threads: default one a processor.
        autoreset_mode: as Gymnasium defines them, default NEXT_STEP. Other settings are those of the task's Config.
    """

    task: ClassVar[type[Task]]
    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **settings: Any,
    ):
        if int(num_envs) != num_envs or num_envs < 1:
            raise ArgumentError(f"num_envs={num_envs!r}: a whole number, 1 or more.")
        if render_mode is not None:
            raise ArgumentError("a vector of stages does not render: use one environment, or a recording.")
        self.num_envs, self.render_mode = int(num_envs), None
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self._task = self.task(self.num_envs, configured(self.task, settings), threads)
        self.single_action_space = self._task.action_space
        self.single_observation_space = self._task.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._over = np.ones(self.num_envs, bool)
        self._seeded = np.zeros(self.num_envs, bool)

    @property
    def stages(self) -> list[Stage]:
        """The stages themselves."""
        return self._task.stages

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None):
        options = dict(options or {})
        mask = options.pop("reset_mask", np.ones(self.num_envs, bool))
        self._check_mask(mask)
        options = _options(self.task, options)
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else int(seed) + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ArgumentError(f"{len(seed)} seeds for {self.num_envs} environments: one each, one for all, or None.")
        infos: dict[str, Any] = {}
        for k in np.flatnonzero(mask):
            if seed[k] is not None or not self._seeded[k]:
                self._task.rngs[k], _ = seeding.np_random(seed[k])
                self._seeded[k] = True
            self._task.restart(int(k), options)
            infos = self._add_info(infos, self._task.describe(int(k)), int(k))
        self._over[mask] = False
        self._last = self._task.observe(self._task.fleet.truth())
        return self._last.copy(), infos

    def step(self, actions: Any):
        mode = self.autoreset_mode
        if mode != AutoresetMode.NEXT_STEP and self._over.any():
            k = int(np.flatnonzero(self._over)[0])
            raise ArgumentError(f"the episode of environment {k} is over: reset it first (options reset_mask).")
        values = checked(self.action_space, actions)
        active = ~self._over
        infos: dict[str, Any] = {}
        for k in np.flatnonzero(self._over):
            self._task.restart(int(k), {})
            infos = self._add_info(infos, self._task.describe(int(k)), int(k))
        rewards, out = self._task.act(values, active)
        diverged = (out.info["cause"] == "diverged") & active if out.info else np.zeros(self.num_envs, bool)
        self._task.renew(active & ~diverged)
        terminated, truncated = out.terminated & active, out.truncated & active
        rewards = np.where(active, rewards, 0.0)
        observation = self._task.observe(self._task.fleet.truth())
        observation[diverged] = self._last[diverged]
        self._add(infos, out, active)
        self._over = terminated | truncated
        if mode == AutoresetMode.SAME_STEP and self._over.any():
            infos = self._same_step(infos, observation, active)
            now = self._task.observe(self._task.fleet.truth())
            observation = np.where(self._over.reshape(-1, *[1] * (now.ndim - 1)), now, observation)
            self._over = np.zeros(self.num_envs, bool)
        self._last = observation
        return observation.copy(), rewards, terminated, truncated, infos

    def _same_step(self, infos: dict[str, Any], observation: np.ndarray, active: np.ndarray) -> dict[str, Any]:
        """Reset what is over, and move its last observation and info aside, as Gymnasium asks."""
        last, kept = infos, {}
        for k in range(self.num_envs):
            info = _one(last, k)
            if self._over[k]:
                kept = self._add_info(kept, {"final_obs": observation[k].copy(), "final_info": info}, k)
                self._task.restart(k, {})
                info = self._task.describe(k)
            kept = self._add_info(kept, info, k)
        return kept

    def _add(self, infos: dict[str, Any], out: Outcome, active: np.ndarray) -> None:
        """The outcome's info as Gymnasium wants it: arrays, each with a mask of whose it is."""
        if not active.any():
            return
        for name, v in out.info.items():
            whose = active.reshape(-1, *[1] * (v.ndim - 1))
            infos[name], infos[f"_{name}"] = np.where(whose, v, _nothing(v)), active.copy()
        parts: dict[str, Any] = {}
        for name, v in out.parts.items():
            parts[name], parts[f"_{name}"] = np.where(active, v, 0.0), active.copy()
        infos["reward_parts"], infos["_reward_parts"] = parts, active.copy()

    def _check_mask(self, mask: Any) -> None:
        if (
            not isinstance(mask, np.ndarray)
            or mask.dtype != np.bool_
            or mask.shape != (self.num_envs,)
            or not mask.any()
        ):
            raise ArgumentError(f"reset_mask {mask!r}: a bool array of shape ({self.num_envs},), at least one True.")

    def close_extras(self, **kwargs: Any) -> None:
        self._task.fleet.close()


def _plain(value: Any) -> Any:
    """A number as Python's, an array as one of its own."""
    return value.item() if isinstance(value, np.generic) else value.copy() if isinstance(value, np.ndarray) else value


def _nothing(values: np.ndarray) -> Any:
    return None if values.dtype == object else np.zeros((), values.dtype)


def _one(infos: Mapping[str, Any], k: int) -> dict[str, Any]:
    """Environment k's info out of a vector's."""
    return {
        name: _one(v, k) if isinstance(v, dict) else _plain(v[k])
        for name, v in infos.items()
        if not name.startswith("_") and infos[f"_{name}"][k]
    }
