"""Python host for a stage that `stage serve` serves. This file needs only Python: copy it to the host's machine.

    from stage.serve.client import connect

    with connect("127.0.0.1:7240") as board:
        board.out8(0x300, 0x11)                          one bus cycle and one round trip
        status = board.in8(0x300)
        answers = board.batch().out8(0x300, 0x15).until8(0x300, mask=0x40, value=0, times=1_000_000).micros().run()

`batch()` collects requests, which `run()` sends in one frame and which the server executes at full speed; `run()`
returns the answers of those that read, in order. docs/serve.md describes the bytes on the wire.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Callable, Iterable
from functools import reduce
from operator import or_
from typing import Any, Generic, NamedTuple, TypeVar

VERSION, PORT, MAGIC = 1, 7240, b"PULSESTG"
HEAD = struct.Struct("<III")
"""Head of a frame: number of bytes that follow it, kind, and a number that the host chooses and the reply repeats."""
MAX_BODY = 1 << 20
HELLO, BATCH, LOG, HOOK, RETURN, RESET, SNAPSHOT, RESTORE, STATUS, POSITIONS, PIN, STICK, TIMER = range(1, 14)
INTERRUPT, ERROR = 254, 255
"""Kinds of frames. A reply has the kind of its request, or ERROR."""
GREETING = struct.Struct("<8sII")
"""HELLO: MAGIC, VERSION, role."""
DRIVE, OBSERVE = 0, 1
ENTRY = struct.Struct("<iiiIqq")
"""A request of a BATCH: what, times, every (us), mask, a (port, us), b (value)."""
IN8, OUT8, IN16, OUT16, DELAY, MICROS, LINE, SPEND, IN32, OUT32 = 0, 1, 2, 3, 4, 5, 8, 12, 13, 14
SET_LINES, READ_LINES, WATCH_LINES = 21, 22, 26
DRIVEN_LINES = ("step", "dir", "enable")
"""Lines of a STEP/DIR axis that a host drives. The server refuses the others in SET_LINES."""
LINES_SHIFT = 32
"""SET_LINES: b is the mask of lines, shifted left by so many bits, and their levels."""
WITH_CYCLE = 1 << 32
"""Added to the number of the chip, a, in SET_LINES and READ_LINES: one bus cycle passes first."""
UNTIL8, UNTIL16, UNTIL_LINE = 100, 101, 102
READS = frozenset((IN8, IN16, IN32, MICROS, LINE, READ_LINES, UNTIL8, UNTIL16, UNTIL_LINE))
TIMING = struct.Struct("<IIq")
"""TIMER: which, level, period (ns; 0: off)."""
THE_LINE, FIRST_TIMER, TIMERS = 0, 1, 4
"""INTERRUPT: whose hook is to be called."""
STATUS_REPLY = struct.Struct("<qqq")
"""Reply to STATUS: time (ns), bus cycles, whether the interrupt line is asserted."""
PLACE = struct.Struct("<ddq")
"""Reply to POSITIONS, for each axis: position and commanded position, m (rad), and full steps lost."""
ANSWER, WORD = struct.Struct("<q"), struct.Struct("<I")
RELEASED, ASSERTED, CLEARED = 0, 1, 2
"""STICK: the state at which a switch sticks, or the end of the fault."""
NO_CONNECTION = "this batch belongs to no connection: client.batch() makes one that does."
_W = TypeVar("_W")  # what a request that writes returns
_R = TypeVar("_R")  # what one that reads returns


class ServerError(RuntimeError):
    """Error that the server of a board has sent.

    Attributes:
        answers: Answers to the requests of the batch that were executed before the error.
    """

    def __init__(self, text: str, answers: tuple[int, ...] = ()):
        super().__init__(text)
        self.answers = answers


class Status(NamedTuple):
    """State of a board: simulated seconds since power-up, number of bus cycles, and whether the interrupt line is asserted."""

    seconds: float
    cycles: int
    interrupt: bool


class AxisPosition(NamedTuple):
    """Position of an axis and commanded position, m or rad, and lost full steps."""

    position: float
    commanded: float
    lost_steps: int


def connect(address: str = "", *, observe: bool = False, timeout: float | None = 10.0) -> Client:
    """Connect to a server.

    Args:
        address: "HOST:PORT", "HOST" or ":PORT"; default: 127.0.0.1 and 7240.
        observe: Whether to read only status, positions and pins. Any number of hosts may observe, but only one may drive.
        timeout: Real seconds to wait for the connection and the greeting.

    Raises:
        OSError: No server listens at this address.
        ValueError: The address is malformed.
        ServerError: The server refuses the connection, for example because another host drives.
    """
    host, _, port = address.rpartition(":") if ":" in address else (address, "", "")
    if port and not port.isdecimal():
        raise ValueError(f"{address!r}: an address is HOST:PORT, for example 127.0.0.1:{PORT}.")
    host, number = host.strip("[]") or "127.0.0.1", int(port or PORT)
    try:
        wire = socket.create_connection((host, number), timeout)
    except ConnectionRefusedError:
        raise ConnectionRefusedError(
            f"nobody listens at {host}, port {number}. Start a server there: stage serve."
        ) from None
    try:
        client = Client(wire, observe)
        wire.settimeout(None)
    except BaseException:
        wire.close()
        raise
    return client


class _Requests(Generic[_W, _R]):
    """Methods for requests of bus cycles and time. A `Batch` collects the requests; a `Client` sends each one at once."""

    def _request_write(self, what: int, a: int, b: int = 0) -> _W:
        """Make or collect a request without an answer; `what` is its kind, `a` and `b` are its operands."""
        raise NotImplementedError

    def _request_read(self, what: int, a: int = 0, b: int = 0, times: int = 0, every: int = 0, mask: int = 0) -> _R:
        """Make or collect a request with an answer; see `Batch.add` for the parameters."""
        raise NotImplementedError

    def out8(self, port: int, value: int) -> _W:
        """Make a write cycle of 8 bits.

        Args:
            port: The port.
            value: The value, 0 to 255.
        """
        return self._request_write(OUT8, port, value)

    def in8(self, port: int) -> _R:
        """Make a read cycle of 8 bits."""
        return self._request_read(IN8, port)

    def out16(self, port: int, value: int) -> _W:
        """Make a write cycle of 16 bits.

        Args:
            port: The port of the low byte.
            value: The value, 0 to 65535.
        """
        return self._request_write(OUT16, port, value)

    def in16(self, port: int) -> _R:
        """Make a read cycle of 16 bits."""
        return self._request_read(IN16, port)

    def out32(self, port: int, value: int) -> _W:
        """Make two write cycles of 16 bits, the low half first.

        Args:
            port: The port of the lowest byte.
            value: The value of 32 bits.
        """
        return self._request_write(OUT32, port, value)

    def in32(self, port: int) -> _R:
        """Make two read cycles of 16 bits, the low half first."""
        return self._request_read(IN32, port)

    def delay_us(self, us: int) -> _W:
        """Let microseconds pass."""
        return self._request_write(DELAY, us)

    def spend_ns(self, ns: int) -> _W:
        """Let nanoseconds pass in which the host computes."""
        return self._request_write(SPEND, ns)

    def micros(self) -> _R:
        """Read the time, us since power-up, which takes a bus cycle."""
        return self._request_read(MICROS)

    def line(self) -> _R:
        """Read whether the interrupt line is asserted (1), which takes a bus cycle."""
        return self._request_read(LINE)

    def until8(self, port: int, mask: int, value: int, times: int, every_us: int = 0) -> _R:
        """Read 8 bits until (value read & mask) == value.

        Args:
            port: The port.
            mask: Mask of the bits to compare.
            value: The value to wait for.
            times: Largest number of reads.
            every_us: Time between two reads, us.

        Returns:
            The last value read.
        """
        return self._request_read(UNTIL8, port, value, times, every_us, mask)

    def until16(self, port: int, mask: int, value: int, times: int, every_us: int = 0) -> _R:
        """Read 16 bits until (value read & mask) == value.

        Args:
            port: The port of the low byte.
            mask: Mask of the bits to compare.
            value: The value to wait for.
            times: Largest number of reads.
            every_us: Time between two reads, us.

        Returns:
            The last value read.
        """
        return self._request_read(UNTIL16, port, value, times, every_us, mask)

    def until_line(self, us: int) -> _R:
        """Wait until the interrupt line is asserted, `us` at most; the answer is 1 if it is, else 0."""
        return self._request_read(UNTIL_LINE, us)

    def set_lines(self, axis: str, **levels: bool) -> _W:
        """Drive lines of a STEP/DIR axis at the end of one bus cycle.

        Args:
            axis: Name of the axis.
            **levels: Whether each named line is asserted: step=True, dir=False, enable=True.

        Raises:
            ValueError: The server's board has no such axis or line, a host can only read the line, or a level is no bool.
        """
        chip, bits = self.find_lines(axis, levels)
        for line, level in levels.items():
            if line not in DRIVEN_LINES:
                raise ValueError(f"{line!r} can only be read; a host drives {', '.join(DRIVEN_LINES)}.")
            if level not in (False, True):  # a text such as "low" would count as asserted
                raise ValueError(f"{line} = {level!r}: a line is asserted or not; give True or False.")
        asserted = _combine_bits(bit for bit, level in zip(bits, levels.values(), strict=True) if level)
        return self._request_write(SET_LINES, chip | WITH_CYCLE, _combine_bits(bits) << LINES_SHIFT | asserted)

    def read_lines(self, axis: str) -> _R:
        """Read the word of all lines of a STEP/DIR axis, in one bus cycle; `find_lines` returns their bits."""
        return self._request_read(READ_LINES, self.find_lines(axis)[0] | WITH_CYCLE)

    def watch_lines(self, axis: str, *lines: str) -> _W:
        """Watch lines of a STEP/DIR axis: assert the interrupt line while they have other levels than at this call.

        A hook calls this method again after it has handled the change.

        Args:
            axis: Name of the axis.
            *lines: Names of the lines, for example limit or origin; without names, stop watching.
        """
        chip, bits = self.find_lines(axis, lines)
        return self._request_write(WATCH_LINES, chip, _combine_bits(bits))

    def find_lines(self, axis: str, lines: Iterable[str] = ()) -> tuple[int, list[int]]:
        """Return the number of the chip of a STEP/DIR axis, and the bits of some of its lines.

        Raises:
            ValueError: The server's board has no such axis or line.
        """
        known = self.get_step_dir_lines().get(axis)
        if known is None:
            raise ValueError(
                f"{axis!r}: STEP/DIR axes of the server are {', '.join(self.get_step_dir_lines()) or 'none'}."
            )
        for line in lines:
            if line not in known["bits"]:
                raise ValueError(f"{line!r}: lines of axis {axis} are {', '.join(known['bits'])}.")
        return known["chip"], [known["bits"][line] for line in lines]

    def get_step_dir_lines(self) -> dict[str, Any]:
        """Return the lines of each STEP/DIR axis, as the server describes them."""
        raise NotImplementedError


class Batch(_Requests["Batch", "Batch"]):
    """Batch of requests that are sent together. The methods return the batch itself, so that calls can be chained."""

    def __init__(self, client: Client | None = None):
        self._client, self._entries = client, bytearray()
        self._reads: list[int] = []  # entries whose answers are returned

    def add(self, what: int, a: int = 0, b: int = 0, times: int = 0, every: int = 0, mask: int = 0) -> Batch:
        """Add a request of any kind.

        Args:
            what: Kind of the request: IN8, OUT8, ...
            a: First operand: a port, or a time in us or ns.
            b: Second operand: a value.
            times: Largest number of reads, for UNTIL8 and UNTIL16.
            every: Time between two reads, us.
            mask: Mask of the bits to compare, for UNTIL8 and UNTIL16.

        Returns:
            This batch.

        Raises:
            ValueError: A number does not fit its field.
        """
        try:
            entry = ENTRY.pack(what, times, every, mask, a, b)
        except struct.error:
            raise ValueError(
                f"a={a!r} b={b!r} times={times!r} every={every!r} mask={mask!r}: no such request."
            ) from None
        if what in READS:
            self._reads.append(len(self))
        self._entries += entry
        return self

    _request_write = _request_read = add

    def get_step_dir_lines(self) -> dict[str, Any]:
        """Return the lines of each STEP/DIR axis, as the server describes them."""
        if self._client is None:
            raise ValueError(NO_CONNECTION)
        return self._client.get_step_dir_lines()

    def __len__(self) -> int:
        return len(self._entries) // ENTRY.size

    def run(self) -> list[int]:
        """Send the requests and empty the batch. A batch that exceeds one frame is split into several.

        Returns:
            Answers to the requests that read, in order.

        Raises:
            ServerError: A request is invalid or has failed; requests of earlier frames were executed.
            ConnectionError: The server has closed the connection.
            ValueError: This batch belongs to no connection.
        """
        entries, reads = bytes(self._entries), list(self._reads)
        self._entries.clear()
        self._reads.clear()
        if self._client is None:
            raise ValueError(NO_CONNECTION)
        size, content = MAX_BODY // ENTRY.size * ENTRY.size, b""
        for k in range(0, len(entries), size):
            try:
                content += self._client.request(BATCH, entries[k : k + size])
            except ServerError as error:
                error.answers = (*_unpack_answers(content), *error.answers)
                raise
        answers = _unpack_answers(content)
        return [answers[k] for k in reads]


def _combine_bits(bits: Iterable[int]) -> int:
    """Return the bitwise OR of all words."""
    return reduce(or_, bits, 0)


def _unpack_answers(content: bytes) -> tuple[int, ...]:
    """Unpack the answers to a batch of requests from the body of its reply."""
    return struct.unpack(f"<{len(content) // ANSWER.size}q", content)


class Client(_Requests[None, int]):
    """Connection to a server; `connect` creates it.

    Attributes:
        about: Description of the server's board.
    """

    def __init__(self, wire: socket.socket, observe: bool = False):
        self._wire, self._number = wire, 0
        self._hooks: dict[int, Callable[[], None] | None] = {}
        self._failed: BaseException | None = None
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        reply = self.request(HELLO, GREETING.pack(MAGIC, VERSION, OBSERVE if observe else DRIVE))
        self.about: dict[str, Any] = json.loads(reply[WORD.size :])

    # --- bus and time ---

    def batch(self) -> Batch:
        """Return an empty batch of this connection."""
        return Batch(self)

    def _request_write(self, what: int, a: int, b: int = 0) -> None:
        self.batch().add(what, a, b).run()

    def _request_read(self, what: int, a: int = 0, b: int = 0, times: int = 0, every: int = 0, mask: int = 0) -> int:
        return self.batch().add(what, a, b, times, every, mask).run()[0]

    def line(self) -> bool:
        """Read whether the interrupt line is asserted, which takes a bus cycle."""
        return bool(super().line())

    def read_line(self, axis: str, line: str) -> bool:
        """Read whether a line of a STEP/DIR axis is asserted, such as limit_plus, in one bus cycle."""
        return bool(self.read_lines(axis) & self.find_lines(axis, [line])[1][0])

    def get_step_dir_lines(self) -> dict[str, Any]:
        """Return the lines of each STEP/DIR axis, as the server describes them."""
        return dict(self.about["lines"])

    def until_line(self, us: int) -> bool:
        """Wait until the interrupt line is asserted, `us` at most, and return whether it is."""
        return bool(super().until_line(us))

    def on_interrupt(self, hook: Callable[[], None] | None) -> None:
        """Call `hook` while the interrupt line is asserted: after a bus cycle, or inside a delay at the exact
        nanosecond. None removes it."""
        self._hooks[THE_LINE] = hook
        self.request(HOOK, WORD.pack(hook is not None))

    def on_timer(self, period_us: float, hook: Callable[[], None] | None, *, n: int = 0, level: int = 1) -> None:
        """Call a function periodically, exact to a nanosecond of simulated time.

        Args:
            period_us: Period, us; 0: the timer is off.
            hook: The function; None: the timer is off.
            n: Number of the timer, 0 to 3.
            level: Level of its interrupt, 1 to 15.

        Raises:
            ValueError: There is no such timer.
        """
        period = round(period_us * 1000) if hook is not None else 0
        self._hooks[FIRST_TIMER + n] = hook
        try:
            self.request(TIMER, TIMING.pack(n, level, period))
        except struct.error:
            raise ValueError(f"n={n!r} level={level!r} period_us={period_us!r}: no such timer.") from None

    def log(self, text: str) -> None:
        """Add a line to the log of the server."""
        self.request(LOG, text.encode())

    # --- the machine; no time passes ---

    def reset(self) -> None:
        """Pulse the reset pin of every chip."""
        self.request(RESET)

    def snapshot(self, name: str) -> None:
        """Store the current state on the server under a name."""
        self.request(SNAPSHOT, name.encode())

    def restore(self, name: str = "start") -> None:
        """Restore the state stored under a name; "start" is the state in which the server started."""
        self.request(RESTORE, name.encode())

    def status(self) -> Status:
        """Read time, bus cycles and the interrupt line."""
        now, cycles, line = STATUS_REPLY.unpack(self.request(STATUS))
        return Status(now * 1e-9, cycles, bool(line))

    def positions(self) -> dict[str, AxisPosition]:
        """Read the positions and lost steps of each axis, by the name of the axis."""
        places = PLACE.iter_unpack(self.request(POSITIONS))
        return {axis: AxisPosition(*place) for axis, place in zip(self.about["axes"], places, strict=True)}

    def pin(self, name: str) -> bool:
        """Read whether a pin of a chip ("x.irq") or a switch ("x.switches.org") is asserted."""
        return bool(ANSWER.unpack(self.request(PIN, name.encode()))[0])

    def stick(self, name: str, asserted: bool | None) -> None:
        """Make a switch stick, or clear this fault.

        Args:
            name: Axis and switch, for example "x.el_plus".
            asserted: True sticks asserted, False sticks released, None clears the fault.
        """
        self.request(STICK, WORD.pack(CLEARED if asserted is None else int(asserted)) + name.encode())

    # --- the wire ---

    def request(self, kind: int, body: bytes = b"") -> bytes:
        """Send a frame, and return the body of its reply.

        Args:
            kind: Kind of the frame: HELLO, BATCH, ...
            body: Body of the frame.

        Raises:
            ServerError: The server refuses the frame.
            ConnectionError: The server has ended, or this connection is closed.
            ValueError: The body is too long for a frame.
        """
        if len(body) > MAX_BODY:
            raise ValueError(f"a frame of {len(body):,} bytes; there are up to {MAX_BODY:,}.")
        self._number = number = (self._number + 1) & 0xFFFFFFFF
        self._send_bytes(HEAD.pack(len(body), kind, number) + body)
        while True:
            length, answered, _ = HEAD.unpack(self._receive_bytes(HEAD.size))
            reply = self._receive_bytes(length)
            if answered == INTERRUPT:
                self._call_hook(WORD.unpack(reply)[0])
            elif answered == ERROR:
                failed, self._failed = self._failed, None
                if failed is not None:
                    raise failed
                done = WORD.unpack_from(reply)[0]
                answers = struct.unpack_from(f"<{done}q", reply, WORD.size)
                raise ServerError(reply[WORD.size + 8 * done :].decode(errors="replace"), answers)
            else:
                return reply

    def _call_hook(self, source: int) -> None:
        """Call the hook of the interrupt line or of a timer, as the server's frame INTERRUPT demands, and send RETURN."""
        message = b""
        try:
            if (hook := self._hooks.get(source)) is not None:
                hook()
        except ConnectionError:
            raise
        except BaseException as error:  # goes on where the interrupted request was made
            self._failed, message = error, f"{type(error).__name__}: {error}".encode()
        self._send_bytes(HEAD.pack(len(message), RETURN, 0) + message)

    def _send_bytes(self, content: bytes) -> None:
        """Send all bytes. Raises ConnectionError if the server has ended."""
        try:
            self._wire.sendall(content)
        except TimeoutError:
            raise
        except OSError:
            raise self._make_error() from None

    def _make_error(self) -> ConnectionError:
        """Return the error for a connection that the server has closed."""
        who = "this connection is closed" if self._wire.fileno() < 0 else "the server has closed the connection"
        return ConnectionError(f"{who}. Make another one: connect().")

    def _receive_bytes(self, size: int) -> bytes:
        """Receive exactly `size` bytes. Raises ConnectionError if the server has ended."""
        content = bytearray()
        while len(content) < size:
            try:
                more = self._wire.recv(size - len(content))
            except TimeoutError:
                raise
            except OSError:
                more = b""
            if not more:
                raise self._make_error()
            content += more
        return bytes(content)

    def close(self) -> None:
        """Close the connection."""
        self._wire.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
