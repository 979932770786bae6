"""Builders of bits, bit groups and words for the register maps of the NOVA chips."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from stage.chips.register_map import Field, Word

AXIS_LETTERS = "XYZU"
LEVELS = ("low", "high")
DCC_WIDTHS_US = (10, 20, 100, 200, 1000, 2000, 10_000, 20_000)
"""Pulse width of the deviation counter clear output, us, by its code."""
Values = tuple[str, ...] | Mapping[int, str]
"""Meanings of the values of a field: a sequence from 0 on, or a mapping by value."""


def format_times(microseconds: Iterable[int]) -> tuple[str, ...]:
    """Format times in microseconds as texts, for the values of a field."""
    return tuple(f"{t // 1000} ms" if t >= 1000 and t % 1000 == 0 else f"{t} us" for t in microseconds)


def name_axes(axes: int) -> str:
    """Return the names of axes, bit 0 for X."""
    return " ".join(a for k, a in enumerate(AXIS_LETTERS) if axes >> k & 1)


def make_bit(name: str, number: int, meaning: str, evidence: str = "C", values: Values = (), **more: Any) -> Field:
    """Return a field of one bit.

    Args:
        name: Name of the field.
        number: Number of the bit.
        meaning: Meaning of the bit; see `Field`.
        evidence: Letter of EVIDENCE.
        values: Meanings of 0 and 1.
        **more: Further attributes of the `Field`.
    """
    return make_bits(name, number, number, meaning, evidence, values, **more)


def make_bits(
    name: str, high: int, low: int, meaning: str, evidence: str = "C", values: Values = (), **more: Any
) -> Field:
    """Return a field of several bits.

    Args:
        name: Name of the field.
        high: Highest bit.
        low: Lowest bit.
        meaning: Subject of the bits; see `Field`.
        evidence: Letter of EVIDENCE.
        values: Meanings of the values, from 0 on or by value.
        **more: Further attributes of the `Field`.
    """
    by_value = values if isinstance(values, Mapping) else dict(enumerate(values))
    between = " " if values == LEVELS else ": "  # level of STOP0 high
    return Field(name, high, low, meaning, evidence, values=by_value, between=between, **more)


def make_axis_bits(name: str, low: int, axes: int, meaning: str, evidence: str = "C") -> Field:
    """Return a field with a bit for each axis, X first.

    Args:
        name: Name of the field.
        low: Bit of X.
        axes: Number of axes.
        meaning: Words that follow the names of the axes whose bits are 1, such as "is driving".
        evidence: Letter of EVIDENCE.
    """
    values = {v: (name_axes(v) or "no axis") + meaning for v in range(1 << axes)}
    note = f"{', '.join(AXIS_LETTERS[:axes])}{meaning}"
    return make_bits(name, low + axes - 1, low, "", evidence, values, note=note, listed=False)


def make_word(name: str, title: str, *fields: Field | Iterable[Field], access: str = "", note: str = "") -> Word:
    """Return a word of 16 bits.

    Args:
        name: Name of the word.
        title: Name in words.
        *fields: Its fields, in any order.
        access: "R" or "W"; default: "R" for a word RRn, "W" for a word WRn.
        note: Further text.
    """
    in_order = [f for some in fields for f in ([some] if isinstance(some, Field) else some)]
    access = access or ("R" if name.startswith("RR") else "W")
    ordered = tuple(replace(f, access=access) for f in sorted(in_order, key=lambda f: -f.high))
    address = int(name[2]) if name[:2] in ("WR", "RR") else None
    return Word(name, title, ordered, 16, note, address)


DATA_WRITE_WORDS = (
    make_word("WR6", "data, low word", make_bits("WD", 15, 0, "bits 15 to 0 of the next command's data")),
    make_word("WR7", "data, high word", make_bits("WD", 15, 0, "bits 31 to 16 of the next command's data")),
)
DATA_READ_WORDS = (
    make_word("RR6", "data, low word", make_bits("RD", 15, 0, "bits 15 to 0 of what a command read")),
    make_word("RR7", "data, high word", make_bits("RD", 15, 0, "bits 31 to 16 of what a command read")),
)
