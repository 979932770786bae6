"""`play`: a player at the games of a suite. What was called and what came of it is kept; so are tokens, where they are told."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stage.agents.arena.games import DIAGNOSIS, Game, Suite
from stage.agents.tool import Answer
from stage.bench.files import Submission
from stage.bench.statistics import interval, iqm

MOST = 400  # calls of a game
Player = Callable[["Table"], None]


class Table:
    """A game as a player has it. task: what is to be done; tools: name, description, schema of each; tokens: the player counts;
    playing: the calls themselves, which keep no log.

    over: nothing more can be done, or too many calls were made.
    """

    def __init__(self, game: Game, most: int = MOST):
        self._game, self._most, self.task, self.name = game, most, game.task, game.name
        self.playing = game.calls
        self.tokens = 0
        self.log: list[dict[str, Any]] = []

    @property
    def tools(self) -> list[dict[str, Any]]:
        """As most interfaces of language models take them: name, description, parameters."""
        return [
            {"name": t.name, "description": t.text, "parameters": t.schema()} for t in self._game.calls.tools.values()
        ]

    @property
    def over(self) -> bool:
        return self._game.over or len(self.log) >= self._most

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Make a call; it never raises."""
        if len(self.log) >= self._most:
            return Answer(False, {"error": f"{self._most} calls are made, and a game has no more."})
        answer = self._game.calls.call(name, arguments)
        row = {"call": name, "arguments": arguments, "ok": answer.ok, "answer": answer.data}
        self.log.append(jsonable(row))
        return answer


@dataclass(frozen=True)
class Round:
    """A game that was played. calls: each with its arguments and answer; score: by name; tokens: 0 where nobody told."""

    game: str
    calls: list[dict[str, Any]]
    score: dict[str, float]
    tokens: int


@dataclass(frozen=True)
class Played:
    """What a player has reached in a suite. value, low, high: of the suite's score, with its 95 % interval: the mean of broken
    set-ups, the interquartile mean of returns."""

    suite: str
    split: str
    player: str
    rounds: list[Round]
    value: float
    low: float
    high: float
    entry: Submission | None = field(default=None, repr=False)

    @property
    def tokens(self) -> int:
        """In all."""
        return sum(r.tokens for r in self.rounds)

    def __str__(self) -> str:
        n, calls = len(self.rounds), sum(len(r.calls) for r in self.rounds)
        what = "mean of found and mended" if self.suite.startswith(DIAGNOSIS) else "interquartile mean of the return"
        where = f"{self.suite} {self.split}".rstrip()
        said = f"{self.player} on {where}: {self.value:.3f} ({self.low:.3f} to {self.high:.3f})"
        return f"{said}, {what} of {n} games; {calls} calls, {self.tokens} tokens"


def play(
    suite: Suite, player: Player, name: str = "", most: int = MOST, told: Callable[[Round], None] | None = None
) -> Played:
    """Let a player play every game. name: of the player; most: calls of a game; told: of each game that is over."""
    name = name or str(getattr(player, "name", getattr(player, "__name__", type(player).__name__)))
    rounds = []
    for game in suite:
        table = Table(game, most)
        player(table)
        done = Round(game.name, table.log, {k: float(v) for k, v in game.score().items()}, table.tokens)
        rounds.append(done)
        if told:
            told(done)
    tokens = sum(r.tokens for r in rounds)
    entry = suite.entry(name, {"tokens": tokens, "calls": sum(len(r.calls) for r in rounds)})
    return Played(
        suite.name, suite.split, name, rounds, *value_of(suite.name, [r.score["value"] for r in rounds]), entry
    )


def value_of(suite: str, values: Sequence[float]) -> tuple[float, float, float]:
    """Of a suite's scores: value, low, high."""
    scores = np.array(values, float)
    if not suite.startswith(DIAGNOSIS):
        return iqm(scores), *interval(scores)
    rng = np.random.default_rng(0)
    means = scores[rng.integers(0, len(scores), (2000, len(scores)))].mean(axis=1)
    return float(scores.mean()), float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def jsonable(value: Any) -> Any:
    """As it comes back from a file of JSON."""
    return json.loads(json.dumps(value, default=repr))
