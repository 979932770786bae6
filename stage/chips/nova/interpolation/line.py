"""Linear interpolation of the NOVA chips, compiled: the longest axis steps at every tick, the others near the line."""

from __future__ import annotations

from stage.native import hot, least


@hot
def begin_line(interpolation, segment):
    """Begin line `segment` of the interpolation, and return whether it has a tick.

    Args:
        interpolation: State of the interpolation.
        segment: The segment.
    """
    interpolation.ticks_left = segment.tick_count * segment.inner_ticks
    for k in range(segment.axis_count):
        interpolation.line_errors[k] = segment.tick_count
        interpolation.directions[k] = (1 if segment.finish[k] > 0 else 0) - (1 if segment.finish[k] < 0 else 0)
    return interpolation.ticks_left > 0


@hot
def step_line(interpolation, segment):
    """Prepare the pulses of the line's next tick, and return whether it is the last one.

    Args:
        interpolation: State of the interpolation.
        segment: The segment.
    """
    for k in range(segment.axis_count):
        interpolation.line_errors[k] += 2 * abs(segment.finish[k])
        interpolation.steps[k] = 0
        if interpolation.line_errors[k] >= 2 * segment.tick_count:
            interpolation.line_errors[k] -= 2 * segment.tick_count
            interpolation.steps[k] = 1
    interpolation.ticks_left -= 1
    return interpolation.ticks_left == 0


@hot
def count_line_ticks(interpolation, segment):
    """Count the ticks of a line by the number of axes that they move.

    Args:
        interpolation: State of the interpolation.
        segment: The segment.

    Returns:
        Numbers of ticks in which one axis or none, two axes, and three axes make a pulse. Only the axes that constant vector speed
        considers are counted.
    """
    ticks_in_all = segment.tick_count * segment.inner_ticks
    if not segment.vector_axes or segment.axis_count == 1:
        return ticks_in_all, 0, 0
    looked, always = least(segment.vector_axes, segment.axis_count), 0
    a = b = 0  # the short ones, as far as there are two
    shorts = 0
    for k in range(looked):
        length = abs(segment.finish[k])
        if length == segment.tick_count:
            always += 1
        elif shorts == 0:
            a, shorts = length, 1
        else:
            b, shorts = length, shorts + 1
    if shorts == 3:
        return _count_ticks_by_steps(interpolation, segment, ticks_in_all)
    both = count_simultaneous_ticks(a, b, segment.tick_count) if shorts == 2 else 0
    alone = a + b - 2 * both  # ticks in which just one of the short ones steps
    moved = (
        (segment.tick_count - alone - both) * segment.inner_ticks,
        alone * segment.inner_ticks,
        both * segment.inner_ticks,
    )
    if always == 0:
        return moved[0] + moved[1], moved[2], 0
    if always == 1:
        return moved
    return (0, ticks_in_all - moved[1], moved[1]) if always == 2 else (0, 0, ticks_in_all)


@hot
def _count_ticks_by_steps(interpolation, segment, ticks_in_all):
    """Count the ticks of a line as `count_line_ticks` does, tick by tick.

    This is needed if three axes are shorter than a fourth axis, or than a maximum that the host has set.
    """
    two = three = 0
    for _ in range(ticks_in_all if begin_line(interpolation, segment) else 0):
        step_line(interpolation, segment)
        moved = interpolation.steps[0] + interpolation.steps[1] + interpolation.steps[2]
        two += moved == 2
        three += moved == 3
    return ticks_in_all - two - three, two, three


@hot
def count_simultaneous_ticks(first_steps, second_steps, tick_count):
    """Count the ticks of a line in which two axes make a pulse at once.

    With n ticks, an axis of a steps makes one in tick k if a k lies in [-h, a - h) modulo n, with h = n // 2. So the function
    counts those points of the lattice (a k, b k) modulo n that lie in a rectangle. Its columns are e apart, and each begins
    `shift` above the one before, modulo `gap`.

    Args:
        first_steps: Steps of the first axis, a, 0 to n.
        second_steps: Steps of the second axis, b, 0 to n.
        tick_count: Ticks of the line, n.
    """
    if first_steps == 0 or second_steps == 0:
        return 0
    e, inverse = _find_gcd_and_inverse(first_steps, tick_count)
    gap = tick_count // e * _find_gcd_and_inverse(second_steps, e)[0]
    shift = second_steps * inverse % gap
    first = -(tick_count // 2 // e)  # the first column in the rectangle
    low = (-(tick_count // 2) - 1 - first * shift) % gap
    down = (gap - shift) % gap
    columns = first_steps // e
    return _find_gcd_and_inverse(second_steps, e)[0] * (
        _sum_floors(columns, gap, down, low + second_steps) - _sum_floors(columns, gap, down, low)
    )


@hot
def _find_gcd_and_inverse(number, modulus):
    """Return the greatest common divisor e of two numbers, and the factor f with number f = e modulo `modulus`."""
    e, rest, u, v = number, modulus, 1, 0
    while rest:
        q = e // rest
        e, rest = rest, e - q * rest
        u, v = v, u - q * v
    return e, u % modulus


@hot
def _sum_floors(term_count, divisor, slope, offset):
    """Compute the sum of (slope i + offset) // divisor over `term_count` terms, i = 0, 1, ..., by Euclid's algorithm on the slope.

    Args:
        term_count: Number of terms.
        divisor: Divisor.
        slope: Slope, 0 to divisor - 1.
        offset: Offset, 0 or more.
    """
    total = 0
    while term_count > 0:
        total += term_count * (term_count - 1) // 2 * (slope // divisor) + term_count * (offset // divisor)
        slope, offset = slope % divisor, offset % divisor
        top = slope * term_count + offset
        if top < divisor:
            break
        term_count, offset, divisor, slope = top // divisor, top % divisor, slope, divisor
    return total
