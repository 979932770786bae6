"""The files that a failed test saves, recording, waveforms and bus trace in a folder of its own, and their names in its report."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import stage as package
from stage.board.bus.host_record import STRAY
from stage.chips.describe import decode
from stage.errors import StageError
from stage.sim import plant
from stage.testing.assertions import distance, pulse_rate, without_current
from stage.testing.settings import setting
from stage.testing.watched import WatchedStage, has_something

if TYPE_CHECKING:
    from stage.board import Board
    from stage.recording import Recording

LAST = 20  # bus cycles in the report
LOGGED = 10  # lines of the firmware's log
LONGEST = 120  # characters of a folder's name
HERE = Path(package.__file__).parent


def folder(config: pytest.Config, nodeid: str) -> Path:
    """The folder of a test, by its id; two tests never share one."""
    given = config.getoption("pulsestage_output")
    where = (
        config.invocation_params.dir / given
        if given
        else config.rootpath / (setting(config, "output") or ".pulsestage")
    )
    name = re.sub(r"[^\w.=+-]+", "_", nodeid.replace("/", ".").replace("::", ".")).strip("_")[:LONGEST]
    if not re.fullmatch(r"[\w./:]+", nodeid) or len(nodeid) > LONGEST:  # something was lost
        digest = hashlib.sha256(nodeid.encode(errors="backslashreplace")).hexdigest()
        name += f"-{digest[:6]}"
    return where / name


class Watch:
    """One test with a stage.

    Args:
        item: the test. stage, model: its stage, and what that was made of.
    """

    def __init__(self, item: pytest.Item, stage: WatchedStage, model: Any):
        self.stage, self._model = stage, model
        self.folder = folder(item.config, item.nodeid)
        self._from = item.config.invocation_params.dir
        self.board: Board | None = None
        self._kept = False

    def clear(self) -> None:
        """A folder is there if its test failed the last time, and not longer."""
        if self.folder.is_dir():
            for pattern in ("recording*.rrd", "waveforms*.vcd", "bus.txt"):
                for file in self.folder.glob(pattern):
                    file.unlink(missing_ok=True)
            if not any(self.folder.iterdir()):
                self.folder.rmdir()

    def shorten(self, error: BaseException) -> None:
        """An error of this package speaks for itself: its traceback ends in the test."""
        if isinstance(error, StageError):
            frame = last = error.__traceback__
            while frame is not None:
                if not Path(frame.tb_frame.f_code.co_filename).is_relative_to(HERE):
                    last = frame
                frame = frame.tb_next
            if last is not None:
                last.tb_next = None

    def keep(self) -> str:
        """Save all files; returns the text for the report. "" if nothing has happened yet, or all is saved already."""
        if self._kept or not (self.stage.time or (self.board and self.board.cycles)):
            return ""
        self._kept = True
        try:
            return self._keep()
        except Exception as error:  # whatever it is, it must not hide why the test failed
            return f"nothing more is saved: {type(error).__name__}: {error}"

    def _keep(self) -> str:
        bus = self._bus()
        last = [f"last of {len(bus) - 1:,} lines of the bus trace:", bus[0], *bus[1:][-LAST:]] if bus else []
        return "\n\n".join(filter(None, [self._state(), self._log(), "\n".join(last), self._files(bus)]))

    def _state(self) -> str:
        stage = self.stage
        lines = [f"stage at {stage.time:.6f} s:"]
        for axis in stage.axes.values():
            on = ", ".join(name for name, asserted in axis.switches.as_dict().items() if asserted)
            rate = pulse_rate(axis)
            lines.append(
                f"  {axis.name} ({type(axis.chip).__name__}) at {distance(axis.position, axis.unit)}, commanded "
                f"{distance(axis.commanded, axis.unit)}, {axis.lost_steps} full steps lost, "
                + (f"{rate:+,.0f} pulses/s" if rate else "no pulses")
                + (f", asserted: {on}" if on else "")
                + without_current(axis)
            )
        said = sum(len(chip.diagnostics) for chip in stage.chips)
        if said:
            lines.append(
                f"  {said} bus writes that a data-sheet reader would call mistakes: assert_no_diagnostics(stage)"
            )
        if self.board is not None:
            cycles = self.board.trace.lines()
            if strays := int(cycles["count"][cycles["kind"] & STRAY != 0].sum()):
                lines.append(f"  {strays:,} bus cycles reached no chip: assert_no_strays(board)")
        lines += [f"  fault in force: {fault}" for fault in stage.faults]
        return "\n".join(lines)

    def _log(self) -> str:
        log = self.board.log if self.board is not None else []
        more = [f"  ... {len(log) - LOGGED} lines before"] if len(log) > LOGGED else []
        lines = [f"  {seconds:.9f}  {text}" for seconds, text in log[-LOGGED:]]
        return "\n".join(["log of the firmware:", *more, *lines]) if log else ""

    def _bus(self) -> list[str]:
        """The bus trace in words, after a line that says what it is."""
        if self.board is not None and len(self.board.trace):
            return str(self.board.trace).splitlines()
        lines = []
        for recording in self._recordings():  # chips driven from Python: their journals
            said = [
                (float(recording.seconds(name, said.clock)), name, str(said))
                for name, journal in recording.journals.items()
                for said in decode(recording.axes[name].chip.decoder(recording.axes[name].chip_axis), journal.entries)
            ]
            lines += [f"{seconds:17.9f}  {name}: {text}" for seconds, name, text in sorted(said)]
        return [f"{'seconds':>17}  bus writes", *lines] if lines else []

    def _recordings(self) -> list[Recording]:
        """Those in which something happened; after `restore`, `reset` and `record` another one begins."""
        return [recording for recording in self.stage.recordings if has_something(recording)]

    def _files(self, bus: list[str]) -> str:
        """Write them; a line for each, with the command that opens it."""
        try:
            new = not self.folder.parent.exists()
            self.folder.mkdir(parents=True, exist_ok=True)
            if new:
                (self.folder.parent / ".gitignore").write_text("*\n", encoding="utf-8")
        except OSError as error:
            return f"nothing is saved: {self.folder} cannot be made ({error.strerror})."
        lines = ["saved:"]
        recordings = self._recordings()
        for k, recording in enumerate(recordings):
            number = f"-{k + 1}" if len(recordings) > 1 else ""
            lines.append(self._saved("recording", f"recording{number}.rrd", "rerun", partial(self._picture, recording)))
            lines.append(self._saved("waveforms", f"waveforms{number}.vcd", "gtkwave", recording.to_vcd))
        if not recordings:
            lines.append("  no recording: it was off, by record=False or pulsestage_record")
        if bus:
            text = "\n".join(bus) + "\n"
            lines.append(
                self._saved(
                    "bus trace",
                    "bus.txt",
                    "less",
                    lambda path: path.write_text(text, encoding="utf-8", errors="backslashreplace"),
                )
            )
        return "\n".join(lines)

    def _saved(self, what: str, name: str, opener: str, save: Callable[[Path], Any]) -> str:
        path = self.folder / name
        try:
            save(path)
        except (StageError, OSError) as error:
            return f"  {what}: not saved: {error}"
        return f"  {what}: {opener} {self._shown(path)}"

    def _picture(self, recording: Recording, path: Path) -> None:
        """Save the recording with the full model for display; the test's stage was made without visuals."""
        model, _ = plant.compile_spec(plant.open_spec(self._model), 0)
        if model.nq == recording.model.nq:
            recording.model = model
        recording.save(path)

    def _shown(self, path: Path) -> str:
        """As one would type it."""
        relative = os.path.relpath(path, self._from)
        return relative if not relative.startswith("..") else str(path)
