"""What is compiled, and how: one decorator for the hot functions. (Another, for those behind an address: stage/sealed.py.)

    @hot
    def advance(rows, i, until): ...

Functions so marked are compiled by numba without the GIL and cached on disk. They keep to scalars, records and arrays:
no allocation, no strings, no exceptions, so that the same source can later compile for other targets.
With NUMBA_DISABLE_JIT=1 they run as plain Python, for debugging and for coverage.

numba looks only at the file of the function itself to tell whether its cache is fresh, but our loops are made of functions of
many files, and of the constants of register maps. So the cache folder carries a hash of them all: a change in any compiles anew.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

numba: Any = import_module("numba")  # its settings have no types
fcntl: Any = import_module("fcntl") if find_spec("fcntl") else None  # not on Windows

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
            text = source.read_bytes()
            if b"@hot" in text or b"@sealed" in text or "chips" in source.parts or "drives" in source.parts:
                digest.update(source.name.encode() + text)
    default = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or default) / "pulsestage"
    folder = base / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError:
        return Path(tempfile.gettempdir()) / f"pulsestage-{os.getuid() if hasattr(os, 'getuid') else 0}" / folder.name
    for old in sorted(base.iterdir(), key=lambda p: p.stat().st_mtime)[:-KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)
    return folder


@contextmanager
def kept() -> Iterator[None]:
    """numba keeps what is decorated here in our folder."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def hot(function: Callable) -> Any:
    """Compile `function` at its first call. No fastmath: the same input gives the same bits."""
    with kept():
        compiled = numba.njit(nogil=True, cache=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    if COMPILED:
        _once_for_all_literals(compiled)
    return compiled


def _once_for_all_literals(compiled: Any) -> None:
    """Callers that say f(1) and f(2) share the code for a whole number: numba would compile one for each."""
    template = compiled.get_call_template
    compiled.get_call_template = lambda args, kws: template(
        tuple(map(numba.types.unliteral, args)), {k: numba.types.unliteral(v) for k, v in kws.items()}
    )


@hot
def least(a: Any, b: Any) -> Any:
    """min(a, b): numba compiles its own anew, and slowly, for every kind of argument."""
    return b if b < a else a


@hot
def greatest(a: Any, b: Any) -> Any:
    """max(a, b), see `least`."""
    return b if b > a else a


def record(fields: list) -> np.dtype:
    """A structured dtype whose elements have attributes, compiled or not; `hot` functions take plain arrays of it."""
    return np.dtype((np.record, np.dtype(fields)))


def plain(dtype: np.dtype) -> np.dtype:
    """The same fields without attributes: c["name"] is then the fast access from Python."""
    return np.dtype([(name, dtype[name]) for name in dtype.names or ()])


_announced: list[str] = []
_first_calls = threading.RLock()
_held: set[str] = set()  # what this process compiles


@contextmanager
def announced(message: str, after: float = 1.0) -> Iterator[None]:
    """Around a call that has to compile if it is the first. If that takes longer than `after` s, `message` goes to stderr.

    Of several processes that come here first, one compiles and the others wait for it and load what it made; what has another
    message they compile meanwhile."""
    if message in _announced:
        yield
        return
    timer = threading.Timer(after, lambda: print(message, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        with _first_calls, _alone(message):
            yield
        _announced.append(message)
    finally:
        timer.cancel()


@contextmanager
def _alone(message: str) -> Iterator[None]:
    """One process at a time."""
    if message in _held:
        yield
        return
    _held.add(message)
    try:
        with _lock_file(hashlib.sha256(message.encode()).hexdigest()[:16]):
            yield
    finally:
        _held.remove(message)


@contextmanager
def _lock_file(name: str) -> Iterator[None]:
    """Hold a lock in the cache folder; go on without one where there is none to be had."""
    with ExitStack() as held:
        with suppress(OSError):
            lock = held.enter_context((cache_folder() / f"{name}.lock").open("w"))
            if fcntl:
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield
