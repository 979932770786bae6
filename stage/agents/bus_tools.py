"""Tools at the bus: a description of the stage, registers, bytes, commands, status in words, the bus trace and diagnostics."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stage.agents.motion_tools import MotionTools
from stage.agents.tool import Tool
from stage.agents.tool_arguments import Text, argument, choice, choose, integer, list_of
from stage.agents.tool_context import ToolContext
from stage.chips.chip import Chip
from stage.chips.cycle_descriptions import FieldDescriber
from stage.chips.register_map import EVIDENCE, Register, RegisterMap, Word, dump
from stage.errors import ArgumentError

MAX_DIAGNOSTICS = 40  # in an answer
MODES = {
    "host": "what a host on the bus can see: what it reads there, what it wrote, its clock",
    "truth": "everything: the tool truth shows the positions of the carriages and lost steps",
}
"""What an agent of each mode sees."""


class BusTools:
    """Tools that work on the bus of the chips.

    Args:
        context: The stage and what its tools share.
        motion: The motion tools, which must learn when a write starts or stops a move.
    """

    def __init__(self, context: ToolContext, motion: MotionTools):
        self._context, self._motion = context, motion

    def list_tools(self) -> list[Tool]:
        """List the tools. The registers and commands of the stage's chips are the choices of their arguments."""
        chips = tuple(dict.fromkeys(type(a.chip) for a in self._context.stage.axes.values()))
        readable = _remove_duplicates(r.name for c in chips for r in c.MAP.registers)
        writable = _remove_duplicates(r.name for c in chips for r in c.MAP.registers if "W" in r.access)
        commands = _remove_duplicates(name for c in chips for name in list_commands(c))
        address = integer(0, max(c.ADDRESSES for c in chips) - 1)
        datum = integer(0, max(c.DATA_MASK for c in chips))
        axis = {"axis": self._context.axis_argument}
        name = argument(Text, "Register, word or command.", None)
        data = argument(integer(), "Its data or bits, if it takes any.", None)
        value = argument(integer(), 'Value: a number, or a text such as 31, "1Fh", "0x1F".')
        values = argument(list_of(datum), "Values, in the order of the cycles.")
        return [
            Tool.from_method(self.describe, free=True),
            Tool.from_method(self.registers, {**axis, "name": name}, free=True),
            Tool.from_method(self.read_register, {**axis, "name": argument(choice(readable), "Register to read.")}),
            Tool.from_method(
                self.write_register, {**axis, "name": argument(choice(writable), "Register to write."), "value": value}
            ),
            Tool.from_method(
                self.command,
                {**axis, "name": argument(choice(commands) if commands else Text, "Command or word."), "data": data},
            ),
            Tool.from_method(
                self.write_bytes, {**axis, "address": argument(address, "Address on the bus."), "values": values}
            ),
            Tool.from_method(
                self.read_bytes,
                {**axis, "addresses": argument(list_of(address), "Addresses, in the order of the cycles.")},
            ),
            Tool.from_method(self.status, axis),
            Tool.from_method(
                self.trace, {**axis, "lines": argument(integer(1, 500), "Number of cycles.", 20)}, free=True
            ),
            Tool.from_method(self.diagnostics, free=True),
            Tool.from_method(self.budget, free=True),
        ]

    def describe(self) -> dict[str, Any]:
        """Describe the stage: axes, chips, units, registers by name, and the budget left."""
        context = self._context
        return {
            "axes": {name: self._describe_axis(name) for name in context.axes},
            "bus_cycle_s": context.stage.bus_cycle,
            "time_s": context.time_s,
            "mode": context.mode,
            "sees": MODES[context.mode],
            "left": context.meter.list_remaining(),
        }

    def _describe_axis(self, name: str) -> dict[str, Any]:
        axis = self._context.get_axis(name)
        map_ = axis.chip.MAP
        return {
            "chip": map_.chip,
            "about": map_.title,
            "axis_of_chip": axis.chip_axis,
            "clock_hz": axis.chip.clock_hz,
            "unit": axis.unit,
            "per_pulse": axis.meters_per_pulse,
            "travel": [round(float(end), 9) for end in axis.travel],
            "homes_by": list(self._context.get_driver(name).list_homing_methods()),
            "registers": [r.name for r in map_.registers],
            "same_chip_as": [a.name for a in self._context.stage.axes.values() if a.chip is axis.chip and a.name != name],
        }  # fmt: skip

    def registers(self, axis: str, name: str | None = None) -> str:
        """Show the register map of an axis' chip; with a name, all bits of that register, word or command."""
        map_ = self._context.get_axis(axis).chip.MAP
        return describe_map(map_) if name is None else describe_entry(map_, name)

    def read_register(self, axis: str, name: str) -> dict[str, Any]:
        """Read a register over the bus. Some registers can only be written."""
        r = self._find_register(axis, name)
        value = self._context.get_driver(axis).read_register(r.name)
        answer = {"axis": axis, "register": r.name, "value": value, "hex": f"{value & r.mask:X}h", "title": r.title}
        return answer | ({"says": FieldDescriber(r).describe(r.name, value & r.mask)} if r.fields else {})

    def write_register(self, axis: str, name: str, value: int) -> dict[str, Any]:
        """Write a whole register by bus cycles. A value that the data sheet does not allow is refused."""
        a, r = self._context.get_axis(axis), self._find_register(axis, name)
        map_ = a.chip.MAP
        if "W" not in r.access:
            raise ArgumentError(f"{map_.chip} {r.name} ({r.title}) can only be read.")
        cycles = a.chip.register_cycles(r.name, map_.check_value(r.name, value), a.chip_axis)
        for cycle in cycles:
            a.chip.write(*cycle)
        return {"axis": axis, "register": r.name, "value": value, "title": r.title, "cycles": len(cycles)}

    def _find_register(self, axis: str, name: str) -> Register:
        """Return the register of an axis' chip with this name. Raises ArgumentError for an unknown name."""
        map_ = self._context.get_axis(axis).chip.MAP
        return map_.register(choose(f"register of axis {axis}", name, tuple(r.name for r in map_.registers)))

    def command(self, axis: str, name: str, data: int | None = None) -> dict[str, Any]:
        """Send a command, or a word that a host writes, with its data."""
        a = self._context.get_axis(axis)
        symbol = choose(f"command of axis {axis}", name, tuple(list_commands(type(a.chip))))
        try:
            cycles = a.chip.command_cycles(symbol, a.chip_axis, data)
        except NotImplementedError as error:
            raise ArgumentError(f"{error} Send its bytes by write_bytes.") from None
        return self._make_write_cycles(axis, cycles)

    def write_bytes(self, axis: str, address: int, values: list[int]) -> dict[str, Any]:
        """Make bus write cycles at an address of the axis' chip, one for each value, without a check."""
        chip = self._context.get_axis(axis).chip
        _check_addresses(chip, [address])
        if any(v > chip.DATA_MASK for v in values):
            raise ArgumentError(f"values={values!r}: the bus of {chip.MAP.chip} has data of 0 to {chip.DATA_MASK:X}h.")
        return self._make_write_cycles(axis, [(address, v) for v in values])

    def _make_write_cycles(self, axis: str, cycles: list[tuple[int, int]]) -> dict[str, Any]:
        """Write values to addresses of an axis' chip, given as (address, value), and return the result of the tool."""
        chip, written = self._context.get_axis(axis).chip, []
        listener = chip.make_describer()
        for address, value in cycles:
            self._motion.watch_write(chip, address, value)
            chip.write(address, value)
            written.append(f"{address:X}: {value:02X}h  {listener.write(address, value)}")
        return {"axis": axis, "written": written}

    def read_bytes(self, axis: str, addresses: list[int]) -> dict[str, Any]:
        """Make bus read cycles, one for each address."""
        chip, trace = self._context.get_axis(axis).chip, self._context.get_trace(axis)
        _check_addresses(chip, addresses)
        listener = chip.make_describer()
        values = [trace.read(address) for address in addresses]
        read = [f"{a:X}: {v:02X}h  {listener.read(a, v)}" for a, v in zip(addresses, values, strict=True)]
        return {"axis": axis, "values": values, "read": read}

    def status(self, axis: str) -> dict[str, Any]:
        """Read the status of an axis, bit by bit, with the evidence for each meaning."""
        places = {p.name: p for p in self._context.get_axis(axis).chip.MAP.places}
        values = self._context.get_driver(axis).read_status_words()
        words = {name: _describe_word(places[name], value) for name, value in values.items()}
        tags = {bit["evidence"] for word in words.values() for bit in word["bits"]}
        return {
            "axis": axis, "time_s": self._context.time_s, "words": words,
            "evidence": {tag: text for tag, text in EVIDENCE.items() if tag in tags},
        }  # fmt: skip

    def trace(self, axis: str, lines: int) -> str:
        """Show the last bus cycles of an axis' chip in words."""
        trace = self._context.get_trace(axis)
        trace.add_new_entries()
        cycles = [line for line in trace.lines if line.kind != "!"][-lines:]
        return "\n".join(line.format(trace.digits) for line in cycles) or "No bus cycle has been made yet."

    def diagnostics(self) -> dict[str, Any]:
        """List the writes that a reader of the data sheet would call mistakes."""
        stage = self._context.stage
        found = [
            {
                "time_s": round(d.clock / chip.clock_hz, 9),
                "axes": [a.name for a in stage.axes.values() if a.chip is chip],
                "address": d.address, "value": f"{d.value:02X}h", "mistake": d.message, "data_sheet": d.source,
            }
            for chip, diagnostics in zip(stage.chips, self._context.diagnostics, strict=True)
            for d in diagnostics.list_all()
        ]  # fmt: skip
        return {"diagnostics": found[-MAX_DIAGNOSTICS:], "all": len(found)}

    def budget(self) -> dict[str, Any]:
        """Show what has been used, and what is left."""
        return {"used": self._context.meter.list_used(), "left": self._context.meter.list_remaining()}


def list_commands(kind: type[Chip]) -> list[str]:
    """Return the names of the words that a host writes to a chip, and of its commands."""
    return [w.name for w in kind.MAP.words if w.is_written] + [c.symbol for c in kind.MAP.commands]


def describe_map(map_: RegisterMap) -> str:
    """Describe a register map as a table, with the values that a host usually writes into its words."""
    sent = [f"{w.name} {code:02X}h  {text}" for w in map_.words if w.is_written for code, text in w.sends.items()]
    return "\n".join([dump(map_), *(["", "usual data of words:", *sent] if sent else [])])


def describe_entry(map_: RegisterMap, name: str) -> str:
    """Describe a register, word or command with all that the register map says of it.

    Raises:
        ArgumentError: The map has no such name; the message lists similar ones.
    """
    places: dict[str, Register | Word] = {p.name: p for p in map_.places}
    commands = {c.symbol: c for c in map_.commands}
    name = choose(f"{map_.chip} register, word or command", name, tuple(dict.fromkeys((*places, *commands))))
    lines = []
    if (p := places.get(name)) is not None:
        lines.append(f"{p.name}: {p.description}")
        if isinstance(p, Register):
            low, high = p.range
            unit, reset = f" {p.unit}" if p.unit else "", f"; {p.reset} after reset" if p.reset is not None else ""
            lines[0] += f"; {p.bits} bits, {p.access}, {low} to {high}{unit}{reset} [{p.evidence}]"
        lines += [f"  b{f.bits}  {f.name}  {f.access}  {f.description} [{f.evidence}]" for f in p.fields]
        if isinstance(p, Word):
            lines += [f"  {code:02X}h  {text}" for code, text in p.sends.items()]
    if (c := commands.get(name)) is not None:
        data, starts = f"; {c.bytes} bytes of data" if c.bytes else "", "; starts a drive" if c.starts else ""
        lines.append(f"{c.symbol} {c.hex}: {c.kind}, {c.description}{data}{starts} [{c.evidence}]")
    return "\n".join(lines)


def _describe_word(place: Register | Word, value: int) -> dict[str, Any]:
    """Describe the value of a register or status word: its number, its fields in a sentence, and fields not at the usual value."""
    bits = [
        {
            "bit": f.name,
            "value": f.extract(value),
            "means": f.describe_value(f.extract(value)) or f.description,
            "evidence": f.evidence,
        }
        for f in place.fields
        if f.silent is None or f.extract(value) != f.silent
    ]
    return {
        "value": f"{value:0{(place.bits + 3) // 4}X}h",
        "says": FieldDescriber(place).describe(place.name, value),
        "bits": bits,
    }


def _check_addresses(chip: Chip, addresses: Iterable[int]) -> None:
    """Raise ArgumentError for an address that the chip does not have; other chips of the stage may have it."""
    for address in addresses:
        if address >= chip.ADDRESSES:
            last = f"{chip.ADDRESSES - 1:X}h"
            raise ArgumentError(f"Address {address}: the bus of {chip.MAP.chip} has addresses 0 to {last}.")


def _remove_duplicates(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
