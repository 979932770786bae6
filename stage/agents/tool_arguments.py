"""Types of the tools' arguments for pydantic, which accept more forms of values than pydantic does.

Agents write numbers as texts, names in capitals, and hexadecimal numbers as data sheets print them; these types accept all of that.
They refuse values without a clear meaning: NaN, true for a number, half a pulse, digits of other scripts.

    speed = argument(number(gt=0), "Speed of the move in m/s.")     an argument of a `Tool`
    axis = argument(choice(("x", "y")), "Axis to move.")
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError

from stage import units
from stage.errors import ArgumentError, find_similar_names
from stage.units import POSITION_FACTORS

MAX_LENGTH_M = 1e3  # also rad
MAX_TEXT_CHARACTERS = 4000
MAX_LIST_ITEMS = 256
MAX_INTEGER = (1 << 63) - 1
UNITS = POSITION_FACTORS["m"] | POSITION_FACTORS["rad"]
INTEGER_PATTERN = rf"^\s*[-+]?({units.INTEGER_PATTERN})\s*$"
LENGTH_PATTERN = rf"^\s*[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?\s*({'|'.join(UNITS)})?\s*$"
LENGTH_WITH_UNIT_PATTERN = LENGTH_PATTERN.replace(")?\\s*$", ")\\s*$")
REQUIRED: Any = ...


def argument(kind: Any, description: str, default: Any = REQUIRED) -> tuple[Any, Any]:
    """Describe one argument of a tool.

    Args:
        kind: A type of this module, or any type that pydantic knows.
        description: Meaning of the argument, for the agent.
        default: Value if the agent gives none. None: the action gets no such argument; `REQUIRED`: such a call is an error.

    Returns:
        The type and the field, as arguments of `pydantic.create_model`.
    """
    return kind, Field(default, description=description)


def format_value(value: Any) -> str:
    """Format a value like JSON, cut to 80 characters."""
    if value is None or isinstance(value, bool):
        return {True: "true", False: "false", None: "null"}[value]
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python turns into text
        text = "a number of thousands of digits"
    return text if len(text) <= 80 else text[:76] + " ..."


def choose(what: str, value: str, choices: tuple[str, ...]) -> str:
    """Return the choice with this name, ignoring upper and lower case.

    Args:
        what: Noun for the choices in the error message, for example "tool".
        value: Name to look for.
        choices: Allowed names.

    Raises:
        ArgumentError: No choice has the name; the message lists similar ones.
    """
    try:
        return _match_name(choices, value)
    except ValueError as error:
        raise ArgumentError(f"{what}: {error}") from None


def parse_integer(what: str, text: str) -> int:
    """Parse an integer in one of the forms 31, 1Fh, 0x1F, 0b11111.

    Args:
        what: Name of the value, for the error message.
        text: The text.

    Raises:
        ArgumentError: The text is no such number.
    """
    try:
        return _parse_integer(text)
    except ValueError as error:
        raise ArgumentError(f"{what}: {error}") from None


def _match_name(choices: tuple[str, ...], value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{format_value(value)} should be a text, one of {', '.join(choices)}.")  # noqa: TRY004
    if value in choices:
        return value
    folded = value.strip().lower()
    same = [c for c in choices if c.lower() == folded]
    if len(same) == 1:
        return same[0]
    near = find_similar_names(folded[:64], choices)
    hint = f" Did you mean {' or '.join(repr(n) for n in near)}?" if near else ""
    known = ", ".join(choices[:40]) + (" ..." if len(choices) > 40 else "")
    raise ValueError(f"{format_value(value)} is not known.{hint} Known: {known or 'none'}.")


def _check_number(value: Any) -> Any:
    """Refuse true, false and texts with characters of other scripts, for which the errors of pydantic would not help."""
    if isinstance(value, bool):
        raise ValueError(f"{format_value(value)} is not a number.")  # noqa: TRY004 (what pydantic takes)
    if not isinstance(value, str):
        return value
    if len(value) > MAX_TEXT_CHARACTERS:
        raise ValueError(f"a text of {len(value)} characters is not a number.")
    if not value.isascii():
        meant = "".join(str(unicodedata.digit(c)) if unicodedata.digit(c, None) is not None else c for c in value)
        for sign, plain in (("\N{MINUS SIGN}", "-"), ("\N{MICRO SIGN}", "u"), ("\N{GREEK SMALL LETTER MU}", "u")):
            meant = meant.replace(sign, plain)
        hint = f" Did you mean {meant!r}?" if meant.isascii() else ""
        raise ValueError(f"{format_value(value)} has characters that are not ASCII.{hint}")
    return value.strip()


def _parse_integer(value: Any) -> Any:
    value = _check_number(value)
    if not isinstance(value, str):
        return value
    text = value.replace("_", "")
    if (number := units.parse_integer(text)) is not None and len(text) <= units.MAX_INTEGER_LENGTH:
        return number
    if re.fullmatch(r"[0-9a-fA-F]{1,16}", text):
        raise ValueError(f"{format_value(value)} is not decimal. Did you mean '{text.upper()}h' ({int(text, 16)})?")
    raise ValueError(f"{format_value(value)} is not a whole number; write 31, '1Fh', '0x1F' or '0b11111'.")


def _parse_length(value: Any) -> Any:
    value = _check_number(value)
    if not isinstance(value, str):
        return value
    if not (match := re.fullmatch(LENGTH_PATTERN, value)):
        raise ValueError(
            f"{format_value(value)} is not a length; write meters as a number, or a text with a unit, '10mm' or '30deg'."
        )
    unit = match.group(3) or ""
    return float(value.removesuffix(unit)) * UNITS.get(unit, 1.0)


def _wrap_single_value(value: Any) -> Any:
    """Return a list with the value if the value is not a list."""
    return [value] if isinstance(value, int | float | str) and not isinstance(value, bool) else value


Text = Annotated[str, Field(max_length=MAX_TEXT_CHARACTERS, examples=["..."])]
Flag = Annotated[
    bool,
    Field(strict=True, examples=[True]),
    BeforeValidator(lambda v: {"true": True, "false": False}.get(str(v).strip().lower(), v)),
]
_Meters = Annotated[float, Field(ge=-MAX_LENGTH_M, le=MAX_LENGTH_M, allow_inf_nan=False)]
Length = Annotated[
    _Meters,
    BeforeValidator(_parse_length, json_schema_input_type=_Meters | Annotated[str, Field(pattern=LENGTH_PATTERN)]),
    Field(examples=["10mm"]),
]
"""Meters or radians: a number, or a text with its unit."""


def _require_unit(value: Any) -> Any:
    """Refuse a length without a unit: 10 would be 10 m, and the agent may mean 10 mm."""
    number_text = value.strip() if isinstance(value, str) else value
    if (isinstance(value, int | float) and not isinstance(value, bool)) or (
        isinstance(value, str) and re.fullmatch(LENGTH_PATTERN, number_text) and number_text[-1] in "0123456789."
    ):
        raise ValueError(f"{format_value(value)} has no unit; write a text such as '10mm' or '30deg'.")
    return value


LengthWithUnit = Annotated[
    _Meters,
    BeforeValidator(_parse_length),
    BeforeValidator(_require_unit, json_schema_input_type=Annotated[str, Field(pattern=LENGTH_WITH_UNIT_PATTERN)]),
    Field(examples=["10mm"]),
]
"""Meters or radians: a text with its unit, for distances of moves."""


def number(**bounds: Any) -> Any:
    """Return the type of finite numbers within `bounds`: gt, ge, le, as in `pydantic.Field`."""
    return Annotated[float, Field(allow_inf_nan=False, examples=[0.1], **bounds), BeforeValidator(_check_number)]


def integer(low: int | None = None, high: int | None = None) -> Any:
    """Return the type of integers from `low` to `high`, by default of 64 bits."""
    bounds = Field(ge=-MAX_INTEGER if low is None else low, le=MAX_INTEGER if high is None else high)
    as_number = Annotated[int, Field(ge=low, le=high)]
    as_text = Annotated[str, Field(pattern=INTEGER_PATTERN)]
    parse = BeforeValidator(_parse_integer, json_schema_input_type=as_number | as_text)
    return Annotated[int, bounds, parse, Field(examples=[100])]


def choice(names: tuple[str, ...]) -> Any:
    """Return the type of one of `names`, in upper or lower case."""
    return Annotated[Literal[names], BeforeValidator(partial(_match_name, names)), Field(examples=[names[0]])]


def list_of(kind: Any) -> Any:
    """Return the type of a list with 1 to `MAX_LIST_ITEMS` values of type `kind`; a single value counts as a list."""
    size = Field(min_length=1, max_length=MAX_LIST_ITEMS)
    return Annotated[
        list[kind], size, BeforeValidator(_wrap_single_value, json_schema_input_type=Annotated[list[kind], size])
    ]


def make_length_mapping_type(names: tuple[str, ...]) -> Any:
    """Return the type of a mapping from some of `names` to lengths."""

    def match_axis_names(value: Any) -> Any:
        """Replace each key by the axis name that it matches in upper or lower case."""
        if not isinstance(value, Mapping):
            return value
        matched = [_match_name(names, name) for name in value]
        if len(set(matched)) < len(matched):
            raise ValueError("each name may be given once.")
        return dict(zip(matched, value.values(), strict=True))

    kind = Annotated[dict[Literal[names], LengthWithUnit], Field(min_length=1)]  # type: ignore[valid-type]
    return Annotated[kind, BeforeValidator(match_axis_names), Field(examples=[dict.fromkeys(names[:2], "10mm")])]


def explain_validation_error(
    error: ValidationError, missing: Callable[[str], str], unexpected: Callable[[str], str]
) -> str:
    """Return one sentence about the first error that pydantic has found.

    Args:
        error: Error of pydantic for the arguments of a call.
        missing: Function that returns the sentence for a missing argument, given its name.
        unexpected: Function that returns the sentence for an argument that the tool does not take, given its name.
    """
    found = error.errors(include_url=False)
    first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    name, *rest = (str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return unexpected(name)
    if first["type"] == "missing":
        return missing(name)
    where = name + "".join(f"[{part}]" for part in rest)
    if first["type"] == "value_error":
        return f"{where}: {first['ctx']['error']}"
    return f"{where}: {first['msg'].replace('Input', format_value(first['input']), 1)}."
