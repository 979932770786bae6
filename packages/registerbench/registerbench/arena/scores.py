"""What was to be played and what came of it: `Head`, `Round`, `Played`. Every number of a score is computed from its rounds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from registerbench.arena.games import DIAGNOSIS
from registerbench.arena.table import MAX_CALLS, Limits, jsonable
from registerbench.entry_files import Entry
from registerbench.statistics import compute_interval, compute_iqm

FAILED = "failed"


@dataclass(frozen=True)
class Head:
    """Head of a run: what was to be played, by whom, within which limits; games: names and seeds."""

    suite: str
    split: str
    round: str
    games: tuple[tuple[str, int | None], ...]
    of: int
    limits: Limits
    player: str

    @property
    def kind(self) -> str:
        """Kind of the suite: "diagnosis", or a task."""
        return self.suite.partition(":")[0]


@dataclass(frozen=True)
class Round:
    """Game that was played.

    Attributes:
        game: Its name.
        seed: Of the episode, or None.
        calls: Calls, each with its arguments and answer.
        score: By name.
        tokens: 0 where the player does not count.
        ended: Why it was ended; "" by the player itself or the game.
        troubles: What went wrong beside calls, and how often.
    """

    game: str
    seed: int | None
    calls: list[dict[str, Any]]
    score: dict[str, float]
    tokens: int
    ended: str = ""
    troubles: dict[str, int] = field(default_factory=dict)

    @property
    def valid(self) -> int:
        """Calls that were not refused."""
        return sum(c["ok"] is True for c in self.calls)


@dataclass(frozen=True)
class Played:
    """Games of a player and their score.

    Attributes:
        head: Of the run.
        rounds: Games, in their order.
        value, low, high: Value of these games with its 95 % interval: the mean of set-ups, the interquartile mean of returns.
        entry: Of the bench, or None.
    """

    head: Head
    rounds: list[Round]
    value: float
    low: float
    high: float
    entry: Entry | None = field(default=None, repr=False)

    @property
    def whole(self) -> bool:
        """All games of the suite were played, so that this is the suite's score."""
        return len(self.rounds) == self.head.of

    @property
    def player(self) -> str:
        """Name of the player."""
        return self.head.player

    @property
    def tokens(self) -> int:
        """Tokens in all games."""
        return sum(r.tokens for r in self.rounds)

    @property
    def calls(self) -> int:
        """Calls in all games."""
        return sum(len(r.calls) for r in self.rounds)

    def __str__(self) -> str:
        return f"{self.player} on {self.said}, {self.tokens} tokens"

    @property
    def said(self) -> str:
        """All that the games themselves tell, in words: which, the score, calls."""
        n, valid = len(self.rounds), sum(r.valid for r in self.rounds)
        where = f"{self.head.kind} {self.head.split}".rstrip()
        what = "mean of found and mended" if self.head.kind == DIAGNOSIS else "interquartile mean of the return"
        head = f"{where}, all {n} games: " if self.whole else f"{n} of {self.head.of} games of {where}: "
        part = "" if self.whole else "; a part, and no score of the suite"
        refused = f", {self.calls - valid} of them refused" if valid < self.calls else ""
        numbers = f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f}), {what}" if n else "no game was played"
        most = self.head.limits.most
        limit = "" if most == MAX_CALLS else f"; up to {most} calls a game, and {MAX_CALLS} are usual"
        return f"{head}{numbers}{part}; {self.calls} calls{refused}{limit}"

    @property
    def troubles(self) -> Counter[str]:
        """Number of each kind of trouble: games that were ended, and what happened beside them."""
        found = Counter({r.ended: 0 for r in self.rounds if r.ended})
        for r in self.rounds:
            found.update(r.troubles)
            if r.ended:
                found[r.ended] += 1
        return found

    @property
    def sound(self) -> bool:
        """At least one call was valid, and no game was ended."""
        return any(r.valid for r in self.rounds) and not any(r.ended for r in self.rounds)


def played(head: Head, rounds: list[Round], entry: Entry | None = None) -> Played:
    """Return what was played, with its score.

    Args:
        head: Of the run.
        rounds: Games, in their order.
        entry: Of the bench, or None.
    """
    return Played(head, rounds, *value_of(head.kind, [r.score["value"] for r in rounds]), entry)


def closing_of(came: Played) -> dict[str, Any]:
    """Return the last line of a transcript: the scores of its games."""
    return jsonable(
        {"played": len(came.rounds), "of": came.head.of, "value": came.value, "low": came.low, "high": came.high}
        | {"calls": came.calls, "tokens": came.tokens}
    )


def value_of(kind: str, values: Sequence[float]) -> tuple[float, float, float]:
    """Compute the value of games.

    Args:
        kind: Of the suite.
        values: Of its games.

    Returns:
        Mean, and both ends of its interval.
    """
    scores = np.array(values, float)
    if not len(scores):
        return float("nan"), float("nan"), float("nan")
    if kind != DIAGNOSIS:
        return compute_iqm(scores), *compute_interval(scores)
    rng = np.random.default_rng(0)
    means = scores[rng.integers(0, len(scores), (2000, len(scores)))].mean(axis=1)
    return float(scores.mean()), float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))
