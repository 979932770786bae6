"""Rules of an environment for n stages at once: `Task`, and `MoveTask`, whose step is a program of bus cycles."""

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
from stage.envs.observation_features import Feature, list_hidden, list_visible
from stage.envs.settings import UnknownSetting
from stage.envs.step_results import Results, make_step_result_dtype
from stage.errors import ArgumentError, unknown_name_error
from stage.sim.fleet import Fleet, PlayedPrograms
from stage.sim.program import Program
from stage.sim.stage_snapshot import Snapshot

ConfigT = TypeVar("ConfigT")


class Task(ABC, Generic[ConfigT]):
    """The rules behind the scalar and the vector environment.

    A subclass sets `Config` (a frozen dataclass of its settings), makes the two spaces and `result` (the dtype of a step's
    record), and writes `stage`, `begin`, `act` and `observe`. Arrays have the stage as their first index and stay where
    they are. A stage's numbers do not depend on how many there are.

    Attributes:
        actions, active: what the next step does, (n, ...), and on which stages, (n,) bool.
        results: of the last step, one record a stage; those of stages that are not active do not count.
        observations: (n, ...). A stage that diverged keeps its last one.
    """

    Config: ClassVar[type]
    OPTIONS: ClassVar[tuple[str, ...]] = ()
    """What `reset(options=...)` takes."""
    STATE: ClassVar[tuple[str, ...]] = ()
    """The arrays of what is drawn and counted for each stage, beside steps, observations and results: snapshots have them."""
    OBSERVATION: ClassVar[tuple[Feature, ...]]
    """What an observation may have, in its order; see `layout`."""
    INFO: ClassVar[tuple[Feature, ...]]
    """Features of an info, of a reset and of a step."""
    PARTS: ClassVar[tuple[str, ...]]
    """Names of the parts whose sum is the reward."""
    RESTARTS: ClassVar[bool] = False
    """Every step begins at power-up, made ready by `renew`; a recording then holds one step."""
    action_space: gymnasium.Space
    observation_space: gymnasium.Space
    shapes: Mapping[str, tuple[int, ...]] = MappingProxyType({})
    """Shapes of the features of an info that are arrays; `prepare` sets them."""

    def __init__(self, n: int, config: ConfigT, threads: int | None = None, visuals: bool = False):
        self.n, self.config = n, config
        first = self.make_stage(visuals)
        self.stages = [first, *(copy.deepcopy(first) for _ in range(n - 1))]
        self.fleet = Fleet(self.stages, threads)
        self.start = first.snapshot()
        self.rngs = [np.random.default_rng(0)] * n
        self.steps = np.zeros(n, np.int64)
        self.active = np.ones(n, bool)
        self.header: Any = None  # of its snapshots, once there is one
        self.prepare()
        self.actions = np.zeros((n, *self.action_space.shape), self.action_space.dtype)  # type: ignore[misc]
        self.observations = np.zeros((n, *self.observation_space.shape), self.observation_space.dtype)  # type: ignore[misc]
        self.hidden = list_hidden(self.INFO, self.truth)
        self.results = Results(n, make_step_result_dtype(self.PARTS, self.INFO, self.shapes), self.hidden)
        self.bind_arrays()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.bind_arrays()

    @abstractmethod
    def make_stage(self, visuals: bool) -> Stage:
        """Make one stage, at power-up.

        Args:
            visuals: Load the visual geoms of the model.
        """

    @abstractmethod
    def prepare(self) -> None:
        """Make the spaces, the record, and the arrays of what is drawn for each stage."""

    def bind_arrays(self) -> None:
        """Note where the arrays lie, if compiled code uses them."""

    @abstractmethod
    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Begin an episode on stage k, drawn from `rngs[k]`. The stage is at power-up; its payload is as it was.

        Args:
            stage_index: Number of the stage.
            options: Of the reset.

        Raises:
            ArgumentError: An option has a wrong value.
        """

    @abstractmethod
    def play(self) -> None:
        """Play `actions` on the `active` stages, at least one, and judge: fill `results` and count `steps`."""

    def apply_machine(self, stage_index: int) -> None:
        """Give stage k the machine that was drawn, the payload and the like, which a stage's snapshots leave alone."""

    def prepare_next(self) -> None:
        """Prepare the stages that are `converged` for their next step."""

    @abstractmethod
    def update_observations(self) -> None:
        """Bring `observations` up to date."""

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        """Return all info of a reset of stage k, truth included."""
        return {}

    def scripted_action(self) -> np.ndarray:
        """Return the next actions of a host that does not learn, (n, ...). Raises ArgumentError for a task without one."""
        raise ArgumentError(f"{type(self).__name__} has no scripted host.")

    def layout(self) -> list[Feature]:
        """Return the features of the whole observation, a feature for each number, truth included."""
        return list(self.OBSERVATION)

    def close(self) -> None:
        """End the threads."""
        self.fleet.close()

    # --- the rest is the same for all ---

    @property
    def truth(self) -> Any:
        """The setting that says where truth is shown."""
        config: Any = self.config
        return config.truth

    @property
    def observation_features(self) -> list[Feature]:
        """Features of the observation, a feature for each number."""
        every = self.layout()
        return [e for e, shown in zip(every, list_visible(every, self.truth), strict=True) if shown]

    def reset_info(self, stage_index: int) -> dict[str, Any]:
        """Return the info of a reset of stage k, without truth where the setting `truth` hides it."""
        return {name: value for name, value in self.describe_episode(stage_index).items() if name not in self.hidden}

    @property
    def converged(self) -> np.ndarray:
        """Mask of the stages that have made a step that did not diverge."""
        return self.active & (self.results["cause"] == 0)

    def reset_stage(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Put stage k back to power-up, and begin an episode.

        Args:
            stage_index: Number of the stage.
            options: Of the reset.
        """
        self.stages[stage_index].restore(self.start)
        self.steps[stage_index] = 0
        self.results["cause"][stage_index] = 0
        self.begin_episode(stage_index, options)

    def save_stage(self, stage_index: int) -> tuple:
        """Return the whole episode of stage k, for `load_stage`."""
        stage = self.stages[stage_index].snapshot()
        arrays = [getattr(self, name)[stage_index].tobytes() for name in self._state_names]
        return (
            (stage.state, stage.diagnostics, stage.checksum), arrays, self.results.rows[stage_index].tobytes(),
            self.rngs[stage_index].bit_generator.state,
        )  # fmt: skip

    def load_stage(self, stage_index: int, saved: tuple) -> None:
        """Put stage k into an episode that `save_stage` returned.

        Args:
            stage_index: Number of the stage.
            saved: What `save_stage` returned.
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
        return ("steps", "observations", *self.STATE)

    def set_action(self, stage_index: int, action: Any) -> None:
        """Set the next action of stage k.

        Args:
            stage_index: Number of the stage.
            action: In the action space.

        Raises:
            ArgumentError: The action is not in the space.
        """
        self.actions[stage_index] = check_action(self.action_space, action)


class MoveTask(Task[ConfigT]):
    """A task whose step is a program of bus cycles, judged when it has been played. Elementwise arithmetic only."""

    @abstractmethod
    def make_programs(self) -> Sequence[Program] | np.ndarray:
        """Return the bus cycles of the host on each stage for its action; those of inactive stages do not count."""

    @abstractmethod
    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        """Fill the results of the step that was just played: parts, info, terminated, truncated.

        Args:
            played: What the fleet returned.
            truth: True state of each axis after it, (n, axes).
        """

    @abstractmethod
    def compute_observations(self) -> np.ndarray:
        """Compute every stage's observation, (n, ...), truth included."""

    def make_observation_space(self) -> gymnasium.spaces.Box:
        """Make the observation space of the visible features."""
        self.visible = np.array(list_visible(self.layout(), self.truth))
        return gymnasium.spaces.Box(-1.0, 1.0, (int(self.visible.sum()),), np.float32)

    def play(self) -> None:
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
        self.results.finish(bad)

    def update_observations(self) -> None:
        fine = self.results["cause"] == 0
        self.observations[fine] = self.compute_observations()[fine][:, self.visible]

    def set_results(self, parts: Mapping[str, Any], info: Mapping[str, Any], terminated: Any, truncated: Any) -> None:
        """Set the results of a step by columns.

        Args:
            parts: Of the reward, by name, (n,).
            info: By name, (n, ...).
            terminated: Mask, (n,).
            truncated: Mask, (n,).
        """
        for columns, values in ((self.results["parts"], parts), (self.results["info"], info)):
            for name, value in values.items():
                columns[name] = value
        self.results["terminated"], self.results["truncated"] = terminated, truncated


def make_config(task: type[Task], settings: Mapping[str, Any], more: Iterable[str] = ()) -> Any:
    """Make the Config of a task.

    Args:
        task: Class of the task.
        settings: By name.
        more: Names that the caller knows beside those of the task, for the error.

    Raises:
        UnknownSetting: The task has no such setting.
    """
    known = [f.name for f in fields(task.Config)]
    for name in settings:
        if name not in known:
            detail = unknown_name_error(f"{task.__name__} setting", name, [*known, *more])
            raise UnknownSetting(f"got an unexpected keyword argument {name!r}: {detail}")
    return task.Config(**settings)


def check_action(space: gymnasium.Space, action: Any) -> np.ndarray:
    """Return an action as an array of the space's type.

    Args:
        space: Of the actions.
        action: To check.

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
