"""stage.study.preset_move_objective: measures of a trial, equal bit for bit in every thread and process."""

import subprocess
import sys

import pytest
from support.mirrored import mirrored

pytest.importorskip("optuna", reason="Optuna is not installed: pip install -e '.[tune]'")

import optuna

from stage import Stage
from stage.chips import PCL240K, PCL240MS
from stage.errors import ArgumentError
from stage.study import PresetMoves, open_study, preset_move_objective, run
from stage.study.preset_move_objective import (
    FAILURE_PENALTY_S,
    RegisterRange,
    _combine_measures,
    _measure_move,
    build_profile,
    parse_register_values,
)

GENTLE = {"R1": 20, "R2": 640, "R4": 400, "R5": 400, "R7": 12}
MOVE = PresetMoves(model="xy", pulses=2000, rest=0.05)


def test_a_trial_has_the_same_bits_in_any_thread(tmp_path):
    """study.optimize(objective, n_jobs=3); objective.measure(trial.params, trial.user_attrs["seed"])"""
    study = open_study(MOVE, tmp_path / "study")
    study.optimize(MOVE, n_trials=6, n_jobs=3)
    for trial in study.trials:
        measured = MOVE.measure(trial.params, trial.user_attrs["seed"])
        assert measured == {name: trial.user_attrs[name] for name in measured}
        assert trial.value == measured["score"]
    assert len({trial.user_attrs["seed"] for trial in study.trials}) == 6


def test_a_process_without_optuna_measures_the_same_bits_and_names_the_extra_for_studies():
    program = f"""
import sys
sys.modules["optuna"] = None
from stage.study import PresetMoves, open_study
move = {MOVE!r}
print(move.measure({GENTLE}, 1))
open_study(move, "study")
"""
    completed = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert completed.stdout == f"{MOVE.measure(GENTLE, 1)}\n"
    assert "ExtraMissing: a study needs Optuna: pip install -e '.[tune]'" in completed.stderr


def test_the_defaults_of_preset_moves_are_those_of_the_page_about_studies():
    assert vars(PresetMoves()) == {
        "space": preset_move_objective.SPACE,
        "goals": ("score",),
        "model": "xyz",
        "axis": "x",
        "chips": "pcl240k",
        "pulses": 16_000,
        "start": -0.13,
        "band": 20e-6,
        "rest": 0.3,
        "seed": 0,
    }


def test_measures_of_a_move_follow_from_its_duration_lost_steps_and_vibration():
    move = PresetMoves(pulses=8000)
    good = move.measure(GENTLE, 1)
    assert (good["lost_steps"], good["reached"]) == (0, 1)
    assert good["duration"] == pytest.approx(8000 / 32_000 + 620 * 400 / 4_915_200, rel=0.02)
    assert good["duration"] <= good["score"] < good["duration"] + 0.02
    assert 0 < good["vibration"] < 20e-6
    harsh = move.measure(GENTLE | {"R2": 2800, "R4": 10, "R5": 10}, 1)
    assert harsh["lost_steps"] > 0
    assert harsh["reached"] == 0
    assert harsh["score"] > 10


def test_a_move_that_an_end_limit_stopped_fails_with_any_band():
    """PresetMoves(band=1.0)"""
    stage = Stage("xy", visuals=False)
    stage.axes["x"].switches.stick("el_plus", True)
    measures = _measure_move(stage, "x", build_profile(GENTLE, PCL240K), 2000, band=1.0, rest=0.01)
    assert (measures["reached"], measures["lost_steps"]) == (0, 0)
    assert measures["score"] >= FAILURE_PENALTY_S


def test_lost_steps_of_opposite_directions_do_not_cancel():
    """PresetMoves(pulses=(2000, -2000)): a move reports the steps that it loses with the sign of their direction"""
    move = {"score": 1.0, "duration": 1.0, "reached": 0, "vibration": 0.0}
    assert _combine_measures([move | {"lost_steps": 4}, move | {"lost_steps": -4}])["lost_steps"] == 8
    assert _combine_measures([move | {"lost_steps": -8}, move | {"lost_steps": 0}])["lost_steps"] == 8


def test_an_s_curve_halves_the_vibration_of_a_camera_on_a_mast():
    registers = {"R1": 4, "R2": 1280, "R4": 963, "R5": 963, "R7": 12}
    move = PresetMoves(registers | {"R14": 0}, model="xy_mast", chips="pcl240ms", pulses=42_100, rest=0.5)
    linear = move.measure(registers, 1)
    curved = move.measure(registers | {"R14": 0, "R15": 0}, 1)
    assert curved["vibration"] < linear["vibration"] / 2
    assert linear["vibration"] == pytest.approx(0.62e-3, rel=0.2)  # README


def test_a_pruner_ends_a_trial_between_its_moves(tmp_path):
    back_and_forth = PresetMoves(model="xy", pulses=[2000, -2000], rest=0.05)
    study = open_study(back_and_forth, tmp_path / "study", pruner=optuna.pruners.ThresholdPruner(upper=0.0))
    study.optimize(back_and_forth, n_trials=1)
    trial = study.trials[0]
    assert trial.state.name == "PRUNED"
    first = PresetMoves(model="xy", pulses=2000, rest=0.05).measure(trial.params, trial.user_attrs["seed"])
    assert trial.intermediate_values == {0: first["score"]}


def test_a_pruner_receives_the_value_of_the_goal(monkeypatch):
    """PresetMoves(goals=("duration",), pulses=(2000, -2000, 2000))"""
    reported = []
    moves = [{"score": 9.0, "duration": t, "lost_steps": 0, "reached": 1, "vibration": 0.0} for t in (0.5, 0.25, 1.0)]
    monkeypatch.setattr(preset_move_objective, "_measure_move", lambda *arguments: moves[len(reported)])
    monkeypatch.setattr(optuna.trial.FixedTrial, "report", lambda trial, value, step: reported.append((step, value)))
    goal = PresetMoves(
        space={k: v for k, v in GENTLE.items()}, goals=("duration",), model="xy", pulses=(2000, -2000, 2000)
    )
    assert goal(optuna.trial.FixedTrial(GENTLE)) == 1.75
    assert reported == [(0, 0.5), (1, 0.75)]


def test_starts_are_drawn_within_a_tenth_of_a_millimeter_in_both_directions(monkeypatch):
    starts = []
    move = {"score": 1.0, "duration": 1.0, "lost_steps": 0, "reached": 1, "vibration": 0.0}
    monkeypatch.setattr(
        preset_move_objective,
        "_measure_move",
        lambda stage, *arguments: starts.append(stage.axes["x"].position) or move,
    )
    for seed in range(12):
        MOVE.measure(GENTLE, seed)
    off = [start - MOVE.start for start in starts]
    assert min(off) < -2e-5
    assert max(off) > 2e-5
    assert max(map(abs, off)) < 1.1e-4


def test_a_study_of_two_goals_has_their_pareto_front(tmp_path):
    objective = PresetMoves(goals=("score", "vibration"), model="xy", pulses=[2000, -2000], rest=0.05)
    study = run(objective, tmp_path / "study", 6)
    values = {trial.number: tuple(trial.values) for trial in study.trials}
    assert values == {t.number: (t.user_attrs["score"], t.user_attrs["vibration"]) for t in study.trials}
    front = {t.number for t in study.best_trials}
    for number, (score, vibration) in values.items():
        beaten = any(s <= score and v <= vibration and (s, v) != (score, vibration) for s, v in values.values())
        assert (number in front) == (not beaten)


def test_registers_become_a_profile_and_the_error_names_missing_and_unknown_ones():
    registers = {"R1": 25, "R2": 500, "R4": 90, "R5": 80, "R7": 12}
    profile = build_profile(registers, PCL240K)
    assert profile.registers() == registers | {"R3": 500}
    assert (profile.spans, profile.chip) == (None, PCL240K)
    assert build_profile(registers | {"R3": 7}, PCL240K).R3 == 7
    for curved, spans in (({"R14": 5}, (5, 0)), ({"R15": 6}, (0, 6)), ({"R14": 5, "R15": 6}, (5, 6))):
        assert build_profile(registers | curved, PCL240MS).spans == spans
    with pytest.raises(ArgumentError, match="unknown PCL240K speed register 'R14'"):
        build_profile(registers | {"R14": 5}, PCL240K)
    for name in registers:
        with pytest.raises(ArgumentError, match=f"a preset move needs {name}, too"):
            build_profile({n: v for n, v in registers.items() if n != name}, PCL240K)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"chips": "mcx514"}, "PCL-240 family"),
        ({"axis": "w"}, "axis 'w'"),
        ({"goals": ("speed",)}, "unknown goal 'speed'"),
        ({"goals": ()}, "one at least"),
        ({"space": {"R2": "400:2800"}}, "needs R1, R4, R5, R7, too"),
        ({"space": GENTLE | {"R2": "9:1"}}, "R2=9:1"),
    ],
)
def test_an_invalid_objective_is_refused_before_its_first_trial(options, message):
    with pytest.raises(ArgumentError, match=message):
        PresetMoves(**{"model": "xy", **options})


def test_values_of_a_register_are_one_value_several_or_a_range():
    assert parse_register_values("R7", 12) == parse_register_values("R7", "12") == (12,)
    assert parse_register_values("R7", "12,24") == (12, 24)
    assert parse_register_values("R2", "400:2800") == RegisterRange(400, 2800, False)
    assert parse_register_values("R4", "60:800:log") == RegisterRange(60, 800, True)


@pytest.mark.parametrize("text", ["", "a", "5:4", "0:9:log", "1:9:lin", "1:9/3", "1:2:log:3", "1.5", "-5:5", "-5", -5])
def test_invalid_values_of_a_register_are_refused(text):
    with pytest.raises(ArgumentError, match="R2="):
        parse_register_values("R2", text)


def test_a_move_on_a_screw_with_an_inverse_gear_reaches_its_goal(tmp_path):
    results = PresetMoves(model=mirrored(tmp_path), pulses=400, start=0.0, rest=0.1, band=1e-4).measure(
        {"R1": 20, "R2": 640, "R4": 400, "R5": 400, "R7": 12}, seed=1
    )
    assert (results["reached"], results["lost_steps"]) == (1, 0)
    assert results["score"] < 1


def test_reached_counts_the_complete_moves():
    registers = {"R1": 20, "R2": 640, "R4": 400, "R5": 400, "R7": 12}
    assert PresetMoves(pulses=(400, -400, 400), rest=0.05).measure(registers, seed=1)["reached"] == 3
