"""Counts of a proof, and the search of the spare payload."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage.tune import MoveCase, proof
from stage.tune.move_runner import MoveOutcomes
from stage.tune.task import PAYLOAD_ROUNDING_KG

PAYLOAD = 2.0
CASES = [MoveCase(0.0, 0.0, 1), MoveCase(PAYLOAD, 0.0, -1), MoveCase(2.6, 0.0, 1), MoveCase(2.6, 5.0, -1)]


def make_runner(outcome=None, run_moves=None, **task_settings):
    """Make a move runner with this outcome, or with this function as its `run_moves`."""
    arguments = {
        "payload": PAYLOAD, "margin": 0.6, "moving_mass": 3.0, "pulses_per_electrical_turn": 64, "overshoot": 1e-4, **task_settings,
    }  # fmt: skip
    task = SimpleNamespace(
        **arguments,
        is_within_payload=lambda cases: np.array([c.payload <= PAYLOAD + PAYLOAD_ROUNDING_KG for c in cases]),
    )
    return SimpleNamespace(task=task, run_moves=run_moves or (lambda plans, cases, limit: outcome))


def test_a_proof_counts_steps_and_arrivals_separately_and_times_moves_within_the_payload():
    nan, distance = np.nan, 2e-4
    outcome = MoveOutcomes(
        np.array([[0.1, 0.2, 0.9, nan], [0.1, nan, 0.3, 0.3], [0.1, 0.2, 0.3, 0.4]]),
        np.array([[True, True, True, True], [True, True, True, False], [False, True, False, False]]),
        np.array([[0.0, 1e-5, 9e-4, 9e-4], [1e-5, 0.0, 0.0, 0.0], [0.0, distance, 0.0, 0.0]]),
    )
    results = proof.prove_plans(make_runner(outcome), [None] * 3, CASES, 1.0)
    counts = [(p.move_count, p.good_count, p.lost_step_count, p.is_passed) for p in results]
    assert counts == [(4, 4, 0, True), (4, 2, 1, False), (4, 0, 3, False)]
    assert [p.failed for p in results] == [(), (1, 3), (0, 1, 2, 3)]
    assert [p.max_overshoot for p in results] == [1e-5, 1e-5, distance], "only moves with up to the payload count"
    assert results[0].arrival_times.tolist() == results[2].arrival_times.tolist() == [0.1, 0.2]
    assert (results[0].mean_time, results[0].max_time) == (pytest.approx(0.15), 0.2)
    assert np.isnan([results[1].mean_time, results[1].max_time]).all(), "a move that has not arrived has no time"
    assert [p.describe() for p in results] == [
        "4 machines 4 were good",
        "4 machines 2 were good, 1 did not keep step, 1 did not come to rest at the goal",
        "4 machines 3 did not keep step, 1 did not come to rest at the goal",
    ]


@pytest.mark.parametrize(
    ("task_settings", "maximum"),
    [
        ({"margin": 0.6}, 2.4),
        ({"margin": 0.0}, 0.4 * (PAYLOAD + 3.0)),
        ({"margin": 0.0, "payload": 0.0}, 0.4 * 3.0),
        ({"margin": 5.0, "payload": 0.0}, 20.0),
    ],
)
def test_spare_payloads_are_tried_up_to_four_margins_or_two_fifths_of_the_moving_mass(task_settings, maximum):
    cases_run = []

    def run_moves(plans, cases, limit):
        cases_run.extend(cases)
        return SimpleNamespace(in_step=np.ones((1, len(cases)), bool))

    assert proof.measure_spare_payload(
        make_runner(run_moves=run_moves, **task_settings), None, 1.0, np.random.default_rng(0)
    ) == (
        maximum,
        True,
    )
    payload = task_settings.get("payload", PAYLOAD)
    assert min(c.payload for c in cases_run) == pytest.approx(payload + maximum / 8)
    assert max(c.payload for c in cases_run) == pytest.approx(payload + maximum)
    assert -32 <= min(c.start_offset for c in cases_run) < -20 < 20 < max(c.start_offset for c in cases_run) <= 32


def test_the_spare_payload_is_below_every_payload_that_lost_a_step():
    """The first round loses a step from 2.0 + 0.9 kg on; the second round goes up to that, and loses none"""
    rounds = iter([0.9, 99.0])

    def run_moves(plans, cases, limit):
        maximum = next(rounds)
        return SimpleNamespace(in_step=np.array([[c.payload - PAYLOAD < maximum - 1e-9 for c in cases]]))

    assert proof.measure_spare_payload(make_runner(run_moves=run_moves), None, 1.0, np.random.default_rng(0)) == (
        pytest.approx(0.9),
        False,
    )


@pytest.mark.parametrize("angle", [0, 1, -1])
def test_a_payload_must_keep_step_at_every_rotor_angle(angle):
    """More than 2.0 + 0.9 kg loses steps at only one of the angles"""

    def run_moves(plans, cases, limit):
        in_step = np.ones((proof.PAYLOADS_PER_ROUND, proof.ANGLES_PER_PAYLOAD), bool)
        in_step[:, angle] = [c.payload - PAYLOAD <= 0.9 for c in cases[:: proof.ANGLES_PER_PAYLOAD]]
        return SimpleNamespace(in_step=in_step.reshape(1, -1))

    carried, is_larger_possible = proof.measure_spare_payload(
        make_runner(run_moves=run_moves), None, 1.0, np.random.default_rng(0)
    )
    assert not is_larger_possible
    assert 0.8 < carried <= 0.9
