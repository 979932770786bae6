"""Where firmware has crashed: noted by the process that it crashes, told by its parent.

In the child `watch` has a signal handler write into shared memory what was touched and by which calls; then the signal ends the
process as it would have done. In the parent `told` makes a sentence of that, with files and lines where addr2line finds them.
"""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import platform
import shutil
import signal
import sys
from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from stage.processes import run_program

HERE = sys.platform == "linux" and sys.maxsize > 1 << 32
"""Where the handler knows what a signal brings."""
SIGNALS = (signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGFPE, signal.SIGABRT)
TOUCHES = (signal.SIGSEGV, signal.SIGBUS)
STACK = 16 << 20  # bytes, of the handler: that of the firmware may be full
DEEPEST = 100  # calls
SHOWN = 6  # of them in a message
ENTRY = "pulsestage_main"
CODE, ADDRESS = 8, 16  # in siginfo_t
ARITHMETIC = {
    1: "an integer was divided by 0 (or the smallest one by -1)",
    2: "an integer overflowed",
    3: "a floating-point number was divided by 0, and the firmware has turned traps on",
    4: "a floating-point result was too large, and the firmware has turned traps on",
    5: "a floating-point result was too small, and the firmware has turned traps on",
    6: "a floating-point result was not exact, and the firmware has turned traps on",
    7: "a floating-point operation was invalid (0 / 0, the root of a negative number), and the firmware has turned traps on",
}
"""What SIGFPE says by its code (FPE_INTDIV, ...); another code: somebody has sent the signal."""
PLACES = {"x86_64": {"pc": 168, "sp": 160, "error": 192}, "aarch64": {"pc": 440, "sp": 432, "lr": 424}}
"""In ucontext_t: program counter, stack pointer, the register that has the return address; the processor's error code, whose bit
1 says that it wrote."""
NULL = 1 << 16
BUS_SPACE = 1 << 32  # addresses of microcontrollers
RUST_ITSELF = "(/rustc/"  # where the files of its own library are


FORKED = b'"a process that it had forked crashed (it has no bus: only the firmware itself has)"'


class Crash(NamedTuple):
    """What the handler saw. frames: (library, symbol, offset in the library) of each call, the innermost first. jumped: to
    the address, from the last place in frames. code: si_code, what kind of the signal it was."""

    signal: int
    address: int
    wrote: bool | None
    stack: bool
    frames: list[tuple[str, str, int]]
    jumped: bool = False
    code: int = 0


# --- in the child ---


class SignalAction(ctypes.Structure):
    """struct sigaction of glibc and musl."""

    _fields_ = (
        ("handler", ctypes.c_void_p),
        ("mask", ctypes.c_ulong * 16),
        ("flags", ctypes.c_int),
        ("restorer", ctypes.c_void_p),
    )


class _Stack(ctypes.Structure):
    """stack_t."""

    _fields_ = (("begin", ctypes.c_void_p), ("flags", ctypes.c_int), ("size", ctypes.c_size_t))


class _Symbol(ctypes.Structure):
    """Dl_info."""

    _fields_ = (
        ("file", ctypes.c_char_p),
        ("base", ctypes.c_void_p),
        ("name", ctypes.c_char_p),
        ("begin", ctypes.c_void_p),
    )


_HANDLER = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
_WITH_INFO, _ON_STACK = 4, 0x08000000
_kept: list[Any] = []  # for as long as the process lives


def watch(note: Callable[[bytes], None]) -> None:
    """From now on a crash of this process is noted: `note` is given a Crash as JSON, in the middle of the signal."""
    libc = ctypes.CDLL(None)
    if not HERE or not hasattr(libc, "backtrace"):
        return
    calls, owner = (ctypes.c_void_p * DEEPEST)(), os.getpid()
    libc.backtrace(calls, DEEPEST)  # the first call loads a library

    def crashed(number: int, info: int, context: int) -> None:
        libc.signal(number, None)
        if os.getpid() != owner:
            os.kill(owner, signal.SIGABRT)  # the run is to fail
            os._exit(1)
        try:
            note(
                FORKED if _from_a_fork(number, info) else json.dumps(_seen(libc, calls, number, info, context)).encode()
            )
        finally:
            os.kill(os.getpid(), number)

    handler = _HANDLER(crashed)
    action = SignalAction(ctypes.cast(handler, ctypes.c_void_p), flags=_WITH_INFO | _ON_STACK)
    _kept.extend((handler, action))
    for number in SIGNALS:
        libc.sigaction(int(number), ctypes.byref(action), None)


class OwnStack:
    """For the thread that makes it, until it calls `close`: handlers of signals have a stack of their own."""

    def __init__(self) -> None:
        self._before = _Stack()
        self._room = mmap.mmap(-1, STACK)
        _kept.append(self._room)
        begin = ctypes.addressof(ctypes.c_char.from_buffer(self._room))
        ctypes.CDLL(None).sigaltstack(ctypes.byref(_Stack(begin, 0, STACK)), ctypes.byref(self._before))

    def close(self) -> None:
        """The thread's is again what it was before."""
        ctypes.CDLL(None).sigaltstack(ctypes.byref(self._before), None)
        _kept.remove(self._room)


def _seen(libc: Any, calls: Any, number: int, info: int, context: int) -> Crash:
    def word(at: int) -> int:
        return int(ctypes.c_uint64.from_address(at).value)

    places = PLACES.get(platform.machine(), {})
    address = word(info + ADDRESS) if number in TOUCHES and ctypes.c_int.from_address(info + CODE).value > 0 else -1
    pc = word(context + places["pc"]) if "pc" in places else None
    jumped = address >= 0 and pc == address
    if jumped:  # nobody can unwind from there: to read the code at the address is the next fault
        found = [address, word(context + places["lr"]) if "lr" in places else word(word(context + places["sp"]))]
    else:
        found = [calls[k] or 0 for k in range(libc.backtrace(calls, DEEPEST))]
    if pc in found:
        found = found[found.index(pc) :]
    wrote = bool(word(context + places["error"]) & 2) if "error" in places else None
    near = address >= 0 and "sp" in places and abs(address - word(context + places["sp"])) < NULL
    frames = [_frame(libc, a - (k > 0)) for k, a in enumerate(found) if a]
    code = ctypes.c_int.from_address(info + CODE).value
    return Crash(number, address, wrote, near and not jumped, frames, jumped, code)


def _from_a_fork(number: int, info: int) -> bool:
    """Whether another process has sent the signal, see `watch`."""
    sent, sender = ctypes.c_int.from_address(info + CODE).value, ctypes.c_int.from_address(info + 16).value
    return number == signal.SIGABRT and sent == 0 and sender != os.getpid()


def _frame(libc: Any, address: int) -> tuple[str, str, int]:
    symbol = _Symbol()
    if not libc.dladdr(ctypes.c_void_p(address), ctypes.byref(symbol)):
        return "", "", address
    return os.fsdecode(symbol.file or b""), os.fsdecode(symbol.name or b""), address - (symbol.base or 0)


def file_of(address: int) -> str:
    """The library that code of this process is in; "" if in none."""
    return _frame(ctypes.CDLL(None), address)[0]


def in_words(text: str) -> bytes:
    """What is noted where no signal tells it."""
    return json.dumps(text).encode()


# --- in the parent ---


def told(noted: bytes, *libraries: Path) -> str:
    """What happened and where, in words; "" if nothing was noted. libraries: the firmware, and devices in C."""
    if not noted:
        return ""
    try:
        found = json.loads(noted)
        if isinstance(found, str):
            return f": {found}"
        crash = Crash(*found)
    except (ValueError, TypeError, RecursionError):  # firmware has written into it
        return ""
    names = [symbol for _, symbol, _ in crash.frames]
    inner = crash.frames[: names.index(ENTRY) + 1] if ENTRY in names else crash.frames
    places = _places(inner, libraries)
    calls = [(place, len(list(same))) for place, same in groupby(places) if place and RUST_ITSELF not in place]
    where = [f"{place}{f', {n} times' if n > 1 else ''}" for place, n in calls[:SHOWN]]
    what = _what(crash, {*names, *places})
    said = [part for part in (what, f"in {', called from '.join(where)}" if where else "") if part]
    return f": {', '.join(said)}" if said else ""


def _what(crash: Crash, names: set[str]) -> str:
    """names: of the functions that were called."""
    if crash.stack:
        return "its stack is full (endless recursion?)"
    if crash.jumped:
        hint = ": a pointer to a function that was never set?" if crash.address < NULL else ""
        return f"it called address {crash.address:X}h, where no code is{hint}"
    if crash.signal in TOUCHES and crash.address >= 0:
        verb = {True: "it wrote to", False: "it read from", None: "an access to"}[crash.wrote]
        hint = ""
        if crash.address < NULL:
            hint = ", a null pointer?"
        elif crash.address < BUS_SPACE:
            hint = " (memory-mapped I/O? --map makes bus cycles of it: docs/memory_mapped.md)"
        return f"{verb} address {crash.address:X}h{hint}"
    if crash.signal == signal.SIGFPE:
        return ARITHMETIC.get(crash.code, "")
    if any("rust_panic" in name or "std::panicking" in name for name in names):
        return "a panic in Rust"
    if any(name.startswith(("__cxa_throw", "_ZSt9terminatev", "_ZN10__cxxabiv1")) for name in names):
        return "a C++ exception that nobody caught"
    return ""


def place(address: int, top: int, *libraries: Path) -> str:
    """Where code of this process is: `function (file:line)` of one of the libraries; else what is known of it, and who of them has
    called it, if the word on top of the stack says so."""
    libc = ctypes.CDLL(None)
    file, symbol, offset = frame = _frame(libc, address)
    if found := _places([frame], libraries)[0]:
        return found
    found = f"{symbol or f'offset {offset:X}h'} of {Path(file).name or 'unknown code'}"
    caller = _places([_frame(libc, top - 1)], libraries)[0]
    return f"{found}, called from {caller}" if caller else found


def _places(frames: list[tuple[str, str, int]], libraries: Sequence[Path]) -> list[str]:
    """Each call as `function (file:line)`; "" for one of a system's library."""
    own = {library.name: library for library in reversed(libraries)}
    found = {
        name: _by_addr2line(library, sorted({offset for file, _, offset in frames if Path(file).name == name}))
        for name, library in own.items()
    }
    names = [Path(file).name for file, _, _ in frames]
    return [
        (found[name].get(offset) or symbol or f"offset {offset:X}h") if name in own else ""
        for name, (_, symbol, offset) in zip(names, frames, strict=True)
    ]


def _by_addr2line(library: Path, offsets: list[int]) -> dict[int, str]:
    """Function, file and line of places in a library, as far as they are known."""
    tool = shutil.which("addr2line") or shutil.which("llvm-addr2line")
    if tool is None or not offsets:
        return {}
    command = [tool, "-f", "-C", "-e", str(library), *(f"{offset:#x}" for offset in offsets)]
    lines = run_program(command).stdout.splitlines()
    found = {}
    for offset, function, line in zip(offsets, lines[::2], lines[1::2], strict=False):
        line = line.split(" (")[0]
        if function not in ("", "??"):
            found[offset] = function + (f" ({line})" if line and not line.startswith("??") else "")
    return found
