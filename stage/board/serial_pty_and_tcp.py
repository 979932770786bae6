"""Other ends of a serial line for programs outside of the simulation: a pseudo-terminal and a TCP port.

Terminal programs and G-code senders connect to them. Bytes move every EXCHANGE_NS of simulated time. Their arrival depends on
wall-clock time, so two runs differ; a serial script (`stage.board.serial_script`) gives the same bits each time.

Before the first connection, the last bytes of the firmware are kept for the program that connects: a real board restarts when its
    port
is opened, and its greeting then arrives. Later, bytes are lost while no program is connected.
"""

from __future__ import annotations

import errno
import os
import select
import socket
from pathlib import Path

from stage.board.bus.serial_core import LINE_BUFFER_SIZE, NO_BYTE
from stage.board.serial_line import SerialEnd
from stage.errors import ArgumentError, StageError

EXCHANGE_NS = 5_000_000
LOCALHOST = "127.0.0.1"
MAX_PORT = 0xFFFF
FORMS = "pty, pty:LINK (a link to the pseudo-terminal is made there) or tcp:PORT"


def open_end(text: str) -> PtyEnd | TcpEnd:
    """Open the end of a serial line that an option describes.

    Args:
        text: pty, pty:LINK or tcp:PORT.

    Raises:
        ArgumentError: The text has another form, the port is in use, or the link exists.
        StageError: This system has no pseudo-terminals.
    """
    kind, _, rest = text.partition(":")
    if kind == "pty" and (rest or text == "pty"):
        return PtyEnd(Path(rest) if rest else None)
    if kind == "tcp" and rest.isascii() and rest.isdigit():
        if int(rest) > MAX_PORT:
            raise ArgumentError(f"--serial {text!r}: TCP ports are 1 to {MAX_PORT}, or 0 for a free one.")
        return TcpEnd(int(rest))
    raise ArgumentError(f"--serial {text!r} is no end of a serial line. Write {FORMS}.")


class ConnectedEnd(SerialEnd):
    """Base class of ends to which programs connect."""

    pausing_byte = NO_BYTE
    is_over = False

    def __init__(self) -> None:
        self._unsent = bytearray()
        self._was_connected = False

    def choose_next_exchange(self, now: int) -> int:
        """Return the time of the stage (ns) at which bytes are exchanged with the connected program next."""
        return now + EXCHANGE_NS

    def exchange(self, sent: bytes, now: int, room: int) -> bytes:
        """Write what the firmware has sent, and return what was received, at most `room` bytes."""
        self._unsent += sent
        del self._unsent[:-LINE_BUFFER_SIZE]
        received = self._read(room)
        if self._is_connected():
            self._was_connected = True
            del self._unsent[: self._write(bytes(self._unsent))]
        elif self._was_connected:
            self._unsent.clear()
        return received

    def _is_connected(self) -> bool:
        """Return whether a program is connected now."""
        raise NotImplementedError

    def _read(self, room: int) -> bytes:
        """Return at most `room` bytes that the program has sent."""
        raise NotImplementedError

    def _write(self, content: bytes) -> int:
        """Send bytes to the program, and return the number of bytes that it has taken."""
        raise NotImplementedError


class PtyEnd(ConnectedEnd):
    """Pseudo-terminal. Programs open `path` like the device file of a serial port, and may close and open it again.

    Args:
        link: Path of a symbolic link to the pseudo-terminal, or None.

    Attributes:
        path: Path of the pseudo-terminal, or of the link.

    Raises:
        ArgumentError: The link cannot be made.
        StageError: This system has no pseudo-terminals.
    """

    def __init__(self, link: Path | None = None):
        super().__init__()
        try:
            import pty
            import tty
        except ImportError:
            raise StageError(
                "--serial pty: this system has no pseudo-terminals; --serial tcp:5331 works here."
            ) from None
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path, self._link = os.ttyname(slave), link
        os.close(slave)  # reading then fails while no program has it open
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN)
        if link is not None:
            self._make_link(link)

    def _make_link(self, link: Path) -> None:
        """Create the symbolic link. Raises ArgumentError if the path exists, unless it is a dead link."""
        try:
            if link.is_symlink() and not link.exists():
                link.unlink()  # of a run that was killed
            link.symlink_to(self.path)
        except OSError as error:
            os.close(self._master)
            raise ArgumentError(
                f"--serial pty:{link}: {error.strerror}. Name a path where a link can be made."
            ) from None
        self.path = str(link)

    def describe(self) -> str:
        """Return the path at which programs connect to the pseudo-terminal."""
        return self.path

    def _is_connected(self) -> bool:
        return not any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def _read(self, room: int) -> bytes:
        if room <= 0 or not any(event & select.POLLIN for _, event in self._poll.poll(0)):
            return b""
        try:
            return os.read(self._master, room)
        except OSError as error:
            if error.errno in (errno.EIO, errno.EAGAIN):  # nobody is there
                return b""
            raise

    def _write(self, content: bytes) -> int:
        try:
            return os.write(self._master, content) if content else 0
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the pseudo-terminal, and remove the link."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
            if self._link is not None:
                self._link.unlink(missing_ok=True)


class TcpEnd(ConnectedEnd):
    """TCP port of this machine; one program at a time connects to it.

    Args:
        port: Number of the port; 0 chooses a free one.

    Attributes:
        port: Number of the port.

    Raises:
        ArgumentError: The port is in use.
    """

    def __init__(self, port: int):
        super().__init__()
        self._connection: socket.socket | None = None
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((LOCALHOST, port))
            self._listener.listen()
        except OSError as error:
            self._listener.close()
            raise ArgumentError(
                f"--serial tcp:{port}: {error.strerror}. Choose another port, or end what listens there."
            ) from None
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])

    def describe(self) -> str:
        """Return the address and the TCP port at which programs connect."""
        return f"{LOCALHOST}:{self.port}"

    def _is_connected(self) -> bool:
        return self._connection is not None

    def _accept(self) -> None:
        """Accept a new connection, and close the former one, whose program may have ended without closing it."""
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._disconnect()
        self._connection = connection

    def _disconnect(self) -> None:
        """Close the present connection."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _read(self, room: int) -> bytes:
        self._accept()
        if self._connection is None or room <= 0:
            return b""
        try:
            received = self._connection.recv(room)
        except BlockingIOError:
            return b""
        except OSError:
            received = b""
        if not received:
            self._disconnect()
        return received

    def _write(self, content: bytes) -> int:
        assert self._connection is not None
        try:
            return self._connection.send(content) if content else 0
        except BlockingIOError:
            return 0
        except OSError:
            self._disconnect()
            return 0

    def close(self) -> None:
        """Close the port and its connection."""
        self._disconnect()
        self._listener.close()
