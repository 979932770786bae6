"""A player that is a command: a process of any language that reads and writes lines of JSON. One process a game.

it gets     {"task": "...", "tools": [{"name", "description", "parameters"}, ...]}
it writes   {"call": "act", "arguments": {...}}                 one a line; "tokens": N beside it counts what it took
it gets     {"ok": true, "answer": {...}, "over": false}
it writes   {"done": true, "tokens": N}, or ends

docs/agents.md has one of ten lines.
"""

from __future__ import annotations

import contextlib
import json
import queue
import shlex
import subprocess
import threading
from collections.abc import Sequence
from typing import Any

from stage.agents.arena.loop import Table
from stage.errors import ArgumentError, StageError

PATIENCE = 600.0  # s for the next line
LONG = 1 << 20  # characters of a line
WRONG = 20  # lines that are no calls, after which the game is ended


class Command:
    """command: as a shell would split it, or in parts; no shell is called. patience: s for each line."""

    def __init__(self, command: str | Sequence[str], patience: float = PATIENCE):
        self.words = shlex.split(command) if isinstance(command, str) else list(command)
        if not self.words:
            raise ArgumentError("the command of a player is empty: give a program, for example 'python agent.py'.")
        self.name, self.patience = self.words[-1] if len(self.words) == 1 else " ".join(self.words), patience

    def __call__(self, table: Table) -> None:
        """Play. Raises StageError where the command cannot be started, or says nothing for too long."""
        try:
            process = subprocess.Popen(
                self.words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8"
            )
        except OSError as why:
            raise StageError(f"{self.words[0]}: {why.strerror}. Name a program that can be run.") from why
        lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
        try:
            self._play(table, process, lines)
        except (BrokenPipeError, ConnectionResetError):  # it has ended
            pass
        finally:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]

    def _play(self, table: Table, process: Any, lines: queue.Queue[str]) -> None:
        def say(what: dict[str, Any]) -> None:
            process.stdin.write(json.dumps(what) + "\n")
            process.stdin.flush()

        say({"task": table.task, "tools": table.tools})
        wrong = 0
        while not table.over and wrong < WRONG:
            try:
                line = lines.get(timeout=self.patience)
            except queue.Empty:
                raise StageError(f"{self.name}: no line for {self.patience:g} s.") from None
            if not line:
                return
            said = _parsed(line)
            if isinstance(said, str):
                wrong += 1
                say({"ok": False, "answer": {"error": said}, "over": False})
                continue
            table.tokens += _tokens(said)
            if said.get("done"):
                return
            answer = table.call(said["call"], said.get("arguments"))
            say({"ok": answer.ok, "answer": answer.data, "over": table.over})


def _read(stream: Any, lines: queue.Queue[str]) -> None:
    """All lines, and "" at the end."""
    try:
        while line := stream.readline(LONG):
            lines.put(line)
    except (OSError, ValueError):
        pass
    lines.put("")


def _parsed(line: str) -> dict[str, Any] | str:
    """What a line says, or what is wrong with it."""
    try:
        said = json.loads(line)
    except (ValueError, RecursionError) as why:
        return f'a line of JSON is expected, {{"call": NAME, "arguments": {{...}}}}: {why}.'
    if not isinstance(said, dict) or not ("call" in said or said.get("done")):
        return 'a line has "call" and "arguments", or "done": true.'
    return said


def _tokens(said: dict[str, Any]) -> int:
    n = said.get("tokens", 0)
    return n if isinstance(n, int) and not isinstance(n, bool) and 0 <= n < 1 << 40 else 0
