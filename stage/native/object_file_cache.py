"""Cache of object files between builds. A SHA-256 beside each file shows damage; a damaged file is built again."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path


def write_object(path: Path, content: bytes) -> None:
    """Write an object file and its digest, so that a power cut cannot leave the name without the content.

    Args:
        path: File to write.
        content: Content of the object file.

    Raises:
        OSError: The file cannot be written.
    """
    for target, written in ((path, content), (_get_digest_path(path), hashlib.sha256(content).hexdigest().encode())):
        part = Path(f"{target}.part")
        with part.open("wb") as file:
            file.write(written)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)


def is_intact(path: Path) -> bool:
    """Return whether an object file is unchanged since it was written."""
    try:
        return _get_digest_path(path).read_bytes() == hashlib.sha256(path.read_bytes()).hexdigest().encode()
    except OSError:
        return False


def _get_digest_path(path: Path) -> Path:
    """Return the path of the digest file beside an object file."""
    return Path(f"{path}.sha256")
