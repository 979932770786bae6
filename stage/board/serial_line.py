r"""`SerialLine`: the serial line of a host in memory. `SerialPort`: its other end in Python, `host.serial`.

    host.serial.write("$H\n")
    host.serial.read_until("ok", timeout=30)
    host.serial.expect(r"MPos:(-?[0-9.]+)")

Bytes move while the firmware is paused, at a simulated time, so that the same script gives the same bits each time. Ends for
programs outside of the simulation (a pseudo-terminal, a TCP port) are in `stage.board.serial_pty_and_tcp`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, AnyStr, Protocol

import numpy as np

from stage.board.bus import serial_core
from stage.board.bus.serial_core import LINE_BUFFER_SIZE, NO_BYTE
from stage.board.devices.uart import UART
from stage.errors import ArgumentError, RunTimeout, StageError
from stage.native import address_of, remove_attribute_access

if TYPE_CHECKING:
    from stage.board.board import Board
    from stage.board.native_host import Host

BUFFER_SIZE = 1 << 20
"""Bytes of the firmware that a SerialPort keeps for its reader."""
POLL_NS = 1_000_000
"""Simulated time between two polls for bytes that the firmware has sent."""
EXCERPT_SIZE = 200
"""Bytes of the firmware that a message shows."""


class SerialLines:
    """Serial lines of a board's host. The first is that of the first UART, of `Serial` of a sketch, or of functions in C.

    Args:
        board: The board.

    Attributes:
        rows: Array of a LINE record for each line. If the firmware runs in a separate process, both processes share this memory.
        lines: The lines.
    """

    def __init__(self, board: Board):
        self.lines = tuple(SerialLine(board) for _ in range(serial_core.SERIAL_LINE_COUNT))
        rows = np.zeros(serial_core.SERIAL_LINE_COUNT, serial_core.SERIAL_LINE)
        rows["pausing_byte"] = NO_BYTE
        self.use_rows(rows)

    def use_rows(self, rows: np.ndarray) -> None:
        """Use another array of LINE records from now on; see `Link.use_serial_rows`."""
        self.rows = rows
        for line, record in zip(self.lines, rows.view(remove_attribute_access(serial_core.SERIAL_LINE)), strict=True):
            line.record = record

    def list_present(self, count: int) -> list[int]:
        """Return which of the first `count` lines the firmware has; the first may be formed by a device on the bus."""
        return [0, *(k for k, line in enumerate(self.lines[:count]) if k and line.is_wired)]

    @property
    def address(self) -> int:
        """Address of the LINE records."""
        return address_of(self.rows)


class SerialLine:
    """Serial line of a board's host: two circular buffers that compiled code reads and writes.

    Args:
        board: The board.

    Attributes:
        record: Its LINE record.
    """

    does_pause = True
    record: Any

    def __init__(self, board: Board):
        self._board = board

    @property
    def is_wired(self) -> bool:
        """True if the firmware has a serial line."""
        return bool(self.record["is_wired"])

    @property
    def pausing_byte(self) -> int:
        """Byte after which the firmware pauses, or NO_BYTE."""
        return int(self.record["pausing_byte"])

    @pausing_byte.setter
    def pausing_byte(self, value: int) -> None:
        self.record["pausing_byte"] = value

    @property
    def free_bytes(self) -> int:
        """Number of bytes that `feed` accepts now."""
        return LINE_BUFFER_SIZE - self._count_bytes("fed", "removed")

    def get_byte_time_ns(self) -> int:
        """Return the time of a byte at the rate that the firmware has set, ns; 0: it has set none."""
        return int(self.record["byte_ns"] or self.record["sent_byte_ns"])

    def feed(self, content: bytes) -> None:
        """Send bytes to the firmware, at most `free_bytes`."""
        line, now = self.record, self._board.stage.now
        if line["fed"] == line["removed"]:
            line["due"] = max(int(line["due"]), now + int(line["byte_ns"]))
        places = (int(line["fed"]) % LINE_BUFFER_SIZE + np.arange(len(content))) % LINE_BUFFER_SIZE
        line["incoming"][places] = np.frombuffer(content, np.uint8)
        line["fed"] += len(content)

    def take(self) -> bytes:
        """Take all bytes that the firmware has sent since the last call."""
        line = self.record
        count = self._count_bytes("sent", "read")
        places = (int(line["read"]) % LINE_BUFFER_SIZE + np.arange(count)) % LINE_BUFFER_SIZE
        content = line["outgoing"][places].tobytes()
        line["read"] = line["sent"]
        return content

    def _count_bytes(self, total: str, removed: str) -> int:
        """Return the number of bytes waiting in one direction.

        Firmware may have overwritten the record, so the number is limited.
        """
        return min(max(int(self.record[total]) - int(self.record[removed]), 0), LINE_BUFFER_SIZE)


class UartLine:
    """Serial line of a 16550 UART on the bus, with the buffers of that device.

    Args:
        uart: The device.
    """

    pausing_byte = NO_BYTE

    def __init__(self, uart: UART):
        self._uart, self._sent_count = uart, uart.sent_count
        self.is_wired, self.does_pause = True, False

    @property
    def free_bytes(self) -> int:
        """Number of bytes that `feed` accepts now."""
        return self._uart.free_bytes

    def feed(self, content: bytes) -> None:
        """Send bytes to the firmware, at most `free_bytes`."""
        self._uart.feed(content)

    def take(self) -> bytes:
        """Take all bytes that the firmware has sent since the last call."""
        content = self._uart.read_sent(self._sent_count)
        self._sent_count = self._uart.sent_count
        return content


class SerialEnd(Protocol):
    """Other end of a serial line, such as a pseudo-terminal."""

    @property
    def pausing_byte(self) -> int:
        """Byte of the firmware after which `exchange` is called at once, or NO_BYTE."""
        ...

    @property
    def is_over(self) -> bool:
        """True when this end of the serial line has nothing more to do, so that the run of the firmware ends."""
        ...

    def exchange(self, sent: bytes, now: int, room: int) -> bytes:
        """Take bytes that the firmware has sent over the serial line, and return bytes for the firmware.

        Args:
            sent: Bytes of the firmware since the last call.
            now: Time of the stage, ns.
            room: Maximum number of bytes to return.
        """
        ...

    def choose_next_exchange(self, now: int) -> int | None:
        """Return the time of the stage (ns) at which `exchange` is to be called again, or None for any time."""
        ...

    def close(self) -> None:
        """Close what this end of the serial line has opened."""
        ...


class SerialPort:
    """Other end of a serial line of a host's firmware.

    Args:
        host: The host.
        number: Number of the line.

    Attributes:
        received: Number of bytes that the firmware has sent so far.
        written: Number of bytes that have been sent to the firmware so far.
        arrivals: Times (ns since it was connected) at which the connected end has sent something, and the bytes.
        connected_at: Time of the stage at which it was connected, ns.
    """

    def __init__(self, host: Host, number: int = 0):
        self._host, self._number = host, number
        self._end: SerialEnd | None = None
        self._unread, self._outgoing = bytearray(), bytearray()
        self._find: Callable[[], Any] | None = None
        self._pausing_byte = NO_BYTE
        self._uart_line: UartLine | None = None
        self.received = self.written = self.connected_at = 0
        self.arrivals: list[tuple[int, bytes]] = []
        self._get_firmware_line().record["is_open"] = 1

    # --- for a person and for tests ---

    def write(self, content: bytes | str) -> None:
        """Send bytes to the firmware from now on, at the rate of its UART.

        Args:
            content: Bytes, or text, each of whose characters is a byte.

        Raises:
            ArgumentError: `content` is neither bytes nor text of such characters.
            StageError: The firmware has no serial line, or was closed.
        """
        self.check_is_wired()
        self._outgoing += to_bytes(content, "write")
        self.exchange()

    def read(self) -> bytes:
        """Return the bytes that the firmware has sent and that were not read before. No time passes."""
        content = bytes(self._unread)
        self._unread.clear()
        return content

    def read_until(self, end: AnyStr, timeout: float = 1.0) -> AnyStr:
        """Run the firmware until it sends `end`; return what it has sent up to there.

        Args:
            end: Text or bytes.
            timeout: Maximum simulated time, s.

        Returns:
            All that nobody has read so far, up to and including `end`, as text or bytes like `end`.

        Raises:
            RunTimeout: The firmware has not sent `end` within `timeout`, or has returned before. Other errors are those of
                `write` and `Host.run_for`.
        """
        wanted = to_bytes(end, "read_until")
        self._run_until(lambda: wanted in self._unread, timeout, repr(end), wanted[-1] if wanted else NO_BYTE)
        return self._take_received(self._unread.index(wanted) + len(wanted), end)

    def expect(self, pattern: AnyStr | re.Pattern[AnyStr], timeout: float = 1.0) -> re.Match[AnyStr]:
        """Run the firmware until what it sends matches a regular expression; read up to the end of the match.

        Args:
            pattern: Regular expression for text or bytes.
            timeout: Maximum simulated time, s.

        Returns:
            The match.

        Raises:
            ArgumentError: `pattern` is no regular expression.
            RunTimeout: Nothing has matched within `timeout`, or the firmware has returned before.
        """
        try:
            compiled: re.Pattern[AnyStr] = re.compile(pattern)
        except (re.error, TypeError) as error:
            raise ArgumentError(f"expect({pattern!r}): no regular expression ({error}).") from None
        kind = compiled.pattern

        def search() -> re.Match[AnyStr] | None:
            """Return the match of the regular expression in the bytes received so far, or None."""
            return compiled.search(from_bytes(bytes(self._unread), kind))

        self._run_until(search, timeout, repr(kind))
        match = search()
        assert match is not None
        self._take_received(match.end(), kind)
        return match

    # --- for the host and its commands ---

    def connect(self, end: SerialEnd) -> None:
        """Connect another end, such as a pseudo-terminal, to the serial line, instead of Python.

        Raises:
            StageError: The firmware has no serial line, or the line has another end.
        """
        self.check_is_wired()
        if self._end is not None:
            raise StageError(
                "this serial line has another end already, such as a chip of --pins x.uart=Serial: a line has two ends."
            )
        self._end, self.connected_at = end, self._host.board.stage.now
        self._unread.clear()

    def check_is_wired(self) -> None:
        """Raise StageError if the firmware has no serial line, or was closed."""
        name = self._host.path.name
        if self._host.is_closed:
            raise StageError(
                f"{name} was closed, so nothing is at its serial line. Run it again first, or make a new host."
            )
        if not self._line.is_wired:
            raise StageError(f"{name}: {self._host.serial_lack}")

    @property
    def is_satisfied(self) -> bool:
        """True when the other end of the serial line has what it waited for, so that the run of the firmware ends."""
        return (self._find is not None and bool(self._find())) or (self._end is not None and self._end.is_over)

    def exchange(self) -> int:
        """Move bytes between the firmware and the other end; return their number."""
        line, end = self._line, self._end
        sent = line.take()
        self.received += len(sent)
        if end is None:
            self._unread += sent
            del self._unread[:-BUFFER_SIZE]
        else:
            room = max(line.free_bytes - len(self._outgoing), 0)
            now = self._host.board.stage.now
            if arrived := end.exchange(sent, now, room):
                self.arrivals.append((now - self.connected_at, arrived))
                self._outgoing += arrived
        content = bytes(self._outgoing[: line.free_bytes])
        del self._outgoing[: len(content)]
        if content:
            line.feed(content)
        self.written += len(content)
        line.pausing_byte = self._pausing_byte if end is None else end.pausing_byte
        return len(sent) + len(content)

    def choose_next_exchange(self, until: int) -> int:
        """Return the time (ns) up to which the firmware may run before the next exchange, at most `until`."""
        now, next_exchange = self._host.board.stage.now, None
        if self._end is not None:
            next_exchange = self._end.choose_next_exchange(now)
        if self._find is not None or self._outgoing or (self._end is not None and not self._line.does_pause):
            next_exchange = min(now + POLL_NS, until if next_exchange is None else next_exchange)
        return until if next_exchange is None else min(until, max(next_exchange, now))

    @property
    def is_connected(self) -> bool:
        """True while another end than Python is at the line."""
        return self._end is not None

    @property
    def unread(self) -> bytes:
        """Bytes that the firmware has sent and nobody has read; they stay unread."""
        return bytes(self._unread)

    def disconnect(self) -> None:
        """Remove the end that is connected to the serial line; Python is the other end again."""
        self._end = None

    # --- inside ---

    def _get_firmware_line(self) -> SerialLine:
        """Return the firmware's own line of this number."""
        return self._host.board.serial_lines.lines[self._number]

    @property
    def _line(self) -> SerialLine | UartLine:
        """The serial line in use: as the first line that of the first UART on the bus, otherwise the firmware's own."""
        if self._number > 0:
            return self._get_firmware_line()
        if self._uart_line is None:
            uart = next((device for device in self._host.board.devices if isinstance(device, UART)), None)
            if uart is None:
                return self._get_firmware_line()
            self._uart_line = UartLine(uart)
        return self._uart_line

    def _run_until(self, find: Callable[[], Any], timeout: float, wanted: str, pausing_byte: int = NO_BYTE) -> None:
        """Run the firmware until `find()` returns a true value. It is called every POLL_NS and after each `pausing_byte`.

        Raises:
            RunTimeout: `find()` returned no true value in time.
        """
        self.check_is_wired()
        if self._end is not None:
            raise StageError(
                "something else is at the other end of this serial line: it reads what the firmware sends."
            )
        host, self._find, self._pausing_byte = self._host, find, pausing_byte
        try:
            self.exchange()
            if find():
                return
            result = host.run_for(timeout)
            if find():
                return
        finally:
            self._find, self._pausing_byte = None, NO_BYTE
            self.exchange()
        when = f"within {timeout:g} s" if result is None else "before it returned"
        raise RunTimeout(
            f"{host.path.name} has not sent {wanted} over its serial line {when} (now {host.board.stage.time:.6f} s). "
            f"{describe_last_bytes(bytes(self._unread))}"
        )

    def _take_received(self, count: int, like: AnyStr) -> AnyStr:
        """Remove `count` received bytes from the buffer, and return them in the type of `like`."""
        content = bytes(self._unread[:count])
        del self._unread[:count]
        return from_bytes(content, like)


def to_bytes(content: Any, name: str) -> bytes:
    """Convert text or bytes to bytes.

    Args:
        content: Text of characters up to U+00FF, or bytes.
        name: Name of the function, for the error.

    Raises:
        ArgumentError: `content` is neither bytes nor such a text.
    """
    if isinstance(content, str):
        try:
            return content.encode("latin-1")
        except UnicodeEncodeError:
            pass
    elif isinstance(content, bytes | bytearray | memoryview):
        return bytes(content)
    raise ArgumentError(f"{name}({content!r}): bytes, or text whose characters are bytes, such as 'G0 X10\\n'.")


def from_bytes(content: bytes, like: AnyStr) -> AnyStr:
    """Convert bytes to the type of `like`."""
    return content.decode("latin-1") if isinstance(like, str) else content


def describe_last_bytes(sent: bytes) -> str:
    """Return a sentence about the last bytes that the firmware has sent."""
    if not sent:
        return "It has sent nothing."
    text = sent[-EXCERPT_SIZE:].decode("latin-1")
    return f"It has sent {'... ' if len(sent) > EXCERPT_SIZE else ''}{text!r}."
