"""Replay of a transcript: its calls are made again, without its player, and every number is computed from them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

from registerbench.arena.game_session import round_trip_json
from registerbench.arena.games import Game
from registerbench.arena.suite_results import GameResult, SuiteResult, make_result, summarize_result
from registerbench.arena.transcript import Transcript, read_transcript, rebuild_suite
from stage.agents.tool_arguments import format_value


@dataclass(frozen=True)
class TranscriptReplay:
    """Result of the replay of a transcript.

    Attributes:
        result: Games that came out as the transcript states, with their score.
        first_difference: First difference, in words; "" if there is none.
        missing_part: Sentence about what a transcript lacks that ends before its games do; "" otherwise.
    """

    result: SuiteResult
    first_difference: str
    missing_part: str = ""

    @property
    def is_same(self) -> bool:
        """True if every answer and every score is equal, bit for bit, and no game is missing."""
        return not self.first_difference and not self.missing_part

    def __str__(self) -> str:
        result = self.result
        claimed = (
            f"Claimed, and not to be verified: the player's name {format_value(result.player)}, {result.tokens} tokens."
        )
        if self.first_difference:
            return f"{len(result.games)} games are equal, then it DIFFERS: {self.first_difference}"
        lines = [
            result.summary,
            "every answer and score is equal, bit for bit",
            *([self.missing_part] if self.missing_part else []),
            claimed,
        ]
        return "\n".join(lines)


def replay(
    transcript: SuiteResult | str | os.PathLike, report_progress: Callable[[int, int], None] | None = None
) -> TranscriptReplay:
    """Make the calls of a transcript again, without the player, and compare.

    Args:
        transcript: Path of a transcript, or the result of a suite.
        report_progress: Called with (games replayed, all games).

    Raises:
        ArgumentError: The file cannot be read.
    """
    if isinstance(transcript, SuiteResult):
        recorded = Transcript(transcript.head, transcript.games, summarize_result(transcript), 0)
    else:
        recorded = read_transcript(transcript)
    games = rebuild_suite(recorded.head)
    replayed: list[GameResult] = []
    for claimed, game in zip(recorded.games, games, strict=False):
        if first := replay_game(game, claimed, recorded.head.limits.max_calls):
            return TranscriptReplay(make_result(recorded.head, replayed), first)
        replayed.append(claimed)
        if report_progress:
            report_progress(len(replayed), len(recorded.games))
    result = make_result(recorded.head, replayed)
    return TranscriptReplay(result, _compare_summary(recorded, result), _describe_missing_games(recorded))


def replay_game(game: Game, claimed: GameResult, max_calls: int | None = None) -> str:
    """Make the calls of a game again, and compare its answers and its score.

    Args:
        game: Game in which to make the calls.
        claimed: The game as the transcript states it.
        max_calls: Largest number of calls; None: any number.

    Returns:
        The first difference in words; "" if all is equal.
    """
    if (game.name, game.seed) != (claimed.game, claimed.seed):
        return f"game {claimed.game!r} with seed {claimed.seed} in the transcript, {game.name!r} with {game.seed} here"
    if max_calls is not None and len(claimed.calls) > max_calls:
        return f"game {game.name}: {len(claimed.calls)} calls, and {max_calls} are allowed"
    for k, row in enumerate(claimed.calls):
        where = f"game {game.name}, call {k + 1}, {format_value(row['call'])}"
        if game.over:
            return f"{where}: the game was over before it"
        if row.get("made") is False:  # its arguments could not be written down
            if row["ok"] is not False:
                return f"{where}: it was not made, and has an answer"
            continue
        answer = game.calls.call(row["call"], row["arguments"])
        if (answer.ok, round_trip_json(answer.data)) != (row["ok"], row["answer"]):
            return f"{where}: {str(row['answer'])[:200]} in the transcript, {answer.text[:200]} here"
    score = round_trip_json({name: float(v) for name, v in game.compute_scores().items()})
    return "" if score == claimed.score else f"game {game.name}, score: {claimed.score} in the transcript, {score} here"


def _compare_summary(recorded: Transcript, result: SuiteResult) -> str:
    """Compare the last line of the transcript with the replayed games, and return the differences in words."""
    if recorded.closing is None:
        return ""
    current = summarize_result(result)
    wrong = [k for k in current if recorded.closing.get(k) != current[k]]
    return "; ".join(
        f"last line, {k}: {format_value(recorded.closing.get(k))} in the transcript, {current[k]} here" for k in wrong
    )


def _describe_missing_games(recorded: Transcript) -> str:
    """Return a sentence about the games that a transcript lacks; "" if it is complete."""
    n, of = len(recorded.games), len(recorded.head.games)
    if n < of:
        return f"The transcript is cut: {n} of its {of} games are there."
    return "" if recorded.closing is not None else "The transcript is cut: its last line is missing."
