"""A controller for G-code senders: a pseudo-terminal that controls a stage with three axes, chips, motors and switches.

python scripts/gcode_controller.py --chips mcx304

It prints the name of its terminal. Open that with a sender, or with `picocom /dev/pts/5`. Each line has one command. The reply is
`ok`, or a line that begins with `error:`. The `ok` of a move comes when the move has ended.
"""

from __future__ import annotations

import argparse
import os
import re
import tty
from collections.abc import Callable
from contextlib import suppress

from stage import Stage, StageError, firmware

MAX_LINE_LENGTH = 256
WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))?")
FASTEST = 50.0  # mm/s, of G0
HELP = "G0 and G1 (X Y Z in mm, F in mm/min), G4 (P ms, S s), G28, G90, G91, G92, M114, M119"


class Refused(Exception):
    """Error whose text the sender reads after `error:`."""


class Controller:
    """Interpreter of G-code that moves a stage. Positions are mm from the origins of G28 or G92; the stage uses meters.

    Args:
        stage: Stage to control.
    """

    def __init__(self, stage: Stage):
        self.stage = stage
        self.letters = {name.upper(): axis for name, axis in stage.axes.items()}
        self.zero = {letter: axis.commanded * 1e3 for letter, axis in self.letters.items()}
        self.relative, self.feed = False, 1000.0
        self.does: dict[str, Callable[[dict[str, float | None]], list[str]]] = {
            "G0": self.move, "G1": self.move, "G4": self.dwell, "G28": self.home, "G90": self.use_absolute_positions,
            "G91": self.use_relative_positions, "G92": self.set_position,
            "M114": self.report_positions, "M119": self.report_switches,
        }  # fmt: skip

    def answer(self, line: str) -> list[str]:
        """Execute a line, and return the lines of the reply."""
        text = re.sub(r"\(.*?\)|;.*|\*.*|^\s*N\d+", "", line.upper()).strip()
        if not text:
            return ["ok"]
        try:
            if len(line) > MAX_LINE_LENGTH:
                raise Refused(f"a line of {len(line)} characters; there are up to {MAX_LINE_LENGTH}")
            command, words = parse_line(text)
            if command not in self.does:
                raise Refused(f"{command} is not known here; there are {HELP}")
            return [*self.does[command](words | {"": float(command == "G0")}), "ok"]
        except (Refused, StageError) as error:
            return [f"error: {' '.join(str(error).split())}"]

    def get_position_mm(self, letter: str) -> float:
        """Return the position of an axis, given by its letter, mm."""
        return self.letters[letter].commanded * 1e3 - self.zero[letter]

    def move(self, words: dict[str, float | None]) -> list[str]:
        """Execute G0 (as fast as possible) or G1 (with the feed rate, along a straight line)."""
        rapid = words.pop("")
        feed = get_number(words, "F", self.feed)
        if feed <= 0:
            raise Refused(f"F{feed:g}: a feed is more than 0 mm/min")
        millimetres = {}
        for letter in self.list_named_axes(words, "F"):
            to = get_number(words, letter)
            millimetres[letter] = to if self.relative else to - self.get_position_mm(letter)
        self.feed = feed
        distances = {k: d for k, d in millimetres.items() if abs(d * 1e-3) >= self.letters[k].meters_per_pulse / 2}
        if not distances:
            return []
        length = sum(d * d for d in distances.values()) ** 0.5
        max_seconds = max(abs(d) for d in distances.values())
        speed = FASTEST if rapid else min(feed / 60 * max_seconds / length, FASTEST)
        axes = {self.letters[letter].name: d * 1e-3 for letter, d in distances.items()}
        if len(axes) == 1:
            ((name, distance),) = axes.items()
            reports = [firmware.move(self.stage.axes[name], distance, speed=speed * 1e-3)]
        else:
            reports = list(firmware.line(axes, self.stage.axes, speed=speed * 1e-3).axes.values())
        for report in reports:
            if not report.ok:
                raise Refused(
                    f"{report.axis.upper()} was stopped by {report.stopped_by}, lost steps: {report.lost_steps}"
                )
        return []

    def home(self, words: dict[str, float | None]) -> list[str]:
        """Execute G28: find the origins of the axes that the line names, or of all axes, one after the other."""
        words.pop("")
        for letter in self.list_named_axes(words) or list(self.letters):
            report = firmware.home(self.letters[letter])
            if report.stopped_by != "ORG":
                raise Refused(f"{letter} has found no origin: stopped by {report.stopped_by}")
            self.zero[letter] = self.letters[letter].commanded * 1e3
        return []

    def dwell(self, words: dict[str, float | None]) -> list[str]:
        """Execute G4: wait."""
        seconds = get_number(words, "P", 0.0) * 1e-3 + get_number(words, "S", 0.0)
        if not 0 <= seconds <= 3600:
            raise Refused(f"a dwell of {seconds:g} s; there are 0 to 3600 s")
        self.stage.run(seconds)
        return []

    def use_absolute_positions(self, words: dict[str, float | None]) -> list[str]:
        """Execute G90."""
        self.relative = False
        return []

    def use_relative_positions(self, words: dict[str, float | None]) -> list[str]:
        """Execute G91."""
        self.relative = True
        return []

    def set_position(self, words: dict[str, float | None]) -> list[str]:
        """Execute G92: define the present position."""
        words.pop("")
        for letter in self.list_named_axes(words):
            self.zero[letter] = self.letters[letter].commanded * 1e3 - get_number(words, letter)
        return []

    def report_positions(self, words: dict[str, float | None]) -> list[str]:
        """Execute M114."""
        return [" ".join(f"{letter}:{self.get_position_mm(letter) + 0.0:.3f}" for letter in self.letters)]

    def report_switches(self, words: dict[str, float | None]) -> list[str]:
        """Execute M119."""
        both = [(letter, axis.switches.as_dict()) for letter, axis in self.letters.items()]
        return [f"{x.lower()}_{name}: {'TRIGGERED' if on else 'open'}" for x, all_ in both for name, on in all_.items()]

    def list_named_axes(self, words: dict[str, float | None], others: str = "") -> list[str]:
        """List the letters of the axes that a line names. Raises Refused for other words.

        Args:
            words: Numbers by letter.
            others: Letters that are also allowed.
        """
        for letter in words:
            if letter not in self.letters and letter not in others:
                raise Refused(f"{letter} is no axis here; there are {', '.join(self.letters)}")
        return [letter for letter in words if letter in self.letters]


def parse_line(text: str) -> tuple[str, dict[str, float | None]]:
    """Parse a line into its command and a mapping of its other words."""
    tokens, left = WORD.findall(text), WORD.sub("", text).strip()
    if left or not tokens or tokens[0][0] not in "GM" or not tokens[0][1]:
        raise Refused(f"{text!r} is no command")
    words = {letter: float(value) if value else None for letter, value in tokens[1:]}
    if len(words) < len(tokens) - 1:
        raise Refused(f"{text!r}: a letter comes twice")
    return f"{tokens[0][0]}{float(tokens[0][1]):g}", words


def get_number(words: dict[str, float | None], letter: str, usual: float | None = None) -> float:
    """Return the number of a word. Raises Refused if it is missing and there is no default.

    Args:
        words: Numbers by letter.
        letter: Letter of the word.
        usual: Default.
    """
    value = words.get(letter, usual)
    if value is None:
        raise Refused(f"{letter} without a number")
    return value


def serve(controller: Controller, master: int) -> None:
    """Answer lines from a terminal until it is closed."""
    came = b""
    while more := os.read(master, 4096):
        *lines, came = re.split(rb"\r\n|\r|\n", (came + more)[-65536:])
        for line in lines:
            for reply in controller.answer(line.decode(errors="replace")):
                os.write(master, f"{reply}\r\n".encode())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="xyz", help="a shipped model, or an MJCF file (default: xyz)")
    parser.add_argument("--chips", default="pcl240k", help="chip on every axis (default: pcl240k)")
    args = parser.parse_args()
    controller = Controller(Stage(args.model, chips=args.chips, visuals=False))
    master, slave = os.openpty()
    tty.setraw(slave)  # no echo; this end stays open, so that senders may come and go
    print(f"{os.ttyname(slave)}: {HELP}; Ctrl-C ends it", flush=True)
    with suppress(KeyboardInterrupt):
        serve(controller, master)


if __name__ == "__main__":
    main()
