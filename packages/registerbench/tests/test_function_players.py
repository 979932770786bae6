"""Players of the command line that are functions play in a process of their own, and reach the game over a pipe alone."""

import pytest

from registerbench.arena import make_game_player, make_suite, play_games, replay
from stage.errors import ArgumentError

PLAYERS = """
import gc

def peeks(session):
    from registerbench.diagnosis import Case
    cases = [o for o in gc.get_objects() if isinstance(o, Case)] + [v for v in vars(session).values() if hasattr(v, "case")]
    session.call("answer", {"cause": cases[0].setup.causes[0] if cases else "no fault"})
    session.call("finish")

def talks(session):
    print("chatter")
    assert {t["name"] for t in session.tools} >= {"task", "run"}
    assert session.task in session.call("task").text
    assert not session.call("answer", {(1, 2): 3}).ok
    session.count_tokens(7)
    assert session.call("finish").ok and session.over
    assert "over" in session.call("task").text

class Made:
    async def __call__(self, session):
        session.call("program")

wrong = 3
"""


@pytest.fixture(autouse=True)
def module(tmp_path, monkeypatch):
    (tmp_path / "piped_players.py").write_text(PLAYERS)
    (tmp_path / "torn_players.py").write_text("def play(session:\n")
    monkeypatch.chdir(tmp_path)


def test_a_function_does_not_find_the_broken_set_up_in_its_interpreter():
    """Read `session._game.case.setup.causes`, as a function in the process of the game did: it scored 0.999 without a run."""
    result = play_games(make_suite("diagnosis:late"), make_game_player("piped_players:peeks"))
    assert result.games[0].score["found"] == -1
    assert replay(result).is_same


def test_a_function_plays_over_the_pipe_as_it_did_in_process():
    result = play_games(make_suite("diagnosis:late"), make_game_player("piped_players:talks"))
    assert result.is_valid, result.trouble_counts
    assert (result.player, result.tokens, result.calls) == ("piped_players:talks", 7, 2)
    assert play_games(make_suite("diagnosis:late"), make_game_player("piped_players:Made")).calls == 1


@pytest.mark.parametrize(
    ("name", "message"), [("piped_players:wrong", "is not a function"), ("torn_players:play", "SyntaxError")]
)
def test_what_is_no_player_is_refused_before_the_first_game(name, message):
    with pytest.raises(ArgumentError, match=message):
        make_game_player(name)
