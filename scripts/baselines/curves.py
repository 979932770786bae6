"""Learning curves of the benchmark's learners, from the CSV files that they write.

python scripts/baselines/curves.py --picture docs/pictures/learning.png docs/data/curves/few-shot*.csv
python scripts/baselines/curves.py --of success --picture docs/pictures/learning_bus.png docs/data/curves/bus*.csv

Each panel is a task, each colour a method, smoothed over SMOOTH batches. Ten runs of a method or more are drawn as their
interquartile mean with its interval, fewer one by one, with that interval where there are three: by the bootstrap over runs.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stage.bench.statistics import RUNS, interval, iqm
from stage.pictures import bare, title

SMOOTH = 5
BAND = 3  # runs, from which on there is an interval
COLORS = ("#17508f", "#d1571f", "#4f9d69", "#8a6bb8")


def read(path: Path, of: str) -> tuple[np.ndarray, np.ndarray]:
    """Steps, and the return (or another column) at each, smoothed: a mean over episodes."""
    with path.open() as file:
        rows = [r for r in csv.DictReader(file) if float(r["episodes"]) > 0]
    steps, n, values = (np.array([float(r[k]) for r in rows]) for k in ("steps", "episodes", of))
    ones = np.ones(min(SMOOTH, len(steps)))
    return steps, np.convolve(values * n, ones, "same") / np.convolve(n, ones, "same")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="TASK_METHOD-RUN.csv")
    parser.add_argument("--of", choices=("return", "success"), default="return")
    parser.add_argument("--picture", type=Path, required=True, metavar="FILE.png")
    args = parser.parse_args()
    found: dict[str, dict[str, list[Path]]] = {}
    for path in args.files:
        task, _, method = path.stem.partition("_")
        found.setdefault(task, {}).setdefault(method.rpartition("-")[0], []).append(path)
    figure = Figure(figsize=(5.6 * len(found), 3.8), layout="constrained")
    for ax, (task, methods) in zip(figure.subplots(1, len(found), squeeze=False)[0], found.items(), strict=True):
        for color, (method, paths) in zip(COLORS, methods.items(), strict=False):
            runs = [read(path, args.of) for path in paths]
            at = runs[0][0]
            every = np.array([np.interp(at, *run) for run in runs])
            if len(runs) >= BAND:
                ends = np.array([interval(column[:, None], draws=500) for column in every.T])
                ax.fill_between(at, *ends.T, color=color, alpha=0.15, lw=0)
            if len(runs) >= RUNS:
                ax.plot(at, [iqm(column) for column in every.T], color=color, lw=2, label=f"{method}, {len(runs)} runs")
                continue
            for k, run in enumerate(runs):
                ax.plot(
                    *run, color=color, lw=1.6, label=None if k else f"{method}, {len(runs)} run{'s'[: len(runs) > 1]}"
                )
        title(ax, task)
        ax.set(xlabel="steps of learning", ylabel=f"{args.of}, with exploration")
        bare(ax)
        ax.legend(frameon=False)
    args.picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.picture, dpi=120)
    print(f"{args.picture}: written")


if __name__ == "__main__":
    main()
