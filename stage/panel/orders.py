"""The language of the bus console: a line becomes bus cycles. No page, and no chip by name.

understand(PCL240K, "R1 <- 100")          the cycles that write it, as a driver makes them
understand(PCL240K, "44 15")              two bytes to address 0
understand(MCX514, "DRVRL", axis=2)       a command, with the axis in it
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from stage.chips.chip import Chip
from stage.chips.register_map import Register, Word
from stage.errors import ArgumentError, near_names
from stage.panel.front import meant, number, shown, span, with_field

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


class Cycle(NamedTuple):
    """A bus cycle to be made. read: else a write."""

    read: bool
    address: int
    datum: int = 0


class Order(NamedTuple):
    """What a line asks for: cycles, and an answer that needs none."""

    cycles: tuple[Cycle, ...]
    answer: str = ""


def names(kind: type[Chip]) -> list[str]:
    """Every name that a line may begin with."""
    map_ = kind.MAP
    words = (w.name for w in map_.words if w.written)
    return list(
        dict.fromkeys((*(r.name for r in map_.registers), *words, *(c.symbol for c in map_.commands), "read", "help"))
    )


def complete(kind: type[Chip], text: str) -> list[str]:
    """The names that begin as the last word of `text` does."""
    last = text.split(" ")[-1].upper()
    return [name for name in names(kind) if name.upper().startswith(last)] if last else []


def understand(kind: type[Chip], text: str, axis: int = 0, values: Mapping[str, int] | None = None) -> Order:
    """What a line of the console asks for. values: what registers hold now, for lines that ask or that change one field. Raises
    ArgumentError, with near misses."""
    line, values = text.strip(), values or {}
    first, _, rest = line.partition(" ")
    if not line:
        raise ArgumentError("nothing to do: `help` lists what can be written here.")
    if first.lower() == "help":
        return Order((), _help(kind, rest.strip()))
    if found := ASSIGN.fullmatch(line):
        return _assign(kind, found.group(1), found.group(2), axis, values)
    if first.lower() == "read":
        if not rest.strip():
            raise ArgumentError(f"read: an address is missing, 0 to {kind.ADDRESSES - 1:X}h.")
        return Order(tuple(Cycle(True, _address(kind, a)) for a in rest.split()))
    if ":" in line:
        address, _, data = line.partition(":")
        if not data.strip():
            raise ArgumentError(f"{line}: the data are missing, as in {address.strip()}: 1F.")
        at = _address(kind, address)
        return Order(tuple(Cycle(False, at, _datum(kind, d)) for d in data.split()))
    return _named(kind, first, rest.strip(), axis, values) or _bytes(kind, line)


def _assign(kind: type[Chip], name: str, given: str, axis: int, values: Mapping[str, int]) -> Order:
    whole, _, part = name.partition(".")
    place = _place(kind, whole)
    if place is None and not part and (cycles := _number_of_several(kind, whole, given, axis)):
        return Order(cycles)
    if place is None:
        raise ArgumentError(f"no register or word of {kind.MAP.chip} is called {whole!r}.{_near(kind, whole)}")
    if isinstance(place, Register) and "W" not in place.access:
        raise ArgumentError(f"{place.name} ({place.title}) can only be read.")
    if part:
        field = kind.MAP.field(place.name, part)
        value = with_field(values.get(place.name, 0), field, number(given, field.high - field.low + 1))
    else:
        value = number(given, place.bits)
    return Order(writes(kind, place, value, axis))


def _number_of_several(kind: type[Chip], name: str, given: str, axis: int) -> tuple[Cycle, ...]:
    """The cycles of a name that the family knows beside its map, such as a number of several registers; () if it does not."""
    try:
        kind.register_cycles(name, 0, axis)
    except (ArgumentError, NotImplementedError):
        return ()
    return tuple(Cycle(False, *cycle) for cycle in kind.register_cycles(name, number(given, 32), axis))


def writes(kind: type[Chip], place: Register | Word, value: int, axis: int) -> tuple[Cycle, ...]:
    """The cycles that put a value into a register, or into a word that a host writes, as a driver makes them."""
    bits = value & (1 << place.bits) - 1
    found = (
        kind.register_cycles(place.name, bits, axis)
        if isinstance(place, Register)
        else kind.command_cycles(place.name, axis, bits)
    )
    return tuple(Cycle(False, *cycle) for cycle in found)


def _named(kind: type[Chip], name: str, given: str, axis: int, values: Mapping[str, int]) -> Order | None:
    """A command, a word or a register by its name; None: it is none."""
    map_ = kind.MAP
    if any(c.symbol == name.upper() for c in map_.commands):
        c = map_.command(name)
        datum = number(given, 8 * c.bytes or c.choice.bit_length() or 1) if given else None
        place = _place(kind, name)
        if datum is None and isinstance(place, Register) and c.kind != "data read":
            return Order((), _holds(place, values))
    else:
        place = _place(kind, name)
        if place is None:
            return None
        if isinstance(place, Register):
            return _assign(kind, name, given, axis, values) if given else Order((), _holds(place, values))
        datum, name = (number(given, place.bits) if given else None), place.name
    try:
        return Order(tuple(Cycle(False, *cycle) for cycle in kind.command_cycles(name, axis, datum)))
    except NotImplementedError as error:
        raise ArgumentError(f"{error} Write its bytes: `0: 15`.") from error


def _bytes(kind: type[Chip], line: str) -> Order:
    """Bytes to address 0."""
    words = line.split()
    if not all(re.fullmatch(r"(0[xX])?[0-9a-fA-F]+[hH]?", w) for w in words):
        raise ArgumentError(
            f"{words[0]!r} is no name of {kind.MAP.chip} and no byte.{_near(kind, words[0])} `help` says more."
        )
    return Order(tuple(Cycle(False, 0, _datum(kind, w)) for w in words))


def _hexadecimal(text: str) -> int:
    try:
        return int(text.strip().rstrip("hH").encode("ascii"), 16)
    except ValueError:
        raise ArgumentError(f"{text.strip()!r} is no hexadecimal number, as 1F, 1Fh or 0x1F are.") from None


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
    """The register, or the word that a host writes, of this name in any case."""
    wanted = name.upper()
    registers = (r for r in kind.MAP.registers if r.name.upper() == wanted)
    return next(registers, None) or next((w for w in kind.MAP.words if w.written and w.name.upper() == wanted), None)


def _near(kind: type[Chip], name: str) -> str:
    known = {n.upper(): n for n in names(kind)}
    near = [known[n] for n in near_names(name.upper(), known)]
    return f" Did you mean {' or '.join(near)}?" if near else ""


def _holds(r: Register, values: Mapping[str, int]) -> str:
    if r.name not in values:
        return f"{r.name} ({r.text}) cannot be seen."
    said = meant(r, values[r.name])
    return f"{r.name} = {shown(r, values[r.name])}{' ' + r.unit if r.unit else ''}{f' ({said})' if said else ''}: {r.title}"


def _help(kind: type[Chip], name: str) -> str:
    if not name:
        return HELP
    map_, place = kind.MAP, _place(kind, name)
    if any(c.symbol == name.upper() for c in map_.commands) and not isinstance(place, Register):
        c = map_.command(name)
        return f"{c.symbol} {c.hex}: {c.what}" + (
            f"; takes {c.bytes} bytes" if c.bytes and "read" not in c.kind else ""
        )
    if place is None:
        raise ArgumentError(f"{map_.chip} has nothing that is called {name!r}.{_near(kind, name)}")
    head = f"{place.name}: {place.text}"
    if isinstance(place, Register):
        head += f"; {span(place)}{' ' + place.unit if place.unit else ''}"
    return "\n".join([head, *(f"  .{f.name}  b{f.bits}  {f.text}" for f in place.fields)])
