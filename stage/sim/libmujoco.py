"""MuJoCo's own library: where its functions lie, for compiled code that calls them."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import mujoco


@cache
def library() -> ctypes.CDLL:
    """The one that the package mujoco has loaded."""
    return ctypes.CDLL(
        str(next(Path(mujoco.__file__).parent.glob("libmujoco.*")))
    )  # .so.VERSION or, on macOS, .VERSION.dylib


@cache
def address(name: str) -> int:
    """Where a function of it lies."""
    return int(ctypes.cast(library()[name], ctypes.c_void_p).value or 0)
