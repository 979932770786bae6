"""The running segment of an interpolation of the NOVA chips: its next tick, and the profile of the main axis; compiled."""

from __future__ import annotations

import math

from stage.chips.nova.interpolation import helix as helical
from stage.chips.nova.interpolation import line as linear
from stage.chips.nova.interpolation import pattern
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion import drive, rates
from stage.chips.nova.motion.planner import (
    CURSOR_PLACE,
    append_braking,
    begin_plan,
    begin_plan_at,
    plan_braking_at,
    plan_endless_drive,
    plan_fixed_drive,
    read_pair,
    write_pair,
)
from stage.chips.nova.motion.profile import PLACE_TOLERANCE, compute_exact_place, compute_time_in_piece
from stage.chips.nova.registers.mcx514 import CONTINUOUS_SPEED, MCX514_MAP
from stage.chips.nova.state import AO, AXES, AXIS, DP, DV, LINE, MCX514_TYPE, NEVER, PATTERN, STAGES, STATE
from stage.native import exported, greatest, hot, least

ONE = (1.0, 0.0)
ROOT2 = (1.4142135623730951, -9.667293313452913e-17)
ROOT3 = (1.7320508075688772, 1.0035084221806903e-16)
MAX_SPEED = MCX514_MAP.register("DV").range[1]
MAX_CLOCKS = 1e17  # centuries
INNER_TICKS = 8  # inner ticks of a tick where short-axis pulses are equalized


@hot
def begin_segment(c):
    """Begin the segment at the head of the queue, and return whether it has a tick."""
    ip, g = c.ip, c.queue[c.ip.queue_head]
    ip.ends_interpolation = ip.zone = 0
    for k in range(AXES):
        ip.inner_positions[k] = 0
    for j in range(c.axes):
        c.ax[j].moves = 0
    if g.kind == LINE:
        return linear.begin_line(ip, g)
    if g.kind == PATTERN:
        return pattern.begin_pattern(ip, g)
    return helical.begin_helix(ip, g)


@hot
def _find_tick_length(moved):
    """Return the length of a tick that moves a number of axes, in places of the profile: 1, sqrt2 or sqrt3."""
    return ONE if moved < 2 else ROOT2 if moved == 2 else ROOT3


@hot
def _compute_length(c, k):
    """Compute the length of the k-th segment of the queue (0: the running one), in places of the profile.

    The segment must not have begun.
    """
    ip, g = c.ip, c.queue[(c.ip.queue_head + k) % (STAGES + 1)]
    if g.kind == LINE:
        one, two, three = linear.count_line_ticks(ip, g)
    elif g.kind == PATTERN:
        one, two, three = pattern.count_pattern_ticks(g)
    else:
        one, two, three = helical.count_helix_ticks(ip.scratch_arc, g)
    distance = dd.add(
        dd.from_integer(one), dd.add(dd.mul(dd.from_integer(two), ROOT2), dd.mul(dd.from_integer(three), ROOT3))
    )
    return dd.scale(distance, 1.0 / g.inner_ticks)


@exported(None, STATE)
def prepare_tick(c):
    """Prepare the steps and directions of the next tick, and its place in the profile."""
    ip, g = c.ip, c.queue[c.ip.queue_head]
    if g.kind == LINE:
        ip.is_last_tick = linear.step_line(ip, g)
    elif g.kind == PATTERN:
        ip.is_last_tick = pattern.step_pattern(ip, g)
    else:
        ip.is_last_tick = helical.step_helix(ip, g)
    moved = 0
    for k in range(least(g.vector_axes, g.axis_count)):
        moved += ip.steps[k]
    write_pair(ip.tick_place, dd.add(read_pair(ip.tick_place), dd.scale(_find_tick_length(moved), 1.0 / g.inner_ticks)))
    for k in range(g.axis_count):
        x, direction = c.ax[g.axis_numbers[k]], ip.directions[k]
        if g.inner_ticks > 1:
            before = (ip.inner_positions[k] + INNER_TICKS // 2) // INNER_TICKS
            ip.inner_positions[k] += direction * ip.steps[k]
            ip.steps[k] = (ip.inner_positions[k] + INNER_TICKS // 2) // INNER_TICKS != before
        x.moves = direction != 0
        if direction != 0 and x.direction != direction:
            x.direction = direction
            c.stale = 1


@hot
def limit_drive_speed(c, x):
    """Return DV, limited to what the interpolation mode allows."""
    ip = c.ip
    if c.variant != MCX514_TYPE:
        return x.reg[DV]
    return least(x.reg[DV], (CONTINUOUS_SPEED if ip.continuous else MAX_SPEED) // c.queue[ip.queue_head].inner_ticks)


@hot
def _plan_segment(c, x):
    """Plan the profile of the main axis, from its cursor on: to the end of the segment if the segment decelerates."""
    ip, g = c.ip, c.queue[c.ip.queue_head]
    ip.planned_speed = limit_drive_speed(c, x)
    ip.plan_decelerates = g.decelerates
    rates.load_drive_speed(c, x, ip.planned_speed)
    if not g.decelerates:
        plan_endless_drive(x, read_pair(x.dv))
        return
    goal = drive.find_goal_speed(x, dd.floor(dd.sub(read_pair(ip.segment_end), read_pair(ip.segment_start))))
    point = dd.floor(read_pair(ip.segment_start)) + x.reg[DP]
    if not x.manual_deceleration:
        plan_fixed_drive(x, dd.sub(read_pair(ip.segment_end), dd.from_integer(x.reg[AO])), goal)
    elif dd.is_less(read_pair(x.cursor[CURSOR_PLACE]), dd.from_integer(point)):
        plan_endless_drive(x, goal)
        if dd.is_less(dd.from_integer(point), read_pair(ip.segment_end)):
            plan_braking_at(x, point)
    else:
        append_braking(x)


@exported(None, STATE, AXIS)
def replan_segment(c, x):
    """Plan the profile again, after the drive speed or the segments to come have changed."""
    ip = c.ip
    if c.clock == ip.start_clock:  # nothing has moved yet
        rates.load_drive_speed(c, x, limit_drive_speed(c, x))
        begin_plan(x, c.clock, dd.ZERO, dd.ZERO, dd.minimum(read_pair(x.sv), read_pair(x.dv)), dd.ZERO)
    else:
        begin_plan_at(x, c.clock - x.origin)
    _plan_segment(c, x)
    schedule_tick(c, x)


@hot
def schedule_tick(c, x):
    """Find the clock of the prepared tick again, after a change of the plan."""
    c.ip.tick_piece = 0
    find_tick_clock(c, x)


@hot
def find_tick_clock(c, x):
    """Find the clock of the prepared tick."""
    ip = c.ip
    ip.next_tick_clock = NEVER
    if not ip.single_stepped:
        n, ip.tick_piece = find_clock_of_place(x, ip.tick_piece, read_pair(ip.tick_place))
        if n < NEVER:
            ip.next_tick_clock = x.origin + n


@hot
def is_chained_pattern(c):
    """Return whether the running segment is a set of a bit pattern of an older chip.

    There the sets are one interpolation, which decelerates at the end of the last set.
    """
    return c.variant != MCX514_TYPE and c.queue[c.ip.queue_head].kind == PATTERN


@hot
def find_segment_end(c):
    """Find the place in the profile at which the running segment ends, if it decelerates there."""
    ip = c.ip
    if c.queue[ip.queue_head].decelerates:
        distance = read_pair(ip.segment_start)
        for k in range(1 + (ip.waiting_segments if is_chained_pattern(c) else 0)):
            distance = dd.add(distance, _compute_length(c, k))
        write_pair(ip.segment_end, distance)


@hot
def update_pattern_end(c):
    """Plan again after the number of sets that follow a bit pattern has changed (MCX312, MCX314As)."""
    if c.interpolating:
        find_segment_end(c)
        c.ip.planned_speed = -1  # plan anew


@hot
def _has_reached(x, s, n, place):
    """Return whether the profile has reached a place.

    Args:
        x: State of the axis.
        s: Number of the piece.
        n: Clocks after the origin.
        place: Pulses, a double-double.
    """
    if x.a2[s, 0] == 0.0 and x.j6[s, 0] == 0.0:  # the same, sooner
        reached = dd.add(read_pair(x.p[s]), dd.mul(dd.sub(dd.from_integer(n), read_pair(x.t[s])), read_pair(x.v[s])))
    else:
        reached = compute_exact_place(x, s, n)
    return not dd.is_less(dd.add(dd.add(dd.from_integer(x.from_pulse[s]), reached), (PLACE_TOLERANCE, 0.0)), place)


@hot
def find_clock_of_place(x, s, place):
    """Find the first clock after the origin at which the profile has reached a place, which may be a fraction of a pulse.

    Double-doubles decide if the time is next to a whole clock.

    Args:
        x: State of the axis.
        s: Number of the first piece of the profile to search.
        place: Pulses, a double-double.

    Returns:
        The clock, NEVER if it is centuries ahead; and the number of the piece.
    """
    while True:
        low = x.from_clock[s]
        last = s + 1 == x.pieces
        edge = NEVER if last else x.from_clock[s + 1]
        max_time = MAX_CLOCKS if last else (x.t[s + 1, 0] - x.t[s, 0]) + (x.t[s + 1, 1] - x.t[s, 1])
        distance = greatest(dd.sub(dd.sub(place, dd.from_integer(x.from_pulse[s])), read_pair(x.p[s]))[0], 0.0)
        t = compute_time_in_piece(x, s, distance, max_time)
        at = x.t[s, 0] + t
        if not at < MAX_CLOCKS:
            return NEVER, s
        n = greatest(int(math.ceil(at)), low)
        slope = x.v[s, 0] + t * (2.0 * x.a2[s, 0] + 3.0 * t * x.j6[s, 0])
        guard = 1e-6 + 1e-14 * at + 1e-14 * (distance + 1.0) / greatest(slope, 1e-12)
        if n - at > 1.0 - guard:
            while n > low and _has_reached(x, s, n - 1, place):
                n -= 1
        if n - at < guard:
            while n < edge and not _has_reached(x, s, n, place):
                n += 1
        if n < edge:
            return n, s
        s += 1
