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
    """A library of this machine."""

    path: Path
    windows: tuple[Window, ...] = ()

    def load(self, board: Board, may_exit: bool) -> Loaded:
        """See `Program`. Raises LibraryError, ArgumentError for a window that cannot be."""
        size = ctypes.sizeof(library.BusStruct)
        bus = library.BusStruct(library.ABI, size, board.link.pointer, board.link.request)
        return Mapped(library.Library(self.path, bus, may_exit), self.windows, board.link)
