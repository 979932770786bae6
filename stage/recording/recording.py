"""`Recording`: the motion and the bus cycles of a run, taken at little cost while it runs and converted when it is saved.

    with stage.record() as recording:
        firmware.origin_return(stage.axes["x"])
    recording.columns["x/position"]
    recording.save("x.rrd")
    recording.to_vcd("x.vcd")
    recording.to_pandas()                        and to_parquet, to_csv, to_npz: see column_files.py

    with stage.record(path="long.rrd"):          written as it goes: what was flushed survives a kill
        ...

The engine fills a buffer of samples (records.SAMPLE, one an axis) and joint positions; full buffers go to a temporary file, so
that hours do not fill memory. Pins are not only sampled: the chips' journals hold the bus writes and switch edges, and
replaying these gives every pulse and pin to the clock. All methods also work during the run, on the part recorded so far.
"""

from __future__ import annotations

import atexit
import os
import tempfile
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np

from stage.chips.exclusive_access import get_stage_lock
from stage.chips.journal import Journal
from stage.errors import ArgumentError, StageError, unknown_name_error
from stage.recording.column_files import Columns, ColumnTable
from stage.recording.vcd_writer import RecordedBusCycles
from stage.sim.engine_records import SAMPLE
from stage.support import html
from stage.support.argument_checks import check_integer, explain_arguments
from stage.support.files import (
    RECORDING,
    WAVEFORMS,
    FileError,
    check_ending,
    check_writable,
    is_stream,
    write_atomically,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from stage.recording.rerun_log import RerunLog

BUFFER_ROWS = 4096
Number = TypeVar("Number", float, np.ndarray)
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
    "current_a": ("A", "phase A; the current of a DC motor"),
    "current_b": ("A", "phase B; 0 for a DC motor"),
    "voltage": ("V", "at a DC motor, mean of the physics step; 0 for a stepper"),
    "rate": ("pps", "pulse rate; the commanded velocity of a servo, counts a second"),
    "pulses": ("pulses", "plus minus minus, since power-up; of a servo the commanded position, counts"),
    "counter": ("pulses", "what counts for the host: down counter R0, logical position LP, actual position R14"),
}
"""Columns of each axis: unit (on a hinge rad for m; counts of the encoder for pulses where the axis is a servo's) and meaning.
Every pin has a bool column of its name as well."""


def find_column_unit(column: str, unit: str, servo: bool) -> str:
    """Return the unit of a column.

    Args:
        column: Name of the column.
        unit: Unit of the axis, m or rad.
        servo: The axis has an encoder.

    Returns:
        The unit, "" for a pin.
    """
    usual, _ = COLUMNS.get(column, ("", ""))
    if servo:
        usual = {"pps": "counts/s", "pulses": "counts"}.get(usual, usual)
    return usual.replace("m", unit, 1) if usual in ("m", "m/s") else usual


class FaultChange(NamedTuple):
    """Begin or end of a fault during a recording.

    Attributes:
        time: Time of the change, s.
        text: The fault in words.
        in_force: All faults in force from then on, see Stage.faults.
    """

    time: float
    text: str
    in_force: tuple[str, ...]


class RecordingError(FileError):
    """Error of a recording that cannot continue or cannot be written to a file."""


class RecordingWarning(UserWarning):
    """Warning that a recording has ended early while the simulation continues (on_error="warn")."""


def _make_write_error(path: Path, error: OSError) -> RecordingError:
    return RecordingError(f"{path} cannot be written: {error.strerror or error}.")


class Recording(ColumnTable):
    """Samples and journals of a run, from its creation to `close`. A context manager; the data stays available after `close`.

    Args:
        stage: A stage that is not being recorded.
        every: Seconds between samples, up to 1e6, rounded to whole physics steps, one at least. Switch edges and bus writes are
            exact in any case.
        path: Rerun file to write during the run, see `stream`.
        overwrite: The file may exist.
        on_error: Reaction to a full disk during the run. "raise": a RecordingError, after which the run can continue without
            recording; "warn": a RecordingWarning.

    Raises:
        ArgumentError: `every` is out of range.
        StageError: The stage is already being recorded.
        RecordingError: The stage drives no axis, or the file cannot be written.

    Attributes:
        model: The MjModel.
        axes: The stage's axes by name.
        every: Seconds between samples.
        fault_changes: Begins and ends of faults, in order.
        host: Bus cycles of a board, if the stage has one.
        samples, positions, filled: The engine's buffers, (BUFFER_ROWS, axes) SAMPLE and (BUFFER_ROWS, nq), and the number
            of filled rows.
    """

    ERROR = RecordingError
    REQUIRES_FORWARD_TIME = True
    """Whether the stage's time may only go forward during the recording."""

    def __init__(
        self,
        stage: Any,
        every: float = 1e-3,
        path: str | os.PathLike | None = None,
        *,
        overwrite: bool = False,
        on_error: str = "raise",
    ):
        if stage.recording is not None:
            raise StageError("this stage is already being recorded; close that recording first.")
        if not 0 < every <= 1e6:
            raise ArgumentError(f"every={every!r}: the samples of a recording are more than 0 and up to 1e6 s apart.")
        if not stage.axes:
            raise RecordingError("this stage drives no axis: there is nothing to record.")
        with get_stage_lock(stage):
            self._begin(stage, max(1, round(every * 1e9 / stage.state.dt)))
        if path is not None:
            try:
                self.stream(path, overwrite=overwrite, on_error=on_error)
            except BaseException:
                self.close()
                raise

    def _begin(self, stage: Any, physics_steps_per_sample: int) -> None:
        """Allocate the buffers, open the journals of all chips and connect to the stage."""
        model, axes = stage.model, stage.axes
        self.model, self.axes, self.every = model, axes, physics_steps_per_sample * stage.state.dt * 1e-9
        self._stage, self._is_closed = stage, False
        self._dtype = np.dtype([("axes", _SAMPLE, (len(axes),)), ("qpos", "f8", (model.nq,))])
        self._open_temporary_file()
        self._spooled = 0
        self.on_error: Literal["raise", "warn"] = "raise"
        self._log: RerunLog | None = None
        self._log_path, self._flush_rows, self._flushed = Path(), 0, 0
        self.samples = np.zeros((BUFFER_ROWS, len(axes)), SAMPLE)
        self.positions = np.zeros((BUFFER_ROWS, model.nq))
        self.filled = 0
        self._disorder = False
        self.fault_changes: list[FaultChange] = []
        self.journals: dict[str, Journal] = {name: axis.chip.journal(axis.chip_axis) for name, axis in axes.items()}
        self.host = RecordedBusCycles(stage)
        stage.begin_recording(self, physics_steps_per_sample)
        if stage.faults:
            self.add_fault_change(stage.time, "in force from the start", stage.faults)

    def _open_temporary_file(self) -> None:
        """Open the file that receives full buffers; it belongs to this process."""
        self._process = os.getpid()
        self._file = tempfile.TemporaryFile(prefix="pulsestage-", buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def _separate_fork(self) -> None:
        """Give a fork of the recording process its own temporary file. Otherwise both processes would write to the same one.

        A rerun file stays with the other process.
        """
        if self._process == os.getpid():
            return
        shared, at, end = self._file, 0, self._spooled * self._dtype.itemsize
        self._open_temporary_file()
        while at < end:
            # the file position of the other process stays
            piece = os.pread(shared.fileno(), min(end - at, 1 << 20), at)
            self._file.write(piece)
            at += len(piece)
        if self._log is not None:
            self._shared_log, self._log = self._log, None  # referenced: its end would write to the file
            atexit.unregister(self._close_at_exit)
            warnings.warn(
                f"{self._log_path} stays that of the process that began it; the recording of this fork goes on without: "
                "recording.save(...) writes it to another place.",
                RecordingWarning,
                stacklevel=2,
            )

    def take_rows(self, filled: int) -> None:
        """Take over the rows of samples that the engine has written to the buffers. Full buffers go to the temporary file.

        Args:
            filled: Number of rows that are filled now.
        """
        self._separate_fork()
        self.filled = filled
        if filled == BUFFER_ROWS:
            self._write_full_buffers()
        if self._log is not None and len(self) - self._flushed >= self._flush_rows:
            self.flush()

    def _write_full_buffers(self) -> None:
        """Append the full buffers to the temporary file and mark them as empty."""
        self.filled = 0  # first of all: the engine must never find a full buffer
        self._disorder |= self._has_backward_time(BUFFER_ROWS)
        rows = self._pack_samples(BUFFER_ROWS).view(np.uint8).data
        try:
            self._file.seek(self._spooled * self._dtype.itemsize)
            while len(rows):
                rows = rows[self._file.write(rows) :]
        except OSError as error:
            self.close()
            self._report_failure(
                f"the recording was closed after {len(self)} samples: its temporary file in {tempfile.gettempdir()} cannot "
                f"grow ({error.strerror}). Set TMPDIR to a folder with more room, or record with a larger `every`.",
                error,
            )
            return
        self._spooled += BUFFER_ROWS

    @explain_arguments
    def stream(
        self, path: str | os.PathLike, seconds: float = 1.0, overwrite: bool = False, on_error: str = "raise"
    ) -> Recording:
        """Write a rerun file while the stage runs, with the same content as a later `save`.

        If this process is killed, `rerun FILE` and rerun's readers can read everything up to the last flush. Only `close` writes
        the footer that `rerun rrd verify` needs, and the path of the tool. If the disk is full, the file ends with the last
        complete flush, and further
        samples go to the temporary file: `save` them elsewhere.

        Args:
            path: The file, .rrd.
            seconds: Simulated seconds between two flushes. Further flushes come after every 4096 samples and with `flush`.
            overwrite: The file may exist.
            on_error: See the class.

        Returns:
            The recording.

        Raises:
            ArgumentError: `seconds` or `on_error` is out of range.
            RecordingError: As `save`.
        """
        from stage.recording.rerun_log import RerunLog

        if not 0 < seconds <= 1e9:
            raise ArgumentError(
                f"seconds={seconds!r}: what is recorded goes to the file after more than 0 s, up to 1e9 s."
            )
        if on_error not in ("raise", "warn"):
            raise ArgumentError(f"on_error={on_error!r}: 'raise' or 'warn'.")
        if self._log is not None or self._is_closed:
            raise RecordingError(f"{self!r} {'goes to a file already' if self._log else 'is over: save it'}.")
        self.on_error = on_error  # type: ignore[assignment]
        check_ending(path, *RECORDING, RecordingError)
        self._log_path = check_writable(path, overwrite, RecordingError)
        self._flush_rows = max(1, round(seconds / self.every))
        try:
            self._log = RerunLog(self, self._log_path, overwrite or is_stream(self._log_path))
        except OSError as error:
            raise _make_write_error(self._log_path, error) from error
        atexit.register(self._close_at_exit)  # a program that forgets to still gets a whole file
        return self

    def flush(self) -> None:
        """Write the samples that are not yet in the file that `stream` writes."""
        self._separate_fork()
        if self._log is not None:
            self._flushed = len(self)
            self._write_or_stop(self._log.write_new_samples)

    def _write_or_stop(self, write: Callable[[], None]) -> None:
        """Call `write`; after an OSError, close the file of `stream` and report the failure."""
        try:
            write()
        except OSError as error:
            log, self._log = self._log, None
            if log is not None:
                log.close()
            rest = "It ends with the last flush; recording.save(...) writes everything to another place."
            self._report_failure(f"{_make_write_error(self._log_path, error)} {rest}", error)

    def _report_failure(self, message: str, error: Exception) -> None:
        """Raise a RecordingError or give a RecordingWarning, according to `on_error`."""
        if self.on_error == "raise":
            raise RecordingError(message) from error
        warnings.warn(message, RecordingWarning, stacklevel=2)

    def _pack_samples(self, row_count: int) -> np.ndarray:
        """Return the first `row_count` rows of the buffers as records with the fields `axes` and `qpos`."""
        rows = np.empty(row_count, self._dtype)
        rows["axes"] = self.samples[:row_count].view(_SAMPLE)
        rows["qpos"] = self.positions[:row_count]
        return rows

    def add_fault_change(self, time: float, text: str, in_force: tuple[str, ...]) -> None:
        """Record that a fault begins or ends.

        Args:
            time: Time of the change, s.
            text: The fault in words.
            in_force: All faults in force from then on.
        """
        self.fault_changes.append(FaultChange(time, text, in_force))

    def close(self) -> None:
        """Stop recording; the stage continues without it. Safe to call twice, and from any thread.

        It waits for other threads that use the stage, except for a session that refuses this thread.
        """
        if self._is_closed:
            return
        with ExitStack() as stack:
            with suppress(StageError):
                stack.enter_context(get_stage_lock(self._stage))
            self._is_closed = True
            self._stage.stop_recording()
            atexit.unregister(self._close_at_exit)
            for journal in self.journals.values():
                journal.close()
            self.host.close()
            self.flush()
            if self._log is not None:
                self._write_or_stop(self._log.finish)
                self._log = None

    def _close_at_exit(self) -> None:
        if self._process == os.getpid():
            self.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self._spooled + self.filled

    @property
    def began(self) -> float:
        """Time at which the recording began, s."""
        return min(float(self.seconds(name, j.start_state["clock"])) for name, j in self.journals.items())

    @property
    def duration(self) -> float:
        """Seconds from the begin of the recording to the last sample."""
        return len(self) * self.every

    def pieces(self, rows: int = 16 * BUFFER_ROWS, begin: int = 0) -> Iterator[np.ndarray]:
        """Yield the samples in order, in arrays of records with the fields `axes` (SAMPLE, one per axis) and `qpos`.

        Args:
            rows: Maximum number of samples in an array.
            begin: Index of the first sample.

        Raises:
            ArgumentError: A number is out of range; raised when the first array is requested.
        """
        check_integer("rows", rows, 1)
        check_integer("begin", begin, 0)
        self._separate_fork()
        skipped = max(0, begin - self._spooled)
        for at in range(begin, self._spooled, rows):
            piece = np.empty(min(rows, self._spooled - at), self._dtype)
            self._file.seek(at * self._dtype.itemsize)
            self._file.readinto(piece.view(np.uint8).data)
            yield piece
        if self.filled > skipped:
            yield self._pack_samples(self.filled)[skipped:]

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Every column by name: "time" (s), "x/position" ... (see COLUMNS), "x/el_plus" ... (bool); arrays of len(recording).

        All columns are read into memory, gigabytes for hours of samples; `column` reads only one.
        """
        return Columns(self._read_columns(list(self.units)))

    @explain_arguments
    def column(self, name: str) -> np.ndarray:
        """Return one column, see `columns`. Raises ArgumentError with similar names for an unknown one."""
        return self._read_columns([name])[name]

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column, "" for a pin; in the order of `columns`."""
        return {"time": "s"} | {
            f"{name}/{column}": find_column_unit(column, axis.unit, axis.drive.has_encoder)
            for name, axis in self.axes.items()
            for column in (*COLUMNS, *axis.chip.INPUTS, *axis.chip.OUTPUTS)
        }

    def _iterate_columns(self, names: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        for piece in self.pieces() if len(self) else [self._pack_samples(0)]:
            yield {name: self._extract_column(piece["axes"], name) for name in names}

    def _read_columns(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        out: dict[str, np.ndarray] = {}
        at = 0
        for part in self.iterate_columns(names):
            for name, values in part.items():
                if name not in out:
                    out[name] = np.empty(len(self), values.dtype)
                out[name][at : at + len(values)] = values
            at += len(part[names[0]])
        return out

    def _extract_column(self, samples: np.ndarray, name: str) -> np.ndarray:
        if name == "time":
            return samples["time"][:, 0]
        axis, column = self._split_column_name(name)
        s = samples[:, axis.index]
        if column == "following_error":
            return s["commanded"] - s["position"]
        if column in COLUMNS:
            return s[column]
        inputs = column in axis.chip.INPUTS
        bit = (axis.chip.INPUTS if inputs else axis.chip.OUTPUTS)[column]
        return s["inputs" if inputs else "outputs"] & bit != 0

    def _split_column_name(self, name: str) -> tuple[Any, str]:
        axis, column = name.rsplit("/", 1)
        return self.axes[axis], column

    @explain_arguments
    def seconds(self, axis: str, clock: Number) -> Number:
        """Convert clocks of a chip to the time of the stage, s. Both count from power-up.

        Args:
            axis: Name of an axis of the chip.
            clock: Clocks, a number or an array.

        Raises:
            ArgumentError: An unknown axis.
        """
        if axis not in self.axes:
            raise unknown_name_error("axis", axis, self.axes)
        return clock / self.axes[axis].chip.clock_hz

    def _has_backward_time(self, row_count: int) -> bool:
        """Return whether the time decreases within the first `row_count` rows of the buffers."""
        return bool(np.any(np.diff(self.samples["time"][:row_count, 0]) < 0))

    def require_forward_time(self) -> None:
        """Raise RecordingError if the stage was restored to an earlier time, because the order of the journals is then lost."""
        for name, journal in self.journals.items():
            clocks = journal.entries.to_packed()["clock"]
            ends = int(clocks.max(initial=0)) > journal.end_clock
            if self._disorder or ends or self._has_backward_time(self.filled) or np.any(np.diff(clocks) < 0):
                raise RecordingError(
                    f"the stage went back in time while it was recorded (axis {name}): restore, reset or copy a stage between "
                    "recordings, not inside one. Its samples are kept: recording.columns."
                )

    def save(self, path: str | os.PathLike, overwrite: bool = False) -> Path:
        """Write a rerun recording (.rrd), which `rerun FILE` opens as a dashboard.

        Args:
            path: The file, .rrd.
            overwrite: The file may exist.

        Returns:
            Its path.

        Raises:
            RecordingError: The file does not end in .rrd, exists, or cannot be written. An existing file stays unchanged.
        """
        from stage.recording.rerun_log import write_rrd

        check_ending(path, *RECORDING, RecordingError)
        self.require_forward_time()
        with write_atomically(path, overwrite, RecordingError) as part:
            write_rrd(self, part)
        return Path(path)

    @explain_arguments
    def plot(self, path: str | os.PathLike | None = None, *, overwrite: bool = False) -> Figure:
        """Draw rates, positions, following errors, lost steps and switches over time in one figure.

        Args:
            path: File to save it to.
            overwrite: The file may exist.

        Returns:
            The figure.

        Raises:
            RecordingError, FileError: The recording is empty, or the file cannot be written.
            ExtraMissing: There is no matplotlib (extra `plot`).
        """
        from stage.recording.recording_plot import draw_recording

        return draw_recording(self, path, overwrite)

    def _repr_html_(self) -> str:
        return html.format_preformatted(repr(self)) + (html.embed_figure(self.plot) if len(self) else "")

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        """Return the dashboard for a notebook in which rerun's widget is installed, and the figure for other viewers."""
        from stage.recording.rerun_viewer import build_widget

        return {"text/plain": repr(self), "text/html": self._repr_html_(), **build_widget(self)}

    def to_vcd(self, path: str | os.PathLike, overwrite: bool = False) -> Path:
        """Write the pins, status bits and R0 of all chips as waveforms (.vcd) with every pulse, for example for `gtkwave FILE`.

        Args:
            path: The file, .vcd.
            overwrite: The file may exist.

        Returns:
            Its path.

        Raises:
            RecordingError: As `save`.
        """
        from stage.recording.vcd_writer import write_vcd

        check_ending(path, *WAVEFORMS, RecordingError)
        self.require_forward_time()
        with write_atomically(path, overwrite, RecordingError) as part:
            write_vcd(self, part)
        return Path(path)

    def __repr__(self) -> str:
        state = "closed" if self._is_closed else "recording"
        return f"<Recording {state}, {len(self)} samples of {', '.join(self.axes)}, {self.duration:.3f} s>"
