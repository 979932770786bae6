"""Semihosting of Arm: `bkpt 0xAB` with a number in r0 asks the debugger's host. Text goes to the log; the end is the program's."""

from __future__ import annotations

from typing import Any

_OPEN, _CLOSE, _CHAR, _TEXT, _WRITE, _IS_TTY, _LENGTH = 0x01, 0x02, 0x03, 0x04, 0x05, 0x09, 0x0C
_CLOCK, _TIME, _ERROR, _COMMAND_LINE, _HEAP, _EXIT, _EXIT_WITH = 0x10, 0x11, 0x13, 0x15, 0x16, 0x18, 0x20
APPLICATION_ENDS = 0x20026
_LONGEST = 4096
_FAILED = 0xFFFFFFFF


class Semihosting:
    """cpu: see stage.targets.cortex."""

    def __init__(self, cpu: Any):
        self._cpu = cpu

    def serve(self) -> None:
        """One request."""
        cpu = self._cpu
        what, about = cpu.get("r0"), cpu.get("r1")
        answer = 0
        if what == _CHAR:
            cpu.say(chr(cpu.uc.mem_read(about, 1)[0]))
        elif what == _TEXT:
            cpu.say(self._text(about))
        elif what == _WRITE:
            at, size = cpu.word(about + 4), cpu.word(about + 8)
            cpu.say(bytes(cpu.uc.mem_read(at, min(size, _LONGEST))).decode("latin1"))
        elif what in (_OPEN, _IS_TTY):
            answer = 1
        elif what == _CLOCK:
            answer = self._hundredths()
        elif what == _TIME:
            answer = self._hundredths() // 100
        elif what == _EXIT:
            cpu.end(0 if about == APPLICATION_ENDS else 1)
        elif what == _EXIT_WITH:
            code = cpu.word(about + 4)
            cpu.end(code - (1 << 32) if code >> 31 else code)
        elif what not in (_CLOSE, _LENGTH, _ERROR, _HEAP):
            answer = _FAILED
        cpu.set(r0=answer)

    def _text(self, address: int) -> str:
        found = b""
        while b"\0" not in found and len(found) < _LONGEST:
            found += bytes(self._cpu.uc.mem_read(address + len(found), 16))
        return found.split(b"\0")[0].decode("latin1")

    def _hundredths(self) -> int:
        t = self._cpu.record
        return int(t.cycles) * 100 // int(t.hz)
