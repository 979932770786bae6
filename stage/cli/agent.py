"""The commands agent and agent-replay: measure an agent, and replay what it did."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from stage.cli.facts import tell, wrote
from stage.errors import ArgumentError

if TYPE_CHECKING:
    from stage.agents.arena import Played, Round

SHOWN = 6  # kinds of trouble


def run(args: argparse.Namespace) -> int:
    """Play a suite with one player; print its score."""
    from stage.agents import arena
    from stage.agents.arena.loop import head_of, name_of
    from stage.files import ENTRY, TRANSCRIPT, ends_as, writable

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

        def told(r: Round) -> None:
            nonlocal count
            count += 1
            if file:
                file.game(r)
            if r.ended:
                print(f"stage: {r.game}: {r.ended}; its score until then counts", file=sys.stderr)
            if sys.stderr.isatty():
                print(f"\r{count} of {len(games.games)} games", end="", file=sys.stderr)

        try:
            came = arena.play(games, player, name, limits, told, file.before if file else ())
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
    """What went wrong, how often, on standard error."""
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
    from stage.agents.arena.players import player

    if args.mcp:
        from stage.agents.arena.players.client import Client
        from stage.extras import need

        need("mcp", "stage agent --mcp")
        return Client()
    if args.command is not None:
        from stage.agents.arena.players.command import Command

        return Command(args.command)
    if args.endpoint is not None:
        from stage.agents.arena.players.endpoint import Endpoint

        key = os.environ.get(args.key_env, "") if args.key_env else ""
        if args.key_env and not key:
            raise ArgumentError(f"--key-env {args.key_env}: there is no such variable in the environment.")
        return Endpoint(args.endpoint, args.model or "", key)
    return player("formula" if args.by is None else args.by)


def replay(args: argparse.Namespace) -> int:
    """Make the calls of a transcript again. 0: the same; 1: it differs, or is cut; 2: refused."""
    from stage.agents import arena

    found = arena.replay(args.file)
    came = found.played
    print(found)
    tell(
        args, same=found.same, first=found.first, cut=found.cut, suite=came.head.kind, split=came.head.split,
        games=len(came.rounds), of=came.head.of, whole=came.whole, calls=came.calls, value=came.value, low=came.low, high=came.high,
        claimed={"player": came.player, "tokens": came.tokens},
    )  # fmt: skip
    return 0 if found.same else 1
