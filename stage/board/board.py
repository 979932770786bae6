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
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np

from stage.board import layout_files, layouts
from stage.board.bus import host_record, requests
from stage.board.bus.interrupts import ANY_LINE, HIGHEST
from stage.board.devices import device_texts
from stage.board.devices.device import Device, Encoder, Listener
from stage.board.devices.user_devices import CDevice, PythonDevice, Tell
from stage.board.errors import HostError
from stage.board.interrupt_hooks import PYTHONS_TIMERS
from stage.board.link import Link
from stage.board.trace import BusTrace, Cycle, Meaning
from stage.board.waveforms import HostWaveforms
from stage.chips.diagnostics import JournalLint
from stage.errors import ArgumentError, StageError, unknown
from stage.sim.stage import MAX_RUN_S, Stage
from stage.support.arguments import told

KEPT_CYCLES = 100_000
MOST_LINES = 1_000_000
MOST_PORTS = 1 << 16  # of a device
MOST_SOURCES = 62  # of interrupts: bits of a word
PIECE_US = 100_000  # a longer delay is made in pieces, between which Ctrl-C is heard
_D = TypeVar("_D", bound=Device)


class Board:
    """A bus with the chips of `stage` on it. One board a stage.

    Args:
        stage: a Stage.
        layout: a name of stage.board.LAYOUTS, a file (see layout_files) or a Layout; default: what is usual for each chip.
        base: the first port of the first chip, or a mapping axis -> first port of its chip; default: the layout's.
        stride: ports from one chip to the next; default: the layout's.
        keep_cycles: lines of the bus trace that are kept.
        devices: what else is on the bus, as text: "hctl2016:0x320:x", see stage.board.devices.device_texts; or later, by `put` and
            `device`.
    Attributes:
        options: the arguments except stage and devices, by name; places: the chips and their layouts.
        devices: in the order in which they were put on the bus.
        regions, port_table: REGION and PORT records, what every port reaches.
        trace: the BusTrace; log: lines that the firmware noted, (seconds, text).
        driver: the firmware, a NativeHost, that has begun and not returned, or None.
        link: its connection to compiled code, for runners of firmware.
    Raises:
        ArgumentError: a layout that does not fit the chips, ports that overlap or do not exist. FileError: no such file.
    """

    LINTS: ClassVar = True

    @told
    def __init__(
        self,
        stage: Stage,
        layout: str | os.PathLike | layouts.Layout | None = None,
        base: int | Mapping[str, int] | None = None,
        stride: int | None = None,
        *,
        keep_cycles: int = KEPT_CYCLES,
        devices: Iterable[str] = (),
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
        stage.host = HostWaveforms(self)
        self.log: list[tuple[float, str]] = []
        self.driver: Any = None
        self.devices: list[Device] = []
        for chip in stage.chips:
            if self.LINTS and chip.journal_lint is None:
                chip.journal_lint = JournalLint(chip)
        self.link = Link(self)
        if not isinstance(devices, Iterable):
            raise ArgumentError(f'devices={devices!r}: a list of texts, for example ["hctl2016:0x320:x"].')
        for text in (devices,) if isinstance(devices, str) else devices:
            device_texts.put(self, text)

    # --- what a host does ---

    @told
    def out8(self, port: int, value: int) -> None:
        """One write cycle of 8 bits. Of a chip with a bus of 16 bits it sets half a register; the other half floats."""
        self.link.ask(host_record.OUT8, port, value)

    @told
    def in8(self, port: int) -> int:
        """One read cycle of 8 bits; FFh where there is nothing."""
        return self.link.ask(host_record.IN8, port, 0)

    @told
    def out16(self, port: int, value: int) -> None:
        """One write cycle of 16 bits; two of 8, the low byte first, at chips with a bus of 8 bits."""
        self.link.ask(host_record.OUT16, port, value)

    @told
    def in16(self, port: int) -> int:
        """One read cycle of 16 bits; two of 8, the low byte first, at chips with a bus of 8 bits."""
        return self.link.ask(host_record.IN16, port, 0)

    @told
    def out32(self, port: int, value: int) -> None:
        """Two write cycles of 16 bits, at `port` the low half, then at `port + 2` the high one; four of 8 at chips with a bus of
        8 bits."""
        self.link.ask(host_record.OUT32, port, value)

    @told
    def in32(self, port: int) -> int:
        """Two read cycles of 16 bits, in the same order."""
        return self.link.ask(host_record.IN32, port, 0)

    @told
    def delay_us(self, us: int) -> None:
        """Microseconds pass. Raises ArgumentError below 0, and beyond 1e15 (1e9 s). After Ctrl-C time stands
        somewhere in the delay, and the board can be used as before."""
        if not 0 <= us <= MAX_RUN_S * 1_000_000:
            raise ArgumentError(f"us={us!r}: a delay takes 0 to 1e15 us (1e9 s).")
        if us <= PIECE_US:
            self.link.ask(host_record.DELAY, us, 0)
            return
        self.link.ask(host_record.SETTLE, 0, 0)
        end = self.stage.now + int(us) * 1000
        while (left := end - self.stage.now) > 0:
            self.link.ask(host_record.SPEND, min(left, PIECE_US * 1000), 0)

    @property
    def micros(self) -> int:
        """Microseconds since power-up."""
        return self.stage.now // 1000

    @property
    def interrupt(self) -> bool:
        """Whether a chip or a device pulls the interrupt line."""
        return bool(self.pulling())

    def pulling(self) -> int:
        """Who pulls the interrupt line, a bit each: the stage's chips, and behind them the devices. No bus cycle."""
        self.stage.ensure_powered()
        return int(requests.pulling.c(self.link.pointer))

    def on_interrupt(self, hook: Callable[[], None] | None) -> None:
        """Call `hook` while the interrupt line is asserted: after a bus cycle, or within a delay at the very ns; again and
        again until it is released, and not from within itself. It may make bus cycles. None: nobody is called. Firmware's own
        hook comes in its place, until the firmware returns."""
        self.link.ask(host_record.SETTLE, 0, 0)
        self.link.hooks.set(ANY_LINE, hook, lines=-1)
        self.link.ask(host_record.LEVEL, -1, 0)  # the line may be asserted now

    def on_timer(self, period_us: float, hook: Callable[[], None] | None, *, n: int = 0, level: int = 1) -> None:
        """Call `hook` every `period_us`, for the first time that long from now: after a bus cycle, or within a delay at the ns.

        A tick that comes while the one before it still waits is missed. The hook may make bus cycles; it is not interrupted. n:
        which of 4 timers; level: 1 to 15, at which it interrupts hooks of the firmware, see docs/interrupts.md. hook=None or
        period_us=0: the timer is off. Raises ArgumentError.
        """
        if not (isinstance(period_us, int | float) and (period_us == 0 or 1e-3 <= period_us <= MAX_RUN_S * 1_000_000)):
            raise ArgumentError(
                f"period_us={period_us!r}: a timer's period is 0.001 to 1e15 us (1 ns to 1e9 s), 0 for off."
            )
        if n not in range(len(PYTHONS_TIMERS)):
            raise ArgumentError(f"n={n!r}: timers of a board in Python are 0 to {len(PYTHONS_TIMERS) - 1}.")
        if level not in range(1, HIGHEST + 1):
            raise ArgumentError(f"level={level!r}: levels of hooks are 1 to {HIGHEST}.")
        period = round(period_us * 1000)
        self.link.ask(host_record.SETTLE, 0, 0)
        self.link.hooks.set(PYTHONS_TIMERS[n], hook if period else None, level=level, period=period)

    # --- devices ---

    @told
    def device(
        self,
        ports: int | Iterable[int],
        read: Callable[[int], int] | None = None,
        write: Callable[[int, int], Any] | None = None,
        *,
        source: str | os.PathLike | Sequence[str | os.PathLike] | None = None,
        flags: Sequence[str] = (),
        state: np.ndarray | bytearray | None = None,
        tell: Tell | None = None,
        name: str | None = None,
        encoders: Sequence[Encoder] = (),
        width: int = 8,
    ) -> Device:
        """A device of your own on the bus, see docs/devices.md.

        Args:
            ports: a port, a range or a list.
            read, write: functions in Python, `read(port) -> value` and `write(port, value)`, which are called at the host's time,
                with the stage as it is then. Without one, reads give all ones and writes are lost.
            source, flags: in their place a device in C: sources, which are built with these flags, or a library, with
                pulsestage_device.h.
            state: of a device in Python, an array that it changes in place: snapshots of the stage carry it.
            tell: `tell(port, value, writes)` -> what a cycle means, for the trace.
            name: what messages call it; encoders: `Encoder`s that it counts, see `Device.counts`.
            width: bits of its bus, 8 or 16. With 16 each register takes two ports, as in the layout "nova".
        Returns the device; its `pull(...)` pulls the interrupt line.
        Raises ArgumentError: ports that do not exist or are taken; StageError while firmware runs; of a device in C as CDevice.
        """
        if source is None:
            own: Device = PythonDevice(read, write, state=state, tell=tell, name=name, encoders=encoders, width=width)
        elif read is not None or write is not None or state is not None:
            raise ArgumentError(
                f"source={source!r}: the device has its functions and its state in C; read, write and state are Python's."
            )
        else:
            own = CDevice(source, flags=flags, tell=tell, name=name, encoders=encoders, width=width)
        return self.put(own, ports)

    def put(self, device: _D, ports: int | Iterable[int]) -> _D:
        """Put a device on the bus, at these ports; of a shipped one the first is enough. Returns the device. Raises as `device`."""
        if not isinstance(device, Device):
            raise ArgumentError(f"{device!r} is no device: stage.board.devices has them, for example UART().")
        if device.board is not None:
            raise ArgumentError(f"{device.name} is on a board already. Make another one.")
        if (self.driver is not None and self.driver.running) or self.link.answering or self.link.calls % 2:
            raise StageError(f"{device.name}: firmware drives this board. Put devices on it before it runs.")
        taken = _ports(device, ports)
        if len(self.stage.chips) + len(self.devices) == MOST_SOURCES:
            raise ArgumentError(f"a bus has at most {MOST_SOURCES} chips and devices.")
        for port in taken:
            if (there := self.ports.get(port)) is not None:
                raise ArgumentError(
                    f"{device.name}: port {port:03X}h is taken: {there}. Choose ports from {self._free(len(taken)):03X}h on, "
                    "for example."
                )
        device.join(self, taken)
        self.devices.append(device)
        self._lay_ports()
        self.changed()
        self.stage.attach(device.name, device.kept())
        return device

    def changed(self) -> None:
        """A device has other functions now, or there is another device."""
        self.link.lay_devices()

    def _lay_ports(self) -> None:
        """Make the table of ports again."""
        lines = {}
        for k, device in enumerate(self.devices):
            for n, port in enumerate(device.ports):
                wide = device.width == 16
                mask = host_record.EIGHT if not wide else host_record.UPPER if n % 2 else host_record.WIDE
                lines[port] = (host_record.DEVICE, k, n // 2 if wide else n, mask)
        self.regions, self.port_table = layouts.table(self.places, lines)
        self.link.lay_ports()

    def _free(self, n: int) -> int:
        """A port from which on so many are free."""
        return (max(self.ports) + 16) & ~15 if max(self.ports) + n + 16 <= host_record.LAST_PORT else 0

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
            if p["kind"] != host_record.DEVICE
            else f"{self.devices[int(p['chip'])].name}, {self.devices[int(p['chip'])].port_name(int(p['address']))}"
            for port, p in self._by_port()
        }

    def __repr__(self) -> str:
        lie = ", ".join(f"{self.name_of(p.index)} at {p.first:03X}h ({p.layout.name})" for p in self.places)
        lie += "".join(f", {device.name}" for device in self.devices)
        return f"<Board {lie}; {self.cycles:,} cycles>"

    # --- inside ---

    @told
    def name_of(self, chip: int) -> str:
        """The axes of a chip."""
        return "".join(axis.name for axis in self.stage.axes.values() if axis.chip is self.stage.chips[chip])

    def teller(self) -> Meaning:
        """Tells what a bus cycle means, those before it given, from the first on."""
        listeners = {place.index: twin.listener() for place, twin in zip(self.places, self._at_first, strict=True)}
        latches: dict[int, int] = {}
        reached = {port: tuple(p) for port, p in self._by_port()}
        told = [device.listener() for device in self.devices]

        def tell(port: int, value: int, writes: bool, wide: bool) -> str:
            kind, chip, address, mask, _ = reached.get(port, (host_record.NOTHING, 0, 0, 0, 0))
            if kind == host_record.NOTHING:
                return "nothing is here"
            if kind == host_record.PULLS:
                on = [self.name_of(k) for k in range(len(self.stage.chips)) if value >> k & 1]
                return f"interrupts: {', '.join(on) or 'none'}"
            if kind == host_record.DEVICE:
                if mask == host_record.UPPER:
                    value = value << 8 | (0xFF if writes else 0)
                elif mask == host_record.WIDE and writes and not wide:
                    value |= 0xFF00
                return f"{self.devices[chip].name}: {self._told(told[chip], address, value, writes, mask != host_record.EIGHT)}"
            name = f"{self.name_of(chip)}: "
            if kind == host_record.LATCH:
                latches[port] = value & mask
                return name + (f"address latch = {value:02X}h" if writes else "the address latch cannot be read")
            if kind == host_record.LATCHED:
                address = latches.get(port - 1, 0)
            if kind == host_record.HALF:
                value = value << 8 | (0xFF if writes else 0)
            elif kind == host_record.WORD and writes and not wide:
                value |= 0xFF00
            listener = listeners[chip]
            return name + (listener.write(address, value) if writes else listener.read(address, value))

        return tell

    def _told(self, listener: Listener, n: int, value: int, writes: bool, wide: bool) -> str:
        """What a cycle of a device means. A `tell` that fails does not hide what the trace is printed for."""
        loop, before = self.stage.loop, self.stage.loop.time_refusal
        loop.time_refusal = "a tell= says what cycles mean, and neither makes any nor lets time pass."
        try:
            return listener(n, value, writes, wide)
        except Exception as error:
            return f"its tell has raised {type(error).__name__}: {error}"
        finally:
            loop.time_refusal = before

    def _by_port(self) -> list[tuple[int, Any]]:
        """The ports that reach something, with their PORT records."""
        pairs = zip(layouts.numbers(self.regions).tolist(), self.port_table, strict=True)
        return [(port, p) for port, p in pairs if p["kind"]]

    def note(self, text: str) -> None:
        """A line for the log, now. Raises HostError for more of them than a log keeps."""
        self.check_lines(len(self.log))
        self.log.append((self.stage.time, text))

    @told
    def check_lines(self, lines: int) -> None:
        """Raises HostError if a log has so many lines that there is room for no more."""
        if lines >= MOST_LINES:
            raise HostError(
                f"{MOST_LINES:,} lines were noted by ps_log, and a log keeps no more (now {self.stage.time:.6f} s): a loop without "
                "end? Note less, or clear host_record.log between two pieces of a run."
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


def _ports(device: Device, ports: Any) -> list[int]:
    """The ports that a device gets. Raises ArgumentError."""
    one, shown = isinstance(ports, int | np.integer), reprlib.repr(ports)
    taken = [int(ports)] if one else list(ports) if isinstance(ports, Iterable) else []
    if one and device.PORTS:
        taken = list(range(taken[0], taken[0] + device.PORTS))
    if not taken or any(not isinstance(p, int | np.integer) or not 0 <= p <= host_record.LAST_PORT for p in taken):
        raise ArgumentError(
            f"{device.name}, ports={shown}: ports are whole numbers from 0 to {host_record.LAST_PORT:X}h, one at least."
        )
    if len(set(taken)) != len(taken) or len(taken) > MOST_PORTS:
        raise ArgumentError(f"{device.name}, ports={shown}: each port once, and at most {MOST_PORTS:,} of them.")
    if device.PORTS and len(taken) != device.PORTS:
        raise ArgumentError(f"{device.name}: it has {device.PORTS} ports, and {len(taken)} are given.")
    if device.width == 16 and (len(taken) % 2 or any(b != a + 1 for a, b in zip(taken[::2], taken[1::2], strict=True))):
        raise ArgumentError(
            f"{device.name}: with width=16 each register takes two ports, one behind the other: range(0x320, 0x328) for four "
            "registers."
        )
    return [int(p) for p in taken]
