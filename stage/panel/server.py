"""`Panel`: the server of a session's page. A process may have several panels.

panel = Panel(Session(Stage("xyz")))
print(panel.address)
panel.close()
"""

from __future__ import annotations

import asyncio
import errno
import secrets
import socket
import threading
import webbrowser
from concurrent.futures import Future
from time import monotonic, sleep
from typing import Any

from stage.errors import ArgumentError, StageError
from stage.panel.access_control import (
    ControlsAssignment,
    RequestGuard,
    report_malformed_messages_once,
    report_task_error,
)
from stage.panel.fault_controls import FaultControls
from stage.panel.sampler import Sampler
from stage.panel.session import Session
from stage.panel.stage_observer import StageObserver
from stage.support.extras import import_extra

_sites_lock = threading.Lock()
_sites: list[Website] = []


def get_website() -> Website:
    """Return the web site of this process; create it at the first call. Raises ImportError if NiceGUI is not installed."""
    with _sites_lock:
        if not _sites:
            _sites.append(Website())
        return _sites[0]


class Website:
    """NiceGUI application for all panels of a process, in an event loop and a thread of its own.

    Each panel has a server and a port in this loop. The port of a request tells to which panel the request belongs.

    Attributes:
        app: ASGI application.
        loop: Event loop.
        panels: Panels by port.
    """

    def __init__(self) -> None:
        from fastapi import FastAPI, Request
        from nicegui import ui

        from stage.panel import page

        def build_page_of_request(request: Request) -> None:
            page.build_page(self._find_panel(request.scope))

        report_malformed_messages_once()
        self.panels: dict[int, Panel] = {}
        self.app = FastAPI(openapi_url=None)
        self.app.add_route("/mesh/{mesh:int}.stl", self._serve_mesh)
        build_page_of_request.__annotations__["request"] = Request
        ui.run_with(
            self.app,
            root=build_page_of_request,
            title="PulseStage",
            dark=None,
            show_welcome_message=False,
            reconnect_timeout=20,
            binding_refresh_interval=None,  # nothing here is bound
        )
        started: Future[asyncio.AbstractEventLoop] = Future()
        threading.Thread(
            target=asyncio.run, args=(self._run_lifespan(started),), name="pulsestage panel", daemon=True
        ).start()
        self.loop = started.result()

    async def _run_lifespan(self, started: Future) -> None:
        """Run the application until the process ends, and set the result of `started` to the event loop, or to the error."""
        try:
            async with self.app.router.lifespan_context(self.app):
                asyncio.get_running_loop().set_exception_handler(report_task_error)
                started.set_result(asyncio.get_running_loop())
                await asyncio.Event().wait()
        except BaseException as error:
            if not started.done():
                started.set_exception(error)
            raise

    def _find_panel(self, scope: Any) -> Panel:
        """Return the panel to whose port the request with an ASGI scope came."""
        return self.panels[scope["server"][1]]

    async def _serve_mesh(self, request: Any) -> Any:
        """Answer the request for a mesh of the model with an STL file."""
        from starlette.responses import Response

        from stage.panel.stage_scene import mesh_to_stl

        model, mesh = self._find_panel(request.scope).session.stage.model, request.path_params["mesh"]
        if mesh >= model.nmesh:
            return Response(status_code=404)
        return Response(mesh_to_stl(model, mesh), media_type="model/stl")


LOOPBACK_ADDRESS = "127.0.0.1"


class Panel:
    """Server of a session's page.

    Args:
        session: The session.
        port: TCP port; 0: a free port.
        host: Address to listen on. With any other than 127.0.0.1, the server demands the token in its link from other machines.
        stage_options: Options with which `stage panel` has created the stage, see saved_panel.py; None for another stage.
        owns_session: Whether to close the session with the panel.

    Raises:
        ArgumentError: The port is out of range.
        StageError: The port is in use, or NiceGUI is not installed.
    """

    def __init__(
        self,
        session: Session,
        port: int = 0,
        host: str = LOOPBACK_ADDRESS,
        stage_options: dict[str, Any] | None = None,
        owns_session: bool = False,
    ):
        import_extra("nicegui", "the panel")
        import uvicorn

        self._site = get_website()
        from stage.panel.procedure_page import ProcedureOutcomes

        self.session, self.controls, self._owns_session = session, ControlsAssignment(), owns_session
        self.reports = ProcedureOutcomes(session)
        self.stage_options = stage_options
        self._socket = _open_listening_socket(host, port)
        self.port = self._socket.getsockname()[1]
        self.token = "" if host == LOOPBACK_ADDRESS else secrets.token_urlsafe(16)
        self.observer, self.sampler, self.fault_controls = (
            StageObserver(session),
            Sampler(session),
            FaultControls(session),
        )
        names = (LOOPBACK_ADDRESS, "localhost") if host == LOOPBACK_ADDRESS else ()
        config = uvicorn.Config(
            RequestGuard(self._site.app, frozenset(f"{name}:{self.port}" for name in names), self.token),
            log_level="error",
            ws_ping_interval=20,
            ws_per_message_deflate=False,  # it takes longer than what it saves
            lifespan="off",
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._host = host
        self._site.panels[self.port] = self
        self._served = asyncio.run_coroutine_threadsafe(self._server.serve([self._socket]), self._site.loop)
        while not (self._server.started or self._served.done()):
            sleep(0.005)

    @property
    def address(self) -> str:
        """Link to open in a browser."""
        host = _find_reachable_host(self._host)
        address = f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"
        return f"{address}?token={self.token}" if self.token else address

    @property
    def watched(self) -> bool:
        """True if a browser shows the page."""
        return self.controls.browser_count > 0

    def wait_until_watched(self, seconds: float = float("inf")) -> bool:
        """Wait until a browser shows the page, or for `seconds` real seconds at most; return whether one does."""
        end = monotonic() + seconds
        while not self.watched and monotonic() < end:
            sleep(0.02)
        return self.watched

    def show(self) -> bool:
        """Open the page in a browser of this machine; return whether there is such a browser."""
        return webbrowser.open(self.address)

    def __enter__(self) -> Panel:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Panel {self.address}>"

    def _repr_html_(self) -> str:
        return f'<a href="{self.address}" target="_blank">{self.address}</a>'

    def close(self) -> None:
        """Stop the server. The session stays open unless the panel owns it."""
        self._server.should_exit = True
        try:
            self._served.result(5)
        except TimeoutError:
            self._served.cancel()
        self._site.panels.pop(self.port, None)
        self.observer.close()
        self.sampler.close()
        self.fault_controls.close()
        self.reports.close()
        if self._owns_session:
            self.session.close()


def _open_listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on a host and port. Raises StageError if that is not possible."""
    if not 0 <= port < 1 << 16:
        raise ArgumentError(f"port={port!r}: a TCP port is 0 (one that is free) to 65535.")
    try:
        info = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(info[0], socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(info[4])
    except OSError as error:
        hint = "Choose another port, or 0 for any that is free."
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            hint = "--host takes an address of this machine, for example 127.0.0.1, or 0.0.0.0 for all of them."
        raise StageError(f"{host}:{port}: {error.strerror}. {hint}") from error
    return listening


WILDCARDS = {"0.0.0.0": (socket.AF_INET, "192.0.2.1", "127.0.0.1"), "::": (socket.AF_INET6, "2001:db8::1", "::1")}
"""Addresses that stand for all of this machine, with an address elsewhere (reserved for documentation) and the loopback."""


def _find_reachable_host(host: str) -> str:
    """Return the address under which browsers reach a server that listens on `host`."""
    if host not in WILDCARDS:
        return host
    family, elsewhere, loopback = WILDCARDS[host]
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((elsewhere, 9))  # selects the network interface; nothing is sent
            return probe.getsockname()[0]
        except OSError:  # there is no network
            return loopback
