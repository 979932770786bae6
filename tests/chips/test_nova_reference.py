"""The references that judge the NOVA chips, themselves judged: by hand-computed moves and by the page's formulas."""

import math
import random
from fractions import Fraction
from itertools import pairwise

import pytest
from reference.nova_paths import (
    END,
    angles,
    arc_angle,
    bit_pattern_ticks,
    circle_errors,
    circle_ticks,
    helix_errors,
    line_errors,
    line_ticks,
    octant_ahead,
    octant_behind,
    points,
)
from reference.nova_profile import SECOND, Drive, mp
from support.examples import SEED, scaled

MS = SECOND // 1000
RAMP = {"SV": 1000, "AC": 1_000_000}  # 1000, 3000, 5000, 7000 pps after 0, 4, 12, 24 pulses and 0, 2, 4, 6 ms
NO_PREVENTION = {"triangle_prevention": False}


def near(value, expected):
    return abs(value - expected) < mp.mpf("1e-30")


# Hand-computed moves


def test_constant_speeds_put_each_pulse_on_its_clock():
    assert Drive(SV=1000, DV=1000, AC=1, P=300).pulse_clocks() == [16_000 * k for k in range(1, 301)]
    assert Drive(SV=8000, DV=3, AC=1, P=4).pulse_clocks() == [5_333_334, 10_666_667, 16_000_000, 21_333_334]


def test_a_linear_ramp_reaches_round_speeds_on_round_clocks():
    drive = Drive(**RAMP, DV=7000)
    clocks = drive.pulse_clocks(6 * MS)
    assert [clocks[k - 1] for k in (4, 12, 24)] == [2 * MS, 4 * MS, 6 * MS]
    assert [drive.speed(clock * MS) for clock in (0, 2, 4, 6, 100)] == [1000, 3000, 5000, 7000, 7000]
    assert [drive.phase(clock) for clock in (0, 6 * MS - 1, 6 * MS + 1)] == ["accelerating"] * 2 + ["constant"]


@pytest.mark.parametrize(
    ("options", "end"),
    [
        ({"P": 48}, 4 + Fraction(24, 5) + 4),  # half of the pulses in ramps: 5000 pps, 24 pulses there
        ({"P": 48, **NO_PREVENTION}, 12),  # a triangle up to 7000 pps
        ({"P": 48, "DP": 24, **NO_PREVENTION}, 12),  # the same by hand
        ({"P": 48, "DP": 12, **NO_PREVENTION}, 4 + 4 + 24),  # down from 5000 pps, 24 pulses of creep
        ({"P": 56, "AO": 8, **NO_PREVENTION}, 12 + 8),  # 8 pulses at SV behind the triangle
    ],
    ids=["prevention", "triangle", "DP", "early DP", "AO"],
)
def test_fixed_pulse_drives_end_at_sv_on_the_clock_that_the_hand_finds(options, end):
    drive = Drive(**{"DV": 8000, **RAMP, **options})
    assert near(drive.end, mp.mpf(end.numerator) / end.denominator / 1000)
    assert near(drive.pieces[-1].v, 1000)
    assert len(drive.pulse_clocks()) == options["P"]


def test_half_of_the_pulses_of_a_short_move_are_in_its_ramps():
    peak = mp.sqrt(1000**2 + 1_000_000 * mp.mpf(24) / 2)  # (V^2 - SV^2) / AC = P / 2
    drive = Drive(**RAMP, DV=5000, P=24)
    assert near(drive.end, 2 * (peak - 1000) / 1_000_000 + 12 / peak)


def test_an_asymmetric_triangle_ends_at_sv():
    drive = Drive(**RAMP, DV=8000, DC=2_000_000, P=36, asymmetric=True, **NO_PREVENTION)
    assert near(drive.end, mp.mpf(9) / 1000), "24 pulses in 6 ms up, 12 in 3 ms down"


def test_the_s_curve_of_the_page_has_jerk_3184():
    drive = Drive(SV=100, DV=20_000, AC=0x1FFFFFFF, JK=Fraction(4 * (20_000 - 100), 5**2), P=200_000, s_curve=True)
    assert drive.jerk[+1] == 3184
    half, full, down, *_ = drive.pieces[1:]
    assert (half.t, half.v, half.a) == (2.5, 10_050, 7960)
    assert (full.t, full.p) == (5, (20_000 + 100) * mp.sqrt(mp.mpf(19_900) / 3184)), "ta and Pa"
    assert near(drive.end, 5 + mp.mpf(200_000 - 2 * 50_250) / 20_000 + 5)
    assert near(down.p, 200_000 - 50_250)


def test_a_partial_s_curve_takes_dv_over_ac_plus_ac_over_jk():
    drive = Drive(SV=1000, DV=9000, AC=100_000, JK=10_000_000, s_curve=True)
    top = drive.pieces[-1]
    assert near(top.t, mp.mpf(8000) / 100_000 + mp.mpf(100_000) / 10_000_000)
    assert near(top.p, (1000 + 9000) / 2 * top.t)


def ramp(low, high, limit, jerk):
    """Return the time and the pulses of a complete S-curve, by its symmetry."""
    gain = high - low
    time = gain / limit + limit / jerk if gain > limit**2 / jerk else 2 * math.sqrt(gain / jerk)
    return time, (low + high) / 2 * time


def test_an_s_curve_too_short_for_dv_peaks_where_pa_and_pd_are_p():
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED)
    for _ in range(scaled(6)):
        sv, peak, up, down = rng.uniform(10, 2000), rng.uniform(3000, 30_000), rng.uniform(1, 40), rng.uniform(1, 40)
        ac, dc = rng.uniform(0.3, 2) * up * 4000, rng.uniform(0.3, 2) * down * 4000
        jk, dj = ac * up, dc * down
        rise, fall = ramp(sv, peak, ac, jk), ramp(sv, peak, dc, dj)
        drive = Drive(sv, 40_000, ac, dc, jk, dj, P=rise[1] + fall[1], s_curve=True, asymmetric=True)
        note = f"{sv} {peak} {ac} {dc} {jk} {dj}"
        top = max(drive.pieces, key=lambda piece: piece.v)
        assert float(top.v) == pytest.approx(peak, rel=1e-9), note
        assert float(top.t) == pytest.approx(rise[0], rel=1e-6), note
        assert float(drive.end) == pytest.approx(rise[0] + fall[0], rel=1e-6), note


CURVE = {"SV": 1000, "DV": 2000, "AC": 2_000_000, "JK": 10**9, "s_curve": True}  # 1 ms and 1 ms, 1e6 pps/s between


def test_a_stop_in_a_rising_s_curve_first_takes_the_acceleration_back():
    drive = Drive(**CURVE, interventions=[(MS, "slow")])
    assert near(drive.end, mp.mpf(1 + 1 + 2) / 1000)
    drive = Drive(**CURVE, interventions=[(MS // 2, "slow")])  # 1125 pps, 1250 at the top
    assert near(drive.end, (1 + 2 * mp.sqrt(mp.mpf(250) / 1000)) / 1000)


def test_overrides_and_stops_act_from_their_clock_on():
    up = Drive(**RAMP, DV=5000, interventions=[(6 * MS, "DV", 7000), (8 * MS, "slow")])
    assert up.end_clock == 14 * MS, "7000 pps at 8 ms"
    assert up.pulse_clocks()[-1] <= 14 * MS
    down = Drive(**RAMP, DV=5000, interventions=[(6 * MS, "DV", 3000), (10 * MS, "stop")])
    assert down.end_clock == 10 * MS
    assert len(down.pulse_clocks()) == 12 + 10 + 8 + 6
    assert [down.phase(c * MS + 1) for c in (3, 5, 7, 9)] == ["accelerating", "constant", "decelerating", "constant"]


def test_new_output_pulses_count_from_the_start_and_those_passed_end_the_drive():
    unmodified = {**RAMP, "DV": 1000, "P": 100}
    assert Drive(**unmodified, interventions=[(5 * MS, "P", 7)]).end_clock == 7 * MS
    assert Drive(**unmodified, interventions=[(5 * MS, "P", 3)]).end_clock == 5 * MS
    assert Drive(**unmodified, interventions=[(5 * MS, "P", 200)]).end_clock == 200 * MS
    later = Drive(**RAMP, DV=5000, P=60, interventions=[(5 * MS, "P", 120)])
    assert later.pulse_clocks() == Drive(**RAMP, DV=5000, P=120).pulse_clocks()


# Any drive


def random_drive(rng):
    def log(low, high):
        return int(low * (high / low) ** rng.random())

    sv = log(1, 100_000)
    gain = log(1, 100_000)
    seconds = log(1, 1000) / 1000
    ac = max(int(gain / seconds), 1)
    options = {"SV": sv, "DV": sv + gain, "AC": ac, "DC": max(int(ac * rng.choice([0.3, 1, 2])), 1)}
    jerk = max(int(ac / seconds * rng.choice([1, 3, 8])), 1)
    options |= {"JK": jerk, "DJ": max(int(jerk * rng.choice([0.5, 1, 3])), 1), "P": log(1, 2000)}
    for name in ("s_curve", "asymmetric", "triangle_prevention"):
        options[name] = rng.random() < 0.5
    return options


def test_any_fixed_pulse_drive_keeps_its_limits_and_ends_at_sv():
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED)
    for _ in range(scaled(12)):
        options = random_drive(rng)
        drive = Drive(**options)
        note = repr(options)
        clocks = drive.pulse_clocks()
        assert len(clocks) == options["P"], note
        assert clocks == sorted(set(clocks)), note
        assert clocks[-1] == drive.end_clock, note
        last = drive.pieces[-1]
        assert abs(last.v - drive.SV) < mp.mpf("1e-30"), note
        assert abs(last.p - drive.P) < mp.mpf("1e-30"), note
        for piece, after in pairwise(drive.pieces):
            assert abs(piece.speed(piece.length) - after.v) < mp.mpf("1e-30"), note
            assert abs(piece.position(piece.length) - after.p) < mp.mpf("1e-30"), note
            assert after.v <= drive.DV + mp.mpf("1e-30"), note
            side = 1 if piece.phase == "accelerating" else -1
            assert abs(piece.a) <= drive.limit[side] + mp.mpf("1e-30"), note
            if drive.s_curve:
                assert abs(piece.acceleration(piece.length) - after.a) < mp.mpf("1e-20"), note


def test_pulses_come_where_the_position_is_an_integer():
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED)
    for _ in range(10):
        drive = Drive(**random_drive(rng))
        for k, clock in enumerate(drive.pulse_clocks(), 1):
            (before, tau), (after, delayed) = drive._of(clock - 1), drive._of(clock)
            assert before.position(tau) < k <= after.position(delayed) + mp.mpf("1e-20")


# Paths


def test_lines_of_a_hand():
    assert points(line_ticks((4, 2))) == [(1, 1), (2, 1), (3, 2), (4, 2)], "ties step"
    assert points(line_ticks((-3, 1, 2))) == [(-1, 0, 1), (-2, 1, 1), (-3, 1, 2)]
    assert line_ticks((0, 0)) == []


def test_any_line_is_within_half_an_lsb():
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED)
    for _ in range(scaled(20)):
        finish = tuple(rng.randint(-300, 300) for _ in range(rng.randint(2, 4)))
        waveforms = points(line_ticks(finish))
        assert waveforms[-1] == finish
        assert max(line_errors(waveforms, finish)) <= Fraction(1, 2)


def test_line_errors_are_measured_at_the_long_axis():
    assert line_errors([(1, 0), (2, 0), (3, 1)], (4, 2)) == [Fraction(1, 2), 1, Fraction(1, 2)]


def test_octants_count_counter_clockwise_from_plus_x():
    around = [(2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (-1, 2), (-2, 2), (-2, 1)]
    around += [(-x, -y) for x, y in around]
    assert [octant_ahead(*at) for at in around] == [k // 2 for k in range(16)]
    assert [octant_behind(*at) for at in around] == [(k - 1) // 2 % 8 for k in range(16)]
    assert [octant_ahead(*at, clockwise=True) for at in around] == [(k - 1) // 2 % 8 for k in range(16)]


def test_a_circle_of_radius_3_by_hand():
    steps = [(0, 1), (-1, 1), (-1, 1), (-1, 0)]
    assert points(circle_ticks((-3, 0), (-3, 3))) == points(steps), "(3, 1), (2, 2), (1, 3), (0, 3) about the centre"


def random_arc(rng, least=3):
    radius, begin, end = least * (100 ** rng.random()), rng.random() * math.tau, rng.random() * math.tau
    centre = round(radius * math.cos(begin)), round(radius * math.sin(begin))
    uncut = rng.random() < 0.3
    finish = (0, 0) if uncut else (centre[0] + round(radius * math.cos(end)), centre[1] + round(radius * math.sin(end)))
    off = abs(math.dist(finish, centre) - math.hypot(*centre))
    if not uncut and (max(map(abs, finish)) < 2 or off > 1):
        return random_arc(rng, least)  # a step or a turn, as rounding has it; or rounded off the circle
    return centre, finish, rng.random() < 0.5


def test_any_arc_is_within_one_lsb_and_ends_at_its_finish():
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED)
    for _ in range(scaled(60)):
        centre, finish, clockwise = random_arc(rng)
        waveforms = points(circle_ticks(centre, finish, clockwise))
        note = f"{centre} {finish} {clockwise}"
        assert max(circle_errors(waveforms, centre)) <= 1, note
        assert max(abs(a - b) for a, b in zip(waveforms[-1], finish, strict=True)) <= (finish != (0, 0)), note
        missed = angles(waveforms, centre, clockwise)[-1] - arc_angle(centre, finish, clockwise)
        assert abs(missed) * math.hypot(*centre) < 2, note


@pytest.mark.parametrize("centre", [(1, 0), (0, -1), (1, 1), (-2, 0), (2, -1), (0, 3), (-2, -2)])
def test_the_smallest_circles_close(centre):
    for clockwise in (False, True):
        waveforms = points(circle_ticks(centre, (0, 0), clockwise))
        assert waveforms[-1] == (0, 0)
        assert max(circle_errors(waveforms, centre)) <= 1
        assert angles(waveforms, centre, clockwise)[-1] == pytest.approx(math.tau)


def test_a_circle_off_its_center_is_detected():
    assert max(circle_errors([(0, 1), (0, 2), (0, 3)], (-3, 0))) == pytest.approx(math.hypot(3, 3) - 3)


def test_a_helix_rises_with_the_angle():
    quarter = [(0, 3, 5), (-3, 3, 10)]
    assert helix_errors(quarter, (-3, 0), (-3, 3), False, 10)[-1] == pytest.approx(0)
    assert helix_errors([(-3, 3, 2)], (-3, 0), (-3, 3), False, 10, turns=1) == [pytest.approx(0)]
    assert helix_errors([(-3, 3, 9)], (-3, 0), (-3, 3), False, 10) == [pytest.approx(1)]


def test_a_bit_pattern_steps_lsb_first_and_ends_where_both_bits_are_1():
    assert bit_pattern_ticks([0x0002_0005]) == [1, -1, 1, *[0] * 13]
    assert bit_pattern_ticks([0x0004_0005]) == [1, 0, END]
