"""Read the columns of an .rrd file in a separate process, because a damaged file can make rerun's reader abort the process.

This file also runs as the program of that process. It writes to standard output, for each chunk, the length of the entity's path
and of the columns, the path, and the columns as an Arrow stream. After the last chunk, or where the reader fails, it writes a
final
message as a chunk without columns. It imports nothing of PulseStage, so that it starts fast. Arrow validates offsets, lengths and
texts of what arrives.
"""

from __future__ import annotations

import os
import resource
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from signal import Signals
from typing import IO, Any

PROGRAM = __file__
CHUNK_HEAD = struct.Struct("<IQ")
END_MARK = "whole"
UNPACK_LIMITS = 256 << 20, 64  # bytes that any file may have when it is unpacked, and times its size
START_LIMIT_S, MIN_BYTES_PER_S = 60.0, 1 << 20
BYTES_OF_PROCESS = 2 << 30  # of its threads and libraries
SKIPPED_ENTITY_PREFIX = "/stage"  # the scene: pictures, no columns


class DamagedFileError(Exception):
    """Error of a file that rerun's reader cannot read. The message says why."""


def read_chunks(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the entity path and the Arrow record batch of each chunk, except those of the 3D scene. Raises DamagedFileError."""
    import pyarrow

    size = path.stat().st_size
    left, seconds = UNPACK_LIMITS[0] + UNPACK_LIMITS[1] * size, START_LIMIT_S + size / MIN_BYTES_PER_S
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "RUST_LOG": "off"}
    process = subprocess.Popen(
        [sys.executable, "-P", PROGRAM, str(path)], env=environment,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    watch = threading.Timer(seconds, process.kill)
    watch.daemon = True
    watch.start()
    message = None
    try:
        out: IO[bytes] = process.stdout  # type: ignore[assignment]
        while len(head := out.read(CHUNK_HEAD.size)) == CHUNK_HEAD.size:
            length, columns = CHUNK_HEAD.unpack(head)
            if not columns:
                message = out.read(length).decode(errors="replace")
                break
            left -= length + columns
            if left < 0:
                raise DamagedFileError("it is far larger when it is unpacked")
            entity, content = out.read(length).decode(), out.read(columns)
            if len(content) < columns:
                break
            yield entity, pyarrow.ipc.open_stream(content).read_next_batch()
    finally:
        if message is None:
            process.kill()
        code = process.wait()
        in_time = watch.is_alive()
        watch.cancel()
        process.stdout.close()  # type: ignore[union-attr]
    if message is None:
        raise DamagedFileError(
            _describe_end(code) if in_time else f"rerun's reader was not done with it after {seconds:.0f} s"
        )
    if message != END_MARK:
        raise DamagedFileError(message)


def _describe_end(code: int) -> str:
    """Describe how the reading process ended, from its exit code."""
    return (
        f"rerun's reader was ended by {Signals(-code).name}" if code < 0 else f"rerun's reader ended with status {code}"
    )


def _write_chunks(path: str, out: IO[bytes]) -> None:
    """Write the chunks of a file to `out`, as the program that `read_chunks` starts."""
    limit = UNPACK_LIMITS[0] + UNPACK_LIMITS[1] * Path(path).stat().st_size + BYTES_OF_PROCESS
    with suppress(ValueError, OSError):  # somebody has set a lower limit
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    import pyarrow
    from rerun.chunk import RrdReader

    message = END_MARK
    try:
        for chunk in RrdReader(path).stream():
            if chunk.entity_path.startswith(SKIPPED_ENTITY_PREFIX):
                continue
            batch = chunk.to_record_batch()
            batch.validate(full=True)
            sink = pyarrow.BufferOutputStream()
            with pyarrow.ipc.new_stream(sink, batch.schema) as stream:
                stream.write_batch(batch)
            entity, content = chunk.entity_path.encode(), sink.getvalue()
            out.write(CHUNK_HEAD.pack(len(entity), content.size) + entity)
            out.write(content)
    except (RuntimeError, ValueError) as error:
        message = str(error).rpartition("rrd: ")[2].partition("\n")[0][:200]
    last = message.encode()
    out.write(CHUNK_HEAD.pack(len(last), 0) + last)
    out.flush()


if __name__ == "__main__":
    _write_chunks(sys.argv[1], sys.stdout.buffer)
    os._exit(0)  # threads of rerun may wait for what a damaged file does not have
