"""`CompiledTask`: a task whose steps, from the actions to the observations, run in compiled code, without the GIL.

The task owns all arrays. An ARRAY_TABLE record holds their addresses and lengths, so that a call passes only a few numbers. A step
has two halves, `play_actions` and `judge_and_observe`, so that Python can play the program of a recorded stage in between.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from stage.envs.task import ConfigT, Task, check_action
from stage.sim import program_player

INTEGER = np.dtype(np.int64)


class CompiledTask(Task[ConfigT]):
    """Base of tasks whose steps run in compiled code.

    A subclass sets `CORE`, calls `make_step_arrays` in `make_spaces_and_arrays`, and implements `list_frame_values`.

    Attributes:
        CORE: Module with the record ARRAY_TABLE and the exported functions `play_actions(frame, begin, end)`,
            `judge_and_observe(frame, begin, end, fresh)` and `step_stages(frame, begin, end)`, which makes a step of a range of
            stages and returns 0 if each of them has played its program to the end.
    """

    CORE: ClassVar[ModuleType]
    IS_COMPILED = True

    def make_step_arrays(self, axis_count: int, operation_count: int) -> None:
        """Make the arrays of programs and true states.

        Args:
            axis_count: Number of axes of a stage.
            operation_count: Number of operations of the longest program.
        """
        n = self.n
        self._ops, self._values = np.zeros((n, operation_count, 4), np.int64), np.zeros((n, operation_count), np.int64)
        self._status, self._is_observed = np.zeros(n, np.int64), np.zeros(n, bool)
        self._observed: list[int] = []
        self._truth = np.zeros((n, axis_count), program_player.TRUTH)

    @abstractmethod
    def list_frame_values(self) -> Mapping[str, Any]:
        """Return the values of the fields of ARRAY_TABLE that this class does not set: arrays, for their addresses, and lengths."""

    def bind_arrays(self) -> None:
        super().bind_arrays()
        values = {
            "handles": self.fleet.handles, "active": self.active, "actions": self.actions, "steps": self.steps,
            "ops": self._ops, "values": self._values, "status": self._status, "truth": self._truth,
            "observed": self._is_observed, "results": self.results.rows, "observations": self.observations,
            "stages": self.n, "width": self.observations.shape[1], **self.list_frame_values(),
        }  # fmt: skip
        self._frame = np.zeros(1, self.CORE.ARRAY_TABLE)
        for name, value in values.items():
            self._frame[name] = value.ctypes.data if isinstance(value, np.ndarray) else value
        self._address, self._action_shape = self._frame.ctypes.data, self.actions.shape[1:]

    def set_action(self, stage_index: int, action: Any) -> None:
        if type(action) is np.ndarray and action.dtype is INTEGER and action.shape == self._action_shape:
            self.actions[stage_index] = action  # compiled code checks its range
        else:
            super().set_action(stage_index, action)

    def play_actions(self) -> None:
        if (observed := self.fleet.list_observed_stages()) != self._observed:
            self._observed, self._is_observed[:] = observed, False
            self._is_observed[observed] = True
        if self.run_step():
            self._finish_step()

    def run_step(self) -> bool:
        """Run the compiled code of a step, and return whether a stage has not played its program to its end."""
        if self.n == 1:
            return bool(self.CORE.step_stages.c(self._address, 0, 1))
        self.fleet.run_on_threads(self.step_stages)
        return any(self._status.tolist())

    def decode_results(self, stage_index: int) -> None:
        """Decode results of a stage's program that compiled code cannot decode. The base class does nothing."""

    def _finish_step(self) -> None:
        """Finish the step of stages whose program Python must play or decode, and raise the error of a stage that has not moved."""
        status, nothing = self._status, np.zeros((0, 2))
        for k in np.flatnonzero((status == program_player.UNREADY) | (status == program_player.UNDECODED)).tolist():
            if status[k] == program_player.UNREADY:
                self.stages[k].ensure_powered()
                status[k] = program_player.play_in_python(self.stages[k], self._ops[k], self._values[k], nothing)
            else:
                status[k] = program_player.PLAYED
            self.decode_results(k)
            self.judge_and_observe(k, k + 1, False)
        for k in np.flatnonzero(status == program_player.REFUSED).tolist():
            check_action(self.action_space, self.actions[k])
        self.fleet.check_status(status)

    def step_stages(self, begin: int, end: int) -> None:
        """Play and judge a step of a range of stages in compiled code."""
        self.CORE.step_stages.c(self._address, begin, end)

    def judge_and_observe(self, begin: int, end: int, fresh: bool) -> None:
        """Judge and observe a range of stages in compiled code.

        Args:
            begin: First stage.
            end: Stage after the last one.
            fresh: Whether an episode begins on these stages, so that there is no step to judge.
        """
        self.CORE.judge_and_observe.c(self._address, begin, end, fresh)

    def update_observations(self) -> None:
        """Do nothing: `begin_episode` and `play_actions` have already updated the observations."""
