"""PC with an 8086 in real mode on Unicorn, with as much of DOS and BIOS as a program that moves axes needs.

IN and OUT reach the board. Exceptions are the PC's timer (40h to 43h, 61h) and interrupt controller (20h, 21h), unless
the board occupies these ports. Timing: 8 cycles for each instruction plus 4 for each of its bytes, at 4.77 MHz, which
approximates an 8088 that mostly waits for its bus.
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
from stage.support.foreign_files import read_bytes
from stage.targets import dos_and_bios_services
from stage.targets.elf import MAX_FILE_BYTES, read_machine_name
from stage.targets.gdb_server import DebugServer, make_8086_registers
from stage.targets.pc_timer import CLOCK_HZ as TIMER_HZ
from stage.targets.pc_timer import PcTimer
from stage.targets.processor_clock_and_bus_cycles import poll_from_python, wait
from stage.targets.unicorn_processor import NEVER, UnicornProcessor

DEFAULT_HZ = 4_772_727
INSTRUCTION_CYCLES, BYTE_CYCLES = 8, 4
MEMORY_BYTES = 0x110000
ROM, STUBS = 0xF000, 0x100  # segment; offset of the routine of interrupt 0, a byte each
TIMER_ROUTINE = bytes.fromhex("50 CD 1C B0 20 E6 20 58 CF")
"""The timer's routine: int 1Ch, end of interrupt, iret."""
TIMER_ROUTINE_OFFSET = 0x10
SOURCE_SUFFIXES = (".asm", ".c", ".cc", ".cpp", ".cxx", ".h", ".ino", ".rs", ".s")
"""Suffixes of source files. A .COM has no header, so that only the name can show that a file is none."""
PREFIX_SEGMENT = 0x1000  # segment of the program's prefix
INTERNAL_PORTS_END = 0x100  # ports below are the PC's own
OPEN_BUS = 0xFF
MAX_COM_SIZE = 0xFE00
_PORT_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
_IF = 0x200


@dataclass(frozen=True)
class PcProgram:
    """DOS program, a .COM or .EXE file.

    Attributes:
        path: The file.
        hz: Clock of the processor in Hz, or None.
        irq: Interrupt of the PC (2 to 7) to which the board's line is wired, or None.
        gdb: TCP port of a GDB server, or None.
    """

    path: Path
    hz: int | None
    irq: int | None
    gdb: int | None = None

    def load(self, board: Board, isolated: bool) -> Pc:
        """Load a copy of the program. Raises LibraryError or FileError."""
        return Pc(self, board)


class Pc(UnicornProcessor):
    """PC with a loaded DOS program.

    Attributes:
        prefix: Segment of the program's prefix (PSP).
    """

    REGISTER_PREFIX = "UC_X86_REG_"
    prefix = PREFIX_SEGMENT

    def __init__(self, program: PcProgram, board: Board):
        import unicorn

        super().__init__(program.path, board, unicorn.UC_ARCH_X86, unicorn.UC_MODE_16, program.hz or DEFAULT_HZ)
        self._irq = program.irq
        t = self.record
        t.each, t.byte, t.flags, t.mask, t.on = (
            INSTRUCTION_CYCLES,
            BYTE_CYCLES,
            self.find_register_number("eflags"),
            _IF,
            _IF,
        )
        t.watched, t.edge = program.irq is not None, 1
        self.uc.mem_map(0, MEMORY_BYTES)
        self._masked, self._in_service = 0xFF & ~(1 | (1 << program.irq if program.irq else 0)), 0
        self.timers = PcTimer(lambda: int(t.cycles) * TIMER_HZ // int(t.hz))
        self._tick_pending = 0
        self._load_bios()
        self._load_program(program.path)
        self.dos = dos_and_bios_services.Dos(self)
        self.uc.hook_add(unicorn.UC_HOOK_INTR, self._handle_interrupt)
        self.hook_ports(_PORT_FUNCTION(self._access_internal_port), INTERNAL_PORTS_END)
        self._call: int | None = None
        if program.gdb:
            self.gdb = DebugServer(self, make_8086_registers(self), program.gdb)
        self._update_line_mask()

    # --- memory ---

    def read(self, segment: int, offset: int, size: int) -> bytes:
        """Read memory of the PC.

        Args:
            segment: Segment of the first byte.
            offset: Offset of the first byte, taken modulo 65536.
            size: Number of bytes.
        """
        return bytes(self.uc.mem_read((segment << 4) + (offset & 0xFFFF), size))

    def write(self, segment: int, offset: int, content: bytes) -> None:
        """Write memory of the PC.

        Args:
            segment: Segment of the first byte.
            offset: Offset of the first byte, taken modulo 65536.
            content: The bytes.
        """
        self.uc.mem_write((segment << 4) + (offset & 0xFFFF), content)

    # --- before the program runs ---

    def _load_bios(self) -> None:
        """Fill the interrupt vectors with default routines in ROM."""
        for n in range(256):
            self.write(0, 4 * n, struct.pack("<HH", *self.get_default_vector(n)))
        self.write(ROM, STUBS, b"\xcf" * 256)
        self.write(ROM, TIMER_ROUTINE_OFFSET, TIMER_ROUTINE)

    @staticmethod
    def get_default_vector(interrupt_number: int) -> tuple[int, int]:
        """Return offset and segment of the default routine of an interrupt."""
        return (TIMER_ROUTINE_OFFSET if interrupt_number == 8 else STUBS + interrupt_number), ROM

    def read_vector(self, interrupt_number: int) -> tuple[int, int]:
        """Return offset and segment of the current routine of an interrupt."""
        offset, segment = struct.unpack("<HH", self.read(0, 4 * interrupt_number, 4))
        return offset, segment

    def _load_program(self, path: Path) -> None:
        """Load a .COM or .EXE file behind its prefix, and set the registers for its start."""
        if machine := read_machine_name(path):
            raise LibraryError(f"{path} was built for {machine} (ELF), and an 8086 runs a .COM or an .EXE of DOS.")
        if path.suffix.lower() in SOURCE_SUFFIXES:
            raise LibraryError(
                f"{path} is a source by its name: an 8086 runs a .COM or an .EXE of DOS. Build it first, for example "
                f"nasm -f bin {path.stem}.asm -o {path.stem}.com."
            )
        content = read_bytes(path, "program", MAX_FILE_BYTES)
        prefix = bytearray(256)
        prefix[:4] = struct.pack("<HH", 0x20CD, 0xA000)  # int 20h; the end of memory
        prefix[0x80:0x82] = b"\0\r"
        self.write(PREFIX_SEGMENT, 0, bytes(prefix))
        if content[:2] in (b"MZ", b"ZM"):
            self._load_exe(path, content)
            return
        if not 0 < len(content) <= MAX_COM_SIZE:
            raise LibraryError(f"{path} has {len(content):,} bytes: a .COM has 1 to 65,024.")
        self.write(PREFIX_SEGMENT, 0x100, content)
        self.write(PREFIX_SEGMENT, 0xFFFE, b"\0\0")
        self.set_registers(
            cs=PREFIX_SEGMENT,
            ds=PREFIX_SEGMENT,
            es=PREFIX_SEGMENT,
            ss=PREFIX_SEGMENT,
            sp=0xFFFE,
            ip=0x100,
            eflags=_IF | 2,
        )

    def _load_exe(self, path: Path, content: bytes) -> None:
        """Load an .EXE file, relocate it, and set the registers for its start."""
        if len(content) < 0x1C:
            raise LibraryError(f"{path} is cut off: an .EXE has a head of 28 bytes.")
        last, pages, relocations, head, _, _, ss, sp, _, ip, cs, table = struct.unpack_from("<12H", content, 2)
        size = pages * 512 - (512 - last if last else 0) - head * 16
        begin = PREFIX_SEGMENT + 0x10
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
        self.set_registers(
            cs=begin + cs, ip=ip, ss=begin + ss, sp=sp, ds=PREFIX_SEGMENT, es=PREFIX_SEGMENT, eflags=_IF | 2
        )

    # --- interrupts ---

    def _handle_interrupt(self, _uc: Any, number: int, _user: Any) -> None:
        """Handle INT n, or an exception of the processor."""
        if self.read_vector(number) != self.get_default_vector(number):
            self._call = number
            self.uc.emu_stop()
        elif number == 0:
            self.fail("a division by 0, or its result is too large")
        elif number in (6, 13):
            self.fail("an instruction that this processor does not have")
        else:
            self.dos.execute_interrupt(number)

    def get_start_address(self) -> int:
        """Return the linear address of CS:IP, at which the 8086 continues."""
        return (self.get_register("cs") << 4) + self.get_register("ip")

    def set_program_counter(self, address: int) -> None:
        """Set the program counter, for a debugger."""
        self.set_registers(ip=address - (self.get_register("cs") << 4) & 0xFFFF)

    def describe_location(self) -> str:
        """Return CS:IP of the 8086 and the offset that appears in the linker's map."""
        cs, ip = self.get_register("cs"), self.get_register("ip")
        return f"{cs:04X}:{ip:04X} (offset {((cs - PREFIX_SEGMENT) << 4) + ip:X}h of its segment)"

    def handle_stop(self) -> None:
        """Handle a stop of Unicorn: enter a software interrupt, wait at HLT, update the timer, or poll the board's line."""
        t = self.record
        if self._call is not None:
            number, self._call = self._call, None
            self._enter_interrupt(number)
            return
        halted = (
            self.read(self.get_register("cs"), self.get_register("ip") - 1, 1) == b"\xf4"
            and not t.raised
            and t.cycles < t.alarm
        )
        if halted and not self.get_register("eflags") & _IF:
            raise self.make_error("it halts for ever, with interrupts off")
        if halted:
            wait.c(t.own)
        if t.cycles >= t.alarm:
            self._pend_timer_interrupt()
        self._enter_pending_interrupt()

    def _enter_interrupt(self, number: int) -> None:
        """Begin the routine of an interrupt."""
        flags, sp = self.get_register("eflags"), (self.get_register("sp") - 6) & 0xFFFF
        self.write(
            self.get_register("ss"),
            sp,
            struct.pack("<HHH", self.get_register("ip"), self.get_register("cs"), flags & 0xFFFF),
        )
        offset, segment = self.read_vector(number)
        self.set_registers(sp=sp, eflags=flags & ~0x300, cs=segment, ip=offset)

    def _enter_pending_interrupt(self) -> None:
        """Enter the routine of a pending interrupt, of the timer or the board's line, if interrupts are enabled."""
        t = self.record
        if not self.get_register("eflags") & _IF:
            t.device_waits = self._tick_pending
            return
        if self._tick_pending and not self._masked & 1 and not self._in_service & 1:
            self._tick_pending = 0
            self._in_service |= 1
            self._enter_interrupt(8)
        elif t.raised and t.line and self._irq:
            t.raised = 0
            self._in_service |= 1 << self._irq
            self._enter_interrupt(8 + self._irq)
        t.device_waits = self._tick_pending if not self._masked & 1 and not self._in_service else 0
        self._update_line_mask()

    def _update_line_mask(self) -> None:
        """Update the record's field that tells compiled code whether the board's line may interrupt."""
        if self._irq:
            lower = (2 << self._irq) - 1
            self.record.line = not self._masked >> self._irq & 1 and not self._in_service & lower
            self.record.due = self.record.cycles

    def _pend_timer_interrupt(self) -> None:
        """Mark the interrupt of timer channel 0 as pending, because the channel has reached zero."""
        self._tick_pending = self.record.device_waits = 1
        self.schedule_timer_interrupt()

    def schedule_timer_interrupt(self) -> None:
        """Schedule the next interrupt of timer channel 0, if the program has installed a routine for it."""
        is_used = any(self.read_vector(n) != self.get_default_vector(n) for n in (0x08, 0x1C))
        t = self.record
        t.alarm = -(-self.timers.find_next_zero() * int(t.hz) // TIMER_HZ) if is_used else NEVER
        t.due = t.cycles

    # --- ports of the PC ---

    def _access_internal_port(self, own: int, port: int, size: int, value: int) -> int:
        """Make a cycle at a port below INTERNAL_PORTS_END and return the byte or word that was read, 0 for a write.

        The board answers if it uses this port, else the PC itself does.

        Args:
            own: Address of the UNICORN_PROCESSOR record.
            port: Port number.
            size: Number of bytes.
            value: Value that is written; -1 for a read.
        """
        try:
            on_board = port in self._board.ports
            if size > 1 and not on_board:
                low, high = (value & 0xFF, value >> 8) if value >= 0 else (-1, -1)
                answer = self._access_internal_port(own, port, 1, low)
                return answer | self._access_internal_port(own, port + 1, 1, high) << 8
            if on_board or not (port in (0x20, 0x21, 0x61) or 0x40 <= port <= 0x43):
                return self._make_board_cycle(port, size, value)
            return self._write_internal_port(port, value) if value >= 0 else self._read_internal_port(port)
        except Exception as error:  # it would be lost in C
            self.fail(str(error))
            return OPEN_BUS

    def _make_board_cycle(self, port: int, size: int, value: int) -> int:
        """Make a bus cycle of the board; `value` is written, -1 for a read. Return the value read."""
        link = self._board.link
        what = (OUT8 if size == 1 else OUT16) if value >= 0 else (IN8 if size == 1 else IN16)
        poll_from_python.c(self.record.own)
        self.record.due = self.record.cycles
        return int(link.request(link.pointer, what, port, max(value, 0)))

    def _read_internal_port(self, port: int) -> int:
        """Return a byte of the timer or the interrupt controller."""
        if port in (0x20, 0x21):
            return self._masked if port == 0x21 else 0
        return self.timers.read(port)

    def _write_internal_port(self, port: int, value: int) -> int:
        """Write a byte to the timer or the interrupt controller."""
        if port not in (0x20, 0x21):
            self.timers.write(port, value)
            self.schedule_timer_interrupt()
            return 0
        if port == 0x21:
            self._masked = value
        elif value == 0x20:  # end of interrupt: of the highest that is served
            self._in_service &= self._in_service - 1
        elif value >= 0x60:
            self._in_service &= ~(1 << (value & 7))
        self.record.device_waits = self._tick_pending if not self._masked & 1 and not self._in_service & 1 else 0
        self._update_line_mask()
        return 0
