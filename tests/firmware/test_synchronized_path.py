"""The distance of a path from its line: against a slow check in plain Python, and on paths whose distance is known."""

import math
import random
from fractions import Fraction

import numpy as np
import pytest
from support.examples import SEED
from support.programs import start_preset

from stage import ArgumentError
from stage.chips import PCL240K
from stage.firmware.path_deviation import (
    compute_path_deviation,
    compute_path_points,
    compute_staircase_deviation,
    replay_pulses,
)


def slow_deviation(pulses, distances):
    """Largest distance squared from the segment, exact: every instant, every axis, fractions."""
    instants = sorted({t for times, _ in pulses for t in times})
    length2 = sum(d * d for d in distances)
    worst, where = Fraction(0), (0,) * len(distances)
    for now in instants:
        at = [sum(s for t, s in zip(*axis, strict=True) if t <= now) for axis in pulses]
        along = Fraction(sum(a * d for a, d in zip(at, distances, strict=True)), length2)
        along = min(max(along, Fraction(0)), Fraction(1))
        d2 = sum((a - along * d) ** 2 for a, d in zip(at, distances, strict=True))
        if d2 > worst:
            worst, where = d2, tuple(at)
    return math.sqrt(worst), where


@pytest.mark.parametrize("axes", [1, 2, 3, 4])
def test_the_path_deviation_agrees_with_a_slow_check_in_fractions(axes):
    seed = SEED
    print("seed", seed)
    rng = random.Random(seed)
    for _ in range(25):
        distances = [rng.randint(-40, 40) or 7 for _ in range(axes)]
        pulses = []
        for d in distances:
            times = sorted(rng.randint(0, 60) for _ in range(abs(d)))  # many coincide
            signs = [(1 if d > 0 else -1) * rng.choice((1, 1, 1, -1)) for _ in times]
            pulses.append((times, signs))
        distance, where = slow_deviation(pulses, distances)
        got = compute_path_deviation(pulses, distances)
        assert got.pulses == pytest.approx(distance, abs=1e-9)
        if distance:
            assert got.counts == where
            at = [sum(s for t, s in zip(*axis, strict=True) if t <= got.time) for axis in pulses]
            assert got.counts == tuple(at)


def test_a_path_on_its_line_has_a_deviation_of_0():
    times = np.arange(1, 101)
    assert compute_path_deviation([(times, 1), (times, -1)], (100, -100)) == (0.0, 0.0, (0, 0))


def test_one_axis_is_always_on_its_line():
    assert compute_path_deviation([(np.arange(1, 38), -1)], [-37]).pulses == 0


def test_an_axis_that_moves_first_leaves_the_line_by_its_share():
    x, y = (np.arange(1, 31), 1), (np.arange(101, 141), 1)  # all of x, then all of y: the corner of a 3:4 triangle
    assert compute_path_deviation([x, y], (30, 40)).pulses == pytest.approx(30 * 0.8)
    assert compute_path_deviation([x, y], (30, 40)).counts == (30, 0)


def test_a_path_beyond_the_end_deviates_by_its_distance_from_the_end():
    assert compute_path_deviation([(np.arange(1, 14), 1)], [10]).pulses == 3


def test_ticks_and_clocks_become_seconds():
    x, y = np.array([100, 200, 300]), np.array([150, 300, 450])
    both = compute_path_deviation([(x, 1), (y, 1)], (3, 3), clock_hz=(1000, 1500))
    assert both.pulses == 0  # 100 ticks at 1000 Hz are 150 at 1500 Hz
    ticks = compute_path_deviation([(x, 1), (y, 1)], (3, 3))
    assert ticks.pulses > 0
    assert compute_path_deviation([(x, 1), (y, 1)], (3, 3), clock_hz=1000).time == ticks.time / 1000


def test_the_path_deviation_accepts_traces_of_chips():
    x, y = PCL240K(), PCL240K()
    start_preset(x, 3000)
    start_preset(y, 3000, minus=True)
    n = 10_000_000
    assert compute_path_deviation([x.trace(n), y.trace(n)], (3000, -3000), x.clock_hz).pulses == 0


@pytest.mark.parametrize(("distances", "distance"), [((1, 1), 0), ((2, 1), 1 / math.sqrt(5)), ((50_000, 100), 0.998)])
def test_perfect_axes_deviate_by_a_staircase(distances, distance):
    assert compute_staircase_deviation(distances) == pytest.approx(distance, abs=1e-4)


def test_path_points_merge_the_pulses_of_all_axes():
    times, counts = compute_path_points([([1, 2, 2], [1, 1, 1]), ([2, 5], [-1, -1])])
    assert times.tolist() == [0, 1, 2, 5]
    assert counts.tolist() == [[0, 0], [1, 0], [3, -1], [3, -2]]


def test_a_journal_replays_every_pulse_of_its_chip():
    chip, replica = PCL240K(), PCL240K()
    for c in (chip, replica):
        c.advance(777)
    journal = chip.journal()
    expected = []
    for minus in (False, True):
        start_preset(chip, 500, minus)
        start_preset(replica, 500, minus)
        expected.append(replica.trace(1_000_000))
        chip.advance(1_000_000)
        chip.pins.el_plus = replica.pins.el_plus = True
        chip.write(0, 0x08)
        replica.write(0, 0x08)
    journal.close()
    expected = np.concatenate(expected)
    got = replay_pulses(journal)
    assert len(got) > 100
    assert (got["clock"] + 777 == expected["clock"]).all()
    assert (got["direction"] == expected["direction"]).all()


def test_errors_of_unsorted_pulses_and_wrong_counts_say_what_to_do():
    with pytest.raises(ArgumentError, match="out of order"):
        compute_path_deviation([([2, 1], 1)], [2])
    with pytest.raises(ArgumentError, match="0 axes of pulses and 0 distances"):
        compute_path_deviation([], [])
    with pytest.raises(ArgumentError, match="1 axes of pulses and 2 distances: give one distance an axis"):
        compute_path_deviation([([1], 1)], [1, 1])
