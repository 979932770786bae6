"""Tool that draws the last move as an operation pattern, or the path of a line, as PNG."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

from stage.agents.host_diagnostics import find_readable_pins
from stage.agents.tool import Picture, Tool
from stage.agents.tool_context import ToolContext
from stage.errors import StageError
from stage.firmware.move_report import Report

DOTS_PER_INCH = 90


def make_picture_tool(context: ToolContext) -> Tool:
    """Make the tool `picture` of a stage."""

    def picture() -> Picture:
        """Draw the last move as PNG: pulse rate over time, the writes and the signals; of a line, its rates by axis."""
        if context.report is None:
            raise StageError("There is no move to draw yet: move, home or line make one.")
        return draw_report(context.report, context.mode)

    return Tool.from_method(picture, free=True)


def draw_report(report: Any, mode: str) -> Picture:
    """Draw a report as PNG. In host mode, omit lost steps and all pins that registers do not show."""
    if isinstance(report, Report):
        from stage.firmware.operation_pattern_figure import draw_operation_pattern

        pins = find_readable_pins(report.waveforms.chip) if mode == "host" else None
        figure = draw_operation_pattern(hide_truth(report) if mode == "host" else report, pins=pins)
        text = f"{report.procedure} on axis {report.axis}: pulse rate over time, {report.duration:.4f} s"
    elif mode == "truth":
        figure, text = report.plot(), "a line: its distance from the straight one, and the rates"
    else:
        return draw_report(max(report.axes.values(), key=lambda r: abs(r.pulses)), mode)
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=DOTS_PER_INCH)
    return Picture(png.getvalue(), text)


def hide_truth(report: Report) -> Report:
    """Return a copy of a report without all that no host knows. A write that a fault has lost looks like any other write."""
    statements = tuple(
        s._replace(kind="command", meaning=s.meaning.removeprefix("LOST: ")) if s.kind == "lost" else s
        for s in report.statements
    )
    return replace(report, start=None, position=None, lost_steps=None, statements=statements)
