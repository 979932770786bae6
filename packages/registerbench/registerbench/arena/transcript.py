"""Transcripts of agents: calls, answers and scores as lines of JSON, written while an agent plays.

first line     format; suite, split, round, and its games with their seeds; the limits; the player; versions
of each game   {"game", "seed"}; its calls {"call", "arguments", "ok", "answer"}; {"score", "tokens", "ended", "troubles"}
last line      {"played", "of", "value", "low", "high", "calls", "tokens"}

A game is written when it ends, so an interrupted run leaves the games until then, and `TranscriptWriter(resume=True)` continues
the file. Transcripts come from strangers: a replay makes their calls, which can do only what tools can do, and executes nothing
else.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from registerbench.arena.game_session import Limits
from registerbench.arena.games import Suite, make_suite
from registerbench.arena.suite_results import GameResult, RunHeader, SuiteResult, summarize_result
from registerbench.package_versions import list_versions
from stage.errors import ArgumentError
from stage.support.files import FileError, check_writable
from stage.support.foreign_files import open_regular, parse_json

FORMAT_VERSION = 2
FORMAT_NAME = "PulseStage transcript"
MAX_FILE_BYTES = 256 << 20  # bytes of a file
MAX_COUNT = 1 << 63  # seeds of a round lie below it


@dataclass(frozen=True)
class Transcript:
    """Transcript that was read from a file.

    Attributes:
        head: Its first line.
        games: Complete games.
        closing: Its last line; None if it is missing.
        complete_bytes: Length of the file up to the end of the last complete game.
    """

    head: RunHeader
    games: list[GameResult]
    closing: dict[str, Any] | None
    complete_bytes: int


def rebuild_suite(head: RunHeader) -> Suite:
    """Make the suite that a transcript names. Raises ArgumentError if its games differ from those of the transcript."""
    one = ":" in head.suite
    games = make_suite(head.suite, head.split or "train", None if one else len(head.games), head.round)
    if (games.split, games.round) != (head.split, head.round):
        raise ArgumentError(
            f"{head.suite}: split {head.split!r}, round {head.round!r} in the transcript, which it does not have."
        )
    if (games.games, games.total_games) != (head.games, head.of):
        raise ArgumentError(
            f"{head.suite}: {head.games[:3]} ... of {head.of} in the transcript, {games.games[:3]} ... of {games.total_games} here."
        )
    return games


class TranscriptWriter:
    """Writer of a transcript, game by game.

    Attributes:
        earlier_games: Games of the file that the writer continues.

    Raises:
        FileError: The file cannot be written.
        ArgumentError: The file to continue belongs to another run, or is complete.
    """

    def __init__(self, path: str | os.PathLike, head: RunHeader, overwrite: bool = False, resume: bool = False):
        self.earlier_games: list[GameResult] = []
        if resume and Path(path).exists():
            self._file, self.earlier_games = _reopen(Path(path), head)
            return
        target = check_writable(path, overwrite, overwrite_hint="give --force, or --resume to go on with it")
        try:
            self._file = target.open("w", encoding="utf-8")
        except OSError as why:
            raise FileError(f"{path} cannot be written: {why.strerror or why}.") from why
        columns, limits = asdict(head), head.limits
        del columns["limits"]
        about = {"format": [FORMAT_NAME, FORMAT_VERSION], "most": limits.max_calls, "patience": limits.patience}
        about |= {"time": limits.time, **columns}
        self._write({**about, "versions": list_versions()})

    def write_game(self, result: GameResult) -> None:
        """Write the lines of a game that is over."""
        end = {
            "score": result.score,
            "tokens": result.tokens,
            "ended": result.end_reason,
            "troubles": result.trouble_counts,
        }
        self._write({"game": result.game, "seed": result.seed}, *result.calls, end)

    def write_summary(self, result: SuiteResult) -> None:
        """Write the last line of the transcript: number of games, score, calls and tokens."""
        self._write(summarize_result(result))

    def close(self) -> None:
        """Close the file of the transcript."""
        self._file.close()

    def __enter__(self) -> TranscriptWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, *lines: dict[str, Any]) -> None:
        """Write values as lines of JSON, and flush the file."""
        try:
            self._file.write("".join(json.dumps(line) + "\n" for line in lines))
            self._file.flush()
            if self._file.seekable():
                os.fsync(self._file.fileno())
        except OSError as why:
            raise FileError(f"{self._file.name} cannot be written: {why.strerror or why}.") from why


def write_transcript(result: SuiteResult, path: str | os.PathLike, overwrite: bool = False) -> None:
    """Write all games of a result as one transcript.

    Args:
        result: Result of a suite.
        path: Path of the file.
        overwrite: Whether to replace an existing file.

    Raises:
        FileError: The file cannot be written.
    """
    with TranscriptWriter(path, result.head, overwrite) as writer:
        for r in result.games:
            writer.write_game(r)
        writer.write_summary(result)


def _reopen(path: Path, head: RunHeader) -> tuple[IO[str], list[GameResult]]:
    """Open a transcript to continue it: cut it after its last complete game, and return the file and its games."""
    earlier = read_transcript(path)
    if earlier.head != head:
        wrong = [k for k, v in asdict(head).items() if asdict(earlier.head)[k] != v]
        raise ArgumentError(
            f"{path} is of another run, by its {', '.join(wrong)}: give the same arguments, or another file."
        )
    if earlier.closing is not None:
        raise ArgumentError(f"{path}: all its {len(earlier.games)} games are played; nothing is left to go on with.")
    file = path.open("r+", encoding="utf-8")
    file.seek(earlier.complete_bytes)
    file.truncate()
    return file, earlier.games


def read_transcript(path: str | os.PathLike) -> Transcript:
    """Read a transcript as far as its games are complete. Raises ArgumentError for any other file."""
    wrong = (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError)
    with open_regular(path, "transcript", MAX_FILE_BYTES, ArgumentError) as file:
        try:
            head = _parse_header(parse_json(file.readline()))
        except wrong as why:
            raise ArgumentError(f"{path}: no transcript of `stage agent`: {_format_reason(why)}.") from None
        games: list[GameResult] = []
        game_lines: list[dict[str, Any]] = []
        complete_bytes, closing, number = file.tell(), None, 1
        for text in file:
            number += 1
            if not text.endswith(b"\n"):
                break  # it was cut in the middle of a line
            try:
                line = parse_json(text)
                if closing is not None:
                    raise ValueError("something stands behind its end")
                if "played" in line and not game_lines:
                    closing = line
                elif "score" in line:
                    games.append(_parse_game(game_lines, line))
                    game_lines, complete_bytes = [], file.tell()
                elif ("game" in line) == bool(game_lines) or not ("game" in line or "call" in line):
                    raise ValueError("a line out of its place")
                else:
                    game_lines.append(line)
            except wrong as why:
                raise ArgumentError(
                    f"{path}, line {number}: no transcript of `stage agent`: {_format_reason(why)}."
                ) from None
    return Transcript(head, games, closing, complete_bytes)


def _format_reason(why: Exception) -> str:
    """Return the reason for which a line of a transcript cannot be parsed, in words."""
    text = str(why)[:200].rstrip(".")
    return text if isinstance(why, ValueError) else f"{type(why).__name__}: {text}"


def _parse_header(line: Any) -> RunHeader:
    """Parse the first line of a transcript. Raises ValueError, KeyError or TypeError."""
    if not isinstance(line, dict) or "format" not in line:
        raise ValueError("its first line says no format")
    if line["format"] != [FORMAT_NAME, FORMAT_VERSION]:
        raise ValueError(f"its format is {line['format']!r:.60}, and [{FORMAT_NAME!r}, {FORMAT_VERSION}] is read")
    games = tuple((_require_text(name), None if seed is None else _require_count(seed)) for name, seed in line["games"])
    limits = Limits(line["most"], line["patience"], line["time"])
    text = [_require_text(line[k]) for k in ("suite", "split", "round")]
    return RunHeader(
        text[0], text[1], text[2], games, _require_count(line["of"]), limits, _require_text(line["player"])
    )


def _parse_game(lines: list[dict[str, Any]], end: dict[str, Any]) -> GameResult:
    """Parse the lines of a game and its last line in a transcript. Raises ValueError, KeyError or TypeError."""
    first, *calls = lines
    for row in calls:
        _ = row["call"], row["arguments"], row["answer"]
        if not isinstance(row["ok"], bool):
            raise ValueError(f"{row['ok']!r:.60} is neither true nor false")
    trouble_counts = {_require_text(k): _require_count(n) for k, n in end["troubles"].items()}
    seed = None if first["seed"] is None else _require_count(first["seed"])
    return GameResult(
        _require_text(first["game"]),
        seed,
        calls,
        dict(end["score"]),
        _require_count(end["tokens"]),
        _require_text(end["ended"]),
        trouble_counts,
    )


def _require_text(value: Any) -> str:
    """Return a value that is a str. Raises ValueError for any other value."""
    if not isinstance(value, str) or len(value) > 2000:
        raise ValueError(f"{value!r:.60} is no text")
    return value


def _require_count(value: Any) -> int:
    """Return a value that is an int from 0 up. Raises ValueError for any other value."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < MAX_COUNT:
        raise ValueError(f"{value!r:.60} is no whole number")
    return value
