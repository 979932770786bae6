"""`play`: a player at the games of a suite. What was called and what came of it is kept; so are tokens, where they are told."""

from __future__ import annotations

import asyncio
import ctypes
import inspect
import threading
from collections.abc import Callable, Sequence
from typing import Any

from registerbench.arena.games import Game, Suite
from registerbench.arena.replay import again
from registerbench.arena.scores import FAILED, Head, Played, Round, played
from registerbench.arena.table import Left, Limits, Table
from stage.errors import ArgumentError, StageError

Player = Callable[[Table], Any]


class Interrupted(StageError):
    """A run cannot go on. played: the games until then; why: in words."""

    def __init__(self, message: str, played: Played):
        super().__init__(message)
        self.played = played


def play(
    suite: Suite,
    player: Player,
    name: str = "",
    limits: Limits | None = None,
    report_progress: Callable[[Round], None] | None = None,
    before: Sequence[Round] = (),
) -> Played:
    """Let a player play every game of a suite.

    Args:
        suite: The games.
        player: Called with the table of each game.
        name: Of the player; default: as it calls itself.
        limits: Of calls and time.
        report_progress: Called with each game that is over.
        before: Games that were played earlier.

    Returns:
        The games and their score.
    """
    name = name or name_of(player)
    limits = limits or Limits()
    head = head_of(suite, name, limits)
    rounds: list[Round] = []
    for k, game in enumerate(suite):
        if k < len(before):
            if differs := again(game, before[k]):
                raise ArgumentError(f"what was played before comes out otherwise here: {differs}.")
            rounds.append(before[k])
            continue
        try:
            rounds.append(_one(game, player, limits))
        except StageError as why:
            said = f"game {k + 1} of {len(suite.games)}, {game.name}: {why}"
            raise Interrupted(said, played(head, rounds)) from why
        if report_progress:
            report_progress(rounds[-1])
    cost: dict[str, float] = {"tokens": sum(r.tokens for r in rounds), "calls": sum(len(r.calls) for r in rounds)}
    return played(head, rounds, suite.entry(name, cost))


def head_of(suite: Suite, player: str, limits: Limits) -> Head:
    """Return the first line of a run."""
    return Head(suite.name, suite.split, suite.round, suite.games, suite.of, limits, player)


def name_of(player: Player) -> str:
    """Return the name that the player gives itself."""
    return str(getattr(player, "name", getattr(player, "__name__", type(player).__name__)))


def _one(game: Game, player: Player, limits: Limits) -> Round:
    table = Table(game, limits)
    _sit(player, table)
    score = {name: float(v) for name, v in game.score().items()}
    return Round(game.name, game.seed, table.log, score, table.tokens, table.ended, dict(table.troubles))


def _sit(player: Player, table: Table) -> None:
    """A player plays in a thread of its own, so that one that hangs can be left."""
    raised: list[BaseException] = []
    done = threading.Event()

    def work() -> None:
        try:
            made = player(table)
            if inspect.iscoroutine(made):
                asyncio.run(made)
        except Left:
            pass
        except BaseException as error:  # it is raised again below
            raised.append(error)
        finally:
            done.set()

    thread = threading.Thread(target=work, name="player", daemon=True)
    thread.start()
    while not done.wait(table.find_time_left()):
        if why := table.late():
            table.leave(why)
            getattr(player, "stop", lambda: None)()
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(Left))
            return
    if raised:
        raise raised[0]


class Guarded:
    """A player of somebody's own, of whose errors a game is ended and not the run."""

    def __init__(self, player: Player):
        self._player, self.name = player, name_of(player)

    def __call__(self, table: Table) -> None:
        try:
            made = self._player(table)
            if inspect.iscoroutine(made):
                asyncio.run(made)
        except StageError:
            raise
        except Exception as error:
            table.leave(f"{FAILED}: {type(error).__name__}: {error}"[:300])
