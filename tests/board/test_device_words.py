"""What the trace says of cycles of devices, what a device says of itself, and the bounds of what it takes."""

from __future__ import annotations

import os
import re

import numpy as np
import pytest

from stage import Stage
from stage.board import Board
from stage.board.board import _parse_ports_of_device
from stage.board.devices import (
    HCTL2000,
    HCTL2016,
    LS7166,
    UART,
    CDevice,
    Device,
    Encoder,
    OutputLatch,
    PythonDevice,
    make_device,
    user_devices,
)
from stage.errors import ArgumentError, StageError


@pytest.fixture(scope="module")
def board():
    """Counters of x, a UART and a latch; x stands at 10.0004 mm."""
    stage = Stage("xy", visuals=False)
    board = Board(stage)
    for port, device in (
        (0x320, HCTL2000(Encoder("x", per_metre=2e6, zero=0.0))),
        (0x340, LS7166(Encoder("x", per_metre=2e6))),
        (0x3F8, UART()),
        (0x378, OutputLatch()),
    ):
        board.attach_device(device, port)
    return board


def meanings_of(board, *cycles):
    """(port, value) is written, a port alone is read; what the trace says of each."""
    for one in cycles:
        board.out8(*one) if isinstance(one, tuple) else board.in8(one)
    return [cycle.meaning.split(": ", 1)[1] for cycle in board.trace.last(len(cycles))]


def test_the_trace_names_control_words_and_status_of_an_ls7166(board):
    c = 0x341
    assert meanings_of(board, (0x340, 0x5A), (c, 0x03), 0x340, (c, 0x20), (c, 0x00), (c, 0x0C), (c, 0x10)) == [
        "PR byte <- 5Ah", "MCR: pointer = 0, latch the counter", "OL byte = 00h", "MCR: master reset", "MCR: nothing",
        "MCR: counter = 0, counter = PR", "MCR: COMPT = 0",
    ]  # fmt: skip
    assert meanings_of(board, (c, 0x68), (c, 0x84), (c, 0xC0), (c, 0xC1), (c, 0xC2), (c, 0xC3)) == [
        "ICR <- 28h", "OCCR <- 04h", "QR: no quadrature", "QR: x1", "QR: x2", "QR: x4",
    ]  # fmt: skip
    describe = board.devices[1].make_describer()
    assert [describe(1, value, False, False) for value in (0, 0x0A, 0x15, 0xE0)] == [
        "status: none", "status: CYT, SIGN", "status: BWT, COMPT, up", "status: none",
    ]  # fmt: skip
    assert [board.ports[0x340], board.ports[0x341]] == ["ls7166 at 340h, data", "ls7166 at 340h, control"]


def test_the_trace_names_registers_of_a_uart_by_its_lcr(board):
    u = 0x3F8
    assert meanings_of(board, (u, 0x41), (u + 3, 0x83), (u, 1), (u + 1, 0), u, (u + 2, 1), (u + 3, 3), (u + 1, 5), u + 1) == [
        "THR <- 41h 'A'", "LCR <- 83h", "DLL <- 01h", "DLM <- 00h", "DLL = 01h", "FCR <- 01h", "LCR <- 03h", "IER <- 05h",
        "IER = 05h",
    ]  # fmt: skip
    assert meanings_of(board, u, u + 2, u + 3, u + 5, (u + 5, 1), (u + 7, 9)) == [
        "RBR = 00h '\\x00'", "IIR: none", "LCR = 03h", "LSR: THR empty, all sent", "LSR <- 01h", "SCR <- 09h",
    ]  # fmt: skip
    describe = board.devices[2].make_describer()
    assert describe(5, 0x91, False, False) == "LSR: data ready, break, FIFO error"
    assert describe(5, 0, False, False) == "LSR: none"
    assert [describe(2, value, False, False) for value in (0xC1, 0xC6, 0xC4, 0xCC, 0xC2, 0x00)] == [
        "IIR: none", "IIR: line status", "IIR: data", "IIR: time-out", "IIR: THR empty", "IIR: modem",
    ]  # fmt: skip
    names = [board.ports[u + n].split(", ", 1)[1] for n in range(8)]
    assert names == ["RBR, THR", "IER", "IIR, FCR", "LCR", "MCR", "LSR", "MSR", "SCR"]


def test_the_trace_names_bytes_and_resets_of_a_counter(board):
    assert meanings_of(board, 0x321, (0x320, 0)) == ["low byte = 00h", "reset"]
    assert board.ports[0x320] == "hctl2000 at 320h, high byte"


def test_a_counter_has_the_nearest_count_from_where_it_is_zero_on():
    """Encoder("x", per_metre=1e6, zero=0.001): at -0.4, 0.6 and 3.2 counts from there, and after a reset"""
    stage = Stage("xy", visuals=False)
    board = Board(stage)
    counter = board.attach_device(HCTL2000(Encoder("x", per_metre=1e6, zero=0.001)), 0x320)
    wide = board.attach_device(HCTL2016(Encoder("x", per_metre=-1e6, zero=0.001)), 0x330)
    q = stage.data.qpos
    for counts, expected in ((-0.4, 0), (0.6, 1), (3.2, 3), (4097.1, 1), (-1.0, 4095)):
        q[stage.state.axis_table[0].qpos] = 0.001 + counts * 1e-6
        stage.restore(stage.snapshot())
        assert counter.counts == [round(counts)]
        assert counter.count == expected, counts
    assert wide.count == 1
    board.out8(0x320, 0)
    assert (counter.count, counter.counts) == (0, [-1])
    q[stage.state.axis_table[0].qpos] = 0.001 - 3e-6
    stage.restore(stage.snapshot())
    assert (counter.count, wide.count) == (4094, 3)


def test_each_device_reports_whether_it_pulls_the_line():
    """two devices of one's own: the second pulls; then the first, then at a time that comes"""
    board = Board(Stage("xy", visuals=False))
    a, b = (board.add_device(port) for port in (0x500, 0x501))
    b.pull()
    assert (a.is_pulling, b.is_pulling, board.interrupt) == (False, True, True)
    a.pull(), b.pull(False)
    assert (a.is_pulling, b.is_pulling, board.interrupt) == (True, False, True)
    a.pull(at=-1e3)  # long ago
    assert a.is_pulling
    for at in (1e10, -1e10, float("nan"), "soon"):
        with pytest.raises(ArgumentError, match="a time of the stage is wanted"):
            a.pull(at=at)
    for question in (lambda: Device().is_pulling, lambda: Device().stage):
        with pytest.raises(StageError, match="is on no board yet"):
            question()


def test_bounds_of_devices_are_what_their_messages_say(tmp_path):
    """UART(clock=1e9), Board(stage, keep_cycles=1 << 28 + 1), board.add_device(range(70000)), a state of 1 MB + 1"""
    assert [UART(clock=c).clock for c in (1, 10**9)] == [1, 10**9]
    for clock in (0, 10**9 + 1, 1.5):
        with pytest.raises(ArgumentError, match="1 to 1e9 Hz"):
            UART(clock=clock)
    maximum = user_devices.MAX_STATE_BYTES
    for state in (np.zeros(maximum, np.uint8), bytearray(3), np.zeros(1)):
        assert PythonDevice(state=state).state[0].nbytes == len(memoryview(state).cast("B"))
    locked = np.zeros(3)
    locked.flags.writeable = False
    for state in (np.zeros(maximum + 1, np.uint8), np.zeros(0), np.zeros((4, 4))[:, 1], locked):
        with pytest.raises(ArgumentError, match="a contiguous, writeable array of 1 to 1,048,576 bytes"):
            PythonDevice(state=state)
    for state in ([1, 2], np.array([object()])):
        with pytest.raises(ArgumentError, match="an array of numbers that the device changes in place"):
            PythonDevice(state=state)
    uart = Board(Stage("xy", visuals=False)).attach_device(UART(), 0x3F8)
    uart.feed(b"x" * 4096)
    with pytest.raises(ArgumentError, match="4,096 bytes are still to arrive, and 1 more are too many"):
        uart.feed(b"y")
    for wrong in (5, None, [1, 2]):
        with pytest.raises(ArgumentError, match=r"feed\(.*\): bytes or text are wanted"):
            uart.feed(wrong)


def test_bounds_of_boards_are_what_their_messages_say():
    """Board("xyz"), keep_cycles=0, 1.5 and 2^28 + 1; ports behind the last, twice, too many; a 63rd source"""
    stage = Stage("xy", visuals=False)
    with pytest.raises(ArgumentError, match=re.escape("'xyz' is no Stage")):
        Board("xyz")
    for keep in (0, 1.5, (1 << 28) + 1):
        with pytest.raises(ArgumentError, match="a trace keeps 1 to 268435456 lines"):
            Board(stage, keep_cycles=keep)
    assert Board(Stage("xy", visuals=False), keep_cycles=1).trace.capacity == 1
    board = Board(stage, devices="latch:0x378")
    assert [device.name for device in board.devices] == ["latch at 378h"]
    with pytest.raises(ArgumentError, match="is no device"):
        board.attach_device("latch", 0x380)
    last = 0xFFFFFFFF
    board.add_device(last)
    with pytest.raises(ArgumentError, match="each port once, and at most 65,536 of them"):
        board.add_device(range(1 << 16, (1 << 17) + 1))
    with pytest.raises(ArgumentError, match="each register takes two ports"):
        board.add_device(range(0x500, 0x503), width=16)
    with pytest.raises(ArgumentError, match="from 000h on"):  # behind the last port there is none
        board.add_device(0x378)
    assert len(_parse_ports_of_device(Device(), range(0x10000, 0x20000))) == 1 << 16
    for n in range(62 - 2 - 2):
        board.add_device(0x600 + n)
    with pytest.raises(ArgumentError, match="at most 62 chips and devices"):
        board.add_device(0x700)
    with pytest.raises(ArgumentError, match=r"a delay takes 0 to 1e15 us"):
        board.delay_us(10**15 + 1)
    for argument in ({"write": print}, {"state": bytearray(2)}, {"read": print}):
        with pytest.raises(ArgumentError, match="the device has its functions and its state in C"):
            board.add_device(0x700, source="adc.c", **argument)


def test_a_board_in_python_refuses_timers_that_cannot_be():
    board = Board(Stage("xy", visuals=False))
    board.on_timer(0.001, None)
    board.on_timer(10**15, print)
    for period in (0.0009, 10**15 + 1, "1", float("nan"), -1):
        with pytest.raises(ArgumentError, match="a timer's period is"):
            board.on_timer(period, print)


def test_a_pseudo_terminal_has_what_is_written_from_then_on(board):
    """UART().pty() before it is on a board; then bytes in both directions, and those before the terminal are not for it"""
    board = Board(Stage("xy", visuals=False))
    uart = UART()
    assert uart.access, "without a terminal Python is not called"
    board.attach_device(uart, 0x3F8)
    for n, value in ((3, 0x83), (0, 1), (1, 0), (3, 3)):
        board.out8(0x3F8 + n, value)
    board.out8(0x3F8, ord("a"))
    board.delay_us(200)
    terminal = os.open(uart.open_pty(), os.O_RDWR | os.O_NOCTTY)
    try:
        assert (uart.open_pty(), uart.access) == (os.ttyname(terminal), 0)
        board.out8(0x3F8, ord("b"))
        assert os.read(terminal, 9) == b"b"
        os.write(terminal, b"k" * 200)
        board.in8(0x3FD)
        s = uart.registers
        assert 64 <= s["fed"] - s["taken"] <= 128, "no more is taken than the line may hold"
    finally:
        os.close(terminal)


def test_byte_writes_to_a_16_bit_device_are_traced_as_words():
    """board.out8 of either half of a register of 16 bits; a read of its half"""
    board = Board(Stage("xy", visuals=False))
    got = []
    board.add_device(range(0x500, 0x504), read=lambda port: 0x1234, write=lambda port, value: got.append((port, value)), width=16,
                 name="adc")  # fmt: skip
    board.out8(0x502, 0x56), board.out8(0x503, 0x78), board.out16(0x502, 0x9ABC), board.in8(0x502), board.in16(0x502)
    assert [cycle.meaning for cycle in board.trace] == [
        "adc: port 1 <- FF56h", "adc: port 1 <- 78FFh", "adc: port 1 <- 9ABCh", "adc: port 1 = 0034h", "adc: port 1 = 1234h",
    ]  # fmt: skip
    assert got == [(0x502, 0xFF56), (0x502, 0x78FF), (0x502, 0x9ABC)]


def test_a_device_of_another_version_or_with_a_huge_state_is_refused(tmp_path):
    """CDevice of a library with pulsestage_device_abi = 2, and with a state of 2 MB"""
    from support.compiled_firmware import firmware

    firmware("PULSESTAGE_MAIN { return 0; }")  # skips without a compiler
    for k, (abi, size, message) in enumerate(
        ((2, 8, "version 2, and this is version 1: build it again"), (1, 1 << 21, "a state of 2,097,152 bytes"))
    ):
        source = tmp_path / f"d{k}.c"
        source.write_text(
            f"unsigned pulsestage_device_abi = {abi}, pulsestage_device_size = {size};"
            "int pulsestage_device_access, pulsestage_device_pulls;"
        )
        with pytest.raises(Exception, match=message):
            CDevice(source)


def test_a_text_of_a_device_that_is_like_none_gives_no_advice():
    with pytest.raises(ArgumentError) as refused:
        make_device("zzzzzz:0x320:x")
    assert "Did you mean" not in str(refused.value)
