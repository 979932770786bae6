"""Windows are given as text or numbers, and what cannot be is refused in words; cycles of 32 bits are two of 16."""

from __future__ import annotations

import re

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, NativeHost
from stage.board.bus_layouts import MAX_PORTS
from stage.board.memory_mapped_ports import MemoryWindow, parse_windows
from stage.chips import MCX304
from stage.errors import ArgumentError


def test_a_window_is_text_or_numbers_one_or_several():
    # stage run driver.so --map 0x40021000=0x300+0x40
    one = MemoryWindow(0x40021000, 0x300, 0x40)
    assert parse_windows("0x40021000=0x300+0x40") == parse_windows(" 1073876992 = 768+64") == (one,)
    assert str(one) == "0x40021000=0x300+0x40"
    assert (
        parse_windows(str(one))
        == parse_windows([one])
        == parse_windows((0x40021000, 0x300, 0x40))
        == parse_windows(one)
        == (one,)
    )
    assert parse_windows(["0x50000000=0x340+4", one]) == (one, MemoryWindow(0x50000000, 0x340, 4)), "sorted by address"
    assert parse_windows([(0x50000010, 0x300, 8), (0x50000000, 0x300, 0x10)])[1].address == 0x50000010, "side by side"
    assert parse_windows() == parse_windows([]) == ()
    assert parse_windows(f"0x1000={MAX_PORTS - 4}+4")[0].length == 4


REFUSED = {
    "0x40021000": "--map '0x40021000': write ADDRESS=PORT+LENGTH, for example 0x40021000=0x300+0x40",
    "40021000h=300h+40h": "write ADDRESS=PORT+LENGTH",
    "0x40021000=0x300": "write ADDRESS=PORT+LENGTH",
    "0x40021000=0x300+0": "its length is 1 port or more",
    f"0x40021000={MAX_PORTS - 4}+5": f"its ports end at {MAX_PORTS:X}h, and ports are 0 to {MAX_PORTS - 1:X}h",
    "0x7fffffffffff=0x300+2": "addresses are 0 to 7FFFFFFFFFFFh",
    ("0x40021000=0x300+0x11", "0x40021010=0x340+4"): "windows 0x40021000=0x300+0x11 and 0x40021010=0x340+0x4 overlap",
    (5,): "map=(5,): a window is a MemoryWindow(address, port, length), or text",
    (1, 2): "a window is",
    ((0x40021000, 0x300),): "a window is",
    (0x40021000, -1, 5): "its ports end at 3h",
    (-8, 1, 5): "addresses are 0 to",
}


@pytest.mark.parametrize("argument", REFUSED, ids=str)
def test_what_is_no_window_is_refused_in_words(argument):
    with pytest.raises(ArgumentError, match=re.escape(REFUSED[argument])):
        parse_windows(argument)


def test_a_cycle_of_32_bits_is_two_of_16_the_low_half_first():
    boards = [Board(Stage("xy", chips=MCX304, visuals=False)) for _ in range(3)]
    boards[0].out32(0x304, 0xA5A51234)
    assert boards[0].in32(0x304) == boards[0].in16(0x304) | boards[0].in16(0x306) << 16
    for port, value in ((0x304, 0x1234), (0x306, 0xA5A5)):
        boards[1].out16(port, value)
    for port in (0x304, 0x306, 0x304, 0x306):
        boards[1].in16(port)
    body = "PULSESTAGE_MAIN { ps_out32(0x304, 0xA5A51234); ps_in32(0x304); ps_in32(0x304); return 0; }"
    NativeHost(firmware(body), boards[2]).run()
    assert boards[0].trace.lines().tobytes() == boards[1].trace.lines().tobytes() == boards[2].trace.lines().tobytes()
