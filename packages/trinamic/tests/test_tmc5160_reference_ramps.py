"""The slow reference of the TMC5160: ramps keep the data sheet's formulas and end at their targets."""

import random
from math import ceil

import pytest
from tmc5160_reference import programs
from tmc5160_reference.chip import Reference
from tmc5160_reference.controls import (
    MINUS,
    PLUS,
    create_reference,
    read_bit,
    read_register,
    read_speed,
    tick_until,
    write_registers,
)


def test_velocity_mode_takes_the_time_and_steps_of_the_formula():
    chip = create_reference(AMAX=60000, VMAX=10000, RAMPMODE=PLUS)
    assert tick_until(chip, lambda: read_speed(chip) == 10000) == ceil(10000 * 2**17 / 60000)
    assert read_bit(chip, 8)
    assert len(chip.steps) == 10000**2 // (256 * 60000) == 6
    write_registers(chip, RAMPMODE=MINUS)
    start, steps = chip.clock, len(chip.steps)
    assert tick_until(chip, lambda: chip.q == 0) - start == ceil(10000 * 2**17 / 60000)
    assert abs(len(chip.steps) - steps - 6.51) <= 1
    tick_until(chip, lambda: read_speed(chip) == 500)
    assert read_register(chip, "VACTUAL") == 2**24 - 500


@pytest.mark.slow
def test_six_phases_of_a_position_ramp():
    chip = create_reference(
        VSTART=6000, A1=60000, V1=11000, AMAX=65535, VMAX=16000, DMAX=50000, D1=65000, VSTOP=8000, XTARGET=30
    )
    x = chip.r

    def measure_phase(condition):
        clock, position = chip.clock, x["XACTUAL"]
        return tick_until(chip, condition) - clock, x["XACTUAL"] - position

    def compute_phase(v0, v1, a):
        return ceil(abs(v1 - v0) * 2**17 / a), abs(v1**2 - v0**2) / (256 * a)

    for condition, (v0, v1, a) in (
        (lambda: read_speed(chip) == 11000, (6000, 11000, 60000)),
        (lambda: read_speed(chip) == 16000, (11000, 16000, 65535)),
    ):
        clocks, steps = measure_phase(condition)
        assert (clocks, steps) == pytest.approx(compute_phase(v0, v1, a), abs=1)
    clocks, steps = measure_phase(lambda: read_speed(chip) < 16000)
    assert clocks == pytest.approx(steps * 2**24 / 16000, abs=2**24 / 16000)
    for goal, (v0, v1, a) in ((11000, (16000, 11000, 50000)), (8000, (11000, 8000, 65000))):
        clocks, steps = measure_phase(lambda goal=goal: chip.q <= goal << 17)
        assert (clocks, steps) == pytest.approx(compute_phase(v0, v1, a), abs=1)
    clocks, steps = measure_phase(lambda: chip.q == 0)
    assert 0 < clocks * 8000 / 2**24 <= 1 + 10 / 256 + 2 * 256 * 16000 / (50000 * 2**24)
    assert x["XACTUAL"] == 30
    assert read_register(chip, "RAMP_STAT") & 0x680 == 0x680


@pytest.mark.slow
def test_a_short_move_peaks_at_the_rate_of_the_triangle_formula():
    a1, amax, dmax, d1, v1, vstop, distance = 60000, 40000, 65535, 50000, 5000, 4500, 12
    chip = create_reference(A1=a1, V1=v1, AMAX=amax, VMAX=100000, DMAX=dmax, D1=d1, VSTOP=vstop, XTARGET=-distance)
    peak = 0
    while chip.clock == 0 or chip.q:
        chip.tick()
        peak = max(peak, read_speed(chip))
    rest = 256 * distance - v1**2 / a1 - (v1**2 - vstop**2) / d1
    ideal = (v1**2 + rest / (1 / amax + 1 / dmax)) ** 0.5
    assert ideal - peak == pytest.approx(0, abs=0.02 * ideal)  # a step of margin, at most
    assert [direction for _, direction in chip.steps] == [-1] * distance


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 24))])
def test_every_move_ends_at_its_target(seed):
    assert_moves_reach_targets(seed, 6, 15)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 124))
def test_every_move_of_many_ends_at_its_target(seed):
    assert_moves_reach_targets(seed, 40, 90)


def assert_moves_reach_targets(seed, changes, reach):
    """Targets and VMAX change in motion; without a change the target is never overshot."""
    rng = random.Random(seed)
    chip = create_reference(
        VSTART=rng.choice((0, programs.draw_speed(rng))), VSTOP=rng.randint(9000, 60000), V1=rng.choice((0, 9000, 40000)),
        AMAX=rng.randint(9000, 65535), A1=rng.randint(9000, 65535), DMAX=rng.randint(9000, 65535),
        VMAX=programs.draw_speed(rng), XTARGET=rng.randint(-reach, reach) or 7,
    )  # fmt: skip
    write_registers(chip, D1=rng.randint(9000, 65535))
    for _ in range(rng.randrange(changes)):
        chip.advance(rng.randrange(4000))
        write_registers(
            chip, **rng.choice(({"XTARGET": rng.randint(-reach, reach)}, {"VMAX": programs.draw_speed(rng)}))
        )
    straight = not chip.steps and chip.q == 0
    tick_until(chip, lambda: chip.dir == 0 and chip.r["XACTUAL"] == chip.r["XTARGET"], 3_000_000)
    if straight:
        assert len({direction for _, direction in chip.steps}) <= 1, f"overshot with seed {seed}"
    step_count = len(chip.steps)
    chip.advance(1000)
    assert len(chip.steps) == step_count
    assert read_register(chip, "RAMP_STAT") & 0x680 == 0x680


def test_a_target_that_requires_a_reversal_is_approached_after_tzerowait():
    chip = create_reference(VSTART=34000, AMAX=60000, DMAX=60000, VMAX=60000, VSTOP=33000, TZEROWAIT=3, XTARGET=1000)
    chip.advance(8000)
    write_registers(chip, XTARGET=0)
    stop = tick_until(chip, lambda: chip.dir == 0)
    assert read_bit(chip, 12)
    assert read_bit(chip, 11)
    assert tick_until(chip, lambda: chip.q > 0) == stop + 512 * 3 + 1
    tick_until(chip, lambda: chip.dir == 0)
    assert read_register(chip, "XACTUAL") == 0
    write_registers(chip, RAMP_STAT=0x1000)
    assert not read_bit(chip, 12)


# The sheet's own numbers at full length: minutes of clocks


@pytest.mark.slow
def test_the_sheets_uart_example_reaches_its_velocity():
    chip = create_reference(AMAX=5000, VMAX=20000, RAMPMODE=PLUS)
    assert tick_until(chip, lambda: read_bit(chip, 8), 600_000) == 524_288
    assert len(chip.steps) == 312


@pytest.mark.slow
def test_the_sheets_turn_to_the_left():
    chip = Reference()
    for datagram in (
        0xEC000100C3, 0x9000061F0A, 0x910000000A, 0x8000000004, 0x93000001F4, 0xA4000003E8, 0xA50000C350,
        0xA6000001F4, 0xA700030D40, 0xA8000002BC, 0xAA00000578, 0xAB0000000A, 0xA000000000, 0xADFFFF3800,
    ):  # fmt: skip
        chip.transfer(datagram)
    marks, peak = [], 0
    for condition in (
        lambda: read_speed(chip) == 50000, lambda: chip.brk, lambda: read_speed(chip) <= 50000, lambda: chip.q == 10 << 17,
        lambda: chip.dir == 0,
    ):  # fmt: skip
        clock = tick_until(chip, condition, 10_000_000)
        marks.append((clock, -sum(direction for _, direction in chip.steps)))
        peak = max(peak, read_speed(chip))
    assert marks == [
        (6_553_600, 9765), (12_117_562, 29_867), (16_091_487, 44_223), (20_771_881, 51_199), (20_846_721, 51_200),
    ]  # fmt: skip
    assert peak == 71_224
    assert chip.mscnt == 0
