"""Fields of forms: what somebody types, in the unit of its axis, and what is wrong with it. No page.

    parsed(fields, {"distance": "2,5", "speed": ""})       {"distance": 2.5}
    at_its_field(error, axis, given, fields)               what a chip cannot do, said in the field's unit

Nothing here knows a chip: what it can comes as the numbers of its driver's error.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, radians
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.errors import ArgumentError, StageError, a_or_an
from stage.firmware import procedures
from stage.panel.stage_thread import has_end_limits

if TYPE_CHECKING:
    from stage.sim.axis import Axis

FAR = {
    True: 10,
    False: 100,
}  # travels, of an axis that has end limits and of one that turns without end: no chip counts less
SLOWEST = 1.0  # pulses a second
LONGEST_RAMP = 60.0  # s: chips that take no more fall back on the slowest ramp that they have, without a word


class Field(NamedTuple):
    """One value. unit: "" of a number without; choices: what can be had, else a number; default: as text."""

    name: str
    title: str
    unit: str = ""
    default: str = ""
    choices: tuple[str, ...] = ()


class WrongField(ArgumentError):
    """What somebody typed in `field` cannot be; the text says why."""

    def __init__(self, field: str, text: str):
        super().__init__(text)
        self.field = field


def parsed(fields: list[Field], given: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a form's texts; empty ones are left out. Raises WrongField."""
    out: dict[str, Any] = {}
    for field in fields:
        text = str(given.get(field.name, field.default) or "").strip()
        if not text:
            continue
        if field.choices:
            if text not in field.choices:
                raise WrongField(field.name, f"{text!r}: {', '.join(field.choices)}.")
            out[field.name] = text
            continue
        try:
            out[field.name] = float(text.replace(",", "."))
        except ValueError:
            raise WrongField(
                field.name, f"{text!r} is not a number{f' of {field.unit}' if field.unit else ''}."
            ) from None
        if not isfinite(out[field.name]):
            raise WrongField(field.name, f"{text!r}: a finite number.")
    return out


def scale(axis: Axis) -> tuple[str, float]:
    """The unit that people use of an axis, and what it is in the stage's."""
    return ("mm", 1e-3) if axis.unit == "m" else ("deg", radians(1))


def at_its_field(error: StageError, axis: Axis, given: Mapping[str, Any], fields: list[Field]) -> StageError:
    """What a chip cannot do, said at the field and in its unit; what is about no field as it is."""
    limit, names = getattr(error, "limit", None), {f.name: f for f in fields}
    if limit is None:
        return error
    name, least, most, value = limit.what, limit.least, limit.most, limit.given
    if name == "acceleration":  # of a ramp as long as its speed takes
        drive = procedures.speeds(axis, _typed(given, "speed", axis), None, procedures.RAMP, None, False).drive
        name, least, most, value = "accel", drive / most, drive / least, drive / value
    elif name != "accel":
        pulse = (axis.meters_per_pulse or 1.0) / scale(axis)[1]
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
    return WrongField(name, f"{value:.4g} {unit}: {a_or_an(axis.chip.MAP.chip)} makes {ends} {unit} here.")


def _typed(given: Mapping[str, Any], name: str, axis: Axis) -> float | None:
    """A speed that somebody has typed, m/s; None: none."""
    text = str(given.get(name) or "").strip().replace(",", ".")
    return float(text) * scale(axis)[1] if text else None


def where(error: BaseException, fields: list[Field]) -> str:
    """The field that an error speaks of, or ""."""
    if isinstance(error, WrongField):
        return error.field
    text = str(error)
    return next((f.name for f in fields if text.startswith((f"{f.name}=", f"{f.name}:"))), "")


def needed(values: dict[str, Any], name: str, what: str) -> Any:
    if name not in values:
        raise WrongField(name, f"say {what}.")
    return values[name]


def speed_fields(axis: Axis) -> list[Field]:
    unit, _ = scale(axis)
    fields = [Field("speed", "speed", f"{unit}/s")]
    if not axis.chip.SERVO:
        fields.append(Field("start_speed", "start speed", f"{unit}/s"))
    return [*fields, Field("accel", "ramp", "s", "0.15")]


def distance_of(axis: Axis, name: str, value: float) -> float:
    """m (rad) of what was typed: a pulse or more, and no more than makes sense."""
    unit, k = scale(axis)
    pulse, most = (axis.meters_per_pulse or 0.0) / k, FAR[has_end_limits(axis)] * (axis.travel[1] - axis.travel[0]) / k
    if abs(value) < 0.5 * pulse:
        raise WrongField(name, f"{value:g} {unit}: less than a pulse, which is {pulse:.4g} {unit}.")
    if abs(value) > most:
        raise WrongField(name, f"{value:g} {unit}: up to {most:g} {unit}, many times the travel of {axis.name}.")
    return value * k


def speeds_of(axis: Axis, values: dict[str, Any]) -> dict[str, Any]:
    _, k = scale(axis)
    out: dict[str, Any] = {}
    for name, factor in (("speed", k), ("start_speed", k), ("accel", 1.0)):
        if name in values:
            if not values[name] > 0:
                raise WrongField(name, f"{values[name]:g}: more than 0.")
            if name == "accel" and values[name] > LONGEST_RAMP:
                raise WrongField(name, f"{values[name]:g} s: up to {LONGEST_RAMP:g} s.")
            out[name] = values[name] * factor
            least = (axis.meters_per_pulse or 0.0) * SLOWEST
            if name != "accel" and out[name] < least:
                unit = f"{scale(axis)[0]}/s"
                raise WrongField(name, f"{values[name]:g} {unit}: {least / k:.3g} {unit}, a pulse a second, or more.")
    return out


def checked(axis: Axis, speeds: Mapping[str, float]) -> Any:
    """Physical speeds as the driver takes them."""
    return procedures.speeds(
        axis, speeds.get("speed"), speeds.get("start_speed"), speeds.get("accel", procedures.RAMP), None, False
    )
