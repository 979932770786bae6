"""Results of a benchmark: figures with their spread, curves of cost, and targets with which they are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Run:
    """Settings of a benchmark.

    Attributes:
        rounds: Number of rounds of each comparison.
        quick: Whether long comparisons are shortened.
    """

    rounds: int = 7
    quick: bool = False

    def choose(self, full: Any, quick: Any) -> Any:
        """Return the first value for a full run, the second for a quick one."""
        return quick if self.quick else full


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Attributes:
        key: Unique key, "subject.name".
        name: Name in the table.
        unit: Unit of the values.
        values: Value of each round.
        note: Remark that a reader needs to understand the number.
    """

    key: str
    name: str
    unit: str
    values: tuple[float, ...]
    note: str = ""

    @classmethod
    def of(cls, key: str, name: str, unit: str, values: Any, note: str = "") -> Figure:
        """Make a figure from any sequence of values."""
        return cls(key, name, unit, tuple(np.atleast_1d(np.asarray(values, float)).tolist()), note)

    @property
    def median(self) -> float:
        return float(np.median(self.values))

    @property
    def minimum(self) -> float:
        return min(self.values)

    @property
    def maximum(self) -> float:
        return max(self.values)


@dataclass(frozen=True)
class Curve:
    """Cost as a function of a size.

    Attributes:
        key: Unique key, "subject.name".
        name: Name in the table.
        over: Name of the size.
        unit: Unit of the cost.
        sizes: Sizes that were measured.
        cost: Cost of each round at each size, (rounds, sizes).
        fitted_from: Smallest size that counts for `exponents`.
    """

    key: str
    name: str
    over: str
    unit: str
    sizes: tuple[float, ...]
    cost: tuple[tuple[float, ...], ...]
    fitted_from: float

    @classmethod
    def of(
        cls, key: str, name: str, over: str, unit: str, sizes: Sequence[float], cost: Any, fitted_from: float
    ) -> Curve:
        rows = tuple(tuple(row) for row in np.atleast_2d(np.asarray(cost, float)).tolist())
        return cls(key, name, over, unit, tuple(map(float, sizes)), rows, float(fitted_from))

    def exponents(self) -> np.ndarray:
        """Compute p of cost ~ size^p for each round, by least squares of the logarithms from `fitted_from` on."""
        upper = np.asarray(self.sizes) >= self.fitted_from
        x = np.log(np.asarray(self.sizes)[upper])
        y = np.log(np.asarray(self.cost)[:, upper])
        x -= x.mean()
        return (y - y.mean(axis=1, keepdims=True)) @ x / (x @ x)

    def figure(self, note: str = "") -> Figure:
        """Return the exponent as a figure."""
        part = f"from {self.fitted_from:,g} {self.over} on" + (f"; {note}" if note else "")
        return Figure.of(f"{self.key}_exponent", f"{self.name}: p of cost ~ n^p", "", self.exponents(), part)


@dataclass(frozen=True)
class Target:
    """Bound for the median of a figure.

    Attributes:
        name: Name in the table.
        figure: Key of the figure.
        kind: ">=" or "<=".
        bound: Value of the bound.
    """

    name: str
    figure: str
    kind: str
    bound: float

    def __str__(self) -> str:
        return f"{self.kind} {format_number(self.bound)}"

    def is_met(self, value: float) -> bool:
        """Return whether a value meets the target."""
        return value >= self.bound if self.kind == ">=" else value <= self.bound

    def verdict(self, value: float) -> str:
        """Say whether a value meets the target, or by how much it misses it."""
        if self.is_met(value):
            return "met"
        distance = abs(value - self.bound)
        part = f" ({distance / abs(self.bound):.0%})" if self.bound and distance < abs(self.bound) else ""
        times = f" ({value / self.bound:.1f} times)" if self.bound > 0 and value >= 2 * self.bound else ""
        return f"missed by {format_number(distance)}{part}{times}"


def format_number(value: float) -> str:
    """Format a number with three digits, with a power of ten if that is easier to read."""
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.2e}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
