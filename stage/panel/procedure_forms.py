"""Procedures as forms: the fields of each, in the units of the axis, and how it begins. No page.

    form = FORMS["move"]
    fields = form.fields(stage, "x")
    run = form.prepare(stage, "x", {"distance": "10", "speed": ""})        ArgumentError, or FieldError, says what is wrong
    session.act("move x", run).result()                                    a report

Fields that are empty are left to the procedure. Nothing here knows a chip: what can be done comes from its driver, and what a chip
cannot do comes as the numbers of the driver's error, which `to_field_error` tells in the unit of the field.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from math import isfinite, radians
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.errors import ArgumentError, StageError, a_or_an
from stage.firmware import procedures
from stage.firmware.driver import Driver, driver_of
from stage.firmware.report import Procedure
from stage.panel.stage_thread import has_end_limits

if TYPE_CHECKING:
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage


MAX_TRAVELS = {
    True: 10,
    False: 100,
}  # travels, of an axis that has end limits and of one that turns without end: no chip counts less
SLOWEST = 1.0  # pulses a second
MAX_RAMP_S = 60.0  # s: chips that take no more fall back on the slowest ramp that they have, without a word


class Field(NamedTuple):
    """Field of a form.

    Attributes:
        name: Name of the value.
        title: Label.
        unit: "" of a number without one.
        default: As text.
        choices: What can be chosen; empty: a number.
    """

    name: str
    title: str
    unit: str = ""
    default: str = ""
    choices: tuple[str, ...] = ()


class FieldError(ArgumentError):
    """Error about what a user typed in `field`; the text says why it cannot be."""

    def __init__(self, field: str, text: str):
        super().__init__(text)
        self.field = field


def parse_fields(fields: list[Field], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a form's texts; empty ones are left out. Raises FieldError."""
    out: dict[str, Any] = {}
    for field in fields:
        text = str(given.get(field.name, field.default) or "").strip()
        if not text:
            continue
        if field.choices:
            if text not in field.choices:
                raise FieldError(field.name, f"{text!r}: {', '.join(field.choices)}.")
            out[field.name] = text
            continue
        try:
            out[field.name] = float(text.replace(",", "."))
        except ValueError:
            raise FieldError(
                field.name, f"{text!r} is not a number{f' of {field.unit}' if field.unit else ''}."
            ) from None
        if not isfinite(out[field.name]):
            raise FieldError(field.name, f"{text!r}: a finite number.")
    return out


def find_scale(axis: Axis) -> tuple[str, float]:
    """Return the unit that people use of an axis, and what it is in the stage's."""
    return ("mm", 1e-3) if axis.unit == "m" else ("deg", radians(1))


def to_field_error(error: StageError, axis: Axis, given: Mapping[str, Any], fields: list[Field]) -> StageError:
    """Return an error about what a chip cannot do as one of its field, in its unit; an error about no field as it is."""
    limit, names = getattr(error, "limit", None), {f.name: f for f in fields}
    if limit is None:
        return error
    name, least, most, value = limit.what, limit.least, limit.most, limit.given
    if name == "acceleration":  # of a ramp as long as its speed takes
        drive = procedures.parse_speeds(axis, {"speed": _typed(given, "speed", axis)}).drive
        name, least, most, value = "accel", drive / most, drive / least, drive / value
    elif name != "accel":
        pulse = (axis.meters_per_pulse or 1.0) / find_scale(axis)[1]
        least, most, value = least * pulse, most * pulse, value * pulse
    name = {"pulses": "distance", "start_speed": "start_speed" if given.get("start_speed") else "speed"}.get(name, name)
    if name not in names:
        return error
    ends = (
        f"{least:.3g} to {most:.3g}"
        if least and isfinite(most)
        else f"{least:.3g} or more"
        if least
        else f"up to {most:.3g}"
    )
    unit = names[name].unit
    return FieldError(name, f"{value:.4g} {unit}: {a_or_an(axis.chip.MAP.chip)} makes {ends} {unit} here.")


def _typed(given: Mapping[str, Any], name: str, axis: Axis) -> float | None:
    """Return a speed that a user typed, m/s; None: none."""
    text = str(given.get(name) or "").strip().replace(",", ".")
    return float(text) * find_scale(axis)[1] if text else None


def find_field(error: BaseException, fields: list[Field]) -> str:
    """Return the field that an error is about, or ""."""
    if isinstance(error, FieldError):
        return error.field
    text = str(error)
    return next((f.name for f in fields if text.startswith((f"{f.name}=", f"{f.name}:"))), "")


def require(values: dict[str, Any], name: str, what: str) -> Any:
    """Return a value of a form. Raises FieldError where it is empty."""
    if name not in values:
        raise FieldError(name, f"say {what}.")
    return values[name]


def list_speed_fields(axis: Axis) -> list[Field]:
    """Return the fields of speed and ramp that an axis has."""
    unit, _ = find_scale(axis)
    fields = [Field("speed", "speed", f"{unit}/s")]
    if not driver_of(axis).has_position_loop:
        fields.append(Field("start_speed", "start speed", f"{unit}/s"))
    return [*fields, Field("accel", "ramp", "s", "0.15")]


def parse_distance(axis: Axis, name: str, value: float) -> float:
    """Return a typed distance in m (rad). Raises FieldError for less than a pulse, and for many times the travel."""
    unit, k = find_scale(axis)
    pulse, most = (
        (axis.meters_per_pulse or 0.0) / k,
        MAX_TRAVELS[has_end_limits(axis)] * (axis.travel[1] - axis.travel[0]) / k,
    )
    if abs(value) < 0.5 * pulse:
        raise FieldError(name, f"{value:g} {unit}: less than a pulse, which is {pulse:.4g} {unit}.")
    if abs(value) > most:
        raise FieldError(name, f"{value:g} {unit}: up to {most:g} {unit}, many times the travel of {axis.name}.")
    return value * k


def parse_speeds(axis: Axis, values: dict[str, Any]) -> dict[str, Any]:
    """Return typed speeds and ramp in m/s (rad/s) and s. Raises FieldError."""
    _, k = find_scale(axis)
    out: dict[str, Any] = {}
    for name, factor in (("speed", k), ("start_speed", k), ("accel", 1.0)):
        if name in values:
            if not values[name] > 0:
                raise FieldError(name, f"{values[name]:g}: more than 0.")
            if name == "accel" and values[name] > MAX_RAMP_S:
                raise FieldError(name, f"{values[name]:g} s: up to {MAX_RAMP_S:g} s.")
            out[name] = values[name] * factor
            least = (axis.meters_per_pulse or 0.0) * SLOWEST
            if name != "accel" and out[name] < least:
                unit = f"{find_scale(axis)[0]}/s"
                raise FieldError(name, f"{values[name]:g} {unit}: {least / k:.3g} {unit}, a pulse a second, or more.")
    return out


ALL_AXES = ""
"""The axis of a form that is about several."""


@dataclass(frozen=True)
class ProcedureForm:
    """Form of a procedure.

    Attributes:
        name, title: For programs, and for people.
        fields: Returns the fields for an axis, by its name; ALL_AXES for a form about several.
        begin: Returns what the stage's thread is to call, for the values of the fields.
        several: It is about several axes.
        needs: Whether the stage and axis can do it.
        finds_origin: After it one knows where the carriage is.
    """

    name: str
    title: str
    fields: Callable[[Stage, str], list[Field]]
    begin: Callable[[Stage, str, dict[str, Any]], Callable[[Stage], Any]]
    several: bool = False
    needs: Callable[[Stage, str], bool] = lambda stage, axis: True
    finds_origin: bool = False

    def prepare(self, stage: Stage, axis: str, given: Mapping[str, str]) -> Callable[[Stage], Any]:
        """Return what `Session.act` takes. Raises FieldError, ArgumentError."""
        return self.begin(stage, axis, parse_fields(self.fields(stage, axis), given))


# --- move ---


def _move_fields(stage: Stage, name: str) -> list[Field]:
    axis = stage.axes[name]
    shapes = ("straight", "S-curve")
    return [Field("distance", "distance", find_scale(axis)[0], "10"), *list_speed_fields(axis),
            Field("s_curve", "ramps", "", shapes[0], shapes)]  # fmt: skip


def _move(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    axis = stage.axes[name]
    distance = parse_distance(axis, "distance", require(values, "distance", "how far"))
    speeds, curved = parse_speeds(axis, values), values.get("s_curve") == "S-curve"
    return lambda stage: procedures.move(axis, distance, s_curve=curved, **speeds)


# --- two rates ---


def _two_fields(stage: Stage, name: str) -> list[Field]:
    axis = stage.axes[name]
    unit, _ = find_scale(axis)
    return [Field("distance", "distance", unit, "40"), Field("speed", "first speed", f"{unit}/s", "20"),
            Field("fast", "second speed", f"{unit}/s", "40"), Field("dwell", "time at each", "s", "0.2"),
            Field("accel", "ramp", "s", "0.15")]  # fmt: skip


def _two(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    axis = stage.axes[name]
    _, k = find_scale(axis)
    pulses = procedures.pulses_of(axis, parse_distance(axis, "distance", require(values, "distance", "how far")), None)
    fast = require(values, "fast", "how fast") * k / (axis.meters_per_pulse or 1.0)
    dwell, speeds = values.get("dwell", 0.2), procedures.parse_speeds(axis, parse_speeds(axis, values))
    if not fast > 0:
        raise FieldError("fast", f"{values['fast']:g}: more than 0.")
    if dwell < 0:
        raise FieldError("dwell", f"{dwell:g}: 0 s or more.")
    return lambda stage: procedures.two_rates(axis, pulses=pulses, speed=speeds.with_second(fast), dwell=dwell)


# --- home ---

DIRECTIONS = ("minus", "plus")


def _home_fields(stage: Stage, name: str) -> list[Field]:
    axis = stage.axes[name]
    how = driver_of(axis).homings()
    return [
        Field("direction", "origin lies", "", DIRECTIONS[0], DIRECTIONS),
        Field("by", "by", "", how[0], how),
        *list_speed_fields(axis),
    ]


def _home(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    axis = stage.axes[name]
    direction, by = (1 if values.get("direction") == "plus" else -1), values.get("by")
    speeds = parse_speeds(axis, values)
    return lambda stage: procedures.home(axis, direction, by=by, **speeds)


# --- line ---


def _line_fields(stage: Stage, name: str) -> list[Field]:
    distances = [
        Field(n, n, find_scale(a)[0], d)
        for (n, a), d in zip(stage.axes.items(), ("20", "-7.5", *[""] * 99), strict=False)
    ]
    return [*distances, *(f for f in list_speed_fields(next(iter(stage.axes.values()))) if f.name != "start_speed")]


def _line(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    distances = {n: parse_distance(a, n, values[n]) for n, a in stage.axes.items() if values.get(n)}
    if not distances:
        raise FieldError(next(iter(stage.axes)), "nothing moves: give at least one axis a distance.")
    speeds = parse_speeds(next(iter(stage.axes.values())), values)
    return lambda stage: procedures.line(distances, stage.axes, **speeds)


# --- circle ---


def _pairs(stage: Stage) -> list[str]:
    """Return two axes each of a chip that draws circles with them: "x y"."""
    axes = [a for a in stage.axes.values() if type(driver_of(a)).circle is not Driver.circle]
    return [f"{a.name} {b.name}" for a, b in combinations(axes, 2) if a.chip is b.chip and a.unit == b.unit]


def _circle_fields(stage: Stage, name: str) -> list[Field]:
    pairs = tuple(_pairs(stage))
    axis = stage.axes[pairs[0].split()[0]]
    unit, _ = find_scale(axis)
    return [Field("axes", "axes", "", pairs[0], pairs), Field("radius", "radius", unit, "5"), *list_speed_fields(axis)]


def _circle(stage: Stage, name: str, values: dict[str, Any]) -> Callable[[Stage], Any]:
    first, second = (stage.axes[n] for n in values["axes"].split())
    radius = procedures.pulses_of(first, parse_distance(first, "radius", require(values, "radius", "how large")), None)
    speeds = procedures.parse_speeds(first, parse_speeds(first, values))
    return lambda stage: driver_of(first).circle(driver_of(second), radius, speeds)


def _two_can(stage: Stage, name: str) -> bool:
    """Return whether the chip has two drive speeds; others would make a plain move of it."""
    return "second" in driver_of(stage.axes[name]).OPTIONS


FORMS: dict[str, ProcedureForm] = {
    f.name: f
    for f in (
        ProcedureForm("move", "Move", _move_fields, _move),
        ProcedureForm("two_rates", "Two rates", _two_fields, _two, needs=_two_can),
        ProcedureForm("home", "Home", _home_fields, _home, finds_origin=True),
        ProcedureForm("line", "Line", _line_fields, _line, several=True, needs=lambda stage, axis: len(stage.axes) > 1),
        ProcedureForm(
            "circle", "Circle", _circle_fields, _circle, several=True, needs=lambda stage, axis: bool(_pairs(stage))
        ),
    )
}
"""Every form by name."""


class Jog:
    """Axis that runs while a button is held: `session.act("jog x", Jog(axis, 1, {"speed": "20"}).run)`, then `release()`.

    Raises:
        FieldError: A text does not fit its field.
        ArgumentError: The chip cannot go so fast.
    """

    def __init__(self, axis: Axis, direction: int, given: Mapping[str, str]):
        self.axis, self.direction = axis, direction
        typed = parse_speeds(axis, parse_fields(list_speed_fields(axis), given))
        self._speeds = procedures.parse_speeds(axis, typed)
        self._released = threading.Event()

    def release(self) -> None:
        """End the run: the button is let go."""
        self._released.set()

    def run(self, stage: Stage) -> Any:
        """Run until the button is let go or something stops the axis; return a report."""
        driver = driver_of(self.axis)
        driver.prepare()
        with Procedure(self.axis, "jog") as p:
            driver.run(self.direction, self._speeds)
            stage.run_until(lambda: self._released.is_set() or not driver.is_running(), 1e6)
            met = "" if driver.is_running() else driver.explain_end(False, p.journal)
            driver.halt()
            report = p.report(met or "decelerating stop")
        if met and not report.pulses:
            raise self._stands(met)
        return report

    def _stands(self, limit: str) -> StageError:
        way = "+" if self.direction > 0 else "-"
        on = f", {limit}" if limit else ""
        return StageError(f"{self.axis.name} stands on its end limit{on}, and does not go {way}: jog the other way.")


def draw_pattern(report: Any) -> str:
    """Return the operation pattern of a report as SVG. Raises StageError where matplotlib is missing."""
    figure = report.plot()
    if figure is None:
        raise StageError("this report draws no picture.")
    out = io.StringIO()
    figure.savefig(out, format="svg")
    text = out.getvalue()
    return text[text.index("<svg") :]
