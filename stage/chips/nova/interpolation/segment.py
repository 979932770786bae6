"""The segment that a NOVA interpolation runs now, compiled: its next tick, and the speed profile of the main axis."""

from __future__ import annotations

import math

from stage.chips.nova.interpolation import bit_pattern
from stage.chips.nova.interpolation import helix as helical
from stage.chips.nova.interpolation import line as linear
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion import rate_registers, single_axis_drive
from stage.chips.nova.motion.profile_evaluation import PLACE_TOLERANCE, compute_exact_place, compute_time_in_piece
from stage.chips.nova.motion.profile_planner import (
    CURSOR_PLACE,
    append_braking,
    begin_plan,
    begin_plan_at,
    plan_braking_at,
    plan_endless_drive,
    plan_fixed_drive,
)
from stage.chips.nova.registers.mcx514 import MAX_CONTINUOUS_PPS, MCX514_MAP
from stage.chips.nova.state import (
    AO,
    AXIS,
    DP,
    DV,
    LINE,
    MAX_CHIP_AXES,
    MCX514_TYPE,
    NEVER,
    PATTERN,
    PRE_BUFFER_STAGES,
    STATE,
)
from stage.native import exported, greatest, hot, least

ONE = (1.0, 0.0)
ROOT2 = (1.4142135623730951, -9.667293313452913e-17)
ROOT3 = (1.7320508075688772, 1.0035084221806903e-16)
MAX_SPEED_PPS = MCX514_MAP.register("DV").range[1]
MAX_CLOCKS = 1e17  # centuries
INNER_TICKS = 8  # inner ticks of a tick where short-axis pulses are equalized


@hot
def begin_segment(chip):
    """Begin the interpolation segment at the head of the queue, and return whether it has a tick."""
    interpolation, segment = chip.ip, chip.queue[chip.ip.queue_head]
    interpolation.ends_interpolation = interpolation.zone = 0
    for k in range(MAX_CHIP_AXES):
        interpolation.inner_positions[k] = 0
    for j in range(chip.axes):
        chip.ax[j].moves = 0
    if segment.kind == LINE:
        return linear.begin_line(interpolation, segment)
    if segment.kind == PATTERN:
        return bit_pattern.begin_pattern(interpolation, segment)
    return helical.begin_helix(interpolation, segment)


@hot
def _find_tick_length(moved_axes):
    """Return the distance on the profile, in pulses, of a tick that moves a number of axes: 1, sqrt2 or sqrt3."""
    return ONE if moved_axes < 2 else ROOT2 if moved_axes == 2 else ROOT3


@hot
def _compute_segment_length(chip, queue_index):
    """Compute the length on the profile, in pulses, of the segment at an index in the queue; 0 is the running segment.

    The segment must not have begun.
    """
    interpolation, segment = chip.ip, chip.queue[(chip.ip.queue_head + queue_index) % (PRE_BUFFER_STAGES + 1)]
    if segment.kind == LINE:
        one, two, three = linear.count_line_ticks(interpolation, segment)
    elif segment.kind == PATTERN:
        one, two, three = bit_pattern.count_pattern_ticks(segment)
    else:
        one, two, three = helical.count_helix_ticks(interpolation.scratch_arc, segment)
    distance = dd.add(
        dd.to_double_double(one),
        dd.add(dd.multiply(dd.to_double_double(two), ROOT2), dd.multiply(dd.to_double_double(three), ROOT3)),
    )
    return dd.scale(distance, 1.0 / segment.inner_ticks)


@exported(None, STATE)
def prepare_tick(chip):
    """Prepare the pulses and directions of the interpolation's next tick, and its place on the speed profile."""
    interpolation, segment = chip.ip, chip.queue[chip.ip.queue_head]
    if segment.kind == LINE:
        interpolation.is_last_tick = linear.step_line(interpolation, segment)
    elif segment.kind == PATTERN:
        interpolation.is_last_tick = bit_pattern.step_pattern(interpolation, segment)
    else:
        interpolation.is_last_tick = helical.step_helix(interpolation, segment)
    moved = 0
    for k in range(least(segment.vector_axes, segment.axis_count)):
        moved += interpolation.steps[k]
    dd.store_pair(
        interpolation.tick_place,
        dd.add(dd.load_pair(interpolation.tick_place), dd.scale(_find_tick_length(moved), 1.0 / segment.inner_ticks)),
    )
    for k in range(segment.axis_count):
        axis, direction = chip.ax[segment.axis_numbers[k]], interpolation.directions[k]
        if segment.inner_ticks > 1:
            before = (interpolation.inner_positions[k] + INNER_TICKS // 2) // INNER_TICKS
            interpolation.inner_positions[k] += direction * interpolation.steps[k]
            interpolation.steps[k] = (interpolation.inner_positions[k] + INNER_TICKS // 2) // INNER_TICKS != before
        axis.moves = direction != 0
        if direction != 0 and axis.direction != direction:
            axis.direction = direction
            chip.stale = 1


@hot
def find_limited_drive_speed(chip, axis):
    """Return the drive speed DV, limited to the maximum that the interpolation mode allows."""
    interpolation = chip.ip
    if chip.variant != MCX514_TYPE:
        return axis.reg[DV]
    return least(
        axis.reg[DV],
        (MAX_CONTINUOUS_PPS if interpolation.continuous else MAX_SPEED_PPS)
        // chip.queue[interpolation.queue_head].inner_ticks,
    )


@hot
def _plan_segment(chip, axis):
    """Plan the profile of the main axis from its cursor on, up to the end of the segment if the segment decelerates."""
    interpolation, segment = chip.ip, chip.queue[chip.ip.queue_head]
    interpolation.planned_speed = find_limited_drive_speed(chip, axis)
    interpolation.plan_decelerates = segment.decelerates
    rate_registers.load_drive_speed(chip, axis, interpolation.planned_speed)
    if not segment.decelerates:
        plan_endless_drive(axis, dd.load_pair(axis.dv))
        return
    goal = single_axis_drive.find_goal_speed(
        axis, dd.floor(dd.subtract(dd.load_pair(interpolation.segment_end), dd.load_pair(interpolation.segment_start)))
    )
    point = dd.floor(dd.load_pair(interpolation.segment_start)) + axis.reg[DP]
    if not axis.manual_deceleration:
        plan_fixed_drive(
            axis, dd.subtract(dd.load_pair(interpolation.segment_end), dd.to_double_double(axis.reg[AO])), goal
        )
    elif dd.is_less(dd.load_pair(axis.cursor[CURSOR_PLACE]), dd.to_double_double(point)):
        plan_endless_drive(axis, goal)
        if dd.is_less(dd.to_double_double(point), dd.load_pair(interpolation.segment_end)):
            plan_braking_at(axis, point)
    else:
        append_braking(axis)


@exported(None, STATE, AXIS)
def replan_segment(chip, axis):
    """Plan the profile of the main axis again, after the drive speed or the queued segments have changed."""
    interpolation = chip.ip
    if chip.clock == interpolation.start_clock:  # nothing has moved yet
        rate_registers.load_drive_speed(chip, axis, find_limited_drive_speed(chip, axis))
        begin_plan(
            axis, chip.clock, dd.ZERO, dd.ZERO, dd.minimum(dd.load_pair(axis.sv), dd.load_pair(axis.dv)), dd.ZERO
        )
    else:
        begin_plan_at(axis, chip.clock - axis.origin)
    _plan_segment(chip, axis)
    reschedule_tick(chip, axis)


@hot
def reschedule_tick(chip, axis):
    """Find the clock of the interpolation's prepared tick again, after a change of the speed plan."""
    chip.ip.tick_piece = 0
    update_next_tick_clock(chip, axis)


@hot
def update_next_tick_clock(chip, axis):
    """Find the clock of the prepared tick of the interpolation."""
    interpolation = chip.ip
    interpolation.next_tick_clock = NEVER
    if not interpolation.single_stepped:
        n, interpolation.tick_piece = find_clock_of_place(
            axis, interpolation.tick_piece, dd.load_pair(interpolation.tick_place)
        )
        if n < NEVER:
            interpolation.next_tick_clock = axis.origin + n


@hot
def is_chained_pattern(chip):
    """Return whether the running segment is a set of a bit pattern of an older chip.

    On these chips all sets form one interpolation, which decelerates at the end of the last set.
    """
    return chip.variant != MCX514_TYPE and chip.queue[chip.ip.queue_head].kind == PATTERN


@hot
def update_segment_end(chip):
    """Find the place in the speed profile at which the running segment ends, if it decelerates there."""
    interpolation = chip.ip
    if chip.queue[interpolation.queue_head].decelerates:
        distance = dd.load_pair(interpolation.segment_start)
        for k in range(1 + (interpolation.waiting_segments if is_chained_pattern(chip) else 0)):
            distance = dd.add(distance, _compute_segment_length(chip, k))
        dd.store_pair(interpolation.segment_end, distance)


@hot
def update_pattern_end(chip):
    """Plan the profile again after the number of sets that follow a bit pattern has changed (MCX312, MCX314As)."""
    if chip.interpolating:
        update_segment_end(chip)
        chip.ip.planned_speed = -1  # plan anew


@hot
def _has_reached_place(axis, piece, clocks, place):
    """Return whether the profile has reached a place at a clock.

    Args:
        axis: State of the axis.
        piece: Number of the piece of the profile that is in force at this clock.
        clocks: Clocks after the origin.
        place: Position on the profile in pulses, a double-double.
    """
    if axis.a2[piece, 0] == 0.0 and axis.j6[piece, 0] == 0.0:  # the same, sooner
        t = dd.subtract(dd.to_double_double(clocks), dd.load_pair(axis.t[piece]))
        reached = dd.add(dd.load_pair(axis.p[piece]), dd.multiply(t, dd.load_pair(axis.v[piece])))
    else:
        reached = compute_exact_place(axis, piece, clocks)
    return not dd.is_less(
        dd.add(dd.add(dd.to_double_double(axis.from_pulse[piece]), reached), (PLACE_TOLERANCE, 0.0)), place
    )


@hot
def find_clock_of_place(axis, piece, place):
    """Find the first clock after the origin at which the profile has reached a place, which may be a fraction of a pulse.

    Double-doubles are used only if the result in floats is next to a whole clock.

    Args:
        axis: State of the axis.
        piece: Number of the first piece of the profile to search.
        place: Position on the profile in pulses, a double-double.

    Returns:
        The clock, NEVER if it is centuries ahead; and the number of the piece in force at that clock.
    """
    while True:
        low = axis.from_clock[piece]
        last = piece + 1 == axis.pieces
        edge = NEVER if last else axis.from_clock[piece + 1]
        max_time = (
            MAX_CLOCKS
            if last
            else (axis.t[piece + 1, 0] - axis.t[piece, 0]) + (axis.t[piece + 1, 1] - axis.t[piece, 1])
        )
        from_pulse = dd.subtract(place, dd.to_double_double(axis.from_pulse[piece]))
        distance = greatest(dd.subtract(from_pulse, dd.load_pair(axis.p[piece]))[0], 0.0)
        t = compute_time_in_piece(axis, piece, distance, max_time)
        at = axis.t[piece, 0] + t
        if not at < MAX_CLOCKS:
            return NEVER, piece
        n = greatest(int(math.ceil(at)), low)
        slope = axis.v[piece, 0] + t * (2.0 * axis.a2[piece, 0] + 3.0 * t * axis.j6[piece, 0])
        guard = 1e-6 + 1e-14 * at + 1e-14 * (distance + 1.0) / greatest(slope, 1e-12)
        if n - at > 1.0 - guard:
            while n > low and _has_reached_place(axis, piece, n - 1, place):
                n -= 1
        if n - at < guard:
            while n < edge and not _has_reached_place(axis, piece, n, place):
                n += 1
        if n < edge:
            return n, piece
        piece += 1
