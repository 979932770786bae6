"""Main program of the process that runs isolated firmware. `starter` starts it; it is the only module that uses
`traps`."""

from __future__ import annotations

import fcntl
import os
import pickle
import select
import shutil
import threading
import time
from contextlib import AbstractContextManager, suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from stage.board import crash_report, temporary_folders
from stage.board.board import Board
from stage.board.bus import host_record, host_requests
from stage.board.bus.interrupt_controller import ANY_INTERRUPT_LINE
from stage.board.errors import HostError
from stage.board.host_record_link import NOTE_BUFFER_ROWS, Link
from stage.board.isolation.shared_memory import (
    LOADING,
    CorruptedError,
    ParentCallRequest,
    PausedMessage,
    RunOrder,
    SharedMemory,
    StartMessage,
    UnreadCounts,
)
from stage.board.thread_runner import LoadedProgram, ThreadRunner
from stage.errors import StageError
from stage.sim.model_fingerprint import iterate_settings
from stage.sim.stage import Stage

if crash_report.IS_SUPPORTED:
    from stage.board.isolation import traps

THREAD_START_S = 0.02  # of real time, for a thread of the firmware to begin
HIGH_DESCRIPTOR = 200  # firmware mostly closes or writes lower ones by mistake
CLOSED_PIPE_MESSAGE = (
    "it closed a file descriptor that it had not opened: that was the connection of its process with the stage"
)
POLL_INTERVAL_MS = (
    500  # hanging up is noticed at once, unless a process that the parent has forked holds the pipe as well
)


class SampleBuffers:
    """Buffers into which the engine writes samples and which the parent copies to its recording.

    The stage uses them like a recording.
    """

    REQUIRES_FORWARD_TIME = True

    def __init__(self, shared: SharedMemory):
        self.samples, self.positions, self.filled = shared.samples, shared.positions, 0

    def take_rows(self, filled: int) -> None:
        """Store how many rows (samples) of the buffers the engine has filled; the parent copies these rows."""
        self.filled = filled


class ChildLink(Link):
    """Link that writes edges, cycles and samples to shared memory and lets the parent execute calls of Python.

    Before the memory is full, it lets the parent read it.
    """

    def __init__(self, board: Board, pipe: Connection, shared_path: str):
        super().__init__(board)
        self._pipe = pipe
        self.shared = shared = SharedMemory(shared_path, board)
        self.samples = SampleBuffers(shared)
        self.checked = 0
        self.use_record(shared.record)
        self.hooks.use_table(shared.sources)
        self.stage.state.set_edge_buffer(shared.edges)
        board.trace.buffer = shared.cycles
        places = self.stage.device_state.move_to(shared.devices)
        for device in board.devices:  # after a crash they are still there
            n = len(device.list_arrays())
            device.use_arrays(places[:n])
            places = places[n:]
        self.publish_devices()
        h = self.record
        self.use_serial_rows(shared.serial)
        h["edges"], h["trace_cycles"], h["edge_room"] = (
            shared.edges.ctypes.data,
            shared.cycles.ctypes.data,
            len(shared.edges),
        )

    def find_checked_chips(self) -> int:
        """Return a bit mask of the chips whose writes the parent checks."""
        return self.checked

    def end_run(self) -> None:
        """Flush samples and edges if their memory is nearly full."""
        h = self.record
        self.samples.filled = int(h["filled"])
        if h["noted"] > NOTE_BUFFER_ROWS // 2 or self.samples.filled == len(self.samples.samples):
            self.flush()

    def publish_state(self) -> UnreadCounts:
        """Write the state to shared memory; return the numbers of edges and samples there, and start counting them anew."""
        h = self.record
        noted = UnreadCounts(int(h["noted"]), int(h["filled"]))
        self.stage.copy_state(self.shared.state)
        h["faults"] = self.windows.faults if self.windows is not None else 0
        h["noted"] = h["filled"] = self.samples.filled = 0
        return noted

    def flush(self) -> None:
        """Wait until the parent has read all edges and samples."""
        self._pipe.send(self.publish_state())
        self._pipe.recv()

    def call_device(self, k: int, n: int, kind: int, value: int) -> int:
        """Let the parent execute a bus cycle of a device in Python."""
        return self._call_parent(k, n, value, kind)

    def is_write_lost(self, chip: int, address: int, value: int) -> bool:
        """Ask the parent process whether a fault of the bus loses this write before it reaches the chip."""
        return bool(self._call_parent(chip, address, value))

    def _call_parent_hook(self, source: int) -> None:
        """Let the parent call a hook in Python."""
        self._call_parent(-1 - source, 0, 0)

    def set_hooks(self, sources: tuple[int, ...]) -> None:
        """Point these interrupt sources to functions in Python, which the parent calls."""
        hooks, row = self.hooks, self.hooks.sources[ANY_INTERRUPT_LINE]
        before = hooks.pointer if ANY_INTERRUPT_LINE in hooks.functions else 0
        of_firmware = row["hook"] != before and not (ANY_INTERRUPT_LINE in sources and not before)
        hooks.functions = {source: partial(self._call_parent_hook, source) for source in sources}
        hooks.point_to_python(sources, keep=of_firmware)

    def _call_parent(self, chip: int, address: int, value: int, kind: int = -1) -> int:
        """Send a request to the parent, wait for its answer, and continue from the parent's state."""
        self._pipe.send(ParentCallRequest(self.publish_state(), chip, address, value, kind))
        answer, succeeded, machine, hooks = self._pipe.recv()
        if machine is not None:
            copy_settings(self.stage, pickle.loads(machine))
        self.stage.load_state(self.shared.state)
        self.set_hooks(hooks)
        if not succeeded:
            raise StageError("Python has raised in the parent")
        return int(answer)


class ChildBoard(Board):
    """Copy of the parent's board."""

    LINTS = False  # the parent does
    link: ChildLink

    def __init__(self, pipe: Connection, start: StartMessage):
        stage, options, devices = _load_board(start.board)
        super().__init__(stage, **options)
        self._lines = 0
        for (make, *arguments), ports in devices:
            self.attach_device(make(*arguments), ports)
        self.link = ChildLink(self, pipe, start.shared)
        self.link.shared.hide_from_forks()
        self.link.shared.remember_constant_fields()

    def add_log_line(self, text: str) -> None:
        """Add a line to the log of the parent's board."""
        self._check_log_lines(self._lines)
        self._lines += 1
        if not self.link.shared.add_log_line(self.stage.now, text):
            self.link.flush()
            self.link.shared.add_log_line(self.stage.now, text)

    def prepare_run(self, order: RunOrder) -> None:
        """Copy the parent's state and settings to this copy of its board before the firmware continues."""
        link, stage, self._lines = self.link, self.stage, order.lines
        if order.machine is not None:
            copy_settings(stage, pickle.loads(order.machine))
        stage.load_state(link.shared.state)
        self.port_table[:] = order.ports
        stage.state.clockwork[0].sample_every = order.sample_every
        stage.loop.recording = link.samples if order.sample_every else None
        link.checked = order.checked_chips
        link.set_hooks(order.hooks)


class ChildRunner(ThreadRunner):
    """Runner of firmware in the separate process. It logs sleeps, and treats threads that outlive the firmware as errors."""

    isolated, outlives = True, ""

    def _check_loadable(self) -> None:
        """Load the firmware for the first run, so that its errors appear before the run."""
        self._checked: LoadedProgram | None = super()._load()

    def _load(self) -> LoadedProgram:
        loaded, self._checked = self._checked, None
        return loaded or super()._load()

    def _prepare_thread(self) -> AbstractContextManager[None]:
        self._reported: set[str] = set()  # functions by which it has slept in real time
        if not crash_report.IS_SUPPORTED:
            return super()._prepare_thread()
        return traps.trap_thread(self._note_sleep, self._wait_for_thread)

    def _report_threads(self, n: int, code: int) -> None:
        self._board.link.set_error(
            HostError(
                f"{self._path.name} has returned {code} while {n} of its threads still ran, at {self._board.stage.time:.6f} s: "
                "whatever they do or break, nobody would know. Join them before PULSESTAGE_MAIN returns."
            )
        )

    def _locate(self, *libraries: Path) -> str:
        """Return a sentence about the function and line in which the firmware is computing."""
        pc, top = traps.find_position(self._thread) if crash_report.IS_SUPPORTED else (0, 0)
        return f" It is in {crash_report.locate_code(pc, top, *libraries)}." if pc else ""

    def _note_sleep(self, call: str) -> None:
        """Log that the firmware sleeps in real time, once for each function and run. Runs in the firmware's thread."""
        link, name = self._board.link, call.partition("(")[0]
        if name in self._reported or threading.current_thread() in link.abandoned:
            return
        self._reported.add(name)
        mode = host_requests.set_usual_float_mode.c()
        try:
            link.request(link.pointer, host_record.SETTLE, 0, 0)
            with suppress(StageError):  # the log is full
                self._board.add_log_line(
                    f"{call} passes real time only, and no simulated time: ps_delay_us passes that"
                )
        finally:
            host_requests.restore_float_mode.c(mode)

    def _wait_for_thread(self) -> None:
        """Give a thread that the firmware has started time for its first bus cycle, see `Link`. Runs in the firmware's
        thread."""
        if self._board.link.record["stack_checks"]:
            time.sleep(THREAD_START_S)


def copy_settings(target: Stage, source: Stage) -> None:
    """Copy the settings that are not part of the state from one stage to another.

    Args:
        target: Stage of this process.
        source: Stage of the parent.
    """
    for part, name, value in iterate_settings(source.model):
        setting_owner = target.model if part is source.model else target.model.opt
        if isinstance(value, np.ndarray):
            np.copyto(getattr(setting_owner, name), value)
        elif value != getattr(setting_owner, name):
            setattr(setting_owner, name, value)
    target.state.switch_table[:] = source.state.switch_table


def _load_board(board: bytes) -> tuple[Any, dict[str, Any], list[Any]]:
    """Unpickle the stage, the options of the board and its devices."""
    try:
        return pickle.loads(board)
    except Exception as error:
        raise StageError(
            f"the process of firmware with isolated=True cannot take over the stage: {error}. Define the classes of its chips and "
            "layouts in a module that it can import (not in a script), or run the firmware with isolated=False."
        ) from None


def _exit_with_parent(parent: int, fileno: int, start_messages: list[StartMessage]) -> None:
    """Exit this process when its parent ends; a thread is needed since computing firmware polls no pipe."""
    pipe = select.poll()
    pipe.register(fileno, 0)  # hanging up is always reported
    while os.getppid() == parent:
        if pipe.poll(POLL_INTERVAL_MS):
            if _is_open(fileno):
                break
            time.sleep(POLL_INTERVAL_MS * 1e-3)  # the firmware has closed it: the next to send reports that
    _remove_files(start_messages)
    os._exit(0)


def _remove_files(start_messages: list[StartMessage]) -> None:
    """Remove the temporary folder that a parent process which has ended may have left behind."""
    for start in start_messages:
        shutil.rmtree(Path(start.shared).parent, ignore_errors=True)


def _is_open(fileno: int) -> bool:
    """Return whether a file descriptor is open."""
    try:
        os.fstat(fileno)
    except OSError:
        return False
    return True


def _move_descriptor(fileno: int) -> int:
    """Move the pipe to a high, not inherited file descriptor, which firmware is unlikely to close by mistake."""
    try:
        high = fcntl.fcntl(fileno, fcntl.F_DUPFD_CLOEXEC, HIGH_DESCRIPTOR)
    except OSError:  # not that many are allowed
        os.set_inheritable(fileno, False)
        return fileno
    os.close(fileno)
    return high


def _prefer_to_be_killed() -> None:
    """Ask the system to kill this process before others if memory runs out."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def main(fileno: int) -> None:
    """Run the firmware that the parent sends over a pipe, until the parent ends."""
    fileno = _move_descriptor(fileno)
    if crash_report.IS_SUPPORTED:
        traps.block_timers()
    start_messages: list[StartMessage] = []
    threading.Thread(
        target=_exit_with_parent, args=(os.getppid(), fileno, start_messages), name="parent", daemon=True
    ).start()
    _prefer_to_be_killed()
    pipe = Connection(fileno)
    start: StartMessage = pipe.recv()
    start_messages.append(start)
    temporary_folders.set_parent_folder(Path(start.shared).parent)
    try:
        board = ChildBoard(pipe, start)
        if crash_report.IS_SUPPORTED:
            traps.watch_crashes(board.link.shared.note_crash)
        pipe.send(LOADING)
        runner = ChildRunner(start.program, board, start.patience)
    except StageError as error:
        pipe.send((type(error).__name__, str(error)))
        return
    try:
        _execute_run_orders(pipe, board, runner)
    except EOFError:
        _remove_files(start_messages)
        raise
    except OSError:
        board.link.shared.note_crash(crash_report.encode_crash_note(CLOSED_PIPE_MESSAGE))
        os._exit(1)
    except Exception:
        with suppress(CorruptedError):
            board.link.shared.check()
            raise
        os._exit(1)  # the error means nothing; the parent finds out, too


def _execute_run_orders(pipe: Connection, board: ChildBoard, runner: ThreadRunner) -> None:
    """Run the firmware each time the parent orders it, until the parent closes the pipe."""
    pipe.send(None)
    while True:
        go: RunOrder = pipe.recv()
        board.prepare_run(go)
        code, failure = None, None
        try:
            code = runner.resume(go.until, go.max_cycles)
        except Exception as error:
            failure = (type(error).__name__, str(error))
        noted = board.link.publish_state()
        pipe.send(PausedMessage(noted, board.port_table, code, failure, runner.wiring_findings))
        if failure is not None:
            os._exit(1)
