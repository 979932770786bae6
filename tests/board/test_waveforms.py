"""The cycles of a board in a VCD: reads too, with the strobes of a bus; polling does not make it grow."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from support.vcd_parser import parse

from stage import Stage
from stage.board import Board, NativeHost
from stage.chips import MCX304


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", visuals=False)


@pytest.fixture
def board(stage):
    stage.reset()
    return Board(stage)


def dumped(recording, tmp_path, name="it.vcd"):
    return parse(recording.to_vcd(tmp_path / name))


def cycles(vcd):
    """(time, R or W, port, data) of each cycle, at the rising edge of its strobe."""
    ends = [(t, "RW"[strobe == "WR_n"]) for strobe in ("RD_n", "WR_n") for t in vcd.edges(f"host.{strobe}", 1)]
    return [(t, way, vcd.at("host.PORT", t), vcd.at("host.DATA", t)) for t, way in sorted(ends)]


def test_each_cycle_has_its_port_its_data_and_a_strobe_that_ends_with_it(board, tmp_path):
    with board.stage.record() as recording:
        board.out8(0x300, 0x81)
        board.out8(0x301, 0x2C)
        read = board.in8(0x304)
        board.in8(0x350)
        board.delay_us(5)
        board.out8(0x305, 7)
    vcd = dumped(recording, tmp_path)
    assert cycles(vcd) == [
        (1000, "W", 0x300, 0x81), (2000, "W", 0x301, 0x2C), (3000, "R", 0x304, read), (4000, "R", 0x350, 0xFF),
        (10000, "W", 0x305, 7),
    ]  # fmt: skip
    assert vcd.edges("host.WR_n", 0) == [500, 1500, 9500]
    assert [t for t, _ in vcd.changes["host.PORT"][1:]] == [125, 1125, 2125, 3125, 9125]
    assert vcd.at("host.DATA", 2400) == 0x2C, "a read has its data with the strobe"
    assert vcd.changes["host.POLLS"] == [(0, 0)]
    assert "host.HOOK" not in vcd.changes


def test_a_loop_of_polling_is_its_first_and_its_last_read(board, tmp_path):
    with board.stage.record() as recording:
        for _ in range(2000):
            board.in8(0x300)
        board.out8(0x304, 0x08)
    vcd = dumped(recording, tmp_path)
    assert [(t, way) for t, way, *_ in cycles(vcd)] == [(1000, "R"), (2_000_000, "R"), (2_001_000, "W")]
    assert vcd.changes["host.POLLS"] == [(0, 0), (1000, 1), (2_000_000, 0)]
    assert (tmp_path / "it.vcd").stat().st_size < 10_000


def test_a_recording_has_the_cycles_made_while_it_runs_also_of_polling_begun_before(board, tmp_path):
    board.out8(0x300, 0x08)
    for _ in range(5):
        board.in8(0x300)
    with board.stage.record() as recording:
        for _ in range(5):
            board.in8(0x300)
        board.in8(0x301)
    board.in8(0x302)
    assert [(t, port) for t, _, port, _ in cycles(dumped(recording, tmp_path))] == [(11_000, 0x300), (12_000, 0x301)]


def test_a_bus_of_16_bits_is_as_wide_and_two_ports_are_polled_at_once(tmp_path):
    board = Board(Stage("xyz", chips=MCX304, visuals=False))
    with board.stage.record() as recording:
        board.out16(0x30C, 0x4321)
        for _ in range(10):
            board.in16(0x300), board.in8(0x302)
    vcd = dumped(recording, tmp_path)
    assert cycles(vcd)[0] == (1000, "W", 0x30C, 0x4321)
    assert vcd.changes["host.POLLS"] == [(0, 0), (2000, 1), (21_000, 0)]
    assert all(a < b for (a, _), (b, _) in pairwise(vcd.changes["host.PORT"][1:]))


def test_a_stage_without_a_board_has_no_bus_of_a_host(tmp_path):
    stage = Stage("xy", visuals=False)
    with stage.record() as recording:
        stage.axes["x"].chip.write(0, 0x08)
    assert not any(name.startswith("host.") for name in dumped(recording, tmp_path).changes)


FIRMWARE = """
#include <pulsestage.h>
static void clear(void *times) { ++*(int *)times; ps_out8(0x300, 0x08); }
PULSESTAGE_MAIN
{
    int times = 0;
    ps_out8(0x300, 0x80), ps_out8(0x301, 2), ps_out8(0x300, 0x81), ps_out8(0x302, 0x1F), ps_out8(0x300, 0x87), ps_out8(0x301, 50);
    ps_on_interrupt(clear, &times);
    ps_out8(0x300, 0x44), ps_out8(0x300, 0x30);
    while (!times) ps_in8(0x300);
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_equal_runs_make_equal_files_in_process_and_isolated_with_the_hook_in_them(tmp_path):
    (tmp_path / "it.c").write_text(FIRMWARE)
    texts = []
    for isolated in (False, True, True):
        board = Board(Stage("xy", visuals=False))
        with board.stage.record() as recording, NativeHost(tmp_path / "it.c", board, isolated=isolated) as host:
            assert host.run().code == 0
        path = recording.to_vcd(tmp_path / f"{len(texts)}.vcd")
        texts.append(path.read_bytes())
    assert texts[0] == texts[1] == texts[2]
    vcd = parse(path)
    up, down = (vcd.edges("host.HOOK", level) for level in (1, 0))
    assert len(up) == len(down) == 1
    assert [c[1:] for c in cycles(vcd) if up[0] < c[0] <= down[0]] == [("W", 0x300, 0x08)]
    assert vcd.edges("x.INT_n", 0)[0] <= up[0]


@pytest.mark.slow
@pytest.mark.skipif(not all(map(shutil.which, ("vcd2fst", "fst2vcd"))), reason="gtkwave is not installed")
def test_gtkwaves_own_reader_finds_the_same_cycles(board, tmp_path):
    # vcd2fst x.vcd x.fst; fst2vcd x.fst
    with board.stage.record() as recording:
        for k in range(20):
            board.out8(0x301, k)
        board.in8(0x300)
        board.delay_us(3)
    path = recording.to_vcd(tmp_path / "it.vcd")
    subprocess.run(["vcd2fst", path, tmp_path / "it.fst"], check=True, capture_output=True)
    text = subprocess.run(["fst2vcd", tmp_path / "it.fst"], check=True, capture_output=True, text=True).stdout
    (tmp_path / "again.vcd").write_text(text)
    ours, theirs = parse(path), parse(tmp_path / "again.vcd")
    for name in ("RD_n", "WR_n"):
        levels = theirs.changes[f"host.{name}"]
        assert [t for (_, a), (t, b) in pairwise(levels) if (a, b) == (0, 1)] == ours.edges(f"host.{name}", 1)
    assert len(ours.edges("host.WR_n", 1)) == 20
    found = {re.sub(r"\[.*", "", name): changes for name, changes in theirs.changes.items()}
    assert [v for _, v in found["host.DATA"]][-21:] == [v for _, v in ours.changes["host.DATA"]][-21:]


@pytest.mark.slow
@pytest.mark.skipif(
    not all(map(shutil.which, ("gtkwave", "xvfb-run", "cc"))), reason="gtkwave, xvfb-run or cc is not installed"
)
def test_gtkwave_opens_it_and_the_picture_can_be_drawn(tmp_path):
    script = Path(__file__).parents[2] / "scripts" / "waveforms_picture.py"
    subprocess.run(
        [sys.executable, str(script), str(tmp_path / "it.png")], check=True, capture_output=True, timeout=200
    )
    assert (tmp_path / "it.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "it.png").stat().st_size > 20_000
