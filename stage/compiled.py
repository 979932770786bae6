"""What is compiled, and how: one decorator for the hot functions, and MuJoCo's `mj_step` for use inside them.

    @hot
    def advance(rows, i, until): ...

Functions so marked are compiled by numba without the GIL and cached on disk. They keep to scalars, records and arrays:
no allocation, no strings, no exceptions, so that the same source can later compile for other targets.
With NUMBA_DISABLE_JIT=1 they run as plain Python, for debugging and for coverage.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numba
import numpy as np

hot = numba.njit(nogil=True, cache=True, error_model="numpy")
"""Decorator of every compiled function. No fastmath: the same input gives the same bits."""

COMPILED = not numba.config.DISABLE_JIT


def record(fields: list) -> np.dtype:
    """A structured dtype whose elements have attributes, compiled or not; `hot` functions take plain arrays of it."""
    return np.dtype((np.record, np.dtype(fields)))


@contextmanager
def announced(message: str, after: float = 1.0) -> Iterator[None]:
    """Print `message` to stderr if the block, a first call that may have to compile, takes longer than `after` s."""
    timer = threading.Timer(after, lambda: print(message, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
