"""What the PCL-240MK and PCL-240MS do beyond the PCL-240K: registers, bus, position counter, automatic ramp-down point.

Sentence by sentence from "Differences between PCL-240MK and PCL-240MS" and spec sections 2 to 5 and 7.
"""

import numpy as np
import pytest
from support.pcl240k_bench import FOREVER, RNG, SEED, clocks_while, commands, counter, operating
from support.pcl240ms_bench import AUTOMATIC, LINEAR, load
from support.pcl240ms_hands import (
    ALL,
    AT_FH,
    AT_FL,
    BITS,
    BOTH,
    K_BITS,
    NAMES,
    PLAIN,
    begun,
    kept,
    read_back,
    select,
)

from stage.chips import PCL240K, PCL240MK, PCL240MS

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
def test_every_register_holds_a_separate_value(make):
    chip = make()
    print(f"PULSESTAGE_SEED={SEED}")
    values = {name: int(RNG.integers(1 << 24)) & kept(make, name) for name in BITS[make]}
    if "R13" in values:  # an EZ count, and EZ read the other way round, would show in R17
        values |= {"R13": values["R13"] & 0xF0FFFF, "R12": values["R12"] & ~0x1000}
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
    pulses = chip.advance(5000)
    assert read_back(chip, "R0") == 1000 - pulses < 900


@pytest.mark.parametrize(("make", "rate"), [(PCL240MK, 0x3FFF), (PCL240MS, 0xFFFF), (PCL240MS, 0x8000)])
def test_a_rate_of_all_its_bits_acts(make, rate):
    chip = begun(make, R1=500, R2=503, R4=rate, R5=rate, R14=LINEAR)
    assert clocks_while(chip, "fup") == 3 * rate
    chip.write(0, 0x14)
    assert clocks_while(chip, "fdown") == 3 * rate


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
def test_waiting_bytes_persist_across_transfers_and_selects(make):
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
def test_waiting_bytes_are_0_at_power_up_and_after_reset(make):
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
def test_a_collective_read_latches_all_bytes_at_the_read_of_the_high_byte(make):
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


def test_the_k_has_no_collective_transfers():
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
    pulses = chip.advance(30_000)
    chip.pins.org = True
    pulses += chip.advance(1000)
    assert not operating(chip)
    assert read_back(chip, "R10") == (1000 - pulses) % 2**24


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
    pulses = chip.advance(10_000)
    assert read_back(chip, "R10") == 100 + pulses
    chip.write(0, 0x40)
    chip.advance(10_000)
    assert read_back(chip, "R10") == 100 + pulses


@BOTH
def test_r10_counts_output_pulses_even_while_r0_counts_extp(make):
    chip = begun(make, 0x60, 0x08, R0=9)
    commands(chip, 0xD0, 0x11)
    pulses = chip.advance(10_000)
    chip.pins.extp = True
    pulses += chip.advance(100)
    chip.pins.extp = False
    pulses += chip.advance(100)
    assert chip.values()["R0"] == 8
    assert chip.values()["R10"] == pulses


@BOTH
def test_r10_can_be_written_in_motion(make):
    chip = begun(make, 0x60, 0x11)
    chip.advance(10_000)
    load(chip, R10=0xFFFFFF)
    pulses = chip.advance(10_000)
    assert read_back(chip, "R10") == pulses - 1


@ALL
def test_control_bits_4_and_5_mean_nothing_on_the_k_and_much_on_mk_and_ms(make):
    unmodified, both = (begun(make, control, 0x15, R0=3000) for control in (0x44, 0x74))
    traces = [chip.trace(FOREVER)["clock"].tolist() for chip in (unmodified, both)]
    assert [len(trace) for trace in traces] == [3000, 3000]
    assert (traces[0] == traces[1]) == (make is PCL240K)


# Resuming


@BOTH
def test_residual_pulses_are_output_after_the_reset_command_r6_written_again_and_a_start(make):
    for r6, last in ((700, AT_FL), (0, AT_FH)):
        chip = begun(make, PLAIN, 0x15, R0=5000, R6=700)
        pulses = chip.advance(60_000)
        chip.write(0, 0x1F)
        pulses += chip.advance(100_000)
        assert counter(chip) == 5000 - pulses > 2000
        chip.write(0, 0x08)
        if r6:
            load(chip, R6=r6)
        chip.write(0, 0x15)
        clocks = chip.trace(FOREVER)["clock"]
        assert pulses + len(clocks) == 5000
        assert set(np.diff(clocks[-5:])) <= set(last), "08h cleared R6: who does not write it again stops from FH"


@BOTH
def test_residual_pulses_under_the_automatic_point_ramp_down_again(make):
    chip = begun(make, AUTOMATIC, 0x15, R0=5000, R6=5)
    pulses = chip.advance(60_000)
    commands(chip, 0x08)
    pulses += chip.advance(1000)
    load(chip, R6=5)
    commands(chip, 0x15)
    clocks = chip.trace(FOREVER)["clock"]
    assert pulses + len(clocks) == 5000
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
    assert clocks_while(chip, "fdown") == 250 * 33 + 32


def curve_with(name, value, ramp, steps_taken):
    """Clocks between the speed steps of a curve up (15h) or down (14h); one of its registers is written after `taken` steps."""
    chip = begun(PCL240MS, start=0x14, R4=20, R5=20, R14=100, R15=100)
    if ramp == 0x14:
        commands(chip, 0x15)
        clocks_while(chip, "fup")
    journal = chip.journal()
    commands(chip, ramp)
    started = chip.state["speed"]
    clocks_while(chip, lambda chip: abs(chip.state["speed"] - started) < steps_taken)
    load(chip, **{name: value})
    chip.advance(100_000)
    edges = journal.replay_waveforms().edges
    return np.diff(edges["clock"][np.flatnonzero(np.diff(edges["speed"])) + 1])


@pytest.mark.parametrize("steps_taken", [1, 90, 300, 700])
@pytest.mark.parametrize(
    ("names", "ramp", "rate"), [(("R4", "R14"), 0x15, 40), (("R5", "R15"), 0x14, 40), (("R4", "R14"), 0x15, 7)]
)
def test_a_rate_revised_inside_an_s_curve_scales_the_times_of_the_steps_after_the_next(names, ramp, rate, steps_taken):
    """R4 = 20, then `rate`: the step that was on its way comes as it would have; the curve keeps its shape."""
    usual, revised = curve_with("R6", 0, ramp, steps_taken), curve_with(names[0], rate, ramp, steps_taken)
    assert len(usual) == len(revised) == 749
    assert (revised[:steps_taken] == usual[:steps_taken]).all()
    assert revised[steps_taken:] == pytest.approx(usual[steps_taken:] * rate / 20, abs=1 + rate / 20)
    assert revised[steps_taken:].sum() == pytest.approx(usual[steps_taken:].sum() * rate / 20, abs=2 + rate / 20)


@pytest.mark.parametrize(("name", "ramp"), [("R14", 0x15), ("R15", 0x14)])
@pytest.mark.parametrize("steps_taken", [1, 90, 300, 700])
def test_a_span_revised_inside_an_s_curve_shapes_the_steps_after_the_next(name, ramp, steps_taken):
    usual, revised = curve_with("R6", 0, ramp, steps_taken), curve_with(name, 40, ramp, steps_taken)
    begun_so = curve_with(name, 40, ramp, 0)
    assert (revised[:steps_taken] == usual[:steps_taken]).all()
    assert (revised[steps_taken:] == begun_so[steps_taken:]).all()


@BOTH
@pytest.mark.parametrize("name", ["R2", "R3"])
def test_writing_the_selected_speed_in_motion_starts_a_ramp(make, name):
    chip = begun(make, start=0x15 if name == "R2" else 0x17, R2=400, R3=400, R4=20, R5=30)
    clocks_while(chip, "fup")
    load(chip, **{name: 900})
    assert clocks_while(chip, "fup") == 500 * 20
    assert chip.advance(8192 * 2 * 10) == 9000
    load(chip, **{"R3" if name == "R2" else "R2": 50})
    assert chip.advance(8192 * 2 * 10) == 9000, "the other register has no influence"


def test_a_new_goal_inside_an_s_curve_starts_a_curve_from_the_present_speed():
    chip = begun(PCL240MS, R2=400, R4=20, R14=0)
    journal = chip.journal()
    chip.advance(4000)
    speed = int(journal.replay_waveforms().edges["speed"][-1])
    assert 50 < speed < 400
    load(chip, R2=1000)
    assert clocks_while(chip, "fup") == (1000 - speed) * 20
