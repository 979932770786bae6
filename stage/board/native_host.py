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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

from stage.board import firmware_library, memory_mapped_ports
from stage.board.board import Board
from stage.board.bus.serial_core import SERIAL_LINE_COUNT
from stage.board.crash_report import IS_SUPPORTED
from stage.board.errors import HostTimeout
from stage.board.firmware_pins import parse_firmware_pins
from stage.board.host_record_link import UNBOUNDED
from stage.board.pacing import RealTimePace
from stage.board.pin_assignment import EMPTY_WIRING, PinWiring, WiringFinding
from stage.board.serial_line import SerialPort
from stage.board.temporary_folders import TemporaryFolder
from stage.board.thread_runner import PATIENCE_S, LoadedProgram, Program, ThreadRunner
from stage.board.uart_wiring import UartWiring
from stage.chips.exclusive_access import SessionLock, exclusive
from stage.errors import ArgumentError, RunTimeout, StageError

DEFAULT_MAX_CYCLES = 1_000_000_000
LISTED_CYCLES = 12  # lines of the trace in messages


@dataclass(frozen=True)
class Result:
    """Result of firmware that has returned.

    Attributes:
        code: Exit code of the firmware.
        seconds: Simulated time that the run took.
        cycles: Number of bus cycles that the run made.
    """

    code: int
    seconds: float
    cycles: int


class Runner(Protocol):
    """Executor of firmware: `ThreadRunner` in this process, or `ProcessRunner` in a separate process."""

    @property
    def wiring_findings(self) -> tuple[WiringFinding, ...]:
        """Signs that lines of axes are at the wrong pins of the firmware."""
        ...

    @property
    def running(self) -> bool:
        """True while the firmware has started and has not returned."""
        ...

    def resume(self, until: int, max_cycles: int) -> int | None:
        """Run the firmware until it returns or reaches a limit, where it pauses. An error ends it.

        Args:
            until: Board time at which the firmware pauses, ns.
            max_cycles: Total number of bus cycles of the board at which the firmware pauses.

        Returns:
            Exit code of the firmware, or None if it is paused.
        """

    def close(self) -> None:
        """End the firmware, or abandon it if it cannot be ended."""


class Host:
    """Firmware on a board; the base of NativeHost and stage.targets.TargetHost.

    Attributes:
        path: File of the firmware.
        board: The Board that it drives.
        serial: Other end of the firmware's first serial line.
        pacing: Pace of the run in wall-clock time, or None for as fast as possible.
        serial_lack: Sentence about firmware that has no serial line.
        is_closed: Whether the firmware was closed, and no run has begun since.
    """

    serial_lack = "it has no serial line."
    SERIAL_LINES = 1
    """Number of serial lines of the firmware."""

    def __init__(self, program: Program, board: Board, isolated: bool, patience: float):
        self.path, self.board = program.path, board
        board.serial_lines.rows["is_wired"] = 0
        self._runner: Runner
        if isolated:
            from stage.board.isolation.process_runner import ProcessRunner

            self._runner = ProcessRunner(program, board, patience)
        else:
            self._runner = ThreadRunner(program, board, patience)
        self._start = (0, 0)  # time and cycles
        self.is_closed = False
        self.serial = SerialPort(self)
        self._serial_ports = {0: self.serial}
        self.pacing: RealTimePace | None = None
        self._uart_wiring: UartWiring | None = None

    @classmethod
    def _check_arguments(cls, board: Board, patience: float, example: str) -> None:
        """Raise ArgumentError for an object that is no board, and for a patience that is not above 0."""
        if not isinstance(board, Board):
            raise ArgumentError(f"{board!r} is no Board: {cls.__name__}({example}, Board(stage)).")
        if not (isinstance(patience, int | float) and patience > 0):
            raise ArgumentError(f"patience={patience!r}: seconds of real time, more than 0.")

    def _connect_uarts(self, wiring: PinWiring) -> None:
        """Connect the UARTs of axes' chips to serial lines of the firmware.

        Raises:
            ArgumentError: The firmware does not have one of the serial lines.
        """
        self._uart_wiring = UartWiring(self, wiring)

    def get_serial_port(self, number: int) -> SerialPort:
        """Return the other end of a serial line; bytes that the firmware sends over it before the first call are lost.

        Args:
            number: 0 is `serial`. Of a sketch, 1 to 3 are Serial1 to Serial3, and 4 to 7 its first objects of SoftwareSerial.

        Raises:
            ArgumentError: There is no line with this number.
        """
        present = self.board.serial_lines.list_present(self.SERIAL_LINES)
        if number not in present:
            raise ArgumentError(
                f"number={number!r}: the serial lines of {self.path.name} are {', '.join(map(str, present))}."
            )
        if number not in self._serial_ports:
            self._serial_ports[number] = SerialPort(self, number)
        return self._serial_ports[number]

    def get_open_serial_ports(self) -> Mapping[int, SerialPort]:
        """Return the other ends of the serial lines that `get_serial_port` has opened, by the number of the line."""
        return self._serial_ports

    @property
    def running(self) -> bool:
        """True while the firmware has started and has not returned; it is then paused in a bus cycle or delay."""
        return self._runner.running

    @property
    def wiring_findings(self) -> tuple[WiringFinding, ...]:
        """Signs that lines of axes are at the wrong pins of the firmware, as of the last pause or end."""
        return self._runner.wiring_findings + (self._uart_wiring.find_wiring_findings() if self._uart_wiring else ())

    @property
    def wiring_problems(self) -> tuple[str, ...]:
        """Sentences about lines of axes at the wrong pins: those of `wiring_findings` that are problems."""
        return tuple(finding.text for finding in self.wiring_findings if finding.is_problem)

    @property
    def log(self) -> list[tuple[float, str]]:
        """Lines that the firmware logged by ps_log: (seconds, text)."""
        return self.board.log

    def run(self, timeout: float = 60.0, max_cycles: int = DEFAULT_MAX_CYCLES) -> Result:
        """Run the firmware until it returns, from its entry point or from where it is paused.

        Args:
            timeout: Maximum simulated time, s.
            max_cycles: Maximum number of bus cycles.

        Raises:
            HostTimeout: The firmware has not returned within these limits. It is paused, and another call resumes it.
            HostError: The firmware has crashed, or has made no bus cycle for `patience` seconds of real time.
            SimulationError, StormError: The simulation has diverged, or a hook does not clear its interrupt. Exceptions
                of hooks in Python pass through unchanged.
        """
        result = self._resume(to_nanoseconds(timeout, "timeout"), max_cycles)
        if result is None:
            by_time = self.board.cycles < self._cycle_limit
            bound = f"{timeout:g} s of simulated time" if by_time else f"{max_cycles:,} bus cycles"
            raise self._make_timeout(f"has not returned after {bound}")
        return result

    def run_for(self, seconds: float, max_cycles: int = DEFAULT_MAX_CYCLES) -> Result | None:
        """Run the firmware for a simulated time and then pause it, possibly in the middle of a delay.

        While the firmware is paused, the stage can be read and changed.

        Args:
            seconds: Simulated time, s.
            max_cycles: Maximum number of bus cycles.

        Returns:
            The Result if the firmware has returned; the remaining time does not pass then. Otherwise None.

        Raises:
            HostTimeout: The firmware has made too many bus cycles. Other errors are those of `run`.
        """
        result = self._resume(to_nanoseconds(seconds, "seconds"), max_cycles)
        if result is None and self.board.cycles >= self._cycle_limit:
            raise self._make_timeout(f"has made {max_cycles:,} bus cycles in less than {seconds:g} s")
        return result

    def run_until(self, condition: Callable[[], bool], timeout: float, poll: float = 1e-3) -> float:
        """Run the firmware until `condition()` is true.

        Args:
            condition: Function without arguments.
            timeout: Maximum simulated time, s.
            poll: Simulated time between two evaluations of the condition, s.

        Returns:
            Simulated seconds that passed.

        Raises:
            RunTimeout: The condition did not come true within `timeout`, or the firmware returned before. Other errors
                are those of `run`.
        """
        stage = self.board.stage
        begin, name = stage.now, getattr(condition, "__name__", repr(condition))
        end, interval = begin + to_nanoseconds(timeout, "timeout"), max(to_nanoseconds(poll, "poll"), 1)
        while not condition():
            if stage.now >= end:
                raise RunTimeout(f"condition {name} did not come true in {timeout:g} s (now {stage.time:.6f} s).")
            done = self.run_for(min(interval, end - stage.now) * 1e-9)
            if done is not None and not condition():
                raise RunTimeout(f"{self.path.name} returned at {stage.time:.6f} s, and condition {name} is not true.")
        return (stage.now - begin) * 1e-9

    def close(self) -> None:
        """Abandon paused firmware. A separate process ends. A thread of this process cannot be ended: it waits forever,
        and its code stays in memory."""
        if self.running:
            self.board.stage.loop.check_state_change_allowed()
        self.is_closed = True
        self._runner.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.path.name}, {'in the middle' if self.running else 'not running'}; {self.board!r}>"

    @property
    def lock(self) -> SessionLock | None:
        """Lock of the board's stage, see `Stage.lock`. A run of firmware holds it."""
        return self.board.stage.lock

    @exclusive
    def _resume(self, ns: int, max_cycles: int) -> Result | None:
        """Run the firmware for `ns` nanoseconds or up to `max_cycles` bus cycles; return its result if it has returned."""
        board, stage = self.board, self.board.stage
        if int(max_cycles) != max_cycles or max_cycles < 1:
            raise ArgumentError(f"max_cycles={max_cycles!r}: a whole number of bus cycles, 1 or more.")
        stage.loop.check_state_change_allowed()
        if not self.running:
            if board.driver is not None and board.driver.running:
                raise StageError(
                    f"{board.driver.path.name} drives this board and has not returned: a bus has one host. "
                    "Run it on, or close() it."
                )
            board.driver, self._start, self.is_closed = self, (stage.now, board.cycles), False
        self._cycle_limit = min(board.cycles + int(max_cycles), UNBOUNDED)
        code = self._run_to(stage.now + ns)
        now, cycles = self._start
        return None if code is None else Result(code, (stage.now - now) * 1e-9, board.cycles - cycles)

    def _run_to(self, end: int) -> int | None:
        """Run the firmware until it returns, until the time `end` (ns), or until the other end of a serial line is satisfied.

        Returns:
            Exit code of the firmware, or None if it is paused.
        """
        board, ports, pacing = self.board, tuple(self._serial_ports.values()), self.pacing
        while True:
            for port in ports:
                port.exchange()
            until, begin = min(port.choose_next_exchange(end) for port in ports), board.stage.now
            if pacing is not None:
                pacing.start(begin)
                until = min(until, begin + pacing.SLICE_NS)
            code = self._runner.resume(until, self._cycle_limit)
            moved = sum([port.exchange() for port in ports])
            if pacing is not None:
                pacing.wait(board.stage.now)
            is_over = (
                board.stage.now >= end or board.cycles >= self._cycle_limit or any(port.is_satisfied for port in ports)
            )
            if code is not None or is_over or not (moved or board.stage.now > begin):
                return code

    def _make_timeout(self, what: str) -> HostTimeout:
        """Return the error for firmware that has not returned within its limits."""
        board = self.board
        return HostTimeout(
            f"{self.path.name} {what} (now {board.stage.time:.6f} s). {board.trace.format_ending(LISTED_CYCLES)}"
        )


@dataclass(frozen=True)
class NativeProgram:
    """Firmware in a shared library of this machine.

    Attributes:
        path: Path of the library.
        windows: Windows of memory-mapped registers.
        cost: Simulated time that each basic block takes, ps; 0: the library does not count basic blocks.
        wiring: Lines of axes at its pins.
    """

    path: Path
    windows: tuple[memory_mapped_ports.MemoryWindow, ...] = ()
    cost: int = 0
    wiring: PinWiring = EMPTY_WIRING

    def load(self, board: Board, isolated: bool) -> LoadedProgram:
        """Load a copy of the library for a board.

        Args:
            board: Board that the firmware drives.
            isolated: Whether this process runs only the firmware.

        Raises:
            LibraryError: The library contains no firmware.
            ArgumentError: A window does not fit.
            StageError: Windows are not available on this system.
        """
        if isolated and IS_SUPPORTED:
            from stage.board.isolation.traps import TrappedLibrary

            return TrappedLibrary(self.path, board.link, self.cost, self.wiring, self.windows)
        if self.windows:
            raise StageError(
                f"map={', '.join(map(str, self.windows))}: {memory_mapped_ports.explain_missing_windows(isolated)}"
            )
        return firmware_library.Library(self.path, board.link, self.cost, self.wiring)


class NativeHost(Host):
    """Host whose firmware is a library of this machine.

    Args:
        firmware: A shared library, or C or C++ sources (one, or a sequence), which are built first.
        board: Board that the firmware drives. Only one firmware at a time can drive a board.
        isolated: Whether the firmware runs in a separate process, so that its crash becomes an error (default, on POSIX systems).
            False is for debuggers: the firmware is loaded into this process, and its effects happen to this process.
        flags: Flags for the compiler.
        platform: Platform for which the sources were written (arduino, avr, vxworks, dos, freertos), see stage.board.platforms.
        libraries: Folders of Arduino libraries that a sketch uses, see docs/step_dir.md.
        patience: Seconds of real time that the firmware may compute without a bus cycle.
        map: Windows of memory-mapped registers, see stage.board.memory_mapped_ports: one, or a sequence.
        cost: Simulated seconds that each basic block of the firmware takes (default: none), see docs/interrupts.md. Sources are
            built so that they count their basic blocks.
        pins: Pins of the firmware that are lines of STEP/DIR axes, see stage.board.pin_assignment: one text or several.

    Raises:
        ArgumentError: A patience, window or cost is out of range.
        LibraryError: The file is no library, is for another machine, has no entry point, or was not built with pulsestage.h.
        CompileError, NoCompilerError: See `build`.
    """

    SERIAL_LINES = SERIAL_LINE_COUNT

    def __init__(  # noqa: PLR0913  each is one property of the firmware or of its wiring
        self,
        firmware: str | os.PathLike | Sequence[str | os.PathLike],
        board: Board,
        *,
        isolated: bool = os.name == "posix",
        flags: tuple[str, ...] = (),
        platform: str | None = None,
        libraries: Sequence[str | os.PathLike] = (),
        patience: float = PATIENCE_S,
        map: memory_mapped_ports.Windows = (),
        cost: float = 0.0,
        pins: str | Sequence[str] = (),
    ):
        self._check_arguments(board, patience, "'driver.c'")
        if not (isinstance(cost, int | float) and (cost == 0 or 1e-12 <= cost <= 1)):
            raise ArgumentError(
                f"cost={cost!r}: simulated seconds a basic block, 1e-12 to 1, for example 50e-9; 0 for none."
            )
        mapped = memory_mapped_ports.parse_windows(map)
        wiring = parse_firmware_pins(pins, board.stage)
        # what is built goes with the host
        self._scratch = TemporaryFolder() if firmware_library.are_sources(firmware) else None
        folder = self._scratch.path if self._scratch else None
        path = firmware_library.find_or_build_library(firmware, flags, platform, folder, cost > 0, libraries)
        super().__init__(NativeProgram(path, mapped, round(cost * 1e12), wiring), board, isolated, patience)
        board.serial_lines.rows["is_wired"] = 1
        self._connect_uarts(wiring)


def to_nanoseconds(seconds: float, name: str) -> int:
    """Convert a simulated time in seconds to nanoseconds.

    Args:
        seconds: Simulated time, s.
        name: Name of the argument, for the error.

    Raises:
        ArgumentError: The time is not between 0 and 1e9 s.
    """
    if not (isinstance(seconds, int | float) and 0 <= seconds < 1e9 and math.isfinite(seconds)):
        raise ArgumentError(f"{name}={seconds!r}: simulated time from 0 to 1e9 s.")
    return round(seconds * 1e9)
