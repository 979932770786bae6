"""`HomeProgram`: an origin return written as a program, which has no branches, and the meaning of its results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from stage.errors import ArgumentError
from stage.firmware.parameter_ranges import ParameterRanges
from stage.sim.program import Program


class HomeResults(NamedTuple):
    """Results of origin returns as a host knows them; arrays with the stage as their index, pulses or bool."""

    timed_out: np.ndarray
    """A run took longer than it may."""
    home: np.ndarray
    """It ended at the origin."""
    end_limit: np.ndarray
    """A run ended neither after its pulses nor at the origin, and in time."""
    released: np.ndarray
    """ORG was released before the last approach."""
    searched: np.ndarray
    """Pulses of the search, minus counts."""
    overrun: np.ndarray
    """Pulses by which the search went beyond ORG; 0 where the chip does not tell."""


class HomeProgram(ABC):
    """One way to write an origin return, minus to ORG, as a program that cannot branch.

    Attributes:
        choices: what a row chooses.
        marks: the places of the results that `read_results` needs; the same for every program.
    """

    choices: ParameterRanges
    marks: dict[str, int]

    @abstractmethod
    def program(self, row: Sequence[int] | np.ndarray) -> Program:
        """Write a whole return.

        Args:
            row: Numbers in the order of `choices`.

        Returns:
            The program.
        """

    def find_nearest_row(
        self, fl: float, fh: float, ramp: float, approach: float, leave: int, back_off: int
    ) -> list[int]:
        """Return the choices that come closest to the rates and pulses of a user.

        Args:
            fl: Start rate, pps.
            fh: Drive rate, pps.
            ramp: Time of the ramps, s.
            approach: Rate of the last approach, pps.
            leave: Pulses to leave ORG by at first.
            back_off: Pulses to back off by before the last approach.

        Raises:
            ArgumentError: The family does not define it.
        """
        raise ArgumentError(
            f"{type(self).__module__}.{type(self).__name__} makes no choices of rates: give those of "
            f"{', '.join(self.choices.ranges)}. (A driver that offers such choices defines its own Search.find_nearest_row.)"
        )

    def _round_to_ranges(self, wanted: Mapping[str, float]) -> list[int]:
        """Return the row whose numbers are as near to the wanted ones as their ranges allow."""
        ranges = self.choices.ranges.items()
        return [int(min(max(round(wanted[name]), low), high)) for name, (low, high) in ranges]

    @abstractmethod
    def read_results(self, results: np.ndarray, rows: np.ndarray) -> HomeResults:
        """Decode the results of programs.

        Args:
            results: Results of the programs (stages, operations).
            rows: Choices with which the programs were written (stages, choices).

        Returns:
            Results as a host knows them.
        """

    def _note_result_index(self, name: str, program: Program) -> Program:
        """Note that the next operation's result is `name`."""
        self.marks[name] = len(program)
        return program
