"""`Table`: a game as a player has it, with what it may use: so many calls, so long for each, so long in all."""

from __future__ import annotations

import json
import math
import threading
from collections import Counter
from dataclasses import dataclass
from time import monotonic
from typing import Any

from registerbench.arena.games import Game
from stage.agents import Answer
from stage.agents.arguments import format_value
from stage.errors import ArgumentError

MAX_CALLS, PATIENCE, TIME = 400, 600.0, 3600.0
AFTER = 20  # calls that are refused when a game is over, and the next one ends the player
TOKENS = 1 << 40  # of a reply, at most


@dataclass(frozen=True)
class Limits:
    """Limits of a game. The simulation's own time is not the player's.

    Attributes:
        most: Number of calls.
        patience: Real seconds that a player may take for its next call.
        time: Real seconds for all of a game's calls.

    Raises:
        ArgumentError: A limit is not such a number.
    """

    most: int = MAX_CALLS
    patience: float = PATIENCE
    time: float = TIME

    def __post_init__(self) -> None:
        if isinstance(self.most, bool) or not isinstance(self.most, int) or not self.most >= 1:
            raise ArgumentError(f"most={format_value(self.most)}: a whole number of calls, 1 or more.")
        for name in ("patience", "time"):
            s = getattr(self, name)
            if isinstance(s, bool) or not isinstance(s, int | float) or not 0 < s < math.inf:
                raise ArgumentError(f"{name}={format_value(s)}: seconds, more than 0.")


class Left(BaseException):
    """Raised in a player that goes on after its game has ended."""


class Table:
    """Game as a player has it.

    Attributes:
        task: What is to be done.
        tools: Name, description and schema of each.
        tokens: As the player counts them.
        playing: The calls themselves, which keep no log.
        troubles: What a player does wrong beside its calls, and how often.
        over: Nothing more can be done, too many calls were made, or it took too long.
        ended: Why it was ended before; "" if it was not.
    """

    def __init__(self, game: Game, limits: Limits | None = None):
        self._game, self.limits, self.task, self.name = game, limits or Limits(), game.task, game.name
        self.playing = game.calls
        self.tokens = 0
        self.log: list[dict[str, Any]] = []
        self.troubles: Counter[str] = Counter()
        self.ended = ""
        self._lock, self._after, self._left = threading.Lock(), 0, False
        self._since: float | None = monotonic()  # the player thinks since then; None: a call is being made
        self._thought = 0.0

    @property
    def tools(self) -> list[dict[str, Any]]:
        """Tools as most interfaces of language models take them: name, description, parameters."""
        return [
            {"name": t.name, "description": t.text, "parameters": t.schema()} for t in self._game.calls.tools.values()
        ]

    @property
    def over(self) -> bool:
        return self._left or self._game.over or len(self.log) >= self.limits.most

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Make a call. It does not raise, unless the player goes on although the game is over.

        Args:
            name: Of the tool.
            arguments: As the player gives them.
        """
        with self._lock:
            self._thought += monotonic() - (self._since or monotonic())
            self._since = None
            try:
                return self._call(name, arguments)
            finally:
                self._since = monotonic()

    def _call(self, name: Any, arguments: Any) -> Answer:
        if self.over:
            return self._refused()
        try:
            request = jsonable({"call": name, "arguments": arguments})
        except (TypeError, ValueError, RecursionError) as why:
            self.trouble("arguments that are no JSON")
            said = f"the arguments cannot be written as JSON ({type(why).__name__}: {format_value(str(why))})."
            request, answer = {"call": format_value(name), "arguments": None}, Answer(False, {"error": said})
            self.log.append({**request, "ok": False, "answer": answer.data, "made": False})
            return answer
        answer = self._game.calls.call(request["call"], request["arguments"])
        self.log.append({**request, "ok": answer.ok, "answer": jsonable(answer.data)})
        return answer

    def _refused(self) -> Answer:
        self._after += 1
        if self._left or self._after > AFTER:
            self.trouble("calls after the end")
            raise Left
        calls = len(self.log)
        why = f"{calls} calls are made, and a game has no more." if calls >= self.limits.most else "this game is over."
        return Answer(False, {"error": why})

    def trouble(self, what: str) -> None:
        """Count what the player does wrong beside its calls; the end of the game reports it."""
        self.troubles[what] += 1

    def spent(self, tokens: Any) -> None:
        """Count the tokens that the player states; anything else than a number does not count."""
        if isinstance(tokens, bool) or not isinstance(tokens, int) or not 0 <= tokens < TOKENS:
            self.trouble("tokens that are no whole number, and are not counted")
        else:
            self.tokens += tokens

    # --- for the loop ---

    def find_time_left(self) -> float:
        """Return the seconds until the player may be out of time."""
        since = self._since
        if since is None:
            return min(self.limits.patience, 1.0)
        gone = monotonic() - since
        return max(min(self.limits.patience - gone, self.limits.time - self._thought - gone), 1e-3)

    def late(self) -> str:
        """Why the player has taken too long; "" if it has not."""
        since = self._since
        if since is None:
            return ""
        gone = monotonic() - since
        if gone >= self.limits.patience:
            return f"timed out: no call for {self.limits.patience:g} s"
        if self._thought + gone >= self.limits.time:
            return f"timed out: its calls took {self.limits.time:g} s in all"
        return ""

    def leave(self, why: str) -> None:
        """End the game for the player, unless it is over already."""
        with self._lock:
            if not self.over:
                self.ended = why
            self._left = True


def jsonable(value: Any) -> Any:
    """Return a value as it comes back from a JSON file."""
    return json.loads(json.dumps(value, default=repr))
