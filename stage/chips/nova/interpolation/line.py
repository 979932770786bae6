"""Linear interpolation of the NOVA chips, compiled: the longest axis steps at every tick, the others near the line."""

from __future__ import annotations

from stage.native import hot, least


@hot
def begin_line(interpolation, segment):
    """Begin line `segment`, and return whether it has a tick.

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
    """Prepare the steps of the next tick, and return whether it is the last one.

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
        Ticks that move one axis or none, two, and three of the axes that constant vector speed considers.
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
    both = count_common_ticks(a, b, segment.tick_count) if shorts == 2 else 0
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
    """Count the ticks as `count_line_ticks` does, by walking along the line.

    Needed for three short axes, below a longer fourth axis or a maximum that the host has set.
    """
    two = three = 0
    for _ in range(ticks_in_all if begin_line(interpolation, segment) else 0):
        step_line(interpolation, segment)
        moved = interpolation.steps[0] + interpolation.steps[1] + interpolation.steps[2]
        two += moved == 2
        three += moved == 3
    return ticks_in_all - two - three, two, three


@hot
def count_common_ticks(multiplier, b, n):
    """Count the ticks of a line in which two axes step at once.

    An axis steps in tick k if a k lies in [-h, a - h) modulo n, with h = n // 2. So the function counts those points of the
    lattice (a k, b k) modulo n that lie in a rectangle: its columns are e apart, and each begins `shift` above the one before,
    modulo `gap`.

    Args:
        multiplier: Steps of the first axis, 0 to n.
        b: Steps of the second axis, 0 to n.
        n: Ticks of the line.
    """
    if multiplier == 0 or b == 0:
        return 0
    e, inverse = _find_gcd_and_inverse(multiplier, n)
    gap = n // e * _find_gcd_and_inverse(b, e)[0]
    shift = b * inverse % gap
    first = -(n // 2 // e)  # the first column in the rectangle
    low = (-(n // 2) - 1 - first * shift) % gap
    down = (gap - shift) % gap
    columns = multiplier // e
    return _find_gcd_and_inverse(b, e)[0] * (
        _sum_floors(columns, gap, down, low + b) - _sum_floors(columns, gap, down, low)
    )


@hot
def _find_gcd_and_inverse(multiplier, n):
    """Return the greatest common divisor e of two numbers, and the factor by which `multiplier` becomes e modulo n."""
    e, rest, u, v = multiplier, n, 1, 0
    while rest:
        q = e // rest
        e, rest = rest, e - q * rest
        u, v = v, u - q * v
    return e, u % n


@hot
def _sum_floors(n, m, multiplier, b):
    """Compute the sum of (a i + b) // m over i = 0 to n - 1, by Euclid's algorithm on the slope.

    Args:
        n: Number of terms.
        m: Divisor.
        multiplier: Slope, 0 to m - 1.
        b: Offset, 0 or more.
    """
    total = 0
    while n > 0:
        total += n * (n - 1) // 2 * (multiplier // m) + n * (b // m)
        multiplier, b = multiplier % m, b % m
        top = multiplier * n + b
        if top < m:
            break
        n, b, m, multiplier = top // m, top % m, multiplier, m
    return total
