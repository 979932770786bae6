"""Player of host programs on many stages at once, compiled: it runs without the GIL.

The results are bit for bit those of a Python program that makes the same bus cycles on a `Stage`. `play_in_python` plays a program
in this way, for recordings and tests.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stage.chips import core_interface
from stage.drives import drive_dispatch
from stage.errors import SimulationError
from stage.native import array_at, array_of, exported, greatest, hot, least, record
from stage.sim import engine_records
from stage.sim.compiled_stage_access import (
    HANDLE,
    REAL,
    get_axis_table,
    get_chip_table,
    get_clockwork,
    get_drives,
    get_qpos,
    get_qvel,
    get_world,
)
from stage.sim.engine import advance
from stage.sim.program import AWAIT_STOP, AWAIT_STOP_OR_LOST_STEP, END, MEASURE, READ, SAMPLE_POSITION, WAIT, WRITE

PLAYED, DIVERGED = engine_records.REACHED, engine_records.DIVERGED
"""How a program ended: as it says, or where the stage diverged. Or why it did not: records.IN_USE and the like."""

STILL_BUSY = -(1 << 62)
STEP_LOST = -1
"""Status of a program that AWAIT_STOP_OR_LOST_STEP has ended because a step was lost."""
HALTED = -2
"""Status of a program that was interrupted, because another thread has set `halt` in the handle."""
UNREADY, REFUSED, UNDECODED = -3, -4, -5
"""Status of a program of a compiled task: Python must play it; it was not played, because the action is not in the action space; it
was played, and Python must decode its results."""
HALT_CHECK_INTERVAL_NS = 100_000_000
"""Longest simulated time, ns, between two checks whether the program is to be interrupted."""
MIN_BACKGROUND_PLAY_NS = 10 * HALT_CHECK_INTERVAL_NS
"""Total simulated time, ns, below which programs are played without a background thread that Ctrl-C can interrupt."""

TRUTH = record(
    [(name, "f8") for name in "position velocity commanded".split()]
    + [(name, "i8") for name in "now lost_steps pulses counter inputs outputs status busy".split()]
)
"""One axis now: SI units, ns, full steps, pulses; pin words; the status byte; 1 while a drive is in progress."""


@hot
def _advance_unless_halted(handle, until_ns):
    """Let a stage's time pass up to `until_ns`, unless the play is halted. Return 0, or the reason of the stop."""
    w, end = get_world(handle), int(until_ns)
    while end - w.now > HALT_CHECK_INTERVAL_NS:
        if handle.halt:
            return HALTED
        bad = advance(handle, w.now + HALT_CHECK_INTERVAL_NS)
        if bad:
            return bad
    return HALTED if handle.halt else advance(handle, end)


@hot
def _has_lost_step(handle, axis_mask):
    """Return whether an axis in the mask has lost a step."""
    w, axes = get_world(handle), get_axis_table(handle)
    tau = (w.now - w.start - 0.5 * get_clockwork(handle).dt) * 1e-9
    for k in range(handle.n_axes):
        if axis_mask >> k & 1:
            t = axes[k]
            net = core_interface.read_net_count(get_chip_table(handle)[t.chip], t.chip_axis)
            theta = (get_qpos(handle)[t.qpos] + get_qvel(handle)[t.dof] * tau) * t.gear
            if drive_dispatch.count_lost_steps(get_drives(handle)[k], float(net), theta) != 0:
                return True
    return False


@hot
def _poll_until_stopped(handle, axis_mask, poll_ns, limit_ns, end_on_lost_step):
    """Poll the status of the axes in a mask until none is in motion.

    Returns:
        Status of `_advance_unless_halted`, or STEP_LOST; duration in ns, negative if `limit_ns` or a lost step came first.
    """
    w, axes = get_world(handle), get_axis_table(handle)
    begin, left = w.now, axis_mask
    while True:
        for k in range(handle.n_axes):
            if left >> k & 1:
                bad = _advance_unless_halted(handle, w.now + handle.bus)
                if bad:
                    return bad, 0
                if not core_interface.is_busy(get_chip_table(handle)[axes[k].chip], axes[k].chip_axis):
                    left &= ~(1 << k)
        took = w.now - begin
        if end_on_lost_step and _has_lost_step(handle, axis_mask):
            return STEP_LOST, -took
        if left == 0 or took >= limit_ns:
            return 0, took if left == 0 else -took
        bad = _advance_unless_halted(handle, w.now + poll_ns)
        if bad:
            return bad, 0


@hot
def _measure_extremes(handle, end_ns, point, extremes):
    """Let time pass up to `end_ns`, and update the extremes of all coordinates at each physics step.

    Returns:
        Status of `_advance_unless_halted`; travel of the point, pm."""
    w, dt, positions = get_world(handle), get_clockwork(handle).dt, get_qpos(handle)
    sites = array_at(handle.sites, (handle.n_sites, 3), REAL)
    bodies = array_at(handle.bodies, (handle.n_bodies, 3), REAL)
    x0 = y0 = z0 = math.inf
    x1 = y1 = z1 = -math.inf
    while w.now < end_ns:
        bad = _advance_unless_halted(handle, least(end_ns, w.start + dt))
        if bad:
            return bad, 0
        for i in range(handle.nq):
            extremes[i, 0] = least(extremes[i, 0], positions[i])
            extremes[i, 1] = greatest(extremes[i, 1], positions[i])
        if point:
            at = sites[point - 1] if point > 0 else bodies[-point]
            x0, y0, z0 = least(x0, at[0]), least(y0, at[1]), least(z0, at[2])
            x1, y1, z1 = greatest(x1, at[0]), greatest(y1, at[1]), greatest(z1, at[2])
    if not x0 <= x1:
        return 0, 0
    return 0, int(math.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2 + (z1 - z0) ** 2) * 1e12)


@hot
def play_program(handle, ops, results, extremes):
    """Play a program on the stage of a handle.

    Args:
        handle: HANDLE of the stage.
        ops: Operations, (operations, 4).
        results: Results of the operations to fill, (operations,).
        extremes: Least and greatest value of each coordinate to update, (nq, 2).

    Returns:
        PLAYED, DIVERGED, or the reason why the program could not be played.
    """
    w, axes = get_world(handle), get_axis_table(handle)
    for j in range(len(ops)):
        kind, a, b, c = ops[j, 0], ops[j, 1], ops[j, 2], ops[j, 3]
        bad = 0
        if kind == END:
            break
        if kind == AWAIT_STOP:
            bad, results[j] = _poll_until_stopped(handle, a, b, c, False)
        elif kind == AWAIT_STOP_OR_LOST_STEP:
            bad, results[j] = _poll_until_stopped(handle, a, b, c, True)
            if bad == STEP_LOST:
                break
        elif kind == MEASURE:
            bad, results[j] = _measure_extremes(handle, w.now + a, b, extremes)
        elif kind == WAIT:
            bad = _advance_unless_halted(handle, w.now + a)
        elif kind == SAMPLE_POSITION and b:
            sites = array_at(handle.sites, (handle.n_sites, 3), REAL)
            bodies = array_at(handle.bodies, (handle.n_bodies, 3), REAL)
            at = sites[b - 1] if b > 0 else bodies[-b]
            results[j] = math.floor(at[c] * 1e12)
        elif kind == SAMPLE_POSITION:
            tau = (w.now - w.start - 0.5 * get_clockwork(handle).dt) * 1e-9
            q, v = get_qpos(handle)[axes[a].qpos], get_qvel(handle)[axes[a].dof]
            results[j] = math.floor((q + v * tau) * 1e12)
        else:
            bad = _advance_unless_halted(handle, w.now + handle.bus)
            if not bad and kind == WRITE:
                core_interface.write(get_chip_table(handle)[axes[a].chip], b, c)
            elif not bad:
                results[j] = core_interface.read(get_chip_table(handle)[axes[a].chip], b)
        if bad:
            return bad
    return PLAYED


@hot
def count_unfinished_programs(status, begin, end):
    """Return how many of the stages `begin` to `end` - 1 have not played their program to its end.

    Args:
        status: Status of `play_program` of each stage, (stages,).
        begin: First stage.
        end: Stage after the last one.
    """
    unfinished = 0
    for k in range(begin, end):
        if status[k] != PLAYED:
            unfinished += 1
    return unfinished


@exported(None, array_of(HANDLE), "i8", "i8", array_of("i8", 3), array_of("i8", 2), array_of("f8", 3), array_of("i8"))
def play_programs(handles, begin, end, ops, results, extremes, status):
    """Play program ops[k] on stage k for k from `begin` to `end` - 1.

    Args:
        handles: HANDLE of each stage.
        begin: First stage.
        end: Stage after the last one.
        ops: Operations, (stages, operations, 4).
        results: Results of the operations to fill, (stages, operations).
        extremes: Least and greatest value of each coordinate to update, (stages, nq, 2).
        status: Status of `play_program` to fill, (stages,).
    """
    for k in range(begin, end):
        status[k] = play_program(handles[k], ops[k], results[k], extremes[k])


@hot
def inspect_axis(world, chip, axis_row, drive, clockwork, qpos, qvel, truth):
    """Write the present true state of an axis into a TRUTH record."""
    tau = (world.now - world.start - 0.5 * clockwork.dt) * 1e-9
    j = axis_row.chip_axis
    net = core_interface.read_net_count(chip, j)
    v = qvel[axis_row.dof]
    q = qpos[axis_row.qpos] + v * tau
    theta = q * axis_row.gear
    truth.now, truth.position, truth.velocity = world.now, q, v
    truth.commanded = q + drive_dispatch.compute_lag(drive, float(net), theta) / axis_row.gear
    truth.lost_steps = drive_dispatch.count_lost_steps(drive, float(net), theta)
    truth.pulses = net
    truth.counter = core_interface.read_counter(chip, j)
    truth.inputs = core_interface.read_inputs(chip, j)
    truth.outputs = core_interface.read_outputs(chip, j)
    truth.status = core_interface.read_status(chip, j)
    truth.busy = 1 if core_interface.is_busy(chip, j) else 0


@exported(None, array_of(HANDLE), "i8", "i8", array_of(TRUTH, 2))
def inspect_axes(handles, begin, end, truth):
    """Fill truth[k, a], TRUTH records, for every axis of the stages `begin` to `end` - 1."""
    for k in range(begin, end):
        handle = handles[k]
        w, clock, axes, drives = get_world(handle), get_clockwork(handle), get_axis_table(handle), get_drives(handle)
        for a in range(handle.n_axes):
            chip = get_chip_table(handle)[axes[a].chip]
            inspect_axis(w, chip, axes[a], drives[a], clock, get_qpos(handle), get_qvel(handle), truth[k, a])


@hot
def write_program_cycles(chip, ops, axis_mask):
    """Make the write cycles of a program on a chip, for the axes in a mask."""
    for j in range(len(ops)):
        if ops[j, 0] == WRITE and axis_mask >> ops[j, 1] & 1:
            core_interface.write(chip, ops[j, 2], ops[j, 3])


@exported(None, core_interface.CHIP, array_of("i8", 2), "i8")
def write_cycles(chip, ops, axis_mask):
    """Make the write cycles of a program on the chip whose axes are in a mask, all at one clock."""
    write_program_cycles(chip, ops, axis_mask)


@exported("i8", core_interface.CHIP, array_of("i8", 2), "i8", "i8", "i8")
def predict_pulses(chip, ops, axis_mask, axis, until_clock):
    """Predict the net pulses of a chip's axis at the clock `until_clock`, after `write_cycles` now, without a stage.

    Returns:
        The net pulses; STILL_BUSY if the axis is still in motion at that clock.
    """
    write_program_cycles(chip, ops, axis_mask)
    core_interface.run(chip, until_clock)
    return STILL_BUSY if core_interface.is_busy(chip, axis) else core_interface.read_net_count(chip, axis)


class _OperationRunner:
    """Runner of a program's operations on one stage, through the bus cycles of its chips; it has a method for each operation.

    Attributes:
        step_lost: Whether AWAIT_STOP_OR_LOST_STEP has ended the program because an axis has lost a step.
    """

    def __init__(self, stage: Any, extremes: np.ndarray):
        self.stage, self.extremes, self.axes = stage, extremes, list(stage.axes.values())
        self.step_lost = False

    def write(self, axis: int, address: int, value: int) -> None:
        """Make a bus write cycle."""
        self.axes[axis].chip.write(address, value)

    def read(self, axis: int, address: int, _: int) -> int:
        """Make a bus read cycle, and return its value."""
        return int(self.axes[axis].chip.read(address))

    def wait(self, ns: int, *_: int) -> None:
        """Let simulated time pass."""
        self.stage.run_to(self.stage.now + ns)

    def wait_for_stop(self, mask: int, poll: int, limit: int, end_on_lost_step: bool = False) -> int:
        """Poll until no axis in the mask is in motion; return the duration in ns, negative after the limit."""
        stage, begin = self.stage, self.stage.now
        axes = [axis for k, axis in enumerate(self.axes) if mask >> k & 1]
        left = axes
        while True:
            left = [axis for axis in left if axis.chip.busy(axis.chip_axis)]
            self.step_lost = end_on_lost_step and any(axis.lost_steps for axis in axes)
            if not left and not self.step_lost:
                return int(stage.now - begin)
            if self.step_lost or stage.now - begin >= limit:
                return int(begin - stage.now)
            stage.run_to(stage.now + poll)

    def wait_while_in_step(self, mask: int, poll: int, limit: int) -> int:
        """Poll as `wait_for_stop` does, and end the program if an axis loses a step."""
        return self.wait_for_stop(mask, poll, limit, end_on_lost_step=True)

    def _find_point_position(self, point: int) -> np.ndarray:
        """Return the world position of a measured point, m, (3,)."""
        data = self.stage.data
        return data.site_xpos[point - 1] if point > 0 else data.xpos[-point]

    def sample_position(self, axis: int, point: int, coordinate: int) -> int:
        """Return a true position in pm (prad on a hinge), see `Program.sample_position`."""
        at = self._find_point_position(point)[coordinate] if point else self.axes[axis].position
        return math.floor(at * 1e12)

    def measure(self, ns: int, point: int, _: int) -> int:
        """Wait, update the extremes, and return the travel of the point in pm."""
        stage, extremes = self.stage, self.extremes
        end, low, high = stage.now + ns, np.full(3, np.inf), np.full(3, -np.inf)
        while stage.now < end:
            stage.run_to(min(end, stage.state.start + stage.state.dt))
            np.minimum(extremes[:, 0], stage.data.qpos, out=extremes[:, 0])
            np.maximum(extremes[:, 1], stage.data.qpos, out=extremes[:, 1])
            if point:
                low = np.minimum(low, self._find_point_position(point))
                high = np.maximum(high, self._find_point_position(point))
        x, y, z = (high - low).tolist()
        return int(math.sqrt(x**2 + y**2 + z**2) * 1e12) if x >= 0 else 0


def play_in_python(stage: Any, ops: np.ndarray, results: np.ndarray, extremes: np.ndarray) -> int:
    """Play a program on one stage in Python, so that recordings, journals and diagnostics receive its bus cycles.

    Args:
        stage: Stage.
        ops: Operations, (operations, 4).
        results: Results of the operations to fill, (operations,).
        extremes: Least and greatest value of each coordinate to update, (nq, 2).

    Returns:
        PLAYED or DIVERGED.
    """
    player = _OperationRunner(stage, extremes)
    play_operation: dict[int, Any] = {
        WRITE: player.write, READ: player.read, WAIT: player.wait,
        AWAIT_STOP: player.wait_for_stop, AWAIT_STOP_OR_LOST_STEP: player.wait_while_in_step,
        SAMPLE_POSITION: player.sample_position, MEASURE: player.measure,
    }  # fmt: skip
    try:
        for j, (kind, *operands) in enumerate(ops.tolist()):
            if kind == END or player.step_lost:
                break
            result = play_operation[kind](*operands)
            if result is not None:
                results[j] = result
    except SimulationError as error:
        if error.__cause__ is not None:  # a callback's own, which says more
            raise
        return DIVERGED
    return PLAYED
