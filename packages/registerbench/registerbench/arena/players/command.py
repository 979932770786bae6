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
import os
import queue
import shlex
import signal
import subprocess
import threading
from collections.abc import Sequence
from typing import Any

from registerbench.arena.scores import FAILED
from registerbench.arena.table import Table
from stage.errors import ArgumentError, StageError
from stage.support.foreign_files import DocumentError, parse_json

LONG = 1 << 20  # characters of a line
WRONG = 20  # lines that are no calls, after which the game is ended
END = 2.0  # s in which a process that has closed its output ends
AHEAD = 100  # lines that are read before they are answered


class Command:
    """command: as a shell would split it, or in parts; no shell is called. Raises ArgumentError."""

    def __init__(self, command: str | Sequence[str]):
        try:
            self.words = shlex.split(command) if isinstance(command, str) else list(command)
        except ValueError as why:
            raise ArgumentError(f"the command {command!r} cannot be read: {why}. Close its quotes.") from None
        if not self.words:
            raise ArgumentError("the command of a player is empty: give a program, for example 'python agent.py'.")
        self.name = self.words[-1] if len(self.words) == 1 else " ".join(self.words)
        self._process: Any = None

    def __call__(self, table: Table) -> None:
        """Play. Raises StageError where the command cannot be started."""
        try:
            process = self._process = subprocess.Popen(
                self.words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8", errors="replace",
                start_new_session=True,
            )  # fmt: skip
        except (OSError, ValueError) as why:
            message = getattr(why, "strerror", None) or why
            raise StageError(f"{self.words[0]}: {message}. Name a program that can be run.") from why
        lines, gone = queue.Queue[str](AHEAD), threading.Event()
        threading.Thread(target=_read, args=(process.stdout, lines, gone), daemon=True).start()
        try:
            if not self._play(table, process, lines):
                _note_end(table, process)
        finally:
            gone.set()
            self._kill(process)
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]

    def stop(self) -> None:
        """End the command, from another thread: the game is over."""
        self._kill(self._process)

    def _kill(self, process: Any) -> None:
        """Kill the command and the processes that it has started."""
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)

    def _play(self, table: Table, process: Any, lines: queue.Queue[str]) -> bool:
        """Play until the game ends, and return whether the command played on to the end."""

        def say(what: dict[str, Any]) -> None:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it reads no more
                process.stdin.write(json.dumps(what) + "\n")
                process.stdin.flush()

        say({"task": table.task, "tools": table.tools})
        wrong = 0
        while not table.over:
            line = lines.get()
            if not line:
                return False
            message = _parsed(line)
            if isinstance(message, str):
                table.trouble("a line that is no call")
                wrong += 1
                if wrong == WRONG:
                    table.leave(f"{FAILED}: {WRONG} lines that are no calls")
                say({"ok": False, "answer": {"error": message}, "over": table.over})
                continue
            if "tokens" in message:
                table.spent(message["tokens"])
            if message.get("done"):
                return True
            answer = table.call(message["call"], message.get("arguments"))
            say({"ok": answer.ok, "answer": answer.data, "over": table.over})
        return True


def _note_end(table: Table, process: Any) -> None:
    """It has ended by itself: which is good after its last call, and else is not."""
    if table.over:
        return
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=END)
    code = process.returncode
    if code:
        table.leave(f"{FAILED}: the command ended with exit code {code}")
    elif not table.log:
        table.trouble("the command ended without a call")


def _read(stream: Any, lines: queue.Queue[str], gone: threading.Event) -> None:
    """All lines, and "" at the end; no more than are asked for."""

    def put(line: str) -> None:
        while not gone.is_set():
            with contextlib.suppress(queue.Full):
                lines.put(line, timeout=0.2)
                return

    with contextlib.suppress(OSError, ValueError):
        while not gone.is_set() and (line := stream.readline(LONG)):
            put(line)
    put("")


def _parsed(line: str) -> dict[str, Any] | str:
    """Parse a line, or say what is wrong with it."""
    try:
        message = parse_json(line)
    except DocumentError as why:
        return f'a line of JSON is expected, {{"call": NAME, "arguments": {{...}}}}: {why}.'
    if not isinstance(message, dict) or not ("call" in message or message.get("done")):
        return 'a line has "call" and "arguments", or "done": true.'
    return message
