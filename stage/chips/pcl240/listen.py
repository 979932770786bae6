"""Bus cycles of the PCL-240 family in words: `select R0: down counter`, `R0 bits 7..0 = 00h: R0 = 1200h (4608)`."""

from __future__ import annotations

from typing import Any

from stage.chips.listener import Fields, bits, line, short
from stage.chips.pcl240.decode import collective, command_meaning, selected
from stage.chips.pcl240.maps import OPERATING_MODE
from stage.chips.register_map import Field, Register, RegisterMap

START, STOP = (next(f for f in OPERATING_MODE.fields if f.name == name) for name in ("start", "stop"))


class Listener:
    """See `stage.chips.listener.Listener`. A register is told whole with its lowest byte, or with its highest where the bytes
    come from low to high; a counter whose other bytes may have counted on meanwhile is not.

    record: the chip's state."""

    def __init__(self, map_: RegisterMap, record: Any):
        self._map = map_
        self._held = {r.name: int(record["reg"][k]) for k, r in enumerate(map_.registers)}
        self._register = map_.registers[int(record["selected"])]
        self._collective = bool(record["collective"])
        self._waiting = {3: int(record["high"]), 2: int(record["middle"])}
        self._latched = {a: int(record["latch"]) >> 8 * (a - 1) & 0xFF for a in (2, 3)}
        self._returned = map_.register("R0")
        self._last = 0  # address of the data write just before
        self._aged: dict[str, set[int]] = {r.name: set() for r in map_.registers if "counter" in r.title}
        self._extension, self._external = (_field(map_, name) for name in ("extension", "external"))
        self._output = int(record["output"])
        self._status = Fields(map_.word("status"))
        self._fields = {r.name: Fields(r) for r in map_.registers if r.fields}

    def write(self, address: int, value: int) -> str:
        """One write cycle, address 0 to 3."""
        address, value = address & 3, value & 0xFF
        if address:
            text = self._data(address, value)
            self._last = address
            return text
        self._last = 0
        group = self._map.words[value >> 6].name
        if group == "output":
            self._output = value
        starts = group == "operate" and START.of(value)
        if starts or self._output & self._external:  # the counters count on by themselves
            for old in self._aged.values():
                old.update((1, 2, 3))
        if self._extension and group == "operate" and STOP.of(value) and not starts:
            self._held["R6"] = 0
        meaning = command_meaning(self._map, value)
        if group == "select":
            self._register, self._collective = selected(self._map, value), bool(collective(self._map, value))
            meaning += f": {short(self._register.title)}"
        return line(meaning)

    def _data(self, address: int, value: int) -> str:
        r = self._register
        said = bits(r.name, address - 1, value)
        if 8 * (address - 1) >= r.bits and not self._collective:
            return f"{said}: {r.name} has {r.bits} bits"
        if self._collective and address > 1:
            self._waiting[address] = value
            return f"{said}: waits for bits 7..0"
        return self._whole(r, said) if self._store(r, address, value) else said

    def _store(self, r: Register, address: int, value: int) -> bool:
        """Keep the byte; is it time to tell the whole?"""
        aged = self._aged.get(r.name, set())
        held = self._held[r.name]
        if self._collective:
            word = self._waiting[3] << 16 | self._waiting[2] << 8 | value
            aged.clear()
        else:
            shift = 8 * (address - 1)
            word = held & ~(0xFF << shift) | value << shift
            aged.discard(address)
        self._held[r.name] = held & ~r.writable | word & r.writable
        climbs = address == (r.bits + 7) // 8 and self._last == address - 1
        return (address == 1 or climbs) and not aged and r.writable == r.mask

    def _whole(self, r: Register, said: str) -> str:
        value = self._held[r.name]
        said = f"{said}: {r.name} = {value:X}h ({r.value(value)})"
        return self._fields[r.name].tell(said, value) if r.fields else said

    def read(self, address: int, value: int) -> str:
        """One read cycle, address 0 to 3."""
        address, value = address & 3, value & 0xFF
        if not address:
            return self._status.tell("status", value)
        r = self._register if self._output & self._extension else self._returned
        said = bits(r.name, address - 1, value)
        if not self._collective:
            return said
        if address > 1:
            if address == 3:
                self._latched.clear()
            self._latched[address] = value
            return f"{said}, latched" if address == 3 else said
        if len(self._latched) < 2:
            return said
        word = self._latched[3] << 16 | self._latched[2] << 8 | value
        return f"{said}: {r.name} = {word:X}h ({r.value(word)}), as latched"


def _field(map_: RegisterMap, name: str) -> int:
    """The mask of a field of the output mode; 0 where the chip has no such field."""
    found: list[Field] = [f for f in map_.word("output").fields if f.name == name]
    return sum(f.mask for f in found)
