"""Words and bounds of boards: latched addresses in the trace, layouts in files, timers, windows, waveforms of recordings."""

from __future__ import annotations

import re
from types import SimpleNamespace

import pytest
from support.vcd_parser import parse

from stage import Stage
from stage.board import Board, bus_layouts
from stage.board.bus import host_record
from stage.board.bus.interrupt_controller import (
    ANY_INTERRUPT_LINE,
    FIRST_INTERRUPT_LINE,
    FIRST_PYTHON_TIMER,
    FIRST_SOFTWARE_SOURCE,
    FIRST_TIMER,
    HIGHEST_LEVEL,
)
from stage.board.bus_layouts import read_layout
from stage.board.devices import HCTL2016, Encoder
from stage.board.interrupt_hooks import format_source_name
from stage.board.isolation.traps.memory_windows import MemoryWindows
from stage.board.memory_mapped_ports import ADDRESS_LIMIT, MemoryWindow, parse_windows
from stage.chips import HCTL1100, MCX304
from stage.errors import ArgumentError
from stage.sim.encoder import choose_encoders


def test_the_trace_names_the_address_in_a_latch():
    """out8(300h, 85h), out8(301h, 1), in8(301h); then another address, and a read of the latch"""
    board = Board(Stage("xyz_servo", chips=HCTL1100, visuals=False))
    for port, value in ((0x300, 0x85), (0x301, 1), (0x300, 0x07), (0x301, 5)):
        board.out8(port, value)
    board.in8(0x301), board.in8(0x300)
    message = [cycle.meaning for cycle in board.trace]
    chip = board.stage.axes["x"].chip.make_replica().make_describer()
    assert message == [
        "x: address latch = 85h", f"x: {chip.write(5, 1)}", "x: address latch = 07h", f"x: {chip.write(7, 5)}",
        f"x: {chip.read(7, board.trace.lines()['value'][4])}", "x: the address latch cannot be read",
    ]  # fmt: skip


def test_names_of_interrupts():
    lines = (0, FIRST_INTERRUPT_LINE, FIRST_INTERRUPT_LINE + 61)
    assert [format_source_name(n) for n in (*lines, FIRST_SOFTWARE_SOURCE, FIRST_SOFTWARE_SOURCE + 1)] == [
        "the interrupt line", "line 0", "line 61", "software interrupt 0", "software interrupt 1",
    ]  # fmt: skip
    assert [format_source_name(n) for n in (FIRST_TIMER, FIRST_TIMER + 1, FIRST_PYTHON_TIMER, FIRST_PYTHON_TIMER + 3)] == [
        "timer 0", "timer 1", "timer 0 of Python", "timer 3 of Python",
    ]  # fmt: skip


def test_a_timer_of_a_board_is_switched_off_by_a_period_of_0_and_keeps_parts_of_a_us():
    board, at = Board(Stage("xy", visuals=False)), []
    board.on_timer(1.5006, lambda: at.append(board.stage.now), n=3, level=HIGHEST_LEVEL)
    board.delay_us(5)
    assert at == [1501, 3002, 4503]
    assert "timer 3 of Python" in str(board.trace)
    board.on_timer(0, lambda: at.append("never"), n=3)
    board.delay_us(5)
    assert len(at) == 3
    board.on_timer(2, lambda: at.append(board.stage.now))
    board.delay_us(1)
    board.on_timer(2, lambda: at.append(board.stage.now))  # from now on
    board.delay_us(2)
    assert at[3:] == [13000]
    for n, level in ((4, 1), (-1, 1), (0, 0), (0, HIGHEST_LEVEL + 1)):
        with pytest.raises(ArgumentError, match=r"timers of a board|levels of hooks"):
            board.on_timer(5, print, n=n, level=level)


def test_a_layout_like_another_for_another_chip_and_the_last_address_of_one(tmp_path):
    file = tmp_path / "card.toml"
    file.write_text('like = "nova"\nchip = "MCX514"\nbase = "0xFFFFFF00"\nstride = 1\n')
    assert (read_layout(file).kind.__name__, read_layout(file).base, read_layout(file).stride) == (
        "MCX514",
        0xFFFFFF00,
        1,
    )
    file.write_text('like = "pcl240"\n')
    assert read_layout(file).kind.__name__ == "PCL240"
    maximum = MCX304.ADDRESSES - 1
    file.write_text(f'chip = "MCX304"\nports = ["word {maximum}", "upper {maximum}"]')
    assert len(read_layout(file).ports) == 2
    for text, message in (
        (f'chip = "MCX304"\nports = ["word {maximum + 1}"]', f"0 to {maximum}. Write"),
        ('chip = "PCL240K"\nports = ["qqqqqq 0"]', r'"none"\.$'),
        ('chip = "PCL240K"\nports = ["byte 0"]\nstride = 0', "stride = 0: a whole number from 1 to"),
        ('chip = "PCL240K"\nports = ["byte 0"]\nchips = 65', "chips = 65: a whole number from 0 to 64"),
        ('chip = "PCL240K"\nports = ["byte 0"]\nbase = -1', "base = -1: a whole number from 0"),
    ):
        file.write_text(text)
        with pytest.raises(ArgumentError, match=message):
            read_layout(file)
    file.write_text('chip = "PCL240K"\nports = ["byte 0"]\nchips = 64\nbase = 4294967295')
    assert (read_layout(file).chips, read_layout(file).base) == (64, bus_layouts.LAST_PORT)


def test_windows_end_with_the_last_port_and_address():
    assert parse_windows((ADDRESS_LIMIT - 1, 0, 1)) == (MemoryWindow(ADDRESS_LIMIT - 1, 0, 1),)
    assert parse_windows((0x10000, bus_layouts.MAX_PORTS - 1, 1))[0].length == 1
    for wrong in (((True, 1, 2),), ((1.0, 1, 2),), ((1, 2, 3, 4),), (True, 1, 2, 3)):
        with pytest.raises(ArgumentError, match="a window is a MemoryWindow"):
            parse_windows(wrong)
    for wrong, message in (((ADDRESS_LIMIT, 0, 1), "addresses are 0 to"), ((0x1000, -1, 1), "ports are 0 to")):
        with pytest.raises(ArgumentError, match=message):
            parse_windows(wrong)


@pytest.mark.parametrize(
    ("address", "nearest"), [(0xFFF, 0), (0x1040, 0), (0x1100, 0), (0x1F80, 1), (0x2041, 1), (0x9000, 2)]
)
def test_an_access_outside_windows_names_the_nearest_window(address, nearest, monkeypatch):
    argument = parse_windows([(0x1000, 0x300, 0x40), (0x2000, 0x340, 0x40), (0x5000, 0x380, 0x40)])
    monkeypatch.setattr("stage.board.crash_report.locate_code", lambda *_: "main")
    state = SimpleNamespace(start=0, stack=id(argument))
    monkeypatch.setattr("stage.board.isolation.traps.memory_windows.array_at", lambda *_: [state])
    mapped = MemoryWindows.__new__(MemoryWindows)
    mapped._windows, mapped._library = list(argument), SimpleNamespace(path=SimpleNamespace(name="it.so"))
    mapped._format_moment = lambda: "now"
    message = str(mapped.explain_refusal(host_record.BEYOND_WINDOW, 0, address))
    assert f"beyond the window {argument[nearest]}, which ends at {argument[nearest].end - 1:X}h" in message


def dumped(recording, tmp_path, name):
    vcd = parse(recording.to_vcd(tmp_path / name))
    ends = sorted(
        (t, direction) for direction, strobe in (("R", "RD_n"), ("W", "WR_n")) for t in vcd.edges(f"host.{strobe}", 1)
    )
    return vcd, [(t, direction, vcd.at("host.PORT", t)) for t, direction in ends]


def test_each_of_two_recordings_has_its_part_of_a_poll(tmp_path):
    """a poll that begins before the first and ends in the second, with a trace that has dropped lines"""
    board = Board(Stage("xy", visuals=False), keep_cycles=16)
    for k in range(40):
        board.out8(0x300, k)
    for _ in range(3):
        board.in8(0x304)
    with board.stage.record() as first:
        for _ in range(4):
            board.in8(0x304)
    for _ in range(5):
        board.in8(0x304)
    with board.stage.record() as second:
        for _ in range(6):
            board.in8(0x304)
        board.in8(0x305), board.in8(0x305)
    vcd, cycles = dumped(first, tmp_path, "first.vcd")
    assert cycles[-1] == (47_000, "R", 0x304)
    assert all(t <= 47_000 for t, *_ in cycles)
    assert max(t for t, _ in vcd.changes["host.POLLS"]) <= 47_000
    vcd, cycles = dumped(second, tmp_path, "second.vcd")
    assert [(t, port) for t, _, port in cycles if t > 52_000] == [(58_000, 0x304), (59_000, 0x305), (60_000, 0x305)]
    assert 59_000 not in [t for t, _ in vcd.changes["host.POLLS"]], "two reads are no poll"
    with board.stage.record() as silent:
        board.delay_us(10)
    assert not any(name.startswith("host.") for name in parse(silent.to_vcd(tmp_path / "silent.vcd")).changes)


def test_wrong_encoders_are_refused_with_their_value():
    """encoders="x", encoders={"x": True}; a chip without an input says which have one"""
    for argument, message in (
        ("x", "encoders='x': a mapping"),
        ({"x": True}, "a number of counts a metre"),
        (5, "encoders=5"),
    ):
        with pytest.raises(ArgumentError, match=message):
            choose_encoders(argument, "xy", [])
    with pytest.raises(ArgumentError, match=re.escape("PCL240K has no input for an encoder")) as refused:
        Stage("xy", encoders={"x": 1e5}, visuals=False)
    assert "PCL240K, " not in str(refused.value).split("encoder; ")[1]
    assert "MCX304" in str(refused.value)


def test_a_counter_without_a_zero_keeps_the_place_where_it_came_on_its_board():
    """put(HCTL2016(Encoder("x", per_metre=1e6)), port) 2 mm from the start: its twin elsewhere counts from there, too"""
    stage = Stage("xy", visuals=False)
    stage.place(x=0.002)
    board = Board(stage)
    counter = board.attach_device(HCTL2016(Encoder("x", per_metre=1e6)), 0x320)
    argument = board.attach_device(HCTL2016(Encoder("x", per_metre=1e6, zero=0.001)), 0x330)
    assert counter.encoders[0].zero == stage.axes["x"].position
    assert argument.encoders[0].zero == 0.001
    make, *arguments = counter.make_recipe()
    assert make(*arguments).encoders == counter.encoders
    assert (counter.count, argument.count) == (0, round((stage.axes["x"].position - 0.001) * 1e6))


def test_nothing_of_a_firmware_that_has_gone_is_left_in_the_table_of_interrupts():
    board = Board(Stage("xy", visuals=False))
    board.on_timer(5, print)
    hooks, h = board.link.hooks, board.link.record
    for name in ("serving", "level", "meter", "stack_low", "stack_high"):
        h[name] = 1
    hooks.sources["hook"][:] = hooks.sources["level"][:] = hooks.sources["interrupt_mask"][:] = 3
    hooks.remove_firmware_hooks()
    assert [int(h[name]) for name in ("serving", "level", "meter", "stack_low", "stack_high")] == [0] * 5
    line, timer = hooks.sources[ANY_INTERRUPT_LINE], hooks.sources[FIRST_PYTHON_TIMER]
    assert (line["hook"], line["level"], line["interrupt_mask"], line["argument"]) == (0, 1, -1, ANY_INTERRUPT_LINE)
    assert (timer["hook"], timer["argument"]) == (hooks.pointer, FIRST_PYTHON_TIMER)
    assert not hooks.sources["hook"][[k for k in range(len(hooks.sources)) if k != FIRST_PYTHON_TIMER]].any()
