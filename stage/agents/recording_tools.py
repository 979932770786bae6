"""`StageRecorderTools`: the last recording of a stage as columns of numbers, and as files in a folder that the user has chosen.

In mode "truth", an agent records with the tool `record`. In host mode, the last recording contains the time, pulses and rate of the
last move. Only the tool `save_recording` writes files, and only into the folder.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from stage.agents.tool import Tool
from stage.agents.tool_arguments import Flag, Text, argument
from stage.agents.tool_context import ToolContext
from stage.errors import ArgumentError, StageError
from stage.firmware.move_report import Report
from stage.firmware.synchronized_report import SynchronizedReport

MAX_SAMPLES = 1000  # of a column in an answer
MAX_DURATION_S = 120.0  # simulated time of a recording
MAX_FILES = 20  # of a session
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}\.(rrd|vcd)")


class StageRecorderTools:
    """Tools that record one stage.

    Args:
        context: The stage and what its tools share.
        folder: Folder for the files of `save_recording`; None: the tool does not exist.

    Raises:
        ArgumentError: The folder does not exist.
    """

    def __init__(self, context: ToolContext, folder: str | None = None):
        if folder is not None and not Path(folder).is_dir():
            raise ArgumentError(f"{folder} is no folder: make it first, or name another.")
        self._context, self._folder = context, None if folder is None else Path(folder).resolve()
        self._recording: Any = None
        self._report_at_end: Any = None  # the last report when the recording ended
        self._files = 0

    def list_tools(self) -> list[Tool]:
        """List the tools; there are none in host mode."""
        if self._context.mode != "truth":
            return []
        on = argument(Flag, "true begins a recording, false ends it.")
        tools = [Tool.from_method(self.record, {"on": on})]
        if self._folder is not None:
            name = argument(Text, 'Name of the file: letters, digits, - and _, and ".rrd" or ".vcd".')
            tools.append(Tool.from_method(self.save_recording, {"name": name}, free=True))
        return tools

    def record(self, on: bool) -> dict[str, Any]:
        """Record everything, from now until the recording is ended."""
        stage = self._context.stage
        if on:
            self._recording = stage.record()
            return {"recording": True, "time_s": stage.time}
        if stage.recording is None:
            raise StageError("Nothing is being recorded: begin with on=true.")
        self._recording = stage.recording  # of this session, or one that the owner of the stage has begun
        self._recording.close()
        self._report_at_end = self._context.report
        return {"recording": False, "seconds": self._recording.duration, "columns": list(self._recording.columns)}

    def save_recording(self, name: str) -> dict[str, Any]:
        """Write the last recording into the folder of this server, for rerun (.rrd) or GTKWave (.vcd)."""
        if self._recording is None:
            raise StageError("There is no recording yet: record with on=true, then on=false.")
        if not FILE_NAME.fullmatch(name):
            raise ArgumentError(
                f"name: {name!r} should be a plain name that ends in .rrd or .vcd, such as first_move.rrd."
            )
        path = (self._folder or Path()) / name
        if os.path.lexists(path):
            raise ArgumentError(f"name: {name} exists in the folder. Choose another.")
        if self._files >= MAX_FILES:
            raise StageError(f"A session writes at most {MAX_FILES} files, and this one has written them.")
        if self._context.stage.recording is not None:
            raise StageError("The recording still runs: end it first, with record on=false.")
        (self._recording.save if name.endswith(".rrd") else self._recording.to_vcd)(path)
        self._files += 1
        return {"written": name, "bytes": path.stat().st_size}

    def enforce_duration_limit(self) -> None:
        """End a recording that has become longer than `MAX_DURATION_S`."""
        running = self._context.stage.recording
        if running is not None and running.duration > MAX_DURATION_S:
            running.close()

    def end_session_recording(self) -> None:
        """End the recording that this session has begun, if it is in progress."""
        running = self._context.stage.recording
        if running is not None and running is self._recording:
            running.close()

    def tabulate_last_recording(self) -> dict[str, Any]:
        """Return the last recording, or the rates of the last move if that is later, as columns of up to `MAX_SAMPLES` values.

        Raises:
            StageError: There is neither a recording nor a move.
        """
        report = self._context.report
        is_last = self._context.stage.recording is not None or report is self._report_at_end
        if self._context.mode == "truth" and self._recording is not None and is_last:
            columns = {name: thin_out(np.asarray(c)) for name, c in self._recording.columns.items()}
            return {"seconds": self._recording.duration, "columns": columns}
        if report is None:
            raise StageError("Nothing has been recorded yet: a move makes a recording of its course.")
        if isinstance(report, SynchronizedReport):
            return {"move": "line", "axes": {name: tabulate_waveform(r) for name, r in report.axes.items()}}
        return tabulate_waveform(report)


def tabulate_waveform(report: Report) -> dict[str, Any]:
    """Return time, pulses and rate of a move as columns."""
    net = report.waveforms.edges["net"]
    columns = {"seconds": report.waveforms.seconds, "pulses": net - net[0], "pulses_per_second": report.rates}
    return {"move": report.procedure, "axis": report.axis, "columns": {n: thin_out(c) for n, c in columns.items()}}


def thin_out(column: np.ndarray) -> list:
    """Return at most `MAX_SAMPLES` values of a column as plain numbers, with the first and the last; None for NaN and infinity."""
    if len(column) > MAX_SAMPLES:
        column = column[np.linspace(0, len(column) - 1, MAX_SAMPLES).astype(int)]
    return [None if isinstance(v, float) and not np.isfinite(v) else v for v in column.tolist()]
