"""Records: the state that compiled code works on, as Python and as C see it."""

from __future__ import annotations

import copyreg
import ctypes
from functools import lru_cache
from math import prod
from operator import itemgetter
from typing import Any

import numpy as np

from stage.native.mode import COMPILED, EMITTING


def record(fields: list) -> np.dtype:
    """A structured dtype whose elements have attributes, compiled or not; `hot` functions take arrays and elements of it."""
    plainly = np.dtype(fields)
    return np.dtype((np.record if COMPILED or EMITTING else _quick(plainly), plainly))


class _Quick(type):
    """Of classes that `_quick` makes; they are pickled as NumPy's."""


def _numpys() -> Any:
    return np.record


def _pickled(_: type) -> Any:
    return _numpys, ()


copyreg.pickle(_Quick, _pickled)


def _quick(dtype: np.dtype) -> type:
    """np.record, whose attributes C looks up: where nothing is compiled, NumPy's look-up, in Python, is most of a run."""
    names = dtype.names or ()
    if any(
        hasattr(np.record, n) or not issubclass(dtype[n].base.type, (np.record, np.number, np.bool_)) for n in names
    ):
        return np.record
    shown: dict[str, Any] = {name: property(itemgetter(name)) for name in names}
    for name in ("__getattribute__", "__getitem__"):
        shown[name] = getattr(np.void, name)
    return _Quick("record", (np.record,), shown)


def plain(dtype: np.dtype) -> np.dtype:
    """The same fields without attributes: c["name"] is then the fast access from Python."""
    return np.dtype([(name, dtype[name]) for name in dtype.names or ()])


def address_of(given: np.ndarray | np.void) -> int:
    """Where an array or a record lies; of a record it takes a while."""
    if isinstance(given, np.ndarray):
        return int(given.ctypes.data)
    return int(given.__array_interface__["data"][0])


@lru_cache(1024)
def _seen(address: int, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    size = prod(shape) * dtype.itemsize
    if not size:
        return np.empty(shape, dtype)
    words: Any = (ctypes.c_char * size).from_address(address)
    return np.frombuffer(words, dtype).reshape(shape)


def _at(address: Any, shape: Any, dtype: Any) -> Any:
    """The array of this shape, a number or a tuple, that lies at an address; whoever holds the memory has to keep it."""
    shape = tuple(map(int, shape)) if isinstance(shape, tuple) else (int(shape),)
    return _seen(int(address), shape, dtype)


array_at: Any = _at


def _room(rows: int, columns: int) -> np.ndarray:
    """An array of float64 for the function's own use, on its stack: nothing is allocated, and it is gone when the function returns.
    Both numbers are constants of the module, or written out."""
    return np.empty((rows, columns))


room: Any = _room
if EMITTING:
    from stage.native import typed

    array_at, room = typed.array_at, typed.room
