"""Planning a:b moves: legal registers, equal ramps, rates in ratio, predictions that come true, reasons for refusals."""

import math
import random
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.examples import SEED, scaled

from stage import ArgumentError
from stage.chips import PCL240K
from stage.firmware import Bench, plan, synchronized_move
from stage.firmware.pcl240 import follower_register_search, line_register_search
from stage.firmware.pcl240.emulated_preset_move import trace_preset_move
from stage.firmware.pcl240.line_register_search import compute_equivalent_linear_steps
from stage.firmware.pcl240.preset_move_closed_form import (
    compute_ramp_ticks,
    count_pulses,
    fill_motion,
    find_first_pulse_tick,
)
from stage.firmware.pcl240.speed_profile import compute_ramp_seconds


def log_uniform(low, high):
    return st.floats(math.log(low), math.log(high)).map(math.exp)


def test_the_closed_form_equals_the_chip_to_the_clock():
    seed = SEED
    print("seed", seed)
    rng = random.Random(seed)
    for _ in range(scaled(12)):
        fl = rng.randint(1, 500)
        fh = fl + rng.choice((0, 1, 5, rng.randint(1, 3000)))
        up, down = (2, 2) if fh == fl else (rng.randint(2, 3000), rng.randint(2, 3000))
        r6 = rng.choice((0, rng.randint(1, 4000)))  # triangles and runs that never leave FL among them
        r = np.array([rng.randint(1, 3000), fl, fh, fh, up, down, r6, rng.randint(2, 1023)])
        pulses, c = trace_preset_move(r), np.zeros(4, np.int64)
        fill_motion(r, c)
        assert c[3] == pulses[-1], r
        at = [int(count_pulses(r, c, float(t))) for t in pulses]
        before = [int(count_pulses(r, c, float(t - 1))) for t in pulses]
        assert at == list(range(1, len(pulses) + 1)), r
        assert before == list(range(len(pulses))), r


def compute_max_deviation(leader, follower, lead, corners=False, hz=4_915_200):
    """The largest distance from the line as fit.py defines it, in pulses of the follower: of 2000 times of the move, or of the
    first pulse and the ends of all ramps."""
    c, o = np.zeros(4, np.int64), np.zeros(4, np.int64)
    fill_motion(leader, c), fill_motion(follower, o)
    rho, lo, hi = follower[0] / leader[0], 1.0, 0.0
    end = min(c[3] / hz, o[3] / hz - lead)
    ends = [
        t / hz - x
        for r, k, x in ((leader, c, 0), (follower, o, lead))
        for t in (compute_ramp_ticks(r, r[4]), k[0], k[0] + compute_ramp_ticks(r, r[5]))
    ]
    ends += [end, find_first_pulse_tick(follower, o) / hz - lead + 1e-12]
    for t in [t for t in ends if 0 <= t <= end] if corners else np.linspace(0, end, 2000):
        n = count_pulses(follower, o, (t + lead) * hz)
        e = n - rho * count_pulses(leader, c, t * hz)
        lo, hi = min(lo, e if n >= 1 else lo), max(hi, e)
    return max(1 - lo, hi + rho)


def test_a_ramp_down_point_may_be_the_largest_that_r6_holds():
    row = np.array([20_000, 100, 1100, 1100, 100, 100, 0, 40])
    needed = int(next(line_register_search._vary_tail_lengths(row, 4_915_200, 1 << 20))[6])
    assert needed > 100
    assert next(line_register_search._vary_tail_lengths(row, 4_915_200, needed))[6] == needed
    with pytest.raises(ArgumentError, match=f"R6 counts to {needed - 1}: shorten decel or lower the rate"):
        next(line_register_search._vary_tail_lengths(row, 4_915_200, needed - 1))


def test_longer_tails_are_tried_only_if_fl_is_fast_enough():
    """FL of 15 and of 1500 pps, FH 1000 pps more: a tail 3 pulses longer takes 0.2 s, or 2 ms"""
    tails = {}
    for fl in (1, 100):
        row = np.array([4000, fl, fl + 66, fl + 66, 100, 100, 0, 40])
        points = [
            int(row_of_registers[6])
            for row_of_registers in line_register_search._vary_tail_lengths(row, 4_915_200, 1 << 20)
        ]
        tails[fl] = [point - points[0] + 5 for point in points]
    assert tails == {1: [5, 4, 6], 100: [5, 8, 11, 14, 4, 6, 9]}


@pytest.mark.parametrize("bent", [False, True])
def test_an_estimate_equals_the_maximum_over_dense_samples(bent):
    """The estimate also holds for followers that fit badly: then the farthest moment is at an end of a ramp of theirs."""
    print("seed", SEED)
    rng, work, short = random.Random(SEED), np.zeros(1, follower_register_search.WORK_DTYPE), []
    for n in range(scaled(160)):
        d, fl, gain, r6 = rng.randint(3000, 9000), rng.randint(40, 200), rng.randint(200, 900), rng.randint(200, 900)
        up, down = rng.choices(range(40, 200), k=2)
        curve = [rng.choice((0, gain // 4))] * 2 if bent else []
        leader = np.array([d, fl, fl + gain, 0, up, down, r6, 40, *curve])
        off = np.array(
            [0.5, rng.uniform(0.3, 1.25), 1, 1, *(rng.uniform(0.8, 1.25) for _ in range(2)), rng.uniform(0.4, 0.6)]
        )
        off[2] = 1 + n % 2 * rng.uniform(-0.03, 0.03)
        follower = leader.copy()
        follower[:7], follower[7] = np.maximum(leader[:7] * off, 2), 80
        lead = rng.choice((0.0, 1e-4))
        distance = follower_register_search.estimate_follower_error(leader, 4_915_200, follower, 4_915_200, lead, work)
        if n % 10 == 0:
            short.append(distance / compute_max_deviation(leader, follower, lead))
        assert distance > compute_max_deviation(leader, follower, lead, corners=True) - 1e-6
    assert min(short) > 0.97, short
    assert max(short) < 1.003, short


@settings(max_examples=scaled(20), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(log_uniform(1, 300_000).map(int), min_size=1, max_size=3),
    log_uniform(20, 1_000_000), log_uniform(1, 10_000), log_uniform(1e-3, 5), log_uniform(1e-3, 5),
    st.sampled_from((1_000_000, 4_915_200, 9_830_400)),
)  # fmt: skip
def test_every_planned_register_is_legal(distances, rate, fl, accel, decel, clock_hz):
    requested = dict(zip("xyz", distances, strict=False))
    try:
        p = plan(requested, rate=max(rate, fl), fl=fl, accel=accel, decel=decel, clock_hz=clock_hz)
    except ArgumentError:
        return  # each reason has a test of its own
    assert p.distances == requested
    for a in p.axes.values():
        assert set(a.registers) == {f"R{k}" for k in range(8)}
        for name, value in a.registers.items():
            assert PCL240K.MAP.check_value(name, value) == value
        assert a.registers["R0"] == abs(a.distance)
        assert a.registers["R1"] <= a.registers["R2"]
        assert a.seconds <= p.seconds


@pytest.mark.parametrize(
    "distances",
    [
        {"x": 20_000, "y": -7_500},
        {"x": 30_000, "y": 10_000},
        {"x": 4_000, "y": 40_000},
        {"x": 12_345, "y": 12_345},
        {"x": 30_000, "y": 20_000, "z": 10_000},
    ],
)
def test_rates_with_a_simple_ratio_are_met_exactly(distances):
    p = plan(distances)
    assert p.ratio_error < 1e-12
    assert p.deviation < 1.1


def test_the_ratio_error_is_the_largest_of_all_axes_in_either_direction():
    """plan({"x": 20_000, "y": 1_234}): y is 1.7e-6 slow; of 5 pulses it has no ramps, and there is no word about its FL"""
    signs = []
    for pulses in (7_919, 1_234, 5):
        p = plan({"x": 20_000, "y": pulses})
        x, y = p.axes["x"], p.axes["y"]
        error = (y.fh / y.distance) / (x.fh / x.distance) - 1
        signs.append(np.sign(error))
        assert p.ratio_error == pytest.approx(abs(error), rel=1e-6)
        assert y.has_ramps or not any("axis y: FL" in note for note in p.notes)
    assert (signs, y.has_ramps) == ([1, -1, 1], False)


def test_equal_distances_have_no_deviation():
    assert plan({"x": 5000, "y": -5000, "z": 5000}).deviation == 0


def test_ramps_take_equal_times_on_all_axes():
    for ratio in (0.9, 0.61803, 0.25, 0.1):
        p = plan({"x": 40_000, "y": int(40_000 * ratio)}, rate=20_000, fl=800, accel=0.2, decel=0.35)
        x, y = p.axes["x"], p.axes["y"]
        assert (x.accel_time, x.decel_time) == pytest.approx((0.2, 0.35), rel=0.01)
        assert (y.accel_time, y.decel_time) == pytest.approx((0.2, 0.35), rel=0.02)
        assert x.fh == pytest.approx(20_000, rel=2e-3)
        assert y.fl / x.fl == pytest.approx(ratio, rel=0.2)  # a little faster: its first pulse comes earlier


def test_a_short_move_peaks_lower_on_all_axes_and_keeps_its_slope():
    p = plan({"x": 800, "y": 350}, rate=16_000, fl=1000, accel=0.15)
    x = p.axes["x"]
    assert 1000 < x.fh < 16_000
    assert (x.fh - x.fl) / x.accel_time == pytest.approx(15_000 / 0.15, rel=0.02)
    assert p.notes == (f"800 pulses are too few for 16000 pps at this slope: peaks at {x.fh:.0f} pps",)
    assert p.deviation < 1


@pytest.mark.parametrize("distances", [{"x": 1}, {"x": 1, "y": -1}, {"x": 7, "y": 3}, {"x": 9, "y": 2}])
def test_a_very_short_move_runs_at_constant_fl(distances):
    p = plan(distances)
    assert not any(a.has_ramps for a in p.axes.values())
    assert "too few for a ramp" in p.notes[0]
    assert p.deviation <= 1


def test_constant_speed_is_rate_equal_to_fl():
    p = plan({"x": 3000, "y": 2000}, rate=1500, fl=1500)
    assert not any(a.has_ramps for a in p.axes.values())
    assert p.axes["y"].fh == pytest.approx(1000, rel=1e-6)


def test_the_axis_with_the_smallest_distance_starts_first_by_the_bus_delay():
    p = plan({"x": 900, "y": -5000, "z": 2000}, bus_delay=5e-6)
    assert p.order == ("x", "z", "y")
    assert [p.axes[n].lead for n in p.order] == pytest.approx([1e-5, 5e-6, 0])


def test_an_axis_with_distance_zero_is_left_out():
    assert list(plan({"x": 500, "y": 0}).axes) == ["x"]


def test_an_axis_with_a_single_pulse_deviates_by_at_most_one_pulse():
    assert plan({"x": 200_000, "y": 1}).deviation <= 1


def test_another_bus_delay_changes_start_times_and_deviation_but_no_registers():
    at_once = plan({"x": 20_000, "y": 16_000}, rate=40_000)
    later = at_once.with_bus_delay(2e-4)
    assert later.axes["y"].registers == at_once.axes["y"].registers
    assert later.axes["y"].lead == 2e-4
    assert later.deviation > 4 * at_once.deviation
    assert later.with_bus_delay(0.0) == at_once


def test_chips_may_have_different_clocks():
    clocks = {"x": 4_915_200, "y": 9_830_400, "z": 4_000_000}
    p = plan({"x": 20_000, "y": 13_000, "z": 5_000}, clock_hz=clocks)
    assert {n: a.clock_hz for n, a in p.axes.items()} == clocks
    assert p.deviation < 1.3


def test_very_long_moves_can_be_planned():
    p = plan({"x": 16_777_215, "y": 7_654_321}, rate=100_000)
    assert not p.exact
    assert p.deviation < 2
    assert "about" in str(p)


def test_a_plan_prints_as_a_table():
    text = str(plan({"x": 20_000, "why": -7_500}))
    head, *rows = text.splitlines()
    assert head.split()[:10] == "axis pulses R0 R1 R2 R3 R4 R5 R6 R7".split()
    assert rows[0].split()[:3] == ["x", "+20000", "20000"]
    assert rows[1].split()[:3] == ["why", "-7500", "7500"]
    assert "ratio error" in rows[2]
    assert "start why, x" in rows[2]


def test_planning_takes_milliseconds():
    plan({"x": 1000, "y": 700})
    rng, seconds = random.Random(1), []
    for _ in range(20):
        distances = {"x": rng.randint(100, 50_000), "y": rng.randint(100, 50_000)}
        begin = time.process_time()
        plan(distances)
        seconds.append(time.process_time() - begin)
    assert np.median(seconds) < 0.05


def test_a_short_move_reaches_the_peak_of_its_plan():
    """38 pulses: with 14 at FL after the ramp-down, R6 = 38, and the chip would ramp down from the first pulse on"""
    bench = Bench(x=PCL240K(), y=PCL240K())
    report = synchronized_move({"x": 38, "y": 4}, bench, rate=6074.492488691149, fl=4000, accel=0.002, decel=0.01)
    x = report.plan.axes["x"]
    assert report.axes["x"].peak_rate == pytest.approx(x.fh, rel=1e-6)
    assert "peaks at 5068 pps" in str(report.plan)


def test_a_move_has_the_deviation_and_duration_of_its_plan():
    seed = SEED
    print("seed", seed)
    rng = random.Random(seed)
    for _ in range(12):
        distances = {n: rng.choice((-1, 1)) * rng.randint(50, 20_000) for n in "xyz"}
        clocks = {n: rng.choice((4_915_200, 8_000_000)) for n in "xyz"}
        bench = Bench(**{n: PCL240K(hz) for n, hz in clocks.items()}, bus_cycle=rng.choice((1e-6, 2e-5)))
        wanted = {"rate": rng.uniform(3000, 60_000), "accel": rng.uniform(0.02, 0.3), "decel": rng.uniform(0.02, 0.3)}
        report = synchronized_move(distances, bench, **wanted)
        assert report.deviation.pulses == pytest.approx(report.plan.deviation, abs=0.15)  # starts fall on whole clocks
        for n, (times, _) in report.paths.items():
            assert times[-1] == pytest.approx(report.plan.axes[n].seconds, abs=1e-6)


@pytest.mark.parametrize(
    ("distances", "options", "reason"),
    [
        ({}, {}, "nothing moves; give at least one axis pulses"),
        ({"x": 0, "y": 0}, {}, "nothing moves"),
        ({"x": 16_777_216}, {}, "x=16777216: R0 counts whole pulses, up to 16777215.*Split"),
        ({"x": 10.5}, {}, "x=10.5: R0 counts whole pulses"),
        ({"x": "far"}, {}, "x='far': R0 counts whole pulses"),
        ({"x": 1000}, {"rate": 3e6}, "at most 2457300 pps"),
        ({"x": 1000}, {"rate": 500, "fl": 800}, "FL is more than 0 and at most the rate"),
        ({"x": 1000}, {"fl": 0}, "FL is more than 0"),
        ({"x": 1000}, {"rate": float("inf")}, "FL is more than 0 and at most the rate"),
        ({"x": 1000}, {"accel": float("inf")}, "accel=inf: a ramp takes more than 0 s"),
        ({"x": 1000}, {"bus_delay": 1.01}, "bus_delay=1.01: start commands are 0 to 1 s apart"),
        ({"x": 1000}, {"accel": 0}, "accel=0: a ramp takes more than 0 s. For constant speed give rate = fl"),
        ({"x": 1000}, {"bus_delay": -1}, "bus_delay=-1"),
        ({"x": 900_000}, {"accel": 40}, "accel=40 s from 1000 to 16000 pps would need R4 outside 2 to 16383.* to 25.6"),
        ({"x": 50_000}, {"decel": 5e-6}, "decel=5e-06 s .* would need R5 outside"),
        ({"x": 900_000}, {"accel": 3e-4, "decel": 25}, "differ too much: no R7 keeps both R4 and R5"),
        ({"x": 16_000_000}, {"rate": 240_000, "decel": 20}, "ramp-down takes .* pulses, and R6 counts to 1048575"),
        ({"x": 1_000_000, "y": 20}, {}, "y would have to run at 0.32 pps, .* is 0.587 pps .*Raise the rate to 29326 pps"),
        ({"x": 50_000, "y": 600}, {"accel": 2.0}, "cannot ramp for accel=2 s: to 192 pps .* about 1 s .* off the line. Shorten"),
        ({"x": 9_000_000, "y": 8_000_000}, {"rate": 2e6, "clock_hz": {"x": 4_915_200, "y": 1_000_000}}, "to 562431 pps"),
        ({"x": 1000, "y": 500}, {"rate": 1000.2, "fl": 1000}, "accel=0.15 s .* would need R4 outside|within one speed step"),
        ({"y": 1000}, {"clock_hz": {"x": 4_915_200}}, "unknown axis in clock_hz 'y'"),
    ],
)  # fmt: skip
def test_the_error_of_an_impossible_plan_states_the_reason(distances, options, reason):
    with pytest.raises(ArgumentError, match=reason):
        plan(distances, **options)


def test_a_ramp_with_curved_ends_is_as_long_as_a_linear_one_of_its_effective_steps():
    for gain, share in ((1, 0.3), (2, 0.1), (3, 0.45), (40, 0.2), (41, 0.49)):
        span = max(round(share * gain), 1)
        made = compute_ramp_seconds(100, 100 + gain, 50, 4_915_200, min(span, gain // 2))
        assert compute_equivalent_linear_steps(gain, share) * 50 / 4_915_200 == pytest.approx(made, rel=1e-9)
    assert [compute_equivalent_linear_steps(40, share) for share in (0, 0.5)] == [40, 40]


def test_a_move_with_a_slow_fl_has_the_tail_of_the_data_sheet():
    """plan({"x": 1000, "y": 500}, rate=1000, fl=10): the 5 pulses at FL take half a second"""
    p = plan({"x": 1000, "y": 500}, rate=1000, fl=10)
    assert p.axes["x"].fl == pytest.approx(10, rel=0.05)
    assert p.axes["x"].has_ramps


def test_the_notes_of_a_plan_name_an_axis_that_cannot_ramp_slowly_enough():
    p = plan({"x": 26_318, "y": -114}, rate=12_000, accel=0.45)
    assert 2 < p.deviation < 5
    ramp, *_, distance = p.notes
    assert ramp.startswith(
        "axis y cannot ramp for accel=0.45 s: to 52 pps it takes no more than about 0.27 s (R7 = 1023"
    )
    assert distance.startswith(f"the closest registers leave the line by {p.deviation:.1f} pulses")


def test_a_plan_notes_an_fl_that_differs_from_its_share():
    p = plan({"x": 40_000, "y": 4_000})
    assert any(n.startswith("axis y: FL") for n in p.notes)


def test_a_plan_does_not_depend_on_earlier_plans():
    """The room that is handed on holds another follower's times: R5, R6 and scores are those of fresh room."""
    leader = np.array([6400, 100, 1600, 1600, 600, 600, 700, 24])
    hz, work = 4_915_200, np.zeros(1, follower_register_search.WORK_DTYPE)

    def rises(d, room):
        scores, kept = (
            np.empty(follower_register_search.MAX_CANDIDATES),
            np.zeros((follower_register_search.MAX_CANDIDATES, len(leader)), np.int64),
        )
        follower_register_search.fit_accelerations(leader, hz, d, hz, 0.0, 0.0, 16_383, 0, scores, kept, room)
        return kept

    def falls(kept, room):
        scores, best = (
            np.empty(follower_register_search.MAX_BEST_ROWS),
            np.zeros((follower_register_search.MAX_BEST_ROWS, len(leader)), np.int64),
        )
        follower_register_search.fit_decelerations(leader, hz, hz, 0.0, False, 16_383, 65_535, kept, scores, best, room)
        return scores.tolist(), best.tolist()

    kept = rises(3000, work)
    fresh = falls(kept, work)
    rises(500, work)
    assert falls(kept, work) == fresh
