"""Snapshots as files: `stage.snapshot().save("homed.snapshot")`, `Snapshot.load("homed.snapshot")`.

    PulseStage snapshot     20 bytes of ASCII, the last a line feed
    format                  4 bytes, little-endian, as all numbers here
    length of the head      4 bytes
    length of the state     8 bytes
    head                    JSON, UTF-8: what it is of, the parts of its header, what the chips have noted, its checksum
    state                   as it lies in memory, little-endian
    SHA-256                 of all before it

Nothing of a file is ever run: there is no pickle in it. The sum finds damage; it does not say who wrote the file.
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
from stage.support.files import written
from stage.support.foreign_files import parse_json, read_bytes
from stage.support.snapshots import VERSION, Header, Snapshot

MAGIC = b"PulseStage snapshot\n"
FORMAT = 1
LENGTHS = struct.Struct("<IIQ")
SUM = hashlib.sha256().digest_size
LEAST = len(MAGIC) + LENGTHS.size + SUM
LARGEST = 1 << 26
"""Bytes of a file that is read."""


class SnapshotError(ArgumentError):
    """A file is no snapshot, or a damaged one, or another kind of one."""


class FiledSnapshot(Snapshot):
    """A snapshot that a file can hold. Classes below say how their state and what was noted go into one."""

    @classmethod
    def _state_of(cls, data: bytes) -> Any:
        """Return the state that `data` holds."""
        return data

    @classmethod
    def _noted_of(cls, description: Any) -> tuple:
        """Return the diagnostics, from what JSON gave for them."""
        raise NotImplementedError

    def save(self, path: str | os.PathLike, overwrite: bool = False) -> Path:
        """Write the snapshot to a file, and return its path.

        Raises:
            FileError: The file cannot be written, or exists (and not `overwrite`).
            ArgumentError: The snapshot is damaged.
        """
        self.checked()
        state = np.frombuffer(self.state, np.uint8).tobytes()
        description = {
            "of": self.of,
            "version": VERSION,
            "parts": self.header.parts,
            "noted": self.diagnostics,
            "checksum": self.checksum,
        }
        head = json.dumps(description).encode()
        content = MAGIC + LENGTHS.pack(FORMAT, len(head), len(state)) + head + state
        with written(path, overwrite) as part:
            part.write_bytes(content + hashlib.sha256(content).digest())
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Self:
        """Return the snapshot in a file that `save` has written; `restore` says whether it fits.

        Raises:
            SnapshotError: The file is missing, no regular file, no snapshot, larger than 64 MiB, damaged, of another format, or of
                something else.
        """
        return cls.from_bytes(read_bytes(path, "snapshot", LARGEST, SnapshotError), str(path))

    @classmethod
    def from_bytes(cls, data: bytes, name: str = "it") -> Self:
        """Return the snapshot that the bytes of a file hold; `name` says in errors where they come from. Raises as `load`."""
        if not isinstance(data, bytes):
            raise SnapshotError(f"data={data!r}: give the bytes of a snapshot's file.")
        description, state = _parts(name, data)
        if description["version"] != VERSION:
            raise SnapshotError(
                f"{name} is of version {description['version']} of {description['of']}'s state, and this PulseStage reads version "
                f"{VERSION}: take it anew."
            )
        if description["of"] != cls.of:
            raise SnapshotError(f"{name} is a snapshot of {description['of']}, and was loaded as one of {cls.of}.")
        try:
            parts = tuple((str(what), str(which)) for what, which in description["parts"])
            snapshot = cls(
                Header(parts), cls._state_of(state), cls._noted_of(description["noted"]), description["checksum"]
            )
            snapshot.checked()
        except (ArgumentError, KeyError, TypeError, ValueError) as error:
            raise SnapshotError(_damaged(name, "what it says of itself does not fit its state")) from error
        return snapshot


def _parts(name: str, data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the description and the state in a file. Raises SnapshotError."""
    if not data.startswith(MAGIC):
        if data and MAGIC.startswith(data[: len(MAGIC)]):
            raise SnapshotError(_damaged(name, "it ends in its first line"))
        raise SnapshotError(
            f"{name} is no snapshot of PulseStage: it does not begin as one. Give what Snapshot.save has written."
        )
    if len(data) < LEAST:
        raise SnapshotError(_damaged(name, f"it has {len(data)} bytes, and the shortest has {LEAST}"))
    form, head, state = LENGTHS.unpack_from(data, len(MAGIC))
    if form != FORMAT:
        raise SnapshotError(
            f"{name} is a snapshot of file format {form}, and this PulseStage reads format {FORMAT}: read it with the version that "
            "wrote it, or take it anew."
        )
    if len(data) != LEAST + head + state:
        raise SnapshotError(_damaged(name, f"it has {len(data)} bytes, and its beginning says {LEAST + head + state}"))
    if hashlib.sha256(data[:-SUM]).digest() != data[-SUM:]:
        raise SnapshotError(_damaged(name, "its SHA-256 is not that of its content"))
    begin = len(MAGIC) + LENGTHS.size
    try:
        description = parse_json(data[begin : begin + head])
        if (
            not isinstance(description, dict)
            or not {"of", "version", "parts", "noted", "checksum"} <= description.keys()
        ):
            raise ValueError("no head")
    except ValueError as error:
        raise SnapshotError(_damaged(name, "its head cannot be read")) from error
    return description, data[begin + head : begin + head + state]


def _damaged(name: str, why: str) -> str:
    return f"{name} is a damaged snapshot: {why}. Take it anew, or copy the file again."
