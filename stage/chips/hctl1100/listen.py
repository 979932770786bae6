"""Bus cycles of the HCTL-1100 in words: `program counter: control`, `R0E = 10h: command position = 4112 counts`."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

from stage.chips.hctl1100.decode import MODES
from stage.chips.hctl1100.maps import FLAG_WRITE
from stage.chips.hctl1100.state import ADDRESSES, IDLE, STORED
from stage.chips.listener import Fields, line, short
from stage.chips.register_map import Register, RegisterMap

FLAGS, MODE, STATUS, CLEAR, PRESET = 0x00, 0x05, 0x07, 0x13, 0x17
SET, NUMBER = FLAG_WRITE.fields
_PART = re.compile(r"(.*?), (low|middle|high|fraction|whole)\b")
_FRACTION = re.compile(r"fraction (?:/(?P<parts>\d+)|in b(?P<bit>\d)\.\.0)")


@dataclass(frozen=True)
class Quantity:
    """A number of two or three registers; `addresses` from the low byte to the high one. One unit is `scale` of it.

    waits: a write of the low byte takes the others along; latched: a read of it keeps the others."""

    title: str
    addresses: tuple[int, ...]
    unit: str
    scale: int
    signed: bool
    waits: bool
    latched: bool

    def of(self, bytes_: dict[int, int]) -> str:
        """The number that the bytes, by address, make."""
        word = sum(bytes_[a] << 8 * k for k, a in enumerate(self.addresses))
        top = 1 << 8 * len(self.addresses)
        number = word - top if self.signed and word >= top // 2 else word
        return f"{self.title} = {number / self.scale:.10g} {self.unit}"


def _quantities(map_: RegisterMap) -> list[Quantity]:
    """Registers whose titles say that they are parts of one number."""
    parts: dict[str, dict[str, Register]] = {}
    for r in map_.registers:
        if found := _PART.match(r.title):
            parts.setdefault(found[1], {})[found[2]] = r
    return [_quantity(title, by_part) for title, by_part in parts.items()]


def _quantity(title: str, by_part: dict[str, Register]) -> Quantity:
    ordered = [by_part[part] for part in ("fraction", "low", "middle", "high", "whole") if part in by_part]
    low, high = ordered[0], ordered[-1]
    fraction = _FRACTION.search(low.title)
    scale = 1
    if fraction:
        scale = int(fraction["parts"]) if fraction["parts"] else 1 << int(fraction["bit"]) + 1
    return Quantity(
        title, tuple(r.number for r in ordered), low.unit, scale,
        signed=high.legal is None, waits="its write" in low.title, latched="its read" in low.title,
    )  # fmt: skip


class Listener:
    """See `stage.chips.listener.Listener`. record: the chip's state."""

    def __init__(self, map_: RegisterMap, record: Any):
        self._chip = map_.chip
        self._registers = {r.number: r for r in map_.registers}
        self._quantities = {a: q for q in _quantities(map_) for a in q.addresses}
        self._bytes = {a: int(record["reg"][a]) for a in range(ADDRESSES)}
        for a, q in self._quantities.items():
            place = q.addresses.index(a)
            if q.waits and place:
                self._bytes[a] = int(
                    record[("preset_" if PRESET in q.addresses else "") + ("middle", "high")[place - 1]]
                )
            elif q.latched:
                self._bytes[a] = int(record["latch"]) >> 8 * place & 0xFF
        self._unread: set[int] = set()  # of the latched bytes
        self._idle = int(record["mode"]) == IDLE
        flags, status = self._registers[FLAGS], self._registers[STATUS]
        self._flags, self._status = Fields(flags), Fields(status)
        self._set = Fields(replace(status, fields=tuple(f for f in status.fields if f.access == "RW")), both=True)
        self._known = {FLAGS: next(f for f in flags.fields if f.name == "f1").mask,
                       STATUS: next(f for f in status.fields if f.name == "init").mask}  # fmt: skip

    def write(self, address: int, value: int) -> str:
        """One write cycle to register `address`, 0 to 63."""
        address, value = address % ADDRESSES, value & 0xFF
        r = self._registers.get(address)
        if r is None:
            return f"no register of the {self._chip} at {address:02X}h: nothing changes"
        if r.access == "R":
            return line(f"{r.name} can only be read: nothing changes ({short(r.title)})")
        if address == FLAGS:
            return self._flag(r, value)
        if address == MODE:
            self._idle = value <= 1 or (self._idle and value > 3)
            mode = MODES[value] if value < len(MODES) else f"{value:02X}h is no mode of the {self._chip}"
            return f"{short(r.title)}: {mode}"
        if address == STATUS:
            return self._set.tell("status", value, "; clears LIMIT and STOP if released")
        if address == CLEAR:
            return f"{r.name}, any value: clears the {self._quantities[address].title}"
        return self._number(r, value)

    def _flag(self, r: Register, value: int) -> str:
        number = NUMBER.of(value)
        verb = "set" if SET.of(value) else "clear"
        f = next((f for f in r.fields if f.low == number), None)
        if f is None:
            return f"{verb} F{number}: no flag of the {self._chip}"
        if f.mask == self._known[FLAGS]:
            return f"{verb} F{number}: nothing changes, it can only be read ({short(f.meaning)})"
        return line(f"{verb} F{number}: {short(f.meaning)}")

    def _number(self, r: Register, value: int) -> str:
        """A write to a register that is a number, or part of one."""
        q = self._quantities.get(r.number)
        if q is None:
            return self._told(r, value, value if r.signed else value & STORED[r.number])
        preset = PRESET in q.addresses
        if self._idle or not preset:
            self._bytes[r.number] = value & STORED[r.number] if not q.waits else value
        if q.waits and (r.number != q.addresses[0] or (preset and not self._idle)):
            return line(f"{r.name} = {value:02X}h: {r.title}")
        return line(f"{r.name} = {value:02X}h: {q.of(self._bytes)}")

    def read(self, address: int, value: int) -> str:
        """One read cycle of register `address`, 0 to 63."""
        address, value = address % ADDRESSES, value & 0xFF
        r = self._registers.get(address)
        if r is None:
            return f"no register of the {self._chip} at {address:02X}h: reads {value:02X}h"
        if r.access == "W":
            return line(f"{r.name} can only be written: reads {value:02X}h ({short(r.title)})")
        if address in self._known:
            self._idle = bool(value & self._known[address])
            return self._flags.tell("flags", value) if address == FLAGS else self._status.tell("status", value)
        q = self._quantities.get(address)
        if q is None:
            return self._told(r, value, value)
        if not q.latched:
            return line(f"{r.name} = {value:02X}h: {r.title}")
        return self._position(r, q, value)

    def _position(self, r: Register, q: Quantity, value: int) -> str:
        """A read of a latched byte: the whole with the last of them, after a read of the low one."""
        low, _, high = q.addresses
        if r.number == low:
            self._unread = set(q.addresses)
        fresh = r.number in self._unread
        self._unread.discard(r.number)
        self._bytes[r.number] = value
        if not self._unread and (fresh or r.number == high):
            return line(f"{r.name} = {value:02X}h: {q.of(self._bytes)}")
        return line(f"{r.name} = {value:02X}h: {r.title}")

    def _told(self, r: Register, value: int, held: int) -> str:
        number = f"{r.value(held)} {r.unit}".strip()
        return line(f"{r.name} = {value:02X}h ({number}): {r.title}")
