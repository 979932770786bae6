"""A stage for compiled code: a HANDLE has the addresses of its arrays. And the functions of the engine that take a HANDLE.

handles = np.zeros(1, HANDLE)
fill(handles, 0, stage.state)
advance(handles[0], until)       the stage's time passes, in hot functions and in Python
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stage.drives import drive
from stage.native import array_at, exported, hot, record
from stage.sim import engine, records
from stage.sim.in_use import ENGINE, claim, release

if TYPE_CHECKING:
    from stage.sim.state import State

_ARRAYS = (
    "world axes drives switches latches table switch_table chips clockwork qpos qvel ctrl sensordata inertia sites bodies"
).split()
_LENGTHS = "n_axes n_switches n_chips nq nv nu ns n_sites n_bodies".split()
_LOGS = "samples positions room filled edges edge_room noted counts".split()
HANDLE_FIELDS: list = [
    (name, "i8")
    for name in ["mj_model", "mj_data", *_ARRAYS, *_LENGTHS, "bus", *_LOGS, "state", "status", "own", "halt"]
]
HANDLE = record(HANDLE_FIELDS)
"""Where a stage's arrays lie, their lengths, and the ns of a bus cycle. samples ... counts: where the engine logs, as `engine.run`
takes it; without rooms it logs nothing. state: where the stage's state goes before the physics moves it, or 0; status: what
`advance` answered last; own: the address of the handle itself; halt: 1 where who plays a program is to stop, see `play`."""

WORLD, AXIS, DRIVE, SWITCH = records.WORLD, records.AXIS, drive.DRIVE, records.SWITCH
AXIS_TABLE, SWITCH_TABLE, CHIP_TABLE, CLOCKWORK = (
    records.AXIS_TABLE, records.SWITCH_TABLE, records.CHIP_TABLE, records.CLOCKWORK,
)  # fmt: skip
REAL, WHOLE = np.dtype("f8"), np.dtype("i8")


@hot
def world(h):
    """The stage's WORLD record."""
    return array_at(h.world, 1, WORLD)[0]


@hot
def clockwork(h):
    """The stage's CLOCKWORK record."""
    return array_at(h.clockwork, 1, CLOCKWORK)[0]


@hot
def chips(h):
    """The stage's CHIP_TABLE."""
    return array_at(h.chips, h.n_chips, CHIP_TABLE)


@hot
def table(h):
    """The stage's AXIS_TABLE."""
    return array_at(h.table, h.n_axes, AXIS_TABLE)


@exported("i8", HANDLE, "i8")
def advance(h, until):
    """The stage's time passes up to `until` ns, unless the engine has to stop before; why it stopped, as `engine.run`."""
    if not claim(h.clockwork, ENGINE):
        return records.IN_USE
    counts = array_at(h.counts, 2, WHOLE)
    samples = array_at(h.samples, (h.room, h.n_axes), records.SAMPLE)
    positions = array_at(h.positions, (h.room, h.nq), REAL)
    status = engine.run(
        h.mj_model, h.mj_data, array_at(h.world, 1, WORLD), array_at(h.axes, h.n_axes, AXIS), array_at(h.drives, h.n_axes, DRIVE),
        array_at(h.switches, h.n_switches, SWITCH), table(h), array_at(h.switch_table, h.n_switches, SWITCH_TABLE), chips(h),
        array_at(h.clockwork, 1, CLOCKWORK), array_at(h.qpos, h.nq, REAL), array_at(h.qvel, h.nv, REAL),
        array_at(h.ctrl, h.nu, REAL),
        array_at(h.sensordata, h.ns, REAL), array_at(h.inertia, h.nv, REAL), until, samples, positions, h.filled,
        array_at(h.edges, h.edge_room, records.EDGE), h.noted, counts, h.state,
    )  # fmt: skip
    if status != records.DIVERGED and status != records.FAILED:
        h.filled, h.noted = counts[0], counts[1]
    h.status = status
    release(h.clockwork, ENGINE)
    return status


@exported("i8", HANDLE)
def called_back(h):
    """1 if MuJoCo has a Python callback whose exceptions are not guarded now."""
    return 1 if engine.unguarded(clockwork(h)) else 0


@exported("i8", HANDLE, "i8")
def take(h, token):
    """1 if the stage was free: no other thread can run it until `give` with this token."""
    return 1 if claim(h.clockwork, token) else 0


@exported(None, HANDLE, "i8")
def give(h, token):
    """Whoever took it with this token has it no more."""
    release(h.clockwork, token)


@exported(None, HANDLE)
def settle(h):
    """See `engine.settle`."""
    engine.settle(
        array_at(h.world, 1, WORLD), array_at(h.axes, h.n_axes, AXIS), array_at(h.drives, h.n_axes, DRIVE),
        array_at(h.switches, h.n_switches, SWITCH),
        table(h), array_at(h.switch_table, h.n_switches, SWITCH_TABLE), chips(h), array_at(h.clockwork, 1, CLOCKWORK),
        array_at(h.qpos, h.nq, REAL), array_at(h.qvel, h.nv, REAL), array_at(h.sensordata, h.ns, REAL),
        array_at(h.edges, 0, records.EDGE),
    )  # fmt: skip


@exported(None, HANDLE, "i8")
def look_again(h, axis):
    """See `engine.look_again`."""
    h.noted = engine.look_again(
        array_at(h.world, 1, WORLD), array_at(h.axes, h.n_axes, AXIS), array_at(h.switches, h.n_switches, SWITCH), table(h),
        array_at(h.switch_table, h.n_switches, SWITCH_TABLE), chips(h), array_at(h.clockwork, 1, CLOCKWORK),
        array_at(h.qpos, h.nq, REAL), array_at(h.qvel, h.nv, REAL),
        axis, array_at(h.edges, h.edge_room, records.EDGE), h.noted,
    )  # fmt: skip


def fill(handles: np.ndarray, k: int, state: State) -> None:
    """Write the HANDLE of a stage's `state`, which must outlive it, into handles[k], whose record has these fields first."""
    h = handles[k]
    model, data = state.model, state.data
    h["mj_model"], h["mj_data"] = model._address, data._address
    held = (
        state.world, state.axes, state.drives, state.switches, state.latches, state.axis_table, state.switch_table,
        state.chip_table, state.clockwork, data.qpos, data.qvel, data.ctrl, data.sensordata, model.dof_M0,
        data.site_xpos, data.xpos,
    )  # fmt: skip
    for name, array in zip(_ARRAYS, held, strict=True):
        h[name] = array.ctypes.data
    h["n_axes"], h["n_switches"], h["n_chips"] = len(state.axis_table), len(state.switch_table), len(state.chip_table)
    h["nq"], h["nv"], h["nu"], h["ns"] = model.nq, model.nv, model.nu, model.nsensordata
    h["n_sites"], h["n_bodies"] = model.nsite, model.nbody
    h["bus"] = state.bus
    h["samples"] = h["positions"] = h["edges"] = state.saved.ctypes.data  # some address: their rooms are 0
    h["counts"], h["state"] = state.counts.ctypes.data, state.saved.ctypes.data
    h["own"] = handles.ctypes.data + k * handles.itemsize


def log_to(h: Any, recording: Any) -> None:
    """From now on the engine samples for `recording`; None: no samples."""
    if recording is not None:
        h["samples"], h["positions"] = recording.samples.ctypes.data, recording.positions.ctypes.data
        h["room"], h["filled"] = len(recording.samples), recording.filled
    elif h["room"]:
        h["samples"] = h["positions"] = h["own"]  # some address: their room is 0
        h["room"] = h["filled"] = 0
