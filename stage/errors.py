"""The project's errors: each says what was given, what is allowed and what to do; state stays as it was."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Self


def escape(text: str) -> str:
    """Write escapes for what UTF-8 cannot encode: the bytes of file names in other encodings."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


class StageError(Exception):
    """Base of every error that PulseStage raises. Its text can be encoded, whatever the names of files in it."""

    def __str__(self) -> str:
        return escape(super().__str__())


class Limit(NamedTuple):
    """What somebody asked of a chip, and from where to where it goes. what: "speed", "start_speed", "fast", the second of two
    speeds (all pps), "acceleration" (pps/s), "accel", a ramp (s), or "pulses"."""

    what: str
    given: float
    least: float
    most: float = float("inf")


class ArgumentError(StageError, ValueError):
    """An argument is out of range or not known.

    Attributes:
        limit: the same as numbers, for who tells it in other units; None where there are none.
    """

    limit: Limit | None = None

    def of(self, limit: Limit) -> Self:
        """This error, with its numbers."""
        self.limit = limit
        return self


class UnknownKey(ArgumentError, KeyError):
    """A mapping has no such key: a KeyError as well, but printed as plain text."""

    def __str__(self) -> str:
        return escape(str(self.args[0]))


class ModelError(StageError, ValueError):
    """An MJCF model does not keep the naming contract; `missing` holds the lines to add.

    Attributes:
        missing: tuple of MJCF lines that would repair the model (may be empty).
    """

    def __init__(self, message: str, missing: Iterable[str] = ()):
        super().__init__(message)
        self.missing = tuple(missing)


class SimulationError(StageError, RuntimeError):
    """The simulation diverged; the stage holds the state before the step that did.

    Attributes:
        time: seconds, the time of the state held.
        axis: name of the axis that diverged first.
    """

    def __init__(self, message: str, time: float, axis: str):
        super().__init__(message)
        self.time = time
        self.axis = axis

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (str(self), self.time, self.axis)


class RunTimeout(StageError, TimeoutError):
    """A condition did not become true within the simulated time allowed."""


class LoadError(StageError, ImportError):
    """A part of the package cannot be loaded, because a library below it cannot."""


class GpuMissing(LoadError):
    """A GPU was asked for, and none can be used here."""


class NativeError(LoadError):
    """The native library is missing, or does not fit these sources or this machine, and could not be built."""


def near_names(given: object, names: Iterable[str], cutoff: float = 0.5) -> list[str]:
    """Those of `names` that are similar to `given`, whatever the case, the most similar first; three at most."""
    from difflib import get_close_matches  # 2 ms of a start that mostly has no error

    folded = {name.casefold(): name for name in names}
    return [folded[near] for near in get_close_matches(str(given).casefold(), folded, n=3, cutoff=cutoff)]


def unknown(kind: str, given: object, allowed: Iterable[str]) -> ArgumentError:
    """An ArgumentError for a name that is not among `allowed`, with the near misses."""
    names = sorted(allowed)
    near = near_names(given, names)
    hint = f" Did you mean {' or '.join(repr(n) for n in near)}?" if near else ""
    return ArgumentError(f"unknown {kind} {given!r}.{hint} Known: {', '.join(names) or 'none'}.")


_SPOKEN_WITH_A_VOWEL = frozenset("8AEFHILMNORSX")
"""What begins with a vowel where it is read letter by letter: an M, an S, an 8."""


def a_or_an(name: str) -> str:
    """With its article: "an MCX304", "a PCL240K", "an ACME1000". What has no vowel is read letter by letter."""
    first, is_word = name[:1].upper(), any(letter in "AEIOU" for letter in name.partition(" ")[0].upper())
    vowel = first in "AEIOU8" if is_word else first in _SPOKEN_WITH_A_VOWEL
    return f"{'an' if vowel else 'a'} {name}"
