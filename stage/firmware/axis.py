"""What firmware needs of an axis, and `Bench`: the same for chips without a stage.

    bench = Bench(x=PCL240K())
    preset_move(bench.axes["x"], 2000)
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from itertools import count
from types import MappingProxyType
from typing import Any, Protocol

from stage.chips import Chip
from stage.errors import ArgumentError


class Axis(Protocol):
    """An axis as firmware sees it: a chip on a bus, and time. The rest is truth, for reports only."""

    name: str
    chip: Chip
    meters_per_pulse: float | None

    @property
    def time(self) -> float:
        """Simulated seconds."""

    def wait(self, seconds: float) -> None:
        """Let simulated time pass, for all axes of the machine."""

    @property
    def position(self) -> float | None:
        """Where the carriage is, m; None without one."""

    @property
    def lost_steps(self) -> int | None:
        """Full steps lost; None without a motor."""


def check(axis: Any) -> None:
    """ArgumentError if `axis` is none."""
    if not isinstance(getattr(axis, "chip", None), Chip):
        raise ArgumentError(f"{axis!r} is no axis: give stage.axes['x'], or Bench(x=PCL240K()).axes['x'].")


class BenchAxis:
    """A chip alone: it makes pulses, and nothing moves."""

    meters_per_pulse = None
    position = None
    commanded = None
    lost_steps = None

    def __init__(self, bench: Bench, name: str, chip: Chip):
        self._bench, self.name, self.chip = bench, name, chip

    @property
    def time(self) -> float:
        return self._bench.time

    def wait(self, seconds: float) -> None:
        self._bench.wait(seconds)


class Bench:
    """Chips on one bus and one time line, without a stage.

    Args:
        bus_cycle: seconds that one bus cycle takes.
        chips: by axis name.
    """

    def __init__(self, *, bus_cycle: float = 1e-6, **chips: Chip):
        if not chips:
            raise ArgumentError("a bench needs at least one chip: Bench(x=PCL240K()).")
        self._now, self._bus_ns = 0, round(bus_cycle * 1e9)
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._order = count()
        self._start = {name: chip.clock for name, chip in chips.items()}
        for chip in chips.values():
            chip._bus = self
        self.axes: Mapping[str, BenchAxis] = MappingProxyType(
            {name: BenchAxis(self, name, chip) for name, chip in chips.items()}
        )

    @property
    def time(self) -> float:
        """Seconds since the bench was made."""
        return self._now * 1e-9

    def cycle(self) -> None:
        """One bus cycle passes."""
        self._advance(self._now + self._bus_ns)

    def wait(self, seconds: float) -> None:
        """`seconds` pass."""
        if not 0 <= seconds < 1e9:
            raise ArgumentError(f"seconds={seconds!r}: time runs forward, by 0 to 1e9 s.")
        self._advance(self._now + round(seconds * 1e9))

    def at(self, seconds: float, action: Callable[[], Any]) -> None:
        """Do `action()` when the bench's time is `seconds`: an input edge, for example."""
        heapq.heappush(self._events, (round(seconds * 1e9), next(self._order), action))

    def _advance(self, until: int) -> None:
        while self._events and self._events[0][0] <= until:
            when, _, action = heapq.heappop(self._events)
            self._run(max(when, self._now))
            action()
        self._run(until)

    def _run(self, until: int) -> None:
        self._now = until
        for name, axis in self.axes.items():
            chip = axis.chip
            seconds, rest = divmod(until, 1_000_000_000)
            clock = self._start[name] + seconds * chip.clock_hz + rest * chip.clock_hz // 1_000_000_000
            chip.CORE.advance(chip._rows, chip._i, clock)
