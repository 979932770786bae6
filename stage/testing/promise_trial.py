"""`PromiseTrial`: chips, random programs and moves with which a promise is tried; and the error `BrokenPromise`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stage.chips import Chip
from stage.testing.chip_acts import (
    Act,
    describe_differences,
    draw_acts,
    draw_drive_starts,
    draw_move,
    limit_pulses,
    list_start_writes,
    perform_acts,
)


class BrokenPromise(Exception):
    """Error of a chip that breaks a promise; its text says what the chip does."""


@dataclass(frozen=True)
class PromiseTrial:
    """Chips, random programs and moves for one promise.

    Attributes:
        kind: Class of the chip.
        make: Makes a chip.
        seed: Seed of all random numbers.
        programs: Number of random programs.
    """

    kind: type[Chip]
    make: Callable[[], Chip]
    seed: int
    programs: int

    def seeded_generators(self) -> Iterator[np.random.Generator]:
        """Yield the random numbers of each program."""
        for k in range(self.programs):
            yield np.random.default_rng([self.seed, k])

    @property
    def counts_pulses(self) -> bool:
        """True if `net` counts the pulses that a trace lists. The `net` of a servo counts its command position."""
        return not self.kind.SERVO

    @cached_property
    def start_writes(self) -> list[Act]:
        """Writes that start a drive, one for each axis."""
        return list_start_writes(self.make())

    def draw_acts(self, rng: np.random.Generator, count: int) -> list[Act]:
        """Draw random acts."""
        return draw_acts(self.kind, rng, count, start_writes=self.start_writes)

    def draw_program(self, rng: np.random.Generator) -> list[Act]:
        """Draw a program: moves of some axes, time, and then random acts; or random acts alone."""
        chip = self.make()
        begin = draw_drive_starts(chip, rng, int(rng.integers(1, 4))) if rng.integers(4) else []
        clocks = (
            chip.clock_hz // 4 if rng.integers(3) == 0 else int(rng.integers(1, 200_000))
        )  # in a quarter second they end
        return limit_pulses([*begin, Act("time", clocks), *self.draw_acts(rng, 25)], chip)

    def draw_drives(self, chip: Chip, rng: np.random.Generator) -> list[Act]:
        """Draw drives of all axes that start now."""
        return limit_pulses(draw_drive_starts(chip, rng, chip.AXES), chip.make_replica())

    def start_move(self, rng: np.random.Generator, slow: bool = False) -> tuple[Chip, int, int]:
        """Start a move on a new chip.

        Returns:
            The chip, its axis, and the pulses to come, negative towards minus; 0 pulses without a driver.
        """
        chip, axis = self.make(), int(rng.integers(self.kind.AXES))
        acts, pulses = draw_move(chip, axis, rng, slow)
        perform_acts(chip, acts)
        return chip, axis, pulses

    def start_moves(self, rng: np.random.Generator) -> Iterator[tuple[Chip, int, int]]:
        """Yield, as `start_move`, a move of each axis in each direction; none for a servo or without a driver."""
        for axis in range(self.kind.AXES if self.kind.DRIVER and self.counts_pulses else 0):
            for direction in (1, -1):
                chip = self.make()
                acts, pulses = draw_move(chip, axis, rng, direction=direction)
                perform_acts(chip, acts)
                yield chip, axis, pulses

    def require_same_state(self, chip: Chip, other: Chip, when: str) -> None:
        """Raise BrokenPromise unless two chips are in the same state, bit for bit."""
        self.require_same_bits(chip.state.tobytes(), other.state.tobytes(), when)

    def require_same_bits(self, one: bytes, other: bytes, when: str) -> None:
        """Raise BrokenPromise unless two states are equal."""
        if one != other:
            raise BrokenPromise(f"{when}, the state differs in {describe_differences(self.kind, one, other)}")


def read_counter(chip: Chip, axis: int) -> int:
    """Read an axis' counter from the core."""
    return int(chip.CORE.read_counter.with_gil(chip.pointer, axis))


def read_visible_state(chip: Chip) -> Any:
    """Return all values of registers, output words and input words of a chip."""
    return (
        chip.values() | {f"{n} of axis {k}": v for k in range(1, chip.AXES) for n, v in chip.values_of(k).items()},
        [chip.output_word(k) for k in range(chip.AXES)],
        [chip.input_word(k) for k in range(chip.AXES)],
    )


def describe_difference(mine: Any, its: Any, when: str = "after power-up") -> str:
    """Describe the first difference of two results of `read_visible_state`.

    Args:
        mine: One result.
        its: The other result.
        when: When `its` was read.
    """
    for name in its[0]:
        if mine[0].get(name) != its[0][name]:
            return f"{name} {mine[0].get(name)}, and {when} {its[0][name]}"
    return f"pins {mine[1:]}, and {when} {its[1:]}"


def format_first_and_last(numbers: np.ndarray) -> str:
    """Format the first numbers and the last one."""
    text = ", ".join(map(str, numbers[:5].tolist()))
    return f"{text} ... {numbers[-1]}" if len(numbers) > 5 else text
