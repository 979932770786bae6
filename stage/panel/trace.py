"""`Trace`: the bus of one chip in words, whoever makes the cycles: the page, a procedure, firmware. No page.

Writes come from a journal of the chip, so that none is missed; so do reads that change something. Other reads are told where they
are made, by `Trace.read`: hosts that poll would fill the list.
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

from stage.chips.chip import Chip, Diagnostic
from stage.chips.describe import Listener
from stage.chips.entries import LOST, READ, RESET, WRITE, Entry

LINES = 500
KINDS = {WRITE: "W", READ: "R", LOST: "lost", RESET: "reset"}


class Line(NamedTuple):
    """A bus cycle, or a diagnostic. number: counts up; time: s; way: W, R, lost, reset, ! for a diagnostic. times: so many reads of
    one address after each other, of which this is the last; first: the number of the first of them."""

    number: int
    time: float
    way: str
    address: int
    datum: int
    words: str
    source: str = ""
    times: int = 1
    first: int = 0

    def text(self, digits: int) -> str:
        """As a line of a list; digits: of the datum, hexadecimal."""
        if self.way in ("reset", "!"):
            return f"{self.time:11.6f}  {self.way}  {self.words}" + (f" [{self.source}]" if self.source else "")
        folded = f"  x {self.times}" if self.times > 1 else ""
        return f"{self.time:11.6f}  {self.way} {self.address:2X}: {self.datum:0{digits}X}  {self.words}{folded}"


class Trace:
    """The last LINES cycles and diagnostics of a chip. All but `since` are called by the stage's thread.

    losses: a write that a fault has lost is told as such; False: as any other, as its host would tell it.
    """

    def __init__(self, chip: Chip, losses: bool = True):
        self.chip, self.lines, self._losses = chip, deque[Line](maxlen=LINES), losses
        self.said: deque[Line] = deque(maxlen=LINES)
        """The diagnostics alone."""
        self.sent: list[Entry] | None = None
        """For who wants to play them again: the cycles that changed something, writes and such reads, since he set it to []."""
        self.digits = (chip.DATA_MASK.bit_length() + 3) // 4
        self._journal = chip.journal()
        self._listener: Listener = chip.listener()
        self._number, self._clock = 0, chip.clock
        self._last: Diagnostic | None = None
        self._diagnostics()

    def look(self) -> None:
        """Take in what has happened since."""
        if self.chip.clock < self._clock:  # a snapshot, or a reset of the stage
            self.begin_again()
        self._clock = self.chip.clock
        entries = self._journal.entries
        if len(entries):
            self._journal.restart()
            for e in entries:
                if e.kind in KINDS:
                    self._heard(e)
        self._diagnostics()

    def read(self, address: int) -> int:
        """Make a read cycle; it is told, too."""
        self.look()
        datum = self.chip.read(address)
        address &= self.chip.ADDRESS_MASK
        if address not in self.chip.READING_ACTS:
            self._add(self.chip.clock, "R", address, datum, self._listener.read(address, datum))
        self.look()
        return datum

    def since(self, number: int) -> list[Line]:
        """The lines with higher numbers, oldest first."""
        return [line for line in tuple(self.lines) if line.number > number]

    def close(self) -> None:
        """End the journal."""
        self._journal.close()

    def begin_again(self) -> None:
        """The chip is in another state than its cycles have brought it to: that of a snapshot."""
        self._journal.restart()
        self._clock = self.chip.clock
        while self.sent and self.sent[-1].clock > self.chip.clock:
            self.sent.pop()
        self._listener = self.chip.listener()
        self._last = self.chip.diagnostics[-1] if self.chip.diagnostics else None
        self._add(self.chip.clock, "reset", 0, 0, "the time went back")

    def _heard(self, e: Entry) -> None:
        if e.kind == RESET:
            self._listener = self.chip.listener()
            words = "the reset pin"
        elif e.kind == LOST and self._losses:
            words = "did not arrive"
        else:
            if e.kind != LOST and self.sent is not None:
                self.sent.append(e)
            words = (self._listener.read if e.kind == READ else self._listener.write)(e.a, e.b)
        way = KINDS[WRITE if e.kind == LOST and not self._losses else e.kind]
        self._add(e.clock, way, e.a, e.b, words)

    def _diagnostics(self) -> None:
        noted = self.chip.diagnostics
        new: list[Any] = []
        for d in reversed(noted):
            if d is self._last:
                break
            new.append(d)
        for d in reversed(new):
            self.said.append(self._add(d.clock, "!", d.address, d.value, d.message, d.source))
        self._last = noted[-1] if noted else None

    def _add(self, clock: int, way: str, address: int, datum: int, words: str, source: str = "") -> Line:
        self._number += 1
        times, first, last = 1, self._number, self.lines[-1] if self.lines else None
        if last is not None and way == last.way == "R" and address == last.address:  # a host that polls
            times, first = last.times + 1, last.first
            self.lines.pop()
        line = Line(self._number, clock / self.chip.clock_hz, way, address, datum, words, source, times, first)
        self.lines.append(line)
        return line
