"""Entries of a chip's journal: one entry for each write, read, reset, or change of an input.

`Entries` stores an entry in 32 bytes, so that millions of them need little memory.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import Any, NamedTuple, overload

import numpy as np


class EntryKind(IntEnum):
    """Kinds of events in a journal."""

    WRITE = 0
    """A bus write cycle: address, value."""
    INPUT = 1
    """The input pins of an axis changed: axis, pin word."""
    RESET = 2
    LOST = 3
    """A write that did not arrive: address, value."""
    READ = 4
    """A read cycle that changes something, see `Chip.READING_ACTS`: address, value."""
    SHAFT = 5
    """Where the shaft of the axis is from now on: count and counts a clock, both as `bits`."""
    LOAD = 6
    """A sample of the load of the axis' motor, see `core_interface.set_load`: angle and share, both as `bits`."""
    WIRES = 7
    """What other chips drive onto the wires between them, see stage/chips/linked_chips.py: the word."""


WRITE, INPUT, RESET, LOST, READ, SHAFT, LOAD, WIRES = map(int, EntryKind)  # for compiled code
PACKED = np.dtype([("clock", "i8"), ("kind", "i4"), ("axis", "i4"), ("a", "i8"), ("b", "i8")])
AXIS_SHIFT = 32
"""Lowest bit of the axis in the second word of a packed entry."""


def float_to_bits(number: float) -> int:
    """Return the integer that has the same 64 bits as a float64, so that an entry can store it."""
    return int(struct.unpack("q", struct.pack("d", number))[0])


def bits_to_float(bits: int) -> float:
    """Return the float64 that has the same 64 bits as an integer."""
    return float(struct.unpack("d", struct.pack("q", bits))[0])


class Entry(NamedTuple):
    """One input that a chip received: a bus cycle, a change of pins, a reset, or a position of a shaft.

    Attributes:
        clock: Reference clocks since power-up.
        kind: A `EntryKind`, which defines the meaning of a and b.
        a: First operand, such as the address of a write.
        b: Second operand, such as the datum of a write.
        axis: Axis of a SHAFT or a LOAD.
    """

    clock: int
    kind: int
    a: int
    b: int
    axis: int = 0

    def apply(self, core: Any, chip_state: Any) -> None:
        """Repeat, on a chip, the input that this entry holds.

        Args:
            core: Core of the chip's family.
            chip_state: State of the chip: a record, an array of one, or an address.
        """
        args: tuple[float, ...] = ()
        kind = self.kind
        if kind == INPUT:
            function, args = core.set_input, (self.a, self.b)
        elif kind == WRITE:
            function, args = core.write, (self.a, self.b)
        elif kind == READ:
            function, args = core.read, (self.a,)
        elif kind == SHAFT:
            function, args = core.set_shaft, (self.axis, bits_to_float(self.a), bits_to_float(self.b))
        elif kind == LOAD:
            function, args = core.set_load, (self.axis, bits_to_float(self.a), bits_to_float(self.b))
        elif kind == WIRES:
            function, args = core.set_wire_word, (self.a,)
        elif kind == RESET:
            function = core.power_up
        else:
            return
        (function.c if isinstance(chip_state, int) else function)(chip_state, *args)


class Entries(Sequence[Entry]):
    """Sequence of entries, packed, that unpacks each `Entry` when it is read."""

    def __init__(self) -> None:
        self._words = array("q")

    def append(self, clock: int, kind: int, a: int, b: int, axis: int = 0) -> None:
        """Append an entry of a journal, given by its fields.

        Args:
            clock: Reference clocks since power-up.
            kind: A `EntryKind`.
            a: First number.
            b: Second number.
            axis: Axis of a SHAFT or a LOAD.
        """
        self._words.extend((clock, kind | axis << AXIS_SHIFT, a, b))

    def extend(self, packed: np.ndarray) -> None:
        """Append entries given as records of the dtype PACKED."""
        self._words.frombytes(packed.tobytes())

    def to_packed(self) -> np.ndarray:
        """Return a copy of the entries as records of the dtype PACKED."""
        return np.frombuffer(self._words.tobytes(), PACKED)

    def __len__(self) -> int:
        return len(self._words) // 4

    def __iter__(self) -> Iterator[Entry]:
        words = iter(self._words)
        return map(_unpack, zip(words, words, words, words, strict=True))

    @overload
    def __getitem__(self, k: int) -> Entry: ...

    @overload
    def __getitem__(self, k: slice) -> Entries: ...

    def __getitem__(self, k: int | slice) -> Entry | Entries:
        if isinstance(k, slice):
            part, (start, stop, step) = Entries(), k.indices(len(self))
            if step == 1:  # without a copy of all
                part._words = self._words[4 * start : 4 * max(start, stop)]
            else:
                part._words.frombytes(self.to_packed()[k].tobytes())
            return part
        at = range(len(self))[k] * 4
        return _unpack(self._words[at : at + 4])


def _unpack(words: Sequence[int]) -> Entry:
    """Convert the words of a packed entry to an `Entry`."""
    clock, kind, a, b = words
    return Entry(clock, kind & (1 << AXIS_SHIFT) - 1, a, b, kind >> AXIS_SHIFT)
