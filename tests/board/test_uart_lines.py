"""The line of a UART as Python sees it: its speed, what it has sent, when what it is fed arrives."""

from __future__ import annotations

import numpy as np
import pytest

from stage import Stage
from stage.board import Board
from stage.board.devices import UART, uart_core

BASE = 0x3F8


def line(divisor=12, **options):
    """A board with a UART, 8 bits, one stop bit, FIFOs."""
    board = Board(Stage("xy", visuals=False))
    uart = board.attach_device(UART(**options), BASE)
    for n, value in ((3, 0x83), (0, divisor & 0xFF), (1, divisor >> 8), (3, 3), (2, 1)):
        board.out8(BASE + n, value)
    return board, uart


@pytest.mark.parametrize(
    ("clock", "divisor", "baud"), [(1_843_200, 12, 9600), (3_686_400, 12, 19_200), (16_000_000, 1, 1e6), (1, 0, 0)]
)
def test_the_speed_follows_from_crystal_and_divisor(clock, divisor, baud):
    assert line(divisor, clock=clock)[1].baud == baud


def test_bytes_fed_later_do_not_delay_bytes_on_the_line():
    """two bytes, and half a character later one more: they arrive a character apart from the first feed on"""
    board, uart = line()
    compute_character_ns = uart._character_ns
    assert compute_character_ns == pytest.approx(10 / 9600 * 1e9, abs=1)
    begin = board.stage.now
    uart.feed(b"ab")
    board.delay_us(compute_character_ns // 2000)
    uart.feed("c")
    arrived = []
    while len(arrived) < 3:
        if board.in8(BASE + 5) & 1:
            arrived.append((chr(board.in8(BASE)), (board.stage.now - begin) // 10_000))
        board.delay_us(5)
    assert [c for c, _ in arrived] == ["a", "b", "c"]
    assert [at for _, at in arrived] == pytest.approx([compute_character_ns * k // 10_000 for k in (1, 2, 3)], abs=1)


@pytest.mark.parametrize(
    ("written", "unsent"), [(0, 0), (5, 2), (5, 5), (4096, 0), (5000, 16), (5000, 17), (12_345, 3)]
)
def test_sent_has_the_bytes_that_have_left_the_uart_in_order(written, unsent):
    """of much the last 4096, and never a byte that is still in the transmitter"""
    board, uart = line()
    s = uart.registers
    message = np.arange(written) * 7 % 251
    for k in range(max(0, written - uart_core.SENT_BUFFER_SIZE), written):
        s["sent"][k % uart_core.SENT_BUFFER_SIZE] = message[k]
    s["written"], s["left"] = written, board.stage.now + unsent * uart._character_ns - (1 if unsent else 0)
    end = written - unsent
    assert uart.sent == bytes(message[max(0, end - 4096) : end].tolist())


def test_what_is_cleared_in_the_transmitter_takes_nothing_of_what_had_left():
    board, uart = line()
    board.out8(BASE + 2, 1)
    message = bytes(k % 251 for k in range(4200))
    for k in range(0, len(message), 15):
        for byte in message[k : k + 15]:
            board.out8(BASE, byte)
        board.delay_us(20_000)
    assert uart.sent == message[-4096:]
    for _ in range(2):
        for _ in range(17):
            board.out8(BASE, 0xFF)
        board.out8(BASE + 2, 5)
    board.delay_us(20_000)
    assert uart.sent == (message + b"\xff")[-4096:]
