"""Program of a host as text: each line makes bus cycles in the language of the bus console, waits, or polls.

    base x 300h                  port at which the host expects the chip of x; default: its real port
    x: R0 <- 4000                write a register by the bus cycles of a host driver
    x: 84 2: 3A 1: 98            write bytes: to address 0, then to address 2, then to address 1
    x: operate 15h               write a command or word by name
    wait 0.05                    wait, s
    until x stopped 5            poll the status until the drive has ended; the host gives up after 5 s
    until x RR1.DSND 1 2         poll a bit of a status word until it is 1; the host gives up after 2 s
    # a remark

If no chip is at the base port, a write has no effect and a read returns FFh.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from stage import Stage
from stage.agents.tool_arguments import choose, parse_integer
from stage.errors import ArgumentError, RunTimeout
from stage.firmware import Axis
from stage.firmware.driver import Driver
from stage.panel.front_panel_content import BusCycle, parse_line

MAX_LINES = 200
MAX_LINE_CHARACTERS = 200
FIRST_PORT, PORTS_PER_CHIP = 0x300, 4  # as on a PCL-240 card
POLL_INTERVAL_S = 5e-4
COMPLETED_TEXT = "the program came to its end"
SAMPLE_INTERVAL_S = 2e-3  # simulated time between two samples of an observer


@dataclass(frozen=True)
class ProgramLine:
    """Line of a program that is not empty and no remark.

    Attributes:
        number: Number of the line in the text, from 1.
        text: Text without the remark.
        execute: Function that executes the line on a host.
    """

    number: int
    text: str
    execute: Callable[[ProgramHost], None]


class ProgramHost:
    """Host that runs programs on a stage.

    Args:
        stage: Stage with the chips.
        get_driver: Function that returns the host driver of an axis by its name.
        sample: Function that is called every few milliseconds of simulated time, for an observer.
    """

    def __init__(self, stage: Stage, get_driver: Callable[[str], Driver], sample: Callable[[], None] | None = None):
        self.stage, self.get_driver, self._sample = stage, get_driver, sample
        self._base: dict[str, int] = {}

    def run(self, lines: Iterable[ProgramLine]) -> dict[str, Any]:
        """Run a program to its end, or until a poll times out.

        Args:
            lines: Lines of the program.

        Returns:
            The values "ended" (COMPLETED_TEXT, or the line and its error), "lines_done" and "time_s".

        Raises:
            StageError: A line failed for another reason than a timeout.
        """
        self._base.clear()
        done = 0
        for line in lines:
            try:
                line.execute(self)
            except RunTimeout as error:
                return {
                    "ended": f"line {line.number}: {error}",
                    "lines_done": done,
                    "time_s": round(self.stage.time, 9),
                }
            done += 1
        return {"ended": COMPLETED_TEXT, "lines_done": done, "time_s": round(self.stage.time, 9)}

    def set_base_port(self, axis: str, port: int) -> None:
        """Set the port at which the host expects the chip of an axis.

        Args:
            axis: Name of the axis.
            port: Number of the port.
        """
        self._base[axis] = port

    def make_bus_cycle(self, axis: str, cycle: BusCycle) -> None:
        """Make a bus cycle at the port at which the host expects the chip of an axis.

        Args:
            axis: Name of the axis.
            cycle: Bus cycle, with its address relative to the base port.
        """
        chip = self.stage.axes[axis].chip
        if axis in self._base:
            k, offset = divmod(self._base[axis] + cycle.address - FIRST_PORT, PORTS_PER_CHIP)
            if not 0 <= k < len(self.stage.chips):
                self.stage.cycle()
                return
            chip, address = self.stage.chips[k], offset
        else:
            address = cycle.address
        if cycle.read:
            chip.read(address)
        else:
            chip.write(address, cycle.datum)

    def wait_until(self, condition: Callable[[], bool], limit: float, description: str) -> None:
        """Poll until a condition is true.

        Args:
            condition: Function that is called at each poll.
            limit: Timeout in simulated seconds.
            description: The condition in words, for the error.

        Raises:
            RunTimeout: The condition was not true in time.
        """
        begun = self.stage.time
        while not condition():
            if self.stage.time - begun >= limit:
                raise RunTimeout(f"{description} did not come within {limit:g} s, and the host gave up.")
            self.stage.run(POLL_INTERVAL_S)
            if self._sample is not None:
                self._sample()

    def wait(self, seconds: float) -> None:
        """Let simulated time pass, and call `sample` meanwhile.

        Args:
            seconds: Simulated time.
        """
        until = self.stage.time + seconds
        while self._sample is not None and self.stage.time + SAMPLE_INTERVAL_S < until:
            self.stage.run(SAMPLE_INTERVAL_S)
            self._sample()
        self.stage.run(max(until - self.stage.time, 0.0))

    def find_answering_axis(self, axis: str) -> Axis:
        """Return the axis whose chip is at the port at which the host expects the chip of `axis`.

        Args:
            axis: Name of the axis.

        Raises:
            RunTimeout: No chip is at the port, so a poll never ends.
        """
        if axis not in self._base:
            return self.stage.axes[axis]
        k = (self._base[axis] - FIRST_PORT) // PORTS_PER_CHIP
        found = [
            a for a in self.stage.axes.values() if 0 <= k < len(self.stage.chips) and a.chip is self.stage.chips[k]
        ]
        if not found:
            raise RunTimeout(f"port {self._base[axis]:X}h answers FFh for ever: no chip is there.")
        return found[0]


def parse_program(text: str, stage: Stage) -> list[ProgramLine]:
    """Parse a program.

    Args:
        text: Text of the program.
        stage: Stage with the axes that the program names.

    Returns:
        Its lines without empty ones and remarks.

    Raises:
        ArgumentError: A line cannot be read; the message has its number.
    """
    if len(text) > MAX_LINES * MAX_LINE_CHARACTERS or text.count("\n") >= MAX_LINES:
        raise ArgumentError(
            f"a program of {text.count(chr(10)) + 1} lines: up to {MAX_LINES}, each of {MAX_LINE_CHARACTERS} characters."
        )
    lines = []
    for number, raw in enumerate(text.split("\n"), 1):
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        try:
            lines.append(ProgramLine(number, line, _parse_line(line, stage)))
        except (ArgumentError, NotImplementedError) as error:
            raise ArgumentError(f"line {number}, {line[:60]!r}: {error}") from None
    return lines


def _parse_line(line: str, stage: Stage) -> Callable[[ProgramHost], None]:
    """Parse one line of a program, and return the function that executes it on a host."""
    word, _, rest = line.partition(" ")
    if word == "wait":
        seconds = _parse_seconds(rest)
        return lambda host: host.wait(seconds)
    if word == "base":
        axis, _, port = rest.partition(" ")
        name, number = choose("axis", axis, tuple(stage.axes)), parse_integer("port", port)
        return lambda host: host.set_base_port(name, number)
    if word == "until":
        return _parse_until(rest.split(), stage)
    if ":" not in line:
        raise ArgumentError(
            "a line begins with an axis and a colon, or with wait, until or base, as in `x: operate 15h`."
        )
    axis, _, order = line.partition(":")
    name = choose("axis", axis.strip(), tuple(stage.axes))
    cycles = _parse_cycles(stage.axes[name], order.strip())

    def send(host: ProgramHost) -> None:
        for cycle in cycles:
            host.make_bus_cycle(name, cycle)

    return send


def _parse_cycles(axis: Axis, text: str) -> tuple[BusCycle, ...]:
    """Parse the text after the colon: an order of the bus console, or bytes with addresses."""
    kind = type(axis.chip)
    if re.fullmatch(r"[0-9a-fA-F]{1,4}( [0-3]: ?[0-9a-fA-F]{1,4})+", text):
        first, *others = re.split(r" (?=[0-3]:)", text)
        pairs = [("0", first), *(o.split(":") for o in others)]
        return tuple(BusCycle(False, int(a, 16), int(d, 16)) for a, d in pairs)
    if "." in text.partition("<-")[0] and "<-" in text:
        raise ArgumentError("Write the whole register: a program must know its other bits.")
    return parse_line(kind, text, axis.chip_axis).cycles


def _parse_until(words: list[str], stage: Stage) -> Callable[[ProgramHost], None]:
    """Parse a line `until ...`, and return the function that polls."""
    usage = "as in `until x stopped 5` or `until x RR1.DSND 1 2`"
    if not words:
        raise ArgumentError(f"until: {usage}.")
    name = choose("axis", words[0], tuple(stage.axes))
    axis = stage.axes[name]
    if len(words) == 3 and words[1] == "stopped":
        limit = _parse_seconds(words[2])

        def wait_until_stopped(host: ProgramHost) -> None:
            answers = host.find_answering_axis(name)
            host.wait_until(lambda: not answers.chip.busy(answers.chip_axis), limit, "the end of the drive")

        return wait_until_stopped
    if len(words) != 4 or "." not in words[1] or words[2] not in ("0", "1"):
        raise ArgumentError(f"until {' '.join(words)}: {usage}.")
    where, _, bit = words[1].partition(".")
    field = axis.chip.MAP.field(where, bit)
    wanted, limit = int(words[2]), _parse_seconds(words[3])

    def wait_until_bit(host: ProgramHost) -> None:
        driver = host.get_driver(host.find_answering_axis(name).name)
        host.wait_until(
            lambda: bool(field.extract(driver.read_status_words()[where])) == bool(wanted),
            limit,
            f"{words[1]} = {wanted}",
        )

    if where not in _list_status_words(axis):
        raise ArgumentError(f"{where} is no status word that is polled here: {', '.join(_list_status_words(axis))}.")
    return wait_until_bit


def _list_status_words(axis: Axis) -> tuple[str, ...]:
    """List the names of the status words of an axis' chip."""
    from stage.firmware.driver import get_driver

    replica = _UnobservedAxis(axis)
    return tuple(get_driver(replica).read_status_words())  # type: ignore[arg-type]


class _UnobservedAxis:
    """Axis with a replica of the chip, on which a host driver can read status words without bus cycles on the stage."""

    def __init__(self, axis: Axis):
        self.name, self.chip, self.chip_axis = axis.name, axis.chip.make_replica(), axis.chip_axis


def _parse_seconds(text: str) -> float:
    """Parse a number of seconds. Raises ArgumentError."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 60:
        raise ArgumentError(f"{text.strip()!r}: seconds, 0 to 60.")
    return value
