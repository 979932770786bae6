"""Our own sine and cosine: as good as the C library's."""

import math

import numpy as np
import pytest
from support.examples import SEED

from stage.drives.trig import compute_sincos


@pytest.mark.parametrize("scale", [1.0, 1e2, 1e4, 1e6])
def test_sine_and_cosine_are_right_to_the_last_place(scale):
    seed = SEED
    print("seed", seed)
    angles = np.random.default_rng(seed).uniform(-scale, scale, 20_000)
    created = np.array([compute_sincos(x) for x in angles])
    assert np.abs(created - np.stack([np.sin(angles), np.cos(angles)], axis=1)).max() <= 2.3e-16


def test_quarter_revolutions_are_exact_where_the_angle_is():
    assert compute_sincos(0.0) == (0.0, 1.0)
    for quarters in range(-8, 9):
        s, c = compute_sincos(quarters * math.pi / 2)
        assert (round(s), round(c)) == ((0, 1), (1, 0), (0, -1), (-1, 0))[quarters % 4]
        assert s * s + c * c == pytest.approx(1.0, abs=3e-16)


def test_a_huge_angle_is_as_good_as_the_number_that_holds_it():
    for x in (1e8, -3.3e9, 1e12):
        assert math.hypot(compute_sincos(x)[0] - math.sin(x), compute_sincos(x)[1] - math.cos(x)) <= 4 * math.ulp(x)
