"""A player that is a command: a process in any language that reads and writes lines of JSON. Each game starts a new process.

it reads    {"task": "...", "name": "...", "tools": [{"name", "description", "parameters"}, ...]}
it writes   {"call": "act", "arguments": {...}}                 one call a line; "tokens": N may stand beside it
it reads    {"ok": true, "answer": {...}, "over": false}
it writes   {"done": true, "tokens": N}, or ends; {"failed": WHY} ends the game, and {"stopped": WHY} the whole run

docs/agents.md shows a player of ten lines.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import Any

from registerbench.arena.game_session import GameSession
from registerbench.arena.suite_results import FAILED
from stage.errors import ArgumentError, StageError
from stage.support.foreign_files import DocumentError, parse_json

MAX_LINE_LENGTH = 1 << 20  # characters of a line
MAX_INVALID_LINES = 20  # lines that are no calls, after which the game is ended
EXIT_TIMEOUT_S = 2.0  # s in which a process that has closed its output ends
MAX_REASON_LENGTH = 300  # characters of what a player states about its failure
READ_AHEAD_LINES = 100  # lines that are read before they are answered


class CommandPlayer:
    """Player that starts a command for each game.

    Args:
        command: Words of the command, or one string that is split as a shell would do; no shell is started.

    Raises:
        ArgumentError: The command is empty or has an open quote.
    """

    def __init__(self, command: str | Sequence[str]):
        try:
            self.words = shlex.split(command) if isinstance(command, str) else list(command)
        except ValueError as why:
            raise ArgumentError(f"the command {command!r} cannot be read: {why}. Close its quotes.") from None
        if not self.words:
            raise ArgumentError("the command of a player is empty: give a program, for example 'python agent.py'.")
        self.name = self.words[-1] if len(self.words) == 1 else " ".join(self.words)
        self._process: Any = None

    def __call__(self, session: GameSession) -> None:
        """Play a game. Raises StageError if the command cannot be started."""
        try:
            process = self._process = subprocess.Popen(
                self.words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8", errors="replace",
                start_new_session=True,
            )  # fmt: skip
        except (OSError, ValueError) as why:
            message = getattr(why, "strerror", None) or why
            raise StageError(f"{self.words[0]}: {message}. Name a program that can be run.") from why
        lines, gone = queue.Queue[str](READ_AHEAD_LINES), threading.Event()
        threading.Thread(target=_read_lines, args=(process.stdout, lines, gone), daemon=True).start()
        try:
            if not self._play(session, process, lines):
                _handle_early_exit(session, process)
        finally:
            gone.set()
            self._kill(process)
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]

    def stop(self) -> None:
        """End the command because its game is over. Another thread may call this method."""
        self._kill(self._process)

    def _kill(self, process: Any) -> None:
        """Kill the command and the processes that it has started."""
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)

    def _play(self, session: GameSession, process: Any, lines: queue.Queue[str]) -> bool:
        """Play until the game ends.

        Args:
            session: Session of the game.
            process: Process of the command.
            lines: Lines that the command has written.

        Returns:
            Whether the command played to the end of the game.
        """

        def send(what: dict[str, Any]) -> None:
            """Write a message to the command as a line of JSON."""
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it reads no more
                process.stdin.write(json.dumps(what) + "\n")
                process.stdin.flush()

        send({"task": session.task, "name": session.name, "tools": session.tools})
        invalid_lines = 0
        while not session.over:
            line = lines.get()
            if not line:
                return False
            message = _parse_message(line)
            if isinstance(message, str):
                session.count_trouble("a line that is no call")
                invalid_lines += 1
                if invalid_lines == MAX_INVALID_LINES:
                    session.end_game(f"{FAILED}: {MAX_INVALID_LINES} lines that are no calls")
                send({"ok": False, "answer": {"error": message}, "over": session.over})
                continue
            if "tokens" in message:
                session.count_tokens(message["tokens"])
            if "stopped" in message:
                raise StageError(str(message["stopped"])[:MAX_REASON_LENGTH])
            if "failed" in message:
                session.end_game(f"{FAILED}: {str(message['failed'])[:MAX_REASON_LENGTH]}")
                return True
            if message.get("done"):
                return True
            answer = session.call(message["call"], message.get("arguments"))
            send({"ok": answer.ok, "answer": answer.data, "over": session.over})
        return True


class FunctionPlayer(CommandPlayer):
    """Player that is a function of a Python module, in a process of its own for each game.

    In the process of the game, such a function found the broken set-up among the attributes of its session, and knew the causes.

    Args:
        name: Name of the function, as "module:function".

    Raises:
        ArgumentError: There is no such function.
    """

    def __init__(self, name: str):
        super().__init__([sys.executable, "-m", f"{__package__}.function_worker", name, json.dumps(sys.path)])
        self.name = name
        trial = subprocess.run(self.words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        if trial.stdout:
            raise ArgumentError(json.loads(trial.stdout)["refused"])
        if trial.returncode:
            raise ArgumentError(f"player {name}: {trial.stderr.strip().rpartition(chr(10))[2]}")


def _handle_early_exit(session: GameSession, process: Any) -> None:
    """End the game if the command exited with an error before the game was over."""
    if session.over:
        return
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=EXIT_TIMEOUT_S)
    code = process.returncode
    if code:
        session.end_game(f"{FAILED}: the command ended with exit code {code}")
    elif not session.log:
        session.count_trouble("the command ended without a call")


def _read_lines(stream: Any, lines: queue.Queue[str], gone: threading.Event) -> None:
    """Put the lines of a stream into a queue, and "" at its end. Wait while the queue is full, unless nobody reads it.

    Args:
        stream: Output of the command.
        lines: Queue for the lines.
        gone: Event that is set when nobody reads the queue any more.
    """

    def put(line: str) -> None:
        """Put a line into the queue as soon as there is room."""
        while not gone.is_set():
            with contextlib.suppress(queue.Full):
                lines.put(line, timeout=0.2)
                return

    with contextlib.suppress(OSError, ValueError):
        while not gone.is_set() and (line := stream.readline(MAX_LINE_LENGTH)):
            put(line)
    put("")


def _parse_message(line: str) -> dict[str, Any] | str:
    """Parse a line of the command; if it is not a message, return a sentence that says why."""
    try:
        message = parse_json(line)
    except DocumentError as why:
        return f'a line of JSON is expected, {{"call": NAME, "arguments": {{...}}}}: {why}.'
    if not isinstance(message, dict) or not ({"call", "failed", "stopped"} & message.keys() or message.get("done")):
        return 'a line has "call" and "arguments", or "done": true.'
    return message
