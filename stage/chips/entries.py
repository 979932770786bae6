"""The entries of a journal, packed: 32 bytes an event, so that millions of them need little memory."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, overload

import numpy as np

WRITE, INPUT, RESET, LOST, READ, SHAFT = range(6)
LOAD = -1
PACKED = np.dtype([(name, "i8") for name in ("clock", "kind", "a", "b")])


def bits(number: float) -> int:
    """A float64 as the whole number of the same bits, for an entry."""
    return int(struct.unpack("q", struct.pack("d", number))[0])


def number(bits: int) -> float:
    """The float64 of these bits."""
    return float(struct.unpack("d", struct.pack("q", bits))[0])


class Entry(NamedTuple):
    """One event between two ticks: WRITE (address, value), INPUT (axis, pin word), RESET, LOST, a write that did not arrive,
    READ (address, value), a read cycle that changes something, see `Chip.READING_ACTS`, or SHAFT + j (count, rate, both as `bits`):
    where the shaft of axis `j` is from then on, in counts and counts a clock. LOAD - j (angle,
    share, both as `bits`): a sample of its motor's load, see `cores.set_load`."""

    clock: int
    kind: int
    a: int
    b: int

    def apply(self, core: Any, c: Any) -> None:
        """Let it happen to the chip of state `c` (a record, an array of one, an address), whose core this is."""
        given: tuple[float, ...] = ()
        kind = self.kind
        if kind == INPUT:
            does, given = core.set_input, (self.a, self.b)
        elif kind == WRITE:
            does, given = core.write, (self.a, self.b)
        elif kind == READ:
            does, given = core.read, (self.a,)
        elif kind >= SHAFT:
            does, given = core.set_shaft, (kind - SHAFT, number(self.a), number(self.b))
        elif kind <= LOAD:
            does, given = core.set_load, (LOAD - kind, number(self.a), number(self.b))
        elif kind == RESET:
            does = core.power_up
        else:
            return
        (does.c if isinstance(c, int) else does)(c, *given)


class Entries(Sequence[Entry]):
    """A sequence that makes each `Entry` from the packed bytes when it is read."""

    def __init__(self) -> None:
        self._words = array("q")

    def note(self, clock: int, kind: int, a: int, b: int) -> None:
        """One more at the end."""
        self._words.extend((clock, kind, a, b))

    def extend(self, packed: np.ndarray) -> None:
        """PACKED records at the end."""
        self._words.frombytes(packed.tobytes())

    def packed(self) -> np.ndarray:
        """A copy as PACKED records."""
        return np.frombuffer(self._words.tobytes(), PACKED)

    def __len__(self) -> int:
        return len(self._words) // 4

    def __iter__(self) -> Iterator[Entry]:
        words = iter(self._words)
        return map(Entry._make, zip(words, words, words, words, strict=True))

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
                part._words.frombytes(self.packed()[k].tobytes())
            return part
        at = range(len(self))[k] * 4
        return Entry._make(self._words[at : at + 4])
