"""`Recording`: what a stage did, kept cheaply while it runs and converted when it is saved.

    with stage.record() as recording:
        firmware.origin_return(stage.axes["x"])
    recording.columns["x/position"]
    recording.save("x.rrd")
    recording.to_vcd("x.vcd")

The engine fills a buffer of samples (engine.SAMPLE, one an axis) and joint positions; full buffers go to a temporary file, so
that hours do not fill memory. Pins are not only sampled: the chips' journals hold the bus writes and switch edges, and
replaying these gives every pulse and pin to the clock. Everything works while the run goes on, too, on what is there so far.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from stage.chips.journal import Journal
from stage.engine import SAMPLE
from stage.errors import StageError, unknown

ROWS = 4096
_FIELDS: Any = SAMPLE.fields
_SAMPLE = np.dtype(_FIELDS)  # without attribute access, which costs at every look

COLUMNS = {
    "position": ("m", "where the carriage is"),
    "commanded": ("m", "where the pulses say it is"),
    "following_error": ("m", "commanded - position"),
    "velocity": ("m/s", "of the carriage"),
    "load_angle": ("rad", "commanded - rotor angle, electrical"),
    "lost_steps": ("full steps", "behind the pulses, a multiple of four"),
    "torque": ("N m", "on the rotor, mean of the physics step"),
    "current_a": ("A", "phase A"),
    "current_b": ("A", "phase B"),
    "rate": ("pps", "pulse rate"),
    "pulses": ("pulses", "plus minus minus, since power-up"),
    "counter": ("pulses", "down counter R0"),
}
"""Columns of each axis: unit (on a hinge rad for m) and meaning. Every pin has a bool column of its name as well."""


class Note(NamedTuple):
    """A fault came or went at `time` (s): in words, and the faults in force from then on, see stage.faults."""

    time: float
    text: str
    in_force: tuple[str, ...]


class RecordingError(StageError):
    """A recording cannot be kept, or not be written where it was asked to be."""


class Recording:
    """Samples and journals of a run. Made by `Stage.record`; a context manager, usable after its end.

    Attributes:
        model: the MjModel. axes: the stage's axes by name. every: seconds between samples.
        notes: the faults that came and went, in order.
        samples, positions, filled: the engine's buffers, (ROWS, axes) SAMPLE and (ROWS, nq), and the rows that it filled.
    """

    def __init__(self, model: mujoco.MjModel, axes: Mapping[str, Any], every: float, on_close: Callable[[], None]):
        if not axes:
            raise RecordingError("this stage drives no axis: there is nothing to record.")
        self.model, self.axes, self.every = model, axes, every
        self._on_close: Callable[[], None] | None = on_close
        self._dtype = np.dtype([("axes", _SAMPLE, (len(axes),)), ("qpos", "f8", (model.nq,))])
        self._file = tempfile.TemporaryFile(prefix="pulsestage-", buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        self._spooled = 0
        self.samples = np.zeros((ROWS, len(axes)), SAMPLE)
        self.positions = np.zeros((ROWS, model.nq))
        self.filled = 0
        self._disorder = False
        self.notes: list[Note] = []
        self.journals: dict[str, Journal] = {name: axis.chip.journal() for name, axis in axes.items()}

    def take(self, filled: int) -> None:
        """The engine has filled the buffers up to row `filled`; full ones go to the file."""
        self.filled = filled
        if filled < ROWS:
            return
        self.filled = 0  # first of all: the engine must never find a full buffer
        self._disorder |= self._backwards(ROWS)
        rows = self._pack(ROWS).view(np.uint8).data
        try:
            self._file.seek(self._spooled * self._dtype.itemsize)
            while len(rows):
                rows = rows[self._file.write(rows) :]
        except OSError as error:
            self.close()
            raise RecordingError(
                f"the recording was closed after {len(self)} samples: its temporary file in {tempfile.gettempdir()} cannot "
                f"grow ({error.strerror}). Set TMPDIR to a folder with more room, or record with a larger `every`."
            ) from error
        self._spooled += ROWS

    def _pack(self, n: int) -> np.ndarray:
        rows = np.empty(n, self._dtype)
        rows["axes"] = self.samples[:n].view(_SAMPLE)
        rows["qpos"] = self.positions[:n]
        return rows

    def note(self, time: float, text: str, in_force: tuple[str, ...]) -> None:
        """A fault came or went."""
        self.notes.append(Note(time, text, in_force))

    def close(self) -> None:
        """Stop recording; the stage goes on without. Safe to call twice."""
        if self._on_close is not None:
            self._on_close()
            self._on_close = None
            for journal in self.journals.values():
                journal.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self._spooled + self.filled

    @property
    def began(self) -> float:
        """Stage time of the start, s."""
        return min(float(self.seconds(name, j.start["clock"])) for name, j in self.journals.items())

    @property
    def duration(self) -> float:
        """Seconds from the start to the last sample."""
        return len(self) * self.every

    def pieces(self, rows: int = 16 * ROWS) -> Iterator[np.ndarray]:
        """The samples in order, at most `rows` at a time: records with fields `axes` (SAMPLE, one an axis) and `qpos`."""
        for begin in range(0, self._spooled, rows):
            piece = np.empty(min(rows, self._spooled - begin), self._dtype)
            self._file.seek(begin * self._dtype.itemsize)
            self._file.readinto(piece.view(np.uint8).data)
            yield piece
        if self.filled:
            yield self._pack(self.filled)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Every column as an array of len(recording): "time" (s), "x/position" ... (see COLUMNS), "x/el_plus" ... (bool).

        All at once: hours of samples want gigabytes; `column` reads one.
        """
        return self._read(self._names())

    def column(self, name: str) -> np.ndarray:
        """One column, see `columns`. Raises ArgumentError with the near misses."""
        if name not in (names := self._names()):
            raise unknown("column", name, names)
        return self._read([name])[name]

    def _names(self) -> list[str]:
        per_axis = (
            f"{name}/{column}"
            for name, axis in self.axes.items()
            for column in (*COLUMNS, *axis.chip.INPUTS, *axis.chip.OUTPUTS)
        )
        return ["time", *per_axis]

    def _read(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        out: dict[str, np.ndarray] = {}
        at = 0
        for piece in self.pieces():
            for name in names:
                values = self._values(piece["axes"], name)
                if name not in out:
                    out[name] = np.empty(len(self), values.dtype)
                out[name][at : at + len(piece)] = values
            at += len(piece)
        return out or {name: self._values(np.zeros((0, len(self.axes)), SAMPLE), name) for name in names}

    def _values(self, samples: np.ndarray, name: str) -> np.ndarray:
        if name == "time":
            return samples["time"][:, 0]
        axis, column = self._split(name)
        s = samples[:, axis.index]
        if column == "following_error":
            return s["commanded"] - s["position"]
        if column in COLUMNS:
            return s[column]
        inputs = column in axis.chip.INPUTS
        bit = (axis.chip.INPUTS if inputs else axis.chip.OUTPUTS)[column]
        return s["inputs" if inputs else "outputs"] & bit != 0

    def _split(self, name: str) -> tuple[Any, str]:
        axis, column = name.rsplit("/", 1)
        return self.axes[axis], column

    def seconds(self, axis: str, clock: Any) -> Any:
        """Stage time, s, of clocks of an axis' chip: both count from power-up."""
        return clock / self.axes[axis].chip.clock_hz

    def _backwards(self, n: int) -> bool:
        return bool(np.any(np.diff(self.samples["time"][:n, 0]) < 0))

    def check_time(self) -> None:
        """Raise RecordingError if the stage was restored to an earlier time: its journals then make no sense."""
        for name, journal in self.journals.items():
            clocks = np.fromiter((e.clock for e in journal.entries), np.int64, len(journal.entries))
            ends = int(clocks.max(initial=0)) > journal.until
            if self._disorder or ends or self._backwards(self.filled) or np.any(np.diff(clocks) < 0):
                raise RecordingError(
                    f"the stage went back in time while it was recorded (axis {name}): restore, reset or copy a stage between "
                    "recordings, not inside one. Its samples are kept: recording.columns."
                )

    def save(self, path: str | os.PathLike, overwrite: bool = False) -> Path:
        """Write a rerun recording (.rrd) that opens as a dashboard: `rerun FILE`.

        Raises RecordingError if the file exists (and not `overwrite`) or cannot be written; then nothing has changed.
        """
        from stage.recording.rerun_log import write

        self.check_time()
        with written(path, overwrite) as part:
            write(self, part)
        return Path(path)

    def to_vcd(self, path: str | os.PathLike, overwrite: bool = False) -> Path:
        """Write the chips' pins, status bits and R0 as waveforms (.vcd), every pulse in them: `gtkwave FILE`.

        Raises RecordingError as `save` does.
        """
        from stage.recording.vcd import write

        self.check_time()
        with written(path, overwrite) as part:
            write(self, part)
        return Path(path)

    def __repr__(self) -> str:
        state = "recording" if self._on_close else "closed"
        return f"<Recording {state}, {len(self)} samples of {', '.join(self.axes)}, {self.duration:.3f} s>"


def writable(path: str | os.PathLike, overwrite: bool) -> Path:
    """`path`, if it can be written and nothing would be lost; RecordingError otherwise."""
    path = Path(path)
    if path.is_dir():
        raise RecordingError(f"{path} is a folder. Name a file in it.")
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} exists. Choose another name, or say overwrite=True (--force).")
    if not path.parent.is_dir():
        raise RecordingError(f"{path.parent} is no folder. Make it first, or choose another.")
    if not os.access(path.parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise RecordingError(f"{path} cannot be written: no permission. Choose another folder.")
    return path


@contextmanager
def written(path: str | os.PathLike, overwrite: bool) -> Iterator[Path]:
    """A name beside `path` to write to; it becomes `path` when all went well, and is gone when not."""
    path = writable(path, overwrite)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror or error}. Choose another folder.") from error
    finally:
        part.unlink(missing_ok=True)
