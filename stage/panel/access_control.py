"""Access to the panel: its requests (`RequestGuard`), the controls (`ControlsAssignment`), a browser's events (`BrowserEventGate`).

A web site can make its name point at 127.0.0.1 (DNS rebinding), and a browser then lets its pages send requests there; so requests
must name this server as their host, and may come from its own pages only. Browsers of other machines need the token of the link,
and keep it as a cookie.

Many browsers may show a panel, but only one has the controls and changes the stage. While a program drives the stage, that browser
can move the stage only after the user has pressed "take over". The server ignores all other events: a browser can forge messages.
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
"""Content-Security-Policy of the page: nothing from other servers."""

MALFORMED = logging.getLogger("stage.panel.malformed")
MESSAGE_COROUTINE = "AsyncServer._handle_event"
"""Begin of the name of socketio's coroutine that gives a message to its handler."""
BYTES_CALLBACK = "protocol.data_received()"
"""Name in asyncio's message where a server fails on the bytes of a connection."""
LOGGERS = ("engineio.server", "socketio.server", MALFORMED.name)
"""Loggers of the libraries that parse messages of browsers before the panel gets them."""
SERVER_LOGGER = "uvicorn.error"
"""Logger of the server, which decodes a socket's texts, and reports failures of its own as well."""


class FirstRecordFilter(logging.Filter):
    """Logging filter that passes only the first record of a process, as one line: a browser can send many malformed messages."""

    def __init__(self) -> None:
        super().__init__()
        self._has_reported = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether this is the first record, and take the traceback from it."""
        if self._has_reported:
            return False
        self._has_reported = True
        error = record.exc_info[1] if record.exc_info else record.getMessage()
        record.msg = "PulseStage: a malformed message came to the panel, and was ignored (%.200r). Further ones are not reported."
        record.args, record.exc_info = (error,), None
        return True


def report_malformed_messages_once() -> None:
    """Make the libraries that parse messages of browsers log only the first malformed message, in one line without traceback."""
    first = FirstRecordFilter()
    for name in LOGGERS:
        logging.getLogger(name).addFilter(first)

    def is_from_server(record: logging.LogRecord) -> bool:
        is_malformed = bool(record.exc_info and isinstance(record.exc_info[1], UnicodeDecodeError))
        if is_malformed:
            MALFORMED.warning("A text could not be decoded.", exc_info=record.exc_info)
        return not is_malformed

    logging.getLogger(SERVER_LOGGER).addFilter(is_from_server)


def report_task_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Handle an error of an asyncio task that nobody awaits.

    Log a malformed message of a browser in one line, and any other error as asyncio does. A message that is not UTF-8 ends here
    because uvicorn then closes the connection twice.

    Args:
        loop: The event loop.
        context: Description of the error, see `asyncio.loop.call_exception_handler`.
    """
    task = context.get("future")
    is_of_message = isinstance(task, asyncio.Task) and getattr(task.get_coro(), "__qualname__", "").startswith(
        MESSAGE_COROUTINE
    )
    if is_of_message or BYTES_CALLBACK in context.get("message", ""):
        MALFORMED.warning("A message could not be taken.", exc_info=context.get("exception"))
    else:
        loop.default_exception_handler(context)


class RequestGuard:
    """ASGI middleware that lets the requests of the server's own pages through.

    Args:
        app: ASGI application that gets the requests that pass.
        names: Host names of the server, with their ports; empty: any name passes.
        token: Token that a browser of another machine must send; "": no other machine can connect.
    """

    def __init__(self, app: Any, names: frozenset[str], token: str = ""):
        self._app, self._names, self._token = app, names, token

    async def __call__(self, scope: dict, receive: Any, send: Any) -> None:
        """Refuse an ASGI request, or give it to the application."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin1"): value.decode("latin1") for name, value in scope["headers"]}
        try:
            reason = self._find_refusal(scope, headers)
        except (ValueError, CookieError):  # no address, or no cookies
            reason = "This server cannot parse the headers of this request."
        if reason:
            await _send_refusal(scope, send, reason)
            return

        async def add_content_policy(message: dict) -> None:
            if message["type"] == "http.response.start":
                added = [(b"content-security-policy", CONTENT_POLICY.encode()), (b"referrer-policy", b"no-referrer")]
                if self._token:
                    cookie = f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    added.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message.get("headers", ()), *added]}
            await send(message)

        try:
            await self._app(scope, receive, add_content_policy)
        except Exception as error:
            if scope["type"] != "websocket":
                raise
            MALFORMED.warning("A message could not be understood: %r", error, exc_info=True)
            with suppress(Exception):  # it may be closed already
                await send({"type": "websocket.close", "code": 1007, "reason": "This message could not be understood."})

    def _find_refusal(self, scope: dict, headers: dict[str, str]) -> str:
        """Return the reason to refuse a request, or "" if the request passes."""
        if self._names and headers.get("host", "").lower() not in self._names:
            return f"This server answers to {' and '.join(sorted(self._names))} only."
        origin = headers.get("origin")
        if origin and urlsplit(origin).netloc.lower() != headers.get("host", "").lower():
            return "This server answers its own pages only."
        if self._token:
            in_link = parse_qs(scope.get("query_string", b"").decode("latin1")).get("token", [""])[0]
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
            tokens = [in_link, cookie.value if cookie else ""]
            if not any(secrets.compare_digest(token.encode(), self._token.encode()) for token in tokens):
                return "Open the link that the panel printed when it began: it ends with ?token=..."
        return ""


async def _send_refusal(scope: dict, send: Any, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    head = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": head})
    await send({"type": "http.response.body", "body": reason.encode()})


class ControlsAssignment:
    """Assignment of the controls to one of the browsers that show a panel.

    The first browser has the controls until another one takes them. If the browser with the controls leaves, the browser that has
    shown the panel for the longest time gets them.

    Attributes:
        holder: Name of the browser that has the controls, or None.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._browsers: list[str] = []
        self._release: dict[str, list[Callable[[], None]]] = {}
        self.holder: str | None = None

    @property
    def browser_count(self) -> int:
        """Number of browsers that show the panel."""
        return len(self._browsers)

    def add_browser(self, browser: str) -> None:
        """Add a browser that shows the panel from now on."""
        with self._lock:
            if browser not in self._browsers:
                self._browsers.append(browser)
            self.holder = self.holder or browser

    def call_when_controls_lost(self, browser: str, release: Callable[[], None]) -> None:
        """Register a function to call when a browser loses the controls: it can then no longer release a button that it holds down.

        Args:
            browser: Name of the browser.
            release: Function that releases the button.
        """
        self._release.setdefault(browser, []).append(release)

    def disconnect_browser(self, browser: str) -> None:
        """Remove a browser that no longer shows the panel. The functions that `call_when_controls_lost` registered stay."""
        with self._lock:
            if browser in self._browsers:
                self._browsers.remove(browser)
            is_lost = self.holder == browser
            if is_lost:
                self.holder = self._browsers[0] if self._browsers else None
        self._release_buttons(browser if is_lost else None)

    def delete_browser(self, browser: str) -> None:
        """Remove a browser that will not come back, with its functions of `call_when_controls_lost`."""
        self.disconnect_browser(browser)
        self._release.pop(browser, None)

    def give_controls_to(self, browser: str) -> None:
        """Give the controls to a browser that shows the panel."""
        with self._lock:
            before = self.holder
            if browser in self._browsers:
                self.holder = browser
        self._release_buttons(before if before != self.holder else None)

    def _release_buttons(self, browser: str | None) -> None:
        for release in self._release.get(browser or "", ()):
            release()


class BrowserEventGate:
    """Gate for the events of one browser, which ignores events of elements that the browser may not use now.

    An element is restricted by `require_controls` or `require_driving_rights`, with all elements in it. The page also shows
    such elements as inert, but only this gate protects the stage.
    """

    def __init__(self, panel: Panel, client: Client):
        self._panel, self._client = panel, client
        self._machine: list[ui.element] = []
        self._driving: list[ui.element] = []
        self._state: tuple[bool, bool] | None = None
        self._handle = client.handle_event
        client.handle_event = self._handle_if_allowed  # type: ignore[method-assign]

    def require_controls(self, element: ui.element) -> None:
        """Restrict an element to the browser with the controls, whether or not a program drives the stage."""
        self._machine.append(element)

    def require_driving_rights(self, element: ui.element) -> None:
        """Restrict an element that moves the stage or changes its time to a browser that may drive (`may_drive`)."""
        self._driving.append(element)

    @property
    def has_controls(self) -> bool:
        """True if this browser has the controls."""
        return self._panel.controls.holder == self._client.id

    @property
    def may_drive(self) -> bool:
        """True if this browser may drive the stage now: it has the controls, and no program drives."""
        session = self._panel.session
        return self.has_controls and (session.program_suspended or not session.program)

    def update_inert_elements(self) -> None:
        """Show exactly those elements as inert that this browser may not use now."""
        state = self.has_controls, self.may_drive
        if state == self._state:
            return
        self._state = state
        for elements, is_allowed in zip((self._machine, self._driving), state, strict=True):
            for element in elements:
                element.props(**{"remove" if is_allowed else "add": "inert"})

    def _handle_if_allowed(self, msg: dict) -> None:
        element = self._client.elements.get(msg.get("id", -1))
        if element is None:
            return
        ancestors = list(element.ancestors(include_self=True))
        for guarded, is_allowed in ((self._driving, self.may_drive), (self._machine, self.has_controls)):
            if not is_allowed and any(e in guarded for e in ancestors):
                return
        self._handle(msg)
