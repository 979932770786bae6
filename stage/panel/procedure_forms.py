"""Forms of the procedures: the fields of each form, in units of the axis, and the call of stage.firmware that it makes.

This module draws no page.

    form = FORMS["move"]
    fields = form.list_fields(stage, "x")
    run = form.prepare(stage, "x", {"distance": "10", "speed": ""})        ArgumentError, or FieldError, says what is wrong
    session.act("move x", run).result()                                    a report

For an empty field, the procedure uses its default. This module knows no chip family: the host driver says what a chip can do, and
an error of the driver carries its bounds as numbers, which `to_field_error` converts to the unit of the field.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain, combinations, repeat
from math import inf, isfinite, radians
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.errors import ArgumentError, StageError, add_article
from stage.firmware import procedures
from stage.firmware.driver import Driver, get_driver
from stage.firmware.move_report import ProcedureObserver
from stage.panel.stage_thread import has_end_limits
from stage.units import parse_integer

if TYPE_CHECKING:
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

MAX_TRAVELS = {True: 10, False: 100}
"""Travels that a form moves, of an axis with end limits and of one that turns without end: every chip counts as far."""
MIN_SPEED_PPS = 1.0
MAX_RAMP_S = 60.0  # chips that take no more use the slowest ramp that they have, and report nothing
DIRECTIONS = {"minus": -1, "plus": 1}
RAMP_SHAPES = {"straight": False, "S-curve": True}
LINE_DEFAULTS = ("20", "-7.5")  # distances of the first axes
Values = dict[str, Any]


class FieldError(ArgumentError):
    """Error about the text that a user has given in the field named `field`."""

    def __init__(self, field: str, text: str):
        super().__init__(text)
        self.field = field


class FormField(NamedTuple):
    """Field of a form.

    Attributes:
        name: Name of the value.
        title: Label of the field.
        unit: Unit of the number; "" for a number without unit.
        default: Text of the field at first.
        choices: Texts to choose from; empty for a number.
        scale: SI value of one `unit`.
        least, most: Bounds of the number, in `unit`.
        allowed: Description of the bounds.
        is_signed: Whether the bounds hold for the magnitude of the number, which may have a sign.
        is_whole: Whether the number must be an integer; it may then be hexadecimal.
        missing: Error text for an empty field; "": the field may be empty.
    """

    name: str
    title: str
    unit: str = ""
    default: str = ""
    choices: tuple[str, ...] = ()
    scale: float = 1.0
    least: float = -inf
    most: float = inf
    allowed: str = ""
    is_signed: bool = False
    is_whole: bool = False
    missing: str = ""

    def parse(self, text: str) -> Any:
        """Return the value of a text: a choice, or a number in SI units. Raises FieldError if the text does not fit."""
        if self.choices:
            if text not in self.choices:
                raise FieldError(self.name, f"{text!r}: {', '.join(self.choices)}.")
            return text
        if self.is_whole:
            if (number := parse_integer(text)) is None:
                raise FieldError(self.name, f"{text!r} is not a whole number: 16, 0x10 or 10h.")
            return number
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            of_unit = f" of {self.unit}" if self.unit else ""
            raise FieldError(self.name, f"{text!r} is not a number{of_unit}.") from None
        if not isfinite(value):
            raise FieldError(self.name, f"{text!r} is not a finite number.")
        if not self.least <= (abs(value) if self.is_signed else value) <= self.most:
            raise FieldError(self.name, f"{value:g} {self.unit}: {self.allowed}.")
        return value * self.scale


def parse_fields(fields: list[FormField], texts: Mapping[str, Any]) -> Values:
    """Return the values of a form by name of the field, in SI units.

    An empty number field has no value; an empty choice has its default.

    Args:
        fields: Fields of the form.
        texts: Text of each field by its name; a field without entry has its default text.

    Raises:
        FieldError: A text does not fit its field, or a field that must not be empty is empty.
    """
    values: Values = {}
    for field in fields:
        text = str(texts.get(field.name, field.default) or "").strip() or (field.default if field.choices else "")
        if text:
            values[field.name] = field.parse(text)
        elif field.missing:
            raise FieldError(field.name, field.missing)
    return values


def find_field(error: BaseException, fields: list[FormField]) -> str:
    """Return the name of the field that an error concerns, or "" if it concerns none of these fields."""
    if isinstance(error, FieldError):
        return error.field
    text = str(error)
    return next((f.name for f in fields if text.startswith((f"{f.name}=", f"{f.name}:"))), "")


def find_display_unit(axis: Axis) -> tuple[str, float]:
    """Return the unit in which the panel shows positions of an axis ("mm" or "deg"), and its SI value."""
    return ("mm", 1e-3) if axis.unit == "m" else ("deg", radians(1))


def to_field_error(error: StageError, axis: Axis, texts: Mapping[str, Any], fields: list[FormField]) -> StageError:
    """Convert an error about a limit of a chip to a FieldError with bounds in the field's unit. Return any other error unchanged.

    Args:
        error: Error of a procedure.
        axis: Axis for which the form was filled in.
        texts: Texts of the fields, by name.
        fields: Fields of the form.
    """
    limit, by_name = getattr(error, "exceeded_limit", None), {f.name: f for f in fields}
    if limit is None:
        return error
    name, bounds = limit.quantity, (limit.minimum, limit.maximum, limit.value)
    if name == "acceleration":  # the form has the time that a ramp to the drive speed takes
        speed = by_name["speed"].parse(str(texts["speed"])) if texts.get("speed") else None
        drive = procedures.parse_speeds(axis, {"speed": speed}).drive
        name, bounds = "accel", (drive / limit.maximum, drive / limit.minimum, drive / limit.value)
    elif name != "accel":
        pulse = (axis.meters_per_pulse or 1.0) / find_display_unit(axis)[1]
        bounds = tuple(bound * pulse for bound in bounds)
    if name == "pulses":
        name = "distance"
    elif name == "start_speed" and not texts.get("start_speed"):
        name = "speed"
    if name not in by_name:
        return error
    least, most, value = bounds
    allowed = f"{least:.3g} to {most:.3g}" if isfinite(most) else f"{least:.3g} or more"
    if not least:
        allowed = f"up to {most:.3g}"
    unit = by_name[name].unit
    return FieldError(name, f"{value:.4g} {unit}: {add_article(axis.chip.MAP.chip)} makes {allowed} {unit} here.")


def build_distance_field(axis: Axis, name: str, title: str, default: str, missing: str = "") -> FormField:
    """Build the field of a distance, whose bounds are one pulse and a multiple of the axis' travel."""
    unit, scale = find_display_unit(axis)
    travels = MAX_TRAVELS[has_end_limits(axis)]
    pulse, most = (axis.meters_per_pulse or 0.0) / scale, travels * (axis.travel[1] - axis.travel[0]) / scale
    allowed = (
        f"at least one pulse, {pulse:.4g} {unit}, and up to {most:g} {unit}, {travels} times the travel of {axis.name}"
    )
    return FormField(
        name, title, unit, default, scale=scale, least=0.5 * pulse, most=most, allowed=allowed, is_signed=True, missing=missing
    )  # fmt: skip


def build_speed_field(axis: Axis, name: str, title: str, default: str = "", missing: str = "") -> FormField:
    """Build the field of a speed of at least one pulse a second."""
    length, scale = find_display_unit(axis)
    unit, least = f"{length}/s", (axis.meters_per_pulse or 0.0) * MIN_SPEED_PPS / scale
    allowed = f"a speed is more than 0, and one pulse a second, {least:.3g} {unit}, or more"
    return FormField(name, title, unit, default, scale=scale, least=least, allowed=allowed, missing=missing)


def list_speed_fields(axis: Axis) -> list[FormField]:
    """Return the fields for the speeds and the ramp of a move of an axis."""
    start = [] if get_driver(axis).has_position_loop else [build_speed_field(axis, "start_speed", "start speed")]
    return [build_speed_field(axis, "speed", "speed"), *start, RAMP_FIELD]


RAMP_FIELD = FormField(
    "accel", "ramp", "s", "0.15", least=1e-9, most=MAX_RAMP_S, allowed=f"a ramp takes more than 0 and up to {MAX_RAMP_S:g} s"
)  # fmt: skip


@dataclass(frozen=True)
class ProcedureForm:
    """Form of a procedure.

    Attributes:
        name: Name for programs.
        title: Name for people.
        list_fields: Function that returns the fields for a stage and the name of an axis.
        begin: Function of the stage, the name of an axis and the values of the fields. It returns the function that the stage's
            thread then calls to perform the procedure.
        is_for_several_axes: Whether the procedure moves several axes.
        is_available: Function that returns whether the stage and the axis can perform the procedure.
        finds_origin: Whether the position of the carriage is known after the procedure.
    """

    name: str
    title: str
    list_fields: Callable[[Stage, str], list[FormField]]
    begin: Callable[[Stage, str, Values], Callable[[Stage], Any]]
    is_for_several_axes: bool = False
    is_available: Callable[[Stage, str], bool] = lambda stage, axis: True
    finds_origin: bool = False

    def prepare(self, stage: Stage, axis: str, texts: Mapping[str, str]) -> Callable[[Stage], Any]:
        """Return the function that performs the procedure, for `Session.act`.

        Args:
            stage: The stage.
            axis: Name of an axis.
            texts: Text of each field by its name.

        Raises:
            FieldError: A text does not fit its field.
            ArgumentError: The chip cannot perform the procedure with these values.
        """
        return self.begin(stage, axis, parse_fields(self.list_fields(stage, axis), texts))


def list_move_fields(stage: Stage, axis_name: str) -> list[FormField]:
    """Return the fields of a move."""
    axis, shapes = stage.axes[axis_name], tuple(RAMP_SHAPES)
    distance = build_distance_field(axis, "distance", "distance", "10", "say how far.")
    return [distance, *list_speed_fields(axis), FormField("s_curve", "ramps", default=shapes[0], choices=shapes)]


def prepare_move(stage: Stage, axis_name: str, values: Values) -> Callable[[Stage], Any]:
    """Return the function that performs a move with the values of the form."""
    values["s_curve"] = RAMP_SHAPES[values["s_curve"]]
    return lambda stage: procedures.move(stage.axes[axis_name], **values)


def list_two_rate_fields(stage: Stage, axis_name: str) -> list[FormField]:
    """Return the fields of a move with two drive speeds."""
    axis = stage.axes[axis_name]
    return [
        build_distance_field(axis, "distance", "distance", "40", "say how far."),
        build_speed_field(axis, "speed", "first speed", "20"),
        build_speed_field(axis, "fast", "second speed", "40", "say how fast."),
        FormField("dwell", "time at each", "s", "0.2", least=0.0, allowed="a time is 0 s or more"),
        RAMP_FIELD,
    ]


def prepare_two_rate_move(stage: Stage, axis_name: str, values: Values) -> Callable[[Stage], Any]:
    """Return the function that performs a move with two drive speeds, with the values of the form."""
    axis = stage.axes[axis_name]
    distance, second = values["distance"], values["fast"] / (axis.meters_per_pulse or 1.0)
    speeds, dwell = procedures.parse_speeds(axis, values).with_second_rate(second), values.get("dwell", 0.2)
    return lambda stage: procedures.move_at_two_rates(axis, distance, speed=speeds, dwell=dwell)


def has_two_rates(stage: Stage, axis_name: str) -> bool:
    """Return whether the chip of an axis has two drive speeds. Other chips would make a move with one speed."""
    return "second" in get_driver(stage.axes[axis_name]).OPTIONS


def list_home_fields(stage: Stage, axis_name: str) -> list[FormField]:
    """Return the fields of an origin return."""
    axis, directions = stage.axes[axis_name], tuple(DIRECTIONS)
    homings = get_driver(axis).list_homing_methods()
    return [
        FormField("direction", "origin lies", default=directions[0], choices=directions),
        FormField("by", "by", default=homings[0], choices=homings),
        *list_speed_fields(axis),
    ]


def prepare_home(stage: Stage, axis_name: str, values: Values) -> Callable[[Stage], Any]:
    """Return the function that performs an origin return with the values of the form."""
    values["direction"] = DIRECTIONS[values["direction"]]
    return lambda stage: procedures.home(stage.axes[axis_name], **values)


def list_line_fields(stage: Stage, axis_name: str) -> list[FormField]:
    """Return the fields of a line: a distance for each axis, the speed and the ramp."""
    defaults = chain(LINE_DEFAULTS, repeat(""))
    distances = [
        build_distance_field(axis, n, n, d) for (n, axis), d in zip(stage.axes.items(), defaults, strict=False)
    ]
    distances = [field._replace(least=0.0) for field in distances]  # 0 keeps an axis still
    return [*distances, build_speed_field(next(iter(stage.axes.values())), "speed", "speed"), RAMP_FIELD]


def prepare_line(stage: Stage, axis_name: str, values: Values) -> Callable[[Stage], Any]:
    """Return the function that moves the axes along a line, with the values of the form."""
    distances = {n: distance for n in stage.axes if (distance := values.pop(n, 0.0))}
    if not distances:
        raise FieldError(next(iter(stage.axes)), "nothing moves: give at least one axis a distance.")
    return lambda stage: procedures.line(distances, stage.axes, **values)


def list_circle_pairs(stage: Stage) -> list[str]:
    """Return the pairs of axes whose chip can draw circles with them, each as a text such as "x y"."""
    axes = [a for a in stage.axes.values() if type(get_driver(a)).draw_circle is not Driver.draw_circle]
    return [f"{a.name} {b.name}" for a, b in combinations(axes, 2) if a.chip is b.chip and a.unit == b.unit]


def list_circle_fields(stage: Stage, axis_name: str) -> list[FormField]:
    """Return the fields of a circle."""
    pairs = tuple(list_circle_pairs(stage))
    axis = stage.axes[pairs[0].split()[0]]
    radius = build_distance_field(axis, "radius", "radius", "5", "say how large.")
    return [FormField("axes", "axes", default=pairs[0], choices=pairs), radius, *list_speed_fields(axis)]


def prepare_circle(stage: Stage, axis_name: str, values: Values) -> Callable[[Stage], Any]:
    """Return the function that draws a circle with the values of the form."""
    first, second = (stage.axes[n] for n in values["axes"].split())
    radius, speeds = procedures.convert_to_pulses(first, values["radius"], None), procedures.parse_speeds(first, values)
    return lambda stage: get_driver(first).draw_circle(get_driver(second), radius, speeds)


FORMS: dict[str, ProcedureForm] = {
    form.name: form
    for form in (
        ProcedureForm("move", "Move", list_move_fields, prepare_move),
        ProcedureForm("two_rates", "Two rates", list_two_rate_fields, prepare_two_rate_move, is_available=has_two_rates),
        ProcedureForm("home", "Home", list_home_fields, prepare_home, finds_origin=True),
        ProcedureForm("line", "Line", list_line_fields, prepare_line, True, lambda stage, axis: len(stage.axes) > 1),
        ProcedureForm("circle", "Circle", list_circle_fields, prepare_circle, True, lambda s, axis: bool(list_circle_pairs(s))),
    )
}  # fmt: skip
"""Every form by name."""


def list_jog_fields(axis: Axis) -> list[FormField]:
    """Return the fields of a jog."""
    return [field for field in list_speed_fields(axis) if field.name != "start_speed"]


class Jog:
    """Move of an axis for as long as a button is held: `session.act("jog x", Jog(axis, 1, {"speed": "20"}).run)`, then `release()`.

    Args:
        axis: The axis.
        direction: +1 or -1.
        texts: Text of each field of `list_jog_fields` by its name.

    Raises:
        FieldError: A text does not fit its field.
        ArgumentError: The chip cannot make this speed.
    """

    def __init__(self, axis: Axis, direction: int, texts: Mapping[str, str]):
        self.axis, self.direction = axis, direction
        self._speeds = procedures.parse_speeds(axis, parse_fields(list_jog_fields(axis), texts))
        self._released = threading.Event()

    def release(self) -> None:
        """End the move: the axis decelerates and stops."""
        self._released.set()

    def run(self, stage: Stage) -> Any:
        """Move the axis until `release`, or until something stops it; return a report.

        Raises:
            StageError: The axis stands on the end limit of this direction and cannot move.
        """
        driver = get_driver(self.axis)
        driver.prepare()
        with ProcedureObserver(self.axis, "jog") as p:
            driver.start_continuous_move(self.direction, self._speeds)
            stage.run_until(lambda: self._released.is_set() or not driver.is_running(), 1e6)
            stopped_by = "" if driver.is_running() else driver.explain_end(False, p.journal)
            driver.halt()
            report = p.make_report(stopped_by or "decelerating stop")
        if stopped_by and not report.pulses:
            sign = "+" if self.direction > 0 else "-"
            raise StageError(
                f"{self.axis.name} stands on its end limit, {stopped_by}, and does not go {sign}: jog the other way."
            )
        return report


def render_operation_pattern_svg(report: Any) -> str:
    """Return the operation pattern of a report as SVG. Raises StageError if the report has none or matplotlib is missing."""
    figure = report.plot()
    if figure is None:
        raise StageError("this report draws no picture.")
    out = io.StringIO()
    figure.savefig(out, format="svg")
    text = out.getvalue()
    return text[text.index("<svg") :]
