"""Measuring agents, whatever they are: games, players, transcripts that anybody replays without the agent.

    played = play(suite("diagnosis"), player("technician"))
    print(played)                              a score with its interval
    save(played, "technician.jsonl")
    assert replay("technician.jsonl").same     the calls again, bit for bit

games.py has what is played, loop.py plays it, players/ who plays: functions that are shipped, commands that speak JSON lines,
OpenAI-compatible endpoints, clients of the Model Context Protocol. `stage agent` on the command line.
"""

from stage.agents.arena.games import Game, suite, suites
from stage.agents.arena.loop import Played, play
from stage.agents.arena.players import player
from stage.agents.arena.transcript import Replayed, read, replay, save

__all__ = ["Game", "Played", "Replayed", "play", "player", "read", "replay", "save", "suite", "suites"]
