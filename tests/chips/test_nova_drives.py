"""Drives of the NOVA chips: what starts them, what stops them, what counts them; by the pages of the MCX514 and the MCX304."""

import itertools

import numpy as np
import pytest
from support.covers import covers
from support.examples import SEED
from support.nova_bench import (
    NOP_304,
    NOP_514,
    X,
    Y,
    Z,
    command,
    driving,
    get,
    get_signed,
    load,
    load_304,
    put,
    set_wr3,
)

from stage import StageError
from stage.chips import MCX302, MCX304, MCX312, MCX514

SECOND = 16_000_000
RR2 = {"SLMT+": 1, "SLMT-": 2, "HLMT+": 4, "HLMT-": 8, "ALARM": 16, "EMG": 32}
END = {
    "STOP0": 1 << 9,
    "STOP1": 1 << 10,
    "STOP2": 1 << 11,
    "LMT+": 1 << 12,
    "LMT-": 1 << 13,
    "ALARM": 1 << 14,
    "EMG": 1 << 15,
}
D_STA, C_STA, C_END, D_END = 0x10, 0x20, 0x40, 0x80
REL, CREL, PLUS, MINUS, ABS, SLOW, STOP = 0x50, 0x51, 0x52, 0x53, 0x54, 0x56, 0x57


@pytest.fixture
def chip():
    """An MCX514 with ramps of a tenth of a second between 1000 and 11000 pps on X, Y and Z."""
    chip = MCX514()
    load(chip, X | Y | Z, SV=1000, DV=11_000, AC=100_000, TP=3000)
    return chip


def wr(chip, n, value, axes=X):
    command(chip, NOP_514, axes)
    chip.write(n, value)


def rr(chip, n, axis=X):
    command(chip, NOP_514, axis)
    return chip.read(n)


def stopped_after(chip, maximum=10 * SECOND):
    """Return the exact number of clocks until X does not drive any more."""
    begin, step = chip.clock, maximum
    probe = chip.snapshot()
    while step:
        before = chip.snapshot()
        chip.advance(step)
        if not driving(chip, X):
            chip.restore(before)
        step //= 2
    chip.advance(1)
    assert not driving(chip, X)
    took = chip.clock - begin
    assert probe.header == chip.snapshot().header
    return took


# --- starting ---


@covers("MCX514", "DRVRL", "DRVNR", "DRVAB", "DRVVP", "DRVVM", "TP", "R-LP")
def test_each_drive_command_moves_in_its_direction():
    ways = {REL: (3000, -3000), CREL: (-3000, 3000), ABS: (3000, -3000)}
    for code, (there, back) in ways.items():
        for tp, target in ((3000, there), (-3000, back)):
            chip = MCX514()
            load(chip, SV=1000, DV=11_000, AC=100_000, TP=tp)
            command(chip, code)
            assert chip.advance(SECOND) == 3000
            assert get_signed(chip, 0x30) == target == chip.net(0)
    for code, sign in ((PLUS, 1), (MINUS, -1)):
        chip = MCX514()
        load(chip, SV=1000, DV=1000, AC=1)
        command(chip, code)
        assert chip.advance(SECOND) == 1000
        assert get_signed(chip, 0x30) == 1000 * sign


@covers("MCX514", "LP", "DRVAB")
def test_an_absolute_drive_reaches_its_target_from_any_position(chip):
    load(chip, LP=-500, TP=700)
    command(chip, ABS)
    assert chip.advance(SECOND) == 1200
    assert get_signed(chip, 0x30) == 700
    command(chip, ABS)
    assert not driving(chip), "it is there"
    assert rr(chip, 1) & D_END


def test_a_command_to_several_axes_starts_them_at_the_same_clock(chip):
    command(chip, REL, X | Z)
    pulses = chip.trace(SECOND)
    by_axis = {axis: pulses["clock"][pulses["axis"] == axis].tolist() for axis in (0, 1, 2)}
    assert by_axis[0] == by_axis[2]
    assert len(by_axis[0]) == 3000
    assert by_axis[1] == []
    assert all(a <= b for a, b in itertools.pairwise(pulses["clock"].tolist()))


@covers("MCX514", "DHOLD", "DFREE")
def test_a_drive_in_start_hold_begins_at_the_release(chip):
    command(chip, 0x77, X | Y)
    command(chip, REL)
    chip.advance(1000)
    command(chip, REL, Y)
    assert chip.advance(SECOND) == 0
    command(chip, 0x78, X | Y)
    begin = chip.clock
    pulses = chip.trace(SECOND)
    first = pulses["clock"][0]
    assert begin < first < begin + SECOND // 1000
    assert set(pulses["axis"][pulses["clock"] == first].tolist()) == {0, 1}


def test_a_drive_command_while_driving_changes_nothing_and_has_a_diagnostic(chip):
    command(chip, REL)
    chip.advance(SECOND // 10)
    command(chip, MINUS)
    assert any("driving" in d.message for d in chip.diagnostics)
    assert chip.net(0) + chip.advance(SECOND) == 3000


def test_a_drive_of_no_pulses_makes_none(chip):
    load(chip, TP=0)
    command(chip, REL)
    assert not driving(chip)
    assert chip.advance(SECOND) == 0
    assert rr(chip, 1) & (D_STA | D_END) == D_STA | D_END


# --- events and status ---


def test_events_come_at_start_constant_speed_and_end(chip):
    command(chip, REL)
    assert rr(chip, 1) == D_STA
    chip.advance(SECOND // 10)
    assert rr(chip, 1) == C_STA, "at 11000 pps after a tenth of a second, and reading cleared the rest"
    chip.advance(SECOND)
    assert rr(chip, 1) == C_END | D_END


def test_only_enabled_factors_assert_the_interrupt_pin(chip):
    wr(chip, 1, D_END)
    command(chip, REL)
    chip.advance(SECOND // 5)
    assert not chip.pins.int0
    chip.advance(SECOND)
    assert chip.pins.int0
    rr(chip, 1)
    assert not chip.pins.int0


def test_the_drive_ends_with_its_last_pulse(chip):
    command(chip, REL)
    last = int(MCX514.trace(_twin(chip), SECOND)["clock"][-1])
    chip.advance(last - chip.clock - 1)
    assert driving(chip)
    chip.advance(1)
    assert not driving(chip)


def _twin(chip):
    replica = type(chip)(**chip.options())
    replica.restore(chip.snapshot())
    return replica


# --- what stops a drive ---


@pytest.mark.parametrize("plus", [True, False], ids=["plus", "minus"])
@covers("MCX514", "DRVVP", "DRVVM", "R2CLR")
def test_a_limit_stops_its_direction_at_once_and_blocks_it_until_cleared(plus):
    chip = MCX514()
    load(chip, SV=1000, DV=11_000, AC=100_000)
    wr(chip, 2, 1 << 11)
    pin, other = ("lmt_plus", "lmt_minus") if plus else ("lmt_minus", "lmt_plus")
    names = ("HLMT+", "LMT+") if plus else ("HLMT-", "LMT-")
    command(chip, PLUS if plus else MINUS)
    chip.advance(SECOND // 5)
    setattr(chip.axes[0].pins, other, True)
    chip.advance(1)
    assert driving(chip), "the other limit does not matter"
    setattr(chip.axes[0].pins, other, False)
    setattr(chip.axes[0].pins, pin, True)
    assert not driving(chip)
    assert chip.advance(SECOND) == 0
    assert rr(chip, 2) == RR2[names[0]] | END[names[1]]
    assert rr(chip, 0) >> 4 & 1
    command(chip, PLUS if plus else MINUS)
    assert chip.advance(SECOND) == 0, "it does not go on into the limit"
    command(chip, MINUS if plus else PLUS)
    assert chip.advance(SECOND // 100) > 0, "it leaves it"
    command(chip, STOP)
    setattr(chip.axes[0].pins, pin, False)
    command(chip, PLUS if plus else MINUS)
    assert chip.advance(SECOND // 100) == 0, "the error blocks until 79h"
    command(chip, 0x79)
    assert rr(chip, 2) == 0
    command(chip, PLUS if plus else MINUS)
    assert chip.advance(SECOND // 100) > 0


def test_a_disabled_limit_stops_nothing(chip):
    command(chip, PLUS)
    chip.axes[0].pins.lmt_plus = True
    assert chip.advance(SECOND) > 1000
    assert driving(chip)


def test_exchanged_limits_are_exchanged(chip):
    wr(chip, 2, 1 << 11)
    chip.write(3, 1 << 12)
    command(chip, PLUS)
    chip.axes[0].pins.lmt_plus = True
    chip.advance(SECOND // 10)
    assert driving(chip)
    chip.axes[0].pins.lmt_minus = True
    assert not driving(chip)


def test_a_limit_in_decelerating_mode_ramps_down_to_sv(chip):
    wr(chip, 2, 1 << 11 | 1 << 12)
    command(chip, PLUS)
    chip.advance(SECOND // 5)
    chip.axes[0].pins.lmt_plus = True
    assert stopped_after(chip) == SECOND // 10, "(11000 - 1000) / 100000 s"


@pytest.mark.parametrize("k", [0, 1, 2])
def test_an_enabled_stop_signal_ramps_down_and_is_reported(chip, k):
    wr(chip, 2, 2 << 2 * k)
    command(chip, PLUS)
    chip.advance(SECOND // 5)
    setattr(chip.axes[0].pins, f"stop{(k + 1) % 3}", True)
    chip.advance(1)
    assert driving(chip), "another one"
    setattr(chip.axes[0].pins, f"stop{k}", True)
    assert stopped_after(chip) == SECOND // 10
    assert rr(chip, 2) == END[f"STOP{k}"]
    assert not rr(chip, 0) >> 4 & 1, "no error"


def test_alarm_and_emergency_stop_at_once(chip):
    wr(chip, 2, 1 << 9)
    command(chip, PLUS)
    chip.advance(SECOND // 5)
    chip.axes[0].pins.alarm = True
    assert chip.advance(SECOND) == 0
    assert rr(chip, 2) == RR2["ALARM"] | END["ALARM"]
    chip = MCX514()
    load(chip, X | Y, SV=1000, DV=11_000, AC=100_000)
    command(chip, PLUS, X | Y)
    chip.advance(SECOND // 5)
    chip.pins.emg = True
    assert chip.advance(SECOND) == 0
    assert rr(chip, 2) == rr(chip, 2, Y) == RR2["EMG"] | END["EMG"]


@pytest.mark.parametrize("instant", [False, True], ids=["decelerating", "instant"])
@covers("MCX514", "SP", "SM", "DRVVP", "DRVVM")
def test_a_software_limit_stops_the_axis_past_its_value(instant):
    for code, register, sign in ((PLUS, 0x0B, 1), (MINUS, 0x0C, -1)):
        chip = MCX514()
        load(chip, SV=1000, DV=11_000, AC=100_000)
        put(chip, 0x0B, 2000)
        put(chip, 0x0C, -2000)
        wr(chip, 2, 1 << 13 | instant << 15)
        command(chip, code)
        chip.advance(SECOND)
        assert not driving(chip)
        lp = get_signed(chip, 0x30) * sign
        assert lp == 2001 if instant else lp == 2001 + 600, "LP > SP at pulse 2001; the ramp takes 600"
        assert rr(chip, 2) == RR2["SLMT+" if register == 0x0B else "SLMT-"]


@covers("MCX514", "DRVSBRK", "DRVFBRK")
def test_stop_commands_stop(chip):
    command(chip, PLUS)
    chip.advance(SECOND // 5)
    command(chip, SLOW)
    assert stopped_after(chip) == SECOND // 10
    assert rr(chip, 2) == 0
    command(chip, PLUS)
    chip.advance(SECOND // 5)
    command(chip, STOP)
    assert not driving(chip)
    assert chip.advance(SECOND) == 0


def test_inpos_is_awaited_where_it_is_enabled(chip):
    wr(chip, 2, 1 << 7)
    command(chip, REL)
    assert chip.advance(SECOND) == 3000
    assert driving(chip)
    assert not rr(chip, 1) & D_END
    chip.axes[0].pins.inpos = True
    assert not driving(chip)
    assert rr(chip, 1) & D_END


# --- filters ---


@covers("MCX514", "FLM")
def test_a_filtered_signal_acts_after_its_delay_and_a_short_one_never():
    for n in (0, 3, 10):
        chip = MCX514()
        load(chip, SV=1000, DV=1000, AC=1)
        put(chip, 0x25, 0x02 | n << 8)
        wr(chip, 2, 1 << 11)
        command(chip, PLUS)
        delay = 8 << n
        chip.axes[0].pins.lmt_plus = True
        chip.advance(delay - 1)
        chip.axes[0].pins.lmt_plus = False
        chip.advance(1)
        assert driving(chip), "too short"
        chip.axes[0].pins.lmt_plus = True
        chip.advance(delay - 1)
        assert driving(chip)
        chip.advance(1)
        assert not driving(chip), f"after {delay} clocks"


@pytest.mark.parametrize("neighbor", [False, True], ids=["alone", "while another signal is in its filter"])
@covers("MCX514", "FLM")
def test_a_filter_forgets_a_glitch_whatever_other_signals_do(neighbor):
    """Glitches of all but the filter's time, each by itself; then the signal, which acts after the whole of that time"""
    chip = MCX514()
    load(chip, SV=1000, DV=1000, AC=1)
    put(chip, 0x25, 0x43 | 3 << 8 | 15 << 12)  # EMG, LMT+ and LMT-: 64 clocks; STOP2: 262,144
    for pins, pin in ((chip.axes[0].pins, "lmt_plus"), (chip.axes[0].pins, "lmt_minus"), (chip.pins, "emg")):
        wr(chip, 2, 1 << 11)
        command(chip, 0x79)
        command(chip, MINUS if pin == "lmt_minus" else PLUS)
        chip.axes[0].pins.stop2 = neighbor
        for _ in range(5):
            setattr(pins, pin, True)
            chip.advance(63)
            setattr(pins, pin, False)
            chip.advance(1)
        setattr(pins, pin, True)
        chip.advance(63)
        assert driving(chip), f"a glitch of {pin} is remembered"
        chip.advance(1)
        assert not driving(chip), f"{pin} acts after 64 clocks"
        setattr(pins, pin, False)
        chip.axes[0].pins.stop2 = False
        chip.advance(1000)


@pytest.mark.parametrize("neighbor", [False, True], ids=["alone", "while another signal is in its filter"])
def test_a_filter_of_the_mcx304_forgets_a_glitch_whatever_other_signals_do(neighbor):
    """FE0 and FE1 with a delay of 512 us; STOP2 enters its filter later than LMT+"""
    chip = MCX304()
    load_304(chip, R=8_000_000, SV=100, V=100, A=100)
    set_wr3(chip, 3 << 8 | 2 << 13, nop=NOP_304)
    command(chip, 0x22)
    pins, delay = chip.axes[0].pins, 512 * 16
    for _ in range(3):
        pins.lmt_plus = True
        chip.advance(delay - 1)
        pins.stop2 = neighbor
        pins.lmt_plus = False
        chip.advance(1)
    pins.lmt_plus = True
    chip.advance(delay - 1)
    assert chip.axes[0].pins.drive, "a glitch is remembered"
    chip.advance(1)
    assert not chip.axes[0].pins.drive


# --- counters ---


@covers("MCX514", "LX", "LP", "R-LP")
def test_a_counter_with_a_maximum_wraps_to_0(chip):
    put(chip, 0x0E, 999)
    load(chip, LP=990, TP=20)
    command(chip, REL)
    chip.advance(SECOND)
    assert get_signed(chip, 0x30) == 10, "1000 values, 0 to 999"
    load(chip, TP=-20)
    command(chip, REL)
    chip.advance(SECOND)
    assert get_signed(chip, 0x30) == 990
    assert chip.net(0) == 0, "what the drive was given does not turn over"


def test_counters_wrap_at_32_bits_with_a_sign(chip):
    load(chip, LP=0x7FFFFFFF, TP=2)
    command(chip, REL)
    chip.advance(SECOND)
    assert get_signed(chip, 0x30) == -0x7FFFFFFF


@pytest.mark.parametrize(("mode", "counts"), [(0, 4), (1, 2), (2, 1)])
@covers("MCX514", "RP", "R-RP", "RX")
def test_the_encoder_counts_by_its_mode(mode, counts):
    chip = MCX514()
    wr(chip, 3, mode << 8)
    pins = chip.axes[0].pins
    for _ in range(10):
        for a, b in ((True, False), (True, True), (False, True), (False, False)):
            pins.eca, pins.ecb = a, b
            chip.advance(1)
    assert get_signed(chip, 0x31) == 10 * counts
    for _ in range(15):
        for a, b in ((False, True), (True, True), (True, False), (False, False)):
            pins.ecb, pins.eca = b, a
            chip.advance(1)
    assert get_signed(chip, 0x31) == -5 * counts
    put(chip, 0x0A, 12)
    assert get_signed(chip, 0x31) == 12
    put(chip, 0x0F, 12)
    for a, b in ((True, False), (True, True), (False, True), (False, False)):
        pins.eca, pins.ecb = a, b
        chip.advance(1)
    assert get_signed(chip, 0x31) == counts - 1, "a ring of 13"


# --- the bus ---


def test_several_axes_are_written_at_once_and_the_lowest_answers(chip):
    command(chip, NOP_514, Y | Z)
    chip.write(2, 0x1234)
    assert [rr_wr(chip, 2, axis) for axis in (X, Y, Z)] == [0, 0x1234, 0x1234]
    load(chip, Y, LP=5)
    load(chip, Z, LP=7)
    assert get(chip, 0x30, Y | Z) == 5


def rr_wr(chip, n, axis):
    command(chip, 0x3C + n, axis)
    return chip.read(6)


@covers("MCX514", "NOP", "R-WR1", "R-WR2", "R-WR3")
def test_mode_words_read_back(chip):
    for n, value in ((1, 0xFFFF), (2, 0x5A5A), (3, 0x2808)):
        wr(chip, n, value, Y)
        assert rr_wr(chip, n, Y) == value
        assert rr_wr(chip, n, X) == 0


@covers("MCX514", "R-AC", "R-SV", "R-DV", "R-TP", "R-SP1", "R-MRM", "R-P1M", "R-P2M")
@covers("MCX514", "AC", "SV", "DV", "TP", "SP1", "MRM", "P1M", "P2M")
def test_what_can_be_read_reads_as_written():
    chip = MCX514()
    for write, read, value in (
        (0x02, 0x43, 536_870_911), (0x04, 0x44, 8_000_000), (0x05, 0x45, 7_999_999), (0x06, 0x46, -5), (0x17, 0x47, 0x00050009),
    ):  # fmt: skip
        put(chip, write, value)
        assert get_signed(chip, read) == value
    for write, read in ((0x20, 0x40), (0x21, 0x41), (0x22, 0x42)):
        put(chip, write, 0xA5C3)
        assert get(chip, read) == 0xA5C3


def test_codes_for_reading_change_nothing_where_data_was_written(chip):
    before = {code: get(chip, code) for code in (0x30, 0x43, 0x44, 0x45, 0x46)}
    for code in before:
        put(chip, code, 123)
    assert {code: get(chip, code) for code in before} == before
    assert chip.diagnostics


def test_raw_levels_are_those_of_the_wires_whatever_the_polarity_bits_say(chip):
    pins = chip.axes[0].pins
    assert rr(chip, 3) & 0x1FF == 0x1E7, "nothing asserted, all low active: high levels; ECA and ECB low"
    pins.stop1 = pins.lmt_minus = True
    assert rr(chip, 3) & 0x1FF == 0x1E7 & ~0x102
    wr(chip, 2, 1 << 2 | 1 << 10)
    assert rr(chip, 3) & 0x1FF == 0x1E7 & ~0x102, "high active: what it makes of them is another matter"


LEVELS = {  # signal: (its level bit, its enable bit) in WR1 or WR2
    MCX304: {
        "stop1": ("WR1", "SP1-L", "SP1-E"), "stop2": ("WR1", "SP2-L", "SP2-E"), "stop0": ("WR1", "SP0-L", "SP0-E"),
        "lmt_plus": ("WR2", "HLMT+", None), "alarm": ("WR2", "ALM-L", "ALM-E"),
    },
    MCX514: {
        "stop1": ("WR2", "SP1-L", "SP1-E"), "stop2": ("WR2", "SP2-L", "SP2-E"), "stop0": ("WR2", "SP0-L", "SP0-E"),
        "lmt_plus": ("WR2", "HLM-L", "HLM-E"), "alarm": ("WR2", "ALM-L", "ALM-E"),
    },
}  # fmt: skip


@pytest.mark.parametrize(("cls", "pin"), [(cls, pin) for cls, pins in LEVELS.items() for pin in pins])
@pytest.mark.parametrize("high", [False, True], ids=["low active", "high active"])
def test_a_level_bit_inverts_its_signal(cls, pin, high):
    """A pin that is set is low. A continuous drive goes on while the signal is not active, and ends when it becomes so."""
    chip = cls()
    word, level, enable = LEVELS[cls][pin]
    setattr(chip.axes[0].pins, pin, high)
    command(chip, 0x0F if cls is MCX304 else 0x1F)
    chip.write(int(word[2]), chip.MAP.mask(word, level) * high | (chip.MAP.mask(word, enable) if enable else 0))
    if cls is MCX514:
        load(chip, AC=1_000_000, SV=1000, DV=1000)
    else:
        load_304(chip, R=8_000_000, A=100, SV=1000, V=1000)
    command(chip, 0x22 if cls is MCX304 else 0x52)
    assert chip.advance(SECOND // 10) == 100
    setattr(chip.axes[0].pins, pin, not high)
    chip.advance(10)
    assert not chip.busy(), "it has ended"


@pytest.mark.parametrize("cls", [MCX304, MCX514])
@pytest.mark.parametrize("high", [False, True], ids=["low active", "high active"])
def test_the_level_bit_of_inpos_says_which_level_ends_a_drive(cls, high):
    chip = cls()
    command(chip, 0x0F if cls is MCX304 else 0x1F)
    chip.write(2, chip.MAP.mask("WR2", "INP-E") | chip.MAP.mask("WR2", "INP-L") * high)
    chip.axes[0].pins.inpos = high
    if cls is MCX514:
        load(chip, AC=1_000_000, SV=1000, DV=1000, TP=3)
    else:
        load_304(chip, R=8_000_000, A=100, SV=1000, V=1000, P=3)
    command(chip, 0x20 if cls is MCX304 else REL)
    chip.advance(SECOND // 10)
    assert chip.busy(), "all pulses are out, and it is not in position"
    chip.axes[0].pins.inpos = not high
    chip.advance(10)
    assert not chip.busy()


@covers("MCX514", "RR3P0", "RR3P1")
def test_each_axis_shows_the_page_selected_for_it(chip):
    command(chip, 0x7B, Y)
    load(chip, Y, TP=3000)
    command(chip, REL, Y)
    chip.advance(SECOND // 20)
    assert rr(chip, 3, Y) & 0x70 == 0x10, "ASND"
    assert rr(chip, 3, X) & 0x1FF == 0x1E7
    command(chip, 0x7A, Y)
    assert rr(chip, 3, Y) & 0x1FF == 0x1E7


def test_the_8_bit_bus_does_what_the_16_bit_bus_does():
    words, octets = MCX514(), MCX514()

    def both(address, value):
        words.write(address, value)
        if address == 0:
            octets.write_byte(1, value >> 8)
            octets.write_byte(0, value & 0xFF)
        else:
            octets.write_byte(2 * address, value & 0xFF)
            octets.write_byte(2 * address + 1, value >> 8)

    for code, value in ((0x04, 1000), (0x05, 70_000), (0x02, 1_000_000), (0x06, 5000)):
        both(6, value & 0xFFFF)
        both(7, value >> 16)
        both(0, X << 8 | code)
    both(0, X << 8 | REL)
    assert words.trace(SECOND).tolist() == octets.trace(SECOND).tolist()
    assert [words.read(k) for k in range(8)] == [
        octets.read_byte(2 * k) | octets.read_byte(2 * k + 1) << 8 for k in range(8)
    ]


def test_every_byte_of_every_word_passes_the_8_bit_bus_as_the_word_does_whichever_half_comes_first():
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    words, octets = MCX514(), MCX514()
    for k in range(300):
        address = int(rng.integers(0, 8))
        value = int(rng.integers(0, 1 << 16)) & (0x0FFF if address == 0 else 0xFFFF)
        if value & 0xFF == 0xFF and address == 0:
            continue  # the reset
        words.write(address, value)
        halves = [(2 * address + 1, value >> 8), (2 * address, value & 0xFF)]
        for at, byte in halves if address == 0 or k % 2 else halves[::-1]:
            octets.write_byte(at, byte)
        for chip in (words, octets):
            chip.advance(300)
        for n in range(8):
            low, high = octets.read_byte(2 * n), octets.read_byte(2 * n + 1)
            assert words.read(n) == low | high << 8, (k, n)
        assert words.values() == octets.values()
        assert [words.output_word(a) for a in range(4)] == [octets.output_word(a) for a in range(4)]


@pytest.mark.parametrize("high_first", [False, True])
def test_a_byte_written_alone_leaves_the_other_half_of_its_register(high_first):
    words, octets, previous = MCX514(), MCX514(), [0] * 8
    for n in (*range(1, 8), *range(7, 0, -1)):
        value = 0x1234 * n & 0x5A5A
        for high in (high_first, not high_first):
            part = 0xFF00 if high else 0xFF
            previous[n] = previous[n] & ~part | value & part
            words.write(n, previous[n])
            octets.write_byte(2 * n + high, (value & part) >> (8 if high else 0))
            assert octets.snapshot().record == words.snapshot().record, f"byte {2 * n + high}"


def test_the_high_byte_of_wr0_waits_for_the_low_one(chip):
    chip.write_byte(1, X)
    assert not driving(chip)
    chip.write_byte(0, REL)
    assert driving(chip)


@covers("MCX514", "RST")
def test_the_reset_command_is_the_reset_pin(chip):
    command(chip, REL)
    chip.advance(SECOND // 10)
    pulses, clock = chip.net(0), chip.clock
    chip.write(0, 0x00FF)
    assert not driving(chip)
    assert chip.advance(SECOND) == 0
    assert (chip.net(0), chip.clock) == (pulses, clock + SECOND)
    assert get(chip, 0x45) == 1, "parameters 1"
    assert get(chip, 0x30) == 0


def test_a_pin_that_does_not_exist_is_an_error_with_the_names_that_do():
    with pytest.raises(StageError, match="stop0"):
        MCX514().axes[0].pins.stop3 = True
    with pytest.raises(StageError, match="emg"):
        MCX514().pins.lmt_plus = True


# --- the older chips ---


@pytest.fixture
def older():
    chip = MCX304()
    load_304(chip, X | Y, R=800_000, A=80, SV=100, V=1100, P=3000, AO=0)  # ramps of a tenth of a second to 11000 pps
    return chip


def old_rr(chip, n, axis=X):
    command(chip, NOP_304, axis)
    return chip.read(n)


@covers("MCX304", "F_DRV_P", "F_DRV_M", "C_DRV_P", "C_DRV_M", "STOP_SUDDEN", "STOP_DEC", "START_HOLD", "START_FREE")
@covers("MCX304", "R", "A", "SV", "V", "AO", "R-LP")
def test_drives_of_the_older_chips_go_and_stop():
    for code, sign in ((0x20, 1), (0x21, -1)):
        chip = MCX304()
        load_304(chip, R=800_000, A=80, SV=100, V=1100, P=3000, AO=0)
        command(chip, code)
        assert chip.advance(SECOND) == 3000
        assert get_signed(chip, 0x10) == 3000 * sign
    for code, sign in ((0x22, 1), (0x23, -1)):
        command(chip, 0x24)
        command(chip, code)
        assert chip.advance(SECOND // 10) == 0
        command(chip, 0x25)
        assert chip.advance(SECOND // 5) > 0
        command(chip, 0x26)
        before = chip.net(0)
        chip.advance(SECOND)
        assert not driving(chip)
        assert (chip.net(0) - before) * sign == 600, "the ramp down"
        command(chip, code)
        chip.advance(SECOND // 5)
        command(chip, 0x27)
        assert chip.advance(SECOND) == 0


def test_hardware_limits_of_the_older_chips_are_always_on(older):
    command(older, 0x22)
    older.advance(SECOND // 5)
    older.axes[0].pins.lmt_plus = True
    assert older.advance(SECOND) == 0
    assert old_rr(older, 1) & 0xF000 == 0x1000
    assert old_rr(older, 2) & 0x3F == 4
    older.axes[0].pins.lmt_plus = False
    assert old_rr(older, 2) & 0x3F == 0, "while the level is there"


def test_software_limits_of_the_older_chips_stop_on_their_value(older):
    put(older, 0x0B, 2000)
    command(older, NOP_304)
    older.write(2, 1)
    command(older, 0x22)
    older.advance(SECOND)
    assert get_signed(older, 0x10) == 2000 + 600, "LP >= C+ at pulse 2000, and the ramp"
    assert old_rr(older, 1) & 1


def test_a_two_axis_chip_has_two_axes():
    chip = MCX302()
    assert len(chip.axes) == 2
    load_304(chip, 0xF, R=800_000, A=80, SV=100, V=100, P=5, AO=0)
    command(chip, 0x20, 0xF)
    assert chip.advance(SECOND) == 10


def test_the_older_chips_reset_by_8000h(older):
    command(older, 0x22)
    older.advance(SECOND // 10)
    older.write(0, 0x8000)
    assert older.advance(SECOND) == 0
    assert old_rr(older, 0) == 0


@covers("MCX304", "K")
def test_s_curves_need_sacc(older):
    load_304(older, K=500)
    set_wr3(older, 4, X, NOP_304)
    command(older, 0x20)
    older.advance(SECOND // 100)
    assert old_rr(older, 1) & 0x24 == 0x24, "ASND and AASND"


@covers("MCX514", "DIRCP", "DIRCM")
def test_a_direction_command_sets_the_signal_at_rest_and_a_drive_sets_it_again(chip):
    directions = []
    command(chip, 0x1F, 3)
    chip.write(3, 1 << 3)  # DPMD: pulse and direction
    for code in (0x59, 0x58, 0x59, PLUS, 0x59, STOP, 0x58, MINUS, 0x58):
        command(chip, code)
        directions.append(chip.axes[0].pins.dir)
        assert not chip.axes[1].pins.dir
    assert directions == [True, False, True, False, False, False, False, True, True]  # True: -


@covers("MCX514", "UI", "LP")
def test_nothing_is_connected_to_the_general_inputs(chip):
    load(chip, LP=-1)
    get(chip, 0x30)
    assert get(chip, 0x48, 0) == 0


@pytest.mark.parametrize("cls", [MCX302, MCX312])
@pytest.mark.parametrize(("plus_high", "minus_high"), [(False, False), (True, False), (False, True), (True, True)])
def test_the_level_of_each_limit_is_that_of_its_wire_and_rr2_reads_it_by_its_own_polarity(cls, plus_high, minus_high):
    """RR4, RR5 of the two-axis chips, D14 and D15; WR2 HLMT+ and HLMT-: 1 is high active."""
    chip = cls()
    map_ = cls.MAP
    chip.write(0, 0x10F)
    chip.write(2, map_.mask("WR2", "HLMT+") * plus_high | map_.mask("WR2", "HLMT-") * minus_high)
    for plus, minus in ((False, False), (True, False), (False, True), (True, True)):
        chip.axes[0].pins.lmt_plus, chip.axes[0].pins.lmt_minus = plus, minus
        word = chip.read(4)
        assert bool(word & map_.mask("RR4", "X-LMT+")) == (not plus)
        assert bool(word & map_.mask("RR4", "X-LMT-")) == (not minus)
        chip.advance(1)
        message = chip.read(2)
        assert bool(message & map_.mask("RR2", "HLMT+")) == (plus != plus_high)
        assert bool(message & map_.mask("RR2", "HLMT-")) == (minus != minus_high)


@pytest.mark.parametrize("cls", [MCX304, MCX514], ids=lambda cls: cls.__name__)
def test_a_speed_of_0_counts_as_the_smallest(cls):
    """An axis that was told to drive makes its pulses, each second one at the least."""
    clocks = []
    for speed in (0, 1):
        chip = cls()
        if cls is MCX514:
            load(chip, AC=1_000_000, SV=speed, DV=speed, TP=3)
            command(chip, REL)
        else:
            load_304(chip, R=16_000, A=100, SV=speed, V=speed, P=3)
            command(chip, 0x20)
        chip.advance(4 * SECOND)
        clocks.append(chip.net(0))
    assert clocks == [3, 3]


@pytest.mark.parametrize("cls", [MCX304, MCX514])
@pytest.mark.parametrize(
    ("pin", "message"), [("lmt_plus", "LMT+ is active"), ("alarm", "ALARM is active"), ("emg", "EMG is active")]
)
def test_a_drive_command_that_a_signal_refuses_says_so_and_another_does_not(cls, pin, message):
    chip = cls()
    command(chip, NOP_304 if cls is MCX304 else NOP_514)
    chip.write(2, chip.MAP.mask("WR2", "ALM-E") | (chip.MAP.mask("WR2", "HLM-E") if cls is MCX514 else 0))
    if cls is MCX514:
        load(chip, AC=1_000_000, SV=1000, DV=1000, TP=3)
    else:
        load_304(chip, R=8_000_000, A=100, SV=1000, V=1000, P=3)
    chip.diagnostics.clear()
    plus, minus = (0x22, 0x23) if cls is MCX304 else (PLUS, MINUS)
    pins = chip.pins if pin == "emg" else chip.axes[0].pins
    setattr(pins, pin, True)
    chip.advance(10)
    command(chip, plus)
    assert chip.advance(SECOND // 100) == 0
    assert [message in d.message for d in chip.diagnostics] == [True], chip.diagnostics
    setattr(pins, pin, False)
    chip.advance(10)
    chip.diagnostics.clear()
    command(chip, minus)
    assert chip.advance(SECOND // 100) == 10
    assert chip.diagnostics == []
