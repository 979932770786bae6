"""A demonstration of a fault, and its result: figures, table, picture."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any

from stage.units import PLACES, SMALL

Figures = dict[str, Any]
Strike = Callable[..., AbstractContextManager]
Record = Callable[[Any], AbstractContextManager]


@dataclass(frozen=True)
class Claim:
    """What happens with a servo, where this differs from a stepper; see `Demo`."""

    claim: str
    notice: str
    happened: Callable[[Figures, Figures], bool]
    draws: tuple[str, str] = ("position", "following_error")


@dataclass(frozen=True)
class Demo:
    """A fault shown.

    claim: what happens, in a sentence. notice: how a host can tell. program(stage, strike): runs, and returns its figures;
    strike(fault, *args) makes the fault on the faulty stage, nothing on the healthy one. happened(healthy, faulty): the
    claim, in figures. draws: two columns of the first axis' recording for the picture; close_up: seconds before and after the
    moment that it shows, that in which the fault begins, or the first edge of a switch among `draws`. servo: the claim of servos;
    None: the same.
    """

    claim: str
    notice: str
    program: Callable[[Any, Strike], Figures]
    happened: Callable[[Figures, Figures], bool]
    draws: tuple[str, str] = ("position", "lost_steps")
    close_up: tuple[float, float] | None = None
    servo: Claim | None = None

    def of(self, servo: bool) -> Demo:
        """What is claimed of a servo, or of a stepper."""
        return replace(self, **vars(self.servo)) if servo and self.servo else self


SCREW = 10e-3  # m a turn


@dataclass(frozen=True)
class Shown:
    """The result: figures and recordings (None where none was kept) of the healthy run and of the faulty one.

    unit: "m", or "rad" where the first axis is a hinge; figures whose names end in mm and um are of metres, and told in its units.
    turn: m (rad) of the axis for one of the motor. Claims of millimetres speak of a screw of 10 mm.
    """

    name: str
    demo: Demo
    figures: tuple[Figures, Figures]
    recordings: tuple[Any, Any] = field(repr=False)
    unit: str = "m"
    turn: float = SCREW

    @property
    def as_claimed(self) -> bool:
        return self.demo.happened(*map(self._as_of_the_screw, self.figures))

    def _as_of_the_screw(self, figures: Figures) -> Figures:
        return {k: v * SCREW / self.turn if k.endswith(", mm") else v for k, v in figures.items()}

    def table(self) -> str:
        """The figures of both runs, a line each."""
        return table(("", "healthy", "faulty"), self.figures, self.unit)

    def plot(self, path: str | None = None, overwrite: bool = False) -> Any:
        """Both runs over time. Saves to `path` if given; returns the figure. Needs recordings, and matplotlib."""
        from stage.cli.fault.picture import draw

        return draw(self, path, overwrite)


def table(head: tuple[str, str, str], figures: tuple[Figures, Figures], unit: str) -> str:
    """Figures of two runs, a line each; those in mm and um are of m or rad, `unit`, and told in degrees of a hinge."""
    first, second = figures
    rows = [head, *(_line(k, v, second[k], unit) for k, v in first.items())]
    widths = [max(len(r[k]) for r in rows) for k in range(3)]
    return "\n".join("  ".join(v.ljust(w) for v, w in zip(r, widths, strict=True)).rstrip() for r in rows)


def _line(figure: str, first: Any, second: Any, unit: str) -> tuple[str, str, str]:
    what, comma, scale = figure.rpartition(", ")
    units = {"mm": PLACES, "um": SMALL}.get(scale) if comma else None
    if units is None:
        return figure, _text(first), _text(second)
    symbol, per = units[unit]
    return f"{what}, {symbol}", *(_text(v * per / units["m"].per) for v in (first, second))  # type: ignore[return-value]


def _text(value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)
