"""`TargetHost`: a program for another processor drives a board, on an emulator of that processor.

    host = TargetHost("firmware.elf", board, mcu="atmega2560", map="data=A,address=C:0-1,cs=B0,wr=G0,rd=G1")
    result = host.run(timeout=10)

It works like NativeHost, except that instructions also take simulated time.
"""

from __future__ import annotations

import math
import os
import re
import socket
from collections.abc import Sequence
from pathlib import Path

from stage.board.board import Board
from stage.board.bus.serial_core import SERIAL_LINE_COUNT
from stage.board.memory_mapped_ports import MemoryWindow, parse_windows
from stage.board.native_host import Host
from stage.board.pin_assignment import PinLine, parse_wiring
from stage.board.thread_runner import PATIENCE_S, Program
from stage.errors import ArgumentError
from stage.targets import supported_processors
from stage.targets.nvic import IRQ_COUNT

MAP_EXAMPLE = "0x40021000=0x300+0x40"
AVR_SERIAL_LACK = "this AVR has no UART, or simavr is of another version than 1.6, whose UART is known."
CORTEX_SERIAL_LACK = (
    "the UARTs of Cortex-M parts differ by manufacturer and are not emulated. Put a 16550 on the bus (--device uart:0x3F8) and "
    "map its ports (--map 0x40013800=0x3F8+8)."
)
PC_SERIAL_LACK = "a PC's serial line is a 16550 on its bus. Add one: --device uart:0x3F8."
DEBUG_PATIENCE_S = 1e9  # with a person at a debugger


class TargetHost(Host):
    """Firmware that runs as a program of another processor, on an emulator.

    Args:
        firmware: An ELF program; for mcu 8086, a .COM or .EXE file.
        board: A Board; only one firmware at a time drives it.
        mcu: Name of the processor, for example atmega2560, cortex-m3, 8086.
        map: Wiring of the board to the processor, one text or several: the pins of an AVR, see stage.targets.avr_bus_wiring; the
            memory windows of a Cortex-M, see stage.board.memory_mapped_ports; an 8086 has ports of its own.
        pins: Pins of an AVR that are STEP/DIR lines and switches of axes, one text or several; see stage.board.pin_assignment.
        mcu_clock: Clock of the processor, Hz; None: the default in docs/targets.md.
        gdb: TCP port on 127.0.0.1 at which the processor waits for a debugger (GDB); None: no debugger.
        isolated: Whether the firmware runs in a process of its own, see stage.board.isolation.
        patience: Longest real time that the firmware may run while no simulated time passes, s.

    Raises:
        ArgumentError: The mcu is unknown, the map has another form, or the clock or patience is out of range.
        NoEmulatorError: The emulator is not installed.
        LibraryError, FileError: The file is no program for this processor.
    """

    SERIAL_LINES = SERIAL_LINE_COUNT

    def __init__(  # noqa: PLR0913  each is one property of the processor or of its wiring
        self,
        firmware: str | os.PathLike,
        board: Board,
        *,
        mcu: str,
        map: str | Sequence[str] = (),
        pins: str | Sequence[str] = (),
        mcu_clock: float | None = None,
        gdb: int | None = None,
        isolated: bool = os.name == "posix",
        patience: float = PATIENCE_S,
    ):
        self._check_arguments(board, patience, "'firmware.elf'")
        if mcu_clock is not None and not (
            isinstance(mcu_clock, int | float) and 1e3 <= mcu_clock <= 1e9 and math.isfinite(mcu_clock)
        ):
            raise ArgumentError(f"mcu_clock={mcu_clock!r}: Hz of the processor's clock, 1e3 to 1e9.")
        if gdb is not None and not (isinstance(gdb, int) and 1024 <= gdb < 65536):
            raise ArgumentError(f"gdb={gdb!r}: a TCP port, 1024 to 65535.")
        if gdb is not None:
            _check_port_is_free(gdb)
        self.mcu = supported_processors.check_mcu(mcu)
        maps = [map] if isinstance(map, str) else list(map)
        chips = {name: axis.chip for name, axis in board.stage.axes.items()}
        hz = None if mcu_clock is None else round(mcu_clock)
        wiring = parse_wiring(pins, chips, fold_case=True)
        program = make_program(Path(firmware), self.mcu, maps, wiring.lines, hz, gdb)
        super().__init__(program, board, isolated, DEBUG_PATIENCE_S if gdb else patience)
        self.serial_lack = (
            AVR_SERIAL_LACK
            if mcu in supported_processors.AVRS
            else CORTEX_SERIAL_LACK
            if mcu in supported_processors.CORTEX_NAMES
            else PC_SERIAL_LACK
        )
        self._connect_uarts(wiring)


def _check_port_is_free(port: int) -> None:
    """Raise ArgumentError if a TCP port is in use.

    An emulator would notice that only during the run, and simavr would then wait forever.
    """
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind(("127.0.0.1", port))
        except OSError as error:
            raise ArgumentError(
                f"gdb={port}: {error.strerror}. Choose another port, or end what listens there."
            ) from None


def make_program(
    path: Path, mcu: str, maps: list[str], lines: tuple[PinLine, ...], hz: int | None, gdb: int | None
) -> Program:
    """Create a program for a processor.

    Args:
        path: The file.
        mcu: Name of the processor.
        maps: Wiring of the board to the processor, see `TargetHost`.
        lines: Lines of axes at the pins of the processor.
        hz: Clock of the processor in Hz, or None.
        gdb: TCP port of a GDB server, or None.

    Raises:
        ArgumentError, NoEmulatorError: See `TargetHost`.
    """
    if mcu in supported_processors.AVRS:
        from stage.targets.avr_bus_wiring import parse_bus_pins
        from stage.targets.simavr import AvrProgram

        supported_processors.load_simavr()
        bus = parse_bus_pins(maps) if maps or not lines else None
        return AvrProgram(path, mcu, bus, lines, hz, gdb)
    if lines:
        raise ArgumentError(f"--pins {lines[0]}: only an AVR's pins can be lines of an axis so far; {mcu} is none.")
    supported_processors.check_unicorn()
    if mcu in supported_processors.CORTEX_NAMES:
        from stage.targets.cortex_m import CortexProgram

        windows, irq = _parse_cortex_maps(maps)
        return CortexProgram(path, mcu, hz, windows, irq, gdb)
    from stage.targets.pc_8086 import PcProgram

    return PcProgram(path, hz, _parse_pc_maps(maps), gdb)


def _parse_cortex_maps(maps: list[str]) -> tuple[tuple[MemoryWindow, ...], int | None]:
    """Parse texts such as 0x40021000=0x300+0x40 (a window) and irq=6 (the NVIC interrupt to which the board's line is wired)."""
    wires = [m for m in maps if m.strip().startswith("irq")]
    windows = parse_windows([m for m in maps if m not in wires])
    match = re.fullmatch(r"\s*irq\s*=\s*([0-9]+)\s*", wires[0]) if wires else None
    if len(wires) > 1 or (wires and (match is None or int(match[1]) >= IRQ_COUNT)):
        raise ArgumentError(
            f"--map {' '.join(wires)!r}: say once irq=0 to irq={IRQ_COUNT - 1}, the interrupt that the line is."
        )
    if not windows:
        raise ArgumentError(
            f"--map: where in the memory of the processor are the chips? For example --map {MAP_EXAMPLE}."
        )
    return windows, int(match[1]) if match else None


def _parse_pc_maps(maps: list[str]) -> int | None:
    """Parse a text such as irq=5: the interrupt of a PC to which the board's line is wired."""
    if not maps:
        return None
    match = re.fullmatch(r"\s*irq\s*=\s*([2-7])\s*", maps[0]) if len(maps) == 1 else None
    if match is None:
        raise ArgumentError(
            f"--map {' '.join(maps)!r}: an 8086 reaches the board by IN and OUT; of it only irq=2 to irq=7 can be said."
        )
    return int(match[1])
