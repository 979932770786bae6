"""What the frames of a host do to a board. Knows no sockets."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from stage import __version__
from stage.board import Board, HostError
from stage.board.bus.batch import ENTRY, first_wrong, go_on, run_batch
from stage.board.bus.host_record import LAST_PORT, MAX_DELAY_US
from stage.errors import ArgumentError, StageError, unknown
from stage.serve import client
from stage.serve.frames import ENTRIES

START = "start"
MOST_SNAPSHOTS, LONGEST_NAME, LONGEST_LINE = 100, 100, 1 << 16
MOST_ENTRIES = client.MOST_BODY // client.ENTRY.size


class BatchError(StageError):
    """A batch that could not be done to the end. `answers`: of the entries that were, i64 each."""

    def __init__(self, text: str, answers: bytes):
        super().__init__(text)
        self.answers = answers


class _Room:
    """For the entries and answers of a batch of up to `n`. bytes: the entries as they come; asked, answered: addresses."""

    def __init__(self, n: int):
        self.entries, self.answers = np.zeros(n, ENTRY), np.zeros(n, np.int64)
        self.bytes = self.entries.view(np.uint8).data
        self.asked, self.answered = self.entries.ctypes.data, self.answers.ctypes.data


class Machine:
    """A board and the states of it that have names.

    keep: lines of the log that are kept. pause: called now and then within a long batch; what it raises ends the batch. hook:
    called while the interrupt line is asserted, and for timers, if the host wants it; with what INTERRUPT says. told: gets each
    line that the host logs.
    """

    def __init__(
        self,
        board: Board,
        *,
        keep: int = 1_000_000,
        pause: Callable[[], None] = lambda: None,
        hook: Callable[[int], None] = lambda source: None,
        told: Callable[[float, str], None] = lambda seconds, text: None,
    ):
        self.board, self._keep, self._pause, self._hook, self._told = board, keep, pause, hook, told
        self._room, self._in_batch = _Room(MOST_ENTRIES), False
        self._timers: dict[int, bytes] = {}
        self._states: dict[str, Any] = {}
        self._keep_state(START)
        self.does: dict[int, Callable[[bytes], bytes]] = {
            client.BATCH: self._batch, client.LOG: self._log, client.HOOK: self._hook_on, client.RESET: self._reset,
            client.SNAPSHOT: self._snapshot, client.RESTORE: self._restore, client.STATUS: self._status,
            client.POSITIONS: self._positions, client.PIN: self._pin, client.STICK: self._stick,
            client.TIMER: self._timer,
        }  # fmt: skip

    def about(self) -> bytes:
        """What a host is told of the board, JSON."""
        board = self.board
        chips = [
            {"chip": type(p.chip).__name__, "axes": board.name_of(p.index), "port": p.first, "layout": p.layout.name}
            for p in board.places
        ]
        axes = {name: axis.unit for name, axis in board.stage.axes.items()}
        devices = [{"device": device.name, "ports": list(device.ports)} for device in board.devices]
        about = {
            "pulsestage": __version__,
            "axes": axes,
            "chips": chips,
            "devices": devices,
            "bus_cycle_ns": round(board.stage.bus_cycle * 1e9),
        }
        return json.dumps(about).encode()

    def fresh(self) -> None:
        """Back to the state of the start."""
        self._restore(START.encode())

    def let_go(self) -> None:
        """The host is gone: nobody is called by the interrupt line or a timer."""
        self.board.on_interrupt(None)
        self._timers.clear()
        for n in range(client.TIMERS):
            self.board.on_timer(0, None, n=n)

    # --- frames: body -> body of the reply ---

    def _batch(self, body: bytes) -> bytes:
        n, rest = divmod(len(body), client.ENTRY.size)
        if rest:
            raise ArgumentError(f"BATCH: {len(body)} bytes; an entry has {client.ENTRY.size}.")
        room = _Room(n) if self._in_batch else self._room  # the outer batch is not done yet
        room.bytes[: len(body)] = body
        wrong = first_wrong.with_gil(room.asked, n)
        if wrong < n:
            raise ArgumentError(
                f"BATCH, entry {wrong}: {_in_words(room.entries[wrong])}. Nothing of this batch was done."
            )
        link, before = self.board.link, (self._in_batch, self.board.link.pause)
        self._in_batch, link.pause = True, self._stand_still
        try:
            link.begin()
            done = run_batch.c(link.pointer, room.asked, n, room.answered, n)
            link.end()
        finally:
            self._in_batch, link.pause = before
        try:
            link.raise_error()
        except Exception as error:
            raise BatchError(said(error), room.answers[: max(done, 0)].tobytes()) from error
        if done < n:
            raise StageError("this board is in use by another thread: a bus has one host at a time.")
        return room.answers[:n].tobytes()

    def _stand_still(self) -> None:
        """Called by compiled code."""
        link = self.board.link
        if not link.record["stopped"]:
            try:
                self._pause()
            except BaseException as error:
                link.fail(error)
        go_on.c(link.pointer)

    def _log(self, body: bytes) -> bytes:
        if len(body) > LONGEST_LINE:
            raise ArgumentError(f"LOG: {len(body):,} bytes; a line has up to {LONGEST_LINE:,}.")
        log = self.board.log
        self.board.note(_printable(body.decode(errors="replace")))
        self._told(*log[-1])
        if len(log) > self._keep + self._keep // 4:
            del log[: len(log) - self._keep]
        return b""

    def _hook_on(self, body: bytes) -> bytes:
        on = _word("HOOK", body, (0, 1))
        self.board.on_interrupt(partial(self._hook, client.THE_LINE) if on else None)
        return b""

    def _timer(self, body: bytes) -> bytes:
        if len(body) != client.TIMING.size:
            raise ArgumentError(f"TIMER: {len(body):,} bytes; it has {client.TIMING.size}.")
        n, level, period = client.TIMING.unpack(body)
        if not 0 <= period <= MAX_DELAY_US * 1000:
            raise ArgumentError(f"TIMER: a period of {period} ns; there are 1 to 1e18, and 0 for off.")
        self.board.on_timer(period / 1000, partial(self._hook, client.FIRST_TIMER + n), n=n, level=level)
        self._timers[n] = body
        return b""

    def _reset(self, body: bytes) -> bytes:
        _empty("RESET", body)
        for chip in self.board.stage.chips:
            chip.reset()
        return b""

    def _snapshot(self, body: bytes) -> bytes:
        name = _text("SNAPSHOT", body)
        if name == START:
            raise ArgumentError(f"SNAPSHOT: {START!r} is the state with which the server began; choose another name.")
        if name not in self._states and len(self._states) > MOST_SNAPSHOTS:
            raise ArgumentError(f"SNAPSHOT: {MOST_SNAPSHOTS} are kept; use one of these names again.")
        self._keep_state(name)
        return b""

    def _keep_state(self, name: str) -> None:
        self._states[name] = self.board.stage.snapshot()

    def _restore(self, body: bytes) -> bytes:
        name, board = _text("RESTORE", body), self.board
        if name not in self._states:
            raise unknown("snapshot", name, self._states)
        if board.link.record["serving"]:
            raise StageError("RESTORE: not from within an interrupt hook.")
        board.stage.restore(self._states[name])
        board.port_table["read_line"] = 0  # a read from now on is a line of its own in the trace
        for timer in list(self._timers.values()):  # they begin anew
            self._timer(timer)
        return b""

    def _status(self, body: bytes) -> bytes:
        _empty("STATUS", body)
        board = self.board
        return client.STANDING.pack(board.stage.now, board.cycles, board.interrupt)

    def _positions(self, body: bytes) -> bytes:
        _empty("POSITIONS", body)
        axes = self.board.stage.axes.values()
        return b"".join(client.PLACE.pack(a.position, a.commanded, a.lost_steps) for a in axes)

    def _pin(self, body: bytes) -> bytes:
        text = _text("PIN", body)
        axis, name, of_switches = _split_place(text)
        pins: Any = self._axis(axis).pins
        if of_switches:
            found = self._axis(axis).switches
            found.row(name)  # says which there are
            return client.ANSWER.pack(getattr(found, name))
        both = {**getattr(self._axis(axis).chip, "pins", pins).as_dict(), **pins.as_dict()}
        if name not in both:
            raise unknown(
                f"pin of axis {axis}", name, (*both, *(f"switches.{s}" for s in self._axis(axis).switches.as_dict()))
            )
        return client.ANSWER.pack(both[name])

    def _stick(self, body: bytes) -> bytes:
        how = _word("STICK", body[: client.WORD.size], (client.RELEASED, client.ASSERTED, client.MENDED))
        axis, name, _ = _split_place(_text("STICK", body[client.WORD.size :]))
        switches = self._axis(axis).switches
        switches.stick(name, None if how == client.MENDED else how == client.ASSERTED)
        return b""

    def _axis(self, name: str) -> Any:
        axes = self.board.stage.axes
        if name not in axes:
            raise ArgumentError(f"{unknown('axis', name, axes)} Write AXIS.PIN or AXIS.switches.SWITCH.")
        return axes[name]


def _split_place(text: str) -> tuple[str, str, bool]:
    """Split AXIS.PIN or AXIS.switches.SWITCH: axis, name and whether it is a switch. The name of an axis may have dots."""
    axis, _, name = text.rpartition(".") if "." in text else (text, "", "")
    of_switches = axis.endswith(".switches")
    return axis.removesuffix(".switches") if of_switches else axis, name, of_switches


def said(error: BaseException) -> str:
    """An error in words for a host."""
    return str(error) if isinstance(error, StageError | HostError) else f"{type(error).__name__}: {error}"


def _in_words(entry: Any) -> str:
    what = int(entry["what"])
    names = {number: name for number, name, *_ in ENTRIES}
    if what not in names:
        return f"{what} is no request; those of a batch are {', '.join(f'{n} {name}' for n, name in names.items())}"
    a, b, name = int(entry["a"]), int(entry["b"]), names[what]
    if what in (client.DELAY, client.UNTIL_LINE):
        return f"{name} {a} us; there are 0 to 1e15 us"
    if what == client.SPEND:
        return f"{name} {a} ns; there are 0 to 1e18 ns"
    if not 0 <= a <= LAST_PORT:
        return f"{name} at port {a}; ports are 0 to {LAST_PORT:X}h"
    if what in (client.UNTIL8, client.UNTIL16):
        return f"{name} {int(entry['times'])} times, every {int(entry['every'])} us; it takes 1 time or more, every 0 us or more"
    return f"{name} {a:03X}h <- {b}; the value does not fit the cycle"


def _word(frame: str, body: bytes, known: tuple[int, ...]) -> int:
    try:
        value = client.WORD.unpack(body)[0]
    except struct.error:
        value = None
    if value not in known:
        given = "no u32" if value is None else value
        raise ArgumentError(f"{frame}: {given}; it takes one of {', '.join(map(str, known))}.")
    return value


def _text(frame: str, body: bytes) -> str:
    if not 0 < len(body) <= LONGEST_NAME:
        raise ArgumentError(f"{frame}: a name of {len(body):,} bytes; it has 1 to {LONGEST_NAME}.")
    try:
        return body.decode()
    except UnicodeDecodeError:
        raise ArgumentError(f"{frame}: a name that is no UTF-8.") from None


def _printable(line: str) -> str:
    """One line without what would control the terminal of whoever reads it; a tab stays."""
    return "".join(c if c.isprintable() or c == "\t" else ascii(c)[1:-1] for c in line.rstrip("\r\n"))


def _empty(frame: str, body: bytes) -> None:
    if body:
        raise ArgumentError(f"{frame}: {len(body):,} bytes; it has no body.")
