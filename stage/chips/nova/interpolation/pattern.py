"""Bit pattern interpolation of the NOVA chips: 16 steps of each axis, bit 0 first; the + and - bits both set end it; compiled."""

from __future__ import annotations

from stage.native import hot

PATTERN_STEPS = 16


@hot
def begin_pattern(ip, g):
    """Begin bit pattern `g`, and return True: it always has ticks.

    Args:
        ip: State of the interpolation.
        g: The segment.
    """
    ip.ticks_left = PATTERN_STEPS
    for k in range(g.axis_count):
        ip.directions[k] = 0
    return True


@hot
def step_pattern(ip, g):
    """Prepare the steps of the next tick, and return whether it is the last one.

    Sets `ends_interpolation` if both bits of an axis are set.

    Args:
        ip: State of the interpolation.
        g: The segment.
    """
    bit = PATTERN_STEPS - ip.ticks_left
    for k in range(g.axis_count):
        plus, minus = g.finish[k] >> bit & 1, g.finish[k] >> bit + PATTERN_STEPS & 1
        ip.steps[k] = plus | minus
        if plus and minus:
            ip.ends_interpolation = 1
        if plus or minus:
            ip.directions[k] = plus - minus
    ip.ticks_left -= 1
    return ip.ticks_left == 0


@hot
def count_pattern_ticks(g):
    """Count the ticks of a pattern as `line.count_line_ticks` does."""
    one = two = three = 0
    for bit in range(PATTERN_STEPS):
        moved = 0
        for k in range(g.axis_count):
            plus, minus = g.finish[k] >> bit & 1, g.finish[k] >> bit + PATTERN_STEPS & 1
            if plus and minus:
                return one, two, three
            if k < g.vector_axes:
                moved += plus | minus
        one += moved < 2
        two += moved == 2
        three += moved == 3
    return one, two, three
