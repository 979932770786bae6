"""`Pattern`: the signals and commands of a family that a drawing of a move shows. Any chip has one; a family may add to it."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from stage.firmware.report import Report

BLUE, GREY, VIOLET, AMBER, GREEN, RED = "#5b8db8", "#9aa5b1", "#9b86bd", "#d9a441", "#4f9d69", "#c8553d"
Lane = tuple[str, str, str]
"""A pin, its label, its colour."""


class Note(NamedTuple):
    """A line of text above the curve, with an arrow (what the host wrote) or a dot (what happened) at `time`."""

    time: float
    code: str
    words: str
    event: bool


class Pattern:
    """Of a report. By default: the outputs that change, and every command with the map's words for it.

    LANES: pins in the order of their lanes, from above. ALWAYS: those that are shown even where they never change.
    """

    LANES: ClassVar[tuple[Lane, ...]] = ()
    ALWAYS: ClassVar[tuple[str, ...]] = ()

    def __init__(self, report: Report):
        self.report, self.course = report, report.course

    def lanes(self, pins: Collection[str] | None = None) -> list[tuple[np.ndarray, str, str]]:
        """(on from each edge, label, colour) of each signal that plays a role. pins: those that may be shown; None: all."""
        chosen = self.LANES or tuple((pin, pin.upper(), BLUE) for pin in self.course.chip.OUTPUTS)
        visible = (lane for lane in chosen if (pins is None or lane[0] in pins) and self.plays(lane[0]))
        return [(self.course.pin(pin), label, colour) for pin, label, colour in visible]

    def plays(self, pin: str) -> bool:
        """Whether a pin plays a role in this move."""
        on = self.course.pin(pin)
        return pin in self.ALWAYS or bool(on.any() if pin in self.course.chip.INPUTS else on.any() and not on.all())

    def minus(self) -> np.ndarray:
        """Whether the axis goes minus, from each edge on (bool)."""
        return np.diff(self.course.edges["net"], append=self.course.edges["net"][-1]) < 0

    def levels(self) -> dict[str, float]:
        """Rates that have a name, pps."""
        return {}

    def notes(self, t: np.ndarray) -> list[Note]:
        """What the host wrote and what happened. t: s from the first start, of each edge of the course."""
        report = self.report
        notes = [
            Note(when, code.split(" ")[0] + "h" if len(code) == 2 else code, meaning, False)
            for (when, code, meaning), s in zip(report.writes(), report.said, strict=True)
            if s.kind == "command" and self.is_noteworthy(meaning) and when > -0.02 * max(report.duration, 1e-3)
        ]
        return sorted([*notes, *self.describe_end()], key=lambda n: n.time)

    def is_noteworthy(self, meaning: str) -> bool:
        """Whether a command is worth a note."""
        return True

    def describe_end(self) -> list[Note]:
        """Why it stopped."""
        report = self.report
        if not report.duration or report.stopped_by == "reset command":  # a note of its own
            return []
        why = "stop" if report.stopped_by == "decelerating stop" else report.stopped_by
        return [Note(report.duration, "", why, True)]
