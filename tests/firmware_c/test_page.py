"""docs/firmware_in_the_loop.md and the tour of the README do what they say, with a C compiler at hand."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, NativeHost, build
from stage.cli import main

ROOT = Path(__file__).resolve().parents[2]
PAGE, README = (ROOT / "docs" / "firmware_in_the_loop.md").read_text(), (ROOT / "README.md").read_text()
DRIVER = re.search(r"^```c\n(/\* driver\.c.*?)^```", PAGE, re.M | re.S)[1]
TEST, WITHOUT_PYTEST = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
HEADERLESS = """
#include <stdint.h>

struct bus { uint32_t abi, size; void *host; int64_t (*request)(void *, int32_t, int64_t, int64_t); };
struct bus *pulsestage_bus = 0;
uint32_t pulsestage_abi = 1;
int pulsestage_main(void)
{
    pulsestage_bus->request(pulsestage_bus->host, 1, 0x300, 0x08);
    return (int)pulsestage_bus->request(pulsestage_bus->host, 0, 0x300, 0);
}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch, firmware):  # `firmware` skips where there is no compiler
    (tmp_path / "driver.c").write_text(DRIVER)
    (tmp_path / "test_driver.py").write_text(TEST)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_driver_of_the_page_compiles_without_a_warning(folder):
    assert build("driver.c", folder / "driver.so", ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")).is_file()


def test_the_tests_of_the_page_pass(folder):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_driver.py"]
    finished_run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert finished_run.returncode == 0, finished_run.stdout + finished_run.stderr
    assert "2 passed" in finished_run.stdout


def test_the_program_of_the_page_runs_and_prints_the_result(folder, capsys):
    exec(compile(WITHOUT_PYTEST, "page", "exec"), {"__name__": "page"})
    assert re.match(
        r"Result\(code=0, seconds=0\.\d+, cycles=\d+\) \[\(0\.\d+, 'done after \d+ us'\)\] 0\n", capsys.readouterr().out
    )


def test_three_symbols_make_a_library(folder):
    (folder / "plain.c").write_text(HEADERLESS)
    host = NativeHost(folder / "plain.c", Board(Stage("xyz")))
    result = host.run(timeout=1.0)
    assert (result.code & 0x40, result.cycles) == (0, 2)


def test_the_tour_of_the_readme_runs_as_printed(folder, capsys):
    driver, test = (
        re.search(rf"^```{begin}(.*?)^```", README, re.M | re.S) for begin in ("c\n", "python\nimport pytest")
    )
    (folder / "driver.c").write_text(driver[1])
    (folder / "test_driver.py").write_text("import pytest" + test[1])
    command = re.search(r"^stage (run driver.*)$", README, re.M)[1].split()
    assert main([*command, "--cflags=-Wall -Wextra -Werror -std=c99 -pedantic"]) == 0
    assert "mistakes" not in capsys.readouterr().out
    expected_output = re.search(r"^```text\n( +0\.0.*?)^```", README, re.M | re.S)[1].splitlines()
    assert set(expected_output) <= set((folder / "run.txt").read_text().splitlines())
    finished_run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "1 passed" in finished_run.stdout, finished_run.stdout + finished_run.stderr
