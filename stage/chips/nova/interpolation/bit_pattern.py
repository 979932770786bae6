"""Bit pattern interpolation of the NOVA chips: 16 steps of each axis, bit 0 first; the + and - bits both set end it; compiled."""

from __future__ import annotations

from stage.native import hot

PATTERN_STEPS = 16


@hot
def begin_pattern(interpolation, segment):
    """Begin bit pattern `segment`, and return True, because a bit pattern always has ticks.

    Args:
        interpolation: State of the interpolation.
        segment: The segment.
    """
    interpolation.ticks_left = PATTERN_STEPS
    for k in range(segment.axis_count):
        interpolation.directions[k] = 0
    return True


@hot
def step_pattern(interpolation, segment):
    """Prepare the pulses of the bit pattern's next tick, and return whether it is the last one.

    Sets `ends_interpolation` if both bits of an axis are set.

    Args:
        interpolation: State of the interpolation.
        segment: The segment.
    """
    bit = PATTERN_STEPS - interpolation.ticks_left
    for k in range(segment.axis_count):
        plus, minus = segment.finish[k] >> bit & 1, segment.finish[k] >> bit + PATTERN_STEPS & 1
        interpolation.steps[k] = plus | minus
        if plus and minus:
            interpolation.ends_interpolation = 1
        if plus or minus:
            interpolation.directions[k] = plus - minus
    interpolation.ticks_left -= 1
    return interpolation.ticks_left == 0


@hot
def count_pattern_ticks(segment):
    """Count the ticks of a bit pattern by the number of axes that they move, as `line.count_line_ticks` does."""
    one = two = three = 0
    for bit in range(PATTERN_STEPS):
        moved = 0
        for k in range(segment.axis_count):
            plus, minus = segment.finish[k] >> bit & 1, segment.finish[k] >> bit + PATTERN_STEPS & 1
            if plus and minus:
                return one, two, three
            if k < segment.vector_axes:
                moved += plus | minus
        one += moved < 2
        two += moved == 2
        three += moved == 3
    return one, two, three
