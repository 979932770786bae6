"""The series that a recording shows of an axis: title, unit, and tolerance of the drawn line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.units import DEGREES_PER_RAD, DEVIATION_UNITS, POSITION_UNITS, Unit

if TYPE_CHECKING:
    from stage.recording.recording import Recording


FORMAT_VERSION = 1
"""Version of the series and lanes in an .rrd file: counted up when what is read back would mean something else."""


class Series(NamedTuple):
    """Quantity of an axis that a recording plots.

    Attributes:
        title: Title of the plot.
        units: Unit for an axis on a slide joint, and for one on a hinge joint.
        scales: Factors from SI to these units.
        tolerance: Largest distance, in these units, between the drawn line and any sample.
        value: Function that computes the quantity from the samples of an axis.
        only: "stepper" or "servo" if only such axes have this series; "" if all have it.
        servo: Title and unit for a servo axis if they differ from those of a stepper axis; else None.
    """

    title: str
    units: tuple[str, str]
    scales: tuple[float, float]
    tolerance: float
    value: Callable[[np.ndarray], np.ndarray]
    only: str = ""
    servo: tuple[str, str] | None = None


def _split_symbols_and_factors(units: dict[str, Unit]) -> tuple[tuple[str, str], tuple[float, float]]:
    """Return the unit symbols and the factors from SI, each for (slide, hinge)."""
    slide, hinge = units["m"], units["rad"]
    return (slide.symbol, hinge.symbol), (slide.factor, hinge.factor)


SERIES = {
    "rate": Series(
        "Pulse rate", ("pps", "pps"), (1, 1), 0.5, lambda s: s["rate"], servo=("Commanded velocity", "counts/s")
    ),
    "position": Series("Position", *_split_symbols_and_factors(POSITION_UNITS), 2e-4, lambda s: s["position"]),
    "commanded": Series(
        "Commanded position", *_split_symbols_and_factors(POSITION_UNITS), 2e-4, lambda s: s["commanded"]
    ),
    "following_error": Series(
        "Following error", *_split_symbols_and_factors(DEVIATION_UNITS), 0.02, lambda s: s["commanded"] - s["position"]
    ),
    "voltage": Series("Motor voltage", ("V", "V"), (1, 1), 0.02, lambda s: s["voltage"], "servo"),
    "current": Series("Motor current", ("A", "A"), (1, 1), 0.005, lambda s: s["current_a"], "servo"),
    "load_angle": Series(
        "Load angle", ("electrical deg",) * 2, (DEGREES_PER_RAD,) * 2, 0.1, lambda s: s["load_angle"], "stepper"
    ),
    "lost_steps": Series("Lost steps", ("full steps",) * 2, (1, 1), 0, lambda s: s["lost_steps"], "stepper"),
    "counter": Series(
        "Counter", ("pulses",) * 2, (1, 1), 0.5, lambda s: s["counter"], servo=("Actual position", "counts")
    ),
}


def select_series(axis: Any, series: Mapping[str, Series] = SERIES) -> dict[str, Series]:
    """Return the entries of `series` that this axis has."""
    kind = "servo" if axis.drive.has_encoder else "stepper"
    return {key: s for key, s in series.items() if s.only in ("", kind)}


def describe_series(series: Series, axis: Any) -> tuple[str, str, float]:
    """Return the title, the unit and the factor from SI to that unit for one series of an axis."""
    on_hinge = axis.unit != "m"
    title, unit = series.servo if series.servo and axis.drive.has_encoder else (series.title, series.units[on_hinge])
    return title, unit, series.scales[on_hinge]


def list_axes_with_series(recording: Recording, series: str) -> list[str]:
    """Return the names of the axes that have a series."""
    return [name for name, axis in recording.axes.items() if series in select_series(axis)]


COLORS = {
    "red": (240, 96, 84), "green": (88, 190, 112), "blue": (88, 152, 245), "amber": (226, 172, 62), "violet": (172, 124, 232),
    "teal": (64, 190, 196),
}  # fmt: skip
"""Colors of the axes in the order of the axes; after the last color the first one follows again."""


def assign_colors(recording: Recording) -> dict[str, str]:
    """Return the color of each axis, by the name of the axis."""
    names = list(COLORS)
    return {name: names[k % len(names)] for k, name in enumerate(recording.axes)}


def make_plot_title(recording: Recording, series: str) -> str:
    """Return the title of the plot of a series over all axes that have it, with its units."""
    axes = [recording.axes[name] for name in list_axes_with_series(recording, series)]
    described = [describe_series(SERIES[series], axis)[:2] for axis in axes]
    title = next((t for t, _ in described if t == SERIES[series].title), described[0][0])
    if series == "counter" and title == SERIES[series].title:
        title = " ".join(dict.fromkeys([title, *(a.chip.COUNTER[0] for a in axes if not a.drive.has_encoder)]))
    return f"{title} ({' | '.join(sorted({unit for _, unit in described}, reverse=True))})"
