"""Edges of switches and of the encoder's index, compiled: predicted at a window's start, passed to a chip at their exact clock."""

from __future__ import annotations

from stage.chips import cores
from stage.chips.entries import INPUT
from stage.native import array_at, floor, hot, least
from stage.sim.handle import (
    axes,
    axis_table,
    clockwork,
    has_edge_room,
    note_edge,
    qpos,
    qvel,
    sensordata,
    switch_table,
    switches,
    world,
)
from stage.sim.records import FLAG_EDGE, HYSTERESIS, INDEX, INDEX_HYSTERESIS, NEVER, SECOND, TURN, clock_at

UNREACHED = 1e300  # joint travel to an edge that is not ahead
RELIABLE_SHARE = 0.8  # share of the travel beside an edge in which the sensor's distance tells the place


@hot
def measure_index_offset(t, q):
    """Return the turns from the nearest index mark to the rotor, -0.5 to 0.5."""
    angle = q * t.gear / TURN - t.index_at
    return angle - floor(angle + 0.5)


@hot
def _predict_index(world, axis, t, q, v, half):
    """Predict, at the start of a window, when the index pulse begins and ends in it; there are at most two such edges."""
    axis.index_edge = axis.index_end = NEVER
    speed = v * t.gear / TURN
    direction = 1.0 if speed >= 0.0 else -1.0
    off = (measure_index_offset(t, q) - speed * half) * direction  # as if the motor turned forward
    off -= floor(off + 0.5)
    rim = 0.5 * INDEX + (INDEX_HYSTERESIS if axis.index_on else 0.0)
    speed *= direction
    if axis.index_on:
        wait = rim - off if abs(off) <= rim else 0.0
    elif abs(off) <= rim:
        wait = 0.0
    else:
        wait = -rim - off if off < -rim else 1.0 - rim - off
    if wait <= speed * 2.0 * half:
        axis.index_edge = world.start + (int(wait / speed * SECOND) if wait > 0.0 else 0)
        if not axis.index_on:
            last = wait + INDEX + INDEX_HYSTERESIS if wait > 0.0 else rim + INDEX_HYSTERESIS - off
            if 0.0 < last < speed * 2.0 * half:
                axis.index_end = world.start + int(last / speed * SECOND)
        axis.next_edge = least(axis.next_edge, axis.index_edge)


@hot
def _flag_edges(clockwork):
    """Return the FLAG_EDGE records of all switches."""
    return array_at(clockwork.flag_edges, clockwork.n_flag_edges, FLAG_EDGE)


@hot
def _measure_travel_from(edge, q, turn):
    """Return the joint travel from an edge to `q`.

    On a joint that turns endlessly the edge repeats after `turn`; the travel is then that from the nearest repetition.
    """
    x = q - edge.at
    return x - turn * floor(x / turn + 0.5) if turn else x


@hot
def _find_nearest_edge(edges, t, q):
    """Return the index of the flag edge of a switch that is nearest to `q`."""
    k, nearest = t.first_edge, UNREACHED
    for i in range(t.first_edge, t.end_edge):
        away = abs(_measure_travel_from(edges[i], q, t.turn))
        if away < nearest:
            k, nearest = i, away
    return k


@hot
def _measure_distance_outside(edges, t, q):
    """Return the joint travel by which `q` is outside the flag of a switch; it is negative inside the flag."""
    e = edges[_find_nearest_edge(edges, t, q)]
    x = _measure_travel_from(e, q, t.turn)
    return x if e.slope > 0.0 else -x


@hot
def _correct_flag_shift(edges, s, t, q, dist):
    """Correct `s.shift` where the sensor's distance, read at joint position `q`, contradicts it.

    Near an edge the distance gives the position of the joint. Elsewhere (far away, or deep in the switch, where the contact's
    direction changes) it only shows on which side of the edge the joint is, and the shift keeps its last value.
    """
    q -= s.shift
    e = edges[_find_nearest_edge(edges, t, q)]
    x, sensed = _measure_travel_from(e, q, t.turn), dist / e.slope
    limit = 0.0
    if sensed < e.below or sensed > e.above:
        limit = RELIABLE_SHARE * (e.above if sensed > 0.0 else e.below)
        if (x - limit) * sensed >= 0.0:
            return
    error, correction, allowed = UNREACHED, x - limit, 0.0
    for i in range(t.first_edge, t.end_edge):
        e = edges[i]
        x, sensed = _measure_travel_from(e, q, t.turn), dist / e.slope
        if e.below <= sensed <= e.above and abs(x - sensed) < error:
            error, correction, allowed = abs(x - sensed), x - sensed, e.noise + e.bend * sensed * sensed
    if error > allowed:
        s.shift += correction


@hot
def _place_flag_ahead(edges, s, t, q, v, dist):
    """Correct `s.shift` if the joint, at `q` when the sensor first detects the vane, would move away from the flag."""
    k, nearest = -1, UNREACHED
    for i in range(t.first_edge, t.end_edge):
        away = abs(_measure_travel_from(edges[i], q, t.turn))
        if edges[i].slope * v < 0.0 and away < nearest:
            k, nearest = i, away
    if k >= 0 and dist > 0.0:
        x, sensed = _measure_travel_from(edges[k], q, t.turn), dist / edges[k].slope
        if x * sensed < 0.0:
            s.shift += x - sensed


@hot
def is_in_flag(clockwork, s, t, q):
    """Return whether the vane is in its switch with the joint at `q`."""
    return s.sensed and _measure_distance_outside(_flag_edges(clockwork), t, q - s.shift) <= 0.0


@hot
def _measure_travel_to_change(edges, t, q, direction, gone, on):
    """Return the travel from flag position `q` after which the switch changes next; `gone` if it should have changed by then.

    Args:
        edges: FLAG_EDGE records of all switches.
        t: The switch's row of SWITCH_TABLE.
        q: Joint position less the flag's shift.
        direction: Direction of travel, 1.0 or -1.0.
        gone: Travel from `q` that is behind the joint.
        on: Whether the switch is asserted there.
    """
    hysteresis, ahead = HYSTERESIS if on else 0.0, UNREACHED
    outside = _measure_distance_outside(edges, t, q + direction * gone)
    if (outside > hysteresis) if on else (outside <= 0.0):
        return gone
    for i in range(t.first_edge, t.end_edge):
        e = edges[i]
        if (e.slope * direction > 0.0) == (on != 0):
            travel = hysteresis - _measure_travel_from(e, q, t.turn) * direction
            if gone <= travel < ahead:
                ahead = travel
    return ahead


@hot
def predict_switch(world, axis, clockwork, s, t, q, v):
    """Predict when a switch will change between now and the window's end, at most twice.

    A contact that bounces comes to rest before the next change.

    Args:
        world, axis, clockwork, s, t: WORLD, AXIS, CLOCKWORK, SWITCH and the switch's row of SWITCH_TABLE.
        q: Position of the axis' joint at the window's center.
        v: Speed of the joint.
    """
    if s.toggles == 0:
        s.edge = s.next_edge = NEVER
        if t.forced >= 0 or not s.sensed:
            if s.on != (t.forced if t.forced >= 0 else 0):
                s.edge = world.now
        else:
            edges, direction = _flag_edges(clockwork), 1.0 if v >= 0.0 else -1.0
            q -= v * clockwork.half + s.shift
            speed = v * direction
            last, gone = speed * 2.0 * clockwork.half, speed * (float(world.now - world.start) / SECOND)
            travel = _measure_travel_to_change(edges, t, q, direction, gone, s.on)
            if travel <= last:
                s.edge = world.start + int(travel / speed * SECOND) if travel > gone else world.now
                if t.bounce == 0:
                    travel = _measure_travel_to_change(edges, t, q, direction, travel, 1 - s.on)
                    if gone < travel <= last:
                        s.next_edge = world.start + int(travel / speed * SECOND)
    axis.next_edge = least(axis.next_edge, s.edge)


@hot
def _schedule_next_toggle(s, t, now):
    """Set when a bouncing contact toggles next. The intervals become shorter, and the last toggle is at the end of the bounce."""
    if s.toggles == 0:
        s.toggles, s.until = t.toggles, now + t.bounce
    else:
        s.toggles -= 1
    if s.toggles:
        s.edge = now + 2 * (s.until - now) // (s.toggles + 1)


@hot
def predict_edges(h, moved):
    """Predict, at the start of a window, where each vane is and when its switch changes within the window.

    Args:
        h: HANDLE record.
        moved: Whether qpos has moved by one step of the present qvel since the sensors were read.
    """
    axis_records, table, readings = axes(h), axis_table(h), sensordata(h)
    for a in range(len(axis_records)):
        q, v = qpos(h)[table[a].qpos], qvel(h)[table[a].dof]
        predict_axis_edges(
            world(h),
            clockwork(h),
            axis_records[a],
            table[a],
            switches(h),
            switch_table(h),
            readings,
            q,
            v,
            moved,
        )


@hot
def predict_axis_edges(now, clock, axis, of_axis, records, rows, sensordata, q, v, moved):
    """Predict the edges of one axis whose joint is at `q` with speed `v`; see `predict_edges`.

    `now` and `clock` are WORLD and CLOCKWORK of the stage, `axis` and `of_axis` the axis' AXIS and its row of AXIS_TABLE, `records`
    and `rows` all SWITCH and SWITCH_TABLE records.
    """
    half, edges = clock.half, _flag_edges(clock)
    axis.next_edge = NEVER
    awake = axis.awake or not moved
    for k in range(of_axis.first_switch, of_axis.end_switch):
        awake |= sensordata[rows[k].found] > 0.0 or rows[k].forced > 0
    axis.awake = 0
    for k in range(of_axis.first_switch, of_axis.end_switch if awake else 0):  # else nothing has changed
        s, t = records[k], rows[k]
        if sensordata[t.found] > 0.0:
            q_sensed, dist = q - v * 2.0 * half if moved else q, sensordata[t.dist]
            if moved and not s.sensed:
                _place_flag_ahead(edges, s, t, q_sensed, v, dist)
            s.sensed = 1
            _correct_flag_shift(edges, s, t, q_sensed, dist)
        else:
            s.sensed, s.shift = 0, 0.0
            if not s.on and t.forced <= 0 and s.toggles == 0:
                s.edge = s.next_edge = NEVER
                continue
        axis.awake = 1
        predict_switch(now, axis, clock, s, t, q, v)
    if of_axis.index_bit:
        _predict_index(now, axis, of_axis, q, v, half)


@hot
def apply_switches(t, records, rows, word):
    """Return the pin word of an axis with the bits of its switches set to their present levels.

    If two switches are wired to one pin, either of them asserts it. A sensor of positive logic sets its bit while
    it is off, since its pin is low then.
    """
    on = off = 0
    for k in range(t.first_switch, t.end_switch):
        bit = rows[k].bit
        on, off = (on | bit, off) if records[k].on else (on, off | bit)
    return word & ~(on | off) | on ^ t.positive & (on | off)


@hot
def apply_index_pulse(t, axis, word):
    """Return the pin word of an axis with the bit of its index pulse set to its present level."""
    return word | t.index_bit if axis.index_on != (t.positive & t.index_bit != 0) else word & ~t.index_bit


@hot
def process_axis_edges(axis, t, c, j, records, rows, now):
    """Apply the edges of chip axis `j` that occur at `now`, ns."""
    axis.next_edge = NEVER
    for k in range(t.first_switch, t.end_switch):
        s = records[k]
        if s.edge <= now:
            s.edge, s.next_edge = s.next_edge, NEVER
            s.on = 1 - s.on
            if s.toggles or rows[k].bounce:
                _schedule_next_toggle(s, rows[k], now)
        axis.next_edge = least(axis.next_edge, s.edge)
    word = apply_switches(t, records, rows, cores.inputs(c, j))
    if t.index_bit:
        if axis.index_edge <= now:
            axis.index_edge, axis.index_end = axis.index_end, NEVER
            axis.index_on = 1 - axis.index_on
            word = apply_index_pulse(t, axis, word)
        axis.next_edge = least(axis.next_edge, axis.index_edge)
    cores.set_input(c, j, word)


@hot
def find_next_edge(axis_records, c):
    """Return the time, ns, at which the next input of a chip changes."""
    edge = axis_records[cores.axis_of(c, 0)].next_edge
    for j in range(1, c.axes):
        edge = least(edge, axis_records[cores.axis_of(c, j)].next_edge)
    return edge


@hot
def journal_input(h, now, c, j):
    """Write into the journal that the inputs of chip axis `j` have changed at `now` ns."""
    if has_edge_room(h):
        note_edge(h, now, c, cores.axis_of(c, j), INPUT, j, cores.inputs(c, j))


@hot
def process_edges(h, c, until):
    """Advance chip `c` to `until` ns, and apply the edges of its switches on the way, each at its time."""
    axis_records, table = axes(h), axis_table(h)
    now = find_next_edge(axis_records, c)
    while now <= until:
        cores.run(c, clock_at(now, c.hz))
        for j in range(c.axes):
            a = cores.axis_of(c, j)
            if axis_records[a].next_edge > now:
                continue
            process_axis_edges(axis_records[a], table[a], c, j, switches(h), switch_table(h), now)
            journal_input(h, now, c, j)
        now = find_next_edge(axis_records, c)
