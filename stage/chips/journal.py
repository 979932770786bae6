"""Journals of the bus cycles and input changes of a chip, and their replay to the waveforms of an axis, to the clock.

A chip is deterministic, so everything that it does follows from its state at the start and from its inputs. `Journal` stores
only these, a few bytes per event, for any number of pulses. `Journal.replay_waveforms()` replays them on a second chip and
returns each change of speed and of every pin, to the clock. Waveforms and the drawings of operation patterns are made from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stage.chips.journal_entries import INPUT, LOST, READ, RESET, SHAFT, WIRES, WRITE, Entries, Entry, float_to_bits
from stage.support.argument_checks import check_integer

if TYPE_CHECKING:
    from stage.chips.chip import Chip

PIECE_EDGES = 65536
MIN_PIECE_EDGES = 64  # a scan may write several edges before it checks for free records


class Waveforms(NamedTuple):
    """Waveforms of one axis of a chip, exact to the clock.

    Attributes:
        chip: Class of the chip.
        clock_hz: Reference clock.
        edges: EDGE records of its core (clock, inputs, outputs, counter, net, rate in pulses per clock, and fields of the family):
            one for the start, one after each entry, one for every change in between, and one for the end.
        entries: The journal's entries.
    """

    chip: type[Chip]
    clock_hz: int
    edges: np.ndarray
    entries: Entries

    @property
    def seconds(self) -> np.ndarray:
        """Time from the first edge to each edge, s."""
        return (self.edges["clock"] - self.edges["clock"][0]) / self.clock_hz

    @property
    def running(self) -> np.ndarray:
        """Whether the axis drives, from each edge on (bool)."""
        return self.chip.is_driving(self.edges)

    def pin(self, name: str) -> np.ndarray:
        """Return the state of a pin from each edge on (bool).

        Args:
            name: Name of the input or output pin.
        """
        bit, word = (self.chip.INPUTS, "inputs") if name in self.chip.INPUTS else (self.chip.OUTPUTS, "outputs")
        return (self.edges[word] & bit[name]) != 0


class Journal:
    """Journal of the bus writes and input changes of one chip, from its creation to `close()`; it replays one axis' waveforms."""

    def __init__(self, chip: Chip, previous: Journal | None = None, axis: int = 0):
        self.chip, self._previous, self.axis = chip, previous, axis
        self._start = chip.state.tobytes()
        self._end: int | None = None
        self.entries = Entries()

    def note_write(self, clock: int, address: int, value: int) -> None:
        """Note in the journal a bus write cycle that the chip received."""
        self._append_entry(clock, WRITE, address, value)

    def note_lost_write(self, clock: int, address: int, value: int) -> None:
        """Note in the journal a write that did not reach the chip."""
        self._append_entry(clock, LOST, address, value)

    def note_read(self, clock: int, address: int, value: int) -> None:
        """Note a read cycle that changes the chip's state."""
        self._append_entry(clock, READ, address, value)

    def note_input(self, clock: int, axis: int, word: int) -> None:
        """Note a change of the input pins of an axis."""
        self._append_entry(clock, INPUT, axis, word)

    def note_reset(self, clock: int) -> None:
        """Note in the journal that the chip's reset pin was asserted."""
        self._append_entry(clock, RESET, 0, 0)

    def note_shaft(self, clock: int, axis: int, count: float, rate: float) -> None:
        """Note that the shaft of an encoder was set: its position (counts) and its rate (counts per clock)."""
        self._append_entry(clock, SHAFT, float_to_bits(count), float_to_bits(rate), axis)

    def extend(self, packed: np.ndarray) -> None:
        """Note entries given as records of the dtype PACKED, in the order of their clocks."""
        if self._end is None:
            self.entries.extend(packed)
        if self._previous is not None:
            self._previous.extend(packed)

    def _append_entry(self, clock: int, kind: int, a: int, b: int, axis: int = 0) -> None:
        """Append an entry unless the journal is closed, and to the journals of this chip that were opened before."""
        if self._end is None:
            self.entries.append(clock, kind, a, b, axis)
        if self._previous is not None:
            self._previous._append_entry(clock, kind, a, b, axis)

    def close(self) -> None:
        """Stop recording inputs of the chip. The waveforms of the journal end here."""
        if self._end is not None:
            return
        self._end = self.chip.clock
        now = self.chip.open_journal
        while now is not None and now._end is not None:
            now = now._previous
        self.chip.open_journal = now

    def restart(self) -> None:
        """Forget all entries of the journal, and begin again with the present state of the chip."""
        self._start, self.entries = self.chip.state.tobytes(), Entries()

    @property
    def start_state(self) -> np.record:
        """State of the chip when the journal began, a record of its core's STATE."""
        return np.frombuffer(self._start, self.chip.CORE.STATE)[0]

    @property
    def end_clock(self) -> int:
        """Clock at which the waveforms end: that of `close()`, or the chip's present clock."""
        return self.chip.clock if self._end is None else self._end

    def replay_waveforms(self, every_pulse: bool = False) -> Waveforms:
        """Replay the journal, and return the waveforms of its axis.

        Args:
            every_pulse: Include the edges of the pulse output.
        """
        chip = self.chip
        return Waveforms(
            type(chip), chip.clock_hz, np.concatenate(list(self.replay_in_pieces(every_pulse))), self.entries[:]
        )

    def replay_in_pieces(self, every_pulse: bool = False, size: int = PIECE_EDGES) -> Iterator[np.ndarray]:
        """Replay the journal piece by piece, in bounded memory.

        Args:
            every_pulse: Include the edges of the pulse output.
            size: Maximum number of edges in a piece, 64 or more.

        Raises:
            ArgumentError: `size` is below 64.
        """
        return GrowingJournalReplay(self).replay_in_pieces(every_pulse, size)


class GrowingJournalReplay:
    """Replay of a journal that is still growing."""

    def __init__(self, journal: Journal):
        self._journal = journal
        self._rows = np.frombuffer(bytearray(journal._start), journal.chip.CORE.STATE)
        self._applied = 0

    @property
    def state(self) -> bytes:
        """State of the chip after the last entry that has been replayed, as bytes."""
        return self._rows.tobytes()

    def replay_in_pieces(self, every_pulse: bool = False, size: int = PIECE_EDGES) -> Iterator[np.ndarray]:
        """Replay the entries since the last call. The first edge is the state at the end of that call.

        Args:
            every_pulse: Include the edges of the pulse output.
            size: Maximum number of edges in a piece, 64 or more.

        Raises:
            ArgumentError: `size` is below 64.
        """
        check_integer("size", size, MIN_PIECE_EDGES)
        return self._iterate_pieces(every_pulse, size)

    def _iterate_pieces(self, every_pulse: bool, size: int) -> Iterator[np.ndarray]:
        core, axis, clock = self._journal.chip.CORE, self._journal.axis, self._rows["clock"]
        chip = self._rows.ctypes.data
        out, done = np.zeros(size, core.EDGE), np.zeros(1, np.int64)
        at, row, count = out.ctypes.data, out.itemsize, done.ctypes.data
        end, entries = self._journal.end_clock, self._journal.entries[self._applied :]
        self._applied += len(entries)
        core.write_present_edge.c(chip, axis, at, size, 0)
        k = 1
        for e, shafts in _split_at_shafts(entries):
            until, done[0] = end if e is None else e.clock, 0
            while clock[0] < until or done[0] < len(shafts[0]):
                if size - k < MIN_PIECE_EDGES:
                    yield out[:k].copy()
                    k = 0
                args = chip, until, every_pulse, axis, at + k * row, size - k
                if len(shafts[0]):
                    where = (word for array in shafts for word in (array.ctypes.data, len(array)))
                    k += core.scan_edges_and_shafts.c(*args, *where, count, 1)
                else:
                    k += core.scan_edges.c(*args)
            if e is not None:
                e.apply(core, chip)
            if k == size:
                yield out.copy()
                k = 0
            core.write_present_edge.c(chip, axis, at, size, k)
            k += 1
        yield out[:k].copy()


ShaftEntries = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # clocks, axes, counts, rates


NO_SHAFT: ShaftEntries = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


def _split_at_shafts(entries: Entries) -> Iterator[tuple[Entry | None, ShaftEntries]]:
    """Split a journal for a replay: collect the entries of shafts and wires into arrays for compiled code, because they are many.

    Yields:
        Each other entry, with the entries of shafts and wires before it. The last pair has None as its entry. An entry of wires
        has its word, negated, in place of the axis.
    """
    packed = entries.to_packed()
    wires = packed["kind"] == WIRES
    of_shafts = (packed["kind"] == SHAFT) | wires
    if not of_shafts.any():
        yield from ((e, NO_SHAFT) for e in entries)
        yield None, NO_SHAFT
        return
    clocks, axes = np.ascontiguousarray(packed["clock"]), np.where(wires, -packed["a"], packed["axis"])
    counts, rates = (np.ascontiguousarray(packed[name]).view(np.float64) for name in ("a", "b"))
    begin = 0
    for k in (*np.flatnonzero(~of_shafts).tolist(), len(entries)):
        part = slice(begin, k)
        yield entries[k] if k < len(entries) else None, (clocks[part], axes[part], counts[part], rates[part])
        begin = k + 1
