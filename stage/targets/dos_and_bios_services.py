"""Functions of DOS and BIOS for a program: text, time, interrupt vectors and exit.

An unsupported function ends the program with an error that names it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from stage.targets.pc_timer import CLOCK_HZ as TIMER_HZ
from stage.targets.pc_timer import MAX_RELOAD

CARRY, ZERO = 1, 0x40
NO_FILE, NO_MEMORY, NO_HANDLE = 2, 8, 6
"""Error codes of DOS."""
CONSOLE_HANDLES = (1, 2)  # handles
MAX_TEXT_BYTES = 4096
NO_KEY_MESSAGE = "it waits for a key, and nobody is at the keyboard"


class Dos:
    """DOS and BIOS services of a PC, by interrupt and function.

    Args:
        pc: A Pc.
    """

    def __init__(self, pc: Any):
        self._pc = pc
        self._functions: dict[int, Callable[[], None]] = {
            0x00: lambda: pc.end(0), 0x02: self._print_character, 0x06: self._perform_console_io, 0x09: self._print_text,
            0x0B: lambda: pc.set_registers(al=0), 0x25: self._set_vector, 0x2A: lambda: pc.set_registers(cx=1995, dx=0x0701, al=6),
            0x2C: self._read_dos_time, 0x30: lambda: pc.set_registers(ax=0x0005, bx=0, cx=0), 0x35: self._read_vector,
            0x40: self._write_to_handle, 0x44: self._read_device_information, 0x48: lambda: self._return_error(NO_MEMORY, bx=0),
            **dict.fromkeys((0x01, 0x07, 0x08, 0x0A, 0x3F), lambda: pc.fail(NO_KEY_MESSAGE)),
            **dict.fromkeys((0x31, 0x4C), lambda: pc.end(pc.get_register("al"))),
            **dict.fromkeys((0x0E, 0x1A, 0x33, 0x3E, 0x49, 0x4A), self._return_success),
            **dict.fromkeys((0x3C, 0x3D, 0x43, 0x4E), lambda: self._return_error(NO_FILE)),
            **dict.fromkeys((0x51, 0x62), lambda: pc.set_registers(bx=pc.prefix)),
        }  # fmt: skip

    def execute_interrupt(self, number: int) -> None:
        """Execute a software interrupt for which the program has installed no routine.

        Args:
            number: Number of the interrupt; AH selects its function.
        """
        pc, ah = self._pc, self._pc.get_register("ah")
        if number == 0x21:
            function = self._functions.get(ah)
            if function is None:
                pc.fail(f"it asks DOS for function {ah:02X}h (INT 21h), which is not here")
            else:
                function()
        elif number == 0x20:
            pc.end(0)
        elif number == 0x10 and ah == 0x0E:
            pc.log_text(chr(pc.get_register("al")))
        elif number == 0x15 and ah == 0x86:
            self._delay()
        elif number == 0x16:
            self._read_key(ah)
        elif number == 0x1A and ah == 0:
            self._read_bios_clock()
        elif number in (0x11, 0x12):
            pc.set_registers(ax=0x0020 if number == 0x11 else 640)

    def _print_character(self) -> None:
        """Print the character in DL (INT 21h, function 02h)."""
        self._pc.log_text(chr(self._pc.get_register("dx") & 0xFF))

    def _perform_console_io(self) -> None:
        """Print the character in DL, or report that no key is pressed if DL is FFh (INT 21h, function 06h)."""
        if self._pc.get_register("dx") & 0xFF != 0xFF:
            self._print_character()
        else:
            self._pc.set_registers(eflags=self._pc.get_register("eflags") | ZERO, al=0)  # no key

    def _print_text(self) -> None:
        """Print the text at DS:DX up to a dollar sign (INT 21h, function 09h)."""
        pc, dx = self._pc, self._pc.get_register("dx")
        text = pc.read(pc.get_register("ds"), dx, min(0x10000 - dx, MAX_TEXT_BYTES))
        pc.log_text(text.split(b"$")[0].decode("cp437"))

    def _set_vector(self) -> None:
        """Set an interrupt vector (INT 21h, function 25h)."""
        pc = self._pc
        pc.write(0, 4 * pc.get_register("al"), struct.pack("<HH", pc.get_register("dx"), pc.get_register("ds")))
        pc.schedule_timer_interrupt()

    def _read_vector(self) -> None:
        """Return an interrupt vector (INT 21h, function 35h)."""
        offset, segment = self._pc.read_vector(self._pc.get_register("al"))
        self._pc.set_registers(bx=offset, es=segment)

    def _read_dos_time(self) -> None:
        """Return the simulated time of day, from 0:00 at the start (INT 21h, function 2Ch)."""
        t = self._pc.record
        hundredths = int(t.cycles) * 100 // int(t.hz)
        minutes, hours = hundredths // 6000 % 60, hundredths // 360000 % 24
        self._pc.set_registers(ch=hours, cl=minutes, dh=hundredths // 100 % 60, dl=hundredths % 100)

    def _read_device_information(self) -> None:
        """Return whether a handle is the console (INT 21h, function 44h)."""
        self._pc.set_registers(dx=0x80D3 if self._pc.get_register("bx") < 3 else 0)
        self._return_success()

    def _write_to_handle(self) -> None:
        """Write bytes to the console (INT 21h, function 40h)."""
        pc = self._pc
        if pc.get_register("bx") not in CONSOLE_HANDLES:
            self._return_error(NO_HANDLE)
            return
        size = pc.get_register("cx")
        pc.log_text(pc.read(pc.get_register("ds"), pc.get_register("dx"), size).decode("cp437"))
        pc.set_registers(ax=size)
        self._return_success()

    def _return_success(self) -> None:
        """Clear the carry flag: the function has succeeded."""
        self._pc.set_registers(eflags=self._pc.get_register("eflags") & ~CARRY)

    def _return_error(self, code: int, **others: int) -> None:
        """Set the carry flag and an error code in AX: the function has failed. `others` are further registers."""
        self._pc.set_registers(ax=code, eflags=self._pc.get_register("eflags") | CARRY, **others)

    def _read_key(self, ah: int) -> None:
        """Report that no key is pressed (INT 16h), or end a program that waits for one."""
        pc = self._pc
        if ah in (0x01, 0x11):
            pc.set_registers(eflags=pc.get_register("eflags") | ZERO)
        elif ah in (0x00, 0x10):
            pc.fail(NO_KEY_MESSAGE)
        else:
            pc.set_registers(al=0)

    def _delay(self) -> None:
        """Let CX:DX microseconds pass, then serve pending interrupts (INT 15h, function 86h)."""
        pc = self._pc
        us = pc.get_register("cx") << 16 | pc.get_register("dx")
        pc.record.cycles += us * int(pc.record.hz) // 1_000_000
        pc.record.due = pc.record.cycles
        self._return_success()

    def _read_bios_clock(self) -> None:
        """Return the ticks of the BIOS clock since the start (INT 1Ah, function 00h)."""
        t = self._pc.record
        ticks = int(t.cycles) * TIMER_HZ // (int(t.hz) * MAX_RELOAD)
        self._pc.set_registers(cx=ticks >> 16, dx=ticks & 0xFFFF, al=0)
