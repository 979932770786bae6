"""The header of a snapshot, which says what it was taken of, and its checksum.

Compiled code trusts the state that it gets: a flipped bit may be an index. So a snapshot has a header, which says what it was
taken of, and a checksum of header and state; both are compared before anything is restored. A pickled snapshot also has a checksum
of all its bytes; a damaged one is refused when it is loaded.
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

VERSION = 1
"""Counted up when a state of before would mean something else now, though its layout is the same."""


@dataclass(frozen=True)
class Header:
    """Description of what a snapshot was taken of: (what, which) in words, the coarsest difference first."""

    parts: tuple[tuple[str, str], ...]

    @cached_property
    def checksum(self) -> int:
        """CRC-32 of the parts."""
        return zlib.crc32(repr((VERSION, self.parts)).encode())


@dataclass(frozen=True, repr=False)
class Snapshot:
    """Base of the snapshots of chips and of stages; `of` says in words what can be restored from it.

    checksum: CRC-32 of header and state. It finds every flip of up to three bits, and of the rest all but one in 2^32.
    """

    of: ClassVar[str]
    header: Header
    state: Any
    diagnostics: tuple
    checksum: int

    def __repr__(self) -> str:
        of = dict(self.header.parts)
        return f"<Snapshot of {self.of}: {next(iter(of.values()), '')}; {len(bytes(self.state)):,} bytes>"

    def checked(self) -> None:
        """Raise ArgumentError where header and state are not those that were taken."""
        try:
            is_intact = self.checksum == zlib.crc32(self.state, self.header.checksum)
        except (TypeError, ValueError, AttributeError):
            is_intact = False
        if not is_intact:
            raise _damaged(type(self))

    def __reduce__(self) -> tuple:
        packed = pickle.dumps(tuple(getattr(self, field.name) for field in fields(self)))
        return _unpacked, (type(self), VERSION, packed, zlib.crc32(packed))

    def __setstate__(self, state: Any) -> None:
        raise ArgumentError(f"this snapshot of {self.of} is from before snapshots had a header: take it anew.")


def _unpacked(cls: type[Snapshot], version: int, packed: bytes, checksum: int) -> Snapshot:
    if version != VERSION:
        raise ArgumentError(
            f"this snapshot of {cls.of} is of format {version}, and this PulseStage reads format {VERSION}: take it anew."
        )
    if not isinstance(packed, bytes) or zlib.crc32(packed) != checksum:
        raise _damaged(cls)
    return cls(*pickle.loads(packed))


def _damaged(cls: type[Snapshot]) -> ArgumentError:
    return ArgumentError(
        f"this snapshot of {cls.of} is damaged: its checksum is not that of its state. Take it anew, or read it from a whole copy."
    )


def check(snapshot: Any, cls: type[Snapshot], header: Header) -> None:
    """Raise ArgumentError unless `snapshot` is an undamaged one of this class with an equal `header`."""
    if not isinstance(snapshot, cls):
        what = f"a snapshot of {snapshot.of}" if isinstance(snapshot, Snapshot) else reprlib.repr(snapshot)
        raise ArgumentError(f"{what} cannot be restored into {cls.of}: give what its own snapshot() returned.")
    snapshot.checked()
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
def layout(dtype: np.dtype) -> str:
    """Return a name for the layout of a record, another one for each layout."""
    return hashlib.blake2b(repr(_fields(dtype)).encode(), digest_size=6).hexdigest()


def _fields(dtype: np.dtype) -> Any:
    """Return all that says how a record lies in memory; NumPy's own text of it takes milliseconds."""
    if dtype.subdtype:
        return _fields(dtype.subdtype[0]), dtype.shape
    if dtype.fields:
        return [(name, offset, _fields(kind)) for name, (kind, offset, *_) in dtype.fields.items()]
    return dtype.str
