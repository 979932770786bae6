"""Objects that are kept between builds: each has its SHA-256 beside it, so that one that is not as it was written is made again."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path


def keep(path: Path, content: bytes) -> None:
    """Write an object, and its seal, so that no power cut leaves the name without the content. Raises OSError."""
    for target, written in ((path, content), (_seal_of(path), hashlib.sha256(content).hexdigest().encode())):
        part = Path(f"{target}.part")
        with part.open("wb") as file:
            file.write(written)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)


def kept(path: Path) -> bool:
    """Whether an object is there as it was written."""
    try:
        return _seal_of(path).read_bytes() == hashlib.sha256(path.read_bytes()).hexdigest().encode()
    except OSError:
        return False


def _seal_of(path: Path) -> Path:
    return Path(f"{path}.sha256")
