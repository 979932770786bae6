"""Rows of the page of worked examples, and helpers of their measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage.chips.chip import Chip

Number = int | float


@dataclass(frozen=True)
class Example:
    """Number of a data sheet, and a measurement of it on the emulated chip.

    Attributes:
        sheet: Name of the data sheet.
        place: Section in it.
        says: Meaning of the number.
        number: Number of the data sheet, or of its formula for the named registers.
        unit: Unit of the number.
        measure: Function that measures it on the emulated chip.
        within: Largest allowed difference, in the same unit.
        why: Reason for a difference.
    """

    sheet: str
    place: str
    says: str
    number: Number
    unit: str
    measure: Callable[[], Number]
    within: float = 0
    why: str = ""

    def agrees(self, emulated: Number) -> bool:
        """Return whether a measured number agrees with the data sheet."""
        return bool(abs(emulated - self.number) <= self.within)


EXAMPLES: list[Example] = []
"""Every row, in the order of the sheets."""


def example(
    sheet: str, place: str, says: str, number: Number, unit: str = "", within: float = 0, why: str = ""
) -> Callable[[Callable[[], Number]], Callable[[], Number]]:
    """Register the decorated function as the measurement of an example.

    Args:
        sheet: Name of the data sheet.
        place: Section in it.
        says: Meaning of the number.
        number: Number of the data sheet.
        unit: Unit of the number.
        within: Largest allowed difference, in the same unit.
        why: Reason for a difference.
    """

    def add(measure: Callable[[], Number]) -> Callable[[], Number]:
        EXAMPLES.append(Example(sheet, place, says, number, unit, measure, within, why))
        return measure

    return add


def write_registers(chip: Chip, **registers: int) -> None:
    """Write registers of a chip's first axis, by bus cycles."""
    for name, value in registers.items():
        for address, data in chip.register_cycles(name, value):
            chip.write(address, data)


def find_clock(chip: Chip, observed: Callable[[Any], bool], within: int) -> int:
    """Let the clock run until a condition is true, and return the number of clocks.

    Args:
        chip: Chip to run.
        observed: Condition, which stays true once it is true.
        within: Largest number of clocks.
    """
    started, least, highest = chip.snapshot(), 0, within
    while highest - least > 1:
        chip.restore(started)
        chip.advance((least + highest) // 2)
        least, highest = (least, (least + highest) // 2) if observed(chip) else ((least + highest) // 2, highest)
    chip.restore(started)
    chip.advance(highest)
    if not observed(chip):
        raise ValueError(f"not within {within} clocks.")
    return highest


def compute_intervals(pulses: np.ndarray) -> np.ndarray:
    """Return the clocks from each pulse of a trace to the next."""
    return np.diff(pulses["clock"])


def compute_highest_rate(pulses: np.ndarray, hz: int, mean: int = 16) -> float:
    """Compute the highest mean rate of consecutive pulses, pps.

    Args:
        pulses: Trace of pulses.
        hz: Clock of the chip, Hz.
        mean: Number of pulses over which the rate is averaged.
    """
    return hz * mean / int((pulses["clock"][mean:] - pulses["clock"][:-mean]).min())
