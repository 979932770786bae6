"""`TargetHost`: a program for another processor drives a board, on an emulator of that processor.

    host = TargetHost("firmware.elf", board, mcu="atmega2560", map="data=A,address=C:0-1,cs=B0,wr=G0,rd=G1")
    result = host.run(timeout=10)

All else is as with NativeHost, except that time passes in its instructions, too.
"""

from __future__ import annotations

import math
import os
import re
import socket
from collections.abc import Sequence
from pathlib import Path

from stage.board.board import Board
from stage.board.host import Host
from stage.board.thread_runner import PATIENCE_S, Program
from stage.board.windows import Window, parse_windows
from stage.errors import ArgumentError
from stage.targets import mcus
from stage.targets.nvic import IRQS

EXAMPLE = "0x40021000=0x300+0x40"
FOR_EVER = 1e9  # s of patience with a person at a debugger


class TargetHost(Host):
    """Firmware as a program of another processor.

    Args:
        firmware: an ELF program; for mcu 8086 a .COM or .EXE.
        board: a Board; one firmware at a time drives it.
        mcu: the processor, for example atmega2560, cortex-m3, 8086.
        map: how the board is wired to it, text or several: an AVR's pins, see stage.targets.pins; of a Cortex-M windows, see
            stage.board.windows; an 8086 has ports of its own.
        mcu_clock: Hz of its clock; default: what is usual for it, see docs/targets.md.
        gdb: TCP port, on 127.0.0.1, at which the processor waits for a GDB.
        isolated: run it in a process of its own, see stage.board.isolation.
        patience: seconds of real time that it may run without simulated time passing.
    Raises:
        ArgumentError: an unknown mcu, a map of another form, a clock or a patience that is none.
        NoEmulatorError: the emulator is not installed.
        LibraryError, FileError: no program of this processor.
    """

    def __init__(
        self,
        firmware: str | os.PathLike,
        board: Board,
        *,
        mcu: str,
        map: str | Sequence[str] = (),
        mcu_clock: float | None = None,
        gdb: int | None = None,
        isolated: bool = os.name == "posix",
        patience: float = PATIENCE_S,
    ):
        self._check(board, patience, "'firmware.elf'")
        if mcu_clock is not None and not (
            isinstance(mcu_clock, int | float) and 1e3 <= mcu_clock <= 1e9 and math.isfinite(mcu_clock)
        ):
            raise ArgumentError(f"mcu_clock={mcu_clock!r}: Hz of the processor's clock, 1e3 to 1e9.")
        if gdb is not None and not (isinstance(gdb, int) and 1024 <= gdb < 65536):
            raise ArgumentError(f"gdb={gdb!r}: a TCP port, 1024 to 65535.")
        if gdb is not None:
            _need_free(gdb)
        self.mcu = mcus.checked(mcu)
        maps = [map] if isinstance(map, str) else list(map)
        program = program_of(Path(firmware), self.mcu, maps, None if mcu_clock is None else round(mcu_clock), gdb)
        super().__init__(program, board, isolated, FOR_EVER if gdb else patience)


def _need_free(port: int) -> None:
    """The emulators find a port that is in use only while they run; simavr then waits for nobody, for ever."""
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind(("127.0.0.1", port))
        except OSError as error:
            raise ArgumentError(
                f"gdb={port}: {error.strerror}. Choose another port, or end what listens there."
            ) from None


def program_of(path: Path, mcu: str, maps: list[str], hz: int | None, gdb: int | None) -> Program:
    """The file as a program of that processor. Raises as `TargetHost`."""
    if mcu in mcus.AVRS:
        from stage.targets.pins import pins
        from stage.targets.simavr import AvrProgram

        mcus.simavr()
        return AvrProgram(path, mcu, pins(maps), hz, gdb)
    mcus.need_unicorn()
    if mcu in mcus.CORTEX:
        from stage.targets.cortex import CortexProgram

        found, irq = _windows_and_irq(maps)
        return CortexProgram(path, mcu, hz, found, irq, gdb)
    from stage.targets.pc import PcProgram

    return PcProgram(path, hz, _irq(maps), gdb)


def _windows_and_irq(maps: list[str]) -> tuple[tuple[Window, ...], int | None]:
    """--map 0x40021000=0x300+0x40, and irq=6: which of NVIC's interrupts the board's line is wired to."""
    wires = [m for m in maps if m.strip().startswith("irq")]
    found = parse_windows([m for m in maps if m not in wires])
    match = re.fullmatch(r"\s*irq\s*=\s*([0-9]+)\s*", wires[0]) if wires else None
    if len(wires) > 1 or (wires and (match is None or int(match[1]) >= IRQS)):
        raise ArgumentError(
            f"--map {' '.join(wires)!r}: say once irq=0 to irq={IRQS - 1}, the interrupt that the line is."
        )
    if not found:
        raise ArgumentError(f"--map: where in the memory of the processor are the chips? For example --map {EXAMPLE}.")
    return found, int(match[1]) if match else None


def _irq(maps: list[str]) -> int | None:
    """--map irq=5: the interrupt of a PC that the board's line is wired to."""
    if not maps:
        return None
    match = re.fullmatch(r"\s*irq\s*=\s*([2-7])\s*", maps[0]) if len(maps) == 1 else None
    if match is None:
        raise ArgumentError(
            f"--map {' '.join(maps)!r}: an 8086 reaches the board by IN and OUT; of it only irq=2 to irq=7 can be said."
        )
    return int(match[1])
