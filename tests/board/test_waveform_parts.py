"""The bus of a host as waveforms, part by part: how wide, which reads are polling, which cycles belong to a recording."""

from __future__ import annotations

import numpy as np
import pytest

from stage import Stage
from stage.board import Board
from stage.board.host import CALLED, CYCLE, IN, IN_WIDE, OUT, OUT_WIDE, RETURNED, STRAY
from stage.board.waveforms import HostWaveforms, _changes, _polls


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
    assert list(_polls(lines(*rows), "POLLS")) == [(t, "POLLS", v) for t, v in changes]


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
    _changes(lines((5, 5, 1, OUT, 0x300, 0), (9, 9, 1, kind, port, 1)), writer, 1000, 0)
    assert (writer.sizes["PORT"], writer.sizes["DATA"]) == sizes
    assert "HOOK" not in writer.sizes
    assert _changes(lines(), Writer(), 1000, 0) == []


def test_a_cycle_has_its_port_an_eighth_behind_its_begin_and_its_strobe_in_its_second_half():
    """a write that ends at 5000, a read at 7000 that is repeated until 9000, cycles of 1000 ns; the recording begins at 4500"""
    cycles, polls = _changes(
        lines((5000, 5000, 1, OUT, 0x301, 0x12), (7000, 9000, 4, IN, 0x300, 0x34)), Writer(), 1000, 4500
    )
    assert list(cycles) == [
        (4500, "PORT", 0x301), (4500, "DATA", 0x12), (4500, "WR_n", 0), (5000, "WR_n", 1),
        (6125, "PORT", 0x300), (6500, "DATA", 0x34), (6500, "RD_n", 0), (7000, "RD_n", 1),
        (8125, "PORT", 0x300), (8500, "DATA", 0x34), (8500, "RD_n", 0), (9000, "RD_n", 1),
    ]  # fmt: skip
    assert list(polls) == [(7000, "POLLS", 1), (9000, "POLLS", 0)]


def test_a_hook_is_high_from_its_call_to_its_return():
    *_, hook = _changes(
        lines((5, 5, 1, CALLED, 0, 0), (7, 7, 1, OUT, 1, 1), (9, 9, 1, RETURNED, 0, 0)), Writer(), 10, 0
    )
    assert list(hook) == [(5, "HOOK", 1), (9, "HOOK", 0)]


def test_of_polling_that_goes_on_each_port_belongs_to_the_recording_and_what_ended_before_does_not():
    """three ports are read by turns, then a mark; two of them go on; then another mark, and one more"""
    board = Board(Stage("xy", visuals=False))
    for port in (0x300, 0x304, 0x308) * 3:
        board.in8(port)
    wave = HostWaveforms(board)
    first = wave.mark()
    begin = board.stage.now
    for port in (0x300, 0x304) * 3:
        board.in8(port)
    last, end = wave.mark(), board.stage.now
    for port in (0x300, 0x30C):
        board.in8(port)
    found = wave._lines(first, last, begin, end)
    assert found["port"].tolist() == [0x300, 0x304]
    assert found["first"].tolist() == [begin, begin], "from where the recording begins"
    assert found["last"].tolist() == [end, end], "the first of them goes on behind it, and is cut"
    whole = wave._lines(None, None, 0, board.stage.now)
    assert whole["port"].tolist() == [0x300, 0x304, 0x308, 0x30C]
    assert whole["count"].tolist() == [7, 6, 3, 1]
