"""Descriptions of the bus cycles of the TMC5160 in words: `VMAX <- 200000 (drive velocity)`, `SPI: read XACTUAL`."""

from __future__ import annotations

from typing import Any

from pulsestage_trinamic.tmc5160 import maps
from stage.chips import cycle_descriptions
from stage.chips.cycle_descriptions import FieldDescriber, Statement, shorten_line

_FIELDS = {r.number: FieldDescriber(r) for r in maps.MAP.registers if r.fields}
WRITE_TO_CLEAR_REGISTERS = [maps.MAP.register(name).number for name in ("GSTAT", "RAMP_STAT", "ENC_STATUS")]
_STATUS = FieldDescriber(maps.MAP.word("SPI_STATUS"))


def describe_register(address: int, value: int, is_write: bool) -> str:
    """Describe a read or write of a register with its value.

    Args:
        address: Number of the register.
        value: Value that was read or written.
        is_write: The host writes the register.
    """
    r = (maps.WRITABLE_REGISTERS if is_write else maps.READABLE_REGISTERS).get(address)
    arrow = "<-" if is_write else "="
    if r is None:
        other = (maps.READABLE_REGISTERS if is_write else maps.WRITABLE_REGISTERS).get(address)
        if other is None:
            return f"no register at {address:02X}h: {'nothing changes' if is_write else 'reads 0'}"
        return f"{other.name} can only be {'read' if is_write else 'written'}"
    if is_write and address in WRITE_TO_CLEAR_REGISTERS:
        named = ", ".join(f.name for f in r.fields if f.mask & value)
        return shorten_line(f"{r.name} <- {value & r.mask:X}h: clears {named or 'nothing'}")
    if r.fields:
        return _FIELDS[address].describe(f"{r.name} {arrow} {value & r.mask:X}h", value & r.mask)
    return shorten_line(f"{r.name} {arrow} {r.value(value)} ({r.title})")


def describe_datagram(datagram: int) -> str:
    """Describe a datagram of 40 bits that a host sends."""
    address = datagram >> 32 & 0x7F
    if datagram >> 39 & 1:
        return shorten_line(f"SPI: {describe_register(address, datagram & maps.M32, True)}")
    r = maps.READABLE_REGISTERS.get(address)
    return f"SPI: read {r.name if r else f'{address:02X}h, which reads 0'}"


class Decoder(cycle_descriptions.Decoder):
    """Decoder of bus cycles that collects the bytes of an SPI datagram until its end."""

    def __init__(self) -> None:
        self._sent: list[int] | None = None

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        if address == maps.SPI_CS:
            sent, self._sent = self._sent, None if value & 1 else []
            if not value & 1 or not sent:
                return []
            word = int.from_bytes(bytes(sent[-5:]), "big")
            short = "" if len(sent) >= 5 else f"a datagram of {8 * len(sent)} bits: nothing happens"
            return [self._describe_datagram(clock, bytes(sent).hex().upper(), word, short)]
        if address == maps.SPI_BYTE:
            if self._sent is not None:
                self._sent.append(value & 0xFF)
            return []
        if address == maps.SPI_DATAGRAM:
            return [self._describe_datagram(clock, f"{value:010X}", value)]
        return [
            self._describe_datagram(
                clock, f"{address:02X} {value & maps.M32:08X}", 1 << 39 | address << 32 | value & maps.M32, "", ""
            )
        ]

    def _describe_datagram(
        self, clock: int, code: str, datagram: int, description: str = "", prefix: str = "SPI: "
    ) -> Statement:
        text = description or describe_datagram(datagram)
        r = maps.WRITABLE_REGISTERS.get(datagram >> 32 & 0x7F) if datagram >> 39 & 1 and not description else None
        known = (r.name, r.value(datagram)) if r else ("", 0)
        return Statement(
            clock, "register" if r else "command", code, text if prefix else text.removeprefix("SPI: "), *known
        )

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        return f"{address:02X} {value:X}", describe_write(address, value)

    def reset(self) -> None:
        self._sent = None


def describe_write(address: int, value: int) -> str:
    """Describe a write cycle without knowledge of the cycles before it.

    Args:
        address: Address on the bus.
        value: Written value.
    """
    if address < maps.REGISTERS:
        return describe_register(address, value & maps.M32, True)
    if address == maps.SPI_CS:
        return "CSN high: the end of a datagram" if value & 1 else "CSN low: a datagram begins"
    if address == maps.SPI_BYTE:
        return f"SDI {value & 0xFF:02X}h"
    return describe_datagram(value) if address == maps.SPI_DATAGRAM else f"nothing can be written at {address:02X}h"


class CycleDescriber:
    """Describer of single bus cycles, see `stage.chips.cycle_descriptions.CycleDescriber`.

    It follows the bytes of a datagram, beginning with those in the chip's record.
    """

    def __init__(self, record: Any):
        self._bits = int(record["bits"])
        self._low = not int(record["csn"])
        self._word = int(record["shift"])

    def write(self, address: int, value: int) -> str:
        """Describe one write cycle.

        Args:
            address: Address on the bus.
            value: Written value.
        """
        if address == maps.SPI_CS:
            ends = self._low and value & 1
            self._low = not value & 1
            if ends:
                request = describe_datagram(self._word) if self._bits >= 40 else f"{self._bits} bits: nothing happens"
                return shorten_line(f"CSN high: {request}")
            self._bits = 0 if self._low else self._bits
        elif address == maps.SPI_BYTE and self._low:
            self._bits += 8
            self._word = (self._word << 8 | value & 0xFF) & ((1 << 40) - 1)
        return describe_write(address, value)

    def read(self, address: int, value: int) -> str:
        """Describe one read cycle.

        Args:
            address: Address on the bus.
            value: Value that was read.
        """
        if address < maps.REGISTERS:
            return describe_register(address, value, False)
        if address == maps.SPI_CS:
            return f"CSN is {'high' if value else 'low'}"
        if address == maps.SPI_BYTE:
            return f"SDO {value:02X}h"
        if address == maps.SPI_DATAGRAM:
            return _STATUS.describe("SPI_STATUS", value >> 32 & 0xFF, f"; data {value & maps.M32:08X}h")
        if address == maps.SPI_STATE:
            return _STATUS.describe("SPI_STATUS", value & 0xFF)
        return (
            f"a drive is {'' if value else 'not '}in progress"
            if address == maps.MOTION
            else f"nothing at {address:02X}h"
        )
