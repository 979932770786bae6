"""`Stage`: chips, drives, motors and a MuJoCo stage under one clock.

    machine = Stage("xyz", chips=PCL240K)
    machine.axes["x"].chip.write(0, 0x10)          a bus cycle; takes `bus_cycle` seconds of simulated time
    machine.run(0.5)
    machine.axes["x"].position                     the true position in meters; .commanded is the position by the pulses

Promises, each with a test: the same stage, program and seed give the same bits; a run of n steps then m is a run of n + m;
snapshot, restore, copy and pickle continue bit for bit; an error leaves the state as it was.

This module is the interface for users. stage.sim.plant reads the model, chip_and_drive_assignment.py chooses the chips and drives,
a `State` holds the records, and a `StageLoop` advances time.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any
from zlib import crc32

import mujoco
import numpy as np

from stage import load_method_of_stage
from stage.chips import ChipAxis
from stage.chips.exclusive_access import SessionLock, exclusive
from stage.drives.dc_motors import Servo
from stage.drives.motors import Drive
from stage.errors import ArgumentError, RunTimeout, StageError, unknown_name_error
from stage.sim import (
    compiled_stage_access,
    encoder,
    engine,
    engine_records,
    integration_checks,
    mujoco_callback_guards,
    plant,
)
from stage.sim.axis import Axes, Axis, format_axes_table
from stage.sim.bus_device_state import DeviceState
from stage.sim.chip_and_drive_assignment import ChipChoice, DriveChoice, choose_chips_and_drives, fit_rotors
from stage.sim.encoder import EncoderChoice
from stage.sim.model_fingerprint import compute_mechanics_digest
from stage.sim.motor_replacement import compute_power_up_state, replace_motor_in_model, set_drive_record
from stage.sim.payload import Payloads
from stage.sim.stage_loop import StageLoop
from stage.sim.stage_snapshot import Snapshot, make_snapshot_header
from stage.sim.stage_state import SAVED_STATE_SPEC, State, count_state_words, list_chips
from stage.sim.wiring_arguments import Wires, WiringChoice, choose_leaders, choose_linked_axes, choose_wiring
from stage.support import html, snapshots
from stage.support.argument_checks import explain_arguments
from stage.support.snapshots import SnapshotHeader

if TYPE_CHECKING:
    from os import PathLike

    from stage.panel.server import Panel
    from stage.recording import Recording

MAX_RUN_S = 1_000_000_000  # s that a stage runs at a time: with as much behind it, a time in ns still fits 63 bits


class Stage:
    """A motion stage driven by emulated chips.

    Args:
        model: a name in models/ ("xyz", "xy"), a path to an MJCF file, an MjSpec or an MjModel that keeps the naming
            contract (docs/models.md).
        chips: a chip class or its name, a function that makes a chip, or a mapping axis -> any of these. A mapping chooses the
            axes. Axes that are given the same class or function share a chip as far as it has axes, in their order.
        drives: a Drive, for a chip of servos a Servo, a motor or its name, or a mapping axis -> either; default: the motor that
            the model names, 1/16 microsteps or an encoder of 2000 counts, 24 V.
        bus_cycle: seconds of simulated time that one bus cycle of a host takes.
        clock: Hz, the reference clock of chips that are given by class or name; default: that of each chip's data sheet.
        encoders: what the chips' own counters of the real position count (RP, EP of NOVA's): a mapping axis -> counts a metre
            (rad), all four edges of a line, or Encoders of stage.sim.encoder. Default: nothing; a Servo has its own.
        wiring: the logic of sensors: a mapping axis -> switch (or "ez", the index) -> "negative", low while on, or "positive".
            Default: the logic that the chip expects after a reset, negative for all of PulseStage's own chips. A chip with polarity
            bits can read other sensors; the drivers of stage.firmware set these bits.
        syni: chips of the PCL-240 family that count another's clock: a mapping follower -> leader of axes, {"y": "x"}.
        multichip: an axis of each MCX514 or MCX512 that the lines of multichip interpolation join, ["x", "u"].
        visuals: False discards elements that are only for display, for runs without pictures: the same bits, a third faster.

    Raises:
        ArgumentError: unknown model, axis, chip or motor.
        ModelError: the model breaks the naming contract, or its integrator or time step is not suitable.

    Attributes:
        model, data: the MjModel and the MjData.
        host: for recordings, the Board's data about the host's bus; None without a Board.
        axes: each `Axis` by its name, in the order of their indices.
        chips: all chips, each once.
        state: records of the stage in memory; for compiled code, boards and tests.
        loop: `StageLoop` that advances time; for boards and tests.
        device_state: arrays of devices on the bus, state outside MuJoCo's; for boards.
    """

    host: Any = None

    @explain_arguments
    def __init__(
        self,
        model: str | PathLike[str] | mujoco.MjModel | mujoco.MjSpec = "xyz",
        chips: ChipChoice | None = None,
        drives: DriveChoice = None,
        *,
        bus_cycle: float = 1e-6,
        clock: int | None = None,
        visuals: bool = True,
        encoders: EncoderChoice = None,
        wiring: WiringChoice = None,
        syni: Mapping[str, str] | None = None,
        multichip: Sequence[str] | None = None,
    ):
        if not 0 <= bus_cycle <= 1:
            raise ArgumentError(
                f"bus_cycle={bus_cycle!r}: a bus cycle takes 0 to 1 s; a slow microcomputer needs 1e-6."
            )
        spec = plant.open_shared_spec(model)
        if not visuals:
            plant.discard_visuals(spec)
        names, chip_axes, axis_drives = choose_chips_and_drives(spec, chips, drives, clock)
        self._encoders = encoder.choose_encoders(encoders, names, chip_axes)
        self._followers = choose_leaders(syni, names, chip_axes)
        self._linked, _ = choose_linked_axes(multichip, names, chip_axes)
        self.model, offset = plant.compile_spec(spec, count_state_words(chip_axes, 5 * len(names)))
        integration_checks.check_integration_options(self.model)
        try:
            self._plant = plant.bind_axes(self.model, names, spec)
            self._build(chip_axes, axis_drives, round(bus_cycle * 1e9), offset, wiring)
        except BaseException:
            for chip in list_chips(chip_axes):
                chip.detach()
            raise

    def _build(
        self,
        chip_axes: list[ChipAxis],
        drives: list[Drive | Servo],
        bus_cycle_ns: int,
        state_offset: int,
        wiring: WiringChoice,
    ) -> None:
        """Build the axes and the state of the stage from its chips and drives."""
        self._positive = choose_wiring(wiring, self._plant, chip_axes)
        fit_rotors(self.model, self._plant, chip_axes, drives)
        self._mechanics = compute_mechanics_digest(self.model)
        self._build_state(chip_axes, drives, bus_cycle_ns, state_offset)
        for k, d in enumerate(drives):
            d.fill_record(self.state.drives[k])
        mujoco_callback_guards.forward_guarded(self.model, self.data)
        integration_checks.check_dampers(self.model, self._plant, drives)
        integration_checks.check_step_length(self.model, self.data, self._plant, drives)
        engine.set_switch_levels.with_gil(self.state.pointer)
        self.run_to(0)
        self._initial = self.snapshot()

    def _build_state(
        self, chip_axes: list[ChipAxis], drives: list[Drive | Servo], bus_cycle_ns: int, state_offset: int
    ) -> None:
        """Lay the state out in userdata, and connect chips, drives and wires to it.

        Args:
            chip_axes: Axis of a chip for each axis of the stage.
            drives: Drive of each axis.
            bus_cycle_ns: Duration of a bus cycle, ns.
            state_offset: Word of userdata at which the state begins.
        """
        self._inherited: list[str] = []  # the faults, in words, of the stage that this is a copy of
        self.active_faults: list[Any] = []
        """The faults of `stage.sim.faults` that were made here and are in force, in their order."""
        self._payloads = Payloads()
        chip_of = {p.name: axis.chip for p, axis in zip(self._plant, chip_axes, strict=True)}
        wires = Wires(
            self._positive,
            {chip_of[follower]: chip_of[leader] for follower, leader in self._followers},
            tuple(dict.fromkeys(chip_of[name] for name in self._linked)),
        )
        per_unit = encoder.list_counts_per_unit(self._encoders, self._plant)
        self.state = State(self.model, state_offset, self._plant, chip_axes, drives, bus_cycle_ns, per_unit, wires)
        for follower, leader in wires.leaders.items():
            follower.syni = leader
        self.data, self.chips = self.state.data, list_chips(chip_axes)
        self.loop = StageLoop(self.state, self.chips, self._power_up)
        for chip, rows in zip(self.chips, self.state.chips, strict=True):
            chip.attach(self.loop, rows)
        for chip_axis, drive in zip(chip_axes, drives, strict=True):
            chip_axis.chip.fit_drive(drive, chip_axis.index)
        axes = zip(self._plant, chip_axes, drives, strict=True)
        self._axes = [
            Axis(self, k, p, chip_axis, drive, self._positive[k]) for k, (p, chip_axis, drive) in enumerate(axes)
        ]
        self.axes: Axes = Axes(self._axes)
        self._header = self._bare = self._make_header()
        self.device_state = DeviceState()

    def _make_header(self) -> SnapshotHeader:
        """Make the description of the stage in its snapshots, without the devices on its bus."""
        return make_snapshot_header(
            self.state, self._axes, self._mechanics, self._encoders, self._followers, self._linked
        )

    @property
    def lock(self) -> SessionLock | None:
        """Lock that users of the stage take while a session is open, see stage.chips.exclusive_access; None without a session."""
        return self.loop.lock

    # --- time ---

    @property
    def time(self) -> float:
        """Simulated seconds since power-up, to the nanosecond; `data.time` is that of the last physics step."""
        return self.state.now * 1e-9

    @property
    def now(self) -> int:
        """Simulated time since power-up, ns."""
        return self.state.now

    @property
    def bus_cycle(self) -> float:
        """Seconds that one bus cycle takes."""
        return self.state.bus * 1e-9

    @exclusive
    def cycle(self) -> None:
        """Let the time of one bus cycle pass."""
        self.loop.cycle()

    def ensure_powered(self) -> None:
        """Power the stage up if MuJoCo has cleared its state, as mj_resetData does: call it before reading records."""
        self.loop.ensure_powered()

    def prepare_change(self) -> None:
        """Check that this thread may write the stage's records, and power the stage up if MuJoCo has cleared its state.

        Raises:
            StageError: Another thread runs the stage.
        """
        self.loop.prepare_change()

    def _power_up(self) -> None:
        """Reset the stage after MuJoCo has cleared its state. Carriages stay where MuJoCo has put them, as by a keyframe."""
        data = self.data
        names = ("qpos", "qvel", "act", "mocap_pos", "mocap_quat")
        places = [getattr(data, name).copy() for name in names]
        self.restore(self._initial)
        arrays = [getattr(data, name) for name in names]
        if any(not np.array_equal(a, b) for a, b in zip(places, arrays, strict=True)):
            self._apply_positions(zip(arrays, places, strict=True))

    @explain_arguments
    @exclusive
    def step(self, n: int = 1) -> None:
        """Advance to the end of the current physics step, and n - 1 more.

        Args:
            n: Number of physics steps.

        Raises:
            ArgumentError: `n` is not a whole number, or out of range.
            SimulationError: The simulation diverges, see `run`.
        """
        dt = self.state.dt
        max_steps = MAX_RUN_S * engine_records.NS_PER_SECOND // dt
        if not 0 <= n <= max_steps or int(n) != n:
            raise ArgumentError(
                f"n={n!r}: a stage advances by a whole number of physics steps, 0 to {max_steps} ({MAX_RUN_S:g} s)."
            )
        self.loop.check_integration_options()
        self.loop.run_to(self.state.start + int(n) * dt)

    @explain_arguments
    @exclusive
    def run(self, seconds: float) -> None:
        """Advance by `seconds` of simulated time, rounded to a nanosecond.

        Args:
            seconds: Simulated time, s.

        Raises:
            SimulationError: The simulation diverges; the state is then that before the diverging step.
            StageError: The model's time step or integrator is not that with which the stage was built.
        """
        if not 0 <= seconds < MAX_RUN_S:
            raise ArgumentError(f"seconds={seconds!r}: time runs forward, by 0 to {MAX_RUN_S:g} s.")
        self.loop.check_integration_options()
        self.loop.run_to(self.state.now + round(seconds * 1e9))

    @explain_arguments
    @exclusive
    def run_to(self, until: int) -> None:
        """Advance to a time. A time that has passed changes nothing.

        Args:
            until: ns since power-up.

        Raises:
            ArgumentError: `until` is not a whole number, or too far away.
            SimulationError: The simulation diverges, see `run`.
        """
        if int(until) != until or until - self.state.now > MAX_RUN_S * engine_records.NS_PER_SECOND:
            raise ArgumentError(
                f"until={until!r}: a time is a whole number of ns since power-up, {MAX_RUN_S:g} s from now at most."
            )
        self.loop.check_integration_options()
        self.loop.run_to(max(int(until), self.state.now))

    @explain_arguments
    @exclusive
    def run_until(self, condition: Callable[[], bool], timeout: float, poll: float = 1e-3) -> float:
        """Advance until a condition holds.

        Args:
            condition: Function that is called every `poll` seconds of simulated time.
            timeout: Simulated time to wait, s.
            poll: Simulated time between two calls, s; 0: every nanosecond.

        Returns:
            Simulated seconds that passed.

        Raises:
            RunTimeout: The condition did not hold within `timeout`.
            ArgumentError: A time is out of range.
        """
        if not 0 <= timeout <= MAX_RUN_S:
            raise ArgumentError(f"timeout={timeout!r}: a condition is given 0 to {MAX_RUN_S:g} s of simulated time.")
        if not 0 <= poll <= MAX_RUN_S:
            raise ArgumentError(
                f"poll={poll!r}: a condition is looked at every 0 s (that is, every ns) to {MAX_RUN_S:g} s."
            )
        self.loop.check_integration_options()
        begin = self.now
        end = begin + round(timeout * 1e9)
        while not condition():
            now = self.now
            if now >= end:
                what = getattr(condition, "__name__", repr(condition))
                raise RunTimeout(
                    f"condition {what} did not come true in {timeout} s (now {self.time:.6f} s). "
                    f"Axes: {', '.join(repr(a) for a in self._axes)}"
                )
            self.loop.run_to(min(now + max(round(poll * 1e9), 1), end))
        return (self.now - begin) * 1e-9

    # --- load and faults ---

    @explain_arguments
    @exclusive
    def set_payload(self, mass: float, body: str | None = None) -> None:
        """Put a payload on a body, in place of the payload that it had, at the body's center of mass.

        The payload is part of the machine, not of its state: snapshots and `reset` leave it alone.

        Args:
            mass: kg.
            body: Name of the body; default: the one that carries the site "work".

        Raises:
            ArgumentError: The mass is out of range, or there is no such body.
        """
        self._payloads.set_payload(self.model, mass, body)

    @explain_arguments
    def payload(self, body: str | None = None) -> float:
        """Return the mass that `set_payload` put on a body, kg.

        Args:
            body: Name of the body; default: the one that carries the site "work".

        Raises:
            ArgumentError: There is no such body.
        """
        return self._payloads.get_payload(self.model, body)

    @property
    def faults(self) -> tuple[str, ...]:
        """Descriptions of the faults in force, see stage.faults. Faults belong to the machine: snapshots and `reset` keep them."""
        return (*self._inherited, *(fault.text for fault in self.active_faults))

    def note_fault(self, fault: Any, begins: bool) -> None:
        """Note that a fault begins or ends, in the list of active faults and in the recording.

        Args:
            fault: The `Fault`.
            begins: Whether the fault begins; False: it ends.
        """
        (self.active_faults.append if begins else self.active_faults.remove)(fault)
        if self.recording is not None:
            self.recording.add_fault_change(
                self.time, f"{fault.text}: {'begins' if begins else 'cleared'}", self.faults
            )

    @explain_arguments
    @exclusive
    def update_switches(self, axis: Axis) -> None:
        """Apply a change of an axis' rows of `state.switch_table` from now on."""
        self.loop.update_switches(axis.index)

    @explain_arguments
    @exclusive
    def replace_drive(self, axis: Axis, drive: Drive | Servo) -> None:
        """Give an axis a drive with another motor, see `faults.motor`. Snapshots that were taken before cannot be restored.

        Args:
            axis: Axis of this stage.
            drive: Its drive from now on.

        Raises:
            ArgumentError: `drive` is not a drive, or the rotor does not fit the armature.
            ModelError: The motor cannot be simulated with this time step. The stage has not changed.
        """
        if not isinstance(drive, Drive | Servo):
            raise ArgumentError(f"drive={drive!r}: give a Drive or a Servo.")
        self.prepare_change()
        self.loop.check_state_change_allowed()
        with self.loop.claim():
            replace_motor_in_model(self.model, self.data, self._axes, axis, drive)
            axis.drive = drive
            set_drive_record(self.state, axis, drive, self.state.drives[axis.index])
        self.apply_faults()
        before = self._initial
        self._bare = self._make_header()
        self._header = SnapshotHeader(self._bare.parts + self.device_state.header_part)
        self._initial = _make_snapshot(
            self._header, compute_power_up_state(self.state, axis, drive, before.state), before.diagnostics
        )

    @exclusive
    def apply_faults(self) -> None:
        """Apply `Axis.faults` to the drives and the switches, after either has changed."""
        state = self.state
        for axis, d in zip(self._axes, state.drives, strict=True):
            faults = axis.faults
            if (d.voltage, d.open) != (faults.bus_voltage, faults.open_phases):
                d.voltage, d.open, d.slice = faults.bus_voltage, faults.open_phases, 0.0
        forced = state.switch_table["forced"]
        if ((forced >= 0) & (forced != state.switches["on"])).any():
            for axis in self._axes:
                self.update_switches(axis)

    # --- state ---

    @explain_arguments
    @exclusive
    def place(self, /, **positions: float) -> None:
        """Place carriages, at rest, as if moved by hand with the motors off: `stage.place(x=0.05)`.

        The drives hold the nearest microstep from then on: no jump, no lost step.

        Args:
            positions: Axis -> position, m (rad on a hinge).

        Raises:
            ArgumentError: There is no such axis, or the position is outside its travel.
        """
        for name, q in positions.items():
            if name not in self.axes:
                raise unknown_name_error("axis", name, self.axes)
            low, high = self.axes[name].travel
            if not low <= q <= high:
                raise ArgumentError(f"{name}={q!r}: the joint travels from {low} to {high} {self.axes[name].unit}.")
        self.prepare_change()
        self.loop.check_time_allowed()
        qpos, qvel = self.data.qpos.copy(), self.data.qvel.copy()
        for name, q in positions.items():
            t = self.state.axis_table[self.axes[name].index]
            qpos[t.qpos], qvel[t.dof] = q, 0.0
        self._apply_positions([(self.data.qpos, qpos), (self.data.qvel, qvel)])

    def _apply_positions(self, changes: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        """Set positions or speeds in MuJoCo's data, and compute switch levels and edges again.

        Args:
            changes: Pairs of an array of MuJoCo and its new values.
        """

        def set_positions() -> None:
            for here, values in changes:
                here[:] = values

        with self.loop.claim():
            self.loop.apply_change(set_positions)
            engine.set_switch_levels.with_gil(self.state.pointer)
        for axis in self._axes:
            chip: Any = axis.chip
            if chip.open_journal is not None:
                if self.state.axis_table[axis.index].counts:
                    chip.open_journal.note_shaft(chip.clock, axis.chip_axis, *chip.get_shaft(axis.chip_axis))
                chip.open_journal.note_input(chip.clock, axis.chip_axis, chip.input_word(axis.chip_axis))

    @property
    def header(self) -> SnapshotHeader:
        """Description of the stage in its snapshots. A snapshot can be restored if its description is equal."""
        return self._header

    @exclusive
    def snapshot(self) -> Snapshot:
        """Return all state: physics, chips, drives, switches, devices, time."""
        self.prepare_change()
        state = np.zeros(len(self.state.saved) + self.device_state.words)
        self.copy_state(state)
        return _make_snapshot(self._header, state, tuple(tuple(chip.diagnostics) for chip in self.chips))

    def copy_state(self, state: np.ndarray) -> None:
        """Copy all state except the diagnostics into an array: MuJoCo's state, followed by the state of devices.

        Args:
            state: float64, (words,).

        Raises:
            ArgumentError: The array has another shape or type.
        """
        self._check_state(state)
        mujoco.mj_getState(self.model, self.data, state[: len(self.state.saved)], SAVED_STATE_SPEC)
        if self.device_state.words:
            self.device_state.copy_to(state[len(self.state.saved) :])

    @exclusive
    def load_state(self, state: np.ndarray) -> None:
        """Load a state that `copy_state` has copied from this stage or an equal one.

        Args:
            state: float64, (words,).

        Raises:
            ArgumentError: The array has another shape or type.
        """
        self._check_state(state)
        self.loop.load_state(state[: len(self.state.saved)])
        if self.device_state.words:
            self.device_state.copy_from(state[len(self.state.saved) :])

    def _check_state(self, state: np.ndarray) -> None:
        """Raise ArgumentError unless `state` is an array for all of the stage's state, of shape (words,) and float64."""
        words = len(self.state.saved) + self.device_state.words
        if not isinstance(state, np.ndarray) or state.dtype != np.float64 or state.shape != (words,):
            what = f"{state.dtype} of shape {state.shape}" if isinstance(state, np.ndarray) else repr(state)
            raise ArgumentError(f"state={what}: this stage's state is an array of float64 of shape ({words},).")

    @explain_arguments
    @exclusive
    def attach_device(self, name: str, arrays: Sequence[np.ndarray]) -> None:
        """Make the arrays of a device on the bus part of the stage's state; their present contents are those at power-up.

        Args:
            name: Name of the device.
            arrays: Contiguous arrays, which stay where they are.

        Raises:
            ArgumentError: An array is not contiguous.
        """
        self.device_state.add_device(name, arrays)
        header = SnapshotHeader(self._bare.parts + self.device_state.header_part)
        state = np.zeros(len(self.state.saved) + self.device_state.words)
        self.copy_state(state)
        before = self._initial
        state[: len(before.state)] = before.state
        self._header, self._initial = header, _make_snapshot(header, state, before.diagnostics)

    def _remove_devices(self, snapshot: Snapshot) -> Snapshot:
        """Remove the devices on the bus from a snapshot, for a copy of the stage, which has no board."""
        return _make_snapshot(self._bare, snapshot.state[: len(self.state.saved)].copy(), snapshot.diagnostics)

    @exclusive
    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot, bit for bit. Payloads and faults belong to the machine and stay as they are.

        Args:
            snapshot: Snapshot of this stage or an equal one.

        Raises:
            ArgumentError: The snapshot is damaged, or of another kind of stage (axes, chips, drives, bus cycle, time step or
                mechanics of the model).
            StageError: A recording is in progress.
        """
        snapshots.check_restorable(snapshot, Snapshot, self._header)
        if self.recording is not None:
            raise StageError("time in a recording runs forward only: close the recording before restoring a snapshot.")
        self.loop.check_state_change_allowed()
        self.load_state(snapshot.state)
        for chip, diagnostics in zip(self.chips, snapshot.diagnostics, strict=True):
            chip.diagnostics[:] = diagnostics
        self.apply_faults()

    def reset(self) -> None:
        """Return to power-up, the state in which the stage was made."""
        self.restore(self._initial)

    # --- recording ---

    @property
    def recording(self) -> Recording | None:
        """Recording in progress, or None."""
        taking = self.loop.recording
        return taking if taking is not None and taking.REQUIRES_FORWARD_TIME else None

    @explain_arguments
    def record(
        self,
        every: float = 1e-3,
        path: str | PathLike | None = None,
        *,
        overwrite: bool = False,
        on_error: str = "raise",
    ) -> Recording:
        """Record the stage from now to the close of the recording; use it as `with stage.record() as recording:`.

        Args:
            every: Seconds between samples, up to 1e6, rounded to whole physics steps, at least one; switch edges and bus writes are
                always exact.
            path: File of rerun to write at the same time, see `Recording.stream`.
            overwrite: Whether an existing file may be replaced.
            on_error: "raise" or "warn", for errors of the file.

        Raises:
            ArgumentError: `every` is out of range.
            StageError: Another recording is in progress.
            RecordingError: The file cannot be written.
        """
        return load_method_of_stage("record")(self, every, path, overwrite=overwrite, on_error=on_error)

    @exclusive
    def begin_recording(self, recording: Any, steps: int) -> None:
        """Make the engine fill the buffers of a recording from now on, see `StageLoop.recording`.

        Args:
            recording: Owner of the buffers.
            steps: Physics steps between two samples.
        """
        self.prepare_change()
        self.loop.recording = recording
        compiled_stage_access.set_sample_buffers(self.state.handle, recording)
        self.state.clockwork[0].sample_every = self.state.world[0].to_sample = steps

    def stop_recording(self) -> None:
        """Stop filling the buffers of a recording. `Recording.close` is the usual way."""
        self.loop.recording = None
        compiled_stage_access.set_sample_buffers(self.state.handle, None)
        self.state.clockwork[0].sample_every = 0

    # --- a page ---

    def panel(
        self,
        port: int = 0,
        *,
        host: str = "127.0.0.1",
        speed: float = 1.0,
        program: str = "your program",
        browser: bool = True,
    ) -> Panel:
        """Open a live page of the stage for the program that drives it, until its `close()`; see docs/panel.md.

        From now on simulated time passes at most `speed` times as fast as real time. The program waits while a user of the page has
        paused it or has taken control of the stage. The stage behaves the same, bit for bit, unless a user changes something.

        Args:
            port: TCP port, 0 for a free one.
            host: Address to bind. With an address other than 127.0.0.1 everybody who has the link with its token can connect.
            speed: Largest number of simulated seconds per second.
            program: Name of the program on the page.
            browser: Whether to open the page in a browser; the attribute `address` of the result has the link.

        Raises:
            ArgumentError: An argument is out of range.
            StageError: NiceGUI is missing, the port is taken, or the stage has a session already.
        """
        return load_method_of_stage("panel")(self, port, host=host, speed=speed, program=program, browser=browser)

    # --- copies ---

    def describe_machine(self) -> dict[str, Any]:
        """Return a description of the machine, including faults and payloads but without its state, for copies of the stage."""
        return {
            "model": self.model,
            "plant": self._plant,
            "chips": [(type(chip), chip.options()) for chip in self.chips],
            "wired": [(self.chips.index(a.chip), a.chip_axis) for a in self._axes],
            "drives": [a.drive for a in self._axes],
            "encoders": self._encoders,
            "positive": self._positive,
            "followers": self._followers,
            "linked": self._linked,
            "bus_ns": self.state.bus,
            "offset": self.state.offset,
            "mechanics": self._mechanics,
            "axis_faults": [a.faults.copy() for a in self._axes],
            "faults": list(self.faults),
            "payloads": (dict(self._payloads.kg), dict(self._payloads.body_masses)),
        }

    def __getstate__(self) -> dict[str, Any]:
        return {
            **self.describe_machine(),
            "initial": self._remove_devices(self._initial),
            "now": self._remove_devices(self.snapshot()),
        }

    def __setstate__(self, s: dict[str, Any]) -> None:
        self.model = s["model"]
        self._plant, self._mechanics, self._encoders = s["plant"], s["mechanics"], s["encoders"]
        self._positive, self._followers, self._linked = s["positive"], s["followers"], s["linked"]
        chips = [cls(**options) for cls, options in s["chips"]]
        self._build_state([chips[k].axes[j] for k, j in s["wired"]], s["drives"], s["bus_ns"], s["offset"])
        for axis, faults in zip(self._axes, s["axis_faults"], strict=True):
            axis.faults.load(faults)
        self._inherited = s["faults"]
        self._payloads.kg, self._payloads.body_masses = s["payloads"]
        self._initial = s["initial"]
        self.restore(s["now"])

    def __deepcopy__(self, memo: dict) -> Stage:
        replica = object.__new__(type(self))
        state = self.__getstate__()
        replica.__setstate__(state | {"model": copy.copy(self.model)})
        return replica

    def __copy__(self) -> Stage:
        return self.__deepcopy__({})

    def __repr__(self) -> str:
        chips = ", ".join(dict.fromkeys(type(chip).__name__ for chip in self.chips))
        return f"<Stage {', '.join(self.axes)}: {chips}, {self.time:.6f} s>"

    def _repr_html_(self) -> str:
        more = f"; faults: {'; '.join(self.faults)}" if self.faults else ""
        return html.format_heading(f"Stage at {self.time:.6f} s{more}") + format_axes_table(self._axes)


def _make_snapshot(header: SnapshotHeader, state: np.ndarray, diagnostics: tuple) -> Snapshot:
    """Make a snapshot with its checksum."""
    state.flags.writeable = False
    return Snapshot(header, state, diagnostics, crc32(state.data, header.checksum))
