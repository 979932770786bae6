"""Settings of the environments with checks of their values.

    @dataclass(frozen=True)
    class Config(Settings):
        moves: Count = 8                                            an integer from 1 up
        limit: Seconds = 4.0                                        more than 0, up to 1e6 s
        payloads: Annotated[Pair, RangeSetting(0.0)] = (0.0, 10.0)  (smallest, largest), from 0 up

A Config with a number out of its range, with NaN, or with an unknown word raises an ArgumentError that names the setting. What
these classes cannot know, for example which axes a model has, is checked where the setting is used.
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
    """Error of a setting that an environment does not have; also a TypeError, which Gymnasium's own environments raise.

    Its message begins with Python's own words, which TorchRL, for example, looks for in order to try again without the settings
    that it had added itself.
    """


MAX_NUMBER = 1e9  # largest value of any setting
MAX_SECONDS = 1e6


@dataclass(frozen=True)
class NumberSetting:
    """Check of a setting that is a number.

    Attributes:
        low: Smallest allowed value.
        exclude_low: Whether the number must be larger than `low`.
        high: Largest allowed value.
        integer: Whether the number must be an integer.
    """

    low: float = 0.0
    exclude_low: bool = False
    high: float = MAX_NUMBER
    integer: bool = False

    @property
    def allowed(self) -> str:
        """Description, in words, of the numbers that the setting allows."""
        start = f"more than {self.low:g}" if self.exclude_low else f"{self.low:g} or more"
        return f"a {'whole ' if self.integer else ''}number, {start}, up to {self.high:g}"

    def accepts(self, value: Any) -> bool:
        """Return whether the setting allows a value as its number. True and False are not numbers."""
        if not isinstance(value, Real) or isinstance(value, bool):
            return False
        number = float(value)
        inside = (self.low < number if self.exclude_low else self.low <= number) and number <= self.high
        return inside and (number.is_integer() or not self.integer)

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not self.accepts(value):
            raise ArgumentError(f"{name}={value!r}: {self.allowed}.")


@dataclass(frozen=True)
class RangeSetting(NumberSetting):
    """Check of a setting that is a pair (smallest, largest), both of which are allowed numbers.

    Attributes:
        further_condition: Further condition in words, for the error.
    """

    further_condition: str = ""

    def check(self, name: str, value: Any) -> None:
        if (
            isinstance(value, Sequence | np.ndarray)
            and len(value) == 2
            and all(map(self.accepts, value))
            and value[0] <= value[1]
        ):
            return
        what = f"{'whole ' if self.integer else ''}numbers {'above' if self.exclude_low else 'from'} {self.low:g} up"
        raise ArgumentError(f"{name}={value!r}: (least, most), {what}, to {self.high:g}{self.further_condition}.")


@dataclass(frozen=True)
class ChoiceSetting:
    """Check of a setting that is one of some words.

    Attributes:
        choices: The allowed words.
    """

    choices: tuple[str, ...]

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not isinstance(value, str) or value not in self.choices:
            raise unknown_name_error(name, value, self.choices)


@dataclass(frozen=True)
class NumberOrRangeSetting(RangeSetting):
    """Check of a setting that is either one allowed number or a pair (smallest, largest)."""

    def check(self, name: str, value: Any) -> None:
        if not self.accepts(value):
            super().check(name, value)


@dataclass(frozen=True)
class NumbersSetting(NumberSetting):
    """Check of a setting that is a sequence of one or more allowed numbers."""

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, Sequence | np.ndarray) or not len(value) or not all(map(self.accepts, value)):
            raise ArgumentError(f"{name}={value!r}: one or more, each {self.allowed}.")


class BooleanSetting:
    """Check of a setting that is True or False. It refuses 0, 1 and other values that Python would convert."""

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not isinstance(value, bool | np.bool_):
            raise ArgumentError(f"{name}={value!r}: True or False.")


class NameSetting:
    """Check of a setting that is the name of something in the model."""

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not isinstance(value, str):
            raise ArgumentError(f"{name}={value!r}: a name in the model.")


@dataclass(frozen=True)
class NamesSetting:
    """Check of a setting that is a sequence of different names in the model. A str counts as a sequence of names of one letter.

    Attributes:
        min_names: Smallest number of names.
    """

    min_names: int

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        names = list(value) if isinstance(value, Sequence) else [None]
        if not all(isinstance(n, str) for n in names) or not self.min_names <= len(set(names)) == len(names):
            few = ("one", "two")[self.min_names - 1]
            raise ArgumentError(f"{name}={value!r}: {few} or more different names, for example ('x', 'y').")


@dataclass(frozen=True)
class ChoicesSetting:
    """Check of a setting that is a sequence of some words, each at most once.

    Attributes:
        choices: The allowed words.
    """

    choices: tuple[str, ...]

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise ArgumentError(f"{name}={value!r}: some of {', '.join(self.choices)}, as ({self.choices[0]!r},).")
        for word in value:
            if not isinstance(word, str) or word not in self.choices:
                raise unknown_name_error(f"word of {name}", word, self.choices)
        if len(set(value)) != len(value):
            raise ArgumentError(f"{name}={value!r}: each once.")


Pair = tuple[float, float]
PositiveNumber = Annotated[float, NumberSetting(exclude_low=True)]
Seconds = Annotated[float, NumberSetting(exclude_low=True, high=MAX_SECONDS)]
BusCycleSeconds = Annotated[float, NumberSetting(high=1.0)]
"""Duration of a bus cycle, s."""
Weight = Annotated[float, NumberSetting()]
"""Factor on a part of the reward, from 0 up; the environment decides whether the part is a cost."""
Discount = Annotated[float, NumberSetting(exclude_low=True, high=1.0)]
"""Discount of the learner for one step."""
Count = Annotated[int, NumberSetting(exclude_low=True, integer=True)]
CountRange = Annotated[tuple[int, int], RangeSetting(1, integer=True)]
PayloadRange = Annotated[Pair, RangeSetting()]
"""Range of the payload, kg."""
Boolean = Annotated[bool, BooleanSetting()]
TruthOption = Annotated[bool | str, TruthSetting()]
"""Whether observation and info have values that no host can know, see observation_features.py."""
AxisName = Annotated[str, NameSetting()]
ActionKind = Annotated[str, ChoiceSetting(("box", "registers"))]


class Settings:
    """Base of every Config, a frozen dataclass, which checks its settings when it is made.

    The value None is allowed only for settings whose default is None.
    """

    def __post_init__(self) -> None:
        config: Any = type(self)
        for name, kind in _list_setting_kinds(config):
            value = getattr(self, name)
            if value is not None or getattr(config, name) is not None:
                kind.check(name, value)


@cache
def _list_setting_kinds(config: type) -> list[tuple[str, Any]]:
    """List the name and the check of each setting that has one. A setting with several checks occurs several times."""
    hints = get_type_hints(config, include_extras=True)
    # also the parts of `KIND | None`
    parts = [(name, part) for name, hint in hints.items() for part in (hint, *get_args(hint))]
    return [(name, kind) for name, part in parts for kind in getattr(part, "__metadata__", ())]


def read_number_option(
    options: Mapping[str, Any], name: str, default: float, limits: tuple[float, float]
) -> float | np.integer | np.floating:
    """Read a number of `reset(options=...)`.

    Args:
        options: Options of the reset.
        name: Name of the option.
        default: Value if the option is absent. If it is an int, the option must be an integer.
        limits: Smallest and largest allowed value.

    Raises:
        ArgumentError: The option is not an allowed number.
    """
    value, is_integer = options.get(name, default), isinstance(default, int)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float | np.integer | np.floating)
        or not limits[0] <= value <= limits[1]
        or (is_integer and value != int(value))
    ):
        raise ArgumentError(
            f"option {name}={value!r}: {'a whole number ' * is_integer}from {limits[0]} to {limits[1]}."
        )
    return value
