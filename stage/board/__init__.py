"""The host's side: chips behind the ports of a bus, and firmware in C that drives them."""

from stage.board.board import Board
from stage.board.bus_layouts import LAYOUTS, Layout
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
from stage.board.firmware_library import build, get_include_folder
from stage.board.native_host import NativeHost, Result

__all__ = [
    "LAYOUTS", "Board", "BusTrace", "CompileError", "CompilerWarning", "Cycle", "HostError", "HostTimeout", "Layout",
    "LibraryError", "NativeHost", "NoCompilerError", "Result", "StormError", "build", "get_include_folder",
]  # fmt: skip
