"""Descriptions of bus cycles in words: interfaces and base classes for describers of bus cycles and decoders of journals.

    describer = chip.make_describer()            begins with the chip's present state
    describer.write(0, 0x85)                     'select R5: deceleration rate', as in the last column of a bus trace
    describer.read(0, 0xE8)                      'status: operating, neither ramping up nor down, R0 = 0'
    decode(chip.decoder(), journal.entries)      a journal as commands and whole register values

A describer describes each bus cycle. It does not notice a reset pin or a lost write: after these, get a new one from the chip. A
decoder returns commands and whole register values: all bytes of a register are one `Statement`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

from stage.chips.journal_entries import LOST, RESET, WRITE, Entry
from stage.chips.register_map import Field, Register, Word

MAX_LINE_LENGTH = 120
"""Largest number of characters in a line that describes a bus cycle."""
MAX_DECIMAL_BITS = 4
"""Largest number of bits of a number that is shown only in decimal; longer numbers are shown in hexadecimal as well."""
MAX_CACHED_LINES = 4096


class Statement(NamedTuple):
    """One command, or one register written with all its words.

    Attributes:
        clock: Reference clocks since power-up, at the last write.
        kind: "command", "register", "reset", or "lost" for a write that did not arrive.
        code: Bytes or words written, in hexadecimal.
        meaning: Meaning of the bytes or words, in English.
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


class CycleDescriber(Protocol):
    """Describer of the bus cycles of one chip, each in a line of ASCII of at most MAX_LINE_LENGTH characters. It never raises."""

    def write(self, address: int, value: int) -> str:
        """Describe a write cycle that follows the cycles described before.

        Args:
            address: Bus address.
            value: Datum.
        """

    def read(self, address: int, value: int) -> str:
        """Describe a read cycle that follows the cycles described before.

        Args:
            address: Bus address.
            value: Datum that the cycle returned.
        """


class Decoder:
    """Base class of decoders, which convert journal entries to commands and whole register values.

    The entries may come in pieces, one call of `decode` each.
    """

    def decode(self, entries: Iterable[Entry]) -> list[Statement]:
        """Decode further entries of a journal.

        Args:
            entries: Entries of a journal, after those of earlier calls.

        Returns:
            Commands and register values. The last writes may wait for later ones, see `flush`.
        """
        statements: list[Statement] = []
        for e in entries:
            if e.kind == WRITE:
                statements += self.decode_write(e.clock, e.a, e.b)
            elif e.kind == RESET:
                statements += self.flush()
                self.reset()
                statements.append(Statement(e.clock, "reset", "/RESET", "reset pin"))
            elif e.kind == LOST:
                code, meaning = self.describe_lost_write(e.a, e.b)
                statements.append(Statement(e.clock, "lost", code, f"LOST: {meaning}"))
        return statements

    def flush(self) -> list[Statement]:
        """Return the statements of writes that have waited for later writes, at the end of a journal."""
        return []

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        """Decode a write, together with earlier writes that needed it to be complete.

        Args:
            clock: Reference clocks since power-up.
            address: Bus address.
            value: Datum.
        """
        raise NotImplementedError

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        """Return the code and the meaning of a write that did not arrive.

        Args:
            address: Bus address.
            value: Datum.
        """
        raise NotImplementedError

    def reset(self) -> None:
        """Forget all writes, because the reset pin of the chip was asserted."""


def decode(decoder: Decoder, entries: Iterable[Entry]) -> list[Statement]:
    """Return the writes of a journal as commands and whole register values.

    Args:
        decoder: A new decoder of the chip's family.
        entries: The journal's entries.
    """
    return decoder.decode(entries) + decoder.flush()


class FieldDescriber:
    """Describer of the contents of a register or word, field by field.

    Args:
        place: The register or word.
        silent: Whether to leave out values without information, see `Field.silent`.
    """

    def __init__(self, place: Register | Word, silent: bool = True):
        self._fields = [
            (f, f.low, f.mask >> f.low, _list_meanings(f, silent)) for f in place.fields if f.name != "group"
        ]
        self._lines: dict[tuple[str, int, str], str] = {}

    def describe(self, head: str, value: int, tail: str = "") -> str:
        """Describe the contents of the register or word in one line.

        Args:
            head: Words before the fields.
            value: Contents of the register or word.
            tail: Words behind the fields.

        Returns:
            `head`, the descriptions of the fields, and `tail`. If the line is too long, only the names of the longest fields
            appear.
        """
        known = self._lines.get((head, value, tail))
        if known is None:
            if len(self._lines) >= MAX_CACHED_LINES:
                self._lines.clear()
            words = self._join_descriptions(value, MAX_LINE_LENGTH - len(head) - len(tail) - 2)
            known = self._lines[head, value, tail] = shorten_line(f"{head}: {words}{tail}")
        return known

    def _join_descriptions(self, value: int, room: int) -> str:
        """Join the descriptions of all fields, in at most `room` characters."""
        words, names = [], []
        for f, low, mask, sayings in self._fields:
            v = value >> low & mask
            text = sayings.get(v) or (_describe_number(f, v) if v and f.high > f.low else "")
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


def shorten_line(text: str) -> str:
    """Return a text, cut off if it is longer than MAX_LINE_LENGTH characters, a line of a bus trace."""
    return text if len(text) <= MAX_LINE_LENGTH else text[: MAX_LINE_LENGTH - 3] + "..."


def describe_byte(name: str, byte_number: int, value: int) -> str:
    """Describe one byte of a register.

    Args:
        name: Name of the register.
        byte_number: Number of the byte; the lowest is 0.
        value: Its new value.
    """
    return f"{name} bits {8 * byte_number + 7}..{8 * byte_number} = {value:02X}h"


def _list_meanings(field: Field, silent: bool) -> dict[int, str]:
    """Return the descriptions that the register map has for the values of a field: value -> words."""
    values = field.values or {1: field.meaning}
    return {v: field.describe_value(v) for v in values if not (silent and v == field.silent)}


def _describe_number(field: Field, value: int) -> str:
    """Describe a value of a field for which the register map has no words."""
    subject = field.meaning or field.name
    return f"{subject} = {value}" if field.high - field.low < MAX_DECIMAL_BITS else f"{subject} = {value:X}h ({value})"
