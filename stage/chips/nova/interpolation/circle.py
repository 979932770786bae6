"""Circular interpolation of the NOVA chips, octant by octant, counter-clockwise about the center; compiled.

In each octant the faster axis makes a pulse in every tick, the slower axis if that leads nearer to the circle. The arc ends in the
octant of the finish point, when the faster axis has reached the coordinate of the finish point, or at the end of that octant.
"""

from __future__ import annotations

import math

from stage.native import hot, least

FAST_AXIS = (1, 0, 0, 1, 1, 0, 0, 1)
"""The faster axis of an octant; octants count counter-clockwise from +X."""
FAST_DIRECTION = (1, -1, -1, -1, -1, 1, 1, 1)
"""Direction of the steps of the faster axis, by octant."""
SLOW_DIRECTION = (-1, 1, -1, -1, 1, -1, 1, 1)
"""Direction of the steps of the slower axis, by octant."""
OCTANT_END_TICKS = 4  # ticks next to the end of an octant, which are made one by one


@hot
def find_octant(x, y):
    """Return the octant in which a counter-clockwise motion from the point (x, y) runs."""
    if x > 0 and y >= 0:
        return 1 if y >= x else 0
    if y > 0:
        return 3 if -x >= y else 2
    if x < 0:
        return 5 if -y >= -x else 4
    return 7 if x >= -y else 6


@hot
def begin_arc(arc, x, y, finish_x, finish_y):
    """Begin an arc, or a whole circle if the finish point is the start.

    Args:
        arc: State of the arc.
        x: First coordinate of the start, from the center.
        y: Second coordinate.
        finish_x: First coordinate of the finish point, from the center.
        finish_y: Second coordinate.

    Returns:
        Whether the radius is not 0.
    """
    arc.x, arc.y, arc.goal_x, arc.goal_y = x, y, finish_x, finish_y
    arc.radius_error = arc.octants_entered = 0
    arc.octant = find_octant(x, y)
    last = 7 - find_octant(finish_x, -finish_y)  # a move to the finish point comes from there
    arc.octants_to_enter = (last - arc.octant) & 7
    if arc.octants_to_enter == 0 and _count_steps_to_go(arc) <= 0:
        arc.octants_to_enter = 8
    return x != 0 or y != 0


@hot
def _count_steps_to_go(arc):
    """Count the pulses of the present octant's faster axis up to the coordinate of the finish point."""
    o = arc.octant
    return ((arc.goal_y - arc.y) if FAST_AXIS[o] else (arc.goal_x - arc.x)) * FAST_DIRECTION[o]


@hot
def has_arrived(arc):
    """Return whether the arc has reached its finish point."""
    return arc.octants_entered > arc.octants_to_enter or (
        arc.octants_entered == arc.octants_to_enter and _count_steps_to_go(arc) <= 0
    )


@hot
def step_arc(arc):
    """Move an arc by one pulse of the octant's faster axis, and return whether the slower axis makes a pulse as well."""
    o = arc.octant
    fast = FAST_AXIS[o]
    u, v = (arc.y, arc.x) if fast else (arc.x, arc.y)
    straight = arc.radius_error + 2 * u * FAST_DIRECTION[o] + 1
    bent = straight + 2 * v * SLOW_DIRECTION[o] + 1
    u += FAST_DIRECTION[o]
    moves = abs(bent) < abs(straight)
    if moves:
        v += SLOW_DIRECTION[o]
        straight = bent
    arc.radius_error = straight
    arc.x, arc.y = (v, u) if fast else (u, v)
    arc.octant = find_octant(arc.x, arc.y)
    arc.octants_entered += (arc.octant - o) & 7
    return moves


@hot
def _compute_integer_root(number):
    """Return the integer part of a square root."""
    r = int(math.sqrt(float(number)))
    while r * r > number:
        r -= 1
    while (r + 1) * (r + 1) <= number:
        r += 1
    return r


@hot
def _find_nearest_coordinate(coordinate, radius_squared):
    """Return the integer v for which coordinate^2 + v^2 is nearest to `radius_squared`."""
    r = _compute_integer_root(radius_squared - coordinate * coordinate)
    return r + 1 if (r + 1) * (r + 1) + r * r < 2 * (radius_squared - coordinate * coordinate) else r


@hot
def count_arc_ticks(arc, radius_squared):
    """Move an arc to its end; count all ticks of the arc, and the ticks in which both axes make a pulse.

    Within an octant the slower axis is always at the position nearest to the circle, so the function need not compute every tick.

    Args:
        arc: State of the arc.
        radius_squared: Square of the radius.
    """
    count = both = 0
    while not has_arrived(arc):
        o = arc.octant
        fast, ahead = FAST_AXIS[o], FAST_DIRECTION[o]
        u, v = (arc.y, arc.x) if fast else (arc.x, arc.y)
        room = _compute_integer_root(radius_squared // 2) - abs(u) if u * ahead >= 0 else abs(u)
        if arc.octants_entered == arc.octants_to_enter:
            room = least(room, _count_steps_to_go(arc))
        if room > 2 * OCTANT_END_TICKS and abs(v) == _find_nearest_coordinate(u, radius_squared):
            jump = room - OCTANT_END_TICKS
            u += jump * ahead
            new = _find_nearest_coordinate(u, radius_squared) * (1 if v > 0 else -1)
            count += jump
            both += abs(new - v)
            arc.radius_error = u * u + new * new - radius_squared
            arc.x, arc.y = (new, u) if fast else (u, new)
        else:
            count += 1
            both += step_arc(arc)
    return count, both
