"""A line of the trace in words: how often, how many ticks were missed; timers of one board, and refusals of hooks in words."""

from __future__ import annotations

import pytest

from stage import Stage
from stage.board import Board, HostTimeout, NativeHost
from stage.board.bus.host_record import CALLED, LEVEL, ON_LINE, RAISE, RETURNED, TIMER, WRONG_LEVEL
from stage.board.bus.interrupt_controller import FIRST_SOFTWARE_LINE, FIRST_SOFTWARE_SOURCE, FIRST_TIMER
from stage.board.bus_trace import Cycle, format_interrupt


@pytest.fixture
def board():
    return Board(Stage("xy", visuals=False))


@pytest.mark.parametrize(
    ("missed", "message"),
    [(0, ""), (1, " (1 tick was missed)"), (2, " (2 ticks were missed)"), (1234, " (1,234 ticks were missed)")],
)
def test_ticks_that_were_missed_are_counted_in_words(missed, message):
    assert format_interrupt(CALLED, 0, missed) == f"interrupt: the hook is called{message}"
    assert format_interrupt(RETURNED, 0, 0) == "interrupt: the hook returns"


@pytest.mark.parametrize(
    ("times", "message"), [(1, ""), (2, "2 times until 0.000002000"), (31204, "31,204 times until 0.000002000")]
)
def test_a_line_says_how_often_and_until_when(times, message):
    output = str(Cycle(1e-6, 2e-6, times, "R", 0x300, 0x40, 8, False, "it reads"))
    assert output == f"{'0.000001000':>17}  300h R 40h    {'it reads':56}  {message}".rstrip()
    assert str(Cycle(1e-6, 2e-6, 1, "W", 0x302, 0x40, 16, False, "a word")).split() == [
        "0.000001000",
        "302h",
        "W",
        "0040h",
        "a",
        "word",
    ]


def test_a_timer_that_its_hook_sets_again_has_no_old_ticks(board):
    """a hook every 10 us takes 25, then asks for another every 100: that comes 100 us later"""
    at = []

    def slow():
        board.delay_us(25)
        board.on_timer(100, lambda: at.append(board.stage.now))
        at.append(board.stage.now)

    board.on_timer(10, slow)
    board.delay_us(150)
    assert at == [35_000, 135_000]
    assert "missed" not in str(board.trace)


@pytest.mark.parametrize("n", range(4))
def test_each_timer_in_python_counts_its_missed_ticks(board, n):
    """period 10 us, 25 us of delay in the hook: two ticks come meanwhile, of which the flag holds one"""
    at = []

    def slow():
        at.append(board.stage.now)
        if len(at) == 1:
            board.delay_us(25)

    board.on_timer(10, slow, n=n)
    board.delay_us(60)
    assert at == [10_000, 35_000, 40_000, 50_000, 60_000]
    called = [c.meaning for c in board.trace if c.direction == "I"]
    assert called[:3] == [
        f"interrupt: timer {n} of Python is called", f"interrupt: timer {n} of Python is called (1 tick was missed)",
        f"interrupt: timer {n} of Python is called",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("levels", "order"),
    [((1, 1, 1), [0, 1, 2]), ((1, 3, 2), [1, 2, 0]), ((2, 2, 5), [2, 0, 1]), ((15, 15, 1), [0, 1, 2])],
)
def test_of_timers_that_are_due_at_once_the_highest_level_comes_first_and_of_one_level_the_first(board, levels, order):
    at = []
    for n, level in enumerate(levels):
        board.on_timer(10, lambda n=n: at.append(n), n=n, level=level)
    board.delay_us(10)
    assert at == order


@pytest.mark.parametrize(
    ("what", "a", "b", "message"),
    [
        (TIMER, 8, 1000, "ps_timer(8, ...), period 1000 ns: timers are 0 to 7, a period 0 (off) to 1e18 ns"),
        (
            ON_LINE,
            2,
            0,
            "ps_on_line(2, ...): this board has lines 0 to 1, and software interrupts PS_SOFTWARE(0) to PS_SOFTWARE(7)",
        ),
        (LEVEL, 16, 0, "ps_level(16): levels are 0 to 15"),
        (RAISE, 8, 0, "ps_raise(8): software interrupts are 0 to 7"),
        (TIMER | WRONG_LEVEL, 3, 0, "level 0 of timer 3: levels of hooks are 1 to 15"),
        (ON_LINE | WRONG_LEVEL, 1, 16, "level 16 of line 1: levels of hooks are 1 to 15"),
        (ON_LINE | WRONG_LEVEL, FIRST_SOFTWARE_LINE + 3, 16, "level 16 of PS_SOFTWARE(3): levels of hooks are 1 to 15"),
    ],
)
def test_a_wrong_request_is_refused_with_the_allowed_range(board, what, a, b, message):
    board.delay_us(1500)
    assert board.link.hooks.describe_refusal(what, a, b) == f"{message}; at 0.001500 s."


@pytest.mark.parametrize(
    ("source", "period", "message"),
    [
        (-1, 0, "hooks of interrupts interrupt each other without end, at 0.000000 s"),
        (0, 0, "the interrupt hook was called 1,000 times in a row at 0.000000 s and the line is still asserted"),
        (2, 0, "the hook of line 1 was called 1,000 times in a row at 0.000000 s and the line is still asserted"),
        (
            FIRST_SOFTWARE_SOURCE + 2,
            0,
            "the hook of software interrupt 2 was called 1,000 times in a row at 0.000000 s and is raised again",
        ),
        (FIRST_TIMER + 1, 2500, "is due again: it takes longer than its period of 2.5 us, so that nothing else runs."),
    ],
)
def test_a_storm_says_whose_hook_it_is_and_why_it_comes_again(board, source, period, message):
    if period:
        board.link.hooks.sources[source]["period"] = period
    assert message in board.link.hooks.describe_storm(source)


def test_cycles_that_reach_no_port_are_counted(tmp_path):
    source = tmp_path / "loop.c"
    source.write_text("#include <pulsestage.h>\nPULSESTAGE_MAIN { for (;;) ps_pin_read(9); }", encoding="utf-8")
    board = Board(Stage("xy", chips="stepdir", visuals=False))
    host = NativeHost(source, board, isolated=False, pins="x.step=2,x.dir=5,x.limit=!9")
    with pytest.raises(HostTimeout, match=r"It has made [0-9,]+ bus cycles, none at a port: polls of pins"):
        host.run(timeout=0.01)
    host.close()


def test_a_message_ends_with_the_last_cycles_of_a_run_that_made_cycles(board):
    assert board.trace.format_ending(2) == "It has made no bus cycle."
    for port in (0x300, 0x304, 0x308):
        board.in8(port)
    message = board.trace.format_ending(2)
    assert message == f"Its last bus cycles:\n{board.trace.text(2)}"
    assert [line.split()[1] for line in message.splitlines()[-2:]] == ["304h", "308h"]
    assert "1 lines before" in message
