"""MuJoCo's own library: addresses of its functions, for compiled code that calls them."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import mujoco


@cache
def load_mujoco_library() -> ctypes.CDLL:
    """Return the library that the package mujoco has loaded."""
    return ctypes.CDLL(
        str(next(Path(mujoco.__file__).parent.glob("libmujoco.*")))
    )  # .so.VERSION or, on macOS, .VERSION.dylib


@cache
def find_mujoco_address(name: str) -> int:
    """Return the address of a function."""
    return int(ctypes.cast(load_mujoco_library()[name], ctypes.c_void_p).value or 0)
