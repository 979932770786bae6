"""NOVA chips, compiled: circular interpolation, octant by octant, counter-clockwise about the centre.

In each octant the faster axis steps at every tick, the slower one when that leads nearer to the circle. The arc ends in the
octant of the finish point, when the faster axis is where the finish point is, or where that octant ends.
"""

from __future__ import annotations

import math

from stage.native import hot, least

FAST = (1, 0, 0, 1, 1, 0, 0, 1)
"""The faster axis of an octant; octants count counter-clockwise from +X."""
AHEAD = (1, -1, -1, -1, -1, 1, 1, 1)
"""The direction of its steps."""
ASIDE = (-1, 1, -1, -1, 1, -1, 1, 1)
"""The direction of the slower axis' steps."""
NEAR = 4  # ticks beside the end of an octant that are made one by one


@hot
def octant_of(x, y):
    """The octant that a move counter-clockwise from a point runs in."""
    if x > 0 and y >= 0:
        return 1 if y >= x else 0
    if y > 0:
        return 3 if -x >= y else 2
    if x < 0:
        return 5 if -y >= -x else 4
    return 7 if x >= -y else 6


@hot
def start(a, x, y, goal_x, goal_y):
    """Begin an arc; a whole circle if the finish point is where it begins.

    Args:
        a: State of the arc.
        x: First coordinate of its begin, from the center.
        y: Second coordinate.
        goal_x: First coordinate of the finish point, from the center.
        goal_y: Second coordinate.

    Returns:
        Whether it has a radius.
    """
    a.x, a.y, a.goal_x, a.goal_y = x, y, goal_x, goal_y
    a.off = a.passed = 0
    a.octant = octant_of(x, y)
    last = 7 - octant_of(goal_x, -goal_y)  # a move to the finish point comes from there
    a.target = (last - a.octant) & 7
    if a.target == 0 and _to_go(a) <= 0:
        a.target = 8
    return x != 0 or y != 0


@hot
def _to_go(a):
    """Steps of the present octant's faster axis until it is where the finish point is."""
    o = a.octant
    return ((a.goal_y - a.y) if FAST[o] else (a.goal_x - a.x)) * AHEAD[o]


@hot
def arrived(a):
    return a.passed > a.target or (a.passed == a.target and _to_go(a) <= 0)


@hot
def step(a):
    """One tick. Returns whether the slower axis steps, too."""
    o = a.octant
    fast = FAST[o]
    u, v = (a.y, a.x) if fast else (a.x, a.y)
    straight = a.off + 2 * u * AHEAD[o] + 1
    bent = straight + 2 * v * ASIDE[o] + 1
    u += AHEAD[o]
    moves = abs(bent) < abs(straight)
    if moves:
        v += ASIDE[o]
        straight = bent
    a.off = straight
    a.x, a.y = (v, u) if fast else (u, v)
    a.octant = octant_of(a.x, a.y)
    a.passed += (a.octant - o) & 7
    return moves


@hot
def _root(n):
    """The whole part of a square root."""
    r = int(math.sqrt(float(n)))
    while r * r > n:
        r -= 1
    while (r + 1) * (r + 1) <= n:
        r += 1
    return r


@hot
def _nearest(u, square):
    """The whole number v for which u^2 + v^2 is nearest to `square`."""
    r = _root(square - u * u)
    return r + 1 if (r + 1) * (r + 1) + r * r < 2 * (square - u * u) else r


@hot
def ticks(a, square):
    """Ticks of the arc `a` to its end, and how many of them move both axes. Inside of an octant it goes at once: there the
    slower axis is where it is nearest to the circle."""
    count = both = 0
    while not arrived(a):
        o = a.octant
        fast, ahead = FAST[o], AHEAD[o]
        u, v = (a.y, a.x) if fast else (a.x, a.y)
        room = _root(square // 2) - abs(u) if u * ahead >= 0 else abs(u)
        if a.passed == a.target:
            room = least(room, _to_go(a))
        if room > 2 * NEAR and abs(v) == _nearest(u, square):
            jump = room - NEAR
            u += jump * ahead
            new = _nearest(u, square) * (1 if v > 0 else -1)
            count += jump
            both += abs(new - v)
            a.off = u * u + new * new - square
            a.x, a.y = (new, u) if fast else (u, new)
        else:
            count += 1
            both += step(a)
    return count, both
