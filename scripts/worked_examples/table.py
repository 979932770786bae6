"""What a row of the page is, and the few things that every measurement needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage.chips.chip import Chip

Number = int | float


@dataclass(frozen=True)
class Example:
    """A number of a data sheet, and how the emulated chip makes it.

    sheet, place: which sheet, and where in it. says: what the number is. number: the sheet's own, or what its formula gives for the
    registers named. within: by how much the emulated one may differ, in the same unit; why: where that is not 0, why.
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
        """Tell whether this is what the sheet says."""
        return bool(abs(emulated - self.number) <= self.within)


EXAMPLES: list[Example] = []
"""Every row, in the order of the sheets."""


def example(
    sheet: str, place: str, says: str, number: Number, unit: str = "", within: float = 0, why: str = ""
) -> Callable[[Callable[[], Number]], Callable[[], Number]]:
    """Make the function below a row."""

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
    """Let the clock run until `seen(chip)`, which once true stays so: the clocks that this took. `within`: the most clocks."""
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
    """Clocks from each pulse of a trace to the next."""
    return np.diff(pulses["clock"])


def compute_highest_rate(pulses: np.ndarray, hz: int, mean: int = 16) -> float:
    """The highest mean rate of `mean` pulses one after the other, pps."""
    return hz * mean / int((pulses["clock"][mean:] - pulses["clock"][:-mean]).min())
