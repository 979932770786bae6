"""Plot of a move as an operation pattern, the kind of figure in data sheets of motion chips.

The figure shows the pulse rate over time with the levels FL, FH1 and FH2. Arrows above the curve mark commands of the host, and
dots mark events. Below the curve is a lane for each relevant signal, filled while the signal is asserted.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.errors import ArgumentError
from stage.firmware.driver import get_driver_class
from stage.firmware.move_plot_signals import OperationPattern, PatternAnnotation
from stage.support.extras import import_extra
from stage.support.files import save_figure
from stage.support.plot_style import COLORS, FRAME_COLOR, MUTED_COLOR, TEXT_COLOR, remove_frame

if TYPE_CHECKING:
    from stage.firmware.move_report import Report

LINE, FILL, MINUS_FILL = COLORS[0], "#dbe8f5", "#e9e2f3"
EVENT_COLOR = "#a4502a"
WIDTH, LEFT, RIGHT, TOP, BOTTOM = 9.2, 0.8, 1.15, 0.42, 0.46  # inches
PANEL, LANE = 2.25, 0.2
ROW, SIZE = 12.0, 7.5  # points: of a row of notes, of their letters


def draw_operation_pattern(
    report: Report,
    path: Any = None,
    title: str | None = None,
    ax: Any = None,
    overwrite: bool = False,
    pins: Collection[str] | None = None,
) -> Any:
    """Draw a report, see `Report.plot`.

    Args:
        report: Report of a procedure.
        path: File to save the figure in, if any.
        title: Title; default: the procedure and the axis.
        ax: Axes of Matplotlib to draw the pulse rate in, without the lanes of signals.
        overwrite: Whether a file that exists is replaced.
        pins: Pins whose lanes may be shown; None: all relevant pins.

    Returns:
        The figure.
    """
    Figure = import_extra("matplotlib.figure", "drawing").Figure
    if ax is not None and not hasattr(ax, "get_window_extent"):
        raise ArgumentError(f"ax={ax!r}: give axes of Matplotlib, or None.")

    pattern = get_driver_class(report.waveforms.chip).PATTERN_CLASS(report)
    t = report.waveforms.seconds - report.began
    begin, end = _compute_time_range(report, t)
    t[0], t[-1] = min(t[0], begin), max(t[-1], end)  # nothing moves before and after
    scale, unit = (1e3, "ms") if end - begin < 2 else (1.0, "s")
    limits = begin * scale, end * scale
    notes = [n._replace(time=n.time * scale) for n in pattern.make_annotations(t)]
    if ax is not None:
        figure = ax.figure
        box = ax.get_window_extent()
        _draw_rate_panel(
            ax, pattern, t * scale, limits, notes, 72 * box.width / figure.dpi, 72 * box.height / figure.dpi
        )
        ax.set_xlabel(f"time from the first start, {unit}", color=TEXT_COLOR, fontsize=8.5)
    else:
        lanes = pattern.list_lanes(pins)
        rows = _assign_annotation_rows(notes, limits, 72 * (WIDTH - LEFT - RIGHT))
        panel = PANEL + (max(rows, default=0) + 1.6) * ROW / 72
        height = TOP + panel + 0.1 + LANE * len(lanes) + BOTTOM
        figure = Figure(figsize=(WIDTH, height))
        width = (WIDTH - LEFT - RIGHT) / WIDTH
        low = figure.add_axes((LEFT / WIDTH, BOTTOM / height, width, LANE * len(lanes) / height))
        top = figure.add_axes((LEFT / WIDTH, 1 - (TOP + panel) / height, width, panel / height))
        _draw_rate_panel(top, pattern, t * scale, limits, notes, 72 * WIDTH * width, 72 * panel)
        top.tick_params(labelbottom=False, bottom=False)
        _draw_lanes(low, t * scale, limits, lanes)
        low.set_xlabel(f"time from the first start, {unit}", color=TEXT_COLOR, fontsize=8.5)
        _draw_heading(figure, report, title, height)
    if path is not None:
        save_figure(figure, path, 150, overwrite)
    return figure


def _draw_heading(figure: Any, report: Report, title: str | None, height: float) -> None:
    """Draw the title and the main results above the plot."""
    y = 1 - 0.25 / height
    name = title or f"{report.procedure[:1].upper()}{report.procedure[1:]}, axis {report.axis}"
    summary = f"{_format_signed(report.pulses)} pulses, {report.duration:.3f} s, stopped by {report.stopped_by}"
    if report.lost_steps:
        summary += f", {report.describe_loss()}"
    figure.text(LEFT / WIDTH, y, name, color=TEXT_COLOR, fontsize=11, weight="bold", va="center")
    figure.text(1 - 0.12 / WIDTH, y, summary, color=MUTED_COLOR, fontsize=8.5, ha="right", va="center")


def _format_signed(number: int) -> str:
    return f"{number:+,d}".replace("-", "\N{MINUS SIGN}")


def _compute_time_range(report: Report, times: np.ndarray) -> tuple[float, float]:
    """Return the times from shortly before the first start to shortly after the last stop, s."""
    last = report.duration if report.duration else max(float(times[-1]), 1e-3)
    return -0.025 * last, 1.04 * last


def _draw_rate_panel(
    ax: Any,
    pattern: OperationPattern,
    times: np.ndarray,
    limits: tuple[float, float],
    notes: list[PatternAnnotation],
    width: float,
    height: float,
) -> None:
    """Draw the pulse rate with the notes above it, in axes of `width` x `height` points."""
    report, levels = pattern.report, pattern.list_named_rates()
    rates = report.rates
    peak = float(rates.max()) or 1.0
    rows = _assign_annotation_rows(notes, limits, width)
    plateaus = _find_plateaus(report, levels, times, limits)
    first = 1.6 if any(rate > 0.97 * peak for _, rate in plateaus) else 0.9  # the lowest note leaves room for the rate
    above = (max(rows, default=0) + first + 0.7) * ROW  # points for the notes
    scale = peak / (height - above)  # pps a point
    ax.set_xlim(*limits)
    ax.set_ylim(0, height * scale)
    minus = pattern.find_minus_edges()
    both = len(set(minus[rates > 0].tolist())) > 1
    for colour, part in ((FILL, ~minus | (not both)), (MINUS_FILL, minus & both)):
        ax.fill_between(times, np.where(part, rates, 0), step="post", color=colour, linewidth=0)
    for name, level in levels.items():
        if level <= 1.02 * peak:
            ax.axhline(level, color=MUTED_COLOR, linewidth=0.6, linestyle=(0, (5, 4)), zorder=1)
            _label_level(ax, level, f"{name}  {level:,.0f}")
    ax.step(times, rates, where="post", color=LINE, linewidth=1.3, zorder=3, solid_joinstyle="round")
    for when, rate in plateaus:
        ax.annotate(
            f"{rate:,.0f}",
            (when, rate),
            xytext=(0, 2.5),
            textcoords="offset points",
            ha="center",
            fontsize=SIZE,
            color=MUTED_COLOR,
        )
    for note, row in zip(notes, rows, strict=True):
        _draw_annotation(
            ax, note, _get_annotation_rate(report, times, note), (height - above + (row + first) * ROW) * scale
        )
    ax.set_ylabel("pulse rate, pps", color=TEXT_COLOR, fontsize=8.5, y=0.5 * (height - above) / height)
    ax.locator_params(axis="y", nbins=6)
    ticks = [v for v in ax.get_yticks() if v <= 1.02 * peak]
    ax.set_yticks(ticks, [f"{v:,.0f}" for v in ticks])
    remove_frame(ax, grid=False, size=SIZE)
    ax.spines["left"].set_bounds(0, max(peak, ticks[-1] if ticks else 0))


def _label_level(ax: Any, level: float, text: str) -> None:
    """Write the name and value of a rate at its level, to the right of the plot."""
    ax.annotate(
        text, (1, level), xycoords=("axes fraction", "data"), xytext=(5, 0), textcoords="offset points", va="center",
        fontsize=SIZE, color=MUTED_COLOR, annotation_clip=False,
    )  # fmt: skip


def _get_annotation_rate(report: Report, times: np.ndarray, note: PatternAnnotation) -> float:
    """Return the rate at which the mark of a note meets the curve: the rate just before it, or the first rate."""
    k = int(np.searchsorted(times, note.time - 1e-9))
    before = float(report.rates[max(k - 1, 0)])
    after = float(report.rates[min(int(np.searchsorted(times, note.time + 1e-9, "right")) - 1, len(times) - 1)])
    return before or after


def _find_plateaus(
    report: Report, named: dict[str, float], times: np.ndarray, limits: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return (time of the middle, rate) of each interval of constant rate that has no labeled level."""
    rates, levels = report.rates, list(named.values())
    begins = np.flatnonzero(np.diff(rates, prepend=-1.0) != 0)
    return [
        ((times[k] + times[stop]) / 2, float(rates[k]))
        for k, stop in zip(begins, [*begins[1:], len(rates) - 1], strict=True)
        if rates[k] > 0
        and times[stop] - times[k] > 0.05 * (limits[1] - limits[0])
        and not any(abs(v - rates[k]) < 0.004 * rates.max() for v in levels)
    ]


def _measure_text_width(text: str, bold: bool = False) -> float:
    """Return the width of a text, points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    if not text:
        return 0.0
    prop = FontProperties(weight="bold" if bold else None)
    return 1.04 * float(TextPath((0, 0), text, size=SIZE, prop=prop).get_extents().x1)


def _assign_annotation_rows(notes: list[PatternAnnotation], limits: tuple[float, float], width: float) -> list[int]:
    """Return a row for each annotation, so that no text overlaps another text or the arrow of a later annotation.

    From the last note to the first, each is placed above all notes that begin within its length.
    """
    at = [(n.time - limits[0]) / (limits[1] - limits[0]) * width for n in notes]
    rows = [0] * len(notes)
    for k in reversed(range(len(notes))):
        end = at[k] + _measure_text_width(notes[k].code, True) + _measure_text_width(notes[k].words) + 12
        rows[k] = max((rows[j] + 1 for j in range(k + 1, len(notes)) if at[j] < end), default=0)
    return rows


def _draw_annotation(ax: Any, note: PatternAnnotation, rate: float, height: float) -> None:
    """Draw an annotation of the plot, its arrow or dot, and the line from it to the curve."""
    colour = EVENT_COLOR if note.event else TEXT_COLOR
    style = "-" if note.event else "-|>,head_width=0.16,head_length=0.32"
    arrow = {
        "arrowstyle": style,
        "color": EVENT_COLOR if note.event else MUTED_COLOR,
        "linewidth": 0.6,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    ax.annotate("", (note.time, rate), (note.time, height), zorder=2, annotation_clip=False, arrowprops=arrow)
    if note.event:
        ax.plot([note.time], [rate], "o", color=EVENT_COLOR, markersize=3, zorder=5, clip_on=False)
    gap = 3.0
    for text, bold in ((note.code, True), (note.words, False)):
        if text:
            ax.annotate(
                text, (note.time, height), xytext=(gap, -0.5), textcoords="offset points", va="center", fontsize=SIZE,
                color=colour if bold or note.event else MUTED_COLOR, weight="bold" if bold else "normal", annotation_clip=False,
            )  # fmt: skip
            gap += _measure_text_width(text, bold) + 3.5


def _draw_lanes(ax: Any, times: np.ndarray, limits: tuple[float, float], lanes: list) -> None:
    """Draw one lane per signal, filled while the signal is on."""
    for k, (on, _, colour) in enumerate(reversed(lanes)):
        ax.axhline(k + 0.14, color=FRAME_COLOR, linewidth=0.6, zorder=0)
        ax.fill_between(times, k + 0.14, k + 0.14 + 0.66 * on, step="post", color=colour, linewidth=0)
    labels = [label for _, label, _ in reversed(lanes)]
    ax.set_yticks([k + 0.45 for k in range(len(lanes))], labels)
    ax.set_ylim(0, len(lanes))
    ax.set_xlim(*limits)
    remove_frame(ax, grid=False, size=SIZE)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
