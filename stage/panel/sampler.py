"""What a stage does, for charts: samples of the last minute, taken while it runs.

    sampler = Sampler(session)
    traces(stage)                                            what there is to see: rates, positions, currents, every pin
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
COARSE, LONGEST = 1e-3, 60.0  # s between the samples of long windows, and how far they go back
EVENTS = 500  # diagnostics that are remembered

_MORE = {
    "velocity": Series("Velocity", ("mm/s", "deg/s"), (1e3, float(np.degrees(1))), 1e-3, lambda s: s["velocity"]),
    "current_a": Series("Current A", ("A", "A"), (1, 1), 0.005, lambda s: s["current_a"], "stepper"),
    "current_b": Series("Current B", ("A", "A"), (1, 1), 0.005, lambda s: s["current_b"], "stepper"),
    "torque": Series("Torque", ("N m", "N m"), (1, 1), 1e-4, lambda s: s["torque"]),
}


class Trace(NamedTuple):
    """Something to see of an axis. name: "x/position"; pin: 0 or 1, on a logic lane; value: from the samples, in `unit`.

    places: the decimals that mean something: what is below them is the arithmetic's."""

    name: str
    axis: int
    title: str
    unit: str
    pin: bool
    value: Any
    places: int = 0


class Event(NamedTuple):
    """Something that happened at `time`, s."""

    time: float
    text: str


def traces(stage: Stage) -> dict[str, Trace]:
    """Everything that can be seen of a stage, by name: the quantities of each axis, then its pins."""
    found = {}
    for axis in stage.axes.values():
        for trace in (*_quantities(axis), *_pins(axis)):
            found[trace.name] = trace
    return found


def _quantities(axis: Axis) -> list[Trace]:
    hinge, mine = axis.unit != "m", "servo" if axis.chip.SERVO else "stepper"
    more = {key: s for key, s in _MORE.items() if s.only in ("", mine)}
    out = []
    for key, s in {**series_of(axis), **more}.items():
        title, unit = s.servo if s.servo and axis.chip.SERVO else (s.title, s.units[hinge])
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
    """The last `room` samples of all axes, by field. `end`: samples that ever came, less those forgotten by going back."""

    def __init__(self, room: int, axes: int):
        self.room, self.end, self.begin = room, 0, 0
        self._times = np.zeros(room)
        self._fields = {name: np.zeros((axes, room), SAMPLE[name]) for name in SAMPLE.names or () if name != "time"}

    def extend(self, rows: np.ndarray) -> None:
        """Rows (n, axes) of SAMPLE, later than all that are here."""
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
        """Time has gone back to `time`, s."""
        if self.end > self.begin and self.last >= time:
            self.end = self.find(time)

    @property
    def last(self) -> float:
        """s, of the newest; -1 where there is none."""
        return float(self._times[(self.end - 1) % self.room]) if self.end > self.begin else -1.0

    @property
    def first(self) -> float:
        """s, of the oldest; of none infinitely late."""
        return float(self._times[self.begin % self.room]) if self.end > self.begin else float("inf")

    def find(self, time: float) -> int:
        """The number of the first sample at `time` or later."""
        low, high = self.begin, self.end
        while low < high:
            middle = (low + high) // 2
            low, high = (middle + 1, high) if self._times[middle % self.room] < time else (low, middle)
        return low

    def times(self, begin: int, end: int) -> np.ndarray:
        """Of samples by number, s."""
        return self._cut(self._times, begin, end)

    def axis(self, axis: int, begin: int, end: int) -> _Columns:
        """The fields of an axis, of samples by number."""
        return _Columns(self, axis, begin, end)

    def _cut(self, kept: np.ndarray, begin: int, end: int) -> np.ndarray:
        if end <= begin:
            return kept[:0].copy()
        a, b = begin % self.room, (end - 1) % self.room + 1
        return kept[a:b].copy() if a < b else np.concatenate([kept[a:], kept[:b]])


class _Columns:
    def __init__(self, ring: SampleBuffer, axis: int, begin: int, end: int):
        self._given = ring, axis, begin, end

    def __getitem__(self, field: str) -> np.ndarray:
        ring, axis, begin, end = self._given
        return ring._cut(ring._fields[field][axis], begin, end)


class Sampler:
    """Samples a session's stage, until `close`.

    Attributes: traces: by name, see `traces`. events: diagnostics of the chips as they came.
    samples, positions, filled: the engine's buffers, as a Recording's; FORWARD: the stage may go back in time meanwhile.
    """

    FORWARD = False

    def __init__(self, session: Session):
        stage = session.stage
        self.session, self.traces = session, traces(stage)
        self.samples = np.zeros((ROWS, len(stage.axes)), SAMPLE)
        self.positions = np.zeros((ROWS, stage.model.nq))
        self.filled = 0
        self.dt = stage.state.dt * 1e-9
        self._thin = max(1, round(COARSE / self.dt))
        self.lock = threading.Lock()
        axes = len(stage.axes)
        self._fine = SampleBuffer(max(64, round(FINE / self.dt)), axes)
        self._coarse = SampleBuffer(max(64, round(LONGEST / self._thin / self.dt)), axes)
        self._phase = 0
        self._recording, self._read = None, 0
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self._said = {id(chip): len(chip.diagnostics) for chip in stage.chips}
        self._also: list[Sampler] = []  # of the same stage: one is told by the engine, and tells the others
        self._over = lambda: None
        if axes:
            session.do(self._join)
            self._over = session.on_slice(self._look)

    # --- in the stage's thread ---

    def take(self, filled: int) -> None:
        """The engine has filled the buffers up to row `filled`."""
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
        """Be told of samples: by the engine, by another sampler that it tells, or by the recording that goes on."""
        now = stage.loop.recording
        if now is None:
            self._attach(stage)
        elif not isinstance(now, Sampler):
            self._follow(now)
        elif self is not now and self not in now._also:
            now._also.append(self)

    def _attach(self, stage: Stage) -> None:
        stage.change()
        stage.loop.recording, self._also = self, []
        handle.log_to(stage.state.handle, self)
        stage.state.clockwork[0].sample_every = 1
        stage.state.world[0].to_sample = 1

    def _look(self, stage: Stage) -> None:
        """After each slice."""
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
        """Somebody records: what is new there."""
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
        """The time of the newest sample, s; -1 where there is none."""
        return self._fine.last

    def trace(self, name: str) -> Trace:
        """By name. Raises ArgumentError with the near misses."""
        if name not in self.traces:
            raise unknown("trace", name, self.traces)
        return self.traces[name]

    def columns(self, names: Sequence[str], begin: float, end: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """The samples from `begin` to `end`, s: their times, and each trace in its unit. Physics steps, where they still are
        there; else samples COARSE apart. Raises ArgumentError."""
        chosen = [self.trace(name) for name in names]
        with self.lock:
            ring = self._ring(begin)
            a, b = ring.find(begin), ring.find(end + 1e-12)
            return ring.times(a, b), {t.name: t.value(ring.axis(t.axis, a, b)) for t in chosen}

    def drawn(
        self, names: Sequence[str], begin: float, end: float, points: int
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """As `columns`, for `points` columns of pixels: of each the least and the greatest value, no peak is missing."""
        times, values = self.columns(names, begin, end)
        return {name: thin_curve(times, v, points) for name, v in values.items()}

    def _ring(self, begin: float) -> SampleBuffer:
        return self._fine if self._fine.first <= max(begin, self._coarse.first) else self._coarse

    def close(self) -> None:
        """End."""
        self._over()
        self.session.do(self._detach)


def thin_curve(times: np.ndarray, values: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """At most 2 `points` of a curve: the least and the greatest of each stretch, in the order in which they come."""
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


__all__ = ["COARSE", "FINE", "LONGEST", "SERIES", "Event", "SampleBuffer", "Sampler", "Trace", "thin_curve", "traces"]
