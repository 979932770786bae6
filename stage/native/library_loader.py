"""Loader of a package's native library, which it builds first if the library does not fit the sources or this machine."""

from __future__ import annotations

import ctypes
import sys
from functools import cache

from stage.errors import NativeError
from stage.native.library_manifest import (
    advise_install,
    compute_source_digest,
    describe_target,
    explain_library_misfit,
    find_library,
)
from stage.native.record_dtypes import get_function_address

__all__ = ["compute_source_digest", "describe_target", "find_function_address"]


def find_function_address(module: str, symbol: str) -> int:
    """Return the address of a function.

    Args:
        module: Module of the function; the library is that of its package.
        symbol: Name of the function in the library.
    """
    return get_function_address(getattr(_load_library(module.partition(".")[0]), symbol))


@cache
def _load_library(package: str) -> ctypes.CDLL:
    """Load the library of a package, and build it first if it does not match."""
    if sys.platform == "win32":
        raise NativeError(
            "PulseStage has no native library for Windows: use WSL. (NUMBA_DISABLE_JIT=1 runs it slowly, as Python.)"
        )
    path = find_library(package)
    if why := explain_library_misfit(package, path):
        from stage.native import library_builder  # few processes build

        path = library_builder.build_missing(package, why)
    if package != "stage":
        _load_library("stage")  # what others call in it, they find by name
    try:
        return ctypes.CDLL(str(path), ctypes.RTLD_GLOBAL)
    except OSError as error:
        raise NativeError(f"{path} cannot be loaded: {error}. {advise_install(package)}") from error
