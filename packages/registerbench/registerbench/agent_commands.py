"""The commands agent and agent-replay: measure an agent, and replay what it did."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from stage.cli.commands import TIME, add_command, number, tell, wrote
from stage.errors import ArgumentError

if TYPE_CHECKING:
    from registerbench.arena import Played, Round

SHOWN = 6  # kinds of trouble


def add_agent(commands: Any) -> None:
    """Add `stage agent`."""
    p = add_command(
        commands, "agent", play_suite, "measure an agent: broken set-ups, or a task of the benchmark by tools",
        "Let a player play the games of a suite by calling tools, and print its score with an interval. A player is one that is "
        "shipped, a command that speaks JSON lines, a language model behind an OpenAI-compatible endpoint, or a client of the "
        "Model Context Protocol. Nothing is called that is not given.",
        ("stage agent diagnosis --by technician -o technician.jsonl", "the ten broken set-ups, with a transcript"),
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
    g.add_argument("--endpoint", metavar="URL", help="OpenAI-compatible, up to its version: https://host/v1")
    g.add_argument("--model", metavar="NAME", help="of the endpoint")
    g.add_argument("--key-env", metavar="VARIABLE", help="the variable of the environment that has the endpoint's key")
    g.add_argument("--mcp", action="store_true", help="the client at standard input and output; one game")
    g.add_argument("--name", help="of the player, in transcripts and entries")
    g = p.add_argument_group("games")
    g.add_argument("--split", default="train", help="of a task, see `stage bench` (default: train)")
    g.add_argument("--episodes", type=number, metavar="N", help="only the first N games")
    g = p.add_argument_group("limits")
    g.add_argument("--most", type=number, default=400, metavar="N", help="calls of a game, at most (default: 400)")
    g.add_argument(
        "--patience", type=TIME, default=600.0, metavar="S", help="seconds in which the next call comes (default: 600)"
    )
    g.add_argument(
        "--time", type=TIME, default=3600.0, metavar="S",
        help="seconds that the player may take in a game, without those of the simulation (default: 3600)",
    )  # fmt: skip
    g = p.add_argument_group("output")
    g.add_argument("-o", "--output", metavar="FILE.jsonl", help="write a transcript, each game when it ends")
    g.add_argument(
        "--resume", action="store_true", help="go on with the transcript that -o names, where a run broke off"
    )
    g.add_argument("--entry", metavar="FILE.bench", help="write an entry of RegisterBench, track tools")
    g.add_argument("--force", action="store_true", help="overwrite files that exist")


def add_agent_replay(commands: Any) -> None:
    """Add `stage agent-replay`."""
    p = add_command(
        commands, "agent-replay", replay_transcript, "make the calls of a transcript again, without the agent",
        "Make every call of a transcript again, compare answers and scores bit for bit, and print the score that comes of them. "
        "Exit code 0 if all are equal, 1 if not or if the transcript is cut, 2 if the file is refused.",
        ("stage agent-replay technician.jsonl", "what was played is what is said"),
    )  # fmt: skip
    p.add_argument("file", metavar="FILE.jsonl")


def play_suite(args: argparse.Namespace) -> int:
    """Play a suite with one player; print its score."""
    from registerbench import arena
    from registerbench.arena.loop import head_of, name_of
    from stage.support.files import ENTRY, TRANSCRIPT, ends_as, writable

    chosen = [name for name in ("by", "command", "endpoint") if getattr(args, name) is not None] + ["mcp"] * args.mcp
    if len(chosen) > 1:
        raise ArgumentError(f"--{' and --'.join(chosen)}: one player at a time.")
    player, limits = _player(args), arena.Limits(args.most, args.patience, args.time)
    games = arena.suite(args.suite, args.split, args.episodes)
    _check(args, len(games.games))
    for path, kind in ((args.output, TRANSCRIPT), (args.entry, ENTRY)):
        if path is not None:
            ends_as(path, *kind)
    if args.entry is not None:
        writable(args.entry, args.force, ask="give --force")
    name = args.name or (name_of(player) if args.mcp or args.command or args.endpoint else args.by or "formula")
    out = sys.stderr if args.mcp else sys.stdout
    with ExitStack() as stack:
        file = None
        if args.output is not None:
            file = stack.enter_context(arena.Writer(args.output, head_of(games, name, limits), args.force, args.resume))
        count = len(file.before) if file else 0

        def report_progress(r: Round) -> None:
            nonlocal count
            count += 1
            if file:
                file.game(r)
            if r.ended:
                print(f"stage: {r.game}: {r.ended}; its score until then counts", file=sys.stderr)
            if sys.stderr.isatty():
                print(f"\r{count} of {len(games.games)} games", end="", file=sys.stderr)

        try:
            came = arena.play(games, player, name, limits, report_progress, file.before if file else ())
        except arena.Interrupted as why:
            _print(args, why.played, out)
            kept = f"{args.output} has the games until then: --resume goes on."
            raise type(why)(f"{why} {kept if file else '-o FILE keeps what was played.'}", why.played) from why
        if file:
            file.end(came)
    _print(args, came, out)
    if args.output is not None and not args.mcp:
        wrote(args, args.output, "the transcript; `stage agent-replay` makes its calls again")
    if args.entry is not None and came.entry is not None:
        came.entry.write(args.entry, args.force)
        if not args.mcp:
            wrote(args, args.entry, "an entry of the bench; `stage bench-verify` replays it")
    _trouble(came)
    code = 0 if came.sound else 1
    if args.mcp and any(r.ended for r in came.rounds):
        sys.stderr.flush()
        os._exit(code)  # a thread that waits for standard input ends with the process alone
    return code


def _check(args: argparse.Namespace, count: int) -> None:
    if args.mcp and count != 1:
        raise ArgumentError(
            f"--mcp: one game for one client, and {args.suite} has {count}: give --episodes 1, or diagnosis:late."
        )
    if args.entry is not None and args.suite.startswith("diagnosis"):
        raise ArgumentError("--entry: entries are of RegisterBench's tasks; broken set-ups have transcripts, -o FILE.")
    if args.resume and args.output is None:
        raise ArgumentError("--resume goes on with a transcript: name it by -o FILE.jsonl.")


def _print(args: argparse.Namespace, came: Played, out: Any) -> None:
    """The games and the score; as facts, too."""
    if sys.stderr.isatty() and came.rounds:
        print(file=sys.stderr)
    for r in came.rounds:
        if came.head.kind == "diagnosis":
            found, mended = (
                {1.0: "found", -1.0: "wrong"}.get(r.score["found"], "-"),
                "mended" if r.score["mended"] else "-",
            )
            print(f"{r.game:22} {found:6} {mended:7} {len(r.calls)} calls", file=out)
    print(came, file=out)
    tell(
        args, suite=came.head.kind, split=came.head.split, player=came.player, value=came.value, low=came.low, high=came.high,
        games={r.game: r.score for r in came.rounds}, of=came.head.of, whole=came.whole, tokens=came.tokens, calls=came.calls,
        valid_calls=sum(r.valid for r in came.rounds), ended={r.game: r.ended for r in came.rounds if r.ended},
        troubles=dict(came.troubles),
    )  # fmt: skip


def _trouble(came: Played) -> None:
    """Print on standard error what went wrong and how often."""
    found = came.troubles
    for what, times in found.most_common(SHOWN):
        print(f"stage: {what}{f' ({times} times)' if times > 1 else ''}", file=sys.stderr)
    if len(found) > SHOWN:
        print(f"stage: and {len(found) - SHOWN} more kinds", file=sys.stderr)
    if not any(r.valid for r in came.rounds):
        refused = next((c for r in came.rounds for c in r.calls), None)
        why = f"; the first answer was: {str(refused['answer'].get('error'))[:200]}" if refused else "; none was made"
        print(f"stage: not one valid call in {len(came.rounds)} games{why}", file=sys.stderr)


def _player(args: argparse.Namespace) -> Any:
    from registerbench.arena.players import player

    if args.mcp:
        from registerbench.arena.players.client import Client
        from stage.support.extras import need

        need("mcp", "stage agent --mcp")
        return Client()
    if args.command is not None:
        from registerbench.arena.players.command import Command

        return Command(args.command)
    if args.endpoint is not None:
        from registerbench.arena.players.endpoint import Endpoint

        key = os.environ.get(args.key_env, "") if args.key_env else ""
        if args.key_env and not key:
            raise ArgumentError(f"--key-env {args.key_env}: there is no such variable in the environment.")
        return Endpoint(args.endpoint, args.model or "", key)
    return player("formula" if args.by is None else args.by)


def replay_transcript(args: argparse.Namespace) -> int:
    """Make the calls of a transcript again. 0: the same; 1: it differs, or is cut; 2: refused."""
    from registerbench import arena

    found = arena.replay(args.file)
    came = found.played
    print(found)
    tell(
        args, same=found.same, first=found.first, cut=found.cut, suite=came.head.kind, split=came.head.split,
        games=len(came.rounds), of=came.head.of, whole=came.whole, calls=came.calls, value=came.value, low=came.low, high=came.high,
        claimed={"player": came.player, "tokens": came.tokens},
    )  # fmt: skip
    return 0 if found.same else 1
