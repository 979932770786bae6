"""Rules of the bench that entries of other years and other places depend on."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from stage import ArgumentError
from stage.bench import statistics
from stage.bench.cards import CARDS, FIRST, LAST, card_of, seeds
from stage.bench.replaying import Difference, _earlier, _Replay
from stage.bench.scores import digest, scored


def entry(player="a", value=1.0, **how):
    usual = {
        "task": "home",
        "split": "train",
        "track": "host",
        "round": "open",
        "player": player,
        "run": 0,
        "seeds": (1, 2, 3),
    }
    made = {**usual, "cost": {}, "scores": {"return": np.full(3, value)}, **how}
    return SimpleNamespace(**made)


def replay(tolerance):
    e = SimpleNamespace(steps=np.array([1]), rewards=np.zeros(1), scores={})
    return _Replay(e, tolerance)


def test_seeds_of_a_round_follow_from_its_name_and_the_task_s_for_good():
    assert seeds(CARDS["home"], "train", "2027")[:2] == [665991244, 1239686963]
    drawn = [seeds(CARDS[name], "train", "2027") for name in CARDS]
    assert len({s for some in drawn for s in some}) == sum(map(len, drawn)), "no two tasks have the same"
    assert all(FIRST + 64 <= s < LAST for some in drawn for s in some)
    assert seeds(CARDS["home"], "train") == seeds(CARDS["home"], "worn") == list(range(FIRST, FIRST + 64))


def test_a_task_is_named_by_its_card_or_its_environment():
    assert card_of("home") is card_of("stage/DriftingHome-v1") is CARDS["home"]
    with pytest.raises(ArgumentError, match="unknown task 'hom'"):
        card_of("hom")


def test_a_digest_tells_observations_of_one_content_by_type_and_shape_and_stays_the_same():
    zeros = np.zeros(4, np.float32)
    others = (zeros.reshape(2, 2), zeros.reshape(4, 1), np.zeros(4, np.int32), np.zeros(2, np.float64), -zeros)
    assert len({digest(zeros), *map(digest, others)}) == 6
    assert digest(np.zeros((2, 4), np.float32)[:, ::2]) == digest(np.zeros((2, 2), np.float32)), (
        "not how it lies in memory"
    )
    assert digest(zeros) == 13031525093526981456


def test_an_episode_without_a_score_has_what_it_has():
    rewards = np.array([1.0, 2.0])
    assert scored(rewards, {}) == {"return": 3.0, "moves": 2.0}
    assert scored(rewards, {"proved": 0.5}) == {"return": 3.0, "time": 0.5, "success": 1.0, "moves": 2.0}
    assert scored(rewards, {"proved": np.inf})["success"] == 0.0
    assert scored(rewards, {"proved": 0.5, "score": {"time": 7.0}}) == {"return": 3.0, "time": 7.0}


def test_the_middle_half_of_few_numbers_is_of_all():
    assert statistics.iqm([1.0]) == 1.0
    assert statistics.iqm([0.0, 1.0, 5.0]) == 2.0
    assert statistics.iqm([0.0, 1.0, 3.0, 100.0]) == 2.0


def test_an_interval_of_a_lower_level_lies_within_that_of_a_higher():
    scores = np.random.default_rng(1).normal(size=(2, 16))
    low, high = statistics.interval(scores, 200, 0.5)
    wide = statistics.interval(scores, 200, 0.95)
    assert wide[0] < low < high < wide[1]


def test_rows_part_by_tracks_splits_and_tasks_and_the_best_stands_first():
    some = [
        entry("b", 1.0),
        entry("a", 2.0),
        entry("a", 3.0, track="truth"),
        entry("a", split="worn"),
        entry("a", task="bus"),
    ]
    rows = [(r.task, r.split, r.track, r.player, r.value) for r in statistics.rows(some)]
    assert rows == [
        ("bus", "train", "host", "a", 1.0),
        ("home", "train", "host", "a", 2.0),
        ("home", "train", "host", "b", 1.0),
        ("home", "train", "truth", "a", 3.0),
        ("home", "worn", "host", "a", 1.0),
    ]


def test_entries_of_other_episodes_are_no_runs_of_one_player():
    with pytest.raises(ArgumentError, match="a on home train: its entries have different test episodes"):
        statistics.rows([entry(), entry(run=1, seeds=(1, 2, 4))])


def test_the_success_of_a_player_is_that_of_all_its_runs_and_of_none_where_a_task_has_none():
    runs = [
        entry(run=k, scores={"return": np.zeros(2), "success": np.array(s)}) for k, s in enumerate([(1, 1), (0, 1)])
    ]
    assert statistics.rows(runs)[0].success == 0.75
    assert "| 75% |" in statistics.table(runs)
    assert statistics.rows([entry()])[0].success is None


def test_a_difference_as_large_as_the_tolerance_is_within_it():
    for by, far in ((0.25, False), (0.26, True), (np.inf, True), (np.nan, False)):
        seen = replay(0.25)
        seen.note(Difference(0, 0, "reward", "", ""), by)
        assert seen.far == far
        assert (seen.worst is None) != far
        assert seen.first is not None
    seen = replay(None)
    seen.note(Difference(0, 0, "digest of the observation", "", ""), np.nan)
    assert seen.far, "without a tolerance every bit counts"


def test_of_differences_in_any_order_the_first_in_the_entry_is_told_and_the_largest():
    places = [(1, 0), (0, 5), (0, -1), (0, None), (None, None)]
    seen = replay(0.0)
    for k, (episode, step) in enumerate(places):
        seen.note(Difference(episode, step, "reward", "", ""), 5.0 - k)
    assert (seen.first.episode, seen.first.step) == (seen.worst.episode, seen.worst.step) == (0, -1)
    assert seen.most == 5.0
    told = [
        Difference(*place, "reward", "", "")
        for place in sorted(places, key=lambda p: (p[0] is None, p[0], p[1] is None, p[1]))
    ]
    assert all(_earlier(a, b) and not _earlier(b, a) for a, b in pairwise(told))
