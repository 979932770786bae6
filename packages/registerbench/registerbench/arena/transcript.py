"""Transcripts: what was called and what came of it, as lines of JSON, written as it happens.

first line     format; suite, split, round, and its games with their seeds, of how many; the limits; player; versions
of each game   {"game", "seed"}; its calls {"call", "arguments", "ok", "answer"}; {"score", "tokens", "ended", "troubles"}
last line      {"played", "of", "value", "low", "high", "calls", "tokens"}

A game is written when it ends, so a run that breaks off leaves the games until then, and `Writer.go_on` continues the file. A
transcript comes from strangers: a replay makes its calls, which can do what tools can do, and nothing else of it is run.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from registerbench.arena.games import Suite, suite
from registerbench.arena.scores import Head, Played, Round, closing_of
from registerbench.arena.table import TOKENS, Limits
from registerbench.versions import list_versions
from stage.errors import ArgumentError
from stage.support.files import FileError, writable
from stage.support.foreign_files import open_regular, parse_json

FORMAT = 2
MARK = "PulseStage transcript"
LARGEST = 256 << 20  # bytes of a file


@dataclass(frozen=True)
class Transcript:
    """Transcript that was read from a file.

    Attributes:
        head: Its first line.
        rounds: Games.
        closing: Its last line; None where it is missing.
        ends: Bytes up to the last complete game.
    """

    head: Head
    rounds: list[Round]
    closing: dict[str, Any] | None
    ends: int


def suite_of(head: Head) -> Suite:
    """Return the suite of a transcript. Raises ArgumentError if its games are others here."""
    one = ":" in head.suite
    games = suite(head.suite, head.split or "train", None if one else len(head.games), head.round)
    if (games.split, games.round) != (head.split, head.round):
        raise ArgumentError(
            f"{head.suite}: split {head.split!r}, round {head.round!r} in the transcript, which it does not have."
        )
    if (games.games, games.of) != (head.games, head.of):
        raise ArgumentError(
            f"{head.suite}: {head.games[:3]} ... of {head.of} in the transcript, {games.games[:3]} ... of {games.of} here."
        )
    return games


class Writer:
    """Writes a transcript as it happens. Raises FileError, and ArgumentError where a file that is to go on is of another run."""

    def __init__(self, path: str | os.PathLike, head: Head, overwrite: bool = False, go_on: bool = False):
        self.before: list[Round] = []
        if go_on and Path(path).exists():
            self._file, self.before = _continued(Path(path), head)
            return
        target = writable(path, overwrite, ask="give --force, or --resume to go on with it")
        try:
            self._file = target.open("w", encoding="utf-8")
        except OSError as why:
            raise FileError(f"{path} cannot be written: {why.strerror or why}.") from why
        columns = asdict(head)
        self._write({"format": [MARK, FORMAT], **columns.pop("limits"), **columns, "versions": list_versions()})

    def game(self, r: Round) -> None:
        """Write the lines of a game that is over."""
        end = {"score": r.score, "tokens": r.tokens, "ended": r.ended, "troubles": r.troubles}
        self._write({"game": r.game, "seed": r.seed}, *r.calls, end)

    def end(self, came: Played) -> None:
        """Write the last line."""
        self._write(closing_of(came))

    def close(self) -> None:
        """Write no more."""
        self._file.close()

    def __enter__(self) -> Writer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, *lines: dict[str, Any]) -> None:
        try:
            self._file.write("".join(json.dumps(line) + "\n" for line in lines))
            self._file.flush()
            if self._file.seekable():
                os.fsync(self._file.fileno())
        except OSError as why:
            raise FileError(f"{self._file.name} cannot be written: {why.strerror or why}.") from why


def write_transcript(came: Played, path: str | os.PathLike, overwrite: bool = False) -> None:
    """Write a transcript as one file.

    Args:
        came: What was played.
        path: Of the file.
        overwrite: Replace a file that is there.

    Raises:
        FileError: The file cannot be written.
    """
    with Writer(path, came.head, overwrite) as writer:
        for r in came.rounds:
            writer.game(r)
        writer.end(came)


def _continued(path: Path, head: Head) -> tuple[IO[str], list[Round]]:
    """A file that is to go on: what it has, cut behind its last whole game."""
    there = read_transcript(path)
    if there.head != head:
        wrong = [k for k, v in asdict(head).items() if asdict(there.head)[k] != v]
        raise ArgumentError(
            f"{path} is of another run, by its {', '.join(wrong)}: give the same arguments, or another file."
        )
    if there.closing is not None:
        raise ArgumentError(f"{path}: all its {len(there.rounds)} games are played; nothing is left to go on with.")
    file = path.open("r+", encoding="utf-8")
    file.seek(there.ends)
    file.truncate()
    return file, there.rounds


def read_transcript(path: str | os.PathLike) -> Transcript:
    """Read a transcript from a file, as far as it goes. Raises ArgumentError for any other file, or none."""
    wrong = (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError)
    with open_regular(path, "transcript", LARGEST, ArgumentError) as file:
        try:
            head = _head(parse_json(file.readline()))
        except wrong as why:
            raise ArgumentError(f"{path}: no transcript of `stage agent`: {_said(why)}.") from None
        rounds: list[Round] = []
        open_: list[dict[str, Any]] = []
        ends, closing, number = file.tell(), None, 1
        for text in file:
            number += 1
            if not text.endswith(b"\n"):
                break  # it was cut in the middle of a line
            try:
                line = parse_json(text)
                if closing is not None:
                    raise ValueError("something stands behind its end")
                if "played" in line and not open_:
                    closing = line
                elif "score" in line:
                    rounds.append(_round(open_, line))
                    open_, ends = [], file.tell()
                elif ("game" in line) == bool(open_) or not ("game" in line or "call" in line):
                    raise ValueError("a line out of its place")
                else:
                    open_.append(line)
            except wrong as why:
                raise ArgumentError(f"{path}, line {number}: no transcript of `stage agent`: {_said(why)}.") from None
    return Transcript(head, rounds, closing, ends)


def _said(why: Exception) -> str:
    said = str(why)[:200].rstrip(".")
    return said if isinstance(why, ValueError) else f"{type(why).__name__}: {said}"


def _head(line: Any) -> Head:
    if not isinstance(line, dict) or "format" not in line:
        raise ValueError("its first line says no format")
    if line["format"] != [MARK, FORMAT]:
        raise ValueError(f"its format is {line['format']!r:.60}, and [{MARK!r}, {FORMAT}] is read")
    games = tuple((_text(name), None if seed is None else _number(seed)) for name, seed in line["games"])
    limits = Limits(line["most"], line["patience"], line["time"])
    text = [_text(line[k]) for k in ("suite", "split", "round")]
    return Head(text[0], text[1], text[2], games, _number(line["of"]), limits, _text(line["player"]))


def _round(lines: list[dict[str, Any]], end: dict[str, Any]) -> Round:
    """Return the game of these lines, without the last one."""
    first, *calls = lines
    for row in calls:
        _ = row["call"], row["arguments"], row["answer"]
        if not isinstance(row["ok"], bool):
            raise ValueError(f"{row['ok']!r:.60} is neither true nor false")
    troubles = {_text(k): _number(n) for k, n in end["troubles"].items()}
    seed = None if first["seed"] is None else _number(first["seed"])
    return Round(
        _text(first["game"]), seed, calls, dict(end["score"]), _number(end["tokens"]), _text(end["ended"]), troubles
    )


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > 2000:
        raise ValueError(f"{value!r:.60} is no text")
    return value


def _number(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < TOKENS * 10_000:
        raise ValueError(f"{value!r:.60} is no whole number")
    return value
