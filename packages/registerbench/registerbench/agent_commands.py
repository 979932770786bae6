"""The commands `stage agent` and `stage agent-replay`, which measure an agent and repeat its calls."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from stage.cli.command_interface import TIME, add_command, add_facts, parse_integer, report_written_file
from stage.errors import ArgumentError

if TYPE_CHECKING:
    from registerbench.arena import GameResult, SuiteResult, TranscriptWriter

MAX_PRINTED_TROUBLES = 6


def add_agent(commands: Any) -> None:
    """Add `stage agent` to argparse's subparsers."""
    p = add_command(
        commands, "agent", play_suite, "measure an agent: broken set-ups, or a task of the benchmark by tools",
        "Let a player play the games of a suite by calling tools, and print its score with an interval. A player is one that is "
        "shipped, a command that speaks JSON lines, a language model behind an OpenAI-compatible endpoint, or a client of the "
        "Model Context Protocol. Nothing is called that is not given.",
        ("stage agent diagnosis --by technician -o technician.jsonl", "broken set-ups, with a transcript"),
        ("stage agent few-shot --by coordinate --episodes 8", "test episodes of RegisterBench"),
        ("stage agent diagnosis:late --command 'python agent.py'", "a player of your own, in any language"),
        ("stage agent diagnosis --endpoint http://127.0.0.1:8000/v1 --model m", "a language model"),
        more="docs/agents.md says how a player is written, and what the scores are. Exit code 0 if all games were played, "
        "1 if one took too long, if its player failed, or if no call of all was valid, 2 if the player cannot play.",
    )  # fmt: skip
    p.add_argument(
        "suite", metavar="SUITE", help="diagnosis, one set-up of it (diagnosis:late), or a task of `stage bench`"
    )
    g = p.add_argument_group("player")
    g.add_argument(
        "--by",
        metavar="PLAYER",
        help="formula, random, coordinate, optuna, trained, technician; or module:function of yours (default: formula)",
    )
    g.add_argument("--command", metavar="COMMAND", help="a program that reads and writes lines of JSON")
    g.add_argument("--endpoint", metavar="URL", help="OpenAI-compatible endpoint, up to its version: https://host/v1")
    g.add_argument("--model", metavar="NAME", help="name of the model at the endpoint")
    g.add_argument(
        "--key-env", metavar="VARIABLE", help="name of the environment variable that holds the key of the endpoint"
    )
    g.add_argument("--mcp", action="store_true", help="the MCP client at standard input and output plays one game")
    g.add_argument("--name", help="name of the player in transcripts and entries")
    g = p.add_argument_group("games")
    g.add_argument("--split", default="train", help="split of a task, see `stage bench` (default: train)")
    g.add_argument("--round", default="open", metavar="NAME", help="whose seeds are played (default: open)")
    g.add_argument("--episodes", type=parse_integer, metavar="N", help="play only the first N games")
    g = p.add_argument_group("limits")
    g.add_argument(
        "--most", type=parse_integer, default=400, metavar="N", help="largest number of calls in a game (default: 400)"
    )
    g.add_argument(
        "--patience",
        type=TIME,
        default=600.0,
        metavar="S",
        help="seconds within which the next call must come (default: 600)",
    )
    g.add_argument(
        "--time", type=TIME, default=3600.0, metavar="S",
        help="seconds that the player may take in a game, without the time of the simulation (default: 3600)",
    )  # fmt: skip
    g = p.add_argument_group("output")
    g.add_argument("-o", "--output", metavar="FILE.jsonl", help="write a transcript, each game when it ends")
    g.add_argument(
        "--resume", action="store_true", help="continue the transcript that -o names after an interrupted run"
    )
    g.add_argument("--entry", metavar="FILE.bench", help="write an entry of RegisterBench, track tools")
    g.add_argument("--force", action="store_true", help="overwrite existing files")


def add_agent_replay(commands: Any) -> None:
    """Add `stage agent-replay` to argparse's subparsers."""
    p = add_command(
        commands, "agent-replay", replay_transcript, "make the calls of a transcript again, without the agent",
        "Make every call of a transcript again, compare answers and scores bit for bit, and print the score that comes of them. "
        "Exit code 0 if all are equal, 1 if not or if the transcript is cut, 2 if the file is refused.",
        ("stage agent-replay technician.jsonl", "what was played is what is said"),
    )  # fmt: skip
    p.add_argument("file", metavar="FILE.jsonl")


def play_suite(args: argparse.Namespace) -> int:
    """Play a suite with one player, and print its score.

    Returns:
        Exit code: 0 if all games were played, 1 if a game was ended for its player or no call was valid.
    """
    from registerbench import arena
    from registerbench.arena.suite_runner import get_player_name, make_header
    from stage.support.files import ENTRY, TRANSCRIPT, check_ending, check_writable

    player, limits = _make_player(args), arena.Limits(args.most, args.patience, args.time)
    suite = arena.make_suite(args.suite, args.split, args.episodes, args.round)
    _check_options(args, len(suite.games))
    for path, kind in ((args.output, TRANSCRIPT), (args.entry, ENTRY)):
        if path is not None:
            check_ending(path, *kind)
    if args.entry is not None:
        check_writable(args.entry, args.force, overwrite_hint="give --force")
    name = args.name or (get_player_name(player) if args.mcp or args.command or args.endpoint else args.by or "formula")
    out = sys.stderr if args.mcp else sys.stdout
    with ExitStack() as stack:
        writer = None
        if args.output is not None:
            header = make_header(suite, name, limits)
            writer = stack.enter_context(arena.TranscriptWriter(args.output, header, args.force, args.resume))
        earlier_games = writer.earlier_games if writer else ()
        progress = _GameReporter(writer, len(earlier_games), len(suite.games))
        try:
            result = arena.play_games(suite, player, name, limits, progress, earlier_games)
        except arena.RunInterrupted as why:
            _print_result(args, why.result, out)
            saved = f"{args.output} has the games until then: --resume goes on."
            raise type(why)(f"{why} {saved if writer else '-o FILE keeps what was played.'}", why.result) from why
        if writer:
            writer.write_summary(result)
    _print_result(args, result, out)
    _write_files(args, result)
    _print_troubles(result)
    code = 0 if result.is_valid else 1
    if args.mcp and any(r.end_reason for r in result.games):
        sys.stderr.flush()
        os._exit(code)  # a thread that waits for standard input ends with the process alone
    return code


class _GameReporter:
    """Callback that writes each finished game to the transcript, and counts the games in a line on a terminal.

    Args:
        writer: Writer of the transcript, or None.
        count: Number of games that are already finished.
        total: Number of games of the suite.
    """

    def __init__(self, writer: TranscriptWriter | None, count: int, total: int):
        self._writer, self._count, self._total = writer, count, total

    def __call__(self, game: GameResult) -> None:
        self._count += 1
        if self._writer:
            self._writer.write_game(game)
        if game.end_reason:
            print(f"stage: {game.game}: {game.end_reason}; its score until then counts", file=sys.stderr)
        if sys.stderr.isatty():
            print(f"\r{self._count} of {self._total} games", end="", file=sys.stderr)


def _check_options(args: argparse.Namespace, count: int) -> None:
    """Raise ArgumentError for options that do not go together.

    Args:
        args: Options of the command line.
        count: Number of games.
    """
    if args.mcp and count != 1:
        raise ArgumentError(
            f"--mcp: one game for one client, and {args.suite} has {count}: give --episodes 1, or diagnosis:late."
        )
    if args.entry is not None and args.suite.startswith("diagnosis"):
        raise ArgumentError("--entry: entries are of RegisterBench's tasks; broken set-ups have transcripts, -o FILE.")
    if args.resume and args.output is None:
        raise ArgumentError("--resume goes on with a transcript: name it by -o FILE.jsonl.")


def _write_files(args: argparse.Namespace, result: SuiteResult) -> None:
    """Write the entry, and print which files were written; MCP uses standard output itself."""
    if args.output is not None and not args.mcp:
        report_written_file(args, args.output, "the transcript; `stage agent-replay` makes its calls again")
    if args.entry is not None and result.entry is not None:
        result.entry.write(args.entry, args.force)
        if not args.mcp:
            report_written_file(args, args.entry, "an entry of the bench; `stage bench-verify` replays it")


def _print_result(args: argparse.Namespace, result: SuiteResult, out: Any) -> None:
    """Print the games and the score, and state them as JSON if --json is given."""
    if sys.stderr.isatty() and result.games:
        print(file=sys.stderr)
    for r in result.games:
        if result.head.kind == "diagnosis":
            found = r.score["found"]
            finding = "found" if found == 1 else "partly" if found > 0 else "wrong" if found < 0 else "-"
            repair = "mended" if r.score["mended"] else "-"
            print(f"{r.game:22} {finding:6} {repair:7} {len(r.calls)} calls", file=out)
    print(result, file=out)
    add_facts(
        args, suite=result.head.kind, split=result.head.split, player=result.player, value=result.value, low=result.low,
        high=result.high, games={r.game: r.score for r in result.games}, of=result.head.of, whole=result.is_complete,
        tokens=result.tokens, calls=result.calls, valid_calls=sum(r.valid_calls for r in result.games),
        ended={r.game: r.end_reason for r in result.games if r.end_reason}, troubles=dict(result.trouble_counts),
    )  # fmt: skip


def _print_troubles(result: SuiteResult) -> None:
    """Print on standard error which troubles occurred in the games, and how often."""
    counts = result.trouble_counts
    for what, times in counts.most_common(MAX_PRINTED_TROUBLES):
        print(f"stage: {what}{f' ({times} times)' if times > 1 else ''}", file=sys.stderr)
    if len(counts) > MAX_PRINTED_TROUBLES:
        print(f"stage: and {len(counts) - MAX_PRINTED_TROUBLES} more kinds", file=sys.stderr)
    if not any(r.valid_calls for r in result.games):
        refused = next((c for r in result.games for c in r.calls), None)
        why = f"; the first answer was: {str(refused['answer'].get('error'))[:200]}" if refused else "; none was made"
        print(f"stage: not one valid call in {len(result.games)} games{why}", file=sys.stderr)


def _make_player(args: argparse.Namespace) -> Any:
    """Make the player that the options select. Raises ArgumentError if they select several."""
    from registerbench.arena.players import make_game_player

    named = [name for name in ("by", "command", "endpoint") if getattr(args, name) is not None] + ["mcp"] * args.mcp
    if len(named) > 1:
        raise ArgumentError(f"--{' and --'.join(named)}: one player at a time.")
    if args.mcp:
        from registerbench.arena.players.mcp_client import McpClientPlayer
        from stage.support.extras import import_extra

        import_extra("mcp", "stage agent --mcp")
        return McpClientPlayer()
    if args.command is not None:
        from registerbench.arena.players.external_command import CommandPlayer

        return CommandPlayer(args.command)
    if args.endpoint is not None:
        from registerbench.arena.players.model_endpoint import EndpointPlayer

        key = os.environ.get(args.key_env, "") if args.key_env else ""
        if args.key_env and not key:
            raise ArgumentError(f"--key-env {args.key_env}: there is no such variable in the environment.")
        return EndpointPlayer(args.endpoint, args.model or "", key)
    return make_game_player("formula" if args.by is None else args.by)


def replay_transcript(args: argparse.Namespace) -> int:
    """Repeat the calls of a transcript, and print the result.

    Returns:
        Exit code: 0 if every answer and score is the same, 1 if one differs or the transcript is incomplete.
    """
    from registerbench import arena

    replay = arena.replay(args.file)
    result = replay.result
    print(replay)
    add_facts(
        args, same=replay.is_same, first=replay.first_difference, cut=replay.missing_part, suite=result.head.kind,
        split=result.head.split, games=len(result.games), of=result.head.of, whole=result.is_complete, calls=result.calls,
        value=result.value, low=result.low, high=result.high, claimed={"player": result.player, "tokens": result.tokens},
    )  # fmt: skip
    return 0 if replay.is_same else 1
