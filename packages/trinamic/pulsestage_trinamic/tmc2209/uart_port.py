"""`UartPort`: the host's end of the single-wire UART of a chip, in Python, at simulated time.

chip.uart.write(bytes.fromhex("0500060F"))    bytes from now on, at `baud`; no time passes
stage.run(2e-3)
chip.uart.read()                              what the chip has sent

build_write(0, 0x10, 0x11F10)                 datagrams by themselves
"""

from __future__ import annotations

from operator import index
from typing import TYPE_CHECKING

from pulsestage_trinamic.tmc2209 import maps, state, uart
from stage.errors import ArgumentError, StageError

if TYPE_CHECKING:
    from pulsestage_trinamic.tmc2209 import TMC2209

SECOND_NS = 1_000_000_000
BAUD_RANGE = (300, 2_000_000)
MAX_ADDRESS = 3


def compute_crc(content: bytes) -> int:
    """Compute the CRC that ends a UART datagram from the bytes before it."""
    crc = 0
    for byte in content:
        crc = int(uart.add_to_crc(crc, byte))
    return crc


def build_read(address: int, register: int) -> bytes:
    """Build the request for a register of the chip with an address, 0 to 3."""
    content = bytes((uart.SYNC, address & 0xFF, register & 0x7F))
    return content + bytes((compute_crc(content),))


def build_write(address: int, register: int, value: int) -> bytes:
    """Build the datagram that writes a register of the chip with an address, 0 to 3."""
    content = bytes((uart.SYNC, address & 0xFF, register & 0x7F | uart.WRITE_BIT)) + (
        value & maps.MASK_32_BITS
    ).to_bytes(4, "big")
    return content + bytes((compute_crc(content),))


class UartPort:
    """Host's end of the UART line to a TMC2209. The chip takes the rate from the sync nibble, so `baud` can be set at any time.

    Args:
        chip: The chip at the other end.
    """

    address_rule = "The address of a TMC2209 is MS1 + 2 MS2, by the microsteps of its Drive: 0 for 8, 1 for 32, 2 for 64, 3 for 16."

    def __init__(self, chip: TMC2209):
        self._chip = chip

    @property
    def datagrams(self) -> int:
        """Number of right datagrams for this chip since it was powered up."""
        return int(self._chip.state["datagrams"])

    def contains_datagram(self, content: bytes) -> bool:
        """Return whether bytes of a host contain a right datagram, for whatever address."""
        begins = (k for k in range(len(content) - uart.READ_SIZE + 1) if content[k] & 0xF == uart.SYNC)
        for k in begins:
            size = uart.WRITE_SIZE if content[k + 2] & uart.WRITE_BIT else uart.READ_SIZE
            datagram = content[k : k + size]
            if len(datagram) == size and content[k + 1] <= MAX_ADDRESS and compute_crc(datagram[:-1]) == datagram[-1]:
                return True
        return False

    @property
    def baud(self) -> int:
        """Baud rate at which the host sends, bits per second."""
        return round(1e9 / int(self._chip.state["bit_ns"]))

    @baud.setter
    def baud(self, value: int) -> None:
        low, high = BAUD_RANGE
        if isinstance(value, bool) or not low <= value <= high:
            raise ArgumentError(
                f"baud={value!r}: {low} to {high:,} bits per second; the chip understands 9,000 to 750,000."
            )
        self._chip.write(maps.UART_BIT_NS, round(1e9 / value))

    @property
    def address(self) -> int:
        """UART address of the TMC2209, set by the levels of MS1 and MS2."""
        pins = self._chip.pins
        return int(pins.ms1) + 2 * int(pins.ms2)

    @property
    def pending(self) -> int:
        """Number of bytes of the host that have not arrived at the TMC2209."""
        c = self._chip.state
        return int(c["queued"] - c["delivered"])

    @property
    def room(self) -> int:
        """Number of bytes that `write` accepts now."""
        return state.UART_QUEUE_BYTES - self.pending

    @property
    def is_replying(self) -> bool:
        """True while a reply of the TMC2209 is on its way."""
        return int(self._chip.state["replied"]) < state.MAX_DATAGRAM_BYTES

    def write(self, content: bytes) -> None:
        """Send bytes to the TMC2209, after those that are still on their way. Only bus cycles take time.

        Raises:
            ArgumentError: `content` is no bytes.
            StageError: More bytes than the line's queue holds are on their way.
        """
        if not isinstance(content, bytes | bytearray):
            raise ArgumentError(f"write({content!r}): give bytes, such as bytes.fromhex('05000048').")
        if len(content) > self.room:
            raise StageError(
                f"{len(content)} bytes: the line holds {state.UART_QUEUE_BYTES}, and {self.pending} are on their way. "
                f"Let time pass first."
            )
        for byte in content:
            self._chip.write(maps.UART_BYTE, byte)

    def receive_reply(self, content: bytes) -> None:
        """Let the chip receive bytes of another chip on the same wire that have just ended."""
        for byte in content:
            self._chip.write(maps.UART_OTHER, byte)

    def find_next_byte_ns(self) -> int | None:
        """Return the time from now to the end of the next byte of either side, ns; None: no byte is on its way."""
        c = self._chip.state
        clock = min(int(c["arrives"]), int(c["replies"]))
        return None if clock == state.NEVER else max(0, -(-(clock - int(c["clock"])) * SECOND_NS // int(c["hz"])))

    def read(self, size: int | None = None) -> bytes:
        """Return bytes that the chip has sent and that nobody has read, at most `size`. No time passes but that of bus cycles."""
        waiting = int(self._chip.state["sent"] - self._chip.state["collected"])
        count = waiting if size is None else min(waiting, index(size))
        return bytes(int(self._chip.read(maps.UART_BYTE)) for _ in range(count))
