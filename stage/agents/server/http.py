"""The transport for several clients: streamable HTTP, on this machine, for whoever has the token."""

from __future__ import annotations

import logging
import os
import secrets
import signal
import socket
import threading
from collections.abc import Callable
from contextlib import asynccontextmanager
from typing import Any

import anyio
import uvicorn
from starlette.applications import Starlette

from stage.agents.server.protocol import Protocol
from stage.agents.server.sessions import Maker, Sessions
from stage.errors import StageError

HERE, PATH = "127.0.0.1", "/mcp"
SESSION = "mcp-session-id"
BODY = 256 * 1024  # bytes of a request, at most
LOOK = 2.0  # s between two looks for sessions that are due


class Door:
    """An ASGI middleware: lets in who brings the token, and tells the sessions who goes."""

    def __init__(self, app: Any, token: str, sessions: Sessions):
        self._app, self._token, self._sessions = app, token, sessions
        self._lines: dict[str, int] = {}
        self._silent: dict[str, None] = {}  # sessions without a stage, who spoke longest ago first

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin1").lower(): value.decode("latin1") for name, value in scope["headers"]}
        if not self._knows(headers.get("authorization", "")):
            await _refuse(send)
            return
        key, method = headers.get(SESSION), scope["method"]
        if key is None:
            await self._open(scope, receive, send)
        elif method == "POST":
            if key in self._silent:
                self._silent[key] = self._silent.pop(key)
            await self._app(scope, receive, send)
        elif method == "DELETE":
            await self._app(scope, receive, send)
            self._silent.pop(key, None)
            await anyio.to_thread.run_sync(self._sessions.close, key)
        else:
            await self._listen(key, scope, receive, send)

    async def _open(self, scope: Any, receive: Any, send: Any) -> None:
        """A request without a session may begin one. Of those that never call a tool so many are kept as may have a stage; who has
        been silent for longest goes first."""

        async def hear(message: Any) -> None:
            if message["type"] == "http.response.start":
                for name, value in message.get("headers", ()):
                    if name.decode("latin1").lower() == SESSION:
                        self._silent[value.decode("latin1")] = None
            await send(message)

        for key in [k for k in self._silent if k in self._sessions]:
            del self._silent[key]
        while len(self._silent) >= self._sessions.most:
            key = next(iter(self._silent))
            del self._silent[key]
            await self._end(key, scope)
        await self._app(scope, receive, hear)

    async def _end(self, key: str, scope: Any) -> None:
        """As if its client had ended it."""
        kept = [(n, v) for n, v in scope["headers"] if n.lower() in (b"host", b"accept", b"authorization")]

        async def nothing() -> Any:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def unheard(message: Any) -> None:
            pass

        headers = [*kept, (SESSION.encode(), key.encode())]
        await self._app({**scope, "method": "DELETE", "headers": headers}, nothing, unheard)

    async def _listen(self, key: str, scope: Any, receive: Any, send: Any) -> None:
        """The line that a client keeps open to be told things: when it breaks, the client has gone, it may be."""
        self._lines[key] = self._lines.get(key, 0) + 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._lines[key] -= 1
            if not self._lines[key]:
                del self._lines[key]
                self._sessions.gone(key)

    def _knows(self, given: str) -> bool:
        kind, _, token = given.partition(" ")
        return kind.lower() == "bearer" and secrets.compare_digest(token.strip().encode(), self._token.encode())


async def _refuse(send: Any) -> None:
    head = [(b"content-type", b"text/plain; charset=utf-8"), (b"www-authenticate", b"Bearer")]
    await send({"type": "http.response.start", "status": 401, "headers": head})
    said = (
        b"Send the header 'Authorization: Bearer TOKEN' with the token that `stage mcp --http` printed when it began.\n"
    )
    await send({"type": "http.response.body", "body": said})


class Ending(uvicorn.Server):
    """A server that ends calls in progress at SIGINT and SIGTERM before it waits for them; at a second SIGINT the process ends."""

    def __init__(self, config: uvicorn.Config, sessions: Sessions):
        super().__init__(config)
        self._sessions = sessions

    def handle_exit(self, sig: int, frame: Any) -> None:
        """Take a signal, as uvicorn calls it."""
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        logging.getLogger("uvicorn.error").setLevel(
            logging.CRITICAL
        )  # of lines that clients keep open, which break off now
        threading.Thread(target=self._sessions.close_all, name="end of the sessions", daemon=True).start()
        super().handle_exit(sig, frame)


class HttpServer:
    """Listens from the beginning on; `run` serves. port 0: any that is free. token: None makes one. Raises StageError."""

    def __init__(self, maker: Maker, sessions: Sessions, port: int = 0, token: str | None = None, host: str = HERE):
        self.sessions, self.token = sessions, token or secrets.token_urlsafe(24)
        self._socket = _listening(host, port)
        self.port = self._socket.getsockname()[1]
        protocol = Protocol(maker, sessions, _key, modern=False, threads=max(2, os.cpu_count() or 2))
        app = protocol.server.streamable_http_app(
            streamable_http_path=PATH, json_response=True, max_request_body_size=BODY, session_idle_timeout=sessions.idle,
            max_sessions=2 * sessions.most, host=host,
        )  # fmt: skip
        _with_reaper(app, sessions)
        door = Door(app, self.token, sessions)
        self._server = Ending(uvicorn.Config(door, log_level="error", timeout_graceful_shutdown=1), sessions)

    @property
    def address(self) -> str:
        """What a client connects to."""
        return f"http://{HERE}:{self.port}{PATH}"

    def run(self) -> None:
        """Until SIGINT, SIGTERM or `stop`."""
        self._server.run([self._socket])

    def stop(self) -> None:
        """From another thread: end."""
        self._server.should_exit = True


def _key(ctx: Any) -> str | None:
    request = ctx.request
    return None if request is None else request.headers.get(SESSION)


def _with_reaper(app: Starlette, sessions: Sessions) -> None:
    """While the app lives, sessions that are due end; with the app, all do."""
    before: Callable[..., Any] = app.router.lifespan_context

    @asynccontextmanager
    async def living(app: Starlette) -> Any:
        async with before(app) as state, anyio.create_task_group() as group:
            group.start_soon(_reap, sessions)
            try:
                yield state
            finally:
                await anyio.to_thread.run_sync(sessions.close_all)
                group.cancel_scope.cancel()

    app.router.lifespan_context = living


async def _reap(sessions: Sessions) -> None:
    while True:
        await anyio.sleep(LOOK)
        await anyio.to_thread.run_sync(sessions.reap)


def _listening(host: str, port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()
    except (OSError, OverflowError) as error:
        listening.close()
        why = getattr(error, "strerror", None) or error
        raise StageError(f"{host}:{port}: {why}. Choose another port, or 0 for any that is free.") from error
    return listening
