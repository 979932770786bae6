"""Transport for several clients: streamable HTTP on this machine, for clients that send the token."""

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

from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory
from stage.agents.server.mcp_handlers import ProtocolServer
from stage.errors import StageError

LOCAL_HOST, PATH = "127.0.0.1", "/mcp"
SESSION_HEADER = "mcp-session-id"
MAX_REQUEST_BYTES = 256 * 1024
CLEANUP_INTERVAL_S = 2.0
UNAUTHORIZED = (
    b"Send the header 'Authorization: Bearer TOKEN' with the token that `stage mcp --http` printed when it began.\n"
)


class TokenGate:
    """ASGI middleware that admits only requests with the token, and tells the sessions which clients leave.

    Args:
        app: ASGI application of the MCP server.
        token: Token that clients must send.
        sessions: The open sessions.
    """

    def __init__(self, app: Any, token: str, sessions: ClientSessions):
        self._app, self._token, self._sessions = app, token, sessions
        self._connections: dict[str, int] = {}  # open event streams of a session
        self._unused: dict[str, None] = {}  # sessions without a stage, longest silent first

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin1").lower(): value.decode("latin1") for name, value in scope["headers"]}
        if not self._is_authorized(headers.get("authorization", "")):
            await _send_unauthorized(send)
            return
        key, method = headers.get(SESSION_HEADER), scope["method"]
        if key is None:
            await self._forward_opening_request(scope, receive, send)
        elif method == "POST":
            if key in self._unused:
                self._unused[key] = self._unused.pop(key)
            await self._app(scope, receive, send)
        elif method == "DELETE":
            await self._app(scope, receive, send)
            self._unused.pop(key, None)
            await anyio.to_thread.run_sync(self._sessions.close, key)
        else:
            await self._serve_event_stream(key, scope, receive, send)

    async def _forward_opening_request(self, scope: Any, receive: Any, send: Any) -> None:
        """Forward a request without session key, which may open a session in the protocol.

        A session has no stage before its first tool call. At most `limit` such sessions stay open; the one that has been silent
        for the
        longest time ends first.
        """

        async def note_session(message: Any) -> None:
            """Store the key of the session that the response opens, and send the message."""
            if message["type"] == "http.response.start":
                for name, value in message.get("headers", ()):
                    if name.decode("latin1").lower() == SESSION_HEADER:
                        self._unused[value.decode("latin1")] = None
            await send(message)

        for key in [k for k in self._unused if k in self._sessions]:
            del self._unused[key]
        while len(self._unused) >= self._sessions.limit:
            key = next(iter(self._unused))
            del self._unused[key]
            await self._delete_session(key, scope)
        await self._app(scope, receive, note_session)

    async def _delete_session(self, key: str, scope: Any) -> None:
        """End a session in the protocol by the DELETE request that its client could send."""

        async def receive() -> Any:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Any) -> None:
            pass

        headers = [(n, v) for n, v in scope["headers"] if n.lower() in (b"host", b"accept", b"authorization")]
        headers.append((SESSION_HEADER.encode(), key.encode()))
        await self._app({**scope, "method": "DELETE", "headers": headers}, receive, send)

    async def _serve_event_stream(self, key: str, scope: Any, receive: Any, send: Any) -> None:
        """Serve an event stream of a client. When its last stream breaks, note that the client has disconnected."""
        self._connections[key] = self._connections.get(key, 0) + 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._connections[key] -= 1
            if not self._connections[key]:
                del self._connections[key]
                self._sessions.note_disconnect(key)

    def _is_authorized(self, authorization: str) -> bool:
        kind, _, token = authorization.partition(" ")
        return kind.lower() == "bearer" and secrets.compare_digest(token.strip().encode(), self._token.encode())


async def _send_unauthorized(send: Any) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"www-authenticate", b"Bearer")]
    await send({"type": "http.response.start", "status": 401, "headers": headers})
    await send({"type": "http.response.body", "body": UNAUTHORIZED})


class InterruptibleServer(uvicorn.Server):
    """Uvicorn server that ends running calls at SIGINT and SIGTERM, then waits for their ends. A second SIGINT ends the process."""

    def __init__(self, config: uvicorn.Config, sessions: ClientSessions):
        super().__init__(config)
        self._sessions = sessions

    def handle_exit(self, sig: int, frame: Any) -> None:
        """Handle a signal; uvicorn calls this method."""
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # event streams break off now
        threading.Thread(target=self._sessions.shut_down, name="end of the sessions", daemon=True).start()
        super().handle_exit(sig, frame)


class HttpServer:
    """HTTP server that listens as soon as it is constructed, and serves in `run`.

    Args:
        factory: Factory of the toolboxes.
        sessions: The open sessions.
        port: TCP port; 0: a free port.
        token: Token that clients must send; None: a new one.
        host: Address to listen on.

    Raises:
        StageError: The port is not available.
    """

    def __init__(
        self,
        factory: ToolboxFactory,
        sessions: ClientSessions,
        port: int = 0,
        token: str | None = None,
        host: str = LOCAL_HOST,
    ):
        self.sessions, self.token = sessions, token or secrets.token_urlsafe(24)
        self._socket = _open_listening_socket(host, port)
        self.port = self._socket.getsockname()[1]
        threads = max(2, os.cpu_count() or 2)
        protocol = ProtocolServer(factory, sessions, _find_session_key, sessionless=False, threads=threads)
        app = protocol.server.streamable_http_app(
            streamable_http_path=PATH, json_response=True, max_request_body_size=MAX_REQUEST_BYTES,
            session_idle_timeout=sessions.idle_s, max_sessions=2 * sessions.limit, host=host,
        )  # fmt: skip
        _add_cleanup(app, sessions)
        config = uvicorn.Config(TokenGate(app, self.token, sessions), log_level="error", timeout_graceful_shutdown=1)
        self._server = InterruptibleServer(config, sessions)

    @property
    def address(self) -> str:
        """The URL to which clients connect."""
        return f"http://{LOCAL_HOST}:{self.port}{PATH}"

    def run(self) -> None:
        """Serve until SIGINT, SIGTERM or `stop`."""
        self._server.run([self._socket])

    def stop(self) -> None:
        """Stop the server; another thread may call this method."""
        self._server.should_exit = True


def _find_session_key(ctx: Any) -> str | None:
    """Return the session key in the header of a request, or None."""
    request = ctx.request
    return None if request is None else request.headers.get(SESSION_HEADER)


def _add_cleanup(app: Starlette, sessions: ClientSessions) -> None:
    """End expired sessions at intervals while the app runs, and all sessions when it ends."""
    inner: Callable[..., Any] = app.router.lifespan_context

    async def close_expired() -> None:
        while True:
            await anyio.sleep(CLEANUP_INTERVAL_S)
            await anyio.to_thread.run_sync(sessions.close_expired)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> Any:
        async with inner(app) as state, anyio.create_task_group() as group:
            group.start_soon(close_expired)
            try:
                yield state
            finally:
                await anyio.to_thread.run_sync(sessions.close_all)
                group.cancel_scope.cancel()

    app.router.lifespan_context = lifespan


def _open_listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on a host and port. Raises StageError if the port is not available."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen()
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise StageError(f"{host}:{port}: {reason}. Choose another port, or 0 for any that is free.") from error
    return listener
