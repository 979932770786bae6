"""Errors of boards and of the firmware on them."""

from __future__ import annotations

from stage.errors import RunTimeout, StageError


class LibraryError(StageError):
    """Error of a file that cannot be loaded as a firmware library."""


class CompileError(StageError):
    """Error of firmware that a compiler could not build.

    Attributes:
        output: Messages of the compiler.
    """

    def __init__(self, message: str, output: str = ""):
        super().__init__(message)
        self.output = output


class CompilerWarning(UserWarning):
    """Warning with a message of the compiler or linker about firmware that was built nevertheless."""


class NoCompilerError(StageError):
    """Error of a build on a system without a C or C++ compiler."""


class StormError(StageError):
    """Error of an interrupt hook that does not clear the interrupt which calls it, so that it would be called forever."""


class HostError(StageError):
    """Error of firmware that cannot continue, for example after a crash."""


class HostTimeout(RunTimeout):
    """Error of firmware that did not return within the allowed simulated time or number of bus cycles."""
