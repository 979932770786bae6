"""Speeds in registers: the data sheet's formulas, and what a profile picks."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from support.examples import SEED

from stage import ArgumentError, firmware
from stage.chips import PCL240K, PCL240MS
from stage.firmware import Bench, Profile
from stage.firmware.pcl240.speed_profile import (
    compute_down_point,
    compute_pulse_rate,
    compute_ramp_pulses,
    compute_ramp_seconds,
    compute_revised_high_speed,
    compute_triangular_down_point,
    is_triangular_move,
)


def test_multipliers_have_the_pulse_rates_of_the_data_sheet():
    """Section 4, R7: R7 = 600, 60, 20 are the 1x, 10x and 30x modes; section (6): 245,730 pps at most in 30x mode."""
    assert [compute_pulse_rate(1, r7) for r7 in (600, 60, 20)] == [1, 10, 30]
    assert compute_pulse_rate(8191, 20) == 245_730


def test_ramp_formulas_are_those_of_the_data_sheet():
    r1, r2, r4, r5, r7 = 50, 800, 300, 200, 60
    assert compute_ramp_seconds(r1, r2, r4) == (r2 - r1) * r4 / 4_915_200
    assert compute_ramp_pulses(r1, r2, r5, r7) == (r2**2 - r1**2) * r5 / (16384 * r7)
    assert compute_triangular_down_point(1000, r4, r5) == 400
    both = compute_ramp_pulses(r1, r2, r4 + r5, r7)
    assert is_triangular_move(math.floor(both), r1, r2, r4, r5, r7)
    assert not is_triangular_move(math.ceil(both), r1, r2, r4, r5, r7)


def test_a_profile_selects_the_finest_multiplier_that_reaches_its_rates():
    """The largest R7: the rate changes in many small steps and not in few large ones."""
    p = Profile.of()
    assert p.R3 > 8191 * 0.9
    assert (p.fl, p.fh1, p.fh2) == pytest.approx((1000, 16_000, 32_000), rel=2e-4)
    assert p.get_accel_time(fh2=True) == pytest.approx(0.15, rel=1e-2)


def test_an_explicit_multiplier_is_not_changed():
    assert Profile.of(multiplier=60).R7 == 60


def test_fl_is_never_above_the_high_rates():
    assert Profile.of(fh1=300).fl == pytest.approx(300, rel=1e-3)


def test_rates_and_ramp_times_of_a_profile_are_those_of_the_chip():
    p = Profile.of(fl=800, fh1=9000, fh2=14_000, accel=0.13, decel=0.21)
    report = firmware.continuous_move(Bench(PCL240K()).axes["x"], 0.3, 1, p, fh2=True)
    assert report.peak_rate == pytest.approx(p.fh2, rel=1e-12)
    waveform = report.waveforms
    up, down = (np.flatnonzero(waveform.pin(n)) for n in ("fup", "fdown"))
    for ramp, seconds, rate in ((up, p.get_accel_time(fh2=True), p.R4), (down, p.get_decel_time(fh2=True), p.R5)):
        step = rate / p.clock_hz  # the first of a ramp-up and the last of a ramp-down are made at FL
        assert waveform.seconds[ramp[-1] + 1] - waveform.seconds[ramp[0]] == pytest.approx(seconds, abs=1.01 * step)


@pytest.mark.parametrize("trial", range(150))
def test_a_preset_move_of_any_length_ends_at_fl(trial):
    """Random registers and lengths around the triangular limit: the last pulse is made at FL, and few before it."""
    print("seed", SEED)
    rng = np.random.default_rng([SEED, trial])
    fl = int(rng.integers(20, 400))
    p = Profile(
        fl,
        fl + int(rng.integers(1, 5000)),
        8191,
        *(int(rng.integers(2, 300)) for _ in range(2)),
        int(rng.integers(8, 200)),
    )
    limit = compute_ramp_pulses(p.R1, p.R2, p.R4 + p.R5, p.R7)
    count = int(min(max(1, rng.uniform(0, 1.5) * limit), 300_000))
    report = firmware.preset_move(Bench(PCL240K()).axes["x"], count, p)
    assert report.ok
    speed = report.waveforms.edges["speed"]
    running = speed[speed > 0]
    assert running[-1] == p.R1
    slow = np.flatnonzero(speed > p.R1)
    if len(slow) and speed.max() == p.R2:
        stairs = (p.R2 - p.R1) * p.R5 / (16384 * p.R7)  # the chip's staircase makes so many fewer
        assert 5 <= report.waveforms.edges["counter"][slow[-1] + 1] + 1 <= 8 + stairs, (p, count)


def test_a_triangular_move_needs_two_pulses_more_than_the_printed_ramp_down_point():
    p = Profile(100, 4000, 8191, 60, 60, 60)
    printed = int(compute_triangular_down_point(400, p.R4, p.R5))
    ends = {}
    for extra in (0, 2):
        report = firmware.preset_move(Bench(PCL240K()).axes["x"], 400, p, down_point=printed + extra)
        speed = report.waveforms.edges["speed"]
        ends[extra] = int(speed[speed > 0][-1])
    assert ends[0] > p.R1
    assert ends[2] == p.R1
    assert compute_down_point(400, p.R1, p.R2, p.R4, p.R5, p.R7) == printed + 2


def test_the_revised_high_rate_is_the_highest_whose_ramps_fit_into_the_move():
    """Data sheet MS, 3-4.1 and 3-4.2: "revised R2", with curved ends of each kind"""
    rng = random.Random(SEED)
    for k in range(200):
        low, r4, r5, r7 = rng.randint(1, 300), rng.randint(10, 900), rng.randint(10, 900), rng.randint(2, 60)
        high = low + rng.randint(2, 500)
        span, other = (rng.randint(1, (high - low) // 2 + 20) for _ in "ab")
        up, down = [(None, None), (0, 0), (span, span), (span, other)][k % 4]

        def compute_ramp_total(rate, low=low, r4=r4, r5=r5, r7=r7, up=up, down=down):
            return compute_ramp_pulses(low, rate, r4, r7, up) + compute_ramp_pulses(low, rate, r5, r7, down)

        pulses = int(compute_ramp_total(high) * rng.uniform(0.01, 1.05)) + 1
        revised = compute_revised_high_speed(pulses, low, high, r4, r5, r7, up, down)
        if (
            up == down or 2 * max(up, down) < revised - low
        ):  # else without a linear part in one ramp, which the sheet leaves out
            assert revised == max(h for h in range(low, high + 1) if compute_ramp_total(h) <= pulses), (
                low,
                high,
                r4,
                r5,
                r7,
                up,
                down,
            )
        assert low <= revised <= high


def test_a_profile_without_ramps_ignores_ramp_time_and_shape():
    """Profile.of(fl=5000, fh1=5000, fh2=5000, accel=50).with_ramp_shape(True)"""
    flat = Profile.of(fl=5000, fh1=5000, fh2=5000, accel=50, chip=PCL240MS)
    assert flat.fh1 == flat.fl == pytest.approx(5000, rel=1e-4)
    assert Profile.of(fl=1234.5, fh1=1234.5, fh2=1234.5, accel=50).fl == pytest.approx(1234.5, rel=2e-4)
    shaped = flat.with_ramp_shape(True)
    assert (shaped.spans, shaped.R4, shaped.R5) == ((0, 0), flat.R4, flat.R5)
    assert flat.for_distance(100) is flat
    assert shaped.for_distance(3).R2 == shaped.R1


def test_a_ramp_shape_keeps_the_ramp_times_to_the_selected_high_rate():
    plain = Profile.of(fl=500, fh1=4000, fh2=16_000, accel=0.2, decel=0.1, chip=PCL240MS)
    for fh2 in (False, True):
        curved = plain.with_ramp_shape(0.2, fh2)
        assert curved.get_accel_time(fh2) == pytest.approx(plain.get_accel_time(fh2), rel=0.01)
        assert curved.get_decel_time(fh2) == pytest.approx(plain.get_decel_time(fh2), rel=0.01)
        assert curved.get_accel_time(not fh2) != pytest.approx(plain.get_accel_time(not fh2), rel=0.05)


@pytest.mark.parametrize("spans", [(0, 4095), (4095, 0)])
def test_curved_ends_take_0_to_4095_speed_steps(spans):
    whole = Profile.of(fl=1000, fh1=8000, chip=PCL240MS)
    assert replace(whole, spans=spans).spans == spans
    for wrong in (-1, 4096):
        with pytest.raises(ArgumentError, match=f"span {wrong}: .* takes 0 to 4095 speed steps"):
            replace(whole, spans=tuple(wrong if s else 0 for s in spans))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Profile.of(multiplier=1), r"R7 .* cannot be 1: .* from 2 to 1023"),
        (lambda: Profile.of(fh1=300_000, multiplier=20), r"up to 245730 pps \(R7 = 20\)"),
        (lambda: Profile.of(fl=5000, fh1=4000), "FL upwards|above a high rate"),
        (lambda: Profile.of(fh1=float("nan")), "fh1=nan"),
        (lambda: Profile.of(fl=10, fh1=50, fh2=100, accel=2), r"R4 = \d+: it takes 2 to 16383.*at most 0\.\d+ s"),
        (lambda: Profile.of(decel=0), "decel=0"),
        (lambda: Profile(8192, 1, 1, 2, 2, 2), r"R1 .FL speed. cannot be 8192"),
        (
            lambda: Profile(1, 8191, 1, 2, 16383, 2).compute_ramp_down_point(10**7),
            r"R6 .ramping-down point. cannot be \d+: .* to 1048575",
        ),
    ],
)
def test_the_error_of_a_value_beyond_its_register_states_name_range_and_value(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()


def test_a_run_through_speeds_dwells_at_each_but_the_last():
    p = Profile.of(1000, 4000, 8000)
    one, two = p.R2, p.R3
    assert p.compute_pulses_through([one], 0.5) == p.compute_pulses_through([one])
    assert p.compute_pulses_through([one, two], 0.5) - p.compute_pulses_through([one, two]) == pytest.approx(
        0.5 * p.fh1
    )
    assert p.compute_pulses_through([one, two, one], 0.5) - p.compute_pulses_through([one, two, one]) == pytest.approx(
        0.5 * (p.fh1 + p.fh2)
    )


def test_the_upper_bound_of_the_duration_uses_fl_and_the_longer_ramp():
    p = Profile.of(1000, 8000, 8000, accel=0.1, decel=0.4)
    assert p.estimate_seconds(500) == pytest.approx(500 / p.fl + 2 * p.get_decel_time(True))
    p = Profile.of(1000, 8000, 8000, accel=0.4, decel=0.1)
    assert p.estimate_seconds(500) == pytest.approx(500 / p.fl + 2 * p.get_accel_time(True))


def test_a_ramp_is_at_most_one_percent_shorter_than_requested():
    """Profile.of(1000, 2000, 2000, accel=0.172, multiplier=30): 50 steps of 16,383 clocks are 0.1667 s"""
    maximum = 50 * 16383 / 4_915_200
    assert Profile.of(1000, 2000, 2000, accel=1.005 * maximum, decel=0.1, multiplier=30).R4 == 16383
    for accel, decel in ((1.03 * maximum, 0.1), (0.1, 1.03 * maximum)):
        with pytest.raises(ArgumentError, match=r"Between these rates a ramp takes at most 0\.167 s"):
            Profile.of(1000, 2000, 2000, accel=accel, decel=decel, multiplier=30)
