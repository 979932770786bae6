"""Measures of a trial: when the tool is quiet, which moves fail, and the sum of several moves."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from stage.chips import PCL240K
from stage.study import PresetMoves, preset_move_objective, suggest_registers
from stage.study.preset_move_objective import FAILURE_PENALTY_S, SPACE, _combine_measures, _measure_move

SECONDS = np.array([-0.1, 0.0, 0.1, 0.2, 0.3, 0.4])
"""Times of the samples since the first pulse; a move takes 0.2 s."""


def measure_move(monkeypatch, deviations, ok=True, lost=0, band=1e-3, camera=None):
    """Measure a move of 100 pulses against the joint's positive direction, with these deviations of the tool, m, at SECONDS."""
    requested = []
    axis = SimpleNamespace(commanded=0.5, meters_per_pulse=2e-3, gear=-300.0)
    columns = {"time": 5.0 + 0.25 + SECONDS, "x/position": 0.3 + np.array(deviations)}
    recording = SimpleNamespace(
        column=columns.__getitem__,
        pieces=lambda: [{"qpos": np.array([[0, c] for c in part])} for part in np.split(camera, 2)],
    )
    names = ["x"] if camera is None else ["x", "camera_x"]
    joints = [SimpleNamespace(name=name, qposadr=[k]) for k, name in enumerate(names)]
    stage = SimpleNamespace(
        axes={"x": axis}, time=5.0, record=lambda every: nullcontext(recording), run=requested.append,
        model=SimpleNamespace(njnt=len(joints), joint=joints.__getitem__),
    )  # fmt: skip
    report = SimpleNamespace(began=0.25, duration=0.2, ok=ok, lost_steps=lost)
    monkeypatch.setattr(
        preset_move_objective.firmware, "preset_move", lambda *arguments: requested.append(arguments[1:]) or report
    )
    results = _measure_move(stage, "x", "a profile", 100, band, 0.7)
    assert requested == [(100, "a profile"), 0.7]
    assert results["duration"] == 0.2
    return results


@pytest.mark.parametrize(
    ("deviations", "score"),
    [
        ([0, 0, 0, 0, 0, 0], 0.2),  # always at the goal: the duration of the move
        ([0.2, 0.1, 2e-3, 0, 0, 0], 0.2),  # quiet at its end
        ([0.2, 0.1, 0.1, 2e-3, 0, 0], 0.3),  # quiet at the sample after the last one outside
        ([0.2, 0.1, 0.1, 0, -2e-3, 0], 0.4),  # the other side counts as well
        ([0.2, 0.1, 0.1, 0, 0, 2e-3], 0.4 + FAILURE_PENALTY_S),  # the last sample is outside
        ([0.2, 0.1, 0.1, 0.9e-3, 0.9e-3, -0.9e-3], 0.2),  # vibrates within the band
    ],
)
def test_the_score_of_a_move_ends_when_the_tool_stays_within_its_band(monkeypatch, deviations, score):
    assert measure_move(monkeypatch, deviations)["score"] == pytest.approx(score)


def test_an_incomplete_move_fails_and_unknown_steps_do_not_count_as_lost(monkeypatch):
    quiet = [0.0] * 6
    failed = measure_move(monkeypatch, quiet, ok=False, lost=-4)
    assert (failed["score"], failed["reached"], failed["lost_steps"]) == (pytest.approx(0.2 + FAILURE_PENALTY_S), 0, -4)
    unknown = measure_move(monkeypatch, quiet, lost=None)
    assert (unknown["score"], unknown["reached"], unknown["lost_steps"]) == (pytest.approx(0.2), 1, 0)


def test_the_vibration_is_half_of_the_swing_after_the_last_pulse(monkeypatch):
    """The samples at 0.2, 0.3 and 0.4 s count"""
    assert measure_move(monkeypatch, [9, 9, 9, 3e-3, -1e-3, 0])["vibration"] == pytest.approx(2e-3)


def test_the_position_of_a_mast_tool_includes_the_bend_of_the_mast(monkeypatch):
    """The camera deviates by 2 mm in the opposite direction: the carriage alone would not be quiet"""
    deviations = np.array([0, 0, 0, 0, 2e-3, 2e-3])
    assert measure_move(monkeypatch, deviations, camera=-deviations)["score"] == pytest.approx(0.2)
    assert measure_move(monkeypatch, np.zeros(6), camera=deviations)["score"] == pytest.approx(0.4 + FAILURE_PENALTY_S)


def test_several_moves_have_the_mean_score_the_total_time_and_the_worst_vibration():
    moves = [
        {"score": 1.0, "duration": 0.5, "lost_steps": 4, "reached": 1, "vibration": 3.0},
        {"score": 4.0, "duration": 0.25, "lost_steps": -8, "reached": 0, "vibration": 2.0},
        {"score": 1.0, "duration": 0.25, "lost_steps": 0, "reached": 1, "vibration": 1.0},
    ]
    assert _combine_measures(moves) == {"score": 2.0, "duration": 1.0, "lost_steps": 12, "reached": 2, "vibration": 3.0}
    assert _combine_measures(moves[1:2]) == {
        "score": 4.0,
        "duration": 0.25,
        "lost_steps": 8,
        "reached": 0,
        "vibration": 2.0,
    }


def test_a_trial_makes_each_move_of_its_objective_in_order(monkeypatch):
    """Axis y with a given start, band and rest: three moves, and one move for a single number of pulses"""
    requested, reported = [], []
    move = {"score": 1.0, "duration": 1.0, "lost_steps": 0, "reached": 1, "vibration": 0.0}
    monkeypatch.setattr(
        preset_move_objective, "_measure_move",
        lambda stage, name, profile, *arguments: requested.append((name, round(stage.axes["y"].position, 3), *arguments)) or move,
    )  # fmt: skip
    registers = {"R1": 20, "R2": 640, "R4": 400, "R5": 400, "R7": 12}
    settings = {"model": "xy", "axis": "y", "start": 0.02, "band": 3e-6, "rest": 0.125}
    PresetMoves(**settings, pulses=(10, -20, 30)).measure(
        registers, 1, lambda k, measures: reported.append((k, measures["duration"]))
    )
    assert requested == [("y", 0.02, 10, 3e-6, 0.125), ("y", 0.02, -20, 3e-6, 0.125), ("y", 0.02, 30, 3e-6, 0.125)]
    assert reported == [(0, 1.0), (1, 2.0)], "after each move except the last"
    requested.clear()
    PresetMoves(**settings, pulses=7).measure(registers, 1)
    assert [arguments[2] for arguments in requested] == [7]


def test_each_kind_of_range_uses_its_optuna_suggestion():
    """Ranges with even and logarithmic scale, several values, one value"""
    requested = []
    trial = SimpleNamespace(
        suggest_int=lambda name, low, high, log=False: requested.append((name, low, high, log)) or low,
        suggest_categorical=lambda name, values: requested.append((name, values)) or values[-1],
    )
    results = suggest_registers(trial, {"R1": "4:100:log", "R2": "400:2800", "R4": "10,20,40", "R7": 12})
    assert requested == [("R1", 4, 100, True), ("R2", 400, 2800, False), ("R4", (10, 20, 40)), ("R7", 12, 12, False)]
    assert results == {"R1": 4, "R2": 400, "R4": 40, "R7": 12}
    assert {name: preset_move_objective.parse_register_values(name, text) for name, text in SPACE.items()} == {
        "R1": (4, 100, True), "R2": (400, 2800, False), "R4": (60, 800, True), "R5": (60, 800, True), "R7": (12,),
    }  # fmt: skip
    assert PresetMoves(model="xy")._chip is PCL240K
