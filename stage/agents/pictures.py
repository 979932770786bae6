"""The tool that draws: the last move as an operation pattern, or a line's way, as PNG."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from stage.agents.notes import readable_pins
from stage.agents.tool import Picture, Tool
from stage.errors import StageError
from stage.firmware.report import Report

if TYPE_CHECKING:
    from stage.agents.toolbox import Toolbox

DPI = 90


def tools(box: Toolbox) -> list[Tool]:
    """Of a toolbox."""

    def picture() -> Picture:
        if box.report is None:
            raise StageError("there is no move to draw yet: move, home or line make one.")
        return drawn(box.report, box.mode)

    text = "A drawing of the last move as PNG: pulse rate over time, what was written, the signals; of a line its rates by axis."
    return [Tool("picture", text, picture, free=True)]


def drawn(report: Any, mode: str) -> Picture:
    """A report as a picture. In host mode without lost steps, and with the pins alone that registers show. Raises StageError."""
    if isinstance(report, Report):
        from stage.firmware.plot import draw

        pins = readable_pins(report.course.chip) if mode == "host" else None
        figure = draw(as_host(report) if mode == "host" else report, pins=pins)
        said = f"{report.procedure} on axis {report.axis}: pulse rate over time, {report.duration:.4f} s"
    elif mode == "truth":
        figure, said = report.plot(), "a line: its distance from the straight one, and the rates"
    else:
        return drawn(max(report.axes.values(), key=lambda r: abs(r.pulses)), mode)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return Picture(out.getvalue(), said)


def as_host(report: Report) -> Report:
    """A report without what no host knows; a write that a fault has lost looks as the others."""
    said = tuple(
        s._replace(kind="command", meaning=s.meaning.removeprefix("LOST: ")) if s.kind == "lost" else s
        for s in report.said
    )
    return replace(report, start=None, position=None, lost_steps=None, said=said)
