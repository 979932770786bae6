"""Planner of the speed profile of a NOVA drive, from any speed and acceleration on; compiled.

A change of speed is limited in jerk: the acceleration rises at the jerk, stays at its limit if it reaches it, and returns to 0
when the goal speed is reached. An acceleration that would overshoot the goal returns to 0 first. In linear ramps the
acceleration jumps. A drive of a fixed number of pulses brakes as late as possible: at its last pulse the speed is the initial
speed and the acceleration 0.

    linear                    S-curve                    a drive too short, AVTRI on
        ______ DV                 ______ DV                   ____  no DV: a quarter of the pulses up,
       /      \\                 (      )                    /    \\ a quarter down, the rest even
    SV/        \\SV           SV_/      \\_SV             SV/      \\SV
"""

from __future__ import annotations

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile_evaluation import NEVER, compute_exact_place, compute_time_in_piece, find_piece
from stage.chips.nova.state import ACCELERATING, AREA_D, CONSTANT, DECELERATING, MAX_PIECES, RUNAWAY
from stage.native import hot

CURSOR_TIME, CURSOR_PLACE, CURSOR_SPEED, CURSOR_ACCELERATION = range(4)  # rows of the cursor
DURATION, START_ACCELERATION, JERK = range(3)  # columns of a piece
RELATIVE_SPEED_TOLERANCE = 1e-25  # of a speed: what rounding leaves


# --- pieces of a change of speed ---


@hot
def _draft_piece(axis, piece_index, duration, rate, jerk):
    """Store a piece of a drafted profile, unless its duration is not positive; return the index of the next piece."""
    dd.store_pair(axis.drafted_pieces[piece_index, DURATION], duration)
    dd.store_pair(axis.drafted_pieces[piece_index, START_ACCELERATION], rate)
    dd.store_pair(axis.drafted_pieces[piece_index, JERK], jerk)
    return piece_index + 1 if duration[0] > 0.0 else piece_index


@hot
def _read_draft_piece(pieces, piece_index):
    """Return the duration, the acceleration at the start and the jerk of piece `piece_index` of a drafted profile."""
    return (
        dd.load_pair(pieces[piece_index, DURATION]),
        dd.load_pair(pieces[piece_index, START_ACCELERATION]),
        dd.load_pair(pieces[piece_index, JERK]),
    )


@hot
def _negate_if(acceleration, negative):
    """Return the acceleration negated if `negative`, else unchanged."""
    return dd.negate(acceleration) if negative else acceleration


@hot
def draft_speed_change(axis, speed, acceleration, goal_speed):
    """Draft the pieces of the change from one speed of a drive to another.

    Args:
        axis: State of the axis.
        speed: Speed at the start, pulses per clock.
        acceleration: Acceleration at the start.
        goal_speed: Speed at the end.

    Returns:
        The number of pieces in the draft.
    """
    zero = dd.ZERO
    if not axis.curved:
        if dd.is_less(speed, goal_speed):
            rate = dd.load_pair(axis.acceleration)
            return _draft_piece(axis, 0, dd.divide(dd.subtract(goal_speed, speed), rate), rate, zero)
        rate = dd.load_pair(axis.deceleration)
        return _draft_piece(axis, 0, dd.divide(dd.subtract(speed, goal_speed), rate), dd.negate(rate), zero)
    k = 0
    falls = acceleration[0] < 0.0
    if acceleration[0] != 0.0:
        jerk = dd.load_pair(axis.deceleration_jerk) if falls else dd.load_pair(axis.acceleration_jerk)
        left = dd.scale(dd.divide(dd.multiply(acceleration, acceleration), jerk), 0.5)
        settled = dd.subtract(speed, left) if falls else dd.add(speed, left)
        if not dd.is_less(goal_speed, settled) if falls else not dd.is_less(settled, goal_speed):
            k = _draft_piece(
                axis, 0, dd.divide(_negate_if(acceleration, falls), jerk), acceleration, _negate_if(jerk, not falls)
            )
            speed, acceleration = settled, zero
    falls = dd.is_less(goal_speed, speed) if acceleration[0] == 0.0 else falls
    gap = _negate_if(dd.subtract(goal_speed, speed), falls)
    if acceleration[0] == 0.0 and gap[0] <= RELATIVE_SPEED_TOLERANCE * goal_speed[0]:
        return k
    jerk, maximum = (
        (dd.load_pair(axis.deceleration_jerk), dd.load_pair(axis.deceleration))
        if falls
        else (dd.load_pair(axis.acceleration_jerk), dd.load_pair(axis.acceleration))
    )
    size = _negate_if(acceleration, falls)
    squares = dd.scale(dd.multiply(size, size), 0.5)
    top = dd.square_root(dd.add(dd.multiply(jerk, gap), squares))
    hold = zero
    if dd.is_less(maximum, top):
        top = maximum
        at_maximum = dd.subtract(gap, dd.divide(dd.subtract(dd.multiply(maximum, maximum), squares), jerk))
        hold = dd.divide(at_maximum, maximum)
    k = _draft_piece(axis, k, dd.divide(dd.subtract(top, size), jerk), acceleration, _negate_if(jerk, falls))
    k = _draft_piece(axis, k, hold, _negate_if(top, falls), zero)
    return _draft_piece(axis, k, dd.divide(top, jerk), _negate_if(top, falls), _negate_if(jerk, not falls))


@hot
def _integrate_piece(duration, speed, acceleration, jerk):
    """Return the distance of a piece of the speed profile, and the speed at its end.

    The distance is duration (v + duration (a / 2 + duration jerk / 6)), the speed v + duration (a + duration jerk / 2).

    Args:
        duration: Clocks.
        speed: Speed at the start, pulses per clock.
        acceleration: Acceleration at the start.
        jerk: Jerk.
    """
    half = dd.scale(dd.multiply(duration, jerk), 0.5)
    third = dd.divide(half, (3.0, 0.0))
    distance = dd.multiply(duration, dd.add(speed, dd.multiply(duration, dd.add(dd.scale(acceleration, 0.5), third))))
    return distance, dd.add(speed, dd.multiply(duration, dd.add(acceleration, half)))


@hot
def draft_braking(axis, speed, acceleration):
    """Draft the deceleration to the initial speed. At or below that speed only the acceleration returns to 0.

    Args:
        axis: State of the axis.
        speed: Speed at the start, pulses per clock.
        acceleration: Acceleration at the start.

    Returns:
        The number of pieces in the draft.
    """
    if not axis.curved or acceleration[0] == 0.0:
        return (
            draft_speed_change(axis, speed, acceleration, dd.load_pair(axis.sv))
            if dd.is_less(dd.load_pair(axis.sv), speed)
            else 0
        )
    falls = acceleration[0] < 0.0
    jerk = dd.load_pair(axis.deceleration_jerk) if falls else dd.load_pair(axis.acceleration_jerk)
    left = dd.scale(dd.divide(dd.multiply(acceleration, acceleration), jerk), 0.5)
    settled = dd.subtract(speed, left) if falls else dd.add(speed, left)
    if dd.is_less(dd.load_pair(axis.sv), settled):
        return draft_speed_change(axis, speed, acceleration, dd.load_pair(axis.sv))
    return _draft_piece(
        axis, 0, dd.divide(_negate_if(acceleration, falls), jerk), acceleration, _negate_if(jerk, not falls)
    )


@hot
def compute_braking_distance(axis, speed, acceleration):
    """Compute the distance that the deceleration to the initial speed takes.

    Args:
        axis: State of the axis.
        speed: Speed at the start, pulses per clock.
        acceleration: Acceleration at the start.

    Returns:
        Pulses, a double-double.
    """
    total = dd.ZERO
    for k in range(draft_braking(axis, speed, acceleration)):
        duration, acceleration, jerk = _read_draft_piece(axis.drafted_pieces, k)
        distance, speed = _integrate_piece(duration, speed, acceleration, jerk)
        total = dd.add(total, distance)
    return total


# --- writing pieces ---


@hot
def begin_plan(axis, clock, clocks_after_origin, place, speed, acceleration):
    """Begin an empty plan of the drive's speed profile.

    Args:
        axis: State of the axis.
        clock: Origin of the plan, in reference clocks since power-up.
        clocks_after_origin: Clocks after the origin at which the first piece begins.
        place: Pulses of the drive at that time.
        speed: Speed at that time, pulses per clock.
        acceleration: Acceleration at that time.
    """
    axis.origin, axis.pieces, axis.end_time, axis.brake_piece = clock, 0, NEVER, MAX_PIECES
    dd.store_pair(axis.cursor[CURSOR_TIME], clocks_after_origin)
    dd.store_pair(axis.cursor[CURSOR_PLACE], place)
    dd.store_pair(axis.cursor[CURSOR_SPEED], speed)
    dd.store_pair(axis.cursor[CURSOR_ACCELERATION], acceleration)


@hot
def _append_open_piece(axis, phase, acceleration, jerk):
    """Append a piece without an end to the plan of the speed profile, from the plan's cursor on.

    Args:
        axis: State of the axis.
        phase: Phase of the profile.
        acceleration: Acceleration at its start.
        jerk: Jerk.
    """
    s = axis.pieces
    t = dd.load_pair(axis.cursor[CURSOR_TIME])
    place = dd.load_pair(axis.cursor[CURSOR_PLACE])
    v = dd.load_pair(axis.cursor[CURSOR_SPEED])
    dd.store_pair(axis.t[s], t)
    axis.from_clock[s] = -dd.floor(dd.add(dd.negate(t), (1e-15, 0.0)))
    axis.from_pulse[s] = dd.floor(place)
    dd.store_pair(axis.p[s], dd.subtract(place, dd.to_double_double(axis.from_pulse[s])))
    dd.store_pair(axis.v[s], v)
    dd.store_pair(axis.a2[s], dd.scale(acceleration, 0.5))
    dd.store_pair(axis.j6[s], dd.divide(jerk, (6.0, 0.0)))
    axis.piece_phase[s] = phase
    axis.pieces = s + 1


@hot
def _append_piece(axis, phase, duration, acceleration, jerk):
    """Append a piece to the plan of the speed profile, and move the plan's cursor to its end.

    Args:
        axis: State of the axis.
        phase: Phase of the profile.
        duration: Clocks.
        acceleration: Acceleration at its start.
        jerk: Jerk.
    """
    if duration[0] <= 0.0:
        return
    _append_open_piece(axis, phase, acceleration, jerk)
    distance, v = _integrate_piece(duration, dd.load_pair(axis.cursor[CURSOR_SPEED]), acceleration, jerk)
    dd.store_pair(axis.cursor[CURSOR_TIME], dd.add(dd.load_pair(axis.cursor[CURSOR_TIME]), duration))
    dd.store_pair(axis.cursor[CURSOR_PLACE], dd.add(dd.load_pair(axis.cursor[CURSOR_PLACE]), distance))
    dd.store_pair(axis.cursor[CURSOR_SPEED], v)
    dd.store_pair(axis.cursor[CURSOR_ACCELERATION], dd.add(acceleration, dd.multiply(jerk, duration)))


@hot
def _find_piece_phase(acceleration, jerk):
    """Return the phase of a piece: ACCELERATING or DECELERATING."""
    return ACCELERATING if acceleration[0] > 0.0 or (acceleration[0] == 0.0 and jerk[0] > 0.0) else DECELERATING


@hot
def append_speed_change(axis, goal_speed):
    """Append the change from the speed at the plan's cursor to another speed."""
    speed, acceleration = dd.load_pair(axis.cursor[CURSOR_SPEED]), dd.load_pair(axis.cursor[CURSOR_ACCELERATION])
    for k in range(draft_speed_change(axis, speed, acceleration, goal_speed)):
        duration, a, jerk = _read_draft_piece(axis.drafted_pieces, k)
        _append_piece(axis, _find_piece_phase(a, jerk), duration, a, jerk)
    dd.store_pair(axis.cursor[CURSOR_SPEED], goal_speed)
    dd.store_pair(axis.cursor[CURSOR_ACCELERATION], dd.ZERO)


@hot
def append_braking(axis):
    """Append the automatic deceleration to the plan, and then the initial speed without an end.

    On chips with the S-curve failure the end of the deceleration is a piece of its own, area d of NOVA's notice.
    """
    axis.brake_piece = axis.pieces
    n = draft_braking(axis, dd.load_pair(axis.cursor[CURSOR_SPEED]), dd.load_pair(axis.cursor[CURSOR_ACCELERATION]))
    for k in range(n):
        duration, a, jerk = _read_draft_piece(axis.drafted_pieces, k)
        dull = dd.load_pair(axis.min_visible_acceleration)
        if dull[0] > 0.0 and a[0] < 0.0 and jerk[0] > 0.0:
            calm = dd.minimum(dd.divide(dull, jerk), duration)
            before = dd.subtract(duration, calm)
            _append_piece(axis, DECELERATING, before, a, jerk)
            _append_piece(axis, AREA_D, calm, dd.add(a, dd.multiply(jerk, before)), jerk)
        else:
            _append_piece(axis, _find_piece_phase(a, jerk), duration, a, jerk)
    if n and dd.is_less(dd.load_pair(axis.sv), dd.load_pair(axis.cursor[CURSOR_SPEED])):  # but for rounding it is there
        dd.store_pair(axis.cursor[CURSOR_SPEED], dd.load_pair(axis.sv))
    dd.store_pair(axis.cursor[CURSOR_ACCELERATION], dd.ZERO)
    _append_constant_speed(axis)


@hot
def _append_constant_speed(axis):
    """Append a piece in which the drive keeps its speed, without an end."""
    _append_open_piece(axis, CONSTANT, dd.ZERO, dd.ZERO)


# --- whole plans; all begin at the cursor ---


@hot
def plan_stop(axis):
    """Plan a decelerating stop of the drive: to the initial speed, at which the drive ends."""
    if (
        dd.is_less(dd.load_pair(axis.sv), dd.load_pair(axis.cursor[CURSOR_SPEED]))
        or axis.cursor[CURSOR_ACCELERATION, 0] > 0.0
    ):
        append_speed_change(axis, dd.load_pair(axis.sv))
    _append_constant_speed(axis)
    axis.end_time = axis.from_clock[axis.pieces - 1]


@hot
def plan_runaway(axis):
    """Plan the runaway of the S-curve erratum: the drive keeps its present speed and never ends."""
    _append_open_piece(axis, RUNAWAY, dd.ZERO, dd.ZERO)


@hot
def compute_triangle_speed(axis, pulses):
    """Compute the speed that triangle prevention allows: that at which accelerating and decelerating take half of the pulses.

    Args:
        axis: State of the axis.
        pulses: Number of pulses of the drive.
    """
    up = dd.load_pair(axis.acceleration)
    down = dd.load_pair(axis.deceleration)
    low = dd.load_pair(axis.sv)
    square = dd.multiply(dd.to_double_double(pulses), dd.divide(dd.multiply(up, down), dd.add(up, down)))
    return dd.square_root(dd.add(dd.multiply(low, low), square))


@hot
def _compute_overshoot(axis, clocks, start_speed, acceleration, jerk, remaining_pulses):
    """Compute the distance by which a drive would pass its end if it began to brake at a time in a piece.

    Args:
        axis: State of the axis.
        clocks: Clocks from the start of the piece to the begin of braking, a double-double.
        start_speed: Speed at the start of the piece, pulses per clock.
        acceleration: Acceleration at the start of the piece.
        jerk: Jerk of the piece.
        remaining_pulses: Pulses from the start of the piece to the end of the drive.
    """
    distance, speed = _integrate_piece(clocks, start_speed, acceleration, jerk)
    braking = compute_braking_distance(axis, speed, dd.add(acceleration, dd.multiply(jerk, clocks)))
    return dd.subtract(dd.add(distance, braking), remaining_pulses)


@hot
def _find_brake_time(axis, max_time, speed, acceleration, jerk, remaining_pulses):
    """Find the time in a piece at which the drive must begin to brake so that it ends after `remaining_pulses` pulses.

    Args:
        axis: State of the axis.
        max_time: Duration of the piece.
        speed: Speed at the start of the piece.
        acceleration: Acceleration at the start of the piece.
        jerk: Jerk of the piece.
        remaining_pulses: Pulses from the start of the piece to the end of the drive.
    """
    low, high = dd.ZERO, max_time
    under = _compute_overshoot(axis, low, speed, acceleration, jerk, remaining_pulses)
    over = _compute_overshoot(axis, high, speed, acceleration, jerk, remaining_pulses)
    side = 0
    for _ in range(200):
        width = dd.subtract(high, low)
        if width[0] <= 1e-31 * high[0] or over[0] == under[0]:
            break
        middle = dd.subtract(high, dd.divide(dd.multiply(over, width), dd.subtract(over, under)))
        off = _compute_overshoot(axis, middle, speed, acceleration, jerk, remaining_pulses)
        if abs(off[0]) <= 1e-28:
            return middle
        if off[0] > 0.0:
            high, over = middle, off
            under = dd.scale(under, 0.5) if side > 0 else under
            side = 1
        else:
            low, under = middle, off
            over = dd.scale(over, 0.5) if side < 0 else over
            side = -1
    return low


@hot
def plan_fixed_drive(axis, pulses, drive_speed):
    """Plan a drive that ends after a number of pulses.

    Args:
        axis: State of the axis.
        pulses: Pulses of the drive from its start, a double-double.
        drive_speed: Drive speed.
    """
    v, a = dd.load_pair(axis.cursor[CURSOR_SPEED]), dd.load_pair(axis.cursor[CURSOR_ACCELERATION])
    room = dd.subtract(pulses, dd.load_pair(axis.cursor[CURSOR_PLACE]))
    if not dd.is_less(compute_braking_distance(axis, v, a), room):
        append_braking(axis)
        return
    n = draft_speed_change(axis, v, a, drive_speed)
    for k in range(n):
        for part in range(3):
            dd.store_pair(axis.stored_draft[k, part], dd.load_pair(axis.drafted_pieces[k, part]))
    for k in range(n):
        duration, a, jerk = _read_draft_piece(axis.stored_draft, k)
        if _compute_overshoot(axis, duration, v, a, jerk, room)[0] > 0.0:
            _append_piece(axis, _find_piece_phase(a, jerk), _find_brake_time(axis, duration, v, a, jerk, room), a, jerk)
            append_braking(axis)
            return
        distance, v = _integrate_piece(duration, v, a, jerk)
        room = dd.subtract(room, distance)
        _append_piece(axis, _find_piece_phase(a, jerk), duration, a, jerk)
    dd.store_pair(axis.cursor[CURSOR_SPEED], drive_speed)
    dd.store_pair(axis.cursor[CURSOR_ACCELERATION], dd.ZERO)
    left = dd.subtract(room, compute_braking_distance(axis, drive_speed, dd.ZERO))
    _append_piece(axis, CONSTANT, dd.divide(left, drive_speed), dd.ZERO, dd.ZERO)
    append_braking(axis)


@hot
def plan_endless_drive(axis, drive_speed):
    """Plan a drive without an end, at the speed `drive_speed`."""
    append_speed_change(axis, drive_speed)
    _append_constant_speed(axis)


@hot
def _compute_speed_and_acceleration(axis, piece, t):
    """Compute speed and acceleration of a piece of the plan, `t` clocks (a double-double) after its start."""
    v, a2, j6 = dd.load_pair(axis.v[piece]), dd.load_pair(axis.a2[piece]), dd.load_pair(axis.j6[piece])
    speed = dd.add(v, dd.multiply(t, dd.add(dd.scale(a2, 2.0), dd.multiply(t, dd.multiply(j6, (3.0, 0.0))))))
    return speed, dd.add(dd.scale(a2, 2.0), dd.multiply(t, dd.multiply(j6, (6.0, 0.0))))


@hot
def plan_braking_at(axis, pulses):
    """Cut the plan after a number of pulses of the drive, and brake to the initial speed from there (manual deceleration)."""
    s = axis.pieces - 1
    while s > 0 and axis.from_pulse[s] + (1 if axis.p[s, 0] > 0.0 else 0) > pulses:
        s -= 1
    distance = dd.subtract(dd.to_double_double(pulses - axis.from_pulse[s]), dd.load_pair(axis.p[s]))
    v, a2, j6 = dd.load_pair(axis.v[s]), dd.load_pair(axis.a2[s]), dd.load_pair(axis.j6[s])
    t = (compute_time_in_piece(axis, s, distance[0], 1e17), 0.0)
    for _ in range(3):
        off = dd.subtract(dd.multiply(t, dd.add(v, dd.multiply(t, dd.add(a2, dd.multiply(t, j6))))), distance)
        slope = v[0] + t[0] * (2.0 * a2[0] + 3.0 * t[0] * j6[0])
        if slope > 0.0:
            t = dd.subtract(t, dd.divide(off, (slope, 0.0)))
    speed, a = _compute_speed_and_acceleration(axis, s, t)
    axis.pieces = s + 1 if t[0] > 0.0 else s
    dd.store_pair(axis.cursor[CURSOR_TIME], dd.add(dd.load_pair(axis.t[s]), t))
    dd.store_pair(axis.cursor[CURSOR_PLACE], dd.to_double_double(pulses))
    dd.store_pair(axis.cursor[CURSOR_SPEED], speed)
    dd.store_pair(axis.cursor[CURSOR_ACCELERATION], a if axis.curved else dd.ZERO)
    append_braking(axis)


@hot
def begin_plan_at(axis, clocks):
    """Begin a new plan `clocks` clocks after the origin, with the drive's place, speed and acceleration at that time."""
    s = find_piece(axis, clocks)
    t = dd.subtract(dd.to_double_double(clocks), dd.load_pair(axis.t[s]))
    place = dd.add(dd.to_double_double(axis.from_pulse[s]), compute_exact_place(axis, s, clocks))
    v, a = _compute_speed_and_acceleration(axis, s, t)
    begin_plan(axis, axis.origin + clocks, dd.ZERO, place, v, a if axis.curved else dd.ZERO)
