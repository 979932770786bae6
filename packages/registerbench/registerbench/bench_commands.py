"""The commands `stage bench`, `stage bench-submit`, `stage bench-verify` and `stage bench-table`."""

from __future__ import annotations

import argparse
import shlex
import sys
import textwrap
from typing import Any

from stage.cli.command_interface import add_command, add_facts
from stage.errors import ArgumentError

BENCHMARK_DOCS_HINT = "docs/benchmark.md says what is promised, and what is not."


def add_bench(commands: Any) -> None:
    """Add `stage bench`."""
    p = add_command(
        commands, "bench", print_tasks, "the tasks of the benchmark and their test episodes",
        "List the tasks of the benchmark, or show one: what is asked, splits, tracks, settings, players that are shipped.",
        ("stage bench", "all tasks"),
        ("stage bench few-shot --json", "one, with the seeds of all test episodes"),
    )  # fmt: skip
    p.add_argument("task", nargs="?", metavar="TASK", help="for example few-shot (default: list them all)")


def add_bench_submit(commands: Any) -> None:
    """Add `stage bench-submit`."""
    p = add_command(
        commands, "bench-submit", submit_entry, "play the test episodes of the benchmark, and pack them into a file",
        "Play the test episodes of a split with a policy and write its actions, rewards, scores and versions to a file, which "
        "anybody can replay.",
        ("stage bench-submit formula -o formula.bench", "a player that is shipped"),
        ("stage bench-submit mine:policy -o mine.bench --split weak", "`policy` of mine.py: (observation, info) -> action"),
        ('stage bench-submit moves.npz -o moves.bench --name "by hand"', "recorded actions"),
        more=BENCHMARK_DOCS_HINT,
    )  # fmt: skip
    p.add_argument(
        "policy", metavar="POLICY", help="module:name, actions.npz, or a player that is shipped: see `stage bench`"
    )
    p.add_argument("-o", "--output", metavar="FILE", required=True, help="of the entry")
    p.add_argument("--task", default="few-shot", help="see `stage bench` (default: few-shot)")
    p.add_argument("--split", default="train", help="where the machines of the episodes come from (default: train)")
    p.add_argument("--track", default="host", help="what the policy sees: host, truth or tools (default: host)")
    p.add_argument(
        "--round", default="open", metavar="NAME",
        help="whose seeds are played; drawn: a new word is drawn after the policy's file is read, and printed (default: open)",
    )  # fmt: skip
    p.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting that players may choose")
    p.add_argument("--name", help="of the player (default: POLICY)")
    p.add_argument(
        "--run", dest="run_number", type=int, default=0, metavar="N", help="number of the training run (default: 0)"
    )
    p.add_argument("--notes", default="", help="a line that goes with it")
    p.add_argument(
        "--training",
        default="",
        metavar="COMMAND",
        help="trains run {run} and writes its entry to {out}; checked by bench-table",
    )
    p.add_argument(
        "--cost", action="append", default=[], metavar="NAME=NUMBER", help="what it took: moves=, processor_s=, tokens="
    )
    p.add_argument(
        "--sandbox", default="", metavar="COMMAND",
        help="starts the process of module:name, which otherwise can read the word of the round in the list of processes; for "
        "example 'unshare --user --pid --fork --mount-proc'",
    )  # fmt: skip
    p.add_argument("--episodes", type=int, metavar="N", help="only the first N, for a trial")
    p.add_argument("--force", action="store_true", help="overwrite a file that exists")


def add_bench_verify(commands: Any) -> None:
    """Add `stage bench-verify`."""
    p = add_command(
        commands, "bench-verify", verify_entry, "replay an entry of the benchmark and compare it bit for bit",
        "Play the actions of an entry again, without the policy, and compare every reward, observation and score. Exit code 0 if "
        "they are equal, 1 if not, 2 if the file is refused.",
        ("stage bench-verify mine.bench", "plays the actions again and compares bit for bit"),
        ("stage bench-verify mine.bench --tolerance 1e-9", "made on another processor"),
        more=BENCHMARK_DOCS_HINT,
    )  # fmt: skip
    p.add_argument(
        "file", metavar="FILE", help="an entry, as `stage bench-submit -o FILE` writes it, or ARCHIVE.zip/NAME"
    )
    p.add_argument(
        "--tolerance", type=float, metavar="T", help="rewards and scores may differ by so much, as on another processor"
    )


def add_bench_table(commands: Any) -> None:
    """Add `stage bench-table`."""
    p = add_command(
        commands, "bench-table", print_tables, "compare entries of the benchmark, as tables in Markdown",
        "Print a table for each task, split, track and round: interquartile mean (IQM) and mean of the return with intervals, "
        "and who beats whom on the same machines. Entries of one player are its runs, and have all test episodes. Each entry is "
        "replayed; what is not confirmed stands below the rest and beats nobody. Runs that do the same count once.",
        ("stage bench-table formula.bench mine.bench", "who beats whom"),
        ("stage bench-table *.bench --long", "regret, damage and steps, too"),
        ("stage bench-table *.bench --spot-check 2", "train two runs of each learner again, by the commands in the entries"),
    )  # fmt: skip
    p.add_argument("files", nargs="+", metavar="FILE", help="an entry, or a zip archive of entries")
    p.add_argument("--long", action="store_true", help="with regret, steps lost, end limits and steps of the episodes")
    p.add_argument("--no-replay", action="store_true", help="replay nothing: every row is marked so")
    p.add_argument(
        "--spot-check", type=int, default=0, metavar="N",
        help="RUN the training commands of N runs of each learner, drawn at random, and compare actions; they are programs of the "
        "entries' authors (default: 0)",
    )  # fmt: skip
    p.add_argument(
        "--new-round",
        action="store_true",
        help="run these commands once more, on a round whose word is drawn now: stored actions do not fit it",
    )


def print_tasks(args: argparse.Namespace) -> int:
    """Print all tasks, or one task with its splits and tracks; with --json as JSON.

    Returns:
        Exit code 0.
    """
    from registerbench import CARDS
    from registerbench.benchmark_tasks import FIRST_TEST_SEED, TRACKS, find_card, list_test_seeds
    from registerbench.shipped_policies import COMMON_PLAYERS, TASK_PLAYERS

    selected = [find_card(args.task)] if args.task else list(CARDS.values())
    if args.json:
        rows = {
            c.name: {
                "id": c.id, "asked": c.asked, "settings": dict(c.settings), "choices": {k: list(v) for k, v in c.choices.items()},
                "splits": {s: list_test_seeds(c, s) for s in c.splits},
                "machines": {s: c.describe_machines(s) for s in c.splits},
                "players": [*COMMON_PLAYERS, *TASK_PLAYERS.get(c.name, {})],
            }
            for c in selected
        }  # fmt: skip
        add_facts(args, rows)
        return 0
    for c in selected:
        print(f"{c.name}  {c.id}\n  {c.asked}")
        print(f"  splits: {', '.join(c.splits)}; {c.episodes} test episodes each, seeds from {FIRST_TEST_SEED} on")
        for name, values in c.choices.items():
            print(f"  a player may choose --set {name}=: {', '.join(map(str, values))}")
        print(f"  players: {', '.join([*COMMON_PLAYERS, *TASK_PLAYERS.get(c.name, {})])}")
    if args.task:
        print("machines of a split, where they differ from train:")
        for split in selected[0].splits:
            print(
                textwrap.fill(
                    selected[0].describe_machines(split), 118, initial_indent=f"  {split:6} ", subsequent_indent=9 * " "
                )
            )
        print("tracks:")
        for name, text in TRACKS.items():
            print(f"  {name:6} {text}")
    return 0


def submit_entry(args: argparse.Namespace) -> int:
    """Play the test episodes of a task, and write the entry that holds them.

    Returns:
        Exit code 0.
    """
    import registerbench
    from registerbench.benchmark_tasks import DRAWN_ROUND, draw_round, find_card
    from stage.support.files import ENTRY, check_ending, check_writable

    card = find_card(args.task)
    check_ending(args.output, *ENTRY)
    check_writable(args.output, args.force, overwrite_hint="give --force")
    progress = _EpisodeCounter("played")
    round_ = draw_round(args.policy) if args.round == DRAWN_ROUND else args.round
    if round_ != args.round:
        print(f"round {round_}: others play it with --round {round_}")
    entry = registerbench.play(
        args.policy, args.task, args.split, track=args.track, round_=round_, settings=_parse_settings(args.set, card.choices),
        name=args.name, run=args.run_number, notes=args.notes, cost=_parse_costs(args.cost), training=args.training,
        sandbox=shlex.split(args.sandbox), episodes=args.episodes,
        report_progress=progress,
    )  # fmt: skip
    progress.erase_line()
    entry.write(args.output, args.force)
    add_facts(args, file=args.output, player=entry.player, mean=_compute_mean_scores(entry))
    print(f"{entry.player}, {entry.task} {entry.split}: {len(entry.seeds)} episodes, {len(entry.rewards)} steps")
    print(
        ", ".join(f"{name} {value:.4g}" for name, value in _compute_mean_scores(entry).items() if value is not None)
        + " (means)"
    )
    if len(entry.seeds) < card.episodes:
        print(f"part of the {card.episodes} test episodes alone: this entry can stand in no table")
    print(f"{args.output}: written")
    return 0


def verify_entry(args: argparse.Namespace) -> int:
    """Replay an entry, and print the verdict.

    Returns:
        Exit code: 0 if the replay confirms the entry, 1 if it differs. A refused entry raises an error, which gives 2.
    """
    import registerbench

    progress = _EpisodeCounter("replayed")
    verdict = registerbench.verify(args.file, args.tolerance, progress)
    progress.erase_line()
    add_facts(args, verdict)
    print(verdict)
    return 0 if verdict.is_confirmed else 1


def print_tables(args: argparse.Namespace) -> int:
    """Print the tables of entries, or their rows as JSON with --json."""
    from registerbench import entry_checks, read_entries, score_statistics

    entries = [entry for path in args.files for entry in read_entries(path).values()]
    is_shown = sys.stderr.isatty() or args.spot_check > 0
    report = (lambda text: print(f"stage: {text}", file=sys.stderr)) if is_shown else (lambda text: None)
    if args.new_round and not args.spot_check:
        raise ArgumentError("--new-round runs the commands of --spot-check: give --spot-check N, too.")
    checks = entry_checks.check_entries(entries, not args.no_replay, args.spot_check, report, args.new_round)
    rows = score_statistics.compute_rows(entries, checks)
    add_facts(args, [row.json() for row in rows])
    print(score_statistics.format_rows(rows, args.long))
    return 0


def _compute_mean_scores(entry: Any) -> dict[str, float | None]:
    """Return the mean of each score over the episodes; None where one is infinite."""
    import numpy as np

    return {name: float(v.mean()) if np.isfinite(v).all() else None for name, v in entry.scores.items()}


def _parse_settings(pairs: list[str], choices: Any) -> dict[str, Any]:
    """Parse settings NAME=VALUE, where VALUE is one of the values that the card allows for NAME.

    Args:
        pairs: Settings as the user wrote them.
        choices: Allowed values by name.

    Raises:
        ArgumentError: A setting has no "=".
    """
    selected = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals:
            raise ArgumentError(f"--set {pair}: NAME=VALUE, for example memory=last.")
        selected[name] = next((v for v in choices.get(name, ()) if str(v) == text), text)
    return selected


def _parse_costs(pairs: list[str]) -> dict[str, float]:
    """Parse costs NAME=NUMBER. Raises ArgumentError for anything but a number from 0 up."""
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


class _EpisodeCounter:
    """Callback that shows on a terminal how many episodes are finished.

    Args:
        what: What happens to the episodes, such as "played".
    """

    def __init__(self, what: str):
        self._what, self._on = what, sys.stderr.isatty()

    def __call__(self, done: int, of: int) -> None:
        if self._on:
            print(f"\r\033[K{self._what} {done} of {of} episodes ...", end="", file=sys.stderr, flush=True)

    def erase_line(self) -> None:
        """Erase the line."""
        if self._on:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
