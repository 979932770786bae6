"""A host's program as text: bus cycles in the language of the bus console, waits and polls, a line each.

    base x 300h                  where the host believes that the chip of x is; default where it really is
    x: R0 <- 4000                a register, by the cycles of a driver
    x: 84 2: 3A 1: 98            bytes: to address 0, then one to address 2 and one to address 1
    x: operate 15h               a command or word by name
    wait 0.05                    s
    until x stopped 5            poll the status until the axis does not drive; the host gives up after 5 s
    until x RR1.DSND 1 2         poll a bit of a status word until it is 1; gives up after 2 s
    # a remark

Whoever writes to a base where no chip is writes into the air, and reads FFh there.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from stage import Stage
from stage.agents.arguments import choose, parse_integer
from stage.errors import ArgumentError, RunTimeout
from stage.firmware import Axis
from stage.firmware.driver import Driver
from stage.panel.register_text import BusCycle, parse_line

MAX_LINES = 200  # lines
MAX_LINE_CHARACTERS = 200  # characters of a line
FIRST, STRIDE = 0x300, 4  # the port of the first chip, and from one chip to the next, as on a PCL-240 card
POLL = 5e-4  # s
DONE = "the program came to its end"
SAMPLE_INTERVAL_S = 2e-3  # s between two looks of who watches


@dataclass(frozen=True)
class Line:
    """A line that does something. do: it, on a host."""

    number: int
    text: str
    do: Callable[[Host], None]


class Host:
    """Runs programs on a stage. driver: of an axis by its name; look: called every few milliseconds."""

    def __init__(self, stage: Stage, driver: Callable[[str], Driver], sample: Callable[[], None] | None = None):
        self.stage, self.driver, self._sample = stage, driver, sample
        self._base: dict[str, int] = {}

    def run(self, lines: Iterable[Line]) -> dict[str, Any]:
        """Run lines to the end, or until the host gives up a poll.

        Args:
            lines: Of a program.

        Returns:
            How the program ended, by name.

        Raises:
            StageError: As the tools raise it.
        """
        self._base.clear()
        done = 0
        for line in lines:
            try:
                line.do(self)
            except RunTimeout as error:
                return {
                    "ended": f"line {line.number}: {error}",
                    "lines_done": done,
                    "time_s": round(self.stage.time, 9),
                }
            done += 1
        return {"ended": DONE, "lines_done": done, "time_s": round(self.stage.time, 9)}

    def base(self, axis: str, port: int) -> None:
        """Set the port at which the host believes the chip of an axis.

        Args:
            axis: Name of the axis.
            port: Number of the port.
        """
        self._base[axis] = port

    def cycle(self, axis: str, cycle: BusCycle) -> None:
        """Make a bus cycle at the ports where the host believes the chip of an axis.

        Args:
            axis: Name of the axis.
            cycle: To make.
        """
        chip = self.stage.axes[axis].chip
        if axis in self._base:
            k, offset = divmod(self._base[axis] + cycle.address - FIRST, STRIDE)
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

    def wait_until(self, test: Callable[[], bool], limit: float, what: str) -> None:
        """Poll until a test is true.

        Args:
            test: Called after each poll.
            limit: Simulated seconds.
            what: The test in words.

        Raises:
            RunTimeout: The test was not true in time.
        """
        begun = self.stage.time
        while not test():
            if self.stage.time - begun >= limit:
                raise RunTimeout(f"{what} did not come within {limit:g} s, and the host gave up.")
            self.stage.run(POLL)
            if self._sample is not None:
                self._sample()

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        until = self.stage.time + seconds
        while self._sample is not None and self.stage.time + SAMPLE_INTERVAL_S < until:
            self.stage.run(SAMPLE_INTERVAL_S)
            self._sample()
        self.stage.run(max(until - self.stage.time, 0.0))

    def reads(self, axis: str) -> Axis:
        """Return the axis whose chip answers where the host believes that of `axis`."""
        if axis not in self._base:
            return self.stage.axes[axis]
        k = (self._base[axis] - FIRST) // STRIDE
        found = [
            a for a in self.stage.axes.values() if 0 <= k < len(self.stage.chips) and a.chip is self.stage.chips[k]
        ]
        if not found:
            raise RunTimeout(f"port {self._base[axis]:X}h answers FFh for ever: no chip is there.")
        return found[0]


def parse(text: str, stage: Stage) -> list[Line]:
    """Parse the lines of a program that do something.

    Args:
        text: Of the program.
        stage: Whose axes it names.

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
            lines.append(Line(number, line, _parsed(line, stage)))
        except (ArgumentError, NotImplementedError) as error:
            raise ArgumentError(f"line {number}, {line[:60]!r}: {error}") from None
    return lines


def _parsed(line: str, stage: Stage) -> Callable[[Host], None]:
    word, _, rest = line.partition(" ")
    if word == "wait":
        seconds = _seconds(rest)
        return lambda host: host.wait(seconds)
    if word == "base":
        axis, _, port = rest.partition(" ")
        name, number = choose("axis", axis, tuple(stage.axes)), parse_integer("port", port)
        return lambda host: host.base(name, number)
    if word == "until":
        return _until(rest.split(), stage)
    if ":" not in line:
        raise ArgumentError(
            "a line begins with an axis and a colon, or with wait, until or base, as in `x: operate 15h`."
        )
    axis, _, order = line.partition(":")
    name = choose("axis", axis.strip(), tuple(stage.axes))
    cycles = _cycles(stage.axes[name], order.strip())

    def send(host: Host) -> None:
        for cycle in cycles:
            host.cycle(name, cycle)

    return send


def _cycles(axis: Axis, order: str) -> tuple[BusCycle, ...]:
    """Parse what stands behind the colon: an order of the console, or bytes with their addresses among them."""
    kind = type(axis.chip)
    if re.fullmatch(r"[0-9a-fA-F]{1,4}( [0-3]: ?[0-9a-fA-F]{1,4})+", order):
        first, *others = re.split(r" (?=[0-3]:)", order)
        pairs = [("0", first), *(o.split(":") for o in others)]
        return tuple(BusCycle(False, int(a, 16), int(d, 16)) for a, d in pairs)
    if "." in order.partition("<-")[0] and "<-" in order:
        raise ArgumentError("write the whole register: what its other bits are, a program has to know.")
    return parse_line(kind, order, axis.chip_axis).cycles


def _until(words: list[str], stage: Stage) -> Callable[[Host], None]:
    usage = "as in `until x stopped 5` or `until x RR1.DSND 1 2`"
    if not words:
        raise ArgumentError(f"until: {usage}.")
    name = choose("axis", words[0], tuple(stage.axes))
    axis = stage.axes[name]
    if len(words) == 3 and words[1] == "stopped":
        limit = _seconds(words[2])

        def stopped(host: Host) -> None:
            answers = host.reads(name)
            host.wait_until(lambda: not answers.chip.busy(answers.chip_axis), limit, "the end of the drive")

        return stopped
    if len(words) != 4 or "." not in words[1] or words[2] not in ("0", "1"):
        raise ArgumentError(f"until {' '.join(words)}: {usage}.")
    where, _, bit = words[1].partition(".")
    field = axis.chip.MAP.field(where, bit)
    wanted, limit = int(words[2]), _seconds(words[3])

    def shows(host: Host) -> None:
        driver = host.driver(host.reads(name).name)
        host.wait_until(
            lambda: bool(field.of(driver.status_words()[where])) == bool(wanted), limit, f"{words[1]} = {wanted}"
        )

    if where not in _status_names(axis):
        raise ArgumentError(f"{where} is no status word that is polled here: {', '.join(_status_names(axis))}.")
    return shows


def _status_names(axis: Axis) -> tuple[str, ...]:
    from stage.firmware.driver import get_driver

    replica = _Elsewhere(axis)
    return tuple(get_driver(replica).status_words())  # type: ignore[arg-type]


class _Elsewhere:
    """An axis whose bus cycles nobody sees: to ask a driver which words it reads."""

    def __init__(self, axis: Axis):
        self.name, self.chip, self.chip_axis = axis.name, axis.chip.make_replica(), axis.chip_axis


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 60:
        raise ArgumentError(f"{text.strip()!r}: seconds, 0 to 60.")
    return value
