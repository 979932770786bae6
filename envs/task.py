"""Rules of an environment for n stages at once: `Task`, and `MoveTask` for tasks whose step is a program of bus cycles."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any, ClassVar, Generic, TypeVar

import gymnasium
import numpy as np

from stage import Stage
from stage.envs.observation_features import Feature, list_hidden_names, list_visibility
from stage.envs.settings import UnknownSetting
from stage.envs.step_results import StepResults, make_step_result_dtype
from stage.errors import ArgumentError, unknown_name_error
from stage.sim.fleet import Fleet, PlayedPrograms
from stage.sim.program import Program
from stage.sim.stage_snapshot import Snapshot

ConfigT = TypeVar("ConfigT")


class Task(ABC, Generic[ConfigT]):
    """Rules that a scalar and a vector environment share, for n stages at once.

    A subclass sets the class attributes, and implements `make_stage`, `make_spaces_and_arrays`, `begin_episode`, `play_actions` and
    `update_observations`. The first index of every array is the stage. Arrays stay at their address, because compiled code may use
    them. The values of a stage do not depend on the number of stages.

    Args:
        n: Number of stages.
        config: Settings, an object of `Config`.
        threads: Number of threads; default: one for each processor.
        visuals: Whether to load the visual geoms of the model.

    Attributes:
        stages: Stages, which begin each episode at the snapshot `start`.
        rngs: Random generator of each stage.
        actions: Actions of the next step, (n, ...).
        active: Mask of the stages that take part in the next step, (n,).
        steps: Number of steps of each episode so far, (n,).
        results: StepResults of the last step; those of stages that are not active are not valid.
        observations: Observations, (n, ...). A stage that diverged keeps its last one.
        first_observation: Row of the first stage.
    """

    Config: ClassVar[type]
    OPTIONS: ClassVar[tuple[str, ...]] = ()
    """Names of the options of a reset."""
    STATE: ClassVar[tuple[str, ...]] = ()
    """Names of the arrays, besides steps, observations and results, that make up the state of the episodes in snapshots."""
    OBSERVATION: ClassVar[tuple[Feature, ...]]
    """Features of an observation in their order, before `list_all_features` repeats them for each axis or chip."""
    INFO: ClassVar[tuple[Feature, ...]]
    """Features of the infos of resets and steps."""
    PARTS: ClassVar[tuple[str, ...]]
    """Names of the parts whose sum is the reward."""
    RESTARTS: ClassVar[bool] = False
    """Whether every step begins at power-up, so that a recording holds only one step."""
    IS_COMPILED: ClassVar[bool] = False
    """Whether `play_actions` has also prepared the next step and computed the observations, in compiled code."""
    STEPS_ARE_MOVES: ClassVar[bool] = False
    """Whether `render` shows frames in the course of a step, because a step can be a whole move."""
    action_space: gymnasium.Space
    observation_space: gymnasium.Space
    shapes: Mapping[str, tuple[int, ...]] = MappingProxyType({})
    """Shapes of the features of an info that are arrays, by name; `make_spaces_and_arrays` sets them."""

    def __init__(self, n: int, config: ConfigT, threads: int | None = None, visuals: bool = False):
        self.n, self.config = n, config
        first = self.make_stage(visuals)
        self.stages = [first, *(copy.deepcopy(first) for _ in range(n - 1))]
        self.fleet = Fleet(self.stages, threads)
        self.start = first.snapshot()
        self.rngs = [np.random.default_rng(0)] * n
        self.steps = np.zeros(n, np.int64)
        self.active = np.ones(n, bool)
        self.header: Any = None  # description for snapshots, made at the first one
        self.make_spaces_and_arrays()
        self.actions = np.zeros((n, *self.action_space.shape), self.action_space.dtype)  # type: ignore[misc]
        self.observations = np.zeros((n, *self.observation_space.shape), self.observation_space.dtype)  # type: ignore[misc]
        self.hidden = list_hidden_names(self.INFO, self.truth)
        self.results = StepResults(n, make_step_result_dtype(self.PARTS, self.INFO, self.shapes), self.hidden)
        self.bind_arrays()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.bind_arrays()

    @abstractmethod
    def make_stage(self, visuals: bool) -> Stage:
        """Make one stage at power-up; the other stages are copies of it.

        Args:
            visuals: Whether to load the visual geoms of the model.
        """

    @abstractmethod
    def make_spaces_and_arrays(self) -> None:
        """Make the action space, the observation space, and the arrays that hold the state of the episodes."""

    def bind_arrays(self) -> None:
        """Bind what refers to the memory of the arrays, such as addresses for compiled code; copies of the task do it again."""
        self.first_observation = self.observations[0]

    @abstractmethod
    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Draw an episode from the stage's random generator, and prepare its first step.

        The stage is at power-up, except for its payload and other changes of the model, which the last episode made.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset, which replace drawn values.

        Raises:
            ArgumentError: An option has a wrong value.
        """

    @abstractmethod
    def play_actions(self) -> None:
        """Play `actions` on the `active` stages, of which there is at least one; fill `results` and count `steps`."""

    def apply_machine(self, stage_index: int) -> None:
        """Apply what was drawn for a stage and is not part of its snapshots, such as the payload. The base class has nothing."""

    def prepare_next_step(self) -> None:
        """Prepare the next step of `undiverged_stages`, for example by drawing the next move. The base class does nothing."""

    @abstractmethod
    def update_observations(self) -> None:
        """Compute `observations` from the present state."""

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        """Return all values of the info of a reset, including truth, by name."""
        return {}

    def scripted_action(self) -> np.ndarray:
        """Return the next actions of a scripted host that does not learn, (n, ...). Raises ArgumentError for a task without one."""
        raise ArgumentError(f"{type(self).__name__} has no scripted host.")

    def list_all_features(self) -> list[Feature]:
        """List a feature for each number of an observation with truth=True, in order."""
        return list(self.OBSERVATION)

    def close(self) -> None:
        """End the threads of the fleet."""
        self.fleet.close()

    # --- the rest is the same for all ---

    @property
    def truth(self) -> Any:
        """Setting `truth`: where values appear that no host can know (True, "info" or False)."""
        config: Any = self.config
        return config.truth

    @property
    def observation_features(self) -> list[Feature]:
        """Features of the observation under the setting `truth`, one for each number."""
        every = self.list_all_features()
        return [e for e, shown in zip(every, list_visibility(every, self.truth), strict=True) if shown]

    def make_reset_info(self, stage_index: int) -> dict[str, Any]:
        """Return the info of a reset of a stage, without the values that the setting `truth` hides."""
        return {name: value for name, value in self.describe_episode(stage_index).items() if name not in self.hidden}

    @property
    def undiverged_stages(self) -> np.ndarray:
        """Mask of the active stages whose simulation did not diverge in the last step, (n,)."""
        return self.active & (self.results["cause"] == 0)

    def reset_stage(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Restore a stage to power-up, and begin an episode.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset.
        """
        self.stages[stage_index].restore(self.start)
        self.steps[stage_index] = 0
        self.results["cause"][stage_index] = 0
        self.begin_episode(stage_index, options)

    def save_episode(self, stage_index: int) -> tuple:
        """Return the complete state of a stage's episode, for `load_episode`."""
        stage = self.stages[stage_index].snapshot()
        arrays = [getattr(self, name)[stage_index].tobytes() for name in self._state_names]
        return (
            (stage.state, stage.diagnostics, stage.checksum), arrays, self.results.rows[stage_index].tobytes(),
            self.rngs[stage_index].bit_generator.state,
        )  # fmt: skip

    def load_episode(self, stage_index: int, saved: tuple) -> None:
        """Restore the state of an episode on a stage.

        Args:
            stage_index: Index of the stage.
            saved: State that `save_episode` returned.
        """
        stage, arrays, result, drawn = saved
        for name, row in zip(self._state_names, arrays, strict=True):
            array = getattr(self, name)
            array[stage_index] = np.frombuffer(row, array.dtype).reshape(array.shape[1:])
        self.results.rows[stage_index] = np.frombuffer(result, self.results.rows.dtype)[0]
        self.rngs[stage_index] = np.random.Generator(np.random.PCG64())
        self.rngs[stage_index].bit_generator.state = drawn
        self.apply_machine(stage_index)
        self.stages[stage_index].restore(Snapshot(self.start.header, *stage))

    @property
    def _state_names(self) -> tuple[str, ...]:
        """Names of the arrays that make up the state of the episodes."""
        return ("steps", "observations", *self.STATE)

    def set_action(self, stage_index: int, action: Any) -> None:
        """Set the next action of a stage.

        Args:
            stage_index: Index of the stage.
            action: Action in the action space.

        Raises:
            ArgumentError: The action is not in the action space.
        """
        self.actions[stage_index] = check_action(self.action_space, action)


class MoveTask(Task[ConfigT]):
    """Task whose step is a program of bus cycles, which is judged after it was played.

    Subclasses compute elementwise over the stages, so that a stage's values do not depend on the number of stages.
    """

    STEPS_ARE_MOVES = True

    @abstractmethod
    def make_programs(self) -> Sequence[Program] | np.ndarray:
        """Make the bus cycles of the host on each stage for its action. Those of inactive stages are ignored."""

    @abstractmethod
    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        """Judge the step that was just played: set the parts of the reward, the info, terminated and truncated.

        Args:
            played: StepResults of the programs.
            truth: True state of each axis after its program, (n, axes).
        """

    @abstractmethod
    def compute_observations(self) -> np.ndarray:
        """Compute all numbers of every stage's observation, (n, numbers), also those that only `truth=True` makes visible."""

    def make_observation_space(self) -> gymnasium.spaces.Box:
        """Make the observation space for the numbers that the setting `truth` leaves visible."""
        self.visible = np.array(list_visibility(self.list_all_features(), self.truth))
        return gymnasium.spaces.Box(-1.0, 1.0, (int(self.visible.sum()),), np.float32)

    def play_actions(self) -> None:
        """Play the program of each active stage's action, a move, and judge the results."""
        active, programs = self.active, self.make_programs()
        if isinstance(programs, np.ndarray):
            programs[~active] = 0
        else:
            programs = [p if on else Program() for p, on in zip(programs, active, strict=True)]
        played = self.fleet.play(programs)
        self.steps += active
        bad = played.diverged & active
        self.results["cause"] = bad
        with np.errstate(invalid="ignore", over="ignore"):
            self.judge(played, self.fleet.truth())
        self.results.compute_rewards(bad)

    def update_observations(self) -> None:
        fine = self.results["cause"] == 0
        self.observations[fine] = self.compute_observations()[fine][:, self.visible]

    def set_results(self, parts: Mapping[str, Any], info: Mapping[str, Any], terminated: Any, truncated: Any) -> None:
        """Set the results of a step by columns.

        Args:
            parts: Parts of the reward by name, (n,) each.
            info: Values of the info by name, (n, ...) each.
            terminated: Mask of the episodes that terminated, (n,).
            truncated: Mask of the episodes that were truncated, (n,).
        """
        for columns, values in ((self.results["parts"], parts), (self.results["info"], info)):
            for name, value in values.items():
                columns[name] = value
        self.results["terminated"], self.results["truncated"] = terminated, truncated


def make_config(task: type[Task], settings: Mapping[str, Any], further_names: Iterable[str] = ()) -> Any:
    """Make the Config of a task from settings by name.

    Args:
        task: Class of the task.
        settings: Settings by name.
        further_names: Names of other arguments of the caller, which the error lists as well.

    Raises:
        UnknownSetting: The task has no setting with one of the names.
    """
    known = [f.name for f in fields(task.Config)]
    for name in settings:
        if name not in known:
            detail = unknown_name_error(f"{task.__name__} setting", name, [*known, *further_names])
            raise UnknownSetting(f"got an unexpected keyword argument {name!r}: {detail}")
    return task.Config(**settings)


def check_action(space: gymnasium.Space, action: Any) -> np.ndarray:
    """Convert an action to an array of the space's type, and check it.

    Args:
        space: Action space.
        action: Action to check.

    Raises:
        ArgumentError: The action is not in the space; the message names both.
    """
    try:
        array = np.asarray(action)
        kinds = "iu" if np.issubdtype(space.dtype, np.integer) else "iuf"
        value = array.astype(space.dtype) if array.dtype.kind in kinds else array
        if array.dtype.kind in kinds and array.shape == space.shape and space.contains(value):
            return value
    except (TypeError, ValueError, OverflowError):
        pass
    raise ArgumentError(f"action {action!r} is not in {space}: give an array of shape {space.shape}, {space.dtype}.")
