"""Files that come from elsewhere: only regular files of bounded size are read, and what they hold is parsed within bounds.

Every reader of such a file uses these functions, so that a device, a FIFO, a zip bomb or a document of 100,000 levels is refused in
words before it costs time or memory. Nothing of a file is ever run.
"""

from __future__ import annotations

import io
import json
import os
import stat
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO

import numpy as np

from stage.errors import ArgumentError, StageError, add_article
from stage.support.files import FileError, readable

MAX_LEVELS = 64
"""Lists and mappings inside each other in a document, at most."""
MAX_INTEGER_BITS = 256
MAX_DOCUMENT_BYTES = 1 << 20
"""Of a document that people write, such as a layout."""


class DocumentError(ArgumentError):
    """A text is no JSON or TOML, or is nested too deep, or has a number that is too long."""


def open_regular(path: str | os.PathLike, what: str, max_bytes: int, error: type[StageError] = FileError) -> BinaryIO:
    """Open a regular file with something in it for reading.

    Args:
        path: the file.
        what: it should be, as in "recording", for errors.
        max_bytes: that it may have.
        error: is raised for what is missing, no regular file, empty, too large or not to be read.
    """
    path = readable(path, what, error)
    try:
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | getattr(os, "O_NONBLOCK", 0)), "rb")
    except OSError as why:
        raise error(f"{path} cannot be read: {why.strerror or why}.") from why
    status = os.fstat(file.fileno())
    if stat.S_ISREG(status.st_mode) and status.st_size <= max_bytes:
        return file
    file.close()
    if stat.S_ISREG(status.st_mode):
        raise error(f"{path} has {status.st_size:,} bytes, and {add_article(what)} has at most {max_bytes:,}.")
    raise error(f"{path} is no regular file, and no {what}. Name a regular file.")


def read_bytes(path: str | os.PathLike, what: str, max_bytes: int, error: type[StageError] = FileError) -> bytes:
    """Return all bytes of a regular file. Arguments and errors are those of `open_regular`."""
    try:
        with open_regular(path, what, max_bytes, error) as file:
            content = file.read(max_bytes + 1)
    except OSError as why:
        raise error(f"{path} cannot be read: {why.strerror or why}.") from why
    if len(content) > max_bytes:
        raise error(
            f"{path} has grown beyond {max_bytes:,} bytes while it was read: {add_article(what)} has at most so many."
        )
    return content


def read_text(
    path: str | os.PathLike, what: str, max_bytes: int = MAX_DOCUMENT_BYTES, error: type[StageError] = FileError
) -> str:
    """Return the text, in UTF-8, of a regular file. Arguments and errors are those of `open_regular`."""
    try:
        return read_bytes(path, what, max_bytes, error).decode("utf-8")
    except UnicodeDecodeError as why:
        raise error(f"{path} cannot be read: {why}. {add_article(what).capitalize()} is a text in UTF-8.") from None


def parse_json(text: str | bytes, parse_constant: Callable[[str], Any] | None = None) -> Any:
    """Return what a JSON document says.

    Args:
        text: the document, bytes in UTF-8; who calls bounds its length.
        parse_constant: is called for NaN, Infinity and -Infinity, as that of `json.loads`; default: they are floats.

    Raises:
        DocumentError: It is no JSON, is nested deeper than 64 levels, or has an integer of more than 256 bits.
    """

    def parse() -> Any:
        document = text if isinstance(text, str) else text.decode("utf-8-sig")
        return json.loads(document, parse_constant=parse_constant)

    return _parsed(parse)


def parse_toml(text: str) -> dict[str, Any]:
    """Return what a TOML document says. Raises DocumentError as `parse_json` does."""
    return _parsed(lambda: tomllib.loads(text))


def read_members(
    content: bytes,
    names: Sequence[str],
    max_bytes: int,
    error: Callable[[str], StageError],
    optional: Sequence[str] = (),
    only: bool = False,
) -> dict[str, bytes]:
    """Return members of a zip archive by their names.

    Args:
        content: the archive.
        names: members that are wanted; what is neither wanted nor optional is not read.
        max_bytes: that they may have together when unpacked.
        error: makes the error to raise from what is wrong with the archive, in words.
        optional: members that need not be status.
        only: refuse an archive with other members, or with one of them twice.

    Raises:
        StageError: What `error` has made: the archive or a member of it is damaged, missing, too large, encrypted, or packed by
            another method than "stored" and "deflated", which are those that PulseStage writes.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = (
                archive.infolist() if only else [m for m in archive.infolist() if m.filename in (*names, *optional)]
            )
            _check_members(members, names, optional, error)
            size = sum(member.file_size for member in members)
            if size > max_bytes:
                raise error(f"it has {size:,} bytes when unpacked, and at most {max_bytes:,} are read")
            return {member.filename: _read_member(archive, member, error) for member in members}
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, ValueError, NotImplementedError, RuntimeError,
            OverflowError) as why:  # fmt: skip
        if isinstance(why, StageError):
            raise
        raise error(f"it is no zip archive, or it is cut off or damaged ({why!s:.200})") from None


def _check_members(
    members: Sequence[zipfile.ZipInfo],
    names: Sequence[str],
    optional: Sequence[str],
    error: Callable[[str], StageError],
) -> None:
    """Raise what `error` makes where one is missing, there twice or unexpected, or packed in another way."""
    present = [member.filename for member in members]
    if sorted(present) != sorted({*names, *(name for name in optional if name in present)}):
        raise error(f"it should hold {', '.join(names)}")
    for member in members:
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise error(f"{member.filename} is packed in another way than PulseStage packs it")


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, error: Callable[[str], StageError]) -> bytes:
    """Return the content of a member. Errors are those of `read_members`."""
    with archive.open(member) as file:
        content = file.read(member.file_size + 1)
    if len(content) != member.file_size:
        raise error(f"{member.filename} has not the length that it says")
    return content


def parse_array(content: bytes) -> np.ndarray:
    """Return the array of numbers that the bytes of an .npy file hold. Raises DocumentError; objects are never unpickled."""
    try:
        array = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except (
        ValueError,
        TypeError,
        EOFError,
        OverflowError,
        MemoryError,
        SyntaxError,
        RecursionError,
        struct.error,
    ) as why:
        raise DocumentError(f"it is no array, or it is cut off or damaged ({why!s:.200})") from None
    if array.dtype.kind not in "biuf":
        raise DocumentError(f"it is an array of {array.dtype}, and numbers are wanted")
    return array


def _parsed(parse: Callable[[], Any]) -> Any:
    """Return what `parse` returns, if it is within the bounds. Raises DocumentError."""
    try:
        document = parse()
    except RecursionError:
        raise DocumentError(_too_deep()) from None
    except (ValueError, OverflowError) as why:  # of a syntax, of an encoding, of Python's limit of digits
        raise DocumentError(str(why).partition("; use sys.")[0][:200]) from None
    values, level = [document], 0
    while values:
        level += 1
        inner: list[Any] = []
        for value in values:
            if isinstance(value, dict | list):
                if level > MAX_LEVELS:
                    raise DocumentError(_too_deep())
                inner += value.values() if isinstance(value, dict) else value
            elif isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
                raise DocumentError(f"an integer in it has more than {MAX_INTEGER_BITS} bits")
        values = inner
    return document


def _too_deep() -> str:
    return f"it is nested deeper than {MAX_LEVELS} levels"
