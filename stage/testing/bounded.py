"""A promise in a process of its own: a core that never answers, or writes where it may not, ends that process, not the tests."""

from __future__ import annotations

import os
import pickle
import select
import signal
import sys
import time
from collections.abc import Callable

FORKS = hasattr(os, "fork")
NOT_ENDED = "it has not ended after"


def bounded(work: Callable[[], str], seconds: float | None) -> str:
    """What `work` says, computed in a copy of this process.

    Args:
        work: says in words what is broken, "" where nothing is.
        seconds: real time that it may take. None: here, without a limit; so it is where a system has no fork.
    Returns its words; or that it has not ended, or what ended its process.
    """
    if seconds is None or not FORKS:
        return work()
    reader, writer = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if not child:
        os.close(reader)
        _answer(work, writer)
    os.close(writer)
    try:
        answer = _until_closed(reader, time.monotonic() + seconds)
        if answer is None:
            os.kill(child, signal.SIGKILL)
    except BaseException:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise
    finally:
        os.close(reader)
    _, status = os.waitpid(child, 0)
    if answer is None:
        return (
            f"{NOT_ENDED} {seconds:g} s: does the core loop without end? (limit=None tries it in this process: "
            "there, with NUMBA_DISABLE_JIT=1, Ctrl-C shows the line)"
        )
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        return f"its process was ended by {name}: does the core write or read beyond an array?"
    if not answer:
        return f"its process ended with status {os.waitstatus_to_exitcode(status)} and no word"
    return pickle.loads(answer)


def _answer(work: Callable[[], str], writer: int) -> None:
    """The child: it says what it found, and goes without a further word; what the parent has open is the parent's."""
    code = 1
    try:
        said = work()
        sys.stdout.flush()
        with os.fdopen(writer, "wb") as pipe:
            pickle.dump(said, pipe)
        code = 0
    finally:
        os._exit(code)


def _until_closed(reader: int, end: float) -> bytes | None:
    """All that comes; None where the time is over before."""
    found = b""
    while (left := end - time.monotonic()) > 0:
        if select.select([reader], [], [], left)[0]:
            piece = os.read(reader, 1 << 16)
            if not piece:
                return found
            found += piece
    return None
