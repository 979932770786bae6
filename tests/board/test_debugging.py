"""docs/debugging.md: gdb, the sanitizers and gcov do what the page shows."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, LibraryError, NativeHost, crash_report

PAGE = Path(__file__).parents[2] / "docs" / "debugging.md"
DRIVER = re.search(r"```c\n(.*?)```", PAGE.read_text(), re.S)[1]
LINE = 1 + DRIVER.splitlines().index("    ps_out8(0x300, 0x80 | r);")
BAD = """
#include <pulsestage.h>
#include <stdlib.h>
PULSESTAGE_MAIN
{
    int *steps = malloc(4 * sizeof *steps);
    for (int k = 0; k <= ps_in8(0x300) % 5; k++)
        steps[k] = k;
    int sum = 0x7fffffff;
    sum += ps_in8(0x300);
    free(steps);
    ps_logf("%d", sum);
    return 0;
}
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not crash_report.IS_SUPPORTED, reason="gdb, gcc and their libraries on Linux"),
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed"),
]


@pytest.fixture
def driver(tmp_path):
    path = tmp_path / "driver.c"
    path.write_text(DRIVER)
    return path


def stage_run(folder, *arguments):
    command = [sys.executable, "-m", "stage", "run", *map(str, arguments), "--model", "xy"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=200)


@pytest.mark.skipif(shutil.which("gdb") is None, reason="gdb is not installed")
def test_gdb_stops_in_the_driver_and_sees_its_variables(driver):
    # gdb --args python -m stage run driver.c --cflags=-O0 --in-process
    orders = ["set debuginfod enabled off", "set breakpoint pending on", "break write_register", "run", "backtrace 2"]
    orders += ["print moves", "delete", "continue"]
    command = ["gdb", "-q", "-batch", *(part for text in orders for part in ("-ex", text)), "--args", sys.executable, "-m", "stage",
               "run", "driver.c", "--cflags=-O0", "--in-process", "--model", "xy"]  # fmt: skip
    message = subprocess.run(
        command, cwd=driver.parent, capture_output=True, text=True, check=False, timeout=200
    ).stdout
    if "ptrace" in message:
        pytest.skip("ptrace is not allowed here")
    assert re.search(rf"Breakpoint 1, write_register \(r=0, value=400\) at .*driver\.c:{LINE}", message), message[
        -2000:
    ]
    assert re.search(r"#1 .* pulsestage_main \(\) at .*driver\.c:\d+", message)
    assert "$1 = 1" in message
    assert "driver.so returned 0" in message


@pytest.mark.parametrize("what", ["address", "undefined"])
def test_a_report_of_a_sanitizer_fails_the_run_and_names_the_line(what, tmp_path):
    # stage run bad.c --cflags=-fsanitize=...
    (tmp_path / "bad.c").write_text(BAD if what == "undefined" else BAD.replace("% 5", "% 5 + 4"))
    done = stage_run(tmp_path, "bad.c", f"--cflags=-fsanitize={what}")
    assert done.returncode == 1, done.stdout + done.stderr
    assert {"address": "heap-buffer-overflow", "undefined": "signed integer overflow"}[what] in done.stderr
    assert re.search(r"was ended by SIGABRT \(Aborted\): in pulsestage_main \(.*bad\.c:\d+\)", done.stderr)


def test_a_driver_without_a_fault_passes_with_both_sanitizers(driver):
    assert stage_run(driver.parent, "driver.c", "--cflags=-fsanitize=address,undefined").returncode == 0


def test_in_process_a_sanitizer_that_was_not_loaded_first_is_refused_in_words(driver):
    board = Board(Stage("xy", visuals=False))
    with pytest.raises(
        LibraryError, match=r"whose libasan\.so\S* has to be loaded before all else: .*LD_PRELOAD=libasan"
    ):
        NativeHost(driver, board, flags=("-fsanitize=address",), isolated=False).run()


@pytest.mark.skipif(shutil.which("gcov") is None, reason="gcov is not installed")
@pytest.mark.parametrize("direction", [[], ["--in-process"]], ids=["isolated", "in process"])
def test_coverage_is_counted(direction, driver):
    folder = driver.parent / "cov"
    folder.mkdir()
    done = stage_run(driver.parent, "driver.c", f"--cflags=--coverage -dumpdir {folder}{os.sep}", *direction)
    if "dumpdir" in done.stderr:
        pytest.skip("gcc before 11")
    assert done.returncode == 0, done.stderr
    command = ["gcov", "--object-directory", "cov", "driver.c"]
    message = subprocess.run(command, cwd=driver.parent, capture_output=True, text=True, check=True)
    assert re.search(r"driver\.c'\nLines executed:100\.00% of 1\d", message.stdout), message.stdout
