"""Promises of `stage.sealed`: functions and records behind addresses."""

import ctypes

import numpy as np
import pytest

from stage import ArgumentError
from stage.chips import PCL240K
from stage.compiled import COMPILED, hot, record
from stage.sealed import Sealed, address_of, at, called, ready, sealed

CELL = record([("a", "i8"), ("b", "f8")])


@sealed("f8", CELL, "i8")
def scaled(c, n):
    """b times n; a grows."""
    c.a += n
    return c.b * n


@sealed(None, CELL)
def cleared(c):
    c.a = 0


@sealed("i8", "i4", "i8")
def joined(a, b):
    return a * 1000 + b


scale = called("f8", "i8", "i8")


@hot
def by_name(rows):
    total = 0.0
    for k in range(len(rows)):
        total += scaled(rows[k], k + 1) + scaled(rows[k], 2)
    cleared(rows[0])
    return total


@hot
def by_address(function, where, n):
    return scale(function, where, n) + at(where, 1, CELL)[0].a


def cells(*b):
    rows = np.zeros(len(b), CELL)
    rows["b"] = b
    return rows


def test_a_hot_function_calls_it_by_its_name():
    ready(__name__, "a test")  # as a chip does for its family: what comes from the cache finds the addresses
    rows = cells(0.5, 1.0, 2.0)
    assert by_name(rows) == 0.5 * 3 + 1.0 * 4 + 2.0 * 5
    assert rows["a"].tolist() == [0, 4, 5]


def test_a_hot_function_calls_it_by_its_address():
    rows = cells(0.5, 3.0)
    assert by_address(scaled.address, rows.ctypes.data + CELL.itemsize, 7) == 21.0 + 7
    assert rows["a"].tolist() == [0, 7]


def test_python_calls_it_with_a_record_an_array_or_an_address():
    rows = cells(0.5, 3.0)
    assert scaled(rows[1], 4) == scaled(rows[1:], 4) == scaled.c(rows.ctypes.data + 16, 4) == 12.0
    assert rows["a"].tolist() == [0, 12]
    assert address_of(rows[1]) == address_of(rows[1:]) == rows.ctypes.data + 16
    assert cleared(rows[1]) is None
    assert rows["a"].tolist() == [0, 0]


@pytest.mark.skipif(not COMPILED, reason="uncompiled, Python looks itself")
def test_what_is_no_record_of_its_kind_is_refused():
    """core.advance(np.zeros(4, np.int64)) read and wrote past the array"""
    rows = cells(0.5, 3.0)
    locked = rows.copy()
    locked.flags.writeable = False
    for wrong in (np.zeros(4, np.int64), rows.ctypes.data, locked, rows[:0], rows[::-1], rows.tobytes(), None,
                  np.zeros(2, record([("a", "i8"), ("b", "i8")]))):  # fmt: skip
        with pytest.raises(ArgumentError, match="scaled"):
            scaled(wrong, 4)
    for given in ((), (rows,), (rows, 1, 2)):
        with pytest.raises(ArgumentError, match="2 arguments"):
            scaled(*given)
    assert rows["a"].tolist() == [0, 0]
    with pytest.raises(ArgumentError, match="record of"):
        PCL240K().CORE.advance(np.zeros(4, np.int64), 1000)


def test_with_the_gil_held_it_is_the_same():
    rows = cells(0.5, 3.0)
    assert scaled.held(rows.ctypes.data, 4) == 2.0
    assert cleared.held(rows.ctypes.data) is None
    assert rows["a"].tolist() == [0, 0]


def test_c_calls_it_through_a_pointer():
    rows = cells(2.0)
    assert isinstance(scaled.pointer, ctypes._CFuncPtr)
    assert scaled.pointer(rows.ctypes.data, 8) == 16.0
    assert joined.pointer(2, 3) == 2003


def test_it_has_the_docstring_of_its_function():
    assert scaled.__doc__ == "b times n; a grows."


def test_ready_makes_those_of_a_package_and_no_others():
    made = [s for s in Sealed.every if s._address]
    ready("stage.no_such_package", "nothing")
    assert [s for s in Sealed.every if s._address] == made
    ready(__name__, "a test")
    assert all(s._address for s in Sealed.every if s.module == __name__)


@pytest.mark.skipif(not COMPILED, reason="this Python runs hot functions uncompiled")
def test_it_is_compiled_once_whoever_calls_it():
    before = scaled._kept
    by_name(cells(1.0))
    by_address(scaled.address, cells(1.0).ctypes.data, 1)
    scaled(cells(1.0)[0], 1)
    assert scaled._kept is before


def test_ready_is_meant_for_a_module_or_a_package_and_not_for_what_begins_alike(monkeypatch):
    # a chip whose core is a module of its own, without a package: every sealed function that there is was compiled
    asked = []

    class Waiting:
        _address = 0

        def __init__(self, module):
            self.module = module

        @property
        def address(self):
            return asked.append(self.module)

    names = ["mine", "mine.core", "minerals", "stage.engine"]
    monkeypatch.setattr(Sealed, "every", [Waiting(name) for name in names])
    ready("mine", "a test of names")
    assert asked == ["mine", "mine.core"]
