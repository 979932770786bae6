"""Base class of snapshots: the captured state, a header that describes the chip or stage, and a checksum.

Compiled code trusts its state: a flipped bit may be an array index. So a snapshot has a checksum of header and state, and `restore`
compares checksum and header before it changes anything. A pickled snapshot also has a checksum of all its bytes, and a damaged one
is refused when it is loaded.
"""

from __future__ import annotations

import hashlib
import pickle
import reprlib
import zlib
from dataclasses import dataclass, fields
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np

from stage.errors import ArgumentError

STATE_VERSION = 1
"""Version of the state; increased when the meaning of a state changes although its layout stays the same."""


@dataclass(frozen=True)
class SnapshotHeader:
    """Description of the object that a snapshot captured: pairs (property, value), the most general property first."""

    parts: tuple[tuple[str, str], ...]

    @cached_property
    def checksum(self) -> int:
        """CRC-32 of the parts."""
        return zlib.crc32(repr((STATE_VERSION, self.parts)).encode())


Header = SnapshotHeader
"""Name of the class in snapshots that earlier versions have pickled."""


@dataclass(frozen=True, repr=False)
class Snapshot:
    """Base class of the snapshots of chips and of stages.

    Attributes:
        of: Kind of object that the snapshot restores, for example "a stage".
        header: Description of the captured object.
        state: Captured state, as bytes or an array.
        diagnostics: Diagnostics of the chips.
        checksum: CRC-32 of header and state. It detects every flip of up to three bits, and all but one in 2^32 of the others.
    """

    of: ClassVar[str]
    header: SnapshotHeader
    state: Any
    diagnostics: tuple
    checksum: int

    def __repr__(self) -> str:
        of = dict(self.header.parts)
        return f"<Snapshot of {self.of}: {next(iter(of.values()), '')}; {len(bytes(self.state)):,} bytes>"

    def check_integrity(self) -> None:
        """Raise ArgumentError if header and state do not match the checksum."""
        try:
            is_intact = self.checksum == zlib.crc32(self.state, self.header.checksum)
        except (TypeError, ValueError, AttributeError):
            is_intact = False
        if not is_intact:
            raise _make_damage_error(type(self))

    def __reduce__(self) -> tuple:
        packed = pickle.dumps(tuple(getattr(self, field.name) for field in fields(self)))
        return _unpacked, (type(self), STATE_VERSION, packed, zlib.crc32(packed))

    def __setstate__(self, state: Any) -> None:
        raise ArgumentError(f"this snapshot of {self.of} is from before snapshots had a header: take it anew.")


def _unpacked(cls: type[Snapshot], version: int, packed: bytes, checksum: int) -> Snapshot:
    """Return a snapshot from its pickled form. Raises ArgumentError if it is damaged or of another version."""
    if version != STATE_VERSION:
        raise ArgumentError(
            f"this snapshot of {cls.of} is of format {version}, and this PulseStage reads format {STATE_VERSION}: take it anew."
        )
    if not isinstance(packed, bytes) or zlib.crc32(packed) != checksum:
        raise _make_damage_error(cls)
    return cls(*pickle.loads(packed))


def _make_damage_error(cls: type[Snapshot]) -> ArgumentError:
    return ArgumentError(
        f"this snapshot of {cls.of} is damaged: its checksum is not that of its state. Take it anew, or read it from a whole copy."
    )


def check_restorable(snapshot: Any, cls: type[Snapshot], header: SnapshotHeader) -> None:
    """Raise ArgumentError unless `snapshot` is an undamaged instance of `cls` whose header equals `header`."""
    if not isinstance(snapshot, cls):
        what = f"a snapshot of {snapshot.of}" if isinstance(snapshot, Snapshot) else reprlib.repr(snapshot)
        raise ArgumentError(f"{what} cannot be restored into {cls.of}: give what its own snapshot() returned.")
    snapshot.check_integrity()
    if snapshot.header is header or snapshot.header.parts == header.parts:
        return
    parts_of_snapshot, parts_of_target = dict(snapshot.header.parts), dict(header.parts)
    different = (
        what
        for what in {**parts_of_snapshot, **parts_of_target}
        if parts_of_snapshot.get(what) != parts_of_target.get(what)
    )
    what = next(different, "order")
    theirs, ours = parts_of_snapshot.get(what, "none"), parts_of_target.get(what, "none")
    raise ArgumentError(
        f"this snapshot of {cls.of} cannot be restored here, for it is another's: {what}: {theirs} there, {ours} here. Restore it "
        f"into {cls.of} made like the one that it was taken of."
    )


@cache
def hash_layout(dtype: np.dtype) -> str:
    """Return a hash of the layout of a record type; two layouts have different hashes."""
    return hashlib.blake2b(repr(_describe_dtype(dtype)).encode(), digest_size=6).hexdigest()


def _describe_dtype(dtype: np.dtype) -> Any:
    """Describe the memory layout of a record type by names, offsets and types; NumPy's own description takes milliseconds."""
    if dtype.subdtype:
        return _describe_dtype(dtype.subdtype[0]), dtype.shape
    if dtype.fields:
        return [(name, offset, _describe_dtype(kind)) for name, (kind, offset, *_) in dtype.fields.items()]
    return dtype.str
