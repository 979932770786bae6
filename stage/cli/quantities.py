"""Numbers that options take, with or without a unit: 20000, 20000pps, 100ms, 24V."""

from __future__ import annotations

import argparse
import math

from stage.units import BESIDES, kind_of, quantity, slip


class Quantity:
    """For argparse: a number of this kind, a key of BESIDES; without a unit in SI, pps for a pulse rate."""

    def __init__(self, kind: str):
        self.kind, self.units = kind, BESIDES[kind]

    def __call__(self, text: str) -> float:
        given = text.strip()
        if (value := quantity(given, {"": 1.0} | self.units)) is not None:
            return value
        other = kind_of(given)
        said = f" {other[0]} is a {other[1]}." if other else slip(text)
        raise argparse.ArgumentTypeError(
            f"{given!r} is no {self.kind}.{said} A number, or one in {', '.join(self.units)}."
        )


class Whole(Quantity):
    """The same, a whole number; also written as 0x300."""

    def __call__(self, text: str) -> int:
        try:
            return int(text, 0)
        except ValueError:
            value = super().__call__(text)
        if not math.isfinite(value) or value != round(value):
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number")
        return round(value)


RATE, TIME, VOLTAGE, MASS, FREQUENCY = map(Quantity, BESIDES)
HERTZ = Whole("frequency")
