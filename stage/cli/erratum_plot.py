"""Picture of `stage erratum`: the drive with a bare 26h in area d, and with the work-around."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stage.units import POSITION_UNITS

if TYPE_CHECKING:
    from stage.cli.erratum import ErratumResult

CLOSE_UP_S = 0.06  # before area d, and after it
STATUS_LANES = {"ASND": "asnd", "CNST": "cnst", "DSND": "dsnd", "n-DRV": "drive"}


def draw_erratum_plot(result: ErratumResult, path: str | None, overwrite: bool) -> Any:
    """Draw rate and position of both runs, and next to them a close-up of the rate and the bits of RR1 around area d.

    Args:
        result: Result of the demonstration, with recordings.
        path: File to write; None: only return the figure.
        overwrite: Whether to overwrite an existing file.
    """
    from stage.support.files import save_figure
    from stage.support.plot_style import COLORS, MUTED_COLOR, TEXT_COLOR, make_figure, remove_frame, set_title

    fig = make_figure(11, 6)
    (rate, close), (place, lanes) = fig.subplots(2, 2)
    styles = ((COLORS[0], 1.6, "26h in area d", 2), (MUTED_COLOR, 3.0, "stop_by_speed", 1))
    areas, unit = _find_areas(result.recordings[0]), POSITION_UNITS[result.unit]
    for recording, (color, width, label, order) in zip(result.recordings, styles, strict=True):
        axis = next(iter(recording.axes))
        time, pps = recording.column("time"), recording.column(f"{axis}/rate")
        drawn = {"color": color, "linewidth": width, "label": label, "zorder": order}
        for panel in (rate, close):
            panel.plot(time, pps, **drawn)
        place.plot(time, recording.column(f"{axis}/position") * unit.factor, **drawn)
        place.plot(
            time, recording.column(f"{axis}/commanded") * unit.factor, color=color, linewidth=1, linestyle=(0, (2, 2))
        )
    _draw_bits(lanes, result.recordings[0], COLORS[0])
    begin, end = areas["d"]
    for panel in (close, lanes):
        panel.set_xlim(begin - CLOSE_UP_S, end + CLOSE_UP_S)
        panel.axvspan(begin, end, color=COLORS[0], alpha=0.15, linewidth=0)
    rate.set_ylim(top=1.12 * pps.max())
    initial = float(np.interp(areas["a"][0] + 1e-3, time, pps))
    close.set_ylim(0.97 * initial, 1.08 * initial)
    letters = {area: sum(areas[area]) / 2 for area in "abc"} | ({} if result.lacks_erratum else {"e": end + 0.9})
    for area, when in letters.items():
        rate.annotate(area, (when, 0.98), xycoords=("data", "axes fraction"), ha="center", va="top", color=TEXT_COLOR)
    for area, when in {"c": begin - CLOSE_UP_S / 2, "d": (begin + end) / 2, "e": end + CLOSE_UP_S / 2}.items():
        if area in letters or area == "d":
            close.annotate(area, (when, 0.92), xycoords=("data", "axes fraction"), ha="center", color=TEXT_COLOR)
    rate.set(ylabel="pulse rate (pps)")
    close.set(ylabel="pulse rate (pps)")
    place.set(ylabel=f"position ({unit.symbol})", xlabel="time (s)")
    lanes.set(xlabel="time (s)")
    titles = {
        rate: f"{result.chip}{', mended' if result.lacks_erratum else ''}: the drive",
        close: "The end of the deceleration; shaded: area d, up to 26h",
        place: "The carriage; dotted: what the pulses say",
        lanes: "RR1 and n-DRV after 26h in area d",
    }
    for panel, text in titles.items():
        remove_frame(panel)
        set_title(panel, text)
    lanes.grid(False, axis="y")
    rate.legend(frameon=False, fontsize=9, loc="center right")
    if path is not None:
        save_figure(fig, path, 150, overwrite)
    return fig


def _read_waveform(recording: Any) -> tuple[Any, np.ndarray]:
    """Return the times, s, and the rates, pps, of the first axis of a recording."""
    waveform = recording.journals[next(iter(recording.axes))].replay_waveforms()
    return waveform, recording.began + waveform.seconds


def _find_areas(recording: Any) -> dict[str, tuple[float, float]]:
    """Return begin and end, s, of each of the areas a to d of the notice, found from the chip's status pins."""
    waveform, time = _read_waveform(recording)
    asnd, cnst, dsnd = (waveform.pin(name) for name in ("asnd", "cnst", "dsnd"))

    def span(on: np.ndarray) -> tuple[float, float]:
        first = int(np.argmax(on))
        rest = np.flatnonzero(~on[first:])
        return float(time[first]), float(time[first + rest[0]] if len(rest) else time[-1])

    a, c = span(asnd), span(dsnd)
    return {"a": a, "b": (a[1], c[0]), "c": c, "d": span(cnst & (time >= c[1]))}


def _draw_bits(panel: Any, recording: Any, color: str) -> None:
    """Draw the bits of RR1 of a recording as lanes."""
    waveform, time = _read_waveform(recording)
    for k, pin in enumerate(reversed(STATUS_LANES.values())):
        panel.plot(time, k + 0.7 * waveform.pin(pin), drawstyle="steps-post", color=color, linewidth=1.6)
        panel.axhline(k, color=color, linewidth=0.5, alpha=0.4)
    panel.set_yticks([k + 0.35 for k in range(len(STATUS_LANES))], list(reversed(STATUS_LANES)))
