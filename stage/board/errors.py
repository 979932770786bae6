"""Errors of boards and of the firmware on them."""

from __future__ import annotations

from stage.errors import RunTimeout, StageError


class LibraryError(StageError):
    """A file that cannot be loaded as a firmware library."""


class CompileError(StageError):
    """The compiler refused the firmware. `output`: what it said."""

    def __init__(self, message: str, output: str = ""):
        super().__init__(message)
        self.output = output


class CompilerWarning(UserWarning):
    """A message of the compiler or linker about firmware that it has built."""


class NoCompilerError(StageError):
    """There is no C compiler."""


class StormError(StageError):
    """An interrupt hook does not clear the interrupt that calls it."""


class HostError(StageError):
    """Firmware that could not continue."""


class HostTimeout(RunTimeout):
    """Firmware that did not return in the simulated time, or the bus cycles, that it was given."""
