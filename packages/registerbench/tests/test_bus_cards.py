"""Tests of the cards on the bus: speed pays, and no failure is as dear as a divergence."""

import numpy as np
import pytest

from registerbench.benchmark_tasks import CARDS
from stage.envs import register_bus
from stage.envs.bus_macros import Config
from stage.envs.step_results import DIVERGENCE_REWARD

BUS_CARDS = ("bus-target", "bus-axes", "bus")
SEEDS = (1_000_000, 1_000_001)


def play_scripted(card, rates):
    """Play the scripted host with other rates; return the sum of rewards and the simulated seconds of each episode."""
    env, played = CARDS[card].make_env("train", "host", {}), []
    macros = list(env.macros)
    for seed in SEEDS:
        env.reset(seed=seed)
        total, is_over = 0.0, False
        while not is_over:
            action = int(env.scripted_action())
            action = macros.index(rates) if macros[action] == "rates usual" else action
            _, reward, terminated, truncated, info = env.step(action)
            total, is_over = total + reward, terminated or truncated
        assert info["success"]
        played.append((total, info["elapsed"]))
    return played


@pytest.mark.parametrize("card", ["bus-axes", pytest.param("bus", marks=pytest.mark.slow)])
def test_the_same_macros_at_lower_rates_earn_less(card):
    """With a twentieth for a second, half of the speed cost less than three macros."""
    for (fast, soon), (slow, late) in zip(
        play_scripted(card, "rates usual"), play_scripted(card, "rates gentle"), strict=True
    ):
        assert late > soon
        assert fast - slow == pytest.approx(0.5 * (late - soon), abs=1e-6)
        assert fast - slow > 0.2


@pytest.mark.parametrize("card", BUS_CARDS)
def test_a_failure_costs_less_than_a_divergence(card):
    c = Config(**CARDS[card].settings)
    failure = c.macros * c.macro_weight + c.time_limit * c.time_weight
    limits = 2 * c.damage_weight * len(c.axes)
    assert failure + limits + c.damage_weight < -DIVERGENCE_REWARD


def test_single_bus_cycles_on_hidden_machines_are_a_task_in_which_slow_moves_earn_less(monkeypatch):
    card, returns = CARDS["bus-cycles"], {}
    c = register_bus.Config(**card.settings, split="train")
    assert c.time_weight * c.time_limit + 64 * c.lost_weight < -DIVERGENCE_REWARD, (
        "a failure costs less than a divergence"
    )
    for rates in ("scripted", "gentle"):
        if rates == "gentle":
            monkeypatch.setattr(register_bus, "SCRIPTED_RATES", register_bus.RATES["gentle"])
        env = card.make_env("train", "host", {})
        _, info = env.reset(seed=SEEDS[0])
        assert info["payload"] > 0
        returns[rates], is_over = 0.0, False
        while not is_over:
            _, reward, terminated, truncated, info = env.step(env.scripted_action())
            returns[rates], is_over = returns[rates] + reward, terminated or truncated
        assert info["score"]["success"] == (info["score"]["time"] < np.inf)
    assert returns["scripted"] > returns["gentle"] + 0.3
