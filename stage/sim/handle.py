"""A stage for compiled code: a HANDLE has the addresses of its arrays, and the functions here return them as arrays.

handles = np.zeros(1, HANDLE)
fill(handles, 0, stage.state)
engine.advance(handles[0], until)       the stage's time passes, in hot functions and in Python

Compiled functions take the record as their argument `h`.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.chips import cores
from stage.drives.stepper import DRIVE
from stage.native import array_at, exchange, hot, record
from stage.sim import records

if TYPE_CHECKING:
    from stage.sim.state import State

_ARRAYS = (
    "world axes drives switches latches table switch_table chips clockwork qpos qvel ctrl sensordata inertia sites bodies"
    " accelerations damping core_loss"
).split()
_LENGTHS = "n_axes n_switches n_chips nq nv nu ns n_sites n_bodies".split()
_LOGS = "samples positions room filled edges edge_room noted".split()
HANDLE_FIELDS: list = [
    (name, "i8")
    for name in ["mj_model", "mj_data", *_ARRAYS, *_LENGTHS, "bus", *_LOGS, "state", "status", "own", "halt"]
]
HANDLE = record(HANDLE_FIELDS)
"""Where a stage's arrays lie, their lengths, and the ns of a bus cycle. samples ... noted: where the engine logs, how much has room
there, and how much it has logged; without rooms it logs nothing. state: where the state goes before the physics moves it, or
0; status: what `engine.advance` answered last; own: the address of the handle itself; halt: 1 where who plays a program is to stop,
see `play`."""

WORLD, AXIS, SWITCH = records.WORLD, records.AXIS, records.SWITCH
AXIS_TABLE, SWITCH_TABLE, CHIP_TABLE, CLOCKWORK = (
    records.AXIS_TABLE, records.SWITCH_TABLE, records.CHIP_TABLE, records.CLOCKWORK,
)  # fmt: skip
REAL, INTEGER = np.dtype("f8"), np.dtype("i8")


def _make_array_accessor(name: str, length: str, dtype: np.dtype) -> Any:
    """Return a hot function of a HANDLE: the array whose address and length are in these fields."""

    @hot
    def view(h):
        return array_at(h[name], h[length], dtype)

    return view


def _make_record_accessor(name: str, dtype: np.dtype) -> Any:
    """Return a hot function of a HANDLE: the record whose address is in this field."""

    @hot
    def view(h):
        return array_at(h[name], 1, dtype)[0]

    return view


world, clockwork = _make_record_accessor("world", WORLD), _make_record_accessor("clockwork", CLOCKWORK)
chip_table, axis_table = (
    _make_array_accessor("chips", "n_chips", CHIP_TABLE),
    _make_array_accessor("table", "n_axes", AXIS_TABLE),
)
axes, drives = _make_array_accessor("axes", "n_axes", AXIS), _make_array_accessor("drives", "n_axes", DRIVE)
switches = _make_array_accessor("switches", "n_switches", SWITCH)
switch_table = _make_array_accessor("switch_table", "n_switches", SWITCH_TABLE)
qpos, qvel = _make_array_accessor("qpos", "nq", REAL), _make_array_accessor("qvel", "nv", REAL)
sensordata = _make_array_accessor("sensordata", "ns", REAL)


@hot
def has_edge_room(h):
    """Return whether another edge can be noted."""
    return h.noted < h.edge_room


@hot
def note_edge(h, now, c, axis, kind, a, b):
    """Note an event that has reached chip `c`; the caller has checked that there is room.

    Args:
        h: HANDLE.
        now: Time, ns.
        c: Row of CHIP_TABLE.
        axis: Axis of the stage, one of the chip's.
        kind: Kind of the `Entry` for the journal.
        a: Its first number.
        b: Its second number.

    Returns:
        The EDGE.
    """
    e = array_at(h.edges, h.edge_room, records.EDGE)[h.noted]
    e.now, e.clock, e.axis, e.kind, e.a, e.b = now, cores.clock(c), axis, kind, a, b
    h.noted += 1
    return e


ENGINE = 1
"""Token with which compiled code claims a stage."""
_tokens = count(ENGINE + 1)
claim: Any = exchange(0, None)
"""(address, token) -> True if the word at the address was 0 and is `token` now: at most one thread has it, with or without the GIL.

Uncompiled, the GIL keeps threads apart, and every claim succeeds."""
release: Any = exchange(None, 0)
"""(address, token) -> True if the word at the address was `token` and is 0 now."""


def make_token() -> int:
    """Return a number for one claim only, so that an exception can be cleaned up after wherever it was raised."""
    return next(_tokens)


def fill_handle(handles: np.ndarray, k: int, state: State) -> None:
    """Write the HANDLE of a stage into handles[k].

    Args:
        handles: Records that begin with the fields of HANDLE.
        k: Index.
        state: State of the stage, which must outlive the handle.
    """
    h = handles[k]
    model, data = state.model, state.data
    h["mj_model"], h["mj_data"] = model._address, data._address
    held = (
        state.world, state.axes, state.drives, state.switches, state.latches, state.axis_table, state.switch_table,
        state.chip_table, state.clockwork, data.qpos, data.qvel, data.ctrl, data.sensordata, model.dof_M0,
        data.site_xpos, data.xpos, data.qacc_warmstart, model.dof_damping, model.actuator_damping,
    )  # fmt: skip
    for name, array in zip(_ARRAYS, held, strict=True):
        h[name] = array.ctypes.data
    h["n_axes"], h["n_switches"], h["n_chips"] = len(state.axis_table), len(state.switch_table), len(state.chip_table)
    h["nq"], h["nv"], h["nu"], h["ns"] = model.nq, model.nv, model.nu, model.nsensordata
    h["n_sites"], h["n_bodies"] = model.nsite, model.nbody
    h["bus"] = state.bus
    h["samples"] = h["positions"] = h["edges"] = state.saved.ctypes.data  # some address: their rooms are 0
    h["state"] = state.saved.ctypes.data
    h["own"] = handles.ctypes.data + k * handles.itemsize


def set_sample_buffers(h: Any, recording: Any) -> None:
    """Have the engine write samples into the buffers of a recording; None: no samples."""
    if recording is not None:
        h["samples"], h["positions"] = recording.samples.ctypes.data, recording.positions.ctypes.data
        h["room"], h["filled"] = len(recording.samples), recording.filled
    elif h["room"]:
        h["samples"] = h["positions"] = h["own"]  # some address: their room is 0
        h["room"] = h["filled"] = 0
