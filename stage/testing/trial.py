"""What a promise is tried with: chips of a kind, random programs and moves, and `Broken`, which a promise raises."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stage.chips import Chip
from stage.testing.hands import Act, beginnings, do_all, driven, fields_that_differ, harmless, under_way, wild


class Broken(Exception):
    """What a chip does in place of what it promises."""


@dataclass(frozen=True)
class Trial:
    """What a promise is tried with. kind, make: the class, and what makes a chip of it."""

    kind: type[Chip]
    make: Callable[[], Chip]
    seed: int
    programs: int

    def draws(self) -> Iterator[np.random.Generator]:
        """For each program its random numbers."""
        for k in range(self.programs):
            yield np.random.default_rng([self.seed, k])

    @cached_property
    def begins(self) -> list[Act]:
        """Writes that begin a drive, one for each axis."""
        return beginnings(self.make())

    def wild(self, rng: np.random.Generator, count: int) -> list[Act]:
        """Random acts."""
        return wild(self.kind, rng, count, begins=self.begins)

    def program(self, rng: np.random.Generator) -> list[Act]:
        """Moves of some axes and their course, then random acts; or such acts alone."""
        chip = self.make()
        begin = under_way(chip, rng, int(rng.integers(1, 4))) if rng.integers(4) else []
        clocks = (
            chip.clock_hz // 4 if rng.integers(3) == 0 else int(rng.integers(1, 200_000))
        )  # in a quarter second they end
        return harmless([*begin, Act("time", clocks), *self.wild(rng, 25)], chip)

    def drives(self, chip: Chip, rng: np.random.Generator) -> list[Act]:
        """Drives of all axes, which begin now."""
        return harmless(under_way(chip, rng, chip.AXES), chip.twin())

    def moving(self, rng: np.random.Generator, slow: bool = False) -> tuple[Chip, int, int]:
        """A chip at the start of a move, its axis, the pulses, below 0 for minus; of a chip without a driver 0 pulses."""
        chip, axis = self.make(), int(rng.integers(self.kind.AXES))
        acts, pulses = driven(chip, axis, rng, slow)
        do_all(chip, acts)
        return chip, axis, pulses

    def moves(self, rng: np.random.Generator) -> Iterator[tuple[Chip, int, int]]:
        """As `moving`, of each axis in either direction; nothing of a servo and of a chip without a driver."""
        for axis in range(self.kind.AXES if self.kind.DRIVER and not self.kind.SERVO else 0):
            for way in (1, -1):
                chip = self.make()
                acts, pulses = driven(chip, axis, rng, way=way)
                do_all(chip, acts)
                yield chip, axis, pulses

    def same(self, chip: Chip, other: Chip, when: str) -> None:
        """Raises Broken where two chips are not in the same state, bit for bit."""
        self.same_bits(chip.state.tobytes(), other.state.tobytes(), when)

    def same_bits(self, one: bytes, other: bytes, when: str) -> None:
        """As `same`, of states."""
        if one != other:
            raise Broken(f"{when}, the state differs in {fields_that_differ(self.kind, one, other)}")
