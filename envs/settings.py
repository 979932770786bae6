"""Kinds of settings of the environments, and their checks.

    @dataclass(frozen=True)
    class Config(Settings):
        moves: Count = 8                                     a whole number from 1 up
        limit: Seconds = 4.0                                 more than 0, up to 1e6 s
        payloads: Annotated[Pair, Range(0.0)] = (0.0, 10.0)  (least, most), from 0 up

A Config with a number out of its range, with nan, or with an unknown word raises an ArgumentError that names the setting. What a
kind cannot know, for example which axes a model has, is checked where the setting is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from numbers import Real
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np

from stage.envs.observation_features import TruthSetting
from stage.errors import ArgumentError, unknown_name_error


class UnknownSetting(ArgumentError, TypeError):
    """An environment has no such setting: a TypeError as well, as Gymnasium's own environments raise it.

    It begins with Python's own words: TorchRL, for one, looks for them, to try again without what it had added itself.
    """


MAX_NUMBER = 1e9  # of any number
MAX_SECONDS = 1e6  # s


@dataclass(frozen=True)
class Number:
    """A number from `low` up, or above it, to `high`; a whole one."""

    low: float = 0.0
    above: bool = False
    high: float = MAX_NUMBER
    whole: bool = False

    @property
    def allowed(self) -> str:
        """Description of the allowed values."""
        start = f"more than {self.low:g}" if self.above else f"{self.low:g} or more"
        return f"a {'whole ' if self.whole else ''}number, {start}, up to {self.high:g}"

    def accepts(self, value: Any) -> bool:
        """Return whether the value is such a number; True and False are not."""
        if not isinstance(value, Real) or isinstance(value, bool):
            return False
        number = float(value)
        inside = (self.low < number if self.above else self.low <= number) and number <= self.high
        return inside and (number.is_integer() or not self.whole)

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not self.accepts(value):
            raise ArgumentError(f"{name}={value!r}: {self.allowed}.")


@dataclass(frozen=True)
class Range(Number):
    """(least, most), each such a number. more: further conditions, in words."""

    more: str = ""

    def check(self, name: str, value: Any) -> None:
        if (
            isinstance(value, Sequence | np.ndarray)
            and len(value) == 2
            and all(map(self.accepts, value))
            and value[0] <= value[1]
        ):
            return
        what = f"{'whole ' if self.whole else ''}numbers {'above' if self.above else 'from'} {self.low:g} up"
        raise ArgumentError(f"{name}={value!r}: (least, most), {what}, to {self.high:g}{self.more}.")


@dataclass(frozen=True)
class Word:
    """One of the words known."""

    known: tuple[str, ...]

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not isinstance(value, str) or value not in self.known:
            raise unknown_name_error(name, value, self.known)


@dataclass(frozen=True)
class NumberOrRange(Range):
    """Such a number, for least and most, or both."""

    def check(self, name: str, value: Any) -> None:
        if not self.accepts(value):
            super().check(name, value)


@dataclass(frozen=True)
class Each(Number):
    """One or more such numbers."""

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, Sequence | np.ndarray) or not len(value) or not all(map(self.accepts, value)):
            raise ArgumentError(f"{name}={value!r}: one or more, each {self.allowed}.")


class Boolean:
    """True or False, and nothing that Python takes for one of them."""

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not isinstance(value, bool | np.bool_):
            raise ArgumentError(f"{name}={value!r}: True or False.")


class Name:
    """A name in the model."""

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not isinstance(value, str):
            raise ArgumentError(f"{name}={value!r}: a name in the model.")


@dataclass(frozen=True)
class Names:
    """At least so many different names in the model; a str is names of one letter."""

    least: int

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        names = list(value) if isinstance(value, Sequence) else [None]
        if not all(isinstance(n, str) for n in names) or not self.least <= len(set(names)) == len(names):
            few = ("one", "two")[self.least - 1]
            raise ArgumentError(f"{name}={value!r}: {few} or more different names, for example ('x', 'y').")


@dataclass(frozen=True)
class Words:
    """Any of some words, each once at most."""

    allowed: tuple[str, ...]

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise ArgumentError(f"{name}={value!r}: some of {', '.join(self.allowed)}, as ({self.allowed[0]!r},).")
        for word in value:
            if not isinstance(word, str) or word not in self.allowed:
                raise unknown_name_error(f"word of {name}", word, self.allowed)
        if len(set(value)) != len(value):
            raise ArgumentError(f"{name}={value!r}: each once.")


Pair = tuple[float, float]
Positive = Annotated[float, Number(above=True)]
Seconds = Annotated[float, Number(above=True, high=MAX_SECONDS)]
Cycle = Annotated[float, Number(high=1.0)]
"""s, that a bus cycle takes."""
Weight = Annotated[float, Number()]
"""Of a part of the reward; which sign the part has is the environment's."""
Discount = Annotated[float, Number(above=True, high=1.0)]
"""A learner's own, of a step."""
Count = Annotated[int, Number(above=True, whole=True)]
Counts = Annotated[tuple[int, int], Range(1, whole=True)]
Payloads = Annotated[Pair, Range()]
"""kg."""
Flag = Annotated[bool, Boolean()]
TruthOption = Annotated[bool | str, TruthSetting()]
"""Where what no host can see is shown, see observation_features.py."""
AxisName = Annotated[str, Name()]
Actions = Annotated[str, Word(("box", "registers"))]


class Settings:
    """The base of every Config: a frozen dataclass whose settings are checked by their kinds.

    None is a value of those settings alone whose default it is.
    """

    def __post_init__(self) -> None:
        config: Any = type(self)
        for name, kind in _list_setting_kinds(config):
            value = getattr(self, name)
            if value is not None or getattr(config, name) is not None:
                kind.check(name, value)


@cache
def _list_setting_kinds(config: type) -> list[tuple[str, Any]]:
    """List name and kind of each setting of a Config that has a kind; a setting with several kinds occurs several times."""
    hints = get_type_hints(config, include_extras=True)
    parts = [
        (name, part) for name, hint in hints.items() for part in (hint, *get_args(hint))
    ]  # those of `KIND | None`, too
    return [(name, kind) for name, part in parts for kind in getattr(part, "__metadata__", ())]


def read_option(
    options: Mapping[str, Any], name: str, drawn: float, ends: tuple[float, float]
) -> float | np.integer | np.floating:
    """Read a number of `reset(options=...)`.

    Args:
        options: Options of the reset.
        name: Of the option.
        drawn: Value where the option is absent; if it is an int, the option must be whole.
        ends: Least and largest value.

    Raises:
        ArgumentError: The option is not such a number.
    """
    value, is_integer = options.get(name, drawn), isinstance(drawn, int)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float | np.integer | np.floating)
        or not ends[0] <= value <= ends[1]
        or (is_integer and value != int(value))
    ):
        raise ArgumentError(f"option {name}={value!r}: {'a whole number ' * is_integer}from {ends[0]} to {ends[1]}.")
    return value
