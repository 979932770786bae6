"""Firmware that calls exit, abort and the like: these calls become an error instead of the end of the process.

In a process of its own such a call ends that process only, and is an error here. In this process it would end the tests that
follow, or the recording, and exit(0) would even look like success. So the slots through which a loaded library calls these
functions are set to our functions: those of the library itself, and of the libraries that were loaded with it. The library may be
built in any way. Not caught are a system call without libc, a call by a library that was loaded before, and a call during loading.

By the same slots the firmware's runner is told, in either process, of calls that sleep in real time or begin a thread.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
from collections.abc import Callable, Container, Iterator, Mapping
from threading import get_ident
from typing import Any

import numpy as np

HERE = sys.platform == "linux" and sys.maxsize > 1 << 32  # 64-bit ELF; elsewhere only isolated=True helps

Runner = tuple[int, int]
"""The process and the thread that firmware runs in: a process that it forks has its thread's number, and is none of it."""

leavers: dict[Runner, Callable[[str], None]] = {}
"""By the runner of the firmware: what is called there in place of a call that would end the process; it does not return."""

_CALL = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
_RELOCATION = np.dtype([("offset", "u8"), ("info", "u8"), ("addend", "i8")])
_SYMBOL_SIZE, _SECTION = 24, 6
_CALLS_SIZE, _NAMES, _SYMBOLS, _RELOCATIONS, _RELOCATIONS_SIZE, _CALLS = 2, 5, 6, 7, 8, 23
"""Entries of a dynamic section; 0 ends it."""


class Loaded(ctypes.Structure):
    """struct link_map: a library in memory."""


Loaded._fields_ = [
    ("base", ctypes.c_uint64), ("name", ctypes.c_char_p), ("dynamic", ctypes.c_uint64), ("next", ctypes.POINTER(Loaded)),
]  # fmt: skip


def _with_status(name: str) -> Callable[..., str]:
    return lambda status, *_: f"{name}({ctypes.c_int(status).value})"


_NAMED: dict[str, Callable[..., str]] = {
    **{name: _with_status(name) for name in ("exit", "_exit", "_Exit", "quick_exit", "err", "errx", "thrd_exit")},
    "abort": lambda *_: "abort()",
    "pthread_exit": lambda *_: "pthread_exit()",
    "__assert_fail": lambda what, file, line, _: f"assert({_text(what)}) in {_text(file)}, line {line & 0xFFFFFFFF}",
}
"""What the call is in words, by its arguments."""


sleepers: dict[Runner, Callable[[str], None]] = {}
"""By the runner of the firmware: what is called there with the call by which it is about to sleep in real time."""

_SLEEP = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * 5)
_SLEEPS: dict[str, Callable[..., str]] = {
    "sleep": lambda seconds, *_: f"sleep({seconds & 0xFFFFFFFF})",
    "usleep": lambda us, *_: f"usleep({us & 0xFFFFFFFF})",
    **{name: lambda *_, name=name: f"{name}()" for name in ("nanosleep", "clock_nanosleep", "thrd_sleep")},
    "select": lambda files, *_: "" if files & 0xFFFFFFFF else "select(0)",
    "poll": lambda _, files, *__: "" if files else "poll(0, 0)",
}
"""What the call is in words, by its arguments; "" where it waits for something else than time."""

creators: dict[Runner, Callable[[], None]] = {}
"""By the runner of the firmware: what is called there after it has begun another thread."""

_CREATES = frozenset({"pthread_create", "thrd_create"})

ALL = frozenset(_NAMED)
OF_THREADS = frozenset({"pthread_exit", "thrd_exit"})
"""What ends the thread of the caller and not its process."""


def identify_runner() -> Runner:
    """Return by what `leavers`, `sleepers` and `creators` know the calling thread."""
    return os.getpid(), get_ident()


def interpose(handle: int, taken: frozenset[str] = ALL) -> None:
    """Take these calls of the library of that handle, just loaded, and of those that came with it; and calls that sleep."""
    if HERE:
        library = ctypes.cast(handle, ctypes.POINTER(Loaded))
        while library:
            for slot, name in _slots(library.contents, taken | _REPORTED):
                _set(slot, _address(name))
            library = library.contents.next


def replace_calls(handle: int, functions: Mapping[str, int]) -> None:
    """The calls of these functions by the library of that handle go to the addresses given; they have to live as long as it."""
    if HERE:
        for slot, name in _slots(ctypes.cast(handle, ctypes.POINTER(Loaded)).contents, functions):
            _set(slot, functions[name])


def _taken(name: str) -> Any:
    def call(*given: int) -> None:
        process, thread = identify_runner()
        by_thread = {runner[1]: leaver for runner, leaver in list(leavers.items()) if runner[0] == process}
        leave = by_thread.get(thread) or next(
            reversed(by_thread.values()), None
        )  # else it is a thread of the firmware's own
        if leave is not None:
            leave(_NAMED[name](*given))
        else:
            ctypes.CDLL(None)[name](*given)

    return _CALL(call)


_REPORTED = _CREATES | _SLEEPS.keys()


def _report_call(name: str) -> Any:
    """Make a function that calls the one of this name of the system; a sleeper is told before, a creator afterwards."""

    def call(*given: int) -> int:
        runner = identify_runner()
        report = sleepers.get(runner)
        if report is not None and name in _SLEEPS and (words := _SLEEPS[name](*given)):
            report(words)
        answer = int(getattr(ctypes.CDLL(None), name)(*map(ctypes.c_int64, given)))
        if name in _CREATES and (created := creators.get(runner)):
            created()
        return answer

    return _SLEEP(call)


_OURS: dict[str, Any] = {}


def _address(name: str) -> int:
    if name not in _OURS:
        _OURS[name] = (
            _report_call(name) if name in _REPORTED else _taken(name)
        )  # for ever: libraries that are never unloaded have its address
    return ctypes.cast(_OURS[name], ctypes.c_void_p).value or 0


def _slots(library: Loaded, wanted: Container[str]) -> Iterator[tuple[int, str]]:
    """Where the addresses of those wanted lie that the library calls."""
    base, tags, at = library.base, {}, library.dynamic
    while tag := ctypes.c_int64.from_address(at).value:
        tags[tag] = ctypes.c_uint64.from_address(at + 8).value
        at += 16
    names, symbols = (_absolute(tags.get(tag, 0), base) for tag in (_NAMES, _SYMBOLS))
    for table, size in ((_CALLS, _CALLS_SIZE), (_RELOCATIONS, _RELOCATIONS_SIZE)):
        if not tags.get(size):
            continue
        raw: Any = (ctypes.c_char * tags[size]).from_address(_absolute(tags[table], base))
        found = np.frombuffer(raw, _RELOCATION)
        numbers = found["info"] >> 32
        for number in np.unique(numbers[numbers > 0]).tolist():
            symbol = symbols + _SYMBOL_SIZE * number
            name = ctypes.string_at(names + ctypes.c_uint32.from_address(symbol).value).decode(errors="replace")
            is_defined_here = ctypes.c_uint16.from_address(symbol + _SECTION).value != 0
            if name in wanted and not is_defined_here:
                for offset in found["offset"][numbers == number].tolist():
                    yield base + offset, name


def _absolute(address: int, base: int) -> int:
    """Some loaders turn the addresses of a dynamic section into those in memory, others leave them."""
    return address if address >= base else base + address


def _set(slot: int, address: int) -> None:
    page = slot // mmap.PAGESIZE * mmap.PAGESIZE
    if ctypes.CDLL(None).mprotect(ctypes.c_void_p(page), mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_WRITE) == 0:
        ctypes.c_uint64.from_address(slot).value = address


def _text(address: int) -> str:
    return ctypes.string_at(address).decode(errors="replace")
