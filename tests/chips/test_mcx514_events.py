"""MCX514: timer, split pulse, comparisons of the multi-purpose registers, ports and the DCC output, clock by clock."""

import random

import pytest
from support.covers import covers
from support.nova_bench import SEED, X, Y, command, get, get_signed, put
from support.nova_hands import (
    CMR0,
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
    pulses,
    set_word,
    word,
)

from stage.chips import MCX514

REPEAT = 0x4000  # TMMD of WR3
LP, RP, CV, CT = range(4)
AT_LEAST, ABOVE, EQUAL, BELOW = range(4)
HOLDS = (int.__ge__, int.__gt__, int.__eq__, int.__lt__)


def rr1(chip):
    return chip.read(1)


def interrupts(chip):
    """Return the pins INT0N and INT1N of the chip."""
    return chip.output_word(chip.AXES)


def generator(n=0):
    print("PULSESTAGE_SEED", SEED)
    return random.Random(SEED + n)


# The timer


@covers("MCX514", "TMSTA", "TM", "CT")
def test_the_timer_is_up_after_tm_microseconds_and_then_reads_0():
    chip = MCX514()
    load(chip, TM=1000)
    command(chip, 0x73)
    assert page1(chip) & 0x400
    assert passes(chip, 1000 * US, rr1) == (0, TIMER)
    assert not page1(chip) & 0x400
    assert get(chip, READ["CT"]) == 0
    chip.advance(10 * MS)
    assert rr1(chip) == 0


def test_ct_counts_microseconds_from_the_start():
    chip = MCX514()
    load(chip, TM=50)
    chip.advance(777)
    command(chip, 0x73)
    observed = []
    for _ in range(50 * US):
        observed.append(get(chip, READ["CT"]))
        chip.advance(1)
    assert observed == [clock // US for clock in range(50 * US)]


@covers("MCX514", "TMSTA", "TMSTP")
def test_74h_stops_the_timer_without_an_event():
    chip = MCX514()
    load(chip, TM=100)
    command(chip, 0x73)
    chip.advance(100 * US - 1)
    command(chip, 0x74)
    chip.advance(MS)
    assert (rr1(chip), get(chip, READ["CT"]), page1(chip) & 0x400) == (0, 0, 0)


def test_73h_restarts_a_timer_that_runs():
    chip = MCX514()
    load(chip, TM=100)
    command(chip, 0x73)
    chip.advance(99 * US)
    command(chip, 0x73)
    assert passes(chip, 199 * US, rr1) == (0, TIMER)


def test_a_repeat_timer_is_up_every_tm_over_a_million_clocks_without_drift():
    chip = MCX514()
    set_word(chip, 3, REPEAT)
    load(chip, TM=37, IV=1, DV=1, S0M=0x8000 | 0x13 << 4 | 2)  # at every timer up: the speed rises by 1
    command(chip, 0x81)
    command(chip, 0x73)
    chip.advance(1_000_000)
    assert get(chip, READ["DV"]) == 1 + 1_000_000 // (37 * US)
    rr1(chip)
    for k in range(1_000_000 // (37 * US) + 1, 2000):
        assert passes(chip, k * 37 * US, rr1) == (0, TIMER | SYNC0)


def test_a_new_tm_acts_from_the_next_timing_on():
    chip = MCX514()
    set_word(chip, 3, REPEAT)
    load(chip, TM=100)
    command(chip, 0x73)
    chip.advance(MS // 100)
    load(chip, TM=30)
    assert passes(chip, 100 * US, rr1) == (0, TIMER)
    assert passes(chip, 130 * US, rr1) == (0, TIMER)


def test_every_axis_has_its_timer():
    chip = MCX514()
    load(chip, X, TM=10)
    load(chip, Y, TM=20)
    command(chip, 0x73, X | Y)
    chip.advance(10 * US)
    assert (word(chip, 1, X), word(chip, 1, Y)) == (TIMER, 0)
    chip.advance(10 * US)
    assert (word(chip, 1, X), word(chip, 1, Y)) == (0, TIMER)


# The split pulse


def is_on(k, cycle, width, count):
    """The output after the k-th drive pulse since the start: k = 1 begins the first split pulse."""
    turn, phase = divmod(k - 1, cycle)
    return k > 0 and phase < width and (count == 0 or turn < count)


@covers("MCX514", "SP1", "SP2", "SPSTA")
@pytest.mark.parametrize("example", range(8))
def test_split_pulses_are_counted_in_drive_pulses_from_the_next_one_on(example):
    rng = generator(example)
    cycle = rng.randint(2, 9)
    width, count = rng.randint(1, cycle - 1), rng.choice([0, 1, 2, 5])
    chip = MCX514()
    load(chip, SP1=width << 16 | cycle, SP2=count)
    cruise(chip, rng.choice([1_000_000, 300_007, 8_000_000]), minus=rng.random() < 0.5)
    chip.advance(rng.randint(0, 3000))
    rr1(chip)
    command(chip, 0x75)
    assert not chip.axes[0].pins.split
    split_pulses = ends = 0
    for k, clock in enumerate(pulses(chip, 4000)[:70], 1):
        on, was = is_on(k, cycle, width, count), is_on(k - 1, cycle, width, count)
        split_pulses += on and not was
        over = was and not on and split_pulses == count
        ends += over
        if clock - 1 > chip.clock:
            chip.advance(clock - 1 - chip.clock)
            assert chip.axes[0].pins.split == was
        chip.advance(clock - chip.clock)
        assert chip.axes[0].pins.split == on, f"pulse {k}"
        assert rr1(chip) & (SPLTP | SPLTE) == (SPLTP if on and not was else 0) | (SPLTE if over else 0)
        assert bool(page1(chip) & 0x800) == (not ends)
    assert split_pulses == count or count == 0


@covers("MCX514", "SPSTP")
def test_76h_ends_the_split_pulse_at_once():
    chip = MCX514()
    load(chip, SP1=8 << 16 | 10)
    command(chip, 0x75)
    cruise(chip)
    chip.advance(3 * US)
    assert chip.axes[0].pins.split
    rr1(chip)
    command(chip, 0x76)
    assert not chip.axes[0].pins.split
    assert rr1(chip) & SPLTE
    assert not page1(chip) & 0x800
    chip.advance(MS)
    assert not rr1(chip) & SPLTP


def test_new_cycle_and_width_act_from_the_next_split_pulse_on():
    chip = MCX514()
    load(chip, SP1=2 << 16 | 6)
    command(chip, 0x75)
    cruise(chip)
    shape = []
    for k in range(20):
        if k == 1:
            load(chip, SP1=1 << 16 | 3)
        chip.advance(US)
        shape.append(int(chip.axes[0].pins.split))
    assert shape == [1, 1, 0, 0, 0, 0] + [1, 0, 0] * 4 + [1, 0]


@covers("MCX514", "SP1", "SP2", "SPSTA")
@pytest.mark.parametrize("after", [1, 2, 4], ids=["at its first pulse", "while it is on", "while it is off"])
def test_75h_while_split_pulses_run_restarts_them_at_the_next_drive_pulse(after):
    """The output goes off at once; width, cycle and count begin again. SPLTE comes at the end of the count, not before."""
    chip = MCX514()
    load(chip, SP1=3 << 16 | 5, SP2=2)
    command(chip, 0x75)
    cruise(chip)
    for _ in range(after):
        chip.advance(US)
    assert chip.axes[0].pins.split == (after < 4)
    rr1(chip)
    command(chip, 0x75)
    assert not chip.axes[0].pins.split, "off until the next drive pulse"
    shape = []
    for k in range(11):
        assert bool(rr1(chip) & SPLTE) == (k == 9), "after the ninth drive pulse the second split pulse is over"
        chip.advance(US)
        shape.append(int(chip.axes[0].pins.split))
    assert shape == [1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 0]


@pytest.mark.parametrize("width", [3, 4, 9])
def test_a_width_of_the_full_cycle_or_more_still_leaves_the_output_off_for_a_pulse(width):
    chip = MCX514()
    load(chip, SP1=width << 16 | 4)
    command(chip, 0x75)
    cruise(chip)
    shape = []
    for _ in range(12):
        chip.advance(US)
        shape.append(int(chip.axes[0].pins.split))
    assert shape == [1, 1, 1, 0] * 3


def test_split_pulses_continue_over_the_next_drive():
    chip = MCX514()
    load(chip, SP1=4 << 16 | 6, SP2=1, SV=1_000_000, DV=1_000_000, TP=3)
    command(chip, 0x75)
    command(chip, 0x50)
    chip.advance(MS)
    assert chip.axes[0].pins.split
    command(chip, 0x50)
    chip.advance(2 * US - 1)
    assert (chip.net(0), chip.axes[0].pins.split) == (4, True)
    chip.advance(1)
    assert (chip.net(0), chip.axes[0].pins.split) == (5, False)


# Comparisons


def mrm(*pairs):
    """The mode word of (object, condition) for MR0 on."""
    return sum((what | condition << 2) << 4 * m for m, (what, condition) in enumerate(pairs))


@covers("MCX514", "MRM", "MR0", "MR1", "MR2", "MR3", "R-MR0", "R-MR1", "R-MR2", "R-MR3", "R-LP")
@pytest.mark.parametrize("example", range(8))
def test_a_comparison_with_lp_is_an_event_at_the_clock_of_its_pulse(example):
    """Against the counter recomputed from the trace, one pulse after the other."""
    rng = generator(100 + example)
    chip = MCX514()
    minus = rng.random() < 0.5
    begin = rng.choice([0, 100, -100, (1 << 31) - 20, -(1 << 31) + 20])
    ring_length = rng.choice([0xFFFFFFFF, 0xFFFFFFFF, 30])
    conditions = rng.sample(range(4), 4)
    levels = [rng.randint(0, 30) if ring_length == 30 else begin + rng.randint(-40, 40) for _ in range(4)]
    load(chip, LX=ring_length, LP=0 if ring_length == 30 else begin)
    load(chip, **{f"MR{m}": level for m, level in enumerate(levels)}, MRM=mrm(*((LP, k) for k in conditions)))
    cruise(chip, 1_000_003, minus=minus)
    rr1(chip)
    counter = get_signed(chip, READ["LP"])
    levels = [get_signed(chip, READ[f"MR{m}"]) for m in range(4)]
    previous = [HOLDS[k](counter, level) for k, level in zip(conditions, levels, strict=True)]
    for clock in pulses(chip, 100 * US):
        counter += -1 if minus else 1
        counter = counter % 31 if ring_length == 30 else (counter + (1 << 31)) % (1 << 32) - (1 << 31)
        now = [HOLDS[k](counter, level) for k, level in zip(conditions, levels, strict=True)]
        due = sum(CMR0 << m for m in range(4) if now[m] and not previous[m])
        if clock - 1 > chip.clock:
            assert passes(chip, clock, lambda c: rr1(c) & 0xF) == (0, due), (counter, levels, conditions)
        else:
            chip.advance(1)
            assert rr1(chip) & 0xF == due
        previous = now


def test_a_comparison_with_rp_follows_the_encoder():
    chip = MCX514()
    load(chip, MR0=3, MRM=mrm((RP, AT_LEAST)))
    rr1(chip)
    pins, observed = chip.axes[0].pins, []
    for a, b in [(1, 0), (1, 1), (0, 1), (0, 0)]:
        pins.eca, pins.ecb = bool(a), bool(b)
        chip.advance(10)
        observed.append((get_signed(chip, READ["RP"]), rr1(chip)))
    assert observed == [(1, 0), (2, 0), (3, CMR0), (4, 0)]


@pytest.mark.parametrize("s_curve", [False, True], ids=["linear", "S-curve"])
def test_a_comparison_with_the_speed_is_an_event_at_the_clock_at_which_cv_passes(s_curve):
    """Against CV, read at every clock from a chip beside it."""
    rng = generator(200 + s_curve)
    base, gain, clocks = (100_000, 100, 25_000) if s_curve else (50_000, 60_000, 9_000)
    levels = [base + rng.randint(gain // 10, gain // 2) for _ in range(4)]
    if not s_curve:
        levels[2] = 0  # it goes in steps of 33 pps: only at rest can a speed be met
    reader, chip = MCX514(), MCX514()
    for one in (reader, chip):
        set_word(one, 3, 0x0004 if s_curve else 0)
        load(one, SV=base, DV=base + gain, AC=536_870_911, JK=0x3FFFFFFF, TP=130 if s_curve else 40)
        load(one, **{f"MR{m}": level for m, level in enumerate(levels)})
        load(one, MRM=mrm((CV, AT_LEAST), (CV, ABOVE), (CV, EQUAL), (CV, BELOW)))
        command(one, 0x50)
        rr1(one)
    due, previous = {}, [True] * 4
    for clock in range(clocks):
        speed = get(reader, READ["CV"])
        now = [HOLDS[m](speed, levels[m]) for m in range(4)]
        if events := sum(CMR0 << m for m in range(4) if now[m] and not previous[m]):
            due[clock] = events
        previous = now
        reader.advance(1)
    assert sum(events.bit_count() for events in due.values()) >= 4
    for clock, events in due.items():
        assert passes(chip, clock, lambda c: rr1(c) & 0xF) == (0, events)
    chip.advance(clocks - chip.clock)
    assert rr1(chip) & 0xF == 0


def test_a_comparison_with_the_timer_is_an_event_at_its_microsecond():
    chip = MCX514()
    load(chip, TM=100, MR0=20, MR1=20, MR2=20, MR3=20)
    load(chip, MRM=mrm((CT, AT_LEAST), (CT, ABOVE), (CT, EQUAL), (CT, BELOW)))
    rr1(chip)
    chip.advance(5)
    command(chip, 0x73)
    assert passes(chip, 5 + 20 * US, rr1) == (0, CMR0 | CMR0 << 2)
    assert passes(chip, 5 + 21 * US, rr1) == (0, CMR0 << 1)
    assert passes(chip, 5 + 100 * US, rr1) == (0, TIMER | CMR0 << 3)


def test_a_write_that_makes_a_comparison_true_is_one_event():
    chip = MCX514()
    load(chip, MR0=10)
    assert rr1(chip) == 0
    load(chip, LP=10)
    assert rr1(chip) == CMR0
    load(chip, LP=11)
    assert rr1(chip) == 0


def test_a_reset_causes_no_events():
    chip = MCX514()
    assert [word(chip, 1, 1 << j) for j in range(4)] == [0] * 4


def test_an_event_causes_an_interrupt_only_if_wr1_enables_it():
    for enabled in (0, TIMER):
        chip = MCX514()
        set_word(chip, 1, enabled)
        load(chip, TM=1)
        command(chip, 0x73)
        assert interrupts(chip) == 0
        chip.advance(US)
        assert interrupts(chip) == (1 if enabled else 0)


# Ports


def ports(chip):
    """Return the pins PIO7 to PIO0 of X."""
    return chip.read(4) & 0xFF


@covers("MCX514", "P1M", "R-P1M")
def test_a_general_output_shows_its_bit_of_wr4_and_a_general_input_its_pin():
    chip = MCX514()
    load(chip, P1M=0x5500)  # PIO4 to PIO7 outputs
    assert get(chip, 0x41) == 0x5500
    chip.write(4, 0xA5A5)
    assert ports(chip) == 0xA0
    chip.axes[0].pins.pio0 = chip.axes[0].pins.pio7 = True
    assert ports(chip) == 0xA1
    assert [getattr(chip.axes[0].pins, f"out{i}") for i in range(8)] == [False] * 5 + [True, False, True]


@pytest.mark.parametrize("axis", range(4), ids="XYZU")
def test_wr4_and_wr5_hold_the_outputs_of_all_axes_and_rr4_and_rr5_their_levels(axis):
    chip = MCX514()
    load(chip, 1 << axis, P1M=0x5555)
    chip.write(4, 0x3412)
    chip.write(5, 0x7856)
    expected = [0, 0, 0, 0]
    expected[axis] = (0x12, 0x34, 0x56, 0x78)[axis]
    assert (chip.read(4), chip.read(5)) == (expected[0] | expected[1] << 8, expected[2] | expected[3] << 8)


def test_the_drive_status_outputs_show_drive_error_and_ramps():
    chip = MCX514()
    load(chip, P1M=0xAAAA, SV=1000, DV=9000, AC=1_000_000, TP=300)
    assert ports(chip) == 0
    command(chip, 0x50)
    assert ports(chip) == 0x01 | 0x04 | 0x40  # DRIVE, ASND, ACNST
    chip.advance(10 * MS)
    assert ports(chip) == 0x01 | 0x08  # CNST
    chip.advance(1000 * MS)
    assert ports(chip) == 0
    chip.axes[0].pins.lmt_plus = True
    set_word(chip, 2, 0x0800)
    command(chip, 0x50)
    assert ports(chip) == 0x02  # ERROR


def test_pio4_to_pio7_can_show_the_comparisons():
    chip = MCX514()
    load(chip, P1M=0xFF00, MR0=5, MR1=5, MR2=5, MR3=5)
    load(chip, MRM=mrm((LP, AT_LEAST), (LP, ABOVE), (LP, EQUAL), (LP, BELOW)))
    assert ports(chip) == 0x80
    load(chip, LP=5)
    assert ports(chip) == 0x50
    load(chip, LP=6)
    assert ports(chip) == 0x30


def test_inputs_are_read_before_their_filter_and_act_after_it():
    chip = MCX514()
    load(chip, FLM=0x0010, S0M=5 << 4 | 0xA)  # FE4, 8 clocks; PIO0 rises: LP -> MR0
    command(chip, 0x81)
    load(chip, LP=77)
    chip.axes[0].pins.pio0 = True
    chip.advance(7)
    assert (ports(chip), get(chip, READ["MR0"])) == (1, 0)
    chip.advance(1)
    assert get(chip, READ["MR0"]) == 77


@covers("MCX514", "DCC", "H2M")
@pytest.mark.parametrize("code", range(8))
def test_72h_puts_out_a_dcc_pulse_as_long_as_h2m_says(code):
    chip = MCX514()
    clocks = (10, 20, 100, 200, 1000, 2000, 10_000, 20_000)[code] * US
    put(chip, 0x24, code << 4)
    chip.advance(3)
    assert not chip.axes[0].pins.dcc
    command(chip, 0x72)
    assert chip.axes[0].pins.dcc
    assert passes(chip, 3 + clocks, lambda c: c.axes[0].pins.dcc) == (True, False)


def test_a_timer_of_0_which_is_no_value_takes_as_long_as_one_of_1():
    chip = MCX514()
    load(chip, TM=0)
    chip.advance(777)
    command(chip, 0x73)
    assert page1(chip) & 0x400
    assert passes(chip, 777 + 1 * US, rr1) == (0, TIMER)
    assert not page1(chip) & 0x400
