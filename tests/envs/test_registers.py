"""Registers as actions: every legal value has an action, and every action a legal value."""

import numpy as np
import pytest
from support.examples import FIXED, SEED

from stage import ArgumentError
from stage.chips import PCL240K, PCL240MS
from stage.envs.register_scaling import RegisterBox
from stage.firmware.pcl240.driver import S_CURVE_REGISTERS
from stage.firmware.pcl240.driver import TUNED_REGISTERS as REGISTERS


def create_registers(chip):
    return RegisterBox.of_registers(chip.MAP, REGISTERS + (S_CURVE_REGISTERS if chip.S_CURVES else ()))


@pytest.mark.parametrize("chip", [pytest.param(PCL240K, marks=pytest.mark.slow), PCL240MS])
def test_every_register_value_survives_the_round_trip_through_an_action(chip):
    # of a long register every day some 20,000 over its whole range; PULSESTAGE_EXAMPLES=... for each
    b = create_registers(chip)
    for k, name in enumerate(b.names):
        span = b.high[k] - b.low[k] + 1
        every = 1 if not FIXED else max(span // 20_000, 1)
        column = np.union1d(np.arange(b.low[k], b.high[k] + 1, every), b.high[k])
        values = np.repeat(b.low[None], len(column), axis=0)
        values[:, k] = column
        actions = b.to_action(values)
        assert actions.dtype == np.float32
        assert (np.abs(actions) <= 1).all()
        assert (b.from_action(actions) == values).all(), name


@pytest.mark.parametrize("chip", [PCL240K, PCL240MS])
def test_every_action_gives_a_legal_value_and_its_limits_the_register_limits(chip):
    print(f"PULSESTAGE_SEED={SEED}")
    b = create_registers(chip)
    actions = np.random.default_rng(SEED).uniform(-1, 1, (5000, len(b))).astype(np.float32)
    for row in b.from_action(actions)[:200]:
        for name, value in b.to_dict(row).items():
            if name not in S_CURVE_REGISTERS:
                chip.MAP.check_value(name, value)
            assert b.discrete.contains(row)
    assert (b.from_action(-np.ones(len(b))) == b.low).all()
    assert (b.from_action(np.ones(len(b))) == b.high).all()


def test_a_batch_of_actions_decodes_like_single_actions():
    b = create_registers(PCL240MS)
    actions = np.random.default_rng(SEED).uniform(-1, 1, (257, len(b))).astype(np.float32)
    rows = b.from_action(actions)
    assert all((b.from_action(actions[k]) == rows[k]).all() for k in range(len(rows)))


def test_actions_scale_speeds_logarithmically():
    b = create_registers(PCL240K)
    middle = b.to_dict(b.from_action(np.zeros(len(b))))
    assert middle["R1"] == 91, "the root of 8191"
    assert middle["R6"] == 131072, "an eighth of its range"


def test_values_out_of_range_and_registers_without_one_are_refused():
    b = create_registers(PCL240K)
    with pytest.raises(ArgumentError, match=r"R4 2\.\.16383"):
        b.to_action({"R1": 1, "R2": 1, "R4": 1, "R5": 2, "R6": 0, "R7": 2})
    with pytest.raises(ArgumentError, match="R10 has no legal range"):
        RegisterBox.of_registers(PCL240MS.MAP, ["R10"])
