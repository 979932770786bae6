"""Terminal of a command: standard output that a reader may close, and progress on standard error.

A reader may close standard output during a command, as in `stage demo | head -1`, or its encoding may lack a character, as ASCII
does. The command then continues and writes its files. Progress is shown only if standard error is a terminal.
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


class ClosableOutput:
    r"""Text stream that drops all text after the first write that fails; `error` is the error of that write.

    A character that the stream cannot encode is written as an escape such as \xb5, as on standard error.
    """

    def __init__(self, stream: Any):
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        """Write to the stream, unless a write has failed."""
        try:
            self._call_stream(self._stream.write, text)
        except UnicodeEncodeError as error:
            self._call_stream(
                self._stream.write, text.encode(error.encoding, "backslashreplace").decode(error.encoding)
            )
        return len(text)

    def flush(self) -> None:
        """Flush the stream, unless a write has failed."""
        self._call_stream(self._stream.flush)

    def _call_stream(self, call: Callable[..., Any], *args: str) -> None:
        """Call a method of the stream unless an earlier call has failed. After a failure, redirect the stream to nowhere."""
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
    """Open the null device for each standard stream that was closed when this process began.

    Otherwise Python has no object for it, and a file that is opened later gets its descriptor: the output of a compiler or of
    firmware
    would then go into that file.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115


def run_with_output(run: Callable[[], int]) -> int:
    """Run a command with a standard output that may be closed; return its exit code.

    A closed standard output is no error. The code is 2 if anything else prevents the text from being written.
    """
    open_missing_streams()
    output = ClosableOutput(sys.stdout)
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


def show_status(text: str) -> None:
    """Show in a line what the command is doing now, if standard error is a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


def show_progress(task: str, share: float) -> None:
    """Show in a line the share of a task that is done, 0 to 1."""
    if sys.stderr.isatty():
        print(f"\r{task} {share:4.0%}", end="\n" if share >= 1 else "", file=sys.stderr, flush=True)


def rewrite_line(text: str) -> None:
    """Replace the line at the cursor by a text; "" clears the line."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


@contextmanager
def show_simulated_time(stage: Any) -> Iterator[None]:
    """Within this block, show the simulated time in a line that is updated regularly."""
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
