"""`SingleBoardHost`: a program for a single-board computer drives a stage in this process, by pins, a serial port and its clock.

    with SingleBoardHost(stage) as host:
        path = host.open_uart("x")                a pseudo-terminal: the program's /dev/serial0
        host.watch_line("x", "diag", callback)    calls callback(level) when the line changes
        host.replace_clock()                      time.sleep and time.time_ns of the program are the stage's
        host.set_line("x", "step", True)          what its GPIO library does

The program is not changed. Simulated time passes while it sleeps, waits for a reply, or asks for the time: each look at a clock
takes CLOCK_READ_S, so that loops that wait for a moment end.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from stage.board.serial_pty_and_tcp import PtyEnd
from stage.board.uart_wire import UartWire
from stage.errors import ArgumentError

if TYPE_CHECKING:
    from types import TracebackType

    from stage import Stage

CLOCK_READ_S = 20e-6
MAX_POLL_INTERVAL_S = 200e-6
"""Longest simulated time between two polls of the watched lines and the serial port."""
SHARED_ADVANCE_S = 20e-6
"""Simulated time that passes at once while other threads of the program may want to act in between."""
YIELD_S = 20e-6
"""Real time for which a thread then steps back."""
IDLE_POLL_INTERVAL_S = 200e-6
"""Real time between two polls of the serial port while no simulated time passes."""
TURNAROUND_S = 200e-6
"""Simulated time that passes after the last byte: no program is faster, and chips listen again after an idle time."""
CLOCKS = ("time", "monotonic", "perf_counter")


class SingleBoardHost:
    """Pins, serial port and clock of a host program, for a stage whose axes have chips with a UART.

    Args:
        stage: The stage; only this host and the program may let its time pass.
    """

    def __init__(self, stage: Stage):
        self.stage = stage
        self._lock = threading.RLock()
        self._watched: list[tuple[Any, str, Callable[[bool], Any], list[bool]]] = []
        self._end: PtyEnd | None = None
        self._wire: UartWire | None = None
        self._to_host, self._exchanged = b"", stage.time
        self._server: threading.Thread | None = None
        self._closes = threading.Event()
        self._real_functions: dict[str, Any] = {}
        self._real_sleep, self._epoch_ns = time.sleep, time.time_ns()

    def __enter__(self) -> SingleBoardHost:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # --- pins ---

    def set_line(self, axis: str, line: str, is_asserted: bool) -> None:
        """Drive a line of a STEP/DIR axis, at the present time."""
        with self._lock:
            setattr(self.stage.axes[axis].chip, line, bool(is_asserted))

    def read_line(self, axis: str, line: str) -> bool:
        """Return whether a line of a STEP/DIR axis is asserted."""
        with self._lock:
            return bool(getattr(self.stage.axes[axis].chip, line))

    def watch_line(self, axis: str, line: str, callback: Callable[[bool], Any]) -> None:
        """Call a function with the level of a line when it changes, within SLICE_S of simulated time."""
        chip = self.stage.axes[axis].chip
        self._watched.append((chip, line, callback, [bool(getattr(chip, line))]))

    # --- serial port ---

    def open_uart(self, *axes: str, echo: bool = True) -> str:
        """Open a pseudo-terminal whose other end is the wire of the axes' chips, and return its path.

        Args:
            axes: Axes whose chips share the wire, with different addresses.
            echo: The program hears what it sends, as on a single wire.

        Raises:
            ArgumentError: A chip has no UART, or a serial port is open already.
        """
        for name in axes:
            if not hasattr(self.stage.axes[name].chip, "uart"):
                raise ArgumentError(f"open_uart({name!r}): the chip of this axis has no UART.")
        if self._end is not None or not axes:
            raise ArgumentError("open_uart: name the axes of one wire; a host has one serial port.")
        self._wire = UartWire([self.stage.axes[name].chip.uart for name in axes], echoes=echo)
        self._end = PtyEnd()
        self._server = threading.Thread(target=self._serve, name="UART of a SingleBoardHost", daemon=True)
        self._server.start()
        return str(self._end.path)

    def _exchange(self) -> bool:
        """Move bytes between the pseudo-terminal and the chips, and return whether bytes are on their way."""
        if self._end is None or self._wire is None:
            return False
        now, room = self.stage.now, self._wire.room
        self._to_host = self._wire.exchange(self._end.exchange(self._to_host, now, room), now, room)
        return bool(self._to_host) or self._wire.is_busy

    def _serve(self) -> None:
        """Let time pass while a program waits for a reply, until `close`."""
        idle_from = 0.0
        while not self._closes.is_set():
            with self._lock:
                if self._exchange():
                    idle_from = self.stage.time + TURNAROUND_S
                is_busy = self.stage.time < idle_from
                if is_busy:
                    self._advance(SHARED_ADVANCE_S)
            self._real_sleep(YIELD_S if is_busy else IDLE_POLL_INTERVAL_S)

    # --- time ---

    def advance(self, seconds: float) -> None:
        """Let simulated time pass, and poll the serial port and the watched lines meanwhile."""
        is_shared = threading.active_count() > 1 + (self._server is not None)
        slice_s = SHARED_ADVANCE_S if is_shared else MAX_POLL_INTERVAL_S
        while seconds > 0:
            with self._lock:
                if self.stage.time - self._exchanged >= slice_s or seconds >= slice_s:
                    self._exchange()
                    self._exchanged = self.stage.time
                self._advance(min(seconds, slice_s))
            seconds -= slice_s
            if is_shared:
                self._real_sleep(YIELD_S)

    def _advance(self, seconds: float) -> None:
        self.stage.run(seconds)
        for chip, line, callback, last in self._watched:
            level = bool(getattr(chip, line))
            if level != last[0]:
                last[0] = level
                callback(level)

    def read_time_ns(self) -> int:
        """Return the program's time, ns since 1970, after the simulated time that a read of the clock takes."""
        self.advance(CLOCK_READ_S)
        return self._epoch_ns + int(self.stage.now)

    def read_time(self) -> float:
        """Return the program's time, s since 1970, see `read_time_ns`."""
        return self.read_time_ns() * 1e-9

    def replace_clock(self) -> None:
        """Replace sleep and the clocks of the module `time` by those of the stage, until `close`."""
        functions: dict[str, Any] = {
            "sleep": self.advance,
            "time_ns": self.read_time_ns,
            **dict.fromkeys(CLOCKS, self.read_time),
        }
        for name, function in functions.items():
            self._real_functions[name] = getattr(time, name)
            setattr(time, name, function)

    def close(self) -> None:
        """Close the serial port and give the program its real clock back."""
        for name, function in self._real_functions.items():
            setattr(time, name, function)
        self._real_functions.clear()
        self._closes.set()
        if self._server is not None:
            self._server.join()
        if self._end is not None:
            self._end.close()
            self._end = None
