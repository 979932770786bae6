"""Descriptions of the bus cycles of a TMC2209 axis in words: `IHOLD_IRUN <- 11F10h: ...`, `UART <- 05h`."""

from __future__ import annotations

from pulsestage_trinamic.tmc2209 import maps
from stage.chips.cycle_descriptions import FieldDescriber, Statement, shorten_line
from stage.chips.stepdir import cycle_descriptions as step_timer

_FIELDS = {r.number: FieldDescriber(r) for r in maps.DRIVER_REGISTERS if r.fields}


def describe_register(number: int, value: int, is_write: bool) -> str:
    """Describe a read or write of a register of the chip with its value.

    Args:
        number: Number of the register.
        value: Value that was read or written.
        is_write: The host writes the register.
    """
    registers = maps.WRITABLE_REGISTERS if is_write else maps.READABLE_REGISTERS
    r = registers.get(number)
    if r is None:
        other = (maps.READABLE_REGISTERS if is_write else maps.WRITABLE_REGISTERS).get(number)
        if other is None:
            return f"no register at {number:02X}h: {'nothing changes' if is_write else 'reads 0'}"
        return f"{other.name} can only be {'read' if is_write else 'written'}"
    arrow = "<-" if is_write else "="
    if r.fields:
        return _FIELDS[number].describe(f"{r.name} {arrow} {value & r.mask:X}h", value & r.mask)
    return shorten_line(f"{r.name} {arrow} {r.value(value)} ({r.title})")


def describe_write(address: int, value: int) -> str:
    """Describe a write cycle."""
    if address >= maps.REGISTER_BASE:
        return describe_register(address - maps.REGISTER_BASE, value & maps.MASK_32_BITS, True)
    if address == maps.UART_BYTE:
        return f"UART <- {value & 0xFF:02X}h"
    if address == maps.UART_BIT_NS:
        return f"UART: {value} ns a bit"
    if address == maps.UART_OTHER:
        return f"UART: {value & 0xFF:02X}h from another chip"
    return step_timer.describe_write(address, value)


class CycleDescriber(step_timer.CycleDescriber):
    """Describer of the bus cycles of a TMC2209 axis."""

    def write(self, address: int, value: int) -> str:
        return describe_write(address, value)

    def read(self, address: int, value: int) -> str:
        if address >= maps.REGISTER_BASE:
            return describe_register(address - maps.REGISTER_BASE, value, False)
        if address == maps.UART_BYTE:
            return "UART: no byte" if value == maps.NO_BYTE else f"UART = {value:02X}h"
        return f"UART: {value} ns a bit" if address == maps.UART_BIT_NS else super().read(address, value)


class Decoder(step_timer.Decoder):
    """Decoder of the writes in a journal of a TMC2209 axis."""

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        r = maps.WRITABLE_REGISTERS.get(address - maps.REGISTER_BASE)
        if r is not None:
            text = describe_register(r.number, value, True)
            return [Statement(clock, "register", f"{address:02X} {value:08X}", text, r.name, r.value(value))]
        if address < maps.UART_BYTE:
            return super().decode_write(clock, address, value)
        return [Statement(clock, "command", f"{address:02X} {value:X}", describe_write(address, value), "", value)]

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        return f"{address:02X} {value:X}", describe_write(address, value)
