"""Where a thread of this process computes: a signal has it note its program counter, and it goes on.

The handler is a few bytes of machine code, as the thread may be anywhere, in malloc, too.
"""

from __future__ import annotations

import ctypes
import mmap
import platform
import signal
import struct
import threading
import time
from contextlib import suppress
from typing import Any

from stage.board import crash
from stage.errors import StageError

HERE = crash.HERE and platform.machine() == "x86_64"
PATIENCE = 0.3  # s; a thread may have blocked the signal
_RESTART, _ON_STACK = 0x10000000, 0x08000000
_pages: list[Any] = []  # for as long as the process lives
_noted = (ctypes.c_uint64 * 2)()


def executable(code: bytes) -> int:
    """Where this machine code lies from now on. Raises StageError where no program may make code."""
    pages = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE)
    pages.write(code)
    at = ctypes.addressof(ctypes.c_char.from_buffer(pages))
    _pages.append(pages)
    if ctypes.CDLL(None).mprotect(ctypes.c_void_p(at), mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_EXEC) != 0:
        raise StageError("this system lets no program make code.")
    return at


def of(thread: threading.Thread | None) -> tuple[int, int]:
    """Program counter of a thread, and the word on top of its stack; (0, 0) where that cannot be had."""
    if not HERE or thread is None or thread.ident is None or not thread.is_alive():
        return 0, 0
    libc, number, before = ctypes.CDLL(None), int(signal.SIGRTMAX) - 5, crash.SignalAction()
    try:
        action = crash.SignalAction(_handler(), flags=_RESTART | _ON_STACK)
    except StageError:
        return 0, 0
    _noted[0] = 0
    libc.sigaction(number, ctypes.byref(action), ctypes.byref(before))
    try:
        with suppress(OSError):  # the thread has ended without Python's knowledge
            signal.pthread_kill(thread.ident, number)
        until = time.monotonic() + PATIENCE
        while not _noted[0] and time.monotonic() < until:
            time.sleep(0.002)
    finally:
        if _noted[0]:  # else the signal may still come
            libc.sigaction(number, ctypes.byref(before), None)
    return (_noted[0], _noted[1]) if _noted[0] else (0, 0)


def _handler() -> int:
    if not _thunks:
        pc, sp = (crash.PLACES["x86_64"][name] for name in ("pc", "sp"))
        _thunks.append(
            executable(
                b"\x48\x8b\x82" + struct.pack("<i", pc)  # mov rax, [rdx + pc]: of the third argument, a ucontext_t
                + b"\x48\x8b\x92" + struct.pack("<i", sp)  # mov rdx, [rdx + sp]
                + b"\x48\x8b\x12"  # mov rdx, [rdx]
                + b"\x48\xb9" + struct.pack("<Q", ctypes.addressof(_noted))  # mov rcx, where it is noted
                + b"\x48\x89\x51\x08"  # mov [rcx + 8], rdx
                + b"\x48\x89\x01\xc3"  # mov [rcx], rax; ret
            )
        )  # fmt: skip
    return _thunks[0]


_thunks: list[int] = []
