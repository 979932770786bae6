"""Promises of `stage.code`: machine code that is kept, and found again only where it fits."""

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from stage import code
from stage.compiled import COMPILED

pytestmark = pytest.mark.skipif(not (COMPILED and code.HERE), reason="numba keeps the code here")

PROGRAM = """
import sys

import numpy as np

from stage import code
from stage.compiled import record
from stage.sealed import sealed

CELL = record([("a", "i8"), ("b", "f8")])


@sealed("f8", CELL, "i8")
def step(c, n):
    c.a += n
    return c.b * n


@sealed("f8", CELL)
def twice(c):
    return step(c, 1) + step(c, 2)


if sys.argv[1:]:
    code._machine = lambda: ("another processor",)
rows = np.zeros(1, CELL)
rows["b"] = 0.5
value = twice(rows[0]) if step.address else None
made = "made" if type(twice._kept).__name__ == "CFunc" else "found"
print(made, value, rows["a"][0], "numba.np.arraymath" in sys.modules)
"""


@pytest.fixture
def play(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)

    def run(*arguments):
        out = subprocess.run(
            [sys.executable, str(program), *arguments], check=True, capture_output=True, text=True
        ).stdout
        made, *values, numba_is_set_up = out.split()
        assert values == ["1.5", "3"]
        return made, numba_is_set_up == "True"

    return run


def test_code_that_was_kept_does_the_same_and_numba_sets_nothing_up(play):
    assert play() == ("made", True)
    assert play() == ("found", False)


def test_code_of_another_processor_or_of_another_source_or_cut_off_is_made_anew(play, tmp_path):
    play()
    assert play("on another processor")[0] == "made"
    (program,) = tmp_path.glob("program.py")
    program.write_text(PROGRAM.replace("c.b * n", "c.b * 1.0 * n"))
    assert play()[0] == "made"
    for file in tmp_path.rglob("twice-*.code"):
        file.write_bytes(file.read_bytes()[:-1])
    assert play()[0] == "made"
    assert play()[0] == "found"


def test_without_a_folder_to_write_in_it_runs_all_the_same(play, tmp_path):
    kept = tmp_path / "kept"
    kept.write_text("not a folder")
    play()


def test_a_full_disk_leaves_nothing_half_written(tmp_path, monkeypatch):
    # stage demo, the cache on a disk that is full
    class Made:
        native_name = "f"

        class _library:
            serialize_using_object_code = staticmethod(lambda: ("", "", (b"code", b"")))

    def full(self, data):
        self.touch()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(code, "folder_of", lambda _: tmp_path)
    code.keep(full, Made)
    assert len(list(tmp_path.iterdir())) == 1
    next(tmp_path.iterdir()).unlink()
    monkeypatch.setattr(Path, "write_bytes", full)
    code.keep(full, Made)
    assert list(tmp_path.iterdir()) == []
