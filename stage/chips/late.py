"""The lint of a chip whose bus cycles are made by compiled code: it reads the chip's journal when the diagnostics are read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stage.chips.chip import Limit
from stage.chips.entries import WRITE

if TYPE_CHECKING:
    from stage.chips.chip import Chip

MOST_ENTRIES = 1 << 21  # 64 MB


class LateLint:
    """Notes all inputs of `chip` from now on. `settle` finds the writes among them that are mistakes by the data sheet."""

    def __init__(self, chip: Chip):
        self._chip = chip
        self._journal = chip.journal()

    def tidy(self) -> None:
        """Settle if there is much to settle, so that the journal does not grow for ever."""
        if len(self._journal.entries) > MOST_ENTRIES:
            self.settle()

    def settle(self) -> None:
        """Live through the journal again and begin a new one."""
        chip, journal = self._chip, self._journal
        entries = journal.entries
        if not len(entries) and journal.until == chip.clock == int(journal.start["clock"]):
            return
        if (entries.packed()["kind"] == WRITE).any():
            twin = chip.twin(journal.start.tobytes())
            for entry in entries:
                chip.CORE.advance.c(twin.pointer, entry.clock)
                if entry.kind == WRITE:
                    said = twin.mistake(entry.a, entry.b)
                    if said:
                        chip.diagnose(entry.clock, entry.a, entry.b, *said, once=isinstance(said, Limit))
                entry.apply(chip.CORE, twin.pointer)
        journal.restart()
