"""`Server`: accepts connections and handles their frames, in one thread with one selector. frame_execution.py executes the frames.

    server = Server(board, port=0)
    print(server.address)
    server.run()                          until server.stop(), from another thread or a signal handler

One host drives, others may observe. The stage keeps its state when a host disconnects. Bytes that are no frame end only
the connection that sent them."""

from __future__ import annotations

import errno
import selectors
import socket
import time
from collections.abc import Callable
from contextlib import suppress

from stage.board import Board
from stage.errors import ArgumentError, StageError
from stage.serve import client
from stage.serve.frame_execution import BatchError, FrameExecutor, describe_error
from stage.serve.frame_table import FRAMES

MAX_HOSTS, MAX_CONNECTIONS = 16, 64
"""Largest number of connections that have been greeted, and of all open connections."""
FRAME_TIMEOUT_S = 10.0
"""Real time within which a connection has to send HELLO, and a frame whose first bytes have arrived has to be complete."""
READ_SIZE = 1 << 18
MAX_WAITING = client.MAX_BODY + client.HEAD.size + READ_SIZE
"""Received or outgoing bytes of a connection that may wait; the server reads no more while there are more."""
_NAMES = {frame.kind: frame.name for frame in FRAMES}
_OBSERVER_FRAME_KINDS = frozenset(frame.kind for frame in FRAMES if frame.observes)


class _HostGoneError(StageError):
    """Error that ends a frame in progress because its host has disconnected or the server ends."""


class _Connection:
    """Connection of a host to the server of a board.

    Attributes:
        role: DRIVE or OBSERVE; None before the connection has sent HELLO.
        received: Bytes that the server has not handled yet.
        outgoing: Bytes that the server has not sent yet.
        since: Monotonic time, s, at which the server began to wait for the rest of a frame, or None.
        closing: Whether the connection closes after its outgoing bytes are sent.
        gone: Whether the host has closed the connection.
    """

    def __init__(self, wire: socket.socket, name: str):
        self.wire, self.name = wire, name
        self.role: int | None = None
        self.received, self.outgoing = bytearray(), bytearray()
        self.since: float | None = time.monotonic()
        self.closing = self.gone = False

    def take_frame(self) -> tuple[int, int, bytes] | None:
        """Return the next complete frame as (kind, number, body), or None."""
        if not self.has_frame():
            return None
        length, kind, number = client.HEAD.unpack_from(self.received)
        if length > client.MAX_BODY:
            raise ArgumentError(
                f"a frame of {length:,} bytes; there are up to {client.MAX_BODY:,}. Is this host's protocol another?"
            )
        end = client.HEAD.size + length
        body = bytes(self.received[client.HEAD.size : end])
        del self.received[:end]
        self.since = time.monotonic() if self.received else None
        return kind, number, body

    def has_frame(self) -> bool:
        """Tell whether a whole frame has arrived, or a head that announces too long a frame."""
        if len(self.received) < client.HEAD.size:
            return False
        length = client.HEAD.unpack_from(self.received)[0]
        return length > client.MAX_BODY or len(self.received) >= client.HEAD.size + length

    def is_frame_awaited(self) -> bool:
        """Tell whether the server waits for the greeting or the rest of a frame."""
        return self.role is None or len(self.received) > 0

    def is_overdue(self) -> bool:
        """Tell whether the rest of a frame, or the greeting, has not arrived within FRAME_TIMEOUT_S."""
        return self.since is not None and time.monotonic() - self.since > FRAME_TIMEOUT_S


class Server:
    """Server of a board, which listens on a socket.

    Args:
        board: A Board; only the server drives it while `run` runs.
        bind: Address on which the server listens.
        port: TCP port; 0: a free port.
        fresh: Whether the server resets the board for each host to its state at the server's start; False: a host finds it as the
            last one left it.
        keep: Greatest number of stored log lines.
        report: Function that is called with lines for a terminal: which hosts connect and disconnect, and what they log.
        before_each: Function that is called before each request of the driving host, and periodically within a batch. It may
            wait.

    Attributes:
        address: Host and port on which the server listens.
        machine: Executor of the frames.

    Raises:
        ArgumentError: The port is out of range.
        StageError: The server cannot listen on this address and port.
    """

    def __init__(
        self,
        board: Board,
        bind: str = "127.0.0.1",
        port: int = client.PORT,
        *,
        fresh: bool = False,
        keep: int = 1_000_000,
        report: Callable[[str], None] = lambda line: None,
        before_each: Callable[[], None] = lambda: None,
    ):
        self._fresh, self._report, self._before_each = fresh, report, before_each
        self.machine = FrameExecutor(
            board, keep=keep, pause=self._handle_events_during_batch, hook=self._call_hook,
            report=lambda seconds, text: report(f"{seconds:12.6f}  {text}"),
        )  # fmt: skip
        self._driver: _Connection | None = None
        self._busy = self._in_hook = self._returned = self._stopping = False
        self._failed_hook = ""
        if not 0 <= port < 1 << 16:
            raise ArgumentError(f"port={port!r}: a TCP port is 0 (one that is free) to 65535.")
        self._listener = _open_listening_socket(bind, port)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._notifier, self._notified = socket.socketpair()
        for end in (self._notifier, self._notified, self._listener):
            end.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._notified, selectors.EVENT_READ)

    def run(self) -> None:
        """Serve until `stop` is called, then close all connections."""
        try:
            while not self._stopping:
                self._handle_events(self._compute_poll_timeout())
        finally:
            for connection in self._list_connections():
                self._close_connection(connection)
            self._selector.close()
            for end in (self._listener, self._notifier, self._notified):
                end.close()

    def stop(self) -> None:
        """Make `run` return soon, even within a batch. Other threads and signal handlers may call this."""
        self._stopping = True
        with suppress(OSError):  # it has ended already
            self._notifier.send(b"!")

    # --- events ---

    def _list_connections(self) -> list[_Connection]:
        return [key.data for key in self._selector.get_map().values() if key.data is not None]

    def _handle_events(self, seconds: float | None) -> None:
        """Wait at most `seconds` (None: without limit) for events, and handle them."""
        for key, events in self._selector.select(seconds):
            connection: _Connection | None = key.data
            if key.fileobj is self._listener:
                self._accept_connection()
            elif connection is None:
                with suppress(OSError):
                    self._notified.recv(4096)
            else:
                if events & selectors.EVENT_READ and len(connection.received) < MAX_WAITING:
                    self._receive_bytes(connection)
                if events & selectors.EVENT_WRITE:
                    self._send_bytes(connection)
        for connection in self._list_connections():
            self._handle_frame(connection)
            self._update_connection(connection)

    def _can_handle_frame(self, connection: _Connection) -> bool:
        """Tell whether the server may handle a frame of this connection now.

        It may not while too many bytes wait to be sent, or while the driving host's last frame is in progress.
        """
        in_request = self._busy and not self._in_hook and connection is self._driver
        return len(connection.outgoing) < MAX_WAITING and not in_request

    def _compute_poll_timeout(self) -> float | None:
        """Return the seconds until the server has to act even if no bytes arrive; None if it only waits for bytes."""
        waits = []
        for connection in self._list_connections():
            if self._can_handle_frame(connection) and not connection.closing and connection.has_frame():
                return 0.0
            if connection.since is not None:
                waits.append(max(connection.since + FRAME_TIMEOUT_S - time.monotonic(), 0.0))
        return min(waits, default=None)

    def _accept_connection(self) -> None:
        with suppress(OSError):  # the other end is gone already
            wire, address = self._listener.accept()
            wire.setblocking(False)
            wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            connection = _Connection(wire, f"{address[0]}:{address[1]}")
            if len(self._list_connections()) >= MAX_CONNECTIONS:
                wire.close()
                return
            self._selector.register(wire, selectors.EVENT_READ, connection)

    def _receive_bytes(self, connection: _Connection) -> None:
        try:
            more = connection.wire.recv(READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            more = b""
        connection.gone = not more
        connection.received += more
        if connection.since is None:
            connection.since = time.monotonic()

    def _send_bytes(self, connection: _Connection) -> None:
        try:
            while connection.outgoing:
                sent = connection.wire.send(connection.outgoing)
                del connection.outgoing[:sent]
        except BlockingIOError:
            pass
        except OSError:
            connection.gone = True

    def _update_connection(self, connection: _Connection) -> None:
        """Close a connection that has ended or is overdue; otherwise select the events for which the server waits."""
        overdue = connection.is_overdue()
        if overdue and not connection.closing and connection.is_frame_awaited() and not connection.has_frame():
            self._refuse_connection(connection, f"no whole frame in {FRAME_TIMEOUT_S:g} s.")
            self._send_bytes(connection)
        if connection.gone or (connection.closing and (overdue or not connection.outgoing)):
            self._close_connection(connection)
            return
        if connection.since is not None and not connection.is_frame_awaited():
            connection.since = None
        reads = len(connection.received) < MAX_WAITING and not connection.closing
        events = (selectors.EVENT_READ if reads else 0) | (selectors.EVENT_WRITE if connection.outgoing else 0)
        if events and events != self._selector.get_key(connection.wire).events:
            self._selector.modify(connection.wire, events, connection)

    def _close_connection(self, connection: _Connection) -> None:
        with suppress(KeyError, ValueError):
            self._selector.unregister(connection.wire)
        connection.wire.close()
        connection.gone = True
        if connection is self._driver and not self._busy:
            self._release_driving_host()

    def _release_driving_host(self) -> None:
        """Let another host drive after the driving host has gone."""
        connection, self._driver = self._driver, None
        if connection is not None:
            self.machine.remove_hooks()
            self._report(f"{connection.name} drives no more, at {self.machine.board.stage.time:.6f} s")

    # --- frames ---

    def _handle_frame(self, connection: _Connection) -> None:
        """Handle the next frame of a connection if the frame is complete and the connection may send it now."""
        if connection.gone or connection.closing or not self._can_handle_frame(connection):
            return
        try:
            frame = connection.take_frame()
        except ArgumentError as error:
            self._refuse_connection(connection, str(error))
            frame = None
        if frame is not None:
            self._answer_frame(connection, *frame)
        if connection.outgoing:
            self._send_bytes(connection)

    def _answer_frame(self, connection: _Connection, kind: int, number: int, body: bytes) -> None:
        """Execute a frame, and queue its reply or its error."""
        if connection.role is None:
            self._handle_greeting(connection, kind, number, body)
            return
        if kind == client.RETURN:
            self._end_hook(connection, body)
            return
        try:
            if kind not in self.machine.handlers:
                known = ", ".join(f"{k} {_NAMES[k]}" for k in self.machine.handlers)
                raise ArgumentError(
                    f"{_NAMES.get(kind, 'there is no frame')} {kind}: a host that was greeted sends {known}."
                )
            if connection.role != client.DRIVE and kind not in _OBSERVER_FRAME_KINDS:
                raise StageError(f"{_NAMES[kind]}: this connection only observes; connect with role 0 to drive.")
            reply = self._execute_frame(connection, kind, body)
        except BatchError as error:
            done = len(error.answers) // client.ANSWER.size
            self._queue_frame(
                connection, client.ERROR, number, client.WORD.pack(done) + error.answers + str(error).encode()
            )
        except Exception as error:
            self._queue_frame(connection, client.ERROR, number, client.WORD.pack(0) + describe_error(error).encode())
        else:
            self._queue_frame(connection, kind, number, reply)

    def _execute_frame(self, connection: _Connection, kind: int, body: bytes) -> bytes:
        """Execute a frame by its handler; mark the server as busy if the driving host has sent it."""
        if connection is not self._driver:
            return self.machine.handlers[kind](body)
        before = self._busy, self._in_hook
        self._busy, self._in_hook = True, False
        try:
            self._before_each()
            return self.machine.handlers[kind](body)
        finally:
            self._busy, self._in_hook = before
            if connection.gone and not self._busy:
                self._release_driving_host()

    def _handle_greeting(self, connection: _Connection, kind: int, number: int, body: bytes) -> None:
        """Admit the host whose first frame is a valid HELLO, or refuse the connection."""
        if kind != client.HELLO or len(body) != client.GREETING.size or not body.startswith(client.MAGIC):
            self._refuse_connection(connection, "the first frame has to be HELLO, see docs/serve.md.", number)
            return
        _, version, role = client.GREETING.unpack(body)
        greeted = sum(1 for other in self._list_connections() if other.role is not None)
        if version != client.VERSION:
            why = f"the host speaks version {version} of the frames, and this server version {client.VERSION}."
        elif role not in (client.DRIVE, client.OBSERVE):
            why = f"role {role}: 0 drives, 1 observes."
        elif greeted >= MAX_HOSTS:
            why = f"{MAX_HOSTS} hosts are connected, and no more can be."
        elif role == client.DRIVE and self._driver is not None:
            why = f"{self._driver.name} drives this stage, one host at a time. Wait until it is gone, or observe."
        else:
            self._admit_host(connection, role, number)
            return
        self._refuse_connection(connection, why, number)

    def _admit_host(self, connection: _Connection, role: int, number: int) -> None:
        """Give a connection its role, and queue the reply to its HELLO."""
        if role == client.DRIVE:
            if self._fresh:
                try:
                    self.machine.reset_to_start()
                except StageError as error:
                    self._refuse_connection(connection, str(error), number)
                    return
            self._driver = connection
            self._report(f"{connection.name} drives, at {self.machine.board.stage.time:.6f} s")
        connection.role = role
        self._queue_frame(
            connection, client.HELLO, number, client.WORD.pack(client.VERSION) + self.machine.describe_board()
        )

    def _queue_frame(self, connection: _Connection, kind: int, number: int, body: bytes) -> None:
        connection.outgoing += client.HEAD.pack(len(body), kind, number) + body

    def _refuse_connection(self, connection: _Connection, text: str, number: int = 0) -> None:
        """Queue an error, and close the connection after it is sent."""
        self._queue_frame(connection, client.ERROR, number, client.WORD.pack(0) + text.encode())
        connection.closing, connection.since = True, time.monotonic()

    # --- while a frame of the driver is being carried out ---

    def _handle_events_during_batch(self) -> None:
        """Handle events during a batch, without waiting for any."""
        self._handle_events(0.0)
        self._check_host_present()
        self._before_each()

    def _check_host_present(self) -> None:
        """Raise _HostGoneError if the server ends, or if the host that sent the frame in progress has disconnected."""
        if self._stopping:
            raise _HostGoneError("the server ends.")
        if self._driver is None or self._driver.gone:
            raise _HostGoneError("the host is gone.")

    def _call_hook(self, source: int) -> None:
        """Let the host call its hook for the interrupt line or a timer, and serve its requests until the hook returns."""
        driver = self._driver
        if driver is None:
            return
        self._queue_frame(driver, client.INTERRUPT, 0, client.WORD.pack(source))
        self._send_bytes(driver)
        self._in_hook, self._returned, self._failed_hook = True, False, ""
        try:
            while not self._returned:
                self._handle_events(self._compute_poll_timeout())
                self._check_host_present()
        finally:
            self._in_hook = False
        if self._failed_hook:
            raise StageError(f"the interrupt hook of the host failed: {self._failed_hook}")

    def _end_hook(self, connection: _Connection, body: bytes) -> None:
        """Handle a frame RETURN of the host, which ends its hook for the interrupt line or a timer."""
        if connection is not self._driver or not self._in_hook:
            self._queue_frame(connection, client.ERROR, 0, client.WORD.pack(0) + b"RETURN: no hook was called.")
            return
        self._returned, self._failed_hook = True, body[:1000].decode(errors="replace")


def _open_listening_socket(bind: str, port: int) -> socket.socket:
    """Return a socket that listens on an address and port. Raises StageError if that is not possible."""
    listener = socket.socket(socket.AF_INET6 if ":" in bind else socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((bind, port))
        listener.listen()
    except OSError as error:
        listener.close()
        if error.errno in (errno.EADDRINUSE, errno.EACCES):
            hint = "Is another server running? Choose another port (--listen), or 0 for one that is free."
        else:
            hint = "--bind takes an address of this machine, for example 127.0.0.1, or 0.0.0.0 for all of them."
        raise StageError(f"nothing can listen on {bind}, port {port}: {error.strerror or error}. {hint}") from None
    return listener
