"""The level of the processor within hooks of firmware, and which of several interrupts of one level comes first."""

from __future__ import annotations

from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, NativeHost

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


def test_a_hook_that_sets_its_own_level_goes_on_as_one_and_one_that_lowers_it_is_over():
    """ps_level(3) and ps_level(2) in hooks of level 3; then interrupts 3, 2 and 7 of levels 3, 3 and 4 while all are disabled"""
    host = NativeHost(firmware(SOURCE), Board(Stage("xy", visuals=False)), isolated=False)
    assert host.run().code == 0
    said = [text.split() for _, text in host.log]
    assert said == [["stays", "/stays", "two", "main", "lowers", "/lowers", "main"], ["seven", "two", "three"]]
    ends = [c.meaning.removeprefix("interrupt: ") for c in host.board.trace if c.way == "i"]
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


def test_a_timer_of_firmware_that_its_hook_sets_anew_has_forgotten_the_ticks_of_before():
    """every 10 us, a hook of 35 that asks for another every 100: that comes 100 later, and has missed nothing"""
    host = NativeHost(firmware(TIMERS), Board(Stage("xy", visuals=False)), isolated=False)
    assert host.run().code == 0
    first, slow, second, again = host.log[-1][1].split()
    assert (first, second) == ("slow", "again")
    assert 135 <= int(again) - int(slow) <= 137, "a look at the time takes a bus cycle"
    assert "missed" not in str(host.board.trace)
