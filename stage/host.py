"""A host's program, played on many stages at once: bus cycles and waiting, compiled, without the GIL.

A program is an array of operations, (kind, a, b, c) of int64 each:

    WRITE    axis, address, value     one bus write cycle; its time passes first
    READ     axis, address, -         one bus read cycle; its value is the operation's result
    WAIT     ns, -, -
    STOP     mask, poll ns, limit ns  poll the status of the axes in `mask` until none operates;
                                      the result is the ns it took, negative where `limit` came first
    MEASURE  ns, -, -                 pass the time a physics step at a time and keep each coordinate's extremes
    LOOK     axis, -, -               the axis' position is the operation's result, in pm (prad on a hinge)
    END      -, -, -

It is what a Python driver would do through `Stage`, to the bit: `by_hand` plays a program that way, for recordings and tests.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload
from numba.np.numpy_support import as_dtype

from stage import engine
from stage.chips import cores
from stage.compiled import COMPILED, greatest, hot, kept, least, record
from stage.drives import drive

END, WRITE, READ, WAIT, STOP, MEASURE, LOOK = range(7)
PLAYED, DIVERGED = range(2)

_ARRAYS = "world axes drives switches table switch_table wiring clockwork qpos qvel ctrl sensordata".split()
_LENGTHS = "n_axes n_switches n_wired nq nv nu ns".split()
MOST_FAMILIES = 3
HANDLE_FIELDS: list = [(name, "i8") for name in ["mj_model", "mj_data", *_ARRAYS, *_LENGTHS, "bus"]]
HANDLE_FIELDS += [("chips", "i8", (MOST_FAMILIES,)), ("n_chips", "i8", (MOST_FAMILIES,))]
HANDLE_FIELDS += [
    (name, "i8") for name in "samples positions room filled edges edge_room noted counts advance own".split()
]
HANDLE = record(HANDLE_FIELDS)
"""Where a stage's arrays lie, their lengths, and the ns of a bus cycle; rows of chips by family, in the order of the families
that the stage has: its *kinds*, a tuple of empty arrays of their records, which compiled code needs beside the handle.
samples ... counts: where the engine logs, as `engine.run` takes it; without rooms it logs nothing. advance: the engine's address,
see `advance`; own: that of the handle itself."""

TRUTH = record(
    [(name, "f8") for name in "position velocity commanded".split()]
    + [(name, "i8") for name in "now lost_steps pulses counter inputs outputs status busy".split()]
)
"""One axis now: SI units, ns, full steps, pulses; pin words; the status byte; 1 while a drive is in progress."""

WORLD, AXIS, DRIVE, SWITCH = engine.WORLD, engine.AXIS, drive.DRIVE, engine.SWITCH
AXIS_TABLE, SWITCH_TABLE, CHIP_TABLE, CLOCKWORK = (
    engine.AXIS_TABLE, engine.SWITCH_TABLE, engine.CHIP_TABLE, engine.CLOCKWORK,
)  # fmt: skip
REAL, WHOLE = np.dtype("f8"), np.dtype("i8")

if COMPILED:

    @intrinsic
    def _pointer(context, address):
        def build(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.voidptr(address), build

    @intrinsic
    def _by_address(context, address, where, until):
        def build(context, builder, signature, given):
            word = ir.IntType(64)
            kind = ir.FunctionType(word, [word, word])
            return builder.call(builder.inttoptr(given[0], kind.as_pointer()), given[1:])

        return types.int64(types.int64, types.int64, types.int64), build
else:

    def _by_address(address, where, until):  # type: ignore[misc]
        return ADVANCE(int(address))(int(where), int(until))

    def _pointer(address):  # type: ignore[misc]
        return ctypes.c_void_p(int(address))


def chips_of(h, kinds):
    """The rows of each family."""
    return tuple(numba.carray(_pointer(h.chips[f]), (int(h.n_chips[f]),), k.dtype) for f, k in enumerate(kinds))


if COMPILED:

    @overload(chips_of)
    def _compile_chips(h, kinds):
        space = {"carray": numba.carray, "pointer": _pointer}
        parts = []
        for f, kind in enumerate(kinds):
            space[f"D{f}"] = as_dtype(kind.dtype)
            parts.append(f"carray(pointer(h.chips[{f}]), (h.n_chips[{f}],), D{f})")
        exec(f"def chips(h, kinds):\n    return ({', '.join(parts)},)", space)
        return space["chips"]


@hot
def at(address, n, dtype):
    """The array of `n` records or numbers at an address."""
    return numba.carray(_pointer(address), (n,), dtype)


@hot
def world(h):
    """The stage's WORLD record."""
    return at(h.world, 1, WORLD)[0]


@hot
def clockwork(h):
    """The stage's CLOCKWORK record."""
    return at(h.clockwork, 1, CLOCKWORK)[0]


@hot
def wiring(h):
    """The stage's CHIP_TABLE."""
    return at(h.wiring, h.n_wired, CHIP_TABLE)


@hot
def table(h):
    """The stage's AXIS_TABLE."""
    return at(h.table, h.n_axes, AXIS_TABLE)


@hot
def _engine(h, kinds, until):
    """The engine runs up to `until` ns. Returns why it returned."""
    counts = at(h.counts, 2, WHOLE)
    samples = numba.carray(_pointer(h.samples), (h.room, h.n_axes), engine.SAMPLE)
    positions = numba.carray(_pointer(h.positions), (h.room, h.nq), REAL)
    status = engine.run(
        int(h.mj_model), int(h.mj_data), at(h.world, 1, WORLD), at(h.axes, h.n_axes, AXIS), chips_of(h, kinds),
        at(h.drives, h.n_axes, DRIVE), at(h.switches, h.n_switches, SWITCH), table(h),
        at(h.switch_table, h.n_switches, SWITCH_TABLE), wiring(h), at(h.clockwork, 1, CLOCKWORK),
        at(h.qpos, h.nq, REAL), at(h.qvel, h.nv, REAL), at(h.ctrl, h.nu, REAL), at(h.sensordata, h.ns, REAL),
        until, samples, positions, h.filled, at(h.edges, h.edge_room, engine.EDGE), h.noted, counts,
    )  # fmt: skip
    if status != engine.DIVERGED:
        h.filled, h.noted = counts[0], counts[1]
    return status


ADVANCE = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)


@cache
def _compiled_engine(dtypes: tuple[np.dtype, ...]) -> Any:
    kinds = tuple(np.zeros(0, dtype) for dtype in dtypes)

    def advance(address: int, until: int) -> Any:
        return _engine(at(address, 1, HANDLE)[0], kinds, until)

    return entry(ADVANCE, types.int64(types.int64, types.int64), advance)


def entry(kind: Any, signature: Any, function: Callable) -> Any:
    """`function` of whole numbers as a C function of the ctypes type `kind`, compiled and cached."""
    if not COMPILED:
        return kind(lambda *given: int(function(*given)))
    with kept():
        made: Any = numba.cfunc(signature, cache=True, error_model="numpy")(function)
    found = kind(made.address)
    found.made = made
    return found


@hot
def advance(h, until):
    """The stage's time passes up to `until` ns; why it stopped, as `engine.run`. The engine is called by its address: numba would
    compile it anew into each function that calls one that calls it."""
    return _by_address(int(h.advance), int(h.own), int(until))


@hot
def _pass(h, until):
    """Let a stage's time pass up to `until`; True if it diverged."""
    return advance(h, until) == engine.DIVERGED


@hot
def _busy_in(rows, first, t):
    if first <= t.chip < first + len(rows):
        return 1 if cores.busy(rows[t.chip - first], t.chip_axis) else 0
    return 0


@hot
def _write_in(rows, first, chip, address, value):
    if first <= chip < first + len(rows):
        cores.write(rows, chip - first, address, value)
    return 0


@hot
def _read_in(rows, first, chip, address):
    if first <= chip < first + len(rows):
        return cores.read(rows, chip - first, address)
    return 0


@hot
def _peek_in(rows, first, chip, address):
    if first <= chip < first + len(rows):
        return cores.peek(rows[chip - first], address)
    return 0


_busy, write, read, peek = map(cores.over_families, (_busy_in, _write_in, _read_in, _peek_in))


@hot
def _until_stopped(h, chips, left, poll, limit):
    """Poll the axes in the mask `left`. Returns (diverged, ns that it took; negative if `limit` came first)."""
    w, axes = world(h), table(h)
    begin = w.now
    while True:
        for k in range(h.n_axes):
            if left >> k & 1:
                if _pass(h, w.now + h.bus):
                    return True, 0
                if not _busy(chips, axes[k]):
                    left &= ~(1 << k)
        took = w.now - begin
        if left == 0 or took >= limit:
            return False, took if left == 0 else -took
        if _pass(h, w.now + poll):
            return True, 0


@hot
def _measure(h, end, extremes):
    """Let time pass up to `end` a physics step at a time; True if the stage diverged."""
    w, dt, qpos = world(h), clockwork(h).dt, at(h.qpos, h.nq, REAL)
    while w.now < end:
        if _pass(h, least(end, w.start + dt)):
            return True
        for i in range(h.nq):
            extremes[i, 0] = least(extremes[i, 0], qpos[i])
            extremes[i, 1] = greatest(extremes[i, 1], qpos[i])
    return False


@hot
def play_one(h, kinds, ops, results, extremes):
    """Play `ops` on the stage of handle `h`. Returns PLAYED or DIVERGED."""
    w, chips, axes = world(h), chips_of(h, kinds), table(h)
    for j in range(len(ops)):
        kind, a, b, c = ops[j, 0], ops[j, 1], ops[j, 2], ops[j, 3]
        bad = False
        if kind == END:
            break
        if kind == STOP:
            bad, results[j] = _until_stopped(h, chips, a, b, c)
        elif kind == MEASURE:
            bad = _measure(h, w.now + a, extremes)
        elif kind == WAIT:
            bad = _pass(h, w.now + a)
        elif kind == LOOK:
            tau = (w.now - w.start - 0.5 * clockwork(h).dt) * 1e-9
            q, v = at(h.qpos, h.nq, REAL)[axes[a].qpos], at(h.qvel, h.nv, REAL)[axes[a].dof]
            results[j] = math.floor((q + v * tau) * 1e12)
        else:
            bad = _pass(h, w.now + h.bus)
            if not bad and kind == WRITE:
                write(chips, axes[a].chip, b, c)
            elif not bad:
                results[j] = read(chips, axes[a].chip, b)
        if bad:
            return DIVERGED
    return PLAYED


@hot
def play(handles, kinds, begin, end, ops, results, extremes, status):
    """Play ops[k] on stage k for k in begin..end-1; results (stages, ops), extremes (stages, nq, 2), status (stages)."""
    for k in range(begin, end):
        status[k] = play_one(handles[k], kinds, ops[k], results[k], extremes[k])


@hot
def _look_at(world, c, t, d, clockwork, qpos, qvel, out):
    tau = (world.now - world.start - 0.5 * clockwork.dt) * 1e-9
    j = t.chip_axis
    net = cores.net(c, j)
    v = qvel[t.dof]
    q = qpos[t.qpos] + v * tau
    theta = q * t.gear
    out.now, out.position, out.velocity = world.now, q, v
    out.commanded = q + drive.behind(d, float(net), theta) / t.gear
    out.lost_steps = drive.lost_steps(d, float(net), theta)
    out.pulses, out.counter, out.inputs = net, cores.counter(c, j), cores.inputs(c, j)
    out.outputs, out.status, out.busy = cores.outputs(c, j), cores.status(c, j), 1 if cores.busy(c, j) else 0


@hot
def _look_at_chips(rows, first, h, truth):
    drives, axes, qpos, qvel = at(h.drives, h.n_axes, DRIVE), table(h), at(h.qpos, h.nq, REAL), at(h.qvel, h.nv, REAL)
    for i in range(len(rows)):
        w = wiring(h)[first + i]
        for j in range(w.axes):
            a = w.axis[j]
            _look_at(world(h), rows[i], axes[a], drives[a], clockwork(h), qpos, qvel, truth[a])
    return 0


_look_at_families = cores.over_families(_look_at_chips)


@hot
def look(handles, kinds, begin, end, truth):
    """Fill truth[k, a] for every axis of the stages begin..end-1."""
    for k in range(begin, end):
        _look_at_families(chips_of(handles[k], kinds), handles[k], truth[k])


def kinds(stage: Any) -> tuple[np.ndarray, ...]:
    """What chips a stage has, for compiled code: see HANDLE."""
    return tuple(rows[:0].copy() for rows in stage._chips)


def fill(handles: np.ndarray, k: int, stage: Any) -> None:
    """Write the HANDLE of `stage`, which must outlive it, into handles[k], whose record has these fields first. Compiles."""
    h = handles[k]
    model, data = stage.model, stage.data
    h["mj_model"], h["mj_data"] = model._address, data._address
    held = (
        stage._world, stage._axis_state, stage._drives, stage._switches, stage._table, stage._switch_table, stage._wiring,
        stage._clockwork, data.qpos, data.qvel, data.ctrl, data.sensordata,
    )  # fmt: skip
    for name, array in zip(_ARRAYS, held, strict=True):
        h[name] = array.ctypes.data
    for f, rows in enumerate(stage._chips):
        h["chips"][f], h["n_chips"][f] = rows.ctypes.data, len(rows)
    h["n_axes"], h["n_switches"], h["n_wired"] = len(stage._table), len(stage._switches), len(stage._wiring)
    h["nq"], h["nv"], h["nu"], h["ns"] = model.nq, model.nv, model.nu, model.nsensordata
    h["bus"] = stage._bus_ns
    h["samples"] = h["positions"] = h["edges"] = stage._state.ctypes.data  # somewhere: no room
    h["counts"] = stage._counts.ctypes.data
    engine_of = _compiled_engine(tuple(rows.dtype for rows in stage._chips))
    h["advance"] = ctypes.cast(engine_of, ctypes.c_void_p).value
    h["own"] = handles.ctypes.data + k * handles.itemsize


def by_hand(stage: Any, ops: np.ndarray, results: np.ndarray, extremes: np.ndarray) -> int:
    """As `play` for one stage, through its chips' own bus cycles: recordings, journals and diagnostics take part."""
    from stage.errors import SimulationError

    axes = list(stage.axes.values())

    def until_stopped(mask: int, poll: int, limit: int) -> int:
        begin, left = stage._now, {k for k in range(len(axes)) if mask >> k & 1}
        while True:
            left = {k for k in sorted(left) if axes[k].chip.busy(axes[k].chip_axis)}
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
            elif kind == LOOK:
                results[j] = math.floor(stage._joint_position(a) * 1e12)
            else:
                measure(a)
    except SimulationError:
        return DIVERGED
    return PLAYED
