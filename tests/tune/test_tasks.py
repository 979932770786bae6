"""What a task is, whatever its machine: its room, where its moves begin and end, its loads; and what `Tries` makes of the looks."""

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
from stage.tune.planners import create_planner
from stage.tune.position_sampler import SAMPLE_INTERVAL_S, PositionSampler
from stage.tune.task import compute_usable_travel

PULSES, PAYLOAD = 400, 2.0


def task_of(stage=None, axis="x", **how):
    stage = Stage("xy", chips=PCL240K, visuals=False) if stage is None else stage
    return Task(stage, axis, **{"pulses": PULSES, "payload": PAYLOAD, "hold": 0.02, **how})


def axis_with(*switches):
    made = [SimpleNamespace(pin=pin, touch=touch, slope=slope) for pin, touch, slope in switches]
    return SimpleNamespace(travel=(-1.0, 1.0), plant=SimpleNamespace(switches=made))


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
def test_the_room_of_an_axis_ends_where_an_end_limit_trips_on_whichever_side_it_is(switches, ends):
    assert compute_usable_travel(axis_with(*switches)) == compute_usable_travel(axis_with(*switches[::-1])) == ends


def test_moves_are_centered_between_the_limit_switches_and_not_in_the_travel(monkeypatch):
    monkeypatch.setattr("stage.tune.task.compute_usable_travel", lambda axis: (-0.02, 0.07))
    task = task_of()
    assert task.travel_center == pytest.approx(0.025)
    stage = task.copy_stage()
    goal = task.place_at_start(stage, MoveCase(0.0, 0.0, 1))
    assert stage.axes["x"].position + goal == pytest.approx(0.05, abs=1e-5)


def test_the_maximum_distance_leaves_one_electrical_revolution_of_the_travel():
    stage = Stage("xy", chips=PCL240K, visuals=False)
    low, high = compute_usable_travel(stage.axes["x"])
    maximum = int((high - low) / stage.axes["x"].meters_per_pulse) - 4 * 16
    assert task_of(stage, pulses=maximum).pulses == task_of(stage, pulses=-maximum).pulses == maximum
    with pytest.raises(ArgumentError, match=f"a distance of {maximum + 1} pulses: .* room for 1 to {maximum} pulses"):
        task_of(stage, pulses=-maximum - 1)
    with pytest.raises(ArgumentError, match="a distance of 0 pulses"):
        task_of(stage, pulses=0)


def test_a_full_step_and_a_turn_are_as_many_pulses_as_the_drive_makes_of_them():
    stage = Stage("xy", chips=PCL240K, drives=Drive(microsteps=8), visuals=False)
    task, x = task_of(stage), stage.axes["x"]
    assert (task.pulses_per_electrical_turn, task.tolerance) == (32, pytest.approx(8 * x.meters_per_pulse))


def test_a_margin_of_zero_is_allowed():
    task = task_of(margin=0.0)
    assert (task.margin, task.max_payload) == (0.0, PAYLOAD)
    assert {case.payload for case in task.build_corner_cases(np.random.default_rng(0), 2, 1.25)} == {0.0, PAYLOAD}
    assert task_of(margin=0.0, payload=0.0).max_payload == 0.0


def test_a_guard_is_on_top_of_the_spare_and_not_of_the_payload():
    task, rng = task_of(margin=1.0), np.random.default_rng(0)
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
@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("turned", [False, True])
def test_a_move_starts_half_its_distance_before_the_center_and_its_goal_follows_from_its_pulses(
    tmp_path, chip, way, turned
):
    stage = Stage(mirrored(tmp_path) if turned else "xy", chips=chip, visuals=False)
    task = task_of(stage, payload_on="x")
    x = stage.axes["x"]
    per_pulse = x.meters_per_pulse * (-1 if turned else 1)
    machine = task.copy_stage()
    goal = task.place_at_start(machine, MoveCase(1.5, 7.0, way))
    begin = task.travel_center - 0.5 * way * PULSES * per_pulse + 7.0 * x.meters_per_pulse
    at = machine.axes["x"]
    assert at.position == pytest.approx(begin, abs=2e-6)
    assert goal == pytest.approx((at.position if chip is HCTL1100 else at.commanded) + way * PULSES * per_pulse)
    assert (machine.payload("x"), machine.payload("y")) == (1.5, 0)
    goals = PositionSampler(task).place_at_start(task.copy_stage(), MoveCase(1.5, 7.0, way))
    assert goals[:, 0] == pytest.approx([goal, way * PULSES * per_pulse])


def test_a_judged_body_is_sampled_like_a_site_and_lateral_errors_count():
    goals = {}
    for name in ("work", task_of(judge_at="work").stage.model.body(2).name):
        task = task_of(judge_at=name)
        goals[name] = PositionSampler(task).place_at_start(task.copy_stage(), MoveCase(0.0, 0.0, 1))[1]
    a, b = goals.values()
    assert a == pytest.approx(b, abs=1e-9), "the way is the same"
    samples = PositionSampler(task)
    distance, beyond = samples.compute_errors(
        np.array([[0, *(1e12 * (a + np.array([3e-3, 4e-3, 0])))]]), np.array([[a, a]])
    )
    assert (distance.item(), beyond.item()) == (pytest.approx(5e-3), pytest.approx(3e-3))


# --- what comes of looks ---


@pytest.fixture(scope="module")
def tries():
    task = task_of()
    with MoveRunner(task, create_planner(task), fleet_size=2) as made:
        yield made


def made(tries, monkeypatch, rows, pulses=None, lost=0, diverged=False, way=1):
    """The outcome of moves that are seen so far from the goal, m, at each look, a row each."""
    task = tries.task
    plan, goals, offs, real = tries.planner.build_formula_plan(), [], iter(rows), tries.fleet.truth
    begin = tries.sampler.place_at_start

    def begun(stage, case):
        goals.append(begin(stage, case))
        return goals[-1]

    def play(ops):
        results = np.zeros(ops.shape[:2], np.int64)
        length = ops.shape[1] - 2 * len(rows[0])
        for row, goal in zip(results, goals, strict=False):
            row[length + 1 :: 2] = np.rint(1e12 * (goal[0, 0] + way * np.array(next(offs))))
        goals.clear()
        return PlayedPrograms(results, np.zeros((2, 2, 2)), np.full(2, diverged))

    def truth():
        found = real().copy()
        found["pulses"][:, tries.axis_index] = way * task.pulses if pulses is None else pulses
        found["lost_steps"][:, tries.axis_index] = lost
        return found

    monkeypatch.setattr(tries.fleet, "play", play)
    monkeypatch.setattr(tries.fleet, "truth", truth)
    monkeypatch.setattr(tries.sampler, "place_at_start", begun)
    return tries.run_moves([plan], [MoveCase(0.0, 0.0, way)] * len(rows), SAMPLE_INTERVAL_S * len(rows[0]))


DISTANCE, NEAR = 1e-3, 1e-6
AT_REST = [DISTANCE] * 10 + [NEAR] * 40


@pytest.mark.parametrize("way", [1, -1])
def test_a_move_arrives_at_the_first_sample_of_those_that_stay_within_the_tolerance(tries, monkeypatch, way):
    rows = [
        AT_REST,
        [DISTANCE] * 9 + [NEAR] + [DISTANCE] * 5 + [NEAR] * 40,
        [NEAR] * 55,
        [DISTANCE] * 14 + [NEAR] * 41,
        [DISTANCE] * 16 + [NEAR] * 39,
        [DISTANCE] * 55,
    ]
    rows[0] = [DISTANCE] * 5 + AT_REST
    outcome = made(tries, monkeypatch, rows, way=way)
    samples = np.round(outcome.arrival_times[0] / SAMPLE_INTERVAL_S, 6).tolist()
    assert samples[:4] == [15, 15, 0, 14]
    assert np.isnan(outcome.arrival_times[0, 4:]).all(), "40 looks are the hold"
    assert outcome.kept_step.all()


def test_a_move_that_stays_before_its_goal_has_no_overshoot(tries, monkeypatch):
    rows = [[-DISTANCE] * 10 + [-NEAR] * 40, [-DISTANCE] * 9 + [3e-5] + [NEAR] * 40]
    outcome = made(tries, monkeypatch, rows)
    assert outcome.overshoots[0] == pytest.approx([0.0, 3e-5])


@pytest.mark.parametrize(
    ("how", "kept", "there"),
    [
        ({}, True, True),
        ({"pulses": PULSES - 1}, False, True),
        ({"pulses": -PULSES}, False, True),
        ({"lost": 1}, False, True),
        ({"lost": -1}, False, True),
        ({"diverged": True}, False, False),
    ],
)
def test_a_move_keeps_step_if_it_makes_all_pulses_in_its_direction_and_loses_none(tries, monkeypatch, how, kept, there):
    before = tries.move_count
    outcome = made(tries, monkeypatch, [AT_REST] * 3, **how)
    assert outcome.kept_step.tolist() == [[kept] * 3]
    assert (~np.isnan(outcome.arrival_times)).tolist() == [[there] * 3]
    assert tries.move_count == before + 3
