"""`Link`: the connection of a board to compiled code: the HOST record, the work before and after each run, and calls
back into Python.

It serves the runners of firmware. A Python program that drives a board uses the methods of `Board` instead.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.board.bus import host_record, host_requests
from stage.board.errors import HostError, StormError
from stage.board.interrupt_hooks import PythonInterruptHooks
from stage.board.memory_mapped_ports import explain_missing_windows
from stage.errors import StageError
from stage.native import get_function_address, remove_attribute_access
from stage.sim import compiled_stage_access, engine_records

if TYPE_CHECKING:
    from stage.board.board import Board
    from stage.board.isolation.traps.memory_windows import MemoryWindows

NOTE_BUFFER_ROWS = 1 << 14  # edges and writes between two calls of Python
UNBOUNDED = 1 << 62
THREAD_WAIT_S = 0.05  # of real time, in which threads without a mutex meet on the bus
UPCALL = ctypes.CFUNCTYPE(None, ctypes.c_int64)


class Link:
    """Connection of one board to compiled code.

    Attributes:
        record: HOST record of the board.
        pointer: Address of the record, for compiled code.
        request: Compiled function that executes all requests of a host: (pointer, code, a, b) -> answer.
        error: Exception from a call of compiled code, stored until `raise_error`.
        hooks: Interrupt hooks in Python, and the table of the interrupt controller.
        windows: Memory windows of the running firmware: addresses at which it reaches ports; None if it has none.
        answering: Device in Python that is answering a bus cycle, or None.
        pause: Function with which the firmware's own thread waits while it is paused.
        abandoned: Threads of abandoned firmware.
        firmware_thread: Identifier of the firmware's own thread.
        has_other_threads: Whether other threads of the firmware have made bus cycles.
        calls: Counter that increases when a call from compiled code begins and when it ends: odd during a call.
    """

    def __init__(self, board: Board):
        self.board, self.stage = board, board.stage
        self.calls = 0
        self.firmware_thread, self.has_other_threads = 0, False
        self.error: BaseException | None = None
        self.windows: MemoryWindows | None = None
        self.answering: Any = None
        self.pause: Callable[[], None] | None = None
        self.abandoned: set[threading.Thread] = set()
        self._left: list[np.ndarray] = []
        self._call = UPCALL(self._answer_call)
        self._answers: dict[int, Callable[[Any], Any]] = {
            host_record.DIVERGED: self._undo_divergence, host_record.STORM: self._raise_storm_error,
            host_record.REFUSED: self._raise_refusal_error, host_record.COLLIDED: self._raise_collision_error,
            host_record.ANOTHER_STACK: self._wait_for_others, host_record.LINE_OF_LOG: self._add_log_line,
            host_record.CHECK_WRITE: self._check_write, host_record.WINDOW_REQUEST: self._answer_window_request,
            host_record.DEVICE_CALLED: self._call_device, host_record.RUN_IN_PYTHON: self._run_stage,
        }  # fmt: skip
        self.request: Any = host_requests.request.pointer
        self._make_record()
        self.hooks = PythonInterruptHooks(self)

    @property
    def traced_lines(self) -> int:
        """Number of lines that the bus trace has got so far."""
        return int(self.record["traced"])

    def _make_record(self) -> None:
        """Create the HOST record and the arrays to which it points."""
        stage = self.stage
        if len(stage.state.edges) < NOTE_BUFFER_ROWS:
            stage.state.set_edge_buffer(np.zeros(NOTE_BUFFER_ROWS, engine_records.LOGGED_EDGE))
        self._rows = np.zeros(1, host_record.HOST)
        self.use_record(self._rows)
        h = self.record
        compiled_stage_access.fill_handle(self._rows, 0, stage.state)
        self.irqs = np.zeros(len(stage.chips), host_record.IRQ)
        self._acts = np.zeros(len(stage.chips), np.int64)
        for k, chip in enumerate(stage.chips):
            axis, bits = chip.IRQ
            self.irqs[k] = (axis % (chip.AXES + 1), bits, 0, 0)
            self._acts[k] = np.uint64(sum(1 << a for a in chip.READING_ACTS)).astype(np.int64)
        words = stage.state.userdata
        self._before = np.zeros(len(words))
        for name, array in (
            ("edges", stage.state.edges), ("trace_cycles", self.board.trace.buffer), ("irqs", self.irqs), ("acts", self._acts),
            ("userdata", words), ("before", self._before),
        ):  # fmt: skip
            h[name] = array.ctypes.data
        self.write_port_table()
        h["edge_room"], h["trace_capacity"], h["words"] = len(stage.state.edges), self.board.trace.capacity, len(words)
        h["until"] = h["max_cycles"] = UNBOUNDED
        h["journals"] = 1
        self.publish_devices()
        h["serial"] = self.board.serial_lines.address
        h["call"] = get_function_address(self._call)

    def write_port_table(self) -> None:
        """Pass the table of ports to compiled code."""
        board, h = self.board, self.record
        h["regions"], h["ports"] = board.regions.ctypes.data, board.port_table.ctypes.data
        h["n_regions"], h["n_ports"] = len(board.regions), len(board.port_table)

    def publish_devices(self) -> None:
        """Pass the table of devices to compiled code."""
        rows = [device.make_record() for device in self.board.devices]
        self._devices = np.array(rows, host_record.DEVICE_TABLE)
        self.record["devices"], self.record["n_devices"] = self._devices.ctypes.data, len(rows)

    def use_serial_rows(self, rows: np.ndarray) -> None:
        """Keep the serial lines of the board in `rows`, an array of a LINE record for each, from now on."""
        self.board.serial_lines.use_rows(rows)
        self.record["serial"] = self.board.serial_lines.address

    def check_is_current(self) -> None:
        """Raise StageError if another board has replaced this one on the stage; two boards would each have their own
        time and interrupts."""
        if self.stage.host is None or self.stage.host.board is not self.board:
            raise StageError(
                "this board's stage has got another board since, and a stage has one: go on with that, or make the other on a "
                "copy, Board(copy.copy(stage))."
            )

    def begin_run(self) -> None:
        """Prepare a run of compiled code. Raises the errors of `check_is_current`."""
        self.check_is_current()
        stage, h = self.stage, self.record
        stage.ensure_powered()
        stage.loop.check_integration_options()
        h["checked_chips"] = self.find_checked_chips()
        h["reached"] = stage.now
        compiled_stage_access.set_sample_buffers(h, stage.loop.recording)

    def find_checked_chips(self) -> int:
        """Return a bit mask of the chips whose writes a fault of the bus may lose."""
        return sum(1 << k for k, chip in enumerate(self.stage.chips) if chip.glitches)

    def end_run(self) -> None:
        """Pass the edges, bus cycles and samples that compiled code has recorded to the journals and the recording."""
        stage, h = self.stage, self.record
        if n := int(h["noted"]):
            h["noted"] = 0
            self.journal_edges(n)
        if (recording := stage.loop.recording) is not None:
            recording.take_rows(int(h["filled"]))
            h["filled"] = recording.filled

    def journal_edges(self, count: int) -> None:
        """Pass the first `count` edges and bus cycles that compiled code has recorded to journals and diagnostics."""
        self.stage.loop.journal_edges(count)
        for chip in self.stage.chips:
            if chip.journal_lint is not None:
                chip.journal_lint.process_long_journal()

    def is_write_lost(self, chip: int, address: int, value: int) -> bool:
        """Return whether a fault of the bus loses this write before it reaches the chip."""
        return self.stage.chips[chip].loses_write(address, value)

    def call_device(self, index: int, register: int, kind: int, value: int) -> int:
        """Make a bus cycle at a register of a device that is written in Python, and return the answer.

        Args:
            index: Index of the device.
            register: Number of its register.
            kind: IN8, OUT8, IN16 or OUT16.
            value: Value that is written.
        """
        device = self.board.devices[index]
        self.answering, loop = device, self.stage.loop
        loop.time_refusal = (
            f"{device.name} answers a bus cycle: within it no time passes, and the stage stays in its state. "
            "Do it later."
        )
        try:
            return device.access_register(register, kind, value)
        finally:
            self.answering, loop.time_refusal = None, ""

    def make_request(self, what: int, a: int, b: int) -> int:
        """Execute a request of a host in Python, with the stage's lock if it has one.

        Args:
            what: Code of the request, see host_record.
            a: First operand.
            b: Second operand.
        """
        lock = self.stage.loop.lock
        if lock is None:
            return self._make_request(what, a, b)
        with lock:
            return self._make_request(what, a, b)

    def _make_request(self, what: int, a: int, b: int) -> int:
        """Execute a request; see `make_request`, which holds the lock."""
        if self.answering is not None:
            raise StageError(f"{self.answering.name} answers a bus cycle: it can make none itself, and no time passes.")
        self.stage.loop.check_time_allowed()
        self.begin_run()
        answer = int(self.request(self.pointer, what | host_record.FROM_PYTHON, int(a), int(b)))
        if answer == host_record.BUS_BUSY:
            raise StageError("this board is in use by another thread: a bus has one host at a time.")
        self.end_run()
        self.raise_error()
        return answer

    def raise_error(self) -> None:
        """Raise the stored exception of a call from compiled code, if there is one."""
        if self.error is not None:
            error, self.error = self.error, None
            self.record["stopped"] = 0
            raise error

    def set_error(self, error: BaseException) -> None:
        """Store an exception, and stop the bus until it is raised."""
        self.record["stopped"] = 1
        if self.error is None:
            self.error = error

    def abandon_thread(self, thread: threading.Thread) -> None:
        """Disconnect a thread of firmware from this board for good.

        The thread may still run. It keeps a stopped HOST record, and the board continues with a copy.
        """
        self.abandoned.add(thread)
        self.record["stopped"] = 1
        self._left.append(self._rows)
        self.use_record(self._rows.copy())
        self.record["stopped"] = self.record["inside"] = self.record["in_python"] = 0
        self.hooks.use_table(self.hooks.sources.copy())
        self.hooks.remove_firmware_hooks()
        self.pause = None

    def take_last_edges(self) -> None:
        """Pass on the edges and cycles that abandoned firmware has recorded last, without a bus cycle.

        The stage keeps its state.
        """
        self.end_run()
        self.begin_run()
        self.request(self.pointer, host_record.SETTLE, 0, 0)
        self.end_run()

    def use_record(self, rows: np.ndarray) -> None:
        """Use the HOST record in the array `rows` of length one from now on."""
        rows[:] = self._rows
        self._rows, self.pointer = rows, rows.ctypes.data
        rows["own"] = self.pointer
        self.record = rows.view(remove_attribute_access(host_record.HOST))[0]

    # --- calls from compiled code ---

    def _answer_call(self, reason: int) -> None:
        """Answer a call from compiled code. `reason` is one of the reasons in host_record."""
        if threading.current_thread() in self.abandoned:
            threading.Event().wait()
        if (lock := self.stage.loop.lock) is None:
            self._handle_call(reason)
        else:  # the thread that runs the firmware has the lock, and waits
            with lock.act_for_owner():
                self._handle_call(reason)
        if self.pause is not None and (reason == host_record.PAUSE or self.record["stopped"]):
            self.pause()

    def _handle_call(self, reason: int) -> None:
        """Call the method that serves the reason for which compiled code has called Python."""
        self.calls += 1
        try:
            self.end_run()
            if (answer := self._answers.get(reason)) is not None:
                answer(self.record)
            self.begin_run()
        except BaseException as error:
            self.set_error(error)
        self.calls += 1

    def _undo_divergence(self, h: Any) -> None:
        """Restore the state before the physics diverged, and raise SimulationError."""
        error = self.stage.loop.undo_divergence(self.pointer)
        self.end_run()
        raise error

    def _run_stage(self, h: Any) -> None:
        """Advance the stage in Python to the time that compiled code requests."""
        self.stage.run_to(int(h["call_value"]))

    def _raise_storm_error(self, h: Any) -> None:
        """Raise StormError for an interrupt hook that is called again and again."""
        raise StormError(f"{self.hooks.describe_storm(int(h['call_value']))}\n{self.board.trace.text(8)}")

    def _raise_refusal_error(self, h: Any) -> None:
        """Raise HostError for a host request whose operands are out of range."""
        raise HostError(self.hooks.describe_refusal(int(h["call_chip"]), int(h["call_address"]), int(h["call_value"])))

    def _raise_collision_error(self, h: Any) -> None:
        """Raise HostError because two threads of the firmware have made requests at once."""
        raise HostError(
            "two threads of the firmware made bus cycles at the same time, or a handler of signals (setitimer, alarm) made "
            f"one in the middle of another, at {self.stage.time:.6f} s: a bus has one host at a time. Guard the cycles of "
            "threads by a mutex; timers of the board are ps_timer and ps_on_timer (docs/interrupts.md)."
        )

    def _wait_for_others(self, h: Any) -> None:
        """Wait at a bus cycle of a thread other than the firmware's own.

        If another thread makes a cycle during the wait, no mutex protects the bus, and that is an error. Without this wait, short
        threads would miss each other in most runs and collide only in some.
        """
        if threading.get_ident() == self.firmware_thread:  # a coroutine, or a handler of signals on a stack of its own
            return
        if not self.has_other_threads:
            self.has_other_threads = True
            self.board.add_log_line(
                "bus cycles come from several threads of the firmware: their order is one of real time, and no two runs need be "
                "alike"
            )
        time.sleep(THREAD_WAIT_S)

    def _add_log_line(self, h: Any) -> None:
        """Add a line that the firmware has printed by ps_log to the log."""
        if not h["call_value"]:
            raise HostError(f"ps_log(0), at {self.stage.time:.6f} s: a null pointer is no text.")
        self.board.add_log_line(ctypes.string_at(int(h["call_value"])).decode(errors="replace"))

    def _check_write(self, h: Any) -> None:
        """Decide whether a fault of the bus loses a write."""
        h["call_value"] = self.is_write_lost(int(h["call_chip"]), int(h["call_address"]), int(h["call_value"]))

    def _call_device(self, h: Any) -> None:
        """Execute a bus cycle at a device in Python."""
        k, n, kind, value = (int(h[name]) for name in ("call_chip", "call_address", "call_kind", "call_value"))
        try:
            h["call_value"] = self.call_device(k, n, kind, value)
        except BaseException:
            self._trace_failure(k, n, kind, value)
            raise

    def _trace_failure(self, index: int, register: int, kind: int, value: int) -> None:
        """Append the bus cycle in which a device in Python has raised an error to the trace."""
        h, buffer, reads = self.record, self.board.trace.buffer, kind in (host_record.IN8, host_record.IN16)
        now = self.stage.now + int(h["ahead"])
        data = (0xFF if kind == host_record.IN8 else 0xFFFF) if reads else value
        port = self.board.devices[index].get_board_port(register)
        buffer[self.traced_lines % len(buffer)] = (now, now, 1, kind | host_record.RAISED, port, data)
        h["traced"] += 1
        h["changed"] = h["traced"]

    def _answer_window_request(self, h: Any) -> None:
        """Map a memory window that the firmware requests, or refuse an access to a window that is no bus cycle."""
        what, a, b = (int(h[name]) for name in ("call_chip", "call_value", "call_address"))
        if self.windows is None:
            raise HostError(f"ps_window({a:#x}, {b:#x}): {explain_missing_windows(isolated=False)}")
        if what != host_record.WINDOW:
            raise self.windows.explain_refusal(what, a, b)
        h["call_value"] = self.windows.map_anywhere(a, b)
