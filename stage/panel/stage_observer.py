"""Data that pages show of a stage: `StageObserver`, its axes and registers; `BusTrace`, the bus cycles of a chip in words.

This module draws no page.

observer = StageObserver(session)             observes FRAMES_PER_S times a second at most, once for all browsers
observer.axes["x"].position
observer.request_registers(0, 1)              the observer reads registers only while a page requests them
observer.chips[0, 1].values["DV"]
observer.traces[0].lines_after(number)
"""

from __future__ import annotations

from collections import deque
from itertools import takewhile
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stage.chips.chip import Chip
from stage.chips.cycle_descriptions import CycleDescriber
from stage.chips.journal_entries import LOST, READ, RESET, WRITE, Entry
from stage.chips.write_diagnostics import Diagnostic
from stage.panel.session import Session
from stage.sim.stage import Snapshot, Stage

if TYPE_CHECKING:
    from stage.sim.axis import Axis


MAX_LINES = 500
KINDS = {WRITE: "W", READ: "R", LOST: "lost", RESET: "reset"}
DIAGNOSTIC = "!"


class TraceLine(NamedTuple):
    """Line of a bus trace: a bus cycle or a diagnostic.

    Attributes:
        number: Number of the line; each line has a higher number than those before it.
        time: Time, s.
        kind: "W", "R", "lost", "reset", or DIAGNOSTIC.
        address, datum: Address and datum of the cycle.
        words: Description.
        source: Data sheet section of a diagnostic.
        times: Number of consecutive reads of one address that this line stands for; the line shows the last of them.
        first: Number of the line of the first of these reads.
    """

    number: int
    time: float
    kind: str
    address: int
    datum: int
    words: str
    source: str = ""
    times: int = 1
    first: int = 0

    def format(self, digits: int) -> str:
        """Return the text of the line, with the datum in `digits` hexadecimal digits."""
        if self.kind in ("reset", DIAGNOSTIC):
            return f"{self.time:11.6f}  {self.kind}  {self.words}" + (f" [{self.source}]" if self.source else "")
        times = f"  x {self.times}" if self.times > 1 else ""
        return f"{self.time:11.6f}  {self.kind} {self.address:2X}: {self.datum:0{digits}X}  {self.words}{times}"


class BusTrace:
    """Trace of the last MAX_LINES bus cycles and diagnostics of a chip, in words. Cycles of any host or tool count.

    A journal of the chip supplies all writes, and the reads that change the chip. Other reads are in the trace only if they are
    made with its method `read`, because a host that polls would fill it. Only `get_lines_after` may be called from any thread.

    Args:
        chip: The chip.
        losses: Whether to show a write that a fault has lost as lost; False: as an ordinary write, as its host sees it.

    Attributes:
        lines: All lines.
        diagnostics: Lines of diagnostics only.
        sent: Cycles that changed the chip, oldest first. Set it to [] to begin collecting; None: they are not collected.
        digits: Number of hexadecimal digits of a datum.
    """

    def __init__(self, chip: Chip, losses: bool = True):
        self.chip, self._losses = chip, losses
        self.lines: deque[TraceLine] = deque(maxlen=MAX_LINES)
        self.diagnostics: deque[TraceLine] = deque(maxlen=MAX_LINES)
        self.sent: list[Entry] | None = None
        self.digits = (chip.DATA_MASK.bit_length() + 3) // 4
        self._journal = chip.journal()
        self._listener: CycleDescriber = chip.make_describer()
        self._number, self._clock = 0, chip.clock
        self._last_diagnostic: Diagnostic | None = None
        self._add_diagnostics()

    def add_new_entries(self) -> None:
        """Add the cycles and diagnostics since the last call."""
        if self.chip.clock < self._clock:  # a snapshot, or a reset of the stage
            self.restart()
        self._clock = self.chip.clock
        entries = self._journal.entries
        if len(entries):
            self._journal.restart()
            for entry in entries:
                if entry.kind in KINDS:
                    self._add_entry(entry)
        self._add_diagnostics()

    def read(self, address: int) -> int:
        """Make a read cycle on the chip, add it to the trace, and return its datum."""
        self.add_new_entries()
        datum = self.chip.read(address)
        address &= self.chip.ADDRESS_MASK
        if address not in self.chip.READING_ACTS:
            self._add_line(self.chip.clock, "R", address, datum, self._listener.read(address, datum))
        self.add_new_entries()
        return datum

    def get_lines_after(self, number: int) -> list[TraceLine]:
        """Return the lines with higher numbers than `number`, oldest first."""
        return [line for line in tuple(self.lines) if line.number > number]

    def close(self) -> None:
        """Close the journal of the chip."""
        self._journal.close()

    def restart(self) -> None:
        """Restart the trace after a snapshot has been restored, which changes the chip without bus cycles."""
        self._journal.restart()
        self._clock = self.chip.clock
        while self.sent and self.sent[-1].clock > self.chip.clock:
            self.sent.pop()
        while self.diagnostics and self.diagnostics[-1].time > self.chip.clock / self.chip.clock_hz:
            self.diagnostics.pop()  # of what has not happened any more
        self._listener = self.chip.make_describer()
        self._last_diagnostic = self.chip.diagnostics[-1] if self.chip.diagnostics else None
        self._add_line(self.chip.clock, "reset", 0, 0, "the time went back")

    def _add_entry(self, e: Entry) -> None:
        is_lost = e.kind == LOST and self._losses
        if e.kind == RESET:
            self._listener = self.chip.make_describer()
            words = "the reset pin"
        elif is_lost:
            words = "did not arrive"
        else:
            if e.kind != LOST and self.sent is not None:
                self.sent.append(e)
            words = (self._listener.read if e.kind == READ else self._listener.write)(e.a, e.b)
        self._add_line(e.clock, KINDS[WRITE if e.kind == LOST and not is_lost else e.kind], e.a, e.b, words)

    def _add_diagnostics(self) -> None:
        diagnostics = self.chip.diagnostics
        new = list(takewhile(lambda d: d is not self._last_diagnostic, reversed(diagnostics)))
        for d in reversed(new):
            self.diagnostics.append(self._add_line(d.clock, DIAGNOSTIC, d.address, d.value, d.message, d.source))
        self._last_diagnostic = diagnostics[-1] if diagnostics else None

    def _add_line(self, clock: int, kind: str, address: int, datum: int, words: str, source: str = "") -> TraceLine:
        self._number += 1
        times, first, last = 1, self._number, self.lines[-1] if self.lines else None
        if last is not None and kind == last.kind == "R" and address == last.address:  # a host that polls
            times, first = last.times + 1, last.first
            self.lines.pop()
        line = TraceLine(self._number, clock / self.chip.clock_hz, kind, address, datum, words, source, times, first)
        self.lines.append(line)
        return line


FRAMES_PER_S = 25  # a second
MAX_PROGRAM_CYCLES = 200_000
REQUEST_LIFETIME_S = 2.0  # for which the registers of a chip are read after a request


class AxisView(NamedTuple):
    """Values of an axis that pages show.

    Attributes:
        position, commanded: Position and commanded position, m or rad.
        lost: Full steps lost since the last origin return from a form.
        switches: Whether each switch of the axis is on, by its name.
    """

    position: float
    commanded: float
    lost: int | None
    switches: dict[str, bool]


class ChipView(NamedTuple):
    """Values of one axis of a chip that pages show.

    Attributes:
        values: Values of registers and words by name.
        inputs, outputs: Levels of the pins by name; True: asserted.
    """

    values: dict[str, int]
    inputs: dict[str, bool]
    outputs: dict[str, bool]


class StageObserver:
    """Observer that keeps the latest values of a stage for pages.

    The observer replaces its attributes and never changes the objects, so any thread can read them.

    Attributes:
        number: Number of updates so far.
        axes: Values of each axis by its name.
        chips: Values of each requested axis of a chip, by the index of the chip in `Stage.chips` and the axis on the chip.
        traces: Bus trace of each chip.
        program_start: Time, ns, and state in which the program in `sent` of the traces begins. The program begins anew if time goes
            back to before its start.
    """

    def __init__(self, session: Session):
        self._session = session
        self._requests: dict[tuple[int, int], float] = {}
        self._observed_at, self.number = 0.0, 0
        self._origins: dict[str, tuple[int, int]] = {}  # when the origin was found, ns, and the lost steps until then
        self.axes: dict[str, AxisView] = {}
        self.chips: dict[tuple[int, int], ChipView] = {}
        self.traces: tuple[BusTrace, ...] = session.do(lambda stage: tuple(BusTrace(chip) for chip in stage.chips))
        self.program_start: tuple[int, Snapshot] = session.do(self._start_program_collection)
        session.do(self.update_views)
        self._end_observing = session.call_after_pacing_intervals(self._update_after_pacing_interval)

    def request_registers(self, chip: int, axis: int) -> None:
        """Request that `chips` has the values of an axis of a chip, from the next update on for REQUEST_LIFETIME_S.

        Args:
            chip: Index of the chip in `Stage.chips`.
            axis: Axis of the chip.
        """
        self._requests[chip, axis] = perf_counter()

    def _update_after_pacing_interval(self, stage: Stage) -> None:
        if perf_counter() - self._observed_at >= 1 / FRAMES_PER_S:
            self.update_views(stage)

    def update_views(self, stage: Stage) -> None:
        """Update all values now. Call this in the stage's thread."""
        self._observed_at = now = perf_counter()
        self.axes = {axis.name: self._build_axis_view(axis) for axis in stage.axes.values()}
        keys = [key for key, at in tuple(self._requests.items()) if now - at < REQUEST_LIFETIME_S]
        self.chips = {(k, axis): build_chip_view(stage.chips[k], axis) for k, axis in keys}
        for trace in self.traces:
            trace.add_new_entries()
        cycles = sum(len(trace.sent or ()) for trace in self.traces)
        if stage.now < self.program_start[0] or cycles > MAX_PROGRAM_CYCLES:
            self.program_start = self._start_program_collection(stage)
        self.number += 1

    def reset_lost_steps(self, axis: str, stage: Stage) -> None:
        """Ignore the steps that an axis has lost so far, because an origin return has found its position.

        Call this in the stage's thread.

        Args:
            axis: Name of the axis.
            stage: The stage.
        """
        self._origins[axis] = stage.now, stage.axes[axis].lost_steps

    def _build_axis_view(self, axis: Axis) -> AxisView:
        when, before = self._origins.get(axis.name, (0, 0))
        if axis.stage.now < when:  # somebody went back in time
            before = 0
            del self._origins[axis.name]
        lost, commanded = axis.lost_steps, axis.commanded
        if before:
            record, _ = axis.read_drive()
            commanded -= before * (np.pi / 2 / record.teeth) / axis.gear
        return AxisView(axis.position, commanded, lost - before, axis.switches.as_dict())

    def _start_program_collection(self, stage: Stage) -> tuple[int, Snapshot]:
        """Begin to collect a program: clear the collected cycles, and return the time, ns, and the state of the stage."""
        for trace in self.traces:
            trace.sent = []
        return stage.now, stage.snapshot()

    def close(self) -> None:
        """Stop observing, and close the bus traces."""
        self._end_observing()
        for trace in self.traces:
            trace.close()


def build_chip_view(chip: Chip, axis: int) -> ChipView:
    """Return the values of one axis of a chip."""
    inputs, outputs = chip.input_word(axis), chip.output_word(axis)
    return ChipView(
        chip.axis_values(axis),
        {name: bool(inputs & bit) for name, bit in chip.INPUTS.items()},
        {name: bool(outputs & bit) for name, bit in chip.OUTPUTS.items()},
    )
