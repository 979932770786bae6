"""`UartWire`: the single wire between a serial line and the UARTs of chips, on which everybody hears everybody.

A chip with such a UART has an attribute `uart` with the names of `ChipUart`. What the host sends reaches every chip, and the host
hears it, too (its echo). What a chip sends reaches the host and the other chips. When several chips send at once, a bit on the wire
is 0 if one of them sends a 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from itertools import zip_longest
from operator import and_
from typing import Protocol

from stage.board.bus.serial_core import ANY_BYTE, BITS_PER_BYTE, SECOND
from stage.board.serial_line import SerialEnd


class ChipUart(Protocol):
    """Interface of a chip's UART for the wire to which it is connected."""

    baud: int

    address_rule: str
    """Sentence for users that says what the address of a chip depends on."""

    @property
    def address(self) -> int:
        """Address of the chip on its wire."""
        ...

    @property
    def datagrams(self) -> int:
        """Number of right datagrams for this chip since it was powered up."""
        ...

    def contains_datagram(self, content: bytes) -> bool:
        """Return whether bytes of a host contain a right datagram, for whatever address."""
        ...

    @property
    def pending(self) -> int:
        """Number of bytes of the host that have not arrived."""
        ...

    @property
    def room(self) -> int:
        """Number of bytes that can be written now."""
        ...

    @property
    def is_replying(self) -> bool:
        """True while a reply is on its way."""
        ...

    def write(self, content: bytes) -> None:
        """Send bytes to the chip, after those that are on their way."""

    def receive_reply(self, content: bytes) -> None:
        """Let the chip receive bytes of another chip that have just ended."""

    def read(self) -> bytes:
        """Return the bytes that the chip has sent since the last call."""
        ...

    def find_next_byte_ns(self) -> int | None:
        """Return the time from now to the end of the next byte of either side, ns; None: no byte is on its way."""
        ...


class UartWire(SerialEnd):
    """Other end of a serial line: the UARTs of one chip or several.

    Args:
        uarts: UARTs at the wire.
        read_byte_ns: Function that returns the time of a byte of the host, ns; 0: the rate of the chips stays.
        echoes: Whether the host hears what it sends.

    Attributes:
        collisions: Number of bytes that several chips have sent at once.
        has_understood: Whether each chip has understood a datagram so far.
    """

    pausing_byte = ANY_BYTE
    is_over = False

    def __init__(
        self, uarts: Sequence[ChipUart], read_byte_ns: Callable[[], int] = lambda: 0, echoes: bool = True
    ) -> None:
        self._uarts, self._read_byte_ns, self._echoes = tuple(uarts), read_byte_ns, echoes
        self._byte_ns = 0
        self.collisions = 0
        self.has_understood = [False] * len(self._uarts)

    @property
    def room(self) -> int:
        """Number of bytes that the host can send now."""
        return min(uart.room for uart in self._uarts)

    @property
    def is_busy(self) -> bool:
        """True while a byte is on its way."""
        return any(uart.pending or uart.is_replying for uart in self._uarts)

    def exchange(self, sent: bytes, now: int, room: int) -> bytes:
        """Pass on the bytes that the host and the chips have sent, and return the bytes that the host receives."""
        received = self._pass_replies_on()
        self.has_understood = [
            bool(known or uart.datagrams) for known, uart in zip(self.has_understood, self._uarts, strict=True)
        ]
        if not sent:
            return received
        if (byte_ns := self._read_byte_ns()) and byte_ns != self._byte_ns:
            self._byte_ns = byte_ns
            for uart in self._uarts:
                uart.baud = BITS_PER_BYTE * SECOND // byte_ns
        for uart in self._uarts:
            uart.write(sent[: uart.room])
        return received + sent if self._echoes else received

    def _pass_replies_on(self) -> bytes:
        """Pass the bytes that each chip has sent to all other chips on the wire, and return these bytes."""
        if any(uart.is_replying and self._is_byte_ending(uart) for uart in self._uarts):
            return b""  # a byte of another chip overlaps with those that have ended
        replies = [uart.read() for uart in self._uarts]
        if not any(replies):
            return b""
        columns = [[byte for byte in column if byte is not None] for column in zip_longest(*replies)]
        self.collisions += sum(len(column) > 1 for column in columns)
        received = bytes(reduce(and_, column) for column in columns)
        for uart, reply in zip(self._uarts, replies, strict=True):
            if not reply:
                uart.receive_reply(received)
        return received

    @staticmethod
    def _is_byte_ending(uart: ChipUart) -> bool:
        """Return whether the next byte of a chip has begun, and ends within half of its time."""
        ns = uart.find_next_byte_ns()
        return ns is not None and 0 < ns < BITS_PER_BYTE * SECOND // (2 * uart.baud)

    def choose_next_exchange(self, now: int) -> int | None:
        """Return the time of the stage (ns) at which the next byte of a chip ends, or None while the wire is idle."""
        times = [ns for uart in self._uarts if (ns := uart.find_next_byte_ns()) is not None]
        return now + min(times) if times else None

    def close(self) -> None:
        """Do nothing, because a wire opens nothing."""
