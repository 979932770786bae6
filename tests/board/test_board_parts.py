"""Parts of a board: texts that name devices, first ports by axis, when a device pulls, what the trace keeps apart."""

from __future__ import annotations

import pytest

from stage import Stage
from stage.board import Board
from stage.board.devices import OutputLatch, device_options
from stage.chips import MCX304, PCL240K
from stage.errors import ArgumentError


@pytest.mark.parametrize(
    ("text", "ports"),
    [
        ("adc.c:0x340+4", [0x340, 0x341, 0x342, 0x343]),
        ("adc.c:0x340", [0x340]),
        ("adc.so:832+2", [832, 833]),
        ("a.cpp:0+1", [0]),
    ],
)
def test_a_device_of_sources_has_as_many_ports_as_its_text_says(monkeypatch, text, ports):
    monkeypatch.setattr(device_options, "CDevice", lambda source: source)
    assert device_options.make_device(text) == (text.partition(":")[0], ports)


def test_a_chip_of_several_axes_has_its_first_port_by_any_of_them():
    board = Board(Stage("xyz", chips=MCX304, visuals=False), base={"y": 0x320})
    assert [(place.first, board.join_axis_names(place.index)) for place in board.places] == [(0x320, "xyz")]
    two = Stage("xy", chips=PCL240K, visuals=False)
    assert [place.first for place in Board(two, base={"y": 0x320, "x": 0x340}).places] == [0x340, 0x320]
    with pytest.raises(ArgumentError, match=r"base=\{'y': 800\}: the chip of axis x has no first port"):
        Board(Stage("xy", chips=PCL240K, visuals=False), base={"y": 0x320})


def test_a_device_pulls_from_the_nearest_nanosecond_on():
    """times whose product with 1e9 is a little less than a whole number; then now, and off"""
    board = Board(Stage("xy", visuals=False))
    latch = board.attach_device(OutputLatch(), 0x378)
    cut = [ns for ns in range(1, 10_000) if int(ns / 1e9 * 1e9) != ns]
    assert cut, "some of them are not whole numbers"
    for ns in (*range(1, 100), *cut):
        latch.pull(at=ns / 1e9)
        assert latch.interrupt_start_ns[0] == ns
    latch.pull(at=5e-6)
    board.delay_us(4)
    assert (latch.is_pulling, board.interrupt) == (False, False)
    board.delay_us(1)
    assert (latch.is_pulling, board.interrupt) == (True, True)
    latch.pull(False)
    assert not board.interrupt


def test_reads_before_and_after_a_failed_cycle_are_two_lines():
    board = Board(Stage("xy", visuals=False))

    def write(port, value):
        raise ZeroDivisionError("no")

    board.add_device(0x400, lambda port: 7, write)
    board.in8(0x302), board.in8(0x302)
    with pytest.raises(ZeroDivisionError):
        board.out8(0x400, 0x12)
    board.in8(0x302)
    assert [(c.port, c.direction, c.times) for c in board.trace] == [(0x302, "R", 2), (0x400, "W", 1), (0x302, "R", 1)]


@pytest.mark.parametrize(
    ("base", "free"), [(0x300, 0x310), (0x304, 0x310), (0x308, 0x310), (0x30C, 0x320), (0xFFFFFFF0, 0)]
)
def test_an_occupied_port_is_refused_with_free_ports(base, free):
    """two chips of 4 ports each; behind the last ports of all the first are named"""
    board = Board(Stage("xy", chips=PCL240K, visuals=False), base=base)
    with pytest.raises(
        ArgumentError, match=rf"port {base + 1:03X}h is taken: .*Choose ports from {free:03X}h on"
    ) as refused:
        board.attach_device(OutputLatch(), base + 1)
    assert "x address 1" in str(refused.value)
    assert board.attach_device(OutputLatch(), free).ports == (free,)
