"""Operation patterns: a move drawn the way motion-chip data sheets draw it, from the chip's own course.

Pulse rate over time with the levels FL, FH1, FH2; above it what the host wrote (arrows) and what happened (dots), below it a
lane for each signal that plays a role, filled while it is asserted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.chips.pcl240 import OPERATING_MODE
from stage.errors import StageError
from stage.files import save_figure

if TYPE_CHECKING:
    from stage.firmware.report import Report

INK, MUTED, HAIR = "#1d2733", "#7b8794", "#c9d1da"
LINE, FILL, MINUS_FILL = "#1f5f9e", "#dbe8f5", "#e9e2f3"
EVENT = "#a4502a"
LANES = (
    ("fup", "FUP", "#5b8db8"),
    ("fkeep", "FKEEP", "#5b8db8"),
    ("fdown", "FDOWN", "#5b8db8"),
    ("hold", "HOLD", "#9aa5b1"),
    ("pdir", "PDIR \N{MINUS SIGN}", "#9b86bd"),
    ("sd_plus", "SD+", "#d9a441"),
    ("sd_minus", "SD-", "#d9a441"),
    ("org", "ORG", "#4f9d69"),
    ("el_plus", "EL+", "#c8553d"),
    ("el_minus", "EL-", "#c8553d"),
    ("extp", "EXTP", "#9b86bd"),
    ("irq", "INT", "#c8553d"),
)
ALWAYS = ("fup", "fkeep", "fdown", "hold")
START, STOP, RAMP, SPEED = (
    next(f for f in OPERATING_MODE.fields if f.name == n) for n in ("start", "stop", "ramp", "speed")
)
SPEEDS = ("FL", "FH1", "FL", "FH2")
WIDTH, LEFT, RIGHT, TOP, BOTTOM = 9.2, 0.8, 1.15, 0.42, 0.46  # inches
PANEL, LANE = 2.25, 0.2
ROW, SIZE = 12.0, 7.5  # points: of a row of notes, of their letters


class Note(NamedTuple):
    """A line of text above the curve, with an arrow (what the host wrote) or a dot (what happened) at `time`."""

    time: float
    code: str
    words: str
    event: bool


def draw(report: Report, path: Any = None, title: str | None = None, ax: Any = None, overwrite: bool = False) -> Any:
    """Draw `report`; see Report.plot."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise StageError("drawing needs matplotlib: pip install 'pulsestage[plot]'.") from error

    t = report.course.seconds - report.began
    begin, end = _window(report, t)
    t[0], t[-1] = min(t[0], begin), max(t[-1], end)  # nothing moves before and after
    scale, unit = (1e3, "ms") if end - begin < 2 else (1.0, "s")
    limits = begin * scale, end * scale
    notes = [n._replace(time=n.time * scale) for n in _notes(report, t)]
    if ax is not None:
        figure = ax.figure
        box = ax.get_window_extent()
        _panel(ax, report, t * scale, limits, notes, 72 * box.width / figure.dpi, 72 * box.height / figure.dpi)
        ax.set_xlabel(f"time from the first start, {unit}", color=INK, fontsize=8.5)
    else:
        lanes = _lanes(report)
        rows = _rows(notes, limits, 72 * (WIDTH - LEFT - RIGHT))
        panel = PANEL + (max(rows, default=0) + 1.6) * ROW / 72
        height = TOP + panel + 0.1 + LANE * len(lanes) + BOTTOM
        figure = Figure(figsize=(WIDTH, height))
        width = (WIDTH - LEFT - RIGHT) / WIDTH
        low = figure.add_axes((LEFT / WIDTH, BOTTOM / height, width, LANE * len(lanes) / height))
        top = figure.add_axes((LEFT / WIDTH, 1 - (TOP + panel) / height, width, panel / height))
        _panel(top, report, t * scale, limits, notes, 72 * WIDTH * width, 72 * panel)
        top.tick_params(labelbottom=False, bottom=False)
        _draw_lanes(low, t * scale, limits, lanes)
        low.set_xlabel(f"time from the first start, {unit}", color=INK, fontsize=8.5)
        _heading(figure, report, title, height)
    if path is not None:
        save_figure(figure, path, 150, overwrite)
    return figure


def _heading(figure: Any, report: Report, title: str | None, height: float) -> None:
    y = 1 - 0.25 / height
    name = title or f"{report.procedure[:1].upper()}{report.procedure[1:]}, axis {report.axis}"
    said = f"{_signed(report.pulses)} pulses, {report.duration:.3f} s, stopped by {report.stopped_by}"
    if report.lost_steps:
        said += f", {report.lost_steps} steps lost"
    figure.text(LEFT / WIDTH, y, name, color=INK, fontsize=11, weight="bold", va="center")
    figure.text(1 - 0.12 / WIDTH, y, said, color=MUTED, fontsize=8.5, ha="right", va="center")


def _signed(n: int) -> str:
    return f"{n:+,d}".replace("-", "\N{MINUS SIGN}")


def _window(report: Report, t: np.ndarray) -> tuple[float, float]:
    """From shortly before the first start to shortly after the last stop, s."""
    last = report.duration if report.duration else max(float(t[-1]), 1e-3)
    return -0.025 * last, 1.04 * last


def _lanes(report: Report) -> list[tuple[np.ndarray, str, str]]:
    course = report.course
    running = ~course.pin("hold")
    both = len(set(course.pin("pdir")[running].tolist())) > 1
    return [
        (course.pin(pin), label, colour)
        for pin, label, colour in LANES
        if pin in ALWAYS or (both if pin == "pdir" else course.pin(pin).any())
    ]


def _panel(
    ax: Any, report: Report, t: np.ndarray, limits: tuple[float, float], notes: list[Note], width: float, height: float
) -> None:
    """The pulse rate, in an axes of `width` x `height` points, with the notes above it."""
    rates = report.rates
    peak = float(rates.max()) or 1.0
    rows = _rows(notes, limits, width)
    plateaus = _plateaus(report, t, limits)
    first = 1.6 if any(rate > 0.97 * peak for _, rate in plateaus) else 0.9  # the lowest note leaves room for the rate
    above = (max(rows, default=0) + first + 0.7) * ROW  # points for the notes
    scale = peak / (height - above)  # pps a point
    ax.set_xlim(*limits)
    ax.set_ylim(0, height * scale)
    minus = report.course.pin("pdir")
    both = len(set(minus[rates > 0].tolist())) > 1
    for colour, part in ((FILL, ~minus | (not both)), (MINUS_FILL, minus & both)):
        ax.fill_between(t, np.where(part, rates, 0), step="post", color=colour, linewidth=0)
    for name, level in _levels(report).items():
        if level <= 1.02 * peak:
            ax.axhline(level, color=MUTED, linewidth=0.6, linestyle=(0, (5, 4)), zorder=1)
            _beside(ax, level, f"{name}  {level:,.0f}")
    ax.step(t, rates, where="post", color=LINE, linewidth=1.3, zorder=3, solid_joinstyle="round")
    for when, rate in plateaus:
        ax.annotate(
            f"{rate:,.0f}",
            (when, rate),
            xytext=(0, 2.5),
            textcoords="offset points",
            ha="center",
            fontsize=SIZE,
            color=MUTED,
        )
    for note, row in zip(notes, rows, strict=True):
        _draw_note(ax, note, _rate_at(report, t, note), (height - above + (row + first) * ROW) * scale)
    ax.set_ylabel("pulse rate, pps", color=INK, fontsize=8.5, y=0.5 * (height - above) / height)
    ax.locator_params(axis="y", nbins=6)
    ticks = [v for v in ax.get_yticks() if v <= 1.02 * peak]
    ax.set_yticks(ticks, [f"{v:,.0f}" for v in ticks])
    _bare(ax)
    ax.spines["left"].set_bounds(0, max(peak, ticks[-1] if ticks else 0))


def _beside(ax: Any, level: float, text: str) -> None:
    ax.annotate(
        text, (1, level), xycoords=("axes fraction", "data"), xytext=(5, 0), textcoords="offset points", va="center",
        fontsize=SIZE, color=MUTED, annotation_clip=False,
    )  # fmt: skip


def _rate_at(report: Report, t: np.ndarray, note: Note) -> float:
    """Where the note's arrow or dot meets the curve: the rate just before it, or what it starts with."""
    k = int(np.searchsorted(t, note.time - 1e-9))
    before = float(report.rates[max(k - 1, 0)])
    after = float(report.rates[min(int(np.searchsorted(t, note.time + 1e-9, "right")) - 1, len(t) - 1)])
    return before or after


def _levels(report: Report) -> dict[str, float]:
    """FL, FH1, FH2 in pps, of those that commands select and whose register was written once."""
    values: dict[str, set[int]] = {}
    used = set()
    for s in report.said:
        if s.kind == "register":
            name, value = s.meaning.split(" ")[0], int(s.meaning.split(" ")[2])
            values.setdefault(name, set()).add(value)
        elif s.kind == "command" and START.of(int(s.code, 16)) and int(s.code, 16) < 0x40:
            used.add(SPEEDS[SPEED.of(int(s.code, 16))])
            used |= {"FL"} if RAMP.of(int(s.code, 16)) else set()
    step = report.course.clock_hz / (8192.0 * max(next(iter(values.get("R7", {1}))), 1))
    names = {"FL": "R1", "FH1": "R2", "FH2": "R3"}
    once = {n: values[r] for n, r in names.items() if n in used and len(values.get(r, ())) == 1}
    return {n: next(iter(v)) * step for n, v in once.items()}


def _plateaus(report: Report, t: np.ndarray, limits: tuple[float, float]) -> list[tuple[float, float]]:
    """(time of its middle, rate) of each stretch of constant rate that no level line names."""
    rates, levels = report.rates, list(_levels(report).values())
    begins = np.flatnonzero(np.diff(rates, prepend=-1.0) != 0)
    return [
        ((t[k] + t[stop]) / 2, float(rates[k]))
        for k, stop in zip(begins, [*begins[1:], len(rates) - 1], strict=True)
        if rates[k] > 0
        and t[stop] - t[k] > 0.05 * (limits[1] - limits[0])
        and not any(abs(v - rates[k]) < 0.004 * rates.max() for v in levels)
    ]


def _notes(report: Report, t: np.ndarray) -> list[Note]:
    """What the host wrote to start, to change or to stop a run, each ramp-down point, and why it stopped.

    Bytes that only prepare a start (reset command, control mode) or a change of speed (a register) stand in front of it.
    """
    course = report.course
    hold, clocks = course.pin("hold"), course.edges["clock"]
    notes: list[Note] = []
    ahead: list[str] = []
    for (when, code, _), s in zip(report.writes(), report.said, strict=True):
        halted = bool(hold[max(int(np.searchsorted(clocks, s.clock)) - 1, 0)])
        if s.kind == "register":
            if not halted:
                ahead.append(s.meaning.split(" (")[0].replace("<-", "\N{LEFTWARDS ARROW}"))
            continue
        if s.kind == "lost":
            notes.append(Note(when, f"{code}h", "lost on the bus", False))
            continue
        byte = int(code, 16)
        words = _words(byte, halted)
        if (
            byte & 0x1F == 0x14
            and not halted
            and not course.pin("fdown")[np.searchsorted(clocks, s.clock, "right") - 1]
        ):
            words = "ramps on"
        if words:
            notes.append(Note(when, " ".join([*ahead, f"{code}h"]), words, False))
        if words or s.kind == "reset" or byte == 0x08:
            ahead.clear()
        if not words and (byte == 0x08 or byte >> 6 == 1 or (byte >> 6 == 3 and byte & 0x3F)):
            ahead = [a for a in ahead if a[0] != code[0]] + [f"{code}h"]  # the latest of a group counts
    falls = course.pin("fdown") & course.pin("lt") & ~hold
    for k in np.flatnonzero(falls[1:] & ~course.pin("lt")[:-1]) + 1:
        notes.append(Note(float(t[k]), "", f"R0 < R6 = {course.edges['counter'][k] + 1:,d}", True))
    if report.duration and report.stopped_by != "reset command":  # a note of its own
        why = "stop at FL" if report.stopped_by == "decelerating stop" else report.stopped_by
        notes.append(Note(report.duration, "", why, True))
    return sorted(notes, key=lambda n: n.time)


def _words(byte: int, halted: bool) -> str:
    """What an operating-mode command does there and then, in few words."""
    if byte >> 6:
        return ""
    irq = ", /INT at stop" if byte & 0x20 else ""
    start, stop = START.of(byte), STOP.of(byte)
    if stop and not start:
        return "" if halted else "reset command"
    if stop:
        return ("decelerating stop" if RAMP.of(byte) else "stop") + irq
    if not start:
        return ""
    speed = SPEEDS[SPEED.of(byte)]
    if halted:
        return (f"start, ramp to {speed}" if RAMP.of(byte) and speed != "FL" else f"start, constant {speed}") + irq
    return (f"ramp to {speed}" if RAMP.of(byte) else f"at once {speed}") + irq


def _width(text: str, bold: bool = False) -> float:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    if not text:
        return 0.0
    prop = FontProperties(weight="bold" if bold else None)
    return 1.04 * float(TextPath((0, 0), text, size=SIZE, prop=prop).get_extents().x1)


def _rows(notes: list[Note], limits: tuple[float, float], width: float) -> list[int]:
    """A row for each note, so that no text meets another or the arrow of a later one: from the last to the first, each
    goes above all that begin within its length."""
    at = [(n.time - limits[0]) / (limits[1] - limits[0]) * width for n in notes]
    rows = [0] * len(notes)
    for k in reversed(range(len(notes))):
        end = at[k] + _width(notes[k].code, True) + _width(notes[k].words) + 12
        rows[k] = max((rows[j] + 1 for j in range(k + 1, len(notes)) if at[j] < end), default=0)
    return rows


def _draw_note(ax: Any, note: Note, rate: float, y: float) -> None:
    colour = EVENT if note.event else INK
    style = "-" if note.event else "-|>,head_width=0.16,head_length=0.32"
    arrow = {"arrowstyle": style, "color": EVENT if note.event else MUTED, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (note.time, rate), (note.time, y), zorder=2, annotation_clip=False, arrowprops=arrow)
    if note.event:
        ax.plot([note.time], [rate], "o", color=EVENT, markersize=3, zorder=5, clip_on=False)
    gap = 3.0
    for text, bold in ((note.code, True), (note.words, False)):
        if text:
            ax.annotate(
                text, (note.time, y), xytext=(gap, -0.5), textcoords="offset points", va="center", fontsize=SIZE,
                color=colour if bold or note.event else MUTED, weight="bold" if bold else "normal", annotation_clip=False,
            )  # fmt: skip
            gap += _width(text, bold) + 3.5


def _draw_lanes(ax: Any, t: np.ndarray, limits: tuple[float, float], lanes: list) -> None:
    for k, (on, _, colour) in enumerate(reversed(lanes)):
        ax.axhline(k + 0.14, color=HAIR, linewidth=0.6, zorder=0)
        ax.fill_between(t, k + 0.14, k + 0.14 + 0.66 * on, step="post", color=colour, linewidth=0)
    labels = [label for _, label, _ in reversed(lanes)]
    ax.set_yticks([k + 0.45 for k in range(len(lanes))], labels)
    ax.set_ylim(0, len(lanes))
    ax.set_xlim(*limits)
    _bare(ax)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)


def _bare(ax: Any) -> None:
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(HAIR)
    ax.tick_params(color=HAIR, labelcolor=INK, labelsize=SIZE)
