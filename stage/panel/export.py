"""Samples of a window as files: CSV, PNG, VCD, .rrd. Each gives the bytes.

Pins are as they are at each sample, a physics step or a millisecond apart; to the clock has them a recording, see Stage.record.
"""

from __future__ import annotations

import csv
import io
import os
import tempfile
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from stage.errors import ArgumentError
from stage.extras import need
from stage.identifiers import escape_name
from stage.panel.sampler import Sampler, Trace
from stage.recording.scene import duration
from stage.recording.sdk import release_streams, rr


def heading(trace: Trace) -> str:
    """ "x position (mm)"."""
    return f"{trace.title} ({trace.unit})" if trace.unit else trace.title


def _taken(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> tuple[np.ndarray, list[tuple]]:
    if not names:
        raise ArgumentError("nothing to export: choose a trace first.")
    times, values = sampler.columns(names, begin, end)
    if not len(times):
        raise ArgumentError(f"nothing to export: no samples between {begin:g} and {end:g} s.")
    return times, [(sampler.trace(name), values[name]) for name in names]


def to_csv(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> bytes:
    """A row a sample, a column a trace, in its unit."""
    times, taken = _taken(sampler, names, begin, end)
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["time (s)", *(heading(t) for t, _ in taken)])
    for k, time in enumerate(times):
        rows.writerow([f"{time:.6f}", *(f"{v[k]:.9g}" for _, v in taken)])
    return text.getvalue().encode()


def to_png(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> bytes:
    """As on the page: a picture a unit, a lane a pin. Needs matplotlib (extra `plot`)."""
    Figure = need("matplotlib.figure", "drawing").Figure
    times, taken = _taken(sampler, names, begin, end)
    units = list(dict.fromkeys(t.unit for t, _ in taken if not t.pin))
    pins = [(t, v) for t, v in taken if t.pin]
    heights = [3.0] * len(units) + [0.35] * len(pins)
    figure = Figure(figsize=(9, sum(heights) * 0.75 + 0.8), layout="constrained")
    plots = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for plot, unit in zip(plots, units, strict=False):
        for t, v in taken:
            if not t.pin and t.unit == unit:
                plot.plot(times, v, label=t.title, linewidth=1)
        plot.set_ylabel(unit)
        plot.legend(loc="upper right", fontsize=8)
        plot.grid(alpha=0.3)
    for plot, (t, v) in zip(plots[len(units) :], pins, strict=True):
        plot.fill_between(times, v, step="post")
        plot.set_ylim(0, 1.1)
        plot.set_yticks([])
        plot.set_ylabel(t.title, rotation=0, ha="right", va="center", fontsize=8)
    plots[-1].set_xlabel("time, s")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=120)
    return out.getvalue()


def to_vcd(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> bytes:
    """Pins as wires, 1 while asserted; everything else as reals."""
    from vcd import VCDWriter

    times, taken = _taken(sampler, names, begin, end)
    ns = np.rint(times * 1e9).astype(np.int64)
    text = io.StringIO()
    with VCDWriter(text, "1 ns", date="simulated time since power-up", init_timestamp=int(ns[0])) as writer:
        variables = []
        for t, v in taken:
            scope, _, name = t.name.rpartition("/")
            kind, size = ("wire", 1) if t.pin else ("real", 64)
            variables.append(
                writer.register_var(escape_name(scope), escape_name(name), kind, size=size, init=v[0].item())
            )
        changes = [(int(ns[k]), n) for n, (_, v) in enumerate(taken) for k in np.flatnonzero(np.diff(v)) + 1]
        at = {int(time): k for k, time in enumerate(ns)}
        for time, n in sorted(changes):
            writer.change(variables[n], time, taken[n][1][at[time]].item())
        writer.close(int(ns[-1]))
    return text.getvalue().encode()


def to_rrd(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> bytes:
    """Series for rerun, an entity a trace. Needs rerun (extra `rerun`)."""
    times, taken = _taken(sampler, names, begin, end)
    handle, path = tempfile.mkstemp(suffix=".rrd")
    os.close(handle)
    try:
        out = rr.RecordingStream("pulsestage scope")
        out.save(path)
        for t, v in taken:
            entity = "/".join(map(escape_name, t.name.rsplit("/", 1)))
            out.log(entity, rr.SeriesLines(names=heading(t)), static=True)
            out.send_columns(entity, indexes=[duration(times)], columns=rr.Scalars.columns(scalars=v.astype(float)))
        out.flush()
        out.disconnect()
        del out
        with open(path, "rb") as file:
            return file.read()
    finally:
        release_streams()
        os.unlink(path)


FORMATS: dict[str, Callable[[Sampler, Sequence[str], float, float], Any]] = {
    "csv": to_csv, "png": to_png, "vcd": to_vcd, "rrd": to_rrd,
}  # fmt: skip
"""By the ending of the file's name."""
