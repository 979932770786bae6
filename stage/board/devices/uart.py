"""16550 UART: a serial line whose other end is a test or a terminal.

Registers of the data sheet (National PC16550D): RBR, THR, IER, IIR, FCR, LCR, MCR, LSR, MSR, SCR, DLL, DLM at +0 to +7; FIFOs of 16
bytes. A character takes the time that divisor and LCR determine. Without a divisor nothing is sent: written bytes are lost, and
bytes of the peer wait. As in a PC, OUT2 of MCR enables the driver of the interrupt line. The peer is always ready (CTS, DSR, DCD),
makes no
parity or framing errors and no breaks, and sends at the UART's own speed.
"""

from __future__ import annotations

import os
import select
from contextlib import suppress
from typing import ClassVar

from stage.board.devices import uart_core
from stage.board.devices.device import CompiledDevice, DeviceDescriber
from stage.errors import ArgumentError, StageError

CLOCK_HZ = 1_843_200
_READ = ("RBR", "IER", "IIR", "LCR", "MCR", "LSR", "MSR", "SCR")
_WRITTEN = ("THR", "IER", "FCR", *_READ[3:])
_LSR = ("data ready", "overrun", "parity", "framing", "break", "THR empty", "all sent", "FIFO error")
_IIR = {1: "none", 6: "line status", 4: "data", 12: "time-out", 2: "THR empty", 0: "modem"}


class UART(CompiledDevice):
    """16550 UART at eight ports.

    Args:
        clock: Frequency of its crystal, Hz.
        name: Name in messages.

    Raises:
        ArgumentError: The frequency is out of range.
    """

    KIND = "uart"
    PORTS = 8
    CORE: ClassVar = uart_core
    OPTIONS = ("clock",)

    def __init__(self, clock: int = CLOCK_HZ, name: str | None = None):
        super().__init__(name=name)
        if not 1 <= clock <= 10**9 or int(clock) != clock:
            raise ArgumentError(f"clock={clock!r}: the crystal of a UART has 1 to 1e9 Hz, for example 1_843_200.")
        self.clock = int(clock)
        self.registers["clock"] = self.clock
        self._master = self._slave = -1
        self._sent_to_terminal = 0

    def feed(self, data: bytes | str) -> None:
        """Let the peer send bytes from now on, after those that it is still sending.

        Args:
            data: Bytes or text.

        Raises:
            ArgumentError: `data` is neither bytes nor text, or more than 4096 bytes would be waiting.
        """
        if not isinstance(data, str | bytes | bytearray | memoryview):
            raise ArgumentError(f"{self.name}: feed({data!r}): bytes or text are wanted, for example b'ok\\r\\n'.")
        content, s = data.encode() if isinstance(data, str) else bytes(data), self.registers
        waiting = uart_core.ROOM - self.free_bytes
        if waiting + len(content) > uart_core.ROOM:
            raise ArgumentError(
                f"{self.name}: {waiting:,} bytes are still to arrive, and {len(content):,} more are too many: "
                f"{uart_core.ROOM:,} at a time. Let time pass in between."
            )
        if not waiting:
            s["due"] = self.stage.now + self._character_ns
        for byte in content:
            s["incoming"][int(s["fed"]) % uart_core.ROOM] = byte
            s["fed"] += 1

    @property
    def sent_count(self) -> int:
        """Number of bytes that have left the transmitter so far."""
        s, c = self.registers, self._character_ns
        return int(s["written"]) - (-(-max(int(s["left"]) - self.stage.now, 0) // c) if c else 0)

    @property
    def sent(self) -> bytes:
        """Bytes that have left the transmitter so far; if there are more than 4096, the last 4096."""
        return self.read_sent(0)

    def read_sent(self, begin: int) -> bytes:
        """Return the bytes that have left the transmitter, from number `begin` on; at most the last 4096."""
        end = self.sent_count
        return self._get_written_bytes(max(begin, end - uart_core.ROOM), end)

    @property
    def free_bytes(self) -> int:
        """Number of bytes that `feed` accepts now."""
        self.CORE.access(self.state[0], self.stage.now, 0, 7, 0, 0)  # what has arrived by now has
        return uart_core.ROOM - int(self.registers["fed"] - self.registers["taken"])

    @property
    def baud(self) -> float:
        """Speed of the line from the divisor, bits per second; 0 without a divisor."""
        divisor = int(self.registers["divisor"])
        return self.clock / 16 / divisor if divisor else 0.0

    def open_pty(self) -> str:
        """Connect the UART to a pseudo-terminal, for `screen PATH`, `cu -l PATH` or another terminal program.

        Bytes arrive in bus cycles of the UART, whenever the other side sends them. Runs are therefore not
        deterministic, and the firmware has to poll.

        Returns:
            Path of the terminal, the same in each call.

        Raises:
            StageError: This system has no pseudo-terminals.
        """
        if self._master >= 0:
            return os.ttyname(self._slave)
        try:
            import pty
            import tty
        except ImportError:
            raise StageError("this system has no pseudo-terminals: feed() and sent are there all the same.") from None
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self._slave, self._sent_to_terminal, self.access = slave, int(self.registers["written"]), 0
        if self.board is not None:
            self.board.link.publish_devices()
        return os.ttyname(slave)

    def access_register(self, register: int, kind: int, value: int) -> int:
        """Execute a bus cycle of the UART while a pseudo-terminal is connected."""
        while select.select([self._master], [], [], 0)[0] and self.registers["fed"] - self.registers["taken"] < 64:
            self.feed(os.read(self._master, 64))
        answer = self.CORE.access(self.state[0], self.stage.now, 0, register, kind, value)
        if (written := int(self.registers["written"])) > self._sent_to_terminal:
            with suppress(BlockingIOError):  # nobody reads there: lost, as on a line
                os.write(self._master, self._get_written_bytes(self._sent_to_terminal, written))
            self._sent_to_terminal = written
        return int(answer)

    def name_port(self, register: int) -> str:
        """Return the name of a register, or both names if reads and writes reach different registers."""
        return _READ[register] if _READ[register] == _WRITTEN[register] else f"{_READ[register]}, {_WRITTEN[register]}"

    def make_describer(self) -> DeviceDescriber:
        """Return a function that explains bus cycles of this UART; bit 7 of LCR selects the divisor registers."""
        lcr = 0

        def describe(n: int, value: int, writes: bool, wide: bool) -> str:
            """Explain one bus cycle."""
            nonlocal lcr
            name = _WRITTEN[n] if writes else _READ[n]
            if n == 3 and writes:
                lcr = value
            elif n < 2 and lcr & 0x80:
                name = ("DLL", "DLM")[n]
            elif n == 0:
                return f"{name} {'<-' if writes else '='} {value:02X}h {chr(value)!r}"
            elif not writes and n == 5:
                return "LSR: " + (", ".join(t for k, t in enumerate(_LSR) if value >> k & 1) or "none")
            elif not writes and n == 2:
                return f"IIR: {_IIR.get(value & 15, 'none')}"
            return f"{name} {'<-' if writes else '='} {value:02X}h"

        return describe

    def _get_written_bytes(self, begin: int, end: int) -> bytes:
        """Return the bytes that the firmware has written, from number `begin` to number `end`."""
        sent = self.registers["sent"]
        return bytes(int(sent[k % uart_core.SENT_BUFFER_SIZE]) for k in range(begin, end))

    @property
    def _character_ns(self) -> int:
        """Time of a character on the UART's line, ns; 0 without a divisor."""
        return int(uart_core.compute_character_ns(self.state[0].view(uart_core.STATE)[0]))
