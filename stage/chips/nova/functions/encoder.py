"""Encoder at ECA and ECB of an axis of a NOVA chip, which the counter RP follows; compiled. `set_shaft` moves its shaft.

    edge       0    1    2    3    4    5      A leads B forward
    ECA      __|^^^^^^^^^|_________|^^^^^      rises at 1, 5, ...
    ECB      _______|^^^^^^^^^|_________|      rises at 2, 6, ...

The shaft is at shaft_edges + shaft_rate * (clock - shaft_clock), in edges. It passes edge n half an edge before position n, so
that a shaft that rests near a whole number makes no edges. Its motion is linear between two calls of `set_shaft`, so RP does
not depend on when it is read. In the up / down mode rises of ECA count up and rises of ECB down; with a quadrature encoder that
is meaningless, as it is on the real chip.
"""

from __future__ import annotations

from stage.chips.nova.functions.inputs import UP_DOWN
from stage.chips.nova.motion.counters import add_encoder_counts
from stage.chips.nova.state import ECA, ECB, NEVER
from stage.native import floor, greatest, hot, least

MAX_EDGE = float(1 << 53)
PINS = ECA | ECB
DOWN_BACKWARD, UP_FORWARD, DOWN_FORWARD, UP_BACKWARD = range(4)
"""Edges modulo 4 at which the up / down mode counts: while the shaft turns forward, edges 1 and 2; backward, 3 and 0."""


@hot
def has_encoder(c, j):
    """Return whether axis `j` has an encoder."""
    return c.encoder_axes >> j & 1


@hot
def _find_edge(x, clock):
    """Return the number of the last edge that the shaft has passed at a clock."""
    at = x.shaft_edges + x.shaft_rate * (clock - x.shaft_clock) + 0.5
    return int(floor(least(greatest(at, -MAX_EDGE), MAX_EDGE)))


@hot
def _count_edges_of_phase(low, high, phase):
    """Count the edges from low + 1 to high whose number is `phase` modulo 4."""
    return (high - phase >> 2) - (low - phase >> 2)


@hot
def _count_rp_steps(mode, begin, end):
    """Count the steps of RP from edge `begin` to edge `end`: every edge, every second, every fourth, or up and down."""
    if mode != UP_DOWN:
        return (end >> mode) - (begin >> mode)
    if end >= begin:
        return _count_edges_of_phase(begin, end, UP_FORWARD) - _count_edges_of_phase(begin, end, DOWN_FORWARD)
    return _count_edges_of_phase(end, begin, UP_BACKWARD) - _count_edges_of_phase(end, begin, DOWN_BACKWARD)


@hot
def _set_encoder_pins(x, edge):
    """Set the levels of ECA and ECB after an edge. They bypass the filters."""
    x.last_edge = edge
    pins = (ECA if edge + 1 & 2 else 0) | (ECB if edge & 2 else 0)
    x.inputs = x.inputs & ~PINS | pins
    x.filtered_inputs = x.filtered_inputs & ~PINS | pins
    x.active_inputs = x.filtered_inputs ^ x.active_high_inputs


@hot
def follow_shafts(c):
    """Update RP and the pins of all axes with an encoder to the present position of their shafts."""
    for j in range(c.axes):
        if has_encoder(c, j):
            x = c.ax[j]
            edge = _find_edge(x, c.clock)
            if edge != x.last_edge:
                n = _count_rp_steps(x.encoder_mode, x.last_edge, edge)
                add_encoder_counts(c, x, -n if x.encoder_reversed else n)
                _set_encoder_pins(x, edge)


@hot
def set_shaft(c, j, count, rate):
    """Put the shaft of an axis at `count + rate * (clock - now)` from now on.

    Args:
        c: State of the chip.
        j: Number of the axis.
        count: Edges of the encoder.
        rate: Edges per reference clock.
    """
    follow_shafts(c)
    x = c.ax[j]
    x.shaft_clock, x.shaft_edges, x.shaft_rate = c.clock, count, rate
    if has_encoder(c, j):
        follow_shafts(c)
    else:
        c.encoder_axes |= 1 << j
        _set_encoder_pins(x, _find_edge(x, c.clock))


@hot
def _has_passed(x, edge, clock):
    """Return whether the shaft has passed an edge ahead of it at a clock."""
    return _find_edge(x, clock) >= edge if x.shaft_rate > 0.0 else _find_edge(x, clock) < edge


@hot
def _find_clock_of_edge(c, x, edge):
    """Find the next clock at which the shaft has passed an edge ahead of it; NEVER if it turns too slowly.

    While it turns backward it passes edge n on the way from n to n - 1.
    """
    ahead = greatest((edge - 0.5 - x.shaft_edges) / x.shaft_rate, 0.0)
    if not ahead < float(NEVER):
        return NEVER
    guess = x.shaft_clock + int(ahead)
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
def find_next_edge(c, x):
    """Find the next clock at which the shaft passes an edge."""
    if x.shaft_rate == 0.0:
        return NEVER
    return _find_clock_of_edge(c, x, x.last_edge + 1 if x.shaft_rate > 0.0 else x.last_edge)


@hot
def is_counting_up(x):
    """Return whether RP counts up at the present rate of the shaft. Not for the up / down mode."""
    return (x.shaft_rate > 0.0) != (x.encoder_reversed != 0)


@hot
def find_clock_of_counts(c, x, counts):
    """Find the next clock at which RP has changed by a number of counts, 1 or more. Not for the up / down mode."""
    if x.shaft_rate == 0.0 or counts >= NEVER:
        return NEVER
    count = x.last_edge >> x.encoder_mode
    return _find_clock_of_edge(c, x, (count + counts if x.shaft_rate > 0.0 else count - counts + 1) << x.encoder_mode)


@hot
def find_up_down_direction(x):
    """Return the direction of the next count in the up / down mode, 1 or -1."""
    at = x.last_edge & 3
    up = at != UP_FORWARD if x.shaft_rate > 0.0 else at == UP_BACKWARD
    return 1 if up != (x.encoder_reversed != 0) else -1
