"""Handlers of signals that firmware has set: nobody calls them after it was unloaded.

A timer of the system (setitimer, alarm) that goes on would else call code that is gone, after a firmware that has returned in time.
"""

from __future__ import annotations

import ctypes
import signal

from stage.board import crash

_NUMBERS = (
    sorted({int(n) for n in signal.valid_signals()} - {int(signal.SIGKILL), int(signal.SIGSTOP)}) if crash.HERE else []
)
_DEFAULT, _IGNORE = 0, 1
TIMERS = (
    {signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF, *range(signal.SIGRTMIN, signal.SIGRTMAX + 1)}
    if crash.HERE
    else set()
)
"""The signals of setitimer, of alarm, and those that timer_create can be given."""


def keep_timers_away() -> None:
    """No timer of the firmware interrupts this thread: a handler that makes a bus cycle in the middle of Python would break it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, TIMERS)


def let_timers_in() -> None:
    """They interrupt this thread: the firmware's."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, TIMERS)


class Handlers:
    """Of this process, as they are when it is made: before a library is loaded."""

    def __init__(self) -> None:
        self._before = {number: _get(number) for number in _NUMBERS}

    def remove_those_of(self, file: str) -> None:
        """Those that lie in this library are again what they were; a signal that nobody handled is ignored: it may still come."""
        libc, ignored = ctypes.CDLL(None), crash.SignalAction(_IGNORE)
        for number, before in self._before.items():
            handler = _get(number).handler or 0
            if handler > _IGNORE and crash.file_of(handler) == file:
                action = before if (before.handler or 0) != _DEFAULT else ignored
                libc.sigaction(number, ctypes.byref(action), None)


def _get(number: int) -> crash.SignalAction:
    action = crash.SignalAction()
    ctypes.CDLL(None).sigaction(number, None, ctypes.byref(action))
    return action
