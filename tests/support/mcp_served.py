"""A server in the process of the tests, and the official client over both transports."""

import asyncio
import sys
import threading

from stage import Stage
from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory


class Served:
    """Over HTTP. `talk(work)`: what `await work(client)` gives, with a client of its own."""

    def __init__(self, **how):
        from stage.agents.server.http import HttpServer

        self.maker = ToolboxFactory(lambda: Stage("xy", visuals=False), **how)
        self.sessions = ClientSessions(self.maker)
        self.server = HttpServer(self.maker, self.sessions)
        self._thread = threading.Thread(target=self.server.run, daemon=True)
        self._thread.start()

    def talk(self, work, **headers):
        return asyncio.run(self._talk(work, headers))

    async def _talk(self, work, headers):
        async with self.client(headers) as client:
            return await work(client)

    def client(self, headers=None):
        import httpx2
        from mcp import Client
        from mcp.client.streamable_http import streamable_http_client

        all_headers = {"Authorization": f"Bearer {self.server.token}", **(headers or {})}
        http = httpx2.AsyncClient(headers=all_headers, timeout=60)
        return Client(streamable_http_client(self.server.address, http_client=http))

    def close(self):
        self.server.stop()
        self._thread.join(20)
        assert not self._thread.is_alive()


def over_stdio(work, *arguments):
    """Return the result of `await work(client)` with a server in a process of its own."""
    from mcp import Client
    from mcp.client.stdio import StdioServerParameters

    async def talk():
        command = StdioServerParameters(command=sys.executable, args=["-m", "stage", "mcp", "xy", *arguments])
        async with Client(command) as client:
            return await work(client)

    return asyncio.run(talk())
