"""`OperationPattern`: the signals and commands that the plot of a move shows.

The base class serves any chip; a family may define a subclass that shows more.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from stage.firmware.move_report import Report

BLUE, GREY, VIOLET, AMBER, GREEN, RED = "#5b8db8", "#9aa5b1", "#9b86bd", "#d9a441", "#4f9d69", "#c8553d"
PatternLane = tuple[str, str, str]
"""Name of a pin, its label and its color."""


class PatternAnnotation(NamedTuple):
    """Line of text above the curve of a plot, with a mark at `time`: a dot for an event, an arrow for a command of the host."""

    time: float
    code: str
    words: str
    event: bool


class OperationPattern:
    """Signals and commands of a report that its plot shows; by default all outputs that change, and every command.

    Attributes:
        LANES: Pins in the order of their lanes, from the top.
        ALWAYS: Pins that the plot shows even if they never change.
    """

    LANES: ClassVar[tuple[PatternLane, ...]] = ()
    ALWAYS: ClassVar[tuple[str, ...]] = ()

    def __init__(self, report: Report):
        self.report, self.waveforms = report, report.waveforms

    def list_lanes(self, pins: Collection[str] | None = None) -> list[tuple[np.ndarray, str, str]]:
        """List the signals of the report that have a meaning in its move, for the plot.

        Args:
            pins: Pins that may be shown; None: all.

        Returns:
            For each signal: an array that says whether it is on after each edge, its label and its color.
        """
        chosen = self.LANES or tuple((pin, pin.upper(), BLUE) for pin in self.waveforms.chip.OUTPUTS)
        visible = (lane for lane in chosen if (pins is None or lane[0] in pins) and self.is_relevant(lane[0]))
        return [(self.waveforms.pin(pin), label, colour) for pin, label, colour in visible]

    def is_relevant(self, pin: str) -> bool:
        """Return whether a pin of the chip has a meaning in this move."""
        on = self.waveforms.pin(pin)
        return pin in self.ALWAYS or bool(on.any() if pin in self.waveforms.chip.INPUTS else on.any() and not on.all())

    def find_minus_edges(self) -> np.ndarray:
        """Return a mask of the edges after which the axis moves in the minus direction."""
        return np.diff(self.waveforms.edges["net"], append=self.waveforms.edges["net"][-1]) < 0

    def list_named_rates(self) -> dict[str, float]:
        """Return the rates that have names in the data sheet, pps."""
        return {}

    def make_annotations(self, times: np.ndarray) -> list[PatternAnnotation]:
        """Return annotations for the commands of the host and the events of the chip.

        Args:
            times: Times of the edges of the report's waveform, s from the first start.
        """
        report = self.report
        notes = [
            PatternAnnotation(when, code.split(" ")[0] + "h" if len(code) == 2 else code, meaning, False)
            for (when, code, meaning), s in zip(report.writes(), report.statements, strict=True)
            if s.kind == "command" and self.needs_annotation(meaning) and when > -0.02 * max(report.duration, 1e-3)
        ]
        return sorted([*notes, *self.make_end_annotations()], key=lambda n: n.time)

    def needs_annotation(self, meaning: str) -> bool:
        """Return whether a command with this meaning gets an annotation in the plot."""
        return True

    def make_end_annotations(self) -> list[PatternAnnotation]:
        """Return annotations that explain why the axis stopped."""
        report = self.report
        if not report.duration or report.stopped_by == "reset command":  # a note of its own
            return []
        why = "stop" if report.stopped_by == "decelerating stop" else report.stopped_by
        return [PatternAnnotation(report.duration, "", why, True)]
