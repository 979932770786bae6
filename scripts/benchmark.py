"""Benchmark of speed as ratios measured in one run: the variants run alternately, and medians are compared with targets.

make bench        or: python scripts/benchmark.py [--quick] [--only closed_loop chips] [--json FILE] [--picture FILE]

The subjects are the files of scripts/bench, scripts/bench/targets.py has the targets, and docs/performance.md explains the results.
"""

from __future__ import annotations

import argparse
import time
from importlib import import_module
from pathlib import Path

from bench.figures import Curve, Run
from bench.report import Results, describe_machine, format_line, list_verdicts, write_markdown

SUBJECTS = (
    "closed_loop vector environment chips nova hctl1100 firmware scaling memory recording startup long_run".split()
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=SUBJECTS, metavar="SUBJECT", help=", ".join(SUBJECTS))
    parser.add_argument("--rounds", type=int, help="of each comparison; default 7, or 3 with --quick")
    parser.add_argument("--quick", action="store_true", help="about a minute: long runs are short, and say so")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure, with its values")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="renew the table in a page, between its markers")
    parser.add_argument("--earlier", type=Path, metavar="FILE",
                        help="begin with the JSON of an earlier run, and replace what is measured now")  # fmt: skip
    args = parser.parse_args()
    run = Run(args.rounds or (3 if args.quick else 7), args.quick)
    if run.rounds < 1:
        parser.error(f"--rounds {run.rounds}: one or more.")
    results = Results.load(args.earlier) if args.earlier else Results()
    print(f"{describe_machine(run)}\n  {'':58}{'median':>11} {'':6} {'least .. most':>22}")
    for name in SUBJECTS if args.only is None else args.only:
        measure(name, run, results)
        if args.json:
            results.save(args.json)
    print("\nTargets")
    print(*list_verdicts(results), sep="\n")
    if args.json:
        results.save(args.json)
    if args.markdown:
        write_markdown(results, args.markdown)
    if args.picture:
        from bench.picture import draw

        draw(results, args.picture)


def measure(name: str, run: Run, results: Results) -> None:
    """Measure one subject, and print its figures at once.

    Args:
        name: Name of the subject, a module of scripts/bench.
        run: Settings of the benchmark.
        results: Results to which the figures are added.
    """
    subject = import_module(f"bench.{name}")
    results.remove_subject(name)
    results.titles[name], results.machines[name] = subject.TITLE, describe_machine(run)
    print(f"\n{subject.TITLE}", flush=True)
    begin = time.perf_counter()
    for result in subject.measure(run):
        results.add(result)
        if not isinstance(result, Curve):
            print(format_line(result), flush=True)
    print(f"  [{time.perf_counter() - begin:.0f} s]", flush=True)


if __name__ == "__main__":
    main()
