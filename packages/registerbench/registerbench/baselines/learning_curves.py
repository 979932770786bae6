"""Learning curves of every task of the benchmark: runs the learners from scratch, packs their raw data, and draws one picture.

python -m registerbench.baselines.learning_curves learn -o runs                  some hours of a processor; skips finished runs
python -m registerbench.baselines.learning_curves learn -o quick --quick         one run and generation of each task, some minutes
python -m registerbench.baselines.learning_curves draw                           picture and table of the published runs
python -m registerbench.baselines.learning_curves draw --runs runs               packs and draws your own runs

one-shot, few-shot, few-shot-wide, home, line   CMA-ES on a policy of few numbers, parametric_policy_learners.py. A point is
          the interquartile mean of the returns of 32 test episodes with CMA-ES's mean, with its interval by the bootstrap over
          whole runs and episodes. Nothing is chosen by these episodes
bus       DQN with masks, bus_macros_learners.py. A point is the share of 64 machines of the split train, on which it does not
          learn, that the policy solves. It is 0 before a run has reached a level, and constant after the level has ended. The
          interval is by the bootstrap over runs
Horizontal lines are players that do not learn, on the same test episodes (data/entries). Needs the extras `rl` and `plot`.
"""

from __future__ import annotations

import argparse
import csv
import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import registerbench
from registerbench.baselines import exit_on_interrupt
from registerbench.benchmark_tasks import OPEN_ROUND
from registerbench.score_statistics import compute_interval, compute_iqm
from stage.support import plot_style

DOCS = Path(__file__).parents[2] / "docs"
DATA, PICTURE = DOCS / "data" / "learning_curves.csv.gz", DOCS / "pictures" / "learning_curves.png"
EPISODES = 32  # test episodes of a point
COLUMNS = ("task", "player", "run", "steps", "processor_s", "episode", "return", "success")
RUNS = {"one-shot": 5, "few-shot": 5, "few-shot-wide": 10, "home": 5, "line": 5}
BUS_MACROS_SEEDS = {"origin": range(5)}
"""Seeds by the last level of the curriculum."""
PANELS = {
    "one-shot": "T1 OneShotTuning", "few-shot": "T2 FewShotTuning, the best try counts",
    "few-shot-wide": "T2 FewShotTuning, wide, the last try counts", "home": "T3 DriftingHome", "bus": "T4 BusMacros",
    "line": "T5 SynchronizedLine",
}  # fmt: skip
PLAYER_LINE_STYLES = {"formula": "-.", "scripted": "-.", "search": "--", "random": ":"}


def learn_missing_runs(folder: Path, tasks: list[str], quick: bool) -> None:
    """Train those runs of some tasks whose files do not exist yet.

    Args:
        folder: Folder of the files.
        tasks: Names of the cards.
        quick: Whether to train only one short run of each task.
    """
    from registerbench.baselines import parametric_policy_learners as rules

    for task in (t for t in RUNS if t in tasks):
        for run in range(1 if quick else RUNS[task]):
            rules.learn(task, run, folder, *((1, 8) if quick else ()))
    if "bus" in tasks:
        from registerbench.baselines import bus_macros_learners as bus

        for level, runs in BUS_MACROS_SEEDS.items() if not quick else {"target": (0,)}.items():
            for run in runs:
                if not (folder / f"{level}-dqn-{run}.zip").exists():
                    bus.learn("dqn", run, 0.1 if quick else 1.0, level, folder)


def collect_rows(folder: Path) -> Iterator[tuple]:
    """Yield the rows of all runs in a folder, with COLUMNS."""
    for path in sorted(folder.glob("*.csv")):
        with path.open() as file:
            rows = list(csv.DictReader(file))
        task, _, name = path.stem.partition("_")
        if name:
            player, _, run = name.rpartition("-")
            for r in rows:
                yield task, player.replace("-", " "), run, *(r[k] for k in COLUMNS[3:])
        elif path.stem.count("-") == 2:
            level, _, run = path.stem.split("-")
            for r in (r for r in rows if r["level"] == level):
                yield "bus", level, run, r["steps"], r["processor_s"], "", r["return"], r["success"]


def pack_runs(folder: Path, path: Path) -> None:
    """Pack the rows of all runs in a folder into one compressed CSV file."""
    with path.open("wb") as raw, gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as file:
        text = "\n".join(",".join(map(str, row)) for row in (COLUMNS, *collect_rows(folder)))
        file.write((text + "\n").encode())


def read_runs(path: Path) -> dict[str, dict[str, dict[str, list[dict]]]]:
    """Read packed runs: task -> player -> run -> rows."""
    rows_by_task: dict[str, Any] = {}
    with gzip.open(path, "rt") as file:
        for row in csv.DictReader(file):
            rows_by_task.setdefault(row["task"], {}).setdefault(row["player"], {}).setdefault(row["run"], []).append(
                row
            )
    return rows_by_task


def collect_points(runs: dict[str, list[dict]], what: str = "return") -> tuple[np.ndarray, np.ndarray]:
    """Collect the points of a learning curve.

    Args:
        runs: Rows of each run of one player.
        what: Name of the column.

    Returns:
        Mean steps of the runs, (points,), and values, (points, runs, episodes).
    """
    every = []
    for rows in runs.values():
        at: dict[int, list[float]] = {}
        for r in rows:
            at.setdefault(int(r["steps"]), []).append(float(r[what]))
        every.append(at)
    number = min(len(at) for at in every)
    steps = np.mean([list(at)[:number] for at in every], axis=0)
    return steps, np.array([[list(at.values())[k] for at in every] for k in range(number)])


def interpolate_levels(runs: dict[str, list[dict]]) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate the learning curves of BusMacros; a run has a share of 0 before it reaches the level.

    Args:
        runs: Rows of each run.

    Returns:
        Steps, (points,), and the share of solved machines, (points, runs, 1).
    """
    curves = [np.array([(float(r["steps"]), float(r["success"])) for r in rows]).T for rows in runs.values()]
    at = np.unique(np.concatenate([c[0] for c in curves]))
    return at, np.stack([np.interp(at, *c, left=0.0) for c in curves], axis=1)[:, :, None]


def read_published_scores(task: str, episodes: int) -> dict[str, dict[str, np.ndarray]]:
    """Read the published scores of a task's players that do not learn.

    Args:
        task: Name of a card.
        episodes: Number of test episodes, from the first.

    Returns:
        Scores, (episodes,), by player and name of the score.
    """
    scores_by_player = {}
    published = registerbench.read_entries(DOCS / "data" / "entries" / f"{task}.zip")
    for name in PLAYER_LINE_STYLES:
        entry = published.get(f"{task}-train-{name}-0.bench")
        if entry is not None and entry.round == OPEN_ROUND:
            scores_by_player[name] = {score: values[:episodes] for score, values in entry.scores.items()}
    return scores_by_player


def format_statistic_with_interval(values: np.ndarray, statistic: Any = compute_iqm) -> str:
    """Format the interquartile mean, or another statistic, with its 95 % interval.

    Args:
        values: Values, (runs, episodes).
        statistic: Function that computes the statistic.
    """
    low, high = compute_interval(values, statistic=statistic)
    return f"{statistic(values):.3f} ({low:.3f} to {high:.3f})"


def format_table(rows_by_task: dict[str, dict[str, dict[str, list[dict]]]]) -> str:
    """Format a Markdown table of the points of all curves that play test episodes, and of players that do not learn."""
    heads = (
        "task",
        "player",
        "runs",
        "tries a run, without proofs",
        "s of a processor",
        "IQM (95 %)",
        "mean (95 %)",
        "success",
    )
    lines: list[tuple] = [heads, ("---",) * len(heads)]
    for task in (t for t in PANELS if t in rows_by_task and t != "bus"):
        for player, runs in rows_by_task[task].items():
            (steps, values), (_, spent), (_, won) = (
                collect_points(runs, c) for c in ("return", "processor_s", "success")
            )
            for at, v, s, w in zip(steps, values, spent, won, strict=True):
                lines.append(
                    (
                        task,
                        player,
                        len(runs),
                        f"{at:.0f}",
                        f"{s.mean():.0f}",
                        format_statistic_with_interval(v),
                        format_statistic_with_interval(v, np.mean),
                        f"{w.mean():.0%}",
                    )
                )
        for name, scores in read_published_scores(task, EPISODES).items():
            v, w = scores["return"], scores["success"]
            lines.append(
                (
                    task,
                    name,
                    "-",
                    "-",
                    "-",
                    format_statistic_with_interval(v),
                    format_statistic_with_interval(v, np.mean),
                    f"{w.mean():.0%}",
                )
            )
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in lines)


def draw_panel(ax: Any, task: str, players: dict[str, dict[str, list[dict]]]) -> None:
    """Draw the learning curves of one task.

    Args:
        ax: Axes of Matplotlib.
        task: Name of the card.
        players: Rows by player and run.
    """
    ordered = sorted(players.items(), key=lambda of: max(int(r[-1]["steps"]) for r in of[1].values()))
    for color, (player, runs) in zip(plot_style.COLORS, ordered, strict=False):
        at, values = interpolate_levels(runs) if task == "bus" else collect_points(runs)
        ends = np.array([compute_interval(v, draws=1000) for v in values])
        ax.fill_between(at, *ends.T, color=color, alpha=0.18, lw=0)
        ax.plot(
            at,
            [compute_iqm(v) for v in values],
            color=color,
            lw=1.8,
            label=f"{player}, {len(runs)} run{'s'[: len(runs) > 1]}",
        )
    for name, scores in (
        {} if task == "bus" else read_published_scores(task, EPISODES)
    ).items():  # returns, where bus has shares
        ax.axhline(
            compute_iqm(scores["return"]), color=plot_style.MUTED_COLOR, lw=1.2, ls=PLAYER_LINE_STYLES[name], label=name
        )
    plot_style.set_title(ax, PANELS[task])
    what = "solved, of 64 machines" if task == "bus" else "return, IQM of test episodes"
    ax.set_xlabel("macros of learning" if task == "bus" else "tries of learning", fontsize=8)
    ax.set_ylabel(what, fontsize=8)
    plot_style.remove_frame(ax)
    ax.legend(frameon=False, fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)


def draw_curves(data: Path, picture: Path) -> None:
    """Draw the learning curves of all tasks from packed runs into one PNG file."""
    rows_by_task = read_runs(data)
    tasks = [task for task in PANELS if task in rows_by_task]
    columns = min(len(tasks), 3)
    rows = -(-len(tasks) // columns)
    figure = plot_style.make_figure(4.4 * columns, 4 * rows)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax, task in zip(axes, tasks, strict=False):
        draw_panel(ax, task, rows_by_task[task])
    for ax in axes[len(tasks) :]:
        ax.set_axis_off()
    figure.savefig(picture, dpi=100)
    print(format_table(rows_by_task))
    print(f"{picture}: written")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    p = commands.add_parser("learn")
    p.add_argument("--tasks", nargs="+", choices=PANELS, default=list(PANELS))
    p.add_argument("--quick", action="store_true", help="a run and a generation of each")
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: learn_missing_runs(a.out, a.tasks, a.quick))
    p = commands.add_parser("draw")
    p.add_argument("--runs", type=Path, metavar="FOLDER", help="folder of `learn`, whose runs are packed into --data")
    p.add_argument("--data", type=Path, default=DATA, metavar="FILE.csv.gz")
    p.add_argument("--picture", type=Path, default=PICTURE, metavar="FILE.png")
    p.set_defaults(run=lambda a: (a.runs and pack_runs(a.runs, a.data), draw_curves(a.data, a.picture)))
    args = parser.parse_args()
    with exit_on_interrupt("the finished runs are saved, and the same command continues after them."):
        args.run(args)


if __name__ == "__main__":
    main()
