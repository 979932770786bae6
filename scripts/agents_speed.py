"""What a call of an agent's tool costs beside the simulation, and how many calls a second many sessions make at once.

python scripts/agents_speed.py --sessions 50
"""

from __future__ import annotations

import argparse
import asyncio
import os
import subprocess
import sys
import threading
from time import perf_counter
from typing import Any

from stage import Stage
from stage.agents import Toolbox
from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory

CALLS = {
    "budget": {}, "status": {"axis": "x"}, "write_register": {"axis": "x", "name": "R1", "value": "1F4h"},
    "write_bytes": {"axis": "x", "address": 0, "values": ["08h"]}, "trace": {"axis": "x"}, "describe": {},
    "snapshot": {"name": "a"}, "restore": {"name": "a"},
}  # fmt: skip


def measure_calls(times: int = 300) -> dict[str, float]:
    """Measure the time of a call of each tool, including the simulation of its bus cycles.

    Args:
        times: Number of calls of each tool.

    Returns:
        Microseconds for one call, by tool.
    """
    box = Toolbox(Stage("xy", visuals=False))
    microseconds = {}
    for name, arguments in CALLS.items():
        box.call(name, arguments)
        start = perf_counter()
        for _ in range(times):
            box.call(name, arguments)
        microseconds[name] = (perf_counter() - start) / times * 1e6
    return microseconds


async def run_client_session(address: str, token: str, calls: int) -> None:
    """Open one session, in which a client writes a register again and again.

    Args:
        address: Address of the server.
        token: Token of the server.
        calls: Number of calls.
    """
    import httpx2
    from mcp import Client
    from mcp.client.streamable_http import streamable_http_client

    http = httpx2.AsyncClient(headers={"Authorization": f"Bearer {token}"}, timeout=120)
    async with Client(streamable_http_client(address, http_client=http)) as c:
        for _ in range(calls):
            answer = await c.call_tool("write_register", CALLS["write_register"])
            assert not answer.is_error, answer


async def run_clients(address: str, token: str, sessions: int, calls: int) -> None:
    """Run sessions of clients at the same time, each in a thread."""
    await asyncio.gather(*(run_client_session(address, token, calls) for _ in range(sessions)))


def measure_calls_per_second(sessions: int, calls: int) -> float:
    """Measure how many calls a second the server answers over HTTP. The clients run in another process on the same machine.

    Args:
        sessions: Number of simultaneous sessions.
        calls: Number of calls of each session.
    """
    from stage.agents.server.http import HttpServer

    maker = ToolboxFactory(lambda: Stage("xy", visuals=False))
    open_sessions = ClientSessions(maker)
    server = HttpServer(maker, open_sessions)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    command: list[Any] = [sys.executable, __file__, "--as-clients", server.address, sessions, calls]
    start = perf_counter()
    subprocess.run([str(word) for word in command], check=True, env={**os.environ, "PULSESTAGE_TOKEN": server.token})
    took = perf_counter() - start
    left = len(open_sessions)
    server.stop()
    thread.join()
    assert left == 0, f"{left} stages were left behind"
    return sessions * calls / took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=50, metavar="N")
    parser.add_argument("--calls", type=int, default=100, metavar="N", help="of each session")
    parser.add_argument("--as-clients", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.as_clients:
        address, sessions, calls = args.as_clients
        asyncio.run(run_clients(address, os.environ["PULSESTAGE_TOKEN"], int(sessions), int(calls)))
        return
    for name, us in measure_calls().items():
        print(f"{name:16}{us:8.0f} us a call")
    rate = measure_calls_per_second(args.sessions, args.calls)
    print(f"{args.sessions} sessions at once over HTTP: {rate:.0f} calls a second, their connecting included")


if __name__ == "__main__":
    main()
