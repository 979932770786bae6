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

from stage.chips.nova.functions.input_pins import UP_DOWN
from stage.chips.nova.motion.counters import add_encoder_counts
from stage.chips.nova.state import ECA, ECB, NEVER
from stage.native import floor, greatest, hot, least

MAX_EDGE = float(1 << 53)
PINS = ECA | ECB
DOWN_BACKWARD, UP_FORWARD, DOWN_FORWARD, UP_BACKWARD = range(4)
"""Edges modulo 4 at which the up / down mode counts: while the shaft turns forward, edges 1 and 2; backward, 3 and 0."""


@hot
def has_encoder(chip, axis_index):
    """Return whether axis `axis_index` has an encoder."""
    return chip.encoder_axes >> axis_index & 1


@hot
def _find_edge(axis, clock):
    """Return the number of the last encoder edge that the shaft has passed at a clock."""
    at = axis.shaft_edges + axis.shaft_rate * (clock - axis.shaft_clock) + 0.5
    return int(floor(least(greatest(at, -MAX_EDGE), MAX_EDGE)))


@hot
def _count_edges_with_remainder(first_edge, last_edge, remainder):
    """Count the edges after `first_edge`, up to `last_edge`, whose number is `remainder` modulo 4."""
    return (last_edge - remainder >> 2) - (first_edge - remainder >> 2)


@hot
def _count_rp_steps(mode, begin, end):
    """Count the steps of RP, the real position counter, from edge `begin` to edge `end` in a counting mode."""
    if mode != UP_DOWN:
        return (end >> mode) - (begin >> mode)
    if end >= begin:
        return _count_edges_with_remainder(begin, end, UP_FORWARD) - _count_edges_with_remainder(
            begin, end, DOWN_FORWARD
        )
    return _count_edges_with_remainder(end, begin, UP_BACKWARD) - _count_edges_with_remainder(end, begin, DOWN_BACKWARD)


@hot
def _set_encoder_pins(axis, edge):
    """Set the levels of the encoder inputs ECA and ECB after an edge. They bypass the input filters."""
    axis.last_edge = edge
    pins = (ECA if edge + 1 & 2 else 0) | (ECB if edge & 2 else 0)
    axis.inputs = axis.inputs & ~PINS | pins
    axis.filtered_inputs = axis.filtered_inputs & ~PINS | pins
    axis.active_inputs = axis.filtered_inputs ^ axis.active_high_inputs


@hot
def update_encoder_inputs(chip):
    """Update RP and the pins of all axes with an encoder to the present position of their shafts."""
    for j in range(chip.axes):
        if has_encoder(chip, j):
            axis = chip.ax[j]
            edge = _find_edge(axis, chip.clock)
            if edge != axis.last_edge:
                n = _count_rp_steps(axis.encoder_mode, axis.last_edge, edge)
                add_encoder_counts(chip, axis, -n if axis.encoder_reversed else n)
                _set_encoder_pins(axis, edge)


@hot
def set_shaft(chip, axis_index, count, rate):
    """Put the shaft of an axis at `count + rate * (clock - now)` from now on.

    Args:
        chip: State of the chip.
        axis_index: Number of the axis.
        count: Edges of the encoder.
        rate: Edges per reference clock.
    """
    update_encoder_inputs(chip)
    axis = chip.ax[axis_index]
    axis.shaft_clock, axis.shaft_edges, axis.shaft_rate = chip.clock, count, rate
    if has_encoder(chip, axis_index):
        update_encoder_inputs(chip)
    else:
        chip.encoder_axes |= 1 << axis_index
        _set_encoder_pins(axis, _find_edge(axis, chip.clock))


@hot
def _has_passed(axis, edge, clock):
    """Return whether the shaft has passed an encoder edge ahead of it at a clock."""
    return _find_edge(axis, clock) >= edge if axis.shaft_rate > 0.0 else _find_edge(axis, clock) < edge


@hot
def _find_clock_of_edge(chip, axis, edge):
    """Find the next clock at which the shaft has passed an edge ahead of it; NEVER if it turns too slowly.

    While it turns backward it passes edge n on the way from n to n - 1.
    """
    ahead = greatest((edge - 0.5 - axis.shaft_edges) / axis.shaft_rate, 0.0)
    if not ahead < float(NEVER):
        return NEVER
    guess = axis.shaft_clock + int(ahead)
    low, span = greatest(guess - 2, chip.clock), greatest(guess + 2 - chip.clock, 1)
    while not _has_passed(axis, edge, chip.clock + span):  # floats far from 0 are coarse
        span *= 2
        if span >= NEVER:
            return NEVER
    if _has_passed(axis, edge, low):
        low = chip.clock
    high = chip.clock + span
    while high - low > 1:
        middle = (low + high) // 2
        if _has_passed(axis, edge, middle):
            high = middle
        else:
            low = middle
    return high


@hot
def find_next_edge(chip, axis):
    """Find the next clock at which the shaft passes an edge of the encoder."""
    if axis.shaft_rate == 0.0:
        return NEVER
    return _find_clock_of_edge(chip, axis, axis.last_edge + 1 if axis.shaft_rate > 0.0 else axis.last_edge)


@hot
def is_counting_up(axis):
    """Return whether RP, the real position counter, counts up at the present rate of the shaft. Not for the up / down mode."""
    return (axis.shaft_rate > 0.0) != (axis.encoder_reversed != 0)


@hot
def find_clock_of_counts(chip, axis, counts):
    """Find the next clock at which RP has changed by a number of counts, 1 or more. Not for the up / down mode."""
    if axis.shaft_rate == 0.0 or counts >= NEVER:
        return NEVER
    count = axis.last_edge >> axis.encoder_mode
    return _find_clock_of_edge(
        chip, axis, (count + counts if axis.shaft_rate > 0.0 else count - counts + 1) << axis.encoder_mode
    )


@hot
def find_up_down_direction(axis):
    """Return the direction of the next count in the up / down mode, 1 or -1."""
    at = axis.last_edge & 3
    up = at != UP_FORWARD if axis.shaft_rate > 0.0 else at == UP_BACKWARD
    return 1 if up != (axis.encoder_reversed != 0) else -1
