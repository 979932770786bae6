"""`ProcessRunner`: firmware in a separate process. A crash of the firmware becomes an error in this process, and an endless loop
can be ended.

The child process drives a copy of the stage at full speed, and sends back its state with the edges, bus cycles, samples and log
lines that it has recorded. The parent's stage thus has the same state to the bit, with recording, waveforms and diagnostics. After
a crash the parent repeats the last bus cycles from the last state that it received.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import struct
import time
import weakref
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from stage import errors as general
from stage.board import crash_report, errors
from stage.board.board import Board
from stage.board.devices.user_devices import CDevice
from stage.board.errors import HostError
from stage.board.firmware_library import list_sanitizers
from stage.board.isolation import process_starter
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
from stage.board.pin_assignment import WiringFinding
from stage.board.temporary_folders import TemporaryFolder
from stage.board.thread_runner import Program, is_debugged, read_process_status
from stage.chips.journal_entries import LOST, READ, WRITE
from stage.errors import StageError
from stage.sim import engine
from stage.sim.model_fingerprint import iterate_settings
from stage.support import files

GRACE_S = 10.0  # of real time beyond its patience, in which the child gives its firmware up itself
START_LIMIT_S = 30.0  # beyond the patience, that a process may take to begin
LOAD_LIMIT_S = 2.0  # beyond the patience, that loading the firmware may take: constructors run then
POLL_INTERVAL_MS = 250
READ_SIZE = 1 << 20
MAX_MESSAGE = 1 << 28  # bytes: text that comes as a length is more
_HEAD = struct.Struct("!i")  # as multiprocessing.connection sends it


class InvalidMessageError(Exception):
    """Error for bytes in the pipe that form no message."""


class _MessageReader:
    """Reader of messages from the firmware's process. It returns complete messages or raises an error, and never blocks
    forever.

    The firmware shares its process with the other end of the pipe and may close it, write to it, or be stopped.
    """

    def __init__(self, pipe: Connection):
        self._file = pipe.fileno()
        self._poll = select.poll()
        self._poll.register(self._file, select.POLLIN)
        self._content = bytearray()

    def receive(self, check: Callable[[], None]) -> Any:
        """Return the next message.

        Args:
            check: Function that is called repeatedly during the wait; it may raise an error.

        Raises:
            EOFError, OSError: The pipe is closed.
            InvalidMessageError: The bytes form no message.
        """
        while (message := self._take_message()) is None:
            if self._poll.poll(POLL_INTERVAL_MS):
                more = os.read(self._file, READ_SIZE)
                if not more:
                    raise EOFError
                self._content += more
            else:
                check()
        try:
            return pickle.loads(message)
        except Exception as error:
            raise InvalidMessageError from error

    def _take_message(self) -> bytes | None:
        """Return the next complete message of the firmware's process from the buffer; None if there is none yet."""
        content = self._content
        if len(content) < _HEAD.size:
            return None
        size = _HEAD.unpack_from(content)[0]
        if not 0 <= size < MAX_MESSAGE:
            raise InvalidMessageError
        end = _HEAD.size + size
        if len(content) < end:
            return None
        message = bytes(content[_HEAD.size : end])
        del content[:end]
        return message


class _StalledError(Exception):
    """Error of a child process that makes no progress. The argument is whether the child handles timer signals."""


class ProcessRunner:
    """`Runner` of firmware in a separate process.

    Args:
        program: The firmware.
        board: Board that the firmware drives.
        patience: Seconds of real time without progress after which the process counts as stalled.
    """

    def __init__(self, program: Program, board: Board, patience: float):
        if os.name != "posix":
            raise StageError("isolated=True needs a POSIX system; run the firmware in this process.")
        self._program, self._path, self._board, self._patience = program, program.path, board, patience
        self._child: process_starter.ChildProcess | None = None
        self._pipe: Any = None
        self._running = False
        self.wiring_findings: tuple[WiringFinding, ...] = ()
        self._owner = os.getpid()
        self._machine = b""  # what the child's stage is like
        self._error: BaseException | None = None
        settable = list(iterate_settings(board.stage.model))
        self._arrays = [value for _, _, value in settable if isinstance(value, np.ndarray)]
        self._options = [name for _, name, value in settable if not isinstance(value, np.ndarray)]
        self._start()

    @property
    def running(self) -> bool:
        """True while the firmware has started and has not returned."""
        return self._running

    def resume(self, until: int, max_cycles: int) -> int | None:
        """Run the child until its firmware returns or reaches a limit.

        Args:
            until: Board time at which the firmware pauses, ns.
            max_cycles: Total number of bus cycles at which the firmware pauses.

        Returns:
            Exit code of the firmware, or None if it is paused.
        """
        board = self._board
        if os.getpid() != self._owner:
            self._detach_from_owner()
        board.link.check_is_current()
        if engine.has_unguarded_callback.with_gil(board.stage.state.pointer):
            raise StageError(
                "MuJoCo calls a function in Python back, which the process of the firmware does not have: run the firmware with "
                "isolated=False."
            )
        if not self._running and self._devices != _list_devices(board):
            self._end_child()  # its copy of the board has others
        if self._child is None:
            self._start()
        self._running, self._error, self._until = True, None, until
        order = self._make_run_order(until, max_cycles)
        try:
            message = self._run_child(order)
        except (EOFError, OSError):
            raise self._make_crash_error(self._explain_end()) from None
        except (InvalidMessageError, _StalledError) as error:
            self._end_child()
            raise self._make_crash_error(self._explain_giving_up(error)) from None
        except CorruptedError:
            self._end_child()
            raise self._make_overwrite_error("was ended") from None
        except BaseException:
            self._end_child()
            raise
        board.port_table[:], self.wiring_findings = message.ports, message.wiring_findings
        if message.error is not None:
            raise self._error or _make_error(*message.error)
        self._running = message.code is None
        return message.code

    def close(self) -> None:
        """End the child process that runs the firmware."""
        if os.getpid() != self._owner:
            self._detach_from_owner(may_run=True)
        self._end_child()

    def _make_run_order(self, until: int, max_cycles: int) -> RunOrder:
        """Write the state of the stage to shared memory, and return the order with which the child process continues from it."""
        board, stage = self._board, self._board.stage
        machine = self._pickle_if_changed()
        every = int(stage.state.clockwork[0].sample_every) if stage.loop.recording is not None else 0
        stage.copy_state(self._shared.state)
        self._shared.copy_board_state(board)
        hooks = tuple(board.link.hooks.functions)
        checked = board.link.find_checked_chips()
        return RunOrder(until, max_cycles, board.port_table, machine, every, checked, hooks, len(board.log))

    def _run_child(self, order: RunOrder) -> PausedMessage:
        """Let the child process execute an order to run, and call Python functions for it when it requests them."""
        self._pipe.send(order)
        while not isinstance(message := self._receive(), PausedMessage):
            if isinstance(message, ParentCallRequest):
                self._pipe.send(self._answer_call(message))
            else:
                self._take_records(message)
                self._pipe.send(None)
        if message.error is not None:
            self._end_child()
        self._take_records(message.noted)
        return message

    def _detach_from_owner(self, may_run: bool = False) -> None:
        """Detach from the child and the shared memory in a fork of this process, because they belong to the original process."""
        ran, self._owner = self._running, os.getpid()
        self._child, self._running, self._machine = None, False, b""
        if ran and not may_run:
            raise StageError(
                f"{self._path.name} stands in the middle of its run, and this process is a fork of the one that has begun it: only "
                "that one can let it go on. A run that is begun here gets a process of its own."
            )

    def _start(self) -> None:
        """Start a child with a copy of the stage. Errors that loading the firmware raises in the child are raised here."""
        board = self._board
        content = _pickle_stage((board.stage, board.options, [(d.make_recipe(), d.ports) for d in board.devices]))
        self._devices = _list_devices(board)
        self._scratch = TemporaryFolder()
        shared = self._scratch.path / "shared"
        ours, theirs = Pipe()
        try:
            self._shared = SharedMemory(shared, board, create=True)
            self._shared.serial[:] = board.serial_lines.rows
            board.link.use_serial_rows(self._shared.serial)
            with theirs:
                self._child = process_starter.start(theirs.fileno(), " ".join(list_sanitizers(self._path)))
            self._pipe, self._messages = ours, _MessageReader(ours)
            weakref.finalize(self, self._child.release)
            ours.send(StartMessage(self._program, str(shared), content, self._patience))
            self._machine, self._faults = self._pickle_machine_settings(), _read_faults(board.stage)
            answer = self._receive(START_LIMIT_S)
            if answer == LOADING:
                answer = self._receive(LOAD_LIMIT_S)
        except (EOFError, ConnectionError):
            raise self._make_load_error(self._explain_end()) from None
        except (InvalidMessageError, _StalledError) as error:
            self._end_child()
            raise self._make_load_error(self._explain_giving_up(error)) from None
        except BaseException:
            self._end_child()
            raise
        finally:
            shared.unlink(missing_ok=True)
        if answer is not None:
            self._end_child()
            raise _make_error(*answer)
        self._shared.remember_constant_fields()

    def _pickle_if_changed(self) -> bytes | None:
        """Return the pickled stage if its settings differ from the child's, otherwise None."""
        stage, before = self._board.stage, self._machine
        self._machine, self._faults = self._pickle_machine_settings(), _read_faults(stage)
        return _pickle_stage(stage) if self._machine != before else None

    def _pickle_machine_settings(self) -> bytes:
        """Return all settings, apart from the state, in which the child's stage must equal this one."""
        parts = self._board.stage.describe_machine()
        model = parts.pop("model")
        options = [getattr(model.opt, name) for name in self._options]
        return b"".join([*(array.tobytes() for array in self._arrays), _pickle_stage((options, parts))])

    # --- what comes over ---

    def _take_records(self, noted: UnreadCounts) -> None:
        """Take over the child's state, and the edges and samples that it has recorded since the last call."""
        board, shared, stage = self._board, self._shared, self._board.stage
        shared.check_records(board, noted.edges, noted.samples, self._until)
        stage.load_state(shared.state)
        shared.copy_board_state(board, back=True)
        stage.state.edges[: noted.edges] = shared.edges[: noted.edges]
        board.link.journal_edges(noted.edges)
        recording, at = stage.loop.recording, 0
        while recording is not None and at < noted.samples:
            begin = recording.filled
            end = min(begin + noted.samples - at, len(recording.samples))
            recording.samples[begin:end] = shared.samples[at : at + end - begin]
            recording.positions[begin:end] = shared.positions[at : at + end - begin]
            at += end - begin
            recording.take_rows(end)
        board.log += shared.take_log_lines()

    def _answer_call(self, call: ParentCallRequest) -> tuple[int, bool, bytes | None, tuple[int, ...]]:
        """Call Python in this process for the child, which continues from the state after the call."""
        board, shared = self._board, self._shared
        self._take_records(call.noted)
        hooks, answer, machine = board.link.hooks, 0, None
        try:
            if call.kind >= 0:
                answer = board.link.call_device(call.chip, call.address, call.kind, call.value)
                # to compare the whole machine takes too long for a bus cycle
                if _read_faults(board.stage) != self._faults:
                    machine = self._pickle_if_changed()
            elif call.chip >= 0:
                answer = int(board.link.is_write_lost(call.chip, call.address, call.value))
            else:
                hooks.call_hook(-1 - call.chip)
                machine = self._pickle_if_changed()
        except BaseException as error:
            self._error = error
        board.stage.copy_state(shared.state)
        shared.copy_board_state(board)
        return answer, self._error is None, machine, tuple(hooks.functions)

    def _receive(self, grace: float = GRACE_S) -> Any:
        """Return the next message of the child. Raises _StalledError if the child makes no progress."""
        begin: tuple[float, Any] = time.monotonic(), None
        self._waited = self._patience + grace

        def check() -> None:
            """Raise _StalledError if the child has made no progress within the patience and `grace`, unless it is debugged."""
            nonlocal begin
            theirs = self._shared.record[0]
            now = tuple(int(theirs[name]) for name in ("cycles", "reached"))
            since, before = begin
            if now != before:
                begin = time.monotonic(), now
            elif time.monotonic() - since > self._patience + grace:
                if self._child is None or not is_debugged(self._child.pid):
                    raise _StalledError(self._child is not None and _handles_timers(self._child.pid))
                begin = time.monotonic(), now

        return self._messages.receive(check)

    # --- errors in words ---

    def _explain_giving_up(self, error: Exception) -> str:
        """Explain why this process has ended the child: it spoiled the connection, or made no progress."""
        if isinstance(error, InvalidMessageError):
            return (
                "wrote into a file descriptor that it had not opened: that was the connection of its process with the stage, and "
                "it was ended"
            )
        why = ""
        if error.args[0]:
            why = (
                ", perhaps because a handler of signals (setitimer, alarm) has made a bus cycle in the middle of another: timers "
                "of the board are ps_timer and ps_on_timer (docs/interrupts.md)"
            )
        return f"has not got on for {self._waited:g} s of real time{why}, and was ended"

    def _make_load_error(self, how: str) -> HostError:
        """Return the error for a child process that ended while it loaded the firmware."""
        what = self._describe_crash()
        return HostError(f"{self._path.name} {how} while it was loaded, before PULSESTAGE_MAIN was called{what}.")

    def _make_crash_error(self, how: str) -> HostError:
        """Repeat the last cycles of the child process, so that the stage stands where it ended.

        Return the error about its end.
        """
        board, theirs = self._board, self._shared.record[0]
        try:
            self._shared.check_records(board, int(theirs["noted"]), 0, self._until, ended=True)
        except CorruptedError:
            return self._make_overwrite_error(f"{how}{self._describe_crash()}")
        edges = self._shared.edges[: int(theirs["noted"])]
        self._repeat_cycles(edges[np.isin(edges["kind"], (WRITE, READ, LOST))])
        board.stage.run_to(max(int(theirs["reached"] + theirs["ahead"]), board.stage.now))
        board.stage.device_state.copy_from(self._shared.devices)
        k = int(theirs["answers"]) - 1
        who = f"in the code of {board.devices[k].label}, " if 0 <= k < len(board.devices) else ""
        self._shared.copy_board_state(board, back=True)
        board.log += self._shared.take_log_lines()
        return HostError(
            f"{who}{self._path.name} {how}{self._describe_crash()}; at {board.stage.time:.6f} s, after "
            f"{board.cycles:,} bus cycles. The stage stands where it stood then. {board.trace.format_ending(12)}"
        )

    def _describe_crash(self) -> str:
        """Return the description of the child's crash from the note in the shared memory."""
        devices = (d.loaded for d in self._board.devices if isinstance(d, CDevice))
        return crash_report.describe_crash(self._shared.crash, self._path, *devices)

    def _make_overwrite_error(self, how: str) -> HostError:
        """Return the error for firmware that has overwritten the memory which it shares with this process."""
        board = self._board
        return HostError(
            f"{self._path.name} has written over the memory by which its process tells what happens on the bus, and {how}. Does a "
            "pointer run on, or a memset beyond its array? -fsanitize=address finds where (docs/debugging.md). What it did last is "
            f"not known: the stage stands at {board.stage.time:.6f} s, after {board.cycles:,} bus cycles, as far as is "
            f"known. {board.trace.format_ending(12)}"
        )

    def _repeat_cycles(self, edges: np.ndarray) -> None:
        """Repeat the last bus cycles of the child process on this process's stage."""
        stage = self._board.stage
        axes = list(stage.axes.values())
        for now, axis, kind, a, b in zip(*(edges[n].tolist() for n in ("now", "axis", "kind", "a", "b")), strict=True):
            stage.run_to(now)
            chip: Any = axes[axis].chip
            if kind == LOST:
                chip.open_journal.note_lost_write(chip.clock, a, b)
            elif kind == READ:
                chip.CORE.read.c(chip.pointer, a)
                chip.open_journal.note_read(chip.clock, a, b)
            else:
                chip.CORE.write.c(chip.pointer, a, b)
                chip.open_journal.note_write(chip.clock, a, b)

    # --- the process ---

    def _explain_end(self) -> str:
        """Wait for a child process that ends by itself, and describe how it ended."""
        code = self._child.wait(self._patience + GRACE_S) if self._child is not None else 0
        stopped = self._child.stopped if self._child is not None else 0
        self._end_child()
        if stopped:
            return f"was stopped by {_name_signal(stopped)}, and ended"
        if code == -signal.SIGKILL:
            return f"was ended by {_name_signal(-code)} (by somebody, or for want of memory)"
        return f"was ended by {_name_signal(-code)}" if code < 0 else f"ended its process with exit code {code}"

    def _end_child(self) -> None:
        """End the child process that runs the firmware, and release its resources."""
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            self._pipe.close()
            self._scratch.close()
        self._child, self._running, self._machine = None, False, b""


def _list_devices(board: Board) -> list[tuple[Any, int]]:
    """Return each device of a board with the address of its compiled function, or 0."""
    return [(device, device.access) for device in board.devices]


def _read_faults(stage: Any) -> bytes:
    """Return the faults and payloads of a stage, for comparison."""
    parts = stage.describe_machine()
    return pickle.dumps([parts[name] for name in ("axis_faults", "faults", "payloads")])


def _pickle_stage(stage: Any) -> bytes:
    """Pickle a stage. Raises StageError if a class of its chips or layouts cannot be pickled."""
    try:
        return pickle.dumps(stage)
    except Exception as error:
        raise StageError(
            f"firmware with isolated=True needs a stage that can be pickled: {error}. Define the classes of its chips and layouts "
            "at the top of a module, or run the firmware with isolated=False."
        ) from None


def _handles_timers(process: int) -> bool:
    """Return whether a process handles one of the signals of setitimer, alarm or timer_create."""
    caught = int(read_process_status(process).get("SigCgt", "0"), 16)
    return any(caught >> number - 1 & 1 for number in (signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF))


def _name_signal(number: int) -> str:
    """Return the name of a signal by its number."""
    try:
        return f"{signal.Signals(number).name} ({signal.strsignal(number)})"
    except ValueError:
        return f"signal {number}"


def _make_error(name: str, text: str) -> Exception:
    """Convert an error of the child to one of this process."""
    kind = next((error for module in (errors, general, files) if (error := getattr(module, name, None))), None)
    return kind(text) if isinstance(kind, type) and issubclass(kind, StageError) else HostError(f"{name}: {text}")
