"""Terminal of a command: standard output that may be closed, and progress on standard error.

Standard output may be closed on the way, as in `stage demo | head -1`, or lack a character, as ASCII lacks most. The command
continues and writes its files. Progress is shown only where standard error is a terminal.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any

FIRST_UPDATE_S, UPDATE_INTERVAL_S = 1.5, 0.5
"""Wall-clock times of the line of `show_simulated_time`."""


class Output:
    r"""Text stream that drops everything after the first write that fails; `error` is what that write raised.

    A character that the stream cannot encode is written as an escape, such as \xb5, as standard error does it.
    """

    def __init__(self, stream: Any):
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        """Write to the stream, unless a write has failed."""
        try:
            self._try(self._stream.write, text)
        except UnicodeEncodeError as error:
            self._try(self._stream.write, text.encode(error.encoding, "backslashreplace").decode(error.encoding))
        return len(text)

    def flush(self) -> None:
        """Flush the stream, unless a write has failed."""
        self._try(self._stream.flush)

    def _try(self, call: Callable[..., Any], *args: str) -> None:
        if self.error is not None:
            return
        try:
            call(*args)
        except OSError as error:
            self.error = error
            with suppress(OSError, ValueError):  # not every stream has a descriptor
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())  # or Python writes what is left once more at its end
                os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def open_missing_streams() -> None:
    """Let standard streams that were closed when this process began lead to nowhere.

    Otherwise Python has no object for them, and the next files that are opened get their numbers: what a compiler or firmware
    then prints would go into these files.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115


def run_with_output(run: Callable[[], int]) -> int:
    """Return the exit code of `run()`, and print what it prints.

    A reader that has gone away is no error; the code is 2 where anything else keeps the text from being written.
    """
    open_missing_streams()
    output = Output(sys.stdout)
    exit_request = None
    with redirect_stdout(output):
        try:
            code = run()
        except SystemExit as end:  # argparse: the help, the version, wrong usage
            exit_request = end
        output.flush()
    if output.error is not None and not isinstance(output.error, BrokenPipeError):
        print(f"stage: nothing can be printed: {output.error.strerror}.", file=sys.stderr)
        return 2
    if exit_request is not None:
        raise exit_request
    return code


def note(text: str) -> None:
    """Show in a line what the command does now."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


def show_progress(task: str, share: float) -> None:
    """Show in a line how much of a task is done, 0 to 1."""
    if sys.stderr.isatty():
        print(f"\r{task} {share:4.0%}", end="\n" if share >= 1 else "", file=sys.stderr, flush=True)


def rewrite_line(text: str) -> None:
    """Replace the line on which the cursor is; "" clears it."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


@contextmanager
def show_simulated_time(stage: Any) -> Iterator[None]:
    """Show in this block, after a while, how far the simulated time is."""
    if not sys.stderr.isatty():
        yield
        return
    over, has_line = threading.Event(), False

    def update() -> None:
        nonlocal has_line
        wait = FIRST_UPDATE_S
        while not over.wait(wait):
            rewrite_line(f"{stage.data.time:.2f} s simulated; Ctrl-C ends it")
            has_line, wait = True, UPDATE_INTERVAL_S

    thread = threading.Thread(target=update, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        if has_line:
            rewrite_line("")
