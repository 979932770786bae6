"""MCX514: the synchronous actions. An action happens at the clock of its factor, to the clock, on this axis or another."""

import copy
import random

import pytest
from support.covers import covers
from support.nova_bench import SEED, U, X, Y, Z, command, get, get_signed
from support.nova_hands import (
    C_END,
    C_STA,
    CMR0,
    D_END,
    D_STA,
    MS,
    READ,
    SPLTE,
    SPLTP,
    SYNC0,
    TIMER,
    US,
    cruise,
    load,
    page1,
    passes,
    set_word,
    word,
)

from stage.chips import MCX514

EVERY = 0x8000  # REP
COMPARISON, TIMER_UP, DRIVE_START, CONSTANT, CONSTANT_END, DRIVE_END, SPLIT_START, SPLIT_END, SPLIT_PULSE = range(1, 10)
RISES, FALLS, RISES_LOW, RISES_HIGH, FALLS_LOW, FALLS_HIGH = range(0xA, 0x10)
(TO_DV, TO_TP, TO_SP1, TO_OWN, FROM_LP, FROM_RP, FROM_CT, FROM_OWN, PULSE, RELATIVE, COUNTER_RELATIVE, ABSOLUTE, PLUS, MINUS,
 RELATIVE_BY, ABSOLUTE_TO, SLOW_STOP, STOP, FASTER, SLOWER, TIMER_START, TIMER_STOP, SPLIT_ON, SPLIT_OFF) = (
    range(1, 25))  # fmt: skip
RUNS_TIMER, RUNS_SPLIT = 0x400, 0x800  # RR3 page 1


def mode(factor=0, action=0, same_axis=0, others=0, every=False):
    """SmM. own: bit k - 1 for set m + k; others: bit k - 1 for SYNC0 of axis + k."""
    return factor | action << 4 | same_axis << 9 | others << 12 | (EVERY if every else 0)


def arm(chip, axes=X, m=0, **what):
    """Write a set and enable it."""
    load(chip, axes, **{f"S{m}M": mode(**what)})
    command(chip, 0x80 | 1 << m, axes)


def activate(chip, axes=X, m=0):
    command(chip, 0xA0 | 1 << m, axes)


def acted(chip, m=0, axes=X):
    """Read SYNCm of RR1, which clears it."""
    return bool(word(chip, 1, axes) & SYNC0 << m)


# Factors


@pytest.mark.parametrize(
    ("factor", "event"),
    [(DRIVE_START, D_STA), (CONSTANT, C_STA), (CONSTANT_END, C_END), (DRIVE_END, D_END), (SPLIT_END, SPLTE),
     (SPLIT_PULSE, SPLTP), (COMPARISON, CMR0), (TIMER_UP, TIMER)],
)  # fmt: skip
def test_a_set_acts_at_the_clock_of_the_event_that_is_its_factor(factor, event):
    chip = MCX514()
    load(chip, SV=100_000, DV=500_000, AC=400_000_000, TP=600, SP1=1 << 16 | 3, SP2=2, MR0=300, TM=200)
    arm(chip, factor=factor, action=FROM_LP)
    chip.advance(9)
    for code in (0x73, 0x75, 0x50):
        command(chip, code)
    observed = chip.read(1)
    while not observed & event and chip.clock < 5 * MS:
        assert not observed & SYNC0
        chip.advance(1)
        observed = chip.read(1)
    assert observed & event
    assert observed & SYNC0
    assert get(chip, READ["MR0"]) == get(chip, READ["LP"])


def test_a_set_acts_at_the_start_of_the_split_pulse():
    chip = MCX514()
    arm(chip, factor=SPLIT_START)
    command(chip, 0x75)
    assert acted(chip)


@pytest.mark.parametrize(
    ("factor", "begin", "end", "neighbor", "acts"),
    [
        (RISES, 0, 1, 0, True), (RISES, 0, 1, 1, True), (RISES, 1, 0, 0, False), (FALLS, 1, 0, 0, True),
        (FALLS, 1, 0, 1, True), (FALLS, 0, 1, 0, False), (RISES_LOW, 0, 1, 0, True), (RISES_LOW, 0, 1, 1, False),
        (RISES_HIGH, 0, 1, 0, False), (RISES_HIGH, 0, 1, 1, True), (FALLS_LOW, 1, 0, 0, True),
        (FALLS_LOW, 1, 0, 1, False), (FALLS_HIGH, 1, 0, 1, True), (FALLS_HIGH, 1, 0, 0, False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("m", range(4))
def test_a_set_acts_at_the_edge_of_its_input_with_the_level_of_the_paired_input(m, factor, begin, end, neighbor, acts):
    chip = MCX514()
    pins = chip.axes[0].pins
    setattr(pins, f"pio{m}", bool(begin))
    setattr(pins, f"pio{m + 4}", bool(neighbor))
    chip.advance(10)
    arm(chip, m=m, factor=factor)
    assert not acted(chip, m)
    setattr(pins, f"pio{m}", bool(end))
    chip.advance(1)
    assert acted(chip, m) == acts


@pytest.mark.parametrize("minus", [False, True], ids=["+", "-"])
def test_lp_is_captured_at_the_clock_of_a_pio_edge(minus):
    chip = MCX514()
    arm(chip, m=2, factor=RISES, action=FROM_LP)
    cruise(chip, 333_333, minus=minus)
    chip.advance(7777)
    chip.axes[0].pins.pio2 = True
    neighbor = copy.copy(chip)
    chip.advance(100_000)
    assert get_signed(chip, READ["MR2"]) == get_signed(neighbor, READ["LP"]) == chip_counts(7777, minus)
    chip.axes[0].pins.pio2 = False
    chip.advance(10)
    chip.axes[0].pins.pio2 = True
    chip.advance(10)
    assert get_signed(chip, READ["MR2"]) == chip_counts(7777, minus)  # once


def chip_counts(clock, minus):
    """Pulses that 333,333 pps make."""
    return clock * 333_333 // 16_000_000 * (-1 if minus else 1)


def test_a_factor_of_0_never_acts_by_itself():
    chip = MCX514()
    for m in range(4):
        arm(chip, m=m)
    load(chip, TM=1)
    command(chip, 0x73)
    cruise(chip)
    chip.axes[0].pins.pio0 = True
    chip.advance(MS)
    assert word(chip, 1) & 0xF000 == 0


# Actions


@covers("MCX514", "SYNCEN", "SYNCACT", "S0M", "S1M", "S2M", "S3M")
@pytest.mark.parametrize(("action", "name"), [(TO_DV, "DV"), (TO_TP, "TP"), (TO_SP1, "SP1"), (TO_OWN, None)])
def test_a_register_is_loaded_from_the_mr_of_the_set(action, name):
    chip = MCX514()
    for m in range(4):
        load(chip, **{f"MR{m}": 0x10004 + m})
        arm(chip, m=m, action=action)
        activate(chip, m=m)
        assert get(chip, READ[name or ("LP", "RP", "SV", "AC")[m]]) == 0x10004 + m


@pytest.mark.parametrize(("m", "name"), [(0, "LP"), (1, "RP")])
def test_a_position_that_is_loaded_from_the_mr_of_the_set_keeps_its_sign(m, name):
    """MR1 = -1000, SYNC1 takes it to RP: RP < MR3 = 0 becomes true"""
    chip, below = MCX514(), 3
    load(chip, **{f"MR{m}": -1000, "MR3": 0, "MRM": (m | below << 2) << 12})
    word(chip, 1)
    arm(chip, m=m, action=TO_OWN)
    activate(chip, m=m)
    assert word(chip, 1) & CMR0 << 3
    assert get_signed(chip, READ[name]) == -1000


@pytest.mark.parametrize("m", range(4))
@pytest.mark.parametrize(("action", "name"), [(FROM_LP, "LP"), (FROM_RP, "RP"), (FROM_CT, "CT"), (FROM_OWN, None)])
def test_the_mr_of_the_set_takes_what_the_action_says(action, name, m):
    chip = MCX514()
    load(chip, LP=-5, RP=123, TM=1000, SV=100, DV=20_000, AC=777)
    command(chip, 0x73)
    command(chip, 0x52)
    chip.advance(300 * US)
    arm(chip, m=m, action=action)
    activate(chip, m=m)
    name = name or ("CV", "CA", None, None)[m]
    assert get(chip, READ[f"MR{m}"]) == (get(chip, READ[name]) if name else 0)
    assert name is None or get(chip, READ[name]) != 0


@pytest.mark.parametrize("m", range(4))
def test_a_sync_pulse_on_pio_m_lasts_two_clocks(m):
    chip = MCX514()
    load(chip, P1M=0x00FF)
    arm(chip, m=m, action=PULSE)
    activate(chip, m=m)
    assert chip.read(4) == 1 << m
    assert getattr(chip.axes[0].pins, f"out{m}")
    chip.advance(1)
    assert chip.read(4) == 1 << m
    chip.advance(1)
    assert chip.read(4) == 0


@pytest.mark.parametrize(
    ("action", "moved"),
    [(RELATIVE, 30), (COUNTER_RELATIVE, -30), (ABSOLUTE, 130), (RELATIVE_BY, -7), (ABSOLUTE_TO, 93)],
)
def test_a_drive_by_an_action_begins_at_the_clock_of_the_factor(action, moved):
    chip = MCX514()
    load(chip, SV=1_000_000, DV=1_000_000, LP=-100, TP=30, MR1=-7, TM=5)
    arm(chip, m=1, factor=TIMER_UP, action=action)
    command(chip, 0x73)
    assert passes(chip, 5 * US, lambda c: c.read(0) & 1) == (0, 1)
    assert passes(chip, 6 * US, lambda c: c.net(0)) == (0, 1 if moved > 0 else -1)
    chip.advance(MS)
    assert chip.net(0) == moved
    assert chip.read(0) & 1 == 0


@pytest.mark.parametrize(("action", "direction"), [(PLUS, 1), (MINUS, -1)])
def test_sets_can_start_and_stop_a_continuous_drive(action, direction):
    chip = MCX514()
    load(chip, SV=1_000_000, DV=1_000_000, TM=100)
    arm(chip, m=0, factor=TIMER_UP, action=action)
    command(chip, 0x73)
    chip.advance(200 * US)
    assert (chip.net(0), chip.read(0) & 1) == (100 * direction, 1)
    arm(chip, m=1, factor=TIMER_UP, action=STOP)
    command(chip, 0x73)
    chip.advance(MS)
    assert (chip.net(0), chip.read(0) & 1) == (200 * direction, 0)
    assert word(chip, 2) == 0x0100  # SYNC


def test_a_decelerating_stop_by_a_set_is_a_finishing_status_too():
    chip = MCX514()
    load(chip, SV=1000, DV=10_000, AC=1_000_000, TP=1000, MR0=500)
    arm(chip, factor=COMPARISON, action=SLOW_STOP)
    load(chip, LP=0)
    command(chip, 0x50)
    chip.advance(1000 * MS)
    assert 500 < chip.net(0) < 560
    assert word(chip, 2) == 0x0100


@pytest.mark.parametrize(("action", "speed"), [(FASTER, 1500), (SLOWER, 500)])
def test_the_speed_is_stepped_by_iv(action, speed):
    chip = MCX514()
    load(chip, DV=1000, IV=500)
    arm(chip, action=action)
    activate(chip)
    assert get(chip, READ["DV"]) == speed


@pytest.mark.parametrize(
    ("on", "off", "bit"), [(TIMER_START, TIMER_STOP, RUNS_TIMER), (SPLIT_ON, SPLIT_OFF, RUNS_SPLIT)]
)
def test_timer_and_split_pulse_can_be_started_and_stopped_by_sets(on, off, bit):
    chip = MCX514()
    load(chip, TM=1000)
    arm(chip, m=0, action=on)
    arm(chip, m=1, action=off)
    activate(chip, m=0)
    assert page1(chip) & bit
    activate(chip, m=1)
    assert not page1(chip) & bit


# Sets


@covers("MCX514", "SYNCDIS")
def test_only_an_enabled_set_acts_and_rr3_shows_which_are():
    chip = MCX514()
    load(chip, IV=1, DV=10, TM=1, **{f"S{m}M": mode(TIMER_UP, FASTER, every=True) for m in range(4)})
    command(chip, 0x8F)
    command(chip, 0x95)
    assert page1(chip) & 0xF == 0b1010
    command(chip, 0x73)
    chip.advance(MS)
    assert get(chip, READ["DV"]) == 12
    assert word(chip, 1) & 0xF000 == 0b1010 << 12


def test_a_set_without_repeat_disables_itself_by_acting():
    chip = MCX514()
    load(chip, IV=1, DV=10)
    arm(chip, action=FASTER)
    activate(chip)
    assert page1(chip) & 0xF == 0
    activate(chip)
    assert get(chip, READ["DV"]) == 11
    arm(chip, action=FASTER, every=True)
    for _ in range(5):
        activate(chip)
    assert get(chip, READ["DV"]) == 16
    assert page1(chip) & 0xF == 1


def test_what_happened_before_a_set_was_enabled_does_not_make_it_act():
    chip = MCX514()
    load(chip, SV=1000, DV=1000, TP=0)
    command(chip, 0x50)
    activate(chip)
    arm(chip, factor=DRIVE_END)
    chip.advance(MS)
    assert not acted(chip)


@pytest.mark.parametrize("m", range(4))
@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_set_takes_another_of_its_axis_along(m, k):
    chip = MCX514()
    arm(chip, m=m, same_axis=1 << k - 1)
    arm(chip, m=(m + k) % 4, action=FROM_LP)
    load(chip, LP=5)
    activate(chip, m=m)
    assert get(chip, READ[f"MR{(m + k) % 4}"]) == 5
    assert word(chip, 1) & 0xF000 == (1 << m | 1 << (m + k) % 4) << 12


@pytest.mark.parametrize("axis", range(4), ids="XYZU")
@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_set_takes_sync0_of_another_axis_along(axis, k):
    chip = MCX514()
    other = 1 << (axis + k) % 4
    arm(chip, 1 << axis, m=3, others=1 << k - 1)
    arm(chip, other, action=FROM_LP)
    load(chip, other, LP=5)
    activate(chip, 1 << axis, m=3)
    assert get(chip, READ["MR0"], other) == 5
    assert [acted(chip, 0, 1 << a) for a in range(4)] == [1 << a == other for a in range(4)]


def test_two_axes_start_at_the_same_clock_where_a_third_passes_a_position():
    chip = MCX514()
    load(chip, X | Y, SV=1_000_000, DV=1_000_000, TP=10)
    arm(chip, X, action=RELATIVE, others=1)
    arm(chip, Y, action=RELATIVE)
    load(chip, U, MR1=100)
    load(chip, U, S1M=mode(COMPARISON, others=1), MRM=0)
    command(chip, 0x82, U)
    cruise(chip, 123_457, axes=U)
    trace = chip.trace(20 * MS)
    at = {axis: trace["clock"][trace["axis"] == axis].tolist() for axis in range(4)}
    assert len(at[0]) == 10
    assert at[0] == at[1] == [at[3][99] + 16 * k for k in range(1, 11)]
    assert at[2] == []


def test_sets_that_activate_each_other_act_once_at_a_clock():
    chip = MCX514()
    load(chip, X | Y | Z | U, IV=1, DV=1, TP=0, **{f"S{m}M": mode(DRIVE_END, FASTER, 7, 7, True) for m in range(4)})
    command(chip, 0x8F, X | Y | Z | U)
    activate(chip)
    chip.advance(MS)
    assert [get(chip, READ["DV"], 1 << a) for a in range(4)] == [5, 5, 5, 5]
    load(chip, S0M=mode(DRIVE_END, RELATIVE, every=True))
    command(chip, 0x50)
    chip.advance(MS)
    assert chip.read(0) & 0xF == 0


def busy():
    """Make a chip on which all functions of this file are active at once."""
    chip = MCX514()
    set_word(chip, 3, 0x4000, X | Y)
    load(chip, X | Y, SV=1000, DV=300_000, AC=50_000_000, TP=500, TM=61, SP1=2 << 16 | 5, IV=777, P1M=0xFF00)
    load(chip, MR0=40, MR1=200_000, MR2=30, MR3=250_000, MRM=0x2 << 4 | 0x3 << 8 | 0xE << 12)
    arm(chip, m=0, factor=COMPARISON, action=SPLIT_ON, others=1)
    arm(chip, m=1, factor=COMPARISON, action=FROM_CT, same_axis=2, every=True)
    arm(chip, m=3, factor=TIMER_UP, action=SLOWER, every=True)
    arm(chip, Y, m=0, factor=TIMER_UP, action=RELATIVE, every=True)
    arm(chip, Y, m=1, factor=SPLIT_PULSE, action=FASTER, every=True)
    for code in (0x73, 0x50):
        command(chip, code)
    command(chip, 0x75, Y)
    return chip


@pytest.mark.parametrize("example", range(10))
def test_a_run_cut_anywhere_is_the_same_run(example):
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED + example)
    uncut, cut = busy(), busy()
    clocks = rng.randint(20_000, 200_000)
    start_clock = uncut.advance(clocks)
    assert start_clock > 0
    left, pulses = clocks, 0
    while left:
        n = min(left, rng.choice([1, 2, rng.randint(1, 100), rng.randint(1, 30_000)]))
        pulses += cut.advance(n) if rng.random() < 0.7 else len(cut.trace(n))
        if rng.random() < 0.2:
            cut = copy.copy(cut)
        left -= n
    assert pulses == start_clock
    assert cut.snapshot() == uncut.snapshot()
