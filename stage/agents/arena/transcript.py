"""Transcripts: what was called and what came of it, as lines of JSON; and their replay, without the agent.

first line     FORMAT, suite, split, player, number of games, versions, and the score with its interval
then           for each game {"game": name}, its calls {"call", "arguments", "ok", "answer"}, and {"score", "tokens"}

A transcript comes from strangers: a replay makes its calls, which can do what tools can do, and nothing else of it is run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stage.agents.arena.games import suite
from stage.agents.arena.loop import Played, Round, jsonable, value_of
from stage.bench.versions import versions
from stage.errors import ArgumentError
from stage.files import written

FORMAT = 1
MARK = "PulseStage transcript"
LARGEST = 256 << 20  # bytes of a file


@dataclass(frozen=True)
class Replayed:
    """What came of a replay. games, calls: replayed; first: the first difference, in words, "" where there is none."""

    games: int
    calls: int
    first: str

    @property
    def same(self) -> bool:
        """Every answer and every score is equal, bit for bit."""
        return not self.first

    def __str__(self) -> str:
        head = f"{self.games} games, {self.calls} calls: "
        return head + (
            "every answer and score is equal, bit for bit" if self.same else f"DIFFERS first in {self.first}"
        )


def save(played: Played, path: str | os.PathLike, overwrite: bool = False) -> None:
    """Write a transcript. Raises FileError."""
    head = {
        "format": [MARK, FORMAT], "suite": played.suite, "split": played.split, "player": played.player,
        "games": len(played.rounds), "value": played.value, "low": played.low, "high": played.high, "tokens": played.tokens,
        "versions": versions(),
    }  # fmt: skip
    with written(path, overwrite) as part, part.open("w", encoding="utf-8") as file:
        for line in (head, *(line for r in played.rounds for line in _lines(r))):
            file.write(json.dumps(line) + "\n")


def _lines(r: Round) -> list[dict[str, Any]]:
    return [{"game": r.game}, *r.calls, {"score": r.score, "tokens": r.tokens}]


def read(path: str | os.PathLike) -> Played:
    """A transcript from a file. Raises ArgumentError in words for any other file, and FileNotFoundError."""
    place = Path(path)
    if not place.is_file():
        raise FileNotFoundError(f"{path}: there is no such file.")
    if place.stat().st_size > LARGEST:
        raise ArgumentError(f"{path}: {place.stat().st_size} bytes, and a transcript has at most {LARGEST}.")
    rounds: list[Round] = []
    with place.open(encoding="utf-8") as file:
        try:
            head = json.loads(file.readline())
            if head["format"] != [MARK, FORMAT]:
                raise ValueError("it is of another format")
            for text in file:
                _take(json.loads(text), rounds)
            if len(rounds) != head["games"] or any(not r.score for r in rounds):
                raise ValueError("its end is missing")
            values = [float(r.score["value"]) for r in rounds]
            return Played(
                str(head["suite"]), str(head["split"]), str(head["player"]), rounds, *value_of(head["suite"], values)
            )
        except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as why:
            raise ArgumentError(f"{path}: no whole transcript of `stage agent`: {why}.") from None


def _take(line: dict[str, Any], rounds: list[Round]) -> None:
    if "game" in line:
        rounds.append(Round(str(line["game"]), [], {}, 0))
    elif "call" in line:
        rounds[-1].calls.append(line)
    else:
        last = rounds.pop()
        rounds.append(Round(last.game, last.calls, dict(line["score"]), int(line["tokens"])))


def replay(transcript: Played | str | os.PathLike, told: Callable[[int, int], None] | None = None) -> Replayed:
    """Make the calls again, without the player, and compare. told: of (games, of). Raises ArgumentError."""
    played = transcript if isinstance(transcript, Played) else read(transcript)
    one = played.rounds[0].game if len(played.rounds) == 1 and played.suite == "diagnosis" else played.suite
    games = suite(one, played.split or "train", None if ":" in one else len(played.rounds))
    calls = 0
    for k, (game, claimed) in enumerate(zip(games, played.rounds, strict=True)):
        if game.name != claimed.game:
            return Replayed(k, calls, f"game {k}: {claimed.game!r} in the transcript, {game.name!r} here")
        for row in claimed.calls:
            answer = game.calls.call(row["call"], row["arguments"])
            calls += 1
            if (answer.ok, jsonable(answer.data)) != (row["ok"], row["answer"]):
                there, here = str(row["answer"])[:200], answer.text[:200]
                where = f"game {game.name}, call {row['call']}"
                return Replayed(k, calls, f"{where}: {there} in the transcript, {here} here")
        score = {name: float(v) for name, v in game.score().items()}
        if jsonable(score) != claimed.score:
            return Replayed(k, calls, f"game {game.name}, score: {claimed.score} in the transcript, {score} here")
        if told:
            told(k + 1, len(played.rounds))
    return Replayed(len(played.rounds), calls, "")
