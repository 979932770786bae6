"""Firmware in a thread of this process. To pause it, its thread waits within a bus cycle.

A thread cannot be ended from outside. Firmware that must not continue (after an error, or because it loops for ever without a bus
cycle) is abandoned, with a bus that has no effect any more.
"""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

from stage.board import bus, crash, exits, handlers, host, whereabouts
from stage.board.board import Board
from stage.board.devices.own import CDevice
from stage.board.errors import HostError
from stage.board.interrupts import NEAR
from stage.board.link import MOST
from stage.board.program import Loaded, Program
from stage.errors import StageError

PATIENCE = 20.0  # s of real time
STACK = 64 << 20  # bytes
LOOKS = 4  # at requests from other threads of the firmware
BEGIN_S = 0.02  # of real time, for a thread of the firmware to begin
TASKS = Path("/proc/self/task")
"""The threads of this process, where the system lists them."""
GOES_ON = " (Its thread goes on until the process ends; isolated=True ends such a loop.)"


def debugged(process: int | str = "self") -> bool:
    """Whether a debugger holds a process: it may stand still for as long as somebody looks."""
    try:
        with open(f"/proc/{process}/status", errors="replace") as status:
            return any(line.startswith("TracerPid:") and line.split()[1] != "0" for line in status)
    except OSError:
        return False


def handles_timers(process: int) -> bool:
    """Whether a process has a handler for one of the signals of setitimer, of alarm or of timer_create."""
    try:
        with open(f"/proc/{process}/status", errors="replace") as status:
            caught = next((int(line.split()[1], 16) for line in status if line.startswith("SigCgt:")), 0)
    except OSError:
        return False
    return any(caught >> number - 1 & 1 for number in (signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF))


class Threaded:
    """See `Runner`. may_exit: firmware that calls exit ends this process, which is its own. Raises what is wrong with the program
    when it is made."""

    def __init__(self, program: Program, board: Board, patience: float, may_exit: bool = False):
        self._program, self._board, self._patience, self._may_exit = program, board, patience, may_exit
        self._path = program.path
        self._check()
        self._thread: threading.Thread | None = None
        self._code: int | None = None
        self._unloadable: list[Loaded] = []
        self._left = ""  # the call by which the firmware would have ended the process
        self._slept: set[str] = set()  # functions by which it has slept in real time

    @property
    def running(self) -> bool:
        return self._thread is not None

    def go_on(self, until: int, most_cycles: int) -> int | None:
        board = self._board
        if self._thread is None:
            self._start()
        board.link.record["lazy"], board.link.record["quiet"] = 1, 0
        board.link.record["until"], board.link.record["most_cycles"] = until, most_cycles
        board.link.stand_still = self._stand_still
        board.link.begin()
        self._go.release()
        try:
            self._wait()
        except BaseException:
            self._interrupt()
            raise
        finally:
            board.link.stand_still = None
            board.link.record["until"] = board.link.record["most_cycles"] = MOST
            board.link.record["lazy"] = 0
        if board.link.error is not None:
            self._abandon()
        board.link.raise_error()
        if self._left:
            self._abandon()
            board.link.settle()
            would = "the process. Return from PULSESTAGE_MAIN instead; or run it with isolated=True, in a process of its own."
            if self._may_exit:
                would = "the thread that runs PULSESTAGE_MAIN. Return from there instead."
            raise HostError(
                f"{self._path.name}: {self._left} at {board.stage.time:.6f} s, after {board.cycles:,} bus cycles, would have ended "
                f"{would} {board.trace.ending(12)}"
            )
        return self._code

    def close(self) -> None:
        self._abandon()

    def _check(self) -> None:
        """Say what is wrong with it before anything runs. What its destructors do as it is unloaded reaches no chip."""
        loaded, record = self._load(), self._board.link.record
        record["stopped"] = 1
        try:
            loaded.close()
        finally:
            record["stopped"] = 0

    def _load(self) -> Loaded:
        """A copy of the firmware, with a bus of its own: firmware that was given up keeps its own."""
        return self._program.load(self._board, self._may_exit)

    def _start(self) -> None:
        loaded = self._load()
        self._go, self._stands = threading.Semaphore(0), threading.Semaphore(0)
        self._code, self._left, self._slept = None, "", set()
        before = threading.stack_size(STACK)
        try:
            name = f"firmware {self._path.name}"
            self._thread = threading.Thread(target=self._main, args=(loaded,), name=name, daemon=True)
            self._thread.start()
        finally:
            threading.stack_size(before)

    def _main(self, loaded: Loaded) -> None:
        """The firmware's thread."""
        self._go.acquire()
        if self._may_exit and crash.HERE:
            crash.OwnStack()
        me = threading.get_ident()
        runner = exits.identify_runner()
        exits.leavers[runner], exits.sleepers[runner] = self._leave, self._note_sleep
        exits.creators[runner] = self._wait_for_thread
        self._board.link.firmware_thread, self._board.link.has_other_threads = me, False
        code, failed, board, others = 0, None, self._board, native_threads()
        top = bus.here.c()
        board.link.record["stack_low"], board.link.record["stack_high"] = top - STACK, top + NEAR
        board.link.record["looks"] = LOOKS
        if self._may_exit:
            handlers.let_timers_in()
        try:
            code = int(loaded.main())
        except Exception as error:
            failed = error
        _reset_float_environment()
        if self._may_exit:
            handlers.keep_timers_away()
        del exits.leavers[runner], exits.sleepers[runner], exits.creators[runner]
        if threading.current_thread() in board.link.abandoned:
            return
        board.link.record["lazy"] = 0
        try:
            board.link.request(board.link.pointer, host.SETTLE, 0, 0)
            board.link.end()
            board.link.hooks.check_returned()
        except BaseException as error:
            board.link.fail(error)
        finally:
            board.link.hooks.without_firmware()
        if failed is not None:
            board.link.fail(failed)
        self._thread = None
        if left := native_threads() - others:  # what they run has to stay where it is
            self._unloadable.append(loaded)
            if self._may_exit:  # else others than the firmware may have begun them
                board.link.fail(
                    HostError(
                        f"{self._path.name} has returned {code} while {len(left)} of its threads still ran, at "
                        f"{board.stage.time:.6f} s: whatever they do or break, nobody would know. Join them before PULSESTAGE_MAIN "
                        "returns."
                    )
                )
        else:
            loaded.close()
        self._code = code
        self._stands.release()

    def _leave(self, call: str) -> None:
        """In the firmware's thread: it is not to go on, and cannot be ended."""
        me = threading.current_thread()
        if me not in self._board.link.abandoned:
            self._left = call
            if me is self._thread:
                self._stands.release()
            else:  # one that the firmware has started: the firmware stands still at its next request
                self._board.link.record["until"] = 0
        threading.Event().wait()

    def _note_sleep(self, call: str) -> None:
        """Note in the log, once for each function and run, that firmware sleeps in real time. In the firmware's thread."""
        link, name = self._board.link, call.partition("(")[0]
        if name in self._slept or threading.current_thread() in link.abandoned:
            return
        self._slept.add(name)
        mode = bus.compute_as_usual.c()
        try:
            link.request(link.pointer, host.SETTLE, 0, 0)
            with suppress(StageError):  # the log is full
                self._board.note(f"{call} passes real time only, and no simulated time: ps_delay_us passes that")
        finally:
            bus.compute_as_before.c(mode)

    def _wait_for_thread(self) -> None:
        """Let a thread that the firmware has begun come to its first bus cycle, see `Link`. In the firmware's thread."""
        if self._board.link.record["looks"]:
            time.sleep(BEGIN_S)

    def _stand_still(self) -> None:
        """In the firmware's thread, called by compiled code."""
        self._stands.release()
        self._go.acquire()

    def _wait(self) -> None:
        """Wait for the firmware to stand still."""
        board = self._board
        h, seen, since = board.link.record, None, time.monotonic()
        while not self._stands.acquire(timeout=0.2):
            if self._left:
                return
            if self._has_lost_its_thread():
                raise HostError(
                    f"{self._path.name} has ended its thread by a system call (SYS_exit) at {board.stage.time:.6f} s, after "
                    f"{board.cycles:,} bus cycles, and PULSESTAGE_MAIN has not returned. Return from there instead. "
                    f"{board.trace.ending(12)}"
                )
            now = (int(h["cycles"]), board.stage.now, board.link.calls)
            if now != seen or board.link.calls % 2:  # a call may have much to do
                seen, since = now, time.monotonic()
            elif time.monotonic() - since > self._patience and debugged():
                since = time.monotonic()
            elif time.monotonic() - since > self._patience:
                raise HostError(self._computes(int(h["answers"])))

    def _has_lost_its_thread(self) -> bool:
        """Tell whether the firmware's thread has ended without a return of PULSESTAGE_MAIN."""
        thread = self._thread
        if thread is None or thread.native_id is None or not TASKS.is_dir() or (TASKS / str(thread.native_id)).is_dir():
            return False
        if self._stands.acquire(blocking=False):  # it has stood still or returned meanwhile: the caller is to see that
            self._stands.release()
            return False
        return True

    def _computes(self, answers: int) -> str:
        """The patience with it is over; answers: see HOST."""
        board, path = self._board, self._path
        long, at = f"has computed for {self._patience:g} s of real time", f"at {board.stage.time:.6f} s"
        end = f"{'' if self._may_exit else GOES_ON} {board.trace.ending(12)}"
        if not answers:
            return (
                f"{path.name} {long} without a bus cycle or a delay ({at}): a loop that waits for nothing?{self._place(path)} "
                "Computing takes no time, and no interrupt comes in it, unless cost= (--cost) says what it takes: "
                f"docs/interrupts.md.{end}"
            )
        device = board.devices[answers - 1]
        where = self._place(device.loaded, path) if isinstance(device, CDevice) else ""
        return f"{device.label} {long} in one bus cycle of {path.name} ({at}): a loop without end?{where}{end}"

    def _place(self, *libraries: Path) -> str:
        """Where it computes: a sentence."""
        pc, top = whereabouts.of(self._thread) if self._may_exit else (0, 0)  # signals are for whoever has this process
        return f" It is in {crash.place(pc, top, *libraries)}." if pc else ""

    def _interrupt(self) -> None:
        """After Ctrl-C, or when the patience is over: the firmware is paused at its next request, or is abandoned."""
        self._board.link.record["until"] = 0
        if not self._stands.acquire(timeout=0.5):
            self._abandon(stands=False)
            self._board.link.settle()

    def _abandon(self, stands: bool = True) -> None:
        """Whatever the firmware still does, it does not reach the board. stands: it waits in a bus cycle, for ever."""
        if self._thread is not None:
            self._board.link.abandon(self._thread, stands)
        self._thread = None


def _reset_float_environment() -> None:
    """Let this thread compute in the usual mode again, whatever traps and rounding firmware has left: Python goes on in it."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "fesetenv"):
        libc.fesetenv(ctypes.c_void_p(-1))  # FE_DFL_ENV


def native_threads() -> set[int]:
    """The threads of this process that are not Python's, where the system lists them."""
    try:
        listed = {int(name) for name in os.listdir(TASKS)}
    except OSError:
        return set()
    known = (
        thread for thread in threading.enumerate() if type(thread).__name__ != "_DummyThread"
    )  # one that has called Python
    return listed - {thread.native_id for thread in known}
