"""The one compiled loop: switches -> chips -> drives -> mj_step, many steps per call.

Time is an integer of nanoseconds. A physics step of dt is a *window* [start, start + dt) of chip time, cut into equal
slices. Every chip runs through the window (an input edge or a bus cycle may fall anywhere inside), and its mean pulse count
in each slice is kept. At the window's end every drive turns its counts into torque, slice by slice; the mean goes to
`ctrl`, and mj_step moves the stage.

MuJoCo's integrator is a leapfrog: positions belong to times t, velocities to half a step before. The force that it needs at a
position is the mean over the window centred there. So the position in `qpos` is that of a window's centre, not of its start: at a
chip time tau after the window's start a joint is at q + v (tau - dt / 2). With this the coupling adds no false damping (the ringing
of a stepper would die out too fast), and a switch's edge is extrapolated by half a step only. The velocity at the centre is not
known before the force is: a drive that needs it solves for it (`stepper.mean_torque`), or the coupling would add energy.

All state is in records inside MjData.userdata, all tables of constants in arrays beside it; nothing here allocates.
"""

from __future__ import annotations

from stage.chips import cores, links
from stage.chips.entries import LOAD, SHAFT
from stage.drives import drive, stepper
from stage.native import array_at, called, hot, least
from stage.sim.edges import (
    foresee,
    in_flag,
    indexed,
    meet_edges,
    next_edge,
    note_input,
    off_index,
    predict_switch,
    switched,
)
from stage.sim.records import (
    ADDRESS,
    CALLBACKS,
    DIVERGED,
    EDGES_FULL,
    FAILED,
    INDEX,
    MAX_SPEED,
    NEVER,
    REACHED,
    SAMPLES_FULL,
    SECOND,
    SLICES,
    UNGUARDED,
    WIPED,
    clock_at,
)

_step = called(None, "i8", "i8")
_get_state = called(None, "i8", "i8", "i8", "i4")


@hot
def _run_chips(chips, world, axes, table, switches, switch_table, stop, clockwork, edges, counts):
    """Run the chips up to `stop` ns, inside the window; counts[1]: edges noted by now. Returns slices done."""
    start, dt = world.start, clockwork.dt
    hz = clock = rest = 0
    k = world.slice
    for i in range(len(chips)):
        c = chips[i]
        if c.link:
            if _leads(chips, i):
                k = _run_linked(chips, i, world, axes, table, switches, switch_table, stop, clockwork, edges, counts)
            continue
        if cores.hear(c):
            counts[1] = note_input(c, 0, edges, counts[1], world.now)
        if c.hz != hz:
            hz = c.hz
            clock, rest = clock_at(start, hz), start % SECOND * hz % SECOND
        k, now = world.slice, 0
        if stop == start + dt and next_edge(axes, c) > stop:
            c.begin, c.rest = clock, rest
            cores.window(c, k)
            k = SLICES
            continue
        while now < stop:
            bound = start + (k + 1) * dt // SLICES
            now = least(bound, stop)
            if next_edge(axes, c) <= now:
                counts[1] = meet_edges(c, axes, table, switches, switch_table, now, edges, counts[1])
            cores.run(c, clock + (rest + (now - start) * hz) // SECOND)
            if now == bound:
                _end_slice(c, axes, k)
                k += 1
    return k


@hot
def _end_slice(c, axes, k):
    """The axes' mean counts in slice `k`, which ends now."""
    for j in range(c.axes):
        axis = axes[cores.axis_of(c, j)]
        axis.counts[k] = cores.drive_input(c, j, axis.count, c.ticks)
        axis.count = cores.net(c, j)


@hot
def _leads(chips, i):
    """Chip `i` is the first of those that are linked to it."""
    m = 0
    while chips[m].link != chips[i].link:
        m += 1
    return m == i


@hot
def _run_linked(chips, first, world, axes, table, switches, switch_table, stop, clockwork, edges, counts):
    """As `_run_chips`, of the chips that are linked to this first one: an edge of one of them acts on all at its clock."""
    start, dt, link, hz = world.start, clockwork.dt, chips[first].link, chips[first].hz
    k, now = world.slice, 0
    while now < stop:
        bound = start + (k + 1) * dt // SLICES
        now = least(bound, stop)
        while True:
            edge = now + 1
            for i in range(first, len(chips)):
                if chips[i].link == link:
                    edge = least(edge, next_edge(axes, chips[i]))
            at = least(edge, now)
            counts[1] = links.run(chips, link, clock_at(at, hz), at, edges, counts[1])
            if edge > now:
                break
            for i in range(first, len(chips)):
                if chips[i].link == link and next_edge(axes, chips[i]) <= edge:
                    c = chips[i]
                    counts[1] = meet_edges(c, axes, table, switches, switch_table, edge, edges, counts[1])
        if now == bound:
            for i in range(first, len(chips)):
                if chips[i].link == link:
                    _end_slice(chips[i], axes, k)
            k += 1
    return k


@hot
def _shaft(world, t, clockwork, qpos, qvel):
    """Where an axis' shaft is now, in counts of its encoder, and how fast, in counts a second."""
    v = qvel[t.dof]
    tau = float(world.now - world.start) / SECOND - clockwork.half
    return (qpos[t.qpos] + v * tau) * t.counts, v * t.counts


@hot
def _show_shafts(chips, world, table, clockwork, qpos, qvel, edges, counts):
    """At a window's start: the shafts, for the chips that look at them. Returns the edges noted by now."""
    for i in range(len(chips)):
        c = chips[i]
        for j in range(c.axes):
            a = cores.axis_of(c, j)
            if table[a].counts == 0.0:
                continue
            count, speed = _shaft(world, table[a], clockwork, qpos, qvel)
            cores.set_shaft(c, j, count, speed / c.hz)
            if counts[1] < len(edges):
                e = edges[counts[1]]
                e.now, e.clock, e.axis, e.kind, e.count, e.rate = (
                    world.now,
                    cores.clock(c),
                    a,
                    SHAFT + j,
                    count,
                    speed / c.hz,
                )
                counts[1] += 1
    return counts[1]


@hot
def _show_loads(chips, world, axes, drives, table, clockwork, qpos, qvel, edges, counts):
    """At a window's start: the loads of the motors, for the chips that drive them. Returns the edges noted by now."""
    for a in range(len(axes)):
        t, d = table[a], drives[a]
        c = chips[t.chip]
        if c.set_load == 0:
            continue
        v = qvel[t.dof]
        angle = drive.load_angle(d, cores.net(c, t.chip_axis), (qpos[t.qpos] - v * clockwork.half) * t.gear)
        share = d.torque_constant * abs(v * t.gear) / d.voltage
        if cores.set_load(c, t.chip_axis, angle, share) and counts[1] < len(edges):
            e = edges[counts[1]]
            e.now, e.clock, e.axis, e.kind, e.count, e.rate = (
                world.now,
                cores.clock(c),
                a,
                LOAD - t.chip_axis,
                angle,
                share,
            )
            counts[1] += 1
    return counts[1]


@hot
def _set_currents(chips, drives, table):
    """The currents of the motors whose chips drive them."""
    for a in range(len(drives)):
        c = chips[table[a].chip]
        if c.current:
            drives[a].current = cores.current(c, table[a].chip_axis)


@hot
def _sample(world, t, c, d, clockwork, qpos, qvel, effort, out):
    j = t.chip_axis
    net = cores.net(c, j)
    v = qvel[t.dof]
    q = qpos[t.qpos] - v * clockwork.half
    theta = q * t.gear
    out.time = world.now / SECOND
    out.position, out.velocity = q, v
    out.commanded = q + drive.behind(d, net, theta) / t.gear
    out.load_angle, out.torque = stepper.load_angle(d, net, theta), drive.torque(d, effort)
    out.voltage = drive.voltage(d, effort)
    out.current_a, out.current_b = d.current_a, d.current_b
    out.rate = cores.pulse_rate(c, j, c.hz)
    out.pulses, out.counter = net, cores.counter(c, j)
    out.lost_steps = drive.lost_steps(d, net, theta)
    out.inputs, out.outputs = cores.inputs(c, j), cores.outputs(c, j)


@hot
def unguarded(clockwork):
    """MuJoCo would call a Python callback whose exceptions are not guarded."""
    if not clockwork.guarded:
        for k in range(CALLBACKS):
            if array_at(clockwork.callbacks[k], 1, ADDRESS)[0] != clockwork.native[k]:
                return True
    return False


@hot
def run(
    model, data, world_, axes, drives, switches, table, switch_table, chips, clockwork_,
    qpos, qvel, ctrl, sensordata, inertia, until, samples, positions, n_samples, edges, n_edges, counts, state,
):  # fmt: skip
    """Run up to `until` ns. Returns why it returned (REACHED, ...); counts[0], counts[1] = samples and edges written.

    model, data: addresses. chips: CHIP_TABLE. inertia: (nv,), kg or kg m^2 that each degree of freedom moves. samples:
    (capacity, axes) SAMPLE; positions: (capacity, nq) float64; edges: EDGE. Empty arrays log nothing. state: address (0: none) that
    takes the state as it is before the physics.
    """
    world, clockwork = world_[0], clockwork_[0]
    status, counts[0], counts[1] = REACHED, n_samples, n_edges
    if not world.powered:
        return WIPED
    if world.start + clockwork.dt <= until:
        if unguarded(clockwork):
            return UNGUARDED
        if state:
            _get_state(clockwork.mj_get_state, (model, data, state, clockwork.state_spec))
    while world.now < until:
        end = world.start + clockwork.dt
        stop = least(until, end)
        k = _run_chips(chips, world, axes, table, switches, switch_table, stop, clockwork, edges, counts)
        world.now = stop
        world.slice = k
        if stop < end:
            break
        if clockwork.currents:
            _set_currents(chips, drives, table)
        for a in range(len(axes)):
            t = table[a]
            omega = qvel[t.dof] * t.gear
            gain = clockwork.half * t.gear * t.gear / inertia[t.dof]
            ctrl[t.actuator] = drive.effort(
                drives[a], axes[a].counts, clockwork.slices, qpos[t.qpos] * t.gear, omega, clockwork.h, gain
            )
        _step(clockwork.mj_step, (model, data))
        world.slice = 0
        world.start += clockwork.dt
        world.steps += 1
        for k in range(clockwork.nv):
            if not abs(qvel[k]) < MAX_SPEED:
                status = DIVERGED
        if clockwork.failed:
            status = FAILED
        if status != REACHED:
            break
        foresee(world, axes, table, switches, switch_table, clockwork, sensordata, qpos, qvel, True)
        if clockwork.encoders:
            counts[1] = _show_shafts(chips, world, table, clockwork, qpos, qvel, edges, counts)
        if clockwork.loads:
            counts[1] = _show_loads(chips, world, axes, drives, table, clockwork, qpos, qvel, edges, counts)
        if clockwork.sample_every and n_samples < len(samples):
            world.to_sample -= 1
            if world.to_sample <= 0:
                world.to_sample = clockwork.sample_every
                for a in range(len(axes)):
                    t = table[a]
                    c, out, effort = chips[t.chip], samples[n_samples, a], ctrl[t.actuator]
                    _sample(world, t, c, drives[a], clockwork, qpos, qvel, effort, out)
                for i in range(len(qpos)):
                    positions[n_samples, i] = qpos[i]
                n_samples += 1
                if n_samples == len(samples):
                    status = SAMPLES_FULL
                    break
        if len(edges) and counts[1] > len(edges) - clockwork.most_edges:
            status = EDGES_FULL
            break
    counts[0] = n_samples
    return status


@hot
def look_again(world_, axes, switches, table, switch_table, chips, clockwork_, qpos, qvel, a, edges, n_edges):
    """A fault of axis `a`'s switches has come or gone, at any moment in a window: their levels now, their edges in the rest
    of it. Returns how many edges are noted.
    """
    world, axis, t = world_[0], axes[a], table[a]
    axis.next_edge, axis.awake = axis.index_edge if t.index_bit else NEVER, 1
    for k in range(t.first_switch, t.end_switch):
        if switch_table[k].forced >= 0:
            switches[k].toggles = 0
        predict_switch(world, axis, clockwork_[0], switches[k], switch_table[k], qpos[t.qpos], qvel[t.dof])
    return meet_edges(chips[t.chip], axes, table, switches, switch_table, world.now, edges, n_edges)


@hot
def _settle_axis(c, world, axis, t, switches, switch_table, d, clockwork, qpos, qvel):
    if t.counts != 0.0:
        count, speed = _shaft(world, t, clockwork, qpos, qvel)
        cores.set_shaft(c, t.chip_axis, count, speed / c.hz)
    axis.next_edge = NEVER
    axis.count = cores.net(c, t.chip_axis)
    for k in range(SLICES):
        axis.counts[k] = drive.at_rest(d, axis.count)
    for k in range(t.first_switch, t.end_switch):
        s, row = switches[k], switch_table[k]
        s.edge = s.next_edge = NEVER
        s.on = row.forced if row.forced >= 0 else (1 if in_flag(clockwork, s, row, qpos[t.qpos]) else 0)
    word = switched(t, switches, switch_table, cores.inputs(c, t.chip_axis))
    if t.index_bit:
        axis.index_edge = axis.index_end = NEVER
        axis.index_on = 1 if abs(off_index(t, qpos[t.qpos])) <= 0.5 * INDEX else 0
        word = indexed(t, axis, word)
    cores.set_input(c, t.chip_axis, word)
    if c.current:
        d.current = cores.current(c, t.chip_axis)
    drive.align(d, float(axis.count), qpos[t.qpos] * t.gear)


@hot
def settle(world_, axes, drives, switches, table, switch_table, chips, clockwork_, qpos, qvel, sensordata, edges):
    """Before the first window, or after the carriages were placed: finds switch levels and pending edges again."""
    world, clockwork = world_[0], clockwork_[0]
    world.powered = 1
    for k in range(len(switches)):
        s = switches[k]
        s.toggles, s.edge, s.shift = 0, NEVER, 0.0
    foresee(world, axes, table, switches, switch_table, clockwork, sensordata, qpos, qvel, False)
    for a in range(len(axes)):
        t = table[a]
        _settle_axis(chips[t.chip], world, axes[a], t, switches, switch_table, drives[a], clockwork, qpos, qvel)
    for i in range(len(chips)):
        if chips[i].link and _leads(chips, i):
            links.exchange(chips, chips[i].link, world.now, edges, len(edges))
