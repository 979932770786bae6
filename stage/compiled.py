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
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import llvmlite.binding
import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numba.extending import intrinsic

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
            if any(mark in (text := source.read_bytes()) for mark in (b"@hot", b"@sealed")):
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


def sealed(result: str | None, *arguments: Any) -> Any:
    """As `hot`, for functions with much behind them that much calls: compiled once and by itself, where a hot function is
    compiled anew into each that calls it.

    result: None, "i8" or "f8"; arguments: the same, or a record's dtype. Only hot functions call it, after `ready`.
    """
    return (lambda function: Sealed(function, result, arguments).inside) if COMPILED else lambda function: function


class Sealed:
    """A function behind an address. `inside`: what hot functions call."""

    every: ClassVar[list[Sealed]] = []

    def __init__(self, function: Callable, result: str | None, arguments: tuple):
        self.function, self.address = function, 0
        self.symbol = f"pulsestage {function.__module__}.{function.__qualname__}"
        types = [numba.from_dtype(np.dtype(a)) for a in arguments]
        self.signature = (numba.from_dtype(np.dtype(result)) if result else numba.types.void)(*types)
        self.every.append(self)

        def call(_context: Any, *given: Any) -> Any:
            self.ready()
            return self.signature, self._call

        self.inside = intrinsic(_with_parameters(call, len(arguments)))

    def _call(self, context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = context.get_value_type
        returned = ir.VoidType() if signature.return_type == numba.types.void else value(signature.return_type)
        kind = ir.FunctionType(returned, [value(a) for a in signature.args])
        done = builder.call(cgutils.get_or_insert_function(builder.module, kind, self.symbol), arguments)
        return context.get_dummy_value() if signature.return_type == numba.types.void else done

    def ready(self) -> None:
        """Compile it, or load what was compiled."""
        if not self.address:
            with kept():
                entry = numba.cfunc(self.signature, cache=True, error_model="numpy")(self.function)
            self._kept = entry
            llvmlite.binding.add_symbol(self.symbol, entry.address)
            self.address = entry.address


def _with_parameters(call: Callable, n: int) -> Any:
    """numba wants parameters by name."""
    names = "".join(f", a{k}" for k in range(n))
    space: dict[str, Any] = {"call": call}
    exec(f"def sealed(context{names}):\n    return call(context{names})", space)
    return space["sealed"]


def ready(package: str) -> None:
    """Before compiled functions of `package` run, fresh or from the cache: what they call by address is there."""
    waiting = [s for s in Sealed.every if not s.address and s.function.__module__.startswith(package)]
    if waiting:
        with announced(f"PulseStage: compiling {package}, once on this machine (about thirty seconds) ..."):
            for function in waiting:
                function.ready()


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
_depth = 0


@contextmanager
def announced(message: str, after: float = 1.0) -> Iterator[None]:
    """Around a call that has to compile if it is the first. If that takes longer than `after` s, `message` goes to stderr.

    Of several processes that come here first, one compiles and the others wait for it and load what it made."""
    if message in _announced:
        yield
        return
    timer = threading.Timer(after, lambda: print(message, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        with _first_calls, _alone():
            yield
        _announced.append(message)
    finally:
        timer.cancel()


@contextmanager
def _alone() -> Iterator[None]:
    """One process at a time; calls may be nested."""
    global _depth
    _depth += 1
    try:
        with _lock_file() if _depth == 1 else nullcontext():
            yield
    finally:
        _depth -= 1


@contextmanager
def _lock_file() -> Iterator[None]:
    """Hold the lock in the cache folder; go on without one where there is none to be had."""
    with ExitStack() as held:
        with suppress(OSError):
            lock = held.enter_context((cache_folder() / "lock").open("w"))
            if fcntl:
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield
