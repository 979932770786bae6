"""What the front panel of a chip shows and takes, made from its register map. No page, and no chip by name.

front = Front(PCL240MS)
front.buttons["operate: ..."]              [Button("15h", "start with a ramp to FH1", "operate", 0x15), ...]
number("1F40h", 13)                  8000
shown(register, 8000), meant(register, 8000)
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from stage.chips.chip import Chip
from stage.chips.register_map import EVIDENCE, Field, Register, Word
from stage.errors import ArgumentError
from stage.units import MOST, WHOLE, whole

BY_ROWS = ("data write", "mode write")
"""Kinds of commands that a register's row sends when somebody writes there."""


@dataclass(frozen=True)
class Button:
    """A command that can be sent. label: short; words: the sheet's; title: all that the map says; symbol, datum: as
    `Chip.command_cycles` takes them; takes: bits of the data that somebody has to give, 0 for none."""

    label: str
    title: str
    symbol: str
    datum: int | None
    evidence: str
    takes: int = 0
    starts: bool = False
    words: str = ""


class Front:
    """The front panel of a kind of chip.

    Attributes:
        registers: a row each. forms: words that a host composes of fields. lamps: words that it reads. buttons: commands by
        group; empty where the family does not say how its commands are sent.
    """

    def __init__(self, kind: type[Chip]):
        self.kind, self.map = kind, kind.MAP
        self.registers: tuple[Register, ...] = self.map.registers
        written = tuple(w for w in self.map.words if w.written and w.fields)
        coded = {c.address for c in written if self.map.commands} & {0}
        self.forms = tuple(w for w in written if w.address not in coded and not _is_data(w))
        self.lamps = tuple(w for w in self.map.words if not w.written and any("R" in f.access for f in w.fields))
        self.buttons: dict[str, list[Button]] = {}
        for group, button in (*self._of_words(written, coded), *self._of_commands()):
            if self._sendable(button):
                self.buttons.setdefault(group, []).append(button)

    def _of_words(self, written: tuple[Word, ...], coded: set[int | None]) -> Iterator[tuple[str, Button]]:
        for w in written:
            if w.address in coded:
                continue
            chosen = [f for f in w.fields if not fixed(f)]
            values = chosen[0].values if len(chosen) == 1 and chosen[0].low == 0 else {}
            for code, title in (w.sends or values).items():
                label = f"{w.fixed | code:0{w.bits // 4}X}h"
                yield f"{w.name}: {w.title}", Button(label, title, w.name, code, worst(w.fields), words=title)

    def _of_commands(self) -> Iterator[tuple[str, Button]]:
        for c in self.map.commands:
            if c.kind in BY_ROWS:
                continue
            if c.choice:
                for k, name in enumerate(c.chooses):
                    title = f"{c.title} {name}"
                    yield c.kind, Button(f"{c.symbol} {name}", title, c.symbol, 1 << k, c.evidence, words=title)
            else:
                takes = 0 if "read" in c.kind else 8 * c.bytes
                title = f"{c.hex}  {c.what}" + (f"; lacking: {c.lacking}" if c.lacking else "")
                yield c.kind, Button(c.symbol, title, c.symbol, None, c.evidence, takes, c.starts, c.title)

    def _sendable(self, button: Button) -> bool:
        try:
            self.kind.command_cycles(button.symbol, 0, button.datum if not button.takes else 0)
        except NotImplementedError:
            return False
        return True


def evidence(letter: str) -> str:
    """What an evidence letter says."""
    return f"{letter}: {EVIDENCE.get(letter, 'not said')}"


def span(register: Register) -> str:
    """The values that it takes, as the sheet says, or as its bits are."""
    low, high = register.range
    said = " or ".join([f"{low} to {high}", *map(str, register.also)])
    return said if register.legal else f"{said} ({register.bits} bits)"


def shown(register: Register | Word, value: int) -> str:
    """A value as its field shows it: bits in hexadecimal, numbers in decimal."""
    if register.fields:
        return f"{value & (1 << register.bits) - 1:0{(register.bits + 3) // 4}X}h"
    return str(register.value(value) if isinstance(register, Register) else value)


def meant(register: Register | Word, value: int) -> str:
    """What a value means beside its number: its fields in words, but for what says nothing, or hexadecimal."""
    word = value & (1 << register.bits) - 1
    if not register.fields:
        return f"{word:X}h" if abs(value) > 9 else ""
    told = [f for f in register.fields if not fixed(f) and f.of(word) != f.silent]
    said = [f.says(f.of(word)) or (f"{f.name} = {f.of(word)}" if f.of(word) else "") for f in told]
    return ", ".join(text for text in said if text)


def choices(field: Field) -> dict[int, str]:
    """What a field can be, for a list; empty where it is a number."""
    if field.values:
        return {v: f"{v}  {text}" for v, text in field.values.items()}
    return {}


def with_field(word: int, field: Field, value: int) -> int:
    """`word` with another value of one field."""
    return word & ~field.mask | value << field.low & field.mask


def number(text: str, bits: int) -> int:
    """What somebody has typed, a whole number that so many bits hold: decimal, 0x1F or 1Fh, 0b101; with a sign it is two's
    complement. Raises ArgumentError, with what was probably meant."""
    typed = re.sub(r"[_\s]", "", text)
    if len(typed) > MOST:
        raise ArgumentError(f"a number of {len(typed)} characters needs more than {bits} bits.")
    if (value := whole(typed)) is None:
        raise ArgumentError(_no_number(text, re.sub(r"^[-+]", "", typed)))
    if not -(1 << bits - 1) <= value < 1 << bits:
        raise ArgumentError(f"{text.strip()} needs more than {bits} bits: {-(1 << bits - 1)} to {(1 << bits) - 1} fit.")
    return value


def _no_number(text: str, digits: str) -> str:
    if not digits:
        return "a number is missing: 100, 64h or 0x64, 0b1100100."
    if re.fullmatch(r"[0-9a-fA-F]+", digits):
        return f"{text.strip()!r} is no decimal number. Did you mean {digits.upper()}h ({int(digits, 16)})?"
    if re.fullmatch(r"[0-9]*[.,][0-9]*", digits):
        return f"{text.strip()!r}: registers hold whole numbers. Did you mean {digits.replace(',', '.').partition('.')[0] or 0}?"
    near = digits.translate(str.maketrans("OoIl", "0011"))
    if re.fullmatch(WHOLE, near):
        return f"{text.strip()!r} is no number. Did you mean {near}?"
    return f"{text.strip()!r} is no number: 100, 64h or 0x64, 0b1100100."


def fixed(field: Field) -> bool:
    """Bits that tell a word from others of its address: nobody chooses them."""
    return field.legal is not None and field.legal[0] == field.legal[1]


def _is_data(word: Word) -> bool:
    """One number without words: the data of commands."""
    return len(word.fields) == 1 and not word.fields[0].values and word.fields[0].mask.bit_count() == word.bits


def lit(field: Field, value: int) -> tuple[str, bool]:
    """A field as a lamp: its words, and whether it is on, that is, says something."""
    on = value != (0 if field.silent is None else field.silent)
    if field.high != field.low:
        return f"{field.says(value) or f'{field.name} {value}'}", on
    return field.says(value) or field.meaning or field.name, on


def worst(fields: tuple[Field, ...]) -> str:
    """The weakest that the parts have."""
    letters = list(EVIDENCE)
    return max((f.evidence for f in fields), key=lambda e: letters.index(e) if e in letters else 0)
