"""What a stage does, for charts: samples of the last minute, taken while it runs.

    sampler = Sampler(session)
    find_traces(stage)                                            what there is to see: rates, positions, currents, every pin
    sampler.columns(["x/position", "x/org"], begin, end)     every sample between two moments

The engine samples at each physics step, as it does for a recording; nothing else runs in the stage's thread than copying what has
come. Unlike a recording it keeps no journals, forgets what is old, and lets time go back: what then lies in the future is
forgotten. While somebody records, the sampler reads the recording's samples.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError, unknown
from stage.recording.series import SERIES, Series, series_of
from stage.sim import handle
from stage.sim.records import SAMPLE

if TYPE_CHECKING:
    from stage.panel.session import Session
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

ROWS = 4096  # of the engine's buffer: a second, far more than a slice
FINE = 2.0  # s of physics steps that are kept
COARSE, MAX_AGE_S = 1e-3, 60.0  # s between the samples of long windows, and how far they go back
EVENTS = 500  # diagnostics that are remembered

_MORE = {
    "velocity": Series("Velocity", ("mm/s", "deg/s"), (1e3, float(np.degrees(1))), 1e-3, lambda s: s["velocity"]),
    "current_a": Series("Current A", ("A", "A"), (1, 1), 0.005, lambda s: s["current_a"], "stepper"),
    "current_b": Series("Current B", ("A", "A"), (1, 1), 0.005, lambda s: s["current_b"], "stepper"),
    "torque": Series("Torque", ("N m", "N m"), (1, 1), 1e-4, lambda s: s["torque"]),
}


class Trace(NamedTuple):
    """Quantity or pin of an axis.

    Attributes:
        name: "x/position".
        axis: Index of the axis.
        title, unit: For people.
        pin: 0 or 1, on a logic lane.
        value: Function of samples, in `unit`.
        places: Decimals that mean something; those below are rounding errors.
    """

    name: str
    axis: int
    title: str
    unit: str
    pin: bool
    value: Any
    places: int = 0


class Event(NamedTuple):
    """Event at `time`, s."""

    time: float
    text: str


def find_traces(stage: Stage) -> dict[str, Trace]:
    """Return all traces of a stage by name: the quantities of each axis, then its pins."""
    found = {}
    for axis in stage.axes.values():
        for trace in (*_quantities(axis), *_pins(axis)):
            found[trace.name] = trace
    return found


def _quantities(axis: Axis) -> list[Trace]:
    hinge, mine = axis.unit != "m", "servo" if axis.drive.has_encoder else "stepper"
    more = {key: s for key, s in _MORE.items() if s.only in ("", mine)}
    out = []
    for key, s in {**series_of(axis), **more}.items():
        title, unit = s.servo if s.servo and axis.drive.has_encoder else (s.title, s.units[hinge])
        scale = s.scales[hinge]
        out.append(
            Trace(
                f"{axis.name}/{key}",
                axis.index,
                f"{axis.name} {title.lower()}",
                unit,
                False,
                lambda c, s=s, k=scale: s.value(c) * k,
                1 - math.floor(math.log10(s.tolerance)) if s.tolerance else 0,
            )
        )
    return out


def _pins(axis: Axis) -> list[Trace]:
    out = []
    for field, pins in (("inputs", axis.chip.INPUTS), ("outputs", axis.chip.OUTPUTS)):
        for pin, bit in pins.items():
            out.append(
                Trace(
                    f"{axis.name}/{pin}",
                    axis.index,
                    f"{axis.name} {pin}",
                    "",
                    True,
                    lambda c, f=field, b=bit: (c[f] & b != 0).astype(np.int8),
                )
            )
    return out


class SampleBuffer:
    """Last `room` samples of all axes, by field. `end`: samples that ever came, less those forgotten by going back."""

    def __init__(self, room: int, axes: int):
        self.room, self.end, self.begin = room, 0, 0
        self._times = np.zeros(room)
        self._fields = {name: np.zeros((axes, room), SAMPLE[name]) for name in SAMPLE.names or () if name != "time"}

    def extend(self, rows: np.ndarray) -> None:
        """Add rows (n, axes) of SAMPLE, later than all that are here."""
        rows = rows[-self.room :]
        n, at = len(rows), self.end % self.room
        first = min(n, self.room - at)
        for begin, end, to in ((0, first, at), (first, n, 0)):
            if end > begin:
                part = rows[begin:end]
                self._times[to : to + end - begin] = part["time"][:, 0]
                for name, kept in self._fields.items():
                    kept[:, to : to + end - begin] = part[name].T
        self.end += n
        self.begin = max(self.begin, self.end - self.room)

    def forget_from(self, time: float) -> None:
        """Forget what is at `time`, s, or later: time has gone back."""
        if self.end > self.begin and self.last >= time:
            self.end = self.find(time)

    @property
    def last(self) -> float:
        """Time of the newest sample, s; -1 where there is none."""
        return float(self._times[(self.end - 1) % self.room]) if self.end > self.begin else -1.0

    @property
    def first(self) -> float:
        """Time of the oldest sample, s; infinite where there is none."""
        return float(self._times[self.begin % self.room]) if self.end > self.begin else float("inf")

    def find(self, time: float) -> int:
        """Return the number of the first sample at `time` or later."""
        low, high = self.begin, self.end
        while low < high:
            middle = (low + high) // 2
            low, high = (middle + 1, high) if self._times[middle % self.room] < time else (low, middle)
        return low

    def times(self, begin: int, end: int) -> np.ndarray:
        """Return the times of samples by number, s."""
        return self._cut(self._times, begin, end)

    def axis(self, axis: int, begin: int, end: int) -> _Columns:
        """Return the fields of an axis, of samples by number."""
        return _Columns(self, axis, begin, end)

    def _cut(self, kept: np.ndarray, begin: int, end: int) -> np.ndarray:
        if end <= begin:
            return kept[:0].copy()
        a, b = begin % self.room, (end - 1) % self.room + 1
        return kept[a:b].copy() if a < b else np.concatenate([kept[a:], kept[:b]])


class _Columns:
    def __init__(self, buffer: SampleBuffer, axis: int, begin: int, end: int):
        self._given = buffer, axis, begin, end

    def __getitem__(self, field: str) -> np.ndarray:
        buffer, axis, begin, end = self._given
        return buffer._cut(buffer._fields[field][axis], begin, end)


class Sampler:
    """Samples a session's stage, until `close`.

    Attributes: traces: by name, see `traces`. events: diagnostics of the chips as they came.
    samples, positions, filled: the engine's buffers, as a Recording's; FORWARD: the stage may go back in time meanwhile.
    """

    FORWARD = False

    def __init__(self, session: Session):
        stage = session.stage
        self.session, self.traces = session, find_traces(stage)
        self.samples = np.zeros((ROWS, len(stage.axes)), SAMPLE)
        self.positions = np.zeros((ROWS, stage.model.nq))
        self.filled = 0
        self.dt = stage.state.dt * 1e-9
        self._thin = max(1, round(COARSE / self.dt))
        self.lock = threading.Lock()
        axes = len(stage.axes)
        self._fine = SampleBuffer(max(64, round(FINE / self.dt)), axes)
        self._coarse = SampleBuffer(max(64, round(MAX_AGE_S / self._thin / self.dt)), axes)
        self._phase = 0
        self._recording, self._read = None, 0
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self._said = {id(chip): len(chip.diagnostics) for chip in stage.chips}
        self._also: list[Sampler] = []  # of the same stage: one is told by the engine, and tells the others
        self._over = lambda: None
        if axes:
            session.do(self._join)
            self._over = session.on_slice(self._after_slice)

    # --- in the stage's thread ---

    def take(self, filled: int) -> None:
        """Take the rows up to `filled`, which the engine has put into the buffers."""
        if filled:
            self.filled = 0
            for sampler in (self, *self._also):
                sampler._keep(self.samples[:filled])

    def _keep(self, rows: np.ndarray) -> None:
        with self.lock:
            time = float(rows["time"][0, 0])
            self._fine.forget_from(time)
            self._coarse.forget_from(time)
            self._fine.extend(rows)
            self._coarse.extend(rows[(-self._phase) % self._thin :: self._thin])
            self._phase = (self._phase + len(rows)) % self._thin

    def _join(self, stage: Stage) -> None:
        """Get samples: from the engine, from another sampler that it fills, or from the recording that goes on."""
        now = stage.loop.recording
        if now is None:
            self._attach(stage)
        elif not isinstance(now, Sampler):
            self._follow(now)
        elif self is not now and self not in now._also:
            now._also.append(self)

    def _attach(self, stage: Stage) -> None:
        stage.prepare_change()
        stage.loop.recording, self._also = self, []
        handle.set_sample_buffers(stage.state.handle, self)
        stage.state.clockwork[0].sample_every = 1
        stage.state.world[0].to_sample = 1

    def _after_slice(self, stage: Stage) -> None:
        """Join again after each slice, forget what lies in the future, and note diagnostics."""
        self._join(stage)
        if self._fine.last > stage.time or self._coarse.last > stage.time:
            with self.lock:
                self._fine.forget_from(stage.time)
                self._coarse.forget_from(stage.time)
                while self.events and self.events[-1].time > stage.time:
                    self.events.pop()
        for chip in stage.chips:
            said = len(chip.diagnostics)
            for d in chip.diagnostics[self._said[id(chip)] :]:
                self.events.append(Event(d.clock / chip.clock_hz, f"{type(chip).__name__}: {d.message}"))
            self._said[id(chip)] = said

    def _follow(self, recording: Any) -> None:
        """Take what is new in a recording."""
        if recording is not self._recording:
            self._recording, self._read = recording, 0
        for piece in recording.pieces(begin=self._read):
            self._read += len(piece)
            rows = np.zeros((len(piece), len(recording.axes)), SAMPLE)
            for name in SAMPLE.names or ():
                rows[name] = piece["axes"][name]
            self._keep(rows)

    def _detach(self, stage: Stage) -> None:
        now = stage.loop.recording
        if now is self:
            stage.stop_recording()
            for other in self._also:
                other._join(stage)
        elif isinstance(now, Sampler) and self in now._also:
            now._also.remove(self)

    # --- from any thread ---

    @property
    def last(self) -> float:
        """Time of the newest sample, s; -1 where there is none."""
        return self._fine.last

    def trace(self, name: str) -> Trace:
        """Return a trace by name. Raises ArgumentError with the near misses."""
        if name not in self.traces:
            raise unknown("trace", name, self.traces)
        return self.traces[name]

    def columns(self, names: Sequence[str], begin: float, end: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the samples from `begin` to `end`, s: their times, and each trace in its unit.

        They are physics steps where these are still there, else samples COARSE s apart. Raises ArgumentError.
        """
        chosen = [self.trace(name) for name in names]
        with self.lock:
            buffer = self._find_buffer(begin)
            a, b = buffer.find(begin), buffer.find(end + 1e-12)
            return buffer.times(a, b), {t.name: t.value(buffer.axis(t.axis, a, b)) for t in chosen}

    def thinned_columns(
        self, names: Sequence[str], begin: float, end: float, points: int
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return `columns` thinned to `points` columns of pixels: least and greatest of each, so that no peak is missing."""
        times, values = self.columns(names, begin, end)
        return {name: thin_curve(times, v, points) for name, v in values.items()}

    def _find_buffer(self, begin: float) -> SampleBuffer:
        return self._fine if self._fine.first <= max(begin, self._coarse.first) else self._coarse

    def close(self) -> None:
        """End."""
        self._over()
        self.session.do(self._detach)


def thin_curve(times: np.ndarray, values: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return at most 2 `points` of a curve: the least and the greatest of each stretch, in the order in which they come."""
    if points < 1:
        raise ArgumentError(f"points={points!r}: 1 or more columns of pixels.")
    n = len(values)
    if n <= 2 * points:
        return times, values
    size = -(-n // points)
    rest = -n % size
    v = np.concatenate([values, np.repeat(values[-1:], rest)]).reshape(-1, size)
    low, high = v.argmin(axis=1), v.argmax(axis=1)
    at = np.stack([np.minimum(low, high), np.maximum(low, high)], axis=1) + np.arange(len(v))[:, None] * size
    at = np.minimum(at.ravel(), n - 1)
    return times[at], values[at]


__all__ = [
    "COARSE",
    "FINE",
    "MAX_AGE_S",
    "SERIES",
    "Event",
    "SampleBuffer",
    "Sampler",
    "Trace",
    "find_traces",
    "thin_curve",
]
