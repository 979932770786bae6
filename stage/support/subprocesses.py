"""Calls of other programs, such as compilers and addr2line, whose output is decoded as text in any encoding."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

ENCODING, ERRORS = "utf-8", "replace"
"""Decoding of the output of other programs: file names and source lines may have any encoding, and are only displayed."""


def run_program(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a program and return its exit code and output. Bytes that are not UTF-8 become U+FFFD."""
    return subprocess.run(command, capture_output=True, encoding=ENCODING, errors=ERRORS, check=False)
