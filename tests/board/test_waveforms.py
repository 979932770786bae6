"""The cycles of a board in a VCD: reads too, with the strobes of a bus; polling does not make it grow."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.vcd_parser import parse

from stage import Stage
from stage.board import Board, NativeHost
from stage.board.bus.host_record import CYCLE, IN, IN_WIDE, OUT, OUT_WIDE, STRAY
from stage.board.bus_waveforms import HostWaveforms, _iterate_polls, _register_signals
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
    """List (time, R or W, port, data) of each cycle in a VCD, at the rising edge of its strobe."""
    ends = [(t, "RW"[strobe == "WR_n"]) for strobe in ("RD_n", "WR_n") for t in vcd.edges(f"host.{strobe}", 1)]
    return [(t, direction, vcd.at("host.PORT", t), vcd.at("host.DATA", t)) for t, direction in sorted(ends)]


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
    assert [(t, direction) for t, direction, *_ in cycles(vcd)] == [(1000, "R"), (2_000_000, "R"), (2_001_000, "W")]
    assert vcd.changes["host.POLLS"] == [(0, 0), (1000, 1), (2_000_000, 0)]
    assert (tmp_path / "it.vcd").stat().st_size < 10_000


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
def test_the_reader_of_gtkwave_finds_the_same_cycles(board, tmp_path):
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
    matches = {re.sub(r"\[.*", "", name): changes for name, changes in theirs.changes.items()}
    assert [v for _, v in matches["host.DATA"]][-21:] == [v for _, v in ours.changes["host.DATA"]][-21:]


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


def lines(*rows):
    """(first, last, count, kind, port, value)"""
    return np.array([*rows], CYCLE)


class Writer:
    def __init__(self):
        self.sizes = {}

    def register_var(self, scope, name, kind, size, init):
        self.sizes[name] = size
        return name


@pytest.mark.parametrize(
    ("rows", "changes"),
    [
        ([(10, 20, 2, IN, 1, 0)], []),  # twice is no polling
        ([(10, 20, 3, IN, 1, 0)], [(10, 1), (20, 0)]),
        ([(10, 30, 9, IN, 1, 0), (20, 50, 9, IN, 2, 0)], [(10, 1), (50, 0)]),  # two ports by turns
        ([(10, 20, 9, IN, 1, 0), (30, 40, 9, IN, 1, 1)], [(10, 1), (20, 0), (30, 1), (40, 0)]),
    ],
)
def test_polling_is_three_equal_reads_and_more_of_any_port(rows, changes):
    assert list(_iterate_polls(lines(*rows), "POLLS")) == [(t, "POLLS", v) for t, v in changes]


@pytest.mark.parametrize(
    ("kind", "port", "sizes"),
    [
        (IN, 0x300, (16, 8)),
        (OUT, 0xFFFF, (16, 8)),
        (IN_WIDE, 0x10000, (17, 16)),
        (OUT_WIDE | STRAY, 0x40021000, (31, 16)),
    ],
)
def test_a_bus_is_as_wide_as_its_ports_and_cycles(kind, port, sizes):
    writer = Writer()
    _register_signals(lines((5, 5, 1, OUT, 0x300, 0), (9, 9, 1, kind, port, 1)), writer, 1000, 0)
    assert (writer.sizes["PORT"], writer.sizes["DATA"]) == sizes
    assert "HOOK" not in writer.sizes
    assert _register_signals(lines(), Writer(), 1000, 0) == []


def test_the_waveform_of_a_cycle_has_the_documented_times():
    """a write that ends at 5000, a read at 7000 that is repeated until 9000, cycles of 1000 ns; the recording begins at 4500"""
    cycles, polls = _register_signals(
        lines((5000, 5000, 1, OUT, 0x301, 0x12), (7000, 9000, 4, IN, 0x300, 0x34)), Writer(), 1000, 4500
    )
    assert list(cycles) == [
        (4500, "PORT", 0x301), (4500, "DATA", 0x12), (4500, "WR_n", 0), (5000, "WR_n", 1),
        (6125, "PORT", 0x300), (6500, "DATA", 0x34), (6500, "RD_n", 0), (7000, "RD_n", 1),
        (8125, "PORT", 0x300), (8500, "DATA", 0x34), (8500, "RD_n", 0), (9000, "RD_n", 1),
    ]  # fmt: skip
    assert list(polls) == [(7000, "POLLS", 1), (9000, "POLLS", 0)]


def test_a_recording_contains_ongoing_polling_but_not_earlier_polling():
    """three ports are read by turns, then a mark; two of them go on; then another mark, and one more"""
    board = Board(Stage("xy", visuals=False))
    for port in (0x300, 0x304, 0x308) * 3:
        board.in8(port)
    wave = HostWaveforms(board)
    first = wave.get_position()
    begin = board.stage.now
    for port in (0x300, 0x304) * 3:
        board.in8(port)
    last, end = wave.get_position(), board.stage.now
    for port in (0x300, 0x30C):
        board.in8(port)
    matches = wave._select_lines(first, last, begin, end)
    assert matches["port"].tolist() == [0x300, 0x304]
    assert matches["first"].tolist() == [begin, begin], "from where the recording begins"
    assert matches["last"].tolist() == [end, end], "the first of them goes on behind it, and is cut"
    complete = wave._select_lines(None, None, 0, board.stage.now)
    assert complete["port"].tolist() == [0x300, 0x304, 0x308, 0x30C]
    assert complete["count"].tolist() == [7, 6, 3, 1]
