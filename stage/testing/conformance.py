"""`chip_conformance`: does a chip keep the promises that stages, boards, recordings and environments build on?

    from stage.testing import chip_conformance

    chip_conformance(ACME1000)                         raises NotConforming, with each promise that is broken
    test_acme1000 = chip_conformance.tests(ACME1000)   a line in the chip's own tests: a test a promise

Programs are random: a failure says its seed, and `chip_conformance(ACME1000, seed=...)` tries the same again.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from stage.chips import Chip, chip_class
from stage.errors import ArgumentError, NativeError, StageError, unknown
from stage.testing.bounded import NOT_ENDED, bounded
from stage.testing.promises import PROMISES
from stage.testing.trial import Broken, Trial

PROGRAMS = 3
LIMIT = 120.0
"""Seconds of real time for one promise."""
SHORT_LIMIT = 15.0
"""And for the others, once a promise has not ended: what is in a loop without end would take its limit each time."""


class NotConforming(StageError, AssertionError):
    """A chip breaks promises; `broken`: promise -> what it does in its place."""

    def __init__(self, message: str, broken: dict[str, str]):
        super().__init__(message)
        self.broken = broken

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (str(self), self.broken)


class ChipConformance:
    """See this module."""

    promises = tuple(PROMISES)
    """The names of all promises."""

    def __call__(
        self,
        chip: type[Chip] | str,
        *,
        programs: int = PROGRAMS,
        seed: int | None = None,
        promises: Iterable[str] | None = None,
        uncompiled: bool = False,
        limit: float | None = LIMIT,
        **options: Any,
    ) -> None:
        """Try every promise, or those named. A chip whose core cannot be compiled is told at once.

        Args:
            chip: a class, or a chip's name.
            programs: random ones for each promise. 3 take a second or so, 300 find what is rare.
            seed: of the random numbers; default: another each time. It is printed, and is in the error's text.
            uncompiled: and the same programs as plain Python, in a process of its own, must give the same bits.
            limit: seconds of real time for each promise, in a process of its own, so that a core that never answers, or that writes
                beyond an array, is told as a broken promise. Once one has not ended, the others have SHORT_LIMIT. None: in this
                process, without a limit, for debuggers.
            options: what the chip is made with, for example clock_hz.
        Raises NotConforming, ArgumentError for a promise that is not known or a limit that is no time.
        """
        __tracebackhide__ = True
        if limit is not None and not (isinstance(limit, int | float) and limit > 0):
            raise ArgumentError(f"limit={limit!r}: seconds above 0, or None for no limit.")
        kind = chip_class(chip) if isinstance(chip, str) else chip
        if not isinstance(kind, type):
            raise ArgumentError(f"chip={chip!r}: give a class of chips, as PCL240K, or the name of one.")
        seed = random.SystemRandom().getrandbits(32) if seed is None else seed
        print(f"chip_conformance({getattr(kind, '__name__', kind)}, seed={seed})")
        trial = Trial(kind, partial(kind, **options), seed, programs)
        broken: dict[str, str] = {}
        try:
            getattr(kind.CORE.power_up, "c")  # noqa: B009  its library is built here, without a limit
        except NativeError as error:
            raise NotConforming(f"{kind.__name__}: {error}", {"has_what_every_chip_has": str(error)}) from None
        except Exception:  # what is wrong with it, a promise says
            pass
        for name in PROMISES if promises is None else promises:
            if name not in PROMISES:
                raise unknown("promise", name, PROMISES)
            if said := bounded(partial(_tried, PROMISES[name], trial), limit):
                broken[name] = said
                limit = _shorter(limit, broken)
                if name == "has_what_every_chip_has":
                    break
        if uncompiled and not broken:
            from stage.testing.uncompiled import compare

            if said := compare(kind, options, seed, programs, limit):
                broken["compiled = uncompiled"] = said
        if broken:
            lines = "\n".join(
                f"  {PROMISES[n].__doc__ if n in PROMISES else n}\n    but: {b}" for n, b in broken.items()
            )
            raise NotConforming(f"{kind.__name__} breaks {len(broken)} of its promises (seed={seed}):\n{lines}", broken)

    def tests(self, chip: type[Chip] | str, **given: Any) -> Callable:
        """A test function for pytest, with one test for each promise; arguments as those of a call."""
        import pytest

        found: dict[str, str] = {}

        @pytest.mark.parametrize("promise", given.pop("promises", self.promises))
        def test_chip_conformance(promise: str) -> None:
            __tracebackhide__ = True
            try:
                self(chip, promises=[promise], **{**given, "limit": _shorter(given.get("limit", LIMIT), found)})
            except NotConforming as error:
                found.update(error.broken)
                raise

        return test_chip_conformance


def _shorter(limit: float | None, broken: dict[str, str]) -> float | None:
    """The limit, once some of these are broken."""
    hangs = limit is not None and any(said.startswith(NOT_ENDED) for said in broken.values())
    return min(limit, SHORT_LIMIT) if limit is not None and hangs else limit


def _tried(promise: Callable[[Trial], None], trial: Trial) -> str:
    """How it is broken, in words; "" if it is kept."""
    try:
        promise(trial)
    except Broken as error:
        return f"{error}."
    except Exception as error:
        import traceback

        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} ({where.filename}, line {where.lineno}, in {where.name})."
    return ""


chip_conformance = ChipConformance()
