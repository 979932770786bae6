"""A recording as waveforms: every pin, pulse, status bit and bus write of every chip, exact to the tick of its clock.

    x                   one scope per axis; "x 1" is x_u20_1, see stage.support.identifier_escapes
      POUT_n PDIR ...   every pin, as a probe on the wire would show it: `_n` marks a wire that is 0 while asserted
      R0 RATE           down counter, 24 bits; pulse rate, pps. Of an HCTL-1100 R14, the actual position, and R0E, the command
                          position, at the samples that change the command or the motor command MC; RATE in counts per second
      status            operating, lt, zero ...: the bits of the byte that a read at address 0 would return
      bus               WR: a write cycle (event), with A, its address, and D, its data; RESET: the /RESET pin (event); only if they
                          occur, LOST: a write cycle that did not reach the chip; RD: a read cycle that changed something
    host                  the bus cycles of a board, with reads, see stage.board.bus_waveforms

Times are those of the stage in nanoseconds. Tick n of a clock of f Hz is at n / f, and each time is rounded to the nanosecond
separately: errors do not add up, and n is round(ns f / 1e9).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.chips.journal_entries import LOST, READ, RESET, WRITE
from stage.recording import pin_signals
from stage.support.identifier_escapes import escape_name

if TYPE_CHECKING:
    from stage.recording.recording import Recording

NS_PER_S = 1_000_000_000
MAX_EDGES_AT_ONCE = 16384  # at a time
HOST_SCOPE = "host"
"""Scope of a board's bus cycles, see stage.board.bus_waveforms."""
DATE = "simulated time since power-up"  # and not the wall clock: equal runs make equal files

EVENT_NAMES = {WRITE: "WR", RESET: "RESET", LOST: "LOST", READ: "RD"}
Change = tuple[int, Any, Any]  # ns, variable, value


def to_nanoseconds(clock: Any, hz: int) -> Any:
    """Convert clocks of a chip to nanoseconds, rounded; exact for centuries.

    Args:
        clock: Ticks since power-up, an int or an int64 array.
        hz: Frequency of the clock, Hz.
    """
    return clock // hz * NS_PER_S + (clock % hz * NS_PER_S + hz // 2) // hz


def write_vcd(recording: Recording, path: Path) -> Path:
    """Write the waveforms of a recording, in memory that does not grow with its length.

    Args:
        recording: The recording.
        path: A new file.
    """
    from vcd import VCDWriter

    with path.open("w", encoding="ascii", buffering=1 << 20) as file:
        begin = min(
            to_nanoseconds(int(j.start_state["clock"]), _get_clock_hz(recording, n))
            for n, j in recording.journals.items()
        )
        end = max(to_nanoseconds(j.end_clock, _get_clock_hz(recording, n)) for n, j in recording.journals.items())
        comment = f"PulseStage: {recording!r}".encode("ascii", "backslashreplace").decode().replace("$", r"\x24")
        with VCDWriter(file, "1 ns", date=DATE, comment=comment, init_timestamp=begin) as writer:
            streams = [
                s
                for axis in recording.axes
                for s in (_register_pins(recording, axis, writer), _register_bus(recording, axis, writer))
            ]
            if recording.host is not None:
                end = max(end, recording.host.end_ns)
                streams += recording.host.register_signals(writer, begin, end)
            for ns, variable, value in heapq.merge(*streams, key=lambda change: change[0]):
                writer.change(variable, ns, value)
            writer.close(end)
    return path


def make_scope_name(axis: str) -> str:
    """Return the name of an axis' scope, which always differs from HOST_SCOPE."""
    return escape_name(axis, reserved=(HOST_SCOPE,))


def _get_clock_hz(recording: Recording, axis: str) -> int:
    return recording.axes[axis].chip.clock_hz


def _register_pins(recording: Recording, axis: str, writer: Any) -> Iterator[Change]:
    """Register the pins, counter, rate and status of an axis in the VCD file, and return an iterator of their changes."""
    chip, journal = recording.axes[axis].chip, recording.journals[axis]
    clocks, minus = pin_signals.list_directions(chip, journal)

    def compute_levels(edges: np.ndarray) -> dict[str, tuple[str, int, np.ndarray]]:
        """Return kind, bits and values of each signal after each edge."""
        return _compute_levels(chip, edges, minus[np.searchsorted(clocks, edges["clock"], side="right") - 1])

    variables, now = {}, {}
    for name, (kind, size, v) in compute_levels(next(journal.replay_in_pieces(size=256))[:1]).items():
        *scope, short = (make_scope_name(axis), *map(escape_name, name.split(".")))
        now[name] = v[0].item()
        variables[name] = writer.register_var(tuple(scope), short, kind, size=size, init=now[name])

    def iterate_changes() -> Iterator[Change]:
        """Yield the changes of all signals in the order of time."""
        for edges in pin_signals.settle_edges(journal.replay_in_pieces(every_pulse=True, size=MAX_EDGES_AT_ONCE)):
            ns = to_nanoseconds(edges["clock"], chip.clock_hz)
            which, at, what = [], [], []
            for name, (_, _, v) in compute_levels(edges).items():
                k = np.flatnonzero(np.concatenate([[v[0] != now[name]], v[1:] != v[:-1]]))
                which += [variables[name]] * len(k)
                at.append(ns[k])
                what += v[k].tolist()
                now[name] = v[-1]
            times = np.concatenate(at)
            order = np.argsort(times, kind="stable")
            for k, t in zip(order.tolist(), times[order].tolist(), strict=True):
                yield t, which[k], what[k]

    return iterate_changes()


def _compute_levels(chip: Any, edges: np.ndarray, minus: np.ndarray) -> dict[str, tuple[str, int, np.ndarray]]:
    """Return for each signal its VCD kind, its number of bits, and its value after each edge."""
    out: dict[str, tuple[str, int, np.ndarray]] = {}
    for pin in (*chip.OUTPUTS, *chip.INPUTS):
        name, level = pin_signals.find_wire_name_and_level(chip, pin)
        out[name] = ("wire", 1, (pin_signals.is_asserted(chip, edges, pin) == bool(level)).astype(np.int64))
    counter, bits = chip.COUNTER
    out[counter] = ("reg", bits, edges["counter"])
    for word, (field, size) in chip.TRACED.items():
        out[word] = ("reg", size, edges[field])
    out["RATE"] = ("real", 64, pin_signals.to_pulse_rates(edges, chip.clock_hz))
    for name, v in pin_signals.decode_status(chip, edges, minus).items():
        out[f"status.{name}"] = ("wire", 1, v.astype(np.int64))
    return out


def _register_bus(recording: Recording, axis: str, writer: Any) -> Iterator[Change]:
    """Register the bus signals of an axis in the VCD file, and return an iterator of its cycles and resets."""
    chip, journal, scope = recording.axes[axis].chip, recording.journals[axis], (make_scope_name(axis), "bus")
    kinds = {WRITE, RESET, *journal.entries.to_packed()["kind"].tolist()}  # most recordings have no LOST and no RD
    events = {k: writer.register_var(scope, name, "event", size=1) for k, name in EVENT_NAMES.items() if k in kinds}
    address = writer.register_var(scope, "A", "reg", size=chip.ADDRESS_MASK.bit_length(), init="x")
    data = writer.register_var(scope, "D", "reg", size=chip.DATA_MASK.bit_length(), init="x")

    def iterate_changes() -> Iterator[Change]:
        for e in journal.entries:
            ns = to_nanoseconds(e.clock, chip.clock_hz)
            if e.kind == RESET:
                yield ns, events[RESET], True
            elif e.kind in events:
                yield from ((ns, address, e.a), (ns, data, e.b), (ns, events[e.kind], True))

    return iterate_changes()


class RecordedBusCycles:
    """Bus cycles that the board of a stage makes from now to `close`, for a VCD file. The board may be created later."""

    def __init__(self, stage: Any):
        self._stage = stage
        self._begin = None if stage.host is None else stage.host.get_position()
        self._end: Any = None
        self._until: int | None = None

    def close(self) -> None:
        """Stop collecting cycles."""
        self._end, self._until = None if self._stage.host is None else self._stage.host.get_position(), self._stage.now

    @property
    def end_ns(self) -> int:
        """Time of `close`, or the present time while open, ns."""
        return self._stage.now if self._until is None else self._until

    def register_signals(self, writer: Any, begin: int, end: int) -> list[Iterator[Change]]:
        """Register the bus in a VCD file, if there were cycles, and return iterators of its changes.

        Args:
            writer: VCDWriter of the file.
            begin: First time of the file, ns.
            end: Last time of the file, ns.
        """
        if self._stage.host is None or (self._until is not None and self._end is None):
            return []
        return self._stage.host.register_signals(writer, self._begin, self._end, begin, end)
