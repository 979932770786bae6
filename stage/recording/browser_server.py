"""Serve one recording to browsers of this machine: rerun's page and the file, by a server of this process.

A web site can make its name point at 127.0.0.1 (DNS rebinding), and a browser then lets its pages read from there. So listening on
127.0.0.1 keeps out other machines, but not their pages, and rerun's own servers accept any host name. This server accepts 127.0.0.1
and localhost only, and only a path that nobody can guess, which also keeps out other users of the machine.
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

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
PAGE = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
    "apple-touch-icon.png": "image/png",
}
"""MIME types of the files of rerun's page, by name."""
RECORDING = "recording.rrd"  # its name in addresses: rerun goes by the ending


CONTENT_POLICY = "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:"
"""Content-Security-Policy of the page: nothing from other servers, to which it would send usage data."""


class Server(ThreadingHTTPServer):
    """Server of a recording at `address`. Raises OSError where the port cannot be had.

    Args:
        rrd: The recording.
        port: TCP port.
        outside: The page may call other servers.

    Attributes:
        page: Files of rerun's page, by the names of PAGE; set them before it serves.
    """

    daemon_threads = True

    def __init__(self, rrd: Path, port: int, outside: bool = False) -> None:
        super().__init__((HOST, port), _Handler)
        self.rrd = rrd
        self.outside = outside
        self.page: Mapping[str, bytes] = {}
        self.folder = f"/{secrets.token_urlsafe(16)}/"

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        return f"http://{HOST}:{self.server_port}{self.folder}"

    @property
    def hosts(self) -> list[str]:
        """Names of the server with its port, which browsers omit where it is 80."""
        return [f"{name}:{self.server_port}" for name in NAMES] + list(NAMES) * (self.server_port == 80)

    def server_bind(self) -> None:
        """Bind without asking the network for the name of the machine, as HTTPServer does."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report errors, but those of a browser that disconnects."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: Server
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
            self._begin(HTTPStatus.FOUND, "text/plain", 0)
            recording = quote(f"http://{hosts[0]}{self.server.folder}{RECORDING}", safe="")
            self.send_header("Location", f"{self.server.folder}?url={recording}")
            self.end_headers()
        elif name == RECORDING:
            self._send_recording()
        elif name in self.server.page:
            self._send(HTTPStatus.OK, PAGE[name], self.server.page[name])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "There is no such file.")

    do_HEAD = do_GET

    def _send_recording(self) -> None:
        try:
            with self.server.rrd.open("rb") as file:
                self._begin(HTTPStatus.OK, "application/octet-stream", self.server.rrd.stat().st_size)
                self.end_headers()
                if self.command == "GET":
                    shutil.copyfileobj(file, self.wfile)
        except FileNotFoundError:
            self._refuse(HTTPStatus.NOT_FOUND, "The recording is no longer there.")

    def _refuse(self, status: HTTPStatus, why: str) -> None:
        self._send(status, "text/plain; charset=utf-8", f"{why}\n".encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self._begin(status, kind, len(content))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    def _begin(self, status: HTTPStatus, kind: str, length: int) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(length))
        if not self.server.outside:
            self.send_header("Content-Security-Policy", CONTENT_POLICY)
        self.send_header("Referrer-Policy", "no-referrer")  # nobody else learns the path
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cache-Control", "no-store")

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing."""
