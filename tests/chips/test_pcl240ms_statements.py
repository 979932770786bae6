"""What the PCL-240MK and PCL-240MS do beyond the PCL-240K: registers, bus, position counter, automatic ramp-down point.

Sentence by sentence from "Differences between PCL-240MK and PCL-240MS" and spec sections 2 to 5 and 7.
"""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from pcl240k_bench import FOREVER, RNG, SEED, clocks_while, commands, counter, operating
from pcl240k_programs import real_programs, register
from pcl240ms_bench import AUTOMATIC, LINEAR, NO_CORRECTION, load

from stage.chips import PCL240K, PCL240MK, PCL240MS

BOTH = pytest.mark.parametrize("make", [PCL240MK, PCL240MS])
ALL = pytest.mark.parametrize("make", [PCL240K, PCL240MK, PCL240MS])
PLAIN = 0x44  # control mode: preset, without the automatic ramp-down point

K_BITS = {"R0": 24, "R1": 13, "R2": 13, "R3": 13, "R4": 14, "R5": 14, "R6": 20, "R7": 10}
EXTENSION_BITS = {"R10": 24, "R11": 24, "R12": 24, "R13": 24, "R14": 16, "R15": 12, "R16": 24, "R17": 24}
BITS = {
    PCL240K: K_BITS,
    PCL240MK: K_BITS | EXTENSION_BITS | {"R13": 23},  # its bit 23 "is fixed as 0"
    PCL240MS: K_BITS | EXTENSION_BITS | {"R4": 16, "R5": 16, "R6": 24},
}
READ_ONLY = {"R17": 0x1F0000}
NAMES = tuple(BITS[PCL240MS])
SWITCH_OFF = ("R1", "R4", "R5", "R14", "R15")  # writing one in motion disables the automatic point


def select(name):
    """R0 is 80h, R7 87h, R10 90h, R17 97h."""
    return (0x90 if len(name) == 3 else 0x80) | int(name[-1])


def begun(make, control=0x40, start=0x15, **registers):
    """A chip that was just started. Unless told otherwise FL 50, FH 800: 20.48 clocks a pulse, 327.68 at FL."""
    chip = make()
    load(chip, **{"R0": 0xFFFFFF, "R1": 50, "R2": 800, "R3": 800, "R4": 30, "R5": 30, "R7": 2, **registers})
    commands(chip, control, start)
    return chip


def read_back(chip, name):
    """A register's value over the bus, in extension mode."""
    commands(chip, 0xC8, select(name))
    return counter(chip)


def kept(make, name):
    """The bits of a register that a write can set."""
    return (1 << BITS[make][name]) - 1 & ~READ_ONLY.get(name, 0)


def wait_for(chip, pin):
    """Advance to the first clock with the pin asserted, however short it is."""
    state = chip.snapshot()
    while not getattr(chip.pins, pin):
        assert operating(chip), f"{pin} never came"
        state = chip.snapshot()
        chip.advance(300)
    chip.restore(state)
    while not getattr(chip.pins, pin):
        chip.advance(1)


def last_gaps(chip):
    """Run to the end; clocks between the last five pulses."""
    clocks = chip.trace(FOREVER)["clock"]
    assert not operating(chip)
    return np.diff(clocks[-5:])


AT_FH, AT_FL = (20, 21), (327, 328)


# Registers


@BOTH
@pytest.mark.parametrize("name", NAMES)
def test_a_register_keeps_the_bits_of_its_width_and_reads_back_in_extension_mode(make, name):
    chip = make()
    for value in (0xFFFFFF, 0, 0x555555, 0xAAAAAA, *(1 << n for n in range(24))):
        load(chip, **{name: value})
        assert read_back(chip, name) == value & kept(make, name), f"{value:06X}h"
        assert chip.values()[name] == value & kept(make, name)


@ALL
def test_every_register_holds_its_own_value(make):
    chip = make()
    print(f"PULSESTAGE_SEED={SEED}")
    values = {name: int(RNG.integers(1 << 24)) & kept(make, name) for name in BITS[make]}
    values |= {"R13": values["R13"] & 0xF0FFFF} if "R13" in values else {}  # an EZ count would show in R17
    load(chip, **values)
    assert {name: chip.values()[name] for name in values} == values
    if make is not PCL240K:
        assert {name: read_back(chip, name) for name in values} == values


@ALL
def test_a_read_gives_r0_whatever_is_selected_unless_extension_mode_is_on(make):
    chip = make()
    load(chip, **dict.fromkeys(BITS[make], 0xFFFFFF) | {"R0": 0x123456})
    for name in BITS[make]:
        commands(chip, select(name))
        assert counter(chip) == 0x123456
    load(chip, R2=777)
    commands(chip, 0xC8)
    assert counter(chip) == (0x123456 if make is PCL240K else 777)
    commands(chip, 0xC0)
    assert counter(chip) == 0x123456


def test_the_k_has_no_extension_registers_90h_selects_r0():
    chip = PCL240K()
    load(chip, R0=5)
    load(chip, R10=7)
    assert counter(chip) == 7
    assert set(chip.values()) == {*K_BITS, "status"}


@BOTH
def test_extension_mode_gates_reading_alone(make):
    """Control bits 4 and 5 latch, registers are written and curves are run with it on or off."""
    programs = [begun(make, AUTOMATIC | 0x20, 0x08, R0=2000, R13=5, R14=100, R15=50, R12=0x1000) for _ in range(2)]
    programs[1].write(0, 0xC8)
    traces = []
    for chip in programs:
        chip.write(0, 0x15)
        traces.append(chip.trace(FOREVER).tolist())
    assert traces[0] == traces[1]
    assert len(traces[0]) == 2000
    assert [read_back(chip, "R10") for chip in programs] == [2000, 2000]


@BOTH
def test_all_registers_are_0_at_power_up(make):
    chip = make()
    for name in NAMES:
        assert read_back(chip, name) == 0, name


@BOTH
def test_r0_reads_back_live_in_extension_mode(make):
    chip = begun(make, start=0x11, R0=1000)
    made = chip.advance(5000)
    assert read_back(chip, "R0") == 1000 - made < 900


@pytest.mark.parametrize(("make", "rate"), [(PCL240MK, 0x3FFF), (PCL240MS, 0xFFFF), (PCL240MS, 0x8000)])
def test_a_rate_of_all_its_bits_acts(make, rate):
    chip = begun(make, R1=500, R2=503, R4=rate, R5=rate, R14=LINEAR)
    assert clocks_while(chip, "fup") == 3 * rate
    chip.write(0, 0x14)
    assert clocks_while(chip, "fdown") == 2 * rate + 1


@ALL
def test_lt_compares_r6_unsigned_with_all_its_bits(make):
    chip = make()
    top = 1 << BITS[make]["R6"] - 1
    load(chip, R0=top - 1, R6=top)
    commands(chip, PLAIN)
    assert chip.pins.lt
    load(chip, R0=top)
    assert not chip.pins.lt
    load(chip, R6=0)
    assert not chip.pins.lt


@ALL
@pytest.mark.parametrize("command", [0x08, 0x28])
@pytest.mark.parametrize("start", [0x15, 0x08], ids=["running", "halted"])
def test_the_reset_command_clears_r6_on_mk_and_ms_and_nothing_else(make, command, start):
    values = {name: 0x0A5A5A & kept(make, name) for name in BITS[make]} | {"R7": 2, "R0": 0x123456}
    chip = begun(make, 0x48, start, **values)
    load(chip, R6=0x0A5A5)
    before = chip.values()
    chip.write(0, command)
    after = chip.values()
    changed = {name for name in values if before[name] != after[name]}
    assert changed == (set() if make is PCL240K else {"R6"})
    assert after["R6"] == (0x0A5A5 if make is PCL240K else 0)
    assert chip.pins.pdir, "the control mode stays"


# Collective input and output


@BOTH
@pytest.mark.parametrize("name", NAMES)
def test_a_collective_write_holds_the_high_bytes_and_transfers_all_with_the_low_byte(make, name):
    chip = make()
    load(chip, **{name: 0})
    chip.write(0, select(name) | 0x20)
    for order in ((3, 2), (2, 3)):
        for address in order:
            chip.write(address, 0x5A)
            assert chip.values()[name] == 0, "held"
        chip.write(1, 0xA5)
        assert chip.values()[name] == 0x5A5AA5 & kept(make, name)
        chip.write(3, 0)
        chip.write(2, 0)
        chip.write(1, 0)


@BOTH
def test_held_bytes_persist_across_transfers_and_selects(make):
    chip = make()
    chip.write(0, 0xA0)
    chip.write(3, 0x12)
    chip.write(2, 0x34)
    chip.write(0, 0x80)
    chip.write(0, 0xB0)
    chip.write(1, 0x56)
    assert chip.values()["R10"] == 0x123456
    assert chip.values()["R0"] == 0
    chip.write(1, 0x78)
    assert chip.values()["R10"] == 0x123478
    commands(chip, 0xA1, 0x08, 0x44, 0xC8)
    chip.write(1, 0x05)
    assert chip.values()["R1"] == 0x1405, "and the width of the register cuts them"


@BOTH
def test_held_bytes_are_0_at_power_up_and_after_reset(make):
    chip = make()
    chip.write(0, 0xA0)
    chip.write(1, 0x07)
    assert counter(chip) >> 8 == chip.values()["R0"] >> 8 == 0
    chip.write(2, 0x55)
    chip.reset()
    chip.write(0, 0xA0)
    chip.write(1, 0x07)
    assert chip.values()["R0"] == 7


@BOTH
def test_a_collective_write_changes_the_speed_once_and_byte_writes_tear_it(make):
    for collective in (0x20, 0):
        chip = begun(make, start=0x11, R2=0x01FF)
        chip.advance(10_000)
        chip.write(0, 0x82 | collective)
        chip.write(2, 0x02)
        chip.advance(1)
        assert chip.advance(8192 * 2 * 10) == (0x01FF if collective else 0x02FF) * 10
        chip.write(1, 0x00)
        chip.advance(1)
        assert chip.advance(8192 * 2 * 10) == 0x0200 * 10


@BOTH
def test_a_collective_read_latches_the_whole_value_at_the_read_of_the_high_byte(make):
    chip = begun(make, start=0x11, R0=0x010000)
    chip.write(0, 0xA0)
    high = chip.read(3)
    chip.advance(100_000)
    assert (high, chip.read(2), chip.read(1)) == (0x01, 0x00, 0x00)
    chip.advance(100_000)
    assert (chip.read(2), chip.read(1)) == (0x00, 0x00), "without a high read: the last latch"
    assert chip.read(3) == 0x00
    left = chip.values()["R0"]
    chip.advance(100_000)
    assert chip.read(2) << 8 | chip.read(1) == left
    chip.write(0, 0x80)
    assert counter(chip) == chip.values()["R0"] < left, "without bit 5: live bytes"


@BOTH
def test_the_latch_of_a_collective_read_outlives_a_select_and_is_0_at_power_up(make):
    chip = make()
    load(chip, R0=0x123456, R10=0x654321)
    commands(chip, 0xC8, 0xA0)
    assert (chip.read(2), chip.read(1)) == (0, 0)
    chip.read(3)
    commands(chip, 0xB0)
    assert (chip.read(2), chip.read(1)) == (0x34, 0x56)
    assert counter(chip) == 0x654321, "high first"
    commands(chip, 0xC0)
    assert counter(chip) == 0x123456, "extension mode off: R0 is latched"


def test_the_k_knows_no_collective_input_and_output():
    chip = PCL240K()
    chip.write(0, 0xA0)
    chip.write(3, 0x12)
    assert counter(chip) == 0x120000


# Position counter


@BOTH
@pytest.mark.parametrize("control", [0x60, 0x64, 0x61, 0x74, 0x62], ids=lambda byte: f"{byte:02X}h")
@pytest.mark.parametrize("start", [0x10, 0x11, 0x15])
def test_r10_counts_every_output_pulse_by_direction_in_every_mode(make, control, start):
    chip = begun(make, control, start, R0=3000)
    position = chip.advance(30_000)
    assert read_back(chip, "R10") == position > 50
    commands(chip, control | 0x08)
    position -= chip.advance(20_000)
    assert read_back(chip, "R10") == position % 2**24
    chip.write(0, 0x1F)
    position -= chip.advance(100_000)
    chip.write(0, 0x08)
    assert read_back(chip, "R10") == position % 2**24, "the reset command keeps it"


@BOTH
def test_r10_counts_an_origin_return_to_its_last_pulse(make):
    chip = begun(make, 0x69, 0x15, R10=1000)
    made = chip.advance(30_000)
    chip.pins.org = True
    made += chip.advance(1000)
    assert not operating(chip)
    assert read_back(chip, "R10") == (1000 - made) % 2**24


@BOTH
@pytest.mark.parametrize(
    ("before", "control", "after"),
    [(0x7FFFFE, 0x64, 0x800003), (0xFFFFFE, 0x64, 3), (2, 0x6C, 0xFFFFFD), (0x800001, 0x6C, 0x7FFFFC)],
)
def test_r10_is_a_two_s_complement_number_of_24_bits_that_wraps(make, before, control, after):
    chip = begun(make, control, 0x11, R0=5, R10=before)
    assert chip.advance(FOREVER) == 5
    assert read_back(chip, "R10") == chip.values()["R10"] == after


@BOTH
def test_r10_counts_only_while_control_bit_5_enables_it(make):
    chip = begun(make, 0x40, 0x11, R10=100)
    assert chip.advance(10_000) > 400
    assert read_back(chip, "R10") == 100
    chip.write(0, 0x60)
    made = chip.advance(10_000)
    assert read_back(chip, "R10") == 100 + made
    chip.write(0, 0x40)
    chip.advance(10_000)
    assert read_back(chip, "R10") == 100 + made


@BOTH
def test_r10_counts_output_pulses_even_while_r0_counts_extp(make):
    chip = begun(make, 0x60, 0x08, R0=9)
    commands(chip, 0xD0, 0x11)
    made = chip.advance(10_000)
    chip.pins.extp = True
    made += chip.advance(100)
    chip.pins.extp = False
    made += chip.advance(100)
    assert chip.values()["R0"] == 8
    assert chip.values()["R10"] == made


@BOTH
def test_r10_can_be_written_in_motion(make):
    chip = begun(make, 0x60, 0x11)
    chip.advance(10_000)
    load(chip, R10=0xFFFFFF)
    made = chip.advance(10_000)
    assert read_back(chip, "R10") == made - 1


@ALL
def test_control_bits_4_and_5_mean_nothing_on_the_k_and_much_on_mk_and_ms(make):
    plain, both = (begun(make, control, 0x15, R0=3000) for control in (0x44, 0x74))
    traces = [chip.trace(FOREVER)["clock"].tolist() for chip in (plain, both)]
    assert [len(trace) for trace in traces] == [3000, 3000]
    assert (traces[0] == traces[1]) == (make is PCL240K)


# Resuming


@BOTH
def test_residual_pulses_are_output_after_the_reset_command_r6_written_again_and_a_start(make):
    for r6, last in ((700, AT_FL), (0, AT_FH)):
        chip = begun(make, PLAIN, 0x15, R0=5000, R6=700)
        made = chip.advance(60_000)
        chip.write(0, 0x1F)
        made += chip.advance(100_000)
        assert counter(chip) == 5000 - made > 2000
        chip.write(0, 0x08)
        if r6:
            load(chip, R6=r6)
        chip.write(0, 0x15)
        clocks = chip.trace(FOREVER)["clock"]
        assert made + len(clocks) == 5000
        assert set(np.diff(clocks[-5:])) <= set(last), "08h cleared R6: who does not write it again stops from FH"


@BOTH
def test_residual_pulses_under_the_automatic_point_ramp_down_again(make):
    chip = begun(make, AUTOMATIC, 0x15, R0=5000, R6=5)
    made = chip.advance(60_000)
    commands(chip, 0x08)
    made += chip.advance(1000)
    load(chip, R6=5)
    commands(chip, 0x15)
    clocks = chip.trace(FOREVER)["clock"]
    assert made + len(clocks) == 5000
    assert min(np.diff(clocks[-3:])) >= 327


# Speed and rates in motion (3-5)


@pytest.mark.parametrize(("make", "r14"), [(PCL240MK, 0), (PCL240MS, LINEAR)])
def test_linear_ramps_follow_a_rate_written_in_motion_at_once(make, r14):
    chip = begun(make, R2=400, R4=20, R5=20, R14=r14)
    chip.advance(100 * 20)
    load(chip, R4=33)
    assert clocks_while(chip, "fup") == 250 * 33
    chip.write(0, 0x14)
    chip.advance(1 + 99 * 20)
    load(chip, R5=33)
    assert clocks_while(chip, "fdown") == 250 * 33


@pytest.mark.parametrize(
    ("name", "pin", "start", "back"),
    [(n, "fup", 0x15, 0x14) for n in ("R4", "R14")] + [(n, "fdown", 0x14, 0x15) for n in ("R5", "R15")],
)
def test_an_s_curve_keeps_the_rate_and_span_it_began_with_and_the_next_one_has_the_new_ones(name, pin, start, back):
    def curve(chip, written=()):
        commands(chip, start)
        begin = chip.clock
        chip.advance(5000)
        load(chip, **dict.fromkeys(written, 40))
        clocks_while(chip, pin)
        return chip.clock - begin

    chip = begun(PCL240MS, start=0x14, R4=20, R5=20, R14=100, R15=100)
    if start == 0x14:
        commands(chip, 0x15)
        clocks_while(chip, "fup")
    before = chip.snapshot()
    usual = curve(chip)
    chip.restore(before)
    assert curve(chip, [name]) == usual
    commands(chip, back)
    clocks_while(chip, "fdown" if pin == "fup" else "fup")
    assert curve(chip) != usual


@BOTH
@pytest.mark.parametrize("name", ["R2", "R3"])
def test_the_selected_speed_register_written_in_motion_starts_a_ramp_of_its_own_length(make, name):
    chip = begun(make, start=0x15 if name == "R2" else 0x17, R2=400, R3=400, R4=20, R5=30)
    clocks_while(chip, "fup")
    load(chip, **{name: 900})
    assert clocks_while(chip, "fup") == 500 * 20
    assert chip.advance(8192 * 2 * 10) == 9000
    load(chip, **{"R3" if name == "R2" else "R2": 50})
    assert chip.advance(8192 * 2 * 10) == 9000, "the other register has no influence"


def test_a_new_goal_inside_an_s_curve_starts_a_curve_from_the_speed_there():
    chip = begun(PCL240MS, R2=400, R4=20, R14=0)
    journal = chip.journal()
    chip.advance(4000)
    speed = int(journal.course().edges["speed"][-1])
    assert 50 < speed < 400
    load(chip, R2=1000)
    assert clocks_while(chip, "fup") == (1000 - speed) * 20


# Automatic ramp-down point


@BOTH
@pytest.mark.parametrize("rates", [(30, 30), (30, 300), (300, 30), (30, 2)], ids=str)
def test_the_automatic_point_decelerates_on_r4_and_leaves_r5_alone(make, rates):
    up, down = rates
    r0 = 1000 * up
    chip = begun(make, AUTOMATIC, 0x15, R0=r0, R4=up, R5=down, R6=10)
    same = begun(make, AUTOMATIC, 0x15, R0=r0, R4=up, R5=up, R6=10)
    assert (chip.trace(FOREVER) == same.trace(FOREVER)).all()
    assert not operating(chip)


def test_the_automatic_ramp_down_of_the_mk_is_linear_with_r4():
    chip = begun(PCL240MK, AUTOMATIC, 0x15, R0=3000, R4=30, R5=77, R6=10)
    assert clocks_while(chip, "fup") == 750 * 30
    wait_for(chip, "fdown")
    assert clocks_while(chip, "fdown") == 749 * 30
    assert 8 <= counter(chip) <= 12, "R6 = 10 pulses early"


@BOTH
def test_a_deceleration_before_the_automatic_point_is_on_r5(make):
    chip = begun(make, AUTOMATIC, 0x15, R0=50_000, R4=30, R5=77, R14=LINEAR)
    clocks_while(chip, "fup")
    chip.write(0, 0x14)
    assert clocks_while(chip, "fdown") == 749 * 77 + 1


@BOTH
def test_r6_is_an_offset_positive_earlier_negative_later(make):
    points = []
    for offset in (200, 0, -200):
        chip = begun(make, AUTOMATIC, 0x15, R0=3000, R6=offset & 0xFFFFFF)
        clocks_while(chip, "fup")
        wait_for(chip, "fdown")
        points.append(counter(chip))
        assert chip.advance(FOREVER) == points[-1]
    assert np.diff(points).tolist() == [-200, -200]


@BOTH
def test_r6_reaches_from_the_most_negative_to_the_most_positive_offset(make):
    sign = 1 << BITS[make]["R6"] - 1
    never = begun(make, AUTOMATIC, 0x15, R0=3000, R6=sign)
    assert set(last_gaps(never)) <= set(AT_FH)
    at_once = begun(make, AUTOMATIC, 0x15, R0=3000, R6=sign - 1)
    assert set(np.diff(at_once.trace(FOREVER)["clock"])) == set(AT_FL), "no ramp-up at all"


@BOTH
def test_a_ramp_up_after_sd_adds_to_the_count_of_the_automatic_point(make):
    chip = begun(make, AUTOMATIC | 0x02, 0x15, R0=5000, R14=LINEAR)
    rising = chip.advance(750 * 30)
    chip.pins.sd_plus = True
    chip.advance(750 * 30)
    chip.pins.sd_plus = False
    rising += chip.advance(750 * 30)
    assert rising > 1000
    wait_for(chip, "fdown")
    assert counter(chip) == pytest.approx(rising, abs=2)


@pytest.mark.parametrize("r14", [0, LINEAR, 100], ids=["S-curve", "linear", "with a linear part"])
def test_the_fh_correction_makes_no_triangle_and_changes_no_register(r14):
    """A triangle goes from FUP to FDOWN; corrected, the chip keeps its top speed for some clocks."""
    for bits, kept_at_top in ((0, True), (NO_CORRECTION, False)):
        chip = begun(PCL240MS, AUTOMATIC, 0x15, R0=700, R14=r14 | bits, R15=r14 & 0xFFF)
        before = [chip.values()[name] for name in NAMES[1:]]
        journal = chip.journal()
        chip.advance(FOREVER)
        assert [chip.values()[name] for name in NAMES[1:]] == before
        course = journal.course()
        speed = course.edges["speed"]
        assert 400 < speed.max() < 800
        assert (course.pin("fkeep") & (speed == speed.max())).any() == kept_at_top


@BOTH
def test_without_the_automatic_point_r6_is_the_point_itself(make):
    chip = begun(make, PLAIN, 0x15, R0=3000, R6=700)
    clocks_while(chip, lambda chip: not chip.pins.lt)
    assert counter(chip) == 699
    assert chip.pins.fdown
    assert set(last_gaps(chip)) <= set(AT_FL)


@BOTH
@pytest.mark.parametrize("when", [5000, 40_000], ids=["ramping up", "at FH"])
@pytest.mark.parametrize("name", NAMES)
def test_r1_r4_r5_r14_r15_written_in_motion_disable_the_automatic_point_and_no_other_register_does(make, name, when):
    """Written with the value that it holds already, collectively, so that nothing but the writing can act."""
    chip, undisturbed = (begun(make, AUTOMATIC, 0x15, R0=4000) for _ in range(2))
    chip.advance(when)
    value = chip.values()[name]
    chip.write(0, select(name) | 0x20)
    for address in (3, 2, 1):
        chip.write(address, value >> 8 * (address - 1) & 0xFF)
    undisturbed.advance(when)
    rest, usual = (c.trace(FOREVER)["clock"] for c in (chip, undisturbed))
    assert len(rest) == len(usual)
    if name in SWITCH_OFF:
        assert set(np.diff(rest[-5:])) <= set(AT_FH)
    else:
        assert (rest == usual).all()
    load(chip, R0=4000)
    begin = chip.clock
    commands(chip, 0x08, 0x15)
    fresh = begun(make, AUTOMATIC, 0x15, R0=4000)
    assert (chip.trace(FOREVER)["clock"] - begin == fresh.trace(FOREVER)["clock"]).all(), "the next run has it again"


@BOTH
@pytest.mark.parametrize("name", SWITCH_OFF)
def test_when_it_is_disabled_the_rule_r0_below_r6_is_back_and_the_deceleration_is_on_r5(make, name):
    chip = begun(make, AUTOMATIC, 0x15, R0=4000, R4=30, R5=40, R6=900, R14=LINEAR)
    chip.advance(5000)
    load(chip, **{name: chip.values()[name]})
    clocks_while(chip, "fup")
    wait_for(chip, "fdown")
    assert counter(chip) == 899
    assert clocks_while(chip, "fdown") == 749 * 40


@BOTH
@pytest.mark.parametrize("name", SWITCH_OFF)
def test_a_deceleration_already_begun_goes_on(make, name):
    chip, undisturbed = (begun(make, AUTOMATIC, 0x15, R0=4000) for _ in range(2))
    wait_for(chip, "fdown")
    chip.advance(3000)
    undisturbed.advance(chip.clock)
    load(chip, **{name: chip.values()[name]})
    assert (chip.trace(FOREVER) == undisturbed.trace(FOREVER)).all()
    assert chip.clock == undisturbed.clock


@BOTH
def test_registers_written_at_rest_disable_nothing(make):
    chip, undisturbed = (begun(make, AUTOMATIC, 0x08, R0=4000) for _ in range(2))
    load(chip, **{name: chip.values()[name] for name in SWITCH_OFF})
    for c in (chip, undisturbed):
        c.write(0, 0x15)
    assert (chip.trace(FOREVER) == undisturbed.trace(FOREVER)).all()


# /RESET


@BOTH
def test_reset_clears_registers_modes_held_bytes_and_latch(make):
    chip = begun(make, 0x75, 0x35, **{name: 0x0A5A5A for name in NAMES} | {"R7": 2, "R1": 50})
    commands(chip, 0xE9, 0xA0)
    chip.read(3)
    chip.write(3, 0x55)
    chip.write(2, 0x55)
    chip.advance(12_345)
    chip.reset()
    fresh = make()
    fresh.advance(12_345)
    for same in (chip, fresh):
        assert same.read(0) == 0b1010_1000, "no /INT, halted, FKEEP, ZERO"
        assert same.values() == fresh.values()
        assert {same.values()[name] for name in NAMES} == {0}
        commands(same, 0xB0)
        assert (same.read(2), same.read(1)) == (0, 0)
        same.write(1, 0x07)
        assert same.values()["R10"] == 7
        load(same, R0=4000, R1=50, R2=800, R4=30, R5=30, R7=2, R16=3)
        commands(same, 0x90)
        assert counter(same) == 4000, "extension mode off"
        same.diagnostics.clear()
        commands(same, 0x15)
        assert same.advance(30_000) > 400
        assert same.diagnostics == [], "armed, and no automatic point without preset left over"
        assert same.values()["R10"] == 7, "position counter off"
    assert (chip.trace(30_000) == fresh.trace(30_000)).all()


# Old software on new chips


def test_the_mk_has_no_s_curves_r14_and_r15_just_store():
    traces = []
    for r14, r15 in ((0, 0), (100, 50), (LINEAR | NO_CORRECTION, 0), (0x0FFF, 0x0FFF)):
        for r0 in (600, 3000):
            chip = begun(PCL240MK, AUTOMATIC, 0x15, R0=r0, R14=r14, R15=r15)
            traces.append((r0, chip.trace(FOREVER)["clock"].tolist()))
    assert traces[::2] == traces[:1] * 4
    assert traces[1::2] == traces[1:2] * 4


MASKS = tuple((1 << bits) - 1 for bits in K_BITS.values())


def as_written_for_an_mk(program, control=0):
    """A K program whose reset commands are followed by R6 again, within the widths; with `control` bits added."""
    selected, r6, out = 0, 0, []
    for operation in program:
        kind, *rest = operation
        if kind != "write":
            out.append(operation)
            continue
        address, value = rest
        if address:
            shift = 8 * (address - 1)
            value &= MASKS[selected] >> shift & (0x07 if (selected, address) == (6, 3) else 0xFF)  # R6 not negative
            if selected == 6:
                r6 = r6 & ~(0xFF << shift) | value << shift
        elif value >> 6 == 2:
            selected = value & 7
        elif value >> 6 == 1:
            value |= control
        out.append(("write", address, value))
        if address == 0 and value & 0xD8 == 0x08:
            out += [*register(6, r6), ("write", 0, 0x80 | selected)]
    return out


def life(make, program, **first):
    """The pulses of a program, and all that can be seen when time has passed or a pin has changed."""
    chip, seen = make(), []
    load(chip, **first)
    chip.write(0, 0x80)
    for kind, *rest in program:
        if kind == "write":
            chip.write(*rest)
            continue
        if kind == "pin":
            setattr(chip.pins, *rest)
        else:
            seen.append(chip.trace(*rest).tolist())
        seen.append((chip.read(0), counter(chip), *(getattr(chip.pins, name) for name in PCL240K.OUTPUTS)))
    return seen


same_programs = settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))


@same_programs
@given(real_programs)
def test_software_written_for_the_k_runs_on_mk_and_ms_to_the_clock(program):
    """If it writes R6 after the reset command, stays within the K's widths and, on the MS, takes linear ramps."""
    program = as_written_for_an_mk(program)
    expected = life(PCL240K, program)
    assert life(PCL240MK, program) == expected
    assert life(PCL240MS, program, R14=LINEAR) == expected


@same_programs
@given(real_programs)
def test_software_written_for_the_mk_runs_on_the_ms_to_the_clock_with_linear_ramps_and_no_fh_correction(program):
    program = as_written_for_an_mk(program, control=0x30)
    assert life(PCL240MK, program) == life(PCL240MS, program, R14=LINEAR | NO_CORRECTION)


def test_with_the_fh_correction_on_only_short_automatic_moves_differ_from_the_mk():
    shortest = (800**2 - 50**2) * 60 // (2 * 16384)
    for r0, control, same in ((3000, 0x54, True), (shortest - 200, 0x54, False), (shortest - 200, 0x44, True)):
        mk, ms, off = (
            begun(make, control, 0x15, R0=r0, R14=r14).trace(FOREVER)["clock"].tolist()
            for make, r14 in ((PCL240MK, 0), (PCL240MS, LINEAR), (PCL240MS, LINEAR | NO_CORRECTION))
        )
        assert mk == off
        assert (ms == mk) == same
        assert len(ms) == len(mk) == r0


def test_mk_software_that_knows_no_r14_gets_s_curves_on_the_ms_in_the_same_time():
    mk, ms = (begun(make, 0x40, 0x15) for make in (PCL240MK, PCL240MS))
    assert mk.trace(10_000).tolist() != ms.trace(10_000).tolist()
    assert clocks_while(mk, "fup") == clocks_while(ms, "fup") == 750 * 30 - 10_000
    constant = [begun(make, 0x44, 0x11, R0=500).trace(FOREVER).tolist() for make in (PCL240K, PCL240MK, PCL240MS)]
    assert constant[0] == constant[1] == constant[2]
    assert len(constant[0]) == 500


@pytest.mark.parametrize("offset", [-5, -100])
def test_a_negative_offset_written_with_all_24_bits_means_the_same_on_mk_and_ms(offset):
    traces = [
        begun(make, AUTOMATIC, 0x15, R0=3000, R6=offset & 0xFFFFFF, R14=LINEAR).trace(FOREVER).tolist()
        for make in (PCL240MK, PCL240MS)
    ]
    assert traces[0] == traces[1]
    twenty_bits = begun(PCL240MS, AUTOMATIC, 0x15, R0=3000, R6=offset & 0xFFFFF, R14=LINEAR)
    assert set(last_gaps(twenty_bits)) <= set(AT_FL), "20 bits of it are a large positive offset on the MS"
