"""How many bus cycles a second a host elsewhere makes: one by one, and in batches. Beside them a bare echo over the same loopback,
which no protocol can beat.

python scripts/serve_speed.py
"""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable

from stage.serve.client import Client, connect

PORT = 0x300
ROUNDS = 3


def rate(n: int, work: Callable[[], object]) -> float:
    """The best of some rounds of `n`, per second."""
    best = 0.0
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        best = max(best, n / (time.perf_counter() - begin))
    return best


def echo(n: int) -> float:
    """Round trips of 44 bytes, between a process and a thread that sends back what comes."""
    listener = socket.create_server(("127.0.0.1", 0))
    program = (
        f"import socket\ns = socket.create_connection({listener.getsockname()})\n"
        "s.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)\nwhile m := s.recv(4096): s.sendall(m)"
    )
    other = subprocess.Popen([sys.executable, "-c", program])
    wire, _ = listener.accept()
    wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def trips() -> None:
        for _ in range(n):
            wire.sendall(bytes(44))
            wire.recv(4096)

    found = rate(n, trips)
    wire.close()
    other.wait()
    return found


def measured(host: Client) -> dict[str, float]:
    """Cycles a second, by the way in which they are made."""

    def one_by_one() -> None:
        for _ in range(2000):
            host.in8(PORT)

    def batched(add: Callable) -> Callable[[], object]:
        def run() -> None:
            batch = host.batch()
            for k in range(20_000):
                add(batch, k)
            batch.run()

        return run

    return {
        "reads, one by one": rate(2000, one_by_one),
        "writes, in batches that Python puts together": rate(20_000, batched(lambda b, k: b.out8(PORT + 1, k & 0xFF))),
        "reads, likewise": rate(20_000, batched(lambda b, k: b.in8(PORT))),
        "reads, in an UNTIL8": rate(1_000_000, lambda: host.until8(PORT, 0xFF, 0xEE, 1_000_000)),
    }


def main() -> None:
    command = [sys.executable, "-m", "stage", "serve", "--listen", "0", "--chips", "pcl240mk"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, errors="replace")
    assert server.stdout is not None
    address = next(found[1] for line in server.stdout if (found := re.match(r"listening on ([\d.:]+);", line)))
    threading.Thread(target=server.stdout.read, daemon=True).start()
    try:
        print(f"{echo(2000):12,.0f}  round trips of a bare echo")
        with connect(address) as host:
            for way, found in measured(host).items():
                print(f"{found:12,.0f}  {way}")
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
