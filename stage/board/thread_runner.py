"""`ThreadRunner`: firmware in a thread of this process. While the firmware is paused, its thread waits within a bus cycle.

Python cannot end a thread. If firmware must not continue (after an error, or because it loops for ever without a bus cycle), the
runner abandons it: its bus then has no effect. In the user's process this mode is for debuggers, because crashes and other effects
of the firmware happen to that process. `stage.board.isolation.firmware_process` runs firmware in a process of its own.
"""

from __future__ import annotations

import ctypes
import threading
import time
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from stage.board.bus import host_record, host_requests
from stage.board.bus.interrupt_controller import MAX_FRAME_DISTANCE_BYTES
from stage.board.devices.user_devices import CDevice
from stage.board.errors import HostError
from stage.board.host_record_link import UNBOUNDED

if TYPE_CHECKING:
    from stage.board.board import Board
    from stage.board.pin_assignment import WiringFinding

PATIENCE_S = 20.0  # of real time
STACK_SIZE = 64 << 20  # bytes
POLL_INTERVAL_S = 0.2
INTERRUPT_LIMIT_S = 0.5  # of real time, in which interrupted firmware has to make a request
STACK_CHECKS = 4  # of requests from other threads of the firmware
TASKS = Path("/proc/self/task")
"""The threads of this process, where the system lists them."""


class LoadedProgram(Protocol):
    """Firmware loaded into memory, with its variables at their initial values."""

    def main(self) -> int:
        """Run the firmware from its entry point in the calling thread, and return its exit code.

        Raises:
            HostError: The firmware ended in another way.
        """
        ...

    def close(self) -> None:
        """Unload the firmware."""
        ...


class Program(Protocol):
    """Firmware in a file: a library of this machine, or a binary that an emulator runs.

    A program can be pickled, since a separate process receives it in this form. It makes its requests to the board in
    the thread that calls `main`; the runner pauses it there.
    """

    @property
    def path(self) -> Path:
        """File of the firmware."""
        ...

    def load(self, board: Board, isolated: bool) -> LoadedProgram:
        """Load a copy of the program whose requests go to the board.

        Args:
            board: Board that the program drives.
            isolated: Whether this process runs only the firmware, so that loading may change the process.

        Raises:
            StageError: The program cannot be loaded.
        """
        ...


def read_process_status(process: int | str) -> dict[str, str]:
    """Return the fields of /proc/PID/status for a process or thread; empty on systems without that file."""
    try:
        lines = Path(f"/proc/{process}/status").read_text(errors="replace").splitlines()
    except OSError:
        return {}
    return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}


def is_debugged(process: int | str = "self") -> bool:
    """Return whether a debugger is attached to a process, which may then stop for a long time."""
    return read_process_status(process).get("TracerPid", "0") != "0"


class ThreadRunner:
    """`Runner` in a thread of this process. The constructor raises an error if the program cannot be loaded.

    Args:
        program: The firmware.
        board: Board that the firmware drives.
        patience: Seconds of real time that the firmware may compute without a bus cycle.
    """

    isolated = False
    outlives = " (Its thread goes on until the process ends; isolated=True ends such a loop.)"
    """Sentence about firmware that was abandoned."""

    def __init__(self, program: Program, board: Board, patience: float):
        self._program, self._board, self._patience = program, board, patience
        self._path = program.path
        self._thread: threading.Thread | None = None
        self._code: int | None = None
        self._unloadable: list[LoadedProgram] = []
        self._loaded: LoadedProgram | None = None
        self._check_loadable()

    @property
    def running(self) -> bool:
        """True while the firmware has started and has not returned."""
        return self._thread is not None

    @property
    def wiring_findings(self) -> tuple[WiringFinding, ...]:
        """Signs that lines of axes are at the wrong pins of the firmware."""
        return getattr(self._loaded, "find_wiring_findings", tuple)()

    def resume(self, until: int, max_cycles: int) -> int | None:
        """Run the firmware until it returns or reaches a limit.

        Args:
            until: Board time at which the firmware pauses, ns.
            max_cycles: Total number of bus cycles at which the firmware pauses.

        Returns:
            Exit code of the firmware, or None if it is paused.
        """
        if self._thread is None:
            self._start()
        link = self._board.link
        h = link.record
        h["lazy"], h["quiet"], h["until"], h["max_cycles"] = 1, 0, until, max_cycles
        link.pause = self._pause
        link.begin_run()
        self._go.release()
        try:
            self._wait_for_pause()
        except BaseException:
            self._interrupt()
            raise
        finally:
            link.pause = None
            h = link.record  # another one if the firmware was given up
            h["lazy"], h["until"], h["max_cycles"] = 0, UNBOUNDED, UNBOUNDED
        if link.error is not None:
            self.close()
        link.raise_error()
        return self._code

    def close(self) -> None:
        """Disconnect the firmware from the board; its thread may continue."""
        if self._thread is not None:
            self._board.link.abandon_thread(self._thread)
        self._thread = None

    # --- what a process of the firmware's own adds ---

    def _prepare_thread(self) -> AbstractContextManager[None]:
        """Return the context in which the firmware's entry is called, in its thread."""
        return nullcontext()

    def _report_threads(self, n: int, code: int) -> None:
        """Report that `n` threads were still running when the entry point returned `code`.

        Does nothing in this process, where threads may belong to other code.
        """

    def _locate(self, *libraries: Path) -> str:
        """Return a sentence about where the firmware computes, or "". Finding out takes a signal, and signals of this
        process belong to the user."""
        return ""

    # --- inside ---

    def _check_loadable(self) -> None:
        """Load and unload the program once, so that errors appear before a run. Requests of its destructors reach no
        chip.
        """
        loaded, record = self._load(), self._board.link.record
        record["stopped"] = 1
        try:
            loaded.close()
        finally:
            record["stopped"] = 0

    def _load(self) -> LoadedProgram:
        """Load a copy of the firmware with its own bus record, since abandoned firmware keeps its record."""
        return self._program.load(self._board, self.isolated)

    def _start(self) -> None:
        """Start the thread of the firmware."""
        self._loaded = loaded = self._load()
        self._go, self._paused, self._code = threading.Semaphore(0), threading.Semaphore(0), None
        before = threading.stack_size(STACK_SIZE)
        try:
            name = f"firmware {self._path.name}"
            self._thread = threading.Thread(target=self._main, args=(loaded,), name=name, daemon=True)
            self._thread.start()
        finally:
            threading.stack_size(before)

    def _main(self, loaded: LoadedProgram) -> None:
        """Run the firmware in its thread."""
        self._go.acquire()
        link = self._board.link
        link.firmware_thread, link.has_other_threads = threading.get_ident(), False
        code, failure, others = 0, None, list_native_threads()
        top, h = host_requests.get_stack_position.c(), link.record
        h["stack_low"], h["stack_high"], h["stack_checks"] = (
            top - STACK_SIZE,
            top + MAX_FRAME_DISTANCE_BYTES,
            STACK_CHECKS,
        )
        try:
            with self._prepare_thread():
                code = int(loaded.main())
        except Exception as error:
            failure = error
        _reset_float_environment()
        if threading.current_thread() in link.abandoned:
            return
        self._advance_to_end()
        if failure is not None:
            link.set_error(failure)
        self._thread = None
        if left := list_native_threads() - others:  # the code that they run has to stay where it is
            self._unloadable.append(loaded)
            self._report_threads(len(left), code)
        else:
            loaded.close()
        self._code = code
        self._paused.release()

    def _advance_to_end(self) -> None:
        """Advance the stage to the time of firmware that has ended, and remove the firmware's hooks."""
        link = self._board.link
        link.record["lazy"] = 0
        try:
            link.request(link.pointer, host_record.SETTLE, 0, 0)
            link.end_run()
            link.hooks.check_hooks_have_returned()
        except BaseException as error:
            link.set_error(error)
        finally:
            link.hooks.remove_firmware_hooks()

    def _pause(self) -> None:
        """Block the firmware's thread until `resume`. Compiled code calls this function."""
        self._paused.release()
        self._go.acquire()

    def _wait_for_pause(self) -> None:
        """Wait until the firmware pauses, and raise HostError if it does not respond."""
        board = self._board
        h, state, since = board.link.record, None, time.monotonic()
        while not self._paused.acquire(timeout=POLL_INTERVAL_S):
            if self._has_lost_its_thread():
                raise HostError(
                    f"{self._path.name} has ended the thread that runs PULSESTAGE_MAIN (pthread_exit, SYS_exit) at "
                    f"{board.stage.time:.6f} s, after {board.cycles:,} bus cycles. Return from there instead. "
                    f"{board.trace.format_ending(12)}"
                )
            now = (int(h["cycles"]), board.stage.now, board.link.calls)
            if now != state or board.link.calls % 2:  # a call may have much to do
                state, since = now, time.monotonic()
            elif time.monotonic() - since > self._patience:
                if not is_debugged():
                    raise HostError(self._explain_missing_bus_cycle(int(h["answers"])))
                since = time.monotonic()

    def _has_lost_its_thread(self) -> bool:
        """Return whether the firmware's thread has ended although its entry point has not returned."""
        thread = self._thread
        if thread is None or thread.native_id is None or not TASKS.is_dir() or (TASKS / str(thread.native_id)).is_dir():
            return False
        if self._paused.acquire(blocking=False):  # it was paused or has returned meanwhile: the caller is to see that
            self._paused.release()
            return False
        return True

    def _explain_missing_bus_cycle(self, device_code: int) -> str:
        """Explain that the firmware, or a device of the board, has computed for too long without a bus cycle.

        Args:
            device_code: 0 if the firmware computes, else the index of the device whose code runs, plus one (`answers` of HOST).
        """
        board, path = self._board, self._path
        duration, at = f"has computed for {self._patience:g} s of real time", f"at {board.stage.time:.6f} s"
        end = f"{self.outlives} {board.trace.format_ending(12)}"
        if not device_code:
            return (
                f"{path.name} {duration} without a bus cycle or a delay ({at}): a loop that waits for nothing?"
                f"{self._locate(path)} A program that has done its work returns, or waits in a delay: `for (;;) _delay_ms(1);`, or "
                f"ps_delay_us. Computing takes no time, and no interrupt comes in it, unless cost= (--cost) says what it takes: "
                f"docs/interrupts.md.{end}"
            )
        device = board.devices[device_code - 1]
        where = self._locate(device.loaded, path) if isinstance(device, CDevice) else ""
        return f"{device.label} {duration} in one bus cycle of {path.name} ({at}): a loop without end?{where}{end}"

    def _interrupt(self) -> None:
        """Pause the firmware at its next request, or abandon it: after Ctrl-C, or when its patience is exhausted."""
        self._board.link.record["until"] = 0
        if not self._paused.acquire(timeout=INTERRUPT_LIMIT_S):
            self.close()
            self._board.link.take_last_edges()


def _reset_float_environment() -> None:
    """Restore the default floating-point environment of this thread, because Python continues in it after the firmware."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "fesetenv"):
        libc.fesetenv(ctypes.c_void_p(-1))  # FE_DFL_ENV


def list_native_threads() -> set[int]:
    """Return the identifiers of the threads of this process that Python did not start; empty where the system does not
    list threads."""
    try:
        listed = {int(task.name) for task in TASKS.iterdir()}
    except OSError:
        return set()
    # a dummy thread is one of C that has called Python
    python = (thread for thread in threading.enumerate() if type(thread).__name__ != "_DummyThread")
    return listed - {thread.native_id for thread in python}
