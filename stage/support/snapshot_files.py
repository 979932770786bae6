"""Snapshots as files: `stage.snapshot().save("homed.snapshot")`, `Snapshot.load("homed.snapshot")`.

    PulseStage snapshot     20 bytes of ASCII, the last a line feed
    format                  4 bytes, little-endian, as all numbers here
    length of the head      4 bytes
    length of the state     8 bytes
    head                    JSON, UTF-8: kind of snapshot, parts of its header, diagnostics of the chips, checksum
    state                   memory of the state, little-endian
    SHA-256                 digest of all bytes before it

No content of a file is ever executed: there is no pickle in it. The digest detects damage; it does not prove who wrote the file.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
from pathlib import Path
from typing import Any, Self

import numpy as np

from stage.errors import ArgumentError
from stage.support.files import write_atomically
from stage.support.foreign_files import parse_json, read_bytes
from stage.support.snapshots import STATE_VERSION, Snapshot, SnapshotHeader

MAGIC = b"PulseStage snapshot\n"
FORMAT_VERSION = 1
LENGTHS_STRUCT = struct.Struct("<IIQ")
DIGEST_BYTES = hashlib.sha256().digest_size
MIN_FILE_BYTES = len(MAGIC) + LENGTHS_STRUCT.size + DIGEST_BYTES
MAX_FILE_BYTES = 1 << 26
"""Maximum size of a snapshot file that is read."""


class SnapshotError(ArgumentError):
    """Error of a file that is not a snapshot, is damaged, or is a snapshot of another kind."""


class SavableSnapshot(Snapshot):
    """Snapshot that can be saved to a file. Subclasses define how its state and its diagnostics are decoded."""

    @classmethod
    def _decode_state(cls, data: bytes) -> Any:
        """Convert the bytes of a file to a state."""
        return data

    @classmethod
    def _decode_diagnostics(cls, description: Any) -> tuple:
        """Convert a JSON value to the diagnostics of the chips."""
        raise NotImplementedError

    def save(self, path: str | os.PathLike, overwrite: bool = False) -> Path:
        """Write the snapshot to a file, and return its path.

        Raises:
            FileError: The file cannot be written, or exists (and not `overwrite`).
            ArgumentError: The snapshot is damaged.
        """
        self.check_integrity()
        state = np.frombuffer(self.state, np.uint8).tobytes()
        description = {
            "of": self.of,
            "version": STATE_VERSION,
            "parts": self.header.parts,
            "noted": self.diagnostics,
            "checksum": self.checksum,
        }
        head = json.dumps(description).encode()
        content = MAGIC + LENGTHS_STRUCT.pack(FORMAT_VERSION, len(head), len(state)) + head + state
        with write_atomically(path, overwrite) as part:
            part.write_bytes(content + hashlib.sha256(content).digest())
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Self:
        """Load a snapshot from a file that `save` has written. Only `restore` checks whether it fits the object.

        Raises:
            SnapshotError: The file is missing, not a regular file, not a snapshot, larger than 64 MiB, damaged, of another format,
                or a
                snapshot of another kind of object.
        """
        return cls.from_bytes(read_bytes(path, "snapshot", MAX_FILE_BYTES, SnapshotError), str(path))

    @classmethod
    def from_bytes(cls, data: bytes, name: str = "it") -> Self:
        """Parse the bytes of a snapshot file. Raises the errors of `load`.

        Args:
            data: Bytes of the file.
            name: Name of the file, for errors.
        """
        if not isinstance(data, bytes):
            raise SnapshotError(f"data={data!r}: give the bytes of a snapshot's file.")
        description, state = _split_file(name, data)
        if description["version"] != STATE_VERSION:
            raise SnapshotError(
                f"{name} is of version {description['version']} of {description['of']}'s state, and this PulseStage reads version "
                f"{STATE_VERSION}: take it anew."
            )
        if description["of"] != cls.of:
            raise SnapshotError(f"{name} is a snapshot of {description['of']}, and was loaded as one of {cls.of}.")
        try:
            parts = tuple((str(what), str(which)) for what, which in description["parts"])
            snapshot = cls(
                SnapshotHeader(parts),
                cls._decode_state(state),
                cls._decode_diagnostics(description["noted"]),
                description["checksum"],
            )
            snapshot.check_integrity()
        except (ArgumentError, KeyError, TypeError, ValueError) as error:
            raise SnapshotError(_describe_damage(name, "its description does not fit its state")) from error
        return snapshot


def _split_file(name: str, data: bytes) -> tuple[dict[str, Any], bytes]:
    """Split the bytes of a snapshot file into its description and its state.

    Args:
        name: Name of the file, for errors.
        data: Bytes of the file.

    Raises:
        SnapshotError: The bytes are not an intact snapshot file.
    """
    if not data.startswith(MAGIC):
        if data and MAGIC.startswith(data[: len(MAGIC)]):
            raise SnapshotError(_describe_damage(name, "it ends in its first line"))
        raise SnapshotError(
            f"{name} is no snapshot of PulseStage: it does not begin as one. Give what Snapshot.save has written."
        )
    if len(data) < MIN_FILE_BYTES:
        raise SnapshotError(_describe_damage(name, f"it has {len(data)} bytes, and the shortest has {MIN_FILE_BYTES}"))
    form, head, state = LENGTHS_STRUCT.unpack_from(data, len(MAGIC))
    if form != FORMAT_VERSION:
        raise SnapshotError(
            f"{name} is a snapshot of file format {form}, and this PulseStage reads format {FORMAT_VERSION}: read it "
            f"with the version that "
            "wrote it, or take it anew."
        )
    if len(data) != MIN_FILE_BYTES + head + state:
        raise SnapshotError(
            _describe_damage(name, f"it has {len(data)} bytes, and its beginning says {MIN_FILE_BYTES + head + state}")
        )
    if hashlib.sha256(data[:-DIGEST_BYTES]).digest() != data[-DIGEST_BYTES:]:
        raise SnapshotError(_describe_damage(name, "its SHA-256 is not that of its content"))
    begin = len(MAGIC) + LENGTHS_STRUCT.size
    try:
        description = parse_json(data[begin : begin + head])
        if (
            not isinstance(description, dict)
            or not {"of", "version", "parts", "noted", "checksum"} <= description.keys()
        ):
            raise ValueError("no head")
    except ValueError as error:
        raise SnapshotError(_describe_damage(name, "its head cannot be read")) from error
    return description, data[begin + head : begin + head + state]


def _describe_damage(name: str, why: str) -> str:
    """Return the error message for a damaged snapshot file, with the reason `why`."""
    return f"{name} is a damaged snapshot: {why}. Take it anew, or copy the file again."
