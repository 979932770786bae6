"""A chip's course, replayed: note the bus writes and input changes, and everything else follows.

A chip is deterministic, so its state at the start and what reached its pins say all it did. `Journal` keeps just that,
a few bytes an event however many pulses there are; `Journal.course()` runs a twin through it and returns each change
of speed and of every pin, to the clock. Waveforms and the drawings of operation patterns are made of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from stage.chips.chip import Chip

WRITE, INPUT, RESET = range(3)
CHUNK = 65536


class Entry(NamedTuple):
    """One event between two ticks: WRITE (address, value), INPUT (axis, pin word), or RESET."""

    clock: int
    kind: int
    a: int
    b: int


class Course(NamedTuple):
    """What a chip did. `edges`: EDGE records of its core (clock, inputs, outputs, speed, multiplier, r0, net), one for
    the start, one after each write or input change, one for every change in between, and one for the end."""

    chip: type[Chip]
    clock_hz: int
    edges: np.ndarray
    entries: tuple[Entry, ...]

    @property
    def seconds(self) -> np.ndarray:
        """Time of each edge since the first."""
        return (self.edges["clock"] - self.edges["clock"][0]) / self.clock_hz

    def pin(self, name: str) -> np.ndarray:
        """A pin's state from each edge on (bool)."""
        bit, word = (self.chip.INPUTS, "inputs") if name in self.chip.INPUTS else (self.chip.OUTPUTS, "outputs")
        return (self.edges[word] & bit[name]) != 0


class Journal:
    """Notes events of one chip from its creation to `close()`."""

    def __init__(self, chip: Chip, previous: Journal | None = None):
        self._chip, self._previous = chip, previous
        self._start = chip._rows[chip._i].tobytes()
        self._end: int | None = None
        self.entries: list[Entry] = []

    def note_write(self, clock: int, address: int, value: int) -> None:
        self._note(Entry(clock, WRITE, address, value))

    def note_input(self, clock: int, axis: int, word: int) -> None:
        self._note(Entry(clock, INPUT, axis, word))

    def note_reset(self, clock: int) -> None:
        self._note(Entry(clock, RESET, 0, 0))

    def _note(self, entry: Entry) -> None:
        if self._end is None:
            self.entries.append(entry)
        if self._previous is not None:
            self._previous._note(entry)

    def close(self) -> None:
        """Stop noting; the course ends here."""
        if self._end is not None:
            return
        self._end = self._chip.clock
        if self._chip._journal is self:
            self._chip._journal = self._previous

    def course(self, every_pulse: bool = False) -> Course:
        """Replay. With `every_pulse` the edges of the pulse output are in it too."""
        chip, core = self._chip, self._chip.CORE
        rows = np.frombuffer(bytearray(self._start), core.STATE)
        out = np.zeros(CHUNK, core.EDGE)
        parts: list[np.ndarray] = []

        def mark() -> None:
            core.mark(rows, 0, out, 0)
            parts.append(out[:1].copy())

        def run(until: int) -> None:
            while rows[0].clock < until:
                n = core.scan(rows, 0, until, every_pulse, out)
                if n:
                    parts.append(out[:n].copy())

        mark()
        for e in self.entries:
            run(e.clock)
            if e.kind == WRITE:
                core.write(rows, 0, e.a, e.b)
            elif e.kind == INPUT:
                core.set_inputs(rows, 0, e.a, e.b)
            else:
                core.power_up(rows, 0)
            mark()
        run(chip.clock if self._end is None else self._end)
        mark()
        return Course(type(chip), chip.clock_hz, np.concatenate(parts), tuple(self.entries))
