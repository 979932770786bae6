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
from stage.board.bus.interrupt_controller import BACK, JUMPED, LOWERED
from stage.board.interrupt_hooks import format_source_name
from stage.support.argument_checks import explain_constructor

if TYPE_CHECKING:
    from stage.board.board import Board

KIND_MASK = 7  # of a line's kind, which say what cycle it is
FLAGS = host_record.STRAY, host_record.WRITE_LOST, host_record.RAISED
HOOK_END_TEXTS = {
    BACK: "returns",
    JUMPED: "is over: a jump has left its hook",
    LOWERED: "is over: its hook has lowered the level",
}


class Cycle(NamedTuple):
    """Equal consecutive bus cycles of one port, or one event of an interrupt hook.

    Attributes:
        seconds: Time at which the first cycle ended, s.
        until: Time at which the last cycle ended, s.
        times: Number of equal cycles.
        direction: "R" for reads, "W" for writes, "I" for the call of a hook, "i" for its return.
        port: Port number; None for a hook.
        value: Value that was read or written.
        width: Width of the cycle, bits.
        stray: Whether the cycle reached no chip or device, or only half of a register.
        meaning: Explanation of the cycle.
    """

    seconds: float
    until: float
    times: int
    direction: str
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
        return f"{self.seconds:17.9f}  {self.port:03X}h {self.direction} {value:5}  {self.meaning:56}  {again}".rstrip()


BoardDescriber = Callable[[int, int, bool, bool], str]
"""Function (port, value, whether the cycle is a write, whether it has 16 bits) that returns the meaning of a bus cycle in words."""


def format_interrupt(kind: int, source: int, value: int) -> str:
    """Return the text of a trace line about an interrupt hook.

    Args:
        kind: CALLED or RETURNED.
        source: Index of the interrupt source.
        value: For CALLED the number of ticks missed before the call; for RETURNED the way in which the hook ended.
    """
    name = format_source_name(source) if source else "the hook"
    if kind == host_record.RETURNED:
        return f"interrupt: {name} {HOOK_END_TEXTS[value]}"
    missed = f" ({value:,} {'tick was' if value == 1 else 'ticks were'} missed)" if value else ""
    return f"interrupt: {name} is called{missed}"


@explain_constructor
class BusTrace:
    """The last cycles of a board, oldest first; iterate for `Cycle`s, print for text.

    The meaning of cycles is found from the lines that are in the buffer; where lines were dropped, the first of the rest may be
    attributed to another register.

    Attributes:
        buffer: CYCLE records, a circular buffer.
        capacity: How many lines the buffer holds.
    """

    def __init__(self, board: Board, capacity: int):
        self._board = board
        self.buffer = np.zeros(capacity, host_record.CYCLE)
        self.capacity = capacity

    def lines(self) -> np.ndarray:
        """Return a copy of the buffered lines as CYCLE records, oldest first."""
        if self.total <= self.capacity:
            return self.buffer[: self.total].copy()
        return np.roll(self.buffer, -(self.total % self.capacity))

    @property
    def total(self) -> int:
        """Number of lines since the board was created, with those that the buffer dropped."""
        return self._board.link.traced_lines

    @property
    def dropped(self) -> int:
        """Number of lines that the buffer dropped."""
        return max(0, self.total - self.capacity)

    def __len__(self) -> int:
        return min(self.total, self.capacity)

    def __iter__(self) -> Iterator[Cycle]:
        return self.last(len(self))

    def last(self, n: int) -> Iterator[Cycle]:
        """Yield the last `n` lines as `Cycle`s. Their meaning is computed from all buffered lines."""
        lines = self.lines()
        first = len(lines) - n
        describe = self._board.make_describer()
        for k, line in enumerate(lines.tolist()):
            cycle = _make_cycle(line, describe)
            if k >= first:
                yield cycle

    def text(self, n: int | None = None) -> str:
        """Return the last `n` lines (default: all) as text."""
        shown = len(self) if n is None else min(n, len(self))
        head = [f"{'seconds':>17}  port R/W value  meaning"]
        if self.total > shown:
            head.append(f"{'':17}  ... {self.total - shown:,} lines before")
        return "\n".join([*head, *map(str, self.last(shown))])

    def format_ending(self, n: int) -> str:
        """Return the last `n` lines as the end of an error message about a program."""
        if self.total:
            return f"Its last bus cycles:\n{self.text(n)}"
        if cycles := self._board.cycles:
            polled = "pins, the serial line, the time or the interrupt line"
            return f"It has made {cycles:,} bus cycles, none at a port: polls of {polled}."
        return "It has made no bus cycle."

    def __str__(self) -> str:
        return self.text()


def _make_cycle(line: tuple[int, ...], describe: BoardDescriber) -> Cycle:
    """Convert a CYCLE record to a `Cycle`.

    Args:
        line: Fields of the record.
        describe: Function that explains cycles; it has to receive each cycle in order.
    """
    at, until, count, kind, port, value = line
    stray, lost, raised = (bool(kind & flag) for flag in FLAGS)
    kind &= KIND_MASK
    if kind in (host_record.CALLED, host_record.RETURNED):
        way = "Ii"[kind - host_record.CALLED]
        return Cycle(at * 1e-9, at * 1e-9, 1, way, None, 0, 0, False, format_interrupt(kind, port, value))
    writes, wide = kind in (host_record.OUT, host_record.OUT_WIDE), kind in (host_record.IN_WIDE, host_record.OUT_WIDE)
    if lost:
        meaning = "lost on the way: it does not reach the chip"
    elif raised:
        meaning = "the device here, in Python, has raised an error"
    else:
        meaning = describe(port, value, writes, wide)
    return Cycle(at * 1e-9, until * 1e-9, count, "W" if writes else "R", port, value, 16 if wide else 8, stray, meaning)
