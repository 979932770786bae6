r"""`SerialScript`: the other end of a serial line, as a file of commands in simulated time.

    expect "Grbl 1.1h"        wait until the firmware sends this text
    send $H                   send the rest of the line and a line feed
    timeout 30                simulated seconds that the next `expect` waits at most (default: 5)
    expect ok
    send "\x18"                send a quoted text as it is, with the escapes of Python
    wait 500ms                let simulated time pass
    at 12.5                   wait until this time of the run

A script that ends with `send` is over when the firmware has received the last byte.

Each `expect` searches in the bytes that the firmware has sent since the end of the last match. Every run is the same, bit for bit.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

from stage.board.bus.serial_core import LINE_BUFFER_SIZE, NO_BYTE
from stage.board.errors import HostError
from stage.board.serial_line import POLL_NS, SerialEnd, describe_last_bytes, to_bytes
from stage.errors import ArgumentError
from stage.support.files import FileError
from stage.support.foreign_files import read_text
from stage.units import OTHER_FACTORS, parse_quantity

TIMEOUT_S = 5.0
MAX_BYTES = 1 << 24
COMMANDS = ("send", "expect", "wait", "at", "timeout")


@dataclass(frozen=True)
class ScriptCommand:
    """One command of a serial script: send, expect, wait, at or timeout.

    Attributes:
        line: Number of its line in the file.
        name: One of COMMANDS.
        text: Bytes of send and expect.
        ns: Time of wait, at and timeout, ns.
    """

    line: int
    name: str
    text: bytes = b""
    ns: int = 0


def read_script(path: str | os.PathLike) -> SerialScript:
    """Read a script from a file.

    Raises:
        ArgumentError: A line is no command, or there is nothing to do.
        FileError: The file cannot be read.
    """
    name = Path(path).name
    text = read_text(path, "serial script", MAX_BYTES, FileError)
    lines = [parse_command(name, k, line) for k, line in enumerate(text.splitlines(), 1)]
    commands = [command for command in lines if command is not None]
    if all(command.name == "timeout" for command in commands):
        raise ArgumentError(f"{name}: this script does nothing. Write send, expect, wait or at; docs/serial.md.")
    return SerialScript(name, commands)


def parse_command(name: str, number: int, line: str) -> ScriptCommand | None:
    """Parse a line of a serial script; return None for an empty line or a comment.

    Args:
        name: Name of the script, for errors.
        number: Number of the line.
        line: The line.

    Raises:
        ArgumentError: The line is no command.
    """
    word, _, rest = line.strip().partition(" ")
    rest = rest.strip()
    if not word or word.startswith("#"):
        return None
    if word not in COMMANDS:
        raise ArgumentError(
            f"{name}:{number}: {word!r} is no command of a serial script; known are {', '.join(COMMANDS)}."
        )
    if word in ("send", "expect"):
        return ScriptCommand(number, word, text=_parse_text(f"{name}:{number}", word, rest))
    seconds = parse_quantity(rest, {"": 1.0} | OTHER_FACTORS["time"])
    if seconds is None or not 0 <= seconds < 1e9:
        raise ArgumentError(
            f"{name}:{number}: {line.strip()!r}: a simulated time is wanted, for example {word} 0.5 or {word} 500ms."
        )
    return ScriptCommand(number, word, ns=round(seconds * 1e9))


def _parse_text(place: str, word: str, rest: str) -> bytes:
    """Return the bytes of a text in a serial script, which may be quoted."""
    if rest[:1] not in ('"', "'"):
        if not rest and word == "expect":
            raise ArgumentError(f"{place}: what is expected? For example: expect ok")
        return to_bytes(rest + "\n" if word == "send" else rest, place)
    try:
        text = ast.literal_eval(rest)
    except (SyntaxError, ValueError):
        text = None
    if not isinstance(text, str) or (not text and word == "expect"):
        raise ArgumentError(
            f'{place}: {rest}: a text in quotes with the escapes of Python is wanted, for example "G0 X10\\n".'
        )
    return to_bytes(text, place)


def format_script(arrivals: list[tuple[int, bytes]], duration: int) -> str:
    """Return a script that sends the same bytes at the same times as another end of a serial line did.

    Args:
        arrivals: `SerialPort.arrivals` of the run.
        duration: Duration of the run, ns.
    """
    lines = ["# What came in over the serial line; stage run --serial-script plays it."]
    for now, content in arrivals:
        lines += [f"at {now * 1e-9:.9f}", f"send {content.decode('latin-1')!a}"]
    return "\n".join([*lines, f"at {duration * 1e-9:.9f}", ""])


class SerialScript(SerialEnd):
    """Other end of a serial line that executes the commands of a script.

    Args:
        name: Name of the script, for errors.
        commands: The commands, one or more.

    Attributes:
        is_over: Whether all commands have been executed, and the firmware has received what the last one sends.
        ends_with_send: Whether the last command is `send`.
    """

    is_over = False

    def __init__(self, name: str, commands: list[ScriptCommand]):
        self._name, self._unread = name, bytearray()
        self._due: int | None = None
        self._expected = b""
        self._begin: int | None = None
        self._room = LINE_BUFFER_SIZE
        self._command = commands[0]
        self.ends_with_send = commands[-1].name == "send"
        self._steps = self._execute(commands)

    @property
    def pausing_byte(self) -> int:
        """Last byte of the text that the present `expect` waits for, or NO_BYTE."""
        return self._expected[-1] if self._expected else NO_BYTE

    def exchange(self, sent: bytes, now: int, room: int) -> bytes:
        """Execute commands up to the time `now` (ns), and return what they send.

        Raises:
            HostError: The firmware has not sent in time what is expected, or the time of `at` has passed.
        """
        self._unread += sent
        self._begin = now if self._begin is None else self._begin
        self._now, self._room = now, room
        outgoing = b""
        while not self.is_over:
            step = next(self._steps, None)
            if step is None:
                self.is_over = True
            elif not step:
                break
            else:
                outgoing += step
                self._room -= len(step)
        return outgoing

    def choose_next_exchange(self, now: int) -> int | None:
        """Return the time (ns) at which a wait ends or an `expect` fails, now if the script is over, or None."""
        return now if self.is_over else self._due

    def describe_awaited_event(self) -> str:
        """Describe in words the event for which the script still waits."""
        if self._command.name == "send":
            return f"the firmware has not received {LINE_BUFFER_SIZE - self._room:,} of its bytes"
        return f"line {self._command.line} waits"

    def close(self) -> None:
        """Do nothing, because a script opens nothing."""

    def _execute(self, commands: list[ScriptCommand]) -> Generator[bytes, None, None]:
        """Execute the commands one after the other; yield the bytes that they send, or no bytes while they wait."""
        timeout = round(TIMEOUT_S * 1e9)
        for command in commands:
            self._command = command
            if command.name == "send":
                while self._room <= 0:
                    yield from self._wait_until(self._now + POLL_NS)
                yield command.text
            elif command.name == "timeout":
                timeout = command.ns
            elif command.name == "expect":
                yield from self._expect(command, self._now + timeout, timeout)
            else:
                due = command.ns + (self._now if command.name == "wait" else self._begin or 0)
                if self._now > due + POLL_NS:
                    raise HostError(
                        f"{self._name}:{command.line}: at {command.ns * 1e-9:g} comes too late, at "
                        f"{(self._now - (self._begin or 0)) * 1e-9:g} s of the run. Use wait, or give a later time."
                    )
                yield from self._wait_until(due)
        while self.ends_with_send and self._room < LINE_BUFFER_SIZE:
            yield from self._wait_until(self._now + POLL_NS)

    def _wait_until(self, due: int) -> Generator[bytes, None, None]:
        """Yield no bytes until the time `due` (ns)."""
        self._due = due
        while self._now < due:
            yield b""
        self._due = None

    def _expect(self, command: ScriptCommand, deadline: int, timeout: int) -> Generator[bytes, None, None]:
        """Wait until the firmware has sent the text of an `expect`; yield no bytes meanwhile. Raises HostError at the deadline."""
        self._expected, self._due = command.text, deadline
        while (at := self._unread.find(command.text)) < 0:
            if self._now >= deadline:
                raise HostError(
                    f"{self._name}:{command.line}: the firmware has not sent {command.text.decode('latin-1')!r} within "
                    f"{timeout * 1e-9:g} s. {describe_last_bytes(bytes(self._unread))}"
                )
            yield b""
        del self._unread[: at + len(command.text)]
        self._expected, self._due = b"", None
