"""Two hundred tests of firmware in one session with two workers: how long it takes, and that nothing stays."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"),
    pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="no /proc here"),
]
TESTS = """
import pytest
from stage.testing import assert_no_lost_steps

@pytest.mark.stage("xy")
@pytest.mark.firmware("driver.c")
@pytest.mark.parametrize("n", range(200))
def test_it_arrives(n, host, stage):
    assert host.run(timeout=5).code == 0
    assert_no_lost_steps(stage)
    assert stage.axes["x"].position == pytest.approx(1.25e-3, abs=25e-6)
"""
DRIVER = r"""
#include <pulsestage.h>
static void put(int r, uint32_t value)
{
    ps_out8(0x300, 0x80 | r);
    for (int byte = 3; byte; byte--)
        ps_out8(0x300 + byte, value >> 8 * (byte - 1));
}
PULSESTAGE_MAIN
{
    ps_out8(0x300, 0x08);
    put(0, 400), put(1, 500), put(7, 300), ps_out8(0x300, 0x44), ps_out8(0x300, 0x10);
    while (ps_in8(0x300) & 0x40)
        ;
    ps_delay_us(50000);
    return 0;
}
"""


def with_mark(mark: str) -> list[int]:
    """Processes that have this in their environment."""
    result = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark.encode() in path.read_bytes():
                result.append(int(path.parent.name))
        except OSError:
            pass
    return result


@pytest.mark.parametrize("isolated", [True, False], ids=["isolated", "in process"])
def test_two_hundred_tests_of_firmware_leave_no_file_and_no_process(isolated, tmp_path):
    # python -m pytest -n 2
    folder, temporary = tmp_path / "project", tmp_path / "tmp"
    folder.mkdir(), temporary.mkdir()
    (folder / "test_many.py").write_text(TESTS)
    (folder / "driver.c").write_text(DRIVER)
    mark = f"MANY_FIRMWARE_TESTS={tmp_path}"
    direction = "isolated" if isolated else "in-process"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n",
        "2",
        f"--pulsestage-firmware={direction}",
        f"--basetemp={tmp_path / 'base'}",
    ]
    environment = os.environ | {"TMPDIR": str(temporary), "MANY_FIRMWARE_TESTS": str(tmp_path)}
    begin = time.monotonic()
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=500
    )
    seconds = time.monotonic() - begin
    assert re.search(r"200 passed", done.stdout), done.stdout[-3000:]
    print(f"200 tests of firmware, {direction}, 2 workers: {seconds:.1f} s, {seconds / 200 * 1e3:.0f} ms each")
    until = time.monotonic() + 5
    while with_mark(mark) and time.monotonic() < until:
        time.sleep(0.1)
    assert with_mark(mark) == []
    assert list(temporary.iterdir()) == []
    assert not (folder / ".pulsestage").exists()
