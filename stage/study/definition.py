"""What a study is: which registers take which values, how many trials, which objective, and the seed of it all.

    Definition("stage.study.objectives:preset_moves", space={"R2": "400:3600", "R4": "10:600:log", "R7": "12"}, trials=200)

A trial follows from the definition and its id alone: any executor, in any order, makes the same one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from importlib import import_module, metadata
from itertools import product
from typing import Any

import numpy as np

from stage.errors import ArgumentError, unknown

METHODS = "random", "grid", "list"
FORMAT = 1


@dataclass(frozen=True)
class Trial:
    """One evaluation: register values by name, a seed for whatever else is drawn, and the study's options."""

    id: int
    registers: dict[str, int]
    seed: int
    options: dict[str, Any] = field(default_factory=dict)


Objective = Callable[[Trial], Mapping[str, float]]
"""Measures a trial. The column "score", if there is one, is what a study minimizes."""


@dataclass(frozen=True)
class Values:
    """The values that a register takes: `choices`, or every whole number from low to high."""

    choices: tuple[int, ...] = ()
    low: int = 0
    high: int = 0
    log: bool = False

    @classmethod
    def parse(cls, name: str, text: str) -> Values:
        """12 | 10,20,40 | low:high | low:high:log | low:high/points | low:high:log/points. Raises ArgumentError."""
        try:
            if ":" not in text:
                return cls(tuple(int(v) for v in str(text).split(",")))
            ends, _, points = text.partition("/")
            low, high, *log = ends.split(":")
            span = cls((), int(low), int(high), log == ["log"])
            if log not in ([], ["log"]) or not 0 <= span.low <= span.high or (span.log and not span.low):
                raise ValueError
            return cls(span._spread(int(points))) if points else span
        except ValueError:
            raise ArgumentError(
                f"{name}={text}: a register takes one value (12), some (10,20,40), a range (400:3600, or 10:600:log evenly "
                f"on a log scale, from 1 up), or so many points of a range (400:3600/5)."
            ) from None

    def _spread(self, points: int) -> tuple[int, ...]:
        if points < 2:
            raise ValueError
        ways = [k / (points - 1) for k in range(points)]
        if self.log:
            return tuple(sorted({round(self.low * (self.high / self.low) ** way) for way in ways}))
        return tuple(sorted({round(self.low + (self.high - self.low) * way) for way in ways}))

    def draw(self, rng: np.random.Generator) -> int:
        if self.choices:
            return self.choices[int(rng.integers(len(self.choices)))]
        if self.log:
            low, high = math.log(self.low), math.log(self.high + 1)
            return min(int(math.exp(low + (high - low) * rng.random())), self.high)
        return int(rng.integers(self.low, self.high + 1))


def versions() -> dict[str, str]:
    """What the numbers depend on. A study keeps to one set."""
    return {name: _version(name) for name in ("pulsestage", "mujoco", "numpy")}


_version = cache(metadata.version)


@dataclass(frozen=True)
class Definition:
    """A study.

    Args:
        objective: "module:function", importable where the trials run.
        space: register -> values, as `Values.parse` reads them; of the methods random and grid.
        rows: register values of each trial; of the method list.
        trials: how many; of the method random, where it may grow later. A grid and a list have as many as they have.
        options: of the objective; anything that JSON can hold.
        versions: of the packages that the numbers depend on.
    Raises ArgumentError.
    """

    objective: str
    method: str = "random"
    space: dict[str, str] = field(default_factory=dict)
    rows: list[dict[str, int]] = field(default_factory=list)
    trials: int = 0
    seed: int = 0
    options: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise unknown("method", self.method, METHODS)
        if int(self.seed) != self.seed or self.seed < 0:
            raise ArgumentError(f"seed={self.seed!r}: a whole number, 0 or more.")
        if self.method == "list":
            names = {tuple(sorted(row)) for row in self.rows}
            if len(names) != 1:
                raise ArgumentError("a list of trials has one row or more, all of the same registers.")
        elif not self.space:
            raise ArgumentError("a study varies a register at least: give a space, for example R2=400:3600.")
        count = {"random": self.trials, "list": len(self.rows)}
        if self.method == "grid":
            for name, values in self._values.items():
                if not values.choices:
                    raise ArgumentError(f"{name}={self.space[name]}: a grid needs points, {name}={self.space[name]}/5.")
            count["grid"] = math.prod(len(v.choices) for v in self._values.values())
        if self.trials not in (0, count[self.method]) or count[self.method] < 1:
            raise ArgumentError(
                f"trials={self.trials!r}: a whole number, 1 or more; a grid or a list has as many as it has "
                f"({count[self.method]})."
            )
        object.__setattr__(self, "trials", count[self.method])
        try:
            object.__setattr__(self, "options", json.loads(json.dumps(self.options)))
        except (TypeError, ValueError):
            raise ArgumentError(f"options={self.options!r}: study.json must be able to hold them.") from None

    @cached_property
    def _values(self) -> dict[str, Values]:
        return {name: Values.parse(name, text) for name, text in self.space.items()}

    @cached_property
    def _grid(self) -> list[tuple[int, ...]]:
        return list(product(*(v.choices for v in self._values.values())))

    @property
    def registers(self) -> list[str]:
        """Names, in the order of the columns."""
        return list(self.rows[0] if self.method == "list" else self.space)

    def trial(self, id: int) -> Trial:
        """Trial `id`, from 0 on."""
        if not 0 <= id < self.trials:
            raise ArgumentError(f"trial {id}: the study has {self.trials}, from 0 on.")
        if self.method == "list":
            registers = {name: int(self.rows[id][name]) for name in self.registers}
        elif self.method == "grid":
            registers = dict(zip(self.space, self._grid[id], strict=True))
        else:
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(id, 0)))
            registers = {name: values.draw(rng) for name, values in self._values.items()}
        seed = np.random.SeedSequence(self.seed, spawn_key=(id, 1)).generate_state(1, np.uint64)[0]
        return Trial(id, registers, int(seed >> np.uint64(1)), self.options)

    def to_json(self) -> str:
        return json.dumps({"format": FORMAT} | asdict(self), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Definition:
        given = json.loads(text)
        if given.pop("format") != FORMAT:
            raise ValueError("another format")
        return cls(**given)

    def differences(self, new: Definition) -> list[str]:
        """What keeps `new` from going on with this study, a line each. More random trials do not."""
        lines = []
        for name in ("objective", "method", "seed"):
            was, now = getattr(self, name), getattr(new, name)
            if was != now:
                lines.append(f"{name}: {was} before, {now} now")
        for name in ("space", "options", "versions"):
            was, now = getattr(self, name), getattr(new, name)
            lines += [
                f"{name} {key}: {was.get(key, 'not given')} before, {now.get(key, 'not given')} now"
                for key in {**was, **now}
                if was.get(key) != now.get(key)
            ]
        if not lines and self.registers != new.registers:
            lines.append(f"order of registers: {' '.join(self.registers)} before, {' '.join(new.registers)} now")
        if self.rows != new.rows and self.method == new.method:
            lines.append(f"rows: {len(self.rows)} before, {len(new.rows)} now, not the same")
        if self.method == new.method == "random" and new.trials < self.trials:
            lines.append(f"trials: {self.trials} before, {new.trials} now; a study only grows")
        return lines


def resolve(objective: str) -> Objective:
    """The function called "module:function". Raises ArgumentError."""
    module, _, name = str(objective).partition(":")
    if not module or not name:
        raise ArgumentError(f"objective={objective!r}: give module:function.")
    try:
        found = getattr(import_module(module), name)
    except ImportError as error:
        raise ArgumentError(f"objective={objective!r}: {error}. It must be importable where the trials run.") from error
    except AttributeError:
        raise ArgumentError(f"objective={objective!r}: {module} has no {name}.") from None
    if not callable(found):
        raise ArgumentError(f"objective={objective!r}: {name} is not a function.")
    return found
