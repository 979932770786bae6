"""NOVA chips, compiled: planning the speed profile of a drive, from any speed and acceleration on.

A change of speed is jerk-limited: the acceleration goes at the jerk to the side of the goal, is held at its limit if it gets
there, and returns to 0 just when the speed is reached; one that would overshoot is brought to 0 first. Linear ramps jump.
A drive of so many pulses brakes as late as it can, so that its speed is the initial speed, and its acceleration 0, exactly at
the last of them.

    linear                    S-curve                    a drive too short, AVTRI on
        ______ DV                 ______ DV                   ____  no DV: a quarter of the pulses up,
       /      \\                 (      )                    /    \\ a quarter down, the rest even
    SV/        \\SV           SV_/      \\_SV             SV/      \\SV
"""

from __future__ import annotations

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile import NEVER, exactly, piece_at, time_in
from stage.chips.nova.state import ACCELERATING, AREA_D, CONSTANT, DECELERATING, MAX_PIECES, RUNAWAY
from stage.native import hot

T, PLACE, SPEED, RATE = range(4)  # rows of the cursor
DURATION, FROM, JERK = range(3)  # columns of a piece
DUST = 1e-25  # of a speed: what rounding leaves


@hot
def pair(row):
    """A double-double out of a record."""
    return row[0], row[1]


@hot
def put(row, x):
    row[0], row[1] = x


# --- pieces of a change of speed ---


@hot
def _piece(x, k, duration, rate, jerk):
    put(x.piece[k, DURATION], duration)
    put(x.piece[k, FROM], rate)
    put(x.piece[k, JERK], jerk)
    return k + 1 if duration[0] > 0.0 else k


@hot
def _signed(a, negative):
    return dd.neg(a) if negative else a


@hot
def draft(x, v, a, goal):
    """Draft the change to another speed.

    Args:
        x: State of the axis.
        v: Speed, pulses per clock.
        a: Acceleration.
        goal: Speed at the end.

    Returns:
        The number of pieces.
    """
    zero = dd.ZERO
    if not x.curved:
        if dd.less(v, goal):
            return _piece(x, 0, dd.div(dd.sub(goal, v), pair(x.up)), pair(x.up), zero)
        return _piece(x, 0, dd.div(dd.sub(v, goal), pair(x.down)), dd.neg(pair(x.down)), zero)
    k = 0
    falls = a[0] < 0.0
    if a[0] != 0.0:
        jerk = pair(x.down_jerk) if falls else pair(x.up_jerk)
        left = dd.times(dd.div(dd.mul(a, a), jerk), 0.5)
        settled = dd.sub(v, left) if falls else dd.add(v, left)
        if not dd.less(goal, settled) if falls else not dd.less(settled, goal):
            k = _piece(x, 0, dd.div(_signed(a, falls), jerk), a, _signed(jerk, not falls))
            v, a = settled, zero
    falls = dd.less(goal, v) if a[0] == 0.0 else falls
    gap = _signed(dd.sub(goal, v), falls)
    if a[0] == 0.0 and gap[0] <= DUST * goal[0]:
        return k
    jerk, maximum = (pair(x.down_jerk), pair(x.down)) if falls else (pair(x.up_jerk), pair(x.up))
    size = _signed(a, falls)
    squares = dd.times(dd.mul(size, size), 0.5)
    top = dd.root(dd.add(dd.mul(jerk, gap), squares))
    hold = zero
    if dd.less(maximum, top):
        top = maximum
        at_maximum = dd.sub(gap, dd.div(dd.sub(dd.mul(maximum, maximum), squares), jerk))
        hold = dd.div(at_maximum, maximum)
    k = _piece(x, k, dd.div(dd.sub(top, size), jerk), a, _signed(jerk, falls))
    k = _piece(x, k, hold, _signed(top, falls), zero)
    return _piece(x, k, dd.div(top, jerk), _signed(top, falls), _signed(jerk, not falls))


@hot
def _after(duration, v, a, jerk):
    """Return the distance and the speed of a piece.

    They are duration (v + duration (a / 2 + duration jerk / 6)) and v + duration (a + duration jerk / 2).
    """
    half = dd.times(dd.mul(duration, jerk), 0.5)
    third = dd.div(half, (3.0, 0.0))
    distance = dd.mul(duration, dd.add(v, dd.mul(duration, dd.add(dd.times(a, 0.5), third))))
    return distance, dd.add(v, dd.mul(duration, dd.add(a, half)))


@hot
def draft_brake(x, v, a):
    """Draft the deceleration to the initial speed. At or below it only an acceleration that there is goes to 0.

    Args:
        x: State of the axis.
        v: Speed, pulses per clock.
        a: Acceleration.

    Returns:
        The number of pieces.
    """
    if not x.curved:
        return draft(x, v, a, pair(x.sv)) if dd.less(pair(x.sv), v) else 0
    if a[0] == 0.0:
        return draft(x, v, a, pair(x.sv)) if dd.less(pair(x.sv), v) else 0
    falls = a[0] < 0.0
    jerk = pair(x.down_jerk) if falls else pair(x.up_jerk)
    left = dd.times(dd.div(dd.mul(a, a), jerk), 0.5)
    settled = dd.sub(v, left) if falls else dd.add(v, left)
    if dd.less(pair(x.sv), settled):
        return draft(x, v, a, pair(x.sv))
    return _piece(x, 0, dd.div(_signed(a, falls), jerk), a, _signed(jerk, not falls))


@hot
def braking_distance(x, v, a):
    """Compute the pulses that the deceleration to the initial speed takes.

    Args:
        x: State of the axis.
        v: Speed, pulses per clock.
        a: Acceleration.

    Returns:
        Pulses, a double-double.
    """
    total = dd.ZERO
    for k in range(draft_brake(x, v, a)):
        distance, v = _after(pair(x.piece[k, DURATION]), v, pair(x.piece[k, FROM]), pair(x.piece[k, JERK]))
        total = dd.add(total, distance)
    return total


# --- writing pieces ---


@hot
def begin(x, clock, t, place, v, a):
    """Begin an empty plan.

    Args:
        x: State of the axis.
        clock: Its origin.
        t: Clocks after the origin at which its first piece begins.
        place: Pulses there.
        v: Speed there, pulses per clock.
        a: Acceleration there.
    """
    x.origin, x.pieces, x.end, x.brake = clock, 0, NEVER, MAX_PIECES
    put(x.cursor[T], t)
    put(x.cursor[PLACE], place)
    put(x.cursor[SPEED], v)
    put(x.cursor[RATE], a)


@hot
def _write(x, kind, a, jerk):
    """A piece from the cursor on, without an end."""
    s = x.pieces
    t, place, v = pair(x.cursor[T]), pair(x.cursor[PLACE]), pair(x.cursor[SPEED])
    put(x.t[s], t)
    x.from_clock[s] = -dd.floor(dd.add(dd.neg(t), (1e-15, 0.0)))
    x.from_pulse[s] = dd.floor(place)
    put(x.p[s], dd.sub(place, dd.from_integer(x.from_pulse[s])))
    put(x.v[s], v)
    put(x.a2[s], dd.times(a, 0.5))
    put(x.j6[s], dd.div(jerk, (6.0, 0.0)))
    x.kind[s] = kind
    x.pieces = s + 1


@hot
def _go(x, kind, duration, a, jerk):
    """A piece of this duration; the cursor moves to its end."""
    if duration[0] <= 0.0:
        return
    _write(x, kind, a, jerk)
    distance, v = _after(duration, pair(x.cursor[SPEED]), a, jerk)
    put(x.cursor[T], dd.add(pair(x.cursor[T]), duration))
    put(x.cursor[PLACE], dd.add(pair(x.cursor[PLACE]), distance))
    put(x.cursor[SPEED], v)
    put(x.cursor[RATE], dd.add(a, dd.mul(jerk, duration)))


@hot
def _kind(a, jerk):
    return ACCELERATING if a[0] > 0.0 or (a[0] == 0.0 and jerk[0] > 0.0) else DECELERATING


@hot
def change(x, goal):
    """Append the change from the cursor's speed to `goal`."""
    for k in range(draft(x, pair(x.cursor[SPEED]), pair(x.cursor[RATE]), goal)):
        duration, a, jerk = pair(x.piece[k, DURATION]), pair(x.piece[k, FROM]), pair(x.piece[k, JERK])
        _go(x, _kind(a, jerk), duration, a, jerk)
    put(x.cursor[SPEED], goal)
    put(x.cursor[RATE], dd.ZERO)


@hot
def brake(x):
    """Append the automatic deceleration, and the initial speed for ever; it may have an area d."""
    x.brake = x.pieces
    n = draft_brake(x, pair(x.cursor[SPEED]), pair(x.cursor[RATE]))
    for k in range(n):
        duration, a, jerk = pair(x.piece[k, DURATION]), pair(x.piece[k, FROM]), pair(x.piece[k, JERK])
        dull = pair(x.finest)
        if dull[0] > 0.0 and a[0] < 0.0 and jerk[0] > 0.0:
            calm = dd.least(dd.div(dull, jerk), duration)
            before = dd.sub(duration, calm)
            _go(x, DECELERATING, before, a, jerk)
            _go(x, AREA_D, calm, dd.add(a, dd.mul(jerk, before)), jerk)
        else:
            _go(x, _kind(a, jerk), duration, a, jerk)
    if n and dd.less(pair(x.sv), pair(x.cursor[SPEED])):  # but for rounding it is there
        put(x.cursor[SPEED], pair(x.sv))
    put(x.cursor[RATE], dd.ZERO)
    _on(x)


@hot
def _on(x):
    """Go on at constant speed."""
    _write(x, CONSTANT, dd.ZERO, dd.ZERO)


# --- whole plans; all begin at the cursor ---


@hot
def slow_down(x):
    """A decelerating stop: to the initial speed, where the drive ends."""
    if dd.less(pair(x.sv), pair(x.cursor[SPEED])) or x.cursor[RATE, 0] > 0.0:
        change(x, pair(x.sv))
    _on(x)
    x.end = x.from_clock[x.pieces - 1]


@hot
def run_away(x):
    """The erratum: at this speed for ever."""
    _write(x, RUNAWAY, dd.ZERO, dd.ZERO)


@hot
def cap(x, pulses):
    """Triangle prevention: the speed at which accelerating and decelerating have taken half of the pulses of the drive."""
    up, down, low = pair(x.up), pair(x.down), pair(x.sv)
    square = dd.mul(dd.from_integer(pulses), dd.div(dd.mul(up, down), dd.add(up, down)))
    return dd.root(dd.add(dd.mul(low, low), square))


@hot
def _overshoot(x, t, v, a, jerk, room):
    """Pulses by which the drive would pass its end if it braked t clocks into this piece."""
    distance, speed = _after(t, v, a, jerk)
    return dd.sub(dd.add(distance, braking_distance(x, speed, dd.add(a, dd.mul(jerk, t)))), room)


@hot
def _brake_time(x, max_time, v, a, jerk, room):
    """Find the time in a piece at which to begin to brake, so that `room` pulses are needed from there."""
    low, high = dd.ZERO, max_time
    under, over = _overshoot(x, low, v, a, jerk, room), _overshoot(x, high, v, a, jerk, room)
    side = 0
    for _ in range(200):
        width = dd.sub(high, low)
        if width[0] <= 1e-31 * high[0] or over[0] == under[0]:
            break
        middle = dd.sub(high, dd.div(dd.mul(over, width), dd.sub(over, under)))
        off = _overshoot(x, middle, v, a, jerk, room)
        if abs(off[0]) <= 1e-28:
            return middle
        if off[0] > 0.0:
            high, over = middle, off
            under = dd.times(under, 0.5) if side > 0 else under
            side = 1
        else:
            low, under = middle, off
            over = dd.times(over, 0.5) if side < 0 else over
            side = -1
    return low


@hot
def to_the_end(x, pulses, goal):
    """Plan a drive that ends after a number of pulses.

    Args:
        x: State of the axis.
        pulses: Pulses of the drive from its start, a double-double.
        goal: Drive speed.
    """
    v, a = pair(x.cursor[SPEED]), pair(x.cursor[RATE])
    room = dd.sub(pulses, pair(x.cursor[PLACE]))
    if not dd.less(braking_distance(x, v, a), room):
        brake(x)
        return
    n = draft(x, v, a, goal)
    for k in range(n):
        for part in range(3):
            put(x.course[k, part], pair(x.piece[k, part]))
    for k in range(n):
        duration, a, jerk = pair(x.course[k, DURATION]), pair(x.course[k, FROM]), pair(x.course[k, JERK])
        if _overshoot(x, duration, v, a, jerk, room)[0] > 0.0:
            _go(x, _kind(a, jerk), _brake_time(x, duration, v, a, jerk, room), a, jerk)
            brake(x)
            return
        distance, v = _after(duration, v, a, jerk)
        room = dd.sub(room, distance)
        _go(x, _kind(a, jerk), duration, a, jerk)
    put(x.cursor[SPEED], goal)
    put(x.cursor[RATE], dd.ZERO)
    _go(x, CONSTANT, dd.div(dd.sub(room, braking_distance(x, goal, dd.ZERO)), goal), dd.ZERO, dd.ZERO)
    brake(x)


@hot
def for_ever(x, goal):
    """A drive without an end: to the speed `goal`."""
    change(x, goal)
    _on(x)


@hot
def brake_at(x, pulses):
    """Cut the plan where `pulses` of the drive are done, and brake to the initial speed from there (manual deceleration)."""
    s = x.pieces - 1
    while s > 0 and x.from_pulse[s] + (1 if x.p[s, 0] > 0.0 else 0) > pulses:
        s -= 1
    distance = dd.sub(dd.from_integer(pulses - x.from_pulse[s]), pair(x.p[s]))
    v, a2, j6 = pair(x.v[s]), pair(x.a2[s]), pair(x.j6[s])
    t = (time_in(x, s, distance[0], 1e17), 0.0)
    for _ in range(3):
        off = dd.sub(dd.mul(t, dd.add(v, dd.mul(t, dd.add(a2, dd.mul(t, j6))))), distance)
        slope = v[0] + t[0] * (2.0 * a2[0] + 3.0 * t[0] * j6[0])
        if slope > 0.0:
            t = dd.sub(t, dd.div(off, (slope, 0.0)))
    a = dd.add(dd.times(a2, 2.0), dd.mul(t, dd.mul(j6, (6.0, 0.0))))
    speed = dd.add(v, dd.mul(t, dd.add(dd.times(a2, 2.0), dd.mul(t, dd.mul(j6, (3.0, 0.0))))))
    x.pieces = s + 1 if t[0] > 0.0 else s
    put(x.cursor[T], dd.add(pair(x.t[s]), t))
    put(x.cursor[PLACE], dd.from_integer(pulses))
    put(x.cursor[SPEED], speed)
    put(x.cursor[RATE], a if x.curved else dd.ZERO)
    brake(x)


@hot
def from_here(x, n):
    """Begin a new plan `n` clocks after the origin, with the place, speed and acceleration that the drive has there."""
    s = piece_at(x, n)
    t = dd.sub(dd.from_integer(n), pair(x.t[s]))
    place = dd.add(dd.from_integer(x.from_pulse[s]), exactly(x, s, n))
    a2, j6 = pair(x.a2[s]), pair(x.j6[s])
    v = dd.add(pair(x.v[s]), dd.mul(t, dd.add(dd.times(a2, 2.0), dd.mul(t, dd.mul(j6, (3.0, 0.0))))))
    a = dd.add(dd.times(a2, 2.0), dd.mul(t, dd.mul(j6, (6.0, 0.0))))
    begin(x, x.origin + n, dd.ZERO, place, v, a if x.curved else dd.ZERO)
