"""`chip_conformance`: check that a chip keeps the promises that stages, boards, recordings and environments build on.

    from stage.testing import chip_conformance

    chip_conformance(ACME1000)                         raises ConformanceError, with each promise that is broken
    test_acme1000 = chip_conformance.tests(ACME1000)   a line in the chip's own tests: a test a promise

Programs are random: a failure prints its seed, and `chip_conformance(ACME1000, seed=...)` tries the same again.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from contextlib import closing
from functools import partial
from typing import Any

from stage.chips import Chip, chip_class
from stage.errors import ArgumentError, NativeError, StageError, unknown_name_error
from stage.testing.bounded_child_process import TIME_LIMIT_MESSAGE, BoundedChildProcess
from stage.testing.promise_trial import BrokenPromise, PromiseTrial
from stage.testing.promises import PROMISES

DEFAULT_PROGRAM_COUNT = 3
PROMISE_TIME_LIMIT_S = 120.0
"""Limit of real time for one promise."""
SHORT_TIME_LIMIT_S = 15.0
"""Limit for the other promises after one has not ended in time, because an endless loop would use up the limit for each."""


class ConformanceError(StageError, AssertionError):
    """Error of a chip that breaks promises.

    Attributes:
        broken: What the chip does instead, by the name of each broken promise.
    """

    def __init__(self, message: str, broken: dict[str, str]):
        super().__init__(message)
        self.broken = broken

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (str(self), self.broken)


class ChipConformance:
    """Conformance suite for chips. Call it, or let `tests` make a test function; see the docstring of the module."""

    promises = tuple(PROMISES)
    """The names of all promises."""

    def __call__(
        self,
        chip: type[Chip] | str,
        *,
        programs: int = DEFAULT_PROGRAM_COUNT,
        seed: int | None = None,
        promises: Iterable[str] | None = None,
        uncompiled: bool = False,
        limit: float | None = PROMISE_TIME_LIMIT_S,
        **options: Any,
    ) -> None:
        """Check every promise, or those in `promises`. A core that cannot be compiled is reported at once.

        Args:
            chip: Class of a chip, or its name.
            programs: Number of random programs for each promise. 3 take about a second; 300 also find rare faults.
            seed: Seed of the random numbers; default: a new one in each call. The suite prints it, and the error contains it.
            promises: Names of the promises to check; default: all.
            uncompiled: Whether plain Python in a separate process must give the same bits for the same programs.
            limit: Real time for each promise, s. The promises are checked in a separate process, so that a core that loops
                forever or writes beyond an array is reported as a broken promise. After a loop the others get
                SHORT_TIME_LIMIT_S. None: check in this process without a limit, for debuggers.
            options: Arguments of the chip's constructor, for example clock_hz.

        Raises:
            ConformanceError: The chip breaks a promise.
            ArgumentError: A promise is unknown, or the limit is not a time.
        """
        __tracebackhide__ = True
        chip_class = _check_arguments(chip, limit)
        seed = random.SystemRandom().getrandbits(32) if seed is None else seed
        print(f"chip_conformance({getattr(chip_class, '__name__', chip_class)}, seed={seed})")
        trial = PromiseTrial(chip_class, partial(chip_class, **options), seed, programs)
        try:
            getattr(chip_class.CORE.power_up, "c")  # noqa: B009  its library is built here, without a limit
        except NativeError as error:
            raise ConformanceError(f"{chip_class.__name__}: {error}", {"has_what_every_chip_has": str(error)}) from None
        except Exception:  # what is wrong with it, a promise says
            pass
        names = list(PROMISES if promises is None else promises)
        for name in names:
            if name not in PROMISES:
                raise unknown_name_error("promise", name, PROMISES)
        broken = _find_broken_promises(names, trial, limit)
        if uncompiled and not broken:
            from stage.testing.uncompiled_comparison import compare_with_plain_python

            if report := compare_with_plain_python(chip_class, options, seed, programs, limit):
                broken["compiled = uncompiled"] = report
        if broken:
            raise _make_error(chip_class, seed, broken)

    def tests(self, chip: type[Chip] | str, **options: Any) -> Callable:
        """Make a test function for pytest, with one test for each promise.

        Args:
            chip: Class of a chip, or its name.
            options: Arguments of a call.
        """
        import pytest

        broken: dict[str, str] = {}

        @pytest.mark.parametrize("promise", options.pop("promises", self.promises))
        def test_chip_conformance(promise: str) -> None:
            __tracebackhide__ = True
            try:
                self(
                    chip,
                    promises=[promise],
                    **{**options, "limit": _shorten_limit(options.get("limit", PROMISE_TIME_LIMIT_S), broken)},
                )
            except ConformanceError as error:
                broken.update(error.broken)
                raise

        return test_chip_conformance


def _check_arguments(chip: Any, limit: Any) -> type[Chip]:
    """Return the class of the chip.

    Raises:
        ArgumentError: There is no such chip, or the limit is not a time.
    """
    if limit is not None and not (isinstance(limit, int | float) and limit > 0):
        raise ArgumentError(f"limit={limit!r}: seconds above 0, or None for no limit.")
    found = chip_class(chip) if isinstance(chip, str) else chip
    if not isinstance(found, type):
        raise ArgumentError(f"chip={chip!r}: give a class of chips, as PCL240K, or the name of one.")
    return found


def _make_error(chip_class: type[Chip], seed: int, broken: dict[str, str]) -> ConformanceError:
    """Return the error that lists broken promises."""
    lines = "\n".join(f"  {_describe_promise(name)}\n    but: {report}" for name, report in broken.items())
    return ConformanceError(
        f"{chip_class.__name__} breaks {len(broken)} of its promises (seed={seed}):\n{lines}", broken
    )


def _describe_promise(name: str) -> str:
    """Return the promise that the first paragraph of its function's docstring states; for an unknown name the name."""
    if name not in PROMISES:
        return name
    paragraph = (PROMISES[name].__doc__ or "").split("\n\n")[0]
    return " ".join(paragraph.split()).removeprefix("Check that ")


def _find_broken_promises(names: list[str], trial: PromiseTrial, limit: float | None) -> dict[str, str]:
    """Try promises in a child process, and return what the chip does instead of keeping some of them."""
    broken: dict[str, str] = {}
    functions = [partial(_describe_broken_promise, PROMISES[name], trial) for name in names]
    with closing(BoundedChildProcess(functions)) as child:
        for name in names:
            if report := child.run_next(_shorten_limit(limit, broken)):
                broken[name] = report
                if name == "has_what_every_chip_has":
                    break
    return broken


def _shorten_limit(limit: float | None, broken: dict[str, str]) -> float | None:
    """Return the limit for the next promise, given those that are broken."""
    hangs = limit is not None and any(answers.startswith(TIME_LIMIT_MESSAGE) for answers in broken.values())
    return min(limit, SHORT_TIME_LIMIT_S) if limit is not None and hangs else limit


def _describe_broken_promise(promise: Callable[[PromiseTrial], None], trial: PromiseTrial) -> str:
    """Return how a promise is broken; "" if it is kept."""
    try:
        promise(trial)
    except BrokenPromise as error:
        return f"{error}."
    except Exception as error:
        import traceback

        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} ({where.filename}, line {where.lineno}, in {where.name})."
    return ""


chip_conformance = ChipConformance()
