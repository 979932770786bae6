"""The bus trace: what a host read and wrote, when, and what it means.

        0.001204000  304h W 11h    y: start, constant FH1
        0.001205000  300h R 40h    x: operating                          31,204 times until 0.412377000

Reads of a port that give the same value as the last one, with no write in between, are one line with a count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stage.board.bus import host_record
from stage.board.bus.interrupts import BACK, JUMPED, LOWERED
from stage.board.interrupt_hooks import named
from stage.support.arguments import told_when_made

if TYPE_CHECKING:
    from stage.board.board import Board


class Cycle(NamedTuple):
    """Equal bus cycles of one port. seconds, until: when the first and the last of `times` ended; width: bits; stray: no chip was
    reached, or half of a register only. port is None where the interrupt hook was called ("I") or returned ("i")."""

    seconds: float
    until: float
    times: int
    way: str
    port: int | None
    value: int
    width: int
    stray: bool
    meaning: str

    def __str__(self) -> str:
        if self.port is None:
            return f"{self.seconds:17.9f}  {self.meaning}"
        value = f"{self.value:0{self.width // 4}X}h"
        again = f"{self.times:,} times until {self.until:.9f}" if self.times > 1 else ""
        return f"{self.seconds:17.9f}  {self.port:03X}h {self.way} {value:5}  {self.meaning:56}  {again}".rstrip()


_FLAGS = host_record.STRAY, host_record.LOST_ON_THE_WAY, host_record.RAISED
Meaning = Callable[[int, int, bool, bool], str]
"""(port, value, whether it is written, whether with 16 bits) -> what it means."""


def _interrupt(kind: int, source: int, value: int) -> str:
    """A call of a hook, before which so many ticks were missed; or its end."""
    name = named(source) if source else "the hook"
    if kind == host_record.CALLED:
        missed = f" ({value:,} {'tick was' if value == 1 else 'ticks were'} missed)" if value else ""
        return f"interrupt: {name} is called{missed}"
    how = {
        BACK: "returns",
        JUMPED: "is over: a jump has left its hook",
        LOWERED: "is over: its hook has lowered the level",
    }
    return f"interrupt: {name} {how[value]}"


@told_when_made
class BusTrace:
    """The last cycles of a board, oldest first; iterate for `Cycle`s, print for text.

    kept: the lines, CYCLE records, as a ring; room: how many of them. dropped: lines before these. The meaning of cycles is found
    from the lines that are kept; where lines were dropped, the first of the rest may be attributed to another register.
    """

    def __init__(self, board: Board, room: int):
        self._board = board
        self.kept = np.zeros(room, host_record.CYCLE)
        self.room = room

    def lines(self) -> np.ndarray:
        """The lines kept, as CYCLE records."""
        n = self._board.link.traced
        if n <= self.room:
            return self.kept[:n].copy()
        return np.roll(self.kept, -(n % self.room))

    @property
    def noted(self) -> int:
        """Lines so far, those that are kept no more among them."""
        return self._board.link.traced

    @property
    def dropped(self) -> int:
        return max(0, self._board.link.traced - self.room)

    def __len__(self) -> int:
        return min(self._board.link.traced, self.room)

    def __iter__(self) -> Iterator[Cycle]:
        return self.last(len(self))

    def last(self, n: int) -> Iterator[Cycle]:
        """The last `n` lines. Their meaning is found from all lines that are kept."""
        lines = self.lines()
        first = len(lines) - n
        tell = self._board.teller()
        for k, line in enumerate(lines.tolist()):
            at, until, count, kind, port, value = line
            stray, lost, raised = (bool(kind & flag) for flag in _FLAGS)
            kind &= 7
            if kind in (host_record.CALLED, host_record.RETURNED):
                if k >= first:
                    text = _interrupt(kind, port, value)
                    yield Cycle(at * 1e-9, at * 1e-9, 1, "Ii"[kind - host_record.CALLED], None, 0, 0, False, text)
                continue
            writes, wide = (
                kind in (host_record.OUT, host_record.OUT_WIDE),
                kind in (host_record.IN_WIDE, host_record.OUT_WIDE),
            )
            if lost:
                meaning = "lost on the way: it does not reach the chip"
            elif raised:
                meaning = "the device here, in Python, has raised an error"
            else:
                meaning = tell(port, value, writes, wide)
            if k >= first:
                way, width = "W" if writes else "R", 16 if wide else 8
                yield Cycle(at * 1e-9, until * 1e-9, count, way, port, value, width, stray, meaning)

    def text(self, n: int | None = None) -> str:
        """The last `n` lines (default: all) as text."""
        shown = len(self) if n is None else min(n, len(self))
        head = [f"{'seconds':>17}  port R/W value  meaning"]
        if len(self) + self.dropped > shown:
            head.append(f"{'':17}  ... {len(self) + self.dropped - shown:,} lines before")
        return "\n".join([*head, *map(str, self.last(shown))])

    def ending(self, n: int) -> str:
        """The last `n` lines as the end of a message about a program that did not end well."""
        return f"Its last bus cycles:\n{self.text(n)}" if len(self) + self.dropped else "It has made no bus cycle."

    def __str__(self) -> str:
        return self.text()
