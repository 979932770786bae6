"""Edges of switches and of the encoder's index, compiled: predicted at a window's start, applied to a chip at their exact clock."""

from __future__ import annotations

from stage.chips import core_interface
from stage.chips.journal_entries import INPUT
from stage.native import array_at, floor, hot, least
from stage.sim.compiled_stage_access import (
    get_axes,
    get_axis_table,
    get_clockwork,
    get_qpos,
    get_qvel,
    get_sensordata,
    get_switch_table,
    get_switches,
    get_world,
    has_edge_room,
    log_edge,
)
from stage.sim.engine_records import (
    FLAG_EDGE,
    INDEX,
    INDEX_HYSTERESIS,
    NEVER,
    NS_PER_SECOND,
    SWITCH_HYSTERESIS_M,
    TURN_RAD,
    compute_clock_at,
)

UNREACHED_TRAVEL = 1e300  # joint travel to an edge that is not ahead
RELIABLE_TRAVEL_SHARE = 0.8  # share of the travel beside an edge in which the sensor's distance tells the place


@hot
def measure_index_offset(axis_row, position):
    """Return the turns from the nearest index mark to the rotor, -0.5 to 0.5."""
    angle = position * axis_row.gear / TURN_RAD - axis_row.index_at
    return angle - floor(angle + 0.5)


@hot
def _predict_index_edges(world, axis, axis_row, position, velocity, half_step):
    """Predict, at the start of a window, when the index pulse begins and ends in it; there are at most two such edges."""
    axis.index_edge = axis.index_end = NEVER
    speed = velocity * axis_row.gear / TURN_RAD
    direction = 1.0 if speed >= 0.0 else -1.0
    off = (measure_index_offset(axis_row, position) - speed * half_step) * direction  # as if the motor turned forward
    off -= floor(off + 0.5)
    rim = 0.5 * INDEX + (INDEX_HYSTERESIS if axis.index_on else 0.0)
    speed *= direction
    if axis.index_on:
        wait = rim - off if abs(off) <= rim else 0.0
    elif abs(off) <= rim:
        wait = 0.0
    else:
        wait = -rim - off if off < -rim else 1.0 - rim - off
    if wait <= speed * 2.0 * half_step:
        axis.index_edge = world.start + (int(wait / speed * NS_PER_SECOND) if wait > 0.0 else 0)
        if not axis.index_on:
            last = wait + INDEX + INDEX_HYSTERESIS if wait > 0.0 else rim + INDEX_HYSTERESIS - off
            if 0.0 < last < speed * 2.0 * half_step:
                axis.index_end = world.start + int(last / speed * NS_PER_SECOND)
        axis.next_edge = least(axis.next_edge, axis.index_edge)


@hot
def _get_flag_edges(clockwork):
    """Return the FLAG_EDGE records of all switches."""
    return array_at(clockwork.flag_edges, clockwork.n_flag_edges, FLAG_EDGE)


@hot
def _measure_travel_from(edge, position, turn):
    """Return the joint travel from an edge to `position`.

    On a joint that turns endlessly the edge repeats after `turn`; the travel is then that from the nearest repetition.
    """
    x = position - edge.at
    return x - turn * floor(x / turn + 0.5) if turn else x


@hot
def _find_nearest_edge(edges, switch_row, position):
    """Return the index of the flag edge of a switch that is nearest to `position`."""
    k, nearest = switch_row.first_edge, UNREACHED_TRAVEL
    for i in range(switch_row.first_edge, switch_row.end_edge):
        away = abs(_measure_travel_from(edges[i], position, switch_row.turn))
        if away < nearest:
            k, nearest = i, away
    return k


@hot
def _measure_distance_outside(edges, switch_row, position):
    """Return the joint travel by which `position` is outside the flag of a switch; it is negative inside the flag."""
    e = edges[_find_nearest_edge(edges, switch_row, position)]
    x = _measure_travel_from(e, position, switch_row.turn)
    return x if e.slope > 0.0 else -x


@hot
def _correct_flag_shift(edges, switch, switch_row, position, distance):
    """Correct the shift of a flag if it contradicts the sensor's distance, which was read at joint position `position`.

    Near an edge the distance gives the position of the joint. Farther from the edge (and deep in the switch, where the direction of
    the contact changes) it only shows on which side of the edge the joint is, and the shift keeps its value.
    """
    position -= switch.shift
    e = edges[_find_nearest_edge(edges, switch_row, position)]
    x, sensed = _measure_travel_from(e, position, switch_row.turn), distance / e.slope
    limit = 0.0
    if sensed < e.below or sensed > e.above:
        limit = RELIABLE_TRAVEL_SHARE * (e.above if sensed > 0.0 else e.below)
        if (x - limit) * sensed >= 0.0:
            return
    error, correction, allowed = UNREACHED_TRAVEL, x - limit, 0.0
    for i in range(switch_row.first_edge, switch_row.end_edge):
        e = edges[i]
        x, sensed = _measure_travel_from(e, position, switch_row.turn), distance / e.slope
        if e.below <= sensed <= e.above and abs(x - sensed) < error:
            error, correction, allowed = abs(x - sensed), x - sensed, e.noise + e.bend * sensed * sensed
    if error > allowed:
        switch.shift += correction


@hot
def _shift_flag_ahead_of_joint(flag_edges, switch, switch_row, position, velocity, distance):
    """Shift a flag so that its edge is ahead of the joint, if the joint would move away from the vane that the sensor detects.

    Args:
        flag_edges: FLAG_EDGE records of all switches.
        switch: SWITCH record, whose shift is corrected.
        switch_row: The switch's SWITCH_ROW record.
        position: Joint position when the sensor first detects the vane, m (rad on a hinge).
        velocity: Speed of the joint, m/s (rad/s).
        distance: Distance that the sensor measures, m.
    """
    k, nearest = -1, UNREACHED_TRAVEL
    for i in range(switch_row.first_edge, switch_row.end_edge):
        away = abs(_measure_travel_from(flag_edges[i], position, switch_row.turn))
        if flag_edges[i].slope * velocity < 0.0 and away < nearest:
            k, nearest = i, away
    if k >= 0 and distance > 0.0:
        x, sensed = _measure_travel_from(flag_edges[k], position, switch_row.turn), distance / flag_edges[k].slope
        if x * sensed < 0.0:
            switch.shift += x - sensed


@hot
def is_in_flag(clockwork, switch, switch_row, position):
    """Return whether the vane is in its switch with the joint at `position`."""
    return (
        switch.sensed
        and _measure_distance_outside(_get_flag_edges(clockwork), switch_row, position - switch.shift) <= 0.0
    )


@hot
def _measure_travel_to_change(edges, switch_row, position, direction, passed_travel, asserted):
    """Compute the joint travel after which a switch changes next, measured from `position`.

    Args:
        edges: FLAG_EDGE records of all switches.
        switch_row: The switch's SWITCH_ROW record.
        position: Joint position less the flag's shift, m (rad on a hinge).
        direction: Direction of travel, 1.0 or -1.0.
        passed_travel: Travel from `position` that the joint has already made.
        asserted: Whether the switch is asserted at `position`.

    Returns:
        Travel in m (rad); `passed_travel` if the switch should already have changed; UNREACHED if no edge is ahead.
    """
    hysteresis, ahead = SWITCH_HYSTERESIS_M if asserted else 0.0, UNREACHED_TRAVEL
    outside = _measure_distance_outside(edges, switch_row, position + direction * passed_travel)
    if (outside > hysteresis) if asserted else (outside <= 0.0):
        return passed_travel
    for i in range(switch_row.first_edge, switch_row.end_edge):
        e = edges[i]
        if (e.slope * direction > 0.0) == (asserted != 0):
            travel = hysteresis - _measure_travel_from(e, position, switch_row.turn) * direction
            if passed_travel <= travel < ahead:
                ahead = travel
    return ahead


@hot
def predict_switch_changes(world, axis, clockwork, switch, switch_row, position, velocity):
    """Predict when a switch will change between now and the window's end, at most twice.

    A contact that bounces comes to rest before the next change.

    Args:
        world: WORLD record.
        axis: AXIS record of the switch's axis.
        clockwork: CLOCKWORK record.
        switch: SWITCH record.
        switch_row: The switch's SWITCH_ROW record.
        position: Position of the axis' joint at the window's center.
        velocity: Speed of the joint.
    """
    if switch.toggles == 0:
        switch.edge = switch.next_edge = NEVER
        if switch_row.forced >= 0 or not switch.sensed:
            if switch.on != (switch_row.forced if switch_row.forced >= 0 else 0):
                switch.edge = world.now
        else:
            edges, direction = _get_flag_edges(clockwork), 1.0 if velocity >= 0.0 else -1.0
            position -= velocity * clockwork.half + switch.shift
            speed = velocity * direction
            last, gone = speed * 2.0 * clockwork.half, speed * (float(world.now - world.start) / NS_PER_SECOND)
            travel = _measure_travel_to_change(edges, switch_row, position, direction, gone, switch.on)
            if travel <= last:
                switch.edge = world.start + int(travel / speed * NS_PER_SECOND) if travel > gone else world.now
                if switch_row.bounce == 0:
                    travel = _measure_travel_to_change(edges, switch_row, position, direction, travel, 1 - switch.on)
                    if gone < travel <= last:
                        switch.next_edge = world.start + int(travel / speed * NS_PER_SECOND)
    axis.next_edge = least(axis.next_edge, switch.edge)


@hot
def _schedule_next_toggle(switch, switch_row, now_ns):
    """Set when a bouncing contact toggles next. The intervals become shorter, and the last toggle is at the end of the bounce."""
    if switch.toggles == 0:
        switch.toggles, switch.until = switch_row.toggles, now_ns + switch_row.bounce
    else:
        switch.toggles -= 1
    if switch.toggles:
        switch.edge = now_ns + 2 * (switch.until - now_ns) // (switch.toggles + 1)


@hot
def predict_switch_edges(handle, has_moved):
    """Predict, at the start of a window, where each vane is and when its switch changes within the window.

    Args:
        handle: HANDLE record.
        has_moved: Whether qpos has moved by one step of the present qvel since the sensors were read.
    """
    w, clock, axis_records, table = get_world(handle), get_clockwork(handle), get_axes(handle), get_axis_table(handle)
    switches, switch_table, readings = get_switches(handle), get_switch_table(handle), get_sensordata(handle)
    for a in range(len(axis_records)):
        q, v = get_qpos(handle)[table[a].qpos], get_qvel(handle)[table[a].dof]
        predict_axis_switch_edges(
            w, clock, axis_records[a], table[a], switches, switch_table, readings, q, v, has_moved
        )


@hot
def predict_axis_switch_edges(
    world, clockwork, axis, axis_row, switches, switch_table, sensordata, position, velocity, has_moved
):
    """Predict when the switches and the index pulse of one axis change within the window; see `predict_switch_edges`.

    Args:
        world: WORLD record of the stage.
        clockwork: CLOCKWORK record of the stage.
        axis: AXIS record of the axis.
        axis_row: The axis' AXIS_ROW record.
        switches: SWITCH records of all switches.
        switch_table: SWITCH_ROW records of all switches.
        sensordata: MuJoCo's sensor values.
        position: Position of the axis' joint, m (rad on a hinge).
        velocity: Speed of the joint, m/s (rad/s).
        has_moved: Whether qpos has moved by one step of the present qvel since the sensors were read.
    """
    half, edges = clockwork.half, _get_flag_edges(clockwork)
    axis.next_edge = NEVER
    awake = axis.awake or not has_moved
    for k in range(axis_row.first_switch, axis_row.end_switch):
        awake |= sensordata[switch_table[k].found] > 0.0 or switch_table[k].forced > 0
    axis.awake = 0
    for k in range(axis_row.first_switch, axis_row.end_switch if awake else 0):  # else nothing has changed
        s, t = switches[k], switch_table[k]
        if sensordata[t.found] > 0.0:
            q_sensed, dist = position - velocity * 2.0 * half if has_moved else position, sensordata[t.dist]
            if has_moved and not s.sensed:
                _shift_flag_ahead_of_joint(edges, s, t, q_sensed, velocity, dist)
            s.sensed = 1
            _correct_flag_shift(edges, s, t, q_sensed, dist)
        else:
            s.sensed, s.shift = 0, 0.0
            if not s.on and t.forced <= 0 and s.toggles == 0:
                s.edge = s.next_edge = NEVER
                continue
        axis.awake = 1
        predict_switch_changes(world, axis, clockwork, s, t, position, velocity)
    if axis_row.index_bit:
        _predict_index_edges(world, axis, axis_row, position, velocity, half)


@hot
def set_switch_bits(axis_row, switches, switch_table, word):
    """Return the input word of an axis with the bits of its switches set to their present levels.

    If two switches are wired to one pin, either of them asserts it. A sensor of positive logic sets its bit while
    it is off, because its pin is then low.
    """
    on = off = 0
    for k in range(axis_row.first_switch, axis_row.end_switch):
        bit = switch_table[k].bit
        on, off = (on | bit, off) if switches[k].on else (on, off | bit)
    return word & ~(on | off) | on ^ axis_row.positive & (on | off)


@hot
def set_index_bit(axis_row, axis, word):
    """Return the input word of an axis with the bit of its index pulse set to the present level."""
    return (
        word | axis_row.index_bit
        if axis.index_on != (axis_row.positive & axis_row.index_bit != 0)
        else word & ~axis_row.index_bit
    )


@hot
def process_axis_edges(axis, axis_row, chip, chip_axis, switches, switch_table, now_ns):
    """Apply the edges of chip axis `chip_axis` that occur at `now_ns`, ns."""
    axis.next_edge = NEVER
    for k in range(axis_row.first_switch, axis_row.end_switch):
        s = switches[k]
        if s.edge <= now_ns:
            s.edge, s.next_edge = s.next_edge, NEVER
            s.on = 1 - s.on
            if s.toggles or switch_table[k].bounce:
                _schedule_next_toggle(s, switch_table[k], now_ns)
        axis.next_edge = least(axis.next_edge, s.edge)
    word = set_switch_bits(axis_row, switches, switch_table, core_interface.read_inputs(chip, chip_axis))
    if axis_row.index_bit:
        if axis.index_edge <= now_ns:
            axis.index_edge, axis.index_end = axis.index_end, NEVER
            axis.index_on = 1 - axis.index_on
            word = set_index_bit(axis_row, axis, word)
        axis.next_edge = least(axis.next_edge, axis.index_edge)
    core_interface.set_input(chip, chip_axis, word)


@hot
def find_next_edge(axis_records, chip):
    """Return the time, ns, at which the next input of a chip changes."""
    edge = axis_records[core_interface.find_stage_axis(chip, 0)].next_edge
    for j in range(1, chip.axes):
        edge = least(edge, axis_records[core_interface.find_stage_axis(chip, j)].next_edge)
    return edge


@hot
def journal_input(handle, now_ns, chip, chip_axis):
    """Log for the journal that the input pins of chip axis `chip_axis` have changed at `now_ns` ns."""
    if has_edge_room(handle):
        axis, word = core_interface.find_stage_axis(chip, chip_axis), core_interface.read_inputs(chip, chip_axis)
        log_edge(handle, now_ns, chip, axis, INPUT, chip_axis, word)


@hot
def process_edges(handle, chip, until_ns):
    """Advance chip `chip` to `until_ns` ns, and apply the edges of its switches on the way, each at its time."""
    axis_records, table = get_axes(handle), get_axis_table(handle)
    now = find_next_edge(axis_records, chip)
    while now <= until_ns:
        core_interface.run(chip, compute_clock_at(now, chip.hz))
        for j in range(chip.axes):
            a = core_interface.find_stage_axis(chip, j)
            if axis_records[a].next_edge > now:
                continue
            process_axis_edges(axis_records[a], table[a], chip, j, get_switches(handle), get_switch_table(handle), now)
            journal_input(handle, now, chip, j)
        now = find_next_edge(axis_records, chip)
