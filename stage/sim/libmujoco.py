"""MuJoCo's own library: addresses of its functions, for compiled code that calls them."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import mujoco


@cache
def library() -> ctypes.CDLL:
    """Return the library that the package mujoco has loaded."""
    return ctypes.CDLL(
        str(next(Path(mujoco.__file__).parent.glob("libmujoco.*")))
    )  # .so.VERSION or, on macOS, .VERSION.dylib


@cache
def address(name: str) -> int:
    """Return the address of a function."""
    return int(ctypes.cast(library()[name], ctypes.c_void_p).value or 0)
