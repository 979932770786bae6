"""The meaning of bus cycles, in words of the register map. Each family has two classes for it, in its describe.py.

    listener = chip.listener()     begins with the chip's present state: the last column of a bus trace
    listener.write(0, 0x85)        'select R5: deceleration rate'
    listener.read(0, 0xE8)         'status: operating, neither ramping up nor down, R0 = 0'
    decode(chip.decoder(), journal.entries)      a journal as commands and whole register values

A listener describes each bus cycle, given those before it. It sees bus cycles only: after a reset pin or a lost write, get a new
one from the chip. A decoder gives the commands and register values as a whole: all bytes of a register are one `Statement`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

from stage.chips.entries import LOST, RESET, WRITE, Entry
from stage.chips.register_map import Field, Register, Word

MAX_LINE_LENGTH = 120
"""Characters of a sentence."""
MAX_DECIMAL_BITS = 4
"""Numbers of more bits are given in hexadecimal, too."""
MAX_CACHED_LINES = 4096


class Statement(NamedTuple):
    """One command, or one register written with all its words.

    Attributes:
        clock: Reference clocks since power-up, at the last write.
        kind: "command", "register", "reset", or "lost": a write that did not arrive.
        code: The bytes or words written, in hexadecimal.
        meaning: What they say, in words.
        register: Name of the register in the map; "" for a command.
        value: Value of the register.
    """

    clock: int
    kind: str
    code: str
    meaning: str
    register: str = ""
    value: int = 0

    def __str__(self) -> str:
        return f"{self.code}  {self.meaning}"


class Listener(Protocol):
    """Descriptions of bus cycles: each a line of ASCII of at most LONGEST characters. A listener never raises."""

    def write(self, address: int, value: int) -> str:
        """Describe a write cycle, given those before it.

        Args:
            address: Bus address.
            value: Datum.
        """

    def read(self, address: int, value: int) -> str:
        """Describe a read cycle.

        Args:
            address: Bus address.
            value: Datum that it returned.
        """


class Decoder:
    """Base class of decoders: journal entries become commands and whole register values, a part at a time."""

    def take(self, entries: Iterable[Entry]) -> list[Statement]:
        """Decode further entries.

        Args:
            entries: Entries of a journal, after those of the calls before.

        Returns:
            Commands and register values. The last writes may wait for what comes next, see `rest`.
        """
        statements: list[Statement] = []
        for e in entries:
            if e.kind == WRITE:
                statements += self.wrote(e.clock, e.a, e.b)
            elif e.kind == RESET:
                statements += self.rest()
                self.reset()
                statements.append(Statement(e.clock, "reset", "/RESET", "reset pin"))
            elif e.kind == LOST:
                code, meaning = self.lost(e.a, e.b)
                statements.append(Statement(e.clock, "lost", code, f"LOST: {meaning}"))
        return statements

    def rest(self) -> list[Statement]:
        """Return what still waited for further writes."""
        return []

    def wrote(self, clock: int, address: int, value: int) -> list[Statement]:
        """Decode a write, and what waited for it.

        Args:
            clock: Reference clocks since power-up.
            address: Bus address.
            value: Datum.
        """
        raise NotImplementedError

    def lost(self, address: int, value: int) -> tuple[str, str]:
        """Return code and meaning of a write that did not arrive.

        Args:
            address: Bus address.
            value: Datum.
        """
        raise NotImplementedError

    def reset(self) -> None:
        """Forget all writes: the reset pin was asserted."""


def decode(decoder: Decoder, entries: Iterable[Entry]) -> list[Statement]:
    """Return the writes of a journal as commands and whole register values.

    Args:
        decoder: A new decoder of the chip's family.
        entries: The journal's entries.
    """
    return decoder.take(entries) + decoder.rest()


class Fields:
    """Descriptions of a register's or word's contents, field by field.

    Args:
        place: The register or word.
        silent: Leave out values without information, see `Field.silent`.
    """

    def __init__(self, place: Register | Word, silent: bool = True):
        self._fields = [
            (f, f.low, f.mask >> f.low, _list_meanings(f, silent)) for f in place.fields if f.name != "group"
        ]
        self._lines: dict[tuple[str, int, str], str] = {}

    def tell(self, head: str, value: int, tail: str = "") -> str:
        """Describe a value.

        Args:
            head: Words before the fields.
            value: Contents of the register or word.
            tail: Words behind the fields.

        Returns:
            `head`, the fields that have something to say, and `tail`. If all words are too long, the longest fields are
            given by name.
        """
        known = self._lines.get((head, value, tail))
        if known is None:
            if len(self._lines) >= MAX_CACHED_LINES:
                self._lines.clear()
            words = self._words(value, MAX_LINE_LENGTH - len(head) - len(tail) - 2)
            known = self._lines[head, value, tail] = line(f"{head}: {words}{tail}")
        return known

    def _words(self, value: int, room: int) -> str:
        words, names = [], []
        for f, low, mask, sayings in self._fields:
            v = value >> low & mask
            text = sayings.get(v) or (_number(f, v) if v and f.high > f.low else "")
            if text:
                words.append(text)
                names.append(text if not v else f.name if f.high == f.low else f"{f.name} {v:X}h")
        if not words:
            return "nothing to report" if value else "all bits 0"
        length = sum(map(len, words)) + 2 * len(words) - 2
        for k in sorted(range(len(words)), key=lambda k: len(names[k]) - len(words[k])):
            if length > room:
                length += len(names[k]) - len(words[k])
                words[k] = names[k]
        return (", " if length <= room else " ").join(words)


def line(text: str) -> str:
    """Return a text, cut where it is longer than a line of a trace."""
    return text if len(text) <= MAX_LINE_LENGTH else text[: MAX_LINE_LENGTH - 3] + "..."


def bits(name: str, byte: int, value: int) -> str:
    """Describe one byte of a register.

    Args:
        name: Name of the register.
        byte: Number of the byte; the lowest is 0.
        value: Its new value.
    """
    return f"{name} bits {8 * byte + 7}..{8 * byte} = {value:02X}h"


def _list_meanings(f: Field, silent: bool) -> dict[int, str]:
    """Return the words that the map has for the values of a field."""
    values = f.values or {1: f.meaning}
    return {v: f.says(v) for v in values if not (silent and v == f.silent)}


def _number(f: Field, v: int) -> str:
    subject = f.meaning or f.name
    return f"{subject} = {v}" if f.high - f.low < MAX_DECIMAL_BITS else f"{subject} = {v:X}h ({v})"
