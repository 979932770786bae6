"""The windows of a firmware in this process: pages that nobody may touch, and the handler of the faults.

An access to such a page raises SIGSEGV. The handler (stage.board.x86) makes bus cycles of it and goes on behind it. Any other
fault goes to the handler that was there before.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import struct
from collections import deque
from pathlib import Path
from signal import SIGSEGV
from threading import Lock, get_ident
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.board import crash
from stage.board.errors import HostError
from stage.board.host import BEYOND_WINDOW
from stage.board.whereabouts import executable
from stage.board.windows import Window, windows
from stage.board.x86 import records, table, trap
from stage.errors import ArgumentError, StageError
from stage.native import array_at

if TYPE_CHECKING:
    from stage.board.library import Library
    from stage.board.link import Link

HERE = crash.HERE and platform.machine() == "x86_64"
PROXIES = "use the registers of pulsestage_mmio.hpp, or macros: docs/memory_mapped.md"
LOWEST = 1 << 16  # below the system lets nobody map
CHOSEN = 0x5000_0000  # from here on lie windows without an address of their own
BETWEEN, CHOICES = 1 << 20, 1024
MARGIN = 1 << 16  # bytes at the end of a stack, where the guard may be
_NO_ACCESS, _PRIVATE, _ANONYMOUS, _NO_RESERVE, _NO_REPLACE = 0, 2, 0x20, 0x4000, 0x100000
_WITH_INFO, _NESTED, _ON_STACK = 4, 0x40000000, 0x08000000  # flags of sigaction
_LOAD, _READ_ONLY = 1, 0x6474E552  # kinds of a program header
_libc: Any = ctypes.CDLL(None)
_libc.mmap.restype = _libc.pthread_self.restype = ctypes.c_void_p
_lock = Lock()


class Mapped:
    """A firmware in memory, with windows. Raises StageError where there can be none, ArgumentError where something else is."""

    def __init__(self, library: Library, given: tuple[Window, ...], link: Link):
        self._library, self._link, self._host = library, link, link.pointer
        self._windows: list[Window] = []
        self._memory = memory_of(library) if HERE else []
        self._stacks: list[tuple[int, crash.OwnStack]] = []
        link.windows = self
        try:
            if given and not HERE:
                raise StageError(
                    f"windows of memory-mapped registers need Linux on x86-64, and this is {platform.system()} on "
                    f"{platform.machine()}: {PROXIES}."
                )
            for window in given:
                self._claim(window)
        except StageError:
            self.close()
            raise

    def main(self) -> int:
        """Run it."""
        if self._windows:
            self._own_stack()
        return int(self._library.main())

    def close(self) -> None:
        """It has returned."""
        self.end()
        for thread, own in self._stacks:
            if thread == get_ident():
                own.close()
        self._library.close()

    def end(self) -> None:
        """Its windows are gone: it does not run any more."""
        with _lock:
            pages = _claims.pop(self, [])
        for begin, end in pages:
            _libc.munmap(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin))
        self._windows = []
        if pages:
            _publish()

    def _own_stack(self) -> None:
        """The handler runs on another stack than the firmware, in this thread: it then may go on with calls of functions."""
        if not self._stacks:
            self._memory.append((*stack(), records.READ | records.WRITE | records.STACK))
            self._stacks.append((get_ident(), crash.OwnStack()))
            _publish()

    def choose(self, port: int, length: int) -> int:
        """A window at an address of our choice; returns the address. Raises HostError, StageError."""
        if not HERE:
            raise StageError(f"ps_window needs Linux on x86-64: {PROXIES}.")
        try:
            size = windows((0, port, length))[0].end
        except ArgumentError as error:
            raise HostError(f"ps_window({port:#x}, {length:#x}): {error}") from None
        begin = max([CHOSEN, *(-(-end // BETWEEN) * BETWEEN for _, end in _claims.get(self, []))])
        for address in range(begin, begin + CHOICES * BETWEEN, BETWEEN):
            try:
                self._claim(Window(address, port, size))
            except ArgumentError:
                continue
            except StageError as error:
                raise HostError(
                    f"ps_window({port:#x}, {length:#x}): {error} Ask once for each window, and keep the pointer; {self._when()}"
                ) from None
            self._own_stack()
            return address
        raise HostError(f"ps_window({port:#x}, {length:#x}): there is no room for a window of this size.")

    def _claim(self, window: Window) -> None:
        """The pages of a window are ours."""
        if window.address < LOWEST:
            raise ArgumentError(
                f"window {window}: the system lets nobody use addresses below {LOWEST:X}h, where null pointers lead; {PROXIES}."
            )
        with _lock:
            pages = _claims.setdefault(self, [])
            begin, end = window.address & -mmap.PAGESIZE, -(-window.end // mmap.PAGESIZE) * mmap.PAGESIZE
            for mine in pages:
                if mine[0] <= begin < mine[1]:
                    begin = mine[1]
            for mine in pages:
                if mine[0] < end <= mine[1]:
                    end = mine[0]
            if begin < end:
                at = _libc.mmap(
                    ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _NO_ACCESS,
                    _PRIVATE | _ANONYMOUS | _NO_RESERVE | _NO_REPLACE, -1, ctypes.c_long(0),
                )  # fmt: skip
                if at != begin:
                    if at != ctypes.c_void_p(-1).value:
                        _libc.munmap(ctypes.c_void_p(at), ctypes.c_size_t(end - begin))
                    raise ArgumentError(
                        f"window {window}: {_in_use(begin, end)}. Choose another address; or {PROXIES}."
                    )
                pages.append((begin, end))
        self._windows.append(window)
        _publish()
        _handle_faults()

    def spans(self) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]], list[tuple[int, ...]]]:
        """SPANs: windows, their pages, memory."""
        pages = _claims.get(self, [])
        return (
            [(w.address, w.end, records.WINDOW, w.port, self._host) for w in self._windows],
            [(begin, end, records.PAGE, 0, self._host) for begin, end in pages],
            [(*memory, 0, self._host) for memory in self._memory] if pages else [],
        )

    def refusal(self, what: int, step: int, address: int) -> HostError:
        """Why an instruction is no bus cycle. step: the address of its STEP."""
        state: Any = array_at(step, 1, records.STEP)[0]
        start, top = int(state.start), ctypes.c_uint64.from_address(int(state.stack)).value
        who = f"{self._library.path.name}: an access to address {address:X}h in {crash.place(start, top, self._library.path)}"
        near = next((w for w in self._windows if w.address <= address < w.end), None)
        if what == BEYOND_WINDOW:
            window = near or min(self._windows, key=lambda w: min(abs(address - w.address), abs(address - w.end)))
            goes = "goes on" if near else "is"
            return HostError(
                f"{who} {goes} beyond the window {window}, which ends at {window.end - 1:X}h. Give it more ports, or another "
                f"window there (--map, map=); {self._when()}"
            )
        code = ctypes.string_at(start, 8).hex(" ")
        return HostError(
            f"{who}, in the window {near}, is by an instruction that is no bus cycle (its code begins {code}). Registers are "
            "read and written one at a time, as `volatile` variables of 8, 16 or 32 bits: not by memcpy or memset, as structs, "
            f"vectors or floats; {self._when()}"
        )

    def _when(self) -> str:
        board = self._link.board
        return f"at {board.stage.time:.6f} s, after {board.cycles:,} bus cycles:\n{board.trace.text(12)}"


# --- what all firmware of this process has in common ---

_claims: dict[Mapped, list[tuple[int, int]]] = {}
"""Pages: begin, end."""
_space = np.zeros(1, records.SPACE)
_published: deque[np.ndarray] = deque(maxlen=64)
"""The last tables of SPANs: a handler in another thread may look at one before."""


def _publish() -> None:
    """From now on the handler knows these windows."""
    with _lock:
        kinds = zip(*(mapped.spans() for mapped in _claims), strict=True)
        rows = [row for kind in kinds for rows in kind for row in rows]
        if len(rows) >= records.SPANS:
            raise StageError(f"{len(rows)} windows and pieces of memory: there is room for {records.SPANS - 1}.")
        spans = np.zeros(records.SPANS, records.SPAN)
        for k, row in enumerate(rows):
            spans[k] = row
        _published.append(spans)
        _space["spans"] = spans.ctypes.data


def faults() -> int:
    """How often the system has called the handler for an access to a window: the handler goes on behind it as long as it can."""
    return int(_space["faults"][0])


_thunks: list[Any] = []


def _handle_faults() -> None:
    """The handler of faults is ours; the one of before is called for what is not."""
    with _lock:
        if not _thunks:
            _space["opcodes"], _space["signal"] = table.TABLE.ctypes.data, _address(_libc.signal)
            _space["request"] = _address(_request())
            _thunks.extend((_thunk(), trap.on_fault.pointer))
        ours, action = _thunks[0], crash.SignalAction()
        _libc.sigaction(int(SIGSEGV), None, ctypes.byref(action))
        if action.handler != ours:
            _space["previous"] = action.handler or 0
            action = crash.SignalAction(ours, flags=_WITH_INFO | _NESTED | _ON_STACK)
            _libc.sigaction(int(SIGSEGV), ctypes.byref(action), None)


def _request() -> Any:
    from stage.board import bus

    return bus.request.pointer


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0


def _thunk() -> int:
    """What the system calls, in machine code: it gives `on_fault` its two records, of which STEP is on the stack, and jumps on to
    the handler of before if that is asked for."""
    size = -(-records.STEP.itemsize // 16) * 16
    code = b"".join(
        (
            b"\x57\x56\x52",  # push rdi, rsi, rdx
            b"\x48\x81\xec" + struct.pack("<i", size),  # sub rsp, size
            b"\x49\x89\xe0\x4d\x89\x00",  # mov r8, rsp; mov [r8], r8
            b"\x48\xb9" + struct.pack("<Q", _space.ctypes.data),  # mov rcx, the SPACE
            b"\x48\xb8" + struct.pack("<Q", _address(trap.on_fault.pointer)),  # mov rax, on_fault
            b"\xff\xd0",  # call rax
            b"\x48\x81\xc4" + struct.pack("<i", size),  # add rsp, size
            b"\x5a\x5e\x5f",  # pop rdx, rsi, rdi
            b"\x85\xc0\x74\x01\xc3",  # return unless eax is 0
            b"\x48\xb8" + struct.pack("<Q", _space.ctypes.data + int(dict(records.SPACE.fields or {})["previous"][1])),
            b"\xff\x20",  # jmp [rax]
        )
    )
    try:
        return executable(code)
    except StageError as error:
        raise StageError(f"{error} Windows need that: {PROXIES}.") from None


# --- what is where in this process ---


def _in_use(begin: int, end: int) -> str:
    """What lies at these addresses, in words."""
    for mapped, pages in _claims.items():
        if any(b < end and begin < e for b, e in pages):
            return f"a window of {mapped._library.path.name}, which has not returned, is there"
    for line in os.fsdecode(Path("/proc/self/maps").read_bytes()).splitlines():
        place, *rest = line.split(maxsplit=5)
        low, high = (int(n, 16) for n in place.split("-"))
        if low < end and begin < high:
            return f"its pages are in use in this process, by {rest[4] if len(rest) > 4 else 'its memory'}"
    return "its pages cannot be had"


def memory_of(library: Library) -> list[tuple[int, int, int]]:
    """Code and data of a library, of those that were loaded with it, and its bus: begin, end, kind."""
    bus = ctypes.addressof(library.bus)
    found = [(bus, bus + ctypes.sizeof(library.bus), records.READ)]
    at = library.loaded
    while at:
        base = at.contents.base
        if base and ctypes.string_at(base, 4) == b"\x7fELF":
            header = ctypes.string_at(base, 64)
            first, size, n = *struct.unpack_from("<Q", header, 32), *struct.unpack_from("<HH", header, 54)
            rows = [struct.unpack_from("<IIQQQQQ", ctypes.string_at(base + first + k * size, size)) for k in range(n)]
            for kind in (_READ_ONLY, _LOAD):  # the first that fits is meant
                found += [
                    (base + start, base + start + length, records.READ if kind == _READ_ONLY else _access(flags))
                    for what, flags, _, start, _, _, length in rows
                    if what == kind
                ]
        at = at.contents.next
    return found


def _access(flags: int) -> int:
    """From the flags of a program header: 4 read, 2 write, 1 execute."""
    return (records.READ if flags & 4 else 0) | (records.WRITE if flags & 2 else 0) | (records.CODE if flags & 1 else 0)


def stack() -> tuple[int, int]:
    """Begin and end of the stack of this thread."""
    attributes, begin, size = (ctypes.c_uint64 * 8)(), ctypes.c_uint64(), ctypes.c_size_t()
    _libc.pthread_getattr_np(ctypes.c_void_p(_libc.pthread_self()), attributes)
    _libc.pthread_attr_getstack(attributes, ctypes.byref(begin), ctypes.byref(size))
    _libc.pthread_attr_destroy(attributes)
    return begin.value + MARGIN, begin.value + size.value
