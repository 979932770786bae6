"""Columns of a recording read from an .rrd file: `read("x.rrd")`.

The file contains only the samples of each series that its plot needs, see rerun_log.py. The columns interpolate between them at the
time of each original sample, within the tolerance of SERIES. Switches and phases in `states` are exact to the clock.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from stage.errors import StageError, unknown_name_error
from stage.recording.axis_series import FORMAT_VERSION, SERIES
from stage.recording.column_files import Columns, ColumnTable
from stage.recording.recording import RecordingError, find_column_unit
from stage.recording.rrd_reader_process import DamagedFileError, read_chunks
from stage.support.extras import import_extra, is_installed
from stage.support.foreign_files import open_regular
from stage.support.identifier_escapes import escape_name

MAGIC = b"RRF"
INTEGER_SERIES = ("lost_steps", "counter")
MAX_FILE_BYTES = 1 << 34
MAX_SAMPLES = 1 << 28  # three days, a sample every millisecond
COLUMN_NAMES = {"current": "current_a"}
"""Columns of series that have another name."""

State = tuple[np.ndarray, np.ndarray]


class SavedRecording(ColumnTable):
    """Content of an .rrd file. `read` creates it.

    Attributes:
        path: The file.
        model: Name of the model in its MJCF.
        axes: Chip, motor and distance per pulse in words, by name of the axis.
        every: Seconds between samples.
        columns: "time" (s), "x/position" ..., as in `Recording.columns`, as far as the file has them; "x/el_plus" ... (bool):
            whether the switch is on; "x/phase" (text).
        states: Times (s) and states (text) from each time on, by lane: "x/phase", "x/el_plus", "faults".
        bus: Time (s) and text of each bus write in the file, in order.
    """

    ERROR = RecordingError

    def __init__(self, path: Path, entities: dict[str, dict[str, Any]]):
        self.path, self._entities = path, entities
        about = entities.get("/__properties/columns", {})
        known = {name: values[0] for name, (_, values) in about.items()}
        if not known:
            raise RecordingError(
                f"{path} is a rerun file, but no recording of this PulseStage: it does not say what its columns are. Give one that "
                "Recording.save or --record has written."
            )
        if known["format"] != [FORMAT_VERSION]:
            raise RecordingError(
                f"{path} is of format {known['format'][0]}, and this PulseStage reads format {FORMAT_VERSION}: read it with the "
                "version that wrote it."
            )
        self._kinds = dict(zip(known["axes"], zip(known["units"], known["servos"], strict=True), strict=True))
        self.every = known["every_ns"][0] * 1e-9
        self._every_ns = known["every_ns"][0]
        self.axes = {name: self._read_property("axes", name) for name in self._kinds}
        self.model = self._read_property("stage", "model")

    def _read_property(self, entity: str, name: str) -> str:
        """Return a text property of the file by its entity and name; "" if the file has none."""
        _, values = self._entities.get(f"/__properties/{entity}", {}).get(name, (None, [[""]]))
        return str(values[-1][0])

    @cached_property
    def _series(self) -> dict[str, tuple[str, str, np.ndarray, np.ndarray]]:
        """Axis, series, times (ns) and drawn values, by name of the column."""
        series = {}
        for axis in self._kinds:
            for key in SERIES:
                drawn = self._entities.get(f"/axes/{escape_name(axis)}/{key}", {}).get("Scalars:scalars")
                if drawn is not None and drawn[0] is not None:
                    order = np.argsort(drawn[0], kind="stable")
                    values = np.array([v[0] for v in drawn[1]], float)[order]
                    series[f"{axis}/{COLUMN_NAMES.get(key, key)}"] = (axis, key, drawn[0][order], values)
        return series

    @cached_property
    def states(self) -> dict[str, State]:
        """Times (s) and the state from each time on, by lane."""
        states_by_lane = {}
        lanes = {f"{axis}/phase": f"/axes/{escape_name(axis)}/phase" for axis in self._kinds}
        for axis in self._kinds:
            begin = f"/axes/{escape_name(axis)}/switches/"
            lanes |= {f"{axis}/{e.removeprefix(begin)}": e for e in sorted(self._entities) if e.startswith(begin)}
        for lane, entity in (lanes | {"faults": "/faults"}).items():
            times, states = self._entities.get(entity, {}).get("StateChange:state", (None, []))
            if times is not None:
                order = np.argsort(times, kind="stable")
                states_by_lane[lane] = (times[order] * 1e-9, np.array([s[0] for s in states])[order])
        return states_by_lane

    @cached_property
    def bus(self) -> list[tuple[float, str]]:
        """Time (s) and text of each bus write in the file, in order."""
        writes = []
        for axis in self._kinds:
            times, texts = self._entities.get(f"/axes/{escape_name(axis)}/bus", {}).get("TextLog:text", (None, []))
            if times is not None:
                writes += [
                    (float(t) * 1e-9, text[0].split(maxsplit=1)[1]) for t, text in zip(times, texts, strict=True)
                ]
        return sorted(writes)

    @cached_property
    def _sample_times_ns(self) -> np.ndarray:
        """Times of the samples, ns."""
        spans = [(times[0], times[-1]) for *_, times, _ in self._series.values() if len(times)]
        if not spans:
            return np.zeros(0, np.int64)
        begin, end = int(min(b for b, _ in spans)), int(max(e for _, e in spans))
        if (end - begin) // self._every_ns > MAX_SAMPLES:
            raise ValueError(f"from {begin} ns to {end} ns there are more than {MAX_SAMPLES:,} samples")
        return np.arange(begin, end + 1, self._every_ns)

    def __len__(self) -> int:
        return len(self._sample_times_ns)

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of each column, "" for states."""
        units = {"time": "s"}
        for axis in self._kinds:
            units |= {
                c: find_column_unit(c.rpartition("/")[2], *self._kinds[axis])
                for c in self._series
                if self._series[c][0] == axis
            }
            units |= {lane: "" for lane in self.states if lane.rpartition("/")[0] == axis}
        return units

    def check(self) -> None:
        """Raise ValueError, or another built-in exception, if the columns are inconsistent because the file is damaged."""
        if not self._every_ns > 0:
            raise ValueError(f"a sample every {self._every_ns} ns")
        for *_, times, values in self._series.values():
            if len(times) != len(values):
                raise ValueError(f"{len(times)} times of {len(values)} samples")
        for lane, (times, states) in self.states.items():
            if len(times) != len(states):
                raise ValueError(f"{lane} has {len(times)} times of {len(states)} states")
        _ = self.bus, self.units, self._sample_times_ns

    def column(self, name: str) -> np.ndarray:
        """Return one column, (len(self),). Raises ArgumentError with similar names for an unknown one."""
        if name not in self.units:
            raise unknown_name_error("column", name, self.units)
        if name == "time":
            return self._sample_times_ns * 1e-9
        if name in self._series:
            axis, key, times, drawn = self._series[name]
            hinge = self._kinds[axis][0] != "m"
            values = np.interp(self._sample_times_ns, times, drawn) / SERIES[key].scales[hinge]
            return np.rint(values).astype(np.int64) if key in INTEGER_SERIES else values
        times, states = self.states[name]
        at = np.maximum(np.searchsorted(np.rint(times * 1e9), self._sample_times_ns, side="right") - 1, 0)
        return states[at] if name.endswith("/phase") else (states != "off")[at]

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns by name."""
        return Columns({name: self.column(name) for name in self.units})

    def _iterate_columns(self, names: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        yield {name: self.column(name) for name in names}

    def __repr__(self) -> str:
        return f"<SavedRecording {self.path.name}, {len(self)} samples of {', '.join(self.axes)}, {len(self) * self.every:.3f} s>"


def read(path: str | os.PathLike) -> SavedRecording:
    """Read a recording that `Recording.save`, `Recording.stream` or `--record` has written.

    Args:
        path: The file, .rrd.

    Raises:
        RecordingError: The file is missing, damaged, or no recording of PulseStage.
        ExtraMissing: There is no rerun.
    """
    with open_regular(path, "recording", MAX_FILE_BYTES, RecordingError) as file:
        path = Path(path)
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError(
                f"{path} is no recording: an .rrd file begins with {MAGIC.decode()}, and this does not. Give one that "
                "Recording.save or --record has written."
            )
    if not is_installed("rerun"):
        # raises ExtraMissing; the import itself takes half a second
        import_extra("rerun", "reading a recording (.rrd)")
    entities: dict[str, dict[str, Any]] = {}
    try:
        for entity, batch in read_chunks(path):
            _add_chunk(entities.setdefault(entity, {}), batch)
        saved = SavedRecording(path, entities)
        saved.check()
    except (
        DamagedFileError,
        LookupError,
        TypeError,
        ValueError,
        OverflowError,
        AttributeError,
        NotImplementedError,
    ) as error:
        if isinstance(error, StageError):
            raise
        reason = (
            str(error) if isinstance(error, DamagedFileError) else f"its columns do not fit together ({error!r:.100})"
        )
        raise RecordingError(
            f"{path} is damaged: {reason}. Of a run that was killed while it wrote, `rerun rrd merge {path} -o "
            "whole.rrd` keeps what is whole."
        ) from error
    return saved


def _add_chunk(entity: dict[str, Any], batch: Any) -> None:
    """Append the columns of a rerun chunk to those of an entity.

    Args:
        entity: Columns read so far, by name of the rerun component: times, ns (None for static data), and values.
        batch: The chunk, an Arrow record batch.
    """
    kinds = {field.name: (field.metadata or {}).get(b"rerun:kind", b"data") for field in batch.schema}
    timeline = "time" if kinds.get("time") == b"index" else ""  # an axis may have that name, too
    time = batch.column(timeline).to_numpy(zero_copy_only=False).astype(np.int64) if timeline else None
    for name in (name for name, kind in kinds.items() if kind == b"data"):
        column, before = batch.column(name), entity.get(name)
        if str(column.type).startswith(
            "timestamp"
        ):  # of other programs' files; Arrow makes no datetime of ns without pandas
            column = column.cast("int64")
        values = column.to_pylist()
        if time is not None and before is not None:
            entity[name] = (np.concatenate([before[0], time]), before[1] + values)
        else:
            entity[name] = (time, values)
