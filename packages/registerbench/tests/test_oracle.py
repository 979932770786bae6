"""Tests of the oracle: its search in a task of several attempts, each of which is a move of its own."""

import dataclasses

import numpy as np
import pytest

import registerbench
from registerbench import benchmark_tasks
from registerbench.baselines import oracle


def test_the_oracle_of_several_attempts_repeats_the_best_attempt_that_it_has_tried(monkeypatch):
    card = dataclasses.replace(benchmark_tasks.CARDS["few-shot"], episodes=1)
    monkeypatch.setitem(benchmark_tasks.CARDS, "few-shot", card)
    policy = oracle.search_split("few-shot", "weak", "open", 2 * oracle.PARALLEL_ENVS)
    best = registerbench.play(policy, "few-shot", "weak", track="truth")
    formula = registerbench.play("formula", "few-shot", "weak")
    assert (best.actions == best.actions[0]).all(), "all attempts are the same"
    assert best.scores["success"][0] == 1
    assert best.scores["return"][0] > formula.scores["return"][0] + 1, "on weak machines, the formula's move fails"
    tries, attempts = 2 * oracle.PARALLEL_ENVS, len(best.actions)
    assert policy.cost["moves"] == attempts + tries + oracle.PARALLEL_ENVS * attempts, (
        "scripted host, tries, whole episodes"
    )


def test_a_search_that_finds_nothing_better_returns_its_beginning(monkeypatch):
    search = oracle.EpisodeSearch(benchmark_tasks.CARDS["one-shot"], "train")
    begin = np.full((1, 4), 0.25, np.float32)
    played = []

    def play_candidates(envs, seed, candidates):
        played.append(candidates)
        return -np.abs(candidates - begin).sum(axis=(1, 2))

    monkeypatch.setattr(search, "play_candidates", play_candidates)
    tried = search._search(search._envs, 1, begin, np.ones(4), 3 * oracle.PARALLEL_ENVS)
    search.close()
    assert len(played) == 3
    assert len(tried) == oracle.PARALLEL_ENVS
    assert tried[0] == pytest.approx(begin), "the best is first"
    spread = [np.std(candidates[1:]) for candidates in played]
    assert spread[0] > spread[2], "the search narrows"
