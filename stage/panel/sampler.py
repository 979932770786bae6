"""`Sampler`: collect samples of the last minute of a running stage, for charts. This module builds no page.

    sampler = Sampler(session)
    find_traces(stage)                                       the traces: rates, positions, currents, every pin
    sampler.read_columns(["x/position", "x/org"], begin, end)     every sample between two moments

The engine samples at each physics step, as it does for a recording; the stage's thread only copies the samples.
Unlike a recording, a sampler keeps no journals, drops old samples, and lets time go back: it then drops the samples of the future.
During a recording, the sampler reads the recording's samples.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError, unknown_name_error
from stage.recording.axis_series import SERIES, Series, describe_series, select_series
from stage.sim import compiled_stage_access
from stage.sim.engine_records import SAMPLE

if TYPE_CHECKING:
    from stage.panel.session import Session
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

BUFFER_ROWS = 4096  # of the engine's buffer: a second, far more than a slice
FINE_HISTORY_S = 2.0  # physics steps that are kept
INTERVAL_S, MAX_AGE_S = 1e-3, 60.0  # between the samples of long windows, and how far they go back
MAX_EVENTS = 500  # diagnostics that are kept

MORE_SERIES = {
    "velocity": Series("Velocity", ("mm/s", "deg/s"), (1e3, float(np.degrees(1))), 1e-3, lambda s: s["velocity"]),
    "current_a": Series("Current A", ("A", "A"), (1, 1), 0.005, lambda s: s["current_a"], "stepper"),
    "current_b": Series("Current B", ("A", "A"), (1, 1), 0.005, lambda s: s["current_b"], "stepper"),
    "torque": Series("Torque", ("N m", "N m"), (1, 1), 1e-4, lambda s: s["torque"]),
}
"""Series of the page that a recording does not show."""


class Trace(NamedTuple):
    """Quantity or pin of an axis that the oscilloscope can show.

    Attributes:
        name: Name of the axis and of the quantity, for example "x/position".
        axis: Index of the axis.
        title: Title for people.
        unit: Unit of the values for people.
        pin: Whether this is a pin with the values 0 and 1, which has a lane of its own.
        value: Function that converts samples of the axis to values in `unit`.
        places: Significant decimals of the values; further digits are rounding errors.
    """

    name: str
    axis: int
    title: str
    unit: str
    pin: bool
    value: Callable[[np.ndarray], np.ndarray]
    places: int = 0


class DiagnosticEvent(NamedTuple):
    """Diagnostic of a chip at `time`, s."""

    time: float
    text: str


def find_traces(stage: Stage) -> dict[str, Trace]:
    """Return all traces of a stage by name: the quantities, then the pins, of each axis."""
    return {trace.name: trace for axis in stage.axes.values() for trace in (*_list_quantities(axis), *_list_pins(axis))}


def _list_quantities(axis: Axis) -> Iterator[Trace]:
    for key, series in select_series(axis, SERIES | MORE_SERIES).items():
        title, unit, scale = describe_series(series, axis)
        places = 1 - math.floor(math.log10(series.tolerance)) if series.tolerance else 0
        value = partial(_scale_series, series, scale)
        yield Trace(f"{axis.name}/{key}", axis.index, f"{axis.name} {title.lower()}", unit, False, value, places)


def _scale_series(series: Series, scale: float, samples: np.ndarray) -> np.ndarray:
    return series.value(samples) * scale


def _list_pins(axis: Axis) -> Iterator[Trace]:
    for field, pins in (("inputs", axis.chip.INPUTS), ("outputs", axis.chip.OUTPUTS)):
        for pin, bit in pins.items():
            value = partial(_is_asserted, field, bit)
            yield Trace(f"{axis.name}/{pin}", axis.index, f"{axis.name} {pin}", "", True, value)


def _is_asserted(field: str, bit: int, samples: np.ndarray) -> np.ndarray:
    return (samples[field] & bit != 0).astype(np.int8)


class SampleBuffer:
    """Buffer of the last `capacity` samples of all axes.

    The samples are contiguous: the memory has room for twice as many, and when it is full the last samples move to its begin.

    Attributes:
        rows: Samples, dtype SAMPLE, shape (samples, axes), oldest first; a view that `extend` may overwrite.
    """

    def __init__(self, capacity: int, axes: int):
        self._capacity, self._memory = capacity, np.zeros((2 * capacity, axes), SAMPLE)
        self.rows = self._memory[:0]
        self._end = 0

    def extend(self, rows: np.ndarray) -> None:
        """Append samples that are later than all in the buffer; dtype SAMPLE, shape (samples, axes)."""
        rows = rows[-self._capacity :]
        kept = self.rows[max(0, len(self.rows) + len(rows) - self._capacity) :]
        if self._end + len(rows) > len(self._memory):
            self._memory[: len(kept)] = kept.copy()
            self._end = len(kept)
        begin, end = self._end - len(kept), self._end + len(rows)
        self._memory[self._end : end] = rows
        self._end, self.rows = end, self._memory[begin:end]

    def drop_samples_from(self, time: float) -> None:
        """Drop the samples at `time`, s, or later, after time has gone back."""
        n = self.count_before(time)
        self._end -= len(self.rows) - n
        self.rows = self.rows[:n]

    @property
    def first_time(self) -> float:
        """Time of the oldest sample, s; infinite if there is no sample."""
        return float(self.rows["time"][0, 0]) if len(self.rows) else float("inf")

    @property
    def last_time(self) -> float:
        """Time of the newest sample, s; -1 where there is none."""
        return float(self.rows["time"][-1, 0]) if len(self.rows) else -1.0

    def count_before(self, time: float) -> int:
        """Return the number of samples before `time`, s."""
        return int(np.searchsorted(self.rows["time"][:, 0], time))


class Sampler:
    """Collector of samples of a session's stage, until `close`.

    Attributes:
        traces: Traces by name, see `find_traces`.
        events: The last diagnostics of the chips, oldest first.
        samples, positions, filled: Buffers that the engine fills, like those of a Recording.
        REQUIRES_FORWARD_TIME: Whether the stage's time may only go forward while this object samples.
    """

    REQUIRES_FORWARD_TIME = False

    def __init__(self, session: Session):
        stage = session.stage
        self.session, self.traces = session, find_traces(stage)
        axes = len(stage.axes)
        self.samples = np.zeros((BUFFER_ROWS, axes), SAMPLE)
        self.positions = np.zeros((BUFFER_ROWS, stage.model.nq))
        self.filled = 0
        self.dt = stage.state.dt * 1e-9
        self._thin = max(1, round(INTERVAL_S / self.dt))
        self.lock = threading.Lock()
        self._fine = SampleBuffer(max(64, round(FINE_HISTORY_S / self.dt)), axes)
        self._coarse = SampleBuffer(max(64, round(MAX_AGE_S / self._thin / self.dt)), axes)
        self._phase = 0
        self._recording, self._read = None, 0
        self.events: deque[DiagnosticEvent] = deque(maxlen=MAX_EVENTS)
        self._diagnostics_read = {id(chip): len(chip.diagnostics) for chip in stage.chips}
        self._followers: list[Sampler] = []  # samplers of the same stage: the engine fills one, and that one the others
        self._end_observing = lambda: None
        if axes:
            session.do(self._connect_source)
            self._end_observing = session.call_after_pacing_intervals(self._update_after_pacing_interval)

    # --- in the stage's thread ---

    def take_rows(self, filled: int) -> None:
        """Store the first `filled` rows of samples of the engine's buffers.

        The engine's loop calls this when the engine has stopped early, for example because the buffers are full.
        """
        if filled:
            self.filled = 0
            for sampler in (self, *self._followers):
                sampler._store_rows(self.samples[:filled])

    def _store_rows(self, rows: np.ndarray) -> None:
        self._forget_from(float(rows["time"][0, 0]))
        with self.lock:
            self._fine.extend(rows)
            self._coarse.extend(rows[(-self._phase) % self._thin :: self._thin])
            self._phase = (self._phase + len(rows)) % self._thin

    def _forget_from(self, time: float) -> None:
        if max(self._fine.last_time, self._coarse.last_time) >= time:
            with self.lock:
                self._fine.drop_samples_from(time)
                self._coarse.drop_samples_from(time)

    def _connect_source(self, stage: Stage) -> None:
        """Connect to a source of samples: the engine, another sampler of the stage, or the recording that is under way."""
        current = stage.loop.recording
        if current is None:
            self._attach_to_engine(stage)
        elif not isinstance(current, Sampler):
            self._read_recording(current)
        elif self is not current and self not in current._followers:
            current._followers.append(self)

    def _attach_to_engine(self, stage: Stage) -> None:
        stage.prepare_change()
        stage.loop.recording, self._followers = self, []
        compiled_stage_access.set_sample_buffers(stage.state.handle, self)
        stage.state.clockwork[0].sample_every = 1
        stage.state.world[0].to_sample = 1

    def _update_after_pacing_interval(self, stage: Stage) -> None:
        """After each slice, connect to the source again, drop samples and events of the future, and collect diagnostics."""
        self._connect_source(stage)
        self._forget_from(math.nextafter(stage.time, math.inf))
        while self.events and self.events[-1].time > stage.time:
            self.events.pop()
        for chip in stage.chips:
            for d in chip.diagnostics[self._diagnostics_read[id(chip)] :]:
                self.events.append(DiagnosticEvent(d.clock / chip.clock_hz, f"{type(chip).__name__}: {d.message}"))
            self._diagnostics_read[id(chip)] = len(chip.diagnostics)

    def _read_recording(self, recording: Any) -> None:
        """Store the samples that a recording has added since the last call."""
        if recording is not self._recording:
            self._recording, self._read = recording, 0
        for piece in recording.pieces(begin=self._read):
            self._read += len(piece)
            self._store_rows(piece["axes"].astype(SAMPLE))

    def _disconnect_source(self, stage: Stage) -> None:
        """Stop getting samples; connect the samplers that got theirs from this one to another source."""
        current = stage.loop.recording
        if current is self:
            stage.stop_recording()
            for follower in self._followers:
                follower._connect_source(stage)
        elif isinstance(current, Sampler) and self in current._followers:
            current._followers.remove(self)

    # --- from any thread ---

    @property
    def last_time(self) -> float:
        """Time of the newest sample, s; -1 where there is none."""
        return self._fine.last_time

    def find_trace(self, name: str) -> Trace:
        """Return the trace with a name. Raises ArgumentError, with similar names, for an unknown one."""
        if name not in self.traces:
            raise unknown_name_error("trace", name, self.traces)
        return self.traces[name]

    def read_columns(self, names: Sequence[str], begin: float, end: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the samples of a time window: those of each physics step if the window is recent, else samples INTERVAL_S apart.

        Args:
            names: Names of traces.
            begin: Begin of the window, s.
            end: End of the window, s.

        Returns:
            The times, s, shape (samples,), and for each name the values of the trace in its unit, shape (samples,).

        Raises:
            ArgumentError: A trace is unknown.
        """
        traces = [self.find_trace(name) for name in names]
        with self.lock:
            is_fine = self._fine.first_time <= max(begin, self._coarse.first_time)
            buffer = self._fine if is_fine else self._coarse
            rows = buffer.rows[buffer.count_before(begin) : buffer.count_before(end + 1e-12)]
            return rows["time"][:, 0].copy(), {trace.name: trace.value(rows[:, trace.axis]) for trace in traces}

    def read_thinned_columns(
        self, names: Sequence[str], begin: float, end: float, pixel_columns: int
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the curves of a time window, thinned to columns of pixels.

        Args:
            names: Names of traces.
            begin: Begin of the window, s.
            end: End of the window, s.
            pixel_columns: Number of columns of pixels.

        Returns:
            For each name, times, s, and values of the least and the greatest sample in each column, so that no peak is missing.
        """
        times, values = self.read_columns(names, begin, end)
        return {name: thin_curve(times, v, pixel_columns) for name, v in values.items()}

    def close(self) -> None:
        """Stop sampling."""
        self._end_observing()
        self.session.do(self._disconnect_source)


def thin_curve(times: np.ndarray, values: np.ndarray, pixel_columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Thin a curve to the least and the greatest value in each of `pixel_columns` columns of pixels, in the order of time.

    Args:
        times: Times, s, shape (samples,).
        values: Values, shape (samples,).
        pixel_columns: Number of columns, 1 or more.

    Returns:
        Times and values of at most 2 `pixel_columns` points.
    """
    if pixel_columns < 1:
        raise ArgumentError(f"pixel_columns={pixel_columns!r}: 1 or more columns of pixels.")
    n = len(values)
    if n <= 2 * pixel_columns:
        return times, values
    size = -(-n // pixel_columns)
    rest = -n % size
    v = np.concatenate([values, np.repeat(values[-1:], rest)]).reshape(-1, size)
    low, high = v.argmin(axis=1), v.argmax(axis=1)
    at = np.stack([np.minimum(low, high), np.maximum(low, high)], axis=1) + np.arange(len(v))[:, None] * size
    at = np.minimum(at.ravel(), n - 1)
    return times[at], values[at]
