"""The series that a recording shows of an axis: what each is called, in which units, and how exactly it is drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.units import DEGREES, PLACES, SMALL, Unit

if TYPE_CHECKING:
    from stage.recording.recording import Recording


FORMAT = 1
"""Of what an .rrd file has of series and lanes: counted up when what is read back would mean something else."""


class Series(NamedTuple):
    """A plot: `value` of the samples of an axis times `scale`, within `tolerance`; (slide, hinge) where they differ.

    only: "stepper" or "servo" where the other kind of axis has none. servo: title and unit of a servo, where they differ."""

    title: str
    units: tuple[str, str]
    scales: tuple[float, float]
    tolerance: float
    value: Callable[[np.ndarray], np.ndarray]
    only: str = ""
    servo: tuple[str, str] | None = None


def _of(units: dict[str, Unit]) -> tuple[tuple[str, str], tuple[float, float]]:
    slide, hinge = units["m"], units["rad"]
    return (slide.symbol, hinge.symbol), (slide.per, hinge.per)


SERIES = {
    "rate": Series(
        "Pulse rate", ("pps", "pps"), (1, 1), 0.5, lambda s: s["rate"], servo=("Commanded velocity", "counts/s")
    ),
    "position": Series("Position", *_of(PLACES), 2e-4, lambda s: s["position"]),
    "commanded": Series("Commanded position", *_of(PLACES), 2e-4, lambda s: s["commanded"]),
    "following_error": Series("Following error", *_of(SMALL), 0.02, lambda s: s["commanded"] - s["position"]),
    "voltage": Series("Motor voltage", ("V", "V"), (1, 1), 0.02, lambda s: s["voltage"], "servo"),
    "current": Series("Motor current", ("A", "A"), (1, 1), 0.005, lambda s: s["current_a"], "servo"),
    "load_angle": Series(
        "Load angle", ("electrical deg",) * 2, (DEGREES,) * 2, 0.1, lambda s: s["load_angle"], "stepper"
    ),
    "lost_steps": Series("Lost steps", ("full steps",) * 2, (1, 1), 0, lambda s: s["lost_steps"], "stepper"),
    "counter": Series(
        "Counter", ("pulses",) * 2, (1, 1), 0.5, lambda s: s["counter"], servo=("Actual position", "counts")
    ),
}


def series_of(axis: Any) -> dict[str, Series]:
    """The series that an axis has."""
    return {key: s for key, s in SERIES.items() if s.only in ("", "servo" if axis.drive.has_encoder else "stepper")}


def axes_with(recording: Recording, series: str) -> list[str]:
    """The names of the axes that have a series."""
    return [name for name, axis in recording.axes.items() if series in series_of(axis)]


COLOURS = {
    "red": (240, 96, 84), "green": (88, 190, 112), "blue": (88, 152, 245), "amber": (226, 172, 62), "violet": (172, 124, 232),
    "teal": (64, 190, 196),
}  # fmt: skip
"""Of the axes, in their order, and again from the first."""


def colours_of(recording: Recording) -> dict[str, str]:
    """The name of each axis' colour."""
    names = list(COLOURS)
    return {name: names[k % len(names)] for k, name in enumerate(recording.axes)}


def heading(recording: Recording, series: str) -> str:
    """What a plot of a series over all axes that have it is called, with its units."""
    spec, axes = SERIES[series], [recording.axes[name] for name in axes_with(recording, series)]
    title, units = spec.title, {spec.units[a.unit != "m"] for a in axes if not (a.drive.has_encoder and spec.servo)}
    if series == "counter":
        title = " ".join([title, *dict.fromkeys(a.chip.COUNTER[0] for a in axes if not a.drive.has_encoder)])
    if spec.servo and any(a.drive.has_encoder for a in axes):
        title = title if units else spec.servo[0]
        units = {*units, spec.servo[1]}
    return f"{title} ({' | '.join(sorted(units, reverse=True))})"
