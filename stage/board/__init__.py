"""The host's side: chips behind the ports of a bus, and firmware in C that drives them."""

from stage.board.board import Board, StormError
from stage.board.layouts import LAYOUTS, Layout
from stage.board.trace import BusTrace, Cycle

__all__ = ["LAYOUTS", "Board", "BusTrace", "Cycle", "Layout", "StormError"]
