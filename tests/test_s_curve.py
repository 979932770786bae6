"""scripts/s_curve.py and models/xy_mast.xml: what an S-curve is good for, and where it is not."""

import importlib.util
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from support.examples import FIXED

from stage import Stage

ROOT = Path(__file__).resolve().parents[1]


def _load():
    spec = importlib.util.spec_from_file_location("s_curve", ROOT / "scripts" / "s_curve.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["s_curve"] = module
    spec.loader.exec_module(module)
    return module


s = _load()
LINEAR, MIXED, CURVE = s.SHAPES


@pytest.mark.parametrize("joint", ["camera_x", "camera_y"])
def test_the_camera_swings_freely_at_9_9_hz_damped_by_one_percent_and_drags_nothing_along(joint):
    stage = Stage("xy_mast")
    at = stage.model.joint(joint).qposadr[0]
    stage.data.qpos[at] = 1e-3
    bend = np.empty(4000)
    for k in range(len(bend)):
        stage.step()
        bend[k] = stage.data.qpos[at]
    up = np.flatnonzero((bend[:-1] < 0) & (bend[1:] >= 0))
    periods = np.diff(up).mean() * stage.model.opt.timestep
    decrement = np.log(bend[up[0] : up[1]].max() / bend[up[5] : up[6]].max()) / 5
    frequency, damping = s.mast()
    assert 1 / periods == pytest.approx(frequency, rel=0.01)
    assert frequency == pytest.approx(9.9, abs=0.1)
    assert decrement / (2 * np.pi) == pytest.approx(damping, rel=0.15)
    other = stage.model.joint("camera_y" if joint == "camera_x" else "camera_x").qposadr[0]
    assert abs(stage.data.qpos[other]) < 1e-5
    assert all(axis.lost_steps == 0 for axis in stage.axes.values())


def test_a_positive_bend_of_the_mast_points_ahead_of_the_moving_axis():
    stage = Stage("xy_mast")
    for axis in ("x", "y"):
        before = stage.data.site("camera").xpos.copy()
        stage.place(**{axis: 0.01})
        moved = stage.data.site("camera").xpos - before
        stage.data.qpos[stage.model.joint(f"camera_{axis}").qposadr[0]] = 0.01
        stage.place(**{axis: 0.01})
        bent = stage.data.site("camera").xpos - before
        assert bent == pytest.approx(2 * moved, abs=1e-9), "a positive bend is ahead of the carriage"
        stage.reset()


@pytest.mark.parametrize("ramp", [0.05, 0.25])
def test_all_shapes_take_the_same_time_to_the_same_rate(ramp):
    for shape in s.SHAPES:
        r = s.run(shape, 64_000, ramp, s.PULSES)
        reached = r.seconds[np.argmax(r.rate >= 63_999)]
        assert reached == pytest.approx(ramp, rel=0.01, abs=5e-4), shape.name
        assert r.rate.max() == pytest.approx(64_000)


def test_peak_acceleration_is_once_one_and_a_half_times_and_twice_the_mean():
    for shape, times in ((LINEAR, 1), (MIXED, 1.5), (CURVE, 2)):
        r = s.run(shape, 64_000, 0.25, s.PULSES)
        up = (r.seconds > 0) & (r.seconds < 0.25)
        slope = np.gradient(r.rate[up], s.EVERY)
        smooth = np.convolve(slope, np.full(40, 1 / 40), "valid").max()  # 10 ms
        assert smooth == pytest.approx(times * 63_800 / 0.25, rel=0.05)
        assert shape.peak == times
        assert np.trapezoid(1 / shape.acceleration(np.linspace(1e-6, 1 - 1e-6, 200_001)), dx=5e-6) == pytest.approx(
            1, rel=0.01
        )


def test_at_equal_ramp_time_an_s_curve_leaves_less_than_a_third_of_the_ringing():
    linear, curve = (s.run(shape, s.RATE, s.RAMP, s.PULSES) for shape in (LINEAR, CURVE))
    assert linear.ringing > 0.5e-3
    assert curve.ringing < linear.ringing / 3
    assert abs(curve.stopped - linear.stopped) < 1e-3


def test_at_equal_peak_acceleration_it_leaves_less_than_a_sixth_and_is_quiet_seconds_earlier():
    linear = s.run(LINEAR, s.RATE, s.RAMP, s.PULSES, rest=4)
    curve = s.run(CURVE, s.RATE, 2 * s.RAMP, s.PULSES, rest=4)
    assert curve.ringing < linear.ringing / 6
    assert curve.stopped > linear.stopped + 0.2
    assert curve.quiet < linear.quiet - 2


def test_a_ramp_of_one_swing_of_the_mast_is_better_linear():
    one = 1 / s.mast()[0]
    linear, curve = (s.run(shape, s.RATE, one, s.PULSES) for shape in (LINEAR, CURVE))
    assert linear.ringing < curve.ringing / 5


@pytest.mark.parametrize("shape", s.SHAPES, ids=lambda shape: shape.name)
def test_ringing_is_that_of_the_spectra_of_the_accelerations(shape):
    ramps = np.array([0.06, 0.09, 0.145, 0.2, 0.25, 0.29, 0.35])
    theory = s.ringing_in_theory(shape, ramps)
    some = slice(None, None, 2 if FIXED else 1)
    measured = np.array([s.run(shape, s.RATE, t, s.PULSES).ringing for t in ramps[some]])
    assert measured == pytest.approx(theory[some], rel=0.2, abs=0.05e-3)
    assert theory.max() > 10 * theory.min()


def test_the_corner_of_a_hard_linear_ramp_loses_steps_and_an_s_curve_of_twice_the_peak_acceleration_none():
    assert not s.keeps_step(LINEAR, s.HARD_RATE, s.HARD_RAMP)
    assert s.keeps_step(CURVE, s.HARD_RATE, s.HARD_RAMP)


def test_after_a_hard_ramp_the_carriage_swings_a_third_as_much_or_less():
    linear, curve = (s.run(shape, 72_000, 0.05, s.LONG, "xyz") for shape in (LINEAR, CURVE))
    assert linear.lost == curve.lost == 0
    assert curve.swing < linear.swing / 3
    assert curve.worst_error < linear.worst_error


def test_the_highest_rate_is_exact_to_one_percent_and_excludes_isolated_successes(monkeypatch):
    monkeypatch.setattr(s, "keeps_step", lambda shape, rate, ramp: rate < 91_234 or 95_000 < rate < 100_000)
    result = s.highest_rate(LINEAR, 0.05)
    assert 91_234 / 1.01 < result.rate < 91_234
    assert result.lucky
    assert all(95_000 < rate < 100_000 for rate in result.lucky)


def test_the_figures_of_the_page_match_the_simulation():
    page = (ROOT / "docs" / "s_curve.md").read_text()
    rows = re.findall(
        r"^\| (linear|S-curve, linear part|S-curve) \| (\d+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$",
        page,
        re.M,
    )
    runs = s.camera_runs()
    assert [(name, float(ms)) for name, ms, *_ in rows] == [(shape.name, ramp * 1e3) for shape, ramp in runs]
    for (_, _, _, stopped, ringing, quiet), r in zip(rows, runs.values(), strict=True):
        assert float(stopped) == pytest.approx(r.stopped, abs=0.01)
        assert float(ringing) == pytest.approx(r.ringing * 1e3, abs=0.01)
        assert float(quiet) == pytest.approx(r.quiet, abs=0.11), "within one swing"


@pytest.mark.slow
def test_the_picture_is_drawn(monkeypatch, tmp_path):
    monkeypatch.setattr(s, "RAMPS", np.array([0.1, 0.25]))
    monkeypatch.setattr(s, "LIMITS", (0.08,))
    monkeypatch.setattr(s, "GRID", np.array([100_000.0, 130_000.0]))
    s.draw(tmp_path / "s.png")
    assert (tmp_path / "s.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
