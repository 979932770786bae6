"""A task: its usable travel, the start and goal of its moves, its loads; and the outcomes of sampled moves."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.mirrored import mirrored

from stage import Stage
from stage.chips import HCTL1100, PCL240K
from stage.drives.motors import Drive
from stage.errors import ArgumentError
from stage.sim.fleet import PlayedPrograms
from stage.tune import MoveCase, Task
from stage.tune.move_runner import MoveRunner
from stage.tune.position_sampler import SAMPLE_INTERVAL_S, PositionSampler
from stage.tune.register_planners import create_planner
from stage.tune.task import compute_usable_travel

PULSES, PAYLOAD = 400, 2.0


def make_task(stage=None, axis="x", **settings):
    stage = Stage("xy", chips=PCL240K, visuals=False) if stage is None else stage
    return Task(stage, axis, **{"pulses": PULSES, "payload": PAYLOAD, "hold": 0.02, **settings})


def make_axis(*switches):
    switch_rows = [SimpleNamespace(pin=pin, touch=touch, slope=slope) for pin, touch, slope in switches]
    return SimpleNamespace(travel=(-1.0, 1.0), plant=SimpleNamespace(switches=switch_rows))


@pytest.mark.parametrize(
    ("switches", "ends"),
    [
        ([("el_plus", 0.5, -1), ("el_minus", -0.6, 1)], (-0.6, 0.5)),
        ([("el_plus", -0.6, 1), ("el_minus", 0.5, -1)], (-0.6, 0.5)),
        ([("el_plus", 0.5, -1)], (-1.0, 0.5)),
        ([("el_plus", -0.6, 1)], (-0.6, 1.0)),
        ([("el_minus", 0.5, -1)], (-1.0, 0.5)),
        ([("el_plus", 1.5, -1), ("el_minus", -1.5, 1)], (-1.0, 1.0)),
        ([("org", 0.1, -1), ("sd_plus", 0.2, -1)], (-1.0, 1.0)),
    ],
)
def test_the_usable_travel_ends_at_the_end_limit_on_either_side(switches, ends):
    assert compute_usable_travel(make_axis(*switches)) == compute_usable_travel(make_axis(*switches[::-1])) == ends


def test_moves_are_centered_between_the_limit_switches(monkeypatch):
    monkeypatch.setattr("stage.tune.task.compute_usable_travel", lambda axis: (-0.02, 0.07))
    task = make_task()
    assert task.travel_center == pytest.approx(0.025)
    stage = task.copy_stage()
    goal = task.place_at_start(stage, MoveCase(0.0, 0.0, 1))
    assert stage.axes["x"].position + goal == pytest.approx(0.05, abs=1e-5)


def test_the_maximum_distance_leaves_one_electrical_revolution_of_the_travel():
    stage = Stage("xy", chips=PCL240K, visuals=False)
    low, high = compute_usable_travel(stage.axes["x"])
    maximum = int((high - low) / stage.axes["x"].meters_per_pulse) - 4 * 16
    assert make_task(stage, pulses=maximum).pulses == make_task(stage, pulses=-maximum).pulses == maximum
    with pytest.raises(ArgumentError, match=f"a distance of {maximum + 1} pulses: .* room for 1 to {maximum} pulses"):
        make_task(stage, pulses=-maximum - 1)
    with pytest.raises(ArgumentError, match="a distance of 0 pulses"):
        make_task(stage, pulses=0)


def test_the_tolerance_and_an_electrical_turn_follow_the_microsteps_of_the_drive():
    stage = Stage("xy", chips=PCL240K, drives=Drive(microsteps=8), visuals=False)
    task, x = make_task(stage), stage.axes["x"]
    assert (task.pulses_per_electrical_turn, task.tolerance) == (32, pytest.approx(8 * x.meters_per_pulse))


def test_a_margin_of_zero_is_allowed():
    task = make_task(margin=0.0)
    assert (task.margin, task.payload_with_margin) == (0.0, PAYLOAD)
    assert {case.payload for case in task.build_corner_cases(np.random.default_rng(0), 2, 1.25)} == {0.0, PAYLOAD}
    assert make_task(margin=0.0, payload=0.0).payload_with_margin == 0.0


def test_a_guard_factor_increases_the_margin_and_not_the_payload():
    task, rng = make_task(margin=1.0), np.random.default_rng(0)
    for cases in (task.build_corner_cases(rng, 2, 1.5), task.draw_cases(rng, 24, 1.5)):
        assert max(case.payload for case in cases) == pytest.approx(3.5)
    assert task.is_within_payload(
        [MoveCase(PAYLOAD, 0, 1), MoveCase(PAYLOAD + 1e-3, 0, 1), MoveCase(0.0, 0, 1)]
    ).tolist() == [
        True,
        False,
        True,
    ]


@pytest.mark.parametrize("chip", [PCL240K, HCTL1100])
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_move_starts_half_its_distance_before_the_center(tmp_path, chip, direction, is_mirrored):
    stage = Stage(mirrored(tmp_path) if is_mirrored else "xy", chips=chip, visuals=False)
    task = make_task(stage, payload_on="x")
    x = stage.axes["x"]
    per_pulse = x.meters_per_pulse * (-1 if is_mirrored else 1)
    machine = task.copy_stage()
    goal = task.place_at_start(machine, MoveCase(1.5, 7.0, direction))
    begin = task.travel_center - 0.5 * direction * PULSES * per_pulse + 7.0 * x.meters_per_pulse
    axis = machine.axes["x"]
    assert axis.position == pytest.approx(begin, abs=2e-6)
    assert goal == pytest.approx(
        (axis.position if chip is HCTL1100 else axis.commanded) + direction * PULSES * per_pulse
    )
    assert (machine.payload("x"), machine.payload("y")) == (1.5, 0)
    goals = PositionSampler(task).place_at_start(task.copy_stage(), MoveCase(1.5, 7.0, direction))
    assert goals[:, 0] == pytest.approx([goal, direction * PULSES * per_pulse])


def test_a_judged_body_is_sampled_like_a_site_and_lateral_errors_count():
    goals = {}
    for name in ("work", make_task(judge_at="work").stage.model.body(2).name):
        task = make_task(judge_at=name)
        goals[name] = PositionSampler(task).place_at_start(task.copy_stage(), MoveCase(0.0, 0.0, 1))[1]
    a, b = goals.values()
    assert a == pytest.approx(b, abs=1e-9), "both move the same distance"
    samples = PositionSampler(task)
    distance, beyond = samples.compute_errors(
        np.array([[0, *(1e12 * (a + np.array([3e-3, 4e-3, 0])))]]), np.array([[a, a]])
    )
    assert (distance.item(), beyond.item()) == (pytest.approx(5e-3), pytest.approx(3e-3))


# --- outcomes of sampled moves ---


@pytest.fixture(scope="module")
def runner():
    task = make_task()
    with MoveRunner(task, create_planner(task), fleet_size=2) as runner:
        yield runner


def run_sampled_moves(runner, monkeypatch, rows, pulses=None, lost=0, diverged=False, direction=1):
    """Run moves with these distances from the goal, m, at each sample, one row for each move."""
    task = runner.task
    plan, goals, distances, real = runner.planner.build_formula_plan(), [], iter(rows), runner.fleet.truth
    place_at_start = runner.sampler.place_at_start

    def place_and_store_goal(stage, case):
        goals.append(place_at_start(stage, case))
        return goals[-1]

    def play(ops):
        results = np.zeros(ops.shape[:2], np.int64)
        length = ops.shape[1] - 2 * len(rows[0])
        for row, goal in zip(results, goals, strict=False):
            row[length + 1 :: 2] = np.rint(1e12 * (goal[0, 0] + direction * np.array(next(distances))))
        goals.clear()
        return PlayedPrograms(results, np.zeros((2, 2, 2)), np.full(2, diverged))

    def truth():
        rows = real().copy()
        rows["pulses"][:, runner.axis_index] = direction * task.pulses if pulses is None else pulses
        rows["lost_steps"][:, runner.axis_index] = lost
        return rows

    monkeypatch.setattr(runner.fleet, "play", play)
    monkeypatch.setattr(runner.fleet, "truth", truth)
    monkeypatch.setattr(runner.sampler, "place_at_start", place_and_store_goal)
    return runner.run_moves([plan], [MoveCase(0.0, 0.0, direction)] * len(rows), SAMPLE_INTERVAL_S * len(rows[0]))


FAR_M, NEAR_M = 1e-3, 1e-6
AT_REST = [FAR_M] * 10 + [NEAR_M] * 40


@pytest.mark.parametrize("direction", [1, -1])
def test_a_move_arrives_at_the_first_sample_of_those_that_stay_within_the_tolerance(runner, monkeypatch, direction):
    rows = [
        AT_REST,
        [FAR_M] * 9 + [NEAR_M] + [FAR_M] * 5 + [NEAR_M] * 40,
        [NEAR_M] * 55,
        [FAR_M] * 14 + [NEAR_M] * 41,
        [FAR_M] * 16 + [NEAR_M] * 39,
        [FAR_M] * 55,
    ]
    rows[0] = [FAR_M] * 5 + AT_REST
    outcome = run_sampled_moves(runner, monkeypatch, rows, direction=direction)
    samples = np.round(outcome.arrival_times[0] / SAMPLE_INTERVAL_S, 6).tolist()
    assert samples[:4] == [15, 15, 0, 14]
    assert np.isnan(outcome.arrival_times[0, 4:]).all(), "the hold takes 40 samples"
    assert outcome.in_step.all()


def test_a_move_that_stays_before_its_goal_has_no_overshoot(runner, monkeypatch):
    rows = [[-FAR_M] * 10 + [-NEAR_M] * 40, [-FAR_M] * 9 + [3e-5] + [NEAR_M] * 40]
    outcome = run_sampled_moves(runner, monkeypatch, rows)
    assert outcome.overshoots[0] == pytest.approx([0.0, 3e-5])


@pytest.mark.parametrize(
    ("settings", "in_step", "has_arrived"),
    [
        ({}, True, True),
        ({"pulses": PULSES - 1}, False, True),
        ({"pulses": -PULSES}, False, True),
        ({"lost": 1}, False, True),
        ({"lost": -1}, False, True),
        ({"diverged": True}, False, False),
    ],
)
def test_a_move_keeps_step_if_it_makes_all_pulses_in_its_direction_and_loses_none(
    runner, monkeypatch, settings, in_step, has_arrived
):
    before = runner.move_count
    outcome = run_sampled_moves(runner, monkeypatch, [AT_REST] * 3, **settings)
    assert outcome.in_step.tolist() == [[in_step] * 3]
    assert (~np.isnan(outcome.arrival_times)).tolist() == [[has_arrived] * 3]
    assert runner.move_count == before + 3
