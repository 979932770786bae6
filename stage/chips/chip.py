"""Base class of all emulated chips, to which a family adds its register map, its core and its lint.

    chip = PCL240K(clock_hz=4_915_200)
    chip.write(0, 0x81)          one bus cycle
    chip.advance(1000)           1000 reference clocks; returns the number of pulses
    chip.pins.el_plus = True     True is asserted, whatever the polarity

A chip of a stage shares the stage's clock: each bus cycle takes the stage's bus time, and only the stage advances the chip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from time import perf_counter
from types import ModuleType
from typing import Any, ClassVar, Protocol
from zlib import crc32

import numpy as np

from stage.chips import contract_check
from stage.chips.cycle_descriptions import CycleDescriber, Decoder
from stage.chips.exclusive_access import SessionLock, exclusive, get_stage_lock, with_lock
from stage.chips.journal import Journal
from stage.chips.observer_attributes import make_observer_attribute
from stage.chips.register_map import RegisterMap, Word, dump
from stage.chips.write_diagnostics import (
    BUS_WIDTH,
    CLOCK_RANGE,
    MAX_DIAGNOSTICS,
    Cause,
    Diagnostic,
    Finding,
    JournalLint,
    parse_diagnostics,
)
from stage.errors import ArgumentError, StageError, add_article, find_similar_names, unknown_name_error
from stage.native import remove_attribute_access
from stage.support import snapshots
from stage.support.argument_checks import explain_arguments
from stage.support.declared_attributes import DeclaredAttributes, UnknownAttribute
from stage.support.snapshot_files import SavableSnapshot

MAX_CLOCKS = 1 << 45  # a speed of 13 bits times this still fits 63 bits
LAST_CLOCK = 1 << 59  # what is scheduled from there on still fits 63 bits
SHORT_RUN_CLOCKS = 1 << 18
MIN_PIECE_S, MAX_PIECE_S = 0.025, 0.1


class Bus(Protocol):
    """Interface of the stage or test bench that a chip belongs to, and that advances the chip's clock."""

    def cycle(self) -> None:
        """Let the time of one bus cycle pass; a chip calls this before it executes the cycle."""

    def ensure_powered(self) -> None:
        """Power the chips up again if MuJoCo has cleared their state; call it before a state is read between bus cycles."""
        return None

    def prepare_change(self) -> None:
        """Prepare for a change of a chip's state between bus cycles.

        Raises:
            StageError: The state may not change now.
        """
        return None


class Snapshot(SavableSnapshot):
    """All state of one chip. It can be restored into a chip of the same kind: class, clock and options.

    `save(path)` and `Snapshot.load(path)` keep it in a file.
    """

    of: ClassVar = "a chip"

    @classmethod
    def _decode_diagnostics(cls, data: Any) -> tuple:
        return parse_diagnostics(data)

    @property
    def record(self) -> bytes:
        """State of the chip as bytes, a record of its core's STATE."""
        return bytes(self.state)


class Pins:
    """Input and output pins by name. True means asserted. Inputs can be set, outputs only read."""

    _chip: Chip
    _axis: int
    _inputs: dict[str, int]
    _outputs: dict[str, int]

    def __init__(self, chip: Chip, axis: int, inputs: dict[str, int], outputs: dict[str, int]):
        for name, value in (("_chip", chip), ("_axis", axis), ("_inputs", inputs), ("_outputs", outputs)):
            object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> bool:
        if name.startswith("_"):
            raise AttributeError(name)
        chip = self._chip
        if name in self._inputs:
            return bool(chip.input_word(self._axis) & self._inputs[name])
        if name in self._outputs:
            return bool(chip.output_word(self._axis) & self._outputs[name])
        raise UnknownAttribute(unknown_name_error(f"{type(chip).__name__} pin", name, dir(self)))

    def __setattr__(self, name: str, value: bool) -> None:
        chip = self._chip
        if name not in self._inputs:
            kind = "is an output and cannot be driven" if name in self._outputs else "is not a pin"
            raise UnknownAttribute(f"{type(chip).__name__} {name!r} {kind}. Inputs: {', '.join(self._inputs)}.")
        if value not in (False, True):  # a text such as "no" would count as asserted
            raise ArgumentError(f"pins.{name} = {value!r}: a pin is asserted or not; give True or False.")
        with get_stage_lock(chip):
            word = chip.input_word(self._axis)
            bit = self._inputs[name]
            new = word | bit if value else word & ~bit
            if new != word:
                chip._prepare_change()
                chip.set_input_word(self._axis, new)
                if chip.open_journal is not None:
                    chip.open_journal.note_input(chip.clock, self._axis, new)

    def __dir__(self) -> list[str]:
        return [*self._inputs, *self._outputs]

    def as_dict(self) -> dict[str, bool]:
        """Return the state of every pin by its name, inputs first."""
        return {name: getattr(self, name) for name in dir(self)}

    def __repr__(self) -> str:
        return "Pins(" + ", ".join(name for name, on in self.as_dict().items() if on) + ")"


class ChipAxis(DeclaredAttributes):
    """One axis of a chip."""

    def __init__(self, chip: Chip, index: int):
        self.chip, self.index, self.pins = chip, index, Pins(chip, index, chip.INPUTS, chip.OUTPUTS)

    def _explain_unknown_attribute(self, name: str) -> str:
        return f"An axis of a chip has no attribute {name!r}. {explain_pins(self.pins, name)}"


def explain_pins(pins: Pins, name: str) -> str:
    """Explain, as a sentence, how to set the input pins of an axis to somebody who took `name` for one of its attributes."""
    similar = find_similar_names(name, pins._inputs)
    return f"Input pins are set as pins.{similar[0] if similar else next(iter(pins._inputs))} = True: {', '.join(pins._inputs)}."


class Chip(DeclaredAttributes):
    """Base class of all chips. A family derives its chips from it."""

    MAP: ClassVar[RegisterMap]
    CORE: ClassVar[ModuleType]
    INPUTS: ClassVar[dict[str, int]]
    OUTPUTS: ClassVar[dict[str, int]]
    COUNTER: ClassVar[tuple[str, int]]
    """Name of the register that counts the pulses for the host, and its number of bits."""
    TRACED: ClassVar[dict[str, tuple[str, int]]] = {}
    """Further signals of waveforms: name of a register or of a signal -> field of the core's EDGE record, number of bits."""
    AXES: ClassVar[int] = 1
    WIRING: ClassVar[dict[str, str]] = {}
    """Pin to which each switch of a stage is wired, if its name differs from that of the switch; see `find_switch_input`."""
    WIRES: ClassVar[dict[str, tuple[str, int]]] = {}
    """Pin -> (name of the signal in waveforms, level while asserted). As in hardware description languages, `_n` marks a signal
    that is active low. A pin without an entry appears under its own name in capitals, with 1 for asserted."""
    PHASES: ClassVar[dict[str, str]] = {}
    """Output pin -> motion phase that the pin shows: hold, up, keep, down; for a servo idle, profile, control. The first asserted
    pin determines the phase; if none is asserted, the phase is hold, or control for a servo."""
    LOGIC: ClassVar[str] = "negative"
    """Logic of the sensors that the chip expects after a reset: signals low ("negative") or high ("positive") while they are on."""
    SYNCHRO: ClassVar[bool] = False
    """Whether the chip has the pins SYNO and SYNI, by which chips share the clock of one chip; see `find_syno_address`."""
    MULTICHIP: ClassVar[bool] = False
    """Whether the chip has the lines by which several chips interpolate together, see stage/chips/linked_chips.py."""
    SERVO: ClassVar[bool] = False
    """Whether the chip drives a DC motor with an encoder, not a stepper."""
    ENCODERS: ClassVar[bool] = False
    """Whether the axes of the chip have inputs for an encoder, which is optional; see `Chip.set_shaft`."""
    IN_POSITION: ClassVar[float] = 4.0
    """Default tolerance, pulses, within which an axis has arrived at its goal."""
    DEFAULT_CLOCK_HZ: ClassVar[int]
    MAX_CLOCK_HZ: ClassVar[int] = 100_000_000
    """Fastest reference clock that is emulated, Hz."""
    CLOCK_RANGE: ClassVar[tuple[int, int]] = (1, 100_000_000)
    """Range of reference clocks, Hz, that the data sheet allows. The emulation accepts others, and adds a diagnostic."""
    CLOCK_SOURCE: ClassVar[str] = "clock"
    """Section of the data sheet that states CLOCK_RANGE."""
    ADDRESSES: ClassVar[int] = 4
    """Number of bus addresses, which are 0 to ADDRESSES - 1."""
    ADDRESS_MASK: ClassVar[int] = 3
    """Mask of the address lines that are connected to the chip."""
    DATA_MASK: ClassVar[int] = 0xFF
    READING_ACTS: ClassVar[frozenset[int]] = frozenset()
    """Bus addresses at which a read cycle can change the state of the chip; journals note these cycles."""
    IRQ: ClassVar[tuple[int, int]] = (0, 0)
    """Interrupt outputs: the axis to whose pins they belong (-1: pins of no axis), and their bits in the output word."""
    DRIVER: ClassVar[str] = ""
    """Host driver of the chip: "package.module:Class" of a `stage.firmware.driver.Driver`, which is loaded when it is needed."""
    MICROSTEPS: ClassVar[int] = 0
    """Pulses per full step of a chip that drives its motor itself; 0 for chips whose motors are driven by the stage's Drive."""
    LAYOUT: ClassVar[str] = ""
    """Layout of the chip on a host's bus: "package.module:NAME" of a `stage.board.bus_layouts.Layout`, which is loaded when it is
    needed. Default: one address after the other."""
    BUSY: ClassVar[tuple[int, int]]
    """Status bit that shows a drive in progress: bus address, and the number of the bit of axis 0."""
    lock: SessionLock | None = None
    """Lock that bus cycles of the chip hold while several threads use its stage, see `set_lock`; None without a session."""

    def __init__(self, clock_hz: int | None = None):
        """Power the chip up.

        Args:
            clock_hz: Reference clock, 1 to MAX_CLOCK_HZ; default: that of the data sheet.

        Raises:
            ArgumentError: The clock is no whole number in this range, or the class breaks the contract of chips.
        """
        contract_check.check_chip_class(type(self), Chip, check_methods=False)
        hz: Any = self.DEFAULT_CLOCK_HZ if clock_hz is None else clock_hz
        if not isinstance(hz, int | float | np.number) or not 1 <= hz <= self.MAX_CLOCK_HZ or int(hz) != hz:
            raise ArgumentError(
                f"clock_hz={clock_hz!r}: a reference clock is a whole number of 1 to {self.MAX_CLOCK_HZ:,} Hz."
            )
        self.clock_hz = int(hz)
        self._diagnostics: list[Diagnostic] = []
        self.axes = tuple(ChipAxis(self, k) for k in range(self.AXES))
        self._bus: Bus | None = None
        self._alone: tuple[np.ndarray, int] | None = None  # where its state was before `attach` moved it
        self.open_journal = None
        self.journal_lint: JournalLint | None = None
        """Lint that checks the writes of a journal, for chips whose bus cycles compiled code makes; else None."""
        self.glitches = ()
        self._use_record(np.zeros(1, self.CORE.STATE), 0)
        self._configure(self._record)
        self.CORE.power_up.with_gil(self._address)
        minimum, maximum = self.CLOCK_RANGE
        if not minimum <= self.clock_hz <= maximum:
            message = (
                f"a reference clock of {self.clock_hz:,} Hz: the silicon is sold for {minimum:,} to {maximum:,} Hz"
            )
            self.diagnose(0, 0, 0, [(CLOCK_RANGE.with_source(self.CLOCK_SOURCE), message)])

    open_journal: Journal | None = make_observer_attribute(
        "_open_journal",
        "Journal that notes the inputs of the chip, the newest one if several are open; None if none is. See `journal`.",
    )
    glitches: tuple[Callable[[int, int], bool], ...] = make_observer_attribute(
        "_glitches",
        "Faults of the bus: functions (address, value) called before every write; if one returns True, the write is lost.",
    )

    def _explain_unknown_attribute(self, name: str) -> str:
        return f"The {type(self).__name__} has no attribute {name!r}. {explain_pins(self.axes[0].pins, name)}"

    @property
    def diagnostics(self) -> list[Diagnostic]:
        """Messages about writes that break a rule of the data sheet: the last MAX_DIAGNOSTICS, oldest first."""
        if self.journal_lint is not None:
            self.journal_lint.process()
        return self._diagnostics

    def _configure(self, record: Any) -> None:
        """Set the fields of the state that distinguish the variants of a family."""

    def lint(self, address: int, value: int) -> Iterable[Finding]:
        """Yield every rule of the data sheet that a write would break now. The chip does not change.

        Args:
            address: Bus address.
            value: Datum.

        Returns:
            Pairs of a rule and a message; none for a write that breaks no rule.
        """
        return ()

    def fit_drive(self, drive: Any, axis: int = 0) -> None:
        """Store what the chip needs to know about the drive of an axis. Most chips need nothing; a stage calls this once.

        Args:
            drive: `stage.drives.motors.Drive` or `Servo` of the axis.
            axis: Axis of the chip.
        """
        self._check_axis(axis)

    def explain_missing_current(self, axis: int = 0) -> str:
        """Explain why the motor has no current.

        Args:
            axis: Axis of the chip.

        Returns:
            A clause for reports of lost steps; "" while the motor has current, and for chips that do not drive their motor
            themselves.
        """
        self._check_axis(axis)
        return ""

    def make_replica(self, state: bytes | None = None) -> Chip:
        """Make another chip of the same kind that belongs to no stage and has no diagnostics.

        Args:
            state: State of the replica, as bytes; default: the present state of this chip.
        """
        replica = type(self)(**self.options())
        replica._use_record(
            np.frombuffer(bytearray(self.state.tobytes() if state is None else state), self.CORE.STATE), 0
        )
        return replica

    def attach(self, bus: Bus, rows: np.ndarray | None = None) -> None:
        """Make the chip part of a stage or bench.

        Args:
            bus: Keeper of the time from now on.
            rows: Array of one record of CORE.STATE, into which the state moves; None leaves the state where it is.
        """
        self._bus = bus
        if rows is not None:
            rows[0] = self._rows[self._i]
            self._alone = self._rows, self._i
            self._use_record(rows, 0)

    def detach(self) -> None:
        """Separate the chip from its stage; its state is again what it was before `attach`."""
        self._bus = None
        if self._alone is not None:
            self._use_record(*self._alone)
            self._alone = None

    def set_lock(self, lock: SessionLock | None) -> None:
        """Set the lock that each later bus cycle takes, see stage.chips.exclusive_access.

        Args:
            lock: Lock of an open session; None: bus cycles take no lock.
        """
        self.lock = lock
        for name in ("read", "write"):
            vars(self).pop(name, None)
            if lock is not None:
                setattr(self, name, with_lock(lock, getattr(self, name)))

    @property
    def attached(self) -> bool:
        """Whether the chip belongs to a stage or a bench."""
        return self._bus is not None

    def _use_record(self, rows: np.ndarray, index: int) -> None:
        """Use record `index` of `rows` as the state."""
        self._rows, self._i = rows, index
        self._address = rows.ctypes.data + index * rows.itemsize
        self._record = rows.view(remove_attribute_access(rows.dtype))[index]

    @property
    def pointer(self) -> int:
        """Address of the state, up to date, for compiled code. `_address` is the same without the update, for bus cycles."""
        if self._bus is not None:
            self._bus.ensure_powered()
        return self._address

    @property
    def state(self) -> Any:
        """State of the chip, up to date, a record of CORE.STATE. `_record` is the same without the update, for bus cycles."""
        if self._bus is not None:
            self._bus.ensure_powered()
        return self._record

    def _prepare_change(self) -> None:
        """Prepare the stage, if there is one, for a change of the state between bus cycles."""
        if self._bus is not None:
            self._bus.prepare_change()

    @property
    def pins(self) -> Pins:
        """Pins of a chip with one axis. Raises StageError for a chip with several axes."""
        if self.AXES != 1:
            raise StageError(f"{type(self).__name__} has {self.AXES} axes: use chip.axes[i].pins")
        return self.axes[0].pins

    @classmethod
    def find_switch_input(cls, switch: str) -> int:
        """Return the bit of the input pin to which a switch of the stage is wired.

        Args:
            switch: Name of the switch: "el_plus", "org", "ez" ...

        Returns:
            A bit of INPUTS; 0 if nothing is wired to the switch.
        """
        return cls.INPUTS.get(cls.WIRING.get(switch, switch), 0)

    @classmethod
    def find_syno_address(cls, rows: np.ndarray) -> int:
        """Return the address of the word that the output SYNO sends to other chips.

        Args:
            rows: State of the chip, an array of one record.

        Raises:
            NotImplementedError: The chip has no SYNO.
        """
        raise NotImplementedError(f"{cls.__name__} has no SYNO.")

    def net(self, axis: int = 0) -> int:
        """Return the net number of pulses (plus less minus) that the drive has received since power-up. No register shows it.

        Args:
            axis: Axis of the chip.
        """
        self._check_axis(axis)
        return int(self.CORE.read_net_count.with_gil(self.pointer, axis))

    @explain_arguments
    @exclusive
    def set_shaft(self, count: float, rate: float = 0.0, axis: int = 0) -> None:
        """Put the shaft of an encoder at `count + rate * (clock - now)` from now on.

        The counter of the axis follows the shaft in the mode that its registers select. The first call only sets the place of the
        shaft, and the counter stays.

        Args:
            count: Position of the shaft in edges of the encoder; the chip family rounds it.
            rate: Edges per reference clock.
            axis: Axis of the chip.

        Raises:
            ArgumentError: A number is not finite, there is no such axis, or the chip has no inputs for an encoder.
        """
        if not (self.ENCODERS or self.SERVO):
            raise ArgumentError(f"set_shaft: {add_article(type(self).__name__)} looks at no encoder.")
        if not (math.isfinite(count) and math.isfinite(rate)):
            raise ArgumentError(f"set_shaft({count!r}, {rate!r}): a shaft is at a finite count and has a finite rate.")
        self._check_axis(axis)
        self._prepare_change()
        self.CORE.set_shaft.with_gil(self.pointer, axis, float(count), float(rate))
        if self.open_journal is not None:
            self.open_journal.note_shaft(self.clock, axis, count, rate)

    def get_shaft(self, axis: int) -> tuple[float, float]:
        """Return the count and the rate of the last call of `set_shaft` for an axis: edges, and edges per reference clock.

        Args:
            axis: Axis of the chip.
        """
        raise NotImplementedError(f"{type(self).__name__} looks at no encoder.")

    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        """Return the bus write cycles that put a value into a register, as a host driver of the family makes them.

        Args:
            name: Name of the register in the map.
            value: Value, which is not checked; see `RegisterMap.check_value`.
            axis: Axis of the chip, where each axis has the register.

        Returns:
            Pairs of address and datum.

        Raises:
            ArgumentError: There is no such register.
        """
        raise NotImplementedError(f"{cls.__name__} does not say how its registers are written.")

    @classmethod
    @explain_arguments
    def command_cycles(cls, symbol: str, axis: int = 0, datum: int | None = None) -> list[tuple[int, int]]:
        """Return the bus write cycles that send a command of the map, or a word that a host writes (see `Word.address`).

        Args:
            symbol: Symbol of the command, or name of the word.
            axis: Axis of the chip, where the command goes to axes.
            datum: Data of a command that takes some; `Command.choice` bits of a command that chooses; bits of a word.

        Returns:
            Pairs of address and datum.

        Raises:
            ArgumentError: There is no such name, or the datum is missing, not expected, or does not fit.
            NotImplementedError: The family does not define how its commands are sent.
        """
        cls._check_axis(axis)
        what, datum = cls.MAP.find_command_or_word(symbol, datum)
        if isinstance(what, Word) and what.address is not None:
            return [(what.address, what.fixed | datum)]
        raise NotImplementedError(f"{cls.__name__} does not say how its commands are sent.")

    @classmethod
    def compute_rates(cls, edges: np.ndarray) -> np.ndarray:
        """Compute the magnitude of an axis' rate from each edge of its waveforms on, in pulses per reference clock.

        Args:
            edges: EDGE records of the core, see `Journal.waveforms`.
        """
        return np.abs(edges["rate"])

    @classmethod
    def is_driving(cls, edges: np.ndarray) -> np.ndarray:
        """Return whether an axis drives, from each edge of its waveforms on (bool).

        Args:
            edges: EDGE records of the core, see `Journal.waveforms`.
        """
        return cls.compute_rates(edges) != 0

    @classmethod
    def find_selected_direction(cls, address: int, value: int) -> bool | None:
        """Return the direction that a bus write selects for later drives.

        Args:
            address: Bus address.
            value: Datum.

        Returns:
            True for minus, False for plus, None if the write does not select a direction.
        """
        return None

    def would_start_drive(self, address: int, value: int, axis: int = 0) -> bool:
        """Return whether a bus write would start a drive of a resting axis now. The chip does not change.

        Args:
            address: Bus address.
            value: Datum.
            axis: Axis of the chip.
        """
        self._check_axis(axis)
        core, (at, bit) = self.CORE, self.BUSY
        replica = np.frombuffer(bytearray(self.state.tobytes()), core.STATE)
        address_of_twin, mask = replica.ctypes.data, bit << axis
        if core.read.with_gil(address_of_twin, at) & mask:
            return False
        core.write.with_gil(address_of_twin, address & self.ADDRESS_MASK, value & self.DATA_MASK)
        return bool(core.read.with_gil(address_of_twin, at) & mask)

    def options(self) -> dict[str, Any]:
        """Return the arguments of the constructor that make an equal chip: `type(chip)(**chip.options())`."""
        return {"clock_hz": self.clock_hz}

    def compatibility_key(self) -> tuple:
        """Return class, reference clock and options: two chips with equal keys can exchange states."""
        return (type(self).__name__, *self.options().values())

    @cached_property
    def header(self) -> snapshots.SnapshotHeader:
        """Description of the chip in its snapshots."""
        name, hz, *also = self.compatibility_key()
        options = "".join(f", {option}" for option in also)
        return snapshots.SnapshotHeader(
            (("chip", f"{name} at {hz} Hz{options}"), ("layout of its state", snapshots.hash_layout(self.CORE.STATE)))
        )

    @property
    def clock(self) -> int:
        """Reference clocks since power-up."""
        return int(self.state["clock"])

    def write(self, address: int, value: int) -> None:
        """Make one bus write cycle.

        Address and value are masked as on the bus; rules that the write breaks appear in `diagnostics`.

        Args:
            address: Bus address, any whole number.
            value: Datum, any whole number.

        Raises:
            ArgumentError: The address or the value is no number.
        """
        try:
            on_the_bus = int(address) & self.ADDRESS_MASK, int(value) & self.DATA_MASK
        except (TypeError, ValueError, OverflowError):
            raise make_cycle_error("write", address, value) from None
        self._write(*on_the_bus, (address, value))

    def _write(self, address: int, value: int, requested: tuple[int, int]) -> None:
        """Make a bus write cycle.

        Args:
            address: Address that the chip sees.
            value: Value that the chip sees.
            requested: Address and value that the host has requested, before masking.
        """
        lost = self.loses_write(address, value)
        if self._bus is not None:
            self._bus.cycle()
        if lost:
            if self.open_journal is not None:
                self.open_journal.note_lost_write(self.clock, address, value)
            return
        if (address, value) != requested:
            self.diagnose(self.clock, address, value, [(BUS_WIDTH, describe_masked_write(requested, (address, value)))])
        if self.journal_lint is None:
            self.diagnose(self.clock, address, value, self.lint(address, value))
        self.CORE.write.with_gil(self._address, address, value)
        if self.open_journal is not None:
            self.open_journal.note_write(self.clock, address, value)

    def loses_write(self, address: int, value: int) -> bool:
        """Return whether a fault of the bus loses a write. Every bus fault in force inspects the write.

        Args:
            address: Bus address.
            value: Datum.
        """
        return any([glitch(address, value) for glitch in self.glitches]) if self.glitches else False

    def diagnose(self, clock: int, address: int, value: int, findings: Iterable[Finding]) -> None:
        """Add the findings of a lint about one write to `diagnostics`.

        Args:
            clock: Reference clocks since power-up.
            address: Address of the write.
            value: Value of the write.
            findings: Pairs of a broken rule and a message. A rule with `once` is left out if `diagnostics` already has its key.
        """
        for rule, message in findings:
            if not rule.once or all(d.key != rule.key for d in self._diagnostics):
                self._diagnostics.append(Diagnostic(clock, address, value, message, rule.source, rule.key))
        del self._diagnostics[:-MAX_DIAGNOSTICS]

    def count_edges_of(self, diagnostic: Diagnostic) -> int:
        """Return the number of edges of lines that a diagnostic is about; 0 if it is about a bus write."""
        return 0

    def find_cause_of(self, diagnostic: Diagnostic) -> Cause:
        """Return what has broken the rule of a diagnostic, and how often."""
        edges = self.count_edges_of(diagnostic)
        return Cause("edge", edges) if edges else Cause("bus write", 1)

    def read(self, address: int) -> int:
        """Make one bus read cycle.

        Args:
            address: Bus address, any whole number; it is masked.

        Returns:
            The byte or word on the data bus.

        Raises:
            ArgumentError: The address is no number.
        """
        try:
            address = int(address) & self.ADDRESS_MASK
        except (TypeError, ValueError, OverflowError):
            raise make_cycle_error("read", address) from None
        if self._bus is not None:
            self._bus.cycle()
        value = int(self.CORE.read.with_gil(self._address, address))
        if self.open_journal is not None and address in self.READING_ACTS:
            self.open_journal.note_read(self.clock, address, value)
        return value

    def busy(self, axis: int = 0) -> bool:
        """Read the status by one bus cycle, and return whether a drive is in progress.

        Args:
            axis: Axis of the chip.
        """
        self._check_axis(axis)
        address, bit = self.BUSY
        return bool(self.read(address) & bit << axis)

    def advance(self, clocks: int) -> int:
        """Let the reference clock run.

        Ctrl-C ends a long run early; the chip is then at the clock that it has reached.

        Args:
            clocks: Reference clocks, 0 to MAX_CLOCKS.

        Returns:
            The number of pulses begun, on all axes.

        Raises:
            ArgumentError: `clocks` is out of range, or leads beyond LAST_CLOCK.
            StageError: The chip shares the clock of a stage.
        """
        until, advance, at = self._find_end_clock(clocks), self.CORE.advance.c, self.pointer
        if clocks <= SHORT_RUN_CLOCKS:
            return int(advance(at, until))
        return sum(int(advance(at, stop)) for stop in split_run(self.clock, until))

    def trace(self, clocks: int) -> np.ndarray:
        """Let the reference clock run as `advance` does, and return the pulses.

        Args:
            clocks: Reference clocks, 0 to MAX_CLOCKS.

        Returns:
            Structured array with the fields clock (int64, tick since power-up at which the pulse begins), axis and direction
            (int8, +1 or -1).

        Raises:
            ArgumentError: `clocks` is out of range, or there are more pulses than memory holds.
            StageError: The chip shares the clock of a stage.
        """
        until = self._find_end_clock(clocks)
        if clocks <= SHORT_RUN_CLOCKS:
            return self._trace_piece(until)
        probe, pulses, stops = self._rows[self._i : self._i + 1].copy(), 0, []
        for stop in split_run(self.clock, until):
            pulses += self.CORE.advance(probe, stop)
            stops.append(stop)
        try:
            np.zeros(pulses, self.CORE.PULSE)
        except (MemoryError, ValueError):
            raise ArgumentError(
                f"clocks={clocks!r}: there are {pulses} pulses, more than memory holds; trace less."
            ) from None
        pieces = [self._trace_piece(stop) for stop in stops]
        out, end = np.zeros(sum(map(len, pieces)), self.CORE.PULSE), 0
        for piece in pieces:
            begin, end = end, end + len(piece)
            out[begin:end] = piece  # field by field, so that the padding stays 0
        return out

    def _trace_piece(self, until: int) -> np.ndarray:
        """Run the chip up to a clock and return the pulses. A copy of the state runs first, to count the pulses."""
        out = np.zeros(self.CORE.advance(self._rows[self._i : self._i + 1].copy(), until), self.CORE.PULSE)
        self.CORE.trace_pulses.c(self.pointer, until, out.ctypes.data, len(out))
        return out

    def _find_end_clock(self, clocks: int) -> int:
        """Check a number of clocks to advance, and return the clock at the end."""
        if self._bus is not None:
            raise StageError("this chip belongs to a stage and shares its clock: use stage.step, run or run_until.")
        try:
            number = int(clocks)
            fits = number == clocks and bool(0 <= number <= MAX_CLOCKS)
        except (TypeError, ValueError, OverflowError):
            fits = False
        if not fits:
            raise ArgumentError(f"clocks={clocks!r}: a chip advances by a whole number of 0 to {MAX_CLOCKS} clocks.")
        until = self.clock + number
        check_clock_limit(until)
        return until

    @exclusive
    def reset(self) -> None:
        """Assert the /RESET pin: registers and modes clear; the clock, the inputs and the diagnostics stay."""
        self._prepare_change()
        self.CORE.power_up.with_gil(self._address)
        if self.open_journal is not None:
            self.open_journal.note_reset(self.clock)

    def snapshot(self) -> Snapshot:
        """Return all state, for `restore` into a chip of the same kind."""
        state = self.state.tobytes()
        return Snapshot(self.header, state, tuple(self.diagnostics), crc32(state, self.header.checksum))

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot.

        Args:
            snapshot: Result of `snapshot` of a chip of this kind.

        Raises:
            ArgumentError: The snapshot is damaged, or of another kind of chip.
            StageError: The chip belongs to a stage, which must be restored as a whole.
        """
        if self._bus is not None:
            raise StageError("this chip belongs to a stage: restore the stage, so that all its parts agree.")
        snapshots.check_restorable(snapshot, Snapshot, self.header)
        self._rows[self._i] = np.frombuffer(snapshot.record, self.CORE.STATE)[0]
        self.diagnostics[:] = snapshot.diagnostics

    def __reduce__(self) -> tuple:
        return _rebuild_chip, (type(self), self.options(), self.snapshot())

    def __copy__(self) -> Chip:
        return self.__deepcopy__({})

    def __deepcopy__(self, memo: dict) -> Chip:
        return _rebuild_chip(type(self), self.options(), self.snapshot())

    def input_word(self, axis: int) -> int:
        """Return the input pins of an axis, bits of INPUTS.

        Args:
            axis: Axis of the chip.
        """
        self._check_pins(axis)
        return int(self.CORE.read_inputs.with_gil(self.pointer, axis))

    def set_input_word(self, axis: int, word: int) -> None:
        """Drive the input pins of an axis. Open journals do not record this change.

        Args:
            axis: Axis of the chip.
            word: Bits of INPUTS.
        """
        self._check_pins(axis)
        self.CORE.set_input.with_gil(self._address, axis, word)

    def output_word(self, axis: int) -> int:
        """Return the output pins of an axis, bits of OUTPUTS.

        Args:
            axis: Axis of the chip.
        """
        self._check_pins(axis)
        return int(self.CORE.read_outputs.with_gil(self.pointer, axis))

    def journal(self, axis: int = 0) -> Journal:
        """Begin to record the inputs of the chip, from which the waveforms of an axis can be replayed exactly.

        The journal has bus writes, input changes, and the reads at READING_ACTS, up to its `close()`. Journals that are already
        open continue as well.

        Args:
            axis: Axis whose waveforms the journal replays.

        Raises:
            ArgumentError: The chip does not have this axis.
        """
        self._check_axis(axis)
        self.open_journal = Journal(self, self.open_journal, axis)
        return self.open_journal

    @classmethod
    def _check_axis(cls, axis: int) -> None:
        """Raise ArgumentError unless the chip has this axis."""
        if isinstance(axis, bool) or not isinstance(axis, int | np.integer) or not 0 <= axis < cls.AXES:
            axes = "one axis, 0" if cls.AXES == 1 else f"axes 0 to {cls.AXES - 1}"
            raise ArgumentError(f"axis={axis!r}: {add_article(cls.__name__)} has {axes}.")

    def _check_pins(self, axis: int) -> None:
        """Raise ArgumentError unless the chip has pins under this axis."""
        self._check_axis(axis)

    def decoder(self, axis: int = 0) -> Decoder:
        """Return an object that describes the bus writes of a journal, as far as they concern an axis.

        Args:
            axis: Axis of the chip.
        """
        raise NotImplementedError

    def make_describer(self) -> CycleDescriber:
        """Return an object that describes bus cycles from now on, beginning with the present state of the chip."""
        raise NotImplementedError

    def values(self) -> dict[str, int]:
        """Return the present contents of every register by its name: a view for debuggers, without bus cycles."""
        raise NotImplementedError

    def axis_values(self, axis: int = 0) -> dict[str, int]:
        """Return the present contents of the registers and words of one axis, by name, and of those that all axes share.

        No bus cycle is made. Registers that a host cannot read are included if the state stores their value.

        Args:
            axis: Axis of the chip.

        Raises:
            ArgumentError: The chip does not have this axis.
        """
        self._check_axis(axis)
        return self.values()

    def dump(self) -> str:
        """Return the register map as text, with the present values."""
        return dump(self.MAP, self.values())

    def __repr__(self) -> str:
        values = " ".join(f"{k}={v}" for k, v in self.values().items())
        return f"<{type(self).__name__} clock={self.clock} {values}>"


def check_clock_limit(until: int) -> None:
    """Raise ArgumentError if a chip's clock would go beyond LAST_CLOCK.

    Args:
        until: Clock that a run would reach.
    """
    if until > LAST_CLOCK:
        raise ArgumentError(
            f"clock {until}: a chip's clock ends at {LAST_CLOCK}, centuries after power-up; make a new chip."
        )


def split_run(begin: int, until: int) -> Iterator[int]:
    """Yield the clocks at which a long run of a chip returns to Python, so that Ctrl-C works; the last one is `until`.

    The pieces become longer or shorter until one takes some hundredths of a second of real time.

    Args:
        begin: Clock at the begin of the run.
        until: Clock at its end.
    """
    piece = SHORT_RUN_CLOCKS
    while until - begin > piece:
        begin += piece
        started = perf_counter()
        yield begin
        took = perf_counter() - started
        if took < MIN_PIECE_S:
            piece *= 2
        elif took > MAX_PIECE_S:
            piece = max(piece // 2, 1)
    yield until


def make_cycle_error(cycle_kind: str, *args: Any) -> ArgumentError:
    """Return the error about a bus cycle whose address or value is no number.

    Args:
        cycle_kind: Name of the method: "read", "write" ...
        *args: Its arguments.
    """
    are = "address and value are whole numbers" if args[1:] else "an address is a whole number"
    return ArgumentError(f"{cycle_kind}({', '.join(map(repr, args))}): {are}.")


def describe_masked_write(requested: tuple[int, int], on_bus: tuple[int, int]) -> str:
    """Describe the effect of a write whose address or value does not fit the bus.

    Args:
        requested: Address and value that the host has requested.
        on_bus: Address and value that the chip sees.
    """
    parts = []
    for what, wanted, got in zip(("address", "value"), requested, on_bus, strict=True):
        if wanted != got:
            number = f"{wanted:02X}h" if isinstance(wanted, int) and wanted >= 0 else repr(wanted)
            parts.append(f"{what} {number} acts as {got:02X}h")
    is_whole = all(
        wanted == got or int(wanted) == wanted
        for wanted, got in zip(requested, on_bus, strict=True)
        if not isinstance(wanted, str)
    )
    return f"{' and '.join(parts)}: the bus {'is no wider' if is_whole else 'has whole numbers'}"


def _rebuild_chip(cls: type[Chip], options: dict[str, Any], snapshot: Snapshot) -> Chip:
    """Build a chip from the parts of its pickle."""
    chip = cls(**options)
    chip.restore(snapshot)
    return chip
