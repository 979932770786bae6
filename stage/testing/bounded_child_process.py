"""Child process with a time limit for each promise, so that an endless loop or a crash of a chip core does not end the tests."""

from __future__ import annotations

import multiprocessing.connection
import multiprocessing.process
import os
import signal
from collections.abc import Callable, Sequence

TIME_LIMIT_MESSAGE = "it has not ended after"


class BoundedChildProcess:
    """Copy of this process that runs functions in their order. One that hangs or crashes ends it, and a new copy runs the next.

    Args:
        functions: Functions that return how a promise is broken, "" if it is kept.
    """

    def __init__(self, functions: Sequence[Callable[[], str]]):
        self._functions = list(functions)
        self._child: multiprocessing.process.BaseProcess | None = None

    def run_next(self, seconds: float | None) -> str:
        """Run the next function and return its text.

        Args:
            seconds: Real time limit, s. None: run in this process without a limit, as on a system without fork.

        Returns:
            The text of the function, or the reason why there is none: the time limit, or the signal that ended the child.
        """
        if seconds is None or not hasattr(os, "fork"):
            return self._functions.pop(0)()
        if self._child is None:
            context = multiprocessing.get_context("fork")
            self._receiver, sender = context.Pipe(duplex=False)
            self._child = context.Process(target=_send_results, args=(self._functions, sender))
            self._child.start()
            sender.close()
        del self._functions[0]
        try:
            if self._receiver.poll(seconds):
                return str(self._receiver.recv())
        except EOFError:
            self._child.join()
            text = _describe_end(self._child.exitcode or 0)
        else:
            text = (
                f"{TIME_LIMIT_MESSAGE} {seconds:g} s: does the core loop without end? (limit=None tries it in this process: "
                "there, with NUMBA_DISABLE_JIT=1, Ctrl-C shows the line)"
            )
        self.close()
        return text

    def close(self) -> None:
        """End the child process."""
        if self._child is not None:
            self._child.kill()
            self._child.join()
            self._receiver.close()
            self._child = None


def _describe_end(status: int) -> str:
    """Return why a child process sent no text, from its exit status."""
    if status < 0:
        return f"its process was ended by {signal.Signals(-status).name}: does the core write or read beyond an array?"
    return f"its process ended with status {status} and no word"


def _send_results(functions: Sequence[Callable[[], str]], sender: multiprocessing.connection.Connection) -> None:
    """Run functions in the child process and send the text of each to the parent."""
    for function in functions:
        sender.send(function())
