"""Files for a failed test (recording, waveforms and bus trace) in a folder per test, and the list of them in the test's report."""

from __future__ import annotations

import hashlib
import os
import re
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import stage as package
from stage.board.bus.host_record import STRAY
from stage.chips.cycle_descriptions import decode
from stage.chips.write_diagnostics import summarize_diagnostics
from stage.errors import StageError
from stage.recording import Recording
from stage.sim import plant
from stage.sim.stage import Snapshot, Stage
from stage.testing.assertions import describe_missing_current, format_position, read_pulse_rate
from stage.testing.marker_arguments import read_setting
from stage.units import format_lost_steps

if TYPE_CHECKING:
    from stage.board import Board

REPORTED_CYCLES = 20  # bus cycles in the report
REPORTED_LOG_LINES = 10  # lines of the firmware's log
MAX_FOLDER_NAME_LENGTH = 120  # characters of a folder's name
PACKAGE_FOLDER = Path(package.__file__).parent


def choose_test_folder(config: pytest.Config, nodeid: str) -> Path:
    """Return the folder for the files of a test. Different test ids have different folders."""
    option = config.getoption("pulsestage_output")
    where = (
        config.invocation_params.dir / option
        if option
        else config.rootpath / (read_setting(config, "output") or ".pulsestage")
    )
    name = re.sub(r"[^\w.=+-]+", "_", nodeid.replace("/", ".").replace("::", ".")).strip("_")[:MAX_FOLDER_NAME_LENGTH]
    if not re.fullmatch(r"[\w./:]+", nodeid) or len(nodeid) > MAX_FOLDER_NAME_LENGTH:  # something was lost
        digest = hashlib.sha256(nodeid.encode(errors="backslashreplace")).hexdigest()
        name += f"-{digest[:6]}"
    return where / name


class FailedTestFiles:
    """Files and report that a test with a stage leaves behind if it fails.

    Args:
        item: Test.
        stage: Stage of the test.
        model: Model that the stage was made of, as `Stage` takes it.
    """

    def __init__(self, item: pytest.Item, stage: WatchedStage, model: Any):
        self.stage, self._model = stage, model
        self.folder = choose_test_folder(item.config, item.nodeid)
        self._from = item.config.invocation_params.dir
        self.board: Board | None = None
        self._saved = False

    def clear(self) -> None:
        """Remove the files of an earlier run: a folder exists only if its test failed the last time."""
        if self.folder.is_dir():
            for pattern in ("recording*.rrd", "waveforms*.vcd", "bus.txt"):
                for file in self.folder.glob(pattern):
                    file.unlink(missing_ok=True)
            if not any(self.folder.iterdir()):
                self.folder.rmdir()

    def shorten_traceback(self, error: BaseException) -> None:
        """Remove the frames of this package from the end of a traceback, because they do not help the author of the test."""
        if isinstance(error, StageError):
            frame = last = error.__traceback__
            while frame is not None:
                if not Path(frame.tb_frame.f_code.co_filename).is_relative_to(PACKAGE_FOLDER):
                    last = frame
                frame = frame.tb_next
            if last is not None:
                last.tb_next = None

    def save(self) -> str:
        """Save all files and return the text for the report; "" if nothing has happened in the test, or the files are already
        saved."""
        if self._saved or not (self.stage.time or (self.board and self.board.cycles)):
            return ""
        self._saved = True
        try:
            return self._save_all()
        except Exception as error:  # whatever it is, it must not hide why the test failed
            return f"nothing more is saved: {type(error).__name__}: {error}"

    def _save_all(self) -> str:
        bus = self._list_bus_cycles()
        last = [f"last of {len(bus) - 1:,} lines of the bus trace:", bus[0], *bus[1:][-REPORTED_CYCLES:]] if bus else []
        return "\n\n".join(
            filter(None, [self._describe_state(), self._describe_log(), "\n".join(last), self._save_files(bus)])
        )

    def _describe_state(self) -> str:
        """Describe position, switches and lost steps of each axis, bus writes that break rules, and faults."""
        stage = self.stage
        lines = [f"stage at {stage.time:.6f} s:"]
        for axis in stage.axes.values():
            on = ", ".join(name for name, asserted in axis.switches.as_dict().items() if asserted)
            rate = read_pulse_rate(axis)
            lines.append(
                f"  {axis.name} ({type(axis.chip).__name__}) at {format_position(axis.position, axis.unit)}, commanded "
                f"{format_position(axis.commanded, axis.unit)}, {format_lost_steps(axis.lost_steps, axis.lost_pulses)}, "
                + (f"{rate:+,.0f} pulses/s" if rate else "no pulses")
                + (f", asserted: {on}" if on else "")
                + describe_missing_current(axis)
            )
        if mistakes := summarize_diagnostics(stage.chips):
            lines.append(f"  {mistakes} that a data-sheet reader would call mistakes: assert_no_diagnostics(stage)")
        if self.board is not None:
            cycles = self.board.trace.lines()
            if strays := int(cycles["count"][cycles["kind"] & STRAY != 0].sum()):
                lines.append(f"  {strays:,} bus cycles reached no chip: assert_no_strays(board)")
        lines += [f"  fault in force: {fault}" for fault in stage.faults]
        return "\n".join(lines)

    def _describe_log(self) -> str:
        """Return the last lines of the firmware's log, after a heading."""
        log = self.board.log if self.board is not None else []
        more = [f"  ... {len(log) - REPORTED_LOG_LINES} lines before"] if len(log) > REPORTED_LOG_LINES else []
        lines = [f"  {seconds:.9f}  {text}" for seconds, text in log[-REPORTED_LOG_LINES:]]
        return "\n".join(["log of the firmware:", *more, *lines]) if log else ""

    def _list_bus_cycles(self) -> list[str]:
        """Return the bus trace in words, after a heading."""
        if self.board is not None and len(self.board.trace):
            return str(self.board.trace).splitlines()
        lines = []
        for recording in self._list_recordings():  # chips driven from Python: their journals
            cycles = [
                (float(recording.seconds(name, cycle.clock)), name, str(cycle))
                for name, journal in recording.journals.items()
                for cycle in decode(recording.axes[name].chip.decoder(recording.axes[name].chip_axis), journal.entries)
            ]
            lines += [f"{seconds:17.9f}  {name}: {text}" for seconds, name, text in sorted(cycles)]
        return [f"{'seconds':>17}  bus writes", *lines] if lines else []

    def _list_recordings(self) -> list[Recording]:
        """Return the recordings that have content. Another recording begins after `restore`, `reset` and `record`."""
        return [recording for recording in self.stage.recordings if has_recorded_anything(recording)]

    def _save_files(self, bus: list[str]) -> str:
        """Write the files; return a line for each with the command that opens it."""
        try:
            new = not self.folder.parent.exists()
            self.folder.mkdir(parents=True, exist_ok=True)
            if new:
                (self.folder.parent / ".gitignore").write_text("*\n", encoding="utf-8")
        except OSError as error:
            return f"nothing is saved: {self.folder} cannot be made ({error.strerror})."
        lines = ["saved:"]
        recordings = self._list_recordings()
        for k, recording in enumerate(recordings):
            number = f"-{k + 1}" if len(recordings) > 1 else ""
            lines.append(
                self._save_file(
                    "recording", f"recording{number}.rrd", "rerun", partial(self._save_recording, recording)
                )
            )
            lines.append(self._save_file("waveforms", f"waveforms{number}.vcd", "gtkwave", recording.to_vcd))
        if not recordings:
            lines.append("  no recording: it was off, by record=False or pulsestage_record")
        if bus:
            text = "\n".join(bus) + "\n"
            lines.append(
                self._save_file(
                    "bus trace",
                    "bus.txt",
                    "less",
                    lambda path: path.write_text(text, encoding="utf-8", errors="backslashreplace"),
                )
            )
        return "\n".join(lines)

    def _save_file(self, what: str, name: str, opener: str, save: Callable[[Path], Any]) -> str:
        """Save one file, and return a line with its description, path and the command that opens it."""
        path = self.folder / name
        try:
            save(path)
        except (StageError, OSError) as error:
            return f"  {what}: not saved: {error}"
        return f"  {what}: {opener} {self._format_path(path)}"

    def _save_recording(self, recording: Recording, path: Path) -> None:
        """Save the recording with the full model for display; the test's stage was made without visuals."""
        model, _ = plant.compile_spec(plant.open_spec(self._model), 0)
        if model.nq == recording.model.nq:
            recording.model = model
        recording.save(path)

    def _format_path(self, path: Path) -> str:
        """Return the path as a user would type it."""
        relative = os.path.relpath(path, self._from)
        return relative if not relative.startswith("..") else str(path)


MAX_RECORDINGS = 3


class WatchedStage(Stage):
    """Stage that is recorded in the background from `watch` to `unwatch`.

    The background recording ends when the test records or restores the stage, and another one begins afterwards. Copies of the
    stage have no background recording.

    Attributes:
        recordings: The last recordings, in order.
    """

    recordings: Sequence[Recording] = ()
    _watched = False
    _background: Recording | None = None

    def watch(self) -> None:
        """Begin the background recording."""
        self._recent: deque[Recording] = deque(maxlen=MAX_RECORDINGS)
        self.recordings = self._recent
        self._watched = True
        self._start_background_recording()

    def unwatch(self) -> None:
        """Stop watching; close a recording of the test that is still open."""
        self._watched = False
        if self.recording is not None:
            self.recording.close()

    def _start_background_recording(self) -> None:
        if self._watched and self.recording is None:
            self._background = super().record()
            self._background.on_error = "warn"  # a full disk is not the test's fault
            self._recent.append(self._background)

    def _stop_background_recording(self) -> None:
        if self._background is not None:
            recording, self._background = self._background, None
            watched, self._watched = self._watched, False
            recording.close()
            self._watched = watched
            if not has_recorded_anything(recording):
                self._recent.remove(recording)

    def record(self, *args: Any, **kwargs: Any) -> Recording:
        """Record for the test, in place of the background recording."""
        self._stop_background_recording()
        try:
            recording = super().record(*args, **kwargs)
        finally:
            self._start_background_recording()
        if self._watched:
            self._recent.append(recording)
        return recording

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot, after which another background recording begins."""
        self._stop_background_recording()
        try:
            super().restore(snapshot)
        finally:
            self._start_background_recording()

    def stop_recording(self) -> None:
        """Stop the test's recording; a background recording begins again."""
        super().stop_recording()
        if self._background is not None:  # `_stop_background_recording` would write more, and the disk is full
            self._background, self._watched = None, False
        self._start_background_recording()


def has_recorded_anything(recording: Recording) -> bool:
    """Return whether time passed during a recording, or a bus cycle was made."""
    return bool(len(recording)) or any(len(journal.entries) for journal in recording.journals.values())
