"""Entries of players that do not learn, for the benchmark's tables. Entries that exist are not played again.

python -m registerbench.baselines.bench_entries -o entries
python -m registerbench.baselines.bench_entries -o entries --tasks few-shot-wide --round 2026-11
python -m registerbench.baselines.bench_entries -o entries --tasks few-shot --splits train weak --players formula search tpe cma-es
stage bench-table entries/*.bench

The players tpe and cma-es are in few_shot_optuna.py (extra `rl`). Players that draw at random play `--runs` runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import registerbench
from registerbench.baselines import exit_on_interrupt
from registerbench.benchmark_tasks import CARDS, OPEN_ROUND
from registerbench.shipped_policies import TASK_PLAYERS

RANDOM_PLAYERS = ("random",)
OPTUNA = {"tpe": "TpePolicy", "cma-es": "CmaEsPolicy"}


def write_entry(policy: Any, task: str, split: str, folder: Path, method: str, run: int, **settings: Any) -> None:
    """Play the test episodes of a split, write the entry, and print its scores.

    Args:
        policy: Policy or player, as `registerbench.play` takes it.
        task: Name of a card.
        split: Split of the machines.
        folder: Folder of the file.
        method: Name of the method, a part of the file name.
        run: Number of the training run.
        **settings: Other arguments of `registerbench.play`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    entry = registerbench.play(policy, task, split, run=run, **settings)
    entry.write(folder / f"{task}-{split}-{method}-{run}.bench", overwrite=True)
    print(f"{task} {split} {entry.player} {run}: return {entry.scores['return'].mean():.3f}", flush=True)


def list_players(task: str) -> list[str]:
    """List the players that do not learn and can play a task."""
    shipped = list(TASK_PLAYERS.get(task, {})) or ["scripted"]
    return ["random", *shipped, *(OPTUNA if task == "few-shot" else ())]


def get_policy(player: str) -> Any:
    """Return the policy of a player, as `registerbench.play` takes it."""
    return f"registerbench.baselines.few_shot_optuna:{OPTUNA[player]}" if player in OPTUNA else player


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--tasks", nargs="+", choices=CARDS, default=list(CARDS))
    parser.add_argument("--splits", nargs="+", default=["train"])
    parser.add_argument("--players", nargs="+", help="of those that a task has (default: all)")
    parser.add_argument("--runs", type=int, default=1, help="of players that draw")
    parser.add_argument(
        "--round",
        default=OPEN_ROUND,
        metavar="WORD",
        help="whose test episodes (default: the open ones); a folder for each",
    )
    args = parser.parse_args()
    for task in args.tasks:
        for split in (s for s in args.splits if s in CARDS[task].splits):
            for player in (p for p in list_players(task) if p in (args.players or list_players(task))):
                for run in range(args.runs if player in RANDOM_PLAYERS else 1):
                    path = args.out / f"{task}-{split}-{player}-{run}.bench"
                    if path.exists():
                        continue
                    write_entry(get_policy(player), task, split, args.out, player, run, name=player, round_=args.round)


if __name__ == "__main__":
    with exit_on_interrupt("the entries written so far are saved, and the same command continues after them."):
        main()
