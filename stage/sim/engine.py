"""The one compiled loop: switches -> chips -> drives -> mj_step, many steps per call.

Time is an integer of nanoseconds. A physics step of dt is a *window* [start, start + dt) of chip time, cut into equal
slices. Every chip runs through the window (an input edge or a bus cycle may fall anywhere inside), and its mean pulse count
in each slice is kept. At the window's end every drive turns its counts into torque, slice by slice; the mean goes to
`ctrl`, and mj_step moves the stage.

MuJoCo's integrator is a leapfrog: positions belong to times t, velocities to half a step before. The force that it needs at a
position is the mean over the window centred there. So the position in `qpos` is that of a window's centre, not of its start: at a
chip time tau after the window's start a joint is at q + v (tau - dt / 2). With this the coupling adds no false damping (the ringing
of a stepper would die out too fast), and a switch's edge is extrapolated by half a step only. The velocity at the centre is not
known before the force is: a drive that needs it solves for it (`stepper.compute_mean_torque`), or the coupling would add energy.

All state is in records inside MjData.userdata, all tables of constants in arrays beside it; nothing here allocates.
"""

from __future__ import annotations

from stage.chips import cores, links
from stage.chips.entries import LOAD, SHAFT
from stage.drives import drive, stepper
from stage.native import array_at, called, exported, hot, least
from stage.sim.edges import (
    apply_index_pulse,
    apply_switches,
    find_next_edge,
    is_in_flag,
    journal_input,
    measure_index_offset,
    predict_edges,
    predict_switch,
    process_edges,
)
from stage.sim.handle import (
    ENGINE,
    HANDLE,
    REAL,
    axes,
    axis_table,
    chip_table,
    claim,
    clockwork,
    drives,
    has_edge_room,
    note_edge,
    qpos,
    qvel,
    release,
    switch_table,
    switches,
    world,
)
from stage.sim.records import (
    ADDRESS,
    CALLBACKS,
    DIVERGED,
    EDGE,
    EDGES_FULL,
    FAILED,
    IN_USE,
    INDEX,
    MAX_SPEED,
    NEVER,
    REACHED,
    SAMPLE,
    SAMPLES_FULL,
    SECOND,
    SLICES,
    UNGUARDED,
    WIPED,
    clock_at,
)
from stage.sim.warm_start import apply_effort

_step = called(None, "i8", "i8")
_get_state = called(None, "i8", "i8", "i8", "i4")


@hot
def _run_chips(h, stop):
    """Run the chips up to `stop` ns, inside the window, and return the slices done."""
    w, rows, axis_records = world(h), chip_table(h), axes(h)
    start, dt = w.start, clockwork(h).dt
    hz = clock = rest = 0
    k = w.slice
    for i in range(len(rows)):
        c = rows[i]
        if c.link:
            if _is_first_linked_chip(rows, i):
                k = _run_linked(h, i, stop)
            continue
        if cores.update_wired_input(c):
            journal_input(h, w.now, c, 0)
        if c.hz != hz:
            hz = c.hz
            clock, rest = clock_at(start, hz), start % SECOND * hz % SECOND
        k, now = w.slice, 0
        if stop == start + dt and find_next_edge(axis_records, c) > stop:
            c.begin, c.rest = clock, rest
            cores.window(c, k)
            k = SLICES
            continue
        while now < stop:
            bound = start + (k + 1) * dt // SLICES
            now = least(bound, stop)
            if find_next_edge(axis_records, c) <= now:
                process_edges(h, c, now)
            cores.run(c, clock + (rest + (now - start) * hz) // SECOND)
            if now == bound:
                _store_slice_counts(c, axis_records, k)
                k += 1
    return k


@hot
def _store_slice_counts(c, axis_records, k):
    """Keep the axes' mean counts in slice `k`, which ends now."""
    for j in range(c.axes):
        axis = axis_records[cores.axis_of(c, j)]
        axis.counts[k] = cores.drive_input(c, j, axis.count, c.ticks)
        axis.count = cores.net(c, j)


@hot
def _is_first_linked_chip(rows, i):
    """Return whether chip `i` is the first of those that are linked to it."""
    m = 0
    while rows[m].link != rows[i].link:
        m += 1
    return m == i


@hot
def _run_linked(h, first, stop):
    """Run the chips that are linked to the first one, as `_run_chips`: an edge of one acts on all at its clock."""
    w, rows, axis_records, edges = world(h), chip_table(h), axes(h), array_at(h.edges, h.edge_room, EDGE)
    start, dt, link, hz = w.start, clockwork(h).dt, rows[first].link, rows[first].hz
    k, now = w.slice, 0
    while now < stop:
        bound = start + (k + 1) * dt // SLICES
        now = least(bound, stop)
        while True:
            edge = now + 1
            for i in range(first, len(rows)):
                if rows[i].link == link:
                    edge = least(edge, find_next_edge(axis_records, rows[i]))
            at = least(edge, now)
            h.noted = links.run_linked_chips(rows, link, clock_at(at, hz), at, edges, h.noted)
            if edge > now:
                break
            for i in range(first, len(rows)):
                if rows[i].link == link and find_next_edge(axis_records, rows[i]) <= edge:
                    process_edges(h, rows[i], edge)
        if now == bound:
            for i in range(first, len(rows)):
                if rows[i].link == link:
                    _store_slice_counts(rows[i], axis_records, k)
            k += 1
    return k


@hot
def _read_shaft(h, t):
    """Return the present count of an axis' encoder, and its speed, counts a second."""
    w, v = world(h), qvel(h)[t.dof]
    tau = float(w.now - w.start) / SECOND - clockwork(h).half
    return (qpos(h)[t.qpos] + v * tau) * t.counts, v * t.counts


@hot
def _pass_shafts_to_chips(h):
    """Pass the shafts to the chips that count them, at the beginning of a window."""
    rows = chip_table(h)
    for i in range(len(rows)):
        c = rows[i]
        for j in range(c.axes):
            a = cores.axis_of(c, j)
            if axis_table(h)[a].counts == 0.0:
                continue
            count, speed = _read_shaft(h, axis_table(h)[a])
            cores.set_shaft(c, j, count, speed / c.hz)
            if has_edge_room(h):
                e = note_edge(h, world(h).now, c, a, SHAFT, j, 0)
                e.count, e.rate = count, speed / c.hz


@hot
def _pass_loads_to_chips(h):
    """Pass the loads of the motors to the chips that drive them, at the beginning of a window."""
    rows, half = drives(h), clockwork(h).half
    for a in range(len(rows)):
        t, d = axis_table(h)[a], rows[a]
        c = chip_table(h)[t.chip]
        if c.set_load == 0:
            continue
        v = qvel(h)[t.dof]
        angle = drive.compute_load_angle(d, cores.net(c, t.chip_axis), (qpos(h)[t.qpos] - v * half) * t.gear)
        share = d.torque_constant * abs(v * t.gear) / d.voltage
        if cores.set_load(c, t.chip_axis, angle, share) and has_edge_room(h):
            e = note_edge(h, world(h).now, c, a, LOAD, t.chip_axis, 0)
            e.count, e.rate = angle, share


@hot
def _read_motor_currents(h):
    """Take the currents of the motors whose chips set them."""
    rows = drives(h)
    for a in range(len(rows)):
        t = axis_table(h)[a]
        c = chip_table(h)[t.chip]
        if c.current:
            rows[a].current = cores.current(c, t.chip_axis)


@hot
def _write_axis_sample(h, a, effort, out):
    """Write axis `a` as it is now into a SAMPLE."""
    t, d = axis_table(h)[a], drives(h)[a]
    c, j = chip_table(h)[t.chip], t.chip_axis
    net = cores.net(c, j)
    v = qvel(h)[t.dof]
    q = qpos(h)[t.qpos] - v * clockwork(h).half
    theta = q * t.gear
    out.time = world(h).now / SECOND
    out.position, out.velocity = q, v
    out.commanded = q + drive.compute_lag(d, net, theta) / t.gear
    out.load_angle, out.torque = stepper.compute_load_angle(d, net, theta), drive.compute_torque(d, effort)
    out.voltage = drive.compute_voltage(d, effort)
    out.current_a, out.current_b = d.current_a, d.current_b
    out.rate = cores.pulse_rate(c, j, c.hz)
    out.pulses, out.counter = net, cores.counter(c, j)
    out.lost_steps = drive.count_lost_steps(d, net, theta)
    out.inputs, out.outputs = cores.inputs(c, j), cores.outputs(c, j)


@hot
def _write_samples(h, ctrl):
    """Write all axes as they are now into the next row of samples."""
    samples = array_at(h.samples, (h.room, h.n_axes), SAMPLE)
    positions = array_at(h.positions, (h.room, h.nq), REAL)
    for a in range(h.n_axes):
        _write_axis_sample(h, a, ctrl[axis_table(h)[a].actuator], samples[h.filled, a])
    for i in range(h.nq):
        positions[h.filled, i] = qpos(h)[i]
    h.filled += 1


@hot
def _would_call_unguarded_callback(clock):
    """Return whether MuJoCo would call a Python callback whose exceptions are not guarded."""
    if not clock.guarded:
        for k in range(CALLBACKS):
            if array_at(clock.callbacks[k], 1, ADDRESS)[0] != clock.native[k]:
                return True
    return False


@hot
def _run_until(h, until):
    """Run up to `until` ns and return why it returned (REACHED, ...)."""
    w, clock, axis_records, table, rows = world(h), clockwork(h), axes(h), axis_table(h), drives(h)
    positions, speeds = qpos(h), qvel(h)
    ctrl, inertia = array_at(h.ctrl, h.nu, REAL), array_at(h.inertia, h.nv, REAL)
    accelerations, damping = array_at(h.accelerations, h.nv, REAL), array_at(h.damping, h.nv, REAL)
    core_loss = array_at(h.core_loss, h.nu, REAL)
    if not w.powered:
        return WIPED
    if w.start + clock.dt <= until:
        if _would_call_unguarded_callback(clock):
            return UNGUARDED
        if h.state:
            _get_state(clock.mj_get_state, (h.mj_model, h.mj_data, h.state, clock.state_spec))
    while w.now < until:
        end = w.start + clock.dt
        stop = least(until, end)
        k = _run_chips(h, stop)
        w.now = stop
        w.slice = k
        if stop < end:
            break
        if clock.currents:
            _read_motor_currents(h)
        for a in range(len(axis_records)):
            apply_effort(
                clock, axis_records[a], table[a], rows[a], positions, speeds,
                ctrl, accelerations, inertia, damping, core_loss,
            )  # fmt: skip
        _step(clock.mj_step, (h.mj_model, h.mj_data))
        w.slice = 0
        w.start += clock.dt
        w.steps += 1
        diverged = False
        for k in range(clock.nv):
            if not abs(speeds[k]) < MAX_SPEED:
                diverged = True
        if clock.failed:
            return FAILED
        if diverged:
            return DIVERGED
        predict_edges(h, True)
        if clock.encoders:
            _pass_shafts_to_chips(h)
        if clock.loads:
            _pass_loads_to_chips(h)
        if clock.sample_every and h.filled < h.room:
            w.to_sample -= 1
            if w.to_sample <= 0:
                w.to_sample = clock.sample_every
                _write_samples(h, ctrl)
                if h.filled == h.room:
                    return SAMPLES_FULL
        if h.edge_room and h.noted > h.edge_room - clock.most_edges:
            return EDGES_FULL
    return REACHED


@exported("i8", HANDLE, "i8")
def advance(h, until):
    """Let the stage's time pass up to `until` ns, unless the engine has to stop before.

    It logs where the handle says. Of a run that is undone nothing stays logged.

    Returns:
        Why it stopped (REACHED, ...).
    """
    if not claim(h.clockwork, ENGINE):
        return IN_USE
    filled, noted = h.filled, h.noted
    status = _run_until(h, until)
    if status in (DIVERGED, FAILED):
        h.filled, h.noted = filled, noted
    h.status = status
    release(h.clockwork, ENGINE)
    return status


@exported("i8", HANDLE)
def has_unguarded_callback(h):
    """Return 1 if MuJoCo has a Python callback whose exceptions are not guarded now."""
    return 1 if _would_call_unguarded_callback(clockwork(h)) else 0


@exported("i8", HANDLE, "i8")
def claim_stage(h, token):
    """Return 1 if the stage was free: no other thread can run it until `release_stage` with this token."""
    return 1 if claim(h.clockwork, token) else 0


@exported(None, HANDLE, "i8")
def release_stage(h, token):
    """End a claim with this token."""
    release(h.clockwork, token)


@exported(None, HANDLE, "i8")
def update_switches(h, a):
    """Apply a fault of axis `a`'s switches that begins or ends at any moment of a window: levels now, edges in the rest of it."""
    axis, t = axes(h)[a], axis_table(h)[a]
    axis.next_edge, axis.awake = axis.index_edge if t.index_bit else NEVER, 1
    for k in range(t.first_switch, t.end_switch):
        if switch_table(h)[k].forced >= 0:
            switches(h)[k].toggles = 0
        q, v = qpos(h)[t.qpos], qvel(h)[t.dof]
        predict_switch(world(h), axis, clockwork(h), switches(h)[k], switch_table(h)[k], q, v)
    process_edges(h, chip_table(h)[t.chip], world(h).now)


@hot
def _find_axis_switch_levels(h, a):
    axis, t, d = axes(h)[a], axis_table(h)[a], drives(h)[a]
    c, q = chip_table(h)[t.chip], qpos(h)[t.qpos]
    if t.counts != 0.0:
        count, speed = _read_shaft(h, t)
        cores.set_shaft(c, t.chip_axis, count, speed / c.hz)
    axis.next_edge = NEVER
    axis.speed = qvel(h)[t.dof]
    axis.count = cores.net(c, t.chip_axis)
    for k in range(SLICES):
        axis.counts[k] = drive.make_rest_signal(d, axis.count)
    for k in range(t.first_switch, t.end_switch):
        s, row = switches(h)[k], switch_table(h)[k]
        s.edge = s.next_edge = NEVER
        s.on = row.forced if row.forced >= 0 else (1 if is_in_flag(clockwork(h), s, row, q) else 0)
    word = apply_switches(t, switches(h), switch_table(h), cores.inputs(c, t.chip_axis))
    if t.index_bit:
        axis.index_edge = axis.index_end = NEVER
        axis.index_on = 1 if abs(measure_index_offset(t, q)) <= 0.5 * INDEX else 0
        word = apply_index_pulse(t, axis, word)
    cores.set_input(c, t.chip_axis, word)
    if c.current:
        d.current = cores.current(c, t.chip_axis)
    drive.power_up(d, float(axis.count), q * t.gear)


@exported(None, HANDLE)
def find_switch_levels(h):
    """Find switch levels and pending edges, before the first window, or after the carriages were placed."""
    world(h).powered = 1
    for k in range(h.n_switches):
        s = switches(h)[k]
        s.toggles, s.edge, s.shift = 0, NEVER, 0.0
    predict_edges(h, False)
    for a in range(h.n_axes):
        _find_axis_switch_levels(h, a)
    rows = chip_table(h)
    for i in range(len(rows)):
        if rows[i].link and _is_first_linked_chip(rows, i):
            links.exchange_words(rows, rows[i].link, world(h).now, array_at(h.edges, 0, EDGE), 0)
