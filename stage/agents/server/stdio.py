"""The transport of desktop clients: one session over standard input and output, for as long as the client lives."""

from __future__ import annotations

import asyncio
import logging
import os
import sys
import threading
from contextlib import suppress
from typing import Any, cast

import anyio
import anyio.to_thread
from mcp.server.stdio import stdio_server

from stage.agents.server.protocol import Protocol
from stage.agents.server.sessions import Maker, Sessions

ONE = "stdio"
WAITING = 8  # lines of the client that are read before they are taken
GONE = (BrokenPipeError, ConnectionError, anyio.ClosedResourceError, anyio.BrokenResourceError)


def serve(maker: Maker) -> None:
    """Until the client closes standard input or standard output, or dies."""
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # desktop clients show standard error to their users
    try:
        anyio.run(_serve, maker)
    except BaseExceptionGroup as group:
        if group.split(GONE)[1] is not None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left to be said nobody reads


async def _serve(maker: Maker) -> None:
    forever = float("inf")
    sessions = Sessions(maker, most=1, idle=forever, life=forever)
    server = Protocol(maker, sessions, lambda ctx: ONE, modern=True, threads=2).server
    try:
        async with (
            stdio_server(stdin=cast(Any, Lines(sys.stdin.fileno()))) as (reading, writing),
            anyio.create_task_group() as group,
        ):
            passed_on, taken = anyio.create_memory_object_stream[Any](0)
            group.start_soon(_relay, reading, passed_on, sessions)
            await server.run(taken, writing, server.create_initialization_options())
    finally:
        sessions.close_all()


class Lines:
    """The lines of a file, by its descriptor, as an asynchronous iterator.

    A daemon thread reads them. Nobody waits for it at the end: after Ctrl-C it may read for as long as the client lives.
    """

    def __init__(self, descriptor: int):
        self._loop = asyncio.get_running_loop()
        self._lines: asyncio.Queue[bytes] = asyncio.Queue(WAITING)
        threading.Thread(target=self._read, args=(descriptor,), name="standard input", daemon=True).start()

    def __aiter__(self) -> Lines:
        return self

    async def __anext__(self) -> str:
        line = await self._lines.get()
        if not line:
            raise StopAsyncIteration
        return line.decode(errors="replace")

    def _read(self, descriptor: int) -> None:
        """Put each line with its end into the queue, and nothing at the end of the file."""
        incomplete = bytearray()
        with suppress(OSError, RuntimeError):  # of a descriptor that was closed, and of a loop that has ended
            while data := os.read(descriptor, 1 << 16):
                *complete, last = data.split(b"\n")
                for part in complete:
                    self._put(bytes(incomplete + part + b"\n"))
                    incomplete.clear()
                incomplete += last
            if incomplete:
                self._put(bytes(incomplete))
            self._put(b"")

    def _put(self, line: bytes) -> None:
        asyncio.run_coroutine_threadsafe(self._lines.put(line), self._loop).result()


async def _relay(reading: Any, passed_on: Any, sessions: Sessions) -> None:
    """Pass on what the client says. When it has gone, a call that is being made ends, and need not be waited for."""
    async with passed_on, reading:
        async for message in reading:
            await passed_on.send(message)
        await anyio.to_thread.run_sync(sessions.close_all)
