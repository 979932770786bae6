"""Safe writing of files: a file is written completely or not at all, and replaces another file only on request.

A symbolic link is followed to its target. Devices and pipes are written to whatever `overwrite` is, as no data are lost. Only
regular files are replaced.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from stage.errors import StageError
from stage.support.extras import import_extra

STREAM_FOLDERS = ("/dev/", "/proc/")  # a regular file named there, such as /dev/stdout, is an open file of a process


RECORDING, WAVEFORMS = ((".rrd",), "a recording"), ((".vcd",), "a file of waveforms")
PICTURE, MODEL = ((".png",), "a rendered picture"), ((".xml",), "a model")
TRANSCRIPT, ENTRY = ((".jsonl",), "a transcript"), ((".bench",), "an entry")
"""Endings of a kind of file, and its name with an article: arguments of `check_ending`."""


class FileError(StageError):
    """Error of a file that cannot be written, or whose former content would be lost."""


def to_path(path: Any, error: type[StageError] = FileError) -> Path:
    """Convert a text or a path object to a Path; raise `error` for anything else."""
    try:
        return Path(path)
    except TypeError:
        raise error(f"{path!r} is no path: give a text, or a pathlib.Path.") from None


def check_readable(path: Any, file_kind: str, error: type[StageError] = FileError) -> Path:
    """Check that a path is a regular, readable file that is not empty, and return the path.

    Args:
        path: Path to check.
        file_kind: Kind of file, for errors, for example "recording".
        error: Type of the error to raise for a missing or empty file, a folder, a device, a pipe, or missing permission.
    """
    path = to_path(path, error)
    status = _read_status(path, error, "read")
    if status is None:
        raise error(f"there is no {file_kind} {path}.")
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{path} is a folder. Name a file in it.")
    refuse_irregular(path, file_kind, error)
    if not os.access(path, os.R_OK):
        raise error(f"{path} cannot be read: no permission. `ls -l` says who may.")
    if not status.st_size:
        raise error(f"{path} is empty, and no {file_kind}.")
    return path


def refuse_irregular(path: Path, file_kind: str, error: type[StageError] = FileError) -> None:
    """Raise `error` if `path` is a device, a pipe, a socket or a loop of links; `file_kind` is the kind of file expected there.

    A missing file and a folder pass: the caller has errors of its own for these.
    """
    status = _read_status(path, error, "read")
    if status is not None and not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        raise error(f"{path} is {_describe_mode(status.st_mode)}, and no {file_kind}. Name a regular file.")


def check_writable(
    path: str | os.PathLike,
    overwrite: bool,
    error: type[FileError] = FileError,
    overwrite_hint: str = "say overwrite=True",
) -> Path:
    """Check that a file can be written without losing another one, and return its path with links resolved.

    Args:
        path: Path to check.
        overwrite: Allow an existing file to be replaced.
        error: Type of the error to raise.
        overwrite_hint: Text for errors that says how a user allows overwriting.
    """
    path = to_path(path, error)
    status = _read_status(path, error, "written", " Choose another name.")
    mode = 0 if status is None else status.st_mode
    if stat.S_ISDIR(mode):
        raise error(f"{path} is a folder. Name a file in it.")
    if stat.S_ISBLK(mode) or stat.S_ISSOCK(mode):
        raise error(f"{path} is a {'disk' if stat.S_ISBLK(mode) else 'socket'}. Choose a file, a pipe or a device.")
    if is_stream(path):
        if not os.access(path, os.W_OK):
            raise error(f"{path} cannot be written: no permission. Choose another.")
        return path
    if status is not None and not overwrite:
        raise error(f"{path} exists. Choose another name, or {overwrite_hint}.")
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if not target.parent.is_dir():
        raise error(f"{target.parent} is no folder. Make it first, or choose another.")
    if not os.access(target.parent, os.W_OK) or (status is not None and not os.access(target, os.W_OK)):
        raise error(f"{path} cannot be written: no permission. Choose another folder.")
    return target


def check_ending(
    path: str | os.PathLike, endings: Iterable[str], file_kind: str, error: type[FileError] = FileError
) -> str:
    """Check that a path has one of some endings, and return its ending in lower case.

    Args:
        path: Path to check. A device or a pipe may have any name; the result is then the first of `endings`.
        endings: Endings that are allowed, such as ".csv".
        file_kind: Kind of file with its article, for errors, as in "a recording".
        error: Type of the error to raise for another ending, or for none.
    """
    known, ending = list(endings), to_path(path, error).suffix.lower()
    if os.path.isdir(path):
        raise error(f"{path} is a folder. Name a file in it.")
    if ending in known:
        return ending
    if is_stream(path):
        return known[0]
    reason = f"{file_kind} is no {ending[1:]!r}" if ending else "the name has no ending, and that says the format"
    raise error(f"{path}: {reason}. Name a file that ends in {', '.join(known)}.")


def is_stream(path: str | os.PathLike) -> bool:
    """Check whether `path` is an existing device, pipe or open file such as /dev/stdout, which is written to and not replaced."""
    try:
        kind = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not stat.S_ISDIR(kind) and (not stat.S_ISREG(kind) or os.path.abspath(path).startswith(STREAM_FOLDERS))


@contextmanager
def write_atomically(path: str | os.PathLike, overwrite: bool, error: type[FileError] = FileError) -> Iterator[Path]:
    """Yield a temporary path to write to; rename it to `path` if the block succeeds, and delete it if the block fails.

    The content is flushed to the disk before the rename. A file that appears at `path` meanwhile stays, unless `overwrite`.
    Raises `error` for every path that `check_writable` refuses, and for every OSError within the block.
    """
    target = check_writable(path, overwrite, error)
    folder = None
    try:
        folder_of_target = None if is_stream(target) else target.parent  # a rename does not leave a file system
        folder = Path(tempfile.mkdtemp(prefix=".", suffix=".part", dir=folder_of_target))
        part = folder / target.name
        yield part
        if folder_of_target is None:
            _copy_to_stream(part, target)
        elif not _move_into_place(part, target, overwrite):
            raise error(f"{path} exists: it appeared meanwhile, and stays. Choose another name, or say overwrite=True.")
    except OSError as why:
        raise error(f"{path} cannot be written: {why.strerror or why}. Choose another folder.") from why
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def save_figure(figure: Any, path: str | os.PathLike, dpi: int, overwrite: bool) -> None:
    """Write a matplotlib figure in the format of the ending of `path`, with `dpi` pixels per inch. Raises FileError."""
    kind = find_figure_format(path)
    with write_atomically(path, overwrite) as part:
        figure.savefig(part, dpi=dpi, format=kind)


def find_figure_format(path: str | os.PathLike) -> str:
    """Return the format in which matplotlib writes `path`: its ending, or "png" for a device. Raises FileError."""
    known = import_extra("matplotlib.backend_bases", "drawing").FigureCanvasBase.get_supported_filetypes()
    return check_ending(path, (".png", *sorted(f".{kind}" for kind in known if kind != "png")), "a figure")[1:]


def _read_status(path: Path, error: type[StageError], action: str, hint: str = "") -> os.stat_result | None:
    """Return the status of `path`; None if nothing exists there.

    Raises `error` if the system refuses: `path` cannot be `action` ("read"), and `hint` says what to do.
    """
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as why:
        raise error(f"{path} cannot be {action}: {getattr(why, 'strerror', None) or why}.{hint}") from why


def _describe_mode(mode: int) -> str:
    """Describe a mode of `os.stat` that is neither a regular file nor a folder, with its article."""
    kinds = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFBLK: "a disk", stat.S_IFCHR: "a device"}
    return kinds.get(stat.S_IFMT(mode), "no file")


def _copy_to_stream(part: Path, target: Path) -> None:
    """Copy the bytes of `part` into the device or pipe `target`."""
    with part.open("rb") as source, os.fdopen(os.open(target, os.O_WRONLY | os.O_APPEND), "wb") as sink:
        shutil.copyfileobj(source, sink)


def _move_into_place(part: Path, target: Path, overwrite: bool) -> bool:
    """Rename `part` to `target`; return False if `target` exists and `overwrite` is False."""
    _flush_to_disk(part)
    if overwrite:
        with suppress(FileNotFoundError):
            shutil.copymode(target, part)
        os.replace(part, target)
    else:
        try:
            _rename_without_overwriting(part, target)
        except FileExistsError:
            return False
    with suppress(OSError):  # not every file system can sync a folder
        _flush_to_disk(target.parent)
    return True


def _rename_without_overwriting(part: Path, target: Path) -> None:
    """Rename `part` to `target`; raise FileExistsError if `target` exists."""
    try:
        os.link(part, target)
    except OSError as why:
        if why.errno not in (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))  # a file system without hard links
        os.replace(part, target)


def _flush_to_disk(path: Path) -> None:
    """Flush the content of a file or a folder to the disk."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
