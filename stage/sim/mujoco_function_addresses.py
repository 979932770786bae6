"""Addresses of the functions in MuJoCo's own library, for compiled code that calls them."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import mujoco


@cache
def load_mujoco_library() -> ctypes.CDLL:
    """Return MuJoCo's library, which the package mujoco has already loaded."""
    # .so.VERSION or, on macOS, .VERSION.dylib
    return ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco.*"))))


@cache
def find_mujoco_address(name: str) -> int:
    """Return the address of a function of MuJoCo's library by its name."""
    return int(ctypes.cast(load_mujoco_library()[name], ctypes.c_void_p).value or 0)
