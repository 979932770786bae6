"""What every target needs: a broken promise is a Finding; what was done is counted, in a file, so that no end loses it."""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path


class Finding(AssertionError):
    """A promise that an input breaks."""


def require(holds: bool, what: str) -> None:
    if not holds:
        raise Finding(what)


class Counts(Counter):
    """Numbers by name, in a file as well where one is given: libFuzzer ends the process without a word to Python."""

    def __init__(self, path: Path | None = None):
        super().__init__()
        self.path, self._saved = path, 0.0

    def save(self, every: float = 0.0) -> None:
        """Write the file, unless that was done less than `every` seconds ago."""
        now = time.monotonic()
        if self.path is None or now - self._saved < every:
            return
        self._saved = now
        temporary = self.path.with_suffix(".new")
        temporary.write_text(json.dumps(self), encoding="utf-8")
        temporary.replace(self.path)


def read_counts(path: Path) -> dict[str, int]:
    """Return what a process has counted, {} if it never came to count."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
