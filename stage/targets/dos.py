"""What DOS and BIOS do for a program: text, time, vectors, its end. A function that is not here ends it, with its number."""

from __future__ import annotations

import struct
from typing import Any

from stage.targets.timer import FULL
from stage.targets.timer import HZ as TIMER_HZ

_CARRY = 1
_NO_KEY = "it waits for a key, and nobody is at the keyboard"


class Dos:
    """The services of a PC, by interrupt and function. pc: see stage.targets.pc."""

    def __init__(self, pc: Any):
        self._pc = pc

    def serve(self, number: int) -> None:
        """INT `number`, of which the program has no routine of its own."""
        pc, ah = self._pc, self._pc.get("ah")
        if number == 0x21:
            self._dos(ah)
        elif number == 0x20:
            pc.end(0)
        elif number == 0x10 and ah == 0x0E:
            pc.say(chr(pc.get("al")))
        elif number == 0x15 and ah == 0x86:
            self._delay()
        elif number == 0x16:
            self._key(ah)
        elif number == 0x1A:
            self._clock(ah)
        elif number == 0x11:
            pc.set(ax=0x0020)
        elif number == 0x12:
            pc.set(ax=640)

    def _dos(self, ah: int) -> None:
        pc = self._pc
        al, dx = pc.get("al"), pc.get("dx")
        if ah in (0x00, 0x4C, 0x31):
            pc.end(al if ah else 0)
        elif ah == 0x02 or (ah == 0x06 and dx & 0xFF != 0xFF):
            pc.say(chr(dx & 0xFF))
        elif ah == 0x06:
            pc.set(eflags=pc.get("eflags") | 0x40, al=0)  # no key
        elif ah == 0x09:
            text = pc.read(pc.get("ds"), dx, min(0x10000 - dx, 4096))
            pc.say(text.split(b"$")[0].decode("cp437"))
        elif ah == 0x0B:
            pc.set(al=0)
        elif ah in (0x01, 0x07, 0x08, 0x0A, 0x3F):
            pc.fault = _NO_KEY
            pc.uc.emu_stop()
        elif ah == 0x25:
            pc.write(0, 4 * al, struct.pack("<HH", dx, pc.get("ds")))
            pc.watch_timer()
        elif ah == 0x35:
            offset, segment = pc.vector(al)
            pc.set(bx=offset, es=segment)
        elif ah == 0x2A:
            pc.set(cx=1995, dx=0x0701, al=6)
        elif ah == 0x2C:
            hundredths = self._ms() // 10
            pc.set(
                ch=hundredths // 360000 % 24, cl=hundredths // 6000 % 60, dh=hundredths // 100 % 60, dl=hundredths % 100
            )
        elif ah == 0x30:
            pc.set(ax=0x0005, bx=0, cx=0)
        elif ah == 0x40:
            self._write()
        elif ah == 0x44:
            pc.set(dx=0x80D3 if pc.get("bx") < 3 else 0, eflags=pc.get("eflags") & ~_CARRY)
        elif ah == 0x48:
            self._refuse(8, bx=0)
        elif ah in (0x49, 0x4A, 0x3E, 0x33, 0x0E, 0x1A):
            pc.set(eflags=pc.get("eflags") & ~_CARRY)
        elif ah in (0x51, 0x62):
            pc.set(bx=pc.prefix)
        elif ah in (0x3C, 0x3D, 0x43, 0x4E):
            self._refuse(2)  # there are no files
        else:
            pc.fault = f"it asks DOS for function {ah:02X}h (INT 21h), which is not here"
            pc.uc.emu_stop()

    def _refuse(self, code: int, **others: int) -> None:
        self._pc.set(ax=code, eflags=self._pc.get("eflags") | _CARRY, **others)

    def _write(self) -> None:
        pc = self._pc
        if pc.get("bx") not in (1, 2):
            self._refuse(6)
            return
        size = pc.get("cx")
        pc.say(pc.read(pc.get("ds"), pc.get("dx"), size).decode("cp437"))
        pc.set(ax=size, eflags=pc.get("eflags") & ~_CARRY)

    def _key(self, ah: int) -> None:
        pc = self._pc
        if ah in (0x01, 0x11):
            pc.set(eflags=pc.get("eflags") | 0x40)
        elif ah in (0x00, 0x10):
            pc.fault = _NO_KEY
            pc.uc.emu_stop()
        else:
            pc.set(al=0)

    def _delay(self) -> None:
        """CX:DX us; interrupts come after it."""
        pc = self._pc
        us = pc.get("cx") << 16 | pc.get("dx")
        pc.record.cycles += us * int(pc.record.hz) // 1_000_000
        pc.record.due = pc.record.cycles
        pc.set(eflags=pc.get("eflags") & ~_CARRY)

    def _clock(self, ah: int) -> None:
        if ah == 0:
            t = self._pc.record
            ticks = int(t.cycles) * TIMER_HZ // (int(t.hz) * FULL)
            self._pc.set(cx=ticks >> 16, dx=ticks & 0xFFFF, al=0)

    def _ms(self) -> int:
        t = self._pc.record
        return int(t.cycles) * 1000 // int(t.hz)
