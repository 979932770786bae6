"""The automatic ramp-down point ends every preset move on its last pulse: at FL, or with the tail that the manual allows.

The chip counts the pulses of its ramp-up and, with R6 = 0, starts down when as many are left. What may be left of the
ramp-down at the last pulse:

- one pulse, since pulses are whole, and what a clock adds, less than half a pulse: R6 = 2 always makes up for it;
- more where the ramp-down takes longer than the ramp-up, R15 > R14 (the manual's condition, Tsdb >= Tsd);
- more after a triangle of S-curves without FH correction, whose ramp-up was broken off on its way;
- more with a negative R6, which is a later start.
"""

import numpy as np
import pytest
from support.examples import scaled
from support.pcl240k_bench import SEED
from support.pcl240ms_bench import LINEAR, NO_CORRECTION, Move, Registers, excuse, random_move, run_move, span_of

from stage.chips import PCL240MK, PCL240MS

ROUNDING = 1.5  # pulses
COUNT = scaled(400)
SLOW = Registers(1, 3, 9, 9, 1023)
FAST = Registers(100, 8191, 2, 2, 2, 4000, 90)
BITS = pytest.mark.parametrize("bits", [0, LINEAR, NO_CORRECTION, LINEAR | NO_CORRECTION], ids=lambda b: f"{b:04X}h")


def random_moves():
    rng = np.random.default_rng(SEED)
    return [random_move(rng) for _ in range(COUNT)]


def assert_ended(move):
    """Make a move, and assert what holds for every move."""
    outcome = run_move(move)
    print(f"{move}\n{outcome}, PULSESTAGE_SEED={SEED}")
    assert outcome.r0 == 0, "exactly at R0 = 0"
    assert outcome.pulses == move.r0, "and not one pulse more"
    assert outcome.peak <= max(move.fh, move.registers.R1)
    if not excuse(move, outcome):
        assert outcome.left < ROUNDING, "at FL, but for the rounding to whole pulses"
    return outcome


def assert_right_to_a_pulse(move):
    """The last pulse comes when the ramp-down ends, later by what the ramp-up took longer."""
    outcome = assert_ended(move)
    r, gain = move.registers, outcome.peak - move.registers.R1
    difference = 0 if move.linear else (span_of(r.R14, gain) - span_of(r.R15, gain)) * r.R4  # clocks
    expected = difference * (r.R1 + outcome.peak - 1) / (16384 * r.R7)
    if gain > 0 and outcome.peak == move.fh:
        assert outcome.delay - expected == pytest.approx(0, abs=ROUNDING)
    elif gain > 0 and move.linear:
        step = r.R4 * outcome.peak / (8192 * r.R7)
        assert -ROUNDING < outcome.delay < ROUNDING + step, "a triangle's top speed lasts less than a step"


def test_every_random_move_ends_at_r0_0_and_at_fl_or_with_a_tail_that_the_manual_allows():
    proper = sum(not excuse(move, assert_ended(move)) for move in random_moves())
    assert proper > COUNT / 2, "the exceptions stay exceptions"


def test_the_automatic_point_is_right_to_a_pulse():
    for move in random_moves():
        assert_right_to_a_pulse(move._replace(offset=0))


def test_with_r6_of_2_only_the_manuals_exceptions_end_above_fl():
    for move in random_moves():
        outcome = assert_ended(move._replace(offset=2))
        assert outcome.speed <= move.registers.R1 or excuse(move._replace(offset=2), outcome)


@BITS
@pytest.mark.parametrize("r0", [1, 2, 3, 4, 5, 6, 7, 16_777_214, 16_777_215])
@pytest.mark.parametrize("registers", [SLOW, FAST, FAST._replace(R15=4000)], ids=["slow", "fast", "equal spans"])
def test_minimum_and_maximum_moves_end_exactly(registers, bits, r0):
    assert_right_to_a_pulse(Move(PCL240MS, r0, registers, bits=bits))
    assert_right_to_a_pulse(Move(PCL240MK, r0, registers))


@BITS
@pytest.mark.parametrize("r0", range(2040, 8220, 515))
def test_moves_about_as_long_as_their_ramps_end_so(bits, r0):
    """At the highest rates there are; both ramps take 8190 pulses, without a linear part."""
    assert_right_to_a_pulse(Move(PCL240MS, r0, FAST._replace(R14=0, R15=0), bits=bits))


def test_an_offset_adds_pulses_at_fl_and_a_negative_one_takes_them_from_the_ramp():
    registers = Registers(50, 800, 300, 300, 20)
    for cls, bits in ((PCL240MK, 0), (PCL240MS, 0), (PCL240MS, LINEAR)):
        delayed = [run_move(Move(cls, 5000, registers, offset, bits)).delay for offset in (0, -300, -100, 5, 20, 1000)]
        assert [v - delayed[0] for v in delayed[1:]] == pytest.approx([-300, -100, 5, 20, 1000], abs=1)


def test_r15_shorter_than_r14_leaves_pulses_at_fl():
    """The difference of the two ramps: (R1 + R2) (R14 - R15) R4 / (16384 R7)."""
    outcome = assert_ended(Move(PCL240MS, 5000, Registers(50, 800, 300, 300, 20, 300, 100)))
    assert outcome.speed == 50
    assert outcome.at_fl == pytest.approx(850 * 200 * 300 / (16384 * 20), abs=3)


def test_r15_longer_than_r14_ends_above_fl():
    """The same difference is missing."""
    outcome = assert_ended(Move(PCL240MS, 5000, Registers(50, 800, 300, 300, 20, 100, 300)))
    assert outcome.speed > 50
    assert outcome.left == pytest.approx(850 * 200 * 300 / (16384 * 20), abs=3)


def test_fh_correction_brings_a_short_s_curve_move_to_fl_and_without_it_a_triangle_ends_above():
    short = Move(PCL240MS, 5000, Registers(50, 4000, 300, 300, 20))
    assert_right_to_a_pulse(short)
    triangle = assert_ended(short._replace(bits=NO_CORRECTION))
    assert triangle.speed > 50
    assert triangle.left > 100


def test_a_triangle_of_linear_ramps_needs_no_correction():
    short = Move(PCL240MK, 5000, Registers(50, 4000, 300, 300, 20))
    for move in (short, short._replace(cls=PCL240MS, bits=LINEAR | NO_CORRECTION)):
        assert assert_ended(move).peak < 4000
        assert_right_to_a_pulse(move)
