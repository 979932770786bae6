"""Who may talk to the panel's server, an ASGI middleware.

A web site can make its name point at 127.0.0.1 (DNS rebinding), and a browser then lets its pages ask there; so requests must name
this server as their host, and may come from its own pages only. Whoever opens the panel to other machines gives them a link with a
token; a browser that came with it keeps it as a cookie.
"""

from __future__ import annotations

import secrets
from http.cookies import SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

COOKIE = "pulsestage"
HERE_ONLY = "; ".join(
    (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:",
        "connect-src 'self' ws: data: blob:",
        "frame-ancestors 'none'",
    )
)
"""What browsers let the page ask for, as a Content-Security-Policy: nothing from elsewhere."""


class Guard:
    """Lets through what is asked by our own pages. names: host names of the server, with their ports; token: what strangers must
    bring, or "" where nobody else can come."""

    def __init__(self, app: Any, names: frozenset[str], token: str = ""):
        self._app, self._names, self._token = app, names, token

    async def __call__(self, scope: dict, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin1"): value.decode("latin1") for name, value in scope["headers"]}
        if reason := self._refuses(scope, headers):
            await _refuse(scope, send, reason)
            return

        async def with_policy(message: dict) -> None:
            if message["type"] == "http.response.start":
                added = [(b"content-security-policy", HERE_ONLY.encode()), (b"referrer-policy", b"no-referrer")]
                if self._token:
                    cookie = f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    added.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message.get("headers", ()), *added]}
            await send(message)

        await self._app(scope, receive, with_policy)

    def _refuses(self, scope: dict, headers: dict[str, str]) -> str:
        if self._names and headers.get("host", "").lower() not in self._names:
            return f"This server answers to {' and '.join(sorted(self._names))} only."
        origin = headers.get("origin")
        if origin and urlsplit(origin).netloc.lower() != headers.get("host", "").lower():
            return "This server answers its own pages only."
        if self._token:
            given = parse_qs(scope.get("query_string", b"").decode("latin1")).get("token", [""])[0]
            kept = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
            known = [given, kept.value if kept else ""]
            if not any(secrets.compare_digest(text.encode(), self._token.encode()) for text in known):
                return "Open the link that the panel printed when it began: it ends with ?token=..."
        return ""


async def _refuse(scope: dict, send: Any, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    head = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": head})
    await send({"type": "http.response.body", "body": reason.encode()})
