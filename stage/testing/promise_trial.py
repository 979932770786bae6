"""`PromiseTrial`: chips, random programs and moves for checking a promise; and the error `BrokenPromise`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stage.chips import Chip
from stage.testing.chip_actions import (
    Act,
    describe_differences,
    draw_acts,
    draw_drive_start_writes,
    draw_move,
    limit_pulses,
    list_start_writes,
    perform_acts,
)


class BrokenPromise(Exception):
    """Error of a chip that breaks a promise. The message says what the chip does instead."""


@dataclass(frozen=True)
class PromiseTrial:
    """Chips, random programs and moves for checking one promise.

    Attributes:
        chip_class: Class of the chip.
        make: Function that creates a chip.
        seed: Seed of all random numbers.
        programs: Number of random programs.
    """

    chip_class: type[Chip]
    make: Callable[[], Chip]
    seed: int
    programs: int

    def make_seeded_generators(self) -> Iterator[np.random.Generator]:
        """Yield a random number generator for each program, with a seed of its own."""
        for k in range(self.programs):
            yield np.random.default_rng([self.seed, k])

    @property
    def counts_pulses(self) -> bool:
        """True if `net` counts the pulses that a trace lists. The `net` of a servo counts its command position."""
        return not self.chip_class.SERVO

    @cached_property
    def start_writes(self) -> list[Act]:
        """Writes that start a drive, one for each axis."""
        return list_start_writes(self.make())

    def draw_acts(self, rng: np.random.Generator, count: int) -> list[Act]:
        """Draw random actions on the chip."""
        return draw_acts(self.chip_class, rng, count, self.start_writes)

    def draw_program(self, rng: np.random.Generator) -> list[Act]:
        """Draw a program: moves of some axes, time, and then random acts; or random acts alone."""
        chip = self.make()
        begin = draw_drive_start_writes(chip, rng, int(rng.integers(1, 4))) if rng.integers(4) else []
        # in a quarter second they end
        clocks = chip.clock_hz // 4 if rng.integers(3) == 0 else int(rng.integers(1, 200_000))
        return limit_pulses([*begin, Act("time", clocks), *self.draw_acts(rng, 25)], chip)

    def draw_drives(self, chip: Chip, rng: np.random.Generator) -> list[Act]:
        """Draw writes that start a drive on each axis now."""
        return limit_pulses(draw_drive_start_writes(chip, rng, chip.AXES), chip.make_replica())

    def start_move(self, rng: np.random.Generator, slow: bool = False) -> tuple[Chip, int, int]:
        """Start a move on a new chip.

        Returns:
            The chip, its axis, and the pulses to come, negative towards minus; 0 pulses without a driver.
        """
        chip, axis = self.make(), int(rng.integers(self.chip_class.AXES))
        acts, pulses = draw_move(chip, axis, rng, slow)
        perform_acts(chip, acts)
        return chip, axis, pulses

    def start_moves(self, rng: np.random.Generator) -> Iterator[tuple[Chip, int, int]]:
        """Start a move of each axis in each direction, and yield what `start_move` returns.

        There are no moves for a servo or without a driver.
        """
        for axis in range(self.chip_class.AXES if self.chip_class.DRIVER and self.counts_pulses else 0):
            for direction in (1, -1):
                chip = self.make()
                acts, pulses = draw_move(chip, axis, rng, direction=direction)
                perform_acts(chip, acts)
                yield chip, axis, pulses

    def require_same_state(self, chip: Chip, other: Chip, when: str) -> None:
        """Raise BrokenPromise unless two chips are in the same state, bit for bit."""
        self.require_same_bits(chip.state.tobytes(), other.state.tobytes(), when)

    def require_same_bits(self, first: bytes, second: bytes, when: str) -> None:
        """Raise BrokenPromise unless two states are equal."""
        if first != second:
            raise BrokenPromise(f"{when}, the state differs in {describe_differences(self.chip_class, first, second)}")


def read_counter(chip: Chip, axis: int) -> int:
    """Read an axis' counter from the core of its chip."""
    return int(chip.CORE.read_counter.with_gil(chip.pointer, axis))


def read_visible_state(chip: Chip) -> Any:
    """Return everything of a chip that can be seen: the values of all registers, and the output and input words."""
    return (
        chip.values() | {f"{n} of axis {k}": v for k in range(1, chip.AXES) for n, v in chip.axis_values(k).items()},
        [chip.output_word(k) for k in range(chip.AXES)],
        [chip.input_word(k) for k in range(chip.AXES)],
    )


def describe_difference(first: Any, second: Any, when: str = "after power-up") -> str:
    """Describe the first difference between two results of `read_visible_state`.

    Args:
        first: One result.
        second: The other result.
        when: When `second` was read, for the message.
    """
    for name in second[0]:
        if first[0].get(name) != second[0][name]:
            return f"{name} {first[0].get(name)}, and {when} {second[0][name]}"
    return f"pins {first[1:]}, and {when} {second[1:]}"


def format_first_and_last(numbers: np.ndarray) -> str:
    """Format the first numbers and the last one."""
    text = ", ".join(map(str, numbers[:5].tolist()))
    return f"{text} ... {numbers[-1]}" if len(numbers) > 5 else text
