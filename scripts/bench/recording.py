"""Benchmark of recording a sample every millisecond: its cost, and the size of its files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.figures import Figure, Run
from bench.machines import make_moving_stage, run_shuttle
from bench.timing import measure_alternately, measure_time

TITLE = "Recording, a sample a millisecond (xyz, three axes to and fro)"


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    seconds = run.choose(10, 5)  # simulated; a full buffer of 4096 samples goes to the temporary file
    stage = make_moving_stage()
    start = stage.snapshot()
    recording: Any = None

    def again() -> None:
        stage.restore(start)

    def work_recorded() -> None:
        nonlocal recording
        recording = stage.record()
        run_shuttle(stage, seconds)
        recording.close()

    works = {"off": (again, lambda: run_shuttle(stage, seconds)), "on": (again, work_recorded)}
    t = measure_alternately(works, run.rounds, 1)
    yield Figure.of("recording.cost", "run recorded / not recorded, time", "ratio", t["on"] / t["off"])
    yield Figure.of("recording.ms", "recording, of a simulated second", "ms", (t["on"] - t["off"]) / seconds * 1e3)
    again()
    work_recorded()
    spans, sizes = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.rrd"
        recording.save(path)  # the first imports rerun
        for _ in range(run.choose(3, 1)):
            spans.append(measure_time(lambda: recording.save(path, overwrite=True)) / seconds * 1e3)
            sizes.append(path.stat().st_size / seconds)
    note = f"of {seconds} s simulated"
    yield Figure.of("recording.save", "save as .rrd, of a simulated second", "ms", spans, note)
    share = np.array(spans) / np.median(t["off"] / seconds * 1e3)
    yield Figure.of("recording.save_share", "  beside the run itself", "ratio", share)
    yield Figure.of("recording.rrd", ".rrd, of a simulated second", "bytes", sizes, note)
