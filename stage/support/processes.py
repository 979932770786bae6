"""Programs that are run for what they print, as compilers and addr2line: their output as text, whatever its encoding."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

ENCODING, ERRORS = "utf-8", "replace"
"""How output of other programs is decoded: names of files and lines of sources may be in any encoding, and are shown only."""


def run_program(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a program to its end; return its exit code and output. Bytes that are not UTF-8 become U+FFFD."""
    return subprocess.run(command, capture_output=True, encoding=ENCODING, errors=ERRORS, check=False)
