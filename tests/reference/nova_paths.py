"""Ideal paths of the NOVA chips' interpolation, how far pulses are from them, and plain constructions of the ticks.

A tick is a tuple of steps, one (-1, 0, +1) for each axis; all its pulses begin at one clock. Points are relative to the
start. From shared/spec/nova_mcx514.md, sections 8 and 11; nothing here comes from stage.chips.
"""

from fractions import Fraction
from itertools import accumulate, pairwise
from math import atan2, hypot, tau

# The axis that moves faster, and the steps of the faster and the slower one, counter-clockwise, octant by octant from +X
OCTANTS = ((1, +1, -1), (0, -1, +1), (0, -1, -1), (1, -1, -1), (1, -1, +1), (0, +1, -1), (0, +1, +1), (1, +1, +1))
END = None  # of a bit pattern: both directions at once


def points(ticks):
    """Return the point to which each tick leads."""
    return list(accumulate(ticks, lambda at, step: tuple(a + s for a, s in zip(at, step, strict=True))))


# Measures, in LSB


def line_errors(course, finish):
    """Return, for each point, the largest distance of an axis to the ideal line at that tick."""
    long = max(range(len(finish)), key=lambda axis: abs(finish[axis]))
    return [
        max(abs(c - Fraction(f * at[long], finish[long])) for c, f in zip(at, finish, strict=True)) for at in course
    ]


def circle_errors(course, centre):
    """Return the distance of each point to the circle through the start."""
    radius = hypot(*centre)
    return [abs(hypot(x - centre[0], y - centre[1]) - radius) for x, y, *_ in course]


def angles(course, centre, clockwise):
    """Return the angle about the center up to each point, rad, rising along the arc, also beyond a full turn."""
    turned, last, total = [], atan2(-centre[1], -centre[0]), 0.0
    for x, y, *_ in course:
        now = atan2(y - centre[1], x - centre[0])
        total += (now - last + tau / 2) % tau - tau / 2
        turned.append(-total if clockwise else total)
        last = now
    return turned


def arc_angle(centre, finish, clockwise):
    """Return the angle of the ideal arc, rad, more than 0 and at most a full turn."""
    begin = atan2(-centre[1], -centre[0])
    angle = atan2(finish[1] - centre[1], finish[0] - centre[0]) - begin
    angle = (-angle if clockwise else angle) % tau
    return tau if angle < 1e-12 else angle


def helix_errors(course, centre, finish, clockwise, rise, turns=0):
    """Of each point (x, y, z), how far z is from the helix, which rises evenly with the angle by `rise` in all."""
    uncut = arc_angle(centre, finish, clockwise) + tau * turns
    turned = angles(course, centre, clockwise)
    return [abs(z - rise * angle / uncut) for (_, _, z), angle in zip(course, turned, strict=True)]


# Constructions


def line_ticks(finish):
    """The long axis steps at every tick, the others go where they are nearest to the ideal line.

    At a tie, half-way between two points, they step: both choices are within 0.5 LSB.
    """
    length = max(map(abs, finish))
    if not length:
        return []
    course = [tuple(_nearest(f * k, length) for f in finish) for k in range(length + 1)]
    return [tuple(b - a for a, b in zip(*pair, strict=True)) for pair in pairwise(course)]


def _nearest(numerator, denominator):
    """Round a fraction to the nearest integer, halves away from zero."""
    sign = -1 if numerator < 0 else 1
    return sign * ((2 * abs(numerator) + denominator) // (2 * denominator))


def octant_ahead(x, y, clockwise=False):
    """Return the octant in which a move from this point about the origin runs, 0 to 7 counter-clockwise from +X."""
    turned = [(x, y), (y, -x), (-x, -y), (-y, x)]
    for quarter, (u, v) in enumerate(turned):  # turned back until it lies in the first quarter, its far border excluded
        if u > 0 and v >= 0:
            octant, on_border = 2 * quarter + (v >= u), v in (0, u)
            return (octant - 1) % 8 if clockwise and on_border else octant
    raise ValueError("the centre itself is in no octant")


def octant_behind(x, y, clockwise=False):
    """Return the octant from which a move to this point comes, 0 to 7 counter-clockwise from +X."""
    return octant_ahead(x, y, not clockwise)


def circle_ticks(centre, finish, clockwise=False):
    """In each octant the faster axis steps at every tick, the slower one when that brings it nearer to the circle.

    Ends in the octant of the finish point, when the faster axis is where the finish point is, the other not corrected.
    Choice: where the octant ends first (a finish point beside the border), the arc ends there. The smallest circles, which
    skip octants, end at the start.
    """
    goal = tuple(f - c for f, c in zip(finish, centre, strict=True))
    x, y = start = (-centre[0], -centre[1])
    full, square = goal == start, x * x + y * y
    last = octant_behind(*goal, clockwise)
    fast_of_last, step_of_last, _ = OCTANTS[last]
    to_go = (goal[fast_of_last] - start[fast_of_last]) * step_of_last * (-1 if clockwise else 1)
    skip = octant_ahead(*start, clockwise) == last and (full or to_go <= 0)  # nearly a full turn
    ticks, before = [], None
    while True:
        octant = octant_ahead(x, y, clockwise)
        if before == last != octant:
            if not skip:
                return ticks
            skip = False
        before = octant
        tick = _circle_tick(x, y, octant, clockwise, square)
        ticks.append(tick)
        x, y = x + tick[0], y + tick[1]
        in_last = last in (octant, octant_ahead(x, y, clockwise))
        arrived = in_last and not skip and (x, y)[fast_of_last] == goal[fast_of_last]
        if arrived or (full and (x, y) == start):
            return ticks


def _circle_tick(x, y, octant, clockwise, square):
    fast, step, slow_step = OCTANTS[octant]
    sign = -1 if clockwise else 1
    straight = (0, sign * step) if fast else (sign * step, 0)
    bent = (sign * slow_step, straight[1]) if fast else (straight[0], sign * slow_step)
    return min(straight, bent, key=lambda tick: abs((x + tick[0]) ** 2 + (y + tick[1]) ** 2 - square))


def bit_pattern_ticks(words):
    """Steps of one axis from its TP words, LSB first: low half + direction, high half - direction; END for both."""
    ticks = []
    for word in words:
        for bit in range(16):
            plus, minus = word >> bit & 1, word >> bit + 16 & 1
            if plus and minus:
                return [*ticks, END]
            ticks.append(plus - minus)
    return ticks
