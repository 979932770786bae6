"""Traps for what firmware does apart from its requests: crashes, memory-mapped accesses, sleeps, threads, signal handlers.

All traps change the process in which they run: they replace slots of calls, handle signals in machine code, and emulate x86
instructions after a fault. So only the process that `stage.board.isolation` starts for firmware imports this package. Firmware in
the user's own process is only a library loaded by ctypes. Needs 64-bit Linux, see `crash_report.IS_SUPPORTED`.

    watch_crashes(note)                    once: a crash leaves a note of what was accessed, and by which calls
    library = TrappedLibrary(...)          firmware with windows of memory-mapped registers, whose sleeps and threads are reported
    with trap_thread(on_sleep, on_thread): around its entry point, in its thread
    find_position(thread)                  where it computes
    redirect_calls(handle, functions)      let a library call other functions
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from stage.board.firmware_library import Library
from stage.board.host_record_link import Link
from stage.board.isolation.traps.memory_windows import MemoryWindows
from stage.board.isolation.traps.signal_handlers import (
    SignalHandlers,
    allocate_signal_stack,
    block_timers,
    find_position,
    unblock_timers,
    watch_crashes,
)
from stage.board.isolation.traps.sleep_calls import observe_calls, redirect_calls, set_observer
from stage.board.memory_mapped_ports import MemoryWindow
from stage.board.pin_assignment import PinWiring
from stage.errors import StageError

__all__ = ["TrappedLibrary", "block_timers", "find_position", "redirect_calls", "trap_thread", "watch_crashes"]


class TrappedLibrary(Library):
    """Firmware library in the separate process of firmware.

    Raises:
        ArgumentError: The memory at the address of a window is in use.
        StageError: The system allows no windows; see also `Library`.
    """

    def __init__(self, path: Path, link: Link, cost: int, wiring: PinWiring, windows: tuple[MemoryWindow, ...]):
        self._handlers = SignalHandlers()
        super().__init__(path, link, cost, wiring)
        observe_calls(self.handle)
        self._windows = link.windows = MemoryWindows(self, link)
        try:
            for window in windows:
                self._windows.map_window(window)
        except StageError:
            self.close()
            raise

    def main(self) -> int:
        """Call the entry point in this thread."""
        self._windows.allow_stack()
        return super().main()

    def close(self) -> None:
        """Unload the library, with its windows and the signal handlers that it has set."""
        self._windows.close()
        self._handlers.remove_handlers(str(self.copy))
        super().close()


@contextmanager
def trap_thread(on_sleep: Callable[[str], None], on_thread: Callable[[], None]) -> Iterator[None]:
    """Prepare this thread for the entry of firmware.

    Args:
        on_sleep: Called before it sleeps in real time, with the call in words.
        on_thread: Called after it has begun another thread.
    """
    allocate_signal_stack()
    set_observer(on_sleep, on_thread)
    unblock_timers()
    try:
        yield
    finally:
        block_timers()
        set_observer(None)
