"""Arguments of tools: the JSON schema of each, and its value from what an agent has given. No stage.

    speed = Field("speed", NUMBER, "of the move", low=0.0, unit="m/s")
    speed.schema()                   {"type": "number", ...}
    speed.read("0.05")               0.05; ArgumentError says what is wrong and what is allowed

Agents write numbers as texts, names in capitals, hexadecimal as data sheets print it: all that is understood. What has no meaning
is refused in words: NaN, true for a number, half a pulse, digits of other scripts.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stage import units
from stage.errors import ArgumentError, near_names
from stage.units import TYPED

NUMBER, WHOLE, TEXT, FLAG, LENGTH = "number", "whole", "text", "flag", "length"
BYTES, NUMBERS, LENGTHS = "bytes", "numbers", "lengths"
FARTHEST = 1e3  # m or rad, of a length
LONG = 4000  # characters of a text, at most
MANY = 256  # numbers of a list, at most
_MOST = (1 << 63) - 1  # of a whole number: what 64 bits hold
UNITS = TYPED["m"] | TYPED["rad"]
DIGITS = rf"^\s*[-+]?({units.WHOLE})\s*$"
"""Whole numbers as texts."""
SIZES = rf"^\s*[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?\s*({'|'.join(UNITS)})?\s*$"
"""Lengths and angles as texts."""


@dataclass(frozen=True)
class Field:
    """An argument. choices: of a text; low, high: of a number, both allowed; above: `low` is not. unit: in words.

    kind: NUMBER (float), WHOLE (int), TEXT, FLAG (bool), LENGTH (m or rad, with a unit as text), BYTES (list of whole numbers),
    NUMBERS (list of floats), LENGTHS (a mapping of `choices` to lengths).
    """

    name: str
    kind: str
    text: str
    needed: bool = False
    default: Any = None
    low: float | None = None
    high: float | None = None
    above: bool = False
    unit: str = ""
    choices: tuple[str, ...] = ()

    def schema(self) -> dict[str, Any]:
        """As JSON schema."""
        said = {"description": self.text + (f", {self.unit}" if self.unit else "")}
        if self.default is not None:
            said["default"] = self.default
        return {**self._form(), **said}

    def _form(self) -> dict[str, Any]:
        if self.kind == TEXT:
            return (
                {"type": "string", "enum": list(self.choices)}
                if self.choices
                else {"type": "string", "maxLength": LONG}
            )
        if self.kind == FLAG:
            return {"type": "boolean"}
        if self.kind == NUMBER:
            return {"type": "number", **self._ends()}
        if self.kind == WHOLE:
            return {"anyOf": [{"type": "integer", **self._ends()}, {"type": "string", "pattern": DIGITS}]}
        if self.kind == LENGTH:
            return _length_form()
        if self.kind == NUMBERS:
            return {"type": "array", "items": {"type": "number", **self._ends()}, "minItems": 1, "maxItems": MANY}
        if self.kind == BYTES:
            one = {"anyOf": [{"type": "integer", **self._ends()}, {"type": "string", "pattern": DIGITS}]}
            return {"type": "array", "items": one, "minItems": 1, "maxItems": MANY}
        one = _length_form()
        return {
            "type": "object", "properties": dict.fromkeys(self.choices, one), "additionalProperties": False, "minProperties": 1
        }  # fmt: skip

    def _ends(self) -> dict[str, Any]:
        ends: dict[str, Any] = {}
        if self.low is not None:
            ends["exclusiveMinimum" if self.above else "minimum"] = self.low
        if self.high is not None:
            ends["maximum"] = self.high
        return ends

    def read(self, given: Any) -> Any:
        """The value. Raises ArgumentError."""
        if self.kind == TEXT:
            return self._text(given)
        if self.kind == FLAG:
            return self._flag(given)
        if self.kind == NUMBER:
            return self._within(self._number(given))
        if self.kind == WHOLE:
            return self._within(self._whole(given))
        if self.kind == LENGTH:
            return self._length(given)
        if self.kind in (BYTES, NUMBERS):
            return self._list(given)
        return self._lengths(given)

    # --- kinds ---

    def _text(self, given: Any) -> str:
        if not isinstance(given, str):
            raise self._wrong(given, f"a text{self._among()}")
        if len(given) > LONG:
            raise ArgumentError(f"{self.name}: a text of {len(given)} characters; up to {LONG} are read.")
        return chosen(self.name, given, self.choices) if self.choices else given

    def _flag(self, given: Any) -> bool:
        if isinstance(given, bool):
            return given
        if isinstance(given, str) and given.strip().lower() in ("true", "false"):
            return given.strip().lower() == "true"
        raise self._wrong(given, "true or false")

    def _number(self, given: Any) -> float:
        if isinstance(given, str):
            given = _plain(self.name, given)
            try:
                given = float(given.replace("_", " "))
            except ValueError:
                raise self._wrong(given, f"a number{self._span()}") from None
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise self._wrong(given, f"a number{self._span()}")
        try:
            value = float(given)
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            raise self._wrong(given, f"a finite number{self._span()}")
        return value

    def _whole(self, given: Any) -> int:
        if isinstance(given, str):
            return whole(self.name, given)
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise self._wrong(given, f'a whole number{self._span()}; in hexadecimal a text, "1Fh" or "0x1F"')
        if isinstance(given, float) and not (math.isfinite(given) and given == int(given)):
            raise self._wrong(given, f"a whole number{self._span()}")
        return _bounded(self.name, int(given))

    def _length(self, given: Any) -> float:
        if isinstance(given, str):
            text = _plain(self.name, given).strip()
            found = re.fullmatch(SIZES, text)
            if not found:
                wanted = (
                    'a length: in m as a number, or with its unit as text: 0.01 or "10mm"; on a hinge rad or "30deg"'
                )
                raise self._wrong(given, wanted)
            unit = found.group(3) or ""
            number = float(text.removesuffix(unit))
            value = number * UNITS.get(unit, 1.0)
        else:
            value = self._number(given)
        if not abs(value) <= FARTHEST:
            raise self._wrong(given, f"a length up to {FARTHEST:g} m")
        return value

    def _list(self, given: Any) -> list[Any]:
        if isinstance(given, int | float | str) and not isinstance(given, bool):
            given = [given]
        if not isinstance(given, list) or not given:
            wanted = 'a list of whole numbers, as [16, "15h"]' if self.kind == BYTES else "a list of numbers"
            raise self._wrong(given, wanted)
        if len(given) > MANY:
            raise ArgumentError(f"{self.name}: a list of {len(given)}; up to {MANY} at a time.")
        one = self._whole if self.kind == BYTES else self._number
        return [self._within(one(item)) for item in given]

    def _lengths(self, given: Any) -> dict[str, float]:
        if not isinstance(given, Mapping) or not given:
            raise self._wrong(given, f'lengths by name, as {{"{self.choices[0]}": "10mm"}}')
        found: dict[str, float] = {}
        for name, length in given.items():
            key = chosen(self.name, str(name), self.choices)
            if key in found:
                raise ArgumentError(f"{self.name}: {key} is given twice.")
            found[key] = self._length(length)
        return found

    def _within(self, value: Any) -> Any:
        low, high = self.low, self.high
        if (low is not None and (value < low or (self.above and value == low))) or (high is not None and value > high):
            raise ArgumentError(f"{self.name}: {shown(value)} is out of range: give a number{self._span()}.")
        return value

    # --- words ---

    def _span(self) -> str:
        unit, (low, high) = f" {self.unit}" if self.unit else "", (self.low, self.high)
        begins = "" if low is None else f" {'above' if self.above else 'from'} {low:g}"
        if high is not None:
            return f"{begins}{',' if self.above else ''} {'up ' if low is None or self.above else ''}to {high:g}{unit}"
        return f"{begins}{unit}{'' if self.above else ' on'}" if begins else (f" of{unit}" if unit else "")

    def _among(self) -> str:
        return f", one of {', '.join(self.choices)}" if self.choices else ""

    def _wrong(self, given: Any, wanted: str) -> ArgumentError:
        return ArgumentError(f"{self.name}: {shown(given)} is not {wanted}.")


def _bounded(what: str, number: int) -> int:
    if abs(number) > _MOST:
        said = (
            f"{what}: {shown(number)} is out of range: give a number from {-_MOST} to {_MOST}; no register is so wide."
        )
        raise ArgumentError(said)
    return number


def _length_form() -> dict[str, Any]:
    number = {"type": "number", "minimum": -FARTHEST, "maximum": FARTHEST}
    return {"anyOf": [number, {"type": "string", "pattern": SIZES}]}


def chosen(what: str, given: str, choices: tuple[str, ...]) -> str:
    """The choice of this name, in any case of letters. Raises ArgumentError with near misses."""
    if given in choices:
        return given
    same = [c for c in choices if c.lower() == given.strip().lower()]
    if len(same) == 1:
        return same[0]
    lower = {c.lower(): c for c in choices}
    near = [lower[n] for n in near_names(given.strip().lower()[:64], lower)]
    hint = f" Did you mean {' or '.join(repr(n) for n in near)}?" if near else ""
    listed = ", ".join(choices) if len(choices) <= 40 else ", ".join(choices[:40]) + " ..."
    raise ArgumentError(f"{what}: {shown(given)} is not known.{hint} Known: {listed or 'none'}.")


def whole(what: str, text: str) -> int:
    """A whole number as somebody writes it: 31, 1Fh, 0x1F, 0b11111. Raises ArgumentError."""
    typed = _plain(what, text).strip().replace("_", "")
    if len(typed) > units.MOST:
        raise ArgumentError(f"{what}: a number of {len(typed)} characters; no register is so wide.")
    if (value := units.whole(typed)) is not None:
        return _bounded(what, value)
    if re.fullmatch(r"[0-9a-fA-F]+", typed):
        raise ArgumentError(
            f'{what}: {shown(text)} is no decimal number. Did you mean "{typed.upper()}h" ({int(typed, 16)})?'
        )
    raise ArgumentError(f'{what}: {shown(text)} is not a whole number: 31, "1Fh", "0x1F" or "0b11111".')


def _plain(what: str, text: str) -> str:
    """A text of ASCII. Raises ArgumentError with the digits that were probably meant."""
    if len(text) > LONG:
        raise ArgumentError(f"{what}: a text of {len(text)} characters is no number.")
    if text.isascii():
        return text
    meant = "".join(str(unicodedata.digit(c)) if unicodedata.digit(c, None) is not None else c for c in text)
    meant = (
        meant.replace("\N{MINUS SIGN}", "-").replace("\N{MICRO SIGN}", "u").replace("\N{GREEK SMALL LETTER MU}", "u")
    )
    hint = f' Did you mean "{meant}"?' if meant.isascii() else ""
    raise ArgumentError(f"{what}: {shown(text)} has characters that are no ASCII digits.{hint}")


def shown(given: Any) -> str:
    """What was given, as JSON would have it, cut short."""
    text = {True: "true", False: "false", None: "null"}.get(given) if given is None or isinstance(given, bool) else None
    if text is None:
        try:
            text = repr(given)
        except ValueError:  # an integer of more digits than Python turns into text
            text = "a number of thousands of digits"
    return text if len(text) <= 80 else text[:76] + " ..."
