"""Interface between a game and its player: the tools, the log of calls, and limits of calls and time."""

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
from stage.agents.tool_arguments import format_value
from stage.errors import ArgumentError

MAX_CALLS, PATIENCE_S, TIME_S = 400, 600.0, 3600.0
MAX_CALLS_AFTER_END = 20  # refused calls after the end of a game; the next one ends the player by an exception
MAX_TOKENS = 1 << 40  # of one reply


@dataclass(frozen=True)
class Limits:
    """Limits of a game. The time of the simulation does not count as the player's.

    Attributes:
        max_calls: Number of calls.
        patience: Real seconds that a player may take for its next call.
        time: Real seconds that a player may take for all calls of a game.

    Raises:
        ArgumentError: A limit is not a positive number.
    """

    max_calls: int = MAX_CALLS
    patience: float = PATIENCE_S
    time: float = TIME_S

    def __post_init__(self) -> None:
        if isinstance(self.max_calls, bool) or not isinstance(self.max_calls, int) or not self.max_calls >= 1:
            raise ArgumentError(f"most={format_value(self.max_calls)}: a whole number of calls, 1 or more.")
        for name in ("patience", "time"):
            s = getattr(self, name)
            if isinstance(s, bool) or not isinstance(s, int | float) or not 0 < s < math.inf:
                raise ArgumentError(f"{name}={format_value(s)}: seconds, more than 0.")


class CallAfterGameEnd(BaseException):
    """Exception that ends a player which continues to make calls after its game is over."""


class GameSession:
    """Interface through which a player plays a game.

    Attributes:
        task: Goal of the game, in words.
        name: Name of the game.
        limits: Limits of calls and time.
        tokens: Number of tokens that the player has stated.
        log: Calls so far, each with its arguments and its answer.
        tools_without_log: The tools themselves; calls made through them are not logged.
        trouble_counts: Mistakes of the player outside calls, in words, and how often each occurred.
        end_reason: Reason for which the game was ended for the player; "" if it was not.
    """

    def __init__(self, game: Game, limits: Limits | None = None):
        self._game, self.limits, self.task, self.name = game, limits or Limits(), game.task, game.name
        self.tools_without_log = game.calls
        self.tokens = 0
        self.log: list[dict[str, Any]] = []
        self.trouble_counts: Counter[str] = Counter()
        self.end_reason = ""
        self._lock, self._calls_after_end, self._is_ended = threading.Lock(), 0, False
        self._thinking_since: float | None = monotonic()  # the player thinks since then; None: a call is being made
        self._thinking_s = 0.0

    @property
    def tools(self) -> list[dict[str, Any]]:
        """Tools as most interfaces of language models take them: name, description, parameters."""
        return [
            {"name": t.name, "description": t.text, "parameters": t.schema()} for t in self._game.calls.tools.values()
        ]

    @property
    def over(self) -> bool:
        """True if no further call is possible: the game is over, or the player has used up its calls or its time."""
        return self._is_ended or self._game.over or len(self.log) >= self.limits.max_calls

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Make a call and return its answer. A refused call has an answer, too.

        Args:
            name: Name of the tool.
            arguments: Arguments, as the player gives them.

        Raises:
            CallAfterGameEnd: The player goes on although the game is over.
        """
        with self._lock:
            self._thinking_s += monotonic() - (self._thinking_since or monotonic())
            self._thinking_since = None
            try:
                return self._call(name, arguments)
            finally:
                self._thinking_since = monotonic()

    def _call(self, name: Any, arguments: Any) -> Answer:
        """Make a call, add it to the log, and return its answer; a player beyond its limits ends its game."""
        if self.over:
            return self._refuse_call()
        try:
            request = round_trip_json({"call": name, "arguments": arguments})
        except (TypeError, ValueError, RecursionError) as why:
            self.count_trouble("arguments that are no JSON")
            message = f"the arguments cannot be written as JSON ({type(why).__name__}: {format_value(str(why))})."
            request, answer = {"call": format_value(name), "arguments": None}, Answer(False, {"error": message})
            self.log.append({**request, "ok": False, "answer": answer.data, "made": False})
            return answer
        answer = self._game.calls.call(request["call"], request["arguments"])
        self.log.append({**request, "ok": answer.ok, "answer": round_trip_json(answer.data)})
        return answer

    def _refuse_call(self) -> Answer:
        """Return the answer to a call after the end; raise CallAfterGameEnd if there are too many."""
        self._calls_after_end += 1
        if self._is_ended or self._calls_after_end > MAX_CALLS_AFTER_END:
            self.count_trouble("calls after the end")
            raise CallAfterGameEnd
        calls = len(self.log)
        why = (
            f"{calls} calls are made, and a game has no more."
            if calls >= self.limits.max_calls
            else "this game is over."
        )
        return Answer(False, {"error": why})

    def count_trouble(self, what: str) -> None:
        """Count a mistake of the player outside its calls, such as an invalid line; the result of the game has the counts."""
        self.trouble_counts[what] += 1

    def count_tokens(self, tokens: Any) -> None:
        """Add a number of tokens that the player states; anything but an integer counts as a trouble."""
        if isinstance(tokens, bool) or not isinstance(tokens, int) or not 0 <= tokens < MAX_TOKENS:
            self.count_trouble("tokens that are no whole number, and are not counted")
        else:
            self.tokens += tokens

    # --- for the loop ---

    def compute_time_left(self) -> float:
        """Return the seconds until the player may have run out of time."""
        since = self._thinking_since
        if since is None:
            return min(self.limits.patience, 1.0)
        elapsed = monotonic() - since
        return max(min(self.limits.patience - elapsed, self.limits.time - self._thinking_s - elapsed), 1e-3)

    def explain_timeout(self) -> str:
        """Return the reason why the player has taken too long, in words; "" if it has not."""
        since = self._thinking_since
        if since is None:
            return ""
        elapsed = monotonic() - since
        if elapsed >= self.limits.patience:
            return f"timed out: no call for {self.limits.patience:g} s"
        if self._thinking_s + elapsed >= self.limits.time:
            return f"timed out: its calls took {self.limits.time:g} s in all"
        return ""

    def end_game(self, why: str) -> None:
        """End the game for the player, unless it is over already.

        Args:
            why: Reason, in words.
        """
        with self._lock:
            if not self.over:
                self.end_reason = why
            self._is_ended = True


def round_trip_json(value: Any) -> Any:
    """Convert a value to JSON and back, so that it equals the value that is read from a transcript."""
    return json.loads(json.dumps(value, default=repr))
