"""The loop that lets a player play the games of a suite, each in a thread, and collects calls, answers and tokens."""

from __future__ import annotations

import asyncio
import ctypes
import inspect
import threading
from collections.abc import Callable, Sequence
from typing import Any

from registerbench.arena.game_session import CallAfterGameEnd, GameSession, Limits
from registerbench.arena.games import Game, Suite
from registerbench.arena.suite_results import GameResult, RunHeader, SuiteResult, make_result
from registerbench.arena.transcript_replay import replay_game
from stage.errors import ArgumentError, StageError

GamePlayer = Callable[[GameSession], Any]


class RunInterrupted(StageError):
    """Error of a run that cannot continue; its attribute `result` has the games that were played before."""

    def __init__(self, message: str, result: SuiteResult):
        super().__init__(message)
        self.result = result


def play_games(
    suite: Suite,
    player: GamePlayer,
    name: str = "",
    limits: Limits | None = None,
    report_progress: Callable[[GameResult], None] | None = None,
    earlier_games: Sequence[GameResult] = (),
) -> SuiteResult:
    """Let a player play every game of a suite.

    Args:
        suite: Games to play.
        player: Function that is called with the session of each game.
        name: Name of the player; default: the name that it gives itself.
        limits: Limits of calls and time.
        report_progress: Called with the result of each game.
        earlier_games: Games of an interrupted run, which are replayed instead of played.

    Returns:
        The games and their score.

    Raises:
        ArgumentError: An earlier game comes out differently here.
        RunInterrupted: The player cannot play.
    """
    name = name or get_player_name(player)
    limits = limits or Limits()
    head = make_header(suite, name, limits)
    games: list[GameResult] = []
    for k, game in enumerate(suite):
        if k < len(earlier_games):
            if differs := replay_game(game, earlier_games[k]):
                raise ArgumentError(f"what was played before comes out otherwise here: {differs}.")
            games.append(earlier_games[k])
            continue
        try:
            games.append(_play_game(game, player, limits))
        except StageError as why:
            message = f"game {k + 1} of {len(suite.games)}, {game.name}: {why}"
            raise RunInterrupted(message, make_result(head, games)) from why
        if report_progress:
            report_progress(games[-1])
    cost: dict[str, float] = {"tokens": sum(r.tokens for r in games), "calls": sum(len(r.calls) for r in games)}
    return make_result(head, games, suite.build_entry(name, cost))


def make_header(suite: Suite, player: str, limits: Limits) -> RunHeader:
    """Return the header of a run, which is the first line of its transcript.

    Args:
        suite: Games to play.
        player: Name of the player.
        limits: Limits of calls and time.
    """
    return RunHeader(suite.name, suite.split, suite.round, suite.games, suite.total_games, limits, player)


def get_player_name(player: GamePlayer) -> str:
    """Return the name that the player gives itself."""
    return str(getattr(player, "name", getattr(player, "__name__", type(player).__name__)))


def _play_game(game: Game, player: GamePlayer, limits: Limits) -> GameResult:
    """Let the player play one game, and return its result."""
    session = GameSession(game, limits)
    _run_in_thread(player, session)
    score = {name: float(v) for name, v in game.compute_scores().items()}
    return GameResult(
        game.name, game.seed, session.log, score, session.tokens, session.end_reason, dict(session.trouble_counts)
    )


def _run_in_thread(player: GamePlayer, session: GameSession) -> None:
    """Call the player in a thread of its own, so that a player that hangs can be abandoned."""
    raised: list[BaseException] = []
    done = threading.Event()

    def work() -> None:
        try:
            returned = player(session)
            if inspect.iscoroutine(returned):
                asyncio.run(returned)
        except CallAfterGameEnd:
            pass
        except BaseException as error:  # it is raised again below
            raised.append(error)
        finally:
            done.set()

    thread = threading.Thread(target=work, name="player", daemon=True)
    thread.start()
    while not done.wait(session.compute_time_left()):
        if why := session.explain_timeout():
            session.end_game(why)
            getattr(player, "stop", lambda: None)()
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(thread.ident or 0), ctypes.py_object(CallAfterGameEnd)
            )
            return
    if raised:
        raise raised[0]
