"""The commands of docs/porting.md run as printed, and its flags have the documented effect."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, NativeHost
from stage.cli import main

ROOT = Path(__file__).resolve().parents[2]
PORTS = ROOT / "scripts" / "firmware" / "ports"
PAGE = (ROOT / "docs" / "porting.md").read_text()
EXAMPLES, BY_HAND = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
pytestmark = pytest.mark.slow

DIFFERENT = r"""
#include <pulsestage.h>
#include <limits.h>
struct gap { char a; int b; };
PULSESTAGE_MAIN
{
    volatile int most = INT_MAX, minus = -2;
    int seen = 0;
    seen |= ((char)0x80 < 0) << 0;
    seen |= (sizeof(struct gap) > 5) << 1;
    seen |= (most + 1 < most) << 2;
    seen |= (minus >> 1 == -1) << 3;
    seen |= (sizeof(long) == 8 && sizeof(int) == 4) << 4;
    return seen;
}
"""


@pytest.fixture(autouse=True)
def compilers(firmware):
    """Skips where there is none."""


@pytest.mark.parametrize("line", re.findall(r"^stage (.*)$", EXAMPLES, re.M))
def test_the_four_programs_run_as_the_page_says(line, monkeypatch, capsys):
    monkeypatch.chdir(PORTS)
    assert main(line.split()) == 0
    printed_text = capsys.readouterr().out
    assert "mistakes" not in printed_text
    if "avr" in line:
        expected_output = re.search(r"The second prints:\n\n```text\n(.*?)```", PAGE, re.S)[1]
        assert expected_output in printed_text


def test_the_commands_of_the_page_make_the_same_libraries(tmp_path):
    command = f'stage() {{ "{sys.executable}" -m stage "$@"; }}\nset -e\n' + re.sub(
        r"(?<= )(\w+\.so|main\.o)(?= |$)", rf"{tmp_path}/\1", BY_HAND, flags=re.M
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run(["bash", "-c", command], cwd=PORTS, env=environment, check=True)
    chips = {"mcx": ("MCX304", "xyz", None), "dos": ("PCL240K", "xy", "pcl240-card"), "avr": ("PCL240K", "xy", None)}
    for name, (chip, model, layout) in chips.items():
        stage = Stage(model, chips=chip, visuals=False)
        stage.place(x=-0.115)
        assert NativeHost(tmp_path / f"{name}.so", Board(stage, layout)).run(timeout=5).code == 0


@pytest.mark.parametrize(
    ("flags", "bits"),
    [((), 0b11011), (("-funsigned-char",), 0b11010), (("-fpack-struct",), 0b11001), (("-fwrapv",), 0b11111)],
)
def test_flags_do_what_the_table_says(flags, bits, tmp_path):
    (tmp_path / "different.c").write_text(DIFFERENT)
    detected_bits = (
        NativeHost(tmp_path / "different.c", Board(Stage("xy", visuals=False)), flags=flags).run(timeout=1).code
    )
    overflows = 0 if "-fwrapv" in flags else 0b100  # without it that is the compiler's own affair
    assert detected_bits | overflows == bits | overflows


def test_the_lines_of_the_examples_are_counted_right():
    programs = (
        "arduino/hctl1100_home/hctl1100_home.ino",
        "avr/main.c",
        "vxworks/mcxDrv.c",
        "dos/home240.c",
        "../freertos/drive_and_watch.c",
    )
    lines = [len((PORTS / name).read_text().splitlines()) for name in programs]
    assert [int(n) for n in re.findall(r"\| 0 of (\d+)", PAGE)] == lines
    for name, counted in zip(("arduino", "avr"), re.findall(r"and (\d+) in a separate file", PAGE), strict=True):
        text = (PORTS / name / "pins.cpp").read_text()
        assert len([x for x in text.splitlines() if x and not x.startswith("/*")]) == int(counted)
