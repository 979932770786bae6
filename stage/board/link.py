"""`Link`: connects a board to compiled code: the HOST record, the work before and after each run, the calls back into Python.

For runners of firmware; a program that drives a board from Python does not need it.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.board.bus import host_record, requests
from stage.board.errors import HostError, StormError
from stage.board.interrupt_hooks import Hooks
from stage.board.windows import explain_missing
from stage.errors import StageError
from stage.native import plain
from stage.sim import handle, records

if TYPE_CHECKING:
    from stage.board.board import Board
    from stage.board.isolation.traps.memory import Windows

NOTED = 1 << 14  # edges and writes between two calls of Python
MOST = 1 << 62
WAIT_S = 0.05  # of real time, in which threads without a mutex meet on the bus
UPCALL = ctypes.CFUNCTYPE(None, ctypes.c_int64)


class Link:
    """Of one board.

    Attributes:
        record: its HOST record; pointer: the address of the record, for compiled code.
        request: the compiled function for all requests of a host: (pointer, what, a, b) -> answer.
        error: the exception of a call from compiled code, until `raise_error`.
        hooks: Python's interrupt hooks, and the table of the interrupt controller.
        windows: those of the firmware that runs.
        answering: the device in Python that answers a bus cycle now, or None.
        stand_still: the function by which firmware in a thread of its own waits, while it runs.
        abandoned: threads of firmware that was given up.
        firmware_thread: the identifier of the firmware's own thread; has_other_threads: whether others of it have made bus cycles.
        calls: counts the calls from compiled code into Python, at their begin and at their end: odd within a call.
    """

    def __init__(self, board: Board):
        self.board, self.stage = board, board.stage
        self.calls = 0
        self.firmware_thread, self.has_other_threads = 0, False
        self.error: BaseException | None = None
        self.windows: Windows | None = None
        self.answering: Any = None
        self.stand_still: Callable[[], None] | None = None
        self.abandoned: set[threading.Thread] = set()
        self._left: list[np.ndarray] = []
        self._call = UPCALL(self._called)
        self.request: Any = requests.request.pointer
        self._lay_out()
        self.hooks = Hooks(self)

    @property
    def traced(self) -> int:
        """Lines that went into the bus trace so far."""
        return int(self.record["traced"])

    def _lay_out(self) -> None:
        """The HOST record, and the arrays that it points to."""
        stage = self.stage
        if len(stage.state.edges) < NOTED:
            stage.state.set_edge_buffer(np.zeros(NOTED, records.EDGE))
        self._rows = np.zeros(1, host_record.HOST)
        self.move_to(self._rows)
        h = self.record
        handle.fill(self._rows, 0, stage.state)
        self.irqs = np.zeros(len(stage.chips), host_record.IRQ)
        self._acts = np.zeros(len(stage.chips), np.int64)
        for k, chip in enumerate(stage.chips):
            axis, bits = chip.IRQ
            self.irqs[k] = (axis % (chip.AXES + 1), bits)
            self._acts[k] = np.uint64(sum(1 << a for a in chip.READING_ACTS)).astype(np.int64)
        words = stage.state.userdata
        self._before = np.zeros(len(words))
        for name, array in (
            ("edges", stage.state.edges),
            ("lines", self.board.trace.kept), ("irqs", self.irqs), ("acts", self._acts), ("userdata", words),
            ("before", self._before),
        ):  # fmt: skip
            h[name] = array.ctypes.data
        self.lay_ports()
        h["edge_room"] = len(stage.state.edges)
        h["line_room"], h["words"] = self.board.trace.room, len(words)
        h["until"] = h["most_cycles"] = MOST
        h["journals"] = 1
        self.lay_devices()
        h["call"] = ctypes.cast(self._call, ctypes.c_void_p).value

    def lay_ports(self) -> None:
        """The ports reach something else from now on."""
        board, h = self.board, self.record
        h["regions"], h["ports"] = board.regions.ctypes.data, board.port_table.ctypes.data
        h["n_regions"], h["n_ports"] = len(board.regions), len(board.port_table)

    def lay_devices(self) -> None:
        """The devices of the board, for compiled code."""
        rows = [device.row() for device in self.board.devices]
        self._devices = np.array(rows, host_record.DEVICE_TABLE)
        self.record["devices"], self.record["n_devices"] = self._devices.ctypes.data, len(rows)

    def check_is_current(self) -> None:
        """Raise StageError for a board in whose place another has come: each would hold time and interrupts for its own."""
        if self.stage.host is None or self.stage.host.board is not self.board:
            raise StageError(
                "this board's stage has got another board since, and a stage has one: go on with that, or make the other on a "
                "copy, Board(copy.copy(stage))."
            )

    def begin(self) -> None:
        """Prepare for compiled code: what it may have to write to, and whom it has to ask. Raises as `check_is_current`."""
        self.check_is_current()
        stage, h = self.stage, self.record
        stage.ensure_powered()
        stage.loop.check_options()
        asks = 0
        for k, chip in enumerate(stage.chips):
            if chip.glitches:
                asks |= 1 << k
        h["asks"], h["reached"] = asks, stage.now
        handle.set_sample_buffers(h, stage.loop.recording)

    def end(self) -> None:
        """After compiled code has run: what it noted goes to journals and recording."""
        stage, h = self.stage, self.record
        if n := int(h["noted"]):
            h["noted"] = 0
            self.take_edges(n)
        if (recording := stage.loop.recording) is not None:
            recording.take(int(h["filled"]))
            h["filled"] = recording.filled

    def take_edges(self, n: int) -> None:
        """The first `n` of what was noted go to journals, and a lint looks at the writes."""
        self.stage.loop.journal_edges(n)
        for chip in self.stage.chips:
            if chip.journal_lint is not None:
                chip.journal_lint.limit_memory()

    def loses(self, chip: int, address: int, value: int) -> bool:
        """Whether a fault of the bus keeps this write from its chip."""
        return self.stage.chips[chip].loses(address, value)

    def call_device(self, k: int, n: int, way: int, value: int) -> int:
        """A cycle reaches port `n` of device `k`, which is written in Python."""
        device = self.board.devices[k]
        self.answering, loop = device, self.stage.loop
        loop.time_refusal = (
            f"{device.name} answers a bus cycle: within it no time passes, and the stage stays in its state. "
            "Do it later."
        )
        try:
            return device.call(n, way, value)
        finally:
            self.answering, loop.time_refusal = None, ""

    def ask(self, what: int, a: int, b: int) -> int:
        """One request of a host in Python."""
        lock = self.stage.loop.lock
        if lock is None:
            return self._ask(what, a, b)
        with lock:
            return self._ask(what, a, b)

    def _ask(self, what: int, a: int, b: int) -> int:
        if self.answering is not None:
            raise StageError(f"{self.answering.name} answers a bus cycle: it can make none itself, and no time passes.")
        self.stage.loop.check_time_allowed()
        self.begin()
        answer = int(self.request(self.pointer, what | host_record.FROM_PYTHON, int(a), int(b)))
        if answer == host_record.TWO_AT_ONCE:
            raise StageError("this board is in use by another thread: a bus has one host at a time.")
        self.end()
        self.raise_error()
        return answer

    def raise_error(self) -> None:
        """Raise what went wrong below compiled code."""
        if self.error is not None:
            error, self.error = self.error, None
            self.record["stopped"] = 0
            raise error

    def _called(self, reason: int) -> None:
        """Compiled code calls, see stage.board.bus.host_record."""
        if threading.current_thread() in self.abandoned:
            threading.Event().wait()
        if (lock := self.stage.loop.lock) is None:
            self._answer_call(reason)
        else:  # the thread that runs the firmware has the lock, and waits
            with lock.acting_for_owner():
                self._answer_call(reason)
        if self.stand_still is not None and (reason == host_record.PAUSE or self.record["stopped"]):
            self.stand_still()

    def _answer_call(self, reason: int) -> None:
        self.calls += 1
        try:
            self.end()
            if reason == host_record.DIVERGED:
                self._diverged()
            elif reason == host_record.STORM:
                raise StormError(f"{self.hooks.storm(int(self.record['asked']))}\n{self.board.trace.text(8)}")
            elif reason == host_record.REFUSED:
                h = self.record
                raise HostError(self.hooks.refused(int(h["asked_chip"]), int(h["asked_address"]), int(h["asked"])))
            elif reason == host_record.TWICE:
                raise HostError(
                    "two threads of the firmware made bus cycles at the same time, or a handler of signals (setitimer, alarm) made "
                    f"one in the middle of another, at {self.stage.time:.6f} s: a bus has one host at a time. Guard the cycles of "
                    "threads by a mutex; timers of the board are ps_timer and ps_on_timer (docs/interrupts.md)."
                )
            elif reason == host_record.ANOTHER_STACK:
                self._wait_for_others()
            elif reason == host_record.LINE_OF_LOG and not self.record["asked"]:
                raise HostError(f"ps_log(0), at {self.stage.time:.6f} s: a null pointer is no text.")
            elif reason == host_record.LINE_OF_LOG:
                self.board.note(ctypes.string_at(int(self.record["asked"])).decode(errors="replace"))
            elif reason == host_record.ASKED_WRITE:
                h = self.record
                h["asked"] = self.loses(int(h["asked_chip"]), int(h["asked_address"]), int(h["asked"]))
            elif reason == host_record.ABOUT_WINDOW:
                self._about_window()
            elif reason == host_record.DEVICE_CALLED:
                h = self.record
                k, n, way, value = (int(h[name]) for name in ("asked_chip", "asked_address", "asked_way", "asked"))
                try:
                    h["asked"] = self.call_device(k, n, way, value)
                except BaseException:
                    self._note_raised(k, n, way, value)
                    raise
            elif reason == host_record.BY_HAND:
                self.stage.run_to(int(self.record["asked"]))
            self.begin()
        except BaseException as error:
            self.fail(error)
        self.calls += 1

    def _wait_for_others(self) -> None:
        """Another thread than the firmware's own makes a bus cycle: one that does so meanwhile is an error, unless a mutex holds it
        back. Without this wait short threads would miss each other in most runs, and would meet in some."""
        if threading.get_ident() == self.firmware_thread:  # a coroutine, or a handler of signals on a stack of its own
            return
        if not self.has_other_threads:
            self.has_other_threads = True
            self.board.note(
                "bus cycles come from several threads of the firmware: "
                "their order is one of real time, and no two runs need be alike"
            )
        time.sleep(WAIT_S)

    def _note_raised(self, k: int, n: int, way: int, value: int) -> None:
        """The cycle that a device in Python has failed in is a line of the trace, too: the last one."""
        h, kept, reads = self.record, self.board.trace.kept, way in (host_record.IN8, host_record.IN16)
        now = self.stage.now + int(h["ahead"])
        seen = (0xFF if way == host_record.IN8 else 0xFFFF) if reads else value
        kept[self.traced % len(kept)] = (now, now, 1, way | host_record.RAISED, self.board.devices[k].port(n), seen)
        h["traced"] += 1
        h["changed"] = h["traced"]

    def _about_window(self) -> None:
        """The firmware wants a window, or touches one in a way that is no bus cycle."""
        h = self.record
        what, a, b = (int(h[name]) for name in ("asked_chip", "asked", "asked_address"))
        if self.windows is None:
            raise HostError(f"ps_window({a:#x}, {b:#x}): {explain_missing(isolated=False)}")
        if what != host_record.WINDOW:
            raise self.windows.explain_refusal(what, a, b)
        h["asked"] = self.windows.choose(a, b)

    def _diverged(self) -> None:
        error = self.stage.loop.undo_divergence(self.pointer)
        self.end()
        raise error

    def fail(self, error: BaseException) -> None:
        """Nothing more happens on this bus until somebody was told."""
        self.record["stopped"] = 1
        if self.error is None:
            self.error = error

    def abandon(self, thread: threading.Thread) -> None:
        """Keep a thread of firmware, which may still run, from this board for ever: it has a HOST record that is stopped, and the
        board goes on with a copy."""
        self.abandoned.add(thread)
        self.record["stopped"] = 1
        self._left.append(self._rows)
        self.move_to(self._rows.copy())
        self.record["stopped"] = self.record["inside"] = self.record["in_python"] = 0
        self.hooks.move_to(self.hooks.sources.copy())
        self.hooks.without_firmware()
        self.stand_still = None

    def settle(self) -> None:
        """After firmware without bus cycles was given up: takes the notes of its last cycles; the stage keeps its state."""
        self.end()
        self.begin()
        self.request(self.pointer, host_record.SETTLE, 0, 0)
        self.end()

    def move_to(self, rows: np.ndarray) -> None:
        """From now on the HOST record is that in `rows`, of one."""
        rows[:] = self._rows
        self._rows, self.pointer = rows, rows.ctypes.data
        rows["own"] = self.pointer
        self.record = rows.view(plain(host_record.HOST))[0]
