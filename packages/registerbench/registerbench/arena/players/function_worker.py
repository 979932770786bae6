"""The process of a player that is a function of a Python module. It speaks the lines of JSON of external_command.py.

python -m registerbench.arena.players.function_worker mine:careful PATHS      is what `FunctionPlayer` starts
"""

from __future__ import annotations

import asyncio
import inspect
import json
import sys
from typing import Any, TextIO

from registerbench.policies import import_attribute, take_standard_output
from stage.agents import Answer
from stage.errors import ArgumentError, StageError


class RemoteGameSession:
    """Interface of a player to a game in another process, with what a `GameSession` has for players.

    Attributes:
        task: Goal of the game, in words.
        name: Name of the game.
        tools: Tools: name, description, parameters.
        over: Whether no further call is possible.
    """

    def __init__(self, first_message: dict[str, Any], requests: TextIO, answers: TextIO):
        self.task, self.name, self.tools = (first_message[key] for key in ("task", "name", "tools"))
        self.over, self._tokens, self._requests, self._answers = False, 0, requests, answers

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Make a call and return its answer. A refused call has an answer, too."""
        if self.over:
            return Answer(False, {"error": "this game is over."})
        try:
            self.send({"call": name, "arguments": arguments})
        except (TypeError, ValueError, RecursionError) as why:
            return Answer(False, {"error": f"the arguments cannot be written as JSON ({type(why).__name__})."})
        line = self._requests.readline()
        if not line:
            raise SystemExit  # the game was ended
        answer = json.loads(line)
        self.over = answer["over"]
        return Answer(answer["ok"], answer["answer"])

    def count_tokens(self, tokens: int) -> None:
        """Add a number of tokens that the player states."""
        self._tokens += tokens

    def send(self, message: dict[str, Any]) -> None:
        """Send a message with the tokens that are not stated yet."""
        self._answers.write(json.dumps({**message, "tokens": self._tokens}, default=repr) + "\n")
        self._answers.flush()
        self._tokens = 0


def play_game(name: str, requests: TextIO, answers: TextIO) -> None:
    """Play one game with the player `module:function`. Without a first message, only check that there is such a player.

    Args:
        name: Name of the player.
        requests: Lines of the game.
        answers: Where the lines of the player go.
    """
    try:
        player = import_attribute(name, "player")
        if not callable(player):
            raise ArgumentError(f"player {name}: it is not a function of a GameSession.")
    except ArgumentError as error:
        answers.write(json.dumps({"refused": str(error)}) + "\n")
        return
    first_line = requests.readline()
    if not first_line:
        return
    session = RemoteGameSession(json.loads(first_line), requests, answers)
    try:
        returned = (player() if isinstance(player, type) else player)(session)
        if inspect.iscoroutine(returned):
            asyncio.run(returned)
    except StageError as error:
        session.send({"stopped": str(error)})
    except Exception as error:
        session.send({"failed": f"{type(error).__name__}: {error}"[:300]})
    else:
        session.send({"done": True})


if __name__ == "__main__":
    sys.path[:] = json.loads(sys.argv[2])
    with take_standard_output() as pipe:
        play_game(sys.argv[1], sys.stdin, pipe)
