"""`Oscilloscope`: show traces of a `Sampler` in a time window with a trigger, and export the window to files.

This module draws no page.

    scope = Oscilloscope(sampler, ["x/rate", "x/org"], window_s=0.5)
    scope.set_trigger("normal", "x/org", rising=True)
    frame = scope.frame(600)            frame.curves["x/rate"]: (times, values) for 600 columns of pixels

In files pins are as they are at each sample, a physics step or a millisecond apart; a recording has them to the clock, see
Stage.record.
"""

from __future__ import annotations

import csv
import io
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stage.errors import ArgumentError
from stage.panel.sampler import MAX_AGE_S, Sampler, Trace
from stage.recording.lazy_rerun import release_streams, rr
from stage.recording.rerun_scene import to_time_column
from stage.support.extras import import_extra
from stage.support.identifier_escapes import escape_name

MIN_WINDOW_LENGTH_S = 1e-3
WINDOW_LENGTHS_S = (1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
MODES = ("free", "auto", "normal", "single")
DIAGNOSTIC, LOST = "a diagnostic", "a lost step"
PRETRIGGER_SHARE = 0.25  # part of the window before the trigger
AUTO_TIMEOUT_S = 1.0  # s of simulated time after which "auto" shows the newest window


@dataclass(frozen=True)
class OscilloscopeFrame:
    """One picture of an oscilloscope.

    Attributes:
        begin, end: Begin and end of the time window, s.
        curves: Times, s, and values of each trace, by the name of the trace.
        trigger: Time of the trigger, s, or None.
        state: State of the oscilloscope in a word, for example "running".
    """

    begin: float
    end: float
    curves: dict[str, tuple[np.ndarray, np.ndarray]]
    trigger: float | None
    state: str


class Oscilloscope:
    """Oscilloscope that shows traces of a sampler in a time window.

    Args:
        sampler: Source of the samples.
        names: Names of the traces to show.
        window_s: Length of the time window, s.

    Raises:
        ArgumentError: A trace is unknown, or `window_s` is out of range.
    """

    def __init__(self, sampler: Sampler, names: Sequence[str] = (), window_s: float = 2.0):
        self.sampler = sampler
        self.names: list[str] = []
        self.select_traces(names)
        self.mode, self.source, self.rising, self.level = "free", "", True, 0.5
        self._running, self._window = True, (0.0, window_s)
        self._trigger_time: float | None = None
        self.set_window_length(window_s)
        self.arm()

    def select_traces(self, names: Sequence[str]) -> None:
        """Show the traces with these names. Raises ArgumentError, with similar names, for an unknown trace."""
        self.names = [self.sampler.find_trace(name).name for name in names]

    def set_window_length(self, window_s: float) -> None:
        """Set the length of the time window, s. Raises ArgumentError if `window_s` is out of range."""
        if not MIN_WINDOW_LENGTH_S <= window_s <= MAX_AGE_S:
            raise ArgumentError(f"window_s={window_s!r}: a window of {MIN_WINDOW_LENGTH_S:g} to {MAX_AGE_S:g} s.")
        self.window_s = float(window_s)
        if self._running:
            return
        end = self._window[1]
        self._window = (end - window_s, end) if self._trigger_time is None else self._compute_window(self._trigger_time)

    def set_trigger(self, mode: str, source: str = "", rising: bool = True, level: float = 0.5) -> None:
        """Set the event that triggers a new picture.

        Args:
            mode: "free": no trigger; "auto": new pictures also while no trigger comes; "normal": only after a trigger; "single":
                one picture after the next trigger.
            source: Name of the trace that triggers when it crosses `level` (a pin: at its edge); or DIAGNOSTIC, or LOST.
            rising: Whether a rising, not a falling, crossing triggers.
            level: Level of the crossing, in the unit of the trace.

        Raises:
            ArgumentError: An unknown mode or trace, or a level that is not finite.
        """
        if mode not in MODES:
            raise ArgumentError(f"mode={mode!r}: {', '.join(MODES)}.")
        if mode != "free" and source not in (DIAGNOSTIC, LOST):
            level = 0.5 if self.sampler.find_trace(source).pin else level
        if not np.isfinite(level):
            raise ArgumentError(f"level={level!r}: a number, in the unit of the trace.")
        self.mode, self.source, self.rising, self.level = mode, source, rising, float(level)
        self.arm()

    def arm(self) -> None:
        """Discard the last trigger, and wait for the next one from now on."""
        self._trigger_time, self._running = None, True
        self._armed_at = self._last_time = self.sampler.last_time

    @property
    def running(self) -> bool:
        """True if the time window follows the time; False: the picture is frozen."""
        return self._running

    @running.setter
    def running(self, value: bool) -> None:
        if value and not self._running:
            self.arm()
        self._running = bool(value)

    def capture_frame(self, pixel_columns: int) -> OscilloscopeFrame:
        """Return the picture now, with each curve thinned to `pixel_columns` columns of pixels."""
        now = self.sampler.last_time
        if self._running:
            self._move_window(now)
        begin, end = self._window
        curves = self.sampler.read_thinned_columns(self.names, begin, end, pixel_columns)
        return OscilloscopeFrame(begin, end, curves, self._trigger_time, self._describe_state(now))

    def _move_window(self, now: float) -> None:
        """Move the time window to the newest trigger, or to time `now`, s, as the trigger mode demands."""
        newest = now - self.window_s, now
        if now < self._last_time:  # time has gone back: what was shown is not any more
            self._armed_at, self._trigger_time, self._window = now, None, newest
        self._last_time = now
        if self.mode == "free":
            self._window = newest
        elif self._trigger_time is None or now >= self._window[1]:
            if self.mode == "single" and self._trigger_time is not None:
                self._running = False
            elif (trigger := self._find_trigger(now)) is not None:
                self._trigger_time, self._window = trigger, self._compute_window(trigger)
                self._armed_at = self._window[1]
                self._running = self.mode != "single" or now < self._window[1]
            elif self.mode == "auto" and now - self._armed_at > max(AUTO_TIMEOUT_S, self.window_s):
                self._trigger_time, self._window = None, newest

    def _compute_window(self, trigger: float) -> tuple[float, float]:
        return trigger - PRETRIGGER_SHARE * self.window_s, trigger + (1 - PRETRIGGER_SHARE) * self.window_s

    def _find_trigger(self, now: float) -> float | None:
        """Return the time, s, of the trigger since `arm` to show, or None if there was no trigger.

        This is the latest trigger whose time window has passed completely; the first one in mode "single", or if no window has.
        """
        times = self._list_triggers(now)
        if not len(times):
            return None
        full = times[times + (1 - PRETRIGGER_SHARE) * self.window_s <= now]
        return float(full[-1] if len(full) and self.mode != "single" else times[0])

    def _list_triggers(self, now: float) -> np.ndarray:
        since = self._armed_at
        if self.source == DIAGNOSTIC:
            return np.array([e.time for e in tuple(self.sampler.events) if since < e.time <= now])
        is_lost = self.source == LOST
        names = [n for n in self.sampler.traces if n.endswith("/lost_steps")] if is_lost else [self.source]
        times, values = self.sampler.read_columns(names, since, now)
        triggers = [np.empty(0)]
        for v in values.values():
            above = (v >= self.level) == self.rising
            crossings = np.diff(v) != 0 if is_lost else above[1:] & ~above[:-1]
            triggers.append(times[1:][crossings])
        return np.sort(np.concatenate(triggers))

    def _describe_state(self, now: float) -> str:
        if not self._running:
            return "frozen"
        if self.mode == "free":
            return "running"
        is_triggered = self._trigger_time is not None and now < self._window[1]
        return "triggered" if is_triggered else "waits for the trigger"


def format_heading(trace: Trace) -> str:
    """Return the name of a trace with its unit, "x position (mm)"."""
    return f"{trace.title} ({trace.unit})" if trace.unit else trace.title


def _collect_columns(
    sampler: Sampler, names: Sequence[str], begin: float, end: float
) -> tuple[np.ndarray, list[tuple]]:
    if not names:
        raise ArgumentError("nothing to export: choose a trace first.")
    times, values = sampler.read_columns(names, begin, end)
    if not len(times):
        raise ArgumentError(f"nothing to export: no samples between {begin:g} and {end:g} s.")
    return times, [(sampler.find_trace(name), values[name]) for name in names]


def to_csv(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> bytes:
    """Export traces to CSV: a row for each sample, a column for each trace in its unit."""
    times, columns = _collect_columns(sampler, names, begin, end)
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["time (s)", *(format_heading(t) for t, _ in columns)])
    for k, time in enumerate(times):
        rows.writerow([f"{time:.6f}", *(f"{v[k]:.9g}" for _, v in columns)])
    return text.getvalue().encode()


def to_png(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> bytes:
    """Export traces to a PNG picture: a chart for each unit, a lane for each pin. Needs matplotlib (extra `plot`)."""
    times, columns = _collect_columns(sampler, names, begin, end)
    units = list(dict.fromkeys(t.unit for t, _ in columns if not t.pin))
    pins = [(t, v) for t, v in columns if t.pin]
    heights = [3.0] * len(units) + [0.35] * len(pins)
    figure = import_extra("matplotlib.figure", "drawing").Figure(
        figsize=(9, sum(heights) * 0.75 + 0.8), layout="constrained"
    )
    plots = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for plot, unit in zip(plots, units, strict=False):
        for t, v in columns:
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
    """Export traces to VCD: pins as wires, which are 1 while asserted, and other traces as reals."""
    from vcd import VCDWriter

    times, columns = _collect_columns(sampler, names, begin, end)
    ns = np.rint(times * 1e9).astype(np.int64)
    text = io.StringIO()
    with VCDWriter(text, "1 ns", date="simulated time since power-up", init_timestamp=int(ns[0])) as writer:
        variables = []
        for t, v in columns:
            scope, _, name = t.name.rpartition("/")
            kind, size = ("wire", 1) if t.pin else ("real", 64)
            variables.append(
                writer.register_var(escape_name(scope), escape_name(name), kind, size=size, init=v[0].item())
            )
        changes = np.stack([np.diff(v) != 0 for _, v in columns], axis=1)
        for k, n in np.argwhere(changes):  # in the order of time
            writer.change(variables[n], int(ns[k + 1]), columns[n][1][k + 1].item())
        writer.close(int(ns[-1]))
    return text.getvalue().encode()


def to_rrd(sampler: Sampler, names: Sequence[str], begin: float, end: float) -> bytes:
    """Export traces to a recording for rerun, with an entity for each trace. Needs rerun (extra `rerun`)."""
    times, columns = _collect_columns(sampler, names, begin, end)
    handle, path = tempfile.mkstemp(suffix=".rrd")
    os.close(handle)
    try:
        out = rr.RecordingStream("pulsestage scope")
        out.save(path)
        for t, v in columns:
            entity = "/".join(map(escape_name, t.name.rsplit("/", 1)))
            out.log(entity, rr.SeriesLines(names=format_heading(t)), static=True)
            out.send_columns(
                entity, indexes=[to_time_column(times)], columns=rr.Scalars.columns(scalars=v.astype(float))
            )
        out.flush()
        out.disconnect()
        del out
        return Path(path).read_bytes()
    finally:
        release_streams()
        Path(path).unlink()


FORMATS: dict[str, Callable[[Sampler, Sequence[str], float, float], Any]] = {
    "csv": to_csv, "png": to_png, "vcd": to_vcd, "rrd": to_rrd,
}  # fmt: skip
"""Export functions by the ending of the file's name."""
