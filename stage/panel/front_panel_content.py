"""Texts from a chip's register map: the content of its front panel, and the meaning of lines of the bus console.

This module draws no page.

format_value(register, 8000), describe_value(register, 8000)
parse_number("1F40h", 13)                 8000
parse_line(PCL240K, "R1 <- 100")          the bus cycles that write it, as a driver makes them
parse_line(MCX514, "DRVRL", axis=2)       a command, with the axis in it
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from stage.chips.chip import Chip
from stage.chips.register_map import EVIDENCE, Field, Register, Word
from stage.errors import ArgumentError, find_similar_names
from stage.units import INTEGER_PATTERN, MAX_INTEGER_LENGTH, parse_integer

ROW_COMMAND_KINDS = ("data write", "mode write")
"""Kinds of commands that the row of a register sends when a user writes its value."""


@dataclass(frozen=True)
class CommandButton:
    """Button of a front panel that sends a command.

    Attributes:
        label: Short name.
        title: Whole description from the register map.
        symbol, datum: Arguments of `Chip.command_cycles`.
        evidence: Letter of the evidence in the register map.
        data_bits: Bits of the data that a user has to give; 0: the command takes none.
        starts_drive: Whether the command starts a drive.
        words: Name of the command in the data sheet.
    """

    label: str
    title: str
    symbol: str
    datum: int | None
    evidence: str
    data_bits: int = 0
    starts_drive: bool = False
    words: str = ""


class FrontPanel:
    """Content of the front panel of a chip class.

    Attributes:
        registers: Registers, each with a row of its own.
        forms: Words that a host writes and that users compose from fields.
        lamps: Words that a host reads, shown as lamps.
        buttons: Command buttons by the name of their group; empty if the family does not define how commands are sent.
    """

    def __init__(self, kind: type[Chip]):
        self.kind, self.map = kind, kind.MAP
        self.registers: tuple[Register, ...] = self.map.registers
        written = tuple(w for w in self.map.words if w.is_written and w.fields)
        coded = {c.address for c in written if self.map.commands} & {0}
        self.forms = tuple(w for w in written if w.address not in coded and not _is_command_data(w))
        self.lamps = tuple(w for w in self.map.words if not w.is_written and any("R" in f.access for f in w.fields))
        self.buttons: dict[str, list[CommandButton]] = {}
        for group, button in (*self._list_buttons_of_words(written, coded), *self._list_buttons_of_commands()):
            if self._can_send(button):
                self.buttons.setdefault(group, []).append(button)

    def _list_buttons_of_words(
        self, written: tuple[Word, ...], coded: set[int | None]
    ) -> Iterator[tuple[str, CommandButton]]:
        """Yield group and button for each described value of the words that a host writes, except words at the command address."""
        for w in written:
            if w.address in coded:
                continue
            free = [f for f in w.fields if not is_fixed(f)]
            values = free[0].values if len(free) == 1 and free[0].low == 0 else {}
            for code, title in (w.sends or values).items():
                label = f"{w.fixed | code:0{w.bits // 4}X}h"
                yield (
                    f"{w.name}: {w.title}",
                    CommandButton(label, title, w.name, code, find_weakest_evidence(w.fields), words=title),
                )

    def _list_buttons_of_commands(self) -> Iterator[tuple[str, CommandButton]]:
        """Yield group and button of each command of the register map, except those that the row of a register sends."""
        for c in self.map.commands:
            if c.kind in ROW_COMMAND_KINDS:
                continue
            if c.choice:
                for k, name in enumerate(c.chooses):
                    title = f"{c.title} {name}"
                    yield c.kind, CommandButton(f"{c.symbol} {name}", title, c.symbol, 1 << k, c.evidence, words=title)
            else:
                data_bits = 0 if "read" in c.kind else 8 * c.bytes
                title = f"{c.hex}  {c.description}" + (f"; lacking: {c.lacking}" if c.lacking else "")
                yield c.kind, CommandButton(c.symbol, title, c.symbol, None, c.evidence, data_bits, c.starts, c.title)

    def _can_send(self, button: CommandButton) -> bool:
        """Return whether the chip class knows the bus cycles that send the command of a button."""
        try:
            self.kind.command_cycles(button.symbol, 0, button.datum if not button.data_bits else 0)
        except NotImplementedError:
            return False
        return True


def describe_evidence(letter: str) -> str:
    """Return an evidence letter of a register map with its meaning."""
    return f"{letter}: {EVIDENCE.get(letter, 'not said')}"


def describe_range(register: Register) -> str:
    """Return a text with the values that a register accepts: the range of the data sheet, or else of its bits."""
    low, high = register.range
    values = " or ".join([f"{low} to {high}", *map(str, register.also)])
    return values if register.legal else f"{values} ({register.bits} bits)"


def format_value(register: Register | Word, value: int) -> str:
    """Format the value of a register or word: hexadecimal if it has fields, else decimal."""
    if register.fields:
        return f"{value & (1 << register.bits) - 1:0{(register.bits + 3) // 4}X}h"
    return str(register.value(value) if isinstance(register, Register) else value)


def describe_value(register: Register | Word, value: int) -> str:
    """Describe a value of a register or word: its fields in words, without those at their usual value; else in hexadecimal."""
    word = value & (1 << register.bits) - 1
    if not register.fields:
        return f"{word:X}h" if abs(value) > 9 else ""
    fields = [(f, f.extract(word)) for f in register.fields if not is_fixed(f) and f.extract(word) != f.silent]
    texts = [f.describe_value(value) or (f"{f.name} = {value}" if value else "") for f, value in fields]
    return ", ".join(text for text in texts if text)


def list_choices(field: Field) -> dict[int, str]:
    """Return a text for each value that a field can have; empty for a field that is a number."""
    return {v: f"{v}  {text}" for v, text in field.values.items()}


def replace_field(word: int, field: Field, value: int) -> int:
    """Return a copy of `word` in which one field has a new value."""
    return word & ~field.mask | value << field.low & field.mask


def parse_number(text: str, bits: int) -> int:
    """Parse a number that a user has typed: decimal, 0x1F, 1Fh or 0b101, with or without sign.

    Args:
        text: The text.
        bits: Bits of the number; a negative one must fit as two's complement, others as unsigned.

    Raises:
        ArgumentError: The text is not a number, or the number needs more bits.
    """
    typed = re.sub(r"[_\s]", "", text)
    if len(typed) > MAX_INTEGER_LENGTH:
        raise ArgumentError(f"a number of {len(typed)} characters needs more than {bits} bits.")
    if (value := parse_integer(typed)) is None:
        raise ArgumentError(_explain_invalid_number(text, re.sub(r"^[-+]", "", typed)))
    if not -(1 << bits - 1) <= value < 1 << bits:
        raise ArgumentError(f"{text.strip()} needs more than {bits} bits: {-(1 << bits - 1)} to {(1 << bits) - 1} fit.")
    return value


def _explain_invalid_number(text: str, digits: str) -> str:
    if not digits:
        return "a number is missing: write for example 100, 64h, 0x64 or 0b1100100."
    if re.fullmatch(r"[0-9a-fA-F]+", digits):
        return f"{text.strip()!r} is not a decimal number. Did you mean {digits.upper()}h ({int(digits, 16)})?"
    if re.fullmatch(r"[0-9]*[.,][0-9]*", digits):
        return f"{text.strip()!r}: registers hold whole numbers. Did you mean {digits.replace(',', '.').partition('.')[0] or 0}?"
    near = digits.translate(str.maketrans("OoIl", "0011"))
    if re.fullmatch(INTEGER_PATTERN, near):
        return f"{text.strip()!r} is not a number. Did you mean {near}?"
    return f"{text.strip()!r} is not a number: write for example 100, 64h, 0x64 or 0b1100100."


def is_fixed(field: Field) -> bool:
    """Return whether a field can have only one value: its bits select the word among those written to the same address."""
    return field.legal is not None and field.legal[0] == field.legal[1]


def _is_command_data(word: Word) -> bool:
    """Return whether a word is the data of commands: a single number without described values."""
    return len(word.fields) == 1 and not word.fields[0].values and word.fields[0].mask.bit_count() == word.bits


def describe_lamp(field: Field, value: int) -> tuple[str, bool]:
    """Return the text of the lamp of a field with this value, and whether the lamp is on."""
    on = value != (0 if field.silent is None else field.silent)
    if field.high != field.low:
        return f"{field.describe_value(value) or f'{field.name} {value}'}", on
    return field.describe_value(value) or field.meaning or field.name, on


def find_weakest_evidence(fields: tuple[Field, ...]) -> str:
    """Return the letter of the weakest evidence that any of these fields has."""
    letters = list(EVIDENCE)
    return max((f.evidence for f in fields), key=lambda e: letters.index(e) if e in letters else 0)


HELP = """\
10 15           bytes to address 0, in hexadecimal as sheets print them (10, 10h and 0x10 are the same)
2: 1F           bytes to address 2, one cycle each
read 0          a read cycle at address 0; read 3 2 1: several
R1 <- 100       a register, by the cycles of a driver; numbers are decimal, 64h, 0x64 or 0b1100100
R14.linear <- 1 one field of it, the others stay
R1              what it holds, without a bus cycle
operate 15h     a command or a word by its name, with its data
help R1         what the map says of a name; up and down arrow: lines before; Tab completes names"""
ASSIGNMENT_PATTERN = re.compile(r"([^\s<=]+)\s*(?:<-|=)\s*(.*)")


class BusCycle(NamedTuple):
    """Bus cycle to make on a chip: a read if `read`, else a write of `datum`."""

    read: bool
    address: int
    datum: int = 0


class ConsoleCommand(NamedTuple):
    """Meaning of a line of the bus console: the bus cycles to make, and an answer to show."""

    cycles: tuple[BusCycle, ...]
    answer: str = ""


def list_console_names(kind: type[Chip]) -> list[str]:
    """Return every name with which a line of the bus console may begin."""
    map_ = kind.MAP
    words = (w.name for w in map_.words if w.is_written)
    registers, commands = (r.name for r in map_.registers), (c.symbol for c in map_.commands)
    return list(dict.fromkeys((*registers, *words, *commands, "read", "help")))


def list_completions(kind: type[Chip], text: str) -> list[str]:
    """Return the names of `list_console_names` that begin with the last word of `text`, in any case."""
    last = text.split(" ")[-1].upper()
    return [name for name in list_console_names(kind) if name.upper().startswith(last)] if last else []


def parse_line(kind: type[Chip], text: str, axis: int = 0, values: Mapping[str, int] | None = None) -> ConsoleCommand:
    """Return the bus cycles or the answer for a line of the bus console.

    Args:
        kind: Class of the chip.
        text: The line.
        axis: Axis of the chip.
        values: Values of registers and words now, by name, for lines that show a value or change one field of it.

    Raises:
        ArgumentError: The line has no meaning; the error lists similar names.
    """
    line, values = text.strip(), values or {}
    first, _, rest = line.partition(" ")
    if not line:
        raise ArgumentError("nothing to do: `help` lists what can be written here.")
    if first.lower() == "help":
        return ConsoleCommand((), _describe_name(kind, rest.strip()))
    if match := ASSIGNMENT_PATTERN.fullmatch(line):
        return _parse_assignment(kind, match[1], match[2], axis, values)
    if first.lower() == "read":
        if not rest.strip():
            raise ArgumentError(f"read: an address is missing, 0 to {kind.ADDRESSES - 1:X}h.")
        return ConsoleCommand(tuple(BusCycle(True, _parse_address(kind, a)) for a in rest.split()))
    if ":" in line:
        address, _, data = line.partition(":")
        if not data.strip():
            raise ArgumentError(f"{line}: the data are missing, as in {address.strip()}: 1F.")
        return _make_write_command(kind, _parse_address(kind, address), data.split())
    return _parse_named_line(kind, first, rest.strip(), axis, values) or _parse_bytes(kind, line)


def _parse_assignment(kind: type[Chip], name: str, text: str, axis: int, values: Mapping[str, int]) -> ConsoleCommand:
    """Return the bus cycles for the line `name <- text`; the name may be that of a field, for example R14.linear."""
    place_name, _, part = name.partition(".")
    place = _find_map_item(kind, place_name)
    if place is None:
        if not part and (cycles := _list_cycles_of_family_name(kind, place_name, text, axis)):
            return ConsoleCommand(cycles)
        near = _suggest_similar_names(kind, place_name)
        raise ArgumentError(f"no register or word of {kind.MAP.chip} is called {place_name!r}.{near}")
    if isinstance(place, Register) and "W" not in place.access:
        raise ArgumentError(f"{place.name} ({place.title}) can only be read.")
    if part:
        field = kind.MAP.field(place.name, part)
        value = replace_field(values.get(place.name, 0), field, parse_number(text, field.high - field.low + 1))
    else:
        value = parse_number(text, place.bits)
    return ConsoleCommand(list_write_cycles(kind, place, value, axis))


def _list_cycles_of_family_name(kind: type[Chip], name: str, text: str, axis: int) -> tuple[BusCycle, ...]:
    """Return the write cycles for a name that only the chip family knows, for example a value of several registers; else ()."""
    try:
        kind.register_cycles(name, 0, axis)
    except (ArgumentError, NotImplementedError):
        return ()
    return tuple(BusCycle(False, *cycle) for cycle in kind.register_cycles(name, parse_number(text, 32), axis))


def list_write_cycles(kind: type[Chip], place: Register | Word, value: int, axis: int) -> tuple[BusCycle, ...]:
    """Return the bus cycles by which a host driver writes a register or word."""
    bits = value & (1 << place.bits) - 1
    is_register = isinstance(place, Register)
    cycles = (
        kind.register_cycles(place.name, bits, axis) if is_register else kind.command_cycles(place.name, axis, bits)
    )
    return tuple(BusCycle(False, *cycle) for cycle in cycles)


def _parse_named_line(
    kind: type[Chip], name: str, text: str, axis: int, values: Mapping[str, int]
) -> ConsoleCommand | None:
    """Return the meaning of a line that begins with the name of a command, word or register; None if there is no such name.

    Args:
        kind: Class of the chip.
        name: First word of the line.
        text: Rest of the line: data, or "".
        axis: Axis of the chip.
        values: Values of registers and words now, by name.
    """
    place = _find_map_item(kind, name)
    command = next((c for c in kind.MAP.commands if c.symbol == name.upper()), None)
    if isinstance(place, Register) and not (text or (command and command.kind == "data read")):
        return ConsoleCommand((), _describe_current_value(place, values))
    if command is not None:
        bits = 8 * command.bytes or command.choice.bit_length() or 1
    elif isinstance(place, Register):
        return _parse_assignment(kind, name, text, axis, values)
    elif place is not None:
        bits, name = place.bits, place.name
    else:
        return None
    try:
        cycles = kind.command_cycles(name, axis, parse_number(text, bits) if text else None)
    except NotImplementedError as error:
        raise ArgumentError(f"{error} Write its bytes: `0: 15`.") from error
    return ConsoleCommand(tuple(BusCycle(False, *cycle) for cycle in cycles))


def _parse_bytes(kind: type[Chip], line: str) -> ConsoleCommand:
    """Return the bus cycles that write the hexadecimal bytes of a line to address 0."""
    words = line.split()
    if not all(re.fullmatch(r"(0[xX])?[0-9a-fA-F]+[hH]?", w) for w in words):
        raise ArgumentError(
            f"{words[0]!r} is no name of {kind.MAP.chip} and no byte.{_suggest_similar_names(kind, words[0])} `help` says more."
        )
    return _make_write_command(kind, 0, words)


def _make_write_command(kind: type[Chip], address: int, words: list[str]) -> ConsoleCommand:
    return ConsoleCommand(tuple(BusCycle(False, address, _parse_datum(kind, word)) for word in words))


def _parse_hexadecimal(text: str) -> int:
    try:
        return int(text.strip().rstrip("hH").encode("ascii"), 16)
    except ValueError:
        raise ArgumentError(f"{text.strip()!r} is not a hexadecimal number such as 1F, 1Fh or 0x1F.") from None


def _parse_address(kind: type[Chip], text: str) -> int:
    address = _parse_hexadecimal(text)
    if not 0 <= address < kind.ADDRESSES:
        raise ArgumentError(f"address {text.strip()}: {kind.MAP.chip} has the addresses 0 to {kind.ADDRESSES - 1:X}h.")
    return address


def _parse_datum(kind: type[Chip], text: str) -> int:
    datum = _parse_hexadecimal(text)
    if not 0 <= datum <= kind.DATA_MASK:
        raise ArgumentError(f"{text.strip()}: the bus of {kind.MAP.chip} takes 0 to {kind.DATA_MASK:X}h in one cycle.")
    return datum


def _find_map_item(kind: type[Chip], name: str) -> Register | Word | None:
    """Return the register, or else the word that a host writes, with this name in upper or lower case, or None."""
    wanted = name.upper()
    registers = (r for r in kind.MAP.registers if r.name.upper() == wanted)
    return next(registers, None) or next((w for w in kind.MAP.words if w.is_written and w.name.upper() == wanted), None)


def _suggest_similar_names(kind: type[Chip], name: str) -> str:
    """Return a question with the names that are similar to `name`, or ""."""
    known = {n.upper(): n for n in list_console_names(kind)}
    near = [known[n] for n in find_similar_names(name.upper(), known)]
    return f" Did you mean {' or '.join(near)}?" if near else ""


def _describe_current_value(r: Register, values: Mapping[str, int]) -> str:
    """Describe the value that a register holds now, for the bus console."""
    if r.name not in values:
        return f"{r.name} ({r.description}) cannot be seen."
    words, unit = describe_value(r, values[r.name]), f" {r.unit}" if r.unit else ""
    return f"{r.name} = {format_value(r, values[r.name])}{unit}{f' ({words})' if words else ''}: {r.title}"


def _describe_name(kind: type[Chip], name: str) -> str:
    """Describe a command, register or word by its name, or how to use the console if the name is ""."""
    if not name:
        return HELP
    place = _find_map_item(kind, name)
    command = next((c for c in kind.MAP.commands if c.symbol == name.upper()), None)
    if command is not None and not isinstance(place, Register):
        data = f"; takes {command.bytes} bytes" if command.bytes and "read" not in command.kind else ""
        return f"{command.symbol} {command.hex}: {command.description}{data}"
    if place is None:
        raise ArgumentError(f"{kind.MAP.chip} has nothing that is called {name!r}.{_suggest_similar_names(kind, name)}")
    head = f"{place.name}: {place.description}"
    if isinstance(place, Register):
        head += f"; {describe_range(place)}{' ' + place.unit if place.unit else ''}"
    return "\n".join([head, *(f"  .{f.name}  b{f.bits}  {f.description}" for f in place.fields)])
