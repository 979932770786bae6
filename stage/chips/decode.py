"""Bus writes in words, from the register map; each family brings its decoder, see `Chip.decoder`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

from stage.chips.entries import Entry


class Said(NamedTuple):
    """One command, or one register written with all its words. `clock`: of the last write; `kind`: command, register, reset,
    lost (a write that did not arrive)."""

    clock: int
    kind: str
    code: str
    meaning: str

    def __str__(self) -> str:
        return f"{self.code}  {self.meaning}"


class Decoder(Protocol):
    """Journal entries as commands and whole register values, in parts."""

    def take(self, entries: Iterable[Entry]) -> list[Said]:
        """What `entries` say, after those before; the last writes may wait for what comes next, see `rest`."""

    def rest(self) -> list[Said]:
        """What nothing followed, if anything."""


def decode(decoder: Decoder, entries: Iterable[Entry]) -> list[Said]:
    """A journal's writes as commands and whole register values."""
    return decoder.take(entries) + decoder.rest()
