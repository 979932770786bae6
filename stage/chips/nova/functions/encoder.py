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
PINS = ECA | ECB
DOWN_BACKWARD, UP_FORWARD, DOWN_FORWARD, UP_BACKWARD = range(4)
"""Edges modulo 4 at which the up / down mode counts: while the shaft turns forward, edges 1 and 2; backward, 3 and 0."""


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
    """Count the edges from low + 1 to high that are `phase` modulo 4."""
    return (high - phase >> 2) - (low - phase >> 2)


@hot
def _counts(mode, begin, end):
    """What RP counts from edge `begin` to edge `end`: all, every second, every fourth, or up and down."""
    if mode != UP_DOWN:
        return (end >> mode) - (begin >> mode)
    if end >= begin:
        return _among(begin, end, UP_FORWARD) - _among(begin, end, DOWN_FORWARD)
    return _among(end, begin, UP_BACKWARD) - _among(end, begin, DOWN_BACKWARD)


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
    """Put the shaft of axis `j` at `count + rate * (clock - now)` from now on."""
    see(c)
    x = c.ax[j]
    x.seen, x.shaft, x.shaft_rate = c.clock, count, rate
    if fed(c, j):
        see(c)
    else:
        c.fed |= 1 << j
        _show(x, _edge_at(x, c.clock))


@hot
def _has_passed(x, edge, clock):
    """Return whether the shaft has passed an edge ahead of it at a clock."""
    return _edge_at(x, clock) >= edge if x.shaft_rate > 0.0 else _edge_at(x, clock) < edge


@hot
def _clock_of(c, x, edge):
    """Return the first clock after now at which the shaft has passed an edge ahead of it; NEVER where it turns too slowly. Turning
    backward it passes edge n on the way from n to n - 1."""
    ahead = greatest((edge - 0.5 - x.shaft) / x.shaft_rate, 0.0)
    if not ahead < float(NEVER):
        return NEVER
    guess = x.seen + int(ahead)
    low, span = greatest(guess - 2, c.clock), greatest(guess + 2 - c.clock, 1)
    while not _has_passed(x, edge, c.clock + span):  # floats far from 0 are coarse
        span *= 2
        if span >= NEVER:
            return NEVER
    if _has_passed(x, edge, low):
        low = c.clock
    high = c.clock + span
    while high - low > 1:
        middle = (low + high) // 2
        if _has_passed(x, edge, middle):
            high = middle
        else:
            low = middle
    return high


@hot
def next_edge(c, x):
    """Return the clock after now at which the shaft passes an edge."""
    if x.shaft_rate == 0.0:
        return NEVER
    return _clock_of(c, x, x.edge + 1 if x.shaft_rate > 0.0 else x.edge)


@hot
def counts_up(x):
    """Return whether RP counts up while the shaft turns as it does now; not of the up / down mode."""
    return (x.shaft_rate > 0.0) != (x.exchanges != 0)


@hot
def clock_of_counts(c, x, counts):
    """Return the clock after now at which RP has moved by so many counts, 1 or more; not of the up / down mode."""
    if x.shaft_rate == 0.0 or counts >= NEVER:
        return NEVER
    count = x.edge >> x.encoder
    return _clock_of(c, x, (count + counts if x.shaft_rate > 0.0 else count - counts + 1) << x.encoder)


@hot
def next_up_down_direction(x):
    """Return whether the next count of the up / down mode is up, 1, or down, -1."""
    at = x.edge & 3
    up = at != UP_FORWARD if x.shaft_rate > 0.0 else at == UP_BACKWARD
    return 1 if up != (x.exchanges != 0) else -1
