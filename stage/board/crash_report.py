"""Explain in words where firmware has crashed or where it computes, with source files and lines if addr2line finds them."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from stage.support.subprocesses import run_program

IS_SUPPORTED = sys.platform == "linux" and sys.maxsize > 1 << 32
"""True on 64-bit Linux, where the firmware's process can report crashes and calls and can have windows."""
MEMORY_SIGNALS = (signal.SIGSEGV, signal.SIGBUS)
MAX_LISTED_CALLS = 6  # calls in a message
ENTRY = "pulsestage_main"
SIGFPE_CAUSES = {
    1: "an integer was divided by 0 (or the smallest one by -1)",
    2: "an integer overflowed",
    3: "a floating-point number was divided by 0, and the firmware has turned traps on",
    4: "a floating-point result was too large, and the firmware has turned traps on",
    5: "a floating-point result was too small, and the firmware has turned traps on",
    6: "a floating-point result was not exact, and the firmware has turned traps on",
    7: "a floating-point operation was invalid (0 / 0, the root of a negative number), and the firmware has turned traps on",
}
"""Cause of a SIGFPE by its code (FPE_INTDIV, ...). Any other code means that a process sent the signal."""
NULL = 1 << 16
BUS_SPACE = 1 << 32  # addresses of microcontrollers
RUST_ITSELF = "(/rustc/"  # where the files of its own library are


class Crash(NamedTuple):
    """Crash of a process that runs firmware, as the signal handler observed it.

    Attributes:
        signal: Number of the signal.
        address: Address that the firmware accessed, or -1.
        wrote: Whether the access was a write; None if unknown.
        stack: Whether the address is near the stack pointer.
        frames: Library, symbol and offset in the library of each call, innermost first.
        jumped: Whether the firmware called the address, from the last call in `frames`.
        code: si_code of the signal, which tells its cause.
    """

    signal: int
    address: int
    wrote: bool | None
    stack: bool
    frames: list[tuple[str, str, int]]
    jumped: bool = False
    code: int = 0


class _Symbol(ctypes.Structure):
    """Structure Dl_info of the C library, which dladdr fills."""

    _fields_ = (
        ("file", ctypes.c_char_p), ("base", ctypes.c_void_p), ("name", ctypes.c_char_p), ("begin", ctypes.c_void_p),
    )  # fmt: skip


def find_symbol(address: int) -> tuple[str, str, int]:
    """Return the library, the symbol and the offset in the library of an address in this process.

    Library and symbol are "" if none is known.
    """
    symbol = _Symbol()
    if not ctypes.CDLL(None).dladdr(ctypes.c_void_p(address), ctypes.byref(symbol)):
        return "", "", address
    return os.fsdecode(symbol.file or b""), os.fsdecode(symbol.name or b""), address - (symbol.base or 0)


def encode_crash_note(text: str) -> bytes:
    """Encode a text about the end of the process for `describe_crash`. It is used if no signal describes the end."""
    return json.dumps(text).encode()


def describe_crash(note: bytes, *libraries: Path) -> str:
    """Explain what has happened and where, from the note of a crash; return "" if there is no note.

    Args:
        note: JSON of a `Crash`, or the result of `encode_crash_note`.
        libraries: Paths of the firmware and of devices in C.
    """
    if not note:
        return ""
    try:
        content = json.loads(note)
        if isinstance(content, str):
            return f": {content}"
        crash = Crash(*content)
    except (ValueError, TypeError, RecursionError):  # firmware has written into it
        return ""
    names = [symbol for _, symbol, _ in crash.frames]
    inner = crash.frames[: names.index(ENTRY) + 1] if ENTRY in names else crash.frames
    places = _locate_frames(inner, libraries)
    calls = [(place, len(list(same))) for place, same in groupby(places) if place and RUST_ITSELF not in place]
    where = [f"{place}{f', {n} times' if n > 1 else ''}" for place, n in calls[:MAX_LISTED_CALLS]]
    cause = _describe_cause(crash, {*names, *places})
    parts = [part for part in (cause, f"in {', called from '.join(where)}" if where else "") if part]
    return f": {', '.join(parts)}" if parts else ""


def _describe_cause(crash: Crash, names: set[str]) -> str:
    """Explain the cause of a crash of the firmware's process.

    Args:
        crash: The crash.
        names: Names of the functions on the call stack.
    """
    if crash.stack:
        return "its stack is full (endless recursion?)"
    if crash.jumped:
        hint = ": a pointer to a function that was never set?" if crash.address < NULL else ""
        return f"it called address {crash.address:X}h, where no code is{hint}"
    if crash.signal in MEMORY_SIGNALS and crash.address >= 0:
        verb = {True: "it wrote to", False: "it read from", None: "an access to"}[crash.wrote]
        hint = ""
        if crash.address < NULL:
            hint = ", a null pointer?"
        elif crash.address < BUS_SPACE:
            hint = " (memory-mapped I/O? --map makes bus cycles of it: docs/memory_mapped.md)"
        return f"{verb} address {crash.address:X}h{hint}"
    if crash.signal == signal.SIGFPE:
        return SIGFPE_CAUSES.get(crash.code, "")
    if any("rust_panic" in name or "std::panicking" in name for name in names):
        return "a panic in Rust"
    if any(name.startswith(("__cxa_throw", "_ZSt9terminatev", "_ZN10__cxxabiv1")) for name in names):
        return "a C++ exception that nobody caught"
    return ""


def locate_code(address: int, stack_top: int, *libraries: Path) -> str:
    """Return the position of code in this process as `function (file:line)` of one of the libraries.

    For code outside of these libraries, return the symbol and, if the word on top of the stack is a return address, the
    function of a library that called it.

    Args:
        address: Address of the code.
        stack_top: Word on top of the stack.
        libraries: Paths of the firmware and of devices in C.
    """
    file, symbol, offset = frame = find_symbol(address)
    if place := _locate_frames([frame], libraries)[0]:
        return place
    place = f"{symbol or f'offset {offset:X}h'} of {Path(file).name or 'unknown code'}"
    caller = _locate_frames([find_symbol(stack_top - 1)], libraries)[0]
    return f"{place}, called from {caller}" if caller else place


def _locate_frames(frames: list[tuple[str, str, int]], libraries: Sequence[Path]) -> list[str]:
    """Return each call of a stack as `function (file:line)`, or "" for a call in another library."""
    offsets: dict[str, set[int]] = {library.name: set() for library in libraries}
    for file, _, offset in frames:
        offsets.get(Path(file).name, set()).add(offset)
    lines = {library.name: _run_addr2line(library, sorted(offsets[library.name])) for library in reversed(libraries)}
    return [
        (lines[name].get(offset) or symbol or f"offset {offset:X}h") if (name := Path(file).name) in lines else ""
        for file, symbol, offset in frames
    ]


def _run_addr2line(library: Path, offsets: list[int]) -> dict[int, str]:
    """Return function, file and line of offsets in a library, as far as addr2line finds them."""
    tool = shutil.which("addr2line") or shutil.which("llvm-addr2line")
    if tool is None or not offsets:
        return {}
    command = [tool, "-f", "-C", "-e", str(library), *(f"{offset:#x}" for offset in offsets)]
    lines = run_program(command).stdout.splitlines()
    places = {}
    for offset, function, line in zip(offsets, lines[::2], lines[1::2], strict=False):
        line = line.split(" (")[0]
        if function not in ("", "??"):
            places[offset] = function + (f" ({line})" if line and not line.startswith("??") else "")
    return places
