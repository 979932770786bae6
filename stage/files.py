"""Files that are written whole or not at all, and never over another one unasked."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stage.errors import StageError


class FileError(StageError):
    """A file cannot be written, or another one would be lost."""


def writable(path: str | os.PathLike, overwrite: bool, error: type[FileError] = FileError) -> Path:
    """`path`, if it can be written and nothing would be lost; raises `error` otherwise."""
    path = Path(path)
    if path.is_dir():
        raise error(f"{path} is a folder. Name a file in it.")
    if path.exists() and not overwrite:
        raise error(f"{path} exists. Choose another name, or say overwrite=True (--force).")
    if not path.parent.is_dir():
        raise error(f"{path.parent} is no folder. Make it first, or choose another.")
    if not os.access(path.parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise error(f"{path} cannot be written: no permission. Choose another folder.")
    return path


@contextmanager
def written(path: str | os.PathLike, overwrite: bool, error: type[FileError] = FileError) -> Iterator[Path]:
    """A name beside `path` to write to; it becomes `path` when all went well, and is gone when not.

    Raises `error` for what `writable` refuses and for every OSError inside.
    """
    path = writable(path, overwrite, error)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    except OSError as why:
        raise error(f"{path} cannot be written: {why.strerror or why}. Choose another folder.") from why
    finally:
        part.unlink(missing_ok=True)


def save_figure(figure: Any, path: str | os.PathLike, dpi: int, overwrite: bool) -> None:
    """Write a matplotlib figure, in the format that the name says. Raises FileError."""
    with written(path, overwrite) as part:
        figure.savefig(part, dpi=dpi)
