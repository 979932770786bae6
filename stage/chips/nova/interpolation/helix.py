"""Helical interpolation of the NOVA chips, compiled: a circle of two axes, and other axes that move in proportion to its ticks.

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
def begin_helix(interpolation, segment):
    """Begin arc or helix `segment` of the interpolation, and return whether it has a tick.

    Args:
        interpolation: State of the interpolation.
        segment: The segment.
    """
    for k in range(segment.axis_count):
        interpolation.line_errors[k] = segment.tick_count
        interpolation.directions[k] = (1 if segment.finish[k] > 0 else 0) - (1 if segment.finish[k] < 0 else 0)
    interpolation.rotations_left = segment.rotations
    interpolation.finished_rotations = 0
    return _begin_arc_or_turn(interpolation.arc, segment, segment.rotations > 0)


@hot
def _begin_arc_or_turn(arc, segment, is_turn):
    """Begin a whole turn, or the arc to the finish point, about the center.

    Args:
        arc: State of the arc.
        segment: The segment.
        is_turn: Whether it is a whole turn.
    """
    x, y = -segment.center[0] * segment.inner_ticks, -segment.center[1] * segment.inner_ticks
    goal_x, goal_y = (
        (0, 0) if is_turn else (segment.finish[0] * segment.inner_ticks, segment.finish[1] * segment.inner_ticks)
    )
    return circular.begin_arc(arc, x, y * segment.y_sign, x + goal_x, (y + goal_y) * segment.y_sign)


@hot
def step_helix(interpolation, segment):
    """Prepare the pulses of the next tick of an arc or helix, and return whether it is the last one.

    Args:
        interpolation: State of the interpolation.
        segment: The segment.
    """
    a = interpolation.arc
    o = a.octant
    fast = circular.FAST_AXIS[o]
    interpolation.zone = o if segment.y_sign > 0 else 7 - o
    interpolation.steps[fast] = 1
    interpolation.steps[1 - fast] = circular.step_arc(a)
    interpolation.directions[fast] = circular.FAST_DIRECTION[o]
    interpolation.directions[1 - fast] = circular.SLOW_DIRECTION[o]
    interpolation.directions[1] *= segment.y_sign
    for k in range(2, segment.axis_count):
        interpolation.line_errors[k] += 2 * abs(segment.finish[k]) * segment.inner_ticks
        interpolation.steps[k] = 0
        if interpolation.line_errors[k] >= 2 * segment.tick_count:
            interpolation.line_errors[k] -= 2 * segment.tick_count
            interpolation.steps[k] = 1
    if not circular.has_arrived(a):
        return False
    if interpolation.rotations_left > 0:
        interpolation.rotations_left -= 1
        interpolation.finished_rotations += 1
        if interpolation.rotations_left > 0 or segment.finish[0] != 0 or segment.finish[1] != 0:
            _begin_arc_or_turn(a, segment, interpolation.rotations_left > 0)
            return False
    return True


@hot
def _count_ticks(arc, segment, is_turn):
    """Count the ticks of a whole turn or of the arc of a segment, and those that move both axes."""
    if not _begin_arc_or_turn(arc, segment, is_turn):
        return 0, 0
    return circular.count_arc_ticks(arc, arc.x * arc.x + arc.y * arc.y)


@hot
def count_helix_ticks(arc, segment):
    """Count the ticks of a helix as `line.count_line_ticks` does.

    Args:
        arc: State of an arc, which the function overwrites.
        segment: The segment.
    """
    count = both = 0
    if segment.rotations > 0:
        count, both = _count_ticks(arc, segment, True)
        count, both = count * segment.rotations, both * segment.rotations
    if segment.rotations == 0 or segment.finish[0] != 0 or segment.finish[1] != 0:
        rest, more = _count_ticks(arc, segment, False)
        count, both = count + rest, both + more
    return (count - both, both, 0) if segment.vector_axes else (count, 0, 0)


@hot
def convert_hlv_to_inner_ticks(arc, segment, hlv):
    """Convert HLV to inner ticks. The result is exact if HLV is the result of the helical calculation.

    Args:
        arc: State of an arc, which the function overwrites.
        segment: The segment.
        hlv: HLV.
    """
    inner, _ = _count_ticks(arc, segment, segment.rotations > 0)
    fine, segment.inner_ticks = segment.inner_ticks, 1
    calculated = calculate_hlv(arc, segment)
    segment.inner_ticks = fine
    return greatest(inner, 1) if hlv == calculated else hlv * fine


@hot
def calculate_hlv(arc, segment):
    """Calculate HLV, the number of ticks of the arc or of a whole turn of a helix, limited to the range of its register.

    Args:
        arc: State of an arc, which the function overwrites.
        segment: The segment.
    """
    count, _ = _count_ticks(arc, segment, segment.rotations > 0)
    return least(greatest(count, 1), MAX_HLV)
