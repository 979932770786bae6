"""Servers for tests: in a thread, on a port that is free."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from stage.board import Board
from stage.serve.client import Client, connect
from stage.serve.server import Server


class Served:
    """A board that is served. said: lines for the terminal."""

    def __init__(self, board: Board, **options):
        self.board, self.said = board, []
        self.server = Server(board, port=0, report=self.said.append, **options)
        self.address = f"127.0.0.1:{self.server.address[1]}"

    def host(self, **options) -> Client:
        return connect(self.address, **options)

    def state(self) -> tuple:
        """Return all state that a host can change."""
        stage = self.board.stage
        return (
            stage.snapshot().state.tobytes(),
            str(self.board.trace),
            self.board.log,
            [c.diagnostics for c in stage.chips],
        )


@contextmanager
def serving(board: Board, **options) -> Iterator[Served]:
    served = Served(board, **options)
    thread = threading.Thread(target=served.server.run)
    thread.start()
    try:
        yield served
    finally:
        served.server.stop()
        thread.join()
