"""`Server`: connections and frames. One thread, one selector; what a frame does is in machine.py.

    server = Server(board, port=0)
    print(server.address)
    server.run()                          until server.stop(), from another thread or a signal handler

One host drives, others may look. A host that is gone leaves the stage as it stands. Whatever bytes come: those that are no frame
end their connection, and nothing else.
"""

from __future__ import annotations

import errno
import selectors
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from stage.board import Board
from stage.errors import ArgumentError, StageError
from stage.serve import client
from stage.serve.frames import FRAMES
from stage.serve.machine import BatchError, Machine, said

MOST_HOSTS, MOST_CONNECTIONS = 16, 64
"""That were greeted; that are open."""
PATIENCE = 10.0
"""s of real time in which a connection has to say hello, and a frame that has begun to arrive has to be whole."""
AT_A_TIME = 1 << 18
MOST_WAITING = client.MOST_BODY + client.HEAD.size + AT_A_TIME
"""Bytes of a connection that wait for being handled, or for being taken by the host: with more, nothing is read from it."""
_NAMES = {frame.kind: frame.name for frame in FRAMES}
_LOOKS = frozenset(frame.kind for frame in FRAMES if frame.looks)


class _Gone(StageError):
    """Nobody waits for the rest of what is being done."""


class _Connection:
    """role: DRIVE or LOOK, None before HELLO. since: from when a frame is waited for, or None. closing: after what is to be
    sent."""

    def __init__(self, wire: socket.socket, name: str):
        self.wire, self.name = wire, name
        self.role: int | None = None
        self.came, self.goes = bytearray(), bytearray()
        self.since: float | None = time.monotonic()
        self.closing = self.gone = False

    def frame(self) -> tuple[int, int, bytes] | None:
        """The next frame, if it is here as a whole: kind, number, body."""
        if len(self.came) < client.HEAD.size:
            return None
        length, kind, number = client.HEAD.unpack_from(self.came)
        if length > client.MOST_BODY:
            raise ArgumentError(
                f"a frame of {length:,} bytes; there are up to {client.MOST_BODY:,}. Is this host's protocol another?"
            )
        end = client.HEAD.size + length
        if len(self.came) < end:
            return None
        body = bytes(self.came[client.HEAD.size : end])
        del self.came[:end]
        self.since = time.monotonic() if self.came else None
        return kind, number, body

    def waits(self) -> bool:
        """Part of a frame has come, or no hello."""
        return self.role is None or len(self.came) > 0


class Server:
    """A board behind a socket that listens.

    Args:
        board: a Board; nobody else drives it while `run` runs.
        bind, port: where it listens; port 0 is one that is free. address: (host, port) that came of it.
        fresh: each host finds the state that the board has now; otherwise that in which the last one left it.
        keep: lines of the log that are kept.
        told: gets lines for a terminal: who comes and goes, what a host logs.
        before_each: is called before each request of the host that drives, and now and then within a batch; it may wait.
    Raises:
        StageError: nothing can listen there.
    """

    def __init__(
        self,
        board: Board,
        bind: str = "127.0.0.1",
        port: int = client.PORT,
        *,
        fresh: bool = False,
        keep: int = 1_000_000,
        told: Callable[[str], None] = lambda line: None,
        before_each: Callable[[], None] = lambda: None,
    ):
        self._fresh, self._told, self._before_each = fresh, told, before_each
        self.machine = Machine(
            board,
            keep=keep,
            pause=self._pause,
            hook=self._hook,
            told=lambda seconds, text: told(f"{seconds:12.6f}  {text}"),
        )
        self._driver: _Connection | None = None
        self._busy = self._called = self._returned = False
        self._stopping = False
        self._failed_hook = ""
        if not 0 <= port < 1 << 16:
            raise ArgumentError(f"port={port!r}: a TCP port is 0 (one that is free) to 65535.")
        family = socket.AF_INET6 if ":" in bind else socket.AF_INET
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((bind, port))
            self._listener.listen()
        except OSError as error:
            self._listener.close()
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                hint = "Is another server running? Choose another port (--listen), or 0 for one that is free."
            else:
                hint = "--bind takes an address of this machine, for example 127.0.0.1, or 0.0.0.0 for all of them."
            raise StageError(f"nothing can listen on {bind}, port {port}: {error.strerror or error}. {hint}") from None
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._wake, self._woken = socket.socketpair()
        for end in (self._wake, self._woken, self._listener):
            end.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)

    def run(self) -> None:
        """Serve until `stop`. All connections are closed then, and nothing listens any more."""
        try:
            while not self._stopping:
                self._turn(self._patience())
        finally:
            for connection in list(self._connections()):
                self._close(connection)
            self._selector.close()
            for end in (self._listener, self._wake, self._woken):
                end.close()

    def stop(self) -> None:
        """`run` returns soon; a batch that is being done ends where it is. For other threads and signal handlers."""
        self._stopping = True
        with suppress(OSError):  # has ended already, or was told already
            self._wake.send(b"!")

    # --- turns ---

    def _connections(self) -> Iterator[_Connection]:
        return (key.data for key in self._selector.get_map().values() if key.data is not None)

    def _turn(self, seconds: float | None) -> None:
        """Wait for whatever comes first, `seconds` at most (None: for ever), and do it."""
        for key, events in self._selector.select(seconds):
            connection: _Connection | None = key.data
            if key.fileobj is self._listener:
                self._accept()
            elif connection is None:
                with suppress(OSError):
                    self._woken.recv(4096)
            else:
                if events & selectors.EVENT_READ and len(connection.came) < MOST_WAITING:
                    self._receive(connection)
                if events & selectors.EVENT_WRITE:
                    self._send(connection)
        for connection in list(self._connections()):
            self._next_frame(connection)
            self._tidy(connection)

    def _may(self, connection: _Connection) -> bool:
        """Whether a frame of this connection may be handled now."""
        return len(connection.goes) < MOST_WAITING and not (
            self._busy and not self._called and connection is self._driver
        )

    def _patience(self) -> float | None:
        """s until something is to be done even if nothing comes."""
        wait: float | None = None
        for connection in self._connections():
            if self._may(connection) and not connection.closing and _whole(connection):
                return 0.0
            if connection.since is not None:
                left = max(connection.since + PATIENCE - time.monotonic(), 0.0)
                wait = left if wait is None else min(wait, left)
        return wait

    def _accept(self) -> None:
        with suppress(OSError):  # who knocked is gone already
            wire, address = self._listener.accept()
            wire.setblocking(False)
            wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            connection = _Connection(wire, f"{address[0]}:{address[1]}")
            if sum(1 for _ in self._connections()) >= MOST_CONNECTIONS:
                wire.close()
                return
            self._selector.register(wire, selectors.EVENT_READ, connection)

    def _receive(self, connection: _Connection) -> None:
        try:
            more = connection.wire.recv(AT_A_TIME)
        except BlockingIOError:
            return
        except OSError:
            more = b""
        connection.gone = not more
        connection.came += more
        if connection.since is None:
            connection.since = time.monotonic()

    def _send(self, connection: _Connection) -> None:
        try:
            while connection.goes:
                sent = connection.wire.send(connection.goes)
                del connection.goes[:sent]
        except BlockingIOError:
            pass
        except OSError:
            connection.gone = True

    def _tidy(self, connection: _Connection) -> None:
        """Close it, or wait for what it may do next."""
        late = connection.since is not None and time.monotonic() - connection.since > PATIENCE
        if late and not connection.closing and connection.waits() and not _whole(connection):
            self._refuse(connection, f"no whole frame in {PATIENCE:g} s.")
            self._send(connection)
        if connection.gone or (connection.closing and (late or not connection.goes)):
            self._close(connection)
            return
        if connection.since is not None and not connection.waits():
            connection.since = None
        read = len(connection.came) < MOST_WAITING and not connection.closing
        events = (selectors.EVENT_READ if read else 0) | (selectors.EVENT_WRITE if connection.goes else 0)
        key = self._selector.get_key(connection.wire)
        if events and events != key.events:
            self._selector.modify(connection.wire, events, connection)

    def _close(self, connection: _Connection) -> None:
        with suppress(KeyError, ValueError):
            self._selector.unregister(connection.wire)
        connection.wire.close()
        connection.gone = True
        if connection is self._driver and not self._busy:
            self._let_go()

    def _let_go(self) -> None:
        """The host that drove is gone."""
        connection, self._driver = self._driver, None
        if connection is not None:
            self.machine.let_go()
            self._told(f"{connection.name} drives no more, at {self.machine.board.stage.time:.6f} s")

    # --- frames ---

    def _next_frame(self, connection: _Connection) -> None:
        if connection.gone or connection.closing or not self._may(connection):
            return
        try:
            frame = connection.frame()
        except ArgumentError as error:
            self._refuse(connection, str(error))
            frame = None
        if frame is not None:
            self._handle(connection, *frame)
        if connection.goes:
            self._send(connection)

    def _handle(self, connection: _Connection, kind: int, number: int, body: bytes) -> None:
        if connection.role is None:
            self._greet(connection, kind, number, body)
            return
        if kind == client.RETURN:
            self._hook_returns(connection, body)
            return
        try:
            if kind not in self.machine.does:
                known = ", ".join(f"{k} {_NAMES[k]}" for k in self.machine.does)
                raise ArgumentError(
                    f"{_NAMES.get(kind, 'there is no frame')} {kind}: a host that was greeted sends {known}."
                )
            if connection.role != client.DRIVE and kind not in _LOOKS:
                raise StageError(f"{_NAMES[kind]}: this connection only looks; connect with role 0 to drive.")
            reply = self._do(connection, kind, body)
        except BatchError as error:
            done = len(error.answers) // client.ANSWER.size
            self._put(connection, client.ERROR, number, client.WORD.pack(done) + error.answers + str(error).encode())
        except Exception as error:
            self._put(connection, client.ERROR, number, client.WORD.pack(0) + said(error).encode())
        else:
            self._put(connection, kind, number, reply)

    def _do(self, connection: _Connection, kind: int, body: bytes) -> bytes:
        if connection is not self._driver:
            return self.machine.does[kind](body)
        before = self._busy, self._called
        self._busy, self._called = True, False
        try:
            self._before_each()
            return self.machine.does[kind](body)
        finally:
            self._busy, self._called = before
            if connection.gone and not self._busy:
                self._let_go()

    def _greet(self, connection: _Connection, kind: int, number: int, body: bytes) -> None:
        if kind != client.HELLO or len(body) != client.GREETING.size or not body.startswith(client.MAGIC):
            self._refuse(connection, "the first frame has to be HELLO, see docs/serve.md.", number)
            return
        _, version, role = client.GREETING.unpack(body)
        if version != client.VERSION:
            self._refuse(
                connection,
                f"the host speaks version {version} of the frames, and this server version {client.VERSION}.",
                number,
            )
        elif role not in (client.DRIVE, client.LOOK):
            self._refuse(connection, f"role {role}: 0 drives, 1 looks.", number)
        elif sum(1 for other in self._connections() if other.role is not None) >= MOST_HOSTS:
            self._refuse(connection, f"{MOST_HOSTS} hosts are connected, and no more can be.", number)
        elif role == client.DRIVE and self._driver is not None:
            self._refuse(
                connection,
                f"{self._driver.name} drives this stage, one host at a time. Wait until it is gone, or look.",
                number,
            )
        else:
            self._admit(connection, role, number)

    def _admit(self, connection: _Connection, role: int, number: int) -> None:
        if role == client.DRIVE:
            if self._fresh:
                try:
                    self.machine.fresh()
                except StageError as error:
                    self._refuse(connection, str(error), number)
                    return
            self._driver = connection
            self._told(f"{connection.name} drives, at {self.machine.board.stage.time:.6f} s")
        connection.role = role
        self._put(connection, client.HELLO, number, client.WORD.pack(client.VERSION) + self.machine.about())

    def _put(self, connection: _Connection, kind: int, number: int, body: bytes) -> None:
        connection.goes += client.HEAD.pack(len(body), kind, number) + body

    def _refuse(self, connection: _Connection, text: str, number: int = 0) -> None:
        """Say why, and close it."""
        self._put(connection, client.ERROR, number, client.WORD.pack(0) + text.encode())
        connection.closing, connection.since = True, time.monotonic()

    # --- while a frame of the driver is being done ---

    def _pause(self) -> None:
        """Now and then within a batch."""
        self._turn(0.0)
        self._check()
        self._before_each()

    def _check(self) -> None:
        if self._stopping:
            raise _Gone("the server ends.")
        if self._driver is None or self._driver.gone:
            raise _Gone("the host is gone.")

    def _hook(self, source: int) -> None:
        """The interrupt line is asserted, or a timer is due: the host's hook is called, and makes bus cycles."""
        driver = self._driver
        if driver is None:
            return
        self._put(driver, client.INTERRUPT, 0, client.WORD.pack(source))
        self._send(driver)
        self._called, self._returned, self._failed_hook = True, False, ""
        try:
            while not self._returned:
                self._turn(self._patience())
                self._check()
        finally:
            self._called = False
        if self._failed_hook:
            raise StageError(f"the interrupt hook of the host failed: {self._failed_hook}")

    def _hook_returns(self, connection: _Connection, body: bytes) -> None:
        if connection is not self._driver or not self._called:
            self._put(connection, client.ERROR, 0, client.WORD.pack(0) + b"RETURN: no hook was called.")
            return
        self._returned, self._failed_hook = True, body[:1000].decode(errors="replace")


def _whole(connection: _Connection) -> bool:
    """Whether the next frame is here, or that it is none can be seen."""
    if len(connection.came) < client.HEAD.size:
        return False
    length = client.HEAD.unpack_from(connection.came)[0]
    return length > client.MOST_BODY or len(connection.came) >= client.HEAD.size + length
