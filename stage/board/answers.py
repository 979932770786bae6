"""What comes from the process of firmware: whole messages, or an error. It never waits for ever.

The firmware shares its process with the other end of the pipe: it may close it, write into it, or be stopped. A process that
neither sends nor gets on for longer than its patience is given up.
"""

from __future__ import annotations

import os
import pickle
import select
import struct
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

LOOK_MS = 250
CHUNK = 1 << 20
MOST = 1 << 28  # bytes of a message: text that comes as its length is more
_HEAD = struct.Struct("!i")  # as multiprocessing.connection sends it


class GarbledError(Exception):
    """This is no message."""


class Answers:
    """The messages that come over a pipe."""

    def __init__(self, pipe: Connection):
        self._file = pipe.fileno()
        self._poll = select.poll()
        self._poll.register(self._file, select.POLLIN)
        self._content = bytearray()

    def next(self, waits: Callable[[], None]) -> Any:
        """The next message. waits: is called again and again while none comes, and may raise.

        Raises EOFError, OSError at the end of the pipe, GarbledError.
        """
        while (message := self._whole()) is None:
            if self._poll.poll(LOOK_MS):
                more = os.read(self._file, CHUNK)
                if not more:
                    raise EOFError
                self._content += more
            else:
                waits()
        try:
            return pickle.loads(message)
        except Exception as error:
            raise GarbledError from error

    def _whole(self) -> bytes | None:
        content = self._content
        if len(content) < _HEAD.size:
            return None
        size = _HEAD.unpack_from(content)[0]
        if not 0 <= size < MOST:
            raise GarbledError
        end = _HEAD.size + size
        if len(content) < end:
            return None
        message = bytes(content[_HEAD.size : end])
        del content[:end]
        return message
