"""Cortex-M on Unicorn: memory, exceptions with priorities, SysTick, NVIC and semihosting. Windows in its memory are bus cycles of
the board.

Timing: 1.5 cycles for a 16-bit instruction and 2.5 cycles for a 32-bit one, which approximates a Cortex-M3 whose flash has wait
states.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stage.board.board import Board
from stage.board.errors import LibraryError
from stage.board.memory_mapped_ports import MemoryWindow
from stage.errors import ArgumentError
from stage.targets.elf import ARM, Elf, check_arm
from stage.targets.gdb_server import DebugServer, make_cortex_registers
from stage.targets.nvic import Nvic
from stage.targets.processor_clock_and_bus_cycles import wait
from stage.targets.unicorn_processor import INVALID_INSTRUCTION, PAGE_SIZE, Registers, UnicornProcessor

DEFAULT_HZ = 72_000_000
INSTRUCTION_UNITS, BYTE_UNITS, UNITS = 1, 1, 2
"""Units of time an instruction and a byte, and units a cycle."""
MEMORY_REGION_SIZES = {
    0x00000000: 1 << 20, 0x08000000: 2 << 20, 0x10000000: 1 << 20, 0x1FFF0000: 1 << 16, 0x20000000: 1 << 20, 0x60000000: 1 << 20,
}  # fmt: skip
"""Size of the memories by address, where no window lies: flash, RAM, external RAM."""
FLASH_ADDRESSES = (0x00000000, 0x08000000)
"""Memory that a program cannot write, unless its linker has put variables there."""
PRIVATE, PRIVATE_SIZE = 0xE0000000, 0x100000
EXTERNAL_MEMORY_BEGIN = 0x60000000
RESET_LINK_REGISTER = 0xFFFFFFFF  # of lr
_EXCEPTION_FRAME = struct.Struct("<8I")
_EXC_RETURN = 0xFFFFFFE0
_THUMB_BIT = 0x01000000
_SVC, _BREAKPOINT, _EXIT = 2, 7, 8
_UNDEFINED, _NO_CODE, _NO_THUMB = 1, 3, 18
_EXCEPTION_MESSAGES = {
    _UNDEFINED: "an instruction that this processor does not have",
    _NO_CODE: "it jumps to where there is no code",
    4: "it touches memory that it may not touch",
    17: "an instruction of a coprocessor that is off or not there (floating point: CPACR)",
    _NO_THUMB: "it jumps to an even address: code of a Cortex-M is Thumb, and addresses of functions are odd",
    22: "it touches a word at an address that this processor cannot",
}
"""Exceptions as Unicorn numbers them."""
_SEMIHOSTING, _WFI = b"\xab\xbe", (b"\x30\xbf", b"\x20\xbf")
BUILD_COMMAND = "arm-none-eabi-gcc -mcpu={mcu} -mthumb -T script.ld ..."
UNICORN_CPU_MODELS = {"cortex-m0": 7, "cortex-m3": 8, "cortex-m4": 9}


@dataclass(frozen=True)
class CortexProgram:
    """ELF program for a Cortex-M.

    Attributes:
        path: The file.
        mcu: Name of the processor.
        hz: Clock of the processor in Hz, or None for the default.
        windows: Address ranges that lead to ports of the board.
        irq: Number of the NVIC interrupt to which the board's line is wired, or None.
        gdb: TCP port of a GDB server, or None.
    """

    path: Path
    mcu: str
    hz: int | None
    windows: tuple[MemoryWindow, ...]
    irq: int | None
    gdb: int | None = None

    def load(self, board: Board, isolated: bool) -> Cortex:
        """Load a copy of the program. Raises LibraryError or FileError."""
        return Cortex(self, board)


class Cortex(UnicornProcessor):
    """Cortex-M with a loaded program."""

    REGISTER_PREFIX = "UC_ARM_REG_"

    def __init__(self, program: CortexProgram, board: Board):
        import unicorn

        self._elf = Elf(program.path, ARM, program.mcu, BUILD_COMMAND.format(mcu=program.mcu))
        check_arm(self._elf, program.mcu, BUILD_COMMAND)
        hz = program.hz or DEFAULT_HZ
        mode = unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS
        super().__init__(program.path, board, unicorn.UC_ARCH_ARM, mode, hz * UNITS, UNICORN_CPU_MODELS[program.mcu])
        t = self.record
        t.each, t.byte, t.flags, t.mask, t.on = (
            INSTRUCTION_UNITS,
            BYTE_UNITS,
            self.find_register_number("primask"),
            1,
            0,
        )
        t.watched = program.irq is not None
        self._interrupted = self._group_registers("control sp xpsr r0 r1 r2 r3 r12 lr")
        self._entry = self._group_registers("sp ipsr lr pc")
        self._mode = self._group_registers("ipsr")
        self._exit = self._group_registers("sp xpsr r0 r1 r2 r3 r12 lr pc")
        self._masks = self._group_registers("primask basepri pc")
        self._map_memory(program.windows)
        self.nvic = Nvic(lambda: int(t.cycles) // UNITS, program.irq)
        self.nvic.vectors = self._load_segments()
        self.semihosting = Semihosting(self)
        self.uc.hook_add(unicorn.UC_HOOK_INTR, self._store_exception)
        self._raised = 0
        if program.gdb:
            self.gdb = DebugServer(self, make_cortex_registers(self), program.gdb)
        self._update_interrupt_fields()

    # --- memory ---

    def read_word(self, address: int) -> int:
        """Return 32 bits of the Cortex-M's memory."""
        return int.from_bytes(self.uc.mem_read(address, 4), "little")

    def _map_memory(self, windows: tuple[MemoryWindow, ...]) -> None:
        """Map the memory regions, the private peripherals and the windows of the board."""
        import unicorn

        self._windows_of_board = windows
        for w in windows:
            if w.end > 1 << 32 or PRIVATE <= w.address < PRIVATE + PRIVATE_SIZE:
                raise ArgumentError(
                    f"window {w}: a Cortex-M has no memory for it there; its devices are at 40000000h and up."
                )
            for begin, size in MEMORY_REGION_SIZES.items():
                if begin <= w.address < begin + size and begin < EXTERNAL_MEMORY_BEGIN:
                    raise ArgumentError(f"window {w}: real memory is there (of {begin:X}h to {begin + size - 1:X}h).")
        for begin, size in MEMORY_REGION_SIZES.items():
            if not any(w.address & -PAGE_SIZE < begin + size and begin < w.end for w in windows):
                fixed = begin in FLASH_ADDRESSES and not self._elf.is_writable(begin, size)
                rights = unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC if fixed else unicorn.UC_PROT_ALL
                self.uc.mem_map(begin, size, rights)
        self.map_windows(windows)
        self.uc.mmio_map(
            PRIVATE, PRIVATE_SIZE, self._read_private_peripherals, None, self._write_private_peripherals, None
        )

    def _load_segments(self) -> int:
        """Load the segments of the program into memory; return the address of the vector table."""
        import unicorn

        for segment in self._elf.segments:
            try:
                self.uc.mem_write(segment.at, segment.content)
            except unicorn.UcError:
                regions = ", ".join(f"{b:X}h to {b + n - 1:X}h" for b, n in MEMORY_REGION_SIZES.items())
                raise LibraryError(
                    f"{self.path} has content for {segment.at:X}h, where this machine has no memory. Memory is {regions}."
                ) from None
        if not self._elf.segments:
            raise LibraryError(f"{self.path} has nothing to load.")
        names = ("__isr_vector", "__Vectors", "g_pfnVectors", "_vectors", "vectors", "vector_table", "__vectors")
        tables = [self._elf.symbols[n] for n in names if n in self._elf.symbols]
        return tables[0] if tables else min(s.at for s in self._elf.segments)

    # --- exceptions ---

    def main(self) -> int:
        """Run the program from its reset vector; return its exit code."""
        vectors = self.nvic.vectors
        self.set_registers(
            msp=self.read_word(vectors), sp=self.read_word(vectors), lr=RESET_LINK_REGISTER, xpsr=_THUMB_BIT
        )
        self._pc = self.read_word(vectors + 4) & ~1
        self.set_registers(pc=self._pc | 1)
        return super().main()

    def get_start_address(self) -> int:
        """Return the program counter with bit 0 set for Thumb, as Unicorn requires."""
        return self._pc | 1

    def get_program_counter(self) -> int:
        """Return the program counter of the Cortex-M."""
        return self._pc

    def set_program_counter(self, address: int) -> None:
        """Set the program counter, for a debugger."""
        self._pc = address & ~1

    def handle_debugger_stop(self) -> None:
        """Store the program counter when a debugger stops the processor."""
        self._pc = self.get_register("pc") & ~1

    def describe_location(self) -> str:
        """Return the source line at the program counter."""
        return self._elf.describe_address(self.get_register("pc") & ~1)

    def _store_exception(self, _uc: Any, number: int, _user: Any) -> None:
        """Store the number of an exception, which `handle_stop` handles. Unicorn calls this."""
        self._raised = number
        self.uc.emu_stop()

    def handle_stop(self) -> None:
        """Handle a stop of Unicorn: enter or leave the exception that caused it, or wait for an interrupt."""
        number, self._raised = self._raised, 0
        primask, basepri, pc = self._masks.read_all()
        self._pc = pc & ~1
        t = self.record
        if number:
            self._handle_exception(number)
        elif (
            t.cycles < t.alarm
            and not self.nvic.has_waiting_exception()
            and bytes(self.uc.mem_read(self._pc - 2, 2)) in _WFI
        ):
            if not t.watched and not self.nvic.is_systick_running():
                raise self.make_error("it sleeps for ever: no interrupt is on that could wake it")
            wait.c(t.own)
        if t.cycles >= t.alarm:
            self.nvic.pend_systick()
        self.nvic.level = bool(t.raised)
        while (exception := self.nvic.find_next_exception(primask, basepri)) is not None:
            self._enter_exception(exception)
        self._update_interrupt_fields()

    def _handle_exception(self, number: int) -> None:
        """Handle an exception of the Cortex-M that Unicorn reports."""
        if number == _EXIT:
            self._leave_exception(self._pc)
        elif number == _SVC:
            self._enter_exception(11)
        elif number != _BREAKPOINT:
            raise self.make_error(self._describe_exception(number))
        elif bytes(self.uc.mem_read(self._pc, 2)) != _SEMIHOSTING:
            raise self.make_error("a breakpoint")
        else:
            self.semihosting.execute_request()
            self._pc += 2

    def _describe_fault(self, error: Any) -> str:
        """Describe an error of Unicorn for an error message."""
        invalid = error.errno == INVALID_INSTRUCTION
        return self._describe_exception(_UNDEFINED) if invalid else super()._describe_fault(error)

    def _describe_exception(self, number: int) -> str:
        """Describe an exception that ends the program for an error message."""
        if number == _UNDEFINED and not self.get_register("xpsr") & _THUMB_BIT:
            number = _NO_THUMB
        words = _EXCEPTION_MESSAGES.get(number, f"exception {number} of Unicorn")
        window = next((w for w in self._windows_of_board if w.address <= self._pc < w.end), None)
        if number == _NO_CODE and window is not None:
            words = f"it jumps into the window {window}, where the chips are and no code"
        if number in (_NO_CODE, _NO_THUMB):
            words += f" (lr is {self._elf.describe_address(self.get_register('lr') & ~1)})"
        return words

    def _enter_exception(self, number: int) -> None:
        """Push a frame to the stack and begin the routine of an exception."""
        routine = self.read_word(self.nvic.vectors + 4 * number)
        if not routine & 1:
            raise self.make_error(f"exception {number} comes, and its vector is {routine:X}h, which is no routine")
        handler = bool(self.nvic.get_active_exception())
        control, sp, xpsr, *words = self._interrupted.read_all()
        process = not handler and control & 2
        padded = sp & 4
        begin = (sp - padded - _EXCEPTION_FRAME.size) & 0xFFFFFFFF
        frame = _EXCEPTION_FRAME.pack(*words, self._pc, xpsr | _THUMB_BIT | (0x200 if padded else 0))
        self.uc.mem_write(begin, frame)
        back = _EXC_RETURN | (0x11 if handler else 0x1D if process else 0x19)
        self._entry.write_all(begin, number, back, routine)
        self._pc = routine & ~1
        self.nvic.enter_exception(number)

    def _leave_exception(self, value: int) -> None:
        """Return from an exception after a jump to EXC_RETURN."""
        self.nvic.leave_exception(self.nvic.get_active_exception())
        self._mode.write_all(0 if value & 8 else self.nvic.get_active_exception())
        if value & 8:
            control = self.get_register("control")
            if bool(control & 2) != (value & 0xC == 0xC):
                self.set_registers(control=control ^ 2)
        sp = self.get_register("sp")
        *words, pc, xpsr = _EXCEPTION_FRAME.unpack(self.uc.mem_read(sp, _EXCEPTION_FRAME.size))
        xpsr_now = xpsr & ~0x3FF | (0 if value & 8 else self.nvic.get_active_exception())
        self._pc = pc & ~1
        self._exit.write_all(sp + _EXCEPTION_FRAME.size + (4 if xpsr & 0x200 else 0), xpsr_now, *words, self._pc | 1)

    def _group_registers(self, names: str) -> Registers:
        """Return a group of registers, given by their names in one text."""
        return Registers(self._lib, self.handle, [self.find_register_number(name) for name in names.split()])

    # --- its own devices ---

    def _update_interrupt_fields(self) -> None:
        """Pass the state of the interrupt controller to compiled code."""
        t = self.record
        t.alarm = self.nvic.find_next_systick_cycle() * UNITS
        t.line, t.device_waits = self.nvic.can_line_interrupt(), self.nvic.has_waiting_exception()
        t.due = t.cycles

    def _read_private_peripherals(self, _uc: Any, offset: int, size: int, _user: Any) -> int:
        """Return bytes of the private peripherals. Unicorn calls this."""
        value = self.nvic.read(offset & ~3) >> 8 * (offset & 3)
        return value & (1 << 8 * size) - 1

    def _write_private_peripherals(self, _uc: Any, offset: int, size: int, value: int, _user: Any) -> None:
        """Write bytes of the private peripherals; end the run if they request a reset. Unicorn calls this."""
        if offset < 0x80:  # ITM, the first stimulus port
            self.log_text(value.to_bytes(size, "little").decode("latin1"))
        elif self.nvic.write(offset & ~3, value << 8 * (offset & 3), size, offset & 3):
            self.fail("it has asked for a reset (AIRCR)")
        self._update_interrupt_fields()


_OPEN, _CLOSE, _CHAR, _TEXT, _WRITE, _IS_TTY, _LENGTH = 0x01, 0x02, 0x03, 0x04, 0x05, 0x09, 0x0C
_CLOCK, _TIME, _ERROR, _COMMAND_LINE, _HEAP, _END, _END_WITH = 0x10, 0x11, 0x13, 0x15, 0x16, 0x18, 0x20
APPLICATION_EXIT = 0x20026
MAX_TEXT_BYTES = 4096
_FAILURE_RESULT = 0xFFFFFFFF


class Semihosting:
    """Arm's semihosting services, which a program requests by a breakpoint instruction.

    Args:
        cpu: A Cortex.
    """

    def __init__(self, cpu: Any):
        self._cpu = cpu

    def execute_request(self) -> None:
        """Execute the request whose number and parameter are in r0 and r1."""
        cpu = self._cpu
        what, about = cpu.get_register("r0"), cpu.get_register("r1")
        answer = 0
        if what == _CHAR:
            cpu.log_text(chr(cpu.uc.mem_read(about, 1)[0]))
        elif what == _TEXT:
            cpu.log_text(self._read_text(about))
        elif what == _WRITE:
            at, size = cpu.read_word(about + 4), cpu.read_word(about + 8)
            cpu.log_text(bytes(cpu.uc.mem_read(at, min(size, MAX_TEXT_BYTES))).decode("latin1"))
        elif what in (_OPEN, _IS_TTY):
            answer = 1
        elif what == _CLOCK:
            answer = self._compute_time_hundredths()
        elif what == _TIME:
            answer = self._compute_time_hundredths() // 100
        elif what == _END:
            cpu.end(0 if about == APPLICATION_EXIT else 1)
        elif what == _END_WITH:
            code = cpu.read_word(about + 4)
            cpu.end(code - (1 << 32) if code >> 31 else code)
        elif what not in (_CLOSE, _LENGTH, _ERROR, _HEAP):
            answer = _FAILURE_RESULT
        cpu.set_registers(r0=answer)

    def _read_text(self, address: int) -> str:
        """Return the text at an address up to its zero byte."""
        text = b""
        while b"\0" not in text and len(text) < MAX_TEXT_BYTES:
            text += bytes(self._cpu.uc.mem_read(address + len(text), 16))
        return text.split(b"\0")[0].decode("latin1")

    def _compute_time_hundredths(self) -> int:
        """Return the simulated time in hundredths of a second, for the program."""
        t = self._cpu.record
        return int(t.cycles) * 100 // int(t.hz)
