"""A benchmark's results as one picture: a panel for each subject that was measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure as Canvas

from bench.figures import Curve
from bench.report import Results
from bench.targets import BY_FIGURE
from stage.support.plot_style import MUTED_COLOR, TEXT_COLOR, remove_frame, set_title

OURS, OTHER, SECOND = "#17508f", "#d1571f", "#4aa8d8"
BOUND: dict[str, Any] = {"color": OTHER, "lw": 1.6, "ls": (0, (4, 2))}


def draw_bars(ax: Any, results: Results, rows: dict[str, str], unit: str) -> None:
    """Draw medians as bars, spreads as lines, and targets as dashed lines.

    Args:
        ax: Axes of Matplotlib.
        results: Results to draw.
        rows: Label of each figure, by key.
        unit: Unit of the figures.
    """
    rows = {key: label for key, label in rows.items() if key in results.figures}
    for y, key in enumerate(rows):
        f = results.figures[key]
        ax.barh(y, f.median, 0.6, color=OURS)
        ax.plot([f.minimum, f.maximum], [y, y], color=TEXT_COLOR, lw=1.4, solid_capstyle="butt")
        if target := BY_FIGURE.get(key):
            ax.plot([target.bound] * 2, [y - 0.42, y + 0.42], **BOUND)
    ax.set_yticks(range(len(rows)), rows.values())
    ax.set(xlabel=unit, ylim=(len(rows) - 0.4, -0.6))
    ax.grid(False, axis="y")


def draw_throughput(ax: Any, results: Results) -> None:
    rows = {"closed_loop.off": "closed loop", "closed_loop.on": "recorded"}
    rows |= {"vector.fleet_batch_1": "64 stages, 1 thread", "vector.fleet_batch_2": "2 threads"}
    rows |= {"vector.env_batch_1": "64 envs, 1 thread", "vector.env_batch_2": "2 threads"}
    draw_bars(ax, results, rows, "throughput / bare mj_step or Batch")
    ax.axvline(1, color=MUTED_COLOR, lw=1)


def draw_threads(ax: Any, results: Results) -> None:
    rows = {"vector.batch_two": "Batch", "vector.fleet_two": "Fleet", "vector.env_two": "vector env"}
    draw_bars(ax, results, rows, "two threads / one, throughput")


def draw_overhead(ax: Any, results: Results) -> None:
    skips = [k for k in (1, 4, 40) if f"environment.ours_{k}" in results.figures]
    x = np.arange(len(skips))
    for shift, kind, color, name in ((-0.2, "ours", OURS, "RegisterBus"), (0.2, "plain", OTHER, "MujocoEnv")):
        figures = [results.figures[f"environment.{kind}_{k}"] for k in skips]
        ax.bar(x + shift, [f.median for f in figures], 0.36, color=color, label=name)
        for at, f in zip(x + shift, figures, strict=True):
            # of a difference the minimum may be below 0, and bars begin at 0
            ax.plot([at, at], [max(f.minimum, 0), f.maximum], color=TEXT_COLOR, lw=1.4, solid_capstyle="butt")
            ax.annotate(
                f"{f.median:.3g}",
                (at, max(f.maximum, 0)),
                (0, 2),
                textcoords="offset points",
                ha="center",
                color=MUTED_COLOR,
            )
    ax.set_xticks(x, [f"{k} step{'s' if k > 1 else ''}" for k in skips])
    ax.set(ylabel="overhead of an action (µs)")
    ax.margins(y=0.12)
    place_legend_below(ax)
    ax.grid(False, axis="x")


def draw_chips(ax: Any, results: Results) -> None:
    rows = {"chips.constant": "constant speed, clocks", "chips.ramp": "fastest ramp, clocks"}
    rows |= {"chips.s_curve": "S-curve, clocks", "chips.traced": "pulses traced"}
    draw_bars(ax, results, rows, "simulated a second of wall time")
    ax.set_xscale("log")


def place_legend_below(ax: Any) -> None:
    """Place the legend below the panel, where it hides no data."""
    ax.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.17), fontsize=9, handletextpad=0.4)


def make_curve_panel(*keys: str) -> Callable[[Any, Results], None]:
    def panel(ax: Any, results: Results) -> None:
        for key, color in zip(keys, (OURS, OTHER), strict=False):
            if key in results.curves:
                draw_curve(ax, results.curves[key], color)
        ax.set(xscale="log", yscale="log")
        place_legend_below(ax)

    return panel


def draw_curve(ax: Any, c: Curve, color: str) -> None:
    """Draw the medians of a curve with their spread, and the fit over the sizes that it uses.

    Args:
        ax: Axes of Matplotlib.
        c: Curve to draw.
        color: Color of the curve.
    """
    sizes, cost = np.array(c.sizes), np.array(c.cost)
    p, middle = float(np.median(c.exponents())), np.median(cost, axis=0)
    ax.plot(sizes, middle, "o", color=color, ms=4.5, label=f"{c.name.strip()}: n^{p:.3f}")
    ax.vlines(sizes, cost.min(axis=0), cost.max(axis=0), color=color, lw=1.2)
    upper = sizes >= c.fitted_from
    level = np.exp(np.mean(np.log(middle[upper]) - p * np.log(sizes[upper])))
    ax.plot(sizes[upper], level * sizes[upper] ** p, color=color, lw=1.2)
    ax.set(xlabel=f"{c.over}", ylabel=c.unit)


PANELS: tuple[tuple[str, str, Callable[[Any, Results], None]], ...] = (
    ("closed_loop vector", "Beside bare MuJoCo", draw_throughput),
    ("vector", "Two threads", draw_threads),
    ("environment", "One environment", draw_overhead),
    ("chips", "Chips alone", draw_chips),
    ("scaling", "Cost over axes", make_curve_panel("scaling.axes", "scaling.axes_bare")),
    ("scaling", "Cost over stages", make_curve_panel("scaling.stages")),
    ("long_run", "Cost over run length", make_curve_panel("long_run.length", "long_run.length_recorded")),
)


HOW = """How to read it

bar, dot: the median of the rounds
thin line: least to most
dashed orange: the target
n^p: cost grows with size to the power p,
    fitted over the line's part
"""
"""In the empty place of the grid."""


def draw(results: Results, path: Path) -> None:
    """Draw all panels that have results into one file.

    Args:
        results: Results to draw.
        path: File of the picture.

    Raises:
        SystemExit: Nothing that the picture shows was measured.
    """
    panels = [(title, panel) for whose, title, panel in PANELS if set(whose.split()) & set(results.titles)]
    if not panels:
        raise SystemExit(f"{path}: not drawn, none of its figures was measured.")
    across = min(len(panels), 4 if len(panels) > 6 else 3)
    down = -(-len(panels) // across)
    canvas = Canvas(figsize=(4.5 * across, 3.9 * down), layout="constrained")
    canvas.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    with rc_context({"font.size": 10}):
        grid = canvas.subplots(down, across, squeeze=False).ravel()
        for ax, (text, panel) in zip(grid, panels, strict=False):
            remove_frame(ax, size=9)
            panel(ax, results)
            set_title(ax, text, 12)
        for k, ax in enumerate(grid[len(panels) :]):
            ax.axis("off")
            if not k:
                ax.text(0, 0.97, HOW, transform=ax.transAxes, va="top", color=TEXT_COLOR, fontsize=10, linespacing=1.6)
    canvas.savefig(path, dpi=140)
    print(f"{path}: drawn")
