"""Tests that every split of a card changes the result compared with train."""

from functools import cache
from itertools import product

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401 registers the ids
from registerbench.benchmark_tasks import CARDS, FIRST_TEST_SEED
from stage.envs import machine_contexts

LAST_FIGURE = 1e-3  # of a return, in the tables
EPISODES = 8


def created(card, split):
    """Create an environment for any split, whether the card offers it or not."""
    return gymnasium.make(card.id, disable_env_checker=True, **{**card.settings, "split": split}).unwrapped


@cache
def play_outcome(task, split, player, seed):
    """Play a test episode and return the sum of rewards and the observations."""
    env = created(CARDS[task], split)
    observation, _ = env.reset(seed=seed)
    env.action_space.seed(seed)
    total, observed, over = 0.0, [observation], False
    while not over:
        action = env.scripted_action() if player == "scripted" else env.action_space.sample()
        observation, reward, terminated, truncated, _ = env.step(action)
        total, over = total + reward, terminated or truncated
        observed.append(observation)
    env.close()
    return total, np.array(observed, float)


LONG = ("home", "bus-target", "bus-axes", "bus", "bus-cycles")  # seconds an episode
SPLITS = [
    pytest.param(c.name, s, marks=[pytest.mark.slow] if c.name in LONG else [])
    for c in CARDS.values()
    for s in c.splits
    if s != "train"
]


@pytest.mark.parametrize(("task", "split"), SPLITS)
def test_every_split_of_a_card_changes_what_comes_out(task, split):
    for seed, player in product(range(FIRST_TEST_SEED, FIRST_TEST_SEED + EPISODES), ("scripted", "random")):
        train, test = (play_outcome(task, name, player, seed)[0] for name in ("train", split))
        if abs(train - test) > LAST_FIGURE:
            return
    pytest.fail(f"{split}: all {EPISODES} returns are those of train")


@pytest.mark.parametrize("task", ["home", "line", "line-3", "bus-target", "bus-axes", "bus", "bus-cycles"])
def test_looseness_changes_no_bit_of_these_tasks_and_they_do_not_offer_it(task):
    assert "loose" not in CARDS[task].splits
    (train, observed), (test, also) = (
        play_outcome(task, split, "scripted", FIRST_TEST_SEED) for split in ("train", "loose")
    )
    assert train == test
    assert (observed == also).all()


@pytest.mark.parametrize("card", CARDS.values(), ids=lambda card: card.name)
def test_environments_take_every_split_whatever_a_card_offers(card):
    assert set(card.splits) <= set(machine_contexts.SPLITS)
    assert card.splits[0] == "train"
    known = [split for split in machine_contexts.SPLITS if split != "mast" or card.name != "line-3"]
    for split in known:
        created(card, split).close()
