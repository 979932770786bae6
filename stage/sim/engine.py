"""The compiled loop of a stage: switches -> chips -> drives -> mj_step, many steps per call.

Time is an integer of nanoseconds. A physics step of dt is a *window* [start, start + dt) of chip time, cut into equal
slices. Every chip runs through the window (an input edge or a bus cycle may come at any time in it), and its mean pulse count
in each slice is stored. At the window's end every drive converts its counts to torque, slice by slice; the mean torque goes to
`ctrl`, and mj_step moves the stage.

MuJoCo's integrator is a leapfrog: positions belong to times t, velocities to half a step before. The force that it needs at a
position is the mean over the window centered at that time. So the position in `qpos` is that at the center of a window, not at its
start: at a chip time tau after the window's start a joint is at q + v (tau - dt / 2). Thus the coupling adds no false damping,
which would make the ringing of a stepper die out too fast, and a switch's edge is extrapolated by half a step only. The velocity at
the center depends on the force: a drive that needs it solves for it (`stepper.compute_mean_torque`); otherwise the coupling would
add energy.

All state is in records inside MjData.userdata, all tables of constants are in separate arrays; this module allocates no memory.
"""

from __future__ import annotations

from stage.chips import core_interface, linked_chips
from stage.chips.journal_entries import LOAD, SHAFT
from stage.drives import drive_dispatch, stepper
from stage.native import array_at, declare_address_call, exported, hot, least
from stage.sim.compiled_stage_access import (
    ENGINE_CLAIM_TOKEN,
    HANDLE,
    REAL,
    claim,
    get_axes,
    get_axis_table,
    get_chip_table,
    get_clockwork,
    get_drives,
    get_qpos,
    get_qvel,
    get_switch_table,
    get_switches,
    get_world,
    has_edge_room,
    log_edge,
    release,
    would_call_unguarded_callback,
)
from stage.sim.engine_records import (
    DIVERGED,
    EDGES_FULL,
    FAILED,
    IN_USE,
    INDEX,
    LOGGED_EDGE,
    MAX_JOINT_SPEED,
    NEVER,
    NS_PER_SECOND,
    REACHED,
    SAMPLE,
    SAMPLES_FULL,
    SLICES,
    UNGUARDED,
    WIPED,
    compute_clock_at,
)
from stage.sim.switch_edges import (
    find_next_edge,
    is_in_flag,
    journal_input,
    measure_index_offset,
    predict_switch_changes,
    predict_switch_edges,
    process_edges,
    set_index_bit,
    set_switch_bits,
)
from stage.sim.warm_start_prediction import apply_effort

_call_mj_step = declare_address_call(None, "i8", "i8")
_call_mj_get_state = declare_address_call(None, "i8", "i8", "i8", "i4")


@hot
def _run_chips(handle, stop_ns):
    """Run the chips up to the time `stop_ns`, inside the window, and return the number of slices that are complete."""
    w, rows, axis_records = get_world(handle), get_chip_table(handle), get_axes(handle)
    start, dt = w.start, get_clockwork(handle).dt
    hz = clock = rest = 0
    k = w.slice
    for i in range(len(rows)):
        chip = rows[i]
        if chip.link:
            if _is_first_linked_chip(rows, i):
                k = _run_linked_chips(handle, i, stop_ns)
            continue
        if core_interface.update_wired_input(chip):
            journal_input(handle, w.now, chip, 0)
        if chip.hz != hz:
            hz = chip.hz
            clock, rest = compute_clock_at(start, hz), start % NS_PER_SECOND * hz % NS_PER_SECOND
        k, now = w.slice, 0
        if stop_ns == start + dt and find_next_edge(axis_records, chip) > stop_ns:
            chip.begin, chip.rest = clock, rest
            core_interface.run_window(chip, k)
            k = SLICES
            continue
        while now < stop_ns:
            bound = start + (k + 1) * dt // SLICES
            now = least(bound, stop_ns)
            if find_next_edge(axis_records, chip) <= now:
                process_edges(handle, chip, now)
            core_interface.run(chip, clock + (rest + (now - start) * hz) // NS_PER_SECOND)
            if now == bound:
                _store_slice_counts(chip, axis_records, k)
                k += 1
    return k


@hot
def _store_slice_counts(chip, axis_records, slice_index):
    """Store the mean pulse counts of a chip's axes in slice `slice_index`, which ends now."""
    for j in range(chip.axes):
        axis = axis_records[core_interface.find_stage_axis(chip, j)]
        axis.counts[slice_index] = core_interface.compute_drive_input(chip, j, axis.count, chip.ticks)
        axis.count = core_interface.read_net_count(chip, j)


@hot
def _is_first_linked_chip(rows, chip_index):
    """Return whether chip `chip_index` is the first of those that are linked to it."""
    m = 0
    while rows[m].link != rows[chip_index].link:
        m += 1
    return m == chip_index


@hot
def _run_linked_chips(handle, first_chip, stop_ns):
    """Run the chips that are linked to the first one, as `_run_chips` does. An edge of one chip acts on all at its clock."""
    w = get_world(handle)
    rows = get_chip_table(handle)
    axis_records = get_axes(handle)
    edges = array_at(handle.edges, handle.edge_room, LOGGED_EDGE)
    start, dt, link, hz = w.start, get_clockwork(handle).dt, rows[first_chip].link, rows[first_chip].hz
    k, now = w.slice, 0
    while now < stop_ns:
        bound = start + (k + 1) * dt // SLICES
        now = least(bound, stop_ns)
        while True:
            edge = now + 1
            for i in range(first_chip, len(rows)):
                if rows[i].link == link:
                    edge = least(edge, find_next_edge(axis_records, rows[i]))
            at = least(edge, now)
            handle.noted = linked_chips.run_linked_chips(rows, link, compute_clock_at(at, hz), at, edges, handle.noted)
            if edge > now:
                break
            for i in range(first_chip, len(rows)):
                if rows[i].link == link and find_next_edge(axis_records, rows[i]) <= edge:
                    process_edges(handle, rows[i], edge)
        if now == bound:
            for i in range(first_chip, len(rows)):
                if rows[i].link == link:
                    _store_slice_counts(rows[i], axis_records, k)
            k += 1
    return k


@hot
def _read_shaft(handle, axis_row):
    """Return the present count of an axis' encoder, and its speed in counts per second."""
    w, v = get_world(handle), get_qvel(handle)[axis_row.dof]
    tau = float(w.now - w.start) / NS_PER_SECOND - get_clockwork(handle).half
    return (get_qpos(handle)[axis_row.qpos] + v * tau) * axis_row.counts, v * axis_row.counts


@hot
def _pass_shafts_to_chips(handle):
    """Pass position and speed of the encoders' shafts to the chips that count them, at the beginning of a window."""
    rows = get_chip_table(handle)
    for i in range(len(rows)):
        chip = rows[i]
        for j in range(chip.axes):
            a = core_interface.find_stage_axis(chip, j)
            if get_axis_table(handle)[a].counts == 0.0:
                continue
            count, speed = _read_shaft(handle, get_axis_table(handle)[a])
            core_interface.set_shaft(chip, j, count, speed / chip.hz)
            if has_edge_room(handle):
                e = log_edge(handle, get_world(handle).now, chip, a, SHAFT, j, 0)
                e.count, e.rate = count, speed / chip.hz


@hot
def _pass_loads_to_chips(handle):
    """Pass the loads of the motors to the chips that drive them, at the beginning of a window."""
    rows, half = get_drives(handle), get_clockwork(handle).half
    for a in range(len(rows)):
        t, d = get_axis_table(handle)[a], rows[a]
        chip = get_chip_table(handle)[t.chip]
        if chip.set_load == 0:
            continue
        v = get_qvel(handle)[t.dof]
        angle = drive_dispatch.compute_load_angle(
            d, core_interface.read_net_count(chip, t.chip_axis), (get_qpos(handle)[t.qpos] - v * half) * t.gear
        )
        share = d.torque_constant * abs(v * t.gear) / d.voltage
        if core_interface.set_load(chip, t.chip_axis, angle, share) and has_edge_room(handle):
            e = log_edge(handle, get_world(handle).now, chip, a, LOAD, t.chip_axis, 0)
            e.count, e.rate = angle, share


@hot
def _read_motor_currents(handle):
    """Read the amplitudes of the phase currents from the chips that set the currents of their motors."""
    rows = get_drives(handle)
    for a in range(len(rows)):
        t = get_axis_table(handle)[a]
        chip = get_chip_table(handle)[t.chip]
        if chip.read_motor_current:
            rows[a].current = core_interface.read_motor_current(chip, t.chip_axis)


@hot
def _write_axis_sample(handle, axis_index, effort, sample):
    """Write the present state of axis `axis_index` into a SAMPLE record."""
    t, d = get_axis_table(handle)[axis_index], get_drives(handle)[axis_index]
    chip, j = get_chip_table(handle)[t.chip], t.chip_axis
    net = core_interface.read_net_count(chip, j)
    v = get_qvel(handle)[t.dof]
    q = get_qpos(handle)[t.qpos] - v * get_clockwork(handle).half
    theta = q * t.gear
    sample.time = get_world(handle).now / NS_PER_SECOND
    sample.position, sample.velocity = q, v
    sample.commanded = q + drive_dispatch.compute_lag(d, net, theta) / t.gear
    sample.load_angle = stepper.compute_load_angle(d, net, theta)
    sample.torque = drive_dispatch.compute_torque(d, effort)
    sample.voltage = drive_dispatch.compute_voltage(d, effort)
    sample.current_a, sample.current_b = d.current_a, d.current_b
    sample.rate = core_interface.read_pulse_rate(chip, j, chip.hz)
    sample.pulses, sample.counter = net, core_interface.read_counter(chip, j)
    sample.lost_steps = drive_dispatch.count_lost_steps(d, net, theta)
    sample.inputs, sample.outputs = core_interface.read_inputs(chip, j), core_interface.read_outputs(chip, j)


@hot
def _write_samples(handle, ctrl):
    """Write the present state of all axes into the next row of samples."""
    samples = array_at(handle.samples, (handle.room, handle.n_axes), SAMPLE)
    positions = array_at(handle.positions, (handle.room, handle.nq), REAL)
    for a in range(handle.n_axes):
        _write_axis_sample(handle, a, ctrl[get_axis_table(handle)[a].actuator], samples[handle.filled, a])
    for i in range(handle.nq):
        positions[handle.filled, i] = get_qpos(handle)[i]
    handle.filled += 1


@hot
def _run_until(handle, until_ns):
    """Let the stage's time pass up to `until_ns`, and return why the run ended (REACHED, ...)."""
    w = get_world(handle)
    clock = get_clockwork(handle)
    axis_records = get_axes(handle)
    table = get_axis_table(handle)
    rows = get_drives(handle)
    positions, speeds = get_qpos(handle), get_qvel(handle)
    ctrl, inertia = array_at(handle.ctrl, handle.nu, REAL), array_at(handle.inertia, handle.nv, REAL)
    accelerations, damping = array_at(handle.accelerations, handle.nv, REAL), array_at(handle.damping, handle.nv, REAL)
    core_loss = array_at(handle.core_loss, handle.nu, REAL)
    if not w.powered:
        return WIPED
    if w.start + clock.dt <= until_ns:
        if would_call_unguarded_callback(clock):
            return UNGUARDED
        if handle.state:
            _call_mj_get_state(clock.mj_get_state, (handle.mj_model, handle.mj_data, handle.state, clock.state_spec))
    while w.now < until_ns:
        end = w.start + clock.dt
        stop = least(until_ns, end)
        k = _run_chips(handle, stop)
        w.now = stop
        w.slice = k
        if stop < end:
            break
        if clock.currents:
            _read_motor_currents(handle)
        for a in range(len(axis_records)):
            apply_effort(
                clock, axis_records[a], table[a], rows[a], positions, speeds,
                ctrl, accelerations, inertia, damping, core_loss,
            )  # fmt: skip
        _call_mj_step(clock.mj_step, (handle.mj_model, handle.mj_data))
        w.slice = 0
        w.start += clock.dt
        w.steps += 1
        diverged = False
        for k in range(clock.nv):
            if not abs(speeds[k]) < MAX_JOINT_SPEED:
                diverged = True
        if clock.failed:
            return FAILED
        if diverged:
            return DIVERGED
        predict_switch_edges(handle, True)
        if clock.encoders:
            _pass_shafts_to_chips(handle)
        if clock.loads:
            _pass_loads_to_chips(handle)
        if clock.sample_every and handle.filled < handle.room:
            w.to_sample -= 1
            if w.to_sample <= 0:
                w.to_sample = clock.sample_every
                _write_samples(handle, ctrl)
                if handle.filled == handle.room:
                    return SAMPLES_FULL
        if handle.edge_room and handle.noted > handle.edge_room - clock.most_edges:
            return EDGES_FULL
    return REACHED


@exported("i8", HANDLE, "i8")
def advance(handle, until_ns):
    """Let the stage's time pass up to `until_ns` nanoseconds since power-up, unless the engine has to stop earlier.

    Edges and samples go to the buffers of the handle. If the run is undone, its edges and samples are removed again.

    Returns:
        Reason of the stop (REACHED, ...).
    """
    if not claim(handle.clockwork, ENGINE_CLAIM_TOKEN):
        return IN_USE
    filled, noted = handle.filled, handle.noted
    status = _run_until(handle, until_ns)
    if status in (DIVERGED, FAILED):
        handle.filled, handle.noted = filled, noted
    handle.status = status
    release(handle.clockwork, ENGINE_CLAIM_TOKEN)
    return status


@exported("i8", HANDLE)
def has_unguarded_callback(handle):
    """Return 1 if MuJoCo has a Python callback whose exceptions are not guarded now."""
    return 1 if would_call_unguarded_callback(get_clockwork(handle)) else 0


@exported("i8", HANDLE, "i8")
def claim_stage(handle, token):
    """Claim a stage for one thread, and return 1 if the stage was free. Others cannot run it until `release_stage(token)`."""
    return 1 if claim(handle.clockwork, token) else 0


@exported(None, HANDLE, "i8")
def release_stage(handle, token):
    """Release a stage that was claimed with this token."""
    release(handle.clockwork, token)


@exported(None, HANDLE, "i8")
def update_switches(handle, axis_index):
    """Apply a switch fault of an axis that begins or ends within a physics step: set the levels, and predict later edges."""
    axis, t = get_axes(handle)[axis_index], get_axis_table(handle)[axis_index]
    axis.next_edge, axis.awake = axis.index_edge if t.index_bit else NEVER, 1
    for k in range(t.first_switch, t.end_switch):
        if get_switch_table(handle)[k].forced >= 0:
            get_switches(handle)[k].toggles = 0
        q, v = get_qpos(handle)[t.qpos], get_qvel(handle)[t.dof]
        predict_switch_changes(
            get_world(handle), axis, get_clockwork(handle), get_switches(handle)[k], get_switch_table(handle)[k], q, v
        )
    process_edges(handle, get_chip_table(handle)[t.chip], get_world(handle).now)


@hot
def _set_axis_switch_levels(handle, axis_index):
    """Set the levels of the switches of one axis, and pass its inputs to its chip."""
    axis, t, d = get_axes(handle)[axis_index], get_axis_table(handle)[axis_index], get_drives(handle)[axis_index]
    chip, q = get_chip_table(handle)[t.chip], get_qpos(handle)[t.qpos]
    if t.counts != 0.0:
        count, speed = _read_shaft(handle, t)
        core_interface.set_shaft(chip, t.chip_axis, count, speed / chip.hz)
    axis.next_edge = NEVER
    axis.speed = get_qvel(handle)[t.dof]
    axis.count = core_interface.read_net_count(chip, t.chip_axis)
    for k in range(SLICES):
        axis.counts[k] = drive_dispatch.make_rest_signal(d, axis.count)
    for k in range(t.first_switch, t.end_switch):
        s, row = get_switches(handle)[k], get_switch_table(handle)[k]
        s.edge = s.next_edge = NEVER
        s.on = row.forced if row.forced >= 0 else (1 if is_in_flag(get_clockwork(handle), s, row, q) else 0)
    word = set_switch_bits(
        t, get_switches(handle), get_switch_table(handle), core_interface.read_inputs(chip, t.chip_axis)
    )
    if t.index_bit:
        axis.index_edge = axis.index_end = NEVER
        axis.index_on = 1 if abs(measure_index_offset(t, q)) <= 0.5 * INDEX else 0
        word = set_index_bit(t, axis, word)
    core_interface.set_input(chip, t.chip_axis, word)
    if chip.read_motor_current:
        d.current = core_interface.read_motor_current(chip, t.chip_axis)
    drive_dispatch.power_up(d, float(axis.count), q * t.gear)


@exported(None, HANDLE)
def set_switch_levels(handle):
    """Set the levels of all switches and predict their edges, before the first window or after the carriages were placed."""
    get_world(handle).powered = 1
    for k in range(handle.n_switches):
        s = get_switches(handle)[k]
        s.toggles, s.edge, s.shift = 0, NEVER, 0.0
    predict_switch_edges(handle, False)
    for a in range(handle.n_axes):
        _set_axis_switch_levels(handle, a)
    rows = get_chip_table(handle)
    for i in range(len(rows)):
        if rows[i].link and _is_first_linked_chip(rows, i):
            linked_chips.exchange_wire_words(
                rows, rows[i].link, get_world(handle).now, array_at(handle.edges, 0, LOGGED_EDGE), 0
            )
