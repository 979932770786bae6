"""Temporary folders that disappear with their owner: for copies of libraries, in which debuggers find symbols.

Closing a folder, collecting its owner and ending the process all remove it. If a kill prevents that, the next process
that creates a folder removes the old one, whose lock nobody holds.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from contextlib import suppress
from functools import cache
from pathlib import Path

try:
    import fcntl
except ImportError:  # no POSIX system: nobody sweeps there
    fcntl = None  # type: ignore[assignment]

PREFIX = "pulsestage-run-"
LOCK = ".lock"
_parent: Path | None = None


class TemporaryFolder:
    """Temporary folder with a lock, removed when it is closed.

    Attributes:
        path: The folder.
    """

    def __init__(self) -> None:
        if fcntl is not None and _parent is None:
            remove_stale_folders()
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=_parent))
        lock = os.open(self.path / LOCK, os.O_CREAT | os.O_RDWR | getattr(os, "O_CLOEXEC", 0), 0o600)
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        self._finalizer = weakref.finalize(self, _remove, self.path, lock, os.getpid())

    def close(self) -> None:
        """Remove the folder."""
        self._finalizer()


def set_parent_folder(folder: Path) -> None:
    """Create all further folders of this process in `folder`, which another process owns and removes."""
    global _parent
    _parent = folder


def _remove(path: Path, lock: int, owner: int) -> None:
    """Remove a folder, except in a fork of its owner, and close its lock."""
    if os.getpid() == owner:  # a fork has it too, and is not to take it away
        shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):
        os.close(lock)


@cache
def remove_stale_folders() -> None:
    """Remove the folders of processes that were killed. Runs once in each process."""
    for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # of another user, or gone already
            lock = os.open(path / LOCK, os.O_RDWR)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(lock)
