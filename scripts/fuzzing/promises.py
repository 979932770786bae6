"""Common parts of all targets: a broken promise is a Finding, and counters are stored in a file, so that no crash loses them."""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path


class Finding(AssertionError):
    """Error of a promise that an input breaks."""


def require(holds: bool, what: str) -> None:
    """Raise Finding with a description unless a condition holds."""
    if not holds:
        raise Finding(what)


class Counts(Counter):
    """Counters by name, which may also be stored in a file, because libFuzzer ends the process without telling Python.

    Args:
        path: File of the counters, or None.
    """

    def __init__(self, path: Path | None = None):
        super().__init__()
        self.path, self._saved = path, 0.0

    def save(self, every: float = 0.0) -> None:
        """Write the file, unless it was written less than `every` seconds ago."""
        now = time.monotonic()
        if self.path is None or now - self._saved < every:
            return
        self._saved = now
        temporary = self.path.with_suffix(".new")
        temporary.write_text(json.dumps(self), encoding="utf-8")
        temporary.replace(self.path)


def read_counts(path: Path) -> dict[str, int]:
    """Return the counters that a process has stored; {} if it has stored none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
