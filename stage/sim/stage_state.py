"""`State`: the records of a stage in memory, for compiled code, boards and tests; users of a stage do not need it.

All values that change while time passes are in MjData.userdata, so that MuJoCo's own snapshots, copies and rollouts include them.
The records are in this order: one WORLD, an AXIS for each axis, the state of every chip, a DRIVE for each axis, a SWITCH for each
switch, an address latch for each chip. Tables of constants, which only faults change, are in separate arrays. A HANDLE gives
compiled code the addresses of all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np

from stage.chips import Chip, ChipAxis, core_interface
from stage.drives.dc_motors import Servo
from stage.drives.motors import Drive
from stage.drives.stepper import DRIVE
from stage.native import address_of, remove_attribute_access
from stage.sim import compiled_stage_access as handle
from stage.sim import engine_records, mujoco_callback_guards, mujoco_function_addresses
from stage.sim.plant import PlantAxis
from stage.sim.wiring_arguments import Wires

SAVED_STATE_SPEC = mujoco.mjtState.mjSTATE_INTEGRATION  # all of it: physics, and in userdata chips, drives, switches
SPARE_EDGE_COUNT = 640
SPARE_LINKED_EDGE_COUNT = 64
_STAGE_TIME_FIELDS = engine_records.STAGE_TIME.names or ()
_READ_EDGE = attrgetter(*(engine_records.FLAG_EDGE.names or ()))
START, POWERED = _STAGE_TIME_FIELDS.index("start"), _STAGE_TIME_FIELDS.index("powered")


class State:
    """State of one stage as records in memory: chips, drives, switches and tables of constants.

    Args:
        model: Model with room for the state in its userdata, see `count_state_words`.
        offset: Word of userdata at which the state begins.
        plant: Axes of the model.
        chip_axes: For each axis of the stage, the axis of its chip.
        drives: For each axis of the stage, its drive.
        bus: Duration of a bus cycle, ns.
        encoders: For each axis, counts per joint unit of an encoder that its chip counts, 0 for none; a Servo has its own.
        wires: Wires of the stage that differ from the default.
    """

    model: mujoco.MjModel
    """Model that is simulated. MuJoCo's automatic reset is off, because it would clear the state of the chips."""
    data: mujoco.MjData
    """MuJoCo's state."""
    offset: int
    """Index in `data.userdata` at which the stage's state begins."""
    userdata: np.ndarray
    """The stage's part of `data.userdata`, float64."""
    world: np.ndarray
    """WORLD record with the time of the stage, in an array of length one."""
    words: np.ndarray
    """Fields of `world` as int64 in their order, for fast access from Python."""
    axes: np.ndarray
    """AXIS of each axis: counts of its pulses, edges to come."""
    chips: list[np.ndarray]
    """For each chip an array with one record of its core's STATE."""
    drives: np.ndarray
    """DRIVE of each axis: motor, currents."""
    switches: np.ndarray
    """SWITCH of each switch of all axes, axis after axis."""
    latches: np.ndarray
    """int64 of each chip: the address that its bus holds, where address and data share the lines."""
    axis_table: np.ndarray
    """AXIS_ROW: which axis of which chip moves which joint, and which switches are its own."""
    switch_table: np.ndarray
    """SWITCH_ROW: pin bit, sensor, geometry; and what faults do to a switch."""
    flag_edges: np.ndarray
    """FLAG_EDGE records: the joint positions at which vanes enter and leave their switches, switch after switch."""
    chip_table: np.ndarray
    """CHIP_ROW: which core runs each chip, and where its state lies."""
    slice_ends: dict[int, np.ndarray]
    """For each reference clock, Hz, where the slices of a window end in it."""
    chip_axes: list[np.ndarray]
    """For each chip its CHIP_AXIS records: which axes of the stage are its own."""
    clockwork: np.ndarray
    """CLOCKWORK, one record: time step, functions of MuJoCo, who runs the stage now."""
    handle: Any
    """HANDLE record with the addresses of all these arrays, for compiled code, and with the state of the engine's logs."""
    pointer: int
    """Address of `handle`."""
    dt: int
    """Duration of a physics step, ns."""
    bus: int
    """Duration of a bus cycle, ns."""
    saved: np.ndarray
    """MuJoCo's state before the last run of the engine, float64, to which a failed run returns."""
    edges: np.ndarray
    """EDGE records in which the engine logs the inputs of the chips, see `set_edge_buffer`."""

    def __init__(
        self,
        model: mujoco.MjModel,
        offset: int,
        plant: Sequence[PlantAxis],
        chip_axes: Sequence[ChipAxis],
        drives: Sequence[Drive | Servo],
        bus: int,
        encoders: Sequence[float],
        wires: Wires,
    ):
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model, self.data = model, mujoco.MjData(model)
        self.offset, self.bus, self.dt = offset, bus, round(model.opt.timestep * 1e9)
        chips = list_chips(chip_axes)
        self._allocate_records(len(plant), sum(len(p.switches) for p in plant), chips)
        self._set_engine_constants(sum(isinstance(drive, Servo) for drive in drives) + sum(map(bool, encoders)))
        self._set_chip_table(chips, wires.leaders, wires.linked)
        self._set_axis_table(plant, chip_axes, drives, chips, encoders, wires)
        self.saved = np.zeros(mujoco.mj_stateSize(model, SAVED_STATE_SPEC))
        rows = np.zeros(1, handle.HANDLE)
        handle.fill_handle(rows, 0, self)
        self.pointer, self.handle = rows.ctypes.data, rows.view(remove_attribute_access(handle.HANDLE))[0]
        max_edges = engine_records.MAX_EDGES_PER_WINDOW * len(plant)
        for chip in wires.linked:  # a pulse a clock, and what goes before and after it
            max_edges += engine_records.compute_clock_at(self.dt, chip.clock_hz) + SPARE_LINKED_EDGE_COUNT
        self.clockwork["most_edges"], self.clockwork["linked"] = max_edges, len(wires.linked)
        self.set_edge_buffer(np.zeros(SPARE_EDGE_COUNT + max_edges, engine_records.LOGGED_EDGE))

    @property
    def now(self) -> int:
        """Simulated time since power-up, ns."""
        return self.words.item(0)

    @property
    def start(self) -> int:
        """Time at the beginning of the present physics step, ns."""
        return self.words.item(START)

    @property
    def powered(self) -> int:
        """Validity of the state: 1, or 0 after userdata was cleared, for example by `mj_resetData`."""
        return self.words.item(POWERED)

    def set_edge_buffer(self, edges: np.ndarray) -> None:
        """Set the array of EDGE records in which the engine logs the inputs of the chips."""
        self.edges = edges
        self.handle["edges"], self.handle["edge_room"] = edges.ctypes.data, len(edges)

    def _allocate_records(self, axis_count: int, switch_count: int, chips: Sequence[Chip]) -> None:
        """Allocate the records in userdata, and the tables of constants in separate arrays."""
        self.userdata = self.data.userdata[self.offset :]
        left = self.userdata

        def take_records(dtype: np.dtype, n: int) -> np.ndarray:
            nonlocal left
            words = n * dtype.itemsize // 8
            words_cut, left = left[:words], left[words:]
            return words_cut.view(dtype)

        self.world = take_records(engine_records.STAGE_TIME, 1)
        self.words = self.world.view(np.int64)
        self.axes = take_records(engine_records.AXIS, axis_count)
        self.chips = [take_records(chip.CORE.STATE, 1) for chip in chips]
        self.drives = take_records(DRIVE, axis_count)
        self.switches = take_records(engine_records.SWITCH, switch_count)
        self.latches = take_records(engine_records.ADDRESS_TYPE, len(chips))
        self.axis_table = np.zeros(axis_count, engine_records.AXIS_ROW)
        self.switch_table = np.zeros(switch_count, engine_records.SWITCH_ROW)
        self.chip_table = np.zeros(len(chips), engine_records.CHIP_ROW)
        self.clockwork = np.zeros(1, engine_records.ENGINE_CONSTANTS)

    def _set_engine_constants(self, encoders: int) -> None:
        """Fill the CLOCKWORK record: durations, counts, and the addresses of MuJoCo's functions."""
        w, dt = self.clockwork[0], self.dt
        w.mj_step = mujoco_function_addresses.find_mujoco_address("mj_step")
        w.mj_get_state = mujoco_function_addresses.find_mujoco_address("mj_getState")
        w.state_spec, w.encoders = int(SAVED_STATE_SPEC), encoders
        w.dt = dt
        w.slices = engine_records.SLICES
        w.h = dt * 1e-9 / engine_records.SLICES
        w.half = dt * 0.5e-9
        w.nv = self.model.nv
        w.callbacks, w.native = mujoco_callback_guards.CALLBACK_ADDRESSES, mujoco_callback_guards.NATIVE_CALLBACKS

    def _set_chip_table(self, chips: Sequence[Chip], leaders: Mapping[Chip, Chip], linked: Sequence[Chip]) -> None:
        """Fill the table of chips: a CHIP record with the addresses of each chip."""
        w, self.slice_ends = self.clockwork[0], dict[int, np.ndarray]()
        rows_of = dict(zip(chips, self.chips, strict=True))
        self.chip_axes = [np.zeros(chip.AXES, core_interface.CHIP_AXIS) for chip in chips]
        for chip, rows, axes, c in zip(chips, self.chips, self.chip_axes, self.chip_table, strict=True):
            core_interface.fill_chip_record(c, chip.CORE, rows.ctypes.data)
            c.table = axes.ctypes.data
            c.hz, c.ticks = chip.clock_hz, w.h * chip.clock_hz
            c.slices, c.ends = w.slices, address_of(self._compute_slice_ends(chip.clock_hz))
            if chip in leaders:
                c.wire = leaders[chip].find_syno_address(rows_of[leaders[chip]])
            c.link = 1 if chip in linked else 0

    def _compute_slice_ends(self, clock_hz: int) -> np.ndarray:
        """Return the SLICE_END records of a window, for chips with this reference clock."""
        if clock_hz not in self.slice_ends:
            ns = [(k + 1) * self.dt // engine_records.SLICES for k in range(engine_records.SLICES)]
            self.slice_ends[clock_hz] = np.array(
                [divmod(end * clock_hz, core_interface.SLICE_REST_UNIT) for end in ns], core_interface.SLICE_END
            )
        return self.slice_ends[clock_hz]

    def _set_axis_table(
        self,
        plant: Sequence[PlantAxis],
        chip_axes: Sequence[ChipAxis],
        drives: Sequence[Drive | Servo],
        chips: Sequence[Chip],
        encoders: Sequence[float],
        wires: Wires,
    ) -> None:
        """Fill the tables of axes and of switches, and the tables in which chips find their axes."""
        first, flag_edges = 0, list[tuple[float, ...]]()
        axis_rows = self.axis_table.view(remove_attribute_access(engine_records.AXIS_ROW))
        switch_rows = self.switch_table.view(remove_attribute_access(engine_records.SWITCH_ROW))
        for k, (p, chip_axis, drive) in enumerate(zip(plant, chip_axes, drives, strict=True)):
            chip, j, t = chip_axis.chip, chip_axis.index, axis_rows[k]
            chip_index = chips.index(chip)
            t["chip"], t["chip_axis"] = chip_index, j
            c = self.chip_table[chip_index]
            c.axes += 1
            self.clockwork["currents"] += c.read_motor_current != 0
            self.clockwork["loads"] += c.set_load != 0
            chip_axis_record = self.chip_axes[chip_index][j]
            chip_axis_record.axis, chip_axis_record.means = k, address_of(self.axes[k]["counts"])
            chip_axis_record.net = address_of(self.axes[k : k + 1]["count"])
            t["qpos"], t["dof"], t["actuator"], t["gear"] = p.qpos, p.dof, p.actuator, p.gear
            t["index_bit"], t["index_at"] = chip.find_switch_input("ez"), p.index
            t["positive"] = wires.find_inverted_pins(k, chip)
            t["counts"] = drive.counts * p.gear / (2 * np.pi) if isinstance(drive, Servo) else encoders[k]
            end = first + len(p.switches)
            t["first_switch"], t["end_switch"] = first, end
            for row, s in zip(switch_rows[first:end], p.switches, strict=True):
                row["bit"], row["found"], row["dist"] = chip.find_switch_input(s.pin), s.found, s.dist
                row["forced"], row["turn"], row["first_edge"] = -1, s.turn, len(flag_edges)
                flag_edges += map(_READ_EDGE, s.edges)
                row["end_edge"] = len(flag_edges)
            first = end
        self.flag_edges = np.array(flag_edges, engine_records.FLAG_EDGE)
        self.clockwork["flag_edges"], self.clockwork["n_flag_edges"] = address_of(self.flag_edges), len(flag_edges)


def list_chips(axes: Sequence[ChipAxis]) -> tuple[Chip, ...]:
    """Return the chips of some axes, each once."""
    return tuple(dict.fromkeys(axis.chip for axis in axes))


def count_state_words(axes: Sequence[ChipAxis], switch_count: int) -> int:
    """Count the float64 words of userdata that the state of a stage takes.

    Args:
        axes: Axes of its chips.
        switch_count: Number of its switches.
    """
    per_axis = engine_records.AXIS.itemsize + DRIVE.itemsize
    rows = sum(chip.CORE.STATE.itemsize for chip in list_chips(axes))
    latches = len(list_chips(axes)) * engine_records.ADDRESS_TYPE.itemsize
    return (
        engine_records.STAGE_TIME.itemsize
        + len(axes) * per_axis
        + rows
        + switch_count * engine_records.SWITCH.itemsize
        + latches
    ) // 8
