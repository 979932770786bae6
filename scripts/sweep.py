"""A study over register values: random search, a grid or a list, on local processes, threads, or a Ray cluster.

python scripts/sweep.py --trials 200 --out study                       random search over the default space
python scripts/sweep.py --trials 200 --out study --ray                 the same, bit for bit, on a local Ray
python scripts/sweep.py --trials 200 --out study --ray HOST:PORT       or on a cluster
python scripts/sweep.py --grid --space R2=400:2800/13 R4=60:800:log/9 R5=200 R1=20 R7=12 --out grid
python scripts/sweep.py --list trials.csv --out list                   a column a register, a row a trial
python scripts/sweep.py --report --out study                           the best trials, also while it runs

Stopped, by Ctrl-C or a power cut: the same command goes on and runs what lacks. Results lie in OUT/trials as Parquet files.
docs/sweep.md says more.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shlex
import signal
import sys
import time
from pathlib import Path

from stage.errors import ArgumentError, StageError
from stage.study import Definition, Processes, Ray, Study, Tally, Threads, read, read_definition, resolve, run
from stage.study.trials import OWN

OBJECTIVE = "stage.study.objectives:preset_moves"


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--out", required=True, type=Path, metavar="FOLDER", help="of the study; made, or gone on with")
    what = p.add_argument_group("the study")
    what.add_argument("--trials", type=int, default=0, help="of a random search; a study may grow")
    what.add_argument("--grid", action="store_true", help="every combination of the space's points")
    what.add_argument("--list", type=Path, metavar="FILE.csv", help="the trials of a file")
    what.add_argument(
        "--space", nargs="+", default=[], metavar="R2=400:2800",
        help="register=12 | 10,20,40 | low:high | low:high:log | low:high/points | low:high:log/points",
    )  # fmt: skip
    what.add_argument("--seed", type=int, default=0)
    what.add_argument("--objective", default=OBJECTIVE, metavar="MODULE:FUNCTION")
    what.add_argument(
        "--option", nargs="+", default=[], metavar="NAME=JSON",
        help="of the objective: model=xy_mast chips=pcl240ms pulses=[42100,-42100] rest=4 band=1e-4",
    )  # fmt: skip
    what.add_argument("--force", action="store_true", help="move another study in FOLDER aside and begin anew")
    how = p.add_argument_group("how it runs")
    how.add_argument("--workers", type=int, help="default: one a processor")
    how.add_argument("--threads", action="store_true", help="threads, not processes")
    how.add_argument("--ray", nargs="?", const="", metavar="ADDRESS", help="a local Ray, or the cluster at ADDRESS")
    report = p.add_argument_group("the report")
    report.add_argument("--report", action="store_true", help="print the best trials of FOLDER, run nothing")
    report.add_argument("--top", type=int, default=10)
    report.add_argument("--by", default="score", metavar="COLUMN", help="least first")
    return p


def definition(args: argparse.Namespace) -> Definition:
    options = {name: _json(text) for name, text in map(_pair, args.option)}
    if args.list:
        if args.grid or args.trials or args.space:
            raise ArgumentError("--list has its own trials: leave --grid, --trials and --space out.")
        return Definition(args.objective, "list", rows=rows(args.list), seed=args.seed, options=options)
    space = dict(map(_pair, args.space))
    if args.objective == OBJECTIVE and not args.grid:
        from stage.study.objectives import SPACE

        space = SPACE | space
    if args.grid:
        return Definition(args.objective, "grid", space, trials=args.trials, seed=args.seed, options=options)
    if args.trials < 1:
        raise ArgumentError("how many? --trials 200, or --grid, or --list FILE.csv.")
    return Definition(args.objective, "random", space, trials=args.trials, seed=args.seed, options=options)


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not name or not equals or not value:
        raise ArgumentError(f"{text!r}: give NAME=VALUE.")
    return name, value


def _json(text: str) -> object:
    try:
        return json.loads(text)
    except ValueError:
        return text


def rows(path: Path) -> list[dict[str, int]]:
    """The trials of a CSV file with a header. Raises ArgumentError."""
    try:
        with path.open(newline="") as file:
            return [{name.strip(): int(value) for name, value in row.items()} for row in csv.DictReader(file)]
    except (ValueError, TypeError, AttributeError):
        raise ArgumentError(f"{path}: a header of register names, and a whole number in every column.") from None
    except OSError as error:
        raise ArgumentError(f"{path} cannot be read: {error.strerror}.") from None


class Line:
    """Progress, in one line of a terminal; nothing where stderr is none."""

    def __init__(self):
        self.began = self.shown = time.monotonic()
        self.terminal = sys.stderr.isatty()

    def __call__(self, tally: Tally) -> None:
        now = time.monotonic()
        if not self.terminal or (now - self.shown < 0.1 and tally.left):
            return
        self.shown = now
        rate = (tally.done + tally.failed - tally.before) / max(now - self.began, 1e-9)
        line = f"{tally.done} of {tally.total} done, {tally.failed} failed, {tally.running} running"
        if rate:
            line += f", {rate:.1f}/s, {_clock(tally.left / rate)} left"
        if tally.best:
            line += f", best {tally.best[0]:.6g} (trial {tally.best[1]})"
        width = os.get_terminal_size(sys.stderr.fileno()).columns or 80
        print(f"\r{line[: width - 1]}\033[K", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self.terminal:
            print(file=sys.stderr)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


class Stop:
    """Ctrl-C or SIGTERM ends the study after what is written; a second one ends it at once."""

    def __enter__(self):
        self.asked = False
        self.before = {s: signal.signal(s, self._ask) for s in (signal.SIGINT, signal.SIGTERM)}
        return self

    def _ask(self, number, frame) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True

    def __call__(self) -> bool:
        return self.asked

    def __exit__(self, *exc) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)


def sweep(args: argparse.Namespace) -> int:
    wanted = definition(args)
    resolve(wanted.objective)
    line = Line()
    with Stop() as stop, Study.open(args.out, wanted, args.force) as study:
        if study.recorded and study.pending():
            print(f"{args.out}: {len(study.recorded)} of {wanted.trials} trials are there; going on", file=sys.stderr)
        if not study.pending():
            tally = Tally(wanted.trials, wanted.trials, study.done, study.failed, best=study.best)
        else:
            with executor(args) as where:
                try:
                    tally = run(study, where, stop=stop, progress=line)
                finally:
                    line.end()
    print(f"{tally.done} of {tally.total} trials done, {tally.failed} failed: {args.out / 'trials'}")
    if tally.best:
        print(f"best: trial {tally.best[1]}, score {tally.best[0]:.6g}")
    if tally.failed:
        failures([t for t in read(args.out).to_pylist() if t["status"] == "failed"])
    if tally.stopped and tally.left:
        print(f"stopped; {tally.left} trials lack. To go on: {shlex.join(['python', *sys.argv])}", file=sys.stderr)
        return 130
    return 0


def executor(args: argparse.Namespace) -> Processes | Threads | Ray:
    if args.ray is not None:
        if args.threads:
            raise ArgumentError("--ray or --threads, not both.")
        return Ray(args.objective, args.workers, args.ray or None)
    return (Threads if args.threads else Processes)(args.objective, args.workers)


def report(args: argparse.Namespace) -> int:
    """Print the best trials, and what failed."""
    study, table = read_definition(args.out), read(args.out)
    trials = table.to_pylist()
    done = [t for t in trials if t["status"] == "done"]
    failed = [t for t in trials if t["status"] == "failed"]
    print(f"{args.out}: {len(done)} of {study.trials} trials done, {len(failed)} failed")
    print(
        f"{study.objective}, {study.method}, seed {study.seed} {json.dumps(study.options) if study.options else ''}\n"
    )
    if done:
        if args.by not in table.column_names:
            raise ArgumentError(f"--by {args.by}: the columns are {', '.join(table.column_names)}.")
        values = [n for n in table.column_names if n not in (*OWN, *study.registers)]
        columns = ["id", *sorted(values, key=lambda n: n != args.by), *study.registers]
        ranked = sorted(
            (t for t in done if t[args.by] is not None and t[args.by] == t[args.by]), key=lambda t: t[args.by]
        )
        show(columns, [[t[c] for c in columns] for t in ranked[: args.top]])
    failures(failed)
    return 0


def failures(failed: list[dict]) -> None:
    """Print why trials failed, five reasons at most."""
    by_reason: dict[str, list[int]] = {}
    for trial in failed:
        by_reason.setdefault(trial["error"], []).append(trial["id"])
    for reason, ids in list(by_reason.items())[:5]:
        print(f"failed, {len(ids)}: {reason}\n  trial {', '.join(map(str, ids[:10]))}{' ...' if ids[10:] else ''}")


def show(columns: list[str], lines: list[list]) -> None:
    cells = [columns, *([f"{v:.6g}" if isinstance(v, float) else str(v) for v in line] for line in lines)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for row in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))


def main() -> int:
    args = parser().parse_args()
    sys.path.insert(0, os.getcwd())  # an objective may lie beside you; workers take the path over
    try:
        return report(args) if args.report else sweep(args)
    except (StageError, OSError) as error:
        print(f"sweep: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
