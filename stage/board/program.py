"""What firmware is to its runner: a `Program` that can be loaded, and what has been loaded has a `main()`.

A library of this machine is one; a binary of another machine on an emulator is one, too. Both make their requests of the board in
the thread that calls `main`, and that is how they are paused.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from stage.board import library
from stage.board.mapping import Mapped
from stage.board.windows import Window

if TYPE_CHECKING:
    from stage.board.board import Board


class Loaded(Protocol):
    """Firmware in memory, with its variables as they were compiled."""

    def main(self) -> int:
        """Run it from its entry, in the thread that calls. What it returned. Raises HostError for what else ended it."""
        ...

    def close(self) -> None:
        """It runs no more."""
        ...


class Program(Protocol):
    """Firmware in a file. It can be pickled: a process of its own gets it so."""

    @property
    def path(self) -> Path: ...

    def load(self, board: Board, may_exit: bool) -> Loaded:
        """A copy of it, whose requests go to the board. may_exit: its calls of exit may end the process.

        Raises StageError: what is wrong with it.
        """
        ...


@dataclass(frozen=True)
class NativeProgram:
    """A library of this machine. cost: ps that each of its basic blocks takes; 0: it does not count them."""

    path: Path
    windows: tuple[Window, ...] = ()
    cost: int = 0

    def load(self, board: Board, may_exit: bool) -> Loaded:
        """See `Program`. Raises LibraryError, ArgumentError for a window that cannot be."""
        size = ctypes.sizeof(library.BusStruct)
        bus = library.BusStruct(library.ABI, size, board.link.pointer, board.link.request)
        loaded = library.Library(self.path, bus, may_exit)
        mapped = Mapped(loaded, self.windows, board.link)
        return Metered(mapped, loaded, board, self.cost) if self.cost else mapped


class Metered:
    """A library whose computing takes time: cost, ps a basic block. Raises LibraryError when it is made."""

    def __init__(self, mapped: Mapped, loaded: library.Library, board: Board, cost: int):
        self._mapped, self._loaded, self._board, self._cost = mapped, loaded, board, cost
        loaded.metered(library.NEVER)

    def main(self) -> int:
        """See `Loaded`. What it counts while it is loaded and unloaded takes no time."""
        h = self._board.link.record
        h["cost"], h["rest"] = self._cost, 0
        h["meter"] = self._loaded.metered(max(int(h["bus"]) * 1000 // self._cost, 1))
        code = self._mapped.main()
        self._loaded.metered(library.NEVER)
        return code

    def close(self) -> None:
        """See `Loaded`."""
        self._mapped.close()
