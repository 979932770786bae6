"""The automatic home search of the MCX514 and the MCX304 family, onto switches that stand at positions of the axis.

`q` is the position in the direction of step 1: STOP0 from 200 on, STOP1 from 400 to 440, STOP2 where q mod 50 = 25, limits
beyond 1000 and -1000.
"""

import copy
import random

import pytest
from support import nova_interpolation_bench as interpolation
from support.covers import covers
from support.nova_bench import SEED, command, get, get_signed
from support.nova_hands import D_END, D_STA, H_END, MS, READ, US, home_state, load, page1, passes, set_word, word

from stage.chips import MCX302, MCX304, MCX312, MCX514

FAMILY = (MCX304, MCX302, MCX312)
CHUNK = MS
S1, S2, S3, S4 = 0x0001, 0x0010, 0x0400, 0x8000  # H1M: steps, and their directions
S1_MINUS, S2_MINUS, S3_MINUS = 0x0002, 0x0020, 0x0800
BY_STOP1, BY_LIMIT, LIMIT_2 = 0x0004, 0x0008, 0x0040  # signals of steps 1 and 2
HM_STEPS, HM_MINUS = 0x0055, 0x002A
ENABLE_LIMITS, ENABLE_STOPS = 0x0800, 0x002A  # WR2
E_EMG, E_HOME = 0x20, 0x40  # RR2
both_ways = pytest.mark.parametrize("direction", [1, -1], ids=["+", "-"])


def switches(direction, stop2=lambda q: q % 50 == 25):
    """Pins by position."""
    return {
        "stop0": lambda p: p * direction >= 200,
        "stop1": lambda p: 400 <= p * direction <= 440,
        "stop2": lambda p: stop2(p * direction),
        "lmt_plus": lambda p: p >= 1000,
        "lmt_minus": lambda p: p <= -1000,
    }


def put_at(chip, start, direction, **also):
    """Set speeds (50,000 pps and HV 5,000 pps), put the axis at q = `start`, and return its switches."""
    chip._place = start * direction  # where net = 0 is
    if isinstance(chip, MCX514):
        load(chip, SV=10_000, DV=50_000, HV=5_000, AC=50_000_000, **also)
        set_word(chip, 2, ENABLE_LIMITS)
    else:
        load(chip, R=800_000, SV=1000, V=5000, HV=500, A=8000, **also)
    table = switches(direction)
    press(chip, table)
    return table


def press(chip, table):
    for pin, at in table.items():
        setattr(chip.axes[0].pins, pin, bool(at(chip._place + chip.net(0))))


def search(chip, table, code=None, maximum=4000 * MS):
    """Run a home search to its end, with the switches pressed at the pulses that reach them. The states that it had."""
    states = []
    command(chip, code or (0x5A if isinstance(chip, MCX514) else 0x62))
    end = chip.clock + maximum
    while chip.read(0) & 1:
        assert chip.clock < end, states
        state = home_state(chip)
        if not states or states[-1] != state:
            states.append(state)
        go_on(chip, table)
    return [state for state in states if state]


def go_on(chip, table):
    """Advance to the next pulse that changes a switch, or a little further."""
    at, pressed = (
        chip._place + chip.net(0),
        {pin: bool(is_on(chip._place + chip.net(0))) for pin, is_on in table.items()},
    )
    for clock, _, direction in copy.copy(chip).trace(CHUNK).tolist():
        at += direction
        if any(bool(is_on(at)) != pressed[pin] for pin, is_on in table.items()):
            chip.advance(clock - chip.clock)
            press(chip, table)
            return
    chip.advance(CHUNK)


def h1m(direction, steps=S1 | S2 | S3 | S4, more=0):
    return steps | more | (S1_MINUS | S2_MINUS | S3_MINUS if direction < 0 else 0)


STARTS = {
    "before all": (0, [3, 20, 28, 36]),
    "on STOP0": (250, [20, 28, 36]),
    "on STOP1": (420, [15, 20, 28, 36]),
    "behind STOP1": (600, [20, 11, 15, 20, 28, 36]),
    "at the limit": (1000, [11, 15, 20, 28, 36]),
    "at the other limit": (-1000, [3, 20, 28, 36]),
}
HMST = {3: 3, 11: 8, 15: 12, 20: 15, 28: 20, 36: 25}


@covers("MCX514", "HMSRC", "H1M", "HV", "TP")
@both_ways
@pytest.mark.parametrize("where", STARTS)
def test_the_search_ends_at_the_same_pulse_wherever_it_starts(where, direction):
    start, states = STARTS[where]
    chip = MCX514()
    table = put_at(chip, start, direction, H1M=h1m(direction), TP=-25 * direction)
    assert search(chip, table) == states
    assert chip._place + chip.net(0) == 400 * direction  # STOP1 at 400, STOP2 at 425, 25 back
    assert home_state(chip) == 0
    assert word(chip, 2) & 0xFF == 0


@covers("MCX304 MCX302 MCX312", "HOME_EXEC", "HM", "HV", "P")
@pytest.mark.parametrize("make", FAMILY)
@both_ways
@pytest.mark.parametrize("where", STARTS)
def test_the_older_chips_search_alike_with_different_state_numbers(where, direction, make):
    start, states = STARTS[where]
    chip = make()
    back = 0x80 if direction > 0 else 0  # step 4 the other way
    table = put_at(chip, start, direction, HM=HM_STEPS | (HM_MINUS if direction < 0 else 0) | back, P=25)
    assert search(chip, table) == [HMST[state] for state in states]
    assert chip._place + chip.net(0) == 400 * direction
    assert word(chip, 3) & 0x180 == 0x180  # HMEND, D-END
    assert word(chip, 2) & 0x80 == 0


@pytest.mark.parametrize("example", range(6))
def test_from_any_start_and_with_any_timer_the_search_finds_the_same_edge(example):
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED + example)
    direction, timer = rng.choice([1, -1]), rng.choice([0, 0x80, 0x180])
    chip = MCX514()
    table = put_at(chip, rng.randint(-1100, 1100), direction, H1M=h1m(direction, S1 | S2), H2M=timer)
    states = search(chip, table)
    assert states[-1] == 20
    assert not set(states) - {3, 6, 11, 15, 18, 20}
    assert chip._place + chip.net(0) == 400 * direction


@both_ways
def test_step_2_against_step_1_finds_the_other_edge(direction):
    chip = MCX514()
    table = put_at(chip, 0, direction, H1M=h1m(direction, S1 | S2) ^ S2_MINUS)
    assert search(chip, table) == [3, 20, 11, 15, 20]
    assert chip._place + chip.net(0) == 440 * direction


@both_ways
def test_the_limit_can_be_the_signal_of_steps_1_and_2(direction):
    chip = MCX514()
    table = put_at(chip, 0, direction, H1M=h1m(direction, S1 | S2, BY_LIMIT | LIMIT_2))
    set_word(chip, 2, ENABLE_LIMITS | ENABLE_STOPS)  # STOP0, STOP1 are passed: their steps do not wait for them
    assert search(chip, table) == [3, 15, 20]
    assert chip._place + chip.net(0) == 1000 * direction
    assert word(chip, 2) == (0x1000 if direction > 0 else 0x2000)  # no error


@both_ways
def test_the_limit_can_be_the_signal_on_the_older_chips(direction):
    chip = MCX304()
    table = put_at(chip, 0, direction, HM=0x0005 | 0x0400 | (HM_MINUS if direction < 0 else 0))
    assert search(chip, table) == [3, 12, 15]
    assert chip._place + chip.net(0) == 1000 * direction


def test_stop1_can_be_the_signal_of_step_1():
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=S1 | BY_STOP1)
    assert search(chip, table) == [3]
    assert 400 < chip.net(0) < 440


def test_a_limit_met_in_step_1_ends_the_step():
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=h1m(1, S1 | S2))
    table["stop0"] = lambda p: False
    assert search(chip, table) == [3, 11, 15, 20]
    assert chip.net(0) == 400


@pytest.mark.parametrize(("decelerating", "overshoot"), [(0, 0), (0x1000, 24)])
def test_a_limit_met_in_step_1_stops_the_axis_as_wr2_says(decelerating, overshoot):
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=S1)
    set_word(chip, 2, ENABLE_LIMITS | decelerating)
    table["stop0"] = lambda p: False
    assert search(chip, table) == [3]
    assert abs(chip.net(0) - 1000 - overshoot) <= 1
    assert word(chip, 2) == 0x1000  # ended by LMT+, no error


@pytest.mark.parametrize("enabled", [0, ENABLE_STOPS])
def test_a_stop_signal_ends_the_step_that_waits_for_it_whatever_its_enable_bit_says(enabled):
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=h1m(1, S1 | S2 | S3))
    set_word(chip, 2, ENABLE_LIMITS | enabled)
    assert search(chip, table) == [3, 20, 28]
    assert chip.net(0) == 425
    assert word(chip, 2) == 0x0800  # ended by STOP2


# Speeds, times


def test_step_1_runs_at_dv_and_step_2_at_hv():
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=h1m(1, S1 | S2))
    command(chip, 0x5A)
    chip.advance(2 * MS)
    assert get(chip, READ["CV"]) == 50_000
    while home_state(chip) != 20:
        go_on(chip, table)
    trace = chip.trace(5 * MS)["clock"]
    assert get(chip, READ["CV"]) == 5_000
    assert set(trace[1:] - trace[:-1]) == {3200}


def test_an_hv_above_sv_is_reached_by_acceleration_and_still_stops_at_once():
    chip = MCX514()
    table = put_at(chip, 250, 1, H1M=S2)
    load(chip, HV=20_000, AC=1_000_000)
    assert search(chip, table) == [20]
    assert chip._place + chip.net(0) == 400
    chip._place -= 350
    press(chip, table)
    command(chip, 0x5A)
    assert page1(chip) & 0x10
    chip.advance(30 * MS)
    assert get(chip, READ["CV"]) == 20_000


@covers("MCX514", "H2M")
@pytest.mark.parametrize("code", range(8))
def test_the_timer_and_the_dcc_pulse_hold_the_next_step_back(code):
    chip = MCX514()
    timer = (1, 2, 10, 20, 100, 200, 500, 1000)[code] * MS
    dcc = (10, 20, 100, 200, 1000, 2000, 10_000, 20_000)[code] * US
    table = put_at(chip, 250, 1, H1M=S2 | 0x80 | S3, H2M=0x80 | code << 8 | code << 4)
    command(chip, 0x5A)
    while home_state(chip) == 20:
        go_on(chip, table)
    assert home_state(chip) == 23
    pins = chip.axes[0].pins
    assert pins.dcc
    stopped = chip.clock
    assert passes(chip, stopped + dcc, lambda c: pins.dcc) == (True, False)
    assert passes(chip, stopped + dcc + timer, home_state) == (23, 28)


def test_no_interpolation_begins_while_an_axis_searches_home_also_in_a_pause_of_it():
    chip = MCX514()
    table = put_at(chip, 250, 1, H1M=S2 | S3, H2M=0x80 | 3 << 8)
    interpolation.load(chip, IPM=3)
    command(chip, 0x5A)
    while home_state(chip) != 23:
        interpolation.line(chip, (50, 30))
        assert not chip.read(0) & 0x02, "Y rests"
        go_on(chip, table)
    pulses = chip.net(0)
    interpolation.line(chip, (50, 30))
    assert passes(chip, chip.clock + 20 * MS, home_state) == (23, 28)
    assert (chip.net(0), chip.net(1)) == (pulses, 0)


def test_a_pin_that_would_begin_a_drive_does_not_in_a_pause_of_a_search():
    chip = MCX514()
    table = put_at(chip, 250, 1, H1M=S2 | S3, H2M=0x80 | 3 << 8, P2M=2 << 7, TP=7)  # EXP+ and EXP- begin fixed drives
    pins = chip.axes[0].pins
    pins.pio4 = pins.pio5 = True
    command(chip, 0x5A)
    while home_state(chip) != 23:
        go_on(chip, table)
    pulses = chip.net(0)
    pins.pio4 = False
    chip.advance(10 * MS)
    assert (home_state(chip), chip.net(0)) == (23, pulses)


def test_dcc_after_step_3_holds_step_4_back():
    chip = MCX514()
    table = put_at(chip, 250, 1, H1M=S3 | 0x1000 | S4, H2M=2 << 4, TP=5)
    command(chip, 0x5A)
    while home_state(chip) == 28:
        go_on(chip, table)
    assert chip.axes[0].pins.dcc
    assert passes(chip, chip.clock + 100 * US, home_state) == (32, 36)


def test_no_timer_runs_after_the_last_step():
    chip = MCX514()
    table = put_at(chip, 420, 1, H1M=S2, H2M=0x80)
    assert search(chip, table) == [15, 18, 20]


def test_counters_are_cleared_where_h1m_and_h2m_say_so():
    for name, bit, counter in [("H1M", 0x0100, "RP"), ("H1M", 0x0200, "LP"), ("H1M", 0x2000, "RP"),
                               ("H1M", 0x4000, "LP"), ("H2M", 0x0002, "RP"), ("H2M", 0x0004, "LP")]:  # fmt: skip
        chip = MCX514()
        table = put_at(chip, 250, 1, LP=-7000, RP=5, TP=20)
        load(chip, H1M=S2 | S3 | S4, H2M=0)
        load(chip, **{name: bit | (S2 | S3 | S4 if name == "H1M" else 0)})
        search(chip, table)
        after = {0x0200: 45, 0x4000: 20}.get(bit, 0) if counter == "LP" else 0
        assert get_signed(chip, READ[counter]) == after, (name, hex(bit))
        other = "RP" if counter == "LP" else "LP"
        assert get_signed(chip, READ[other]) == (5 if other == "RP" else -7000 + 195)


def test_the_older_chips_clear_both_counters_and_put_out_dcc_at_the_end():
    chip = MCX304()
    table = put_at(chip, 250, 1, LP=-7000, EP=5, HM=0x0004 | 0x0100 | 0x0800 | 2 << 13)
    assert search(chip, table) == [15]
    assert (get_signed(chip, 0x10), get_signed(chip, 0x11)) == (0, 0)
    assert chip.axes[0].pins.dcc
    assert passes(chip, chip.clock + 100 * US, lambda c: c.axes[0].pins.dcc) == (True, False)


def test_with_sand_step_3_stops_only_while_stop1_is_active():
    for make, mode, end in [(MCX514, {"H1M": S3, "H2M": 0}, 275), (MCX514, {"H1M": S3, "H2M": 1}, 425),
                            (MCX304, {"HM": 0x0010}, 275), (MCX304, {"HM": 0x0210}, 425)]:  # fmt: skip
        chip = make()
        table = put_at(chip, 250, 1, **mode)
        assert search(chip, table) == [28 if make is MCX514 else 20]
        assert chip._place + chip.net(0) == end


# Ends


def test_stop2_active_at_the_start_of_step_3_is_a_home_error():
    for make, mode, bit in [(MCX514, {"H1M": S3 | S4, "TP": 50}, E_HOME), (MCX304, {"HM": 0x50, "P": 50}, 0x80)]:
        chip = make()
        table = put_at(chip, 225, 1, **mode)
        assert search(chip, table) == []
        assert chip.net(0) == 0
        assert word(chip, 2) & 0xFF == bit
        assert chip.read(0) & 0x11 == 0x10  # n-ERR


def test_a_limit_in_step_3_is_an_error_and_ends_the_search():
    chip = MCX514()
    table = put_at(chip, 800, 1, H1M=S3 | S4, H2M=6, TP=50, LP=1)
    table["stop2"] = lambda p: False
    assert search(chip, table) == [28]
    assert chip._place + chip.net(0) == 1000
    assert word(chip, 2) == 0x1004
    assert get(chip, READ["LP"]) == 201


@pytest.mark.parametrize("where", [3, 6, 20, 23, 28, 36])
@pytest.mark.parametrize("cause", ["56h", "57h", "EMG"])
def test_a_stop_ends_the_search_in_any_step(where, cause):
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=h1m(1), H2M=0x86, TP=5000, LP=1)
    command(chip, 0x5A)
    while home_state(chip) != where:
        go_on(chip, table)
    assert chip.read(0) & 1
    if cause == "EMG":
        chip.set_input_word(chip.AXES, 1)
        chip.advance(1)
    else:
        command(chip, int(cause[:2], 16))
    assert home_state(chip) == 0
    chip.advance(10 * MS)
    assert chip.read(0) & 1 == 0
    observed = word(chip, 1)
    assert observed & H_END
    assert observed & D_END
    assert word(chip, 2) & 0xFF == (E_EMG if cause == "EMG" else 0)
    assert get(chip, READ["LP"]) == 1 + chip.net(0)  # not cleared: it was not found
    assert chip.advance(2000 * MS) == 0


@pytest.mark.parametrize("action", [0x11, 0x12], ids=["decelerating", "instant"])
def test_a_stop_by_a_synchronous_action_ends_the_search(action):
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=h1m(1), S0M=action << 4)
    command(chip, 0x81)
    command(chip, 0x5A)
    for _ in range(8):
        go_on(chip, table)
    command(chip, 0xA1)
    chip.advance(10 * MS)
    assert (chip.read(0) & 1, home_state(chip), word(chip, 2)) == (0, 0, 0x0100)
    assert chip.advance(1000 * MS) == 0


@pytest.mark.parametrize(
    ("wr2", "status", "status_later"),
    [(ENABLE_LIMITS | 0x0200, (0, 0, 0x4010), (0, 0, 0x4010)), (None, (1, 6, 0), (1, 20, 0))],
    ids=["enabled", "not enabled"],
)
def test_an_alarm_between_two_steps_ends_the_search_where_it_is_enabled(wr2, status, status_later):
    chip = MCX514()
    table = put_at(chip, 0, 1, H1M=h1m(1), H2M=0x780)
    if wr2 is not None:
        set_word(chip, 2, wr2)
    command(chip, 0x5A)
    while home_state(chip) != 6:
        go_on(chip, table)
    chip.axes[0].pins.alarm = True
    for clocks, expected in ((1, status), (1000 * MS, status_later)):
        chip.advance(clocks)
        assert (chip.read(0) & 1, home_state(chip), word(chip, 2) & 0xC0FF) == expected


@pytest.mark.parametrize("make", [MCX514, MCX304])
def test_n_drv_is_1_during_the_search_and_its_end_is_one_event(make):
    chip = make()
    mode = {"H1M": h1m(1), "H2M": 0x80, "TP": 30} if make is MCX514 else {"HM": HM_STEPS, "P": 30}
    table = put_at(chip, 0, 1, **mode)
    word(chip, 1 if make is MCX514 else 3)
    command(chip, 0x5A if make is MCX514 else 0x62)
    observed = word(chip, 1 if make is MCX514 else 3)
    if make is MCX514:
        assert observed & D_STA
    d_end, h_end = (D_END, H_END) if make is MCX514 else (0x80, 0x100)
    for _ in range(100_000):
        running = chip.read(0) & 1
        observed = word(chip, 1 if make is MCX514 else 3)
        if make is MCX304:
            assert chip.read(0) >> 8 & 1 == running  # n-HOM
        if not running:
            break
        assert not observed & (d_end | h_end)
        go_on(chip, table)
    assert observed & d_end
    assert observed & h_end


def test_a_search_without_steps_ends_at_once():
    chip = MCX514()
    command(chip, 0x5A)
    assert chip.read(1) == D_STA | D_END | H_END
    assert chip.read(0) & 1 == 0


@pytest.mark.parametrize("code", [0x50, 0x52, 0x54, 0x5A])
def test_drive_commands_do_nothing_during_a_search(code):
    chip, replica = MCX514(), MCX514()
    for one in (chip, replica):
        table = put_at(one, 0, 1, H1M=h1m(1), H2M=0x780, TP=30)
        command(one, 0x5A)
        while home_state(one) != 6:
            go_on(one, table)
    command(chip, code)
    command(replica, 0x1F)
    chip.advance(50 * MS)
    replica.advance(50 * MS)
    assert chip.snapshot() == replica.snapshot()
