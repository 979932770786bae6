"""Results of a player: the header of a run, the result of each game, and the score of a suite, which is computed from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from registerbench.arena.game_session import MAX_CALLS, Limits, round_trip_json
from registerbench.arena.games import DIAGNOSIS
from registerbench.benchmark_tasks import OPEN_ROUND
from registerbench.entry_files import Entry
from registerbench.score_statistics import compute_interval, compute_iqm

FAILED = "failed"


@dataclass(frozen=True)
class RunHeader:
    """Header of a run: what a player is to play, and within which limits.

    Attributes:
        suite: Name of the suite, such as "diagnosis:late".
        split, round: Split and round of a task of the benchmark; "" for broken set-ups.
        games: Name and seed of each game.
        of: Number of games of the complete suite.
        limits: Limits of a game.
        player: Name of the player.
    """

    suite: str
    split: str
    round: str
    games: tuple[tuple[str, int | None], ...]
    of: int
    limits: Limits
    player: str

    @property
    def kind(self) -> str:
        """Kind of the suite that is played: "diagnosis", or a task of the benchmark."""
        return self.suite.partition(":")[0]


@dataclass(frozen=True)
class GameResult:
    """Result of one game that a player has played.

    Attributes:
        game: Name of the game.
        seed: Seed of the episode, or None.
        calls: Calls, each with its arguments and its answer.
        score: Scores by name.
        tokens: Number of tokens; 0 if the player does not count them.
        end_reason: Why the game was ended for the player; "" if the player or the game ended it.
        trouble_counts: What the player did wrong apart from calls, and how often.
    """

    game: str
    seed: int | None
    calls: list[dict[str, Any]]
    score: dict[str, float]
    tokens: int
    end_reason: str = ""
    trouble_counts: dict[str, int] = field(default_factory=dict)

    @property
    def valid_calls(self) -> int:
        """Number of tool calls in the game that were not refused."""
        return sum(c["ok"] is True for c in self.calls)


@dataclass(frozen=True)
class SuiteResult:
    """Result of a player on a suite: its games, and their score.

    Attributes:
        head: Header of the run.
        games: Results of the games, in order.
        value, low, high: Score with its 95 % interval: the mean over broken set-ups, or the interquartile mean of the returns.
        entry: Entry of the benchmark; None for broken set-ups.
    """

    head: RunHeader
    games: list[GameResult]
    value: float
    low: float
    high: float
    entry: Entry | None = field(default=None, repr=False)

    @property
    def is_complete(self) -> bool:
        """True if all games of the suite were played, so that the value is the score of the suite."""
        return len(self.games) == self.head.of

    @property
    def player(self) -> str:
        """Name of the player that has played the suite."""
        return self.head.player

    @property
    def tokens(self) -> int:
        """Number of tokens in all games, as the player states it."""
        return sum(r.tokens for r in self.games)

    @property
    def calls(self) -> int:
        """Number of tool calls in all games."""
        return sum(len(r.calls) for r in self.games)

    def __str__(self) -> str:
        return f"{self.player} on {self.summary}, {self.tokens} tokens"

    @property
    def summary(self) -> str:
        """Sentence with the suite, the score and the number of calls. It omits the tokens, which only the player states."""
        n, valid = len(self.games), sum(r.valid_calls for r in self.games)
        where = f"{self.head.kind} {self.head.split}".rstrip() + ", for practice" * (":" in self.head.suite)
        where += f", round {self.head.round}" * (self.head.round not in ("", OPEN_ROUND))
        what = "mean of found and mended" if self.head.kind == DIAGNOSIS else "interquartile mean of the return"
        head = f"{where}, all {n} games: " if self.is_complete else f"{n} of {self.head.of} games of {where}: "
        part = "" if self.is_complete else "; a part, and no score of the suite"
        refused = f", {self.calls - valid} of them refused" if valid < self.calls else ""
        numbers = f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f}), {what}" if n else "no game was played"
        max_calls = self.head.limits.max_calls
        limit = "" if max_calls == MAX_CALLS else f"; up to {max_calls} calls a game, and {MAX_CALLS} are usual"
        return f"{head}{numbers}{part}; {self.calls} calls{refused}{limit}"

    @property
    def trouble_counts(self) -> Counter[str]:
        """Number of times that each trouble occurred: reasons for which games were ended, and mistakes of players outside calls."""
        counts = Counter({r.end_reason: 0 for r in self.games if r.end_reason})
        for r in self.games:
            counts.update(r.trouble_counts)
            if r.end_reason:
                counts[r.end_reason] += 1
        return counts

    @property
    def is_valid(self) -> bool:
        """True if at least one call was valid and no game was ended for the player."""
        return any(r.valid_calls for r in self.games) and not any(r.end_reason for r in self.games)


def make_result(head: RunHeader, games: list[GameResult], entry: Entry | None = None) -> SuiteResult:
    """Compute the score of games, and return both as the result of a suite.

    Args:
        head: Header of the run.
        games: Results of the games, in order.
        entry: Entry of the benchmark, or None.
    """
    return SuiteResult(head, games, *compute_suite_score(head.kind, [r.score["value"] for r in games]), entry)


def summarize_result(result: SuiteResult) -> dict[str, Any]:
    """Return the last line of a transcript: number of games, score, calls and tokens."""
    return round_trip_json(
        {
            "played": len(result.games),
            "of": result.head.of,
            "value": result.value,
            "low": result.low,
            "high": result.high,
        }
        | {"calls": result.calls, "tokens": result.tokens}
    )


def compute_suite_score(suite_kind: str, values: Sequence[float]) -> tuple[float, float, float]:
    """Compute the score of a suite from the values of its games.

    Args:
        suite_kind: "diagnosis", or the name of a task.
        values: Value of each game.

    Returns:
        The score, and both ends of its 95 % interval; NaN if there are no games.
    """
    scores = np.array(values, float)
    if not len(scores):
        return float("nan"), float("nan"), float("nan")
    if suite_kind != DIAGNOSIS:
        return compute_iqm(scores), *compute_interval(scores)
    rng = np.random.default_rng(0)
    means = scores[rng.integers(0, len(scores), (2000, len(scores)))].mean(axis=1)
    return float(scores.mean()), float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))
