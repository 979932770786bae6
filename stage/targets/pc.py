"""A PC of the age of these chips: an 8086 in real mode on Unicorn, with as much of DOS and BIOS as a program needs that moves axes.

IN and OUT reach the board, except that ports below 100h where the board has nothing are the PC's timer (40h to 43h, 61h) and its
interrupt controller (20h, 21h). Time: 8 cycles an instruction and 4 for each of its bytes, of 4.77 MHz: an 8088 that waits for its
bus most of the time.
"""

from __future__ import annotations

import ctypes
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stage.board.board import Board
from stage.board.bus.host_record import IN8, IN16, OUT8, OUT16
from stage.board.errors import LibraryError
from stage.support.files import FileError, refuse_irregular
from stage.support.foreign_files import read_bytes
from stage.targets import dos
from stage.targets.elf import MAX_SIZE, machine_of
from stage.targets.engine import NEVER, Engine
from stage.targets.gdb import PcRegisters, Server
from stage.targets.machine import looked, wait
from stage.targets.timer import HZ as TIMER_HZ
from stage.targets.timer import Timers

USUAL_HZ = 4_772_727
EACH, BYTE = 8, 4
MEMORY = 0x110000
ROM, STUBS = 0xF000, 0x100  # segment; offset of the routine of interrupt 0, a byte each
TICK = bytes.fromhex("50 CD 1C B0 20 E6 20 58 CF")
"""The timer's routine: int 1Ch, end of interrupt, iret."""
TICK_AT = 0x10
SOURCES = (".asm", ".c", ".cc", ".cpp", ".cxx", ".h", ".ino", ".rs", ".s")
"""A .COM begins with its first instruction, so that any file could be one: its name has to tell."""
LOAD = 0x1000  # segment of the program's prefix
RARE = 0x100  # ports below are the PC's own
NO_ONE = 0xFF
_RARE = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
_IF = 0x200


@dataclass(frozen=True)
class PcProgram:
    """A .COM or .EXE. irq: the PC's interrupt (2 to 7) that the board's line is wired to, or None. gdb: port of a GDB server."""

    path: Path
    hz: int | None
    irq: int | None
    gdb: int | None = None

    def load(self, board: Board, isolated: bool) -> Pc:
        """See stage.board.thread_runner. Raises LibraryError, FileError."""
        return Pc(self, board)


class Pc(Engine):
    """See stage.board.thread_runner."""

    prefix = LOAD

    def __init__(self, program: PcProgram, board: Board):
        import unicorn
        from unicorn import x86_const as x

        super().__init__(program.path, board, unicorn.UC_ARCH_X86, unicorn.UC_MODE_16, program.hz or USUAL_HZ)
        self.x, self._irq = x, program.irq
        t = self.record
        t.each, t.byte, t.flags, t.mask, t.on = EACH, BYTE, x.UC_X86_REG_EFLAGS, _IF, _IF
        t.watched, t.edge = program.irq is not None, 1
        self.uc.mem_map(0, MEMORY)
        self._masked, self._in_service = 0xFF & ~(1 | (1 << program.irq if program.irq else 0)), 0
        self.timers = Timers(lambda: int(t.cycles) * TIMER_HZ // int(t.hz))
        self._ticks_at = 0
        self._bios()
        self._load(program.path)
        self.dos = dos.Dos(self)
        self.uc.hook_add(unicorn.UC_HOOK_INTR, self._interrupt)
        self.ports(_RARE(self._rare), RARE)
        self._call: int | None = None
        if program.gdb:
            self.gdb = Server(self, PcRegisters(self), program.gdb)
        self._set_line()

    # --- registers and memory ---

    def get(self, name: str) -> int:
        """A register, for example "ax"."""
        return int(self.uc.reg_read(getattr(self.x, f"UC_X86_REG_{name.upper()}")))

    def set(self, **values: int) -> None:
        """Registers."""
        for name, value in values.items():
            self.uc.reg_write(getattr(self.x, f"UC_X86_REG_{name.upper()}"), value)

    def read(self, segment: int, offset: int, size: int) -> bytes:
        """Memory."""
        return bytes(self.uc.mem_read((segment << 4) + (offset & 0xFFFF), size))

    def write(self, segment: int, offset: int, content: bytes) -> None:
        """Memory."""
        self.uc.mem_write((segment << 4) + (offset & 0xFFFF), content)

    # --- what there is before the program runs ---

    def _bios(self) -> None:
        for n in range(256):
            self.write(0, 4 * n, struct.pack("<HH", *self.usual(n)))
        self.write(ROM, STUBS, b"\xcf" * 256)
        self.write(ROM, TICK_AT, TICK)

    @staticmethod
    def usual(n: int) -> tuple[int, int]:
        """Where the routine of an interrupt is, offset and segment, until the program sets one."""
        return (TICK_AT if n == 8 else STUBS + n), ROM

    def vector(self, n: int) -> tuple[int, int]:
        """Where it is now."""
        offset, segment = struct.unpack("<HH", self.read(0, 4 * n, 4))
        return offset, segment

    def _load(self, path: Path) -> None:
        refuse_irregular(path, "program")
        if not path.is_file():
            raise FileError(f"{path}: there is no such file.")
        if machine := machine_of(path):
            raise LibraryError(f"{path} was built for {machine} (ELF), and an 8086 runs a .COM or an .EXE of DOS.")
        if path.suffix.lower() in SOURCES:
            raise LibraryError(
                f"{path} is a source by its name: an 8086 runs a .COM or an .EXE of DOS. Build it first, for example "
                f"nasm -f bin {path.stem}.asm -o {path.stem}.com."
            )
        content = read_bytes(path, "program", MAX_SIZE)
        prefix = bytearray(256)
        prefix[:4] = struct.pack("<HH", 0x20CD, 0xA000)  # int 20h; the end of memory
        prefix[0x80:0x82] = b"\0\r"
        self.write(LOAD, 0, bytes(prefix))
        if content[:2] in (b"MZ", b"ZM"):
            self._load_exe(path, content)
            return
        if not 0 < len(content) <= 0xFE00:
            raise LibraryError(f"{path} has {len(content):,} bytes: a .COM has 1 to 65,024.")
        self.write(LOAD, 0x100, content)
        self.write(LOAD, 0xFFFE, b"\0\0")
        self.set(cs=LOAD, ds=LOAD, es=LOAD, ss=LOAD, sp=0xFFFE, ip=0x100, eflags=_IF | 2)

    def _load_exe(self, path: Path, content: bytes) -> None:
        if len(content) < 0x1C:
            raise LibraryError(f"{path} is cut off: an .EXE has a head of 28 bytes.")
        last, pages, relocations, head, _, _, ss, sp, _, ip, cs, table = struct.unpack_from("<12H", content, 2)
        size = pages * 512 - (512 - last if last else 0) - head * 16
        begin = LOAD + 0x10
        image = bytearray(content[head * 16 : head * 16 + size])
        if size <= 0 or len(image) < size or size > 0x80000 or table + 4 * relocations > len(content):
            raise LibraryError(
                f"{path} is no .EXE of DOS, or is cut off: its head does not fit its {len(content):,} bytes."
            )
        for k in range(relocations):
            offset, segment = struct.unpack_from("<HH", content, table + 4 * k)
            at = (segment << 4) + offset
            if at + 2 > len(image):
                raise LibraryError(f"{path} is damaged: relocation {k} points behind its end.")
            struct.pack_into("<H", image, at, (struct.unpack_from("<H", image, at)[0] + begin) & 0xFFFF)
        self.write(begin, 0, bytes(image))
        self.set(cs=begin + cs, ip=ip, ss=begin + ss, sp=sp, ds=LOAD, es=LOAD, eflags=_IF | 2)

    # --- interrupts ---

    def _interrupt(self, _uc: Any, number: int, _user: Any) -> None:
        """INT n, or an exception of the processor."""
        if self.vector(number) == self.usual(number):
            if number in (0, 6, 13):
                self.fault = {0: "a division by 0, or its result is too large"}.get(
                    number, "an instruction that this processor does not have"
                )
                self.uc.emu_stop()
            else:
                self.dos.serve(number)
        else:
            self._call = number
            self.uc.emu_stop()

    def where_to_go_on(self) -> int:
        return (self.get("cs") << 4) + self.get("ip")

    def go_to(self, address: int) -> None:
        """A debugger sets the program counter."""
        self.set(ip=address - (self.get("cs") << 4) & 0xFFFF)

    def place(self) -> str:
        cs, ip = self.get("cs"), self.get("ip")
        return f"{cs:04X}:{ip:04X} (offset {((cs - LOAD) << 4) + ip:X}h of its segment)"

    def stopped(self) -> None:
        t = self.record
        if self._call is not None:
            number, self._call = self._call, None
            self._enter(number)
            return
        halted = self.read(self.get("cs"), self.get("ip") - 1, 1) == b"\xf4" and not t.raised and t.cycles < t.alarm
        if halted and not self.get("eflags") & _IF:
            self.fault = "it halts for ever, with interrupts off"
            raise self.wrong(self.fault)
        if halted:
            wait.c(t.own)
        if t.cycles >= t.alarm:
            self._tick()
        self._serve_line()

    def _enter(self, number: int) -> None:
        """As the processor does it."""
        flags, sp = self.get("eflags"), (self.get("sp") - 6) & 0xFFFF
        self.write(self.get("ss"), sp, struct.pack("<HHH", self.get("ip"), self.get("cs"), flags & 0xFFFF))
        offset, segment = self.vector(number)
        self.set(sp=sp, eflags=flags & ~0x300, cs=segment, ip=offset)

    def _serve_line(self) -> None:
        t = self.record
        if not self.get("eflags") & _IF:
            t.wanted = self._ticks_at
            return
        if self._ticks_at and not self._masked & 1 and not self._in_service & 1:
            self._ticks_at = 0
            self._in_service |= 1
            self._enter(8)
        elif t.raised and t.line and self._irq:
            t.raised = 0
            self._in_service |= 1 << self._irq
            self._enter(8 + self._irq)
        t.wanted = self._ticks_at if not self._masked & 1 and not self._in_service else 0
        self._set_line()

    def _set_line(self) -> None:
        """Whether the board's line may interrupt."""
        if self._irq:
            lower = (2 << self._irq) - 1
            self.record.line = not self._masked >> self._irq & 1 and not self._in_service & lower
            self.record.due = self.record.cycles

    def _tick(self) -> None:
        """Channel 0 has run down."""
        self._ticks_at = self.record.wanted = 1
        self.watch_timer()

    def watch_timer(self) -> None:
        """From now on channel 0 interrupts, if somebody has set its routine."""
        own = any(self.vector(n) != self.usual(n) for n in (0x08, 0x1C))
        t = self.record
        t.alarm = -(-self.timers.next_tick() * int(t.hz) // TIMER_HZ) if own else NEVER
        t.due = t.cycles

    # --- ports of the PC ---

    def _rare(self, _own: int, port: int, size: int, value: int) -> int:
        try:
            if size > 1 and port not in self._board.ports:
                if value >= 0:
                    return self._rare(_own, port, 1, value & 0xFF) | self._rare(_own, port + 1, 1, value >> 8)
                return self._rare(_own, port, 1, -1) | self._rare(_own, port + 1, 1, -1) << 8
            if port in self._board.ports or not self._own(port):
                return self._on_board(port, size, value)
            return self._own_port(port, value)
        except Exception as error:  # it would be lost in C
            self.fault = str(error)
            self.uc.emu_stop()
            return NO_ONE

    @staticmethod
    def _own(port: int) -> bool:
        return port in (0x20, 0x21, 0x61) or 0x40 <= port <= 0x43

    def _on_board(self, port: int, size: int, value: int) -> int:
        link = self._board.link
        what = (OUT8 if size == 1 else OUT16) if value >= 0 else (IN8 if size == 1 else IN16)
        looked.c(self.record.own)
        self.record.due = self.record.cycles
        return int(link.request(link.pointer, what, port, max(value, 0)))

    def _own_port(self, port: int, value: int) -> int:
        if 0x40 <= port <= 0x43 or port == 0x61:
            answer = self.timers.read(port) if value < 0 else self.timers.write(port, value)
            if value >= 0:
                self.watch_timer()
            return answer
        if port == 0x21:
            if value < 0:
                return self._masked
            self._masked = value
        elif value == 0x20:  # end of interrupt: of the highest that is served
            self._in_service &= self._in_service - 1
        elif value >= 0x60:
            self._in_service &= ~(1 << (value & 7))
        self.record.wanted = self._ticks_at if not self._masked & 1 and not self._in_service & 1 else 0
        self._set_line()
        return 0
