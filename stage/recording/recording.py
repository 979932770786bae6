"""`Recording`: what a stage did, kept cheaply while it runs and converted when it is saved.

The engine fills a buffer of samples (engine.SAMPLE, one an axis) and joint positions; full buffers go to a temporary file, so
that hours do not fill memory. The chips' course is not sampled at all: their journals hold the bus writes and switch edges,
and replaying these gives every pulse and pin to the clock.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stage.chips.journal import Course
from stage.engine import SAMPLE
from stage.errors import StageError

ROWS = 4096

COLUMNS = {
    "position": ("m", "carriage, true"),
    "commanded": ("m", "where the pulses say the carriage is"),
    "following_error": ("m", "commanded - position"),
    "velocity": ("m/s", "of the joint"),
    "load_angle": ("electrical rad", "commanded - rotor angle"),
    "lost_steps": ("full steps", "behind the pulses, a multiple of four"),
    "torque": ("N m", "on the rotor"),
    "current_a": ("A", "phase A"),
    "current_b": ("A", "phase B"),
    "rate": ("pps", "pulse rate"),
    "pulses": ("pulses", "+ minus -, since power-up"),
    "counter": ("pulses", "down counter R0"),
}
"""Columns of each axis: unit and meaning. (rad for m on a hinge.) Every pin has a bool column of its name as well."""


class RecordingError(StageError):
    """A recording cannot be written where it was asked to be."""


class Recording:
    """Samples, journals and what is needed to draw them. Made by `Stage.record`."""

    def __init__(self, model: mujoco.MjModel, axes: Mapping[str, Any], every: float, on_close: Callable[[], None]):
        self.model, self.axes, self.every = model, axes, every
        self._on_close: Callable[[], None] | None = on_close
        self._dtype = np.dtype([("axes", np.dtype(SAMPLE.fields), (len(axes),)), ("qpos", "f8", (model.nq,))])
        self._file = tempfile.TemporaryFile(prefix="pulsestage-")  # noqa: SIM115: lives as long as the recording
        self._spooled = 0
        self.samples = np.zeros((ROWS, len(axes)), SAMPLE)
        self.positions = np.zeros((ROWS, model.nq))
        self.filled = 0
        self.began = next(iter(axes.values())).time
        self._journals = {name: axis.chip.journal() for name, axis in axes.items()}
        self._origins = {name: (axis.time, axis.chip.clock) for name, axis in axes.items()}

    def take(self, filled: int) -> None:
        """The engine has filled the buffers up to row `filled`; full ones go to the file."""
        self.filled = filled
        if filled == ROWS:
            self._file.write(self._pack(filled).tobytes())
            self._spooled += filled
            self.filled = 0

    def _pack(self, n: int) -> np.ndarray:
        rows = np.zeros(n, self._dtype)
        rows["axes"] = self.samples[:n].view(np.dtype(SAMPLE.fields))
        rows["qpos"] = self.positions[:n]
        return rows

    def close(self) -> None:
        """Stop recording; the stage goes on without. Safe to call twice."""
        if self._on_close is not None:
            self._on_close()
            self._on_close = None
            for journal in self._journals.values():
                journal.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self._spooled + self.filled

    @property
    def duration(self) -> float:
        """Seconds from the start to the last sample."""
        return len(self) * self.every

    def pieces(self, rows: int = 65536) -> Iterator[np.ndarray]:
        """The samples in order, at most `rows` at a time: records with fields `axes` (SAMPLE) and `qpos`."""
        self._file.flush()
        size = self._dtype.itemsize
        for begin in range(0, self._spooled, rows):
            n = min(rows, self._spooled - begin)
            yield np.frombuffer(os.pread(self._file.fileno(), n * size, begin * size), self._dtype)
        if self.filled:
            yield self._pack(self.filled)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Arrays of len(recording): "time" (s), and "x/position" and the like, see COLUMNS; "x/el_plus" ... (bool)."""
        parts = list(self.pieces())
        rows = np.concatenate(parts) if parts else np.zeros(0, self._dtype)
        out = {"time": rows["axes"]["time"][:, 0] if len(rows) else np.zeros(0)}
        for k, (name, axis) in enumerate(self.axes.items()):
            s = rows["axes"][:, k]
            for column in COLUMNS:
                out[f"{name}/{column}"] = s["commanded"] - s["position"] if column == "following_error" else s[column]
            for pin, bit in axis.chip.INPUTS.items():
                out[f"{name}/{pin}"] = s["inputs"] & bit != 0
            for pin, bit in axis.chip.OUTPUTS.items():
                out[f"{name}/{pin}"] = s["outputs"] & bit != 0
        return out

    def course(self, axis: str, every_pulse: bool = False) -> Course:
        """Every change of the axis' chip, replayed; see chips.journal."""
        return self._journals[axis].course(every_pulse)

    def seconds(self, axis: str, clock: np.ndarray) -> np.ndarray:
        """Stage time, s, of clocks of an axis' chip."""
        time, first = self._origins[axis]
        return time + (clock - first) / self.axes[axis].chip.clock_hz

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write a rerun recording (.rrd) that opens as a dashboard. Raises RecordingError rather than overwrite."""
        from stage.recording.rerun_log import write

        return write(self, writable(path, overwrite))

    def to_vcd(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write the chips' pins, status and R0 as waveforms (.vcd), every pulse in them."""
        from stage.recording.vcd import write

        return write(self, writable(path, overwrite))

    def __repr__(self) -> str:
        state = "recording" if self._on_close else "closed"
        return f"<Recording {state}, {len(self)} samples of {', '.join(self.axes)}, {self.duration:.3f} s>"


def writable(path: str | os.PathLike, overwrite: bool) -> Path:
    """`path`, if it can be written and nothing would be lost; RecordingError otherwise."""
    path = Path(path)
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} exists. Choose another name, or say overwrite=True (--force).")
    if not path.parent.is_dir():
        raise RecordingError(f"{path.parent} is no folder. Make it first, or choose another.")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise RecordingError(f"{path} cannot be written: no permission. Choose another folder.")
    return path
