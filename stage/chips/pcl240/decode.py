"""Bus writes in words, from the register map: `15h start, ramp to FH1`, `R2 <- 8000`."""

from __future__ import annotations

from collections.abc import Iterable

from stage.chips.decode import Said
from stage.chips.entries import LOST, RESET, WRITE, Entry
from stage.chips.pcl240.maps import SELECT
from stage.chips.register_map import Register, RegisterMap

_SPEEDS = ("FL", "FH1", "FL", "FH2")


def command_meaning(map_: RegisterMap, value: int) -> str:
    """What a command byte (address 0) of the PCL-240 family says."""
    group = value >> 6
    if group == 0:
        return _operating(value)
    word = map_.words[group]
    if group == 2:
        return f"select {selected(map_, value).name}{', collective' if collective(map_, value) else ''}"
    on = [f.name for f in word.fields if f.name != "group" and f.of(value)]
    none = "manual, plus" if group == 1 else "common pulses"
    return f"{word.name} mode: {', '.join(on) or none}"


def selected(map_: RegisterMap, value: int) -> Register:
    """The register that a select byte names; bits that the chip does not have do not count."""
    extension = sum(f.mask for f in map_.word("select").fields if f.name == "extension")
    number = value & (extension | 7)
    return next(r for r in map_.registers if r.number == number)


def collective(map_: RegisterMap, value: int) -> int:
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


class Decoder:
    """Journal entries as commands and whole register values, in parts; register selects are folded into the writes."""

    def __init__(self, map_: RegisterMap):
        self._map = map_
        self._select, self._clock = SELECT, 0
        self._bytes: dict[int, int] = {}
        self._held: dict[int, int] = {}

    def take(self, entries: Iterable[Entry]) -> list[Said]:
        """What `entries` say, after those before; a register's last bytes may wait for what comes next, see `rest`."""
        said: list[Said] = []
        for e in entries:
            if e.kind == WRITE and e.a:
                if e.a in self._bytes:
                    said += self.rest()
                self._bytes[e.a] = e.b
                self._clock = e.clock
            elif e.kind == WRITE:
                said += self.rest()
                if e.b >> 6 == 2:
                    self._select = e.b
                else:
                    said.append(Said(e.clock, "command", f"{e.b:02X}", command_meaning(self._map, e.b)))
            elif e.kind == RESET:
                said += self.rest()
                self._held.clear()
                self._select = SELECT
                said.append(Said(e.clock, "reset", "/RESET", "reset pin"))
            elif e.kind == LOST:
                what = f"data to address {e.a}" if e.a else command_meaning(self._map, e.b)
                said.append(Said(e.clock, "lost", f"{e.b:02X}", f"LOST: {what}"))
        return said

    def rest(self) -> list[Said]:
        """The register whose bytes are there, if any."""
        if not self._bytes:
            return []
        r, whole, parts = selected(self._map, self._select), self._bytes, self._bytes
        self._bytes = {}
        if collective(self._map, self._select):  # the upper bytes wait for the lowest, and stay for the next
            self._held.update(parts)
            whole = self._held
            if 1 not in parts:
                return []
        value = sum(b << 8 * (a - 1) for a, b in whole.items()) & r.mask
        raw = " ".join(f"{b:02X}" for _, b in sorted(parts.items(), reverse=True))
        return [Said(self._clock, "register", f"{self._select:02X} {raw}", f"{r.name} <- {value} ({r.title})")]
