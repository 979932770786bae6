"""Plot of an a:b move: the path around its point farthest from the line, the distance from the line, and the rates over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stage.firmware.operation_pattern_figure import LINE, SIZE
from stage.firmware.path_deviation import compute_path_points
from stage.support.extras import import_extra
from stage.support.files import save_figure
from stage.support.plot_style import MUTED_COLOR, TEXT_COLOR, remove_frame

if TYPE_CHECKING:
    from stage.firmware.synchronized_report import SynchronizedReport

AXIS_COLORS = (LINE, "#c05621", "#2f855a", "#6b46c1", "#b7791f", "#2b6cb0")
WORST_POINT_COLOR = "#c53030"
MARGIN_PULSES = 5.5  # pulses to either side of the farthest point
RATE_BINS = 300


def draw_synchronized_move(
    report: SynchronizedReport, path: Any = None, title: str | None = None, overwrite: bool = False
) -> Any:
    """Draw a report of several axes, see `SynchronizedReport.plot`.

    Args:
        report: Report of the move.
        path: File to save the figure in, if any.
        title: Title; default: the distances.
        overwrite: Whether a file that exists is replaced.

    Returns:
        The figure.
    """
    Figure = import_extra("matplotlib.figure", "drawing").Figure

    line = np.array(list(report.distances.values()), float)
    times, counts = compute_path_points(list(report.paths.values()))
    flat = len(line) == 2
    figure = Figure(figsize=(10.5, 4.6) if flat else (8, 5.2), layout="constrained")
    if flat:
        near, off, rates = figure.subplot_mosaic([["near", "off"], ["near", "rates"]], width_ratios=[1, 1.25]).values()
        _draw_farthest_point_detail(near, report, counts, line)
    else:
        off, rates = figure.subplots(2, 1)
    _draw_distance(off, report, times, counts, line)
    _draw_rates(rates, report)
    distances = ", ".join(f"{n} {d:+,}" for n, d in report.distances.items())
    figure.suptitle(
        title or f"a:b move, {distances} pulses", x=0.01, ha="left", color=TEXT_COLOR, fontsize=11, weight="bold"
    )
    if path is not None:
        save_figure(figure, path, 150, overwrite)
    return figure


def _draw_farthest_point_detail(ax: Any, report: SynchronizedReport, counts: np.ndarray, line: np.ndarray) -> None:
    """Draw the path around its farthest point, in the plane of two axes."""
    worst = np.array(report.deviation.counts, float)
    unit = line / np.linalg.norm(line)
    foot = np.clip(worst @ unit, 0, np.linalg.norm(line)) * unit
    near = (np.abs(counts - worst) <= MARGIN_PULSES + 2).all(axis=1)
    x, y = counts[near].T
    ends = (foot[:, None] + unit[:, None] * np.array([-3, 3]) * MARGIN_PULSES).clip(
        np.minimum(line, 0)[:, None], np.maximum(line, 0)[:, None]
    )
    ax.plot(*ends, color=MUTED_COLOR, linewidth=1.2, label="the line")
    ax.plot(x, y, color=LINE, linewidth=1.3, marker="o", markersize=3, label="the path, a dot a pulse")
    if report.deviation.pulses:
        label = f"farthest: {report.deviation.pulses:.2f} pulses"
        ax.plot(*np.stack([foot, worst], axis=1), color=WORST_POINT_COLOR, linewidth=1.6, label=label)
        ax.plot(*worst, color=WORST_POINT_COLOR, marker="o", markersize=5)
    for lim, middle in ((ax.set_xlim, worst[0]), (ax.set_ylim, worst[1])):
        lim(middle - MARGIN_PULSES, middle + MARGIN_PULSES)
    for axis, name in ((ax.xaxis, 0), (ax.yaxis, 1)):
        axis.set_major_locator(_make_locator())
        axis.set_label_text(f"{list(report.paths)[name]} (pulses)", color=TEXT_COLOR)
        axis.set_major_formatter(lambda v, _: f"{v:,.0f}")
    ax.set_aspect("equal")
    ax.legend(loc="best", frameon=False, fontsize=8, labelcolor=TEXT_COLOR)
    remove_frame(ax, size=SIZE)


def _make_locator() -> Any:
    """Return a tick locator that uses only whole pulses."""
    from matplotlib.ticker import MultipleLocator

    return MultipleLocator(2)


def _draw_distance(
    ax: Any, report: SynchronizedReport, times: np.ndarray, counts: np.ndarray, line: np.ndarray
) -> None:
    """Draw the distance from the line over time; with two axes it has a sign: + is left of the line, - is right of it."""
    unit = line / max(np.linalg.norm(line), 1.0)
    if len(line) == 2:
        off = counts @ np.array([-unit[1], unit[0]])
    else:
        along = np.clip(counts @ unit, 0, np.linalg.norm(line))
        off = np.linalg.norm(counts - along[:, None] * unit, axis=1)
    ax.set_ylabel("from the line (pulses)", color=TEXT_COLOR)
    scale, _ = _choose_time_unit(report)
    d = report.deviation
    if len(off) > 3 * RATE_BINS:
        cuts = np.unique(np.searchsorted(times, np.linspace(0, times[-1], RATE_BINS)))[:-1]
        low, high = np.minimum.reduceat(off, cuts), np.maximum.reduceat(off, cuts)
        ax.fill_between(times[cuts] * scale, low, high, step="post", color=LINE, alpha=0.55, linewidth=0)
    else:
        ax.step(times * scale, off, where="post", color=LINE, linewidth=0.7)
    at = off[np.searchsorted(times, d.time)] if d.pulses else 0.0
    if d.pulses:
        ax.plot(d.time * scale, at, color=WORST_POINT_COLOR, marker="o", markersize=5, zorder=3)
    reach = max(1.25, 1.15 * d.pulses)
    ax.set_ylim(-reach if off.min() < 0 else 0, reach)
    for k in (-1, 0, 1):
        ax.axhline(k, color=MUTED_COLOR, linewidth=0.7, linestyle="-" if k == 0 else (0, (4, 4)), zorder=0)
    ax.set_title(
        f"at most {d.pulses:.2f} pulses from the line, after {d.time * 1e3:,.4g} ms",
        loc="right", color=MUTED_COLOR, fontsize=9,
    )  # fmt: skip
    ax.set_xlim(0, report.seconds * scale * 1.01)
    ax.tick_params(labelbottom=False)
    remove_frame(ax, grid=False, size=SIZE)


def _draw_rates(ax: Any, report: SynchronizedReport) -> None:
    """Draw the pulse rates of all axes over time."""
    scale, unit_name = _choose_time_unit(report)
    first = min(r.began for r in report.axes.values())
    peak = 0.0
    for k, (name, r) in enumerate(report.axes.items()):
        ax.step(
            (r.waveforms.seconds - first) * scale, r.rates, where="post", color=AXIS_COLORS[k % len(AXIS_COLORS)], linewidth=1.4,
            label=f"{name}  {report.describe_rate(name)}",
        )  # fmt: skip
        peak = max(peak, r.peak_rate)
    ax.set_xlim(0, report.seconds * scale * 1.01)
    ax.set_ylim(0, 1.08 * (peak or 1.0))
    ax.set_xlabel(f"time from the first start command ({unit_name})", color=TEXT_COLOR)
    ax.set_ylabel("pulse rate (pps)", color=TEXT_COLOR)
    ax.yaxis.set_major_formatter(lambda v, _: f"{v:,.0f}")
    ax.legend(
        loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=len(report.axes), frameon=False, fontsize=8, labelcolor=TEXT_COLOR,
    )  # fmt: skip
    remove_frame(ax, grid=False, size=SIZE)


def _choose_time_unit(report: SynchronizedReport) -> tuple[float, str]:
    """Return the factor from seconds to the unit of the time axis, and the name of the unit."""
    return (1e3, "ms") if report.seconds < 2 else (1.0, "s")
