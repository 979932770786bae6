"""The notes of a bus cycle, compiled: a line of the trace, an entry of a chip's journal."""

from __future__ import annotations

from stage.board.host import CYCLE, FULL, IN, IN_WIDE, STRAY, ask, chip_of, now_of, stage_of
from stage.chips import cores
from stage.native import array_at, hot
from stage.sim import records
from stage.sim.handle import clockwork


@hot
def note(h, kind, port, value, seen):
    """A line of the trace about the cycle that has just ended. seen: the last line about a read of this port that may say
    it all, or -1. Returns the line's number."""
    if h.stopped:
        return -1
    now, lines = now_of(h), array_at(h.lines, h.line_room, CYCLE)
    if seen >= h.changed and h.traced - seen <= h.line_room:
        line = lines[seen % h.line_room]
        if line.value == value and line.kind == kind and line.port == port:
            line.last, line.count = now, line.count + 1
            return seen
    line = lines[h.traced % h.line_room]
    line.first, line.last, line.count, line.kind, line.port, line.value = now, now, 1, kind, port, value
    h.traced += 1
    if kind & ~STRAY not in (IN, IN_WIDE):
        h.changed = h.traced
    return h.traced - 1


@hot
def journal(h, kind, chip, address, value):
    """What a cycle did to a chip, for its journal, in the order of the switches' edges."""
    if h.noted >= h.edge_room - clockwork(stage_of(h)).most_edges:  # the engine needs that much in any step
        ask(h, FULL)
    e = array_at(h.edges, h.edge_room, records.EDGE)[h.noted]
    c = chip_of(h, chip)
    e.now, e.clock, e.axis = now_of(h), cores.clock(c), cores.axis_of(c, 0)
    e.kind, e.a, e.b = kind, address, value
    h.noted += 1
