"""The transport of desktop clients: one session over standard input and output, for as long as the client lives."""

from __future__ import annotations

import logging
import os
import sys
from typing import Any

import anyio
import anyio.to_thread
from mcp.server.stdio import stdio_server

from stage.agents.server.protocol import Protocol
from stage.agents.server.sessions import Maker, Sessions

ONE = "stdio"
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
        async with stdio_server() as (reading, writing), anyio.create_task_group() as group:
            passed_on, taken = anyio.create_memory_object_stream[Any](0)
            group.start_soon(_relay, reading, passed_on, sessions)
            await server.run(taken, writing, server.create_initialization_options())
    finally:
        sessions.close_all()


async def _relay(reading: Any, passed_on: Any, sessions: Sessions) -> None:
    """Pass on what the client says. When it has gone, a call that is being made ends, and need not be waited for."""
    async with passed_on, reading:
        async for message in reading:
            await passed_on.send(message)
        await anyio.to_thread.run_sync(sessions.close_all)
