"""NOVA chips, compiled: an encoder at ECA and ECB of an axis. Somebody tells where its shaft is; the counter RP follows.

    edge       0    1    2    3    4    5      A leads B forward
    ECA      __|^^^^^^^^^|_________|^^^^^      rises at 1, 5, ...
    ECB      _______|^^^^^^^^^|_________|      rises at 2, 6, ...

The shaft is at count + rate * (clock - seen), in edges; edge n is passed half an edge before n, so that a shaft at rest near a
whole number stays there. In between its way is straight, so that RP never depends on who looks at it meanwhile. In the up / down
mode rises of ECA count up and those of ECB down, which makes no sense of a quadrature encoder, as on the real chip.
"""

from __future__ import annotations

from stage.chips.nova.functions.inputs import UP_DOWN
from stage.chips.nova.motion.counters import count_encoder
from stage.chips.nova.state import ECA, ECB, NEVER
from stage.native import floor, greatest, hot, least

FAR = float(1 << 53)
SLOWEST = 1e-9  # edges a clock; what is slower passes no edge before it is seen anew
PINS = ECA | ECB


@hot
def fed(c, j):
    """Axis `j` has an encoder."""
    return c.fed >> j & 1


@hot
def _edge_at(x, clock):
    at = x.shaft + x.shaft_rate * (clock - x.seen) + 0.5
    return int(floor(least(greatest(at, -FAR), FAR)))


@hot
def _among(low, high, phase):
    """How many of the edges low + 1 to high are `phase` modulo 4."""
    return (high - phase >> 2) - (low - phase >> 2)


@hot
def _counts(mode, begin, end):
    """What RP counts from edge `begin` to edge `end`: all, every second, every fourth, or up and down."""
    if mode != UP_DOWN:
        return (end >> mode) - (begin >> mode)
    if end >= begin:
        return _among(begin, end, 1) - _among(begin, end, 2)
    return _among(end, begin, 3) - _among(end, begin, 0)


@hot
def _show(x, edge):
    """The levels at the pins; they do not pass the filters."""
    x.edge = edge
    pins = (ECA if edge + 1 & 2 else 0) | (ECB if edge & 2 else 0)
    x.inputs = x.inputs & ~PINS | pins
    x.level = x.level & ~PINS | pins
    x.active = x.level ^ x.turned


@hot
def see(c):
    """RP and the pins of all axes that have an encoder follow their shafts to the present clock."""
    for j in range(c.axes):
        if fed(c, j):
            x = c.ax[j]
            edge = _edge_at(x, c.clock)
            if edge != x.edge:
                n = _counts(x.encoder, x.edge, edge)
                count_encoder(c, x, -n if x.exchanges else n)
                _show(x, edge)


@hot
def set_shaft(c, j, count, rate):
    """From now on the shaft of axis `j` is at `count + rate * (clock - now)`. Where it is at first counts nothing."""
    see(c)
    x = c.ax[j]
    x.seen, x.shaft, x.shaft_rate = c.clock, count, rate
    if fed(c, j):
        see(c)
    else:
        c.fed |= 1 << j
        _show(x, _edge_at(x, c.clock))


@hot
def next_edge(c, x):
    """The clock after now at which the shaft passes an edge, or an earlier one."""
    rate = abs(x.shaft_rate)
    if rate < SLOWEST:
        return NEVER
    low, high = c.clock, c.clock + int(1.0 / rate) + 2
    if _edge_at(x, high) == x.edge:
        return high
    while high - low > 1:
        middle = (low + high) // 2
        if _edge_at(x, middle) == x.edge:
            low = middle
        else:
            high = middle
    return high
