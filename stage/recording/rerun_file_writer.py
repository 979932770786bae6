"""A rerun file, written through a pipe: rerun makes the bytes, this process writes them and gets the system's errors.

rerun's own file sink (0.41) does not report a full disk to its caller, and waits for ever in the next flush.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import termios
import threading
import time
from pathlib import Path
from typing import Any

from stage.recording.lazy_rerun import release_streams

FLUSH_TIMEOUT_S = 60.0


class BlueprintWithStream:
    """Blueprint that keeps the stream into which rerun writes it. rerun calls its methods.

    Attributes:
        stream: RecordingStream, set when the blueprint is saved.
    """

    def __init__(self, blueprint: Any):
        self._blueprint = blueprint
        self.stream: Any = None

    def to_blueprint(self) -> BlueprintWithStream:
        """Return itself, because rerun accepts only complete blueprints."""
        return self

    def _log_to_stream(self, stream: Any) -> None:
        self.stream = stream
        self._blueprint._log_to_stream(stream)


class RrdSink:
    """Writer of a RecordingStream's file. The constructor, `flush` and `close` raise OSError.

    Each flush is one write of complete messages. After an OSError the file ends with the last flush that succeeded.

    Args:
        out: The RecordingStream.
        path: The file.
        blueprint: Blueprint of the file.
        overwrite: The file may exist.

    Attributes:
        out: The RecordingStream until `close` or `abandon`, which free its threads and memory if nobody else refers to it.
    """

    def __init__(self, out: Any, path: Path, blueprint: Any, overwrite: bool):
        self.out, self._bytes, self._closing = out, bytearray(), False
        self._file = path.open("wb" if overwrite else "xb", buffering=0)
        self._end, write_end = os.pipe()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._read_pipe, name="rerun file", daemon=True)
        self._thread.start()
        wrapped = blueprint and BlueprintWithStream(blueprint)
        out.save(f"/dev/fd/{write_end}", default_blueprint=wrapped)
        if wrapped:
            wrapped.stream.disconnect()  # it holds itself in memory, and would for ever
        os.close(write_end)

    def _read_pipe(self) -> None:
        """Read bytes from the pipe all the time, so that rerun never waits."""
        poll = select.poll()
        poll.register(self._end, select.POLLIN)
        while True:
            events = poll.poll(100)
            with self._lock:
                if not events and not self._closing:
                    continue
                data = os.read(self._end, 1 << 16) if events else b""
                if not data:
                    return
                self._bytes += data

    def flush(self) -> None:
        """Write all messages so far to the file, where a kill of this process does not affect them."""
        try:
            self.out.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except RuntimeError as error:
            raise OSError(f"rerun: {error}") from error
        self._write()

    def _write(self) -> None:
        """Write to the file the bytes that have come out of the pipe; on failure, cut the file to its former length."""
        while True:
            with self._lock:  # what is not in the pipe is in the buffer, never between
                if not struct.unpack("i", fcntl.ioctl(self._end, termios.FIONREAD, bytes(4)))[0]:
                    data, self._bytes = memoryview(self._bytes), bytearray()
                    break
            time.sleep(1e-4)
        length = self._file.tell() if self._file.seekable() else 0
        try:
            while len(data):
                data = data[self._file.write(data) :]
        except OSError:
            with contextlib.suppress(OSError):  # a device has no length
                self._file.truncate(length)
            raise

    def close(self) -> None:
        """Write the remaining messages and rerun's footer. Safe to call twice."""
        if self._file.closed:
            return
        try:
            self.out.disconnect()
            self._write()
        finally:
            self._stop()

    def abandon(self) -> None:
        """Close the file without writing anything more. Safe to call twice, and after `close`."""
        if not self._file.closed:
            self.out.disconnect()
            self._stop()

    def _stop(self) -> None:
        """End the thread that reads the pipe, and close both."""
        self.out = None
        release_streams()
        self._closing = True
        self._thread.join()
        os.close(self._end)
        self._file.close()
