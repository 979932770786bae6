"""Who may talk to the panel's server (`RequestGuard`), who has the controls (`Controls`), and what a page may do (`EventGate`).

A web site can make its name point at 127.0.0.1 (DNS rebinding), and a browser then lets its pages ask there; so requests must name
this server as their host, and may come from its own pages only. Whoever opens the panel to other machines gives them a link with a
token; a browser that came with it keeps it as a cookie.

Many may look at a panel; one has the controls and gives orders, and while a program drives the stage nobody drives it from a page
unless he takes it over. The server refuses the rest, whatever a page does: what comes from a browser can be forged.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Callable
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from threading import Lock
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

if TYPE_CHECKING:
    from nicegui import Client, ui

    from stage.panel.server import Panel


COOKIE = "pulsestage"
CONTENT_POLICY = "; ".join(
    (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:",
        "connect-src 'self' ws: data: blob:",
        "frame-ancestors 'none'",
    )
)
"""What browsers let the page ask for, as a Content-Security-Policy: nothing from elsewhere."""

MALFORMED = logging.getLogger("stage.panel.malformed")
TAKES_MESSAGE = "AsyncServer._handle_event"
"""How the coroutine of socketio begins that gives a message to its handler."""
TAKES_BYTES = "protocol.data_received()"
"""What asyncio names where a server fails on the bytes of a connection."""
LOGGERS = ("engineio.server", "socketio.server", MALFORMED.name)
"""Loggers of those that take messages of browsers apart, before anything of the panel sees them."""
SERVER_LOGGER = "uvicorn.error"
"""Logger of the server, which takes a socket's texts from their encoding, and reports failures of its own as well."""


class OnlyFirst(logging.Filter):
    """Filter that lets the first record of a process through, as one line: whoever can send messages can send many that are
    malformed."""

    def __init__(self) -> None:
        super().__init__()
        self._has_reported = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether this is the first record, and take the traceback from it."""
        if self._has_reported:
            return False
        self._has_reported = True
        error = record.exc_info[1] if record.exc_info else record.getMessage()
        record.msg = (
            "PulseStage: a malformed message came to the panel, and was ignored (%.200r). More of them are not told."
        )
        record.args, record.exc_info = (error,), None
        return True


def report_malformed_messages_once() -> None:
    """Let the libraries that read messages of browsers write one line for all that are malformed, and no traceback."""
    first = OnlyFirst()
    for name in LOGGERS:
        logging.getLogger(name).addFilter(first)

    def is_of_server(record: logging.LogRecord) -> bool:
        is_malformed = bool(record.exc_info and isinstance(record.exc_info[1], UnicodeDecodeError))
        if is_malformed:
            MALFORMED.warning("A text could not be decoded.", exc_info=record.exc_info)
        return not is_malformed

    logging.getLogger(SERVER_LOGGER).addFilter(is_of_server)


def report_task_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Handle an error that nobody waits for: one of a message or of a connection's bytes as malformed, any other as asyncio does.

    uvicorn itself fails on a socket's text that is not UTF-8: it closes the connection twice.
    """
    task = context.get("future")
    is_of_message = isinstance(task, asyncio.Task) and getattr(task.get_coro(), "__qualname__", "").startswith(
        TAKES_MESSAGE
    )
    if is_of_message or TAKES_BYTES in context.get("message", ""):
        MALFORMED.warning("A message could not be taken.", exc_info=context.get("exception"))
    else:
        loop.default_exception_handler(context)


class RequestGuard:
    """ASGI middleware that lets through what the server's own pages ask for.

    Args:
        app: The application behind it.
        names: Host names of the server, with their ports; empty: any.
        token: What a browser from another machine must bring; "": nobody else can come.
    """

    def __init__(self, app: Any, names: frozenset[str], token: str = ""):
        self._app, self._names, self._token = app, names, token

    async def __call__(self, scope: dict, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin1"): value.decode("latin1") for name, value in scope["headers"]}
        try:
            reason = self._refuses(scope, headers)
        except (ValueError, CookieError):  # no address, or no cookies
            reason = "This server does not parse_line the headers of this request."
        if reason:
            await _refuse(scope, send, reason)
            return

        async def with_policy(message: dict) -> None:
            if message["type"] == "http.response.start":
                added = [(b"content-security-policy", CONTENT_POLICY.encode()), (b"referrer-policy", b"no-referrer")]
                if self._token:
                    cookie = f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    added.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message.get("headers", ()), *added]}
            await send(message)

        try:
            await self._app(scope, receive, with_policy)
        except Exception as error:
            if scope["type"] != "websocket":
                raise
            MALFORMED.warning("A message could not be understood: %r", error, exc_info=True)
            with suppress(Exception):  # it may be closed already
                await send({"type": "websocket.close", "code": 1007, "reason": "This message could not be understood."})

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


class Controls:
    """Register of who looks at a panel, and of who has the controls: the first to come, whoever takes them, and then the next in
    line."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._here: list[str] = []
        self._letting_go: dict[str, list[Callable[[], None]]] = {}
        self.holder: str | None = None

    @property
    def watching(self) -> int:
        """Number of browsers that look."""
        return len(self._here)

    def come(self, who: str) -> None:
        """Add a browser that looks from now on."""
        with self._lock:
            if who not in self._here:
                self._here.append(who)
            self.holder = self.holder or who

    def when_lost(self, who: str, let_go: Callable[[], None]) -> None:
        """Have `let_go` called when this browser loses the controls: what it holds it could not release then."""
        self._letting_go.setdefault(who, []).append(let_go)

    def go(self, who: str) -> None:
        """Remove a browser that does not look any more; it may come back."""
        with self._lock:
            if who in self._here:
                self._here.remove(who)
            lost = self.holder == who
            if lost:
                self.holder = self._here[0] if self._here else None
        self._let_go(lost, who)

    def forget(self, who: str) -> None:
        """Remove a browser that will not come back."""
        self.go(who)
        self._letting_go.pop(who, None)

    def take(self, who: str) -> None:
        """Give the controls to this browser. One that has not come cannot take them."""
        with self._lock:
            before = self.holder
            if who in self._here:
                self.holder = who
        self._let_go(before not in (None, self.holder), before or "")

    def _let_go(self, lost: bool, who: str) -> None:
        for let_go in self._letting_go.get(who, ()) if lost else ():
            let_go()


class EventGate:
    """Gate for the events of one browser: from now on none of a guarded element, or of what stands in one, is heard unless allowed.

    A page that shows its parts as dead is a courtesy; this is the rule.
    """

    def __init__(self, panel: Panel, client: Client):
        self._panel, self._client = panel, client
        self._machine: list[ui.element] = []
        self._driving: list[ui.element] = []
        self._state: tuple[bool, bool] | None = None
        self._handle = client.handle_event
        client.handle_event = self._handle_if_allowed  # type: ignore[method-assign]

    def guard_machine(self, element: ui.element) -> None:
        """Let only the browser with the controls use this element, also beside a program."""
        self._machine.append(element)

    def guard_driving(self, element: ui.element) -> None:
        """Let only a browser that may drive use this element: it moves the stage, or changes its time."""
        self._driving.append(element)

    @property
    def has_controls(self) -> bool:
        """Whether this browser has the controls."""
        return self._panel.controls.holder == self._client.id

    @property
    def may_drive(self) -> bool:
        """Whether this browser may drive now."""
        session = self._panel.session
        return self.has_controls and (session.taken_over or not session.program)

    def refresh(self) -> None:
        """Make the parts that this browser may not use look so."""
        now = self.has_controls, self.may_drive
        if now == self._state:
            return
        self._state = now
        for elements, may in ((self._machine, now[0]), (self._driving, now[1])):
            for element in elements:
                element.props(**({"remove": "inert"} if may else {"add": "inert"}))

    def _handle_if_allowed(self, msg: dict) -> None:
        element = self._client.elements.get(msg.get("id", -1))
        if element is None:
            return
        above = list(element.ancestors(include_self=True))
        if any(e in self._driving for e in above) and not self.may_drive:
            return
        if any(e in self._machine for e in above) and not self.has_controls:
            return
        self._handle(msg)
