"""What is compiled, and how: one decorator for the hot functions. (Another, for those behind an address: stage/sealed.py.)

    @hot
    def advance(rows, i, until): ...

Functions so marked are compiled by numba without the GIL and cached on disk. They keep to scalars, records and arrays:
no allocation, no strings, no exceptions, so that the same source can later compile for other targets.
With NUMBA_DISABLE_JIT=1 they run as plain Python, for debugging and for coverage.
"""

from __future__ import annotations

import hashlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from stage.cache import cache_folder, kept, numba

event: Any = import_module("numba.core.event")
fcntl: Any = import_module("fcntl") if find_spec("fcntl") else None  # not on Windows

COMPILED = not numba.config.DISABLE_JIT
WAIT = 5.0  # s for another process, before that is said


def hot(function: Callable) -> Any:
    """Compile `function` at its first call. No fastmath: the same input gives the same bits."""
    with kept(function) as there:
        compiled = numba.njit(nogil=True, cache=there, error_model="numpy", no_cfunc_wrapper=True)(function)
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
_open: list[_Message] = []  # the last one is what is compiled now


class _Message:
    """Said on stderr if something is still compiled `after` s from now."""

    def __init__(self, text: str, after: float):
        self.text, self.due = text, time.monotonic() + after
        self.timer: threading.Timer | None = None

    def soon(self) -> None:
        if self.timer is None:
            self.timer = threading.Timer(max(0.0, self.due - time.monotonic()), self._say)
            self.timer.daemon = True
            self.timer.start()

    def never(self) -> None:
        if self.timer is not None:
            self.timer.cancel()

    def _say(self) -> None:
        print(self.text, file=sys.stderr, flush=True)


def compiling() -> None:
    """Something was not in the cache."""
    for said in _open[-1:]:
        said.soon()


class _Listener(event.Listener):
    def on_start(self, _event: Any) -> None:
        compiling()

    def on_end(self, _event: Any) -> None:
        pass


event.register("numba:compile", _Listener())


@contextmanager
def announced(message: str, after: float = 1.0) -> Iterator[None]:
    """Around a call that has to compile if it is the first. If it does, and takes longer than `after` s, `message` goes to stderr.

    Of several processes that come here first, one compiles and the others wait for it and load what it made; what has another
    message they compile meanwhile."""
    if message in _announced:
        yield
        return
    said = _Message(message, after)
    with _first_calls:
        with _alone(message):
            _open.append(said)
            try:
                yield
            finally:
                _open.remove(said)
                said.never()
        _announced.append(message)


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
                _lock(lock)
        yield


def _lock(file: Any) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        waiting = _Message("PulseStage: waiting for another process, which compiles or loads the same code ...", WAIT)
        waiting.soon()
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        finally:
            waiting.never()
