"""`Board`: the chips of a stage behind the ports of a host's bus.

    board = Board(Stage("xyz", chips=PCL240K))           one chip per 4 ports, from 300h on
    board.out8(0x300, 0x11)                              a bus cycle; takes the stage's `bus_cycle`
    board.in8(0x300)
    board.delay_us(500)
    print(board.trace)

A port without a chip reads as FFh and is noted in `board.strays`. Firmware in C runs on the same board, see NativeHost.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from stage.board import host, layout_files, layouts
from stage.board.errors import HostError
from stage.board.link import Link
from stage.board.trace import BusTrace, Cycle, Meaning
from stage.chips.late import LateLint
from stage.errors import ArgumentError, unknown
from stage.sim.stage import LONGEST, Stage

KEPT_CYCLES = 100_000
MOST_LINES = 1_000_000


class Board:
    """A bus with the chips of `stage` on it. One board a stage.

    Args:
        stage: a Stage.
        layout: a name of stage.board.LAYOUTS, a file (see layout_files) or a Layout; default: what is usual for each chip.
        base: the first port of the first chip, or a mapping axis -> first port of its chip; default: the layout's.
        stride: ports from one chip to the next; default: the layout's.
        keep_cycles: lines of the bus trace that are kept.
    Attributes:
        options: the arguments except the stage, by name; places: the chips and their layouts.
        regions, port_table: REGION and PORT records, what every port reaches.
        trace: the BusTrace; log: lines that the firmware noted, (seconds, text).
        driver: the firmware, a NativeHost, that has begun and not returned, or None.
        link: its connection to compiled code, for runners of firmware.
    Raises:
        ArgumentError: a layout that does not fit the chips, ports that overlap or do not exist. FileError: no such file.
    """

    LINTS: ClassVar = True

    def __init__(
        self,
        stage: Stage,
        layout: str | os.PathLike | layouts.Layout | None = None,
        base: int | Mapping[str, int] | None = None,
        stride: int | None = None,
        *,
        keep_cycles: int = KEPT_CYCLES,
    ):
        if not isinstance(stage, Stage):
            raise ArgumentError(f"{stage!r} is no Stage: Board(Stage('xyz', chips=PCL240K)).")
        if int(keep_cycles) != keep_cycles or not 1 <= keep_cycles <= 1 << 28:
            raise ArgumentError(f"keep_cycles={keep_cycles!r}: a trace keeps 1 to {1 << 28} lines.")
        chosen = layout_files.chosen(layout)
        self.stage = stage
        self.options = {"layout": chosen, "base": base, "stride": stride, "keep_cycles": keep_cycles}
        chips = {stage.chips.index(axis.chip): axis.chip for axis in stage.axes.values()}
        self.places = layouts.places(chips, chosen, _by_chip(stage, base), stride)
        self.regions, self.port_table = layouts.table(self.places)
        self._at_first = [place.chip.twin() for place in self.places]
        self.trace = BusTrace(self, int(keep_cycles))
        self.log: list[tuple[float, str]] = []
        self.driver: Any = None
        for chip in stage.chips:
            if self.LINTS and chip.late_lint is None:
                chip.late_lint = LateLint(chip)
        self.link = Link(self)

    # --- what a host does ---

    def out8(self, port: int, value: int) -> None:
        """One write cycle of 8 bits. Of a chip with a bus of 16 bits it sets half a register; the other half floats."""
        self.link.ask(host.OUT8, port, value)

    def in8(self, port: int) -> int:
        """One read cycle of 8 bits; FFh where there is nothing."""
        return self.link.ask(host.IN8, port, 0)

    def out16(self, port: int, value: int) -> None:
        """One write cycle of 16 bits; two of 8, the low byte first, at chips with a bus of 8 bits."""
        self.link.ask(host.OUT16, port, value)

    def in16(self, port: int) -> int:
        """One read cycle of 16 bits; two of 8, the low byte first, at chips with a bus of 8 bits."""
        return self.link.ask(host.IN16, port, 0)

    def out32(self, port: int, value: int) -> None:
        """Two write cycles of 16 bits, at `port` the low half, then at `port + 2` the high one; four of 8 at chips with a bus of
        8 bits."""
        self.link.ask(host.OUT32, port, value)

    def in32(self, port: int) -> int:
        """Two read cycles of 16 bits, in the same order."""
        return self.link.ask(host.IN32, port, 0)

    def delay_us(self, us: int) -> None:
        """Microseconds pass. Raises ArgumentError below 0, and beyond 1e15 (1e9 s)."""
        if not 0 <= us <= LONGEST * 1_000_000:
            raise ArgumentError(f"us={us!r}: a delay takes 0 to 1e15 us (1e9 s).")
        self.link.ask(host.DELAY, us, 0)

    @property
    def micros(self) -> int:
        """Microseconds since power-up."""
        return self.stage.now // 1000

    @property
    def interrupt(self) -> bool:
        """Whether a chip pulls the interrupt line."""
        irqs = zip(self.stage.chips, self.link.irqs.tolist(), strict=True)
        return any(chip.output_word(axis) & bits for chip, (axis, bits) in irqs if bits)

    def on_interrupt(self, hook: Callable[[], None] | None) -> None:
        """Call `hook` while the interrupt line is asserted: after a bus cycle, or within a delay at the very ns; again and
        again until it is released, and not from within itself. It may make bus cycles. None: nobody is called. Firmware's own
        hook comes in its place, until the firmware returns."""
        self.link.hook = hook
        self.link.ask(host.HOOK, self.link.own_hook(), 0)

    # --- what one looks at ---

    @property
    def cycles(self) -> int:
        """Bus cycles since the board was made."""
        return int(self.link.record["cycles"])

    @property
    def strays(self) -> list[Cycle]:
        """The cycles of the trace that reached no chip, or half of a register only."""
        return [cycle for cycle in self.trace if cycle.stray]

    @property
    def ports(self) -> dict[int, str]:
        """What each port reaches, in words."""
        names = {place.index: self.name_of(place.index) for place in self.places}
        kinds = ("", "address {}", "address {}", "upper byte of address {}", "address latch", "data", "interrupts")
        return {
            port: f"{names[int(p['chip'])]} {kinds[int(p['kind'])].format(int(p['address']))}"
            for port, p in self._by_port()
        }

    def __repr__(self) -> str:
        lie = ", ".join(f"{self.name_of(p.index)} at {p.first:03X}h ({p.layout.name})" for p in self.places)
        return f"<Board {lie}; {self.cycles:,} cycles>"

    # --- inside ---

    def name_of(self, chip: int) -> str:
        """The axes of a chip."""
        return "".join(axis.name for axis in self.stage.axes.values() if axis.chip is self.stage.chips[chip])

    def teller(self) -> Meaning:
        """Tells what a bus cycle means, those before it given, from the first on."""
        listeners = {place.index: twin.listener() for place, twin in zip(self.places, self._at_first, strict=True)}
        latches: dict[int, int] = {}
        reached = {port: tuple(p) for port, p in self._by_port()}

        def tell(port: int, value: int, writes: bool, wide: bool) -> str:
            kind, chip, address, mask, _ = reached.get(port, (host.NOTHING, 0, 0, 0, 0))
            if kind == host.NOTHING:
                return "nothing is here"
            if kind == host.PULLS:
                on = [self.name_of(k) for k in range(len(self.stage.chips)) if value >> k & 1]
                return f"interrupts: {', '.join(on) or 'none'}"
            name = f"{self.name_of(chip)}: "
            if kind == host.LATCH:
                latches[port] = value & mask
                return name + (f"address latch = {value:02X}h" if writes else "the address latch cannot be read")
            if kind == host.LATCHED:
                address = latches.get(port - 1, 0)
            if kind == host.HALF:
                value = value << 8 | (0xFF if writes else 0)
            elif kind == host.WORD and writes and not wide:
                value |= 0xFF00
            listener = listeners[chip]
            return name + (listener.write(address, value) if writes else listener.read(address, value))

        return tell

    def _by_port(self) -> list[tuple[int, Any]]:
        """The ports that reach something, with their PORT records."""
        pairs = zip(layouts.numbers(self.regions).tolist(), self.port_table, strict=True)
        return [(port, p) for port, p in pairs if p["kind"]]

    def note(self, text: str) -> None:
        """A line for the log, now. Raises HostError for more of them than a log keeps."""
        self.check_lines(len(self.log))
        self.log.append((self.stage.time, text))

    def check_lines(self, lines: int) -> None:
        """Raises HostError if a log has so many lines that there is room for no more."""
        if lines >= MOST_LINES:
            raise HostError(
                f"{MOST_LINES:,} lines were noted by ps_log, and a log keeps no more (now {self.stage.time:.6f} s): a loop without "
                "end? Note less, or clear host.log between two pieces of a run."
            )


def _by_chip(stage: Stage, base: int | Mapping[str, int] | None) -> Any:
    if not isinstance(base, Mapping):
        return base
    for name in base:
        if name not in stage.axes:
            raise unknown("axis", name, stage.axes)
    found = {stage.axes[name].chip: port for name, port in base.items()}
    for axis in stage.axes.values():
        if axis.chip not in found:
            raise ArgumentError(f"base={dict(base)!r}: the chip of axis {axis.name} has no first port.")
    return found
