"""HTTP server of one recording for browsers of this machine: it serves rerun's page and the recording.

A web site can make its name point at 127.0.0.1 (DNS rebinding), and a browser then lets the site's pages read from there.
Listening on 127.0.0.1 therefore keeps out other machines, but not such pages, and rerun's own servers accept any host name. This
server accepts only the names 127.0.0.1 and localhost, and only paths in a folder with a random name. Other users of the machine
cannot guess that name.
"""

from __future__ import annotations

import secrets
import shutil
import sys
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import TCPServer
from typing import Any
from urllib.parse import quote, urlsplit

LOOPBACK_ADDRESS = "127.0.0.1"
ALLOWED_HOST_NAMES = (LOOPBACK_ADDRESS, "localhost")
PAGE_MIME_TYPES = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
    "apple-touch-icon.png": "image/png",
}
"""MIME types of the files of rerun's page, by name."""
RECORDING_NAME = "recording.rrd"  # its name in addresses: rerun goes by the ending


CONTENT_POLICY = "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:"
"""Content-Security-Policy of the page: nothing from other servers, to which it would send usage data."""


class RecordingServer(ThreadingHTTPServer):
    """HTTP server of a recording at `address`. The constructor raises OSError if the port is not free.

    Args:
        rrd: Path of the recording.
        port: TCP port.
        allow_other_servers: Whether the page may call other servers.

    Attributes:
        page: Contents of the files of rerun's page, by the names of PAGE_MIME_TYPES. Set them before the server starts.
    """

    daemon_threads = True

    def __init__(self, rrd: Path, port: int, allow_other_servers: bool = False) -> None:
        super().__init__((LOOPBACK_ADDRESS, port), _Handler)
        self.rrd = rrd
        self.allows_other_servers = allow_other_servers
        self.page: Mapping[str, bytes] = {}
        self.folder = f"/{secrets.token_urlsafe(16)}/"

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        return f"http://{LOOPBACK_ADDRESS}:{self.server_port}{self.folder}"

    @property
    def hosts(self) -> list[str]:
        """Host names, with and where possible without the port, that a request may address."""
        return [f"{name}:{self.server_port}" for name in ALLOWED_HOST_NAMES] + list(ALLOWED_HOST_NAMES) * (
            self.server_port == 80
        )

    def server_bind(self) -> None:
        """Bind the port without a DNS look-up of this machine's name, which HTTPServer would make."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = LOOPBACK_ADDRESS, int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report errors of a request, except those of a browser that disconnects."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Handler of one browser connection to a RecordingServer."""

    server: RecordingServer
    timeout = 60  # s that a browser may say nothing

    def do_GET(self) -> None:
        """Answer a request of a browser."""
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1 or hosts[0].lower() not in self.server.hosts:
            self._refuse(HTTPStatus.FORBIDDEN, f"This server answers to {' and '.join(self.server.hosts)} only.")
            return
        try:
            address = urlsplit(self.path)
        except ValueError:
            self._refuse(HTTPStatus.BAD_REQUEST, "This is no address.")
            return
        name = address.path.removeprefix(self.server.folder)
        if name == address.path:  # not in our folder
            self._refuse(HTTPStatus.NOT_FOUND, "Nothing is served here. Open the address that the command has printed.")
        elif name == "" and not address.query:
            self._send_head(HTTPStatus.FOUND, "text/plain", 0)
            recording = quote(f"http://{hosts[0]}{self.server.folder}{RECORDING_NAME}", safe="")
            self.send_header("Location", f"{self.server.folder}?url={recording}")
            self.end_headers()
        elif name == RECORDING_NAME:
            self._send_recording()
        elif name in self.server.page:
            self._send(HTTPStatus.OK, PAGE_MIME_TYPES[name], self.server.page[name])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "There is no such file.")

    do_HEAD = do_GET

    def _send_recording(self) -> None:
        try:
            with self.server.rrd.open("rb") as file:
                self._send_head(HTTPStatus.OK, "application/octet-stream", self.server.rrd.stat().st_size)
                self.end_headers()
                if self.command == "GET":
                    shutil.copyfileobj(file, self.wfile)
        except FileNotFoundError:
            self._refuse(HTTPStatus.NOT_FOUND, "The recording is no longer there.")

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        self._send(status, "text/plain; charset=utf-8", f"{reason}\n".encode())

    def _send(self, status: HTTPStatus, mime_type: str, content: bytes) -> None:
        self._send_head(status, mime_type, len(content))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    def _send_head(self, status: HTTPStatus, mime_type: str, length: int) -> None:
        """Send the status and the headers that all answers have; the caller may add headers before `end_headers`."""
        self.send_response(status)
        self.send_header("Content-Type", mime_type)
        self.send_header("Content-Length", str(length))
        if not self.server.allows_other_servers:
            self.send_header("Content-Security-Policy", CONTENT_POLICY)
        self.send_header("Referrer-Policy", "no-referrer")  # nobody else learns the path
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cache-Control", "no-store")

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing."""
