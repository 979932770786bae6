"""Child process with a time limit for one promise, so that an endless loop or a crash of a chip core does not end the tests."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection

NOT_FINISHED = "it has not ended after"


def run_in_child_process(work: Callable[[], str], seconds: float | None) -> str:
    """Run `work` in a copy of this process and return its text.

    Args:
        work: Function that returns how a promise is broken, "" if it is kept.
        seconds: Real time limit, s. None: run in this process without a limit, as on a system without fork.

    Returns:
        The text of `work`, or the reason why there is none: the time limit, or the signal that ended the child.
    """
    if seconds is None or not hasattr(os, "fork"):
        return work()
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_send_result, args=(work, sender))
    child.start()
    sender.close()
    try:
        finished = receiver.poll(seconds)
        text = receiver.recv() if finished else ""
    except EOFError:
        child.join()
        code = child.exitcode or 0
        if code < 0:
            return (
                f"its process was ended by {signal.Signals(-code).name}: does the core write or read beyond an array?"
            )
        return f"its process ended with status {code} and no word"
    finally:
        child.kill()
        child.join()
        receiver.close()
    if finished:
        return str(text)
    return (
        f"{NOT_FINISHED} {seconds:g} s: does the core loop without end? (limit=None tries it in this process: "
        "there, with NUMBA_DISABLE_JIT=1, Ctrl-C shows the line)"
    )


def _send_result(work: Callable[[], str], sender: Connection) -> None:
    """Run `work` in the child process and send its text to the parent."""
    sender.send(work())
