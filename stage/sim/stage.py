"""`Stage`: chips, drives, motors and a MuJoCo stage under one clock.

    stage = Stage("xyz", chips=PCL240K)
    stage.axes["x"].chip.write(0, 0x10)          a bus cycle; takes `bus_cycle` seconds of simulated time
    stage.run(0.5)
    stage.axes["x"].position                     metres, true; .commanded is where the pulses say it should be

Promises, each with a test: the same stage, program and seed give the same bits; a run of n steps then m is a run of n + m;
snapshot, restore, copy and pickle continue bit for bit; an error leaves the state as it was.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar
from zlib import crc32

import mujoco
import numpy as np

from stage import snapshots
from stage.chips import CHIPS, PCL240K, Chip, ChipAxis, chip_class, cores
from stage.chips.entries import PACKED, SEE
from stage.drives import drive as any_drive
from stage.drives import stepper
from stage.drives.dc_motors import DC_MOTORS, DCMotor, Servo, dc_motor
from stage.drives.motors import MOTORS, Drive, Motor, motor
from stage.errors import (
    ArgumentError,
    ModelError,
    RunTimeout,
    SimulationError,
    StageError,
    UnknownKey,
    unknown,
)
from stage.native import address_of, plain
from stage.sim import callbacks, engine, handle, integration, libmujoco, plant
from stage.sim.fingerprint import mechanics
from stage.sim.in_use import token

if TYPE_CHECKING:
    from os import PathLike

    from stage.chips.chip import Pins
    from stage.recording import Recording

STATE = mujoco.mjtState.mjSTATE_INTEGRATION  # all of it: physics, and in userdata chips, drives, switches
HYSTERESIS = 25e-6  # m; a slotted optical switch lets go that much later than it trips (typical data sheets)
EDGES = 640
LONGEST = 1_000_000_000  # s that a stage runs at a time: with as much behind it, a time in ns still fits 63 bits
HEAVIEST = 1e6  # kg
SWITCH_FAULTS = ("forced", "bounce", "toggles")  # of the table of switches: what faults change
POWERED = (engine.WORLD.names or ()).index("powered")
SHORT, LONG = 0.025, 0.1  # s of real time, a piece of a long run takes between them: Ctrl-C is seen to after each
FIRST_PIECE = 16  # physics steps
IN_USE = (
    "this stage is in use, by another thread or by the run that has called MuJoCo's callback: one thread at a time runs a stage "
    "or changes it. Give each thread a stage of its own, copy.deepcopy(stage); stage.sim.fleet.Fleet plays many on threads."
)

ChipChoice = type[Chip] | str | Callable[[], Chip] | Mapping[str, Any]
DriveChoice = Drive | Servo | Motor | DCMotor | str | Mapping[str, Any] | None


class Snapshot(snapshots.Snapshot):
    """All state of a stage; restores into any stage made alike. state: MuJoCo's, float64; diagnostics: of each chip."""

    of: ClassVar = "a stage"


class Switches:
    """The limit switches of an axis by name; True = asserted. `stick` forces one, for fault tests."""

    _axis: Axis

    def __init__(self, axis: Axis):
        object.__setattr__(self, "_axis", axis)

    def _find(self, name: str) -> int:
        axis = self._axis
        for k, s in enumerate(axis._plant.switches):
            if s.pin == name:
                return int(axis._stage._table[axis.index].first_switch) + k
        raise unknown(f"switch of axis {axis.name}", name, (s.pin for s in axis._plant.switches))

    def __getattr__(self, name: str) -> bool:
        if name.startswith("_"):
            raise AttributeError(name)
        self._axis._stage._awake()
        return bool(self._axis._stage._switches[self._find(name)].on)

    def __setattr__(self, name: str, value: Any) -> None:
        raise StageError(f"a switch follows its vane; to force {name!r} use switches.stick({name!r}, True or False).")

    def stick(self, name: str, asserted: bool | None) -> None:
        """Hold switch `name` asserted (True) or released (False) from now on; None mends it. Raises ArgumentError."""
        if asserted is not None and (not isinstance(asserted, int | np.bool_) or asserted not in (0, 1)):
            raise ArgumentError(f"asserted={asserted!r}: True holds {name} asserted, False released, None mends it.")
        self._axis._stage.change()
        self._axis._stage._switch_table[self._find(name)].forced = -1 if asserted is None else int(asserted)
        self._axis._stage._look_again(self._axis.index)

    def __dir__(self) -> list[str]:
        return [s.pin for s in self._axis._plant.switches]

    def as_dict(self) -> dict[str, bool]:
        """Every switch fitted."""
        return {s.pin: getattr(self, s.pin) for s in self._axis._plant.switches}

    def __repr__(self) -> str:
        return f"Switches({', '.join(name for name, on in self.as_dict().items() if on) or 'none asserted'})"


class Axis:
    """One axis: chip, drive, motor, joint, switches.

    Attributes:
        name, chip, drive: as given; `chip_axis`: the number of its axis of the chip.
        index: its column in recordings; `joint`: id in the model.
        gear: rotor radians per joint unit; meters_per_pulse: joint units per pulse (rad on a hinge).
        unit: "m", or "rad" on a hinge.
    """

    def __init__(
        self, stage: Stage, index: int, plant_axis: plant.PlantAxis, chip_axis: ChipAxis, drive: Drive | Servo
    ):
        self._stage, self._plant = stage, plant_axis
        self.index, self.name, self.drive = index, plant_axis.name, drive
        self.chip, self.chip_axis = chip_axis.chip, chip_axis.index
        self.joint, self.gear, self.travel = plant_axis.joint, plant_axis.gear, plant_axis.travel
        self.unit = "rad" if plant_axis.hinge else "m"
        self.meters_per_pulse = 2 * np.pi / drive.pulses_per_turn / abs(self.gear)
        self.switches = Switches(self)
        self._voltage, self._open = drive.bus_voltage, 0  # faults change them: see stage.faults

    @property
    def pins(self) -> Pins:
        """The pins of its axis of the chip."""
        return self.chip.axes[self.chip_axis].pins

    @property
    def time(self) -> float:
        """Simulated time of the stage, s."""
        return self._stage.time

    def wait(self, seconds: float) -> None:
        """Let simulated time pass, for the whole stage."""
        self._stage.run(seconds)

    @property
    def position(self) -> float:
        """Where the carriage is, m (rad on a hinge)."""
        return self._stage._joint_position(self.index)

    @property
    def commanded(self) -> float:
        """Where the pulses say that the carriage is, m; it differs from `position` by following error and lost steps."""
        q = self.position
        d, net = self._electrics()
        return float(q + any_drive.behind(d, net, q * self.gear) / self.gear)

    @property
    def lost_steps(self) -> int:
        """Full steps by which the rotor is behind the pulses, a multiple of four; from the rotor's angle. 0 for a servo."""
        d, net = self._electrics()
        return int(any_drive.lost_steps(d, net, self.position * self.gear))

    @property
    def load_angle(self) -> float:
        """Commanded minus rotor angle, electrical radians; plain radians for a servo."""
        d, net = self._electrics()
        return float(any_drive.load_angle(d, net, self.position * self.gear))

    def __reduce__(self) -> tuple:
        """A copy is the same axis of a copy of its stage: by itself it would be a chip that nothing drives."""
        return _axis_of, (self._stage, self.name)

    def _electrics(self) -> tuple[Any, float]:
        chip = self.chip
        return self._stage._drives[self.index], float(chip.CORE.net.held(chip._at, self.chip_axis))

    def __repr__(self) -> str:
        return (
            f"<Axis {self.name} {type(self.chip).__name__} position={self.position * 1e3:.4f} m{self.unit} "
            f"lost_steps={self.lost_steps} {self.switches!r}>"
        )


def _axis_of(stage: Stage, name: str) -> Axis:
    return stage.axes[name]


class _Axes(dict[str, Axis]):
    """Axes by name; for a wrong one the near misses."""

    def __missing__(self, name: Any) -> Axis:
        raise UnknownKey(str(unknown("axis", name, self)))


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
        visuals: False leaves out what is only looked at, for runs that nobody sees: the same bits, a third faster.
    Raises:
        ArgumentError: unknown model, axis, chip or motor. ModelError: the model breaks the naming contract, or its integrator or
            time step cannot be right.
    """

    def __init__(
        self,
        model: Any = "xyz",
        chips: ChipChoice | None = None,
        drives: DriveChoice = None,
        *,
        bus_cycle: float = 1e-6,
        visuals: bool = True,
    ):
        chips = _named(PCL240K if chips is None else chips)
        if not 0 <= bus_cycle <= 1:
            raise ArgumentError(
                f"bus_cycle={bus_cycle!r}: a bus cycle takes 0 to 1 s; a slow microcomputer needs 1e-6."
            )
        spec = plant.open_spec(model)
        if not visuals:
            plant.discard_visuals(spec)
        known = plant.axis_names(spec)
        names = list(chips) if isinstance(chips, Mapping) else known
        for given in (chips, drives):
            for name in given if isinstance(given, Mapping) else ():
                if name not in known:
                    raise unknown("axis", name, known)
        made = _make_chips(chips, names)
        chosen = [_choose_drive(drives, name, axis.chip, spec) for name, axis in zip(names, made, strict=True)]
        self.model, offset = plant.compile_spec(spec, _words(made, 5 * len(names)))
        integration.check_options(self.model)
        free = [(chip, chip._rows, chip._i) for chip in _each_once(made)]
        try:
            self._build(names, made, chosen, round(bus_cycle * 1e9), offset)
        except BaseException:
            for chip, rows, i in free:
                chip._detach(rows, i)
            raise

    def _build(
        self, names: list[str], chips: list[ChipAxis], chosen: list[Drive | Servo], bus_ns: int, offset: int
    ) -> None:
        model = self.model
        self._plant = plant.bind(model, names)
        for p, axis, d in zip(self._plant, chips, chosen, strict=True):
            if p.servo != axis.chip.SERVO:
                have, want = ("<dcmotor>", "<motor>") if p.servo else ("<motor>", "<dcmotor>")
                raise ModelError(
                    f"axis {p.name}: {type(axis.chip).__name__} drives a {want}, and this MjModel, which cannot change, has a "
                    f"{have}: pass its path or MjSpec."
                )
            built_in = _motor_named(p.motor).rotor_inertia if p.motor else d.motor.rotor_inertia
            given, inside = float(model.dof_armature[p.dof]), built_in * p.gear**2
            model.dof_armature[p.dof] += (d.motor.rotor_inertia - built_in) * p.gear**2
            if model.dof_armature[p.dof] < 0:
                raise ModelError(
                    f"axis {p.name}: the model names motor {p.motor} inside an armature of {given:g}, but the rotor of that alone "
                    f'makes {inside:g}: write armature="{inside:g}" or more, or leave the text {p.name}_motor out.'
                )
        self._mechanics = mechanics(model)
        self._wire(chips, chosen, bus_ns, offset)
        for k, d in enumerate(chosen):
            d.fill(self._drives[k])
        mujoco.mj_forward(model, self.data)
        integration.check_step(model, self.data, self._plant, chosen)
        handle.settle.held(self._at)
        self._run_until(0)
        self._initial = self.snapshot()

    def _wire(self, chips: list[ChipAxis], drives: list[Drive | Servo], bus_ns: int, offset: int) -> None:
        """Lay the state out in userdata and the tables beside it; connect the axes of the chips, one an axis of the stage."""
        model = self.model
        self._faults: list[str] = []
        self._payloads: dict[int, float] = {}
        self._own_masses: dict[int, float] = {}
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(model)
        self._offset, self._bus_ns = offset, bus_ns
        n, m = len(chips), sum(len(p.switches) for p in self._plant)
        cut = _Cut(self.data.userdata[offset:])
        self._world = cut(engine.WORLD, 1)
        self._words = self._world.view(np.int64)  # now, start, ... powered: fast access from Python
        self._axis_state = cut(engine.AXIS, n)
        self.chips = _each_once(chips)
        for chip in self.chips:
            chip._attach(self, cut(chip.CORE.STATE, 1), 0)
        self._drives = cut(stepper.DRIVE, n)
        self._switches = cut(engine.SWITCH, m)
        self._table = np.zeros(n, engine.AXIS_TABLE)
        self._switch_table = np.zeros(m, engine.SWITCH_TABLE)
        self._clockwork = np.zeros(1, engine.CLOCKWORK)
        dt = round(model.opt.timestep * 1e9)
        self._dt = dt
        w = self._clockwork[0]
        w.mj_step, w.mj_get_state, w.state_spec = (
            libmujoco.address("mj_step"),
            libmujoco.address("mj_getState"),
            int(STATE),
        )
        w.dt, w.slices, w.h, w.half, w.nv = dt, engine.SLICES, dt * 1e-9 / engine.SLICES, dt * 0.5e-9, model.nv
        w.callbacks, w.native = callbacks.ADDRESSES, callbacks.NATIVE
        self._piece = FIRST_PIECE * dt
        self._failure: BaseException | None = None
        self._chip_table = np.zeros(len(self.chips), engine.CHIP_TABLE)
        for chip, c in zip(self.chips, self._chip_table, strict=True):
            cores.fill(c, chip.CORE, chip._here)
            c.hz, c.ticks = chip.clock_hz, w.h * chip.clock_hz
            c.slices, c.clocks = w.slices, address_of(w["clocks"])
        axes, first = _Axes(), 0
        for k, (p, chip_axis, drive) in enumerate(zip(self._plant, chips, drives, strict=True)):
            chip, t = chip_axis.chip, self._table[k]
            t.chip, t.chip_axis = self.chips.index(chip), chip_axis.index
            self._chip_table[t.chip].axis[chip_axis.index] = k
            self._chip_table[t.chip].axes += 1
            self._chip_table[t.chip].means[chip_axis.index] = address_of(self._axis_state[k]["counts"])
            self._chip_table[t.chip].nets[chip_axis.index] = address_of(self._axis_state[k : k + 1]["count"])
            t.qpos, t.dof, t.actuator, t.gear = p.qpos, p.dof, p.actuator, p.gear
            t.index_bit, t.index_at = chip.wired("ez"), p.index
            if isinstance(drive, Servo):
                t.counts = drive.counts * p.gear / (2 * np.pi)
                w.encoders += 1
            t.first_switch, t.end_switch = first, first + len(p.switches)
            for row, s in zip(self._switch_table[first : t.end_switch], p.switches, strict=True):
                row.bit, row.found, row.at, row.slope = chip.wired(s.pin), s.found, s.dist, s.slope
                row.hysteresis, row.forced = HYSTERESIS * abs(s.slope), -1
            first = int(t.end_switch)
            axes[p.name] = Axis(self, k, p, chip_axis, drive)
        self.axes: Mapping[str, Axis] = MappingProxyType(axes)
        self._axes_by_index = list(axes.values())
        self._recording: Recording | None = None
        self._counts = np.zeros(2, np.int64)
        self._state = np.zeros(mujoco.mj_stateSize(model, STATE))
        rows = np.zeros(1, handle.HANDLE)
        handle.fill(rows, 0, self)
        self._at, self._handle = rows.ctypes.data, rows.view(plain(handle.HANDLE))[0]
        self._note_in(np.zeros(EDGES + engine.EDGES_A_WINDOW * n, engine.EDGE))
        self._advance = handle.advance.c
        self._header = self._headed()

    def _note_in(self, edges: np.ndarray) -> None:
        """From now on the engine notes what reaches the chips in `edges`."""
        self._edges = edges
        self._handle["edges"], self._handle["edge_room"] = edges.ctypes.data, len(edges)

    # --- time ---

    @property
    def time(self) -> float:
        """Simulated seconds since power-up, to the nanosecond. (`data.time` is that of the last physics step.)"""
        return self._now * 1e-9

    @property
    def _now(self) -> int:
        return self._words.item(0)

    @property
    def bus_cycle(self) -> float:
        """Seconds that one bus cycle takes."""
        return self._bus_ns * 1e-9

    def cycle(self) -> None:
        """Let the time of one bus cycle pass; chips call it before each read and write."""
        if self._bus_ns:
            self._run_until(self._now + self._bus_ns)
        else:
            self.change()

    def look(self) -> None:
        """Chips call it before their state is looked at."""
        if not self._words.item(POWERED):
            self._awake()

    def change(self) -> None:
        """Chips call it before their state is changed. Raises StageError while another thread runs the stage."""
        if self._clockwork["busy"].item(0):
            raise StageError(IN_USE)
        self._awake()

    def _awake(self) -> None:
        """Whoever looks at the stage sees a machine under power, also after mj_resetData, mj_resetDataKeyframe and the like: they
        clear userdata, where chips and drives live. Not in a recording, whose time would run backwards."""
        if not self._words.item(POWERED) and self._recording is None:
            self._power_up()

    def _power_up(self) -> None:
        """As `reset`; but a carriage that MuJoCo put elsewhere (a keyframe's place) is there."""
        data = self.data
        names = ("qpos", "qvel", "act", "mocap_pos", "mocap_quat")
        given = [getattr(data, name).copy() for name in names]
        self.restore(self._initial)
        here = [getattr(data, name) for name in names]
        if any(not np.array_equal(a, b) for a, b in zip(given, here, strict=True)):
            for a, b in zip(given, here, strict=True):
                b[:] = a
            self._settle()

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """In here nobody else runs the stage. Raises StageError if somebody does."""
        mine = token()
        try:
            if not handle.take.held(self._at, mine):
                raise StageError(IN_USE)
            yield
        finally:
            handle.give.held(self._at, mine)

    def step(self, n: int = 1) -> None:
        """Advance to the end of the current physics step, and n - 1 more."""
        most = LONGEST * engine.SECOND // self._dt
        if not 0 <= n <= most or int(n) != n:
            raise ArgumentError(
                f"n={n!r}: a stage advances by a whole number of physics steps, 0 to {most} ({LONGEST:g} s)."
            )
        self._run_until(self._words.item(1) + int(n) * self._dt)

    def run(self, seconds: float) -> None:
        """Advance by `seconds` of simulated time, rounded to a nanosecond.

        Raises SimulationError when the simulation diverges; the state is then that before the step which did.
        """
        if not 0 <= seconds < LONGEST:
            raise ArgumentError(f"seconds={seconds!r}: time runs forward, by 0 to {LONGEST:g} s.")
        self._run_until(self._now + round(seconds * 1e9))

    def run_until(self, condition: Callable[[], bool], timeout: float, poll: float = 1e-3) -> float:
        """Advance until `condition()` holds, looked at every `poll` seconds. Returns the seconds that passed.

        Raises RunTimeout when `timeout` seconds of simulated time were not enough; ArgumentError.
        """
        if not 0 <= timeout <= LONGEST:
            raise ArgumentError(f"timeout={timeout!r}: a condition is given 0 to {LONGEST:g} s of simulated time.")
        if not 0 <= poll <= LONGEST:
            raise ArgumentError(
                f"poll={poll!r}: a condition is looked at every 0 s (that is, every ns) to {LONGEST:g} s."
            )
        begin = self._now
        end = begin + round(timeout * 1e9)
        while not condition():
            now = self._now
            if now >= end:
                what = getattr(condition, "__name__", repr(condition))
                raise RunTimeout(
                    f"condition {what} did not come true in {timeout} s (now {self.time:.6f} s). "
                    f"Axes: {', '.join(repr(a) for a in self._axes_by_index)}"
                )
            self._run_until(min(now + max(round(poll * 1e9), 1), end))
        return (self._now - begin) * 1e-9

    def _run_until(self, until: int) -> None:
        recording, piece = self._recording, self._piece
        while True:
            goal = until
            if long := until - self._words.item(1) > piece:
                goal, begin = self._words.item(1) + piece, perf_counter()
            if recording is not None:
                self._handle["filled"] = recording.filled
            try:
                status = self._advance(self._at, goal)
            except BaseException:  # Ctrl-C while compiled code ran: it has come to its end
                self._account(int(self._handle["status"]), 0)
                raise
            if status or recording is not None or self._handle["noted"]:
                self._account(status, until)
            if long:
                if status == engine.REACHED:
                    self._piece = piece = self._next_piece(perf_counter() - begin)
            elif status == engine.REACHED:
                return

    def _next_piece(self, took: float) -> int:
        """ns of simulated time for the next piece of a long run, when the last took so many seconds."""
        if took < SHORT:
            return min(2 * self._piece, 1 << 60)
        return max(self._piece // 2, self._dt) if took > LONG else self._piece

    def _account(self, status: int, until: int) -> None:
        """The engine has returned on its way to `until`: what it noted is taken, what stopped it is seen to, or raised."""
        h, recording = self._handle, self._recording
        error: BaseException | None = None
        if status == engine.DIVERGED:
            error = self._undo_divergence(self._at)
        elif status == engine.FAILED:
            error = self._undo_failure()
        elif status == engine.IN_USE:
            raise StageError(IN_USE)
        if h["noted"]:
            self._note_edges(int(h["noted"]))
            h["noted"] = 0
        if recording is not None:
            recording.take(int(h["filled"]))
        if error is not None:
            raise error
        if status == engine.WIPED:
            if recording is not None:
                raise StageError(
                    "the stage's state was cleared (mj_resetData?) in the middle of a recording, whose time runs forward only: "
                    "close the recording; the stage is at power-up then."
                )
            self._power_up()
        elif status == engine.UNGUARDED:
            self._run_guarded(until)

    def _run_guarded(self, until: int) -> None:
        """As `_run_until` where MuJoCo calls somebody back: a physics step at a time, to go back to the one before."""
        clockwork = self._clockwork[0]

        def failed(error: BaseException | None) -> bool:
            if error is not None:
                self._failure, clockwork.failed = error, 1
            return bool(clockwork.failed)

        try:
            with callbacks.guarded(failed):
                clockwork.guarded = 1
                while self._now < until:
                    self._run_until(min(until, self._words.item(1) + self._dt))
        finally:
            clockwork.guarded = clockwork.failed = 0

    def _note_edges(self, n: int) -> None:
        edges, chip_of = self._edges[:n], self._table["chip"][self._edges["axis"][:n]]
        for k, chip in enumerate(self.chips):
            if chip._journal is None:
                continue
            own = np.flatnonzero(chip_of == k)
            if not len(own):
                continue
            packed = np.empty(len(own), PACKED)
            for name in PACKED.names or ():
                packed[name] = edges[name][own]
            seen = np.flatnonzero(packed["kind"] == SEE)
            if len(seen):
                packed["a"][seen] = edges["count"][own[seen]].view(np.int64)
                packed["b"][seen] = edges["rate"][own[seen]].view(np.int64)
            chip._journal.extend(packed)

    def _look_again(self, axis: int) -> None:
        """The table of switches has changed: what it means for this axis, from now on."""
        self._awake()
        with self._alone():
            handle.look_again.held(self._at, axis)
        if n := int(self._handle["noted"]):
            self._note_edges(n)
            self._handle["noted"] = 0

    def _equip(self) -> None:
        """Whatever state they were restored to: the drives have the supply and windings of today, and stuck switches stick."""
        for axis, d in zip(self._axes_by_index, self._drives, strict=True):
            if (d.voltage, d.open) != (axis._voltage, axis._open):
                d.voltage, d.open, d.slice = axis._voltage, axis._open, 0.0
        forced = self._switch_table["forced"]
        if ((forced >= 0) & (forced != self._switches["on"])).any():
            for axis in self._axes_by_index:
                self._look_again(axis.index)

    def _undo_failure(self) -> BaseException:
        """Go back to before the step in which a callback failed."""
        mujoco.mj_setState(self.model, self.data, self._state, STATE)
        self._clockwork[0].failed = 0
        failure, self._failure = self._failure, None
        if not isinstance(failure, Exception):  # Ctrl-C while it ran
            return failure or KeyboardInterrupt()
        error = SimulationError(
            f"a callback that MuJoCo calls raised {type(failure).__name__}: {failure} (at {self.time:.6f} s). The stage holds the "
            "state before that physics step.",
            self.time,
            "",
        )
        error.__cause__ = failure
        return error

    def _undo_divergence(self, at: int) -> SimulationError:
        """Go back to where the last loop began and run it again, by the handle at this address, up to the step before the one that
        diverged."""
        speeds = np.abs(self.data.qvel)
        bad = int(np.argmax(np.where(np.isfinite(speeds), speeds, np.inf)))
        joint = self.model.joint(int(self.model.dof_jntid[bad])).name or f"degree of freedom {bad}"
        good = self._words.item(1) - self._dt
        mujoco.mj_setState(self.model, self.data, self._state, STATE)
        self._advance(at, good)
        return SimulationError(
            f"the simulation diverged at {self.time:.6f} s on axis {joint!r}: its speed left +-{engine.MAX_SPEED:g} per "
            f"second. The stage holds the state before that step. Usual causes: a timestep too long for the motor's "
            f"stiffness (now {self.model.opt.timestep} s), a mass near zero, or an external force that is not finite.",
            self.time,
            joint,
        )

    # --- load ---

    def set_payload(self, mass: float, body: str | None = None) -> None:
        """Put `mass` kg on a body, in place of the payload that it had; default: the body that carries the site "work".

        The payload is part of the machine, not of its state: snapshots and `reset` leave it alone. It sits at the body's
        centre of mass. Raises ArgumentError.
        """
        model, k = self.model, self._carrier(body)
        if not 0 <= mass < HEAVIEST:
            raise ArgumentError(f"mass={mass!r} kg: a payload weighs 0 kg or more, and less than {HEAVIEST:g} kg.")
        if mass == self._payloads.get(k, 0.0):
            return
        own = self._own_masses.setdefault(k, float(model.body_mass[k]))
        self._payloads[k] = float(mass)
        model.body_mass[k] = own + mass
        mujoco.mj_setConst(model, mujoco.MjData(model))

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults in force, in words, see stage.faults. They are the machine's: snapshots and `reset` leave them alone."""
        return tuple(self._faults)

    def payload(self, body: str | None = None) -> float:
        """kg that `set_payload` put on a body; see there. Raises ArgumentError."""
        return self._payloads.get(self._carrier(body), 0.0)

    def _carrier(self, body: str | None) -> int:
        """The id of the body that a payload goes on."""
        model = self.model
        if body is None:
            site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "work")
            if site < 0:
                raise ArgumentError("the model has no site 'work' to put a payload on: name the body.")
            return int(model.site_bodyid[site])
        k = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body))
        if k < 0:
            raise unknown("body", body, (model.body(i).name for i in range(1, model.nbody)))
        return k

    def _note_fault(self, text: str, begins: bool) -> None:
        """A fault comes or goes: keep the list, tell the recording."""
        (self._faults.append if begins else self._faults.remove)(text)
        if self._recording is not None:
            self._recording.note(self.time, f"{text}: {'begins' if begins else 'mended'}", self.faults)

    # --- state ---

    def _joint_position(self, index: int) -> float:
        p = self._plant[index]
        self._awake()
        tau = (self._now - self._words.item(1) - 0.5 * self._dt) * 1e-9
        return float(self.data.qpos[p.qpos] + self.data.qvel[p.dof] * tau)

    def place(self, **positions: float) -> None:
        """Put carriages somewhere, at rest, as by hand with the motors off: `stage.place(x=0.05)`, metres (rad).

        The drives take hold at the nearest microstep: no jump, no lost step.
        """
        for name, q in positions.items():
            if name not in self.axes:
                raise unknown("axis", name, self.axes)
            low, high = self.axes[name].travel
            if not low <= q <= high:
                raise ArgumentError(f"{name}={q!r}: the joint travels from {low} to {high} {self.axes[name].unit}.")
        self.change()
        for name, q in positions.items():
            t = self._table[self.axes[name].index]
            self.data.qpos[t.qpos], self.data.qvel[t.dof] = q, 0.0
        self._settle()

    def _settle(self) -> None:
        """The carriages stand where somebody has put them: see `engine.settle`."""
        with self._alone():
            mujoco.mj_forward(self.model, self.data)
            handle.settle.held(self._at)
        for axis in self._axes_by_index:
            chip: Any = axis.chip
            if chip._journal is not None:
                if chip.SERVO:
                    chip._journal.note_seen(chip.clock, *chip.shaft)
                chip._journal.note_input(chip.clock, axis.chip_axis, chip._input_word(axis.chip_axis))

    def snapshot(self) -> Snapshot:
        """All state: physics, chips, drives, switches, time."""
        self.change()
        state = np.zeros_like(self._state)
        mujoco.mj_getState(self.model, self.data, state, STATE)
        state.flags.writeable = False
        said = tuple(tuple(chip.diagnostics) for chip in self.chips)
        return Snapshot(self._header, state, said, crc32(state.data, self._header.checksum))

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from `snapshot`, bit for bit. Raises ArgumentError when it is of another kind of stage (axes, chips, drives, bus
        cycle, time step or mechanics of the model), or damaged.

        Payloads and faults are the machine's and stay as they are.
        """
        snapshots.check(snapshot, Snapshot, self._header)
        if self._recording is not None:
            raise StageError("time in a recording runs forward only: close the recording before restoring a snapshot.")
        with self._alone():
            mujoco.mj_setState(self.model, self.data, snapshot.state, STATE)
            mujoco.mj_forward(self.model, self.data)
            mujoco.mj_setState(self.model, self.data, snapshot.state, STATE)
        for chip, said in zip(self.chips, snapshot.diagnostics, strict=True):
            chip.diagnostics[:] = said
        self._equip()

    def reset(self) -> None:
        """Back to power-up: the state that the stage was made with."""
        self.restore(self._initial)

    def _headed(self) -> snapshots.Header:
        """What the snapshots of this stage are taken of. Payloads and faults are no part of it."""
        axes = self._axes_by_index
        parts = [("axes", ", ".join(a.name for a in axes))]
        for a in axes:
            chip = dict(a.chip._header.parts)["chip"]
            parts.append((f"chip of axis {a.name}", f"{chip}, its axis {a.chip_axis}"))
        for a in axes:
            constants = np.zeros(1, stepper.DRIVE)
            a.drive.fill(constants[0])
            parts.append((f"drive of axis {a.name}", f"{a.drive.title} (constants {_digest(constants.tobytes())})"))
        parts.append(("time step", f"{self._dt} ns"))
        parts.append(("bus cycle", f"{self._bus_ns} ns"))
        parts.append(("mechanics of the model", self._mechanics))
        records = (engine.WORLD, engine.AXIS, engine.SWITCH, stepper.DRIVE, *(chip.CORE.STATE for chip in self.chips))
        layouts = " ".join(map(snapshots.layout, records))
        parts.append(("layout of the state", f"{_digest(layouts.encode())} ({len(self._state)} words)"))
        return snapshots.Header(tuple(parts))

    def record(
        self,
        every: float = 1e-3,
        path: str | PathLike | None = None,
        *,
        overwrite: bool = False,
        on_error: str = "raise",
    ) -> Recording:
        """A recording of all that happens from now to its close; use as `with stage.record() as recording:`.

        every: seconds between samples, up to 1e6, rounded to whole physics steps, one at least; switch edges and bus writes are
            exact anyway.
        path: write a rerun file as it goes, see `Recording.stream`, as for overwrite and on_error ("raise" or "warn").
        Raises ArgumentError; StageError while another recording goes on; RecordingError.
        """
        from stage.recording import Recording

        if self._recording is not None:
            raise StageError("this stage is already being recorded; close that recording first.")
        if not 0 < every <= 1e6:
            raise ArgumentError(f"every={every!r}: the samples of a recording are more than 0 and up to 1e6 s apart.")
        self.change()
        steps = max(1, round(every * 1e9 / self._dt))
        dt = self._dt * 1e-9
        self._recording = Recording(self.model, self.axes, steps * dt, self._stop_recording)
        handle.log_to(self._handle, self._recording)
        if self._faults:
            self._recording.note(self.time, "in force from the start", self.faults)
        self._clockwork[0].sample_every = steps
        self._world[0].to_sample = steps
        recording = self._recording
        if path is not None:
            try:
                recording.stream(path, overwrite=overwrite, on_error=on_error)
            except BaseException:
                recording.close()
                raise
        return recording

    def _stop_recording(self) -> None:
        self._recording = None
        handle.log_to(self._handle, None)
        self._clockwork[0].sample_every = 0

    def __getstate__(self) -> dict[str, Any]:
        return {
            "model": self.model,
            "plant": self._plant,
            "chips": [(type(chip), chip.options()) for chip in self.chips],
            "wired": [(self.chips.index(a.chip), a.chip_axis) for a in self._axes_by_index],
            "drives": [a.drive for a in self._axes_by_index],
            "bus_ns": self._bus_ns,
            "offset": self._offset,
            "mechanics": self._mechanics,
            "switch_faults": self._switch_table[list(SWITCH_FAULTS)].copy(),
            "drive_faults": [(a._voltage, a._open) for a in self._axes_by_index],
            "faults": list(self._faults),
            "payloads": (dict(self._payloads), dict(self._own_masses)),
            "initial": self._initial,
            "now": self.snapshot(),
        }

    def __setstate__(self, s: dict[str, Any]) -> None:
        self.model = s["model"]
        self._plant, self._mechanics = s["plant"], s["mechanics"]
        chips = [cls(**options) for cls, options in s["chips"]]
        self._wire([chips[k].axes[j] for k, j in s["wired"]], s["drives"], s["bus_ns"], s["offset"])
        for field in SWITCH_FAULTS:
            self._switch_table[field] = s["switch_faults"][field]
        for axis, fault in zip(self._axes_by_index, s["drive_faults"], strict=True):
            axis._voltage, axis._open = fault
        self._faults = s["faults"]
        self._payloads, self._own_masses = s["payloads"]
        self._initial = s["initial"]
        self.restore(s["now"])

    def __deepcopy__(self, memo: dict) -> Stage:
        twin = object.__new__(type(self))
        state = self.__getstate__()
        twin.__setstate__(state | {"model": copy.copy(self.model)})
        return twin

    def __copy__(self) -> Stage:
        return self.__deepcopy__({})

    def __repr__(self) -> str:
        return f"<Stage {', '.join(repr(a) for a in self._axes_by_index)} time={self.time:.6f} s>"


class _Cut:
    """Cuts one array of float64 words into record arrays, from its beginning on."""

    def __init__(self, words: np.ndarray):
        self._words, self._at = words, 0

    def __call__(self, dtype: np.dtype, n: int) -> np.ndarray:
        begin = self._at
        self._at += n * dtype.itemsize // 8
        return self._words[begin : self._at].view(dtype)


def _words(chips: list[ChipAxis], switches: int) -> int:
    """float64 words of userdata that a stage needs."""
    per_axis = engine.AXIS.itemsize + stepper.DRIVE.itemsize
    rows = sum(chip.CORE.STATE.itemsize for chip in _each_once(chips))
    return (engine.WORLD.itemsize + len(chips) * per_axis + rows + switches * engine.SWITCH.itemsize) // 8


def _each_once(axes: list[ChipAxis]) -> tuple[Chip, ...]:
    """The chips of these axes."""
    return tuple(dict.fromkeys(axis.chip for axis in axes))


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=6).hexdigest()


def _named(chips: Any) -> Any:
    """Chips that were given by their names, as classes."""
    if isinstance(chips, Mapping):
        return {axis: _named(chip) for axis, chip in chips.items()}
    return chip_class(chips) if isinstance(chips, str) else chips


def _make_chips(chips: Any, names: list[str]) -> list[ChipAxis]:
    """A chip's axis for each axis named; axes that are given the same thing share its chips."""
    free: dict[int, list[ChipAxis]] = {}
    found: list[ChipAxis] = []
    for name in names:
        given = chips[name] if isinstance(chips, Mapping) else chips
        left = free.setdefault(id(given), [])
        if not left:
            chip = given() if callable(given) else given
            if not isinstance(chip, Chip):
                raise ArgumentError(
                    f"chips for axis {name}: {given!r} is no chip class, nor a name of one: {', '.join(CHIPS)}."
                )
            if chip._bus is not None or any(chip is axis.chip for axis in found):
                raise ArgumentError(f"chips for axis {name}: {given!r} has no axis left that is free.")
            left += chip.axes
        found.append(left.pop(0))
    return found


def _motor_named(name: str) -> Motor | DCMotor:
    return DC_MOTORS[name] if name in DC_MOTORS else motor(name)


def _choose_drive(drives: Any, axis: str, chip: Chip, spec: Any) -> Drive | Servo:
    """The drive of an axis for its chip, as asked or as the model says; the spec gets the actuator that it needs."""
    given, named = drives.get(axis) if isinstance(drives, Mapping) else drives, plant.motors(spec).get(axis)
    kind, presets = ((Drive, Motor), MOTORS) if chip.SERVO else ((Servo, DCMotor), DC_MOTORS)
    if isinstance(given, kind) or (isinstance(given, str) and given in presets):
        what, want = (
            ("a DC servo", "a Servo or a DC motor") if chip.SERVO else ("a stepper", "a Drive or a stepper motor")
        )
        shown = given.title if isinstance(given, Drive | Servo) else getattr(given, "name", repr(given))
        raise ArgumentError(
            f"drives for axis {axis}: {type(chip).__name__} drives {what}; {shown} is none: give {want}."
        )
    if not chip.SERVO:
        plant.equip(spec, axis, None)
        if isinstance(given, Drive):
            return given
        return Drive(motor(given if given is not None else named if named and named not in DC_MOTORS else "17HS4401"))
    own = plant.dc_constants(spec, axis)
    if isinstance(given, Servo):
        chosen = given
    elif given is not None:
        chosen = Servo(dc_motor(given))
    elif named in DC_MOTORS:
        chosen = Servo(DC_MOTORS[named])
    elif own is not None:
        chosen = Servo(DCMotor(f"that of axis {axis}", own[1], own[0], 0.0, own[0]))
    else:
        chosen = Servo()
    plant.equip(spec, axis, (chosen.motor.torque_constant, chosen.motor.resistance))
    return chosen
