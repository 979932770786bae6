"""`HomeProgram`: an origin return written as a program without branches, and the decoding of its results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from stage.errors import ArgumentError
from stage.firmware.parameter_ranges import ParameterRanges
from stage.sim.program import Program


class HomeResults(NamedTuple):
    """Results of origin returns, as far as a host knows them: arrays of pulses or bool, shape (stages,)."""

    timed_out: np.ndarray
    """Whether a run exceeded its time limit."""
    home: np.ndarray
    """Whether the return ended at the origin."""
    end_limit: np.ndarray
    """Whether a run ended in time, but neither after its pulses nor at the origin: an end limit stopped it."""
    released: np.ndarray
    """Whether ORG was off before the last approach."""
    searched: np.ndarray
    """Pulses of the search; towards minus they are counted as positive."""
    overrun: np.ndarray
    """Pulses by which the search went beyond ORG; 0 if the chip does not show them."""


class HomeProgram(ABC):
    """Origin return towards minus as a program, which cannot branch.

    Attributes:
        choices: Names and ranges of the parameters that the user chooses, in the order of a row.
        result_indices: Indices of the operations whose results `decode_results` needs, by name; equal for every program.
    """

    choices: ParameterRanges
    result_indices: dict[str, int]

    @abstractmethod
    def write_program(self, row: Sequence[int] | np.ndarray) -> Program:
        """Write the program of a complete origin return.

        Args:
            row: Value of each parameter in `choices`, in its order, integers.

        Returns:
            The program.
        """

    def find_nearest_row(
        self, fl: float, fh: float, ramp: float, approach: float, leave: int, back_off: int
    ) -> list[int]:
        """Return the values of the parameters in `choices` that come closest to the rates and pulses of a user.

        Args:
            fl: Start rate, pps.
            fh: Drive rate, pps.
            ramp: Time of the ramps, s.
            approach: Rate of the last approach, pps.
            leave: Pulses of the first move, away from ORG.
            back_off: Pulses of the move away from ORG before the last approach.

        Raises:
            ArgumentError: This family does not support the conversion.
        """
        raise ArgumentError(
            f"{type(self).__module__}.{type(self).__name__} makes no choices of rates: give those of "
            f"{', '.join(self.choices.ranges)}. (A driver that offers such choices defines its own Search.find_nearest_row.)"
        )

    def _round_to_ranges(self, wanted: Mapping[str, float]) -> list[int]:
        """Return the values of the parameters in `choices`, in its order, rounded and clipped to their ranges."""
        ranges = self.choices.ranges.items()
        return [int(min(max(round(wanted[name]), low), high)) for name, (low, high) in ranges]

    @abstractmethod
    def decode_results(self, results: np.ndarray, rows: np.ndarray) -> HomeResults:
        """Decode the results of programs of origin returns.

        Args:
            results: Results of the programs, shape (stages, operations).
            rows: Values of the parameters with which the programs were written, shape (stages, parameters).

        Returns:
            Results of all stages.
        """

    def _store_result_index(self, name: str, program: Program) -> Program:
        """Store the index of the program's next operation under `name` in `result_indices`, and return the program."""
        self.result_indices[name] = len(program)
        return program
