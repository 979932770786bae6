"""The commands agent and agent-replay: measure an agent, and replay what it did."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any

from stage.cli.facts import tell, wrote
from stage.errors import ArgumentError


def run(args: argparse.Namespace) -> int:
    """Play a suite with one player; print its score."""
    from stage.agents import arena
    from stage.files import ENTRY, TRANSCRIPT, ends_as, writable

    chosen = [name for name in ("by", "command", "endpoint", "mcp") if getattr(args, name)]
    if len(chosen) > 1:
        raise ArgumentError(f"--{' and --'.join(chosen)}: one player at a time.")
    player = _player(args)
    for path, kind in ((args.output, TRANSCRIPT), (args.entry, ENTRY)):
        if path is not None:
            ends_as(path, *kind)
            writable(path, args.force, ask="give --force")
    games = arena.suite(args.suite, args.split, args.episodes)
    if args.mcp and games.count != 1:
        raise ArgumentError(
            f"--mcp: one game for one client, and {args.suite} has {games.count}: give --episodes 1, or diagnosis:late."
        )
    if args.entry is not None and args.suite.startswith("diagnosis"):
        raise ArgumentError("--entry: entries are of RegisterBench's tasks; broken set-ups have transcripts, -o FILE.")
    done = []

    def told(r: Any) -> None:
        done.append(r)
        if sys.stderr.isatty():
            print(
                f"\r{len(done)} of {games.count} games", end="\n" if len(done) == games.count else "", file=sys.stderr
            )

    name = args.name or ("" if args.mcp or args.command or args.endpoint else args.by or "formula")
    played = arena.play(games, player, name, args.most, told)
    out = sys.stderr if args.mcp else sys.stdout
    for r in played.rounds:
        if args.suite.startswith("diagnosis"):
            found, mended = ("found" if r.score["found"] else "-"), ("mended" if r.score["mended"] else "-")
            print(f"{r.game:22} {found:6} {mended:7} {len(r.calls)} calls", file=out)
    print(played, file=out)
    tell(
        args, suite=played.suite, split=played.split, player=played.player, value=played.value, low=played.low, high=played.high,
        games={r.game: r.score for r in played.rounds}, tokens=played.tokens, calls=sum(len(r.calls) for r in played.rounds),
    )  # fmt: skip
    if args.output is not None:
        arena.save(played, args.output, args.force)
        wrote(args, args.output, "the transcript; `stage agent-replay` makes its calls again") if not args.mcp else None
    if args.entry is not None and played.entry is not None:
        played.entry.write(args.entry, args.force)
        wrote(args, args.entry, "an entry of the bench; `stage bench-verify` replays it") if not args.mcp else None
    return 0


def _player(args: argparse.Namespace) -> Any:
    from stage.agents.arena.players import player

    if args.mcp:
        from stage.agents.arena.players.client import Client
        from stage.extras import need

        need("mcp", "stage agent --mcp")
        return Client()
    if args.command:
        from stage.agents.arena.players.command import Command

        return Command(args.command)
    if args.endpoint:
        from stage.agents.arena.players.endpoint import Endpoint

        key = os.environ.get(args.key_env, "") if args.key_env else ""
        if args.key_env and not key:
            raise ArgumentError(f"--key-env {args.key_env}: there is no such variable in the environment.")
        return Endpoint(args.endpoint, args.model or "", key)
    return player(args.by or "formula")


def replay(args: argparse.Namespace) -> int:
    """Make the calls of a transcript again. 0: the same; 1: it differs; 2: refused."""
    from stage.agents import arena

    found = arena.replay(args.file)
    print(found)
    tell(args, same=found.same, games=found.games, calls=found.calls, first=found.first)
    return 0 if found.same else 1
