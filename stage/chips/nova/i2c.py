"""The serial interface of the MCX514, MCX512 and MCX501: chips on an I2C bus, for a host that has no parallel one.

    bus = I2C({0: chip})                          by the levels of the pins A2 to A0
    bus.write(bus.address(0, 13), 0x00)           WR6, high byte
    bus.write(0x02, 0x01, ...)                    the address byte as it goes over the wire, then bytes
    bus.read(0x01, 2)                             RR0: [low, high]

The address byte is A2 A1 A0 RA3 RA2 RA1 RA0 R/W: RA is the byte, 0 the low one of WR0 or RR0, 1 its high one, up to 15; R/W is 1
for a read (manual, page 155). More bytes go to, or come from, the bytes behind it. The low byte of WR0 executes the command, so its
high byte is written before it, in a transfer of its own. Inferred: behind byte 15 comes byte 0; a chip that is not addressed
acknowledges nothing, and the host ends the transfer.
"""

from __future__ import annotations

from collections.abc import Mapping

from stage.chips.nova import MCX514
from stage.errors import ArgumentError

BYTES, PINS = 16, 8
FREE = 0xFF
"""What is read where no chip answers: nobody pulls the line down."""


class I2C:
    """One bus. hz: its clock, SCL. Raises ArgumentError for a chip without this interface, or what A2 to A0 cannot be."""

    def __init__(self, chips: Mapping[int, MCX514], hz: float = 400_000):
        for pins, chip in chips.items():
            if not isinstance(chip, MCX514):
                raise ArgumentError(f"{chip!r} has no I2C interface: MCX514, MCX512 and MCX501 have one.")
            if not (isinstance(pins, int) and 0 <= pins < PINS):
                raise ArgumentError(f"I2C address {pins!r}: A2 to A0 of a chip are 0 to {PINS - 1}.")
        if not hz > 0:
            raise ArgumentError(f"I2C at {hz!r} Hz: give its clock, more than 0, usually 100000 or 400000.")
        self.chips, self.hz = dict(chips), hz
        self.seconds = 0.0
        """How long the transfers so far took, s. They let no time pass for the chips: that is the host's to do."""

    @staticmethod
    def address(pins: int, byte: int, read: bool = False) -> int:
        """The address byte. pins: A2 to A0. byte: 2 n is the low byte of WRn or RRn, 2 n + 1 its high one."""
        if not (0 <= pins < PINS and 0 <= byte < BYTES):
            raise ArgumentError(f"I2C address of byte {byte} of chip {pins}: bytes are 0 to 15, chips 0 to 7.")
        return pins << 5 | byte << 1 | read

    def write(self, address: int, *data: int) -> int:
        """A write transfer. Returns how many bytes were acknowledged, the address byte among them: 0 where no chip answers."""
        chip, first = self._addressed(address, False)
        for k, value in enumerate(data):
            if not 0 <= value <= 0xFF:
                raise ArgumentError(f"I2C byte {k} is {value}: a byte is 0 to 255.")
        self._took(len(data) if chip else 0)
        if chip is None:
            return 0
        for k, value in enumerate(data):
            chip.write_byte((first + k) % BYTES, value)
        return 1 + len(data)

    def read(self, address: int, count: int) -> bytes:
        """A read transfer of so many bytes; FFh each where no chip answers."""
        chip, first = self._addressed(address, True)
        self._took(count if chip else 0)
        return bytes(chip.read_byte((first + k) % BYTES) if chip else FREE for k in range(count))

    def _addressed(self, address: int, read: bool) -> tuple[MCX514 | None, int]:
        if not 0 <= address <= 0xFF:
            raise ArgumentError(f"I2C address byte {address}: it is 0 to 255.")
        if (address & 1 == 1) != read:
            says, does = ("a read", "write") if address & 1 else ("a write", "read")
            raise ArgumentError(
                f"I2C address byte {address:02X}h says {says}: its bit 0 must be {int(read)} to {does}."
            )
        return self.chips.get(address >> 5), address >> 1 & 15

    def _took(self, count: int) -> None:
        """Start, the address byte and so many others, each with its acknowledge, stop."""
        self.seconds += (2 + 9 * (1 + count)) / self.hz
