"""What a benchmark finds: figures with their spread, curves of cost, and targets to hold them against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Run:
    """Settings of a benchmark: rounds of each comparison; `quick` shortens long ones."""

    rounds: int = 7
    quick: bool = False

    def choose(self, full: Any, quick: Any) -> Any:
        return quick if self.quick else full


@dataclass(frozen=True)
class Figure:
    """One measured number. key: unique, "subject.name"; values: one a round; note: what a reader must know."""

    key: str
    name: str
    unit: str
    values: tuple[float, ...]
    note: str = ""

    @classmethod
    def of(cls, key: str, name: str, unit: str, values: Any, note: str = "") -> Figure:
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
    """Cost over size. cost: (rounds, sizes), in `unit`; `fitted_from`: the least size that `exponent` looks at."""

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
        """P of cost ~ size^p, a value a round: least squares in logarithms from `fitted_from` on."""
        upper = np.asarray(self.sizes) >= self.fitted_from
        x = np.log(np.asarray(self.sizes)[upper])
        y = np.log(np.asarray(self.cost)[:, upper])
        x -= x.mean()
        return (y - y.mean(axis=1, keepdims=True)) @ x / (x @ x)

    def figure(self, note: str = "") -> Figure:
        """The exponent as a figure."""
        part = f"from {self.fitted_from:,g} {self.over} on" + (f"; {note}" if note else "")
        return Figure.of(f"{self.key}_exponent", f"{self.name}: p of cost ~ n^p", "", self.exponents(), part)


@dataclass(frozen=True)
class Target:
    """A bound for the median of a figure: `kind` ">=" or "<="."""

    name: str
    figure: str
    kind: str
    bound: float

    def __str__(self) -> str:
        return f"{self.kind} {format_number(self.bound)}"

    def is_met(self, value: float) -> bool:
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
    """Three digits, and a power of ten where that reads better."""
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.2e}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
