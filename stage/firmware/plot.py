"""Operation patterns: a move drawn the way motion-chip data sheets draw it, from the chip's own course.

Pulse rate over time, the levels FL, FH1, FH2 beside it, commands as arrows, and below it a lane for each signal that matters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stage.errors import StageError

if TYPE_CHECKING:
    from stage.firmware.report import Report

INK, MUTED, FILL, ACCENT = "#1d2733", "#8a94a0", "#cfe0f2", "#1f5f9e"
LANES = (
    ("fup", "FUP", "#2f855a"),
    ("fkeep", "FKEEP", "#2b6cb0"),
    ("fdown", "FDOWN", "#b7791f"),
    ("sd_plus", "SD+", "#d69e2e"),
    ("sd_minus", "SD-", "#d69e2e"),
    ("org", "ORG", "#38a169"),
    ("el_plus", "EL+", "#c53030"),
    ("el_minus", "EL-", "#c53030"),
    ("extp", "EXTP", "#6b46c1"),
    ("irq", "/INT", "#c05621"),
)
ALWAYS = ("fup", "fkeep", "fdown")
MAX_NOTES = 12


def draw(report: Report, path: str | None = None, title: str | None = None) -> Any:
    """Draw `report`; see Report.plot."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise StageError("drawing needs matplotlib: pip install 'pulsestage[plot]'.") from error

    course = report.course
    t = course.seconds
    begin = _begin(report)
    t = t - begin
    rate = course.edges["speed"] * course.clock_hz / (8192.0 * np.maximum(course.edges["multiplier"], 1))
    lanes = [(course.pin(p), label, colour) for p, label, colour in LANES if p in ALWAYS or course.pin(p).any()]
    scale, unit = (1e3, "ms") if t[-1] < 2 else (1.0, "s")

    figure = Figure(figsize=(9, 3.1 + 0.26 * len(lanes)), layout="constrained")
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[3.1, 0.28 * len(lanes)])
    _rate(top, t * scale, rate, report)
    _notes(top, report, begin, scale, rate.max() or 1)
    top.set_title(title or f"{report.procedure}, axis {report.axis}", loc="left", color=INK, fontsize=11, weight="bold", pad=17)
    top.set_title(
        f"{report.pulses:+d} pulses in {report.duration:.3f} s, stopped by {report.stopped_by}",
        loc="right", color=MUTED, fontsize=9, pad=17,
    )  # fmt: skip
    _draw_lanes(low, t * scale, lanes)
    low.set_xlabel(f"time from the first start ({unit})", color=INK)
    margin = 0.02 * (t[-1] - min(t[0], 0)) * scale
    low.set_xlim(-3 * margin, t[-1] * scale + margin)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


def _begin(report: Report) -> float:
    moving = np.flatnonzero(~report.course.pin("hold"))
    return float(report.course.seconds[moving[0]]) if len(moving) else 0.0


def _rate(ax: Any, t: np.ndarray, rate: np.ndarray, report: Report) -> None:
    ax.fill_between(t, rate, step="post", color=FILL, linewidth=0)
    ax.step(t, rate, where="post", color=ACCENT, linewidth=1.4)
    peak = rate.max() or 1.0
    for name, level in _levels(report).items():
        if level <= 1.05 * peak:
            ax.axhline(level, color=MUTED, linewidth=0.7, linestyle=(0, (4, 4)), zorder=0)
            ax.annotate(
                f"{name} {level:,.0f}", (1, level), xycoords=("axes fraction", "data"), xytext=(4, 0),
                textcoords="offset points", va="center", fontsize=8, color=MUTED, annotation_clip=False,
            )  # fmt: skip
    ax.set_ylim(0, 1.5 * peak)
    ax.set_ylabel("pulse rate (pps)", color=INK)
    ax.yaxis.set_major_formatter(lambda v, _: f"{v:,.0f}")
    _bare(ax)


def _levels(report: Report) -> dict[str, float]:
    """FL, FH1, FH2 as last written before the move, in pps."""
    names = {"R1": "FL", "R2": "FH1", "R3": "FH2"}
    values: dict[str, int] = {}
    for s in report.said:
        if s.kind == "register":
            name, value = s.meaning.split(" ")[0], int(s.meaning.split(" ")[2])
            values.setdefault(name, value)
    if "R7" not in values or values["R7"] < 2:
        return {}
    step = report.course.clock_hz / (8192.0 * values["R7"])
    used = {s.meaning.rsplit(" ", 1)[-1] for s in report.said if s.kind == "command"} | {"FL"}
    return {n: values[r] * step for r, n in names.items() if r in values and n in used}


def _notes(ax: Any, report: Report, begin: float, scale: float, peak: float) -> None:
    """Commands of the operating group, once the motion has begun: a hair line with the byte, and what the bytes mean."""
    clock0, hz = report.course.edges["clock"][0], report.course.clock_hz
    seen = [
        ((s.clock - clock0) / hz - begin, s)
        for s in report.said
        if s.kind == "command" and int(s.code, 16) < 0x40 and (s.clock - clock0) / hz - begin > -1e-4
    ][:MAX_NOTES]
    span = report.course.seconds[-1] - begin
    rows: list[float] = []  # when each row of labels is free again
    for when, s in seen:
        row = next((k for k, free in enumerate(rows) if free <= when), len(rows))
        rows[row : row + 1] = [when + 0.035 * span]
        height = (1.10 + 0.085 * min(row, 4)) * peak
        ax.plot([when * scale] * 2, [0, height], color=MUTED, linewidth=0.6, zorder=0)
        ax.annotate(
            f"{s.code}h", (when * scale, height), xytext=(2, 0), textcoords="offset points", fontsize=7.5, color=INK,
            ha="left", va="center",
        )  # fmt: skip
    meanings = dict.fromkeys(f"{s.code}h {s.meaning}" for _, s in seen)
    ax.annotate(
        "   ".join(meanings), (0, 1), xycoords="axes fraction", xytext=(0, 3), textcoords="offset points",
        fontsize=7.5, color=MUTED, va="bottom",
    )  # fmt: skip


def _draw_lanes(ax: Any, t: np.ndarray, lanes: list) -> None:
    for k, (on, _, colour) in enumerate(reversed(lanes)):
        ax.fill_between(t, k + 0.16, k + 0.16 + 0.68 * on, step="post", color=colour, alpha=0.75, linewidth=0)
        ax.axhline(k + 0.16, color="#dfe4ea", linewidth=0.7, zorder=0)
    ax.set_yticks([k + 0.5 for k in range(len(lanes))], [label for _, label, _ in reversed(lanes)], fontsize=8)
    ax.set_ylim(0, len(lanes))
    _bare(ax)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)


def _bare(ax: Any) -> None:
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(MUTED)
    ax.tick_params(colors=INK, labelsize=8)
