"""`StageEnv` and `StageVectorEnv`: the Gymnasium environments that run a `Task` on one stage or on many, with the same results."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from stage import Stage
from stage.envs import env_snapshots
from stage.envs.env_snapshots import EnvSnapshot
from stage.envs.observation_features import Feature
from stage.envs.settings import NumberSetting
from stage.envs.step_results import DIVERGENCE_REWARD as DIVERGENCE_REWARD
from stage.envs.task import Task, check_action, make_config
from stage.errors import ArgumentError, unknown_name_error
from stage.support.snapshots import SnapshotHeader

RENDER_MODES = ("rgb_array", "rgb_array_list", "human")
FPS = 30  # frames in a second of simulated time
WIDTH, HEIGHT = 640, 480
ENV_SETTINGS = ("render_mode", "camera", "record", "render_every")
VECTOR_SETTINGS = ("num_envs", "threads", "autoreset_mode", "render_mode")
"""Settings of the scalar and of the vector environment beside those of the task."""
FRAME_INTERVAL_SETTING = NumberSetting(low=1e-4, high=1e3)  # time between frames, s


def _check_reset_options(
    task: type[Task], options: Mapping[str, Any] | None, further_names: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the options of a reset as a dict. Raises ArgumentError for unknown options.

    Args:
        task: Class of the task.
        options: Options of the reset, or None.
        further_names: Names of options that are allowed in addition to those of the task.
    """
    known = [*task.OPTIONS, *further_names]
    if not isinstance(options, Mapping | None):
        raise ArgumentError(f"options={options!r}: None, or a dict with any of: {', '.join(known) or 'nothing'}.")
    for name in options or {}:
        if name not in known:
            raise unknown_name_error(f"{task.__name__} reset option", name, known)
    return dict(options or {})


def _spread_seeds(seed: Any, n: int) -> list[int | None]:
    """Return one seed for each of n environments. A single seed s stands for s, s + 1, ..."""
    if seed is None or isinstance(seed, int | np.integer):
        return [None if seed is None else int(seed) + k for k in range(n)]
    if not isinstance(seed, Sequence | np.ndarray) or not all(
        s is None or isinstance(s, int | np.integer) for s in seed
    ):
        raise ArgumentError(f"seed={seed!r}: a whole number, None, or one of them for each environment.")
    if len(seed) != n:
        raise ArgumentError(f"{len(seed)} seeds for {n} environments: one each, one for all, or None.")
    return [None if s is None else int(s) for s in seed]


class _TaskAccess:
    """Mixin with the properties that scalar and vector environments take from their task."""

    _task: Task

    @property
    def observation_features(self) -> list[Feature]:
        """Features of one environment's observation: name and meaning of each number, in order."""
        return self._task.observation_features

    @property
    def task_instance(self) -> Task:
        """Task that the environment plays, with its settings `config`, its `stages`, and what it has drawn for them."""
        return self._task

    @property
    def info_features(self) -> tuple[Feature, ...]:
        """Features of an info: name, meaning and type of each value, and whether a host could know it."""
        return (*self._task.INFO,)

    @property
    def header(self) -> SnapshotHeader:
        """Description of the environment that its snapshots carry."""
        return env_snapshots.make_header(self._task)


class StageEnv(_TaskAccess, gymnasium.Env[np.ndarray, Any]):
    """Gymnasium environment of one stage that a task controls.

    Args:
        render_mode: Kind of pictures that `render` returns; all need OpenGL. None: no pictures. "rgb_array": the stage at the
            end of the step, before the next move is prepared. "rgb_array_list": the frames since the last call or reset; if a
            step is a whole move, one each `render_every` of simulated time and one at the end. "human": a window that shows
            these frames in real time.
        camera: Name of a camera of the model.
        record: File name for recordings, such as "run/{}.rrd"; {} stands for the number of the episode, or of the step if each step
            begins at power-up.
        render_every: Simulated time between two frames, s; default: 1/30 s. If a step is a bus cycle, each step has a frame by
            default; with a value, the shortest time between two frames.
        **settings: Settings of the task's Config.
    """

    task: ClassVar[type[Task]]
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": FPS}  # noqa: RUF012 (as in Gymnasium)

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "overview",
        record: str | None = None,
        render_every: float | None = None,
        **settings: Any,
    ):
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise unknown_name_error("render mode", render_mode, RENDER_MODES)
        if render_every is not None:
            FRAME_INTERVAL_SETTING.check("render_every", render_every)
        self.render_mode, self._camera, self._record = render_mode, camera, record
        self._frame_interval, self._last_frame_time = render_every, 0.0
        self.metadata = {**type(self).metadata, "render_fps": max(1, round(1 / (render_every or 1 / FPS)))}
        self._task = self.task(
            1, make_config(self.task, settings, ENV_SETTINGS), 1, visuals=render_mode is not None or record is not None
        )
        self.action_space, self.observation_space = self._task.action_space, self._task.observation_space
        self._over, self._is_started = True, False
        self._viewer: Any = None
        self._recording: Any = None
        self._episode = 0
        self._frames: list[np.ndarray] = []  # joint positions of the frames that `render` will return
        self._end: np.ndarray | None = (
            None  # joint positions at the end of the last step, if the task has moved the stage since
        )

    @property
    def config(self) -> Any:
        """Settings of the task, a frozen dataclass."""
        return self._task.config

    @property
    def stage(self) -> Stage:
        """Stage of the environment, for inspection."""
        return self._task.stages[0]

    def scripted_action(self) -> Any:
        """Return the next action of the task's scripted host, which does not learn. Raises ArgumentError for a task without one."""
        return self._task.scripted_action()[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        options = _check_reset_options(self.task, options)
        self._save_recording()
        self._task.rngs[0] = self.np_random
        self._task.reset_stage(0, options)
        self._over, self._is_started = False, True
        self._start_recording()
        self._frames.clear()
        self._last_frame_time = self.stage.time
        self._add_frames(self.stage.data.qpos[None], None)
        self._task.update_observations()
        return self._task.observations[0].copy(), self._task.make_reset_info(0)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if self._over:
            raise ArgumentError("the episode is over: call reset() first.")
        task = self._task
        task.set_action(0, action)
        if self.render_mode is None:
            task.play_actions()
        else:
            self._play_and_film()
        if not task.IS_COMPILED:
            self._prepare_next_step()
        reward, terminated, truncated, info = task.results.read_row(0)
        self._over = terminated or truncated
        return task.first_observation.copy(), reward, terminated, truncated, info

    def snapshot(self) -> EnvSnapshot:
        """Take a snapshot of the complete episode, for `restore`. Raises ArgumentError before the first reset."""
        env_snapshots.require_episodes([self._is_started])
        return env_snapshots.take_snapshot(self._task, (self._over, self._np_random_seed, self._end))

    def restore(self, snapshot: EnvSnapshot) -> None:
        """Continue from a snapshot, bit for bit, as often as you like.

        Args:
            snapshot: Snapshot of an environment with the same settings.

        Raises:
            ArgumentError: The snapshot is of an environment with other settings, or damaged.
            StageError: The environment makes a recording.
        """
        self._over, self._np_random_seed, self._end = env_snapshots.restore_snapshot(self._task, snapshot)
        self._np_random, self._is_started = self._task.rngs[0], True

    def _prepare_next_step(self) -> None:
        """Let the task prepare its next step, in a recording of its own if it restarts, and observe."""
        task = self._task
        if task.RESTARTS:
            self._save_recording()
        task.prepare_next_step()
        if task.RESTARTS:
            self._start_recording()
        task.update_observations()

    def _play_and_film(self) -> None:
        """Play one step of the task, and collect its frames for `render`."""
        task = self._task
        if not task.STEPS_ARE_MOVES:
            task.play_actions()
            if self._frame_interval is None or self.stage.time >= self._last_frame_time + self._frame_interval - 1e-9:
                self._last_frame_time = self.stage.time
                self._add_frames(self.stage.data.qpos[None], None)
        else:
            frames = self._sample_move_poses()
            self._add_frames(frames, frames[-1].copy())

    def _sample_move_poses(self) -> np.ndarray:
        """Play a whole move, and return the joint positions of its frames, (frames, nq); the last frame is the end of the move."""
        if self.render_mode == "rgb_array":
            self._task.play_actions()
            return self.stage.data.qpos[None]
        from stage.envs.rendering import PoseSampler

        begin, sampler = self.stage.data.qpos.copy(), PoseSampler(self.stage, self._frame_interval or 1 / FPS)
        try:
            self._task.play_actions()
        finally:
            frames = sampler.read_sampled_poses()
        is_noted = self._frames and (begin == self._frames[-1]).all()
        return frames if is_noted else np.concatenate([begin[None], frames])

    def _add_frames(self, frames: np.ndarray, end: np.ndarray | None) -> None:
        """Store frames for `render`, or show them at once in render mode "human".

        Args:
            frames: Joint positions, (frames, nq).
            end: Joint positions at the end of the step, if the task has moved the stage since then; else None.
        """
        self._end = end
        if self.render_mode == "rgb_array_list":
            self._frames += list(frames.copy())
        elif self.render_mode == "human":
            for k, qpos in enumerate(frames):
                if k:
                    time.sleep(self._frame_interval or 1 / FPS)
                self._open_viewer().render_stage(qpos)

    def _open_viewer(self) -> Any:
        """Return the viewer of the render mode, and open it at the first call."""
        if self._viewer is None:
            from stage.envs.rendering import make_viewer

            self._viewer = make_viewer(self.stage, str(self.render_mode), self._camera, WIDTH, HEIGHT)
        return self._viewer

    def render(self) -> Any:
        """Return an image, (height, width, 3) uint8, a list of images, or None, depending on the render mode."""
        if self.render_mode is None:
            return None
        if self.render_mode == "rgb_array_list":
            frames = [self._open_viewer().render_stage(qpos) for qpos in self._frames]
            self._frames.clear()
            return frames
        return self._open_viewer().render_stage(self._end)

    def close(self) -> None:
        self._save_recording()
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _start_recording(self) -> None:
        """Begin a recording of the stage, if the environment makes recordings."""
        if self._record is not None:
            self._recording = self.stage.record()

    def _save_recording(self) -> None:
        """Save the current recording under the number of the episode or step, and count up."""
        if self._recording is not None:
            self._recording.close()
            path = Path(str(self._record).replace("{}", str(self._episode)))
            path.parent.mkdir(parents=True, exist_ok=True)
            self._recording.save(path)
            self._recording = None
            self._episode += 1

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_viewer": None, "_recording": None}


class StageVectorEnv(_TaskAccess, VectorEnv[np.ndarray, Any, np.ndarray]):
    """Gymnasium vector environment of many stages that one task controls, stepped on threads without the GIL.

    The results are bit for bit those of the same number of scalar environments.

    Args:
        num_envs: Number of stages.
        threads: Number of threads; default: one for each processor.
        autoreset_mode: When finished episodes are reset, as Gymnasium defines it.
        render_mode: Always None: a vector does not render.
        **settings: Settings of the task's Config.
    """

    task: ClassVar[type[Task]]
    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 (as in Gymnasium)

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
        self._task = self.task(self.num_envs, make_config(self.task, settings, VECTOR_SETTINGS), threads)
        self.single_action_space = self._task.action_space
        self.single_observation_space = self._task.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._over = np.ones(self.num_envs, bool)
        self._seeded = np.zeros(self.num_envs, bool)

    @property
    def stages(self) -> list[Stage]:
        """Stages of the environments, in order."""
        return self._task.stages

    def scripted_action(self) -> np.ndarray:
        """Return the next actions of the task's scripted host, (num_envs, ...). Raises ArgumentError for a task without one."""
        return self._task.scripted_action()

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        options = _check_reset_options(self.task, options, ["reset_mask"])
        mask = options.pop("reset_mask", np.ones(self.num_envs, bool))
        self._check_reset_mask(mask)
        seeds = _spread_seeds(seed, self.num_envs)
        infos: dict[str, Any] = {}
        for k in np.flatnonzero(mask).tolist():
            if seeds[k] is not None or not self._seeded[k]:
                self._task.rngs[k], _ = seeding.np_random(seeds[k])
                self._seeded[k] = True
            self._task.reset_stage(k, options)
            infos = self._add_info(infos, self._task.make_reset_info(k), k)
        self._over[mask] = False
        self._task.update_observations()
        return self._task.observations.copy(), infos

    def snapshot(self) -> EnvSnapshot:
        """Take a snapshot of the episodes of all stages, for `restore`. Raises ArgumentError before the first reset."""
        env_snapshots.require_episodes(self._seeded)
        return env_snapshots.take_snapshot(self._task, self._over)

    def restore(self, snapshot: EnvSnapshot) -> None:
        """Continue from a snapshot, bit for bit. It can be restored repeatedly.

        Args:
            snapshot: Snapshot of a vector environment with the same settings and number of stages.

        Raises:
            ArgumentError: The snapshot is of another vector environment, or damaged.
        """
        self._over = env_snapshots.restore_snapshot(self._task, snapshot).copy()
        self._seeded[:] = True

    def step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        mode = self.autoreset_mode
        if mode != AutoresetMode.NEXT_STEP and self._over.any():
            k = int(np.argmax(self._over))
            raise ArgumentError(f"the episode of environment {k} is over: reset it first (options reset_mask).")
        task, active = self._task, self._task.active
        task.actions[...] = check_action(self.action_space, actions)
        active[...] = ~self._over
        infos: dict[str, Any] = {}
        for k in np.flatnonzero(self._over).tolist():
            task.reset_stage(k, {})
            infos = self._add_info(infos, task.make_reset_info(k), k)
        rewards, ends = np.zeros(self.num_envs), np.zeros((2, self.num_envs), bool)
        if active.any():
            task.play_actions()
            rewards[active] = task.results["reward"][active]
            ends[:, active] = task.results["terminated"][active], task.results["truncated"][active]
            _merge_info_columns(infos, task.results.read_columns(active))
            task.prepare_next_step()
        task.update_observations()
        observations = task.observations.copy()
        self._over = ends[0] | ends[1]
        if mode == AutoresetMode.SAME_STEP and self._over.any():
            infos = self._reset_finished_stages(infos, observations)
            task.update_observations()
            observations[self._over] = task.observations[self._over]
            self._over = np.zeros(self.num_envs, bool)
        return observations, rewards, ends[0], ends[1], infos

    def _reset_finished_stages(self, infos: dict[str, Any], observations: np.ndarray) -> dict[str, Any]:
        """Reset finished stages, and return the infos with their last observation and info, as Gymnasium's SAME_STEP requires.

        Args:
            infos: Infos of the step.
            observations: Observations of the step, (num_envs, ...).
        """
        last = infos
        merged: dict[str, Any] = {}
        for k in range(self.num_envs):
            info = extract_info(last, k)
            if self._over[k]:
                merged = self._add_info(merged, {"final_obs": observations[k].copy(), "final_info": info}, k)
                self._task.reset_stage(k, {})
                info = self._task.make_reset_info(k)
            merged = self._add_info(merged, info, k)
        return merged

    def _check_reset_mask(self, mask: Any) -> None:
        """Raise ArgumentError unless the option reset_mask is a mask of the environments that selects at least one."""
        if (
            not isinstance(mask, np.ndarray)
            or mask.dtype != np.bool_
            or mask.shape != (self.num_envs,)
            or not mask.any()
        ):
            raise ArgumentError(f"reset_mask {mask!r}: a bool array of shape ({self.num_envs},), at least one True.")

    def close_extras(self, **kwargs: Any) -> None:
        if hasattr(self, "_task"):  # Gymnasium also closes an environment whose settings were refused
            self._task.close()


def _to_plain_value(value: Any) -> Any:
    """Convert a NumPy scalar to a Python value, and copy an array; return any other value as it is."""
    return value.item() if isinstance(value, np.generic) else value.copy() if isinstance(value, np.ndarray) else value


def _merge_info_columns(infos: dict[str, Any], columns: dict[str, Any]) -> None:
    """Merge the columns of a step into infos that already have columns of environments that were reset."""
    for name in [n for n in columns if n in infos and f"_{n}" in infos]:
        whose = infos[f"_{name}"]
        columns[name][whose] = infos[name][whose]
        columns[f"_{name}"] |= whose
    infos.update(columns)


def extract_info(infos: Mapping[str, Any], stage_index: int) -> dict[str, Any]:
    """Return the info of one environment from the infos of a vector environment.

    Args:
        infos: Infos of the vector environment, with a mask for each key.
        stage_index: Index of the environment.
    """
    return {
        name: extract_info(v, stage_index) if isinstance(v, dict) else _to_plain_value(v[stage_index])
        for name, v in infos.items()
        if not name.startswith("_") and infos[f"_{name}"][stage_index]
    }
