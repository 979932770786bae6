"""Measuring agents of any kind: games, players, and transcripts that anybody can replay without the agent.

    result = play_games(make_suite("diagnosis"), make_player("technician"))
    print(result)                                 a score with its interval, and the number of games
    write_transcript(result, "technician.jsonl")
    assert replay("technician.jsonl").is_same     the same calls again, compared bit for bit

games.py defines the games, game_session.py the interface of a player to a game, and suite_runner.py plays a suite.
suite_results.py computes the scores; transcript.py and transcript_replay.py store games and repeat them. players/ has the
players: shipped functions, commands that speak JSON lines, OpenAI-compatible endpoints, and clients of the Model Context
Protocol. The command line offers all of this as `stage agent`.
"""

from registerbench.arena.game_session import GameSession, Limits
from registerbench.arena.games import Game, list_suites, make_suite
from registerbench.arena.players import make_game_player
from registerbench.arena.suite_results import GameResult, SuiteResult
from registerbench.arena.suite_runner import RunInterrupted, make_header, play_games
from registerbench.arena.transcript import TranscriptWriter, read_transcript, write_transcript
from registerbench.arena.transcript_replay import TranscriptReplay, replay

__all__ = [
    "Game",
    "GameResult",
    "GameSession",
    "RunInterrupted",
    "Limits",
    "SuiteResult",
    "TranscriptReplay",
    "TranscriptWriter",
    "list_suites",
    "make_header",
    "make_game_player",
    "play_games",
    "read_transcript",
    "replay",
    "make_suite",
    "write_transcript",
]
