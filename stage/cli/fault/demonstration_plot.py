"""Picture of a demonstration: both runs over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stage.support import plot_style
from stage.units import POSITION_UNITS

if TYPE_CHECKING:
    from stage.cli.fault.demonstrations import DemoResult

STYLES = (
    {"color": "#f0a868", "linewidth": 5.5, "alpha": 0.75, "label": "healthy"},
    {"color": plot_style.COLORS[0], "linewidth": 1.4, "label": "faulty"},
)
"""Styles of the two runs. The healthy one is a wide band, so that both are visible where the runs are alike."""


def draw_demonstration(result: DemoResult, path: str | None, overwrite: bool) -> Any:
    """Draw a result that has both recordings, and return the figure; see `DemoResult.plot`."""
    from stage.support.files import save_figure

    figure = plot_style.make_figure(9, 5.2)
    panels = figure.subplots(2, 1, sharex=True)
    begins = [n.time for n in result.recordings[1].fault_changes if n.text.endswith("begins")][:1]
    limits = _find_time_limits(result, begins)
    for panel, column in zip(panels, result.demo.draws, strict=True):
        unit = _find_unit(column)
        if unit is None:
            _draw_pin(panel, result, column)
        else:
            for recording, style in zip(result.recordings, STYLES, strict=True):
                time, values, steps = _read_waveform(recording, column)
                scale = POSITION_UNITS[result.unit].factor if unit == "m" else 1
                panel.plot(time, values * scale, drawstyle="steps-post" if steps else "default", **style)
        for when in begins:
            if limits is None or limits[0] <= when <= limits[1]:
                panel.axvline(when, color="#c53030", linewidth=1, linestyle=(0, (4, 2)), label="the fault begins")
        unit = POSITION_UNITS[result.unit].symbol if unit == "m" else unit
        panel.set_ylabel(
            f"{column.replace('_', ' ')}{f', {unit}' if unit else ''}", color=plot_style.TEXT_COLOR, fontsize=8.5
        )
        plot_style.remove_frame(panel)
    handles, labels = panels[0].get_legend_handles_labels()
    place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.2}
    panels[0].legend(handles, labels, ncols=len(labels), frameon=False, fontsize=8, **place)
    panels[1].set_xlabel("time, s", color=plot_style.TEXT_COLOR, fontsize=8.5)
    if limits:
        panels[0].set_xlim(limits)
    name = result.recordings[1].fault_changes[0].text.removesuffix(": begins")
    plot_style.add_heading(figure, f"{name[:1].upper()}{name[1:]}", result.name)
    if path is not None:
        save_figure(figure, path, 150, overwrite)
    return figure


def _draw_pin(panel: Any, result: DemoResult, column: str) -> None:
    """Draw a lane for each run, filled while the pin is asserted."""
    for k, (recording, style) in enumerate(zip(result.recordings, STYLES, strict=True)):
        time, on, _ = _read_waveform(recording, column)
        low = 1 - k
        panel.fill_between(time, low + 0.15, low + 0.15 + 0.7 * on, step="post", color=style["color"], linewidth=0)
    panel.set_yticks([1.5, 0.5], ["healthy", "faulty"])
    panel.set_ylim(0, 2)


def _find_unit(column: str) -> str | None:
    """Return the unit of a column; None for a pin."""
    from stage.recording.recording import COLUMNS

    return COLUMNS[column][0] if column in COLUMNS else None


def _read_waveform(recording: Any, column: str) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return times in s, values, and whether each value holds until the next one, for a column of the first axis.

    Rates and pins are exact to a clock of the chip.
    """
    from stage.recording.pin_signals import is_asserted, to_pulse_rates

    name, axis = next(iter(recording.axes.items()))
    if _find_unit(column) is not None and column != "rate":
        return recording.column("time"), recording.column(f"{name}/{column}"), False
    waveform = recording.journals[name].replay_waveforms()
    values = (
        to_pulse_rates(waveform.edges, waveform.clock_hz)
        if column == "rate"
        else is_asserted(axis.chip, waveform.edges, column)
    )
    return recording.began + waveform.seconds, values, True


def _find_time_limits(result: DemoResult, begins: list[float]) -> tuple[float, float] | None:
    """Return the times, s, at which the picture begins and ends; None: the whole run.

    Args:
        result: Result of the demonstration.
        begins: Times at which the fault began in each run, s.
    """
    if result.demo.close_up is None:
        return None
    pin = next((column for column in result.demo.draws if _find_unit(column) is None), None)
    moment = begins[0]
    if pin is not None:
        time, on, _ = _read_waveform(result.recordings[1], pin)
        moment = float(time[on.argmax()])
    before, after = result.demo.close_up
    return moment + before, moment + after
