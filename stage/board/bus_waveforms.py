r"""The bus of a host as waveforms: the cycles of a board's trace, as a logic analyzer on the slot would show them.

        PORT    ==X 300h X 301h X==      changes an eighth after a cycle begins, and stays
        DATA    ====X 81h X 2Ch X==      of a write likewise, of a read with its strobe
        WR_n    ~~~~\___/~\___/~~~~      the second half of a cycle, which ends with the rising edge
        RD_n    ~~~~~~~~~~~~~~~~~~~
        POLLS   ___________________      1 between two reads that were repeated, each with the same answer
        HOOK    ___________________      1 while the interrupt hook runs

Equal reads are one line of the trace with a count; of these the first and the last are shown as cycles.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.board.bus.host_record import CALLED, IN, IN_WIDE, OUT_WIDE, RETURNED
from stage.board.bus_trace import KIND_MASK
from stage.recording.vcd_writer import HOST_SCOPE

if TYPE_CHECKING:
    from stage.board.board import Board

NEWEST_LINES = 64  # lines that may go on where a recording begins: a read of each port that is polled
PIECE_CYCLES = 16384
HOLD_FRACTION = 8  # of a cycle: for so long PORT and DATA of the one before stay


class TracePosition(NamedTuple):
    """Position in the bus trace at which a recording begins or ends.

    Attributes:
        total: Number of lines so far.
        last: Times at which the newest lines ended, ns.
    """

    total: int
    last: np.ndarray


class HostWaveforms:
    """Waveforms of the bus of a board, for recordings of its stage."""

    def __init__(self, board: Board):
        self.board = board

    def get_position(self) -> TracePosition:
        """Return the current position in the bus trace, for the begin or the end of a recording."""
        trace = self.board.trace
        return TracePosition(trace.total, trace.lines()["last"][-NEWEST_LINES:])

    def register_signals(
        self, writer: Any, first: TracePosition | None, last: TracePosition | None, begin: int, end: int
    ) -> list[Iterator[tuple[int, Any, Any]]]:
        """Register the signals of the bus in a VCD file, if the recording has bus cycles, and return their changes.

        Args:
            writer: Writer of the VCD file.
            first: Position at the begin of the recording; None: the stage had no board then.
            last: Position at the end of the recording; None: the recording continues.
            begin: Time at which the recording begins, ns.
            end: Time at which the recording ends, ns.

        Returns:
            One iterator of (time in ns, variable, value) for each group of signals.
        """
        return _register_signals(
            self._select_lines(first, last, begin, end), writer, round(self.board.stage.bus_cycle * 1e9), begin
        )

    def _select_lines(
        self, first: TracePosition | None, last: TracePosition | None, begin: int, end: int
    ) -> np.ndarray:
        """Return the CYCLE records of a recording, with polling that began earlier cut at the begin."""
        trace = self.board.trace
        lines, until = trace.lines(), last.total if last is not None else trace.total
        number = trace.total - len(lines) + np.arange(len(lines))
        inside = number < until
        if first is not None:
            new = number >= first.total
            before = first.total - len(first.last)  # the number of the oldest whose end is known
            known = np.flatnonzero(~new & (number >= before))
            new[known] = lines["last"][known] != first.last[number[known] - before]
            inside &= new
        cycles = lines[inside]
        cycles["last"] = np.minimum(cycles["last"], end)
        cycles["first"] = np.minimum(np.maximum(cycles["first"], begin), cycles["last"])
        return cycles


def _register_signals(lines: np.ndarray, writer: Any, bus_ns: int, begin: int) -> list[Iterator[tuple[int, Any, Any]]]:
    """Register the signals in the VCD file, and return iterators of their changes."""
    if not len(lines):
        return []
    kind = lines["kind"] & KIND_MASK
    hooks = (kind == CALLED) | (kind == RETURNED)
    cycles, kinds = lines[~hooks], kind[~hooks]
    wide = bool(np.isin(kinds, (IN_WIDE, OUT_WIDE)).any())
    bits = max(16, int(cycles["port"].max()).bit_length() if len(cycles) else 16)
    port = writer.register_var(HOST_SCOPE, "PORT", "reg", size=bits, init="x")
    data = writer.register_var(HOST_SCOPE, "DATA", "reg", size=16 if wide else 8, init="x")
    rd, wr = (writer.register_var(HOST_SCOPE, name, "wire", size=1, init=1) for name in ("RD_n", "WR_n"))
    polls = writer.register_var(HOST_SCOPE, "POLLS", "wire", size=1, init=0)
    streams = [
        _iterate_cycles(cycles, np.isin(kinds, (IN, IN_WIDE)), (port, data, rd, wr), bus_ns, begin),
        _iterate_polls(cycles, polls),
    ]
    if hooks.any():
        hook = writer.register_var(HOST_SCOPE, "HOOK", "wire", size=1, init=0)
        times, levels = lines["first"][hooks].tolist(), (kind[hooks] == CALLED).astype(int).tolist()
        streams.append((t, hook, level) for t, level in zip(times, levels, strict=True))
    return streams


def _iterate_cycles(
    lines: np.ndarray, reads: np.ndarray, variables: tuple[Any, ...], bus_ns: int, begin: int
) -> Iterator[Any]:
    """Yield the signal changes of the first cycle of each line and, for repeated reads, of the last one."""
    port, data, rd, wr = variables
    more = np.flatnonzero(lines["last"] > lines["first"])
    at = np.concatenate([lines["first"], lines["last"][more]])
    which = np.concatenate([np.arange(len(lines)), more])
    order = np.lexsort((which, at))
    for piece in np.array_split(order, max(1, -(-len(order) // PIECE_CYCLES))):
        k = which[piece]
        columns = at[piece].tolist(), lines["port"][k].tolist(), lines["value"][k].tolist(), reads[k].tolist()
        for end, number, value, is_read in zip(*columns, strict=True):
            middle, start = max(begin, end - (bus_ns + 1) // 2), max(begin, end - bus_ns + bus_ns // HOLD_FRACTION)
            strobe = rd if is_read else wr
            yield start, port, number
            yield (middle if is_read else start), data, value
            yield middle, strobe, 0
            yield end, strobe, 1


def _iterate_polls(lines: np.ndarray, variable: Any) -> Iterator[Any]:
    """Yield (time, variable, 1) when repeated reads of at least one port begin, (time, variable, 0) when the last of them end."""
    lines = lines[lines["count"] > 2]
    steps = heapq.merge(((t, 1) for t in lines["first"].tolist()), ((t, -1) for t in np.sort(lines["last"]).tolist()))
    depth = 0
    for t, step in steps:
        before, depth = depth, depth + step
        if bool(before) != bool(depth):
            yield t, variable, int(depth > 0)
