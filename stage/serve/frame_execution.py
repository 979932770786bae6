"""`FrameExecutor`: executes the frames of a host on a board, independently of sockets."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from stage import __version__
from stage.board import Board, HostError
from stage.board.bus.host_record import LAST_PORT, MAX_DELAY_US
from stage.board.bus.request_batch import ENTRY, find_first_invalid, resume_batch, run_batch
from stage.board.pin_assignment import DRIVEN_LINE_PINS, READ_LINE_PINS, has_line
from stage.errors import ArgumentError, StageError, unknown_name_error
from stage.serve import client
from stage.serve.frame_table import ENTRIES
from stage.sim.stage import Stage

START = "start"
MAX_SNAPSHOTS, MAX_NAME_BYTES, MAX_LINE_BYTES = 100, 100, 1 << 16
MAX_ENTRIES = client.MAX_BODY // client.ENTRY.size


class BatchError(StageError):
    """Error of a batch that could not be completed.

    Attributes:
        answers: Answers to the completed entries, i64 each.
    """

    def __init__(self, text: str, answers: bytes):
        super().__init__(text)
        self.answers = answers


class _BatchBuffers:
    """Memory for the entries and answers of a batch of requests.

    Args:
        n: Largest number of entries.
    """

    def __init__(self, n: int):
        self.entries, self.answers = np.zeros(n, ENTRY), np.zeros(n, np.int64)
        self.bytes = self.entries.view(np.uint8).data
        self.entries_at, self.answers_at = self.entries.ctypes.data, self.answers.ctypes.data


class FrameExecutor:
    """Executor of the frames that a host sends to a board, with the board's named snapshots.

    Args:
        board: The board.
        keep: Number of log lines that are kept.
        pause: Function that is called periodically within a long batch; an error that it raises ends the batch.
        hook: Function that is called while the interrupt line is asserted, and when a timer expires, if the host has asked for
            it. Its argument is the source as a frame INTERRUPT names it.
        report: Function that gets time (s) and text of each line that the host logs.

    Attributes:
        handlers: Functions that execute frames, by kind. Each takes the body and returns the body of the reply.
    """

    def __init__(
        self,
        board: Board,
        *,
        keep: int = 1_000_000,
        pause: Callable[[], None] = lambda: None,
        hook: Callable[[int], None] = lambda source: None,
        report: Callable[[float, str], None] = lambda seconds, text: None,
    ):
        self.board, self._keep, self._pause, self._hook, self._report = board, keep, pause, hook, report
        self._buffers, self._in_batch = _BatchBuffers(MAX_ENTRIES), False
        self._timers: dict[int, bytes] = {}
        self._snapshots: dict[str, Any] = {START: board.stage.snapshot()}
        self.handlers: dict[int, Callable[[bytes], bytes]] = {
            client.BATCH: self._execute_batch, client.LOG: self._add_log_line, client.HOOK: self._set_hook,
            client.RESET: self._reset_chips,
            client.SNAPSHOT: self._store_snapshot, client.RESTORE: self._restore_snapshot, client.STATUS: self._read_status,
            client.POSITIONS: self._read_positions, client.PIN: self._read_pin, client.STICK: self._stick_switch,
            client.TIMER: self._set_timer,
        }  # fmt: skip

    def describe_board(self) -> bytes:
        """Return a JSON description of the board for a host."""
        board = self.board
        chips = [
            {
                "chip": type(p.chip).__name__,
                "axes": board.join_axis_names(p.index),
                "port": p.first,
                "layout": p.layout.name,
            }
            for p in board.places
        ]
        axes = {name: axis.unit for name, axis in board.stage.axes.items()}
        devices = [{"device": device.name, "ports": list(device.ports)} for device in board.devices]
        bus_ns = round(board.stage.bus_cycle * 1e9)
        about = {
            "pulsestage": __version__, "axes": axes, "chips": chips, "devices": devices, "bus_cycle_ns": bus_ns,
            "lines": _describe_lines(board.stage),
        }  # fmt: skip
        return json.dumps(about).encode()

    def reset_to_start(self) -> None:
        """Restore the state in which the server started."""
        self._restore_snapshot(START.encode())

    def remove_hooks(self) -> None:
        """Remove the interrupt hook and the timers of a host that has disconnected."""
        self.board.on_interrupt(None)
        self.board.link.irqs["watched"] = 0
        self._timers.clear()
        for n in range(client.TIMERS):
            self.board.on_timer(0, None, n=n)

    # --- frames: body -> body of the reply ---

    def _execute_batch(self, body: bytes) -> bytes:
        """Execute the entries of a frame BATCH, and return the answers."""
        n, rest = divmod(len(body), client.ENTRY.size)
        if rest:
            raise ArgumentError(f"BATCH: {len(body)} bytes; an entry has {client.ENTRY.size}.")
        buffers = _BatchBuffers(n) if self._in_batch else self._buffers  # the outer batch is not done yet
        buffers.bytes[: len(body)] = body
        wrong = find_first_invalid.with_gil(buffers.entries_at, n, len(self.board.stage.chips))
        if wrong < n:
            raise ArgumentError(
                f"BATCH, entry {wrong}: {_describe_wrong_entry(buffers.entries[wrong])}. Nothing of this batch was done."
            )
        link, before = self.board.link, (self._in_batch, self.board.link.pause)
        self._in_batch, link.pause = True, self._pause_batch
        try:
            link.begin_run()
            done = run_batch.c(link.pointer, buffers.entries_at, n, buffers.answers_at, n)
            link.end_run()
        finally:
            self._in_batch, link.pause = before
        try:
            link.raise_error()
        except Exception as error:
            raise BatchError(describe_error(error), buffers.answers[: max(done, 0)].tobytes()) from error
        if done < n:
            raise StageError("this board is in use by another thread: a bus has one host at a time.")
        return buffers.answers[:n].tobytes()

    def _pause_batch(self) -> None:
        """Call the server's `pause` during a batch. Compiled code calls this method periodically."""
        link = self.board.link
        if not link.record["stopped"]:
            try:
                self._pause()
            except BaseException as error:
                link.set_error(error)
        resume_batch.c(link.pointer)

    def _add_log_line(self, body: bytes) -> bytes:
        if len(body) > MAX_LINE_BYTES:
            raise ArgumentError(f"LOG: {len(body):,} bytes; a line has up to {MAX_LINE_BYTES:,}.")
        log = self.board.log
        self.board.add_log_line(_make_printable(body.decode(errors="replace")))
        self._report(*log[-1])
        if len(log) > self._keep + self._keep // 4:
            del log[: len(log) - self._keep]
        return b""

    def _set_hook(self, body: bytes) -> bytes:
        on = _parse_word("HOOK", body, (0, 1))
        self.board.on_interrupt(partial(self._hook, client.THE_LINE) if on else None)
        return b""

    def _set_timer(self, body: bytes) -> bytes:
        if len(body) != client.TIMING.size:
            raise ArgumentError(f"TIMER: {len(body):,} bytes; it has {client.TIMING.size}.")
        n, level, period = client.TIMING.unpack(body)
        if not 0 <= period <= MAX_DELAY_US * 1000:
            raise ArgumentError(f"TIMER: a period of {period} ns; there are 1 to 1e18, and 0 for off.")
        self.board.on_timer(period / 1000, partial(self._hook, client.FIRST_TIMER + n), n=n, level=level)
        self._timers[n] = body
        return b""

    def _reset_chips(self, body: bytes) -> bytes:
        _check_body_is_empty("RESET", body)
        for chip in self.board.stage.chips:
            chip.reset()
        return b""

    def _store_snapshot(self, body: bytes) -> bytes:
        name = _parse_text("SNAPSHOT", body)
        if name == START:
            raise ArgumentError(f"SNAPSHOT: {START!r} is the state with which the server began; choose another name.")
        if name not in self._snapshots and len(self._snapshots) > MAX_SNAPSHOTS:
            raise ArgumentError(f"SNAPSHOT: {MAX_SNAPSHOTS} are kept; use one of these names again.")
        self._snapshots[name] = self.board.stage.snapshot()
        return b""

    def _restore_snapshot(self, body: bytes) -> bytes:
        name, board = _parse_text("RESTORE", body), self.board
        if name not in self._snapshots:
            raise unknown_name_error("snapshot", name, self._snapshots)
        if board.link.record["serving"]:
            raise StageError("RESTORE: not from within an interrupt hook.")
        board.stage.restore(self._snapshots[name])
        board.port_table["read_line"] = 0  # a read from now on is a line of its own in the trace
        for timer in list(self._timers.values()):  # they begin anew
            self._set_timer(timer)
        return b""

    def _read_status(self, body: bytes) -> bytes:
        _check_body_is_empty("STATUS", body)
        board = self.board
        return client.STATUS_REPLY.pack(board.stage.now, board.cycles, board.interrupt)

    def _read_positions(self, body: bytes) -> bytes:
        _check_body_is_empty("POSITIONS", body)
        axes = self.board.stage.axes.values()
        return b"".join(client.PLACE.pack(a.position, a.commanded, a.lost_steps) for a in axes)

    def _read_pin(self, body: bytes) -> bytes:
        axis_name, name, of_switches = _split_pin_path(_parse_text("PIN", body))
        axis = self._find_axis(axis_name)
        if of_switches:
            axis.switches.find_index(name)  # raises for an unknown one
            return client.ANSWER.pack(getattr(axis.switches, name))
        pins: dict[str, bool] = {**getattr(axis.chip, "pins", axis.pins).as_dict(), **axis.pins.as_dict()}
        if name not in pins:
            raise unknown_name_error(
                f"pin of axis {axis_name}", name, (*pins, *(f"switches.{s}" for s in axis.switches.as_dict()))
            )
        return client.ANSWER.pack(pins[name])

    def _stick_switch(self, body: bytes) -> bytes:
        state = _parse_word("STICK", body[: client.WORD.size], (client.RELEASED, client.ASSERTED, client.CLEARED))
        axis, name, _ = _split_pin_path(_parse_text("STICK", body[client.WORD.size :]))
        self._find_axis(axis).switches.stick(name, None if state == client.CLEARED else state == client.ASSERTED)
        return b""

    def _find_axis(self, name: str) -> Any:
        """Return the axis with a name. Raises ArgumentError for an unknown name."""
        axes = self.board.stage.axes
        if name not in axes:
            raise ArgumentError(f"{unknown_name_error('axis', name, axes)} Write AXIS.PIN or AXIS.switches.SWITCH.")
        return axes[name]


def _describe_lines(stage: Stage) -> dict[str, Any]:
    """Return the chip of each STEP/DIR axis, and the bits of its lines in the chip's input word."""
    chips = list(stage.chips)
    return {
        name: {
            "chip": chips.index(axis.chip),
            "bits": {
                line: sum(axis.chip.INPUTS[pin] for pin in pins)
                for line, pins in (DRIVEN_LINE_PINS | READ_LINE_PINS).items()
                if has_line(axis.chip, line)
            },
        }
        for name, axis in stage.axes.items()
        if "step" in axis.chip.INPUTS
    }


def _split_pin_path(text: str) -> tuple[str, str, bool]:
    """Split AXIS.PIN or AXIS.switches.SWITCH into the axis, the name, and whether it is a switch. An axis name may contain dots."""
    axis, _, name = text.rpartition(".") if "." in text else (text, "", "")
    of_switches = axis.endswith(".switches")
    return axis.removesuffix(".switches") if of_switches else axis, name, of_switches


def describe_error(error: BaseException) -> str:
    """Describe an error to a host: its text, and its type unless it is one of the project's own errors."""
    return str(error) if isinstance(error, StageError | HostError) else f"{type(error).__name__}: {error}"


def _describe_wrong_entry(entry: Any) -> str:
    """Explain what is invalid in an entry of a batch of requests."""
    what = int(entry["what"])
    names = {number: name for number, name, *_ in ENTRIES}
    if what not in names:
        return f"{what} is no request; those of a batch are {', '.join(f'{n} {name}' for n, name in names.items())}"
    a, b, name = int(entry["a"]), int(entry["b"]), names[what]
    if what in (client.SET_LINES, client.READ_LINES, client.WATCH_LINES):
        lines = ", with lines step, dir and enable only" if what == client.SET_LINES else ""
        return f"{name} at chip {a & ~client.WITH_CYCLE}, b = {b}; the text of HELLO has the chips, and b is 0 or more{lines}"
    if what in (client.DELAY, client.UNTIL_LINE):
        return f"{name} {a} us; there are 0 to 1e15 us"
    if what == client.SPEND:
        return f"{name} {a} ns; there are 0 to 1e18 ns"
    if not 0 <= a <= LAST_PORT:
        return f"{name} at port {a}; ports are 0 to {LAST_PORT:X}h"
    if what in (client.UNTIL8, client.UNTIL16):
        return f"{name} {int(entry['times'])} times, every {int(entry['every'])} us; it takes 1 time or more, every 0 us or more"
    return f"{name} {a:03X}h <- {b}; the value does not fit the cycle"


def _parse_word(frame: str, body: bytes, known: tuple[int, ...]) -> int:
    """Parse the body of a frame as a u32 that is one of the `known` values. Raises ArgumentError for anything else."""
    try:
        value = client.WORD.unpack(body)[0]
    except struct.error:
        value = None
    if value not in known:
        text = "no u32" if value is None else value
        raise ArgumentError(f"{frame}: {text}; it takes one of {', '.join(map(str, known))}.")
    return value


def _parse_text(frame: str, body: bytes) -> str:
    """Parse the body of a frame as a short UTF-8 text. Raises ArgumentError for anything else."""
    if not 0 < len(body) <= MAX_NAME_BYTES:
        raise ArgumentError(f"{frame}: a name of {len(body):,} bytes; it has 1 to {MAX_NAME_BYTES}.")
    try:
        return body.decode()
    except UnicodeDecodeError:
        raise ArgumentError(f"{frame}: a name that is no UTF-8.") from None


def _make_printable(line: str) -> str:
    """Escape control characters except tabs, because they could affect the terminal that shows the line."""
    return "".join(c if c.isprintable() or c == "\t" else ascii(c)[1:-1] for c in line.rstrip("\r\n"))


def _check_body_is_empty(frame: str, body: bytes) -> None:
    """Raise ArgumentError if the body of a frame is not empty."""
    if body:
        raise ArgumentError(f"{frame}: {len(body):,} bytes; it has no body.")
