"""Procedures as forms: what each asks for, in the units of the axis, and how it is begun. No page.

    form = FORMS["move"]
    fields = form.fields(stage, "x")
    order = form.order(stage, "x", {"distance": "10", "speed": ""})       ArgumentError, or WrongField, says what is wrong
    session.act("move x", order).result()                                  a report

Empty fields are left to the procedure. Nothing here knows a chip: what can be done comes from its driver.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

from stage.errors import StageError
from stage.firmware import procedures
from stage.firmware.driver import Driver, driver_of
from stage.firmware.report import Procedure
from stage.panel.fields import Field, WrongField, checked, distance_of, needed, parsed, scale, speed_fields, speeds_of

if TYPE_CHECKING:
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

ALL = ""
"""The axis of a form that is about several."""


@dataclass(frozen=True)
class Form:
    """A procedure. fields: of an axis by its name, ALL for a form about several; begin: what the stage's thread is to call;
    finds_origin: after it one knows where the carriage is."""

    name: str
    title: str
    fields: Callable[[Stage, str], list[Field]]
    begin: Callable[[Stage, str, dict[str, Any]], Callable[[Stage], Any]]
    several: bool = False
    needs: Callable[[Stage, str], bool] = lambda stage, axis: True
    finds_origin: bool = False

    def order(self, stage: Stage, axis: str, given: Mapping[str, str]) -> Callable[[Stage], Any]:
        """What `Session.act` takes. Raises WrongField, ArgumentError."""
        return self.begin(stage, axis, parsed(self.fields(stage, axis), given))


# --- move ---


def _move_fields(stage: Stage, name: str) -> list[Field]:
    axis = stage.axes[name]
    shapes = ("straight", "S-curve")
    return [Field("distance", "distance", scale(axis)[0], "10"), *speed_fields(axis),
            Field("s_curve", "ramps", "", shapes[0], shapes)]  # fmt: skip


def _move(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    axis = stage.axes[name]
    distance = distance_of(axis, "distance", needed(values, "distance", "how far"))
    speeds, curved = speeds_of(axis, values), values.get("s_curve") == "S-curve"
    return lambda stage: procedures.move(axis, distance, s_curve=curved, **speeds)


# --- two rates ---


def _two_fields(stage: Stage, name: str) -> list[Field]:
    axis = stage.axes[name]
    unit, _ = scale(axis)
    return [Field("distance", "distance", unit, "40"), Field("speed", "first speed", f"{unit}/s", "20"),
            Field("fast", "second speed", f"{unit}/s", "40"), Field("dwell", "time at each", "s", "0.2"),
            Field("accel", "ramp", "s", "0.15")]  # fmt: skip


def _two(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    axis = stage.axes[name]
    _, k = scale(axis)
    pulses = procedures.pulses_of(axis, distance_of(axis, "distance", needed(values, "distance", "how far")), None)
    fast = needed(values, "fast", "how fast") * k / (axis.meters_per_pulse or 1.0)
    dwell, speeds = values.get("dwell", 0.2), checked(axis, speeds_of(axis, values))
    if not fast > 0:
        raise WrongField("fast", f"{values['fast']:g}: more than 0.")
    if dwell < 0:
        raise WrongField("dwell", f"{dwell:g}: 0 s or more.")
    return lambda stage: driver_of(axis).two_rates(pulses, speeds, fast, dwell)


# --- home ---

WAYS = ("minus", "plus")


def _home_fields(stage: Stage, name: str) -> list[Field]:
    axis = stage.axes[name]
    how = driver_of(axis).homings()
    return [
        Field("direction", "origin lies", "", WAYS[0], WAYS),
        Field("by", "by", "", how[0], how),
        *speed_fields(axis),
    ]


def _home(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    axis = stage.axes[name]
    direction, by = (1 if values.get("direction") == "plus" else -1), values.get("by")
    speeds = speeds_of(axis, values)
    return lambda stage: procedures.home(axis, direction, by=by, **speeds)


# --- line ---


def _line_fields(stage: Stage, name: str) -> list[Field]:
    distances = [
        Field(n, n, scale(a)[0], d) for (n, a), d in zip(stage.axes.items(), ("20", "-7.5", *[""] * 99), strict=False)
    ]
    return [*distances, *(f for f in speed_fields(next(iter(stage.axes.values()))) if f.name != "start_speed")]


def _line(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    distances = {n: distance_of(a, n, values[n]) for n, a in stage.axes.items() if values.get(n)}
    if not distances:
        raise WrongField(next(iter(stage.axes)), "nothing moves: give at least one axis a distance.")
    speeds = speeds_of(next(iter(stage.axes.values())), values)
    return lambda stage: procedures.line(distances, stage.axes, **speeds)


# --- circle ---


def _pairs(stage: Stage) -> list[str]:
    """Two axes of a chip that draws circles with them: "x y"."""
    axes = [a for a in stage.axes.values() if type(driver_of(a)).circle is not Driver.circle]
    return [f"{a.name} {b.name}" for a, b in combinations(axes, 2) if a.chip is b.chip and a.unit == b.unit]


def _circle_fields(stage: Stage, name: str) -> list[Field]:
    pairs = tuple(_pairs(stage))
    axis = stage.axes[pairs[0].split()[0]]
    unit, _ = scale(axis)
    return [Field("axes", "axes", "", pairs[0], pairs), Field("radius", "radius", unit, "5"), *speed_fields(axis)]


def _circle(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    first, second = (stage.axes[n] for n in values["axes"].split())
    radius = procedures.pulses_of(first, distance_of(first, "radius", needed(values, "radius", "how large")), None)
    speeds = checked(first, speeds_of(first, values))
    return lambda stage: driver_of(first).circle(driver_of(second), radius, speeds)


def _two_can(stage: Stage, name: str) -> bool:
    """Chips of one drive speed would make a plain move of it."""
    return type(driver_of(stage.axes[name])).two_rates is not Driver.two_rates


FORMS: dict[str, Form] = {
    f.name: f
    for f in (
        Form("move", "Move", _move_fields, _move),
        Form("two_rates", "Two rates", _two_fields, _two, needs=_two_can),
        Form("home", "Home", _home_fields, _home, finds_origin=True),
        Form("line", "Line", _line_fields, _line, several=True, needs=lambda stage, axis: len(stage.axes) > 1),
        Form("circle", "Circle", _circle_fields, _circle, several=True, needs=lambda stage, axis: bool(_pairs(stage))),
    )
}
"""Every form by name."""


class Jog:
    """An axis that runs while a button is held: `session.act("jog x", Jog(axis, 1, {"speed": "20"}).order)`, then `release()`.

    Raises WrongField, ArgumentError.
    """

    def __init__(self, axis: Axis, direction: int, given: Mapping[str, str]):
        self.axis, self.direction = axis, direction
        self._speeds = checked(axis, speeds_of(axis, parsed(speed_fields(axis), given)))
        self._released = threading.Event()

    def release(self) -> None:
        """The button is let go."""
        self._released.set()

    def order(self, stage: Stage) -> Any:
        """Run until the button is let go or something stops it; a report."""
        driver = driver_of(self.axis)
        driver.ready()
        with Procedure(self.axis, "jog") as p:
            driver.run(self.direction, self._speeds)
            stage.run_until(lambda: self._released.is_set() or not driver.runs(), 1e6)
            met = "" if driver.runs() else driver.explain_end(False, p.journal)
            driver.halt()
            report = p.report(met or "decelerating stop")
        if met and not report.pulses:
            raise self._stands(met)
        return report

    def _stands(self, limit: str) -> StageError:
        way = "+" if self.direction > 0 else "-"
        on = f", {limit}" if limit else ""
        return StageError(f"{self.axis.name} stands on its end limit{on}, and does not go {way}: jog the other way.")


def stopping(axes: list[str], at_once: bool) -> Callable[[Stage], None]:
    """Stop these axes, with a ramp or at once."""

    def order(stage: Stage) -> None:
        for name in axes:
            procedures.stop(stage.axes[name], at_once)

    return order


def picture(report: Any) -> str:
    """The operation pattern of a report as SVG. Raises StageError where matplotlib is not there."""
    figure = report.plot()
    if figure is None:
        raise StageError("this report draws no picture.")
    out = io.StringIO()
    figure.savefig(out, format="svg")
    text = out.getvalue()
    return text[text.index("<svg") :]
