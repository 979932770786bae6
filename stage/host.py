"""A host's program, played on many stages at once: bus cycles and waiting, compiled, without the GIL.

A program is an array of operations, (kind, a, b, c) of int64 each:

    WRITE    axis, address, value     one bus write cycle; its time passes first
    READ     axis, address, -         one bus read cycle; its value is the operation's result
    WAIT     ns, -, -
    STOP     mask, poll ns, limit ns  poll status bit 6 of the axes in `mask` until none operates;
                                      the result is the ns it took, negative where `limit` came first
    MEASURE  ns, -, -                 pass the time a physics step at a time and keep each coordinate's extremes
    END      -, -, -

It is what a Python driver would do through `Stage`, to the bit: `by_hand` plays a program that way, for recordings and tests.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.extending import intrinsic

from stage import engine
from stage.chips.pcl240 import core
from stage.compiled import COMPILED, hot, record
from stage.drives import stepper

END, WRITE, READ, WAIT, STOP, MEASURE = range(6)
PLAYED, DIVERGED = range(2)
OPERATING = 0x40  # of the status byte

_ARRAYS = "world axes chips drives switches table switch_table clockwork qpos qvel ctrl sensordata".split()
HANDLE = record(
    [(name, "i8") for name in ["model", "data", *_ARRAYS, "n_axes", "n_switches", "nq", "nv", "nu", "ns", "bus"]]
)
"""Where a stage's arrays lie, their lengths, and the ns of a bus cycle."""

TRUTH = record(
    [(name, "f8") for name in "position velocity commanded".split()]
    + [(name, "i8") for name in "now lost_steps pulses counter inputs outputs status".split()]
)
"""One axis now: SI units, ns, full steps, pulses; pin words; the status byte."""

WORLD, AXIS, CHIP, DRIVE = engine.WORLD, engine.AXIS, core.STATE, stepper.STEPPER
SWITCH, AXIS_TABLE, SWITCH_TABLE, CLOCKWORK = engine.SWITCH, engine.AXIS_TABLE, engine.SWITCH_TABLE, engine.CLOCKWORK
REAL = np.dtype("f8")

if COMPILED:

    @intrinsic
    def _pointer(context, address):
        def build(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.voidptr(address), build
else:

    def _pointer(address):
        return ctypes.c_void_p(int(address))


@hot
def _play(h, ops, results, extremes, samples, positions, edges, counts):
    """Play `ops` on the stage of handle `h`. Returns PLAYED or DIVERGED."""
    world = numba.carray(_pointer(h.world), (1,), WORLD)
    axes = numba.carray(_pointer(h.axes), (h.n_axes,), AXIS)
    chips = numba.carray(_pointer(h.chips), (h.n_axes,), CHIP)
    drives = numba.carray(_pointer(h.drives), (h.n_axes,), DRIVE)
    switches = numba.carray(_pointer(h.switches), (h.n_switches,), SWITCH)
    table = numba.carray(_pointer(h.table), (h.n_axes,), AXIS_TABLE)
    switch_table = numba.carray(_pointer(h.switch_table), (h.n_switches,), SWITCH_TABLE)
    clockwork = numba.carray(_pointer(h.clockwork), (1,), CLOCKWORK)
    qpos = numba.carray(_pointer(h.qpos), (h.nq,), REAL)
    qvel = numba.carray(_pointer(h.qvel), (h.nv,), REAL)
    ctrl = numba.carray(_pointer(h.ctrl), (h.nu,), REAL)
    sensordata = numba.carray(_pointer(h.sensordata), (h.ns,), REAL)
    here = world[0]
    for j in range(len(ops)):
        kind, a, b, c = ops[j, 0], ops[j, 1], ops[j, 2], ops[j, 3]
        if kind == END:
            break
        begin = here.now
        until = begin + (a if kind in (WAIT, MEASURE) else h.bus if kind in (WRITE, READ) else 0)
        left = a  # axes that still operate
        k = 0
        while True:
            if kind == MEASURE:
                until = min(begin + a, here.start + clockwork[0].dt)
            elif kind == STOP:
                until = here.now + h.bus
            status = engine.run(
                h.model, h.data, world, axes, chips, drives, switches, table, switch_table, clockwork,
                qpos, qvel, ctrl, sensordata, until, samples, positions, 0, edges, 0, counts,
            )  # fmt: skip
            if status == engine.DIVERGED:
                return DIVERGED
            if kind == MEASURE:
                for i in range(h.nq):
                    extremes[i, 0] = min(extremes[i, 0], qpos[i])
                    extremes[i, 1] = max(extremes[i, 1], qpos[i])
                if here.now >= begin + a:
                    break
            elif kind == STOP:
                while k < h.n_axes and not left >> k & 1:
                    k += 1
                if k < h.n_axes:
                    if not core.read(chips, table[k].chip, 0) & OPERATING:
                        left &= ~(1 << k)
                    k += 1
                if k >= h.n_axes or left >> k == 0:  # all were asked
                    k = 0
                    if left == 0:
                        results[j] = here.now - begin
                        break
                    if here.now - begin >= c:
                        results[j] = begin - here.now
                        break
                    status = engine.run(
                        h.model, h.data, world, axes, chips, drives, switches, table, switch_table, clockwork,
                        qpos, qvel, ctrl, sensordata, here.now + b, samples, positions, 0, edges, 0, counts,
                    )  # fmt: skip
                    if status == engine.DIVERGED:
                        return DIVERGED
            else:
                break
        if kind == WRITE:
            core.write(chips, table[a].chip, b, c)
        elif kind == READ:
            results[j] = core.read(chips, table[a].chip, b)
    return PLAYED


@hot
def play(handles, begin, end, ops, results, extremes, status, samples, positions, edges, counts):
    """Play ops[k] on stage k for k in begin..end-1; results (stages, ops), extremes (stages, nq, 2), status (stages)."""
    for k in range(begin, end):
        status[k] = _play(handles[k], ops[k], results[k], extremes[k], samples, positions, edges, counts)


@hot
def look(handles, begin, end, truth):
    """Fill truth[k, a] for every axis of the stages begin..end-1."""
    for k in range(begin, end):
        h = handles[k]
        world = numba.carray(_pointer(h.world), (1,), WORLD)
        chips = numba.carray(_pointer(h.chips), (h.n_axes,), CHIP)
        drives = numba.carray(_pointer(h.drives), (h.n_axes,), DRIVE)
        table = numba.carray(_pointer(h.table), (h.n_axes,), AXIS_TABLE)
        clockwork = numba.carray(_pointer(h.clockwork), (1,), CLOCKWORK)
        qpos = numba.carray(_pointer(h.qpos), (h.nq,), REAL)
        qvel = numba.carray(_pointer(h.qvel), (h.nv,), REAL)
        tau = (world[0].now - world[0].start - 0.5 * clockwork[0].dt) * 1e-9
        for a in range(h.n_axes):
            t, out = table[a], truth[k, a]
            c, d = chips[t.chip], drives[a]
            v = qvel[t.dof]
            q = qpos[t.qpos] + v * tau
            theta = q * t.gear
            out.now, out.position, out.velocity = world[0].now, q, v
            out.commanded = q + stepper.mechanical(d, stepper.load_angle(d, float(c.net), theta)) / t.gear
            out.lost_steps = stepper.lost_steps(d, float(c.net), theta)
            out.pulses, out.counter, out.inputs = c.net, c.reg[0], c.inputs
            out.outputs, out.status = core.outputs(c), core.read(chips, t.chip, 0)


def handle(stage: Any) -> np.record:
    """The HANDLE of a stage, which must outlive it."""
    h = np.zeros(1, HANDLE)
    model, data = stage.model, stage.data
    h["model"], h["data"] = model._address, data._address
    held = (
        stage._world, stage._axis_state, stage._chips, stage._drives, stage._switches, stage._table, stage._switch_table,
        stage._clockwork, data.qpos, data.qvel, data.ctrl, data.sensordata,
    )  # fmt: skip
    for name, array in zip(_ARRAYS, held, strict=True):
        h[name] = array.ctypes.data
    h["n_axes"], h["n_switches"] = len(stage._table), len(stage._switches)
    h["nq"], h["nv"], h["nu"], h["ns"] = model.nq, model.nv, model.nu, model.nsensordata
    h["bus"] = stage._bus_ns
    return h[0]


def by_hand(stage: Any, ops: np.ndarray, results: np.ndarray, extremes: np.ndarray) -> int:
    """As `play` for one stage, through its chips' own bus cycles: recordings, journals and diagnostics take part."""
    from stage.errors import SimulationError

    axes = list(stage.axes.values())

    def until_stopped(mask: int, poll: int, limit: int) -> int:
        begin, left = stage._now, {k for k in range(len(axes)) if mask >> k & 1}
        while True:
            left = {k for k in sorted(left) if axes[k].chip.read(0) & OPERATING}
            if not left:
                return int(stage._now - begin)
            if stage._now - begin >= limit:
                return int(begin - stage._now)
            stage._run_until(stage._now + poll)

    def measure(ns: int) -> None:
        end = stage._now + ns
        while stage._now < end:
            stage._run_until(min(end, stage._words.item(1) + stage._dt))
            np.minimum(extremes[:, 0], stage.data.qpos, out=extremes[:, 0])
            np.maximum(extremes[:, 1], stage.data.qpos, out=extremes[:, 1])

    try:
        for j, (kind, a, b, c) in enumerate(ops.tolist()):
            if kind == END:
                break
            if kind == WRITE:
                axes[a].chip.write(b, c)
            elif kind == READ:
                results[j] = axes[a].chip.read(b)
            elif kind == WAIT:
                stage._run_until(stage._now + a)
            elif kind == STOP:
                results[j] = until_stopped(a, b, c)
            else:
                measure(a)
    except SimulationError:
        return DIVERGED
    return PLAYED
