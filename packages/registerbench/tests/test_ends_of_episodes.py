"""Episodes of the bench close what they open, and the run seeds the player."""

import pytest

import registerbench
from registerbench import entry_creation
from registerbench.benchmark_tasks import CARDS, Card
from registerbench.entry_creation import EpisodeSequence
from stage.envs.stage_env import StageEnv

BRIEF = Card(
    "brief",
    "stage/FewShotTuning-v1",
    "one try of a short move, for tests",
    settings={"model": "xy", "distances": (400, 500), "tries": 1, "proofs": 0, "settle": 0.01},
    episodes=2,
)


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    monkeypatch.setitem(CARDS, "brief", BRIEF)


@pytest.fixture
def closed(monkeypatch):
    results = []
    monkeypatch.setattr(StageEnv, "close", lambda self: results.append(self))
    return results


def test_episodes_that_are_closed_close_their_environment(closed):
    created = EpisodeSequence("brief", "train", "host", "open", {})
    created.close()
    assert closed == [created.env]


def test_a_play_closes_its_environment_after_its_end_and_after_an_error(closed):
    registerbench.play("random", "brief", episodes=1)
    assert len(closed) == 1
    with pytest.raises(ZeroDivisionError):
        registerbench.play(lambda observation, info: 1 / 0, "brief", episodes=1)
    assert len(closed) == 2


def test_a_player_that_draws_is_seeded_by_its_run_and_plays_the_round_that_was_requested(monkeypatch):
    requested, rounds, real, drawn = [], [], entry_creation.make_player, entry_creation.list_test_seeds
    monkeypatch.setattr(
        entry_creation, "make_player", lambda *arguments: (requested.append(arguments), real(*arguments))[1]
    )
    monkeypatch.setattr(
        entry_creation, "list_test_seeds", lambda *arguments: (rounds.append(arguments[1:]), drawn(*arguments))[1]
    )
    created = registerbench.play(
        "random", "brief", "heavy", run=6, round_="2031", episodes=1, name="dice", notes="n", cost={"moves": 4}
    )
    assert requested == [("random", "brief", 6, ())], "without a sandbox"
    assert rounds == [("heavy", "2031")]
    assert (created.run, created.player, created.notes, created.round, created.split, created.cost["moves"]) == (
        6,
        "dice",
        "n",
        "2031",
        "heavy",
        4,
    )
    assert registerbench.play("random", "brief", episodes=1).player == "random"
    assert created.seeds == (drawn(BRIEF, "heavy", "2031")[0],)


def test_counted_costs_override_those_of_the_policy_which_override_stated_costs():
    def frugal(observation, info):
        return [0.0] * 4

    frugal.cost = {"tokens": 12, "test_moves": 99}
    created = registerbench.play(frugal, "brief", episodes=1, cost={"tokens": 1, "moves": 7, "test_moves": 5})
    assert created.cost == {"tokens": 12, "moves": 7, "test_moves": 1}
