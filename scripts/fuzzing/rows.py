"""State of a chip in Python's own numbers. Uncompiled code spends nine tenths of its time in NumPy's records otherwise."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

LEAST = -(1 << 63)  # number of a word


class Table(list):
    """Array of several dimensions as nested lists, with t[i, j] for t[i][j]."""

    def __getitem__(self, k: Any) -> Any:
        if type(k) is not tuple:
            return list.__getitem__(self, k)
        part: Any = self
        for place in k:
            part = list.__getitem__(part, place)
        return part

    def __setitem__(self, k: Any, value: Any) -> None:
        if type(k) is tuple:
            list.__setitem__(self[k[:-1]], k[-1], value)
        else:
            list.__setitem__(self, k, copy.deepcopy(value))


class Row:
    """Record, with its nested records, as Python objects."""

    def __init__(self, record: Any):
        for name in record.dtype.names:
            setattr(self, name, _copy_as_python(record[name]))

    def fits(self) -> bool:
        """Return whether every integer fits into 64 bits, as compiled code needs it."""
        return all(map(_fits, vars(self).values()))

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)

    def __setitem__(self, name: str, value: int) -> None:
        setattr(self, name, value)


def make_record(row: Row, dtype: np.dtype) -> np.ndarray:
    """Make an array with one record that has the contents of a Row."""
    rows = np.zeros(1, dtype)
    _fill(rows[0], row)
    return rows


def _fill(to: Any, row: Row) -> None:
    for name in to.dtype.names:
        value = getattr(row, name)
        if isinstance(value, Row):
            _fill(to[name], value)
        elif isinstance(value, list) and value and isinstance(value[0], Row):
            for inner, own in zip(to[name], value, strict=True):
                _fill(inner, own)
        else:
            to[name] = value


def _copy_as_python(value: Any) -> Any:
    if value.dtype.names:
        return Row(value) if value.ndim == 0 else [Row(inner) for inner in value]
    if value.ndim < 2:
        return value.tolist()
    return Table(_copy_as_python(inner) for inner in value)


def _fits(value: Any) -> bool:
    if type(value) is int:
        return LEAST <= value <= -LEAST - 1
    if type(value) is Row:
        return value.fits()
    if type(value) is not list or not value or type(value[0]) is float:
        return True
    return all(map(_fits, value)) if type(value[0]) is Row else min(value) >= LEAST and max(value) <= -LEAST - 1


def to_lists(value: Any) -> Any:
    """Convert numbers in any container to nested lists."""
    if isinstance(value, Row):
        return [to_lists(inner) for inner in vars(value).values()]
    if isinstance(value, list):
        return [to_lists(inner) for inner in value]
    if names := getattr(getattr(value, "dtype", None), "names", None):
        if value.ndim:
            return [to_lists(inner) for inner in value]
        return [to_lists(value[name]) for name in names]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return int(value) if isinstance(value, bool) else value
