"""Locks that keep other threads away from a stage while one call uses it.

A stage, its chips, axes, drivers and boards have an attribute `lock`, which is None as long as one thread drives the stage. A
session of stage.panel sets it to a re-entrant lock. Each call below holds it from its first bus cycle to its last, and releases
it while simulated time passes.

    @exclusive
    def move(self, pulses): ...          the whole method; each call reads `self.lock` anew

    with exclusively(stage): ...         a block
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import wraps
from typing import Any, ParamSpec, Protocol, TypeVar

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")
UNSHARED = nullcontext()


class SessionLock(Protocol):
    """Re-entrant lock of an open session, as a context manager."""

    def __enter__(self) -> Any: ...

    def __exit__(self, *exc: object) -> None: ...

    def act_for_owner(self) -> AbstractContextManager[Any]:
        """Let this thread act for the owner of the lock, which waits for it: firmware runs on a thread of its own."""


def get_stage_lock(owner: Any) -> AbstractContextManager[Any]:
    """Return the lock of the stage to which `owner` belongs, or a context that does nothing while no session is open."""
    return getattr(owner, "lock", None) or UNSHARED


def exclusive(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Decorate a method, or a function of axes, so that it holds the lock of its stage while it runs."""

    @wraps(function)
    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Returned:
        __tracebackhide__ = True  # pytest shows the caller
        lock = _find_lock((*args, *kwargs.values()))
        if lock is None:
            return function(*args, **kwargs)
        with lock:
            return function(*args, **kwargs)

    return call


def _find_lock(values: Iterable[Any]) -> SessionLock | None:
    """Return the lock of the first argument that has an attribute `lock`, or None.

    The keys and values of an argument that is a mapping are searched as well.
    """
    for value in values:
        if isinstance(value, Mapping):
            lock = _find_lock((*value.keys(), *value.values()))
            if lock is not None:
                return lock
        elif not isinstance(value, type) and hasattr(value, "lock"):
            return value.lock
    return None


def with_lock(lock: SessionLock, method: Callable[..., Returned]) -> Callable[..., Returned]:
    """Return a function that calls `method` while it holds `lock`."""

    def call(*args: Any) -> Returned:
        with lock:
            return method(*args)

    return call
