"""HANDLE records, which give compiled code access to a stage: a HANDLE has the addresses of the stage's arrays.

handles = np.zeros(1, HANDLE)
fill_handle(handles, 0, stage.state)
engine.advance(handles[0], until)       the stage's time passes, in hot functions and in Python

Compiled functions take the record as their argument `handle`.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.chips import core_interface
from stage.drives.stepper import DRIVE
from stage.native import array_at, hot, make_compare_and_exchange, record
from stage.sim import engine_records

if TYPE_CHECKING:
    from stage.sim.stage_state import State

_ARRAY_FIELDS = (
    "world axes drives switches latches table switch_table chips clockwork qpos qvel ctrl sensordata inertia sites bodies"
    " accelerations damping core_loss"
).split()
_LENGTH_FIELDS = "n_axes n_switches n_chips nq nv nu ns n_sites n_bodies".split()
_LOG_FIELDS = "samples positions room filled edges edge_room noted".split()
_LAST_FIELDS = "state status own halt".split()
HANDLE_FIELDS: list = [
    (name, "i8")
    for name in ("mj_model", "mj_data", *_ARRAY_FIELDS, *_LENGTH_FIELDS, "bus", *_LOG_FIELDS, *_LAST_FIELDS)
]
HANDLE = record(HANDLE_FIELDS)
"""Where a stage's arrays lie, their lengths, and the ns of a bus cycle. samples ... noted: where the engine logs, how much has room
there, and how much it has logged; without rooms it logs nothing. state: where the state goes before the physics moves it, or
0; status: what `engine.advance` answered last; own: the address of the handle itself; halt: 1 where who plays a program is to stop,
see `play`."""

WORLD, AXIS, SWITCH = engine_records.STAGE_TIME, engine_records.AXIS, engine_records.SWITCH
AXIS_ROW, SWITCH_ROW, CHIP_ROW, CLOCKWORK = (
    engine_records.AXIS_ROW, engine_records.SWITCH_ROW, engine_records.CHIP_ROW, engine_records.ENGINE_CONSTANTS,
)  # fmt: skip
REAL, INTEGER = np.dtype("f8"), np.dtype("i8")


def _make_array_accessor(name: str, length: str, dtype: np.dtype) -> Any:
    """Make a hot function of a HANDLE that returns an array. Fields of the HANDLE have the array's address and length."""

    @hot
    def view(handle):
        return array_at(handle[name], handle[length], dtype)

    return view


def _make_record_accessor(name: str, dtype: np.dtype) -> Any:
    """Make a hot function of a HANDLE that returns a record. A field of the HANDLE has the record's address."""

    @hot
    def view(handle):
        return array_at(handle[name], 1, dtype)[0]

    return view


get_world, get_clockwork = _make_record_accessor("world", WORLD), _make_record_accessor("clockwork", CLOCKWORK)
get_chip_table = _make_array_accessor("chips", "n_chips", CHIP_ROW)
get_axis_table = _make_array_accessor("table", "n_axes", AXIS_ROW)
get_axes, get_drives = _make_array_accessor("axes", "n_axes", AXIS), _make_array_accessor("drives", "n_axes", DRIVE)
get_switches = _make_array_accessor("switches", "n_switches", SWITCH)
get_switch_table = _make_array_accessor("switch_table", "n_switches", SWITCH_ROW)
get_qpos, get_qvel = _make_array_accessor("qpos", "nq", REAL), _make_array_accessor("qvel", "nv", REAL)
get_sensordata = _make_array_accessor("sensordata", "ns", REAL)


@hot
def has_edge_room(handle):
    """Return whether the buffer of the HANDLE has room for another edge."""
    return handle.noted < handle.edge_room


@hot
def log_edge(handle, now_ns, chip, axis, kind, first_number, second_number):
    """Log an input that a chip has received, for its journal. The caller has checked that the buffer has room.

    Args:
        handle: HANDLE.
        now_ns: Time, ns.
        chip: CHIP_ROW record.
        axis: Axis of the stage, one of the chip's.
        kind: Kind of the `Entry` for the journal.
        first_number: Operand `a` of the entry.
        second_number: Operand `b` of the entry.

    Returns:
        The EDGE record.
    """
    e = array_at(handle.edges, handle.edge_room, engine_records.LOGGED_EDGE)[handle.noted]
    e.now = now_ns
    e.clock = core_interface.read_clock(chip)
    e.axis = axis
    e.kind = kind
    e.a = first_number
    e.b = second_number
    handle.noted += 1
    return e


ENGINE_CLAIM_TOKEN = 1
"""Token with which compiled code claims a stage."""
_claim_tokens = count(ENGINE_CLAIM_TOKEN + 1)
claim: Any = make_compare_and_exchange(0, None)
"""(address, token) -> True if the word at the address was 0 and is `token` now: at most one thread has it, with or without the GIL.

Uncompiled, the GIL keeps threads apart, and every claim succeeds."""
release: Any = make_compare_and_exchange(None, 0)
"""(address, token) -> True if the word at the address was `token` and is 0 now."""


def make_claim_token() -> int:
    """Return a number that identifies one claim of a stage, so that a cleanup after an exception releases only its own claim."""
    return next(_claim_tokens)


def fill_handle(handles: np.ndarray, index: int, state: State) -> None:
    """Write the HANDLE of a stage into handles[index].

    Args:
        handles: Records that begin with the fields of HANDLE.
        index: Index of the record to fill.
        state: State of the stage, which must outlive the handle.
    """
    handle = handles[index]
    model, data = state.model, state.data
    handle["mj_model"], handle["mj_data"] = model._address, data._address
    held = (
        state.world, state.axes, state.drives, state.switches, state.latches, state.axis_table, state.switch_table,
        state.chip_table, state.clockwork, data.qpos, data.qvel, data.ctrl, data.sensordata, model.dof_M0,
        data.site_xpos, data.xpos, data.qacc_warmstart, model.dof_damping, model.actuator_damping,
    )  # fmt: skip
    for name, array in zip(_ARRAY_FIELDS, held, strict=True):
        handle[name] = array.ctypes.data
    handle["n_axes"] = len(state.axis_table)
    handle["n_switches"] = len(state.switch_table)
    handle["n_chips"] = len(state.chip_table)
    handle["nq"], handle["nv"], handle["nu"], handle["ns"] = model.nq, model.nv, model.nu, model.nsensordata
    handle["n_sites"], handle["n_bodies"] = model.nsite, model.nbody
    handle["bus"] = state.bus
    handle["state"] = state.saved.ctypes.data
    handle["samples"] = handle["positions"] = handle["edges"] = handle["state"]  # some address: their rooms are 0
    handle["own"] = handles.ctypes.data + index * handles.itemsize


def set_sample_buffers(handle: Any, recording: Any) -> None:
    """Make the engine write samples into the buffers of a recording; None: no samples."""
    if recording is not None:
        handle["samples"], handle["positions"] = recording.samples.ctypes.data, recording.positions.ctypes.data
        handle["room"], handle["filled"] = len(recording.samples), recording.filled
    elif handle["room"]:
        handle["samples"] = handle["positions"] = handle["own"]  # some address: their room is 0
        handle["room"] = handle["filled"] = 0


@hot
def would_call_unguarded_callback(clock):
    """Return whether MuJoCo would call a Python callback whose exceptions are not guarded."""
    if not clock.guarded:
        for k in range(engine_records.CALLBACK_COUNT):
            callback = array_at(clock.callbacks[k], 1, engine_records.ADDRESS_TYPE)[0]
            if callback != 0 and callback != clock.native[k]:
                return True
    return False


@hot
def is_ready(handle):
    """Return whether compiled code can run a stage now: it has power, and no callback of Python is unguarded."""
    return get_world(handle).powered != 0 and not would_call_unguarded_callback(get_clockwork(handle))
