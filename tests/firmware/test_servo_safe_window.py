"""The data sheet's warning, on the chip alone: commands written while a sample is computed corrupt it, safe ones never.

A compiled host writes a new command position in every sample, at a drawn moment of the unsafe or of the safe part; the control law
is worked out beside the chip, in this file, from the numbers that were written.
"""

import numpy as np
import pytest
from loops.hctl1100 import A, B, K, T, play
from support.examples import SEED

from stage.chips import HCTL1100
from stage.chips.hctl1100.maps import MINIMUM_T

MINIMUM = MINIMUM_T["position"]
SAFE = 16 * MINIMUM  # clocks of a sample, after which commands are safe
SAMPLES = 1_000_000


def chip_before_a_sample():
    """Return a chip in position control, one clock before a sample."""
    chip = HCTL1100()
    for address, value in ((0x0F, T), (0x20, A), (0x21, B), (0x22, K)):
        chip.write(address, value)
    chip.advance(2000)
    chip.write(0x05, 0x03)
    chip.advance(int(chip.state["sample_end"]) - chip.clock - 1)
    return chip


def corrupted(rng, moments):
    """Count the samples of a new chip that are corrupted with a command in each, at these clocks of it."""
    n = len(moments)
    return play(chip_before_a_sample()._rows, moments, rng.integers(-40, 41, n), rng.integers(-9, 10, n))


@pytest.fixture
def rng():
    print(f"PULSESTAGE_SEED={SEED}")
    return np.random.default_rng(SEED)


def test_commands_in_the_safe_part_never_corrupt_a_sample_in_a_million(rng):
    assert corrupted(rng, rng.integers(SAFE, 16 * T, SAMPLES)) == 0


@pytest.mark.parametrize("count", range(MINIMUM))
def test_commands_at_any_count_of_the_unsafe_part_corrupt_samples(rng, count):
    assert corrupted(rng, rng.integers(16 * count, 16 * count + 16, 20_000)) > 0.3 * 20_000


def test_what_is_torn_lasts_for_that_sample_and_the_next_is_right_again(rng):
    early = rng.random(100_000) < 1e-3
    moments = np.where(early, rng.integers(0, SAFE, len(early)), rng.integers(SAFE, 16 * T, len(early)))
    assert 0 < corrupted(rng, moments) <= early.sum()
