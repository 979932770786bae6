"""Descriptions of bus cycles of the HCTL-1100, for example `R0E = 10h: command position = 4112 counts`, and of its journals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stage.chips import cycle_descriptions
from stage.chips.cycle_descriptions import FieldDescriber, Statement, shorten_line
from stage.chips.hctl1100 import maps
from stage.chips.hctl1100.state import IDLE, STORED_MASKS
from stage.chips.register_map import Register, RegisterMap

SET, NUMBER = maps.FLAG_WRITE.fields
MODES = maps.MODE_WRITE.fields[0].values
_IDLE = [v for v, mode in MODES.items() if mode in ("reset", "Init/Idle")]
"""Values of R05 that lead to Init/Idle."""


class Decoder(cycle_descriptions.Decoder):
    """Decoder of journals of the HCTL-1100. Each write concerns one register, so that no write waits for later ones."""

    def __init__(self, map_: RegisterMap):
        self._registers = {register.number: register for register in map_.registers}

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        register = self._registers.get(address)
        kind = "command" if address in (maps.FLAG, maps.MODE) else "register"
        known = (register.name, register.value(value)) if register and kind == "register" else ("", 0)
        return [Statement(clock, kind, f"{address:02X} {value:02X}", self._describe_meaning(address, value), *known)]

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        return f"{address:02X} {value:02X}", self._describe_meaning(address, value)

    def _describe_meaning(self, address: int, value: int) -> str:
        """Describe the meaning of a write to a register."""
        if address == maps.FLAG:
            return f"{SET.describe_value(SET.extract(value))} F{NUMBER.extract(value)}"
        if address == maps.MODE:
            return MODES.get(value, "no mode")
        register = self._registers.get(address)
        return (
            f"{register.name} <- {register.value(value)} ({register.description})"
            if register
            else f"no register at {address:02X}h"
        )


class CycleDescriber:
    """Describer of the bus cycles of an HCTL-1100.

    Args:
        map_: Register map of the chip.
        record: State of the chip.
    """

    def __init__(self, map_: RegisterMap, record: Any):
        self._chip = map_.chip
        self._registers = {register.number: register for register in map_.registers}
        self._bytes = {a: int(record["reg"][a]) for a in range(maps.ADDRESS_COUNT)}
        for a, q in maps.QUANTITIES.items():
            if q.waits and a != q.low:
                place = ("high", "middle")[q.addresses.index(a)]
                self._bytes[a] = int(record[f"{'preset' if q is maps.PRESET_POSITION else 'command'}_{place}"])
            elif q.latched:
                self._bytes[a] = int(record["position_latch"]) >> q.get_shift(a) & 0xFF
        self._unread: set[int] = set()  # of the latched bytes
        self._idle = int(record["mode"]) == IDLE
        flags, status = self._registers[maps.FLAG], self._registers[maps.STATUS]
        self._flags, self._status = FieldDescriber(flags), FieldDescriber(status)
        self._set = FieldDescriber(
            replace(status, fields=tuple(f for f in status.fields if f.access == "RW")), silent=False
        )
        self._known = {maps.FLAG: map_.mask(flags.name, "f1"), maps.STATUS: map_.mask(status.name, "init")}

    def write(self, address: int, value: int) -> str:
        """Describe a write cycle to register `address`, 0 to 63."""
        address, value = address % maps.ADDRESS_COUNT, value & 0xFF
        register = self._registers.get(address)
        if register is None:
            return f"no register of the {self._chip} at {address:02X}h: nothing changes"
        if register.access == "R":
            return shorten_line(f"{register.name} can only be read: nothing changes ({_find_title(register)})")
        if address == maps.FLAG:
            return self._describe_flag(register, value)
        if address == maps.MODE:
            self._idle = value in _IDLE or (self._idle and value not in MODES)
            return f"{register.title}: {MODES.get(value) or f'{value:02X}h is no mode of the {self._chip}'}"
        if address == maps.STATUS:
            return self._set.describe("status", value, "; clears LIMIT and STOP if released")
        if address == maps.CLEAR_POSITION_ADDRESS:
            return f"{register.name}, any value: clears the {maps.QUANTITIES[address].title}"
        return self._describe_number(register, value)

    def _describe_flag(self, register: Register, value: int) -> str:
        """Describe a write to R00, which sets or clears a flag."""
        number = NUMBER.extract(value)
        verb = SET.describe_value(SET.extract(value))
        f = next((f for f in register.fields if f.low == number), None)
        if f is None:
            return f"{verb} F{number}: no flag of the {self._chip}"
        if f.mask == self._known[maps.FLAG]:
            return f"{verb} F{number}: nothing changes, it can only be read ({f.meaning})"
        return shorten_line(f"{verb} F{number}: {f.meaning}")

    def _describe_number(self, register: Register, value: int) -> str:
        """Describe a write to a register that is a number or one byte of it."""
        q = maps.QUANTITIES.get(register.number)
        if q is None:
            return self._describe_register(
                register, value, value if register.signed else value & STORED_MASKS[register.number]
            )
        preset = q is maps.PRESET_POSITION
        if self._idle or not preset:
            self._bytes[register.number] = value & STORED_MASKS[register.number] if not q.waits else value
        if q.waits and (register.number != q.low or (preset and not self._idle)):
            return shorten_line(f"{register.name} = {value:02X}h: {register.description}")
        return shorten_line(f"{register.name} = {value:02X}h: {q.describe(self._bytes)}")

    def read(self, address: int, value: int) -> str:
        """Describe a read cycle of register `address`, 0 to 63."""
        address, value = address % maps.ADDRESS_COUNT, value & 0xFF
        register = self._registers.get(address)
        if register is None:
            return f"no register of the {self._chip} at {address:02X}h: reads {value:02X}h"
        if register.access == "W":
            return shorten_line(f"{register.name} can only be written: reads {value:02X}h ({_find_title(register)})")
        if address in self._known:
            self._idle = bool(value & self._known[address])
            return (
                self._flags.describe("flags", value) if address == maps.FLAG else self._status.describe("status", value)
            )
        q = maps.QUANTITIES.get(address)
        if q is None:
            return self._describe_register(register, value, value)
        if not q.latched:
            return shorten_line(f"{register.name} = {value:02X}h: {register.description}")
        return self._describe_latched_read(register, q, value)

    def _describe_latched_read(self, register: Register, quantity: maps.RegisterQuantity, value: int) -> str:
        """Describe a read of a latched byte: with the last byte the whole number, if the low byte was read before."""
        if register.number == quantity.low:
            self._unread = set(quantity.addresses)
        fresh = register.number in self._unread
        self._unread.discard(register.number)
        self._bytes[register.number] = value
        if not self._unread and (fresh or register.number == quantity.addresses[0]):
            return shorten_line(f"{register.name} = {value:02X}h: {quantity.describe(self._bytes)}")
        return shorten_line(f"{register.name} = {value:02X}h: {register.description}")

    def _describe_register(self, register: Register, value: int, stored: int) -> str:
        """Describe a register that holds a number of one byte."""
        number = f"{register.value(stored)} {register.unit}".strip()
        return shorten_line(f"{register.name} = {value:02X}h ({number}): {register.description}")


def _find_title(register: Register) -> str:
    """Return the title of a register, or of the number of which the register holds one byte."""
    q = maps.QUANTITIES.get(register.number)
    return q.title if q else register.title
