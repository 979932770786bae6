"""`Bench`: chips on one bus and one time line, without a machine. Firmware runs on it unchanged and takes milliseconds.

    bench = Bench(PCL240K())                                     one chip, its axis is "x"; or Bench(x=..., y=...)
    bench.add_rail("x", at=9000, org=(None, 0), el_minus=(None, -1600))
    print(origin_return(bench.axes["x"]))
    bench.at(bench.time + 0.2, lambda: ...)                      for example an edge of an input

A rail is a carriage that never slips: its position follows the pulses exactly, and it asserts input pins while it is within given
spans of pulses. A pin changes exactly at its pulse, between two clocks, as with the switches of a stage.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from itertools import count
from types import MappingProxyType
from typing import Any

import numpy as np

from stage.chips import Chip
from stage.chips.chip import Bus, Pins, check_clock_limit, split_run
from stage.errors import ArgumentError, unknown_name_error
from stage.firmware.axis import check_seconds
from stage.sim.procedure_threads import MIN_WAIT_NS, ProcedureSchedule
from stage.support.argument_checks import explain_arguments, explain_constructor

DEFAULT_AXIS_NAMES = "xyzuvw"
PositionSpan = tuple[int | None, int | None]


class BenchAxis:
    """Axis of a bench: a chip without a machine, or with a carriage that follows the pulses exactly (`Bench.add_rail`)."""

    chip_axis = 0
    meters_per_pulse = None
    position = None
    commanded = None
    lost_steps = None

    def __init__(self, bench: Bench, name: str, chip: Chip):
        self._bench, self.name, self.chip = bench, name, chip
        self._offset = -chip.net(self.chip_axis)
        self._spans: dict[str, PositionSpan] = {}
        self._bounds: list[int] = []

    @property
    def pins(self) -> Pins:
        """The pins of the chip's first axis."""
        return self.chip.axes[self.chip_axis].pins

    @property
    def time(self) -> float:
        """Simulated seconds since the bench was made."""
        return self._bench.time

    @property
    def procedures(self) -> ProcedureSchedule:
        """Procedures under way on the bench."""
        return self._bench.procedures

    @explain_arguments
    def wait(self, seconds: float) -> None:
        """Let `seconds` of simulated time pass, for all chips of the bench."""
        self._bench.wait(seconds)

    @property
    def rail_position(self) -> int:
        """Position of a rail's carriage, pulses."""
        return self._offset + self.chip.net(self.chip_axis)

    def _place_on_rail(self, position: int, spans: dict[str, PositionSpan]) -> None:
        """Place the carriage of a rail at `position` pulses, with the pins that it asserts within spans of pulses."""
        self._offset, self._spans = position - self.chip.net(self.chip_axis), spans
        self._bounds = [bound for span in spans.values() for bound in span if bound is not None]
        self._assert_switches()

    def _assert_switches(self) -> None:
        """Set all inputs at once, so that the chip sees no intermediate state where switches share an edge."""
        chip, place = self.chip, self.rail_position
        old = word = chip.input_word(self.chip_axis)
        for pin, span in self._spans.items():
            bit = chip.INPUTS[pin]
            word = word | bit if _is_within(place, span) else word & ~bit
        if word != old:
            chip.set_input_word(self.chip_axis, word)
            if chip.open_journal is not None:
                chip.open_journal.note_input(chip.clock, self.chip_axis, word)

    def _copy_record(self) -> np.ndarray:
        """Return a copy of the chip's record, with which the caller computes the next pulses."""
        return np.frombuffer(bytearray(self.chip.state.tobytes()), self.chip.CORE.STATE)

    def _run(self, clock: int) -> None:
        """Run the chip of this axis up to `clock`, in parts between which Ctrl-C takes effect."""
        for stop in split_run(self.chip.clock, clock):
            self._run_part(stop)

    def _run_part(self, clock: int) -> None:
        """Run the chip of a bench axis up to `clock`.

        Update the inputs at each pulse that moves the carriage into or out of a span.
        """
        chip = self.chip
        core, c = chip.CORE, chip.pointer
        while self._spans and chip.clock < clock:
            n, place = core.advance(self._copy_record(), clock), self.rail_position
            if n == 0 or n < min((abs(bound - place) for bound in self._bounds), default=0):
                break
            pulses = np.empty(n, core.PULSE)
            replica = self._copy_record()
            core.trace_pulses.c(replica.ctypes.data, clock, pulses.ctypes.data, n)
            places = place + np.cumsum(pulses["direction"], dtype=np.int64)
            changed = np.zeros(n, bool)
            for pin, span in self._spans.items():
                changed |= _is_within(places, span) != getattr(self.pins, pin)
            if not changed.any():
                break
            core.advance.c(c, int(pulses["clock"][np.argmax(changed)]))
            self._assert_switches()
        core.advance.c(c, clock)

    def __repr__(self) -> str:
        return f"<BenchAxis {self.name} {self.chip!r}>"


@explain_constructor
class Bench(Bus):
    """Chips on one bus and one time line.

    Args:
        chips: Chips, named x, y, z, u, v, w in their order; or one mapping name -> chip; or keywords.
        bus_cycle: Seconds that one bus cycle takes.

    Raises:
        ArgumentError: There is no chip, or one belongs to a stage or another bench.
    """

    def __init__(self, *chips: Chip | Mapping[str, Chip], bus_cycle: float = 1e-6, **named: Chip):
        all_: dict[str, Any] = dict(named)
        if len(chips) == 1 and isinstance(chips[0], Mapping):
            all_ |= chips[0]
        elif len(chips) > len(DEFAULT_AXIS_NAMES):
            raise ArgumentError(
                f"{len(chips)} chips: there are names for {len(DEFAULT_AXIS_NAMES)}; give a mapping name -> chip."
            )
        else:
            all_ |= zip(DEFAULT_AXIS_NAMES, chips, strict=False)
        if not all_:
            raise ArgumentError("a bench needs at least one chip: Bench(PCL240K()).")
        if not 0 <= bus_cycle <= 1:
            raise ArgumentError(f"bus_cycle={bus_cycle!r}: a bus cycle takes 0 to 1 s.")
        for name, chip in all_.items():
            if not isinstance(chip, Chip):
                raise ArgumentError(f"{name}={chip!r} is no chip; for example Bench(PCL240K()).")
            if chip.attached or sum(chip is other for other in all_.values()) > 1:
                raise ArgumentError(f"chip {name} already has a bus: a chip sits on one stage or bench, once.")
        self._now, self._bus_ns = 0, round(bus_cycle * 1e9)
        self.procedures = ProcedureSchedule(self)
        self._events: list[tuple[int, int, Callable[[], Any]]] = []
        self._order = count()
        self._start = {name: chip.clock for name, chip in all_.items()}
        for chip in all_.values():
            chip.attach(self)
        self.axes: Mapping[str, BenchAxis] = MappingProxyType({n: BenchAxis(self, n, c) for n, c in all_.items()})

    @property
    def time(self) -> float:
        """Simulated seconds since the bench was made."""
        return self._now * 1e-9

    @property
    def bus_cycle(self) -> float:
        """Simulated seconds that one bus cycle of the bench takes."""
        return self._bus_ns * 1e-9

    def cycle(self) -> None:
        """Let the time of one bus cycle pass; chips call this method before each read and write."""
        self._advance(self._now + self._bus_ns)

    @explain_arguments
    def wait(self, seconds: float) -> None:
        """Let `seconds` of simulated time pass on the bench. Raises ArgumentError for a negative time."""
        check_seconds(seconds)
        until, procedures = self._now + round(seconds * 1e9), self.procedures
        if procedures.running is not None:
            procedures.running.wait_until(self._now, until)
        takes_turns = procedures.running is None and until - self._now >= MIN_WAIT_NS
        while procedures.waiting and (takes_turns or procedures.is_overdue(self._now)) and self._now < until:
            self._advance(procedures.resume_due_procedures(self._now, until))
        self._advance(until)

    @explain_arguments
    def at(self, seconds: float, action: Callable[[], Any]) -> None:
        """Call a function at a time of the bench, to change an input, for example.

        Args:
            seconds: Time of the bench, s.
            action: Function without arguments.

        Raises:
            ArgumentError: The time is outside 0 to 1e9 s, or `action` is no function.
        """
        if not 0 <= seconds < 1e9:
            raise ArgumentError(f"seconds={seconds!r}: the time of an event is 0 to 1e9 s.")
        if not callable(action):
            raise ArgumentError(f"action={action!r}: give a function without arguments.")
        heapq.heappush(self._events, (round(seconds * 1e9), next(self._order), action))

    @explain_arguments
    def add_rail(self, axis: str, at: int = 0, **spans: PositionSpan) -> None:
        """Put a carriage that never slips under an axis.

        Args:
            axis: Name of the axis.
            at: Position of the carriage, pulses.
            spans: Input pin -> (low, high), both inclusive, None for no bound: the positions at which the carriage asserts the pin.

        Raises:
            ArgumentError: The axis or a pin does not exist.
        """
        if axis not in self.axes:
            raise unknown_name_error("axis", axis, self.axes)
        chip = self.axes[axis].chip
        for pin in spans:
            if pin not in chip.INPUTS:
                raise unknown_name_error(f"{type(chip).__name__} input", pin, chip.INPUTS)
        self.axes[axis]._place_on_rail(at, spans)

    def _advance(self, until: int) -> None:
        """Advance the bench to a time, ns, and call the actions that are due."""
        for name, axis in self.axes.items():
            check_clock_limit(self._compute_clock_at(name, axis.chip, until))
        while self._events and self._events[0][0] <= until:
            when, _, action = heapq.heappop(self._events)
            self._run(max(when, self._now))
            action()
        self._run(max(until, self._now))  # an action may have spent bus cycles

    def _run(self, until: int) -> None:
        """Run all chips of the bench to a time, ns."""
        self._now = until
        for name, axis in self.axes.items():
            axis._run(self._compute_clock_at(name, axis.chip, until))

    def _compute_clock_at(self, name: str, chip: Chip, time: int) -> int:
        """Return the clock of the chip of axis `name` at a time of the bench, ns."""
        return self._start[name] + time * chip.clock_hz // 1_000_000_000


def _is_within(place: Any, span: PositionSpan) -> Any:
    """Return whether a position, or each position of an array, is within a span."""
    low, high = span
    return (place >= (-np.inf if low is None else low)) & (place <= (np.inf if high is None else high))
