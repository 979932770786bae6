"""NOVA chips, compiled: helical interpolation: a circle of the first two axes, on which the others go in proportion to its ticks.

The helical calculation counts the ticks of the arc, or with a rotation number of a whole turn, into HLV; in so many ticks the
other axes make their pulses, one a tick at most: pulses beyond HLV are lost [I]. With a rotation number there are so many whole
turns, then the arc to a finish point that is not the start.
"""

from __future__ import annotations

from stage.chips.nova.interpolation import circle as circular
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.native import greatest, hot, least

MOST = MCX514_MAP.register("HLV").range[1]


@hot
def load(ip, g):
    """Begin arc or helix `g`. Returns whether it has a tick."""
    for k in range(g.axes):
        ip.error[k] = g.longest
        ip.toward[k] = (1 if g.finish[k] > 0 else 0) - (1 if g.finish[k] < 0 else 0)
    ip.turns = g.turns
    ip.rotations = 0
    return _arc(ip.arc, g, g.turns > 0)


@hot
def _arc(a, g, turn):
    """A whole turn, or the arc to the finish point, about the centre."""
    x, y = -g.centre[0] * g.fine, -g.centre[1] * g.fine
    goal_x, goal_y = (0, 0) if turn else (g.finish[0] * g.fine, g.finish[1] * g.fine)
    return circular.start(a, x, y * g.mirror, x + goal_x, (y + goal_y) * g.mirror)


@hot
def step(ip, g):
    """The steps of the next tick. Returns whether it is the last one."""
    a = ip.arc
    o = a.octant
    fast = circular.FAST[o]
    ip.zone = o if g.mirror > 0 else 7 - o
    ip.step[fast] = 1
    ip.step[1 - fast] = circular.step(a)
    ip.toward[fast], ip.toward[1 - fast] = circular.AHEAD[o], circular.ASIDE[o]
    ip.toward[1] *= g.mirror
    for k in range(2, g.axes):
        ip.error[k] += 2 * abs(g.finish[k]) * g.fine
        ip.step[k] = 0
        if ip.error[k] >= 2 * g.longest:
            ip.error[k] -= 2 * g.longest
            ip.step[k] = 1
    if not circular.arrived(a):
        return False
    if ip.turns > 0:
        ip.turns -= 1
        ip.rotations += 1
        if ip.turns > 0 or g.finish[0] != 0 or g.finish[1] != 0:
            _arc(a, g, ip.turns > 0)
            return False
    return True


@hot
def _count(a, g, turn):
    if not _arc(a, g, turn):
        return 0, 0
    return circular.ticks(a, a.x * a.x + a.y * a.y)


@hot
def ticks(a, g):
    """Count the ticks as line.py does; `a` is scratch."""
    count = both = 0
    if g.turns > 0:
        count, both = _count(a, g, True)
        count, both = count * g.turns, both * g.turns
    if g.turns == 0 or g.finish[0] != 0 or g.finish[1] != 0:
        rest, more = _count(a, g, False)
        count, both = count + rest, both + more
    return (count - both, both, 0) if g.vector else (count, 0, 0)


@hot
def inner_ticks(a, g, value):
    """Return HLV in inner ticks: those that the circle has, where the value is what the calculation makes of it. `a` is scratch."""
    inner, _ = _count(a, g, g.turns > 0)
    fine, g.fine = g.fine, 1
    calculated = calculate(a, g)
    g.fine = fine
    return greatest(inner, 1) if value == calculated else value * fine


@hot
def calculate(a, g):
    """HLV, as far as it can hold that."""
    count, _ = _count(a, g, g.turns > 0)
    return least(greatest(count, 1), MOST)
