"""Readers of untrusted files: they read only regular files of bounded size, and parse their content within bounds.

Every reader of such a file uses these functions, so that a device, a FIFO, a zip bomb or a document of 100,000 levels is refused
with an explanation before it costs time or memory. No content of a file is ever executed.
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
from stage.support.files import FileError, check_readable

MAX_NESTING_LEVELS = 64
"""Maximum depth of nested lists and mappings in a document."""
MAX_INTEGER_BITS = 256
MAX_DOCUMENT_BYTES = 1 << 20
"""Maximum size of a document that people write, such as a layout."""


class DocumentError(ArgumentError):
    """Error of a text that is not JSON or TOML, is nested too deeply, or has a number that is too long."""


def open_regular(
    path: str | os.PathLike, file_kind: str, max_bytes: int, error: type[StageError] = FileError
) -> BinaryIO:
    """Open a regular file that is not empty for reading.

    Args:
        path: Path of the file.
        file_kind: Kind of file, for errors, as in "recording".
        max_bytes: Maximum size of the file.
        error: Type of the error to raise for a file that is missing, empty, too large, unreadable or not regular.
    """
    path = check_readable(path, file_kind, error)
    try:
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | getattr(os, "O_NONBLOCK", 0)), "rb")
    except OSError as why:
        raise error(f"{path} cannot be read: {why.strerror or why}.") from why
    status = os.fstat(file.fileno())
    if stat.S_ISREG(status.st_mode) and status.st_size <= max_bytes:
        return file
    file.close()
    if stat.S_ISREG(status.st_mode):
        raise error(f"{path} has {status.st_size:,} bytes, and {add_article(file_kind)} has at most {max_bytes:,}.")
    raise error(f"{path} is no regular file, and no {file_kind}. Name a regular file.")


def read_bytes(path: str | os.PathLike, file_kind: str, max_bytes: int, error: type[StageError] = FileError) -> bytes:
    """Read all bytes of a regular file. Arguments and errors are those of `open_regular`."""
    try:
        with open_regular(path, file_kind, max_bytes, error) as file:
            content = file.read(max_bytes + 1)
    except OSError as why:
        raise error(f"{path} cannot be read: {why.strerror or why}.") from why
    if len(content) > max_bytes:
        raise error(
            f"{path} has grown beyond {max_bytes:,} bytes while it was read: {add_article(file_kind)} has at most so many."
        )
    return content


def read_text(
    path: str | os.PathLike, file_kind: str, max_bytes: int = MAX_DOCUMENT_BYTES, error: type[StageError] = FileError
) -> str:
    """Read a regular file as text in UTF-8. Arguments and errors are those of `open_regular`."""
    try:
        return read_bytes(path, file_kind, max_bytes, error).decode("utf-8")
    except UnicodeDecodeError as why:
        raise error(
            f"{path} cannot be read: {why}. {add_article(file_kind).capitalize()} is a text in UTF-8."
        ) from None


def parse_json(text: str | bytes, parse_constant: Callable[[str], Any] | None = None) -> Any:
    """Parse a JSON document within the bounds of this module.

    Args:
        text: Document as text, or as bytes in UTF-8. The caller bounds its length.
        parse_constant: Function that is called for NaN, Infinity and -Infinity, as in `json.loads`; default: they are floats.

    Raises:
        DocumentError: The document is not JSON, is nested deeper than 64 levels, or has an integer of more than 256 bits.
    """

    def parse() -> Any:
        document = text if isinstance(text, str) else text.decode("utf-8-sig")
        return json.loads(document, parse_constant=parse_constant)

    return _parse_within_bounds(parse)


def parse_toml(text: str) -> dict[str, Any]:
    """Parse a TOML document within the bounds of this module. Raises DocumentError as `parse_json` does."""
    return _parse_within_bounds(lambda: tomllib.loads(text))


def read_members(
    content: bytes,
    names: Sequence[str],
    max_bytes: int,
    error: Callable[[str], StageError],
    optional: Sequence[str] = (),
    exact: bool = False,
) -> dict[str, bytes]:
    """Read members of a zip archive, and return their content by name.

    Args:
        content: Bytes of the archive.
        names: Members that must exist.
        max_bytes: Maximum size of these members together when unpacked.
        error: Function that makes the error to raise from a description of what is wrong with the archive.
        optional: Members that are read if they exist; any further members are ignored.
        exact: Refuse an archive that has further members, or one member twice.

    Raises:
        StageError: Made by `error`: the archive or one of its members is damaged, missing, too large, encrypted, or packed by a
            method other than "stored" and "deflated", which are those that PulseStage writes.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = (
                archive.infolist() if exact else [m for m in archive.infolist() if m.filename in (*names, *optional)]
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
    """Raise the error that `error` makes if a member is missing, duplicate, unexpected, or packed by another method."""
    present = [member.filename for member in members]
    if sorted(present) != sorted({*names, *(name for name in optional if name in present)}):
        raise error(f"it should hold {', '.join(names)}")
    for member in members:
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise error(f"{member.filename} is packed in another way than PulseStage packs it")


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, error: Callable[[str], StageError]) -> bytes:
    """Read the content of a member. Errors are those of `read_members`."""
    with archive.open(member) as file:
        content = file.read(member.file_size + 1)
    if len(content) != member.file_size:
        raise error(f"{member.filename} does not have the length that the archive states")
    return content


def parse_array(content: bytes) -> np.ndarray:
    """Parse the bytes of an .npy file into an array of numbers. Raises DocumentError; objects are never unpickled."""
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


def _parse_within_bounds(parse: Callable[[], Any]) -> Any:
    """Return the document that `parse` returns if it is within the bounds. Raises DocumentError."""
    try:
        document = parse()
    except RecursionError:
        raise DocumentError(_describe_depth_limit()) from None
    except (ValueError, OverflowError) as why:  # wrong syntax or encoding, or more digits than Python converts
        raise DocumentError(str(why).partition("; use sys.")[0][:200]) from None
    values, level = [document], 0
    while values:
        level += 1
        inner: list[Any] = []
        for value in values:
            if isinstance(value, dict | list):
                if level > MAX_NESTING_LEVELS:
                    raise DocumentError(_describe_depth_limit())
                inner += value.values() if isinstance(value, dict) else value
            elif isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
                raise DocumentError(f"an integer in it has more than {MAX_INTEGER_BITS} bits")
        values = inner
    return document


def _describe_depth_limit() -> str:
    return f"it is nested deeper than {MAX_NESTING_LEVELS} levels"
