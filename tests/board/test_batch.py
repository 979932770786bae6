"""Many requests in one compiled call are the same requests one by one, and the time and the trace are the same."""

from __future__ import annotations

import random

import numpy as np
import pytest

from stage import Stage
from stage.board import Board
from stage.board.bus.host_record import DELAY, IN8, IN16, IN32, LINE, MICROS, OUT8, OUT16, OUT32
from stage.board.bus.request_batch import ENTRY, UNTIL8, UNTIL16, UNTIL_LINE, find_first_invalid, run_batch
from stage.chips import PCL240MK

PORT, OPERATING = 0x300, 0x40


def entries(*rows: tuple[int, ...]) -> np.ndarray:
    """Make entries of (what, a, b, times, every, mask)."""
    built = np.zeros(len(rows), ENTRY)
    for row, entry in zip(rows, built, strict=True):
        what, a, b, times, every, mask = (*row, 0, 0, 0, 0, 0)[:6]
        entry.what, entry.a, entry.b, entry.times, entry.every, entry.mask = what, a, b, times, every, mask
    return built


def together(board: Board, rows: list[tuple[int, ...]]) -> list[int]:
    """Run rows as one batch, and return their answers."""
    requested, answers = entries(*rows), np.zeros(len(rows), np.int64)
    assert find_first_invalid(requested, 1) == len(rows)
    board.link.begin_run()
    done = run_batch.c(board.link.pointer, requested.ctypes.data, len(rows), answers.ctypes.data, len(rows))
    board.link.end_run()
    assert done == len(rows)
    return answers.tolist()


def move(pulses: int, interrupts: bool = False) -> list[tuple[int, ...]]:
    """Starts an axis at FL."""
    registers = ((0, pulses), (1, 1000), (7, 30))
    writes = [(OUT8, PORT, 0x08)]
    for register, value in registers:
        writes += [(OUT8, PORT, 0x80 | register)]
        writes += [(OUT8, PORT + 1 + byte, value >> 8 * byte & 0xFF) for byte in (2, 1, 0)]
    return [*writes, (OUT8, PORT, 0x44), (OUT8, PORT, 0x30 if interrupts else 0x10)]


@pytest.fixture(scope="module")
def pair():
    stages = [Stage("xy", chips=PCL240MK, visuals=False) for _ in range(2)]
    return [(Board(stage), stage, stage.snapshot()) for stage in stages]


@pytest.fixture
def boards(pair):
    for _, stage, start in pair:
        stage.restore(start)
    return [board for board, _, _ in pair]


def state(board: Board) -> tuple:
    return board.stage.snapshot().state.tobytes(), board.cycles, str(board.trace)


def test_a_batch_is_its_requests_one_by_one_to_the_bit(boards):
    for seed in range(3):
        print("seed", seed)
        rng = random.Random(seed)
        rows = move(300)
        for _ in range(300):
            what = rng.choice((IN8, IN8, IN8, OUT8, IN16, OUT16, IN32, OUT32, DELAY, MICROS, LINE))
            port = PORT + rng.randrange(10)
            rows.append((DELAY, rng.choice((0, 3, 260, 4000))) if what == DELAY else (what, port, rng.randrange(256)))
        batched, single = boards
        answers = together(batched, rows)
        assert [single.link.make_request(*row[:2], row[2] if len(row) > 2 else 0) for row in rows] == answers
        assert state(batched) == state(single)


@pytest.mark.parametrize("every", [0, 50])
@pytest.mark.parametrize("wide", [False, True], ids=["8 bits", "16 bits"])
def test_a_batch_reads_until_a_value_comes_as_a_loop_would(boards, every, wide):
    batched, single = boards
    mask, what, end = OPERATING, UNTIL16 if wide else UNTIL8, 0
    *_, last = together(batched, [*move(5), (what, PORT, end, 1_000_000, every, mask)])
    for row in move(5):
        single.out8(*row[1:])
    reads = 0
    while True:
        value, reads = (single.in16 if wide else single.in8)(PORT), reads + 1
        if value & mask == end:
            break
        if every:
            single.delay_us(every)
    assert reads > 5
    assert last == value
    assert state(batched) == state(single)


def test_a_read_until_ends_after_its_number_of_reads(boards):
    board = boards[0]
    before = board.cycles
    (last,) = together(board, [(UNTIL8, PORT, 0xFF, 7, 0, 0xFF)])
    assert last == board.in8(PORT) != 0xFF
    assert board.cycles == before + 7 + 1


def test_a_batch_waits_for_the_interrupt_line_to_the_nanosecond(boards):
    batched, single = boards
    asserted = together(batched, [*move(50, interrupts=True), (UNTIL_LINE, 1_000_000)])[-1]
    assert asserted == 1
    for row in move(50, interrupts=True):
        single.out8(*row[1:])
    single.in8(0x500)  # UNTIL_LINE looks at the line first, which takes a bus cycle
    begin = single.stage.snapshot()
    single.stage.run_to(batched.stage.now - 1)
    assert not single.interrupt
    single.stage.restore(begin)
    single.stage.run_to(batched.stage.now)
    assert single.interrupt
    assert single.stage.snapshot().state.tobytes() == batched.stage.snapshot().state.tobytes()


def test_a_wait_for_the_interrupt_line_ends_after_its_limit(boards):
    board = boards[0]
    assert together(board, [(UNTIL_LINE, 1000)]) == [0]
    assert board.micros == 1001


@pytest.mark.parametrize(
    "row",
    [
        (6,), (7,), (63,), (99,), (103,), (-1,), (IN8, -1), (IN8, 1 << 32), (OUT8, PORT, 256), (OUT8, PORT, -1),
        (OUT16, PORT, 1 << 16),
        (OUT32, PORT, 1 << 32),         (DELAY, -1), (DELAY, 10**15 + 1), (UNTIL_LINE, -1), (UNTIL8, PORT, 0, 0),
        (UNTIL8, PORT, 0, 1, -1),
    ],
)  # fmt: skip
def test_a_wrong_entry_is_detected_before_a_batch_begins(row):
    assert find_first_invalid(entries((IN8, PORT), row, (IN8, PORT)), 1) == 1


def test_fractions_of_a_nanosecond_of_computing_time_are_carried_over(boards):
    """NativeHost(cost=0.3e-9): 300 ps a block, one between two reads: ten of them are 3 ns"""
    board = boards[0]
    host, blocks = board.link._rows[0], np.zeros(1, np.int64)
    host["meter"], host["cost"], host["rest"] = blocks.ctypes.data, 300, 0
    try:
        board.link.begin_run()
        for _ in range(10):
            blocks[0] = 1
            board.link.request(board.link.pointer, IN8, PORT, 0)
        board.link.end_run()
    finally:
        host["meter"] = 0
    assert (int(blocks[0]), int(host["rest"])) == (0, 0)
    assert round(board.stage.time * 1e9) == 10 * 1000 + 3
