"""`NativeHost`: firmware in C (C++, Rust, Zig) drives a board.

    host = NativeHost("driver.c", board)       built with cc first; or a shared library
    result = host.run(timeout=10)              until the firmware returns: result.code, .seconds, .cycles
    host.run_for(0.5)                          or for so long: it then stands still in its bus cycle or delay

Time passes in the firmware's bus cycles and delays only, so a run is the same to the bit every time. Each run from the entry uses
a fresh copy of the library: variables are as compiled.
"""

from __future__ import annotations

import ctypes
import math
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from stage.board import bus, library
from stage.board.board import MOST, Board
from stage.errors import ArgumentError, RunTimeout, StageError

MOST_CYCLES = 1_000_000_000
PATIENCE = 20.0  # s of real time
STACK = 64 << 20  # bytes
SHOWN = 12  # lines of the trace in messages


class HostError(StageError):
    """Firmware that could not go on."""


class HostTimeout(RunTimeout):
    """Firmware that did not return in the simulated time, or the bus cycles, that it was given."""


@dataclass(frozen=True)
class Result:
    """What a run came to. code: what the firmware returned; seconds, cycles: simulated time and bus cycles that it took."""

    code: int
    seconds: float
    cycles: int


class NativeHost:
    """Firmware on a board.

    Args:
        firmware: a shared library, or a C or C++ source, which is built first.
        board: a Board; one firmware at a time drives it.
        flags: for the compiler.
        patience: seconds of real time that the firmware may compute without a bus cycle.
    Raises:
        LibraryError: not a library, for another machine, without the entry point, or not built with pulsestage.h.
        CompileError, NoCompilerError: see `build`.
    """

    def __init__(
        self, firmware: str | os.PathLike, board: Board, *, flags: tuple[str, ...] = (), patience: float = PATIENCE
    ):
        if not isinstance(board, Board):
            raise ArgumentError(f"{board!r} is no Board: NativeHost('driver.c', Board(stage)).")
        made = library.build(firmware, flags=flags) if str(firmware).endswith(library.SOURCES) else firmware
        self.path = library.check(made)
        self.board, self.patience = board, patience
        self._bus = library.BusStruct(
            library.ABI, ctypes.sizeof(library.BusStruct), board._rows.ctypes.data, board._request
        )
        library.Library(self.path, self._bus).close()  # says what is wrong before anything runs
        self._thread: threading.Thread | None = None
        self._code: int | None = None
        self._bound = False  # cycles were up, not time
        self._begun: tuple[int, int] = (0, 0)

    @property
    def running(self) -> bool:
        """The firmware has begun and not returned: it stands still in a bus cycle or delay."""
        return self._thread is not None

    @property
    def log(self) -> list[tuple[float, str]]:
        """The lines that the firmware noted (ps_log): seconds, text."""
        return self.board.log

    def run(self, timeout: float = 60.0, max_cycles: int = MOST_CYCLES) -> Result:
        """Run the firmware until it returns: from its entry, or on from where it stands.

        Raises HostTimeout after `timeout` seconds of simulated time or `max_cycles` bus cycles, with the last cycles; it then
        stands still and may be run on. HostError if it makes no bus cycle for `patience` seconds of real time. And what went
        wrong on the way: SimulationError, StormError, an exception of a hook.
        """
        self._go_on(_nanoseconds(timeout, "timeout"), max_cycles)
        if self._code is None:
            board, now = self.board, self.board.stage.time
            bound = f"{max_cycles:,} bus cycles" if self._bound else f"{timeout:g} s of simulated time"
            raise HostTimeout(
                f"{self.path.name} has not returned after {bound} (now {now:.6f} s). Its last bus cycles:\n"
                f"{board.trace.text(SHOWN)}"
            )
        return self._result()

    def run_for(self, seconds: float, max_cycles: int = MOST_CYCLES) -> Result | None:
        """Run the firmware for `seconds` of simulated time; it then stands still, in the middle of a delay maybe, and the stage
        can be looked at and changed. Returns the Result if it has returned, else None; time then has passed up to its return.

        Raises as `run`; HostTimeout for bus cycles only.
        """
        self._go_on(_nanoseconds(seconds, "seconds"), max_cycles)
        if self._code is not None:
            return self._result()
        if self._bound:
            raise HostTimeout(
                f"{self.path.name} has made {max_cycles:,} bus cycles in less than {seconds:g} s (now "
                f"{self.board.stage.time:.6f} s). The last:\n{self.board.trace.text(SHOWN)}"
            )
        return None

    def run_until(self, condition: Callable[[], bool], timeout: float, poll: float = 1e-3) -> float:
        """Run the firmware until `condition()` holds, looked at every `poll` simulated seconds. Returns the seconds that passed.

        Raises RunTimeout when `timeout` was not enough or the firmware has returned before, and as `run`.
        """
        begin = self.board.stage.time
        while not condition():
            passed = self.board.stage.time - begin
            name = getattr(condition, "__name__", repr(condition))
            if passed >= timeout:
                raise RunTimeout(
                    f"condition {name} did not come true in {timeout:g} s (now {self.board.stage.time:.6f} s)."
                )
            if self.run_for(min(poll, timeout - passed)) is not None and not condition():
                raise RunTimeout(
                    f"{self.path.name} returned at {self.board.stage.time:.6f} s, and condition {name} is not true."
                )
        return self.board.stage.time - begin

    def _result(self) -> Result:
        assert self._code is not None
        now, cycles = self._begun
        stage, code = self.board.stage, self._code
        self._code = None
        return Result(code, (stage._now - now) * 1e-9, self.board.cycles - cycles)

    def _go_on(self, ns: int, max_cycles: int) -> None:
        """Let the firmware run up to its return, or to where it is to stand still."""
        board = self.board
        if int(max_cycles) != max_cycles or max_cycles < 1:
            raise ArgumentError(f"max_cycles={max_cycles!r}: a whole number of bus cycles, 1 or more.")
        if self._thread is None:
            if board._driver is not None:
                raise StageError(
                    f"{board._driver.path.name} drives this board and has not returned: a bus has one host."
                )
            self._start()
        h = board._host
        h["lazy"], h["quiet"] = 1, 0
        h["until"], h["most_cycles"] = board.stage._now + ns, int(h["cycles"]) + int(max_cycles)
        board._stand_still = self._stand_still
        board._begin()
        self._go.release()
        try:
            self._wait()
        except BaseException:
            self._interrupt()
            raise
        finally:
            board._stand_still = None
            self._bound = int(h["cycles"]) >= int(h["most_cycles"])
            board._host["until"] = board._host["most_cycles"] = MOST
        if board._error is not None:
            self._abandon()
        board._raise()

    def _start(self) -> None:
        board = self.board
        self._bus.host = board._rows.ctypes.data
        loaded = library.Library(self.path, self._bus)
        self._go, self._stands = threading.Semaphore(0), threading.Semaphore(0)
        self._code, self._begun = None, (board.stage._now, board.cycles)
        before = threading.stack_size(STACK)
        try:
            thread = threading.Thread(target=self._main, args=(loaded,), name=f"firmware {self.path.name}", daemon=True)
            thread.start()
        finally:
            threading.stack_size(before)
        board._driver, self._thread = self, thread

    def _main(self, loaded: library.Library) -> None:
        """The firmware's thread."""
        self._go.acquire()
        code, board = int(loaded.main()), self.board
        if threading.get_ident() in board._abandoned:
            return
        board._host["hook"] = board._host["lazy"] = 0
        try:
            board._request(board._rows.ctypes.data, bus.SETTLE, 0, 0)
            board._end()
        except BaseException as error:
            board._fail(error)
        board._driver = self._thread = None
        loaded.close()
        self._code = code
        self._stands.release()

    def _stand_still(self) -> None:
        """In the firmware's thread, called by compiled code."""
        self._stands.release()
        self._go.acquire()

    def _wait(self) -> None:
        """Wait for the firmware to stand still."""
        h, seen, since = self.board._host, None, time.monotonic()
        while not self._stands.acquire(timeout=0.2):
            now = (int(h["cycles"]), self.board.stage._now)
            if now != seen:
                seen, since = now, time.monotonic()
            elif time.monotonic() - since > self.patience:
                raise HostError(
                    f"{self.path.name} has computed for {self.patience:g} s of real time without a bus cycle or a delay (at "
                    f"{self.board.stage.time:.6f} s): a loop that waits for nothing? Its thread goes on until the process ends; "
                    f"isolated=True ends it. Its last bus cycles:\n{self.board.trace.text(SHOWN)}"
                )

    def _interrupt(self) -> None:
        """Somebody has pressed Ctrl-C, or lost patience: the firmware stands still at its next request, or is left alone."""
        self.board._host["until"] = 0
        if not self._stands.acquire(timeout=0.5):
            self._abandon()

    def _abandon(self) -> None:
        """Whatever the firmware still does, it does not reach the board."""
        if self._thread is not None:
            self.board._abandon(self._thread)
        self.board._driver = self._thread = None


def _nanoseconds(seconds: float, name: str) -> int:
    if not (isinstance(seconds, int | float) and 0 <= seconds < 1e9 and math.isfinite(seconds)):
        raise ArgumentError(f"{name}={seconds!r}: simulated time from 0 to 1e9 s.")
    return round(seconds * 1e9)
