"""Common style of PulseStage's plots: colors, headings, panels without a frame. Plots need matplotlib (extra `plot`)."""

from __future__ import annotations

from typing import Any

from stage.support.extras import import_extra

TEXT_COLOR, MUTED_COLOR, FRAME_COLOR, GRID_COLOR = "#1d2733", "#66717d", "#c9d1da", "#e7ebef"
COLORS = ("#1f5f9e", "#c4572e", "#3a8a5f", "#7b5aa6", "#a8842c", "#4d5866")
SWITCH_COLORS = {"el": "#ce342e", "sd": "#cc9216", "org": "#2c9e58"}
"""Colors of the limit switches by kind."""


def make_figure(width: float, height: float) -> Any:
    """Make a matplotlib figure of `width` x `height` inches. Raises ExtraMissing without matplotlib."""
    return import_extra("matplotlib.figure", "drawing").Figure(figsize=(width, height), layout="constrained")


def add_heading(fig: Any, title: str, result: str = "") -> None:
    """Write a title, bold at the left, and a result, small at the right, above the panels of a figure."""
    height = fig.get_size_inches()[1]
    fig.get_layout_engine().set(rect=(0, 0, 1, 1 - 0.36 / height))
    y = 1 - 0.2 / height
    fig.text(0.012, y, title, color=TEXT_COLOR, fontsize=11, weight="bold", va="center")
    fig.text(0.988, y, result, color=MUTED_COLOR, fontsize=8.5, ha="right", va="center")


def set_title(ax: Any, text: str, size: float = 10) -> None:
    """Write a title above one panel of a figure."""
    ax.set_title(text, loc="left", color=TEXT_COLOR, fontsize=size, weight="bold")


def remove_frame(ax: Any, grid: bool = True, size: float = 8) -> None:
    """Remove the right and top frame of a panel and draw its grid behind the data; `size` is the font size of its ticks."""
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(FRAME_COLOR)
    ax.tick_params(color=FRAME_COLOR, labelcolor=TEXT_COLOR, labelsize=size)
    if grid:
        ax.grid(True, color=GRID_COLOR, linewidth=0.7)
    ax.set_axisbelow(True)
