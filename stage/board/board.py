"""`Board`: the chips of a stage behind the ports of a host's bus.

    board = Board(Stage("xyz", chips=PCL240K))           one chip per 4 ports, from 300h on
    board.out8(0x300, 0x11)                              a bus cycle; takes the stage's `bus_cycle`
    board.in8(0x300)
    board.delay_us(500)
    print(board.trace)

A port that reaches nothing reads as FFh, and is noted: `board.strays`. Firmware in C runs on the same board, see NativeHost.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from stage.board import bus, layouts
from stage.board.trace import BusTrace, Cycle, Meaning
from stage.chips.late import LateLint
from stage.errors import ArgumentError, StageError, unknown
from stage.native import plain
from stage.sim import engine, handle
from stage.sim.stage import LONGEST, Stage

KEPT_CYCLES = 100_000
NOTED = 1 << 14  # edges and writes between two calls of Python
MOST = 1 << 62
UPCALL = ctypes.CFUNCTYPE(None, ctypes.c_int64)
HOOK = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class StormError(StageError):
    """An interrupt hook does not clear the interrupt that calls it."""


class Board:
    """A bus with the chips of `stage` on it. One board a stage.

    Args:
        stage: a Stage.
        layout: a name of stage.board.LAYOUTS or a Layout; default: what is usual for each chip.
        base: the first port of the first chip, or a mapping axis -> first port of its chip; default: the layout's.
        stride: ports from one chip to the next; default: the layout's.
        keep_cycles: lines of the bus trace that are kept.
    Raises:
        ArgumentError: a layout that does not fit the chips, ports that overlap or do not exist.
    """

    LINTS: ClassVar = True

    def __init__(
        self,
        stage: Stage,
        layout: str | layouts.Layout | None = None,
        base: int | Mapping[str, int] | None = None,
        stride: int | None = None,
        *,
        keep_cycles: int = KEPT_CYCLES,
    ):
        if not isinstance(stage, Stage):
            raise ArgumentError(f"{stage!r} is no Stage: Board(Stage('xyz', chips=PCL240K)).")
        if int(keep_cycles) != keep_cycles or not 1 <= keep_cycles <= 1 << 28:
            raise ArgumentError(f"keep_cycles={keep_cycles!r}: a trace keeps 1 to {1 << 28} lines.")
        self.stage = stage
        self._options = {"layout": layout, "base": base, "stride": stride, "keep_cycles": keep_cycles}
        chips = {stage.chips.index(axis.chip): axis.chip for axis in stage.axes.values()}
        self.places = layouts.places(chips, layout, _by_chip(stage, base), stride)
        self._first, self._ports = layouts.table(self.places)
        self._at_first = [place.chip.twin() for place in self.places]
        self.trace = BusTrace(self, int(keep_cycles))
        self.log: list[tuple[float, str]] = []
        """Lines that the firmware noted: seconds, text."""
        self.calls = 0  # of Python by compiled code, begun and ended: odd in one
        self._error: BaseException | None = None
        self._driver: Any = None  # the firmware that has begun and not returned
        self._abandoned: set[threading.Thread] = set()
        self._left: list[np.ndarray] = []
        self._stand_still: Callable[[], None] | None = None  # how a host in a thread of its own waits
        self._hook: Callable[[], None] | None = None
        self._call, self._call_hook = UPCALL(self._called), HOOK(self._hooked)
        for chip in stage.chips:
            if self.LINTS and chip.late_lint is None:
                chip.late_lint = LateLint(chip)
        self._request = bus.request.pointer
        self._lay_out()

    # --- what a host does ---

    def out8(self, port: int, value: int) -> None:
        """One write cycle of 8 bits. Of a chip with a bus of 16 bits it sets half a register; the other half floats."""
        self._ask(bus.OUT8, port, value)

    def in8(self, port: int) -> int:
        """One read cycle of 8 bits; FFh where there is nothing."""
        return self._ask(bus.IN8, port, 0)

    def out16(self, port: int, value: int) -> None:
        """One write cycle of 16 bits; two of 8, the low byte first, at chips with a bus of 8 bits."""
        self._ask(bus.OUT16, port, value)

    def in16(self, port: int) -> int:
        """One read cycle of 16 bits; two of 8, the low byte first, at chips with a bus of 8 bits."""
        return self._ask(bus.IN16, port, 0)

    def delay_us(self, us: int) -> None:
        """Microseconds pass. Raises ArgumentError below 0, and beyond 1e15 (1e9 s)."""
        if not 0 <= us <= LONGEST * 1_000_000:
            raise ArgumentError(f"us={us!r}: a delay takes 0 to 1e15 us (1e9 s).")
        self._ask(bus.DELAY, us, 0)

    @property
    def micros(self) -> int:
        """Microseconds since power-up."""
        return self.stage.now // 1000

    @property
    def interrupt(self) -> bool:
        """Whether a chip pulls the interrupt line."""
        irqs = zip(self.stage.chips, self._irqs.tolist(), strict=True)
        return any(chip.output_word(axis) & bits for chip, (axis, bits) in irqs if bits)

    def on_interrupt(self, hook: Callable[[], None] | None) -> None:
        """Call `hook` while the interrupt line is asserted: after a bus cycle, or within a delay at the very ns; again and
        again until it is released, and not from within itself. It may make bus cycles. None: nobody is called. Firmware's own
        hook comes in its place, until the firmware returns."""
        self._hook = hook
        self._ask(bus.HOOK, self._own_hook(), 0)

    # --- what one looks at ---

    @property
    def cycles(self) -> int:
        """Bus cycles since the board was made."""
        return int(self._host["cycles"])

    @property
    def strays(self) -> list[Cycle]:
        """The cycles of the trace that reached no chip, or half of a register only."""
        return [cycle for cycle in self.trace if cycle.stray]

    @property
    def ports(self) -> dict[int, str]:
        """What each port reaches, in words."""
        names = {place.index: self._name(place.index) for place in self.places}
        kinds = ("", "address {}", "address {}", "upper byte of address {}", "address latch", "data", "interrupts")
        return {
            self._first + n: f"{names[int(p['chip'])]} {kinds[int(p['kind'])].format(int(p['address']))}"
            for n, p in enumerate(self._ports)
            if p["kind"]
        }

    def __repr__(self) -> str:
        lie = ", ".join(f"{self._name(p.index)} at {p.first:03X}h ({p.layout.name})" for p in self.places)
        return f"<Board {lie}; {self.cycles:,} cycles>"

    # --- inside ---

    def _name(self, chip: int) -> str:
        """The axes of a chip."""
        return "".join(axis.name for axis in self.stage.axes.values() if axis.chip is self.stage.chips[chip])

    def _lay_out(self) -> None:
        """The HOST record, and the arrays that it points to."""
        stage = self.stage
        if len(stage.state.edges) < NOTED:
            stage.state.note_in(np.zeros(NOTED, engine.EDGE))
        self._take(np.zeros(1, bus.HOST))
        h = self._host
        handle.fill(self._rows, 0, stage.state)
        self._irqs = np.zeros(len(stage.chips), bus.IRQ)
        self._acts = np.zeros(len(stage.chips), np.int64)
        for k, chip in enumerate(stage.chips):
            axis, bits = chip.IRQ
            self._irqs[k] = (axis % (chip.AXES + 1), bits)
            self._acts[k] = np.uint64(sum(1 << a for a in chip.READING_ACTS)).astype(np.int64)
        words = stage.state.userdata
        self._before = np.zeros(len(words))
        for name, array in (
            ("edges", stage.state.edges), ("ports", self._ports),
            ("lines", self.trace._lines), ("irqs", self._irqs), ("acts", self._acts), ("userdata", words),
            ("before", self._before),
        ):  # fmt: skip
            h[name] = array.ctypes.data
        h["edge_room"], h["n_ports"], h["first"] = len(stage.state.edges), len(self._ports), self._first
        h["line_room"], h["words"] = self.trace.room, len(words)
        h["until"] = h["most_cycles"] = MOST
        h["journals"] = 1
        h["call"] = ctypes.cast(self._call, ctypes.c_void_p).value

    @property
    def _traced(self) -> int:
        return int(self._host["traced"])

    def _teller(self) -> Meaning:
        """Tells what a bus cycle means, those before it given, from the first on."""
        listeners = {place.index: twin.listener() for place, twin in zip(self.places, self._at_first, strict=True)}
        latches: dict[int, int] = {}
        reached = {self._first + n: tuple(p) for n, p in enumerate(self._ports.tolist())}

        def tell(port: int, value: int, writes: bool, wide: bool) -> str:
            kind, chip, address, mask, _ = reached.get(port, (bus.NOTHING, 0, 0, 0, 0))
            if kind == bus.NOTHING:
                return "nothing is here"
            if kind == bus.PULLS:
                on = [self._name(k) for k in range(len(self.stage.chips)) if value >> k & 1]
                return f"interrupts: {', '.join(on) or 'none'}"
            name = f"{self._name(chip)}: "
            if kind == bus.LATCH:
                latches[port] = value & mask
                return name + (f"address latch = {value:02X}h" if writes else "the address latch cannot be read")
            if kind == bus.LATCHED:
                address = latches.get(port - 1, 0)
            if kind == bus.HALF:
                value = value << 8 | (0xFF if writes else 0)
            elif kind == bus.WORD and writes and not wide:
                value |= 0xFF00
            listener = listeners[chip]
            return name + (listener.write(address, value) if writes else listener.read(address, value))

        return tell

    def _begin(self) -> None:
        """Before compiled code runs: what it may have to write to, and whom it has to ask."""
        stage, h = self.stage, self._host
        stage.look()
        asks = 0
        for k, chip in enumerate(stage.chips):
            if chip.glitches:
                asks |= 1 << k
        h["asks"], h["reached"] = asks, stage.now
        handle.log_to(h, stage.recording)

    def _end(self) -> None:
        """After compiled code has run: what it noted goes to journals and recording."""
        stage, h = self.stage, self._host
        if n := int(h["noted"]):
            h["noted"] = 0
            stage.loop.note_edges(n)
            for chip in stage.chips:
                if chip.late_lint is not None:
                    chip.late_lint.tidy()
        if (recording := stage.recording) is not None:
            recording.take(int(h["filled"]))
            h["filled"] = recording.filled

    def _ask(self, what: int, a: int, b: int) -> int:
        """One request of a host in Python."""
        self._begin()
        answer = int(self._request(self._at, what, int(a), int(b)))
        if answer == bus.TWO_AT_ONCE:
            raise StageError("this board is in use by another thread: a bus has one host at a time.")
        self._end()
        self._raise()
        return answer

    def _raise(self) -> None:
        """Raise what went wrong below compiled code."""
        if self._error is not None:
            error, self._error = self._error, None
            self._host["stopped"] = 0
            raise error

    def _called(self, reason: int) -> None:
        """Compiled code calls, see stage.board.bus."""
        if threading.current_thread() in self._abandoned:
            threading.Event().wait()
        self.calls += 1
        try:
            self._end()
            if reason == bus.DIVERGED:
                self._diverged()
            elif reason == bus.STORM:
                raise StormError(
                    f"the interrupt hook was called {bus.STORM_CALLS:,} times in a row at {self.stage.time:.6f} s and the line is "
                    f"still asserted: the hook has to clear the interrupt at its chip.\n{self.trace.text(8)}"
                )
            elif reason == bus.LINE_OF_LOG:
                self.note(ctypes.string_at(int(self._host["asked"])).decode(errors="replace"))
            elif reason == bus.ASKED_WRITE:
                h = self._host
                chip = self.stage.chips[int(h["asked_chip"])]
                h["asked"] = chip.loses(int(h["asked_address"]), int(h["asked"]))
            elif reason == bus.BY_HAND:
                self.stage.run_to(int(self._host["asked"]))
            self._begin()
        except BaseException as error:
            self._fail(error)
        self.calls += 1
        if self._stand_still is not None and (reason == bus.PAUSE or self._host["stopped"]):
            self._stand_still()

    def _diverged(self) -> None:
        error = self.stage.loop.undo_divergence(self._at)
        self._end()
        raise error

    def _fail(self, error: BaseException) -> None:
        """Nothing more happens on this bus until somebody was told."""
        self._host["stopped"] = 1
        if self._error is None:
            self._error = error

    def _abandon(self, thread: threading.Thread) -> None:
        """A firmware's thread, which may still run, never reaches this board again: it has a HOST record that is stopped, and
        the board goes on with a copy."""
        self._abandoned.add(thread)
        self._host["stopped"] = 1
        self._left.append(self._rows)
        self._take(self._rows.copy())
        self._host["stopped"] = self._host["serving"] = self._host["inside"] = 0
        self._host["hook"] = self._own_hook()
        self._stand_still = None

    def _settle(self) -> None:
        """After firmware that computed was given up: what its cycles noted is taken, and the stage stands where it stood."""
        self._end()
        self._begin()
        self._request(self._at, bus.SETTLE, 0, 0)
        self._end()

    def _take(self, rows: np.ndarray) -> None:
        self._rows, self._at = rows, rows.ctypes.data
        rows["own"] = self._at
        self._host = rows.view(plain(bus.HOST))[0]

    def note(self, text: str) -> None:
        """A line for the log, now."""
        self.log.append((self.stage.time, text))

    def _own_hook(self) -> int:
        """What calls the hook of `on_interrupt`: its address, or 0."""
        return (ctypes.cast(self._call_hook, ctypes.c_void_p).value or 0) if self._hook else 0

    def _hooked(self, _: Any) -> None:
        try:
            self._end()  # the hook may write to a chip itself: journals want what was before it first
            try:
                if self._hook is not None:
                    self._hook()
            finally:
                self._begin()
        except BaseException as error:
            self._fail(error)


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
