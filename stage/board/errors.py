"""Errors of boards and of the firmware on them."""

from __future__ import annotations

from stage.errors import RunTimeout, StageError


class LibraryError(StageError):
    """A file that cannot be loaded as a firmware library."""


class CompileError(StageError):
    """Error of a compiler that could not build the firmware.

    Attributes:
        output: Messages of the compiler.
    """

    def __init__(self, message: str, output: str = ""):
        super().__init__(message)
        self.output = output


class CompilerWarning(UserWarning):
    """A message of the compiler or linker about firmware that it has built."""


class NoCompilerError(StageError):
    """Error for a system without a C or C++ compiler."""


class StormError(StageError):
    """Error for an interrupt hook that does not clear the interrupt that calls it."""


class HostError(StageError):
    """Error of firmware that cannot continue."""


class HostTimeout(RunTimeout):
    """Error of firmware that did not return within the simulated time or the number of bus cycles allowed."""
