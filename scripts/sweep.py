"""Tune registers with Optuna: a study that several processes share, and that goes on after a kill.

python scripts/sweep.py --out study.log --trials 120                               TPE over the default space
python scripts/sweep.py --out study.log --trials 240 --workers 2                   goes on, with two processes
python scripts/sweep.py --out pareto.log --trials 120 --goals score vibration   several goals: their Pareto front
python scripts/sweep.py --out mast.log --trials 60 --pruner median --option model=xy_mast pulses=[42100,-42100] rest=4 band=1e-4
python scripts/sweep.py --out own.log --trials 60 --objective mine:Settle          an objective of your own
python scripts/sweep.py --out study.log                                            the best trials, also while it runs

Needs the extra `tune`. docs/sweep.md says more.
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from stage.errors import ArgumentError, StageError
from stage.study import SPACE, PresetMoves, count_finished, read_study, run
from stage.study.optuna_storage import optuna

SAMPLERS = {"tpe": "TPESampler", "random": "RandomSampler", "nsga2": "NSGAIISampler"}
PRUNERS = {"none": "NopPruner", "median": "MedianPruner", "hyperband": "HyperbandPruner"}
"""Names on the command line -> Optuna's."""


def make_parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--out", required=True, metavar="FILE|URL", help="where the study is kept: made, or gone on with")
    p.add_argument("--trials", type=int, metavar="N", help="run until so many are finished; without: print the best")
    p.add_argument("--workers", type=int, default=1, help="processes (1)")
    p.add_argument("--sampler", choices=SAMPLERS, default="tpe")
    p.add_argument("--pruner", choices=PRUNERS, default="none", help="ends bad trials of several moves early")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument(
        "--objective", metavar="MODULE:NAME", help="a function of an Optuna trial, or a class that makes one"
    )
    p.add_argument("--goals", nargs="+", metavar="NAME", help="score, duration, lost_steps, vibration")
    p.add_argument(
        "--space",
        nargs="+",
        type=parse_pair,
        default=[],
        metavar="R2=400:2800",
        help="12 | 10,20,40 | low:high | low:high:log",
    )
    p.add_argument("--option", nargs="+", type=parse_pair, default=[], metavar="NAME=JSON", help="of the objective")
    p.add_argument("--top", type=int, default=10, help="how many of the best to print (10)")
    return p


def parse_pair(text: str) -> tuple[str, str]:
    """Parse NAME=VALUE."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r}: give NAME=VALUE")
    return name, value


def parse_value(text: str) -> Any:
    """Parse a value as JSON, or return the text if it is not JSON."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def make_objective(args: argparse.Namespace) -> Any:
    """Make the objective with its options. Raises ArgumentError."""
    options = {name: parse_value(text) for name, text in args.option}
    if args.goals:
        options["goals"] = tuple(args.goals)
    if args.space:
        options["space"] = (SPACE if args.objective is None else {}) | dict(args.space)
    created = PresetMoves if args.objective is None else load_study(args.objective)
    if not isinstance(created, type):
        if options:
            raise ArgumentError(f"{args.objective} is a function: it takes no {', '.join(options)}.")
        return created
    try:
        return created(**options)
    except ArgumentError:
        raise
    except TypeError as error:
        raise ArgumentError(f"{error}. Options: {', '.join(created.__annotations__)}.") from None


def load_study(name: str) -> Any:
    module, _, attribute = name.partition(":")
    try:
        return getattr(import_module(module), attribute)
    except (ImportError, ValueError, AttributeError) as error:
        raise ArgumentError(f"--objective {name}: give MODULE:NAME that can be imported here ({error}).") from error


def print_results(study: Any, top: int) -> None:
    """Print the best trials, or the Pareto front, and why trials failed."""
    trials = study.get_trials(deepcopy=False)
    goals = len(study.directions)
    states = [t.state.name.lower() for t in trials]
    counted = ", ".join(f"{states.count(s)} {s}" for s in dict.fromkeys(states))
    print(
        f"{count_finished(study)} trials finished ({counted or 'none'}); {'the best' if goals == 1 else 'the Pareto front'}:"
    )
    front = [t for t in trials if t.state.name == "COMPLETE"] if goals == 1 else study.best_trials
    for t in sorted(front, key=lambda t: t.values)[:top]:
        values = " ".join(f"{v:12.6g}" for v in t.values)
        print(f"{t.number:6} {values}  {' '.join(f'{name}={value}' for name, value in t.params.items())}".rstrip())
    reasons: dict[str, list[int]] = {}
    for t in trials:
        if "error" in t.user_attrs:
            reasons.setdefault(t.user_attrs["error"], []).append(t.number)
    for reason, numbers in list(reasons.items())[:5]:
        print(f"failed, {len(numbers)}: {reason} (trial {', '.join(map(str, numbers[:5]))})")


def main() -> int:
    args = make_parser().parse_args()
    sys.path.insert(0, str(Path.cwd()))  # an objective may lie beside you; workers take the path over
    try:
        if args.trials is None:
            study = read_study(args.out)
        else:
            sampler, pruner = (
                getattr(optuna.samplers, SAMPLERS[args.sampler]),
                getattr(optuna.pruners, PRUNERS[args.pruner]),
            )
            how = {"sampler": sampler, "pruner": pruner(), "seed": args.seed}
            study = run(make_objective(args), args.out, args.trials, workers=args.workers, **how)
        print_results(study, args.top)
    except StageError as error:
        print(f"sweep: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("sweep: stopped; the same command goes on", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
