"""What the drive is told of a slice: the mean of the pulse count over it, from the phase at its end alone."""

import numpy as np
from programs import load_registers

from stage.chips import PCL240K
from stage.chips.pcl240 import core as pcl240_core
from stage.compiled import hot


@hot
def mean_count(rows, i, before, ticks):
    return pcl240_core.mean_count(rows[i], 0, before, ticks)


def test_it_is_the_mean_over_every_tick_at_constant_speed():
    seed = np.random.SeedSequence().entropy
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for trial in range(200):
        chip, way = PCL240K(), -1 if trial % 2 else 1
        speed = int(rng.integers(1, 8192))
        load_registers(chip, R0=0xFFFFFF, R1=speed, R2=speed, R3=speed, R4=2, R5=2, R6=0, R7=int(rng.integers(2, 40)))
        chip.write(0, 0x40 if way > 0 else 0x48)
        chip.write(0, 0x10)
        before = way * chip.advance(int(rng.integers(1000, 50_000)))
        ticks = int(rng.integers(50, 600))
        start = chip.clock
        pulses = chip.trace(ticks)
        counts = before + way * np.searchsorted(pulses["clock"], np.arange(start + 1, start + ticks + 1), side="right")
        error = abs(mean_count(chip._rows, chip._i, before, float(ticks)) - counts.mean())
        assert error <= 0.03 * max(1, len(pulses)), "a tick is rounded away, no more"


def test_a_halted_chip_stands_on_its_count():
    chip = PCL240K()
    assert mean_count(chip._rows, chip._i, 0, 154.0) == 0
