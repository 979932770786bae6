"""The units in which places and ways are told and typed: a slide's in mm, a hinge's in degrees. Inside they are SI: m, rad."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import NamedTuple


class Unit(NamedTuple):
    """symbol; per: so many are an SI unit."""

    symbol: str
    per: float

    def text(self, value: float, form: str = "z.4f") -> str:
        """A value in SI, told in this unit: "12.5000 mm"."""
        return f"{value * self.per:{form}} {self.symbol}"


DEGREES = math.degrees(1)
PLACES = {"m": Unit("mm", 1e3), "rad": Unit("deg", DEGREES)}
"""Of an axis' places and ways, by the unit that the axis has inside (`Axis.unit`)."""

SMALL = {"m": Unit("um", 1e6), "rad": Unit("mdeg", 1e3 * DEGREES)}
"""Of deviations."""

TYPED = {
    "m": {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "rad": {"urad": 1e-6, "mrad": 1e-3, "rad": 1.0, "mdeg": 1e-3 / DEGREES, "deg": 1 / DEGREES},
}
"""What may follow a number that somebody types, and how much it is in SI."""

BESIDES = {
    "pulse rate": {"pps": 1.0, "kpps": 1e3},
    "time": {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0},
    "voltage": {"mV": 1e-3, "V": 1.0},
    "mass": {"g": 1e-3, "kg": 1.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6},
}
"""The same of what is no place: the first with 1.0 is what a number without a unit is in."""

KINDS = {"length": TYPED["m"], "angle": TYPED["rad"], **BESIDES}


WHOLE = "0[xX][0-9a-fA-F]+|[0-9a-fA-F]+[hH]|0[bB][01]+|[0-9]+"
"""A whole number as somebody types it, without a sign. Its digits are those of ASCII."""
MOST = 80
"""Characters of one, at most: no register is so wide."""


def whole(text: str) -> int | None:
    """The whole number that somebody has typed: 31, 1Fh, 0x1F, 0b11111, with a sign or without. None: it is none."""
    sign, digits = (-1, text[1:]) if text.startswith("-") else (1, text.removeprefix("+"))
    if not re.fullmatch(WHOLE, digits):
        return None
    if digits[-1] in "hH":
        return sign * int(digits[:-1], 16)
    return sign * int(digits, {"0x": 16, "0b": 2}.get(digits[:2].lower(), 10))


def kind_of(text: str) -> tuple[str, str] | None:
    """The unit behind a number, and what it is a unit of: ("kg", "mass") of "2kg". None: no number with a unit."""
    for kind, units in KINDS.items():
        symbol = next((u for u in sorted(units, key=len, reverse=True) if text.strip().endswith(u)), None)
        if symbol is not None and quantity(text.strip(), {symbol: 1.0}) is not None:
            return symbol, kind
    return None


def slip(text: str) -> str:
    """What is wrong with a number that is none, in a sentence with a blank before it; "": nobody knows."""
    mended = text.strip().replace(",", ".")
    if text.count(",") == 1 and (kind_of(mended) or quantity(mended, {"": 1.0}) is not None):
        return f" A decimal point, no comma: {mended}."
    return ""


def typed(text: str, unit: str) -> float | None:
    """A place or way as it is typed, `10mm`, `-0.5deg`, in m or rad; without a unit in that of PLACES. None: it is neither.

    Args:
        unit: "m" or "rad", as of an axis.
    """
    text = text.strip()
    if text.endswith(tuple(TYPED[unit])):
        return quantity(text, TYPED[unit])
    bare = quantity(text, {"": 1.0})
    return None if bare is None else bare / PLACES[unit].per


def quantity(text: str, units: Mapping[str, float]) -> float | None:
    """A number with one of these units behind it, times what the unit says; "": it has none. None: it is no such."""
    for symbol in (u for u in sorted(units, key=len, reverse=True) if text.endswith(u)):
        try:
            return float(text.removesuffix(symbol)) * units[symbol]
        except ValueError:
            continue
    return None
