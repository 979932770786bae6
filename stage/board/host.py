"""`NativeHost`: firmware in C (C++, Rust, Zig) drives a board.

    host = NativeHost("driver.c", board)       built with cc first; or a shared library
    result = host.run(timeout=10)              until the firmware returns: result.code, .seconds, .cycles
    host.run_for(0.5)                          or for so long: it is then paused in its bus cycle or delay

Time passes in the firmware's bus cycles and delays only, so every run gives the same bits. Each run from the entry uses a fresh
copy of the library: variables have their initial values.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

from stage.board import library, windows
from stage.board.board import Board
from stage.board.crash_report import IS_SUPPORTED
from stage.board.errors import HostTimeout
from stage.board.link import MOST
from stage.board.scratch import Scratch
from stage.board.thread_runner import PATIENCE, Loaded, Program, Threaded
from stage.chips.sharing import Lock, exclusive
from stage.errors import ArgumentError, RunTimeout, StageError

MOST_CYCLES = 1_000_000_000
SHOWN = 12  # lines of the trace in messages


@dataclass(frozen=True)
class Result:
    """The result of a run. code: what the firmware returned; seconds, cycles: simulated time and bus cycles that it took."""

    code: int
    seconds: float
    cycles: int


class Runner(Protocol):
    """Where firmware runs. running: it has begun and not returned."""

    @property
    def running(self) -> bool: ...

    def go_on(self, until: int, most_cycles: int) -> int | None:
        """Let it run up to a time (ns) or a number of cycles of the board. What it returned, or None if it stands still.

        Raises what went wrong; it then runs no more.
        """

    def close(self) -> None: ...


class Host:
    """Firmware on a board: what is the same for all its kinds. See NativeHost and stage.targets.TargetHost.

    Attributes: path: its file; board: the Board that it drives.
    """

    def __init__(self, program: Program, board: Board, isolated: bool, patience: float):
        self.path, self.board = program.path, board
        self._runner: Runner
        if isolated:
            from stage.board.isolation.process_runner import Isolated

            self._runner = Isolated(program, board, patience)
        else:
            self._runner = Threaded(program, board, patience)
        self._begun = (0, 0)

    @classmethod
    def _check(cls, board: Board, patience: float, example: str) -> None:
        if not isinstance(board, Board):
            raise ArgumentError(f"{board!r} is no Board: {cls.__name__}({example}, Board(stage)).")
        if not (isinstance(patience, int | float) and patience > 0):
            raise ArgumentError(f"patience={patience!r}: seconds of real time, more than 0.")

    @property
    def running(self) -> bool:
        """The firmware has begun and not returned: it stands still in a bus cycle or delay."""
        return self._runner.running

    @property
    def log(self) -> list[tuple[float, str]]:
        """The lines that the firmware noted (ps_log): seconds, text."""
        return self.board.log

    def run(self, timeout: float = 60.0, max_cycles: int = MOST_CYCLES) -> Result:
        """Run the firmware until it returns: from its entry, or on from where it stands.

        Raises HostTimeout after `timeout` seconds of simulated time or `max_cycles` bus cycles, with the last cycles; it then
        stands still and may be run on. HostError if it makes no bus cycle for `patience` seconds of real time, or has crashed.
        And what went wrong on the way: SimulationError, StormError, an exception of a hook.
        """
        result = self._go_on(_nanoseconds(timeout, "timeout"), max_cycles)
        if result is None:
            bound = (
                f"{timeout:g} s of simulated time" if self.board.cycles < self._most else f"{max_cycles:,} bus cycles"
            )
            raise self._timeout(f"has not returned after {bound}")
        return result

    def run_for(self, seconds: float, max_cycles: int = MOST_CYCLES) -> Result | None:
        """Run the firmware for `seconds` of simulated time; it then stands still, in the middle of a delay maybe, and the stage
        can be looked at and changed. Returns the Result if it has returned, else None; time then has passed up to its return.

        Raises as `run`; HostTimeout for bus cycles only.
        """
        result = self._go_on(_nanoseconds(seconds, "seconds"), max_cycles)
        if result is None and self.board.cycles >= self._most:
            raise self._timeout(f"has made {max_cycles:,} bus cycles in less than {seconds:g} s")
        return result

    def run_until(self, condition: Callable[[], bool], timeout: float, poll: float = 1e-3) -> float:
        """Run the firmware until `condition()` holds, looked at every `poll` simulated seconds. Returns the seconds that passed.

        Raises RunTimeout when `timeout` was not enough or the firmware has returned before, and as `run`.
        """
        stage = self.board.stage
        begin, name = stage.now, getattr(condition, "__name__", repr(condition))
        end, pause = begin + _nanoseconds(timeout, "timeout"), max(_nanoseconds(poll, "poll"), 1)
        while not condition():
            if stage.now >= end:
                raise RunTimeout(f"condition {name} did not come true in {timeout:g} s (now {stage.time:.6f} s).")
            done = self.run_for(min(pause, end - stage.now) * 1e-9)
            if done is not None and not condition():
                raise RunTimeout(f"{self.path.name} returned at {stage.time:.6f} s, and condition {name} is not true.")
        return (stage.now - begin) * 1e-9

    def close(self) -> None:
        """Give up firmware that stands still; a process of its own ends. A thread cannot be ended: it waits for ever, and what
        it stands in stays in memory."""
        if self.running:
            self.board.stage.loop.check_state_allowed()
        self._runner.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.path.name}, {'in the middle' if self.running else 'not running'}; {self.board!r}>"

    @property
    def lock(self) -> Lock | None:
        """Lock of the board's stage, see `Stage.lock`: a run of firmware has it from its begin to its end."""
        return self.board.stage.lock

    @exclusive
    def _go_on(self, ns: int, max_cycles: int) -> Result | None:
        board, stage = self.board, self.board.stage
        if int(max_cycles) != max_cycles or max_cycles < 1:
            raise ArgumentError(f"max_cycles={max_cycles!r}: a whole number of bus cycles, 1 or more.")
        stage.loop.check_state_allowed()
        if not self.running:
            if board.driver is not None and board.driver.running:
                raise StageError(
                    f"{board.driver.path.name} drives this board and has not returned: a bus has one host. "
                    "Run it on, or close() it."
                )
            board.driver, self._begun = self, (stage.now, board.cycles)
        self._most = min(board.cycles + int(max_cycles), MOST)
        code = self._runner.go_on(stage.now + ns, self._most)
        now, cycles = self._begun
        return None if code is None else Result(code, (stage.now - now) * 1e-9, board.cycles - cycles)

    def _timeout(self, what: str) -> HostTimeout:
        board = self.board
        return HostTimeout(f"{self.path.name} {what} (now {board.stage.time:.6f} s). {board.trace.ending(SHOWN)}")


@dataclass(frozen=True)
class NativeProgram:
    """A library of this machine. cost: ps that each of its basic blocks takes; 0: it does not count them."""

    path: Path
    windows: tuple[windows.Window, ...] = ()
    cost: int = 0

    def load(self, board: Board, isolated: bool) -> Loaded:
        """See `Program`. Raises LibraryError, ArgumentError for a window that cannot be, StageError for one in process."""
        if isolated and IS_SUPPORTED:
            from stage.board.isolation.traps import TrappedLibrary

            return TrappedLibrary(self.path, board.link, self.cost, self.windows)
        if self.windows:
            raise StageError(f"map={', '.join(map(str, self.windows))}: {windows.explain_missing(isolated)}")
        return library.Library(self.path, board.link, self.cost)


class NativeHost(Host):
    """Firmware as a library of this machine.

    Args:
        firmware: a shared library, or C or C++ sources (one, or a sequence), which are built first.
        board: a Board; one firmware at a time drives it.
        isolated: run it in a process of its own, whose crash is an error here (default, on POSIX systems; stage.board.isolation).
            False is for debuggers: it is then loaded into this process, and whatever it does happens to this process.
        flags: for the compiler.
        platform: what the sources were written for (arduino, avr, vxworks, dos, freertos), see stage.board.platforms.
        patience: seconds of real time that the firmware may compute without a bus cycle.
        map: windows of memory-mapped registers, see stage.board.windows: one, or a sequence.
        cost: simulated seconds that each basic block of the firmware takes (default: none), see docs/interrupts.md; sources are
            built so that they count them.
    Raises:
        ArgumentError: a patience that is none, a window that cannot be, a cost that is none.
        LibraryError: not a library, for another machine, without the entry point, or not built with pulsestage.h.
        CompileError, NoCompilerError: see `build`.
    """

    def __init__(
        self,
        firmware: str | os.PathLike | Sequence[str | os.PathLike],
        board: Board,
        *,
        isolated: bool = os.name == "posix",
        flags: tuple[str, ...] = (),
        platform: str | None = None,
        patience: float = PATIENCE,
        map: windows.Given = (),
        cost: float = 0.0,
    ):
        self._check(board, patience, "'driver.c'")
        if not (isinstance(cost, int | float) and (cost == 0 or 1e-12 <= cost <= 1)):
            raise ArgumentError(
                f"cost={cost!r}: simulated seconds a basic block, 1e-12 to 1, for example 50e-9; 0 for none."
            )
        mapped = windows.windows(map)
        self._scratch = Scratch() if library.are_sources(firmware) else None  # what is built goes with the host
        path = library.ready(firmware, flags, platform, self._scratch.path if self._scratch else None, metered=cost > 0)
        super().__init__(NativeProgram(path, mapped, round(cost * 1e12)), board, isolated, patience)


def _nanoseconds(seconds: float, name: str) -> int:
    if not (isinstance(seconds, int | float) and 0 <= seconds < 1e9 and math.isfinite(seconds)):
        raise ArgumentError(f"{name}={seconds!r}: simulated time from 0 to 1e9 s.")
    return round(seconds * 1e9)
