"""Rates that the tuning tasks decode from extreme actions, and payloads that they declare with an error."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage.envs.few_shot import ACTION_RANGES, MIN_RAMP_S, FewShotTuning
from stage.envs.one_shot import OneShotTuning


def decode_rates(*action, distance=16_000):
    return FewShotTuning.decode_action(None, np.array(action), distance)  # type: ignore[arg-type]


def test_the_limits_of_an_action_are_the_limits_of_the_rates():
    assert decode_rates(-1, -1, -1, -1) == pytest.approx([low for low, _ in ACTION_RANGES.values()])
    assert decode_rates(1, 1, 1, 1, distance=10**6) == pytest.approx([high for _, high in ACTION_RANGES.values()])


def test_a_start_rate_above_the_drive_rate_raises_the_drive_rate():
    start, drive, *_ = decode_rates(1, -1, -1, -1)
    assert (start, drive) == pytest.approx((6000, 6300))


def test_ramps_too_long_for_the_distance_keep_their_slope_at_a_lower_top_rate():
    start, top, up, down = decode_rates(-1, 1, 1, 1, distance=1600)
    assert (start + top) / 2 * (up + down) == pytest.approx(1600)
    assert (top - start) / up == pytest.approx((60_000 - 200) / 0.3)
    assert up == down
    assert decode_rates(1, 1, 1, -1, distance=20)[3] == MIN_RAMP_S


def test_a_declared_payload_stays_in_its_range_despite_its_error():
    requested = []
    context = np.array([(5.0,)], [("payload", float)])
    task = SimpleNamespace(
        config=SimpleNamespace(error=0.9), ranges={"payload": (4.0, 5.0)}, context=context, declared=np.zeros(1)
    )
    task._store_formula_move = lambda k, payload: requested.append(payload)
    rng = np.random.default_rng(1)
    for _ in range(12):
        OneShotTuning._compute_formula_move(task, 0, rng, {})  # type: ignore[arg-type]
    assert max(requested) == 5.0, "no more than the heaviest"
    assert 0 <= min(requested) < 4.0
    OneShotTuning._compute_formula_move(task, 0, rng, {"declared": 0.0})  # type: ignore[arg-type]
    assert requested[-1] == 0.0
