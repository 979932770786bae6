"""`Recordings`: what was recorded last in a toolbox, as columns of numbers; and files of it, in one folder that was given.

In mode "truth" an agent records with the tool `record`; in host mode the last recording is the course of the last move: time,
pulses and rate. No file is written but by `save_recording`, and only into the folder.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from stage.agents.fields import FLAG, TEXT, Field
from stage.agents.tool import Tool
from stage.agents.toolbox import Toolbox
from stage.errors import ArgumentError, StageError
from stage.firmware.report import Report
from stage.firmware.together import SynchronizedReport

SAMPLES = 1000  # of a column that is told
LONGEST = 120.0  # s of simulated time that a recording may have
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}\.(rrd|vcd)")
FILES = 20  # a session


class Recordings:
    """Of one toolbox. folder: where files may be written; None: nowhere."""

    def __init__(self, box: Toolbox, folder: str | None = None):
        if folder is not None and not os.path.isdir(folder):
            raise ArgumentError(f"{folder} is no folder: make it first, or name another.")
        self._box, self._folder = box, None if folder is None else Path(folder).resolve()
        self._last: Any = None
        self._seen: Any = None  # the report that was the last one when the recording ended
        self._written = 0

    def join(self) -> None:
        """Add the tools to the toolbox, and be what it calls its recordings."""
        box = self._box
        box.recordings = self
        if box.mode != "truth":
            return
        on = Field("on", FLAG, "true begins a recording, false ends it", True)
        box.tools["record"] = Tool("record", "Record all that happens, from now until it is ended.", self.record, (on,))
        if self._folder is not None:
            name = Field("name", TEXT, 'of the file: letters, digits, - and _, and ".rrd" or ".vcd"', True)
            text = "Write the last recording into the folder of this server, for rerun (.rrd) or GTKWave (.vcd)."
            box.tools["save_recording"] = Tool("save_recording", text, self.save, (name,), free=True)

    def record(self, on: bool) -> dict[str, Any]:
        stage = self._box.stage
        if on:
            self._last = stage.record()
            return {"recording": True, "time_s": stage.time}
        if stage.recording is None:
            raise StageError("nothing is being recorded: begin with on=true.")
        stage.recording.close()
        self._seen = self._box.report
        return {"recording": False, "seconds": self._last.duration, "columns": list(self._last.columns)}

    def save(self, name: str) -> dict[str, Any]:
        if self._last is None:
            raise StageError("there is no recording yet: record with on=true, then on=false.")
        if not NAME.fullmatch(name):
            raise ArgumentError(f"name: {name!r} should be a plain name that ends in .rrd or .vcd, as first_move.rrd.")
        path = (self._folder or Path()) / name
        if os.path.lexists(path):
            raise ArgumentError(f"name: {name} exists in the folder. Choose another.")
        if self._written >= FILES:
            raise StageError(f"a session writes {FILES} files at most, and has.")
        if self._box.stage.recording is not None:
            raise StageError("the recording goes on: end it first, with record on=false.")
        (self._last.save if name.endswith(".rrd") else self._last.to_vcd)(path)
        self._written += 1
        return {"written": name, "bytes": path.stat().st_size}

    def bound(self) -> None:
        """After a call: a recording does not grow without end."""
        going_on = self._box.stage.recording
        if going_on is not None and going_on.duration > LONGEST:
            going_on.close()

    def last(self) -> dict[str, Any]:
        """The last recording as columns, thinned to SAMPLES. Raises StageError where there is none."""
        report = self._box.report
        goes_on = self._box.stage.recording is not None
        if self._box.mode == "truth" and self._last is not None and (goes_on or report is self._seen):
            columns = {name: np.asarray(c) for name, c in self._last.columns.items()}
            return {"seconds": self._last.duration, "columns": {name: thinned(c) for name, c in columns.items()}}
        if report is None:
            raise StageError("nothing has been recorded yet: a move makes a recording of its course.")
        if isinstance(report, SynchronizedReport):
            return {"move": "line", "axes": {name: course(r) for name, r in report.axes.items()}}
        return course(report)


def course(report: Report) -> dict[str, Any]:
    """The course of a move as columns."""
    edges = report.course.edges
    columns = {
        "seconds": report.course.seconds,
        "pulses": edges["net"] - edges["net"][0],
        "pulses_per_second": report.rates,
    }
    return {"move": report.procedure, "axis": report.axis, "columns": {n: thinned(c) for n, c in columns.items()}}


def thinned(column: np.ndarray) -> list:
    """At most SAMPLES of it, the first and the last among them, as plain numbers."""
    if len(column) > SAMPLES:
        column = column[np.linspace(0, len(column) - 1, SAMPLES).astype(int)]
    values = column.tolist()
    return [None if isinstance(v, float) and not np.isfinite(v) else v for v in values]
