"""Errors of PulseStage. Each text states what was given, what is allowed and what to do. No state has changed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Self


def escape(text: str) -> str:
    """Replace characters that UTF-8 cannot encode, such as bytes of file names in other encodings, by escapes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


class StageError(Exception):
    """Base class of every error that PulseStage raises. UTF-8 can encode its text, whatever file names it contains."""

    def __str__(self) -> str:
        return escape(super().__str__())


class ExceededLimit(NamedTuple):
    """Limit of a chip that a requested value exceeds.

    Attributes:
        quantity: "speed", "start_speed" or "fast" (the second of two speeds), pps; "acceleration", pps/s; "accel", the duration of
            a ramp, s; or "pulses".
        value: Value requested.
        minimum: Least value that the chip can have.
        maximum: Greatest value that the chip can have.
    """

    quantity: str
    value: float
    minimum: float
    maximum: float = float("inf")


class ArgumentError(StageError, ValueError):
    """Error of an argument that is out of range or not known.

    Attributes:
        exceeded_limit: Limit of the chip that a value has exceeded, for callers that show it in other units; None otherwise.
    """

    exceeded_limit: ExceededLimit | None = None

    def with_limit(self, limit: ExceededLimit) -> Self:
        """Attach the limit that was exceeded, and return this error."""
        self.exceeded_limit = limit
        return self


class UnknownKey(ArgumentError, KeyError):
    """Error of a key that a mapping does not have. It is a KeyError as well, but its text is printed without quotes."""

    def __str__(self) -> str:
        return escape(str(self.args[0]))


class ModelError(StageError, ValueError):
    """Error of an MJCF model that does not keep the naming contract.

    Attributes:
        missing: MJCF lines that would repair the model if they were added; it may be empty.
    """

    def __init__(self, message: str, missing: Iterable[str] = ()):
        super().__init__(message)
        self.missing = tuple(missing)


class SimulationError(StageError, RuntimeError):
    """Error of a simulation that diverged. The stage is back in the state before the physics step that diverged.

    Attributes:
        time: Simulated time of that state, s.
        axis: Name of the axis that diverged first.
    """

    def __init__(self, message: str, time: float, axis: str):
        super().__init__(message)
        self.time = time
        self.axis = axis

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (str(self), self.time, self.axis)


class RunTimeout(StageError, TimeoutError):
    """Error of a condition that did not become true within its timeout of simulated time."""


class LoadError(StageError, ImportError):
    """Error of a part of the package that cannot be loaded because a library that it needs cannot be loaded."""


class GpuMissing(LoadError):
    """Error of a request for a GPU on a machine on which none can be used."""


class NativeError(LoadError):
    """Error of a native library that is missing or does not match the sources or the machine, and could not be built."""


def find_similar_names(name: object, names: Iterable[str], cutoff: float = 0.5) -> list[str]:
    """Return up to three names that are similar to a name, the most similar first; case does not count.

    Args:
        name: Name to compare.
        names: Names to choose from.
        cutoff: Least similarity, 0 to 1.
    """
    from difflib import get_close_matches  # 2 ms of a start that mostly has no error

    folded = {known.casefold(): known for known in names}
    return [folded[match] for match in get_close_matches(str(name).casefold(), folded, n=3, cutoff=cutoff)]


def unknown_name_error(kind: str, name: object, allowed: Iterable[str]) -> ArgumentError:
    """Make the error for an unknown name; its text proposes similar names.

    Args:
        kind: Kind of thing that has the name, such as "axis".
        name: Unknown name.
        allowed: Known names.
    """
    names = sorted(allowed)
    similar = find_similar_names(name, names)
    hint = f" Did you mean {' or '.join(repr(n) for n in similar)}?" if similar else ""
    return ArgumentError(f"unknown {kind} {name!r}.{hint} Known: {', '.join(names) or 'none'}.")


_LETTERS_AFTER_AN = frozenset("8AEFHILMNORSX")
"""Letters and digits whose own names begin with a vowel: an M, an S, an 8."""


def add_article(name: str) -> str:
    """Put the article before a name: "an MCX304", "a PCL240K". A name without vowels is read letter by letter."""
    first, is_word = name[:1].upper(), any(letter in "AEIOU" for letter in name.partition(" ")[0].upper())
    vowel = first in "AEIOU8" if is_word else first in _LETTERS_AFTER_AN
    return f"{'an' if vowel else 'a'} {name}"
