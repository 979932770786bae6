"""Registers in words, made from a chip's register map: what its front panel shows, and what lines of the console mean. No page.

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

BY_ROWS = ("data write", "mode write")
"""Kinds of commands that a register's row sends when somebody writes there."""


@dataclass(frozen=True)
class CommandButton:
    """Command that can be sent.

    Attributes:
        label: Short name.
        title: All that the map says.
        symbol, datum: As `Chip.command_cycles` takes them.
        evidence: Letter of the map.
        takes: Bits of the data that a user has to give, 0 for none.
        starts: It begins a drive.
        words: The data sheet's.
    """

    label: str
    title: str
    symbol: str
    datum: int | None
    evidence: str
    takes: int = 0
    starts: bool = False
    words: str = ""


class FrontPanel:
    """Front panel of a kind of chip.

    Attributes:
        registers: A row each.
        forms: Words that a host composes of fields.
        lamps: Words that a host reads.
        buttons: Commands by group; empty where the family does not say how its commands are sent.
    """

    def __init__(self, kind: type[Chip]):
        self.kind, self.map = kind, kind.MAP
        self.registers: tuple[Register, ...] = self.map.registers
        written = tuple(w for w in self.map.words if w.written and w.fields)
        coded = {c.address for c in written if self.map.commands} & {0}
        self.forms = tuple(w for w in written if w.address not in coded and not _is_data(w))
        self.lamps = tuple(w for w in self.map.words if not w.written and any("R" in f.access for f in w.fields))
        self.buttons: dict[str, list[CommandButton]] = {}
        for group, button in (*self._of_words(written, coded), *self._of_commands()):
            if self._sendable(button):
                self.buttons.setdefault(group, []).append(button)

    def _of_words(self, written: tuple[Word, ...], coded: set[int | None]) -> Iterator[tuple[str, CommandButton]]:
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

    def _of_commands(self) -> Iterator[tuple[str, CommandButton]]:
        for c in self.map.commands:
            if c.kind in BY_ROWS:
                continue
            if c.choice:
                for k, name in enumerate(c.chooses):
                    title = f"{c.title} {name}"
                    yield c.kind, CommandButton(f"{c.symbol} {name}", title, c.symbol, 1 << k, c.evidence, words=title)
            else:
                takes = 0 if "read" in c.kind else 8 * c.bytes
                title = f"{c.hex}  {c.description}" + (f"; lacking: {c.lacking}" if c.lacking else "")
                yield c.kind, CommandButton(c.symbol, title, c.symbol, None, c.evidence, takes, c.starts, c.title)

    def _sendable(self, button: CommandButton) -> bool:
        try:
            self.kind.command_cycles(button.symbol, 0, button.datum if not button.takes else 0)
        except NotImplementedError:
            return False
        return True


def describe_evidence(letter: str) -> str:
    """Return what an evidence letter means."""
    return f"{letter}: {EVIDENCE.get(letter, 'not said')}"


def describe_range(register: Register) -> str:
    """Return the values that a register takes, as the data sheet says, or as its bits are."""
    low, high = register.range
    values = " or ".join([f"{low} to {high}", *map(str, register.also)])
    return values if register.legal else f"{values} ({register.bits} bits)"


def format_value(register: Register | Word, value: int) -> str:
    """Return a value as its field shows it: bits in hexadecimal, numbers in decimal."""
    if register.fields:
        return f"{value & (1 << register.bits) - 1:0{(register.bits + 3) // 4}X}h"
    return str(register.value(value) if isinstance(register, Register) else value)


def describe_value(register: Register | Word, value: int) -> str:
    """Return what a value means beside its number: its fields in words, but for silent ones, or hexadecimal."""
    word = value & (1 << register.bits) - 1
    if not register.fields:
        return f"{word:X}h" if abs(value) > 9 else ""
    fields = [(f, f.of(word)) for f in register.fields if not is_fixed(f) and f.of(word) != f.silent]
    texts = [f.says(value) or (f"{f.name} = {value}" if value else "") for f, value in fields]
    return ", ".join(text for text in texts if text)


def list_choices(field: Field) -> dict[int, str]:
    """Return what a field can be, for a list; empty where it is a number."""
    return {v: f"{v}  {text}" for v, text in field.values.items()}


def replace_field(word: int, field: Field, value: int) -> int:
    """Return `word` with another value of one field."""
    return word & ~field.mask | value << field.low & field.mask


def parse_number(text: str, bits: int) -> int:
    """Return a typed number of so many bits: decimal, 0x1F or 1Fh, 0b101, signed in two's complement. Raises ArgumentError."""
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
    """Return whether a field's bits tell its word from others of the address: nobody chooses them."""
    return field.legal is not None and field.legal[0] == field.legal[1]


def _is_data(word: Word) -> bool:
    """Return whether a word is one number without words: the data of commands."""
    return len(word.fields) == 1 and not word.fields[0].values and word.fields[0].mask.bit_count() == word.bits


def describe_lamp(field: Field, value: int) -> tuple[str, bool]:
    """Return the words of a field as a lamp, and whether the lamp is on."""
    on = value != (0 if field.silent is None else field.silent)
    if field.high != field.low:
        return f"{field.says(value) or f'{field.name} {value}'}", on
    return field.says(value) or field.meaning or field.name, on


def find_weakest_evidence(fields: tuple[Field, ...]) -> str:
    """Return the weakest evidence letter of some fields."""
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
ASSIGN = re.compile(r"([^\s<=]+)\s*(?:<-|=)\s*(.*)")


class BusCycle(NamedTuple):
    """Bus cycle to be made. read: else a write."""

    read: bool
    address: int
    datum: int = 0


class ConsoleCommand(NamedTuple):
    """Meaning of a line of the console: bus cycles, and an answer that needs none."""

    cycles: tuple[BusCycle, ...]
    answer: str = ""


def list_names(kind: type[Chip]) -> list[str]:
    """Return every name that a line may begin with."""
    map_ = kind.MAP
    words = (w.name for w in map_.words if w.written)
    registers, commands = (r.name for r in map_.registers), (c.symbol for c in map_.commands)
    return list(dict.fromkeys((*registers, *words, *commands, "read", "help")))


def complete_name(kind: type[Chip], text: str) -> list[str]:
    """Return the names that begin as the last word of `text` does."""
    last = text.split(" ")[-1].upper()
    return [name for name in list_names(kind) if name.upper().startswith(last)] if last else []


def parse_line(kind: type[Chip], text: str, axis: int = 0, values: Mapping[str, int] | None = None) -> ConsoleCommand:
    """Return what a line of the console means.

    Args:
        kind: Class of the chip.
        text: The line.
        axis: Axis of the chip.
        values: What registers hold now, for lines that ask or that change one field.

    Raises:
        ArgumentError: The line means nothing; the text has the near misses.
    """
    line, values = text.strip(), values or {}
    first, _, rest = line.partition(" ")
    if not line:
        raise ArgumentError("nothing to do: `help` lists what can be written here.")
    if first.lower() == "help":
        return ConsoleCommand((), _help(kind, rest.strip()))
    if match := ASSIGN.fullmatch(line):
        return _assign(kind, match[1], match[2], axis, values)
    if first.lower() == "read":
        if not rest.strip():
            raise ArgumentError(f"read: an address is missing, 0 to {kind.ADDRESSES - 1:X}h.")
        return ConsoleCommand(tuple(BusCycle(True, _address(kind, a)) for a in rest.split()))
    if ":" in line:
        address, _, data = line.partition(":")
        if not data.strip():
            raise ArgumentError(f"{line}: the data are missing, as in {address.strip()}: 1F.")
        return _write_data(kind, _address(kind, address), data.split())
    return _named(kind, first, rest.strip(), axis, values) or _bytes(kind, line)


def _assign(kind: type[Chip], name: str, text: str, axis: int, values: Mapping[str, int]) -> ConsoleCommand:
    """Return the cycles of `name <- text`, where the name may have a field: R14.linear."""
    place_name, _, part = name.partition(".")
    place = _place(kind, place_name)
    if place is None:
        if not part and (cycles := _number_of_several(kind, place_name, text, axis)):
            return ConsoleCommand(cycles)
        near = _near(kind, place_name)
        raise ArgumentError(f"no register or word of {kind.MAP.chip} is called {place_name!r}.{near}")
    if isinstance(place, Register) and "W" not in place.access:
        raise ArgumentError(f"{place.name} ({place.title}) can only be read.")
    if part:
        field = kind.MAP.field(place.name, part)
        value = replace_field(values.get(place.name, 0), field, parse_number(text, field.high - field.low + 1))
    else:
        value = parse_number(text, place.bits)
    return ConsoleCommand(list_write_cycles(kind, place, value, axis))


def _number_of_several(kind: type[Chip], name: str, text: str, axis: int) -> tuple[BusCycle, ...]:
    """Return the cycles of a name that the family knows beside its map, such as a number of several registers; () for none."""
    try:
        kind.register_cycles(name, 0, axis)
    except (ArgumentError, NotImplementedError):
        return ()
    return tuple(BusCycle(False, *cycle) for cycle in kind.register_cycles(name, parse_number(text, 32), axis))


def list_write_cycles(kind: type[Chip], place: Register | Word, value: int, axis: int) -> tuple[BusCycle, ...]:
    """Return the cycles that write a register, or a word that a host writes, as a driver makes them."""
    bits = value & (1 << place.bits) - 1
    is_register = isinstance(place, Register)
    cycles = (
        kind.register_cycles(place.name, bits, axis) if is_register else kind.command_cycles(place.name, axis, bits)
    )
    return tuple(BusCycle(False, *cycle) for cycle in cycles)


def _named(kind: type[Chip], name: str, text: str, axis: int, values: Mapping[str, int]) -> ConsoleCommand | None:
    """Return a command, a word or a register by its name, with its data; None where there is none of this name."""
    place = _place(kind, name)
    command = next((c for c in kind.MAP.commands if c.symbol == name.upper()), None)
    if isinstance(place, Register) and not (text or (command and command.kind == "data read")):
        return ConsoleCommand((), _holds(place, values))
    if command is not None:
        bits = 8 * command.bytes or command.choice.bit_length() or 1
    elif isinstance(place, Register):
        return _assign(kind, name, text, axis, values)
    elif place is not None:
        bits, name = place.bits, place.name
    else:
        return None
    try:
        cycles = kind.command_cycles(name, axis, parse_number(text, bits) if text else None)
    except NotImplementedError as error:
        raise ArgumentError(f"{error} Write its bytes: `0: 15`.") from error
    return ConsoleCommand(tuple(BusCycle(False, *cycle) for cycle in cycles))


def _bytes(kind: type[Chip], line: str) -> ConsoleCommand:
    """Return bytes to address 0."""
    words = line.split()
    if not all(re.fullmatch(r"(0[xX])?[0-9a-fA-F]+[hH]?", w) for w in words):
        raise ArgumentError(
            f"{words[0]!r} is no name of {kind.MAP.chip} and no byte.{_near(kind, words[0])} `help` says more."
        )
    return _write_data(kind, 0, words)


def _write_data(kind: type[Chip], address: int, words: list[str]) -> ConsoleCommand:
    return ConsoleCommand(tuple(BusCycle(False, address, _datum(kind, word)) for word in words))


def _hexadecimal(text: str) -> int:
    try:
        return int(text.strip().rstrip("hH").encode("ascii"), 16)
    except ValueError:
        raise ArgumentError(f"{text.strip()!r} is not a hexadecimal number such as 1F, 1Fh or 0x1F.") from None


def _address(kind: type[Chip], text: str) -> int:
    address = _hexadecimal(text)
    if not 0 <= address < kind.ADDRESSES:
        raise ArgumentError(f"address {text.strip()}: {kind.MAP.chip} has the addresses 0 to {kind.ADDRESSES - 1:X}h.")
    return address


def _datum(kind: type[Chip], text: str) -> int:
    datum = _hexadecimal(text)
    if not 0 <= datum <= kind.DATA_MASK:
        raise ArgumentError(f"{text.strip()}: the bus of {kind.MAP.chip} takes 0 to {kind.DATA_MASK:X}h in one cycle.")
    return datum


def _place(kind: type[Chip], name: str) -> Register | Word | None:
    """Return the register, or the word that a host writes, of this name in any case."""
    wanted = name.upper()
    registers = (r for r in kind.MAP.registers if r.name.upper() == wanted)
    return next(registers, None) or next((w for w in kind.MAP.words if w.written and w.name.upper() == wanted), None)


def _near(kind: type[Chip], name: str) -> str:
    known = {n.upper(): n for n in list_names(kind)}
    near = [known[n] for n in find_similar_names(name.upper(), known)]
    return f" Did you mean {' or '.join(near)}?" if near else ""


def _holds(r: Register, values: Mapping[str, int]) -> str:
    if r.name not in values:
        return f"{r.name} ({r.text}) cannot be seen."
    words, unit = describe_value(r, values[r.name]), f" {r.unit}" if r.unit else ""
    return f"{r.name} = {format_value(r, values[r.name])}{unit}{f' ({words})' if words else ''}: {r.title}"


def _help(kind: type[Chip], name: str) -> str:
    if not name:
        return HELP
    place = _place(kind, name)
    command = next((c for c in kind.MAP.commands if c.symbol == name.upper()), None)
    if command is not None and not isinstance(place, Register):
        takes = f"; takes {command.bytes} bytes" if command.bytes and "read" not in command.kind else ""
        return f"{command.symbol} {command.hex}: {command.description}{takes}"
    if place is None:
        raise ArgumentError(f"{kind.MAP.chip} has nothing that is called {name!r}.{_near(kind, name)}")
    head = f"{place.name}: {place.text}"
    if isinstance(place, Register):
        head += f"; {describe_range(place)}{' ' + place.unit if place.unit else ''}"
    return "\n".join([head, *(f"  .{f.name}  b{f.bits}  {f.text}" for f in place.fields)])
