"""What all emulated processors have in common, compiled: their time is the board's, their bus cycles are requests.

A processor counts its clock cycles. Before each of its bus cycles the board's time is let get to the processor's; and at the latest
after a quantum, when the interrupt line is looked at. Where the board's bus cycle is longer than the processor's, it waits (READY).
"""

from __future__ import annotations

import numpy as np

from stage.board.host import HOST, UNTIL, now_of
from stage.native import array_at, called, greatest, hot

BASE = [(name, "i8") for name in "host request hz begin waits watched line ended code".split()]
"""Fields that the record of every processor begins with:
    host, request    the HOST record, and the function for its requests
    hz, begin, waits the clock; the board's time (ns) at cycle 0; ns that the processor stood still for the bus
    watched, line    whether the interrupt line leads to the processor; its level at the last look (of an AVR), or whether it may
                     interrupt (of others)
    ended, code      the program has ended, with this code
"""
WHOLE = np.dtype("i8")
SECOND = 1_000_000_000
_request = called("i8", "i8", "i4", "i8", "i8")


@hot
def request(t, what, a, b):
    """A request of the board."""
    return _request(t.request, (t.host, what, a, b))


@hot
def time_of(t, cycles):
    """The board's time (ns) at which the processor has run so many cycles."""
    return t.begin + t.waits + cycles // t.hz * SECOND + cycles % t.hz * SECOND // t.hz


@hot
def reach(t, cycles):
    """The board's time gets to the processor's; 1 if the interrupt line then is asserted and leads here."""
    return request(t, UNTIL, time_of(t, cycles), t.watched)


@hot
def bus_cycle(t, cycles, what, port, value):
    """A bus cycle that ends when the processor has run so many cycles."""
    h = array_at(t.host, 1, HOST)[0]
    end = time_of(t, cycles)
    request(t, UNTIL, end - h.bus, 0)
    answer = request(t, what, port, value)
    t.waits += greatest(now_of(h) - end, 0)
    return answer
