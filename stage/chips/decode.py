"""Bus writes in words, from the register map: `15h start, ramp to FH1`, `R2 <- 8000`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from stage.chips.journal import LOST, RESET, WRITE, Entry
from stage.chips.register_map import Register, RegisterMap

_SPEEDS = ("FL", "FH1", "FL", "FH2")


class Said(NamedTuple):
    """One command, or one register written with all its bytes. `clock`: of the last byte; `kind`: command, register, reset,
    lost (a byte that did not arrive)."""

    clock: int
    kind: str
    code: str
    meaning: str

    def __str__(self) -> str:
        return f"{self.code}  {self.meaning}"


def command_meaning(map_: RegisterMap, value: int) -> str:
    """What a command byte (address 0) of the PCL-240 family says."""
    group = value >> 6
    if group == 0:
        return _operating(value)
    word = map_.words[group]
    if group == 2:
        return f"select {_selected(map_, value).name}{', collective' if _collective(map_, value) else ''}"
    on = [f.name for f in word.fields if f.name != "group" and f.of(value)]
    none = "manual, plus" if group == 1 else "common pulses"
    return f"{word.name} mode: {', '.join(on) or none}"


def _selected(map_: RegisterMap, value: int) -> Register:
    """The register that a select byte names; bits that the chip does not have do not count."""
    extension = sum(f.mask for f in map_.word("select").fields if f.name == "extension")
    number = value & (extension | 7)
    return next(r for r in map_.registers if r.number == number)


def _collective(map_: RegisterMap, value: int) -> int:
    return sum(f.of(value) for f in map_.word("select").fields if f.name == "collective")


def _operating(value: int) -> str:
    start, stop, ramp = value & 0x10, value & 0x08, value & 0x04
    irq = ", /INT at stop" if value & 0x20 else ""
    if stop and not start:
        return "reset command" + irq
    if stop:
        return ("decelerating stop" if ramp else "stop") + irq
    if start:
        speed = _SPEEDS[value & 3]
        return (f"start, ramp to {speed}" if ramp else f"start, constant {speed}") + irq
    return "no operation" + (irq or ", clear /INT")


def decode(map_: RegisterMap, entries: Iterable[Entry]) -> list[Said]:
    """A journal's writes as commands and whole register values; register selects are folded into the writes."""
    said: list[Said] = []
    select, clock = 0x80, 0
    bytes_: dict[int, int] = {}
    held: dict[int, int] = {}

    def flush() -> None:
        if bytes_:
            r, whole = _selected(map_, select), bytes_
            if _collective(map_, select):  # the upper bytes wait for the lowest, and stay for the next
                held.update(bytes_)
                whole = held
            value = sum(b << 8 * (a - 1) for a, b in whole.items()) & r.mask
            raw = " ".join(f"{b:02X}" for _, b in sorted(bytes_.items(), reverse=True))
            if whole is bytes_ or 1 in bytes_:
                said.append(Said(clock, "register", f"{select:02X} {raw}", f"{r.name} <- {value} ({r.title})"))
            bytes_.clear()

    for e in entries:
        if e.kind == WRITE and e.a:
            if e.a in bytes_:
                flush()
            bytes_[e.a] = e.b
            clock = e.clock
            continue
        if e.kind == WRITE:
            flush()
            if e.b >> 6 == 2:
                select = e.b
            else:
                said.append(Said(e.clock, "command", f"{e.b:02X}", command_meaning(map_, e.b)))
        elif e.kind == RESET:
            flush()
            held.clear()
            select = 0x80
            said.append(Said(e.clock, "reset", "/RESET", "reset pin"))
        elif e.kind == LOST:
            what = f"data to address {e.a}" if e.a else command_meaning(map_, e.b)
            said.append(Said(e.clock, "lost", f"{e.b:02X}", f"LOST: {what}"))
    flush()
    return said
