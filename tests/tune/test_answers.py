"""Selection of the answer by `tune`, its result texts and its errors, with moves whose outcomes the tests define."""

import json
import re
from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.mirrored import mirrored

from stage import Stage
from stage.chips import PCL240K
from stage.errors import StageError
from stage.firmware.driver import Speeds
from stage.tune import Task, proof, tune, tuning
from stage.tune.bus_listing import RegisterValue
from stage.tune.move_runner import MoveOutcomes
from stage.tune.register_planners import MovePlan, create_planner
from stage.tune.result import Answer, TuningResult
from stage.tune.search import Trial

PAYLOAD, MAX_PAYLOAD = 2.0, 2.6  # kg, with the spare


def make_task(stage=None, **settings):
    stage = Stage("xy", chips=PCL240K, visuals=False) if stage is None else stage
    return Task(stage, "x", **{"pulses": 400, "payload": PAYLOAD, "hold": 0.02, **settings})


@pytest.fixture(scope="module")
def task():
    return make_task()


def make_named_plan(name):
    return MovePlan({"name": name}, Speeds())


class ScriptedRunner:
    """Move runner whose outcomes the test defines.

    `outcome_of(plan name, case)` returns the arrival time in seconds and whether the move keeps step. The plan of the formula is
    called "formula".
    """

    def __init__(self, task, outcome_of):
        self.task, self.planner, self.outcome_of, self.move_count = task, None, outcome_of, 0

    def run_moves(self, plans, cases, limit):
        outcomes = np.array(
            [[self.outcome_of(p.registers.get("name", "formula"), c) for c in cases] for p in plans], float
        )
        times = np.where(outcomes[..., 0] <= limit, outcomes[..., 0], np.nan)
        return MoveOutcomes(times, outcomes[..., 1] != 0, np.zeros(times.shape))

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        pass


@pytest.fixture
def tune_scripted(monkeypatch, task):
    """Function (outcome_of, moves, measured times of the trials by name, names of broken trials) that runs `tune`."""

    def run_tune(outcome_of, moves, measured_times=None, broken_names=(), **settings):
        ranked = [
            Trial(k, make_named_plan(name), worst, int(name in broken_names))
            for k, (name, worst) in enumerate((measured_times or {}).items())
        ]
        monkeypatch.setattr(tuning, "import_optuna", lambda: None)
        monkeypatch.setattr(tuning, "search_registers", lambda *arguments: (ranked, False))
        monkeypatch.setattr(tuning, "MoveRunner", lambda task, plans, workers: ScriptedRunner(task, outcome_of))
        return tune(task, by="formula" if measured_times is None else "search", moves=moves, **settings)

    return run_tune


def test_a_slow_candidate_is_observed_in_the_proof_until_it_arrives(tune_scripted):
    result = tune_scripted(
        lambda name, case: ({"fast": 0.05, "slow": 0.2}.get(name, 0.3), True), 8, {"fast": 0.05, "slow": 0.2}
    )
    assert (result.selected_name, result.rejected_count) == ("search", 0)
    assert result.answer.plan == make_named_plan("fast")


def test_the_candidate_with_the_lowest_mean_time_is_selected(tune_scripted):
    uneven = {"uneven": lambda case: 0.2 if case.payload == 0 else 0.04, "even": lambda case: 0.13}
    result = tune_scripted(
        lambda name, case: (uneven[name](case) if name in uneven else 0.3, True), 8, {"even": 0.13, "uneven": 0.2}
    )
    assert result.answer.plan == make_named_plan("uneven")


def test_registers_that_lose_steps_at_a_payload_within_the_margin_are_rejected(tune_scripted):
    """The registers carry the payload of 2 kg and 2.6 kg, but not 2.3 kg"""
    result = tune_scripted(
        lambda name, case: (0.1, name == "formula" or not 2.1 < case.payload < 2.5), 3, {"other": 0.1}
    )
    assert (result.selected_name, result.rejected_count, len(result.answers)) == ("formula", 1, 1)
    assert "found nothing that passes the proof" in result.explain_selection()


def test_a_time_gain_below_its_error_does_not_replace_the_formula(tune_scripted):
    result = tune_scripted(
        lambda name, case: (0.1 - (0.002 if name == "lucky" and case.payload == 0 else 0.0), True), 3, {"lucky": 0.1}
    )
    assert result.selected_name == "formula"
    assert "gains 1.0 ms (+- 2.0 ms), which the proof cannot tell from nothing" in result.explain_selection()


def test_the_search_wins_at_equal_time_if_the_formula_loses_steps_in_the_proof(tune_scripted):
    result = tune_scripted(
        lambda name, case: (0.1, name == "sound" or case.payload in (0.0, PAYLOAD, MAX_PAYLOAD)), 4, {"sound": 0.1}
    )
    assert result.selected_name == "search"
    assert result.explain_selection() == "The search's registers (1 trials): the formula's lose steps in the proof."


def test_the_error_of_a_formula_that_loses_steps_states_its_largest_payload(tune_scripted):
    with pytest.raises(StageError, match=r"lose steps, .* Up to 1\.3 kg in all they keep step"):
        tune_scripted(lambda name, case: (0.1, case.payload <= 1.4), 3)
    with pytest.raises(StageError, match="Nor do they keep step with nothing on it"):
        tune_scripted(lambda name, case: (0.1, False), 3)


def test_a_swinging_move_is_observed_for_four_times_the_usual_limit(tune_scripted):
    assert tune_scripted(lambda name, case: (0.9, True), 3).answer.proof.max_time == 0.9
    with pytest.raises(StageError, match=r"keep step, but do not come to rest within .* give more room, --settle"):
        tune_scripted(lambda name, case: (9.0, True), 3)


def test_the_error_counts_the_good_machines_when_no_registers_pass_the_proof(tune_scripted):
    message = (
        r"no registers are proved with up to 2\.6 kg: a proof wants every drawn machine to be good\. Of the formula's 4 machines 3 "
        r"were good, 1 did not keep step\. The strongest of those that failed has core loss 0\.000\d+ N m s/rad, .*, supply "
        r"[\d.]+ V\. "
        r"Ask for less payload or spare, "
        r"give more room \(--settle, --overshoot\), or search longer \(--trials\)\."
    )
    with pytest.raises(StageError, match=message):
        tune_scripted(
            lambda name, case: (0.1, name == "formula" and case.payload in (0.0, PAYLOAD, MAX_PAYLOAD)), 4, {"bad": 0.1}
        )


def test_the_fastest_candidate_that_passes_the_proof_is_the_answer(tune_scripted):
    measured_times = {f"try {k}": 0.1 + 0.01 * k for k in range(20)}
    result = tune_scripted(
        lambda name, case: (measured_times.get(name, 0.5), name not in ("try 0", "try 1")), 4, measured_times
    )
    assert result.answer.plan == make_named_plan("try 2")
    assert (len(result.answers), result.rejected_count) == (2, 2)


def test_at_most_24_candidates_of_a_search_are_proved(tune_scripted):
    """Trial k loses steps only in the k-th move of the proof"""
    measured_times, case_numbers = {f"try {k}": 0.1 for k in range(40)}, {}

    def outcome_of(name, case):
        return 0.1, name not in measured_times or case_numbers.setdefault(case, len(case_numbers)) != int(
            name.removeprefix("try ")
        )

    result = tune_scripted(outcome_of, 96, measured_times)
    assert (result.selected_name, result.rejected_count, result.trial_count) == ("formula", 24, 40)
    assert "24 of the search's best registers failed in moves that it had not seen" in str(
        replace(result, rejected_count=24)
    )


def test_candidates_that_lose_steps_in_the_moves_that_failed_others_are_rejected(tune_scripted):
    """The first 30 of 40 trials lose steps above the payload only"""
    measured_times = {f"try {k}": 0.1 + 1e-3 * k for k in range(40)}
    result = tune_scripted(
        lambda name, case: (
            measured_times.get(name, 0.5),
            int(name.split()[-1]) >= 30 if name in measured_times and case.payload > 2.0 else True,
        ),
        4,
        measured_times,
    )
    assert result.answer.plan == make_named_plan("try 30")
    assert result.rejected_count == 30


def test_a_trial_that_lost_steps_is_never_a_candidate(tune_scripted):
    result = tune_scripted(lambda name, case: (0.05 if name == "fast" else 0.2, True), 4, {"fast": 0.05}, {"fast"})
    assert (result.selected_name, len(result.answers), result.rejected_count) == ("formula", 1, 0)


def test_a_proof_may_consist_of_one_move(tune_scripted):
    result = tune_scripted(lambda name, case: (0.05 if name == "fast" else 0.2, True), 1, {"fast": 0.05})
    assert result.answer.plan == make_named_plan("fast")
    assert (result.answer.proof.move_count, result.answer.proof.good_count) == (1, 1)


def test_an_answer_must_carry_the_whole_requested_margin(tune_scripted, task):
    for max_kg in (MAX_PAYLOAD, MAX_PAYLOAD - 0.01):
        try:
            is_proved = tune_scripted(
                lambda name, case, max_kg=max_kg: (0.1, case.payload <= max_kg + 1e-9), 3
            ).answer.is_proved
        except StageError:
            is_proved = False
        assert is_proved == (max_kg == MAX_PAYLOAD)


def test_progress_is_reported_from_the_formula_to_the_end(tune_scripted, monkeypatch):
    received = []
    tune_scripted(
        lambda name, case: (0.1, True), 4, {"even": 0.1}, on_progress=lambda *message: received.append(message)
    )
    assert received == [("the formula", 0.0, None), ("the proof", 0.0, None), ("the proof", 1.0, None)]
    received.clear()

    def search_with_three_reports(*arguments):
        for done, best in ((8, None), (16, Trial(0, None, 0.3, 0)), (24, Trial(0, None, 0.2, 1))):
            arguments[-1](done, best)
        return [], True

    set_attribute = monkeypatch.setattr
    set_attribute(tuning, "import_optuna", lambda: None)
    set_attribute(tuning, "search_registers", search_with_three_reports)
    result = tune(make_task(), trials=20, moves=1, on_progress=lambda *message: received.append(message))
    assert received[1:-2] == [("searching", 0.4, None), ("searching", 0.8, 0.3), ("searching", 1.0, None)]
    assert ", ended by Ctrl-C)" in result.explain_selection()


def make_result(task, **changes):
    plans = create_planner(task)
    answer = Answer("formula", plans.build_formula_plan(), proof.Proof(1, 1, np.array([0.1]), 0.0), 0.6, False, True)
    defaults = {
        "selected_name": "formula", "safety_factor": 1.5, "method": "formula", "trial_count": 0, "interrupted": False,
        "rejected_count": 0, "seed": 0,
    }  # fmt: skip
    return TuningResult(task, plans, (answer,), move_count=1, **{**defaults, **changes})


def make_result_of_two_answers(task, **changes):
    """Make a result with two answers that differ in every number."""
    plans = create_planner(task)
    speeds = Speeds(1000.0, 20_000.0, 0.1, 0.05)
    plan = plans.build_formula_plan()
    times = np.array([0.1, 0.2, np.nan]), np.array([0.05, 0.08, 0.08])
    answers = (
        Answer("formula", plan, proof.Proof(4, 3, times[0], 3e-5, 1), 0.61, False, False),
        Answer("search", plan._replace(speeds=speeds), proof.Proof(4, 4, times[1], 1.5e-5, 0), 2.4, True, True),
    )
    defaults = {
        "safety_factor": 1.5, "method": "search", "trial_count": 20, "interrupted": True, "rejected_count": 2, "seed": 7,
    }  # fmt: skip
    return TuningResult(task, plans, answers, move_count=99, **{"selected_name": "search", **defaults, **changes})


def test_the_result_text_contains_every_number_of_an_answer(task):
    result = make_result_of_two_answers(task)
    lines = str(result).splitlines()
    assert lines[0] == (
        "axis x, PCL240K: 1.25 mm (400 pulses) with up to 2 kg, margin 0.6 kg more; arrived: within 50 um for 20 ms"
    )
    assert "\n".join(lines[2:10]) == result.describe_spreads()
    del lines[1:10]
    assert (
        lines[3].split()
        == "formula nan ms nan ms 30.0 um 0.61 kg NOT proved: keeps step in 3 of 4 drawn machines with up to 2.6 kg".split()
    )
    assert (
        lines[4].split()
        == "search 70.0 ms 80.0 ms 15.0 um >= 2.40 kg keeps step in 4 of 4 drawn machines with up to 2.6 kg".split()
    )
    assert lines[5] == "2 of the search's best registers failed in moves that it had not seen, and are out."
    assert "(20 trials, ended by Ctrl-C): the formula's lose steps in the proof." in lines[7]
    assert (
        lines.pop(8)
        == result.state_claim()
        == (
            "The axis keeps step in 4 of 4 drawn machines with up to 2.6 kg, from the ranges above. Core loss of the 17HS4401: "
            "0.0002 to 0.00064 N m s/rad (no pull-out curve of the 17HS4401 is at hand; after the 17HS19-2004S1)."
        )
    )
    assert lines[8] == "They ask for from 1,000 up to 20,000 pps, ramps of 100.0 and 50.0 ms."
    text = result.c_source("x")
    assert "arrives after 70.0 ms, 80.0 ms at most" in text
    assert "(by search; stage tune, seed 7)" in text
    assert "by the data sheet formula" in make_result_of_two_answers(task, selected_name="formula").c_source("x")


def test_every_number_of_an_answer_is_in_its_json(task):
    message = make_result_of_two_answers(task).json()
    assert {k: message[k] for k in ("axis", "pulses", "payload", "spare", "hold", "seed", "trials", "moves", "stopped", "won")} == {
        "axis": "x", "pulses": 400, "payload": 2.0, "spare": 0.6, "hold": 0.02, "seed": 7, "trials": 20, "moves": 99,
        "stopped": True, "won": "search",
    }  # fmt: skip
    assert (message["within"], message["overshoot"]) == pytest.approx((5e-5, 1e-4))
    assert list(message["answers"]) == ["formula", "search"]
    search = message["answers"]["search"]
    assert search["speeds"] == {"start": 1000.0, "drive": 20_000.0, "up": 0.1, "down": 0.05, "s_curve": False}
    numbers = {k: search[k] for k in ("mean", "worst", "beyond", "spare", "spare_may_be_more", "kept", "proved")}
    assert numbers == {
        "mean": pytest.approx(0.07), "worst": 0.08, "beyond": 1.5e-5, "spare": 2.4, "spare_may_be_more": True, "kept": 4,
        "proved": 4,
    }  # fmt: skip
    formula = message["answers"]["formula"]
    assert (formula["kept"], formula["proved"], formula["spare"], formula["spare_may_be_more"]) == (3, 4, 0.61, False)


def test_the_result_of_a_servo_is_stated_in_encoder_counts():
    task = make_task(Stage("xy", chips="HCTL1100", visuals=False))
    result = make_result_of_two_answers(task)
    assert result.describe_distance() == "2 mm (400 counts)"
    assert result.describe_proof(result.answer) == "arrives in 4 of 4 drawn machines with up to 2.6 kg"
    assert "up to 20,000 counts/s" in result.describe_rates()


def test_the_unit_follows_the_meaning_of_a_register_that_does_not_contain_it():
    assert RegisterValue("R1", 1, 4, "FL speed", "pps").meaning_with_unit == "FL speed, pps"
    assert RegisterValue("R1", 1, 4, "rate in pps", "pps").meaning_with_unit == "rate in pps"
    assert RegisterValue("R1", 1, 4, "mode", "").meaning_with_unit == "mode"


def test_a_negative_register_is_printed_in_hexadecimal_as_on_the_bus(task):
    result = make_result(task)
    vars(result)["register_values"] = [
        RegisterValue("TP", -40_000, 8, "goal", ""),
        RegisterValue("R1", 20, 4, "FL", ""),
    ]
    assert [line.split()[:3] for line in result.format_register_table().splitlines()[2:]] == [
        ["TP", "-40000", "FFFF63C0h"],
        ["R1", "20", "0014h"],
    ]


def test_an_unlimited_overshoot_is_null_in_json():
    message = make_result(make_task(judge_at="work")).json()
    assert message["overshoot"] is None
    assert json.loads(json.dumps(message, allow_nan=False))["judge_at"] == "work"


def test_corner_and_random_cases_move_in_both_directions_with_each_payload(task):
    rng = np.random.default_rng(0)
    for cases in (task.build_corner_cases(rng, 2), task.draw_cases(rng, 16)):
        for payload in (0.0, PAYLOAD, MAX_PAYLOAD):
            assert {case.direction for case in cases if case.payload == pytest.approx(payload)} == {1, -1}


def test_the_plot_of_an_axis_with_an_inverse_gear_shows_a_plus_move(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    drawn = []
    monkeypatch.setattr("stage.tune.result_plot.save_figure", lambda figure, *rest: drawn.append(figure))
    result = make_result(make_task(Stage(mirrored(tmp_path), chips=PCL240K, visuals=False)))
    result.plot(tmp_path / "tuned.png")
    position, following_error = (drawn[0].axes[k].lines[0].get_ydata() for k in (1, 2))
    assert position[-1] == pytest.approx(1e3 * 400 * result.task.stage.axes["x"].meters_per_pulse, abs=0.02)
    assert following_error[np.abs(following_error) > 1][0] > 0, "um: at the start the carriage lags"
    deviation = drawn[0].axes[3]
    band = deviation.transData.inverted().transform_bbox(deviation.patches[0].get_extents())
    assert (band.y0, band.y1) == pytest.approx((-1e6 * result.task.tolerance, 1e6 * result.task.tolerance))


def test_c_functions_of_axes_whose_names_are_invalid_in_c_are_distinct(task, monkeypatch):
    monkeypatch.setattr(TuningResult, "register_values", ())
    monkeypatch.setattr(TuningResult, "bus_cycles", ())
    functions = []
    for name in ("x 1", "轴"):
        renamed = copy(task)
        object.__setattr__(renamed, "axis", name)
        object.__setattr__(renamed, "stage", SimpleNamespace(axes={name: task.stage.axes["x"]}))
        header = replace(make_result_of_two_answers(task), task=renamed).c_source()
        functions += re.findall(r"static void (\w+_move)\(", header)
    assert functions == ["x_u20_1_tuned_move", "_u8f74__tuned_move"]
