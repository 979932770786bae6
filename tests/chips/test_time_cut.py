"""Where time is cut makes no difference, also where it is cut at the very clock at which something happens.

At rates that divide the reference clock evenly every pulse comes on a whole clock, so a cut can hit it. Short runs of every family
are cut at every single clock: a first clock, the rest up to the cut, the rest of the run.
"""

import copy

import pytest
from support.hctl1100_bench import bench
from support.hctl1100_programs import COMMAND, FINAL, acceleration, begin, gains, velocity, word
from support.nova_programs import command, load
from support.pcl240k_bench import commands
from support.pcl240ms_bench import load as load_registers

from stage.chips import CHIPS, HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS, STEPDIR

LONG = 1 << 40
"""Clocks, days: what has not ended by then goes on for ever."""
PCL240 = pytest.mark.parametrize("make", [PCL240K, PCL240MK, PCL240MS])
OLDER = pytest.mark.parametrize("make", [MCX302, MCX304, MCX312, CHIPS["MCX314AS"]])


def cut_everywhere(chip, clocks):
    """Cut these clocks of a chip wherever possible. Returns what they make in one piece: the clocks of the pulses."""
    start, uncut, short = chip.clock, copy.copy(chip), copy.copy(chip)
    pulses = uncut.trace(clocks)["clock"] - start
    end_snapshot = uncut.snapshot()
    for n in range(1, clocks + 1):
        cut = copy.copy(chip)
        pulse_count = cut.advance(1) + cut.advance(n - 1)
        short.advance(1)
        assert pulse_count == (pulses <= n).sum(), f"cut after {n} clocks"
        assert cut.snapshot().record == short.snapshot().record, f"cut after {n} clocks"
        pulse_count += cut.advance(clocks - n)
        assert pulse_count == len(pulses), f"cut after {n} clocks"
        assert cut.snapshot().record == end_snapshot.record, f"cut after {n} clocks"
    assert short.snapshot().record == end_snapshot.record
    return pulses.tolist()


def ends_after(chip, period, pulses, clocks):
    """Assert that a run makes so many evenly spaced pulses, however it is cut into pieces, and none later."""
    pulse_count = cut_everywhere(chip, clocks)
    assert pulse_count == [period * k for k in range(1, pulses + 1)]
    for n in (*pulse_count, clocks):
        cut = copy.copy(chip)
        assert cut.advance(1) + cut.advance(n - 1) + cut.advance(LONG) == pulses, f"cut after {n} clocks"


@PCL240
@pytest.mark.parametrize("speed", [4096, 2048, 1024])
@pytest.mark.parametrize("control", [0x44, 0x4C])
@pytest.mark.parametrize("start", [0x10, 0x11, 0x15])
def test_a_preset_move_at_a_power_of_two_ends_at_its_last_pulse(make, speed, control, start):
    """R0 = 10, R1 = R2 = 4096, R7 = 2: a pulse every 4 clocks; time cut at the 10th: it ran for ever"""
    chip = make()
    load_registers(chip, R0=10, R1=speed, R2=speed, R4=2, R5=2, R6=0, R7=2)
    commands(chip, control, start)
    period = 8192 * 2 // speed
    ends_after(chip, period, 10, 12 * period)


@PCL240
@pytest.mark.parametrize("r6", [1, 2, 5, 9])
def test_r6_is_passed_at_the_clock_of_a_pulse(make, r6):
    """At FH from the start, evenly; then FL is lower, and the ramp to it begins with a pulse."""
    chip = make()
    load_registers(chip, R0=10, R1=2048, R2=2048, R4=2, R5=9, R6=r6, R7=2)
    commands(chip, 0x44, 0x15)
    load_registers(chip, R1=1024)
    assert len(cut_everywhere(chip, 200)) == 10


@PCL240
@pytest.mark.parametrize("r0", [0, 1, 3])
def test_a_run_without_preset_counts_through_0_at_the_clock_of_a_pulse(make, r0):
    chip = make()
    load_registers(chip, R0=r0, R1=4096, R6=2, R7=2)
    commands(chip, 0x40, 0x10)
    assert cut_everywhere(chip, 40) == list(range(4, 41, 4))


@pytest.mark.parametrize("make", [PCL240MK, PCL240MS])
@pytest.mark.parametrize("offset", [0, 3, -3])
def test_the_automatic_point_comes_at_the_clock_of_a_pulse(make, offset):
    chip = make()
    load_registers(
        chip, R0=20, R1=2040, R2=2048, R4=8, R5=8, R6=offset & chip.MAP.register("R6").mask, R7=2, R14=0x9000
    )
    commands(chip, 0x54, 0x15)
    assert len(cut_everywhere(chip, 250)) == 20


@PCL240
def test_external_pulses_end_a_run_at_any_clock(make):
    chip = make()
    load_registers(chip, R0=1, R1=4096, R7=2)
    commands(chip, 0xD0, 0x44, 0x10)
    chip.pins.extp = True
    chip.advance(6)
    chip.pins.extp = False
    cut_everywhere(chip, 20)


@pytest.mark.parametrize("pps", [4_000_000, 1_000_000, 500_000])
def test_a_drive_of_the_mcx514_ends_at_its_last_pulse(pps):
    chip = MCX514()
    load(chip, SV=pps, DV=pps, TP=10)
    command(chip, "DRVRL")
    ends_after(chip, 16_000_000 // pps, 10, 12 * 16_000_000 // pps)


@OLDER
@pytest.mark.parametrize("v", [8000, 2000, 1000])
def test_a_drive_of_the_older_chips_ends_at_its_last_pulse(make, v):
    chip = make()
    load(chip, R=16_000, SV=v, V=v, A=1, P=10)
    command(chip, "F_DRV_P")
    ends_after(chip, 32_000 // v, 10, 12 * 32_000 // v)


def cruising(make):
    """Start a drive with a pulse every 16 clocks."""
    chip = make()
    if make is MCX514:
        load(chip, SV=1_000_000, DV=1_000_000, TP=10)
    else:
        load(chip, R=16_000, SV=2000, V=2000, A=1, P=10)
    return chip


@pytest.mark.parametrize("direction", [1, -1])
def test_comparisons_become_true_at_the_clock_of_a_pulse(direction):
    chip = cruising(MCX514)
    load(chip, MR0=5 * direction, MR1=5 * direction, MR2=5 * direction, MR3=5 * direction, TP=10 * direction)
    chip.write(6, 0b1100_1000_0100_0000)  # LP >=, >, =, < MR
    command(chip, "MRM")
    command(chip, "DRVRL")
    assert len(cut_everywhere(chip, 200)) == 10


@pytest.mark.parametrize("limits", [0x2000, 0xA000], ids=["slow", "instant"])  # WR2 of the MCX514
@pytest.mark.parametrize("make", [MCX302, MCX304, MCX312, MCX514])
def test_a_software_limit_stops_at_the_clock_of_a_pulse(make, limits):
    chip = cruising(make)
    if make is MCX514:
        load(chip, SP=5)
        chip.write(2, limits)
    else:
        load(chip, CP=5)
        chip.write(2, 0x0001)
    command(chip, "DRVRL" if make is MCX514 else "F_DRV_P")
    assert len(cut_everywhere(chip, 200)) < 10


@pytest.mark.parametrize("again", [0, 1])
def test_the_timer_is_up_at_its_clock(again):
    chip = MCX514()
    load(chip, TM=4, MR0=2, MR1=3)
    chip.write(3, again * chip.MAP.mask("WR3", "TMMD"))
    command(chip, "TMSTA")
    cut_everywhere(chip, 200)


def test_the_split_pulse_begins_and_ends_at_the_clock_of_a_pulse():
    chip = cruising(MCX514)
    load(chip, SP1=1 << 16 | 3, SP2=2)
    command(chip, "SPSTA")
    command(chip, "DRVRL")
    assert len(cut_everywhere(chip, 200)) == 10


@pytest.mark.parametrize("curve", [0, 4], ids=["linear", "S-curve"])
@pytest.mark.parametrize("make", [MCX304, MCX514])
def test_ramps_change_their_segments_at_any_clock(make, curve):
    chip = make()
    if make is MCX514:
        load(chip, SV=1_000_000, DV=2_000_000, AC=500_000_000 * 40, JK=0x3FFFFFFF, TP=40)
    else:
        load(chip, R=16_000, SV=1000, V=2000, A=8000, K=1, P=40)
    chip.write(3, curve)
    command(chip, "DRVRL" if make is MCX514 else "F_DRV_P")
    cut_everywhere(chip, 500)


@pytest.mark.parametrize("mode", ["position", "proportional", "trapezoid", "integral"])
@pytest.mark.parametrize("t", [0, 0x0F])
def test_the_hctl1100_samples_at_the_clock_at_which_its_timer_ends(mode, t):
    settings = [[(0x0F, t), (0x28, 3), (0x3C, 2)], gains(0xE5, 0x40, 0x20), acceleration(128), velocity(40)]
    chip = bench(*settings, word(COMMAND, 3), word(FINAL, 12), begin(mode))
    assert not cut_everywhere(chip, 16 * (t + 1) * 6 + 20)
    chip.set_shaft(0.0, 1 / 64)
    cut_everywhere(chip, 16 * (t + 1) * 3 + 20)


def test_a_cut_changes_nothing_for_the_hctl1100_timer_in_idle_or_stopped_by_sync():
    chip = bench([(0x0F, 3)])
    cut_everywhere(chip, 200)
    chip.pins.sync = True
    cut_everywhere(chip, 200)
    chip.pins.sync = False
    cut_everywhere(chip, 200)


@pytest.mark.parametrize("curved", [0, 40])
def test_a_move_of_the_step_timer_ends_at_its_last_step_however_time_is_cut(curved):
    chip = STEPDIR(clock_hz=1_000_000)
    registers = {"START": 20_000, "RATE": 100_000, "UP": 60, "DOWN": 40, "CURVED": curved, "STEPS": 12}
    for name, value in registers.items():
        chip.write(*chip.register_cycles(name, value)[0])
    chip.write(*chip.command_cycles("MOVE-")[0])
    assert len(cut_everywhere(chip, 200)) == 12
    assert chip.trace(200)["direction"].tolist() == [-1] * 12


def test_every_family_is_cut():
    cut = {PCL240K, PCL240MK, PCL240MS, MCX302, MCX304, MCX312, MCX514, CHIPS["MCX314AS"], HCTL1100, STEPDIR}
    assert all(cls in cut or issubclass(cls, MCX514) for cls in map(CHIPS.get, CHIPS.built_in)), (
        "smaller ones of a generation share its core"
    )


@PCL240
def test_a_decelerating_stop_below_fl_makes_no_other_pulse_however_time_is_cut(make):
    """1Dh while the speed rises, then R1 <- 2000, above it: run(20000)"""
    chip = make()
    load_registers(chip, R0=100_000, R1=100, R2=4000, R4=50, R5=50, R6=10, R7=30)
    commands(chip, 0x40, 0x15)
    chip.advance(20_000)
    commands(chip, 0x1D)
    load_registers(chip, R1=2000)
    cut = copy.copy(chip)
    assert chip.advance(20_000) == 0, "it is below FL: no ramp leads down to it"
    assert chip.pins.hold
    assert cut.advance(1) + cut.advance(19_999) == 0
    assert cut.snapshot().record == chip.snapshot().record
