"""Look of PulseStage's pictures: colours, a heading, axes without a box. Pictures need matplotlib (extra `plot`)."""

from __future__ import annotations

from typing import Any

from stage.support.extras import need

INK, MUTED, HAIR, GRID = "#1d2733", "#66717d", "#c9d1da", "#e7ebef"
COLOURS = ("#1f5f9e", "#c4572e", "#3a8a5f", "#7b5aa6", "#a8842c", "#4d5866")
KINDS = {"el": "#ce342e", "sd": "#cc9216", "org": "#2c9e58"}
"""Of switches."""


def figure(width: float, height: float) -> Any:
    """Return a figure of so many inches; raise ExtraMissing without matplotlib."""
    return need("matplotlib.figure", "drawing").Figure(figsize=(width, height), layout="constrained")


def heading(fig: Any, title: str, result: str = "") -> None:
    """Write what a picture shows, bold at the left, and its result, small at the right, above everything else."""
    height = fig.get_size_inches()[1]
    fig.get_layout_engine().set(rect=(0, 0, 1, 1 - 0.36 / height))
    y = 1 - 0.2 / height
    fig.text(0.012, y, title, color=INK, fontsize=11, weight="bold", va="center")
    fig.text(0.988, y, result, color=MUTED, fontsize=8.5, ha="right", va="center")


def title(ax: Any, text: str, size: float = 10) -> None:
    """Write what one panel of several shows."""
    ax.set_title(text, loc="left", color=INK, fontsize=size, weight="bold")


def bare(ax: Any, grid: bool = True, size: float = 8) -> None:
    """Remove the box around a panel, and draw its grid behind; `size` is that of the numbers at the axes."""
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(HAIR)
    ax.tick_params(color=HAIR, labelcolor=INK, labelsize=size)
    if grid:
        ax.grid(True, color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
