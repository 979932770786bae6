"""Report calls by which firmware sleeps in real time, and wait for threads that it starts, through the call slots of loaded
libraries.

A library calls functions of others through slots that the loader fills in. `observe_calls` sets the slots of some calls to
functions of this module, which report the call and then make it. The libraries may be built in any way. The slots of all libraries
that were
loaded together are read from memory at each load, so a reader of ELF files (pyelftools) would not help. System calls that bypass
the C library are not noticed.
"""

from __future__ import annotations

import ctypes
import mmap
import os
from collections.abc import Callable, Iterator, Mapping
from threading import get_ident
from typing import Any, NamedTuple

import numpy as np

from stage.native import get_function_address

_SLEEPS: dict[str, Callable[..., str]] = {
    "sleep": lambda seconds, *_: f"sleep({seconds & 0xFFFFFFFF})",
    "usleep": lambda us, *_: f"usleep({us & 0xFFFFFFFF})",
    **{name: lambda *_, name=name: f"{name}()" for name in ("nanosleep", "clock_nanosleep", "thrd_sleep")},
    "select": lambda files, *_: "" if files & 0xFFFFFFFF else "select(0)",
    "poll": lambda _, files, *__: "" if files else "poll(0, 0)",
}
"""Calls in words, by their arguments; "" for one that waits for something else than time."""
_THREAD_CREATORS = frozenset({"pthread_create", "thrd_create"})
_CALL = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * 5)
_RELOCATION = np.dtype([("offset", "u8"), ("info", "u8"), ("addend", "i8")])
_SYMBOL_SIZE, _SECTION_OFFSET = 24, 6
_CALLS_SIZE, _NAMES, _SYMBOLS, _RELOCATIONS, _RELOCATIONS_SIZE, _CALLS = 2, 5, 6, 7, 8, 23
"""Entries of a dynamic section; 0 ends it."""


class LoadedLibrary(ctypes.Structure):
    """The struct link_map: a library in memory."""


LoadedLibrary._fields_ = [
    ("base", ctypes.c_uint64), ("name", ctypes.c_char_p), ("dynamic", ctypes.c_uint64), ("next", ctypes.POINTER(LoadedLibrary)),
]  # fmt: skip


class _Observer(NamedTuple):
    """Functions that receive reports, and the process and thread of the firmware.

    A process that the firmware forks is not observed.
    """

    thread: tuple[int, int]
    on_sleep: Callable[[str], None]
    on_thread: Callable[[], None]


_observer: _Observer | None = None
_functions: dict[str, Any] = {}  # never freed: libraries that are never unloaded have their addresses


def set_observer(on_sleep: Callable[[str], None] | None, on_thread: Callable[[], None] = lambda: None) -> None:
    """Set the functions to which observed calls of this thread are reported.

    Args:
        on_sleep: Function that is called before the thread sleeps, with the call in words; None: report nothing.
        on_thread: Function that is called after the thread has started another one.
    """
    global _observer
    _observer = None if on_sleep is None else _Observer((os.getpid(), get_ident()), on_sleep, on_thread)


def list_loaded_libraries(handle: int) -> Iterator[LoadedLibrary]:
    """Yield the library with a handle, which was just loaded, and those that were loaded with it."""
    library = ctypes.cast(handle, ctypes.POINTER(LoadedLibrary))
    while library:
        yield library.contents
        library = library.contents.next


def observe_calls(handle: int) -> None:
    """Report calls that sleep or start a thread, made by the library with this handle and by the libraries loaded with it."""
    for name in _THREAD_CREATORS | _SLEEPS.keys():
        if name not in _functions:
            _functions[name] = _CALL(_make_reporter(name))
    for library in list_loaded_libraries(handle):
        _redirect(library, _functions)


def redirect_calls(handle: int, functions: Mapping[str, Any]) -> None:
    """Let the library with this handle call other functions (of ctypes), which must exist as long as the library."""
    _redirect(next(list_loaded_libraries(handle)), functions)


def _make_reporter(name: str) -> Callable[..., int]:
    """Make a function that reports a call to the observer and then calls the system's function of this name."""

    def call_and_report(*arguments: int) -> int:
        """Report this call of a system function to the observer, and make it."""
        observer = _observer if _observer is not None and _observer.thread == (os.getpid(), get_ident()) else None
        if observer is not None and name in _SLEEPS and (words := _SLEEPS[name](*arguments)):
            observer.on_sleep(words)
        result = int(getattr(ctypes.CDLL(None), name)(*map(ctypes.c_int64, arguments)))
        if observer is not None and name in _THREAD_CREATORS:
            observer.on_thread()
        return result

    return call_and_report


def _redirect(library: LoadedLibrary, functions: Mapping[str, Any]) -> None:
    """Set the slots by which a library calls these functions, unless the library itself defines functions of these names."""
    base, tags, at = library.base, {}, library.dynamic
    while tag := ctypes.c_int64.from_address(at).value:
        tags[tag] = ctypes.c_uint64.from_address(at + 8).value
        at += 16
    names, symbols = (_make_absolute(tags.get(tag, 0), base) for tag in (_NAMES, _SYMBOLS))
    for table, size in ((_CALLS, _CALLS_SIZE), (_RELOCATIONS, _RELOCATIONS_SIZE)):
        if not tags.get(size):
            continue
        raw: Any = (ctypes.c_char * tags[size]).from_address(_make_absolute(tags[table], base))
        relocations = np.frombuffer(raw, _RELOCATION)
        numbers = relocations["info"] >> 32
        for number in np.unique(numbers[numbers > 0]).tolist():
            symbol = symbols + _SYMBOL_SIZE * number
            name = ctypes.string_at(names + ctypes.c_uint32.from_address(symbol).value).decode(errors="replace")
            if name in functions and ctypes.c_uint16.from_address(symbol + _SECTION_OFFSET).value == 0:
                for offset in relocations["offset"][numbers == number].tolist():
                    _set_slot(base + offset, get_function_address(functions[name]))


def _make_absolute(address: int, base: int) -> int:
    """Return an absolute address. Some loaders relocate the addresses of a dynamic section, others leave them relative."""
    return address if address >= base else base + address


def _set_slot(slot: int, address: int) -> None:
    """Write an address into a slot of a library's table of imported functions, whose page may be read-only."""
    page = slot // mmap.PAGESIZE * mmap.PAGESIZE
    if ctypes.CDLL(None).mprotect(ctypes.c_void_p(page), mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_WRITE) == 0:
        ctypes.c_uint64.from_address(slot).value = address
