"""NOVA chips, compiled: the running segment of an interpolation: its next tick, and the profile that it gives the main axis."""

from __future__ import annotations

import math

from stage.chips.nova.interpolation import helix as helical
from stage.chips.nova.interpolation import line as linear
from stage.chips.nova.interpolation import pattern
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion import drive, rates
from stage.chips.nova.motion.planner import PLACE, begin, brake, brake_at, for_ever, from_here, pair, put, to_the_end
from stage.chips.nova.motion.profile import SNAP, exactly, time_in
from stage.chips.nova.registers.mcx514 import CONTINUOUS_SPEED, MCX514_MAP
from stage.chips.nova.state import AO, AXES, AXIS, DP, DV, LINE, MCX514_TYPE, NEVER, PATTERN, STAGES, STATE
from stage.native import exported, greatest, hot, least

ONE = (1.0, 0.0)
ROOT2 = (1.4142135623730951, -9.667293313452913e-17)
ROOT3 = (1.7320508075688772, 1.0035084221806903e-16)
MAX_SPEED = MCX514_MAP.register("DV").range[1]
MAX_CLOCKS = 1e17  # centuries
INNER = 8  # inner ticks of a tick where short-axis pulses are equalized


@hot
def load(c):
    """Begin the segment at the head of the queue. Returns whether it has a tick."""
    ip, g = c.ip, c.queue[c.ip.head]
    ip.closing = ip.zone = 0
    for k in range(AXES):
        ip.inner[k] = 0
    for j in range(c.axes):
        c.ax[j].moves = 0
    if g.kind == LINE:
        return linear.load(ip, g)
    if g.kind == PATTERN:
        return pattern.load(ip, g)
    return helical.load(ip, g)


@hot
def _length(moved):
    return ONE if moved < 2 else ROOT2 if moved == 2 else ROOT3


@hot
def _way(c, k):
    """Length of the k-th segment of the queue, the running one is 0, in places of the profile. It must not have begun."""
    ip, g = c.ip, c.queue[(c.ip.head + k) % (STAGES + 1)]
    if g.kind == LINE:
        one, two, three = linear.ticks(ip, g)
    elif g.kind == PATTERN:
        one, two, three = pattern.ticks(g)
    else:
        one, two, three = helical.ticks(ip.probe, g)
    distance = dd.add(
        dd.from_integer(one), dd.add(dd.mul(dd.from_integer(two), ROOT2), dd.mul(dd.from_integer(three), ROOT3))
    )
    return dd.times(distance, 1.0 / g.fine)


@exported(None, STATE)
def prepare(c):
    """The steps and directions of the next tick, and its place in the profile."""
    ip, g = c.ip, c.queue[c.ip.head]
    if g.kind == LINE:
        ip.last = linear.step(ip, g)
    elif g.kind == PATTERN:
        ip.last = pattern.step(ip, g)
    else:
        ip.last = helical.step(ip, g)
    moved = 0
    for k in range(least(g.vector, g.axes)):
        moved += ip.step[k]
    put(ip.place, dd.add(pair(ip.place), dd.times(_length(moved), 1.0 / g.fine)))
    for k in range(g.axes):
        x, direction = c.ax[g.axis[k]], ip.toward[k]
        if g.fine > 1:
            before = (ip.inner[k] + INNER // 2) // INNER
            ip.inner[k] += direction * ip.step[k]
            ip.step[k] = (ip.inner[k] + INNER // 2) // INNER != before
        x.moves = direction != 0
        if direction != 0 and x.way != direction:
            x.way = direction
            c.stale = 1


@hot
def limited(c, x):
    """DV, as far as the mode allows."""
    ip = c.ip
    if c.variant != MCX514_TYPE:
        return x.reg[DV]
    return least(x.reg[DV], (CONTINUOUS_SPEED if ip.continuous else MAX_SPEED) // c.queue[ip.head].fine)


@hot
def _plan(c, x):
    """Plan from the cursor of the main axis on: to the end of the segment if it slows."""
    ip, g = c.ip, c.queue[c.ip.head]
    ip.speed = limited(c, x)
    ip.ends = g.slows
    rates.take_speed(c, x, ip.speed)
    if not g.slows:
        for_ever(x, pair(x.dv))
        return
    goal = drive.goal_of(x, dd.floor(dd.sub(pair(ip.ends_at), pair(ip.begun))))
    point = dd.floor(pair(ip.begun)) + x.reg[DP]
    if not x.manual:
        to_the_end(x, dd.sub(pair(ip.ends_at), dd.from_integer(x.reg[AO])), goal)
    elif dd.less(pair(x.cursor[PLACE]), dd.from_integer(point)):
        for_ever(x, goal)
        if dd.less(dd.from_integer(point), pair(ip.ends_at)):
            brake_at(x, point)
    else:
        brake(x)


@exported(None, STATE, AXIS)
def replan(c, x):
    """The speed, or what is to come, has changed."""
    ip = c.ip
    if c.clock == ip.began:  # nothing has moved yet
        rates.take_speed(c, x, limited(c, x))
        begin(x, c.clock, dd.ZERO, dd.ZERO, dd.least(pair(x.sv), pair(x.dv)), dd.ZERO)
    else:
        from_here(x, c.clock - x.origin)
    _plan(c, x)
    schedule(c, x)


@hot
def schedule(c, x):
    """The clock of the prepared tick, after a change of the plan."""
    c.ip.piece = 0
    next_clock(c, x)


@hot
def next_clock(c, x):
    ip = c.ip
    ip.due = NEVER
    if not ip.stepped:
        n, ip.piece = clock_at(x, ip.piece, pair(ip.place))
        if n < NEVER:
            ip.due = x.origin + n


@hot
def sets_follow(c):
    """MCX312: a bit pattern, whose sets are one interpolation: it slows at the end of the last one."""
    return c.variant != MCX514_TYPE and c.queue[c.ip.head].kind == PATTERN


@hot
def find_end(c):
    """Find the place in the profile at which the running segment ends, if it slows there."""
    ip = c.ip
    if c.queue[ip.head].slows:
        distance = pair(ip.begun)
        for k in range(1 + (ip.waiting if sets_follow(c) else 0)):
            distance = dd.add(distance, _way(c, k))
        put(ip.ends_at, distance)


@hot
def extend(c):
    """MCX312: the number of sets that follow has changed."""
    if c.interpolating:
        find_end(c)
        c.ip.speed = -1  # plan anew


@hot
def _reached(x, s, n, place):
    """The profile, in its piece `s`, has come to `place` n clocks after its origin."""
    if x.a2[s, 0] == 0.0 and x.j6[s, 0] == 0.0:  # the same, sooner
        reached = dd.add(pair(x.p[s]), dd.mul(dd.sub(dd.from_integer(n), pair(x.t[s])), pair(x.v[s])))
    else:
        reached = exactly(x, s, n)
    return not dd.less(dd.add(dd.add(dd.from_integer(x.from_pulse[s]), reached), (SNAP, 0.0)), place)


@hot
def clock_at(x, s, place):
    """Find the first clock after the origin at which the profile has come to a place, which need not be a whole number of pulses.

    Double-doubles decide where the time is next to a whole clock.

    Args:
        x: State of the axis.
        s: First piece of the profile to search.
        place: Pulses, a double-double.

    Returns:
        The clock, NEVER if it is centuries ahead; and the number of the piece.
    """
    while True:
        low = x.from_clock[s]
        last = s + 1 == x.pieces
        edge = NEVER if last else x.from_clock[s + 1]
        max_time = MAX_CLOCKS if last else (x.t[s + 1, 0] - x.t[s, 0]) + (x.t[s + 1, 1] - x.t[s, 1])
        distance = greatest(dd.sub(dd.sub(place, dd.from_integer(x.from_pulse[s])), pair(x.p[s]))[0], 0.0)
        t = time_in(x, s, distance, max_time)
        at = x.t[s, 0] + t
        if not at < MAX_CLOCKS:
            return NEVER, s
        n = greatest(int(math.ceil(at)), low)
        slope = x.v[s, 0] + t * (2.0 * x.a2[s, 0] + 3.0 * t * x.j6[s, 0])
        guard = 1e-6 + 1e-14 * at + 1e-14 * (distance + 1.0) / greatest(slope, 1e-12)
        if n - at > 1.0 - guard:
            while n > low and _reached(x, s, n - 1, place):
                n -= 1
        if n - at < guard:
            while n < edge and not _reached(x, s, n, place):
                n += 1
        if n < edge:
            return n, s
        s += 1
