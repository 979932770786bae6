"""A player that is a client of the Model Context Protocol: it is served a game over standard input and output, and plays.

The game ends when it is over, or when the client goes.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from registerbench.arena.table import Table
from stage.agents import Answer


class Client:
    """A client of the Model Context Protocol at standard input and output; it plays one game."""

    name = "mcp client"

    def __call__(self, table: Table) -> None:
        from stage.agents.server.stdio import serve

        serve(cast(Any, _Game(table)))


class _Game:
    """A game in the place of a maker of stages: its one session is the table."""

    def __init__(self, table: Table):
        self._table = table
        self.catalog = self

    @property
    def tools(self) -> Any:
        return self._table.playing.tools

    @property
    def axes(self) -> tuple[str, ...]:
        return ()

    stage = recordings = None

    def __call__(self) -> Any:
        return SimpleNamespace(
            call=self._call,
            close=lambda: None,
            interrupt=lambda: None,
            cancel=lambda: None,
            tools=self.tools,
            stage=None,
            recordings=None,
            axes=(),
        )

    def _call(self, name: Any, arguments: Any) -> Answer:
        if self._table.over:
            return Answer(
                False, {"error": "this game is over. Disconnect: the score is told where the server was started."}
            )
        return self._table.call(name, arguments)
