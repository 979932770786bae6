"""The host's side: chips behind the ports of a bus, and firmware in C that drives them."""

from stage.board.board import Board
from stage.board.bus_trace import BusTrace, Cycle
from stage.board.errors import (
    CompileError,
    CompilerWarning,
    HostError,
    HostTimeout,
    LibraryError,
    NoCompilerError,
    StormError,
)
from stage.board.firmware_library import build, include
from stage.board.host import NativeHost, Result
from stage.board.layouts import LAYOUTS, Layout

__all__ = [
    "LAYOUTS", "Board", "BusTrace", "CompileError", "CompilerWarning", "Cycle", "HostError", "HostTimeout", "Layout",
    "LibraryError", "NativeHost", "NoCompilerError", "Result", "StormError", "build", "include",
]  # fmt: skip
