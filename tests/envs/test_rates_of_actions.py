"""What the tuning tasks make of the ends of an action, and what they tell of a payload that is known badly."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage.envs.few_shot import MIN_RAMP_S, RATES, FewShotTuning
from stage.envs.one_shot import OneShotTuning


def rates(*action, distance=16_000):
    return FewShotTuning.rates(None, np.array(action), distance)  # type: ignore[arg-type]


def test_the_ends_of_an_action_are_those_of_the_rates():
    assert rates(-1, -1, -1, -1) == pytest.approx([low for low, _ in RATES.values()])
    assert rates(1, 1, 1, 1, distance=10**6) == pytest.approx([high for _, high in RATES.values()])


def test_who_requests_a_start_above_the_drive_rate_drives_a_little_faster_than_that():
    start, drive, *_ = rates(1, -1, -1, -1)
    assert (start, drive) == pytest.approx((6000, 6300))


def test_ramps_that_do_not_fit_are_as_steep_and_meet_on_the_way():
    start, top, up, down = rates(-1, 1, 1, 1, distance=1600)
    assert (start + top) / 2 * (up + down) == pytest.approx(1600)
    assert (top - start) / up == pytest.approx((60_000 - 200) / 0.3)
    assert up == down
    assert rates(1, 1, 1, -1, distance=20)[3] == MIN_RAMP_S


def test_a_declared_payload_is_within_what_may_be_however_badly_it_is_known():
    requested = []
    context = np.array([(5.0,)], [("payload", float)])
    task = SimpleNamespace(
        config=SimpleNamespace(error=0.9), ranges={"payload": (4.0, 5.0)}, context=context, declared=np.zeros(1)
    )
    task._set_formula = lambda k, payload: requested.append(payload)
    rng = np.random.default_rng(1)
    for _ in range(12):
        OneShotTuning._compute_formula(task, 0, rng, {})  # type: ignore[arg-type]
    assert max(requested) == 5.0, "no more than the heaviest"
    assert 0 <= min(requested) < 4.0
    OneShotTuning._compute_formula(task, 0, rng, {"declared": 0.0})  # type: ignore[arg-type]
    assert requested[-1] == 0.0
