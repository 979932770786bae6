"""The commands `stage bench`, `stage bench-submit`, `stage bench-verify` and `stage bench-table`."""

from __future__ import annotations

import argparse
import sys
import textwrap
from typing import Any

from stage.cli.facts import tell
from stage.errors import ArgumentError


def cards(args: argparse.Namespace) -> int:
    """The tasks, or one of them."""
    from stage.bench import CARDS
    from stage.bench.cards import OPEN, TRACKS, card_of, seeds
    from stage.bench.shipped import OWN, PLAYERS

    chosen = [card_of(args.task)] if args.task else list(CARDS.values())
    if args.json:
        rows = {
            c.name: {
                "id": c.id, "asked": c.asked, "settings": dict(c.settings), "choices": {k: list(v) for k, v in c.choices.items()},
                "splits": {s: seeds(c, s) for s in c.splits},
                "machines": {s: c.machines(s) for s in c.splits}, "players": [*PLAYERS, *OWN.get(c.name, {})],
            }
            for c in chosen
        }  # fmt: skip
        tell(args, rows)
        return 0
    for c in chosen:
        print(f"{c.name}  {c.id}\n  {c.asked}")
        print(
            f"  splits: {', '.join(c.splits)}; {c.episodes} test episodes each, seeds from {seeds(c, c.splits[0], OPEN)[0]} on"
        )
        for name, values in c.choices.items():
            print(f"  a player may choose --set {name}=: {', '.join(map(str, values))}")
        print(f"  players: {', '.join([*PLAYERS, *OWN.get(c.name, {})])}")
    if args.task:
        print("machines of a split, where they differ from train:")
        for split in chosen[0].splits:
            print(
                textwrap.fill(chosen[0].machines(split), 118, initial_indent=f"  {split:6} ", subsequent_indent=9 * " ")
            )
        print("tracks:")
        for name, text in TRACKS.items():
            print(f"  {name:6} {text}")
    return 0


def submit(args: argparse.Namespace) -> int:
    """Play and pack."""
    from stage import bench
    from stage.bench.cards import card_of
    from stage.files import ENTRY, ends_as, writable

    card = card_of(args.task)
    ends_as(args.output, *ENTRY)
    writable(args.output, args.force, ask="give --force")
    progress = _Progress("played")
    entry = bench.play(
        args.policy, args.task, args.split, track=args.track, round_=args.round, settings=_settings(args.set, card.choices),
        name=args.name, run=args.run_number, notes=args.notes, cost=_cost(args.cost), episodes=args.episodes, told=progress,
    )  # fmt: skip
    progress.end()
    bench.submit(entry, args.output, args.force)
    tell(args, file=args.output, player=entry.player, mean=_means(entry))
    print(f"{entry.player}, {entry.task} {entry.split}: {len(entry.seeds)} episodes, {len(entry.rewards)} steps")
    print(", ".join(f"{name} {value:.4g}" for name, value in _means(entry).items() if value is not None) + " (means)")
    if len(entry.seeds) < card.episodes:
        print(f"part of the {card.episodes} test episodes alone: this entry can stand in no table")
    print(f"{args.output}: written")
    return 0


def verify(args: argparse.Namespace) -> int:
    """Replay. 0: it is what it says; 1: it differs; 2: refused."""
    from stage import bench

    progress = _Progress("replayed")
    verdict = bench.verify(args.file, args.tolerance, progress)
    progress.end()
    tell(args, verdict)
    print(verdict)
    return 0 if verdict.ok else 1


def table(args: argparse.Namespace) -> int:
    """Entries compared."""
    from stage.bench import read, statistics

    entries = [read(path) for path in args.files]
    if args.json:
        tell(args, statistics.rows(entries))
    print(statistics.table(entries, args.long))
    return 0


def _means(entry: Any) -> dict[str, float | None]:
    """Of each score over the episodes; None where one is infinite."""
    import numpy as np

    return {name: float(v.mean()) if np.isfinite(v).all() else None for name, v in entry.scores.items()}


def _settings(pairs: list[str], choices: Any) -> dict[str, Any]:
    """NAME=VALUE, where VALUE is one of those that the card has. Raises ArgumentError."""
    chosen = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals:
            raise ArgumentError(f"--set {pair}: NAME=VALUE, for example memory=last.")
        chosen[name] = next((v for v in choices.get(name, ()) if str(v) == text), text)
    return chosen


def _cost(pairs: list[str]) -> dict[str, float]:
    cost = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            cost[name] = float(text)
            if not (name and 0 <= cost[name] <= 1e15):
                raise ValueError
        except ValueError:
            raise ArgumentError(f"--cost {pair}: NAME=NUMBER, from 0 up, for example moves=20000.") from None
    return cost


class _Progress:
    """A line on a terminal that says how many episodes are done."""

    def __init__(self, what: str):
        self._what, self._on = what, sys.stderr.isatty()

    def __call__(self, done: int, of: int) -> None:
        if self._on:
            print(f"\r\033[K{self._what} {done} of {of} episodes ...", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self._on:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
