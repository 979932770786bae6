"""The meaning of bus cycles, in words of the register map. Each family has two classes for it, in its describe.py.

    listener = chip.listener()     begins with the chip's present state: the last column of a bus trace
    listener.write(0, 0x85)        'select R5: deceleration rate'
    listener.read(0, 0xE8)         'status: operating, neither ramping up nor down, R0 = 0'
    decode(chip.decoder(), journal.entries)      a journal as commands and whole register values

A listener describes each bus cycle, given those before it. It sees bus cycles only: after a reset pin or a lost write, get a new
one from the chip. A decoder gives the commands and register values as a whole: all bytes of a register are one `Said`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

from stage.chips.entries import LOST, RESET, WRITE, Entry
from stage.chips.register_map import Field, Register, Word

LONGEST = 120
"""Characters of a sentence."""
WIDE = 4
"""Numbers of more bits are given in hexadecimal, too."""
_MANY = 4096


class Said(NamedTuple):
    """One command, or one register written with all its words. `clock`: of the last write; `kind`: command, register, reset,
    lost (a write that did not arrive). `register`, `value`: which register and what, where a map has it by name."""

    clock: int
    kind: str
    code: str
    meaning: str
    register: str = ""
    value: int = 0

    def __str__(self) -> str:
        return f"{self.code}  {self.meaning}"


class Listener(Protocol):
    """The meaning of each bus cycle, as one line of ASCII of at most LONGEST characters. Never raises."""

    def write(self, address: int, value: int) -> str:
        """What this write cycle says, given those before."""

    def read(self, address: int, value: int) -> str:
        """What this read cycle, which returned `value`, said."""


class Decoder:
    """Journal entries as commands and whole register values, in parts. A family defines the meaning of its writes and resets."""

    def take(self, entries: Iterable[Entry]) -> list[Said]:
        """What `entries` say, after those before; the last writes may wait for what comes next, see `rest`."""
        said: list[Said] = []
        for e in entries:
            if e.kind == WRITE:
                said += self.wrote(e.clock, e.a, e.b)
            elif e.kind == RESET:
                said += self.rest()
                self.reset()
                said.append(Said(e.clock, "reset", "/RESET", "reset pin"))
            elif e.kind == LOST:
                code, meaning = self.lost(e.a, e.b)
                said.append(Said(e.clock, "lost", code, f"LOST: {meaning}"))
        return said

    def rest(self) -> list[Said]:
        """What nothing followed, if anything."""
        return []

    def wrote(self, clock: int, address: int, value: int) -> list[Said]:
        """What a write says, and what waited for it."""
        raise NotImplementedError

    def lost(self, address: int, value: int) -> tuple[str, str]:
        """Code and meaning of a write that did not arrive."""
        raise NotImplementedError

    def reset(self) -> None:
        """The reset pin: forget."""


def decode(decoder: Decoder, entries: Iterable[Entry]) -> list[Said]:
    """A journal's writes as commands and whole register values."""
    return decoder.take(entries) + decoder.rest()


class Fields:
    """Describes the contents of a register or word, field by field.

    silent: values without information are left out, see `Field.silent`.
    """

    def __init__(self, place: Register | Word, silent: bool = True):
        self._fields = [(f, f.low, f.mask >> f.low, _sayings(f, silent)) for f in place.fields if f.name != "group"]
        self._lines: dict[tuple[str, int, str], str] = {}

    def tell(self, head: str, value: int, tail: str = "") -> str:
        """`head`, the fields that say something, and `tail`; the longest fields by name where there is not room for all words."""
        known = self._lines.get((head, value, tail))
        if known is None:
            if len(self._lines) >= _MANY:
                self._lines.clear()
            words = self._words(value, LONGEST - len(head) - len(tail) - 2)
            known = self._lines[head, value, tail] = line(f"{head}: {words}{tail}")
        return known

    def _words(self, value: int, room: int) -> str:
        words, names = [], []
        for f, low, mask, sayings in self._fields:
            v = value >> low & mask
            said = sayings.get(v) or (_number(f, v) if v and f.high > f.low else "")
            if said:
                words.append(said)
                names.append(said if not v else f.name if f.high == f.low else f"{f.name} {v:X}h")
        if not words:
            return "nothing to report" if value else "all bits 0"
        length = sum(map(len, words)) + 2 * len(words) - 2
        for k in sorted(range(len(words)), key=lambda k: len(names[k]) - len(words[k])):
            if length > room:
                length += len(names[k]) - len(words[k])
                words[k] = names[k]
        return (", " if length <= room else " ").join(words)


def line(text: str) -> str:
    """`text`, cut where it is too long."""
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def bits(name: str, byte: int, value: int) -> str:
    """One byte of a register, the lowest is byte 0."""
    return f"{name} bits {8 * byte + 7}..{8 * byte} = {value:02X}h"


def _sayings(f: Field, silent: bool) -> dict[int, str]:
    """What the map says of the values of a field."""
    values = f.values or {1: f.meaning}
    return {v: f.says(v) for v in values if not (silent and v == f.silent)}


def _number(f: Field, v: int) -> str:
    subject = f.meaning or f.name
    return f"{subject} = {v}" if f.high - f.low < WIDE else f"{subject} = {v:X}h ({v})"
