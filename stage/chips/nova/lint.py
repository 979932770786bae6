"""Lint of the NOVA chips: the rules of their manuals that a bus write breaks.

Ranges, axes and bits come from the register map, so that all chips of the family share the rules. `LintState` has the contents of
a chip before the write; each value is computed when it is read, because most writes need few. A mask of axes has bit 0 for X.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import numpy as np

from stage.chips.nova import core, state
from stage.chips.nova.interpolation import multichip
from stage.chips.nova.registers.field_builders import AXIS_LETTERS
from stage.chips.nova.registers.mcx300 import RESET
from stage.chips.nova.registers.mcx514 import COORDINATE_RANGE_PULSES, MAX_CONTINUOUS_PPS, MCX514_MAP
from stage.chips.register_map import ChipCommand, Register, RegisterMap, Word
from stage.chips.write_diagnostics import Finding, Rule

# WR0
RESERVED_BITS = Rule("reserved-bits", "WR0")
RESET_WITH_MORE = Rule("reset-with-more", "WR0")
UNKNOWN_COMMAND = Rule("unknown-command", "command list")
ABSENT_AXES = Rule("absent-axes", "command list")
AXES_MISSING = Rule("axes-missing", "command list")
UNNEEDED_AXES = Rule("axes-given", "command list")
SEVERAL_AXES_READ = Rule("several-axes-read", "command list")
NOT_MODELED = Rule("not-modeled", "command list")
# WR1 to WR5, and the data of commands that write
UNUSED_BITS = Rule("unused-bits", "mode writing commands")
FIELD_RANGE = Rule("field-range", "mode writing commands")
VALUE_RANGE = Rule("value-range", "data writing commands")
ONE_AXIS_ONLY = Rule("one-axis-only", "mode writing commands")
EXCLUSIVE_BITS = Rule("exclusive-bits", "mode writing commands")
DATA_NOT_USED = Rule("data-not-used", "data reading commands")
TP_IN_ABSOLUTE_DRIVE = Rule("tp-in-absolute-drive", "7.2.7")
TP_REVERSES_DRIVE = Rule("tp-turns-drive", "7.2.7")
# drive commands
ALREADY_DRIVING = Rule("already-driving", "driving commands")
PULSE_NUMBER = Rule("pulse-number", "7.2.7")
STARTS_NO_DRIVE = Rule("starts-no-drive", "driving commands")
# interpolation commands
NUMBER_OF_AXES = Rule("number-of-axes", "interpolation commands")
AXIS_DRIVES = Rule("axis-drives", "interpolation commands")
PRE_BUFFER_FULL = Rule("pre-buffer-full", "interpolation commands")
CONTINUOUS_TOO_FAST = Rule("continuous-too-fast", "interpolation commands")
FINISH_POINT_RANGE = Rule("finish-point-range", "7.2.7")
HELIX_PULSES_LOST = Rule("helix-pulses-lost", "interpolation commands")
NO_OTHER_CHIP = Rule("no-other-chip", "IPM, MLT")
ONLY_LINES = Rule("only-lines", "IPM, MLT")
LINE_IN_PROGRESS = Rule("line-in-progress", "IPM, MLT")
SLAVE_AFTER_START = Rule("slave-too-late", "IPM, MLT")

CODE, AXIS = MCX514_MAP.field("WR0", "CODE"), MCX514_MAP.field("WR0", "AXIS")
MLT, LMDF = MCX514_MAP.field("IPM", "MLT"), MCX514_MAP.field("IPM", "LMDF")
TP_DRIVES, HELICES = ("DRVRL", "DRVNR", "DRVAB"), ("HLCW", "HLCCW")
REFUSALS = {
    state.E_HLMT_PLUS: "LMT+ is active, drive the other way",
    state.E_HLMT_MINUS: "LMT- is active, drive the other way",
    state.E_SLMT_PLUS: "beyond the software limit +",
    state.E_SLMT_MINUS: "beyond the software limit -",
    state.E_ALARM: "ALARM is active",
    state.E_EMG: "EMG is active",
    state.F_STOP0: "STOP0 is active and enabled",
    state.F_STOP1: "STOP1 is active and enabled",
    state.F_STOP2: "STOP2 is active and enabled",
}
"""Error of RR2, or what has ended the drive -> why a drive does not begin."""
STOP3_REFUSAL_REASON = {state.F_STOP3: "STOP3 is active and enabled"}
"""Table like REFUSALS for chips that have STOP3; in the other chips this bit has another cause."""


class LintState:
    """Contents of a NOVA chip before a write, as the lint (check against the data sheet) reads them.

    Args:
        record: State of the chip.
        axes: Number of axes.
        find_interpolated_axes: Function that returns the axes that IPM or WR5 select, as bits.
    """

    def __init__(self, record: Any, axes: int, find_interpolated_axes: Callable[..., int]):

        self._record, self._count, self._find_interpolated_axes = record, axes, find_interpolated_axes

    @cached_property
    def _axes(self) -> list[Any]:
        return list(self._record["ax"][: self._count])

    @property
    def command_data(self) -> int:
        """Data in WR6 and WR7, 32 bits."""
        return int(self._record["data_low"]) | int(self._record["data_high"]) << 16

    @property
    def has_unused_data(self) -> bool:
        """Whether WR6 or WR7 was written after the last command."""
        return bool(self._record["has_unused_data"])

    @cached_property
    def driving_axes(self) -> int:
        """Axes whose status bit n-DRV is 1, as bits."""
        return sum(1 << k for k, x in enumerate(self._axes) if x["driving"] or x["interpolates"])

    def _find_fixed_drive_axes(self, is_absolute: int) -> int:
        """Return the axes in drives of a fixed number of pulses, absolute or relative, as bits."""
        axes = enumerate(self._axes)
        return sum(
            1 << k for k, x in axes if self.driving_axes >> k & 1 and x["fixed"] and x["absolute"] == is_absolute
        )

    @property
    def relative_drive_axes(self) -> int:
        """Axes in relative or counter relative position driving (50h, 51h), as bits."""
        return self._find_fixed_drive_axes(0)

    @property
    def absolute_drive_axes(self) -> int:
        """Axes in absolute position driving (54h), as bits."""
        return self._find_fixed_drive_axes(1)

    @property
    def is_interpolating(self) -> bool:
        """Whether an interpolation is in progress."""
        return bool(self._record["interpolating"])

    @property
    def is_queue_full(self) -> bool:
        """Whether the next segment cannot be written yet (CNEXT = 0)."""
        queue = self._record["ip"]
        return self.is_interpolating and bool(queue["waiting_segments"] >= queue["queue_depth"])

    @property
    def is_loading_pattern(self) -> bool:
        """Whether writes to WR2 to WR5 go to the bit pattern registers, after command 36h."""
        return bool(self._record["ip"]["loads_pattern"])

    @property
    def interpolated_axes(self) -> int:
        """Axes that the register IPM or WR5 selects for interpolation, as bits."""
        return self._find_interpolated_axes()

    def find_axes_of_interpolation(self, command: ChipCommand) -> int:
        """Return the axes that take part in an interpolation command, as bits."""
        return self.interpolated_axes

    def find_refused_axes(self, value: int) -> dict[int, str]:
        """Try a drive command on a copy of the chip, and find the axes that it does not start although they have pulses to make.

        Args:
            value: The word to WR0.

        Returns:
            Axis -> reason in RR2, in words.
        """
        rows = self.copy_record()
        core.write(rows, 0, value)
        refusals = {}
        reasons = REFUSALS | STOP3_REFUSAL_REASON if self._record["extended"] else REFUSALS
        for k in range(self._count):
            x, after = self._axes[k], rows[0]["ax"][k]
            empty = after["fixed"] and after["output_pulses"] == 0
            commanded = value >> 8 + k & 1 and not (x["start_hold"] & 1 or empty or core.is_busy(rows, k))
            texts = [text for bit, text in reasons.items() if int(after["stop_causes"]) & bit]
            if commanded and texts:
                refusals[k] = ", ".join(texts)
        return refusals

    def copy_record(self) -> np.ndarray:
        """Return an array of one record with the chip's state."""
        rows = np.zeros(1, state.STATE)
        rows[0] = self._record
        return rows

    @property
    def multichip_role(self) -> int:
        """MLT of IPM: 1 master, 2 slave of a multichip interpolation."""
        return int(self._axes[0]["mode"][state.IPM]) >> multichip.MLT & 3

    @property
    def is_wired_to_other_chips(self) -> bool:
        """True if wires join the chip to other chips, for multichip interpolation."""
        return bool(self._record["wire_word"])

    @property
    def has_master_started(self) -> bool:
        """True if the master of the chips that are wired together has started."""
        return bool(self._record["wire_word"] & multichip.GO)

    @property
    def drive_speeds(self) -> tuple[int, ...]:
        """DV of every axis, pps; empty on chips whose speeds have no common unit."""
        return tuple(int(x["reg"][state.DV]) for x in self._record["ax"])

    @property
    def tp_values(self) -> tuple[int, ...]:
        """TP of every axis: the number of pulses of a drive, or the finish point of an interpolation."""
        return tuple(int(x["reg"][state.TP]) for x in self._record["ax"])

    @property
    def helix_ticks(self) -> int:
        """HLV of the MCX514: the number of ticks of the arc or of a whole turn of a helix."""
        return int(self._axes[0]["reg"][state.HLV])


class Mcx312LintState(LintState):
    """Contents of an MCX312, whose finish points are signed, and whose speeds have no common unit."""

    @property
    def multichip_role(self) -> int:
        return 0

    @property
    def drive_speeds(self) -> tuple[int, ...]:
        return ()

    @property
    def tp_values(self) -> tuple[int, ...]:
        """TP of every axis as a signed number of 32 bits."""
        return tuple(p - (p >> 31 << 32) for p in super().tp_values)


class Mcx314asLintState(Mcx312LintState):
    """Contents of an MCX314As, whose WR5 selects three axes; a command of two axes ignores the third."""

    def find_axes_of_interpolation(self, command: ChipCommand) -> int:
        return self._find_interpolated_axes(max(command.together))


def lint_write(map_: RegisterMap, chip: Any, address: int, value: int) -> Iterator[Finding]:
    """Yield every rule that a write breaks, with a message.

    Args:
        map_: Register map of the chip.
        chip: Contents of the chip before the write, a LintState.
        address: Number of the WR register.
        value: The word, 16 bits.
    """
    if address == 0:
        yield from _lint_command(map_, chip, value)
    elif address < 6 and not (chip.is_loading_pattern and address >= 2):
        w = map_.word(f"WR{address}")
        if unused := value & ~w.used:
            message = f"{w.name} = {value:04X}h: the {map_.chip} has no {_name_bits(unused)} there"
            yield UNUSED_BITS.with_source(w.name), message
        yield from _lint_fields(w, value, w.name)


def _lint_command(map_: RegisterMap, chip: Any, value: int) -> Iterator[Finding]:
    """Check a command, a word that is written to WR0."""
    if reserved := value & map_.mask("WR0", "zero"):
        yield RESERVED_BITS, f"WR0 = {value:04X}h: {_name_bits(reserved)} must be 0"
    if value & RESET:
        if more := value & ~RESET & ~reserved:
            yield RESET_WITH_MORE, f"WR0 = {value:04X}h resets the chip: leave {_name_bits(more)} 0"
        return
    code, axes = CODE.extract(value), AXIS.extract(value)
    command = map_.by_code.get(code)
    if command is None:
        yield UNKNOWN_COMMAND, f"{code:02X}h is no command of the {map_.chip}"
        return
    name = f"{code:02X}h ({command.title})"
    yield from _lint_axes(map_, command, name, axes)
    if command.lacking:
        yield NOT_MODELED, f"{name} is {command.lacking}"
        return
    if command.kind in ("data write", "mode write"):
        yield from _lint_data(map_.register(command.symbol), chip, command, axes)
    if command.kind == "data read" and chip.has_unused_data:
        yield DATA_NOT_USED, f"{name} takes no data: what was written to WR6, WR7 is not used"
    if command.kind == "drive":
        yield from _lint_drive(map_, chip, command, value)
    if command.together:
        yield from _lint_interpolation(chip, command, name)


def _lint_drive(map_: RegisterMap, chip: Any, command: ChipCommand, value: int) -> Iterator[Finding]:
    """Check a drive command, the word `value` to WR0."""
    name, axes = f"{command.code:02X}h ({command.title})", AXIS.extract(value)
    if command.starts and (moving := axes & chip.driving_axes):
        yield ALREADY_DRIVING, f"{name} while {_name_axes(moving)} is driving (n-DRV = 1)"
    if command.symbol in TP_DRIVES:
        yield from _lint_pulse_numbers(map_, chip, name, axes)
    if command.starts and (refusals := chip.find_refused_axes(value)):
        reasons = "; ".join(f"{_name_axes(1 << k)}: {why}" for k, why in refusals.items())
        yield STARTS_NO_DRIVE, f"{name} starts no drive: {reasons}"


def _lint_axes(map_: RegisterMap, command: ChipCommand, name: str, axes: int) -> Iterator[Finding]:
    """Check the axis bits of a command."""
    absent = axes >> map_.axes << map_.axes
    if absent:
        yield ABSENT_AXES, f"{name} to {_name_axes(absent)}: the {map_.chip} has {map_.axes} axes"
    if command.axes and not axes and map_.axes > 1:
        yield AXES_MISSING, f"{name} needs axis bits and has none"
    if not command.axes and axes and command.kind != "data read":
        yield UNNEEDED_AXES, f"{name} carries no axis bits: {_name_axes(axes)} given"
    if command.axes and command.kind == "data read" and axes & (axes - 1):
        yield SEVERAL_AXES_READ, f"{name} reads one axis: of {_name_axes(axes)} only the first is read"


def _lint_data(register: Register, chip: Any, command: ChipCommand, axes: int) -> Iterator[Finding]:
    """Check the data of a command that writes register `register`."""
    word = chip.command_data & register.mask
    value = register.value(word)
    section = register.section or f"{command.kind[:4]} writing commands"
    if (
        not register.allows(value) and register.name != "TP"
    ):  # TP may be any number as data of a bit pattern: its drives are checked
        yield (
            VALUE_RANGE.with_source(section),
            f"{register.name} = {value}: {register.title} takes {register.range[0]} to {register.range[1]}",
        )
    if command.kind == "mode write" and (unused := word & ~register.used):
        yield UNUSED_BITS.with_source(section), f"{register.name} = {word:04X}h: it has no {_name_bits(unused)}"
    for f in register.fields:
        if axes and f.only is not None and f.extract(word) and not axes >> f.only & 1:
            message = (
                f"{register.name} = {word:04X}h to {_name_axes(axes)}: {f.name} ({f.meaning}) acts on "
                f"{AXIS_LETTERS[f.only]} only"
            )
            yield ONE_AXIS_ONLY.with_source(section), message
    if register.name == "IPM" and MLT.extract(word) and LMDF.extract(word):
        message = f"IPM = {word:04X}h: MLT and LMDF exclude each other; short-axis pulses are not equalized"
        yield EXCLUSIVE_BITS.with_source(section), message
    if register.name == "TP":
        yield from _lint_pulses_in_motion(register, chip, axes, value)
    if register.name == "DV" and chip.is_interpolating and axes & _find_main_axis(chip) and value > MAX_CONTINUOUS_PPS:
        message = f"DV = {value} in continuous interpolation: {MAX_CONTINUOUS_PPS} is the most"
        yield CONTINUOUS_TOO_FAST, message
    yield from _lint_fields(register, word, section)


def _lint_pulses_in_motion(tp: Register, chip: Any, axes: int, value: int) -> Iterator[Finding]:
    """Check a value that is written to TP while axes drive."""
    if axes & chip.relative_drive_axes and not tp.allows(value):
        yield (
            VALUE_RANGE.with_source(tp.section),
            f"TP = {value} while driving: {tp.title} takes {tp.range[0]} to {tp.range[1]}",
        )
    if moving := axes & chip.absolute_drive_axes:
        message = f"TP written while {_name_axes(moving)} is in absolute position driving: it cannot be changed"
        yield TP_IN_ABSOLUTE_DRIVE, message
    if turned := sum(
        1 << k for k, old in enumerate(chip.tp_values) if axes & chip.relative_drive_axes & 1 << k and old * value < 0
    ):
        why = "the direction cannot be changed, and the drive stops at once"
        yield TP_REVERSES_DRIVE, f"TP = {value} while {_name_axes(turned)} drives the other way: {why}"


def _lint_pulse_numbers(map_: RegisterMap, chip: Any, name: str, axes: int) -> Iterator[Finding]:
    """Check that TP of each axis of a drive command is a number of pulses."""
    tp = map_.register("TP")
    for k, value in enumerate(chip.tp_values[: map_.axes]):
        if (axes >> k & 1 or map_.axes == 1) and not tp.allows(value):
            yield (
                PULSE_NUMBER,
                f"{name} with TP = {value} of {AXIS_LETTERS[k]}: {tp.title} takes {tp.range[0]} to {tp.range[1]}",
            )


def _lint_interpolation(chip: Any, command: ChipCommand, name: str) -> Iterator[Finding]:
    """Check an interpolation command."""
    axes = chip.find_axes_of_interpolation(command)
    if (count := axes.bit_count()) not in command.together:
        yield NUMBER_OF_AXES, f"{name} with {count} axes chosen{': ' if axes else ''}{_name_axes(axes)}"
    if chip.multichip_role:
        yield from _lint_multichip(chip, command, name)
    if not chip.is_interpolating and (moving := axes & chip.driving_axes):
        yield AXIS_DRIVES, f"{name} while {_name_axes(moving)} is driving (n-DRV = 1)"
    if chip.is_queue_full and not (
        chip.multichip_role and chip.is_wired_to_other_chips
    ):  # lines of several chips do not queue
        yield PRE_BUFFER_FULL, f"{name} while the pre-buffer is full: wait for CNEXT = 1"
    speed = sum(dv for k, dv in enumerate(chip.drive_speeds) if _find_main_axis(chip) >> k & 1)
    if chip.is_interpolating and speed > MAX_CONTINUOUS_PPS:
        message = f"{name} in continuous interpolation with DV = {speed}: {MAX_CONTINUOUS_PPS} is the most"
        yield CONTINUOUS_TOO_FAST, message
    for k, tp in enumerate(chip.tp_values):
        if axes >> k & 1 and command.points and not COORDINATE_RANGE_PULSES[0] <= tp <= COORDINATE_RANGE_PULSES[1]:
            message = (
                f"{name} with TP = {tp} of {AXIS_LETTERS[k]}: a finish point takes {COORDINATE_RANGE_PULSES[0]} "
                f"to {COORDINATE_RANGE_PULSES[1]}"
            )
            yield FINISH_POINT_RANGE, message
    if command.symbol in HELICES:
        yield from _lint_helix(chip, name)


def _lint_helix(chip: Any, name: str) -> Iterator[Finding]:
    """Find the axes along a helix that have more pulses than the helix has ticks."""
    for k in [k for k in range(len(chip.tp_values)) if chip.interpolated_axes >> k & 1][2:]:
        if (pulses := abs(chip.tp_values[k])) > chip.helix_ticks:
            limit = f"the {chip.helix_ticks} ticks of HLV make one pulse each at most"
            lost = f"the other {pulses - chip.helix_ticks} are lost"
            yield HELIX_PULSES_LOST, f"{name} with TP = {chip.tp_values[k]} of {AXIS_LETTERS[k]}: {limit}; {lost}"


def _lint_multichip(chip: Any, command: ChipCommand, name: str) -> Iterator[Finding]:
    """Check an interpolation command to a master or slave."""
    subject = (
        f"{name} as {MLT.values[chip.multichip_role]} (MLT = {chip.multichip_role})"
        if chip.multichip_role < len(MLT.values)
        else name
    )
    if chip.multichip_role == 1 and not chip.is_wired_to_other_chips:
        why = "no other chip is wired to this one, which interpolates by itself; see Stage(multichip=...)"
        yield NO_OTHER_CHIP, f"{subject}: {why}"
        return
    if not command.symbol.startswith("LHK"):
        why = "starts nothing: of several chips together only lines, 60h to 63h, are modeled"
        yield ONLY_LINES, f"{subject} {why}"
    if not chip.is_wired_to_other_chips:
        why = "no other chip is wired to this one, and no pulse of a master will come; see Stage(multichip=...)"
        yield NO_OTHER_CHIP, f"{subject}: {why}"
    if chip.is_interpolating:
        why = "is refused: one after the other without a stop is not modeled"
        yield LINE_IN_PROGRESS, f"{subject} during a line of several chips {why}"
    elif chip.multichip_role == 2 and chip.has_master_started:
        yield SLAVE_AFTER_START, f"{subject} while the master interpolates is refused (MCERR): start slaves first"


def _find_main_axis(chip: Any) -> int:
    """Find the main axis of the MCX514's interpolation, the lowest, as a bit."""
    axes: int = chip.interpolated_axes
    return axes & -axes


def _lint_fields(place: Register | Word, word: int, section: str) -> Iterator[Finding]:
    """Find the fields of a register or word whose value has no meaning."""
    for f in place.fields:
        if f.legal and not f.legal[0] <= f.extract(word) <= f.legal[1]:
            yield (
                FIELD_RANGE.with_source(section),
                f"{place.name} = {word:04X}h: {f.name} = {f.extract(word)} ({f.description})",
            )


def _name_bits(mask: int) -> str:
    """Return the numbers of the bits that are set in a mask, in words."""
    numbers = [str(k) for k in range(15, -1, -1) if mask >> k & 1]
    return f"bit{'s' if len(numbers) > 1 else ''} {' and '.join(numbers)}"


def _name_axes(axes: int) -> str:
    """Return the names of the axes whose bits are set in a mask, in words."""
    return ", ".join(a for k, a in enumerate(AXIS_LETTERS) if axes >> k & 1)
