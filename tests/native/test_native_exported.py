"""Promises of `exported`: functions of the native library, called by name, by address, from C and from Python."""

import ctypes
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from loops.rows import CELL, by_address, by_name, cleared, joined, on_the_stack, scaled, twice_weighed, weighed

from stage import ArgumentError
from stage.chips import PCL240K
from stage.native import COMPILED, ExportedFunction, address_of, array_at, greatest, least, record_dtypes

TESTS = Path(__file__).parents[1]


def cells(*b):
    rows = np.zeros(len(b), CELL)
    rows["b"] = b
    return rows


def test_another_compiled_function_calls_it_by_its_name():
    rows = cells(0.5, 1.0, 2.0)
    assert by_name(rows) == 0.5 * 3 + 1.0 * 4 + 2.0 * 5
    assert rows["a"].tolist() == [0, 4, 5]


def test_another_compiled_function_calls_it_by_its_address():
    rows = cells(0.5, 3.0)
    assert by_address(scaled.address, rows.ctypes.data + CELL.itemsize, 7) == 21.0 + 7
    assert rows["a"].tolist() == [0, 7]


def test_it_may_be_the_first_that_a_process_does():
    """python -c "from loops.rows import joined, scaled; print(joined(2, 3), scaled.address > 0)"
    Compiled code that ran before `ready` had said where others lie went nowhere."""
    program = "from loops.rows import joined, scaled; print(joined(2, 3), scaled.address > 0)"
    done = subprocess.run([sys.executable, "-c", program], cwd=TESTS, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("2003 True\n", "")


def test_python_calls_it_with_a_record_or_an_array_and_by_c_with_an_address():
    rows = cells(0.5, 3.0)
    assert scaled(rows[1], 4) == scaled(rows[1:], 4) == scaled.c(rows.ctypes.data + 16, 4) == 12.0
    assert rows["a"].tolist() == [0, 12]
    assert address_of(rows[1]) == address_of(rows[1:]) == rows.ctypes.data + 16
    assert cleared(rows[1]) is None
    assert rows["a"].tolist() == [0, 0]


@pytest.mark.parametrize("function", [weighed, twice_weighed])
def test_arrays_of_any_dimensions_are_passed_in_place(function):
    table, weights = np.arange(6.0).reshape(2, 3), np.array([10, 1])
    times = 2 if function is twice_weighed else 1
    expected = sum((10 + k) * 3.0 + (1 + k) * 12.0 for k in range(times))
    assert function(table, weights) == expected
    assert weights.tolist() == [10 + times, 1 + times]
    assert function(table[:0], weights) == 0.0


def test_c_calls_it_through_a_pointer():
    rows = cells(2.0)
    assert isinstance(scaled.pointer, ctypes._CFuncPtr)
    assert scaled.pointer(rows.ctypes.data, 8) == 16.0
    assert joined.pointer(2, 3) == 2003


def test_it_has_the_docstring_of_its_function():
    assert scaled.__doc__ == "b times n; a grows."


def test_no_two_of_them_have_the_same_symbol():
    symbols = [f.symbol for f in ExportedFunction.every]
    assert len(symbols) == len(set(symbols))


def test_at_shows_the_memory_itself():
    rows = cells(1.0, 2.0)
    array_at(rows.ctypes.data, 2, CELL)[1].b = 5.0
    assert rows["b"].tolist() == [1.0, 5.0]
    assert array_at(0, 0, CELL).shape == (0,)


@pytest.mark.parametrize(("a", "b"), [(1, 2), (2, 1), (-3, -3), (0.5, -0.5), (1, 0.5), (-0.0, 0.0)])
def test_least_and_greatest_are_min_and_max(a, b):
    assert least(a, b) == min(a, b)
    assert greatest(a, b) == max(a, b)


def test_room_on_the_stack_is_a_separate_array():
    assert on_the_stack(3.0) == 2 * 5 * 3.0
    assert on_the_stack(-1.5) == 2 * 5 * -1.5


BAD = {
    "of another dtype": (lambda: (np.zeros(4, np.int64), 1), "argument 1: elements int64; it takes a record, or an array"),
    "an address": (lambda: (cells(1.0).ctypes.data, 1), "argument 1: an int"),
    "empty": (lambda: (cells(), 1), "argument 1: an empty array"),
    "strided": (lambda: (cells(1.0, 2.0, 3.0)[::2], 1), "strides"),
    "read-only": (lambda: (np.frombuffer(bytes(32), CELL), 1), "read-only"),
    "too few": (lambda: (cells(1.0),), "1 arguments given, it takes 2"),
    "no whole number": (lambda: (cells(1.0), 1.5), "argument 2: 1.5; it takes a whole number"),
    "out of range": (lambda: (cells(1.0), 1 << 64), "argument 2"),
    "one too many": (lambda: (cells(1.0), 1 << 63), "argument 2: 9223372036854775808; it takes a whole number of 64 bits"),
    "one too few": (lambda: (cells(1.0), -(1 << 63) - 1), "argument 2: -9223372036854775809"),
}  # fmt: skip


@pytest.mark.skipif(not COMPILED, reason="Python looks by itself")
@pytest.mark.parametrize("case", BAD)
def test_what_compiled_code_could_not_take_is_refused_in_words(case):
    arguments, words = BAD[case]
    with pytest.raises(ArgumentError, match=words):
        scaled(*arguments())


def test_the_limits_of_the_range_are_accepted():
    for n in ((1 << 63) - 1, -(1 << 63)):
        rows = cells(1.0)
        scaled(rows, n)
        assert rows["a"][0] == n


@pytest.mark.skipif(not COMPILED, reason="Python looks by itself")
def test_arrays_are_refused_likewise():
    unaligned = np.zeros(49, np.uint8)[1:].view(float).reshape(2, 3)
    for table in (np.zeros(3), np.zeros((2, 3), np.float32), np.zeros((3, 2)).T, unaligned):
        with pytest.raises(ArgumentError, match="weighed, argument 1"):
            weighed(table, np.array([1, 2]))


@pytest.mark.skipif(not COMPILED, reason="Python looks by itself")
@pytest.mark.parametrize("argument", ["fast", None, [1.0]])
def test_a_number_that_is_none_is_refused_likewise(argument):
    halved = ExportedFunction(lambda x: x / 2, "f8", ("f8",))
    ExportedFunction.every.remove(halved)
    with pytest.raises(ArgumentError, match=r"argument 1: .*it takes a number"):
        halved(argument)


@pytest.mark.skipif(not COMPILED, reason="Python looks by itself")
def test_a_core_refuses_an_array_of_another_kind():
    """core.advance(np.zeros(4, np.int64))"""
    with pytest.raises(ArgumentError, match="advance, argument 1"):
        PCL240K.CORE.advance(np.zeros(4, np.int64), 1000)


@pytest.mark.skipif(not COMPILED, reason="asks of the compiled library")
def test_a_process_that_runs_a_stage_loads_neither_numba_nor_a_compiler():
    say = "import sys; from stage import Stage; Stage('xy', visuals=False).step(); print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", say], capture_output=True, text=True, check=True)
    assert out.stderr == ""
    assert not {"numba", "llvmlite", "scipy", "stage.native.library_builder", "stage.native.object_emitter"} & set(
        out.stdout.split()
    )


def test_records_of_uncompiled_runs_are_numpys_but_quicker():
    inner = np.dtype(
        (record_dtypes._make_fast_record(np.dtype([("k", "i8"), ("v", "f8", (3,))])), [("k", "i8"), ("v", "f8", (3,))])
    )
    fields = [("a", inner), ("bs", inner, (2,)), ("n", "i4")]
    quick = np.zeros(2, (record_dtypes._make_fast_record(np.dtype(fields)), fields))
    theirs = np.zeros(2, (np.record, fields))
    for rows in (quick, theirs):
        row = rows[1]
        row.a.k, row.bs[1].v[2], row.n = 5, 1.5, 3
        with pytest.raises(AttributeError, match="no attribute 'm'"):
            row.m = 1
        with pytest.raises(AttributeError, match="no attribute 'm'"):
            _ = row.m
    assert quick.tobytes() == theirs.tobytes()
    assert type(quick[1].n) is type(theirs[1].n)
    assert quick[1].bs[1].v[2] == quick[1]["bs"][1]["v"][2] == 1.5
    back = pickle.loads(pickle.dumps(quick))
    assert back.dtype.type is np.record
    assert back.tobytes() == quick.tobytes()
    assert type(quick[1]).n is not None, "an attribute of its own, looked up in C"
    assert record_dtypes._make_fast_record(np.dtype([("item", "i4")])) is np.record, "a name that NumPy has itself"
