"""Promises of `stage.compiled`: how hot functions are compiled, and how often."""

import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest
from numba.core.types import literal

from stage.compiled import COMPILED, Sealed, announced, greatest, hot, least, ready, record, sealed

CELL = record([("a", "i8"), ("b", "f8")])
compiled_only = pytest.mark.skipif(not COMPILED, reason="this Python runs hot functions uncompiled")


@hot
def double(n):
    return 2 * n


@sealed("f8", CELL, "i8")
def scaled(c, n):
    c.a += n
    return c.b * n


@sealed(None, CELL)
def cleared(c):
    c.a = 0


@hot
def through_the_seal(rows):
    total = 0.0
    for k in range(len(rows)):
        total += scaled(rows[k], k + 1) + scaled(rows[k], 2)
    cleared(rows[0])
    return total


@compiled_only
def test_literal_arguments_share_one_compiled_function():
    for number in (1, 2):  # as the compiler asks where it finds double(1) and double(2)
        double.get_call_template((literal(number),), {})
    assert [str(s) for s in double.signatures] == ["(int64,)"]


def test_a_sealed_function_does_through_its_address_what_it_says():
    ready(__name__)  # as a chip does for its family: what comes from the cache finds the addresses
    rows = np.zeros(3, CELL)
    rows["b"] = 0.5, 1.0, 2.0
    assert through_the_seal(rows) == 0.5 * 3 + 1.0 * 4 + 2.0 * 5
    assert rows["a"].tolist() == [0, 4, 5]


@compiled_only
def test_ready_makes_the_sealed_functions_of_a_package_and_no_others():
    ready("stage.no_such_package")
    ready(__name__)
    assert all(s.address for s in Sealed.every if s.function.__module__ == __name__)


@pytest.mark.parametrize(("a", "b"), [(1, 2), (2, 1), (-3, -3), (0.5, -0.5), (1, 0.5), (-0.0, 0.0)])
def test_least_and_greatest_are_min_and_max(a, b):
    assert least(a, b) == min(a, b)
    assert greatest(a, b) == max(a, b)


def test_a_first_call_that_takes_long_is_announced_once(capsys):
    for _ in range(2):
        with announced("a test that is slow on purpose", after=0.01):
            time.sleep(0.1)
    assert capsys.readouterr().err == "a test that is slow on purpose\n"


def test_an_error_in_a_first_call_comes_through_and_the_next_one_is_first_again(capsys):
    def fail():
        with announced("a test that fails on purpose", after=0.01):
            time.sleep(0.1)
            raise ZeroDivisionError

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            fail()
    assert capsys.readouterr().err.count("on purpose") == 2


FIRST = """
    import sys, time
    from stage.compiled import announced
    with announced("x", after=60):
        with announced("y", after=60):
            print("in", time.monotonic(), flush=True)
            time.sleep(0.3)
            print("out", time.monotonic(), flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no lock on Windows: each process compiles for itself")
def test_of_processes_that_come_first_at_once_one_goes_in_at_a_time(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    command = [sys.executable, "-c", textwrap.dedent(FIRST)]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    said = [line.split() for p in running for line in p.communicate(timeout=60)[0].splitlines()]
    order = [what for what, _ in sorted(said, key=lambda line: float(line[1]))]
    assert order == ["in", "out"] * 3


def test_without_a_cache_folder_to_write_in_nothing_is_locked_and_all_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("stage.compiled.cache_folder", lambda: tmp_path / "is not there")
    with announced("somewhere else", after=60):
        pass
