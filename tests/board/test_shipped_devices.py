"""Shipped devices do what their data sheets say, at the nanosecond at which they are asked."""

from __future__ import annotations

import os
import random

import pytest

from stage import Stage
from stage.board import Board
from stage.board.devices import HCTL2000, HCTL2016, LS7166, UART, Encoder, OutputLatch, make_device

BAUD = ((3, 0x83), (0, 1), (1, 0), (3, 0x03), (2, 0x01))  # 115200, 8 bits, no parity, FIFOs
CHARACTER = 86805  # ns


@pytest.fixture(scope="module")
def moving():
    """A board with counters of all kinds on x, which moves to and fro."""
    stage = Stage("xy", visuals=False)
    board = Board(stage)
    for port, kind in ((0x320, HCTL2000), (0x330, HCTL2016), (0x340, LS7166)):
        board.attach_device(kind(Encoder("x", per_metre=2e6)), port)
    for command in (0x20, 0x68, 0xC3):
        board.out8(0x341, command)
    return stage, board


def true(stage, encoder=2e6) -> int:
    return round(stage.axes["x"].position * encoder)


def ls7166(board) -> int:
    board.out8(0x341, 0x03)
    return board.in8(0x340) | board.in8(0x340) << 8 | board.in8(0x340) << 16


def test_counters_count_the_true_position_at_the_moment_of_the_cycle(moving):
    stage, board = moving
    start = stage.snapshot()
    for n, value in (
        (0, 0x80),
        (3, 0),
        (2, 0x40),
        (1, 0),
        (0, 0x81),
        (2, 0),
        (1, 128),
        (0, 0x87),
        (2, 0),
        (1, 30),
        (0, 0x10),
    ):
        board.out8(0x300 + n, value)
    seed = random.randrange(1 << 30)
    print("seed", seed)
    rng, observed = random.Random(seed), set()
    for _ in range(200):
        board.delay_us(rng.randrange(5000))
        high, at = board.in8(0x330), true(stage)
        board.delay_us(rng.randrange(50))
        assert (high << 8 | board.in8(0x331)) - at & 0xFFFF in (0, 1, 0xFFFF), (
            "both bytes are of the moment of the first"
        )
        assert (board.in8(0x320) << 8 | board.in8(0x321)) - true(stage) & 0xFFF in (0, 1, 2, 3, 0xFFF)
        assert ls7166(board) - true(stage) & 0xFFFFFF in (0, 1, 0xFFFFFF, 0xFFFFFE, 0xFFFFFD, 0xFFFFFC)
        observed.add(at)
    assert len(observed) > 100
    assert max(observed) > 1 << 12, "beyond the twelve bits of the HCTL-2000"
    board.out8(0x330, 0)
    assert (board.in8(0x330), board.in8(0x331) < 4) == (0, True), "reset"
    stage.restore(start)
    assert board.in8(0x330) << 8 | board.in8(0x331) == 0


def test_a_latch_reads_back_and_calls_when_it_changes():
    stage, calls = Stage("xy", visuals=False), []
    board = Board(stage, devices=["latch:0x378"])
    board.attach_device(OutputLatch(lambda before, after: calls.append((stage.now, before, after))), 0x379)
    for port in (0x378, 0x379):
        for value in (5, 5, 0x80):
            board.out8(port, value)
        assert board.in8(port) == 0x80
    assert calls == [(5000, 0, 5), (7000, 5, 0x80)]
    assert [d.value for d in board.devices] == [0x80, 0x80]


@pytest.fixture
def line():
    """A UART at 3F8h, 115200 baud."""
    board = Board(Stage("xy", visuals=False))
    uart = board.attach_device(UART(), 0x3F8)
    for register, value in BAUD:
        board.out8(0x3F8 + register, value)
    return board, uart


def test_characters_of_a_uart_take_their_time_in_both_directions(line):
    board, uart = line
    assert uart.baud == 115200
    begin = board.stage.now
    uart.feed(b"abc")
    board.out8(0x3F8, ord("X")), board.out8(0x3F8, ord("Y"))
    got, sent = [], {}
    while len(got) < 3 or len(uart.sent) < 2:
        if board.in8(0x3FD) & 1:
            got.append((chr(board.in8(0x3F8)), board.stage.now - begin))
        sent.setdefault(uart.sent, board.stage.now - begin)
    assert [byte for byte, _ in got] == ["a", "b", "c"]
    assert all(0 <= when - k * CHARACTER < 3000 for k, (_, when) in enumerate(got, 1))
    assert 0 <= sent[b"X"] - CHARACTER - 1000 < 3000
    assert uart.sent == b"XY"
    assert 0 <= board.stage.now - begin - 3 * CHARACTER < 3000
    assert board.in8(0x3FD) == 0x60
    board.out8(0x3FB, 0x1F)  # 8 bits, parity, two stop bits
    board.out8(0x3F8, 65)
    board.delay_us(103)
    assert uart.sent == b"XY"
    board.delay_us(2)
    assert uart.sent == b"XYA"


def test_without_a_divisor_nothing_leaves_a_uart_and_what_is_fed_waits():
    board = Board(Stage("xy", visuals=False), devices=["uart:0x3F8"])
    uart = board.devices[0]
    uart.feed("z")
    board.out8(0x3F8, 65)
    board.delay_us(5000)
    assert (board.in8(0x3FD) & 1, uart.sent, uart.baud) == (0, b"", 0)
    for register, value in BAUD:
        board.out8(0x3F8 + register, value)
    assert board.in8(0x3FD) & 1 == 0
    board.delay_us(100)
    assert (board.in8(0x3FD) & 1, board.in8(0x3F8), uart.sent) == (1, ord("z"), b"")


def test_a_fifo_of_sixteen_overruns_and_without_one_the_last_byte_counts(line):
    board, uart = line
    uart.feed(bytes(range(20)))
    board.delay_us(3000)
    assert board.in8(0x3FD) & 3 == 3, "overrun"
    assert board.in8(0x3FD) & 3 == 1, "told once"
    assert [board.in8(0x3F8) for _ in range(17)] == [*range(16), 15]
    assert board.in8(0x3FD) & 1 == 0
    board.out8(0x3FA, 0)
    uart.feed(b"pq")
    board.delay_us(300)
    assert (board.in8(0x3FD) & 3, board.in8(0x3F8)) == (3, ord("q"))
    for k in range(20):
        board.out8(0x3F8, k)
    board.delay_us(3000)
    assert uart.sent == bytes([0, 19]), "one on the line, one waiting"
    board.out8(0x3FA, 1)
    for k in range(20):
        board.out8(0x3F8, 100 + k)
    board.delay_us(3000)
    assert uart.sent[2:] == bytes(range(100, 117)), "one on the line, sixteen waiting"


def test_interrupts_of_a_uart_come_at_their_nanosecond_by_priority_and_trigger(line):
    board, uart = line
    when = []

    def hook():
        matches = board.in8(0x3FA) & 15
        when.append((board.stage.now - begin - 1000, matches))
        if matches in (4, 12):
            while board.in8(0x3FD) & 1:
                board.in8(0x3F8)
        elif matches == 6:
            board.in8(0x3FD)

    board.on_interrupt(hook)
    board.out8(0x3FA, 0x41)  # trigger at 4
    board.out8(0x3F9, 0x05)
    begin = board.stage.now
    uart.feed(bytes(6))
    board.delay_us(2000)
    assert not when, "OUT2 is off"
    board.in8(0x3F8), board.out8(0x3FA, 0x43)
    board.out8(0x3FC, 0x08)
    begin = board.stage.now
    uart.feed(bytes(6))
    board.delay_us(2000)
    assert when == [(4 * CHARACTER, 4), (6 * CHARACTER + 4 * CHARACTER, 12)]
    when.clear()
    begin = board.stage.now
    board.out8(0x3F9, 0x02)
    assert when == [(1000, 2)], "empty when it is enabled; told once"
    when.clear()
    begin = board.stage.now + 1000
    board.out8(0x3F8, 1), board.out8(0x3F8, 2)
    board.delay_us(2000)
    assert when == [(0, 2), (CHARACTER, 2)], "each goes on the line at once, or when the one before has left"


@pytest.mark.skipif(not hasattr(os, "ttyname"), reason="no pseudo-terminals")
def test_a_pseudo_terminal_is_the_other_end_of_a_uart(line):
    board, uart = line
    terminal = os.open(uart.open_pty(), os.O_RDWR | os.O_NOCTTY)
    os.write(terminal, b"hi")
    got = b""
    for _ in range(2000):
        if board.in8(0x3FD) & 1:
            got += bytes([board.in8(0x3F8)])
    board.out8(0x3F8, ord("?"))
    board.delay_us(1000), board.in8(0x3FD)
    assert (got, os.read(terminal, 10)) == (b"hi", b"?")
    os.close(terminal)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hctl2016", "write KIND:PORT"), ("hctl2061:0x320:x", "Did you mean 'hctl2016'"), ("hctl2016:0x320", "hctl2016:0x320:x"),
        ("uart:three", "'three' is no port"), ("uart:0x3F8:x", "is on no axis"), ("ls7166:0x330:x:many", "no number of counts"),
        ("gone.c:0x340", "gone.c: there is no such source"), ("adc.c:1:2", "SOURCE.c:PORT"), ("hctl2016:1:x:0", "per_turn"),
        (5, "write"),
    ],
)  # fmt: skip
def test_a_text_that_is_no_device_says_what_to_write(text, message):
    with pytest.raises(Exception, match=message):
        make_device(text)


@pytest.mark.board(devices=["latch:0x378", "hctl2016:0x320:x"])
@pytest.mark.stage("xy", record=False)
def test_a_marker_puts_devices_on_the_board_of_a_test(board):
    board.out8(0x378, 9)
    assert (board.in8(0x378), [device.KIND for device in board.devices]) == (9, ["latch", "hctl2016"])
    assert board.ports[0x321] == "hctl2016 at 320h, low byte"
