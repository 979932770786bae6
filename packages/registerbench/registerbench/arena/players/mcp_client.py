"""A player that is a client of the Model Context Protocol (MCP): it plays one game over standard input and output.

The game ends when it is over, or when the client disconnects.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from registerbench.arena.game_session import GameSession
from stage.agents import Answer


class McpClientPlayer:
    """Player that serves a game to an MCP client at standard input and output."""

    name = "mcp client"

    def __call__(self, session: GameSession) -> None:
        from stage.agents.server.stdio import serve

        serve(cast(Any, _GameToolboxFactory(session)))


class _GameToolboxFactory:
    """Stand-in for the MCP server's factory of stages. The only session that it makes is the game."""

    def __init__(self, session: GameSession):
        self._table = session
        self.catalog = self

    @property
    def tools(self) -> Any:
        return self._table.tools_without_log.tools

    @property
    def axes(self) -> tuple[str, ...]:
        return ()

    stage = recordings = None

    def __call__(self) -> Any:
        return SimpleNamespace(
            call=self._call,
            close=lambda: None,
            request_session_end=lambda: None,
            cancel_call=lambda: None,
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
