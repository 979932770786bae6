"""What pages show of a stage: `StageObserver`, axes and registers; `BusTrace`, the bus of a chip in words. No page.

observer = StageObserver(session)             looks at most FRAMES times a second, once for all browsers
observer.axes["x"].position
observer.request_registers(0, 1)              registers only of what somebody looks at
observer.chips[0, 1].values["DV"]
observer.traces[0].lines_after(number)
"""

from __future__ import annotations

from collections import deque
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.chips.chip import Chip
from stage.chips.describe import Listener
from stage.chips.diagnostics import Diagnostic
from stage.chips.entries import LOST, READ, RESET, WRITE, Entry
from stage.panel.session import Session
from stage.sim.stage import Snapshot, Stage

if TYPE_CHECKING:
    from stage.sim.axis import Axis


LINES = 500
KINDS = {WRITE: "W", READ: "R", LOST: "lost", RESET: "reset"}


class Line(NamedTuple):
    """Bus cycle or diagnostic in a trace.

    Attributes:
        number: Counts up.
        time: s.
        way: W, R, lost, reset, ! for a diagnostic.
        address, datum: Of the cycle.
        words: What it says.
        source: Of a diagnostic, the data sheet.
        times: Reads of one address in a row, of which this is the last.
        first: Number of the first of these.
    """

    number: int
    time: float
    way: str
    address: int
    datum: int
    words: str
    source: str = ""
    times: int = 1
    first: int = 0

    def text(self, digits: int) -> str:
        """Return the line of a list; digits: of the datum, hexadecimal."""
        if self.way in ("reset", "!"):
            return f"{self.time:11.6f}  {self.way}  {self.words}" + (f" [{self.source}]" if self.source else "")
        folded = f"  x {self.times}" if self.times > 1 else ""
        return f"{self.time:11.6f}  {self.way} {self.address:2X}: {self.datum:0{digits}X}  {self.words}{folded}"


class Trace:
    """Last LINES cycles and diagnostics of a chip, in words, whoever makes them. Only `since` is for any thread.

    Writes come from a journal of the chip, so that none is missing; so do reads that change something. Other reads are noted where
    they are made, by `read`: hosts that poll would fill the list.

    Args:
        chip: The chip.
        losses: Show a write that a fault has lost as such; False: as any other, as its host would see it.
    """

    def __init__(self, chip: Chip, losses: bool = True):
        self.chip, self.lines, self._losses = chip, deque[Line](maxlen=LINES), losses
        self.said: deque[Line] = deque(maxlen=LINES)
        """The diagnostics alone."""
        self.sent: list[Entry] | None = None
        """For who wants to play them again: the cycles that changed something, writes and such reads, since he set it to []."""
        self.digits = (chip.DATA_MASK.bit_length() + 3) // 4
        self._journal = chip.journal()
        self._listener: Listener = chip.listener()
        self._number, self._clock = 0, chip.clock
        self._last: Diagnostic | None = None
        self._diagnostics()

    def look(self) -> None:
        """Take in what has happened since."""
        if self.chip.clock < self._clock:  # a snapshot, or a reset of the stage
            self.begin_again()
        self._clock = self.chip.clock
        entries = self._journal.entries
        if len(entries):
            self._journal.restart()
            for e in entries:
                if e.kind in KINDS:
                    self._heard(e)
        self._diagnostics()

    def read(self, address: int) -> int:
        """Make a read cycle, and note it."""
        self.look()
        datum = self.chip.read(address)
        address &= self.chip.ADDRESS_MASK
        if address not in self.chip.READING_ACTS:
            self._add(self.chip.clock, "R", address, datum, self._listener.read(address, datum))
        self.look()
        return datum

    def since(self, number: int) -> list[Line]:
        """Return the lines with higher numbers, oldest first."""
        return [line for line in tuple(self.lines) if line.number > number]

    def close(self) -> None:
        """End the journal."""
        self._journal.close()

    def begin_again(self) -> None:
        """Go on from a snapshot: the chip is in another state than its cycles have brought it to."""
        self._journal.restart()
        self._clock = self.chip.clock
        while self.sent and self.sent[-1].clock > self.chip.clock:
            self.sent.pop()
        self._listener = self.chip.listener()
        self._last = self.chip.diagnostics[-1] if self.chip.diagnostics else None
        self._add(self.chip.clock, "reset", 0, 0, "the time went back")

    def _heard(self, e: Entry) -> None:
        if e.kind == RESET:
            self._listener = self.chip.listener()
            words = "the reset pin"
        elif e.kind == LOST and self._losses:
            words = "did not arrive"
        else:
            if e.kind != LOST and self.sent is not None:
                self.sent.append(e)
            words = (self._listener.read if e.kind == READ else self._listener.write)(e.a, e.b)
        way = KINDS[WRITE if e.kind == LOST and not self._losses else e.kind]
        self._add(e.clock, way, e.a, e.b, words)

    def _diagnostics(self) -> None:
        noted = self.chip.diagnostics
        new: list[Any] = []
        for d in reversed(noted):
            if d is self._last:
                break
            new.append(d)
        for d in reversed(new):
            self.said.append(self._add(d.clock, "!", d.address, d.value, d.message, d.source))
        self._last = noted[-1] if noted else None

    def _add(self, clock: int, way: str, address: int, datum: int, words: str, source: str = "") -> Line:
        self._number += 1
        times, first, last = 1, self._number, self.lines[-1] if self.lines else None
        if last is not None and way == last.way == "R" and address == last.address:  # a host that polls
            times, first = last.times + 1, last.first
            self.lines.pop()
        line = Line(self._number, clock / self.chip.clock_hz, way, address, datum, words, source, times, first)
        self.lines.append(line)
        return line


FRAMES = 25
MAX_PROGRAM_CYCLES = 200_000  # bus cycles of a program
REQUEST_LIFETIME_S = 2.0  # s for which the registers of a chip are looked at after somebody wanted them


class AxisView(NamedTuple):
    """What is shown of an axis.

    Attributes:
        position, commanded: m or rad.
        lost: Full steps, since the last origin return from a form.
        switches: Of the stage, by name.
    """

    position: float
    commanded: float
    lost: int | None
    switches: dict[str, bool]


class ChipView(NamedTuple):
    """What is shown of one axis of a chip.

    Attributes:
        values: Of registers and words.
        inputs, outputs: Pins by name, True is asserted.
    """

    values: dict[str, int]
    inputs: dict[str, bool]
    outputs: dict[str, bool]


class StageObserver:
    """Latest view of a stage. Attributes are replaced, never changed, and can be read from any thread.

    Attributes:
        number: Of the views so far.
        axes: By name.
        chips: By index in `Stage.chips` and axis of the chip.
        traces: One for each chip.
        program_start: Time, ns, and state in which the program of the traces' `sent` begins; taken again where time goes back to
            before it.
    """

    def __init__(self, session: Session):
        self._session, self._requested = session, {}  # type: ignore[var-annotated]
        self._at, self.number = 0.0, 0
        self._origins: dict[
            str, tuple[int, int]
        ] = {}  # when the origin was found, ns, and the steps that were lost by then
        self.axes: dict[str, AxisView] = {}
        self.chips: dict[tuple[int, int], ChipView] = {}
        self.traces: tuple[Trace, ...] = session.do(lambda stage: tuple(Trace(chip) for chip in stage.chips))
        self.program_start: tuple[int, Snapshot] = session.do(self._start_program)
        session.do(self.observe)
        self._end = session.on_slice(self._slice)

    def request_registers(self, chip: int, axis: int) -> None:
        """Have the registers of this axis in `chips` after the next look, for REQUEST_LIFETIME_S."""
        self._requested[chip, axis] = perf_counter()

    def _slice(self, stage: Stage) -> None:
        if perf_counter() - self._at >= 1 / FRAMES:
            self.observe(stage)

    def observe(self, stage: Stage) -> None:
        """Look now, in the stage's thread."""
        self._at = now = perf_counter()
        self.axes = {a.name: self._seen(a) for a in stage.axes.values()}
        wanted = [key for key, at in tuple(self._requested.items()) if now - at < REQUEST_LIFETIME_S]
        self.chips = {(k, axis): view_axis_of(stage.chips[k], axis) for k, axis in wanted}
        for trace in self.traces:
            trace.look()
        if (
            stage.now < self.program_start[0]
            or sum(len(trace.sent or ()) for trace in self.traces) > MAX_PROGRAM_CYCLES
        ):
            self.program_start = self._start_program(stage)
        self.number += 1

    def note_origin(self, axis: str, stage: Stage) -> None:
        """Note that an origin return has found where the carriage is: earlier lost steps do not count. In the stage's thread."""
        self._origins[axis] = stage.now, stage.axes[axis].lost_steps

    def _seen(self, axis: Axis) -> AxisView:
        when, before = self._origins.get(axis.name, (0, 0))
        if axis.stage.now < when:  # somebody went back in time
            before = 0
            del self._origins[axis.name]
        lost, commanded = axis.lost_steps, axis.commanded
        if before:
            record, _ = axis.read_drive()
            commanded -= before * (np.pi / 2 / record.teeth) / axis.gear
        return AxisView(axis.position, commanded, lost - before, axis.switches.as_dict())

    def _start_program(self, stage: Stage) -> tuple[int, Snapshot]:
        for trace in self.traces:
            trace.sent = []
        return stage.now, stage.snapshot()

    def close(self) -> None:
        """End."""
        self._end()
        for trace in self.traces:
            trace.close()


def view_axis_of(chip: Chip, axis: int) -> ChipView:
    """Return what one axis of a chip shows now."""
    inputs, outputs = chip.input_word(axis), chip.output_word(axis)
    return ChipView(
        chip.values_of(axis),
        {name: bool(inputs & bit) for name, bit in chip.INPUTS.items()},
        {name: bool(outputs & bit) for name, bit in chip.OUTPUTS.items()},
    )
