"""Files that are written completely or not at all, and that replace another file only on request.

A symbolic link is followed to the file that it names. A device or a pipe is written into, whatever `overwrite` says, as no data are
lost. Only regular files are replaced.
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
from stage.support.extras import need

PASSING = ("/dev/", "/proc/")  # a regular file named there, as /dev/stdout, is somebody's open file


RECORDING, WAVEFORMS = ((".rrd",), "a recording"), ((".vcd",), "a file of waveforms")
PICTURE, MODEL = ((".png",), "a rendered picture"), ((".xml",), "a model")
TRANSCRIPT, ENTRY = ((".jsonl",), "a transcript"), ((".bench",), "an entry")
"""How such files end, and what they are: for `ends_as`."""


class FileError(StageError):
    """A file cannot be written, or another one would be lost."""


def path_of(path: Any, error: type[StageError] = FileError) -> Path:
    """Return a path as a Path; raise `error` for what is none."""
    try:
        return Path(path)
    except TypeError:
        raise error(f"{path!r} is no path: give a text, or a pathlib.Path.") from None


def readable(path: Any, what: str, error: type[StageError] = FileError) -> Path:
    """Return a path, if it is a regular file with something in it that can be read.

    Args:
        path: Path to check.
        what: What should be there, for errors, as in "recording".
        error: Type of the error for what is missing, a folder, a device or a pipe, empty, or cannot be read.
    """
    path = path_of(path, error)
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise error(f"there is no {what} {path}.") from None
    except (OSError, ValueError) as why:
        raise error(f"{path} cannot be read: {getattr(why, 'strerror', None) or why}.") from why
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{path} is a folder. Name a file in it.")
    refuse_irregular(path, what, error)
    if not os.access(path, os.R_OK):
        raise error(f"{path} cannot be read: no permission. `ls -l` says who may.")
    if not status.st_size:
        raise error(f"{path} is empty, and no {what}.")
    return path


def refuse_irregular(path: Path, what: str, error: type[StageError] = FileError) -> None:
    """Raise `error` where a device, a pipe, a socket or a circle of links stands at `path`; what: should be there.

    For readers that say in their own words what to do about a missing file or a folder.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as why:
        raise error(f"{path} cannot be read: {getattr(why, 'strerror', None) or why}.") from why
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise error(f"{path} is {_kind_in_words(mode)}, and no {what}. Name a regular file.")


def writable(
    path: str | os.PathLike, overwrite: bool, error: type[FileError] = FileError, ask: str = "say overwrite=True"
) -> Path:
    """Return the file that a path names, links followed, if it can be written and nothing would be lost.

    Args:
        path: Path to check.
        overwrite: A file that exists may be lost.
        error: Type of the error for what cannot be written.
        ask: What a user has to do in order to overwrite, for errors.
    """
    path = path_of(path, error)
    kind = _kind(path, error)
    if kind is not None and stat.S_ISDIR(kind):
        raise error(f"{path} is a folder. Name a file in it.")
    if kind is not None and (stat.S_ISBLK(kind) or stat.S_ISSOCK(kind)):
        raise error(f"{path} is a {'disk' if stat.S_ISBLK(kind) else 'socket'}. Choose a file, a pipe or a device.")
    if is_stream(path):
        if not os.access(path, os.W_OK):
            raise error(f"{path} cannot be written: no permission. Choose another.")
        return path
    if kind is not None and not overwrite:
        raise error(f"{path} exists. Choose another name, or {ask}.")
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if not target.parent.is_dir():
        raise error(f"{target.parent} is no folder. Make it first, or choose another.")
    if not os.access(target.parent, os.W_OK) or (kind is not None and not os.access(target, os.W_OK)):
        raise error(f"{path} cannot be written: no permission. Choose another folder.")
    return target


def ends_as(path: str | os.PathLike, endings: Iterable[str], what: str, error: type[FileError] = FileError) -> str:
    """Return the ending of a path in small letters; that of a device, which may have any, is the first of `endings`.

    Args:
        path: Path to check.
        endings: Endings that are allowed.
        what: What is written there, for errors, as in "a recording".
        error: Type of the error for another ending, or none.
    """
    known, ending = list(endings), path_of(path, error).suffix.lower()
    if os.path.isdir(path):
        raise error(f"{path} is a folder. Name a file in it.")
    if ending in known:
        return ending
    if is_stream(path):
        return known[0]
    reason = f"{what} is no {ending[1:]!r}" if ending else "the name has no ending, and that says the format"
    raise error(f"{path}: {reason}. Name a file that ends in {', '.join(known)}.")


def is_stream(path: str | os.PathLike) -> bool:
    """Check whether `path` exists and bytes pass through it, as through a device, a pipe or /dev/stdout."""
    try:
        kind = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not stat.S_ISDIR(kind) and (not stat.S_ISREG(kind) or os.path.abspath(path).startswith(PASSING))


@contextmanager
def written(path: str | os.PathLike, overwrite: bool, error: type[FileError] = FileError) -> Iterator[Path]:
    """Yield a temporary name to write to, which becomes `path` when all went well, and is gone when not.

    The bytes are on the disk before the name is. A file that appears as `path` meanwhile stays, unless `overwrite`.
    Raises `error` for what `writable` refuses and for every OSError inside.
    """
    target = writable(path, overwrite, error)
    folder = None
    try:
        folder_of_target = None if is_stream(target) else target.parent  # a rename does not leave a file system
        folder = Path(tempfile.mkdtemp(prefix=".", suffix=".part", dir=folder_of_target))
        part = folder / target.name
        yield part
        if folder_of_target is None:
            _pour(part, target)
        elif not _placed(part, target, overwrite):
            raise error(f"{path} exists: it appeared meanwhile, and stays. Choose another name, or say overwrite=True.")
    except OSError as why:
        raise error(f"{path} cannot be written: {why.strerror or why}. Choose another folder.") from why
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def save_figure(figure: Any, path: str | os.PathLike, dpi: int, overwrite: bool) -> None:
    """Write a matplotlib figure, in the format that the name says. Raises FileError."""
    kind = figure_format(path)
    with written(path, overwrite) as part:
        figure.savefig(part, dpi=dpi, format=kind)


def figure_format(path: str | os.PathLike) -> str:
    """Return the format that matplotlib writes to `path`, PNG to a device; raise FileError where it knows none of that name."""
    known = need("matplotlib.backend_bases", "drawing").FigureCanvasBase.get_supported_filetypes()
    return ends_as(path, (".png", *sorted(f".{kind}" for kind in known if kind != "png")), "a figure")[1:]


def _kind(path: Path, error: type[FileError]) -> int | None:
    """Return the mode (of stat) of what exists at `path`; None if nothing does."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as why:
        raise error(f"{path} cannot be written: {getattr(why, 'strerror', None) or why}. Choose another name.") from why


def _kind_in_words(mode: int) -> str:
    """Return what a mode (of stat) that is no regular file's and no folder's stands for, with its article."""
    kinds = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFBLK: "a disk", stat.S_IFCHR: "a device"}
    return kinds.get(stat.S_IFMT(mode), "no file")


def _pour(part: Path, target: Path) -> None:
    """Copy the bytes of `part` into the device or pipe `target`."""
    with part.open("rb") as source, os.fdopen(os.open(target, os.O_WRONLY | os.O_APPEND), "wb") as sink:
        shutil.copyfileobj(source, sink)


def _placed(part: Path, target: Path, overwrite: bool) -> bool:
    """Give `part` the name `target`; False if something else has it and is not to be overwritten."""
    _sync(part)
    if overwrite:
        with suppress(FileNotFoundError):
            shutil.copymode(target, part)
        os.replace(part, target)
    else:
        try:
            _name(part, target)
        except FileExistsError:
            return False
    with suppress(OSError):  # not every file system can sync a folder
        _sync(target.parent)
    return True


def _name(part: Path, target: Path) -> None:
    """Rename, but never over another file: FileExistsError."""
    try:
        os.link(part, target)
    except OSError as why:
        if why.errno not in (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))  # a file system without hard links
        os.replace(part, target)


def _sync(path: Path) -> None:
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
