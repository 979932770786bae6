"""Structured dtypes for compiled code, and access to arrays and records by their addresses."""

from __future__ import annotations

import copyreg
import ctypes
from functools import cache, lru_cache
from math import prod
from operator import itemgetter
from typing import Any

import numpy as np

from stage.native.compile_mode import COMPILED, IS_EMITTER_PROCESS


def record(fields: list) -> np.dtype:
    """Make a structured dtype whose elements have their fields as attributes, in compiled functions and in plain Python.

    Args:
        fields: Fields as NumPy takes them.
    """
    plainly = np.dtype(fields)
    return np.dtype((np.record if COMPILED or IS_EMITTER_PROCESS else _make_fast_record(plainly), plainly))


class _FastRecordType(type):
    """Metaclass of the classes that `_make_fast_record` makes, which are pickled as NumPy's record types."""


def _get_record_type() -> Any:
    """Return NumPy's record type, for pickles."""
    return np.record


def _reduce_to_numpy(_: type) -> Any:
    """Pickle a fast record type as NumPy's record type."""
    return _get_record_type, ()


copyreg.pickle(_FastRecordType, _reduce_to_numpy)


def _make_fast_record(dtype: np.dtype) -> type:
    """Make a subclass of np.record whose fields are C descriptors, because NumPy's own look-up of attributes is slow."""
    names = dtype.names or ()
    if any(
        hasattr(np.record, n) or not issubclass(dtype[n].base.type, (np.record, np.number, np.bool_)) for n in names
    ):
        return np.record
    members: dict[str, Any] = {name: property(itemgetter(name)) for name in names}
    for name in ("__getattribute__", "__getitem__"):
        members[name] = getattr(np.void, name)
    return _FastRecordType("record", (np.record,), members)


@cache
def remove_attribute_access(dtype: np.dtype) -> np.dtype:
    """Return a dtype with the same fields whose elements have no attributes, so that access by `element["name"]` is faster."""
    return np.dtype([(name, dtype[name]) for name in dtype.names or ()])


def address_of(item: np.ndarray | np.void) -> int:
    """Return the address of the memory of an array or a record; for a record this takes longer."""
    array = item if isinstance(item, np.ndarray) else np.frombuffer(item, np.uint8)
    return int(array.ctypes.data)


def get_function_address(function: Any) -> int:
    """Return the address of a ctypes function."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0


@lru_cache(1024)
def _view_memory(address: int, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Return an array over the memory at an address, from a cache."""
    size = prod(shape) * dtype.itemsize
    if not size:
        return np.empty(shape, dtype)
    words: Any = (ctypes.c_char * size).from_address(address)
    return np.frombuffer(words, dtype).reshape(shape)


def _view_array(address: Any, shape: Any, dtype: Any) -> Any:
    """Return an array over the memory at an address. The caller must keep the memory alive.

    Args:
        address: Address.
        shape: A number or a tuple.
        dtype: Type of the elements.
    """
    shape = tuple(map(int, shape)) if isinstance(shape, tuple) else (int(shape),)
    return _view_memory(int(address), shape, dtype)


array_at: Any = _view_array


def _allocate_on_stack(rows: int, columns: int) -> np.ndarray:
    """Allocate an array of float64 on the stack of the calling function; it ends when that function returns.

    Both arguments must be literals or constants of the module.
    """
    return np.empty((rows, columns))


allocate_on_stack: Any = _allocate_on_stack
if IS_EMITTER_PROCESS:
    from stage.native import numba_implementations

    array_at, allocate_on_stack = numba_implementations.array_at, numba_implementations.allocate_on_stack
