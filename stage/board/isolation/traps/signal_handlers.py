"""Handle signals in the process of firmware: note crashes, find where a thread computes, remove handlers of unloaded code."""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import platform
import signal
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from stage.board.crash_report import MEMORY_SIGNALS, Crash, encode_crash_note, find_symbol
from stage.errors import StageError

CRASHES = (*MEMORY_SIGNALS, signal.SIGILL, signal.SIGFPE, signal.SIGABRT)
TIMER_SIGNALS = {signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF, *range(signal.SIGRTMIN, signal.SIGRTMAX + 1)}
"""The signals of setitimer, of alarm, and those that timer_create can be given."""
STACK_SIZE = 16 << 20  # bytes, of handlers: that of the firmware may be full
MAX_DEPTH = 100  # calls
POSITION_LIMIT_S = 0.3  # of real time; a thread may have blocked the signal
_CODE, _ADDRESS, _SENDER = 8, 16, 16  # in siginfo_t
_CONTEXT = {"x86_64": {"pc": 168, "sp": 160, "error": 192}, "aarch64": {"pc": 440, "sp": 432, "lr": 424}}
"""Offsets in ucontext_t: program counter, stack pointer, the register that has the return address; the processor's error code,
whose bit 1 says that it wrote."""
_NEAR_STACK = 1 << 16  # bytes
_DEFAULT, _IGNORE = 0, 1
WITH_INFO, NO_MASK, RESTART, ON_STACK = 4, 0x40000000, 0x10000000, 0x08000000  # flags of sigaction
_FORK_CRASH_NOTE = encode_crash_note(
    "a process that it had forked crashed (it has no bus: only the firmware itself has)"
)
_HANDLER = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
_permanent: list[Any] = []  # objects that live as long as the process
_position = (ctypes.c_uint64 * 2)()  # program counter, and the word on top of the stack
_position_handler = 0


class SignalAction(ctypes.Structure):
    """The struct sigaction of glibc and musl."""

    _fields_ = (
        ("handler", ctypes.c_void_p), ("mask", ctypes.c_ulong * 16), ("flags", ctypes.c_int), ("restorer", ctypes.c_void_p),
    )  # fmt: skip


class _Stack(ctypes.Structure):
    """The struct stack_t."""

    _fields_ = (("begin", ctypes.c_void_p), ("flags", ctypes.c_int), ("size", ctypes.c_size_t))


def get_action(number: int) -> SignalAction:
    """Return the present handling of a signal."""
    action = SignalAction()
    ctypes.CDLL(None).sigaction(int(number), None, ctypes.byref(action))
    return action


def set_action(number: int, action: SignalAction) -> None:
    """Set the handling of a signal."""
    ctypes.CDLL(None).sigaction(int(number), ctypes.byref(action), None)


def make_executable(code: bytes) -> int:
    """Store machine code in memory for the rest of the process, and return its address.

    Raises:
        StageError: The system does not allow programs to create code.
    """
    pages = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE)
    pages.write(code)
    address = ctypes.addressof(ctypes.c_char.from_buffer(pages))
    _permanent.append(pages)
    if ctypes.CDLL(None).mprotect(ctypes.c_void_p(address), mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_EXEC) != 0:
        raise StageError("this system lets no program make code.")
    return address


# --- crashes ---


def watch_crashes(note: Callable[[bytes], None]) -> None:
    """Report crashes of this process from now on. The signal then ends the process as it would have done.

    Args:
        note: Function that is called within the signal handler with a `Crash` as JSON.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "backtrace"):
        return
    calls, owner = (ctypes.c_void_p * MAX_DEPTH)(), os.getpid()
    libc.backtrace(calls, MAX_DEPTH)  # the first call loads a library

    def handle(number: int, info: int, context: int) -> None:
        """Report the crash that caused a signal, and restore the default handling of the signal."""
        libc.signal(number, None)
        if os.getpid() != owner:
            os.kill(owner, signal.SIGABRT)  # the run is to fail
            os._exit(1)
        try:
            crash = (
                _FORK_CRASH_NOTE
                if _is_from_a_fork(number, info)
                else json.dumps(_describe_crash(libc, calls, number, info, context)).encode()
            )
            note(crash)
        finally:
            os.kill(os.getpid(), number)

    handler = _HANDLER(handle)
    action = SignalAction(ctypes.cast(handler, ctypes.c_void_p), flags=WITH_INFO | ON_STACK)
    _permanent.extend((handler, action))
    for number in CRASHES:
        set_action(number, action)


def allocate_signal_stack() -> None:
    """Give signal handlers of this thread a stack of their own, for the rest of the process."""
    room = mmap.mmap(-1, STACK_SIZE)
    _permanent.append(room)
    begin = ctypes.addressof(ctypes.c_char.from_buffer(room))
    ctypes.CDLL(None).sigaltstack(ctypes.byref(_Stack(begin, 0, STACK_SIZE)), None)


def _describe_crash(libc: Any, calls: Any, number: int, info: int, context: int) -> Crash:
    """Read from the records of a signal what has happened."""

    def word(at: int) -> int:
        """Return the 64-bit word at an address."""
        return int(ctypes.c_uint64.from_address(at).value)

    places = _CONTEXT.get(platform.machine(), {})
    code = ctypes.c_int.from_address(info + _CODE).value
    address = word(info + _ADDRESS) if number in MEMORY_SIGNALS and code > 0 else -1
    pc = word(context + places["pc"]) if "pc" in places else None
    jumped = address >= 0 and pc == address
    if jumped:  # nobody can unwind from there: to read the code at the address is the next fault
        stack = [address, word(context + places["lr"]) if "lr" in places else word(word(context + places["sp"]))]
    else:
        stack = [calls[k] or 0 for k in range(libc.backtrace(calls, MAX_DEPTH))]
    if pc in stack:
        stack = stack[stack.index(pc) :]
    wrote = bool(word(context + places["error"]) & 2) if "error" in places else None
    near = address >= 0 and "sp" in places and abs(address - word(context + places["sp"])) < _NEAR_STACK
    frames = [find_symbol(a - (k > 0)) for k, a in enumerate(stack) if a]
    return Crash(number, address, wrote, near and not jumped, frames, jumped, code)


def _is_from_a_fork(number: int, info: int) -> bool:
    """Return whether another process has sent the signal, as `watch_crashes` has to know."""
    code, sender = ctypes.c_int.from_address(info + _CODE).value, ctypes.c_int.from_address(info + _SENDER).value
    return number == signal.SIGABRT and code == 0 and sender != os.getpid()


# --- where a thread computes ---


def find_position(thread: threading.Thread | None) -> tuple[int, int]:
    """Return a thread's program counter and the word on top of its stack; (0, 0) if they cannot be found.

    A signal makes the thread store them and continue. The handler consists of a few bytes of machine code, because the thread may
    be anywhere, even in malloc.
    """
    global _position_handler
    if platform.machine() != "x86_64" or thread is None or thread.ident is None or not thread.is_alive():
        return 0, 0
    number = int(signal.SIGRTMAX) - 5
    before = get_action(number)
    try:
        _position_handler = _position_handler or _make_position_handler()
    except StageError:
        return 0, 0
    _position[0] = 0
    set_action(number, SignalAction(_position_handler, flags=RESTART | ON_STACK))
    with suppress(OSError):  # the thread has ended without Python's knowledge
        signal.pthread_kill(thread.ident, number)
    until = time.monotonic() + POSITION_LIMIT_S
    while not _position[0] and time.monotonic() < until:
        time.sleep(0.002)
    if not _position[0]:  # the signal may still come
        return 0, 0
    set_action(number, before)
    return _position[0], _position[1]


def _make_position_handler() -> int:
    """Make the signal handler of `find_position` in machine code, and return its address."""
    pc, sp = (_CONTEXT["x86_64"][name] for name in ("pc", "sp"))
    return make_executable(
        b"\x48\x8b\x82" + struct.pack("<i", pc)  # mov rax, [rdx + pc]: of the third argument, a ucontext_t
        + b"\x48\x8b\x92" + struct.pack("<i", sp)  # mov rdx, [rdx + sp]
        + b"\x48\x8b\x12"  # mov rdx, [rdx]
        + b"\x48\xb9" + struct.pack("<Q", ctypes.addressof(_position))  # mov rcx, where it is noted
        + b"\x48\x89\x51\x08"  # mov [rcx + 8], rdx
        + b"\x48\x89\x01\xc3"  # mov [rcx], rax; ret
    )  # fmt: skip


# --- handlers that firmware sets ---


def block_timers() -> None:
    """Block timer signals in this thread: a handler of the firmware that makes a bus cycle would break Python."""
    signal.pthread_sigmask(signal.SIG_BLOCK, TIMER_SIGNALS)


def unblock_timers() -> None:
    """Allow timer signals in this thread, which runs the firmware."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, TIMER_SIGNALS)


class SignalHandlers:
    """Signal handlers of this process at the time when the object is created, before a library is loaded.

    A system timer (setitimer, alarm) that outlives the firmware would otherwise call code that is no longer loaded.
    """

    def __init__(self) -> None:
        numbers = {int(n) for n in signal.valid_signals()} - {int(signal.SIGKILL), int(signal.SIGSTOP)}
        self._before = {number: get_action(number) for number in sorted(numbers)}

    def remove_handlers(self, file: str) -> None:
        """Restore the signal handlers that a library has replaced.

        A signal without a former handler is ignored, because it may still come.
        """
        for number, before in self._before.items():
            handler = get_action(number).handler or 0
            if handler > _IGNORE and find_symbol(handler)[0] == file:
                set_action(number, before if (before.handler or 0) != _DEFAULT else SignalAction(_IGNORE))
