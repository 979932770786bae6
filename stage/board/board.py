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

from stage.board import bus_layouts
from stage.board.bus import host_record, host_requests
from stage.board.bus.host_record import DEVICE, EIGHT, HALF, LATCH, LATCHED, NOTHING, PULLS, UPPER, WIDE, WORD
from stage.board.bus.interrupt_controller import ANY_INTERRUPT_LINE, HIGHEST_LEVEL
from stage.board.bus_trace import BoardDescriber, BusTrace, Cycle
from stage.board.bus_waveforms import HostWaveforms
from stage.board.devices import device_options
from stage.board.devices.device import Device, DeviceDescriber, Encoder
from stage.board.devices.user_devices import CDevice, PythonDevice, UserDescriber
from stage.board.errors import HostError
from stage.board.host_record_link import Link
from stage.board.interrupt_hooks import PYTHONS_TIMERS
from stage.board.serial_line import SerialLines
from stage.chips.write_diagnostics import JournalLint
from stage.errors import ArgumentError, StageError, unknown_name_error
from stage.sim.stage import MAX_RUN_S, Stage
from stage.support.argument_checks import explain_arguments

DEFAULT_TRACE_LINES = 100_000  # lines of the trace
MAX_TRACE_LINES = 1 << 28
MAX_LOG_LINES = 1_000_000
MAX_DEVICE_PORTS = 1 << 16
MAX_SOURCES = 62  # of interrupts: bits of a word
DELAY_PIECE_US = 100_000  # a longer delay is made in pieces, between which Ctrl-C is heard
PORT_DESCRIPTIONS = ("", "address {}", "address {}", "upper byte of address {}", "address latch", "data", "interrupts")
"""Description of what a port reaches, by the kind of the port."""
_D = TypeVar("_D", bound=Device)


class Board:
    """Bus of a host with the chips of a stage on it. A stage has one board.

    Args:
        stage: A Stage.
        layout: A name of stage.board.LAYOUTS, a file (see layouts.read_layout) or a Layout; default: the usual one of each chip.
        base: The first port of the first chip, or a mapping axis -> first port of its chip; default: the layout's.
        stride: Ports from one chip to the next; default: the layout's.
        keep_cycles: Lines of the bus trace that are kept.
        devices: Devices on the bus, as text: "hctl2016:0x320:x", see device_options. `add_device` and `attach_device` add more
            later.

    Attributes:
        options: Arguments of the constructor except stage and devices, by name.
        places: The chips and their layouts.
        devices: Devices in the order in which they were put on the bus.
        regions, port_table: REGION and PORT records, which say what every port reaches.
        trace: The BusTrace.
        log: Lines that the firmware has logged, (seconds, text).
        driver: The firmware, a NativeHost, that has begun and not returned, or None.
        link: The connection to compiled code, for runners of firmware.
        serial: The serial line of the host, in memory.

    Raises:
        ArgumentError: A layout that does not fit the chips, ports that overlap or do not exist.
        FileError: There is no such file.
    """

    LINTS: ClassVar = True

    @explain_arguments
    def __init__(
        self,
        stage: Stage,
        layout: str | os.PathLike | bus_layouts.Layout | None = None,
        base: int | Mapping[str, int] | None = None,
        stride: int | None = None,
        *,
        keep_cycles: int = DEFAULT_TRACE_LINES,
        devices: Iterable[str] = (),
    ):
        if not isinstance(stage, Stage):
            raise ArgumentError(f"{stage!r} is no Stage: Board(Stage('xyz', chips=PCL240K)).")
        if int(keep_cycles) != keep_cycles or not 1 <= keep_cycles <= MAX_TRACE_LINES:
            raise ArgumentError(f"keep_cycles={keep_cycles!r}: a trace keeps 1 to {MAX_TRACE_LINES} lines.")
        layout = bus_layouts.load_layout(layout)
        self.stage = stage
        self.options = {"layout": layout, "base": base, "stride": stride, "keep_cycles": keep_cycles}
        chips = {stage.chips.index(axis.chip): axis.chip for axis in stage.axes.values()}
        self.places = bus_layouts.assign_ports(chips, layout, _map_bases_to_chips(stage, base), stride)
        self.regions, self.port_table = bus_layouts.make_port_table(self.places)
        self._initial_chips = [place.chip.make_replica() for place in self.places]
        self.trace = BusTrace(self, int(keep_cycles))
        stage.host = HostWaveforms(self)
        self.log: list[tuple[float, str]] = []
        self.driver: Any = None
        self.devices: list[Device] = []
        for chip in stage.chips:
            if self.LINTS and chip.journal_lint is None:
                chip.journal_lint = JournalLint(chip)
        self.serial_lines = SerialLines(self)
        self.serial = self.serial_lines.lines[0]
        self.link = Link(self)
        if not isinstance(devices, Iterable):
            raise ArgumentError(f'devices={devices!r}: a list of texts, for example ["hctl2016:0x320:x"].')
        for text in (devices,) if isinstance(devices, str) else devices:
            self.attach_device(*device_options.make_device(text))

    # --- requests of a host ---

    @explain_arguments
    def out8(self, port: int, value: int) -> None:
        """Write 8 bits to a port in one bus cycle.

        On a 16-bit bus this sets one half of the register, and the other half floats.
        """
        self.link.make_request(host_record.OUT8, port, value)

    @explain_arguments
    def in8(self, port: int) -> int:
        """Read 8 bits from a port in one bus cycle; a port without a chip or device reads FFh."""
        return self.link.make_request(host_record.IN8, port, 0)

    @explain_arguments
    def out16(self, port: int, value: int) -> None:
        """Write 16 bits to a port: one cycle on a 16-bit bus, two cycles with the low byte first on an 8-bit bus."""
        self.link.make_request(host_record.OUT16, port, value)

    @explain_arguments
    def in16(self, port: int) -> int:
        """Read 16 bits from a port: one cycle on a 16-bit bus, two cycles with the low byte first on an 8-bit bus."""
        return self.link.make_request(host_record.IN16, port, 0)

    @explain_arguments
    def out32(self, port: int, value: int) -> None:
        """Write 32 bits in two 16-bit cycles: the low half to `port`, then the high half to `port + 2`. An 8-bit bus
        takes four cycles."""
        self.link.make_request(host_record.OUT32, port, value)

    @explain_arguments
    def in32(self, port: int) -> int:
        """Read 32 bits in two 16-bit cycles: the low half from `port`, then the high half from `port + 2`."""
        return self.link.make_request(host_record.IN32, port, 0)

    @explain_arguments
    def delay_us(self, us: int) -> None:
        """Let time pass. After Ctrl-C the time stands somewhere within the delay, and the board can be used as before.

        Args:
            us: Microseconds.

        Raises:
            ArgumentError: Below 0, and beyond 1e15 (1e9 s).
        """
        if not 0 <= us <= MAX_RUN_S * 1_000_000:
            raise ArgumentError(f"us={us!r}: a delay takes 0 to 1e15 us (1e9 s).")
        if us <= DELAY_PIECE_US:
            self.link.make_request(host_record.DELAY, us, 0)
            return
        self.link.make_request(host_record.SETTLE, 0, 0)
        end = self.stage.now + int(us) * 1000
        while (left := end - self.stage.now) > 0:
            self.link.make_request(host_record.SPEND, min(left, DELAY_PIECE_US * 1000), 0)

    @property
    def micros(self) -> int:
        """Microseconds since power-up."""
        return self.stage.now // 1000

    @property
    def interrupt(self) -> bool:
        """True while a chip or a device pulls the interrupt line."""
        return bool(self.read_interrupt_mask())

    def read_interrupt_mask(self) -> int:
        """Return which chips and devices pull the interrupt line, as a bit mask: first the chips of the stage, then the
        devices.

        Reading the mask makes no bus cycle.
        """
        self.stage.ensure_powered()
        return int(host_requests.read_interrupt_mask.c(self.link.pointer))

    def on_interrupt(self, hook: Callable[[], None] | None) -> None:
        """Call `hook` while the interrupt line is asserted: after a bus cycle, or inside a delay at the exact
        nanosecond.

        The board calls the hook again until the line is released, but never from inside the hook. The hook may make bus
        cycles. While firmware runs, the firmware's own interrupt hook replaces this one.

        Args:
            hook: Function without arguments, or None to remove the hook.
        """
        self.link.make_request(host_record.SETTLE, 0, 0)
        self.link.hooks.set_hook(ANY_INTERRUPT_LINE, hook, interrupt_mask=-1)
        self.link.make_request(host_record.LEVEL, -1, 0)  # the line may be asserted now

    def on_timer(self, period_us: float, hook: Callable[[], None] | None, *, n: int = 0, level: int = 1) -> None:
        """Call `hook` periodically, for the first time one period from now: after a bus cycle, or inside a delay at the
        exact nanosecond.

        If a tick falls due while the previous one is still pending, the board counts it as missed. The hook may make
        bus cycles, and nothing interrupts it.

        Args:
            period_us: Period in microseconds; 0 turns the timer off.
            hook: Function without arguments; None turns the timer off.
            n: Number of the timer, 0 to 3.
            level: Level, 1 to 15, at which the timer interrupts hooks of the firmware, see docs/interrupts.md.

        Raises:
            ArgumentError: The period, timer or level is out of range.
        """
        if not (isinstance(period_us, int | float) and (period_us == 0 or 1e-3 <= period_us <= MAX_RUN_S * 1_000_000)):
            raise ArgumentError(
                f"period_us={period_us!r}: a timer's period is 0.001 to 1e15 us (1 ns to 1e9 s), 0 for off."
            )
        if n not in range(len(PYTHONS_TIMERS)):
            raise ArgumentError(f"n={n!r}: timers of a board in Python are 0 to {len(PYTHONS_TIMERS) - 1}.")
        if level not in range(1, HIGHEST_LEVEL + 1):
            raise ArgumentError(f"level={level!r}: levels of hooks are 1 to {HIGHEST_LEVEL}.")
        period = round(period_us * 1000)
        self.link.make_request(host_record.SETTLE, 0, 0)
        self.link.hooks.set_hook(PYTHONS_TIMERS[n], hook if period else None, level=level, period=period)

    # --- devices ---

    @explain_arguments
    def add_device(  # noqa: PLR0913  each is one property of the device
        self,
        ports: int | Iterable[int],
        read: Callable[[int], int] | None = None,
        write: Callable[[int, int], Any] | None = None,
        *,
        source: str | os.PathLike | Sequence[str | os.PathLike] | None = None,
        flags: Sequence[str] = (),
        state: np.ndarray | bytearray | None = None,
        describe: UserDescriber | None = None,
        name: str | None = None,
        encoders: Sequence[Encoder] = (),
        width: int = 8,
    ) -> Device:
        """Put a device of your own on the bus, see docs/devices.md.

        Args:
            ports: A port, a range or a list.
            read: Function `read(port) -> value`, called at the host's time, with the stage as it is then. Without one, reads give
                all ones.
            write: Function `write(port, value)`, likewise. Without one, writes are lost.
            source: Instead of both, a device in C: sources, or a library, with pulsestage_device.h.
            flags: Flags of the compiler for `source`.
            state: Array that a device in Python changes in place: snapshots of the stage carry it.
            describe: Function `describe(port, value, writes)` that returns what a cycle means, for the trace.
            name: What messages call it.
            encoders: Encoders that it counts, see `Device.counts`.
            width: Bits of its bus, 8 or 16. With 16 each register takes two ports, as in the layout "nova".

        Returns:
            The device; its `pull(...)` pulls the interrupt line.

        Raises:
            ArgumentError: Ports that do not exist or are taken.
            StageError: Firmware runs.
            LibraryError, CompileError, NoCompilerError, FileError: See CDevice.
        """
        if source is None:
            device: Device = PythonDevice(
                read, write, state=state, describe=describe, name=name, encoders=encoders, width=width
            )
        elif read is not None or write is not None or state is not None:
            raise ArgumentError(
                f"source={source!r}: the device has its functions and its state in C; read, write and state are Python's."
            )
        else:
            device = CDevice(source, flags=flags, describe=describe, name=name, encoders=encoders, width=width)
        return self.attach_device(device, ports)

    def attach_device(self, device: _D, ports: int | Iterable[int]) -> _D:
        """Put a device on the bus.

        Args:
            device: The device.
            ports: Its ports; for a shipped device the first port is enough.

        Returns:
            The device.

        Raises:
            ArgumentError, StageError: See `add_device`.
        """
        if not isinstance(device, Device):
            raise ArgumentError(f"{device!r} is no device: stage.board.devices has them, for example UART().")
        if device.board is not None:
            raise ArgumentError(f"{device.name} is on a board already. Make another one.")
        if (self.driver is not None and self.driver.running) or self.link.answering or self.link.calls % 2:
            raise StageError(f"{device.name}: firmware drives this board. Put devices on it before it runs.")
        numbers = _parse_ports_of_device(device, ports)
        if len(self.stage.chips) + len(self.devices) == MAX_SOURCES:
            raise ArgumentError(f"a bus has at most {MAX_SOURCES} chips and devices.")
        for port in numbers:
            if (occupant := self.ports.get(port)) is not None:
                raise ArgumentError(
                    f"{device.name}: port {port:03X}h is taken: {occupant}. Choose ports from "
                    f"{self._find_free_port(len(numbers)):03X}h on, for example."
                )
        device.attach_to(self, numbers)
        self.devices.append(device)
        self._rebuild_port_table()
        self.link.publish_devices()
        self.stage.attach_device(device.name, device.list_arrays())
        return device

    def _rebuild_port_table(self) -> None:
        """Rebuild the table of ports from the chips and the devices, and pass it to compiled code."""
        rows = {}
        for k, device in enumerate(self.devices):
            for n, port in enumerate(device.ports):
                wide = device.width == 16
                rows[port] = (DEVICE, k, n // 2 if wide else n, EIGHT if not wide else UPPER if n % 2 else WIDE)
        self.regions, self.port_table = bus_layouts.make_port_table(self.places, rows)
        self.link.write_port_table()

    def _find_free_port(self, n: int) -> int:
        """Return the first of `n` consecutive ports that reach no chip or device."""
        return (max(self.ports) + 16) & ~15 if max(self.ports) + n + 16 <= host_record.LAST_PORT else 0

    # --- what has happened ---

    @property
    def cycles(self) -> int:
        """Number of bus cycles since the board was created."""
        return int(self.link.record["cycles"])

    @property
    def strays(self) -> list[Cycle]:
        """Cycles of the trace that reached no chip or device, or only half of a register."""
        return [cycle for cycle in self.trace if cycle.stray]

    @property
    def ports(self) -> dict[int, str]:
        """Description of each port that reaches a chip or device."""
        names = {place.index: self.join_axis_names(place.index) for place in self.places}
        return {
            port: f"{names[int(p['chip'])]} {PORT_DESCRIPTIONS[int(p['kind'])].format(int(p['address']))}"
            if p["kind"] != DEVICE
            else f"{self.devices[int(p['chip'])].name}, {self.devices[int(p['chip'])].name_port(int(p['address']))}"
            for port, p in self._list_ports()
        }

    def __repr__(self) -> str:
        members = [f"{self.join_axis_names(p.index)} at {p.first:03X}h ({p.layout.name})" for p in self.places]
        members += [device.name for device in self.devices]
        return f"<Board {', '.join(members)}; {self.cycles:,} cycles>"

    # --- inside ---

    @explain_arguments
    def join_axis_names(self, chip: int) -> str:
        """Return the joined names of the axes that a chip drives, for example "xyz".

        Args:
            chip: Index of the chip in `stage.chips`.
        """
        return "".join(axis.name for axis in self.stage.axes.values() if axis.chip is self.stage.chips[chip])

    def make_describer(self) -> BoardDescriber:
        """Return a function that explains bus cycles. It must receive all cycles from the first one on."""
        listeners = {
            place.index: twin.make_describer() for place, twin in zip(self.places, self._initial_chips, strict=True)
        }
        latches: dict[int, int] = {}
        by_port = {port: tuple(p) for port, p in self._list_ports()}
        of_devices = [device.make_describer() for device in self.devices]

        def describe(port: int, value: int, writes: bool, wide: bool) -> str:
            kind, chip, address, mask, _ = by_port.get(port, (NOTHING, 0, 0, 0, 0))
            if kind == NOTHING:
                return "nothing is here"
            if kind == PULLS:
                on = [self.join_axis_names(k) for k in range(len(self.stage.chips)) if value >> k & 1]
                return f"interrupts: {', '.join(on) or 'none'}"
            if kind == HALF or (kind == DEVICE and mask == UPPER):
                value = value << 8 | (0xFF if writes else 0)
            elif writes and not wide and (kind == WORD or (kind == DEVICE and mask == WIDE)):
                value |= 0xFF00
            if kind == DEVICE:
                words = self._describe_device_cycle(of_devices[chip], address, value, writes, mask != EIGHT)
                return f"{self.devices[chip].name}: {words}"
            if kind == LATCH:
                latches[port] = value & mask
                words = f"address latch = {value:02X}h" if writes else "the address latch cannot be read"
            else:
                if kind == LATCHED:
                    address = latches.get(port - 1, 0)
                listener = listeners[chip]
                words = listener.write(address, value) if writes else listener.read(address, value)
            return f"{self.join_axis_names(chip)}: {words}"

        return describe

    def _describe_device_cycle(self, listener: DeviceDescriber, n: int, value: int, writes: bool, wide: bool) -> str:
        """Explain a bus cycle of a device. If the user's `describe` function fails, return its error, so that the trace
        still prints."""
        loop, before = self.stage.loop, self.stage.loop.time_refusal
        loop.time_refusal = "a describe= function only explains cycles: it makes none and lets no time pass."
        try:
            return listener(n, value, writes, wide)
        except Exception as error:
            return f"its function describe raised {type(error).__name__}: {error}"
        finally:
            loop.time_refusal = before

    def _list_ports(self) -> list[tuple[int, Any]]:
        """Return each port that reaches a chip or device, with its PORT record."""
        pairs = zip(bus_layouts.list_port_numbers(self.regions).tolist(), self.port_table, strict=True)
        return [(port, p) for port, p in pairs if p["kind"]]

    def add_log_line(self, text: str) -> None:
        """Add a line with the current time to the log.

        Raises:
            HostError: The log is full.
        """
        self._check_log_lines(len(self.log))
        self.log.append((self.stage.time, text))

    def _check_log_lines(self, lines: int) -> None:
        """Raise HostError if a log with this number of lines has no room for another."""
        if lines >= MAX_LOG_LINES:
            raise HostError(
                f"{MAX_LOG_LINES:,} lines were noted by ps_log, and a log keeps no more (now {self.stage.time:.6f} s): a loop "
                "without end? Note less, or clear host.log between two pieces of a run."
            )


def _map_bases_to_chips(stage: Stage, base: int | Mapping[str, int] | None) -> Any:
    """Convert a mapping from axis names to first ports into a mapping from chips to first ports."""
    if not isinstance(base, Mapping):
        return base
    for name in base:
        if name not in stage.axes:
            raise unknown_name_error("axis", name, stage.axes)
    by_chip = {stage.axes[name].chip: port for name, port in base.items()}
    for axis in stage.axes.values():
        if axis.chip not in by_chip:
            raise ArgumentError(f"base={dict(base)!r}: the chip of axis {axis.name} has no first port.")
    return by_chip


def _parse_ports_of_device(device: Device, ports: Any) -> list[int]:
    """Return the ports of a device as a list. Raises ArgumentError if they do not fit the device."""
    one, text = isinstance(ports, int | np.integer), reprlib.repr(ports)
    numbers = [int(ports)] if one else list(ports) if isinstance(ports, Iterable) else []
    if one and device.PORTS:
        numbers = list(range(numbers[0], numbers[0] + device.PORTS))
    if not numbers or any(not isinstance(p, int | np.integer) or not 0 <= p <= host_record.LAST_PORT for p in numbers):
        raise ArgumentError(
            f"{device.name}, ports={text}: ports are whole numbers from 0 to {host_record.LAST_PORT:X}h, one at least."
        )
    if len(set(numbers)) != len(numbers) or len(numbers) > MAX_DEVICE_PORTS:
        raise ArgumentError(f"{device.name}, ports={text}: each port once, and at most {MAX_DEVICE_PORTS:,} of them.")
    if device.PORTS and len(numbers) != device.PORTS:
        raise ArgumentError(f"{device.name}: it has {device.PORTS} ports, and {len(numbers)} are given.")
    pairs = zip(numbers[::2], numbers[1::2], strict=False)
    if device.width == 16 and (len(numbers) % 2 or any(high != low + 1 for low, high in pairs)):
        raise ArgumentError(
            f"{device.name}: with width=16 each register takes two ports, one behind the other: range(0x320, 0x328) for four "
            "registers."
        )
    return [int(p) for p in numbers]
