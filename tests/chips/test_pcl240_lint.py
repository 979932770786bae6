"""Diagnostics of the PCL-240 chips: silicon accepts any write, and `chip.diagnostics` names the rules that it breaks.

Messages are tested by the names that they must mention, never by their words. Each set-up has one contradiction.
"""

import numpy as np
import pytest
from support.pcl240k_bench import FOREVER, RNG, SEED, clocks_while, commands, counter, operating
from support.pcl240ms_bench import AUTOMATIC, LINEAR, NO_CORRECTION, load
from support.pcl240ms_hands import BITS, NAMES, SWITCH_OFF, begun, kept, last_gaps, select

from stage.chips import PCL240K, PCL240MK, PCL240MS

BOTH = pytest.mark.parametrize("make", [PCL240MK, PCL240MS])
ALL = pytest.mark.parametrize("make", [PCL240K, PCL240MK, PCL240MS])
PRESET, MANUAL = 0x44, 0x40


def find_messages(chip, *names):
    """Return the messages that mention all these names, in any case."""
    text = [d.message for d in chip.diagnostics]
    return [message for message in text if all(name.lower() in message.lower() for name in names)]


def has_diagnostic(chip, *names, also=()):
    """Check that the chip has one diagnostic with these words, and no other but those with the keys `also`."""
    others = [d for d in chip.diagnostics if d.key not in also]
    assert len(find_messages(chip, *names)) == len(others) == 1, chip.diagnostics
    assert chip.diagnostics[0].source
    return True


def set_up(make, control, start, **registers):
    """Start a chip whose registers break no rule but by `registers`: FL 50, FH 800, ramps of 583 pulses.

    Args:
        make: Class of the chip.
        control: Control mode command.
        start: Start command.
        registers: Values to write instead. A register given as 0 is written, which may break `value-range` too; one given as
            None is not written and stays 0, as after power-up.
    """
    sound = {"R0": 5000, "R1": 50, "R2": 800, "R3": 810, "R4": 30, "R5": 30, "R7": 2}
    if control & 0x14 == 0x04:
        sound["R6"] = 800
    return begun(make, control, start, **(sound | registers))


# Silicon takes anything


@BOTH
def test_any_write_is_accepted_and_no_register_exceeds_its_width(make):
    print(f"PULSESTAGE_SEED={SEED}")
    chip = make()
    for _ in range(3000):
        chip.write(int(RNG.integers(-9, 9)), int(RNG.integers(-1000, 1000)))
        chip.advance(int(RNG.integers(0, 50)))
        assert 0 <= chip.read(int(RNG.integers(-9, 9))) <= 0xFF
    values = chip.values()
    assert {name: values[name] & ~((1 << BITS[make][name]) - 1) for name in NAMES} == dict.fromkeys(NAMES, 0)


@BOTH
@pytest.mark.parametrize(("address", "value"), [(1, 1 << 40), (1, -1), (5, 0x15), (-1, 0xFF), (1 << 40, 0x15)])
def test_address_and_value_are_masked_to_2_and_8_bits(make, address, value):
    chip, replica = make(), make()
    for one in (chip, replica):
        load(one, R0=0x123456, R1=50, R7=2)
        one.write(0, 0x80)
    chip.write(address, value)
    replica.write(address & 3, value & 0xFF)
    assert chip.values() == replica.values()
    assert chip.trace(10_000).tolist() == replica.trace(10_000).tolist()


@BOTH
def test_an_ez_return_with_every_bit_of_every_register_set_raises_nothing(make):
    chip = begun(make, 0x75, 0x35, **dict.fromkeys(NAMES, 0xFFFFFF))
    chip.pins.org = True
    for level in (True, False) * 20:
        chip.pins.ez = level
        chip.advance(1 << 20)
        assert chip.dump()
    assert 0 <= chip.read(0) <= 0xFF


# Bits that a register does not have


@ALL
def test_bits_above_a_width_are_masked_and_each_byte_that_loses_some_has_a_diagnostic(make):
    for name, bits in BITS[make].items():
        if make is PCL240MK and name == "R6":  # all ones are the offset -1
            continue
        chip = make()
        load(chip, **{name: 0xFFFFFF & ~(0 if name != "R17" else 0x1F0000)})
        about_width = find_messages(chip, name, f"{bits} bits")
        expected = (24 - bits + 7) // 8
        assert len(about_width) == expected, (name, chip.diagnostics)
        assert chip.values()[name] == kept(make, name)
        fits = make()
        load(fits, **{name: kept(make, name)})
        assert [d for d in fits.diagnostics if "S-curve" not in d.message] == [], "nothing is lost"


def test_r15_of_the_ms_loses_its_bits_15_to_12():
    chip = PCL240MS()
    load(chip, R15=0x8123)
    assert has_diagnostic(chip, "R15")
    assert chip.values()["R15"] == 0x123


def test_r13_bit_23_of_the_mk_is_fixed_as_0_and_the_ms_has_it():
    mk, ms = PCL240MK(), PCL240MS()
    for chip in (mk, ms):
        load(chip, R13=0x800000)
    assert has_diagnostic(mk, "R13")
    assert mk.values()["R13"] == 0
    assert ms.diagnostics == []
    assert ms.values()["R13"] == 0x800000


def write_24_bits(chip, name, value, collective):
    """Write all 24 bits of a register, byte by byte or as a collective transfer."""
    commands(chip, select(name) | (0x20 if collective else 0))
    for address in (3, 2, 1):
        chip.write(address, value >> 8 * (address - 1) & 0xFF)


@BOTH
@pytest.mark.parametrize("collective", [False, True])
@pytest.mark.parametrize("offset", [-1, -2, -1000, -524_288])
def test_a_negative_offset_written_with_24_bits_loses_nothing_and_means_the_same_on_both(make, offset, collective):
    """chip.write(0, 86h), then FFh, FFh, FEh to addresses 3, 2, 1 of a PCL240MK: docs/chips.md"""
    chip = make()
    write_24_bits(chip, "R6", offset & 0xFFFFFF, collective)
    assert chip.diagnostics == []
    assert chip.values()["R6"] == offset & (1 << BITS[make]["R6"]) - 1


def test_a_move_with_an_offset_of_24_bits_makes_the_same_pulses_on_mk_and_ms():
    clocks = []
    for make in (PCL240MK, PCL240MS):
        chip = begun(make, AUTOMATIC, 0x08, R0=5000, **({"R14": LINEAR | NO_CORRECTION} if make is PCL240MS else {}))
        write_24_bits(chip, "R6", -40 & 0xFFFFFF, False)
        commands(chip, 0x15)
        clocks.append(chip.trace(FOREVER)["clock"])
        assert chip.diagnostics == []
        assert 21 < np.diff(clocks[-1])[-1] < 327, "the ramp-down began 40 pulses too late to reach FL"
    assert len(clocks[0]) == 5000
    assert (clocks[0] == clocks[1]).all()


@pytest.mark.parametrize(
    ("make", "value", "collective"),
    [
        *((PCL240MK, value, c) for value in (0xF00000, 0xF7FFFF, 0x1FFFFF, 0x7FFFFE) for c in (False, True)),
        (PCL240K, 0xFFFFFE, False),
    ],
)
def test_bits_of_r6_that_repeat_no_sign_are_lost_with_a_diagnostic(make, value, collective):
    chip = make()
    write_24_bits(chip, "R6", value, collective)
    assert has_diagnostic(chip, "R6", "20 bits")
    assert chip.values()["R6"] == value & 0xFFFFF


@BOTH
@pytest.mark.parametrize("bit", range(24))
def test_the_monitor_bits_of_r17_are_read_only(make, bit):
    chip = make()
    load(chip, R17=1 << bit)
    if 16 <= bit <= 20:
        assert has_diagnostic(chip, "R17")
        assert chip.values()["R17"] == 0
    else:
        assert chip.diagnostics == []
        assert chip.values()["R17"] == 1 << bit


@BOTH
def test_a_collective_write_that_loses_bits_has_one_diagnostic_when_it_transfers(make):
    chip = make()
    chip.write(0, 0xA1)
    chip.write(3, 0xFF)
    chip.write(2, 0xFF)
    assert chip.diagnostics == [], "held, and nothing lost yet"
    chip.write(0, 0xA0)
    chip.write(1, 0xFF)
    assert chip.diagnostics == [], "R0 takes them all"
    chip.write(0, 0xA1)
    chip.write(1, 0xFF)
    assert has_diagnostic(chip, "R1")
    assert chip.values()["R1"] == 0x1FFF


@BOTH
def test_the_legal_minimum_is_judged_by_the_value_that_a_collective_write_transfers(make):
    chip = make()
    for name, value in (("R1", 0x0100), ("R4", 0x0200), ("R7", 0x0300)):
        commands(chip, select(name) | 0x20)
        chip.write(3, 0)
        chip.write(2, value >> 8)
        chip.write(1, 0)
        assert chip.values()[name] == value
    assert chip.diagnostics == []
    commands(chip, 0xA1)
    chip.write(2, 0)
    chip.write(1, 0)
    assert has_diagnostic(chip, "R1")


# Commands that are in no table, and a direction that changes in motion

IN_A_TABLE = {0x08} | {code | irq for code in (0x10, 0x11, 0x13, 0x14, 0x15, 0x17, 0x1D, 0x1F) for irq in (0, 0x20)}
"""Section 3 a of the PCL-240K's data sheet; 28h is not there, for the reset command has no choice of /INT."""


@ALL
@pytest.mark.parametrize("value", range(0x40))
def test_an_operating_mode_has_a_diagnostic_where_the_table_of_the_data_sheet_does_not_have_it(make, value):
    chip = set_up(make, MANUAL, 0x08)
    assert chip.diagnostics == []
    chip.write(0, value)
    if value in IN_A_TABLE:
        assert chip.diagnostics == []
    else:
        assert has_diagnostic(chip, f"{value:02X}h", "in no table")
        assert chip.diagnostics[0].source == "section 3 a"


@ALL
@pytest.mark.parametrize(
    ("start", "command", "effect", "at_once"),
    [
        (0x11, 0x18, "stop at once", True),
        (0x11, 0x19, "stop at once", True),
        (0x11, 0x1B, "stop at once", True),
        (0x11, 0x1C, "decelerating stop", False),
        (0x15, 0x18, "decelerating stop", False),
        (0x15, 0x19, "decelerating stop", False),
        (0x15, 0x1C, "decelerating stop", False),
        (0x15, 0x1E, "decelerating stop", False),
        (0x15, 0x28, "reset command, with /INT", True),
        (0x15, 0x0F, "reset command", True),
        (0x15, 0x00, "does nothing", None),
        (0x15, 0x27, "does nothing", None),
    ],
)
def test_a_command_in_no_table_does_what_its_diagnostic_says(make, start, command, effect, at_once):
    chip = set_up(make, MANUAL, start)
    chip.advance(60_000)
    chip.write(0, command)
    assert has_diagnostic(chip, f"{command:02X}h", effect)
    chip.advance(2 * 8192)  # a period of FL is 328 clocks, a ramp of 750 steps 22,500
    assert operating(chip) == (not at_once)
    chip.advance(60_000)
    assert operating(chip) == (at_once is None)
    assert chip.pins.irq == (command == 0x28)


@ALL
@pytest.mark.parametrize(("first", "then"), [(0x40, 0x48), (0x48, 0x40)])
@pytest.mark.parametrize("start", [0x11, 0x15])
def test_a_new_direction_in_motion_has_a_diagnostic_and_reverses_the_next_pulse(make, start, first, then):
    """chip.write(0, 40h); chip.write(0, 15h); chip.write(0, 48h)"""
    chip = set_up(make, first, start)
    chip.advance(30_000)
    chip.write(0, first)
    assert chip.diagnostics == [], "the same direction again"
    chip.write(0, then)
    assert has_diagnostic(chip, f"{then:02X}h", "direction", "next pulse goes the other way")
    assert chip.trace(500)["direction"][0] == (-1 if then == 0x48 else 1)


@ALL
def test_a_direction_that_changes_within_the_last_pulse_has_a_diagnostic_and_one_that_changes_at_rest_has_none(make):
    chip = set_up(make, MANUAL, 0x11)
    clocks_while(chip, lambda c: not c.pins.pout)
    commands(chip, 0x08)
    assert operating(chip), "POUT is low: the pulse is completed first"
    chip.write(0, 0x48)
    assert has_diagnostic(chip, "48h", "PDIR changes within the last pulse")
    chip.advance(100)
    assert not operating(chip)
    chip.write(0, 0x40)
    assert len(chip.diagnostics) == 1


@ALL
def test_a_high_speed_preset_move_without_ramping_down_point_has_a_diagnostic(make):
    """R6 takes 1 to 1048575: R6 = 0 is no point, and the move stops from FH. A constant-speed move needs none."""
    for start, expected in ((0x11, 0), (0x14, 0), (0x15, 1), (0x17, 1)):
        chip = set_up(make, PRESET, start, R6=0)
        assert len(find_messages(chip, "R6 = 0")) == len(chip.diagnostics) == expected, hex(start)
    assert set_up(PCL240K, PRESET, 0x15, R6=1).diagnostics == []


# What a chip does not have


def test_the_k_has_neither_extension_registers_nor_automatic_point_nor_extension_mode():
    for command in (0x90, 0x97, 0xA1, 0x88, 0x50, 0x60, 0xC8):
        chip = PCL240K()
        chip.write(0, command)
        assert len(chip.diagnostics) == 1, f"{command:02X}h"
        mk = PCL240MK()
        mk.write(0, command)
        assert len(mk.diagnostics) == (command == 0x88), f"{command:02X}h: bit 3 of a register select means nothing"


def test_extension_register_4_of_the_k_is_r4():
    chip = PCL240K()
    load(chip, R14=0x1234)
    assert chip.values()["R4"] == 0x1234
    assert chip.diagnostics


@pytest.mark.parametrize(("name", "value"), [("R14", 1), ("R14", 0x100), ("R15", 100), ("R15", 0xF00)])
def test_an_s_curve_span_on_the_mk_has_a_diagnostic_and_is_only_stored(name, value):
    chip = PCL240MK()
    load(chip, **{name: value})
    assert has_diagnostic(chip, name)
    assert chip.values()[name] == value


def test_selecting_linear_ramps_on_the_mk_changes_nothing():
    chip = PCL240MK()
    load(chip, R14=LINEAR | NO_CORRECTION, R15=0)
    assert chip.diagnostics == []


# Spans above half the ramp


@pytest.mark.parametrize("fh", [800, 801], ids=["even", "odd"])
@pytest.mark.parametrize("control", [PRESET, AUTOMATIC], ids=["R6", "automatic"])
@pytest.mark.parametrize("r0", [5000, 700], ids=["trapezoid", "short"])
def test_a_span_above_half_the_ramp_falls_back_to_half(fh, control, r0):
    half = (fh - 50) // 2

    def pulses(r14, r15):
        chip = set_up(PCL240MS, control, 0x15, R0=r0, R2=fh, R14=r14, R15=r15)
        trace = chip.trace(FOREVER)
        assert len(trace) == r0
        return trace["clock"].tolist()

    zero = pulses(0, 0)
    above = (fh - 50) // 2 + 1
    for r14, r15 in ((above, above), (4095, 4095), (above, 0), (0, 4095), (750, 2000)):
        assert pulses(r14, r15) == zero, (r14, r15)
    if r0 == 5000:
        assert pulses(half // 2, half // 2) != zero
        assert pulses(half // 2, 0) != zero
        assert pulses(0, half // 2) != zero


def test_the_upper_bits_of_r14_are_not_part_of_the_span():
    traces = [
        set_up(PCL240MS, PRESET, 0x15, R14=bits | 200, R15=200).trace(FOREVER)["clock"].tolist()
        for bits in (0, 0x2000, 0x4000, 0x6000, NO_CORRECTION)
    ]
    assert traces[1:] == traces[:-1]


# Contradictions at the start


@BOTH
@pytest.mark.parametrize("control", [0x50, 0x70, 0x58])
def test_the_automatic_point_without_preset_has_a_diagnostic(make, control):
    assert has_diagnostic(set_up(make, control, 0x15), "automatic", "preset")


@BOTH
@pytest.mark.parametrize(("start", "name", "control"), [(0x15, "R2", MANUAL), (0x17, "R3", MANUAL), (0x35, "R2", 0x54)])
def test_fl_above_fh_with_ramps_has_a_diagnostic(make, start, name, control):
    chip = set_up(make, control, start, R0=5000, R1=1000, R14=LINEAR)
    assert has_diagnostic(chip, "R1", name, also={"too-fast"})
    chip.advance(1)
    assert chip.pins.fdown or control == 0x54
    assert chip.advance(1_000_000) > 0


@BOTH
def test_a_preset_run_whose_r6_the_reset_command_cleared_has_a_diagnostic(make):
    chip = set_up(make, PRESET, 0x08, R6=800)
    commands(chip, 0x08, 0x15)
    assert has_diagnostic(chip, "R6", "08h")
    assert set(last_gaps(chip)) <= {20, 21}, "it stops from FH"


@BOTH
@pytest.mark.parametrize("offset", [-1200, -100_000], ids=str)
def test_an_offset_so_negative_that_no_ramp_down_comes_has_a_diagnostic(make, offset):
    chip = set_up(make, AUTOMATIC, 0x15, R6=offset & (1 << BITS[make]["R6"]) - 1)
    assert has_diagnostic(chip, "R6")
    assert set(last_gaps(chip)) <= {20, 21}, "it stops from FH"


@pytest.mark.parametrize("span", [0, 100], ids=["no linear part", "with a linear part"])
def test_the_pulses_of_an_s_curve_decide_what_is_too_negative(span):
    """583 of them without a linear part; 369 with spans of 100."""
    for offset, too_negative in ((-290 if span == 0 else -180, False), (-450, span > 0), (-1170, True)):
        chip = set_up(PCL240MS, AUTOMATIC, 0x15, R6=offset & 0xFFFFFF, R14=span, R15=span)
        assert bool(find_messages(chip, "R6")) == too_negative
        journal = chip.journal()
        chip.advance(FOREVER)
        assert journal.replay_waveforms().pin("fdown").any() == (not too_negative), "so it is"


@BOTH
def test_a_move_shorter_than_its_negative_offset_has_a_diagnostic(make):
    """With 200 pulses, all of them made while the speed rises, R0 never gets down to 200 - 400."""
    chip = set_up(make, AUTOMATIC, 0x15, R0=200, R6=-400 & (1 << BITS[make]["R6"]) - 1, R14=NO_CORRECTION)
    assert has_diagnostic(chip, "R6", also={"move-too-short"})
    clocks_while(chip, "fup")
    assert counter(chip) == 0
    assert not operating(chip) or chip.pins.zero


@BOTH
@pytest.mark.parametrize("r13", [0x030000, 0x100000, 0x1F0000])
def test_an_ez_count_without_r13_bit_21_has_a_diagnostic_at_an_origin_return(make, r13):
    for start in (0x10, 0x15):
        assert has_diagnostic(set_up(make, 0x41, start, R13=r13), "R13")


@pytest.mark.parametrize(("r14", "r15"), [(100, 0), (0, 100), (100, 100), (4095, 4095)])
def test_a_span_with_linear_ramps_selected_has_a_diagnostic(r14, r15):
    chip = set_up(PCL240MS, MANUAL, 0x15, R14=LINEAR | r14, R15=r15)
    assert has_diagnostic(chip, "R14")
    replica = set_up(PCL240MS, MANUAL, 0x15, R14=LINEAR)
    assert replica.diagnostics == []
    assert (chip.trace(100_000) == replica.trace(100_000)).all(), "the span means nothing"


@pytest.mark.parametrize("r0", [300, 700, 1000])
def test_the_fh_correction_of_a_linear_ramp_ignores_the_spans(r0):
    """R14 bit 12: the move is too short for FH, and its highest speed follows from linear ramps."""
    traces = [
        set_up(PCL240MS, AUTOMATIC, 0x15, R0=r0, R14=LINEAR | span, R15=span).trace(FOREVER)["clock"].tolist()
        for span in (0, 100)
    ]
    assert len(traces[0]) == r0
    assert traces[0] == traces[1]


@pytest.mark.parametrize(
    ("r14", "r15", "text"), [(100, 300, True), (100, 0, True), (100, 4095, True), (300, 100, False), (0, 100, False)]
)
def test_a_deceleration_span_above_the_acceleration_span_has_a_diagnostic_with_the_automatic_point_on(r14, r15, text):
    for control, bits in ((AUTOMATIC, 0), (AUTOMATIC, NO_CORRECTION), (0x74, 0)):
        chip = set_up(PCL240MS, control, 0x15, R14=r14 | bits, R15=r15)
        assert bool(find_messages(chip, "R14", "R15")) == bool(chip.diagnostics) == text
    assert set_up(PCL240MS, PRESET, 0x15, R14=r14, R15=r15).diagnostics == [], "automatic off: R6 is the host's"


@ALL
def test_the_diagnostics_of_a_start_of_the_k_hold_for_every_chip(make):
    assert "multiplier" in set_up(make, MANUAL, 0x15, R7=0).diagnostics[-1].message
    assert has_diagnostic(set_up(make, PRESET, 0x15, R0=0), "R0")
    assert [d.key for d in set_up(make, MANUAL, 0x11, R1=0).diagnostics] == ["value-range", "fl-is-0"], "0 is written"
    assert [d.key for d in set_up(make, MANUAL, 0x11, R1=None).diagnostics] == ["fl-is-0"], "nothing is written"
    chip = set_up(make, MANUAL, 0x11)
    chip.advance(1000)
    commands(chip, 0x08)
    chip.advance(1000)
    commands(chip, 0x11)
    assert chip.diagnostics == []
    chip.pins.el_plus = True
    chip.advance(1000)
    chip.pins.el_plus = False
    commands(chip, 0x11)
    assert has_diagnostic(chip, "reset command")


# Writes in motion


@BOTH
@pytest.mark.parametrize("name", SWITCH_OFF)
@pytest.mark.parametrize("collective", [0, 0x20], ids=["bytes", "collective"])
def test_a_write_that_switches_the_automatic_point_off_has_one_diagnostic_a_run(make, name, collective):
    chip = set_up(make, AUTOMATIC, 0x15)
    chip.advance(5000)
    value = chip.values()[name]
    for _ in range(2):
        chip.write(0, select(name) | collective)
        for address in (3, 2):
            chip.write(address, value >> 8 * (address - 1) & 0xFF)
        assert len(chip.diagnostics) == (0 if collective and not _ else 1)
        chip.write(1, value & 0xFF)
    assert has_diagnostic(chip, name, "automatic")
    assert set(last_gaps(chip)) <= {20, 21}, "it stops from FH"
    load(chip, R0=5000)
    commands(chip, 0x08, 0x15)
    chip.advance(5000)
    load(chip, **{name: value})
    assert len(find_messages(chip, name, "automatic")) == len(chip.diagnostics) == 2, "the next run says it again"


@BOTH
@pytest.mark.parametrize("name", NAMES)
def test_a_write_in_motion_that_switches_nothing_off_has_no_diagnostic(make, name):
    for control, start in ((AUTOMATIC, 0x11), (MANUAL, 0x15), (PRESET, 0x15), (0x41, 0x15), (AUTOMATIC, 0x15)):
        chip = set_up(make, control, start)
        chip.advance(5000)
        load(chip, **{name: chip.values()[name]})
        preset_ramp = control & 0x04 and start == 0x15
        if not (preset_ramp and name in ("R0", "R6")) and not (
            preset_ramp and control == AUTOMATIC and name in SWITCH_OFF
        ):
            assert chip.diagnostics == [], (f"{control:02X}h", f"{start:02X}h")


@ALL
@pytest.mark.parametrize("name", ["R0", "R6"])
def test_r0_and_r6_written_in_a_high_speed_preset_run_have_a_diagnostic(make, name):
    chip = set_up(make, PRESET, 0x15)
    chip.advance(5000)
    load(chip, **{name: chip.values()[name]})
    assert len(find_messages(chip, name)) == len(chip.diagnostics) > 0


# What breaks no rule


def silent(make, control, start, **registers):
    chip = set_up(make, control, start, **registers)
    assert chip.diagnostics == []
    assert chip.advance(1_000_000) > 0
    return chip


@BOTH
def test_sound_set_ups_have_no_diagnostic(make):
    small = -20 & (1 << BITS[make]["R6"]) - 1
    silent(make, PRESET, 0x15)
    silent(make, 0x74, 0x17, R6=0)
    silent(make, 0x74, 0x15, R6=10)
    silent(make, 0x74, 0x15, R6=small)
    silent(make, 0x74, 0x15, R4=30, R5=3000)
    silent(make, 0x7C, 0x11, R6=0)
    silent(make, 0x50, 0x11)
    silent(make, 0x60, 0x10, R10=0x800000)
    silent(make, PRESET, 0x11, R6=0)
    silent(make, MANUAL, 0x15, R1=800)
    silent(make, MANUAL, 0x14, R1=815)
    silent(make, MANUAL, 0x11, R1=815)
    silent(make, PRESET, 0x15, R1=800, R6=0)
    silent(make, 0x41, 0x15, R13=0x200000)
    silent(make, 0x63, 0x15, R13=0x350000, R12=0x1000)


@BOTH
def test_an_ez_return_stays_set_up_during_other_moves(make):
    silent(make, PRESET, 0x15, R13=0x330000)
    silent(make, MANUAL, 0x15, R13=0x330000)
    silent(make, PRESET, 0x15, R13=0x030000)


def test_sound_s_curves_have_no_diagnostic():
    for r14, r15 in ((0, 0), (200, 200), (200, 100), (4095, 4095), (4095, 0), (0, 4095), (NO_CORRECTION, 0)):
        silent(PCL240MS, PRESET, 0x15, R14=r14, R15=r15)
        silent(PCL240MS, AUTOMATIC, 0x15, R14=r14, R15=r15)
        silent(PCL240MS, AUTOMATIC, 0x11, R14=r14, R15=r15)
    silent(PCL240MS, MANUAL, 0x15, R14=100, R15=200)
    silent(PCL240MS, MANUAL, 0x11, R14=LINEAR | 100)


@BOTH
def test_commands_and_reads_of_the_extension_have_no_diagnostic(make):
    chip = make()
    for command in (
        *range(0x90, 0x98),
        *range(0xB0, 0xB8),
        *range(0xA0, 0xA8),
        0xC8,
        0xC9,
        0xC0,
        0x50,
        0x60,
        0x7F,
        0x08,
    ):
        chip.write(0, command)
        for address in range(4):
            chip.read(address)
    load(chip, R10=0xFFFFFF, R11=0xFFFFFF, R12=0xFFFFFF, R16=0xFFFFFF)
    assert chip.diagnostics == []


@BOTH
def test_a_diagnostic_says_when_where_what_and_on_whose_word(make):
    chip = make()
    chip.advance(77)
    load(chip, R1=0x012345)
    diagnostic = chip.diagnostics[0]
    assert (diagnostic.clock, diagnostic.address, diagnostic.value) == (77, 3, 0x01)
    assert "R1" in diagnostic.message
    assert diagnostic.source


def test_diagnostics_do_not_change_what_the_chip_does():
    """The same bytes on chips whose diagnostics were cleared and not."""
    chips = [set_up(PCL240MS, 0x50, 0x15, R14=LINEAR | 100) for _ in range(2)]
    for n in range(200):
        chips[1].diagnostics.clear()
        for chip in chips:
            chip.write(n % 4, n * 37 & 0xFF)
            chip.advance(100)
    assert chips[0].values() == chips[1].values()
    assert np.array_equal(chips[0].trace(10_000), chips[1].trace(10_000))


@ALL
@pytest.mark.parametrize(
    ("name", "least", "rest"),
    [("R0", 1, {}), ("R1", 1, {}), ("R2", 1, {"R1": 1}), ("R4", 2, {}), ("R5", 2, {}), ("R7", 2, {})],
)
def test_a_start_with_the_least_that_a_register_takes_is_sound_and_with_one_less_has_a_diagnostic(
    make, name, least, rest
):
    assert set_up(make, PRESET, 0x15, **rest, **{name: least}).diagnostics == []
    assert find_messages(set_up(make, PRESET, 0x15, **rest, **{name: least - 1}), name)


@BOTH
def test_fl_may_be_as_high_as_fh_and_no_higher(make):
    assert set_up(make, PRESET, 0x15, R1=800).diagnostics == []
    assert find_messages(set_up(make, PRESET, 0x15, R1=801), "R1", "R2")
    assert set_up(make, PRESET, 0x17, R1=810).diagnostics == []
    assert find_messages(set_up(make, PRESET, 0x17, R1=901), "R1", "R3")


# What a bus or the silicon cannot take


@ALL
@pytest.mark.parametrize(("fl", "fh", "start", "text"), [(50, 8191, 0x15, 1), (8191, 50, 0x11, 0), (50, 8191, 0x10, 0)])
def test_an_output_beyond_the_silicon_has_one_diagnostic(make, fl, fh, start, text):
    """30 pps a step: 245,730 pps. With R7 = 19 it is 258,663."""
    for r7, count in ((20, 0), (19, text)):
        chip = make()
        load(chip, R0=5000, R1=fl, R2=fh, R4=30, R5=30, R6=5000, R7=r7)
        for command in (0x40, start, start, 0x08, start):
            commands(chip, command)
        assert len(find_messages(chip, "245,730", "R7")) == len(chip.diagnostics) == count


def test_a_speed_change_beyond_the_silicon_has_a_diagnostic():
    chip = set_up(PCL240MS, 0x40, 0x15, R7=10, R3=5000)
    commands(chip, 0x17)
    assert has_diagnostic(chip, "245,730", "R3 = 5000", "300,000 pps")


def test_a_triangle_below_a_tenth_of_a_steep_ramp_has_a_diagnostic_if_pulses_are_missing():
    """FL 240 pps, FH 244 kpps: it stops at 24 kpps, dozens of pulses before FL. One that lacks a few is as good as can be."""
    steep = {"R0": 1806, "R1": 8, "R2": 8131, "R4": 213, "R5": 207, "R7": 20, "R14": 1809, "R15": 1668}
    at_half = 1806 * 207 // (213 + 207)
    assert has_diagnostic(set_up(PCL240MS, PRESET, 0x15, **steep, R6=at_half), "stops at 23,", "FL is 240 pps")
    assert set_up(PCL240MS, PRESET, 0x15, **steep, R6=at_half + 100).diagnostics == []


def test_an_s_curve_triangle_that_nobody_corrects_and_that_stops_above_fl_has_a_diagnostic_with_its_speed():
    """FL 100 pps, FH 50,000 pps. What the diagnostic says is what happens."""
    sound = {"R1": 10, "R2": 5000, "R4": 1500, "R5": 1500, "R7": 60, "R0": 9000}
    chip = set_up(PCL240MS, AUTOMATIC, 0x15, **sound, R14=0x8000 | 500, R15=500)
    text = find_messages(chip, "FH correction", "R14 bit 15", "FL is 100 pps")
    assert len(text) == len(chip.diagnostics) == 1
    last = np.diff(chip.trace(FOREVER)["clock"][-2:])[0]
    stops = float(text[0].split("stops at ")[1].split(" pps")[0].replace(",", ""))
    assert stops > 1000
    assert stops == pytest.approx(chip.clock_hz / last, rel=0.01)
    for r14 in (500, 0x9000):
        assert not find_messages(set_up(PCL240MS, AUTOMATIC, 0x15, **sound, R14=r14, R15=500), "triangle", "stops at")
    assert find_messages(
        set_up(PCL240MS, PRESET, 0x15, **sound, R6=100, R14=500, R15=500), "without the automatic point"
    )
    assert set_up(PCL240MS, PRESET, 0x15, **sound | {"R0": 200_000}, R6=170_000, R14=500, R15=500).diagnostics == []
