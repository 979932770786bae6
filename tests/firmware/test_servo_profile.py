"""Custom profiles: a command a sample, in its safe part, to axes in step by SYNC; the error that a linear model predicts."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from stage import ArgumentError, Stage
from stage.chips import HCTL1100
from stage.chips.journal_entries import WRITE
from stage.firmware.hctl1100.chip_port import ChipPort
from stage.firmware.hctl1100.moves import FilterTuning, set_up_servo
from stage.firmware.hctl1100.position_streaming import (
    compute_circle_errors,
    compute_circle_positions,
    stream_positions,
    synchronize_sample_timers,
)
from stage.firmware.hctl1100.servo_loop_model import ServoLoop, design_filter

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

import servo_moves

RADIUS, SECONDS = 2_000, 0.6


@pytest.fixture
def stage():
    return Stage("xyz_servo", chips=HCTL1100, visuals=False)


def early(ports):
    """Notes of commands written while a sample was computed."""
    return [d for port in ports for d in port.chip.diagnostics if "while the sample is computed" in d.message]


@pytest.mark.parametrize("axes", [2, 3])
def test_a_circle_lies_on_a_circle_from_rest_to_rest(axes):
    points = compute_circle_positions(RADIUS, seconds=SECONDS, sample=520e-6, axes=axes)
    assert abs(compute_circle_errors(points, RADIUS)).max() < 1e-6
    assert points[-1] == pytest.approx(np.zeros(axes), abs=1e-6)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() * len(points) == pytest.approx(2 * np.pi * RADIUS * SECONDS / (SECONDS - 0.2), rel=0.01)
    assert max(steps[0], steps[-1]) < 0.02 * steps.max()
    away = points + [3.0, 4.0, 12.0][:axes]
    assert 0 < compute_circle_errors(away, RADIUS).max() <= 13.0
    if axes == 3:  # beside its plane
        assert compute_circle_errors(points + np.array([0.0, 3.0, -3.0]), RADIUS) == pytest.approx(
            3 * math.sqrt(2), abs=1e-6
        )
    for radius, number in ((RADIUS, 4), (float("nan"), 2)):
        with pytest.raises(ArgumentError, match="a finite radius, 2 or 3 axes"):
            compute_circle_positions(radius, seconds=SECONDS, sample=520e-6, axes=number)
    assert len(compute_circle_positions(RADIUS, seconds=0.4, sample=520e-6, ramp=0.2)) == 770, (
        "half of the time is ramp"
    )
    for ramp in (0.0, -0.1, 0.201):
        with pytest.raises(ArgumentError, match=f"ramp={ramp}"):
            compute_circle_positions(RADIUS, seconds=0.4, sample=520e-6, ramp=ramp)
    for sample in (0.0, -1e-3, float("nan")):
        with pytest.raises(ArgumentError, match=f"sample={sample}: .*a sample time above 0"):
            compute_circle_positions(RADIUS, seconds=SECONDS, sample=sample)


def test_sync_lets_the_samples_of_all_axes_begin_at_one_clock(stage):
    ports = []
    for axis in stage.axes.values():
        stage.run(137e-6)
        axis.chip.write(0x05, 0)
        ports.append(set_up_servo(axis))
    assert len({int(port.chip.state["sample_end"]) for port in ports}) == 3
    synchronize_sample_timers(ports)
    assert len({int(port.chip.state["sample_end"]) for port in ports}) == 1
    stage.run(0.05)
    for port in ports:
        assert abs(port.read_command_position() - port.read_position()) <= 8, "gravity on Z"
    other = set_up_servo(stage.axes["x"], FilterTuning(timer=0x20))
    with pytest.raises(ArgumentError, match="one sample time"):
        synchronize_sample_timers([other, ports[1]])


@pytest.mark.parametrize(("timer", "names"), [(0x20, "xyz"), (0x40, "xyz"), (0x40, "yx")])
def test_a_profile_is_one_command_a_sample_each_in_the_safe_part(stage, timer, names):
    ports = [set_up_servo(stage.axes[n], FilterTuning(timer=timer)) for n in names]
    synchronize_sample_timers(ports)
    begin = [port.read_command_position() for port in ports]
    profile = compute_circle_positions(RADIUS, seconds=SECONDS, sample=ports[0].sample, axes=len(ports))
    journals = [port.chip.journal() for port in ports]
    report = stream_positions(ports, profile)
    assert report.missed == 0
    assert report.commands == len(profile)
    assert report.seconds == pytest.approx(SECONDS, abs=2 * ports[0].sample)
    assert not early(ports)
    for port, journal, k in zip(ports, journals, range(len(ports)), strict=True):
        written = [e.clock for e in journal.entries if e.kind == WRITE and e.a == 0x0E]
        clocks = 16 * (timer + 1)
        assert len(written) == len(profile)
        assert abs(np.diff(written) - clocks).max() <= 16 * 2
        assert port.read_command_position() == begin[k] + round(float(profile[-1, k]))


def test_the_error_of_a_too_slow_host_counts_the_missed_samples():
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False, bus_cycle=80e-6)
    ports = [set_up_servo(stage.axes[n]) for n in "xyz"]
    synchronize_sample_timers(ports)
    profile = np.zeros((50, 3))
    assert stream_positions(ports, profile).missed > 20
    for arguments, where in [((5, 2), ports), ((5,), ports[:1]), ((5, 0), [])]:
        with pytest.raises(ArgumentError, match=r"\(samples, axes\)"):
            stream_positions(where, np.zeros(arguments))


def test_a_designed_gain_is_within_its_register():
    """design(loop, rattle=1e6) of a motor that wants more than 255"""
    weak = ServoLoop(gain=400.0, tau=0.05, friction=0.0, tuning=FilterTuning(pole=64, timer=64))
    gains = [design_filter(weak, rattle=rattle).gain for rattle in (1e6, 48.0)]
    assert 192 < gains[0] <= 255
    assert gains[1] <= 192


def test_without_a_common_sample_each_chips_timer_is_polled(stage, monkeypatch):
    """follow(ports, profile, leader_only=False)"""
    ports, requested = [set_up_servo(stage.axes[name]) for name in "xy"], []
    monkeypatch.setattr(
        ChipPort, "wait_for_safe_part_of_sample", lambda port, mode="position": requested.append(port.axis.name)
    )
    for alone, expected in ((True, ["x", "x"]), (False, ["x", "x", "y"] * 2)):
        stream_positions(ports, np.zeros((2, 2)), leader_only=alone)
        assert requested == expected
        requested.clear()


def test_a_profile_of_fractions_is_rounded_to_the_nearest_count(stage):
    port = set_up_servo(stage.axes["x"])
    begin, journal = port.read_command_position(), port.chip.journal()
    stream_positions([port], np.array([[0.6], [-0.6], [1.4], [2.7]]))
    written = [e.b for e in journal.entries if e.kind == WRITE and e.a == 0x0E]
    assert written == [begin + count & 0xFF for count in (1, -1, 1, 3)]


@pytest.mark.slow
def test_a_circle_of_three_axes_is_rounder_with_sync_than_without():
    off, torn = {}, {}
    for name, (sync, one, _) in servo_moves.CIRCLES.items():
        _, distance, torn[name] = servo_moves.run_circle(sync, one)
        off[name] = np.sqrt((distance**2).mean())
    with_sync, are_separate, blind = off.values()
    assert with_sync < 0.6 * are_separate
    assert are_separate < blind
    assert list(torn.values())[:2] == [0, 0]
    assert list(torn.values())[2] > 100, "whoever reads one timer of chips out of step writes to the others too early"


def test_commands_written_too_early_kick_the_axis_and_safe_ones_do_not():
    """Each time that the low byte of the command wraps, a torn one is 256 counts off."""
    _, bad = servo_moves.run_line(early=True)
    _, good = servo_moves.run_line(early=False)
    moving = slice(400, None)
    assert np.ptp(good[moving]) < 6
    assert np.ptp(bad[moving]) > 4 * np.ptp(good[moving])


# --- the linear model ---


@pytest.mark.parametrize(
    "tuning",
    [FilterTuning(), FilterTuning(gain=0x30, zero=0xF0, pole=0x00, timer=0x20)],
    ids=["after a reset", "other"],
)
def test_the_following_error_of_a_trapezoid_is_the_linear_models_within_a_tenth(tuning):
    move = servo_moves.run_trapezoid(tuning)
    assert move.report.ok
    assert move.command[-1] == servo_moves.COUNTS
    assert np.abs(move.predicted).max() > 15, "there is something to predict"
    assert move.deviation < 0.1
    flat = np.abs(np.diff(move.command, 2, append=[0, 0])) <= 1
    assert flat.any()
    assert np.abs(move.error).max() == pytest.approx(np.abs(move.predicted).max(), rel=0.1)


def test_the_models_plant_is_the_differential_equation_sampled():
    """A constant motor command from rest: x = g u (t - tau (1 - exp(-t / tau)))."""
    from scipy.signal import dlsim

    loop = ServoLoop(gain=1260.0, tau=0.02, friction=0.0, tuning=FilterTuning())
    b, a = loop.plant
    t, x = dlsim((b, a, loop.sample), np.ones(400))
    expected = loop.gain * (t - loop.tau * (1 - np.exp(-t / loop.tau)))
    assert x[:, 0] == pytest.approx(expected, abs=1e-6)


def test_the_models_closed_loop_is_the_sum_over_its_samples():
    """Worked out sample by sample: filter, then plant with its two states."""
    loop = ServoLoop(gain=1260.0, tau=0.02, friction=1.5, tuning=FilterTuning())
    h, p, k, t = loop.sample, np.exp(-loop.sample / loop.tau), loop.tuning.gain / 4, loop.tuning
    command = np.cumsum(np.concatenate([[0], np.minimum(np.arange(1, 300) * 0.1, 12)]))
    x = v = e_before = u = 0.0
    expected = []
    for n, r in enumerate(command):
        e = r - x
        u = k * e - t.zero / 256 * k * e_before - t.pole / 256 * u
        e_before = e
        expected.append(e)
        direction = 1.0 if n and r > command[n - 1] else 0.0
        f = loop.gain * (u - loop.friction * direction)
        x, v = x + loop.tau * (1 - p) * v + (h - loop.tau * (1 - p)) * f, p * v + (1 - p) * f
    assert loop.compute_following_error(command) == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize("name", ["x", "y"])
@pytest.mark.parametrize("payload", [0.0, 8.0])
def test_the_models_masses_and_friction_are_those_of_the_machine(stage, name, payload):
    """An open loop: half of full drive from rest, PWM port in Init/Idle; the way after 0.1 s."""
    axis = stage.axes[name]
    stage.set_payload(payload)
    loop, before = ServoLoop.from_axis(axis, FilterTuning()), axis.position
    axis.chip.write(0x09, 50)
    stage.run(0.1)
    u = 50 - loop.friction
    expected = loop.gain * u * (0.1 - loop.tau * (1 - np.exp(-0.1 / loop.tau)))
    assert (axis.position - before) / axis.meters_per_pulse == pytest.approx(expected, rel=0.02)
