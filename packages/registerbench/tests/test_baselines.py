"""Tests of the baselines: they run within their budgets, and the formula loses no steps."""

import importlib

import numpy as np
import pytest
from support.examples import scaled

from registerbench.baselines import formula, formula_knobs, move_tuning, tool_calling_agent
from registerbench.baselines.move_tuning import (
    DISTANCE_PULSES,
    PAYLOADS_KG,
    MoveLog,
    MoveTuning,
    find_best_proof,
    prove_rows,
)
from stage import Stage
from stage.errors import ArgumentError
from stage.tune.formula import Load, compute_registers, plan_profile

EXTRAS = {
    "search_by_cma_es": ("optuna", "cmaes"),
    "search_by_ppo": ("stable_baselines3",),
    "search_by_sac": ("stable_baselines3",),
}
SEARCHES = ("search_randomly", *EXTRAS)


def load_search(name):
    for extra in EXTRAS.get(name, ()):
        pytest.importorskip(extra, reason=f"{name} needs {extra}: pip install -e '.[rl]'")
    module = "sb3_searches" if "stable_baselines3" in EXTRAS.get(name, ()) else "searches"
    return getattr(importlib.import_module(f"registerbench.baselines.{module}"), name)


def results(name, seed, budget=10, lanes=4):
    with MoveTuning(0.5, budget, distance=2000, lanes=lanes, seed=seed) as moves:
        load_search(name)(moves, seed)
        return moves.log


@pytest.fixture
def axis():
    return Stage("xyz").axes["x"]


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("payload", "distance"),
    [
        *(pytest.param(PAYLOADS_KG["light"], d, marks=SLOW) for d in (1600, 5000)),
        (PAYLOADS_KG["light"], DISTANCE_PULSES),
        *((PAYLOADS_KG["heavy"], d) for d in (1600, 5000)),
        pytest.param(PAYLOADS_KG["heavy"], DISTANCE_PULSES, marks=SLOW),
    ],
)
def test_the_formula_loses_no_step_at_any_position_within_the_payload_tolerance(payload, distance, axis):
    axis.stage.set_payload(payload)
    r = compute_registers(axis, distance)
    (log,) = prove_rows([[r[n] for n in ("R1", "R2", "R4", "R5", "R6", "R7")]], payload, distance, repeats=scaled(5))
    assert len(log) == scaled(5)
    assert not any(log.lost)


def test_the_formula_predicts_the_duration_of_its_move(axis):
    p = plan_profile(Load.from_axis(axis), DISTANCE_PULSES)
    ramps = formula.np.array([p.get_accel_time(), p.get_decel_time()])
    created = (p.fl + p.fh1) / 2 * ramps.sum()
    with MoveTuning(0.0, 1, distance=DISTANCE_PULSES, lanes=1) as moves:
        formula.make_formula_move(moves)
        (duration,) = moves.log.duration
    assert duration == pytest.approx(ramps.sum() + (DISTANCE_PULSES - created) / p.fh1, rel=0.01)


def test_no_other_top_rate_makes_the_formulas_move_shorter(axis):
    """The test computes thrust, friction and mass independently."""
    load, safety = Load.from_axis(axis), formula.SAFETY_FACTOR
    best = plan_profile(load, DISTANCE_PULSES)
    low = best.fl / load.pulses_per_metre

    def seconds(top):
        thrust, drag = float(load.compute_max_thrust(np.array(top))) / safety, load.friction + load.damping * top
        up, down = (thrust - drag) / load.mass, (thrust + drag) / load.mass
        ramps = (top**2 - low**2) * (0.5 / up + 0.5 / down)
        distance = DISTANCE_PULSES / load.pulses_per_metre
        return np.inf if up <= 0 or ramps > distance else (top - low) * (1 / up + 1 / down) + (distance - ramps) / top

    predicted_s = seconds(best.fh1 / load.pulses_per_metre)
    assert predicted_s <= min(seconds(best.fh1 / load.pulses_per_metre * k) for k in np.linspace(0.7, 1.3, 61)) * 1.001


def test_a_heavier_load_or_a_larger_safety_factor_makes_the_formulas_move_slower(axis):
    bare = plan_profile(Load.from_axis(axis), DISTANCE_PULSES)
    careful = plan_profile(Load.from_axis(axis), DISTANCE_PULSES, safety_factor=2.0)
    axis.stage.set_payload(10.0)
    heavy = plan_profile(Load.from_axis(axis), DISTANCE_PULSES)
    for slower in (careful, heavy):
        assert slower.fh1 < bare.fh1
        assert slower.get_accel_time() / slower.fh1 > bare.get_accel_time() / bare.fh1


def test_the_formula_refuses_what_the_motor_cannot_move(axis):
    with pytest.raises(ArgumentError, match="too weak a motor"):
        plan_profile(Load.from_axis(axis), DISTANCE_PULSES, safety_factor=100.0)


def test_knobs_at_zero_give_the_formula_and_each_changes_its_named_rate(axis):
    knobs = formula_knobs.FormulaKnobs(axis, DISTANCE_PULSES)
    middle = knobs.compute_registers(np.zeros(5))
    assert middle == compute_registers(axis, DISTANCE_PULSES)

    def rates(r):
        step = 1 / r["R7"]
        return np.array([r["R1"] * step, r["R2"] * step, step / r["R4"], step / r["R5"], r["R6"]])

    for k, factor in enumerate(knobs.RANGES):
        turned = rates(knobs.compute_registers(np.eye(5)[k])) / rates(middle)
        assert turned[k] == pytest.approx(factor, rel=0.03)
        others = [j for j in range(4) if j != k]
        assert turned[others] == pytest.approx(1, rel=0.03)


@pytest.mark.parametrize("chip", ["MCX514", "MCX304"])
def test_a_nova_chip_is_tuned_by_three_knobs_and_its_formula_keeps_step(chip):
    with MoveTuning(0.5, 1, distance=2000, lanes=1, chip=chip) as moves:
        assert moves.size == 3
        middle = moves.knobs.compute_registers(np.zeros(3))
        assert middle == compute_registers(moves.axis, 2000, s_curve=False)
        assert tuple(middle) == moves.registers.names
        for k, factor in enumerate(moves.knobs.ranges):
            turned = moves.knobs.compute_registers(np.eye(3)[k])
            assert turned[moves.registers.names[k]] == pytest.approx(
                factor * middle[moves.registers.names[k]], rel=0.02
            )
        formula.make_formula_move(moves)
    assert moves.log.registers == [list(middle.values())]
    assert find_best_proof(prove_rows(moves.log.registers, 0.5, 2000, repeats=8, chip=chip)) == 0


@pytest.mark.parametrize("chip", ["PCL240K", "MCX514", "MCX304"])
@pytest.mark.parametrize("space", ["knobs", "registers"])
def test_any_choice_makes_legal_registers(space, chip):
    rng = np.random.default_rng(5)
    with MoveTuning(10.0, 1, space, lanes=1, chip=chip) as moves:
        for choice in rng.choice([-1.0, 0.0, 1.0], (40, moves.size)):
            if moves.knobs:
                moves.registers.to_action(moves.knobs.compute_registers(choice))
            else:
                moves.registers.from_action(choice)


@pytest.mark.parametrize("name", SEARCHES)
def test_a_search_spends_exactly_its_budget(name):
    log = results(name, seed=1)
    assert len(log) == 10
    assert {len(getattr(log, f)) for f in MoveLog.__dataclass_fields__} == {10}


@pytest.mark.slow
@pytest.mark.parametrize("name", SEARCHES)
def test_equal_seeds_give_equal_searches_and_different_seeds_different_ones(name):
    assert results(name, seed=3) == results(name, seed=3)
    assert results(name, seed=3).registers != results(name, seed=4).registers


@pytest.mark.parametrize("name", ["search_by_cma_es"])
def test_a_search_that_begins_with_the_formula_makes_its_move_first(name, axis):
    axis.stage.set_payload(0.5)
    first = compute_registers(axis, 2000)
    assert results(name, seed=0).registers[0] == [first[n] for n in ("R1", "R2", "R4", "R5", "R6", "R7")]


def test_the_learning_curve_is_the_running_maximum_reward_of_moves_without_lost_steps():
    log = MoveLog()
    for reward, duration, saved in ((-9, 1, False), (-3, 3, True), (-1, 9, False), (-4, 2, True), (-2, 5, True)):
        log.append_move(reward, duration, 0, 0.0, saved, [1], (2000, 0.5, 0.0))
    np.testing.assert_equal(log.compute_best_rewards_so_far(), [-np.inf, -3, -3, -3, -2])
    assert log.ranking == [4, 1, 3]


def test_a_move_that_succeeded_only_once_fails_the_proof(axis):
    reckless, r = {"R1": 8000, "R2": 8000, "R4": 20, "R5": 20, "R6": 4000, "R7": 30}, compute_registers(axis, 2000)
    rows = [[a[n] for n in ("R1", "R2", "R4", "R5", "R6", "R7")] for a in (reckless, r)]
    assert find_best_proof(prove_rows(rows[:1], 0.5, 2000, repeats=8)) is None
    assert find_best_proof(prove_rows(rows, 0.5, 2000, repeats=8)) == 1


def test_proofs_draw_the_margin_from_none_to_full_equally_for_all_candidates(axis):
    """A proof with only the full margin would accept a move that loses steps with the payload itself."""
    axis.stage.set_payload(3.0)
    r = compute_registers(axis, 2000)
    row = [r[n] for n in ("R1", "R2", "R4", "R5", "R6", "R7")]
    first, second = prove_rows([row, row], 2.0, 2000, repeats=32, margin=1.0, needed=2)
    assert first == second
    kg = [drawn[1] for drawn in first.drawn]
    assert 2.0 * (1 - move_tuning.PAYLOAD_TOLERANCE) < min(kg) < 2.2
    assert 2.8 < max(kg) < 3.0 * (1 + move_tuning.PAYLOAD_TOLERANCE)
    assert len({drawn[2] for drawn in first.drawn}) == 32


def test_test_moves_alternate_in_direction_and_otherwise_follow_the_environment(axis):
    created = {"budget": 8, "space": "registers", "distance": 2000, "lanes": 4, "seed": 5}
    logs = []
    for both_directions in (False, True):
        with MoveTuning(0.5, both_directions=both_directions, **created) as moves:
            action = moves.registers.to_action(compute_registers(axis, 2000, s_curve=False))
            while moves.moves_left:
                moves.measure_rewards_of_actions(np.tile(action, (4, 1)))
            assert (np.abs(moves.observation) <= 1).all()
        logs.append(moves.log)
    present, both = logs
    assert [d for d, *_ in both.drawn] == [d if k % 2 == 0 else -d for k, (d, *_) in enumerate(present.drawn)]
    assert [rest for _, *rest in both.drawn] == [rest for _, *rest in present.drawn]
    assert present.reward[::2] == both.reward[::2]
    assert all(both.in_step)
    assert both.duration == pytest.approx(present.duration, rel=0.01)


@pytest.mark.slow
def test_a_baseline_accepts_a_model_and_a_margin():
    """python -m registerbench.baselines.formula --model xy --margin 100: of xyz, and with the payload alone"""
    with MoveTuning(0.5, 1, distance=2000, lanes=1, model="xy") as moves:
        assert list(moves.axis.stage.axes) == list(moves.env.unwrapped.stages[0].axes) == ["x", "y"]
        assert moves.axis.stage.payload() == 0.5
        formula.make_formula_move(moves)
    rows = moves.log.registers
    assert find_best_proof(prove_rows(rows, 0.5, 2000, repeats=4, model="xy")) == 0
    message = move_tuning.format_answer(moves.log, moves.registers.names, 0.5, 2000, model="xy", margin=100.0)
    assert "none of the best 1 keeps step in every repetition" in message


def test_stable_baselines3_accepts_the_vector_environment():
    pytest.importorskip("stable_baselines3", reason="needs stable-baselines3: pip install -e '.[rl]'")
    from registerbench.baselines.sb3_searches import SCALE, WORST, MovesVecEnv

    with MoveTuning(0.5, 6, distance=2000, lanes=4) as moves:
        env = MovesVecEnv(moves)
        assert env.reset().shape == (4, *env.observation_space.shape)
        for _ in range(3):  # the second step goes over the budget, the third makes nothing
            observed, rewards, over, infos = env.step(np.zeros((4, 5), np.float32))
            assert all(row in env.observation_space for row in observed)
            assert over.all()
            assert ((rewards <= 0) & (rewards >= SCALE * WORST)).all()
            assert len(infos) == 4
        assert len(moves.log) == 6


def test_an_agent_with_only_tools_improves_a_move():
    tuned = tool_calling_agent.TuningSession(0.5, distance=4000, budget=12)
    tool_calling_agent.tune_by_coordinates(tuned)
    assert len(tuned.log) == 12
    assert max(tuned.log.reward) > tuned.log.reward[0] + 0.02
    assert "All 12 moves are spent" in tuned.box.call("attempt").text


def test_an_agent_with_empty_registers_is_informed_of_the_result():
    tuned = tool_calling_agent.TuningSession(0.5, distance=500, budget=1)
    assert "from 1 to 8191" in tuned.box.call("write_register", {"axis": "x", "name": "R2", "value": "0h"}).text
    assert tuned.box.call("attempt").data["all_pulses_made"] is False
    assert "R2" in tuned.task


@pytest.mark.slow
def test_the_answer_passes_the_margin_and_has_the_best_mean_reward(axis):
    """The candidates are ordered so that a move that was lucky once comes first."""
    plans = [compute_registers(axis, 2000, safety_factor=safety) for safety in (1.5, 3.0)]
    rows = [[a[n] for n in ("R1", "R2", "R4", "R5", "R6", "R7")] for a in plans]
    means = [
        np.mean(log.reward)
        for log in prove_rows(rows, 0.5, 2000, repeats=4, margin=move_tuning.PAYLOAD_MARGIN_KG, needed=2)
    ]
    rows = [rows[k] for k in np.argsort(means)]
    which, again = move_tuning.choose_answer(rows, 0.5, 2000, repeats=4)
    assert which == 1
    assert np.mean(again.reward) == max(means)
    assert move_tuning.choose_answer(rows, 0.5, 2000, repeats=4, margin=200.0) is None
