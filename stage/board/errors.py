"""Errors of boards and of the firmware on them."""

from __future__ import annotations

from stage.errors import RunTimeout, StageError


class LibraryError(StageError):
    """Error: a file cannot be loaded as a firmware library."""


class CompileError(StageError):
    """Error: a compiler could not build the firmware.

    Attributes:
        output: Messages of the compiler.
    """

    def __init__(self, message: str, output: str = ""):
        super().__init__(message)
        self.output = output


class CompilerWarning(UserWarning):
    """Warning with a message of the compiler or linker about firmware that was built nevertheless."""


class NoCompilerError(StageError):
    """Error: the system has no C or C++ compiler."""


class StormError(StageError):
    """Error: an interrupt hook does not clear the interrupt that calls it, so it would be called forever."""


class HostError(StageError):
    """Error: firmware cannot continue."""


class HostTimeout(RunTimeout):
    """Error: firmware did not return within the allowed simulated time or number of bus cycles."""
