"""NiceGUI's part of the panels: one a process, in an event loop and a thread of its own. Each panel has a server and a port in that
loop, and a page is that of the panel on whose port somebody asks for it."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from stage.panel.guard import report_malformed_messages_once, report_task_error

if TYPE_CHECKING:
    from stage.panel.server import Panel

_alone = threading.Lock()
_sites: list[Website] = []


def website() -> Website:
    """The one of this process. Raises ImportError where NiceGUI is not there."""
    with _alone:
        if not _sites:
            _sites.append(Website())
        return _sites[0]


class Website:
    """Attributes: app, an ASGI application; loop; panels, by port."""

    def __init__(self) -> None:
        from fastapi import FastAPI, Request
        from nicegui import ui

        from stage.panel import page

        def build(request: Request) -> None:
            page.build(self._panel(request.scope))

        report_malformed_messages_once()
        self.panels: dict[int, Panel] = {}
        self.app = FastAPI(openapi_url=None)
        self.app.add_route("/shape/{body:int}.glb", self._shape)
        build.__annotations__["request"] = Request
        ui.run_with(
            self.app,
            root=build,
            title="PulseStage",
            dark=None,
            show_welcome_message=False,
            reconnect_timeout=20,
            binding_refresh_interval=None,  # nothing here is bound
        )
        begun: Future[asyncio.AbstractEventLoop] = Future()
        threading.Thread(target=asyncio.run, args=(self._live(begun),), name="pulsestage panel", daemon=True).start()
        self.loop = begun.result()

    async def _live(self, begun: Future) -> None:
        try:
            async with self.app.router.lifespan_context(self.app):
                asyncio.get_running_loop().set_exception_handler(report_task_error)
                begun.set_result(asyncio.get_running_loop())
                await asyncio.Event().wait()
        except BaseException as error:
            if not begun.done():
                begun.set_exception(error)
            raise

    def _panel(self, scope: Any) -> Panel:
        return self.panels[scope["server"][1]]

    async def _shape(self, request: Any) -> Any:
        from starlette.responses import Response

        found = self._panel(request.scope).shapes.get(request.path_params["body"])
        return Response(found or b"", status_code=200 if found else 404, media_type="model/gltf-binary")
