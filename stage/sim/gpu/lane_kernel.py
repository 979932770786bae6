"""Program of a lane, which is one chip of one copy with its axes, for one physics step: a thread of the GPU kernel.

    kernel      see what physics did; play the host's program and run the chip up to the window's end; give physics the torques
    mj_step     of all copies, by mujoco-warp; and so on

Every lane of a copy plays the same program by itself, with the bus cycles of its own chip. Only polls need the other lanes: each
polls its own axes, and the lanes of a warp tell each other which are in motion. All of it happens at the times, and in the order,
of `stage.sim.program_player` and `stage.sim.engine`, so chips that see the same edges are the same to the bit.

A copy whose program has ended stands still, perhaps within a window: mujoco-warp still moves it, and the kernel restores its state.
"""

from __future__ import annotations

import math
from typing import Any

from stage.chips import core_interface
from stage.drives import drive_dispatch
from stage.sim.engine_records import AXIS, MAX_JOINT_SPEED, NS_PER_SECOND, SLICES, STAGE_TIME, SWITCH, compute_clock_at
from stage.sim.gpu.gpu_compilation import LaneChip
from stage.sim.gpu.lane_memory_layout import PLAYING, PROGRAM_STATE, THREADS_PER_WARP
from stage.sim.program import AWAIT_STOP, AWAIT_STOP_OR_LOST_STEP, END, MEASURE, READ, SAMPLE_POSITION, WRITE
from stage.sim.program_player import DIVERGED, PLAYED, inspect_axis
from stage.sim.switch_edges import find_next_edge, predict_axis_switch_edges, process_axis_edges
from stage.sim.warm_start_prediction import apply_effort

LOST_STEP_BIT = 1 << 62
"""Bit beside those of the axes in motion: AWAIT_STOP_OR_LOST_STEP has found a lost step."""

STATE: Any = None
DRIVE: Any = None
LANES = AXES = SWITCHES = BUS = 1
W_STATE = W_AXES = W_DRIVES = W_SWITCHES = W_WORLD = W_HOST = 1
HAS_ENCODERS = False
is_any_true_in_warp: Any = None
read_value_in_warp: Any = None
get_thread_number: Any = None
view_as_words: Any = None
cuda: Any = None
"""`DeviceModules.module` gives these: records, sizes and their words (W_), ns of a bus cycle, functions of the GPU."""


def load_records(records, words, row, thread):
    """Copy a lane's words from the array of all lanes to records of its own."""
    for k in range(records.shape[0]):
        records[k] = words[row + k, thread]


def store_records(records, words, row, thread):
    """Copy a lane's own records back to its words in the array of all lanes."""
    for k in range(records.shape[0]):
        words[row + k, thread] = records[k]


def run_chip(chip, axes, table, switches, switch_table, world, window_ns, slice_index, now, stop):
    """Run the chip of a lane and its switches from `now` to `stop` ns, within a window (the time of a physics step).

    Args:
        chip: The lane's chip.
        axes: AXIS records of its axes.
        table: AXIS_ROW records of its axes.
        switches: SWITCH records of its switches.
        switch_table: SWITCH_ROW records of its switches.
        world: WORLD record of the lane.
        window_ns: Length of a window, ns.
        slice_index: Slice of the window in which `now` is.
        now: Time at which the run begins, ns.
        stop: Time at which it ends, ns.

    Returns:
        The slice in which `stop` is.
    """
    start, hz, edge = world.start, chip.hz, find_next_edge(axes, chip)
    clock, rest = compute_clock_at(start, hz), start % NS_PER_SECOND * hz % NS_PER_SECOND
    while now < stop:
        bound = start + (slice_index + 1) * window_ns // SLICES
        now = min(min(bound, stop), max(edge, now))
        core_interface.run(chip, clock + (rest + (now - start) * hz) // NS_PER_SECOND)
        if edge <= now:
            for j in range(chip.axes):
                if axes[j].next_edge <= now:
                    process_axis_edges(axes[j], table[j], chip, j, switches, switch_table, now)
            edge = find_next_edge(axes, chip)
        if now == bound:
            for j in range(chip.axes):
                axis = axes[j]
                axis.counts[slice_index] = core_interface.compute_drive_input(chip, j, axis.count, chip.ticks)
                axis.count = core_interface.read_net_count(chip, j)
            slice_index += 1
    return slice_index


def begin_operation(host, now, kind, first_argument):
    """Begin an operation of a GPU copy's program at `now` ns: compute its end, and reset the extremes that it measures."""
    host.started, host.begin, host.left, host.poll, host.until = 1, now, first_argument, 0, now
    if kind in (WRITE, READ):
        host.until = now + BUS
    elif kind not in (AWAIT_STOP, AWAIT_STOP_OR_LOST_STEP, SAMPLE_POSITION):
        host.until = now + first_argument
    host.x0 = host.y0 = host.z0 = math.inf
    host.x1 = host.y1 = host.z1 = -math.inf


def end_operation(host):
    """Proceed to the next operation of a GPU copy's program."""
    host.started = 0
    host.op += 1


def read_point_coordinate(sites, bodies, copy, point, coordinate):
    """Return a coordinate of a measured point, see `stage.sim.program`."""
    return sites[copy, point - 1, coordinate] if point > 0 else bodies[copy, -point, coordinate]


def update_extremes(host, extremes, qpos, sites, bodies, copy, point):
    """Update the extremes of a copy's joint positions and of its measured point."""
    for k in range(qpos.shape[0]):
        extremes[k, 0], extremes[k, 1] = min(extremes[k, 0], float(qpos[k])), max(extremes[k, 1], float(qpos[k]))
    if point:
        x = read_point_coordinate(sites, bodies, copy, point, 0)
        y = read_point_coordinate(sites, bodies, copy, point, 1)
        z = read_point_coordinate(sites, bodies, copy, point, 2)
        host.x0, host.y0, host.z0 = min(host.x0, x), min(host.y0, y), min(host.z0, z)
        host.x1, host.y1, host.z1 = max(host.x1, x), max(host.y1, y), max(host.z1, z)


def measure_travel(host):
    """Return the diagonal of the box around all positions of a copy's measured point, pm."""
    x, y, z = host.x1 - host.x0, host.y1 - host.y0, host.z1 - host.z0
    return int(math.sqrt(x * x + y * y + z * z) * 1e12) if x >= 0.0 else 0


def begin_window(world, host, chip, axes, table, switches, switch_table, clockwork, sensordata, qpos, qvel):
    """Begin a lane's window after a physics step: predict the switch edges, and pass encoder shafts to chips that count them."""
    host.stepped = 0
    world.slice = 0
    world.start += clockwork.dt
    world.steps += 1
    for k in range(qvel.shape[0]):
        if not abs(qvel[k]) < MAX_JOINT_SPEED:
            host.status = DIVERGED
    for j in range(chip.axes):
        t = table[j]
        x, speed = qpos[t.qpos], qvel[t.dof]
        predict_axis_switch_edges(world, clockwork, axes[j], t, switches, switch_table, sensordata, x, speed, True)
        if HAS_ENCODERS:
            tau = float(world.now - world.start) / NS_PER_SECOND - clockwork.half
            core_interface.set_shaft(chip, j, (x + speed * tau) * t.counts, speed * t.counts / chip.hz)


def choose_polls(host, places, lane, end):
    """Choose the status polls that the lanes of a copy make in the next round, at most one for each lane.

    Returns:
        Time of the last of these polls, ns; their axes as bits; time and axis of this lane's poll, or -1; whether the next
        poll is beyond the end of the window.
    """
    now, lanes, polled, time, axis = host.until, 0, 0, -1, -1
    for k in range(host.poll, places.shape[0]):
        if host.left >> k & 1:
            if now + BUS >= end:
                return now, polled, time, axis, True
            if lanes >> places[k].lane & 1:
                break
            lanes |= 1 << places[k].lane
            now += BUS
            polled |= 1 << k
            if places[k].lane == lane:
                time, axis = now, k
    return now, polled, time, axis, False


def has_lost_step(chip, drives, table, axis_numbers, mask, qpos, qvel, tau):
    """Return whether one of the lane's axes in the mask has lost a step. `tau` is the time since that of `qpos`, s."""
    for j in range(chip.axes):
        t = table[j]
        if mask >> axis_numbers[j] & 1:
            theta = (qpos[t.qpos] + qvel[t.dof] * tau) * t.gear
            if drive_dispatch.count_lost_steps(drives[j], float(core_interface.read_net_count(chip, j)), theta) != 0:
                return True
    return False


def advance_lanes(
    words, rows, axis_numbers, places, tables, switch_tables, clockworks, ops, results, extremes,
    qpos, qvel, ctrl, sensordata, inertia, damping, core_loss, warmstart, sites, bodies, frozen_coordinates, playing,
):  # fmt: skip
    """Advance every lane (one chip of one copy of a stage) by one window, the chip time of a physics step.

    This is the kernel of a GPU fleet.

    Args:
        words: Records of all lanes as words, see `LaneLayout`.
        rows: Row of each lane, see `LaneLayout`.
        axis_numbers: Number of each axis of a lane in the stage.
        places: AXIS_INDICES record of each axis of the stage: its lane, its number there, and its indices in qpos and qvel.
        tables: AXIS_ROW records of each lane.
        switch_tables: SWITCH_ROW records of each lane.
        clockworks: One CLOCKWORK.
        ops: Operations of each copy's program, as `stage.sim.program_player.play` takes them.
        results: Results of the operations, likewise.
        extremes: Extremes that the program measures, likewise.
        qpos: mujoco-warp's joint positions, a row a copy.
        qvel: mujoco-warp's joint speeds, a row a copy.
        ctrl: mujoco-warp's actuator inputs, a row a copy.
        sensordata: mujoco-warp's sensor values, a row a copy.
        inertia: MuJoCo's dof_M0, a row per copy.
        damping: MuJoCo's dof_damping, the same for all copies.
        core_loss: MuJoCo's actuator_damping, the same for all copies.
        warmstart: mujoco-warp's qacc_warmstart, a row a copy.
        sites: mujoco-warp's positions of sites, a row a copy.
        bodies: mujoco-warp's positions of bodies, a row a copy.
        frozen_coordinates: (copies, nq + 2 nv), coordinates, speeds and accelerations of copies that stand still.
        playing: (1,), set to 1 if any program has not ended.
    """
    thread = get_thread_number()
    in_warp = thread % THREADS_PER_WARP
    group = in_warp // LANES
    copy = thread // THREADS_PER_WARP * (THREADS_PER_WARP // LANES) + group
    lane = in_warp - group * LANES
    first = group * LANES
    in_use = copy < qpos.shape[0] and group < THREADS_PER_WARP // LANES
    if not in_use:  # it takes part in the votes of its warp
        copy = lane = 0
    clockwork = clockworks[0]
    dt = clockwork.dt
    chip_records, axes, drives = cuda.local.array(1, STATE), cuda.local.array(AXES, AXIS), cuda.local.array(AXES, DRIVE)
    switches = cuda.local.array(SWITCHES, SWITCH)
    world_records = cuda.local.array(1, STAGE_TIME)
    host_records = cuda.local.array(1, PROGRAM_STATE)
    if in_use:
        load_records(view_as_words(chip_records, W_STATE), words, 0, thread)
        load_records(view_as_words(axes, W_AXES), words, W_STATE, thread)
        load_records(view_as_words(drives, W_DRIVES), words, W_STATE + W_AXES, thread)
        load_records(view_as_words(switches, W_SWITCHES), words, W_STATE + W_AXES + W_DRIVES, thread)
        load_records(view_as_words(world_records, W_WORLD), words, W_STATE + W_AXES + W_DRIVES + W_SWITCHES, thread)
        load_records(
            view_as_words(host_records, W_HOST), words, W_STATE + W_AXES + W_DRIVES + W_SWITCHES + W_WORLD, thread
        )
    world, host = world_records[0], host_records[0]
    table, switch_table, numbers = tables[lane], switch_tables[lane], axis_numbers[lane]
    c = LaneChip(chip_records[0], rows[lane].axes, rows[lane].hz, rows[lane].ticks)
    q, v = qpos[copy], qvel[copy]
    nq, nv = q.shape[0], v.shape[0]
    if in_use and host.stepped:
        begin_window(world, host, c, axes, table, switches, switch_table, clockwork, sensordata[copy], q, v)
        if lane == 0 and host.started and ops[copy, host.op, 0] == MEASURE:
            update_extremes(host, extremes[copy], q, sites, bodies, copy, ops[copy, host.op, 2])
    elif in_use and host.frozen and lane == 0:
        for k in range(nq):
            q[k] = frozen_coordinates[copy, k]
        for k in range(nv):
            v[k], warmstart[copy, k] = frozen_coordinates[copy, nq + k], frozen_coordinates[copy, nq + nv + k]

    start, end, now = world.start, world.start + dt, world.now
    chip_now, slice_now = now, world.slice
    acting, running = in_use and host.status == PLAYING, in_use and not host.frozen
    while is_any_true_in_warp(running):
        kind, op, a, b, x = END, host.op, 0, 0, 0
        target, axis, polled, moving, beyond, judged = -1, -1, 0, 0, False, False
        if running and not acting:  # nothing more to do in this window, or the program is over
            target = end if host.status == PLAYING else now
        if acting:
            if op < ops.shape[1]:
                kind, a, b, x = ops[copy, op, 0], ops[copy, op, 1], ops[copy, op, 2], ops[copy, op, 3]
            if kind != END and not host.started:
                begin_operation(host, now, kind, a)
            if kind == END:
                host.status = PLAYED
                acting = False
            elif host.until >= end:
                acting = False
            elif kind in (AWAIT_STOP, AWAIT_STOP_OR_LOST_STEP):
                judged = host.left >> host.poll == 0
                now, polled, target, axis, beyond = choose_polls(host, places, lane, end)
                if judged and kind == AWAIT_STOP_OR_LOST_STEP:
                    target = now
            else:
                now = host.until
                if kind in (WRITE, READ) and places[a].lane == lane:
                    target = now
        working = running and target > chip_now
        if is_any_true_in_warp(working) and working:  # the only place: a chip's code is long
            slice_now = run_chip(c, axes, table, switches, switch_table, world, dt, slice_now, chip_now, target)
            chip_now = target
        if running and not acting and target >= 0:
            running = False
        polling = acting and kind in (AWAIT_STOP, AWAIT_STOP_OR_LOST_STEP)
        tau = (now - start - 0.5 * dt) * 1e-9
        if acting and not polling:
            if kind == WRITE:
                if places[a].lane == lane:
                    core_interface.write(c, b, x)
            elif kind == READ:
                if places[a].lane == lane:
                    results[copy, op] = core_interface.read(c, b)
            elif kind == MEASURE:
                if lane == 0:
                    if a > 0:
                        update_extremes(host, extremes[copy], q, sites, bodies, copy, b)
                    results[copy, op] = measure_travel(host)
            elif kind == SAMPLE_POSITION and lane == 0:
                place = q[places[a].qpos] + v[places[a].dof] * tau
                if b:
                    place = read_point_coordinate(sites, bodies, copy, b, x)
                results[copy, op] = int(math.floor(place * 1e12))
            end_operation(host)
        if is_any_true_in_warp(polling):
            if axis >= 0 and core_interface.is_busy(c, places[axis].axis):
                moving = 1 << axis
            if (
                polling
                and judged
                and kind == AWAIT_STOP_OR_LOST_STEP
                and has_lost_step(c, drives, table, numbers, a, q, v, tau)
            ):
                moving |= LOST_STEP_BIT
            in_motion, moving = moving, 0
            for k in range(LANES):
                moving |= read_value_in_warp(in_motion, first + k)
            if polling:
                host.left &= ~polled | moving
                host.until = now
                for k in range(host.poll, places.shape[0]):
                    if polled >> k & 1:
                        host.poll = k + 1
                if beyond:
                    acting = False
                elif judged:
                    took, lost = now - host.begin, moving & LOST_STEP_BIT
                    if lost or host.left == 0 or took >= x:
                        if lane == 0:
                            results[copy, op] = took if host.left == 0 and not lost else -took
                        end_operation(host)
                        if lost:
                            host.status = PLAYED
                            acting = False
                    else:
                        host.poll, host.until = 0, now + b

    if in_use and host.status == PLAYING:
        world.now = end
        host.stepped = 1
        for j in range(c.axes):
            apply_effort(
                clockwork, axes[j], table[j], drives[j], q, v,
                ctrl[copy], warmstart[copy], inertia[copy], damping, core_loss,
            )  # fmt: skip
        if lane == 0:
            playing[0] = 1
    elif in_use and not host.frozen:
        world.slice, world.now, host.frozen = slice_now, now, 1
        if lane == 0:
            for k in range(nq):
                frozen_coordinates[copy, k] = q[k]
            for k in range(nv):
                frozen_coordinates[copy, nq + k], frozen_coordinates[copy, nq + nv + k] = v[k], warmstart[copy, k]
    if in_use:
        store_records(view_as_words(chip_records, W_STATE), words, 0, thread)
        store_records(view_as_words(axes, W_AXES), words, W_STATE, thread)
        store_records(view_as_words(drives, W_DRIVES), words, W_STATE + W_AXES, thread)
        store_records(view_as_words(switches, W_SWITCHES), words, W_STATE + W_AXES + W_DRIVES, thread)
        store_records(view_as_words(world_records, W_WORLD), words, W_STATE + W_AXES + W_DRIVES + W_SWITCHES, thread)
        store_records(
            view_as_words(host_records, W_HOST), words, W_STATE + W_AXES + W_DRIVES + W_SWITCHES + W_WORLD, thread
        )


def inspect_lanes(words, rows, axis_numbers, tables, clockworks, qpos, qvel, truth):
    """Fill truth[copy, axis] with the true state of every axis, TRUTH records. The kernel has the threads of `advance_lanes`."""
    thread = get_thread_number()
    in_warp = thread % THREADS_PER_WARP
    group = in_warp // LANES
    copy, lane = thread // THREADS_PER_WARP * (THREADS_PER_WARP // LANES) + group, in_warp - group * LANES
    if copy >= qpos.shape[0] or group >= THREADS_PER_WARP // LANES:
        return
    chip_records = cuda.local.array(1, STATE)
    drives = cuda.local.array(AXES, DRIVE)
    world_records = cuda.local.array(1, STAGE_TIME)
    load_records(view_as_words(chip_records, W_STATE), words, 0, thread)
    load_records(view_as_words(drives, W_DRIVES), words, W_STATE + W_AXES, thread)
    load_records(view_as_words(world_records, W_WORLD), words, W_STATE + W_AXES + W_DRIVES + W_SWITCHES, thread)
    c = LaneChip(chip_records[0], rows[lane].axes, rows[lane].hz, rows[lane].ticks)
    for j in range(c.axes):
        out = truth[copy, axis_numbers[lane, j]]
        inspect_axis(world_records[0], c, tables[lane, j], drives[j], clockworks[0], qpos[copy], qvel[copy], out)
