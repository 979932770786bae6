"""What a board and the process of its firmware both see: a file in memory, and the messages about it.

The child writes what it notes into the file: bus cycles and edges (EDGE), samples of a recording, lines of the log, the trace; and
from time to time the whole state of its stage. A message says how much there is. After a crash the file is still there.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stage.board.board import Board
from stage.board.bus import host_record
from stage.board.bus.interrupts import BACK, HIGHEST, LOWERED, SOURCE, SOURCES
from stage.board.interrupt_hooks import PYTHONS_TIMERS
from stage.board.link import NOTED
from stage.board.thread_runner import Program
from stage.chips.entries import LOST, READ, WRITE
from stage.errors import StageError
from stage.native import plain
from stage.sim.records import EDGE, SAMPLE, SECOND

ROWS = 512  # samples
TEXT = 1 << 16  # bytes of lines
CRASH = 1 << 14  # bytes about a crash
COUNTS = ("cycles", "traced", "changed", "faults")  # of HOST
PYTHONS_ROWS = slice(PYTHONS_TIMERS.start, PYTHONS_TIMERS.stop)
_ALIGNED = 64
_LINE = struct.Struct("qq")  # time, length
_GUARD = 64  # bytes of chance behind each array
_FIXED = (
    "mj_model mj_data world axes drives switches table switch_table chips clockwork qpos qvel ctrl sensordata inertia sites bodies "
    "n_axes n_switches n_chips nq nv nu ns n_sites n_bodies bus own edges edge_room regions n_regions ports n_ports lines "
    "line_room call irqs acts before userdata words journals devices n_devices"
).split()
"""What the child's HOST record has once for all."""


class SpoiltError(Exception):
    """Firmware has written over the file."""


LOADING = "loading"
"""The first message of the child: the firmware is about to be loaded. Then comes None, or what was wrong: type and text."""


class Begin(NamedTuple):
    """The first message to the child. board: the stage, what else a Board takes, and its devices, pickled."""

    program: Program
    shared: str
    board: bytes
    patience: float


class Go(NamedTuple):
    """Run up to there, from the state in the file.

    machine: the stage, pickled, if it was changed in what is no state. sample_every: physics steps between samples, 0 for none.
    asks: chips, a bit each, whose writes a fault of the bus looks at. hooks: the interrupt sources that call Python.
    lines: of the log so far.
    """

    until: int
    most_cycles: int
    ports: np.ndarray
    machine: bytes | None
    sample_every: int
    asks: int
    hooks: tuple[int, ...]
    lines: int


class Noted(NamedTuple):
    """So many EDGE records and samples are in the file, and the state."""

    edges: int
    samples: int


class Asked(NamedTuple):
    """Python is to be called, in the parent: about a write to a chip, by an interrupt source (chip -1 - its index), or as a device
    on the bus (chip: which, way: as `Device.call` has it).

    The answer: (what Python said, whether it went well, the stage as in `Go.machine`, `Go.hooks`).
    """

    noted: Noted
    chip: int
    address: int
    value: int
    way: int = -1


class Stands(NamedTuple):
    """The firmware is paused or has returned; or `error` ended it."""

    noted: Noted
    ports: np.ndarray
    code: int | None
    error: tuple[str, str] | None


_LINES = {
    "kind": (0, 7 | host_record.STRAY | host_record.LOST_ON_THE_WAY | host_record.RAISED),
    "count": (1, 1 << 62),
    "port": (0, host_record.LAST_PORT),
}


def _make(path: Path, size: int) -> None:
    """A file whose bytes the disk has: a write to one that it had not would end the process. Raises StageError."""
    try:
        with path.open("wb") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
    except OSError as error:
        raise StageError(
            f"firmware in a process of its own needs {size / 1e6:.1f} MB in {path.parent.parent}, mostly for the trace, and they "
            f"cannot be had: {error.strerror}. Make room, set TMPDIR to another folder, keep fewer cycles (--keep, keep_cycles=), "
            "or run it in this process."
        ) from None


def _within(rows: np.ndarray, **bounds: tuple[int, int]) -> bool:
    """Whether the fields of all rows are in these bounds."""
    return not len(rows) or all(low <= rows[n].min() and rows[n].max() <= high for n, (low, high) in bounds.items())


def _map_for_firmware(path: str | Path, size: int) -> np.ndarray:
    """Map the file for as long as this process lives, and keep no file descriptor: firmware could cut the file by it.

    A process that has mapped more than a file holds ends with SIGBUS where it reads beyond, and the parent maps it, too.
    """
    map_file = ctypes.CDLL(None, use_errno=True).mmap
    map_file.restype = ctypes.c_void_p
    with open(path, "r+b") as file:
        address = map_file(
            None,
            ctypes.c_size_t(size),
            mmap.PROT_READ | mmap.PROT_WRITE,
            mmap.MAP_SHARED,
            file.fileno(),
            ctypes.c_long(0),
        )
    if address is None or address == ctypes.c_void_p(-1).value:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), str(path))
    return np.ctypeslib.as_array((ctypes.c_uint8 * size).from_address(address))


class Shared:
    """The file. Both sides make it of boards that are alike.

    Attributes: record: the HOST record of the child; edges: EDGE; cycles: the lines of its trace; state: float64, MuJoCo's, with
    the whole stage in it, and the state of the devices behind it; samples, positions: as those of a Recording; sources: of the
    child's interrupt controller; devices: float64, where the devices of the child have their state.
    """

    def __init__(self, path: str | Path, board: Board, create: bool = False):
        state = board.stage.state
        axes, nq, words = len(board.stage.axes), state.model.nq, len(state.saved) + board.stage.device_state.words
        sizes: list[tuple[Any, tuple[int, ...]]] = [
            (host_record.HOST, (1,)), (EDGE, (NOTED,)), (host_record.CYCLE, (board.trace.room,)), (np.float64, (words,)),
            (SAMPLE, (ROWS, axes)), (np.float64, (ROWS, nq)), (plain(SOURCE), (SOURCES,)), (np.int64, (1,)), (np.uint8, (TEXT,)),
            (np.uint8, (CRASH,)), (np.float64, (board.stage.device_state.words,)),
        ]  # fmt: skip
        lengths = [int(np.dtype(dtype).itemsize * np.prod(shape)) for dtype, shape in sizes]
        places = np.cumsum([0, *(-(-n // _ALIGNED) * _ALIGNED + _GUARD for n in lengths)]).tolist()
        if create:
            _make(Path(path), places[-1])
        self._map = (
            np.memmap(path, np.uint8, "r+", shape=(places[-1],)) if create else _map_for_firmware(path, places[-1])
        )
        (
            self.record, self.edges, self.cycles, self.state, self.samples, self.positions, self.sources, used, text, crash,
            self.devices,
        ) = (
            np.asarray(self._map[at : at + n]).view(dtype).reshape(shape)
            for at, n, (dtype, shape) in zip(places, lengths, sizes, strict=False)
        )  # fmt: skip
        self._used, self._text, self._crash = used.data, text.data, crash.data
        self._guards = [np.asarray(self._map[end - _GUARD : end]) for end in places[1:]]
        if create:
            for guard in self._guards:
                guard[:] = np.frombuffer(os.urandom(_GUARD), np.uint8)
        self._guarded = b"".join(map(bytes, self._guards))
        self._fixed: tuple[int, ...] | None = None

    # --- the state of a stage ---

    def keep(self, stage: Any) -> None:
        """The state of this stage goes into the file."""
        stage.copy_state(self.state)

    def not_for_forks(self) -> None:
        """A process that this one forks does not have the memory: it would change what it shares with nobody's knowledge."""
        if hasattr(mmap, "MADV_DONTFORK"):
            address, size = ctypes.c_void_p(self._map.ctypes.data), ctypes.c_size_t(self._map.nbytes)
            ctypes.CDLL(None).madvise(address, size, mmap.MADV_DONTFORK)

    # --- whether it is whole ---

    def remember(self) -> None:
        """The child's HOST record is complete: from now on `check` knows it."""
        self._fixed = self.record[_FIXED].item()

    def check(self) -> None:
        """Raises SpoiltError if somebody has written where only the board writes."""
        guarded = b"".join(map(bytes, self._guards))
        if guarded != self._guarded or self._fixed not in (None, self.record[_FIXED].item()):
            raise SpoiltError

    def check_notes(self, board: Board, edges: int, samples: int, until: int, ended: bool = False) -> None:
        """As `check`, for the parent, before it takes so many EDGE records and samples of a run up to `until` (ns). ended: the
        cycles are to be made again, and the trace is to be read as it is."""
        self.check()
        h, ours = self.record[0], board.link.record
        latest, timers = until + SECOND, self.sources[PYTHONS_ROWS]
        whole = 0 <= edges <= len(self.edges) and 0 <= samples <= len(self.samples)
        whole = (
            whole
            and h["cycles"] >= ours["cycles"]
            and ours["traced"] <= h["traced"]
            and 0 <= h["changed"] <= h["traced"]
        )
        whole = whole and bool(((timers["period"] >= 0) & (timers["level"] >= 0) & (timers["level"] <= HIGHEST)).all())
        if not (whole and _within(self.edges[:edges], axis=(0, len(board.stage.axes) - 1), now=(0, latest))):
            raise SpoiltError
        if not ended:
            return
        lines = np.arange(max(int(ours["traced"]), int(h["traced"]) - len(self.cycles)), h["traced"]) % len(self.cycles)
        cycles = self.edges[:edges][np.isin(self.edges[:edges]["kind"], (WRITE, READ, LOST))]
        whole = (
            0 <= h["reached"] <= latest and 0 <= h["ahead"] <= latest and _within(cycles, a=(0, 0xFF), b=(0, 0xFFFF))
        )
        lines = self.cycles[lines]
        whole = whole and _within(lines, first=(0, latest), last=(0, latest), **_LINES)
        if not (whole and _within(lines[lines["kind"] == host_record.RETURNED], value=(BACK, LOWERED))):
            raise SpoiltError

    # --- a crash ---

    def note_crash(self, noted: bytes) -> None:
        """What `crash_report.describe` reads."""
        self._crash[: min(len(noted), CRASH)] = noted[:CRASH]

    @property
    def crash(self) -> bytes:
        """What was noted of it; empty if nothing was."""
        return self._crash.tobytes().rstrip(b"\0")

    # --- lines of the log ---

    def note(self, now: int, text: str) -> bool:
        """One more line; False if there is no room for it."""
        content, begin = text.encode(errors="replace")[: TEXT // 2], self._used[0]
        end = begin + _LINE.size + len(content)
        if end > TEXT:
            return False
        _LINE.pack_into(self._text, begin, now, len(content))
        self._text[begin + _LINE.size : end] = content
        self._used[0] = end
        return True

    def lines(self) -> list[tuple[float, str]]:
        """The lines noted since the last time: seconds, text."""
        content, at, found = self._text[: self._used[0]].tobytes(), 0, []
        while at + _LINE.size <= len(content):
            now, length = _LINE.unpack_from(content, at)
            if not 0 <= length <= len(content) - at - _LINE.size:  # firmware has written here
                break
            at += _LINE.size + length
            found.append((now * 1e-9, content[at - length : at].decode(errors="replace")))
        self._used[0] = 0
        return found

    # --- the trace ---

    def copy(self, board: Board, back: bool = False) -> None:
        """A board's cycles, counted and traced, and timers, for the child's board to go on from; or back."""
        timers, theirs_too = board.link.hooks.sources[PYTHONS_ROWS], self.sources[PYTHONS_ROWS]
        for name in ("level", "period", "next", "pending", "missed"):
            (timers if back else theirs_too)[name] = (theirs_too if back else timers)[name]
        pairs = [(board.link.record[name], self.record[0][name]) for name in COUNTS]
        if all(ours == theirs for ours, theirs in pairs):
            return
        target, source = (board.link.record, self.record[0]) if back else (self.record[0], board.link.record)
        begin = int(min(target["changed"], source["changed"]))  # lines before are as they were
        for name in COUNTS:
            target[name] = source[name]
        ours, theirs = board.trace.kept, self.cycles
        lines = np.arange(max(begin, int(target["traced"]) - len(ours)), target["traced"]) % len(ours)
        if back:
            ours[lines] = theirs[lines]
        else:
            theirs[lines] = ours[lines]
