"""HCTL-1100, compiled: the shaft as the encoder sees it, and the actual position."""

from __future__ import annotations

import math

from stage.chips.hctl1100.state import NEVER, signed
from stage.native import greatest, hot, least

FASTEST = 1.0 / 3.0  # counts a clock: a state that is shorter than the filter's three clocks does not come through
FAR = float(1 << 53)


@hot
def raw(c):
    """The encoder's count now."""
    return _count_at(c, c.clock)


@hot
def _count_at(c, clock):
    x = c.count - c.lost + heard(c) * (clock - c.seen)
    return int(math.floor(least(greatest(x, -FAR), FAR)))


@hot
def heard(c):
    """Counts a clock that come through the filter: all of them or, too fast, none."""
    return c.rate if abs(c.rate) <= FASTEST else 0.0


@hot
def set_shaft(c, count, rate):
    """Put the shaft at `count + rate * (clock - now)` from now on."""
    c.lost = lost(c)
    c.seen, c.count, c.rate = c.clock, count, rate


@hot
def lost(c):
    """Counts that came too fast for the filter so far, plus minus minus: the shaft is so far ahead of the count."""
    return least(greatest(c.lost + (c.rate - heard(c)) * (c.clock - c.seen), -FAR), FAR)


@hot
def actual(c):
    """The actual position, 24 bits, sign extended."""
    return signed(raw(c) - c.zero, 24)


@hot
def next_count(c, until):
    """The clock after now at which the raw count changes, at most `until`."""
    if heard(c) == 0.0:
        return NEVER
    now = raw(c)
    if _count_at(c, until) == now:
        return NEVER
    low, high = c.clock, until
    while high - low > 1:
        middle = (low + high) // 2
        if _count_at(c, middle) == now:
            low = middle
        else:
            high = middle
    return high
