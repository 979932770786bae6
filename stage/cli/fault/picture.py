"""The picture of a demonstration: both runs over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stage.extras import need
from stage.units import PLACES

if TYPE_CHECKING:
    from stage.cli.fault.demo import Shown


def draw(shown: Shown, path: str | None, overwrite: bool) -> Any:
    """Draw `shown`, which has both recordings; see `Shown.plot`."""
    from stage.drives.picture import ACCENT, GRID, INK, MUTED
    from stage.files import save_figure

    Figure = need("matplotlib.figure", "drawing").Figure
    figure = Figure(figsize=(9, 5.2), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    struck = [n.time for n in shown.recordings[1].notes if n.text.endswith("begins")][:1]
    shows = _shows(shown, struck)
    for panel, column in zip(panels, shown.demo.draws, strict=True):
        for recording, style in zip(shown.recordings, ((MUTED, 2.6, "healthy"), (ACCENT, 1.4, "faulty")), strict=True):
            time, values, steps = _course(recording, column)
            scale = PLACES[shown.unit].per if _unit(column) == "m" else 1
            drawn = {"color": style[0], "linewidth": style[1], "label": style[2]}
            panel.plot(time, values * scale, drawstyle="steps-post" if steps else "default", **drawn)
        unit = _unit(column)
        if unit is None:
            panel.set_yticks([0, 1], ["off", "on"])
        unit = PLACES[shown.unit].symbol if unit == "m" else unit
        for when in struck:
            if shows is None or shows[0] <= when <= shows[1]:
                panel.axvline(when, color="#c53030", linewidth=1, linestyle=(0, (4, 2)), label="the fault begins")
        panel.set_ylabel(f"{column.replace('_', ' ')}{f' ({unit})' if unit else ''}", color=INK)
        panel.grid(True, color=GRID, linewidth=0.7)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False, fontsize=9)
    panels[1].set_xlabel("time (s)", color=INK)
    if shows:
        panels[0].set_xlim(shows)
    title = shown.recordings[1].notes[0].text.removesuffix(": begins")
    figure.suptitle(title, x=0.01, ha="left", color=INK, weight="bold")
    if path is not None:
        save_figure(figure, path, 150, overwrite)
    return figure


def _unit(column: str) -> str | None:
    """None: a pin, on or off."""
    from stage.recording.recording import COLUMNS

    return COLUMNS[column][0] if column in COLUMNS else None


def _course(recording: Any, column: str) -> tuple[np.ndarray, np.ndarray, bool]:
    """(times in s, values, whether those stay until the next) of the first axis; rates and pins are to the clock."""
    from stage.recording.signals import asserted, rates

    name, axis = next(iter(recording.axes.items()))
    if _unit(column) is not None and column != "rate":
        return recording.column("time"), recording.column(f"{name}/{column}"), False
    course = recording.journals[name].course()
    values = rates(course.edges, course.clock_hz) if column == "rate" else asserted(axis.chip, course.edges, column)
    return recording.began + course.seconds, values, True


def _shows(shown: Shown, struck: list[float]) -> tuple[float, float] | None:
    """From when to when, s; None: all of it."""
    if shown.demo.close_up is None:
        return None
    pin = next((column for column in shown.demo.draws if _unit(column) is None), None)
    moment = struck[0]
    if pin is not None:
        time, on, _ = _course(shown.recordings[1], pin)
        moment = float(time[on.argmax()])
    before, after = shown.demo.close_up
    return moment + before, moment + after
