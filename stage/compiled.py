"""What is compiled, and how: one decorator for the hot functions.

    @hot
    def advance(rows, i, until): ...

Functions so marked are compiled by numba without the GIL and cached on disk. They keep to scalars, records and arrays:
no allocation, no strings, no exceptions, so that the same source can later compile for other targets.
With NUMBA_DISABLE_JIT=1 they run as plain Python, for debugging and for coverage.

numba looks only at the file of the function itself to tell whether its cache is fresh, but our loops are made of functions of
many files. So the cache folder carries a hash of them all: a change anywhere compiles anew.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

numba: Any = import_module("numba")  # its settings have no types

COMPILED = not numba.config.DISABLE_JIT
KEPT_CACHES = 4


@cache
def cache_folder() -> Path:
    """Where compiled code is kept: $NUMBA_CACHE_DIR or the user's cache folder, by the state of the sources."""
    digest = hashlib.sha256(numba.__version__.encode())
    environments = find_spec("stage.envs")  # a folder of its own in a source tree
    folders = [str(Path(__file__).parent), *((environments and environments.submodule_search_locations) or ())]
    for folder in folders:
        for source in sorted(Path(folder).rglob("*.py")):
            if b"@hot" in (text := source.read_bytes()):
                digest.update(source.name.encode() + text)
    default = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or default) / "pulsestage"
    kept = base / digest.hexdigest()[:16]
    try:
        kept.mkdir(parents=True, exist_ok=True)
        os.utime(kept)
    except OSError:
        return Path(tempfile.gettempdir()) / f"pulsestage-{os.getuid() if hasattr(os, 'getuid') else 0}" / kept.name
    for old in sorted(base.iterdir(), key=lambda p: p.stat().st_mtime)[:-KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)
    return kept


def hot(function: Callable) -> Any:
    """Compile `function` at its first call. No fastmath: the same input gives the same bits."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())
    try:
        return numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = before


def record(fields: list) -> np.dtype:
    """A structured dtype whose elements have attributes, compiled or not; `hot` functions take plain arrays of it."""
    return np.dtype((np.record, np.dtype(fields)))


def plain(dtype: np.dtype) -> np.dtype:
    """The same fields without attributes: c["name"] is then the fast access from Python."""
    return np.dtype([(name, dtype[name]) for name in dtype.names or ()])


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
