"""The serial interface of the MCX514, MCX512 and MCX501: chips on an I2C bus, for a host without a parallel bus.

    bus = I2C({0: chip})                          by the levels of the pins A2 to A0
    bus.write(bus.address(0, 13), 0x00)           WR6, high byte
    bus.write(0x02, 0x01, ...)                    the address byte as it goes over the wire, then bytes
    bus.read(0x01, 2)                             RR0: [low, high]

The address byte is A2 A1 A0 RA3 RA2 RA1 RA0 R/W. RA is the number of the byte: 0 is the low byte of WR0 or RR0, 1 its high
byte, and so on to 15. R/W is 1 for a read (manual, page 155). Further bytes go to, or come from, the bytes after it. The low
byte of WR0 executes the command, so the host writes the high byte first, in a transfer of its own. Inferred: after byte 15
comes byte 0; a chip that is not addressed acknowledges nothing, and the host ends the transfer.
"""

from __future__ import annotations

from collections.abc import Mapping

from stage.chips.nova import MCX514
from stage.errors import ArgumentError

BYTES, PINS = 16, 8
RELEASED_BUS_BYTE = 0xFF
"""Value of a read if no chip answers: nothing pulls the line down."""


class I2C:
    """I2C bus with chips.

    Args:
        chips: Levels of the pins A2 to A0, as a number 0 to 7 -> chip.
        hz: Clock of the bus, SCL.

    Raises:
        ArgumentError: A chip has no such interface, or a number is not allowed.
    """

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
        """Time of all transfers so far, s. The chips do not see it pass: the host must advance them."""

    @staticmethod
    def make_address_byte(pins: int, byte: int, read: bool = False) -> int:
        """Return the address byte of a transfer.

        Args:
            pins: Levels of A2 to A0.
            byte: 2 n for the low byte of WRn or RRn, 2 n + 1 for the high byte.
            read: Whether it is a read transfer.
        """
        if not (0 <= pins < PINS and 0 <= byte < BYTES):
            raise ArgumentError(f"I2C address of byte {byte} of chip {pins}: bytes are 0 to 15, chips 0 to 7.")
        return pins << 5 | byte << 1 | read

    def write(self, address: int, *data: int) -> int:
        """Make a write transfer.

        Args:
            address: Address byte.
            *data: Bytes.

        Returns:
            The number of bytes acknowledged, including the address byte; 0 if no chip has the address.
        """
        chip, first = self._find_chip(address, False)
        for k, value in enumerate(data):
            if not 0 <= value <= 0xFF:
                raise ArgumentError(f"I2C byte {k} is {value}: a byte is 0 to 255.")
        self._add_transfer_time(len(data) if chip else 0)
        if chip is None:
            return 0
        for k, value in enumerate(data):
            chip.write_byte((first + k) % BYTES, value)
        return 1 + len(data)

    def read(self, address: int, count: int) -> bytes:
        """Make a read transfer.

        Args:
            address: Address byte.
            count: Number of bytes.

        Returns:
            The bytes; FFh each if no chip has the address.
        """
        chip, first = self._find_chip(address, True)
        self._add_transfer_time(count if chip else 0)
        return bytes(chip.read_byte((first + k) % BYTES) if chip else RELEASED_BUS_BYTE for k in range(count))

    def _find_chip(self, address: int, read: bool) -> tuple[MCX514 | None, int]:
        """Return the chip that an address byte names, or None, and the number of the first byte."""
        if not 0 <= address <= 0xFF:
            raise ArgumentError(f"I2C address byte {address}: it is 0 to 255.")
        if (address & 1 == 1) != read:
            says, does = ("a read", "write") if address & 1 else ("a write", "read")
            raise ArgumentError(
                f"I2C address byte {address:02X}h says {says}: its bit 0 must be {int(read)} to {does}."
            )
        return self.chips.get(address >> 5), address >> 1 & 15

    def _add_transfer_time(self, count: int) -> None:
        """Add the time of a transfer: start, address byte and data, each with its acknowledge, and stop."""
        self.seconds += (2 + 9 * (1 + count)) / self.hz
