"""Units in which users read and type quantities. Inside the program all quantities are in SI units: m, rad, s."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import NamedTuple


class Unit(NamedTuple):
    """Unit in which a quantity is shown.

    Attributes:
        symbol: Symbol, such as "mm".
        factor: Number of these units in one SI unit.
    """

    symbol: str
    factor: float

    def format(self, value: float, spec: str = "z.4f") -> str:
        """Format a quantity in this unit, as "12.5000 mm".

        Args:
            value: Quantity in the SI unit.
            spec: Format specification of the number.
        """
        return f"{value * self.factor:{spec}} {self.symbol}"


DEGREES_PER_RAD = math.degrees(1)
POSITION_UNITS = {"m": Unit("mm", 1e3), "rad": Unit("deg", DEGREES_PER_RAD)}
"""Units of positions and distances, by the SI unit of the axis (`Axis.unit`)."""

DEVIATION_UNITS = {"m": Unit("um", 1e6), "rad": Unit("mdeg", 1e3 * DEGREES_PER_RAD)}
"""Units of small deviations, by the SI unit of the axis."""

POSITION_FACTORS = {
    "m": {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "rad": {"urad": 1e-6, "mrad": 1e-3, "rad": 1.0, "mdeg": 1e-3 / DEGREES_PER_RAD, "deg": 1 / DEGREES_PER_RAD},
}
"""Units that users may type behind a position, with their values in the SI unit of the axis."""

OTHER_FACTORS = {
    "pulse rate": {"pps": 1.0, "kpps": 1e3},
    "time": {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0},
    "voltage": {"mV": 1e-3, "V": 1.0},
    "mass": {"g": 1e-3, "kg": 1.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6},
}
"""Units that users may type behind other quantities. A number without a unit is in the first one whose value is 1.0."""

FACTORS_BY_QUANTITY = {"length": POSITION_FACTORS["m"], "angle": POSITION_FACTORS["rad"], **OTHER_FACTORS}


INTEGER_PATTERN = "0[xX][0-9a-fA-F]+|[0-9a-fA-F]+[hH]|0[bB][01]+|[0-9]+"
"""Regular expression of an integer that a user types, without a sign. Its digits are those of ASCII."""
MAX_INTEGER_LENGTH = 80
"""Maximum number of characters of such an integer: no register needs more."""


def parse_integer(text: str) -> int | None:
    """Parse an integer such as 31, 1Fh, 0x1F or 0b11111, with or without a sign; return None for any other text."""
    sign, digits = (-1, text[1:]) if text.startswith("-") else (1, text.removeprefix("+"))
    if not re.fullmatch(INTEGER_PATTERN, digits):
        return None
    if digits[-1] in "hH":
        return sign * int(digits[:-1], 16)
    return sign * int(digits, {"0x": 16, "0b": 2}.get(digits[:2].lower(), 10))


def format_lost_steps(steps: int, pulses: int, ahead: bool = False) -> str:
    """Format lost steps in both units that users meet, as "400 full steps (6400 pulses) lost", whichever way the axis went.

    Args:
        steps: Full steps, signed.
        pulses: The same in pulses.
        ahead: Whether the carriage went farther than its pulses, in the direction of the move.
    """
    count = format_step_count(steps, pulses) if steps else "0 full steps"
    return f"{count} {'too far' if ahead else 'lost'}"


def format_step_count(steps: int, pulses: int) -> str:
    """Format a signed number of full steps and of pulses for a column of a table: "400 full steps (6400 pulses)", or "0"."""
    return f"{abs(steps)} full steps ({abs(pulses)} pulses)" if steps else "0"


def identify_unit(text: str) -> tuple[str, str] | None:
    """Return the unit of a number and its quantity, as ("kg", "mass") of "2kg"; None where there is no such unit."""
    for quantity, factors in FACTORS_BY_QUANTITY.items():
        symbol = next((u for u in sorted(factors, key=len, reverse=True) if text.strip().endswith(u)), None)
        if symbol is not None and parse_quantity(text.strip(), {symbol: 1.0}) is not None:
            return symbol, quantity
    return None


def explain_number_error(text: str) -> str:
    """Explain why a text is not a number: a sentence that begins with a space, or "" if there is no explanation."""
    repaired = text.strip().replace(",", ".")
    if text.count(",") == 1 and (identify_unit(repaired) or parse_quantity(repaired, {"": 1.0}) is not None):
        return f" Use a decimal point: {repaired}."
    return ""


def parse_position(text: str, unit: str) -> float | None:
    """Parse a position or distance such as `10mm` or `-0.5deg`; a number without a unit is in that of POSITION_UNITS.

    Args:
        text: Text that a user has typed.
        unit: SI unit of the axis, "m" or "rad".

    Returns:
        The position in the SI unit, or None if the text is not a number or has another unit.
    """
    text = text.strip()
    if text.endswith(tuple(POSITION_FACTORS[unit])):
        return parse_quantity(text, POSITION_FACTORS[unit])
    number = parse_quantity(text, {"": 1.0})
    return None if number is None else number / POSITION_UNITS[unit].factor


def parse_quantity(text: str, factors: Mapping[str, float]) -> float | None:
    """Parse a number with a unit, and return the quantity in the SI unit; None if it is not a number with one of the units.

    Args:
        text: Text that a user has typed.
        factors: Value of each unit in the SI unit; "" stands for no unit.
    """
    for symbol in (u for u in sorted(factors, key=len, reverse=True) if text.endswith(u)):
        try:
            return float(text.removesuffix(symbol)) * factors[symbol]
        except ValueError:
            continue
    return None
