"""What the register maps of the NOVA chips share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from stage.chips.register_map import Field, Word

AXES = "XYZU"
Range = tuple[int, int] | None


def bit(name: str, number: int, meaning: str, evidence: str = "C") -> Field:
    """A field of one bit."""
    return Field(name, number, number, meaning, evidence)


def bits(name: str, high: int, low: int, meaning: str, evidence: str = "C", legal: Range = None) -> Field:
    """A field of several bits."""
    return Field(name, high, low, meaning, evidence, legal=legal)


def word(name: str, title: str, *fields: Field | Iterable[Field], access: str = "") -> Word:
    """A word of 16 bits; `fields` in any order. RRn can be read, WRn be written, unless `access` says more."""
    found = [f for some in fields for f in ([some] if isinstance(some, Field) else some)]
    access = access or ("R" if name.startswith("RR") else "W")
    return Word(name, title, tuple(replace(f, access=access) for f in sorted(found, key=lambda f: -f.high)), 16)


DATA_WRITTEN = (
    word("WR6", "data, low word", bits("WD", 15, 0, "bits 15 to 0 of the next command's data")),
    word("WR7", "data, high word", bits("WD", 15, 0, "bits 31 to 16 of the next command's data")),
)
DATA_READ = (
    word("RR6", "data, low word", bits("RD", 15, 0, "bits 15 to 0 of what a command read")),
    word("RR7", "data, high word", bits("RD", 15, 0, "bits 31 to 16 of what a command read")),
)
