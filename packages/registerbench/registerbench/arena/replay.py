"""`replay`: the calls of a transcript once more, without its player. Whatever it says is computed from them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

from registerbench.arena.games import Game
from registerbench.arena.scores import Played, Round, closing_of, played
from registerbench.arena.table import jsonable
from registerbench.arena.transcript import Transcript, read_transcript, suite_of
from stage.agents.arguments import format_value


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes:
        played: Games that came out as the transcript says, with their score.
        first: First difference, in words; "" where there is none.
        cut: Sentence about a transcript that ends before its games do; "" otherwise.
    """

    played: Played
    first: str
    cut: str = ""

    @property
    def same(self) -> bool:
        """Every answer and every score is equal, bit for bit, and every game is there."""
        return not self.first and not self.cut

    def __str__(self) -> str:
        p = self.played
        claimed = f"Claimed, and not to be verified: the player's name {format_value(p.player)}, {p.tokens} tokens."
        if self.first:
            return f"{len(p.rounds)} games are equal, then it DIFFERS: {self.first}"
        lines = [p.said, "every answer and score is equal, bit for bit", *([self.cut] if self.cut else []), claimed]
        return "\n".join(lines)


def replay(
    transcript: Played | str | os.PathLike, report_progress: Callable[[int, int], None] | None = None
) -> Replayed:
    """Make the calls of a transcript again, without the player, and compare.

    Args:
        transcript: What was played, or a file.
        report_progress: Called with (games replayed, games).

    Raises:
        ArgumentError: The file cannot be read.
    """
    if isinstance(transcript, Played):
        given = Transcript(transcript.head, transcript.rounds, closing_of(transcript), 0)
    else:
        given = read_transcript(transcript)
    games = suite_of(given.head)
    rounds: list[Round] = []
    for claimed, game in zip(given.rounds, games, strict=False):
        if first := again(game, claimed, given.head.limits.most):
            return Replayed(played(given.head, rounds), first)
        rounds.append(claimed)
        if report_progress:
            report_progress(len(rounds), len(given.rounds))
    came = played(given.head, rounds)
    return Replayed(came, _closing(given, came), _cut(given))


def again(game: Game, claimed: Round, most: int | None = None) -> str:
    """Make the calls of a game again.

    Args:
        game: To play.
        claimed: What the transcript says of it.
        most: Number of calls.

    Returns:
        The first difference in words, "" if all is equal.
    """
    if (game.name, game.seed) != (claimed.game, claimed.seed):
        return f"game {claimed.game!r} with seed {claimed.seed} in the transcript, {game.name!r} with {game.seed} here"
    if most is not None and len(claimed.calls) > most:
        return f"game {game.name}: {len(claimed.calls)} calls, and {most} are allowed"
    for k, row in enumerate(claimed.calls):
        where = f"game {game.name}, call {k + 1}, {format_value(row['call'])}"
        if game.over:
            return f"{where}: the game was over before it"
        if row.get("made") is False:  # its arguments could not be written down
            if row["ok"] is not False:
                return f"{where}: it was not made, and has an answer"
            continue
        answer = game.calls.call(row["call"], row["arguments"])
        if (answer.ok, jsonable(answer.data)) != (row["ok"], row["answer"]):
            return f"{where}: {str(row['answer'])[:200]} in the transcript, {answer.text[:200]} here"
    score = jsonable({name: float(v) for name, v in game.score().items()})
    return "" if score == claimed.score else f"game {game.name}, score: {claimed.score} in the transcript, {score} here"


def _closing(given: Transcript, came: Played) -> str:
    """The last line against what came out."""
    if given.closing is None:
        return ""
    here = closing_of(came)
    wrong = [k for k in here if given.closing.get(k) != here[k]]
    return "; ".join(
        f"last line, {k}: {format_value(given.closing.get(k))} in the transcript, {here[k]} here" for k in wrong
    )


def _cut(given: Transcript) -> str:
    n, of = len(given.rounds), len(given.head.games)
    if n < of:
        return f"The transcript is cut: {n} of its {of} games are there."
    return "" if given.closing is not None else "The transcript is cut: its last line is missing."
