"""Shared memory of a board and the process of its firmware: a file in memory, and the messages about it.

The child writes bus cycles, edges (EDGE), samples of a recording, log lines, the trace and, from time to time, the
whole state of its stage. Messages tell the parent how much there is to read. The file survives a crash of the child.
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
from stage.board.bus import host_record, serial_core
from stage.board.bus.interrupt_controller import BACK, HIGHEST_LEVEL, LOWERED, SOURCE, SOURCE_COUNT
from stage.board.host_record_link import NOTE_BUFFER_ROWS
from stage.board.interrupt_hooks import PYTHONS_TIMERS
from stage.board.pin_assignment import WiringFinding
from stage.board.thread_runner import Program
from stage.chips.journal_entries import LOST, READ, WRITE
from stage.errors import StageError
from stage.native import remove_attribute_access
from stage.sim.engine_records import LOGGED_EDGE, NS_PER_SECOND, SAMPLE

SAMPLE_ROWS = 512
TEXT_SIZE = 1 << 16  # bytes of lines
CRASH_SIZE = 1 << 14  # bytes about a crash
COUNTS = ("cycles", "traced", "changed", "faults")  # of HOST
TIMER_ROWS = slice(PYTHONS_TIMERS.start, PYTHONS_TIMERS.stop)
_ALIGNMENT = 64
_LINE = struct.Struct("qq")  # time, length
_GUARD_SIZE = 64  # random bytes behind each array
_CONSTANT_FIELDS = (
    "mj_model mj_data world axes drives switches table switch_table chips clockwork qpos qvel ctrl sensordata inertia sites bodies "
    "n_axes n_switches n_chips nq nv nu ns n_sites n_bodies bus own edges edge_room regions n_regions ports n_ports "
    "trace_cycles trace_capacity call irqs acts before userdata words journals devices n_devices serial"
).split()
"""Fields of the child's HOST record that never change."""
_LINE_BOUNDS = {
    "kind": (0, 7 | host_record.STRAY | host_record.WRITE_LOST | host_record.RAISED),
    "count": (1, 1 << 62),
    "port": (0, host_record.LAST_PORT),
}


class CorruptedError(Exception):
    """Error of shared memory that the firmware has overwritten."""


LOADING = "loading"
"""The first message of the child: the firmware is about to be loaded. Then comes None, or what is wrong: type and text."""


class StartMessage(NamedTuple):
    """First message to the child.

    Attributes:
        program: The firmware.
        shared: Path of the shared file.
        board: Pickled stage, options of the Board, and devices.
        patience: Real time in seconds that the firmware may compute without a bus cycle.
    """

    program: Program
    shared: str
    board: bytes
    patience: float


class RunOrder(NamedTuple):
    """Order to continue from the state in the shared file.

    Attributes:
        until: Time at which to pause, ns.
        max_cycles: Number of bus cycles at which to pause.
        ports: Table of ports.
        machine: Pickled stage if its settings changed, otherwise None.
        sample_every: Physics steps between samples; 0 for none.
        checked_chips: Bit mask of the chips whose writes a fault of the bus may lose.
        hooks: Interrupt sources that call Python.
        lines: Number of log lines so far.
    """

    until: int
    max_cycles: int
    ports: np.ndarray
    machine: bytes | None
    sample_every: int
    checked_chips: int
    hooks: tuple[int, ...]
    lines: int


class UnreadCounts(NamedTuple):
    """Numbers of EDGE records and samples in the shared file that the parent has not read."""

    edges: int
    samples: int


class ParentCallRequest(NamedTuple):
    """Request by the child: the parent is to run Python code for a bus write, an interrupt source or a device.

    The answer is a tuple: result of the call, whether it succeeded, `RunOrder.machine`, `RunOrder.hooks`.

    Attributes:
        noted: Numbers of edges and samples in the shared file that the parent has not read.
        chip: Number of the chip or device; -1 - k for interrupt source k.
        address: Address at the chip, or register of the device.
        value: Value that is written.
        kind: Kind of the bus cycle as in `Device.access_register`; -1 for a chip.
    """

    noted: UnreadCounts
    chip: int
    address: int
    value: int
    kind: int = -1


class PausedMessage(NamedTuple):
    """Message that the firmware has paused or returned, or that an error ended it.

    Attributes:
        noted: Numbers of notes in the shared file.
        ports: Table of ports.
        code: Value that the firmware returned; None while it has not returned.
        error: Type and text of the error that ended the firmware.
        wiring_findings: Sentences about lines of axes that seem to be at the wrong pins.
    """

    noted: UnreadCounts
    ports: np.ndarray
    code: int | None
    error: tuple[str, str] | None
    wiring_findings: tuple[WiringFinding, ...]


def _make_file(path: Path, size: int) -> None:
    """Create a file with reserved disk space, since a write without space would kill the process. Raises StageError."""
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


def _is_within(rows: np.ndarray, **bounds: tuple[int, int]) -> bool:
    """Return whether the named fields of all rows are within their bounds."""
    return not len(rows) or all(low <= rows[n].min() and rows[n].max() <= high for n, (low, high) in bounds.items())


def _map_for_firmware(path: Path, size: int) -> np.ndarray:
    """Map the file for the life of this process and close its descriptor, with which firmware could truncate the file.

    A read beyond the end of a truncated file raises SIGBUS, in the parent too.
    """
    map_file = ctypes.CDLL(None, use_errno=True).mmap
    map_file.restype = ctypes.c_void_p
    access, offset = mmap.PROT_READ | mmap.PROT_WRITE, ctypes.c_long(0)
    with path.open("r+b") as file:
        address = map_file(None, ctypes.c_size_t(size), access, mmap.MAP_SHARED, file.fileno(), offset)
    if address is None or address == ctypes.c_void_p(-1).value:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), str(path))
    return np.ctypeslib.as_array((ctypes.c_uint8 * size).from_address(address))


class SharedMemory:
    """Shared file. Parent and child create it from equal boards.

    Attributes:
        record: HOST record of the child.
        edges: EDGE records.
        cycles: Lines of the child's trace.
        state: State of MuJoCo with the whole stage, then the state of the devices, as float64.
        samples, positions: Buffers like those of a Recording.
        sources: Interrupt sources of the child.
        devices: State of the child's devices, as float64.
        serial: LINE records of the serial lines, which both processes use.
    """

    def __init__(self, path: str | Path, board: Board, create: bool = False):
        state = board.stage.state
        axes, nq, words = len(board.stage.axes), state.model.nq, len(state.saved) + board.stage.device_state.words
        sizes: list[tuple[Any, tuple[int, ...]]] = [
            (host_record.HOST, (1,)), (LOGGED_EDGE, (NOTE_BUFFER_ROWS,)), (host_record.CYCLE, (board.trace.capacity,)),
            (np.float64, (words,)),
            (SAMPLE, (SAMPLE_ROWS, axes)), (np.float64, (SAMPLE_ROWS, nq)), (remove_attribute_access(SOURCE), (SOURCE_COUNT,)),
            (np.int64, (1,)),
            (np.uint8, (TEXT_SIZE,)), (np.uint8, (CRASH_SIZE,)), (np.float64, (board.stage.device_state.words,)),
            (serial_core.SERIAL_LINE, (serial_core.SERIAL_LINE_COUNT,)),
        ]  # fmt: skip
        lengths = [int(np.dtype(dtype).itemsize * np.prod(shape)) for dtype, shape in sizes]
        places = np.cumsum([0, *(-(-n // _ALIGNMENT) * _ALIGNMENT + _GUARD_SIZE for n in lengths)]).tolist()
        if create:
            _make_file(Path(path), places[-1])
            self._map: np.ndarray = np.memmap(path, np.uint8, "r+", shape=(places[-1],))
        else:
            self._map = _map_for_firmware(Path(path), places[-1])
        (
            self.record, self.edges, self.cycles, self.state, self.samples, self.positions, self.sources, used, text, crash,
            self.devices, self.serial,
        ) = (
            np.asarray(self._map[at : at + n]).view(dtype).reshape(shape)
            for at, n, (dtype, shape) in zip(places, lengths, sizes, strict=False)
        )  # fmt: skip
        self._used, self._text, self._crash = used.data, text.data, crash.data
        self._guards = [np.asarray(self._map[end - _GUARD_SIZE : end]) for end in places[1:]]
        if create:
            for guard in self._guards:
                guard[:] = np.frombuffer(os.urandom(_GUARD_SIZE), np.uint8)
        self._guarded = b"".join(map(bytes, self._guards))
        self._fixed: tuple[int, ...] | None = None

    def hide_from_forks(self) -> None:
        """Exclude the shared memory from forks of this process, which could otherwise change it unnoticed."""
        if hasattr(mmap, "MADV_DONTFORK"):
            address, size = ctypes.c_void_p(self._map.ctypes.data), ctypes.c_size_t(self._map.nbytes)
            ctypes.CDLL(None).madvise(address, size, mmap.MADV_DONTFORK)

    # --- whether firmware has written over it ---

    def remember_constant_fields(self) -> None:
        """Store the constant fields of the child's HOST record, for `check`."""
        self._fixed = self.record[_CONSTANT_FIELDS].item()

    def check(self) -> None:
        """Raise CorruptedError if the firmware has changed the guard words or constant fields of the shared memory."""
        guarded = b"".join(map(bytes, self._guards))
        if guarded != self._guarded or self._fixed not in (None, self.record[_CONSTANT_FIELDS].item()):
            raise CorruptedError

    def check_records(self, board: Board, edges: int, samples: int, until: int, ended: bool = False) -> None:
        """Validate the edges and samples that the parent is about to read.

        Args:
            board: Board of the parent.
            edges: Number of EDGE records.
            samples: Number of samples.
            until: End of the run, ns.
            ended: Whether the child has ended; then the cycles and the trace are validated too.

        Raises:
            CorruptedError: The child cannot have written these records.
        """
        self.check()
        h, ours, timers = self.record[0], board.link.record, self.sources[TIMER_ROWS]
        latest = until + NS_PER_SECOND
        valid = (
            0 <= edges <= len(self.edges)
            and 0 <= samples <= len(self.samples)
            and h["cycles"] >= ours["cycles"]
            and ours["traced"] <= h["traced"]
            and 0 <= h["changed"] <= h["traced"]
            and _is_within(timers, period=(0, 1 << 62), level=(0, HIGHEST_LEVEL))
            and _is_within(self.edges[:edges], axis=(0, len(board.stage.axes) - 1), now=(0, latest))
        )
        if not valid or (ended and not self._is_end_valid(int(ours["traced"]), edges, latest)):
            raise CorruptedError

    def _is_end_valid(self, traced: int, edges: int, latest: int) -> bool:
        """Return whether a child process that has ended can have written its noted cycles, and the trace from line `traced` on."""
        h = self.record[0]
        if not (0 <= h["reached"] <= latest and 0 <= h["ahead"] <= latest):
            return False
        lines = np.arange(max(traced, int(h["traced"]) - len(self.cycles)), h["traced"]) % len(self.cycles)
        cycles = self.edges[:edges][np.isin(self.edges[:edges]["kind"], (WRITE, READ, LOST))]
        lines = self.cycles[lines]
        return (
            _is_within(cycles, a=(0, 0xFF), b=(0, 0xFFFF))
            and _is_within(lines, first=(0, latest), last=(0, latest), **_LINE_BOUNDS)
            and _is_within(lines[lines["kind"] == host_record.RETURNED], value=(BACK, LOWERED))
        )

    # --- a crash ---

    def note_crash(self, note: bytes) -> None:
        """Store the note of a crash of the child, which `crash_report.describe_crash` reads."""
        self._crash[: min(len(note), CRASH_SIZE)] = note[:CRASH_SIZE]

    @property
    def crash(self) -> bytes:
        """Note of a crash of the child, as bytes; empty if there is none."""
        return self._crash.tobytes().rstrip(b"\0")

    # --- lines of the log ---

    def add_log_line(self, now: int, text: str) -> bool:
        """Add a line for the log of the parent's board; return False if there is no room.

        Args:
            now: Time, ns.
            text: The line.
        """
        content, begin = text.encode(errors="replace")[: TEXT_SIZE // 2], self._used[0]
        end = begin + _LINE.size + len(content)
        if end > TEXT_SIZE:
            return False
        _LINE.pack_into(self._text, begin, now, len(content))
        self._text[begin + _LINE.size : end] = content
        self._used[0] = end
        return True

    def take_log_lines(self) -> list[tuple[float, str]]:
        """Return the firmware's log lines since the last call: (simulated seconds, text)."""
        content, at, lines = self._text[: self._used[0]].tobytes(), 0, []
        while at + _LINE.size <= len(content):
            now, length = _LINE.unpack_from(content, at)
            if not 0 <= length <= len(content) - at - _LINE.size:  # firmware has written here
                break
            at += _LINE.size + length
            lines.append((now * 1e-9, content[at - length : at].decode(errors="replace")))
        self._used[0] = 0
        return lines

    # --- the trace ---

    def copy_board_state(self, board: Board, back: bool = False) -> None:
        """Copy trace, counters and timers from the parent's board to the shared file, or with `back` in the other
        direction."""
        ours = board.link.record, board.link.hooks.sources[TIMER_ROWS], board.trace.buffer
        theirs = self.record[0], self.sources[TIMER_ROWS], self.cycles
        source, timers, cycles = theirs if back else ours
        target, target_timers, target_cycles = ours if back else theirs
        for name in ("level", "period", "next", "pending", "missed"):
            target_timers[name] = timers[name]
        if all(target[name] == source[name] for name in COUNTS):
            return
        begin = int(min(target["changed"], source["changed"]))  # lines before are the same
        for name in COUNTS:
            target[name] = source[name]
        lines = np.arange(max(begin, int(target["traced"]) - len(cycles)), target["traced"]) % len(cycles)
        target_cycles[lines] = cycles[lines]
