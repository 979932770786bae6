"""Promises of `stage.compiled`: how hot functions are compiled, and how often."""

import hashlib
import subprocess
import sys
import textwrap
import threading
import time

import pytest
from numba.core.types import literal

from stage.compiled import COMPILED, announced, compiling, greatest, hot, least

compiled_only = pytest.mark.skipif(not COMPILED, reason="this Python runs hot functions uncompiled")


@hot
def double(n):
    return 2 * n


@compiled_only
def test_literal_arguments_share_one_compiled_function():
    for number in (1, 2):  # as the compiler asks where it finds double(1) and double(2)
        double.get_call_template((literal(number),), {})
    assert [str(s) for s in double.signatures] == ["(int64,)"]


@pytest.mark.parametrize(("a", "b"), [(1, 2), (2, 1), (-3, -3), (0.5, -0.5), (1, 0.5), (-0.0, 0.0)])
def test_least_and_greatest_are_min_and_max(a, b):
    assert least(a, b) == min(a, b)
    assert greatest(a, b) == max(a, b)


def test_a_first_call_that_takes_long_is_announced_once(capsys):
    for _ in range(2):
        with announced("a test that is slow on purpose", after=0.01):
            compiling()
            time.sleep(0.1)
    assert capsys.readouterr().err == "a test that is slow on purpose\n"


def test_a_first_call_that_is_slow_and_compiles_nothing_says_nothing(capsys):
    # stage demo, the second time, on a machine that is busy
    with announced("a test that only loads", after=0.01):
        time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_of_two_announced_calls_the_inner_one_says_what_is_compiled(capsys):
    with announced("the outer call", after=0.01), announced("the inner call", after=0.01):
        compiling()
        time.sleep(0.1)
    assert capsys.readouterr().err == "the inner call\n"


def test_an_error_in_a_first_call_comes_through_and_the_next_one_is_first_again(capsys):
    def fail():
        with announced("a test that fails on purpose", after=0.01):
            compiling()
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


@pytest.mark.skipif(sys.platform == "win32", reason="no lock on Windows: each process compiles for itself")
def test_waiting_for_another_process_is_said_and_not_called_compiling(tmp_path, monkeypatch, capsys):
    # stage demo, in two terminals at once, the first time
    import fcntl

    monkeypatch.setattr("stage.compiled.cache_folder", lambda: tmp_path)
    monkeypatch.setattr("stage.compiled.WAIT", 0.01)
    name = hashlib.sha256(b"what two want").hexdigest()[:16]
    lock = (tmp_path / f"{name}.lock").open("w")
    fcntl.flock(lock, fcntl.LOCK_EX)
    threading.Timer(0.3, lock.close).start()
    with announced("what two want", after=0.01):
        pass
    assert capsys.readouterr().err.startswith("PulseStage: waiting for another process")


MEETS = """
    import sys, time
    from pathlib import Path
    from stage.compiled import announced
    here, other = map(Path, sys.argv[1:])
    with announced(here.name, after=60):
        here.touch()
        end = time.monotonic() + 50
        while not other.exists() and time.monotonic() < end:
            time.sleep(0.01)
        sys.exit(not other.exists())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no lock on Windows: each process compiles for itself")
def test_what_has_another_message_is_compiled_meanwhile(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    names = [str(tmp_path / name) for name in ("the one", "the other")]
    command = [sys.executable, "-c", textwrap.dedent(MEETS)]
    running = [subprocess.Popen([*command, *order]) for order in (names, names[::-1])]
    assert [p.wait(timeout=60) for p in running] == [0, 0], "each saw that the other was inside"


def test_without_a_cache_folder_to_write_in_nothing_is_locked_and_all_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("stage.compiled.cache_folder", lambda: tmp_path / "is not there")
    with announced("somewhere else", after=60):
        pass
