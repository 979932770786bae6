"""Measuring agents, whatever they are: games, players, transcripts that anybody replays without the agent.

    came = play(suite("diagnosis"), player("technician"))
    print(came)                                a score with its interval, of so many games
    save(came, "technician.jsonl")
    assert replay("technician.jsonl").same     the calls again, bit for bit

games.py has what is played, table.py a game as a player has it, loop.py plays, scores.py counts, transcript.py and replay.py keep
what was played; players/ has who plays: functions that are shipped, commands that speak JSON lines, OpenAI-compatible endpoints,
clients of the Model Context Protocol. `stage agent` on the command line.
"""

from registerbench.arena.games import Game, suite, suites
from registerbench.arena.loop import Interrupted, head_of, play
from registerbench.arena.players import player
from registerbench.arena.replay import Replayed, replay
from registerbench.arena.scores import Played, Round
from registerbench.arena.table import Limits, Table
from registerbench.arena.transcript import Writer, read_transcript, write_transcript

__all__ = [
    "Game",
    "Interrupted",
    "Limits",
    "Played",
    "Replayed",
    "Round",
    "Table",
    "Writer",
    "head_of",
    "play",
    "player",
    "read_transcript",
    "replay",
    "suite",
    "suites",
    "write_transcript",
]
