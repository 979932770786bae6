"""What the drive is told of a slice: the mean of the pulse count over it, from the phase at its end alone."""

import numpy as np
from support.examples import SEED
from support.nova_programs import command, load
from support.programs import load_registers

from stage.chips import MCX302, MCX514, PCL240K


def drive_input(chip, j, before, ticks):
    return chip.CORE.compute_drive_input(chip._rows[0], j, before, ticks)


def test_it_is_the_mean_over_every_tick_at_constant_speed():
    seed = SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for trial in range(200):
        chip, direction = PCL240K(), -1 if trial % 2 else 1
        speed = int(rng.integers(1, 8192))
        load_registers(chip, R0=0xFFFFFF, R1=speed, R2=speed, R3=speed, R4=2, R5=2, R6=0, R7=int(rng.integers(2, 40)))
        chip.write(0, 0x40 if direction > 0 else 0x48)
        chip.write(0, 0x10)
        before = direction * chip.advance(int(rng.integers(1000, 50_000)))
        ticks = int(rng.integers(50, 600))
        start = chip.clock
        pulses = chip.trace(ticks)
        counts = before + direction * np.searchsorted(
            pulses["clock"], np.arange(start + 1, start + ticks + 1), side="right"
        )
        error = abs(drive_input(chip, 0, before, float(ticks)) - counts.mean())
        assert error <= 0.03 * max(1, len(pulses)), "a tick is rounded away, no more"


def test_the_drive_input_of_a_halted_chip_is_its_count():
    chip = PCL240K()
    assert drive_input(chip, 0, 0, 154.0) == 0


def mean_over_every_clock(chip, axis, before, ticks):
    """Compute the mean that `drive_input` must return, clock by clock, and return both and the number of pulses."""
    start = chip.clock
    pulses = chip.trace(ticks)
    own_pulses = pulses[pulses["axis"] == axis]
    steps = np.concatenate([[0], np.cumsum(own_pulses["direction"], dtype=np.int64)])
    clocks = np.arange(start + 1, start + ticks + 1)
    counts = before + steps[np.searchsorted(own_pulses["clock"], clocks, side="right")]
    return drive_input(chip, axis, before, float(ticks)), counts.mean(), len(own_pulses)


def test_of_a_nova_chip_too_at_any_speed_of_any_axis():
    seed = SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for trial in range(200):
        chip, minus = (MCX514, MCX302)[trial // 2 % 2](), trial % 2
        axis, of_514 = int(rng.integers(0, chip.AXES)), isinstance(chip, MCX514)
        speed = int(np.exp(rng.uniform(np.log(1000), np.log(8_000_000))))
        named = {"SV": speed, "DV": speed} if of_514 else {"R": 16_000, "SV": speed // 1000 + 1, "V": speed // 1000 + 1}
        load(chip, 1 << axis, **named)
        orders = ("DRVVP", "DRVVM") if of_514 else ("C_DRV_P", "C_DRV_M")
        command(chip, orders[minus], 1 << axis)
        chip.advance(int(rng.integers(1000, 200_000)))
        result, expected, pulses = mean_over_every_clock(chip, axis, chip.net(axis), int(rng.integers(50, 2000)))
        assert abs(result - expected) <= 0.03 * max(1, pulses), "a clock is rounded away, no more"


def test_of_a_nova_chip_in_a_ramp_it_is_close():
    """The engine's slice is 50 us; in the steepest of these ramps the speed changes by a tenth in that time."""
    seed = SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for trial in range(200):
        chip = MCX514()
        load(chip, 1, SV=20_000, DV=200_000, AC=40_000_000, JK=1_000_000_000)
        chip.write(3, 4 * (trial % 2))
        command(chip, "DRVVM" if trial % 4 > 1 else "DRVVP")
        chip.advance(int(rng.integers(10, 60_000)))
        result, expected, pulses = mean_over_every_clock(chip, 0, chip.net(0), 800)
        assert abs(result - expected) <= 0.06 * max(1, pulses)


def test_the_drive_input_of_a_nova_chip_at_rest_is_its_count():
    for make in (MCX514, MCX302):
        chip = make()
        assert [drive_input(chip, j, 0, 800.0) for j in range(chip.AXES)] == [0] * chip.AXES


def test_of_pulses_whose_times_are_past_telling_it_is_the_middle():
    """A chip that was stopped in a slice has no phase that says when its pulses came."""
    chip = PCL240K()
    load_registers(chip, R0=100, R1=1000, R2=1000, R3=1000, R4=2, R5=2, R6=0, R7=20)
    chip.write(0, 0x40)
    chip.write(0, 0x10)
    pulse_count = chip.advance(100_000)
    chip.write(0, 0x08)
    chip.advance(10_000)
    assert pulse_count > 20
    assert drive_input(chip, 0, pulse_count - 10, 100_000.0) == pulse_count - 5
