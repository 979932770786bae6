"""Transport for desktop clients: one session over standard input and output, for as long as the client runs."""

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

from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory
from stage.agents.server.mcp_handlers import ProtocolServer

SESSION_KEY = "stdio"
MAX_QUEUED_LINES = 8
DISCONNECT_ERRORS = (BrokenPipeError, ConnectionError, anyio.ClosedResourceError, anyio.BrokenResourceError)


def serve(factory: ToolboxFactory) -> None:
    """Serve one MCP client over standard input and output, until it closes one of them or exits."""
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # desktop clients show standard error to their users
    try:
        anyio.run(_serve_client, factory)
    except BaseExceptionGroup as group:
        if group.split(DISCONNECT_ERRORS)[1] is not None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nobody reads what is still buffered


async def _serve_client(factory: ToolboxFactory) -> None:
    forever = float("inf")
    sessions = ClientSessions(factory, limit=1, idle_s=forever, life_s=forever)
    server = ProtocolServer(factory, sessions, lambda ctx: SESSION_KEY, sessionless=True, threads=2).server
    try:
        async with (
            stdio_server(stdin=cast(Any, LineReader(sys.stdin.fileno()))) as (reading, writing),
            anyio.create_task_group() as group,
        ):
            send, receive = anyio.create_memory_object_stream[Any](0)
            group.start_soon(_relay_messages, reading, send, sessions)
            await server.run(receive, writing, server.create_initialization_options())
    finally:
        sessions.shut_down()


class LineReader:
    """Asynchronous iterator over the lines of a file, given by its descriptor.

    A daemon thread reads the lines, and nothing waits for its end: after Ctrl-C it may still read for as long as the client runs.
    """

    def __init__(self, descriptor: int):
        self._loop = asyncio.get_running_loop()
        self._lines: asyncio.Queue[bytes] = asyncio.Queue(MAX_QUEUED_LINES)
        threading.Thread(target=self._read_lines, args=(descriptor,), name="standard input", daemon=True).start()

    def __aiter__(self) -> LineReader:
        return self

    async def __anext__(self) -> str:
        line = await self._lines.get()
        if not line:
            raise StopAsyncIteration
        return line.decode(errors="replace")

    def _read_lines(self, descriptor: int) -> None:
        """Put each line, with its line end, into the queue, and an empty one at the end of the file. Runs in the daemon thread."""
        incomplete = b""
        with suppress(OSError, RuntimeError):  # the descriptor was closed, or the loop has ended
            while data := os.read(descriptor, 1 << 16):  # and not a file: its lock would block the end of the process
                *complete, incomplete = (incomplete + data).split(b"\n")
                for line in complete:
                    self._put_line(line + b"\n")
            if incomplete:
                self._put_line(incomplete)
            self._put_line(b"")

    def _put_line(self, line: bytes) -> None:
        asyncio.run_coroutine_threadsafe(self._lines.put(line), self._loop).result()


async def _relay_messages(reading: Any, send: Any, sessions: ClientSessions) -> None:
    """Forward the client's messages to the server. After the last one, end the running call, because no client waits for it."""
    async with send, reading:
        async for message in reading:
            await send.send(message)
        await anyio.to_thread.run_sync(sessions.close_all)
