"""Edges of switches and of the encoder's index, compiled: predicted at a window's start, given to the chip at their exact clock."""

from __future__ import annotations

from stage.chips import cores
from stage.chips.entries import INPUT
from stage.native import floor, greatest, hot, least
from stage.sim.records import FAR, INDEX, INDEX_HYSTERESIS, NEVER, SECOND, TURN, clock_at


@hot
def off_index(t, q):
    """Turns from the nearest index mark to the rotor, -0.5 to 0.5."""
    turns = q * t.gear / TURN - t.index_at
    return turns - floor(turns + 0.5)


@hot
def _foresee_index(world, axis, t, q, v, half):
    """At a window's start: when in this window the index pulse will begin or end, at most both."""
    axis.index_edge = axis.index_end = NEVER
    speed = v * t.gear / TURN
    way = 1.0 if speed >= 0.0 else -1.0
    off = (off_index(t, q) - speed * half) * way  # as if the motor turned forward
    off -= floor(off + 0.5)
    rim = 0.5 * INDEX + (INDEX_HYSTERESIS if axis.index_on else 0.0)
    speed *= way
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
def foresee_switch(world, axis, s, t, v, half):
    """When in this window, from now on, a switch will change; `s.dist` is known. A bouncing contact comes to rest first."""
    if s.toggles == 0:
        s.edge = NEVER
        approach = -t.slope * v
        threshold = t.hysteresis if s.on else 0.0
        on = 1 if s.dist - approach * half <= threshold else 0
        if t.forced >= 0:
            on = t.forced
        if on != s.on:
            wait = 0.0
            if t.forced < 0 and approach != 0.0:
                wait = least(greatest(half + (s.dist - threshold) / approach, 0.0), 2.0 * half)
            s.edge = greatest(world.start + int(wait * SECOND), world.now)
    axis.next_edge = least(axis.next_edge, s.edge)


@hot
def _bounce(s, t, now):
    """After an edge, or a toggle that followed it: when the contact toggles next, ever sooner, the last at the bounce's end."""
    if s.toggles == 0:
        s.toggles, s.until = t.toggles, now + t.bounce
    else:
        s.toggles -= 1
    if s.toggles:
        s.edge = now + 2 * (s.until - now) // (s.toggles + 1)


@hot
def foresee(world, axes, table, switches, switch_table, clockwork, sensordata, qpos, qvel, moved):
    """At a window's start: where each vane is, and when in this window its switch will change.

    `moved`: qpos has moved since the sensors were read, by one step of the present qvel.
    """
    half = clockwork.half
    for a in range(len(axes)):
        axes[a].next_edge = NEVER
        v = qvel[table[a].dof]
        for k in range(table[a].first_switch, table[a].end_switch):
            s, t = switches[k], switch_table[k]
            s.dist = FAR
            if sensordata[t.found] > 0.0:
                s.dist = sensordata[t.at] + (t.slope * v * 2.0 * half if moved else 0.0)
            elif not s.on and t.forced <= 0 and s.toggles == 0:
                s.edge = NEVER
                continue
            foresee_switch(world, axes[a], s, t, v, half)
        if table[a].index_bit:
            _foresee_index(world, axes[a], table[a], qpos[table[a].qpos], v, half)


@hot
def switched(t, switches, switch_table, word):
    """The pin word of an axis with its switches as they are. Two that are wired to one pin assert it if either is on. A sensor of
    positive logic sets its pin, which is low then, while it is off."""
    on = off = 0
    for k in range(t.first_switch, t.end_switch):
        bit = switch_table[k].bit
        on, off = (on | bit, off) if switches[k].on else (on, off | bit)
    return word & ~(on | off) | on ^ t.positive & (on | off)


@hot
def indexed(t, axis, word):
    """The pin word of an axis with its index pulse as it is."""
    return word | t.index_bit if axis.index_on != (t.positive & t.index_bit != 0) else word & ~t.index_bit


@hot
def _meet_axis_edges(axis, t, c, j, switches, switch_table, now):
    """The switches of chip axis `j` that change at `now` do."""
    axis.next_edge = NEVER
    for k in range(t.first_switch, t.end_switch):
        s = switches[k]
        if s.edge <= now:
            s.edge = NEVER
            s.on = 1 - s.on
            if s.toggles or switch_table[k].bounce:
                _bounce(s, switch_table[k], now)
        axis.next_edge = least(axis.next_edge, s.edge)
    word = switched(t, switches, switch_table, cores.inputs(c, j))
    if t.index_bit:
        if axis.index_edge <= now:
            axis.index_edge, axis.index_end = axis.index_end, NEVER
            axis.index_on = 1 - axis.index_on
            word = indexed(t, axis, word)
        axis.next_edge = least(axis.next_edge, axis.index_edge)
    cores.set_input(c, j, word)


@hot
def next_edge(axes, c):
    """When the next input of a chip changes."""
    edge = axes[cores.axis_of(c, 0)].next_edge
    for j in range(1, c.axes):
        edge = least(edge, axes[cores.axis_of(c, j)].next_edge)
    return edge


@hot
def note_input(c, j, edges, n_edges, now):
    """The inputs of chip axis `j` have changed: returns how many edges are noted by now."""
    if n_edges < len(edges):
        e = edges[n_edges]
        e.now, e.clock, e.axis, e.kind, e.a, e.b = (
            now,
            cores.clock(c),
            cores.axis_of(c, j),
            INPUT,
            j,
            cores.inputs(c, j),
        )
        n_edges += 1
    return n_edges


@hot
def meet_edges(c, axes, table, switches, switch_table, until, edges, n_edges):
    """Take chip `c` through the edges of its switches up to `until` ns. Returns how many are noted by now."""
    now = next_edge(axes, c)
    while now <= until:
        cores.run(c, clock_at(now, c.hz))
        for j in range(c.axes):
            a = cores.axis_of(c, j)
            if axes[a].next_edge > now:
                continue
            _meet_axis_edges(axes[a], table[a], c, j, switches, switch_table, now)
            n_edges = note_input(c, j, edges, n_edges, now)
        now = next_edge(axes, c)
    return n_edges
