"""Windows in the memory of firmware: protected pages, and the handler of the faults that accesses to them raise.

The handler (x86_execution.py) turns the access into bus cycles and continues after it. Any other fault goes to the previous
handler, which reports crashes.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import struct
from pathlib import Path
from signal import SIGSEGV
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.board import crash_report
from stage.board.bus import host_record, host_requests
from stage.board.errors import HostError
from stage.board.isolation.traps import x86_execution
from stage.board.isolation.traps.signal_handlers import (
    NO_MASK,
    ON_STACK,
    WITH_INFO,
    SignalAction,
    get_action,
    make_executable,
    set_action,
)
from stage.board.isolation.traps.sleep_calls import list_loaded_libraries
from stage.board.isolation.traps.x86_instructions import TABLE
from stage.board.memory_mapped_ports import (
    PROXY_HINT,
    MemoryWindow,
    explain_missing_windows,
    is_supported,
    parse_windows,
)
from stage.errors import ArgumentError, StageError
from stage.native import array_at, get_function_address

if TYPE_CHECKING:
    from stage.board.firmware_library import Library
    from stage.board.host_record_link import Link

MIN_ADDRESS = 1 << 16  # below the system lets nobody map
FREE_ADDRESS = 0x5000_0000  # from here on lie windows without an address of their own
SPACING, MAX_PLACES = 1 << 20, 1024
STACK_MARGIN = 1 << 16  # bytes at the end of a stack, where the guard may be
_NO_ACCESS = 0
_FLAGS = 2 | 0x20 | 0x4000 | 0x100000  # of mmap: private, anonymous, no reserve, at this address or not at all
_ELF, _LOAD, _READ_ONLY = b"\x7fELF", 1, 0x6474E552  # kinds of a program header
_libc: Any = ctypes.CDLL(None)
_libc.mmap.restype = _libc.pthread_self.restype = ctypes.c_void_p
_handler_data = np.zeros(1, x86_execution.HANDLER_DATA)
_tables: list[np.ndarray] = []  # the handler in another thread may look at one before
_thunks: list[int] = []


class MemoryWindows:
    """The windows of a firmware library in this process."""

    def __init__(self, library: Library, link: Link):
        self._library, self._link = library, link
        self._windows: list[MemoryWindow] = []
        self._pages: list[tuple[int, int]] = []
        self._memory = _list_memory(library) if is_supported() else []

    @property
    def faults(self) -> int:
        """Number of faults of this process that were accesses to windows. One fault can cover several accesses in a row."""
        return int(_handler_data["faults"][0])

    def map_anywhere(self, port: int, length: int) -> int:
        """Claim a window at an address that the function chooses, and return the address.

        Raises:
            HostError, StageError: There is no such window, or no room for it.
        """
        request = f"ps_window({port:#x}, {length:#x})"
        if not is_supported():
            raise HostError(f"{request}: {explain_missing_windows(isolated=True)}")
        try:
            size = parse_windows((0, port, length))[0].end
        except ArgumentError as error:
            raise HostError(f"{request}: {error}") from None
        begin = max([FREE_ADDRESS, *(-(-end // SPACING) * SPACING for _, end in self._pages)])
        for address in range(begin, begin + MAX_PLACES * SPACING, SPACING):
            try:
                self.map_window(MemoryWindow(address, port, size))
            except ArgumentError:
                continue
            except StageError as error:
                raise HostError(
                    f"{request}: {error} Ask once for each window, and keep the pointer; {self._format_moment()}"
                ) from None
            return address
        raise HostError(f"{request}: there is no room for a window of this size.")

    def map_window(self, window: MemoryWindow) -> None:
        """Turn accesses to a window into bus cycles.

        Raises:
            ArgumentError: The memory at the window's address is in use.
            StageError: There are too many windows, or the system allows none.
        """
        if not is_supported():
            raise StageError(explain_missing_windows(isolated=True))
        if window.address < MIN_ADDRESS:
            raise ArgumentError(
                f"window {window}: the system lets nobody use addresses below {MIN_ADDRESS:X}h, where null pointers lead; "
                f"{PROXY_HINT}."
            )
        begin, end = window.address & -mmap.PAGESIZE, -(-window.end // mmap.PAGESIZE) * mmap.PAGESIZE
        for first, last in self._pages:
            begin = last if first <= begin < last else begin
        for first, last in self._pages:
            end = first if first < end <= last else end
        if begin < end:
            size = ctypes.c_size_t(end - begin)
            at = _libc.mmap(ctypes.c_void_p(begin), size, _NO_ACCESS, _FLAGS, -1, ctypes.c_long(0))
            if at != begin:
                if at != ctypes.c_void_p(-1).value:
                    _libc.munmap(ctypes.c_void_p(at), size)
                raise ArgumentError(
                    f"window {window}: {_describe_address_range(begin, end)}. Choose another address; or {PROXY_HINT}."
                )
            self._pages.append((begin, end))
        self._windows.append(window)
        self._publish()
        _install_handler()

    def close(self) -> None:
        """Release the memory windows: accesses to their addresses are no bus cycles any more."""
        for begin, end in self._pages:
            _libc.munmap(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin))
        if self._pages:
            self._windows, self._pages = [], []
            self._publish()

    def allow_stack(self) -> None:
        """Allow the fault handler to access the stack of this thread."""
        if is_supported():
            self._memory.append((*_find_stack(), x86_execution.READABLE | x86_execution.WRITABLE | x86_execution.STACK))

    def _publish(self) -> None:
        """Inform the fault handler of the memory windows, their pages and the memory that it may access."""
        at = self._link.pointer
        rows = [(w.address, w.end, x86_execution.WINDOW, w.port, at) for w in self._windows]
        rows += [(begin, end, x86_execution.PAGE, 0, at) for begin, end in self._pages]
        rows += [(*memory, 0, at) for memory in self._memory]
        if len(rows) >= x86_execution.SPANS:
            raise StageError(f"{len(rows)} windows and pieces of memory: there is room for {x86_execution.SPANS - 1}.")
        spans = np.zeros(x86_execution.SPANS, x86_execution.SPAN)
        spans[: len(rows)] = rows
        _tables.append(spans)
        _handler_data["spans"] = spans.ctypes.data

    def explain_refusal(self, what: int, instruction_address: int, address: int) -> HostError:
        """Return the error for an instruction that accesses a window but is no bus cycle.

        Args:
            what: NO_CYCLE or BEYOND_WINDOW.
            instruction_address: Address of the INSTRUCTION record.
            address: Address that was accessed.
        """
        state: Any = array_at(instruction_address, 1, x86_execution.INSTRUCTION)[0]
        start, top = int(state.start), ctypes.c_uint64.from_address(int(state.stack)).value
        place = crash_report.locate_code(start, top, self._library.path)
        access = f"{self._library.path.name}: an access to address {address:X}h in {place}"
        near = next((w for w in self._windows if w.address <= address < w.end), None)
        if what == host_record.BEYOND_WINDOW:
            window = near or min(self._windows, key=lambda w: min(abs(address - w.address), abs(address - w.end)))
            verb = "goes on" if near else "is"
            return HostError(
                f"{access} {verb} beyond the window {window}, which ends at {window.end - 1:X}h. Give it more ports, or another "
                f"window there (--map, map=); {self._format_moment()}"
            )
        code = ctypes.string_at(start, 8).hex(" ")
        return HostError(
            f"{access}, in the window {near}, is by an instruction that is no bus cycle (its code begins {code}). Registers are "
            "read and written one at a time, as `volatile` variables of 8, 16 or 32 bits: not by memcpy or memset, as structs, "
            f"vectors or floats; {self._format_moment()}"
        )

    def _format_moment(self) -> str:
        """Return the simulated time, the number of bus cycles and the last lines of the bus trace, in words."""
        board = self._link.board
        return f"at {board.stage.time:.6f} s, after {board.cycles:,} bus cycles. {board.trace.format_ending(12)}"


def _install_handler() -> None:
    """Install the handler of faults. Faults that are no accesses to windows go to the previous handler."""
    if not _thunks:
        _handler_data["opcodes"], _handler_data["signal"] = TABLE.ctypes.data, get_function_address(_libc.signal)
        _handler_data["request"] = get_function_address(host_requests.request.pointer)
        _thunks.append(_make_thunk())
    action = get_action(SIGSEGV)
    if action.handler != _thunks[0]:
        _handler_data["previous"] = action.handler or 0
        set_action(SIGSEGV, SignalAction(_thunks[0], flags=WITH_INFO | NO_MASK | ON_STACK))


def _make_thunk() -> int:
    """Make the entry of the fault handler in machine code, and return its address.

    It calls `handle_fault` with an INSTRUCTION record on the stack, and jumps to the previous handler if that is requested.
    """
    size = struct.pack("<i", -(-x86_execution.INSTRUCTION.itemsize // 16) * 16)
    previous = _handler_data.ctypes.data + int(dict(x86_execution.HANDLER_DATA.fields or {})["previous"][1])
    code = (
        b"\x57\x56\x52"  # push rdi, rsi, rdx
        + b"\x48\x81\xec" + size  # sub rsp, size
        + b"\x49\x89\xe0\x4d\x89\x00"  # mov r8, rsp; mov [r8], r8
        + b"\x48\xb9" + struct.pack("<Q", _handler_data.ctypes.data)  # mov rcx, the SPACE record
        + b"\x48\xb8" + struct.pack("<Q", get_function_address(x86_execution.handle_fault.pointer))  # mov rax, handle_fault
        + b"\xff\xd0"  # call rax
        + b"\x48\x81\xc4" + size  # add rsp, size
        + b"\x5a\x5e\x5f"  # pop rdx, rsi, rdi
        + b"\x85\xc0\x74\x01\xc3"  # return unless eax is 0
        + b"\x48\xb8" + struct.pack("<Q", previous) + b"\xff\x20"  # mov rax, previous; jmp [rax]
    )  # fmt: skip
    try:
        return make_executable(code)
    except StageError as error:
        raise StageError(f"{error} Windows need that: {PROXY_HINT}.") from None


def _describe_address_range(begin: int, end: int) -> str:
    """Explain why the addresses from `begin` to `end` cannot become a window: what uses them, if anything does."""
    for line in os.fsdecode(Path("/proc/self/maps").read_bytes()).splitlines():
        place, *rest = line.split(maxsplit=5)
        low, high = (int(n, 16) for n in place.split("-"))
        if low < end and begin < high:
            return f"its pages are in use in this process, by {rest[4] if len(rest) > 4 else 'its memory'}"
    return "its pages cannot be had"


def _list_memory(library: Library) -> list[tuple[int, int, int]]:
    """Return the code and data of a library, of those loaded with it, and its bus struct: begin, end, kind."""
    bus_struct = ctypes.addressof(library.bus)
    memory = [(bus_struct, bus_struct + ctypes.sizeof(library.bus), x86_execution.READABLE)]
    for base in (loaded.base for loaded in list_loaded_libraries(library.handle)):
        if not base or ctypes.string_at(base, 4) != _ELF:
            continue
        header = ctypes.string_at(base, 64)
        first, size, n = *struct.unpack_from("<Q", header, 32), *struct.unpack_from("<HH", header, 54)
        rows = [struct.unpack_from("<IIQQQQQ", ctypes.string_at(base + first + k * size, size)) for k in range(n)]
        for kind in (_READ_ONLY, _LOAD):  # the first that fits is meant
            memory += [
                (
                    base + start,
                    base + start + length,
                    x86_execution.READABLE if kind == _READ_ONLY else _convert_flags(flags),
                )
                for what, flags, _, start, _, _, length in rows
                if what == kind
            ]
    return memory


def _convert_flags(flags: int) -> int:
    """Convert the flags of an ELF program header (4 read, 2 write, 1 execute) to those of x86_execution."""
    names = ((4, x86_execution.READABLE), (2, x86_execution.WRITABLE), (1, x86_execution.CODE))
    return sum(kind for flag, kind in names if flags & flag)


def _find_stack() -> tuple[int, int]:
    """Return the begin and the end of the stack of this thread."""
    attributes, begin, size = (ctypes.c_uint64 * 8)(), ctypes.c_uint64(), ctypes.c_size_t()
    _libc.pthread_getattr_np(ctypes.c_void_p(_libc.pthread_self()), attributes)
    _libc.pthread_attr_getstack(attributes, ctypes.byref(begin), ctypes.byref(size))
    _libc.pthread_attr_destroy(attributes)
    return begin.value + STACK_MARGIN, begin.value + size.value
