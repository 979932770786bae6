"""`Host` and `Search`: what the rules of a task ask of a family of chips."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.envs.registers import RegisterBox
from stage.errors import ArgumentError
from stage.sim.program import Program
from stage.sim.stage import Axis

if TYPE_CHECKING:
    from stage.envs.hosts.line import Line


class Found(NamedTuple):
    """What a host knows of origin returns when they are over; arrays with the stage as their index, pulses or bool."""

    late: np.ndarray
    """A run took longer than it may."""
    home: np.ndarray
    """It ended at the origin."""
    end_limit: np.ndarray
    """A run ended neither after its pulses nor at the origin, and in time."""
    released: np.ndarray
    """ORG let go before the last approach."""
    searched: np.ndarray
    """Pulses of the search, minus counts."""
    overrun: np.ndarray
    """Pulses by which the search went beyond ORG; 0 where the chip does not tell."""


class Search(ABC):
    """One way to write an origin return, minus to ORG, as a program that cannot branch.

    Attributes:
        box: what an action chooses.
        marks: where the results stand that `found` needs; the same for every program.
    """

    box: RegisterBox
    marks: dict[str, int]

    @abstractmethod
    def program(self, row: np.ndarray) -> Program:
        """A whole return with these choices, in the order of box.names."""

    @abstractmethod
    def found(self, results: np.ndarray, rows: np.ndarray) -> Found:
        """What the results of programs of these rows say, (stages, operations)."""

    def _mark(self, name: str, program: Program) -> Program:
        """The next operation's result is `name`."""
        self.marks[name] = len(program)
        return program


class Host(ABC):
    """Writes programs for one axis."""

    def __init__(self, axis: Axis):
        self.axis, self.index, self.chip = axis, axis.index, axis.chip

    @abstractmethod
    def tuned_by(self, s_curve: bool | None) -> tuple[str, ...]:
        """The registers that make a move what it is. s_curve: ramps; None: S-curves where the chip is made for them.

        Raises ArgumentError where the chip has no S-curves.
        """

    @abstractmethod
    def move(self, program: Program, values: Mapping[str, int], pulses: int) -> None:
        """From power-up to the start of a move of so many pulses, plus: bus cycles. values: of `tuned_by`, by name."""

    @abstractmethod
    def rest(self, program: Program) -> None:
        """What a host does when the move is over, or has taken too long."""

    @abstractmethod
    def formula(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        """The registers of `tuned_by` by the data sheet: rates in pps, ramps in s."""

    @abstractmethod
    def search(self, settings: Any) -> Search:
        """An origin return with the settings of OriginReturn. Raises ArgumentError for what the chip cannot do."""

    def line(self, hosts: Sequence[Host], settings: Any) -> Line:
        """Straight lines with the axes of `hosts`, whose chips are of this one's kind, with the settings of SynchronizedMove.

        Raises ArgumentError where the chips cannot.
        """
        raise ArgumentError(f"chip {type(self.chip).__name__}: no host draws lines with it yet (stage.envs.hosts).")

    def no_s_curves(self) -> ArgumentError:
        return ArgumentError(f"s_curve=True: a {self.chip.MAP.chip} has linear ramps only.")
