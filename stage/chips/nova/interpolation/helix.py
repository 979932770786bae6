"""Helical interpolation of the NOVA chips: a circle of two axes, along which the others move in proportion to its ticks; compiled.

The helical calculation counts the ticks of the arc, or, if there is a rotation number, of a whole turn, and stores them in HLV.
The other axes make their pulses in that number of ticks, one per tick at most; pulses beyond HLV are lost [I]. The rotation
number is the number of whole turns before the arc; there is no arc if the finish point is the start.
"""

from __future__ import annotations

from stage.chips.nova.interpolation import circle as circular
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.native import greatest, hot, least

MAX_HLV = MCX514_MAP.register("HLV").range[1]


@hot
def begin_helix(ip, g):
    """Begin arc or helix `g`, and return whether it has a tick.

    Args:
        ip: State of the interpolation.
        g: The segment.
    """
    for k in range(g.axis_count):
        ip.line_errors[k] = g.tick_count
        ip.directions[k] = (1 if g.finish[k] > 0 else 0) - (1 if g.finish[k] < 0 else 0)
    ip.rotations_left = g.rotations
    ip.finished_rotations = 0
    return _begin_arc_or_turn(ip.arc, g, g.rotations > 0)


@hot
def _begin_arc_or_turn(a, g, turn):
    """Begin a whole turn, or the arc to the finish point, about the center.

    Args:
        a: State of the arc.
        g: The segment.
        turn: Whether it is a whole turn.
    """
    x, y = -g.center[0] * g.inner_ticks, -g.center[1] * g.inner_ticks
    goal_x, goal_y = (0, 0) if turn else (g.finish[0] * g.inner_ticks, g.finish[1] * g.inner_ticks)
    return circular.begin_arc(a, x, y * g.y_sign, x + goal_x, (y + goal_y) * g.y_sign)


@hot
def step_helix(ip, g):
    """Prepare the steps of the next tick, and return whether it is the last one.

    Args:
        ip: State of the interpolation.
        g: The segment.
    """
    a = ip.arc
    o = a.octant
    fast = circular.FAST_AXIS[o]
    ip.zone = o if g.y_sign > 0 else 7 - o
    ip.steps[fast] = 1
    ip.steps[1 - fast] = circular.step_arc(a)
    ip.directions[fast], ip.directions[1 - fast] = circular.FAST_DIRECTION[o], circular.SLOW_DIRECTION[o]
    ip.directions[1] *= g.y_sign
    for k in range(2, g.axis_count):
        ip.line_errors[k] += 2 * abs(g.finish[k]) * g.inner_ticks
        ip.steps[k] = 0
        if ip.line_errors[k] >= 2 * g.tick_count:
            ip.line_errors[k] -= 2 * g.tick_count
            ip.steps[k] = 1
    if not circular.has_arrived(a):
        return False
    if ip.rotations_left > 0:
        ip.rotations_left -= 1
        ip.finished_rotations += 1
        if ip.rotations_left > 0 or g.finish[0] != 0 or g.finish[1] != 0:
            _begin_arc_or_turn(a, g, ip.rotations_left > 0)
            return False
    return True


@hot
def _count_ticks(a, g, turn):
    """Count the ticks of a whole turn or of the arc, and those that move both axes."""
    if not _begin_arc_or_turn(a, g, turn):
        return 0, 0
    return circular.count_arc_ticks(a, a.x * a.x + a.y * a.y)


@hot
def count_helix_ticks(a, g):
    """Count the ticks of a helix as `line.count_line_ticks` does.

    Args:
        a: State of an arc, which the function overwrites.
        g: The segment.
    """
    count = both = 0
    if g.rotations > 0:
        count, both = _count_ticks(a, g, True)
        count, both = count * g.rotations, both * g.rotations
    if g.rotations == 0 or g.finish[0] != 0 or g.finish[1] != 0:
        rest, more = _count_ticks(a, g, False)
        count, both = count + rest, both + more
    return (count - both, both, 0) if g.vector_axes else (count, 0, 0)


@hot
def compute_inner_ticks(a, g, value):
    """Convert HLV to inner ticks. The result is exact if HLV is the result of the helical calculation.

    Args:
        a: State of an arc, which the function overwrites.
        g: The segment.
        value: HLV.
    """
    inner, _ = _count_ticks(a, g, g.rotations > 0)
    fine, g.inner_ticks = g.inner_ticks, 1
    calculated = calculate_hlv(a, g)
    g.inner_ticks = fine
    return greatest(inner, 1) if value == calculated else value * fine


@hot
def calculate_hlv(a, g):
    """Calculate HLV, limited to the range of its register.

    Args:
        a: State of an arc, which the function overwrites.
        g: The segment.
    """
    count, _ = _count_ticks(a, g, g.rotations > 0)
    return least(greatest(count, 1), MAX_HLV)
