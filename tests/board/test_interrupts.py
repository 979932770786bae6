"""Timers, levels of interrupts, hooks that are left by a jump: in process and in a process of its own, to the bit."""

from __future__ import annotations

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, HostError, LibraryError, NativeHost, StormError
from stage.chips import PCL240K
from stage.errors import ArgumentError


def host(body: str, isolated: bool = False, **options) -> NativeHost:
    """Build firmware and return its host on a new board."""
    return NativeHost(firmware(body), Board(Stage("xy", chips=PCL240K, visuals=False)), isolated=isolated, **options)


def collect_results(h: NativeHost) -> tuple:
    """Return the results of a run: state, trace, log and number of cycles."""
    return h.board.stage.snapshot().state.tobytes(), h.board.trace.lines().tobytes(), h.board.log, h.board.cycles


def read_log_texts(h: NativeHost) -> list[str]:
    return [text for _, text in h.log]


def list_hook_calls(h: NativeHost) -> list[tuple[int, str]]:
    """List (ns, text) of each begin and end of a hook."""
    return [(round(c.seconds * 1e9), c.meaning.removeprefix("interrupt: ")) for c in h.board.trace if c.port is None]


def run_in_every_mode(body: str, code: int = 0, piece: float = 0.000123457) -> NativeHost:
    """Run firmware in process, in pieces and in a child process; require equal results and return the first host."""
    h, pieces, in_child_process = host(body), host(body), host(body, isolated=True)
    assert h.run(timeout=1).code == in_child_process.run(timeout=1).code == code
    while pieces.run_for(piece) is None:
        pass
    assert collect_results(h) == collect_results(pieces) == collect_results(in_child_process)
    return h


TICKS = r"""
static volatile int ticks;
static void tick(void *wait) { ticks++; if (wait && ticks == 3) ps_delay_us(*(uint32_t *)wait); }
PULSESTAGE_MAIN
{
    uint32_t wait = 250;
    ps_in8(0x300);
    ps_on_timer(100, tick, &wait);
    ps_delay_us(1000); /* in the middle of a delay at the very ns */
    ps_logf("%d", ticks);
    for (int k = 0; k < 150; k++) /* between bus cycles, without drift */
        ps_in8(0x304);
    ps_logf("%d", ticks);
    ps_on_timer(0, 0, 0);
    ps_delay_us(1000);
    return ticks;
}
"""


def test_a_timer_calls_at_its_ns_without_drift_and_what_its_flag_cannot_hold_is_missed():
    h = run_in_every_mode(TICKS, 10)
    assert read_log_texts(h) == ["9", "10"]
    calls = [(ns, what) for ns, what in list_hook_calls(h) if "called" in what]
    delayed = [551 if k == 4 else 1 + 100 * k for k in (1, 2, 3, 4, 6, 7, 8, 9, 10, 11)]
    assert [ns for ns, _ in calls] == [1000 * us for us in delayed]
    assert calls[3][1] == "timer 0 is called (1 tick was missed)"
    assert list_hook_calls(h)[1] == (101_000, "timer 0 returns")


LEVELS = r"""
static char order[200];
static int at;
static void put(const char *what) { at += snprintf(order + at, sizeof order - (size_t)at, "%s ", what); }
static void low(void *a) { put("low"); ps_delay_us(100); put((const char *)a); }
static void high(void *a) { put("high"); ps_delay_us(10); put((const char *)a); }
static void soft(void *a) { put((const char *)a); }
PULSESTAGE_MAIN
{
    int before, inner;
    ps_timer(0, 2, 1000000, low, "/low");
    ps_timer(7, 5, 1050000, high, "/high");
    ps_timer(1, 2, 1020000, high, "/same"); /* of the same level: it waits */
    ps_delay_us(1500);
    ps_log(order), at = 0;
    ps_timer(0, 0, 0, 0, 0), ps_timer(1, 0, 0, 0, 0), ps_timer(7, 0, 0, 0, 0);
    ps_on_line(PS_SOFTWARE(0), 3, soft, "three");
    ps_on_line(PS_SOFTWARE(1), 4, soft, "four");
    ps_raise(0), put("main");
    before = ps_disable();
    inner = ps_disable();
    ps_raise(0), ps_raise(1), ps_raise(1);
    ps_enable(inner), put("still disabled"), ps_enable(before);
    ps_level(3), ps_raise(0), ps_raise(1), put("three waits"), ps_level(0);
    ps_log(order);
    return before * 100 + inner;
}
"""


def test_a_higher_level_interrupts_a_hook_of_a_lower_one_and_the_same_level_waits():
    h = run_in_every_mode(LEVELS, 15)
    assert read_log_texts(h) == [
        "low high /high /low high /same ",
        "three main still disabled four three four three waits three ",
    ]
    assert list_hook_calls(h)[1] == (1_050_000, "timer 7 is called")


LINES = r"""
static void put(uint32_t port, int r, uint32_t value)
{
    ps_out8(port, (uint8_t)(0x80 | r));
    for (int byte = 3; byte; byte--)
        ps_out8(port + (uint32_t)byte, (uint8_t)(value >> 8 * (byte - 1)));
}
static void start(uint32_t port, uint32_t pulses) /* of 5 ms each; it interrupts when it stops */
{
    ps_out8(port, 8), put(port, 0, pulses), put(port, 1, 100), put(port, 2, 1500), put(port, 7, 300);
    ps_out8(port, 0x44), ps_out8(port, 0x30);
}
static void stopped(void *port)
{
    ps_out8((uint32_t)(uintptr_t)port, 0);
    ps_logf("%x", (unsigned)(uintptr_t)port);
    ps_delay_us(20000);
    ps_logf("%x done", (unsigned)(uintptr_t)port);
}
static void any(void *a) { (void)a; ps_log("any"), ps_out8(0x300, 0), ps_out8(0x304, 0); }
PULSESTAGE_MAIN
{
    ps_on_line(0, 1, stopped, (void *)0x300);
    ps_on_line(1, 2, stopped, (void *)0x304);
    start(0x300, 10), start(0x304, 12);
    ps_delay_us(90000);
    ps_on_line(0, 0, 0, 0), ps_on_interrupt(any, 0);
    start(0x300, 10), start(0x304, 12);
    ps_delay_us(90000);
    return ps_interrupt_line();
}
"""


def test_each_chip_has_a_line_with_a_level_and_all_of_them_together_one_more():
    h = run_in_every_mode(LINES, piece=0.00123457)
    assert read_log_texts(h) == ["300", "304", "304 done", "300 done", "any"]
    assert [what for _, what in list_hook_calls(h)][:2] == ["line 0 is called", "line 1 is called"]


STUCK = r"""
#include <stdlib.h>
static void slow(void *a) { (void)a; ps_delay_us(200); }
static void again(void *a) { (void)a; ps_raise(2); }
static void nested(void *a) { ps_level(0); ps_raise(2); (void)a; }
PULSESTAGE_MAIN
{
    switch (atoi(getenv("STUCK"))) {
    case 0: ps_on_timer(100, slow, 0); break;
    case 1: ps_on_line(PS_SOFTWARE(2), 9, again, 0), ps_raise(2); break;
    case 2: ps_on_line(PS_SOFTWARE(2), 9, nested, 0), ps_raise(2); break;
    case 3: ps_on_line(2, 1, slow, 0); break;
    case 4: ps_timer(8, 1, 1000, slow, 0); break;
    case 5: ps_timer(3, 16, 1000, slow, 0); break;
    case 6: ps_level(16); break;
    case 7: ps_raise(8); break;
    }
    ps_delay_us(1000);
    return 0;
}
"""


@pytest.mark.parametrize(
    ("case", "error", "message"),
    [
        (
            0,
            StormError,
            r"timer 0 was called 1,000 times in a row .* due again: it takes longer than its period of 100 us",
        ),
        (1, StormError, r"software interrupt 2 was called 1,000 times .* it raises itself"),
        (2, StormError, r"interrupt each other without end.* clears its interrupt before"),
        (3, HostError, r"ps_on_line\(2, \.\.\.\): this board has lines 0 to 1, and software"),
        (4, HostError, r"ps_timer\(8, \.\.\.\), period 1000 ns: timers are 0 to 7"),
        (5, HostError, r"level 16 of timer 3: levels of hooks are 1 to 15"),
        (6, HostError, r"ps_level\(16\): levels are 0 to 15"),
        (7, HostError, r"ps_raise\(8\): software interrupts are 0 to 7"),
    ],
)
def test_interrupt_storms_and_invalid_calls_are_explained(case, error, message, monkeypatch):
    monkeypatch.setenv("STUCK", str(case))
    h = host(STUCK, isolated=case in (0, 2, 3))
    with pytest.raises(error, match=rf"(?s){message}"):
        h.run()
    h.board.delay_us(1000)
    assert h.board.in8(0x300) != 0xFF


JUMPS = r"""
#include <setjmp.h>
static jmp_buf out;
static volatile int jumps, calls;
static void jump(void *a) { (void)a; calls++; ps_in8(0x300); longjmp(out, 1); }
static void higher(void *a) { (void)a; longjmp(out, 2); }
static void lower(void *a) { (void)a; calls++; ps_delay_us(1000); }
static int __attribute__((noinline)) deep(int n)
{
    volatile char room[200];
    room[0] = (char)n;
    return n ? deep(n - 1) + room[0] : ps_in8(0x304);
}
PULSESTAGE_MAIN
{
    ps_timer(0, 2, 100000, jump, 0);
    for (jumps = 0; jumps < 3; jumps++)
        if (setjmp(out) == 0)
            for (;;) ps_in8(0x304);
    ps_logf("polling: level %d", ps_level(-1));
    if (setjmp(out) == 0)
        ps_delay_us(1000000);
    ps_logf("a delay: level %d", ps_level(-1));
    if (setjmp(out) == 0)
        for (;;) deep(3);
    ps_logf("called from above: level %d", ps_level(-1));
    if (setjmp(out) == 0)
        for (;;) ps_in8(0x304);
    for (int k = 0; k < 3; k++) deep(3);
    ps_logf("called from below: level %d", ps_level(-1));
    ps_timer(0, 2, 100000, lower, 0), ps_timer(1, 3, 130000, higher, 0);
    if (setjmp(out) == 0)
        ps_delay_us(1000000);
    ps_logf("two of them: level %d", ps_level(-1));
    return calls;
}
"""


def test_a_hook_left_by_longjmp_is_over_and_interrupts_go_on():
    h = run_in_every_mode(JUMPS, 7)
    assert all(text.endswith("level 0") for text in read_log_texts(h)), read_log_texts(h)
    assert len(read_log_texts(h)) == 5
    ends = [what for _, what in list_hook_calls(h) if "called" not in what]
    assert ends == ["timer 0 is over: a jump has left its hook"] * 6 + [
        "timer 1 is over: a jump has left its hook", "timer 0 is over: a jump has left its hook",
    ]  # fmt: skip


STACKS = r"""
#include <ucontext.h>
static ucontext_t contexts[3];
static char stacks[3][256 * 1024];
static int last;
static void turn(int to) { int from = last; last = to; swapcontext(&contexts[from], &contexts[to]); }
static void task(void)
{
    int own = last;
    for (int k = 0; k < 400; k++) {
        ps_out8(0x301 + 4 * (uint32_t)(own - 1), (uint8_t)(own + k));
        turn(3 - own);
    }
    ps_logf("task %d", own);
    turn(own == 1 ? 2 : 0);
}
static void leave(void *a) { (void)a; setcontext(&contexts[0]); }
static void waiting(void) { ps_delay_us(1000); }
PULSESTAGE_MAIN
{
    for (int k = 1; k < 3; k++) {
        getcontext(&contexts[k]);
        contexts[k].uc_stack.ss_sp = stacks[k], contexts[k].uc_stack.ss_size = sizeof stacks[k];
        makecontext(&contexts[k], task, 0);
    }
    if (ps_in8(0x301) == 0) /* R0 as it is after power-up */
        turn(1);
    else { /* a hook goes to another stack, and never comes back */
        ps_on_timer(100, leave, 0);
        makecontext(&contexts[1], waiting, 0);
        swapcontext(&contexts[0], &contexts[1]);
        ps_delay_us(1000);
    }
    return 3;
}
"""


def test_coroutines_on_several_stacks_make_bus_cycles():
    h = run_in_every_mode(STACKS, 3, piece=0.00123457)
    assert read_log_texts(h) == ["task 1", "task 2"]
    lines = h.board.trace.lines()["port"].tolist()
    assert lines[1:] == [0x301, 0x305] * 400
    h.board.out8(0x301, 1)
    with pytest.raises(HostError, match=r"the hook of timer 0 has not: .* Call ps_level\(0\) where the code goes on"):
        h.run(timeout=1)
    assert h.board.link.record["level"] == 0


COMPUTING = r"""
static volatile int flag, counted;
static void tick(void *a) { (void)a; flag = 1; ps_in8(0x300); }
PULSESTAGE_MAIN
{
    ps_on_timer(1000, tick, 0);
    while (!flag)
        counted++;
    ps_logf("%lld", (long long)ps_micros());
    ps_on_timer(0, 0, 0);
    for (volatile int k = 0; k < 1000; k++)
        ;
    ps_spend_ns(123456);
    ps_logf("%lld", (long long)ps_micros());
    return 0;
}
"""


def test_computing_takes_its_cost_and_timers_come_in_the_middle_of_it(tmp_path):
    source = tmp_path / "driver.c"
    source.write_text(f"#include <pulsestage.h>\n{COMPUTING}")
    left = []
    for isolated in (False, True):
        board = Board(Stage("xy", chips=PCL240K, visuals=False))
        h = NativeHost(source, board, isolated=isolated, cost=50e-9, flags=("-Wall", "-Wextra", "-Werror"))
        assert h.run(timeout=1).code == 0
        left.append(collect_results(h))
    assert left[0] == left[1]
    flag, counted = map(int, read_log_texts(h))
    assert flag == 1002, "the tick at 1000 us, its cycle, and that of ps_micros"
    assert list_hook_calls(h)[0] == (1_000_050, "timer 0 is called"), "a period from where it was set, after one block"
    assert counted - flag == pytest.approx(123 + 1 + 1000 * 0.05, abs=5)
    with pytest.raises(ArgumentError, match=r"cost=2: simulated seconds a basic block"):
        NativeHost(source, board, cost=2)
    with pytest.raises(LibraryError, match=r"does not count what it computes.*give the sources"):
        NativeHost(firmware(COMPUTING), board, cost=50e-9)


def test_timers_in_python_are_called_at_the_same_ns_wherever_the_firmware_runs():
    observed: dict[bool, list] = {}
    left = []
    for isolated in (False, True):
        h = host(TICKS, isolated)
        calls = observed[isolated] = []

        def hook(board=h.board, calls=calls):
            calls.append((board.stage.now, board.in8(0x300)))
            board.delay_us(30)
            if len(calls) == 20:
                board.on_timer(0, None)

        h.board.on_timer(50.5, hook, level=2)
        h.run_for(0.0005)
        h.run(timeout=1)
        left.append(collect_results(h))
    assert observed[False] == observed[True]
    assert left[0] == left[1]
    assert [ns for ns, _ in observed[True][:3]] == [50_500, 101_000, 151_500]
    assert len(observed[True]) == 20


def test_a_board_in_python_has_timers():
    board, calls = Board(Stage("xy", chips=PCL240K, visuals=False)), []
    board.on_timer(100, lambda: calls.append(board.stage.now))
    board.on_timer(250, lambda: calls.append(-board.stage.now), n=3)
    board.delay_us(300)
    for _ in range(120):
        board.in8(0x300)
    assert calls == [100_000, 200_000, -250_000, 300_000, 400_000]
    board.on_timer(0, None)
    board.on_timer(250, None, n=3)
    board.delay_us(300)
    assert len(calls) == 5
    for wrong, message in (({"period_us": -1}, "period_us=-1"), ({"n": 4}, "n=4"), ({"level": 0}, "level=0")):
        with pytest.raises(ArgumentError, match=message):
            board.on_timer(**{"period_us": 1, "hook": print, **wrong})


SOURCE = r"""
static char order[200];
static int at;
static void put(const char *what) { at += snprintf(order + at, sizeof order - (size_t)at, "%s ", what); }
static void stays(void *a) { (void)a; put("stays"); ps_level(3); ps_raise(2); ps_in8(0x500); put("/stays"); }
static void lowers(void *a) { (void)a; put("lowers"); ps_level(2); ps_in8(0x500); put("/lowers"); }
static void plain(void *a) { put((const char *)a); }
PULSESTAGE_MAIN
{
    int before;
    ps_on_line(PS_SOFTWARE(0), 3, stays, 0);
    ps_on_line(PS_SOFTWARE(1), 3, lowers, 0);
    ps_on_line(PS_SOFTWARE(2), 3, plain, "two");
    ps_on_line(PS_SOFTWARE(3), 3, plain, "three");
    ps_on_line(PS_SOFTWARE(7), 4, plain, "seven");
    ps_raise(0), put("main");
    ps_raise(1), put("main");
    ps_log(order), at = 0;
    ps_level(0);
    before = ps_disable();
    ps_raise(3), ps_raise(2), ps_raise(7), ps_raise(2);
    ps_enable(before);
    ps_log(order), at = 0;
    return 0;
}
"""


def test_a_hook_that_lowers_its_level_is_over():
    """ps_level(3) and ps_level(2) in hooks of level 3; then interrupts 3, 2 and 7 of levels 3, 3 and 4 while all are disabled"""
    host = NativeHost(firmware(SOURCE), Board(Stage("xy", visuals=False)), isolated=False)
    assert host.run().code == 0
    words = [text.split() for _, text in host.log]
    assert words == [["stays", "/stays", "two", "main", "lowers", "/lowers", "main"], ["seven", "two", "three"]]
    ends = [c.meaning.removeprefix("interrupt: ") for c in host.board.trace if c.direction == "i"]
    assert ends[:3] == [
        "software interrupt 0 returns", "software interrupt 2 returns",
        "software interrupt 1 is over: its hook has lowered the level",
    ]  # fmt: skip


TIMERS = r"""
static char order[200];
static int at;
static void note(void *a) { at += snprintf(order + at, sizeof order - (size_t)at, "%s %d ", (char *)a, (int)ps_micros()); }
static void again(void *a) { note(a); ps_timer(0, 0, 0, 0, 0); }
static void slow(void *a) { note(a); ps_delay_us(35); ps_timer(0, 1, 100000, again, "again"); }
PULSESTAGE_MAIN
{
    ps_timer(0, 1, 10000, slow, "slow");
    ps_delay_us(200);
    ps_log(order);
    return 0;
}
"""


def test_a_firmware_timer_that_its_hook_sets_again_has_no_old_ticks():
    """every 10 us, a hook of 35 that asks for another every 100: that comes 100 later, and has missed nothing"""
    host = NativeHost(firmware(TIMERS), Board(Stage("xy", visuals=False)), isolated=False)
    assert host.run().code == 0
    first, slow, second, again = host.log[-1][1].split()
    assert (first, second) == ("slow", "again")
    assert 135 <= int(again) - int(slow) <= 137, "a look at the time takes a bus cycle"
    assert "missed" not in str(host.board.trace)
