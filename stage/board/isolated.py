"""Firmware in a process of its own: its crash is an error here, and a loop that never ends is ended.

The child has a stage like ours, a copy, and the firmware drives that. The bus cycles that changed something come over, and our
stage lives through them: since a stage is the same to the bit whenever it is treated alike, it ends where the child's did,
recording, waveforms and diagnostics included. What the firmware did last before a crash lies in memory that both share.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import weakref
from multiprocessing import Pipe
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stage import errors as general
from stage.board import errors, host
from stage.board.board import Board
from stage.board.errors import HostError
from stage.board.link import NOTED
from stage.chips.entries import LOST, READ, WRITE
from stage.errors import StageError
from stage.sim.fingerprint import fingerprint
from stage.sim.records import EDGE

SENT = (WRITE, READ, LOST)
COUNTS = ("cycles", "traced", "changed")  # of HOST


class Begin(NamedTuple):
    """The first message to the child. board: the stage and what else a Board takes, pickled."""

    library: str
    shared: str
    board: bytes
    patience: float


class Go(NamedTuple):
    """Run up to there; `stage`, pickled, if ours was changed since."""

    until: int
    most_cycles: int
    ports: np.ndarray
    stage: bytes | None


class Cycles(NamedTuple):
    """Bus cycles that changed something, EDGE records."""

    edges: np.ndarray


class Line(NamedTuple):
    """A line for the log."""

    now: int
    text: str


class Stands(NamedTuple):
    """The firmware stands still or has returned, at `now`; or `error` ended it."""

    now: int
    ports: np.ndarray
    code: int | None
    error: tuple[str, str] | None


class Shared:
    """What parent and child both see: a file in memory."""

    def __init__(self, path: str | Path, room: int, create: bool = False):
        sizes = [(host.HOST, 1), (EDGE, NOTED), (host.CYCLE, room)]
        total = sum(dtype.itemsize * n for dtype, n in sizes)
        self._map = np.memmap(path, np.uint8, "w+" if create else "r+", shape=(total,))
        parts, at = [], 0
        for dtype, n in sizes:
            parts.append(np.asarray(self._map[at : at + dtype.itemsize * n]).view(dtype))
            at += dtype.itemsize * n
        self.record, self.edges, self.trace = parts

    def copy(self, board: Board, back: bool = False) -> None:
        """A board's cycles, counted and traced, for the child's board to go on from; or back."""
        pairs = [(board.link.record[name], self.record[0][name]) for name in COUNTS]
        if all(ours == theirs for ours, theirs in pairs):
            return
        target, source = (board.link.record, self.record[0]) if back else (self.record[0], board.link.record)
        begin = int(min(target["changed"], source["changed"]))  # lines before are as they were
        for name in COUNTS:
            target[name] = source[name]
        ours, theirs = board.trace.kept, self.trace
        lines = np.arange(max(begin, int(target["traced"]) - len(ours)), target["traced"]) % len(ours)
        if back:
            ours[lines] = theirs[lines]
        else:
            theirs[lines] = ours[lines]


class Isolated:
    """See `Runner`."""

    def __init__(self, path: Path, board: Board, patience: float):
        if os.name != "posix":
            raise StageError("isolated=True needs a POSIX system; run the firmware in this process.")
        self._path, self._board, self._patience = path, board, patience
        self._child: subprocess.Popen | None = None
        self._pipe: Any = None
        self._running = False
        self._seen = b""
        self._start()

    @property
    def running(self) -> bool:
        return self._running

    def go_on(self, until: int, most_cycles: int) -> int | None:
        board = self._board
        if any(chip.glitches for chip in board.stage.chips):
            raise StageError(
                "a fault of the bus asks this process about each write: run the firmware with isolated=False."
            )
        if board.link.record["hook"]:
            raise StageError(
                "an interrupt hook in Python is called in this process only: run the firmware with isolated=False, or take the "
                "hook away: board.on_interrupt(None)."
            )
        if self._child is None:
            self._start()
        self._running = True
        changed = _pickled(board.stage) if _fingerprint(board.stage) != self._seen else None
        self._shared.copy(board)
        try:
            self._pipe.send(Go(until, most_cycles, board.port_table, changed))
            while not isinstance(message := self._pipe.recv(), Stands):
                self._take(message)
        except (EOFError, OSError):
            raise self._crashed() from None
        except BaseException:
            self._end()
            raise
        if message.error is not None:
            self._end()
        self._catch_up(message.now)
        board.port_table[:] = message.ports
        if message.error is not None:
            raise _revived(*message.error)
        self._running = message.code is None
        self._seen = _fingerprint(board.stage)
        return message.code

    def close(self) -> None:
        self._end()

    def _start(self) -> None:
        """A child with a copy of the stage; raises what is wrong with the library."""
        board = self._board
        given = _pickled((board.stage, board.options))
        file, shared = tempfile.mkstemp(prefix="pulsestage-")
        os.close(file)
        ours, theirs = Pipe()
        try:
            self._shared = Shared(shared, board.trace.room, create=True)
            command = [sys.executable, "-m", "stage.board.child", str(theirs.fileno())]
            self._child = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, process_group=0,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
            )  # fmt: skip
            theirs.close()
            self._pipe = ours
            weakref.finalize(self, _ended, self._child)
            ours.send(Begin(str(self._path), shared, given, self._patience))
            self._seen = _fingerprint(board.stage)
            answer = ours.recv()
        except (EOFError, ConnectionError):
            raise HostError(f"{self._path.name} {self._ended_how()} while it was loaded.") from None
        finally:
            os.unlink(shared)
        if answer is not None:
            self._end()
            raise _revived(*answer)

    def _take(self, message: Cycles | Line) -> None:
        if isinstance(message, Line):
            self._board.log.append((message.now * 1e-9, message.text))
        else:
            self._live_through(message.edges)

    def _live_through(self, edges: np.ndarray) -> None:
        """Our stage makes the cycles that the child's has made."""
        stage = self._board.stage
        axes = list(stage.axes.values())
        for now, axis, kind, a, b in zip(*(edges[n].tolist() for n in ("now", "axis", "kind", "a", "b")), strict=True):
            stage.run_to(now)
            chip: Any = axes[axis].chip
            if kind == LOST:
                chip.open_journal.note_lost(chip.clock, a, b)
            elif kind == READ:
                read = chip.CORE.read.c(chip.pointer, a)
                if read != b:
                    raise HostError(
                        f"the stage of the firmware's process read {b:X}h where this one reads {read:X}h: report this."
                    )
                chip.open_journal.note_read(chip.clock, a, b)
            else:
                chip.CORE.write.c(chip.pointer, a, b)
                chip.open_journal.note_write(chip.clock, a, b)

    def _catch_up(self, now: int) -> None:
        """To `now`, and what the child's board knows."""
        board = self._board
        board.stage.run_to(max(now, board.stage.now))
        self._shared.copy(board, back=True)

    def _crashed(self) -> HostError:
        """The child is gone. What it did last is in the memory that we share."""
        how, board, theirs = self._ended_how(), self._board, self._shared.record[0]
        edges = self._shared.edges[: int(theirs["noted"])]
        self._live_through(edges[np.isin(edges["kind"], SENT)])
        self._catch_up(int(theirs["reached"] + theirs["ahead"]))
        return HostError(
            f"{self._path.name} {how} at {board.stage.time:.6f} s, after {board.cycles:,} bus cycles. The stage stands where it "
            f"stood then. Its last bus cycles:\n{board.trace.text(12)}"
        )

    def _ended_how(self) -> str:
        """How the child ended by itself."""
        code = self._child.wait() if self._child is not None else 0
        self._end()
        return f"was ended by {_signal(-code)}" if code < 0 else f"ended its process with exit code {code}"

    def _end(self) -> None:
        """No child any more."""
        if self._child is not None:
            _ended(self._child)
            self._pipe.close()
        self._child, self._running, self._seen = None, False, b""


def _ended(child: subprocess.Popen) -> None:
    child.kill()
    child.wait()


def _fingerprint(stage: Any) -> bytes:
    """Of all in which the child's stage must be like this one."""
    parts = stage.__getstate__()
    return fingerprint(parts.pop("model")) + hashlib.blake2b(_pickled(parts)).digest()


def _pickled(stage: Any) -> bytes:
    try:
        return pickle.dumps(stage)
    except Exception as error:
        raise StageError(
            f"firmware with isolated=True needs a stage that can be pickled: {error}. Define the classes of its chips and layouts "
            "at the top of a module, or run the firmware with isolated=False."
        ) from None


def _signal(number: int) -> str:
    try:
        return f"{signal.Signals(number).name} ({signal.strsignal(number)})"
    except ValueError:
        return f"signal {number}"


def _revived(name: str, text: str) -> Exception:
    """An error of the child's, as ours."""
    kind = getattr(errors, name, None) or getattr(general, name, None)
    return kind(text) if isinstance(kind, type) and issubclass(kind, StageError) else HostError(f"{name}: {text}")
