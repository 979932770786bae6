"""Tools at the bus: what there is, registers, bytes, commands, status in words, the trace, mistakes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stage.agents.fields import BYTES, TEXT, WHOLE, Field, chosen
from stage.agents.tool import Tool
from stage.chips.chip import Chip
from stage.chips.describe import Fields
from stage.chips.register_map import EVIDENCE, Register, RegisterMap, Word
from stage.errors import ArgumentError

if TYPE_CHECKING:
    from stage.agents.toolbox import Toolbox

LINES = 40


def tools(box: Toolbox) -> list[Tool]:
    """Of a toolbox."""
    made = Bus(box)
    chips = tuple(dict.fromkeys(type(a.chip) for a in box.stage.axes.values()))
    written = _names(r.name for c in chips for r in c.MAP.registers if "W" in r.access)
    every = _names(r.name for c in chips for r in c.MAP.registers)
    sent = _names(n for c in chips for n in commands_of(c))
    axis = axis_field(box)
    address = Field("address", WHOLE, "on the chip's bus", True, low=0, high=max(c.ADDRESSES for c in chips) - 1)
    datum = max(c.DATA_MASK for c in chips)
    return [
        Tool("describe", "What there is: axes, chips, units, registers by name, what may be used.", made.describe, free=True),
        Tool(
            "registers", "The register map of an axis' chip in words; with a name, all bits of that register or word.",
            made.registers, (axis, Field("name", TEXT, "of a register, a word or a command")), free=True,
        ),
        Tool(
            "read_register", "What a register holds, read over the bus. Some registers can only be written.", made.read_register,
            (axis, Field("name", TEXT, "of the register", True, choices=every)),
        ),
        Tool(
            "write_register", "Write a whole register by bus cycles. Refused where the data sheet does not allow the value.",
            made.write_register,
            (axis, Field("name", TEXT, "of the register", True, choices=written),
             Field("value", WHOLE, 'a number, or a text: 31, "1Fh", "0x1F"', True)),
        ),
        Tool(
            "command", "Send a command by its name, or a word that a host writes, with its data.", made.command,
            (axis, Field("name", TEXT, "of the command or word", True, choices=sent),
             Field("data", WHOLE, "its data or bits, where it takes some")),
        ),
        Tool(
            "write_bytes", "Bus write cycles at an address of the axis' chip, one for each value. Nothing is checked.",
            made.write_bytes, (axis, address, Field("values", BYTES, "one after the other", True, low=0, high=datum)),
        ),
        Tool(
            "read_bytes", "Bus read cycles, one for each address.", made.read_bytes,
            (axis, Field("addresses", BYTES, "one after the other", True, low=0, high=address.high)),
        ),
        Tool("status", "What the chip says of an axis, bit by bit, with the evidence for each meaning.", made.status, (axis,)),
        Tool(
            "trace", "The last bus cycles of an axis' chip in words.", made.trace,
            (axis, Field("lines", WHOLE, "how many", default=20, low=1, high=500)), free=True,
        ),
        Tool(
            "diagnostics", "The writes so far that a reader of the data sheet would call mistakes.", made.diagnostics, free=True
        ),
        Tool("budget", "What has been used, and what is left.", made.budget, free=True),
    ]  # fmt: skip


def axis_field(box: Toolbox) -> Field:
    """The argument that names an axis; of a stage with one axis it may be left out."""
    alone = len(box.axes) == 1
    return Field("axis", TEXT, "which one", not alone, box.axes[0] if alone else None, choices=box.axes)


def commands_of(kind: type[Chip]) -> list[str]:
    """The words that a host writes, and the commands."""
    return [w.name for w in kind.MAP.words if w.written] + [c.symbol for c in kind.MAP.commands]


class Bus:
    """Acts for the tools."""

    def __init__(self, box: Toolbox):
        self._box = box

    def describe(self) -> dict[str, Any]:
        box = self._box
        stage = box.stage
        return {
            "axes": {name: self._axis(name) for name in box.axes},
            "bus_cycle_s": stage.bus_cycle,
            "time_s": round(stage.time, 9),
            "mode": box.mode,
            "sees": SEES[box.mode],
            "left": box.meter.left(),
        }

    def _axis(self, name: str) -> dict[str, Any]:
        axis = self._box.axis(name)
        low, high = axis.travel
        kind = type(axis.chip)
        return {
            "chip": kind.MAP.chip,
            "about": kind.MAP.title,
            "axis_of_chip": axis.chip_axis,
            "clock_hz": axis.chip.clock_hz,
            "unit": axis.unit,
            "per_pulse": axis.meters_per_pulse,
            "travel": [round(float(low), 9), round(float(high), 9)],
            "homes_by": list(self._box.driver(name).homings()),
            "registers": [r.name for r in kind.MAP.registers],
            "same_chip_as": [a.name for a in self._box.stage.axes.values() if a.chip is axis.chip and a.name != name],
        }

    def registers(self, axis: str, name: str | None = None) -> str:
        kind = type(self._box.axis(axis).chip)
        return overview(kind) if name is None else about(kind, name)

    def read_register(self, axis: str, name: str) -> dict[str, Any]:
        map_ = self._box.axis(axis).chip.MAP
        r = map_.register(chosen(f"register of axis {axis}", name, tuple(x.name for x in map_.registers)))
        value = self._box.driver(axis).read_register(r.name)
        said = {"axis": axis, "register": r.name, "value": value, "hex": f"{value & r.mask:X}h", "title": r.title}
        return {**said, **({"says": Fields(r).tell(r.name, value & r.mask)} if r.fields else {})}

    def write_register(self, axis: str, name: str, value: int) -> dict[str, Any]:
        a = self._box.axis(axis)
        map_ = a.chip.MAP
        r = map_.register(chosen(f"register of axis {axis}", name, tuple(x.name for x in map_.registers)))
        if "W" not in r.access:
            raise ArgumentError(f"{map_.chip} {r.name} ({r.title}) can only be read.")
        cycles = a.chip.register_cycles(r.name, map_.checked(r.name, value), a.chip_axis)
        for cycle in cycles:
            a.chip.write(*cycle)
        return {"axis": axis, "register": r.name, "value": value, "title": r.title, "cycles": len(cycles)}

    def command(self, axis: str, name: str, data: int | None = None) -> dict[str, Any]:
        chip = self._box.axis(axis).chip
        symbol = chosen(f"command of axis {axis}", name, tuple(commands_of(type(chip))))
        try:
            cycles = chip.command_cycles(symbol, self._box.axis(axis).chip_axis, data)
        except NotImplementedError as error:
            raise ArgumentError(f"{error} Send its bytes by write_bytes.") from None
        return self._write(axis, cycles)

    def write_bytes(self, axis: str, address: int, values: list[int]) -> dict[str, Any]:
        chip = self._box.axis(axis).chip
        self._check(chip, [address])
        if any(v > chip.DATA_MASK for v in values):
            raise ArgumentError(f"values={values!r}: the bus of {chip.MAP.chip} has data of 0 to {chip.DATA_MASK:X}h.")
        return self._write(axis, [(address, v) for v in values])

    def _write(self, axis: str, cycles: list[tuple[int, int]]) -> dict[str, Any]:
        chip, said = self._box.axis(axis).chip, []
        listener = chip.listener()
        for address, value in cycles:
            self._box.motion.before_write(chip, address, value)
            chip.write(address, value)
            said.append(f"{address:X}: {value:02X}h  {listener.write(address, value)}")
        return {"axis": axis, "written": said}

    def read_bytes(self, axis: str, addresses: list[int]) -> dict[str, Any]:
        box, said, values = self._box, [], []
        chip = box.axis(axis).chip
        self._check(chip, addresses)
        listener = chip.listener()
        trace = box.traces[box.stage.chips.index(chip)]
        for address in addresses:
            value = trace.read(address)
            values.append(value)
            said.append(f"{address:X}: {value:02X}h  {listener.read(address, value)}")
        return {"axis": axis, "values": values, "read": said}

    def _check(self, chip: Chip, addresses: Iterable[int]) -> None:
        for address in addresses:
            if not 0 <= address < chip.ADDRESSES:
                raise ArgumentError(
                    f"address {address}: {chip.MAP.chip} has addresses 0 to {chip.ADDRESSES - 1:X}h on its bus."
                )

    def status(self, axis: str) -> dict[str, Any]:
        map_ = self._box.axis(axis).chip.MAP
        places = {p.name: p for p in map_.places}
        words: dict[str, dict[str, Any]] = {}
        for name, value in self._box.driver(axis).status_words().items():
            place = places[name]
            words[name] = {
                "value": f"{value:0{(place.bits + 3) // 4}X}h",
                "says": Fields(place).tell(name, value),
                "bits": [
                    {
                        "bit": f.name,
                        "value": f.of(value),
                        "means": f.says(f.of(value)) or f.text,
                        "evidence": f.evidence,
                    }
                    for f in place.fields
                    if f.of(value) != (0 if f.silent is None else f.silent) or f.silent is None
                ],
            }
        used = {b["evidence"] for w in words.values() for b in w["bits"]}
        return {
            "axis": axis, "time_s": round(self._box.stage.time, 9), "words": words,
            "evidence": {k: text for k, text in EVIDENCE.items() if k in used},
        }  # fmt: skip

    def trace(self, axis: str, lines: int) -> str:
        box = self._box
        trace = box.traces[box.stage.chips.index(box.axis(axis).chip)]
        trace.look()
        last = [line for line in trace.lines if line.way != "!"][-lines:]
        return "\n".join(line.text(trace.digits) for line in last) or "nothing has been written yet."

    def diagnostics(self) -> dict[str, Any]:
        box = self._box
        found = [
            {
                "time_s": round(d.clock / chip.clock_hz, 9),
                "axes": [a.name for a in box.stage.axes.values() if a.chip is chip],
                "address": d.address, "value": f"{d.value:02X}h", "mistake": d.message, "data_sheet": d.source,
            }
            for chip, notes in zip(box.stage.chips, box.notes, strict=True)
            for d in notes.all()
        ]  # fmt: skip
        return {"diagnostics": found[-LINES:], "all": len(found)}

    def budget(self) -> dict[str, Any]:
        return {"used": self._box.meter.used(), "left": self._box.meter.left()}


SEES = {
    "host": "what a host on the bus can see: what it reads there, what it wrote, its clock",
    "truth": "everything: the tool truth tells where the carriages are and which steps are lost",
}


def overview(kind: type[Chip]) -> str:
    """The register map in a line each."""
    m: RegisterMap = kind.MAP
    lines = [
        f"{m.chip}: {m.title}",
        f"source: {m.source}",
        "",
        "registers: name, access, what it takes, meaning [evidence]",
    ]
    for r in m.registers:
        low, high = r.range
        lines.append(f"{r.name}  {r.access}  {low}..{high}{' ' + r.unit if r.unit else ''}  {r.text} [{r.evidence}]")
    written = [w for w in m.words if w.written]
    if written:
        lines += ["", "words that a host writes, by the tool `command`:", *(f"{w.name}  {w.text}" for w in written)]
        lines += [f"  {w.name} {code:02X}h  {text}" for w in written for code, text in w.sends.items()]
    read = [w for w in m.words if not w.written]
    if read:
        lines += ["", "words that a host reads:", *(f"{w.name}  {w.text}" for w in read)]
    if m.commands:
        lines += ["", "commands:", *(f"{c.symbol}  {c.hex}  {c.kind}  {c.what} [{c.evidence}]" for c in m.commands)]
    used = {r.evidence for r in m.registers}
    return "\n".join([*lines, "", "evidence: " + ", ".join(f"{k} {t}" for k, t in EVIDENCE.items() if k in used)])


def about(kind: type[Chip], name: str) -> str:
    """A register, word or command with all that the map says. Raises ArgumentError with near misses."""
    m: RegisterMap = kind.MAP
    places: dict[str, Register | Word] = {p.name: p for p in m.places}
    symbols = {c.symbol: c for c in m.commands}
    found = chosen(f"{m.chip} register, word or command", name, tuple(dict.fromkeys((*places, *symbols))))
    lines = []
    if found in places:
        p = places[found]
        head = f"{p.name}: {p.text}"
        if isinstance(p, Register):
            low, high = p.range
            reset = f"; {p.reset} after reset" if p.reset is not None else ""
            head += (
                f"; {p.bits} bits, {p.access}, {low} to {high}{' ' + p.unit if p.unit else ''}{reset} [{p.evidence}]"
            )
        lines += [head, *(f"  b{f.bits}  {f.name}  {f.access}  {f.text} [{f.evidence}]" for f in p.fields)]
        if isinstance(p, Word):
            lines += [f"  {code:02X}h  {text}" for code, text in p.sends.items()]
    if found in symbols:
        c = symbols[found]
        takes = f"; {c.bytes} bytes of data" if c.bytes else ""
        lines.append(
            f"{c.symbol} {c.hex}: {c.kind}, {c.what}{takes}{'; starts a drive' if c.starts else ''} [{c.evidence}]"
        )
    return "\n".join(lines)


def _names(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
