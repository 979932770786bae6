"""Standard output that does not take what a command prints: the command continues and writes its files.

It may be closed on the way, as in `stage demo | head -1`, or lack a character, as ASCII lacks most.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from typing import Any


class Output:
    """A text stream that drops everything after the first write that fails; `error` is what it failed with.

    A character that the stream cannot encode is written as an escape, such as \\xb5, as standard error does it.
    """

    def __init__(self, stream: Any):
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        try:
            self._try(self._stream.write, text)
        except UnicodeEncodeError as error:
            self._try(self._stream.write, text.encode(error.encoding, "backslashreplace").decode(error.encoding))
        return len(text)

    def flush(self) -> None:
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
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def printing(run: Callable[[], int]) -> int:
    """The exit code of `run()`, and what it prints. A reader that has gone away has seen all it wanted; for anything else that
    keeps the text from being written the code is 2."""
    open_missing_streams()
    output = Output(sys.stdout)
    ended = None
    with redirect_stdout(output):
        try:
            code = run()
        except SystemExit as end:  # argparse: the help, the version, wrong usage
            ended = end
        output.flush()
    if output.error is not None and not isinstance(output.error, BrokenPipeError):
        print(f"stage: nothing can be printed: {output.error.strerror}.", file=sys.stderr)
        return 2
    if ended is not None:
        raise ended
    return code
