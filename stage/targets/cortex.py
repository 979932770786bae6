"""A Cortex-M on Unicorn: memory, exceptions with priorities, SysTick, NVIC, semihosting; the board lies in windows of its memory.

Time: 1.5 cycles for an instruction of 16 bits and 2.5 for one of 32, an approximation of a Cortex-M3 whose flash has wait states.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stage.board.board import Board
from stage.board.errors import LibraryError
from stage.board.windows import Window
from stage.errors import ArgumentError
from stage.targets.elf import ARM, Elf, check_arm
from stage.targets.engine import INVALID_INSTRUCTION, Engine, Registers
from stage.targets.gdb import CortexRegisters, Server
from stage.targets.machine import wait
from stage.targets.nvic import Nvic

USUAL_HZ = 72_000_000
EACH, BYTE, UNITS = 1, 1, 2
"""Units of time an instruction and a byte, and units a cycle."""
REGIONS = {
    0x00000000: 1 << 20, 0x08000000: 2 << 20, 0x10000000: 1 << 20, 0x1FFF0000: 1 << 16, 0x20000000: 1 << 20, 0x60000000: 1 << 20,
}  # fmt: skip
"""Memory that there is, where no window lies: of flash, RAM, external RAM."""
FLASH = (0x00000000, 0x08000000)
"""Memory that a program cannot write, unless its linker has put variables there."""
PRIVATE, PAGE = 0xE0000000, 0x1000
_FRAME = struct.Struct("<8I")
_RETURN = 0xFFFFFFE0
_THUMB = 0x01000000
_SVC, _BREAKPOINT, _EXIT = 2, 7, 8
_UNDEFINED, _NO_CODE, _NO_THUMB = 1, 3, 18
_EXCEPTIONS = {
    _UNDEFINED: "an instruction that this processor does not have",
    _NO_CODE: "it jumps to where there is no code",
    4: "it touches memory that it may not touch",
    17: "an instruction of a coprocessor that is off or not there (floating point: CPACR)",
    _NO_THUMB: "it jumps to an even address: code of a Cortex-M is Thumb, and addresses of functions are odd",
    22: "it touches a word at an address that this processor cannot",
}
"""Exceptions as Unicorn numbers them."""
_SEMIHOSTING, _WFI = b"\xab\xbe", (b"\x30\xbf", b"\x20\xbf")
HOW = "arm-none-eabi-gcc -mcpu={mcu} -mthumb -T script.ld ..."
MODELS = {"cortex-m0": 7, "cortex-m3": 8, "cortex-m4": 9}


@dataclass(frozen=True)
class CortexProgram:
    """An ELF program. windows: of the board; irq: which of NVIC's the board's line is wired to, or None. gdb: TCP port of a
    GDB server."""

    path: Path
    mcu: str
    hz: int | None
    windows: tuple[Window, ...]
    irq: int | None
    gdb: int | None = None

    def load(self, board: Board, isolated: bool) -> Cortex:
        """See stage.board.thread_runner. Raises LibraryError, FileError."""
        return Cortex(self, board)


class Cortex(Engine):
    """See stage.board.thread_runner."""

    def __init__(self, program: CortexProgram, board: Board):
        import unicorn
        from unicorn import arm_const as a

        self._elf = Elf(program.path, ARM, program.mcu, HOW.format(mcu=program.mcu))
        check_arm(self._elf, program.mcu, HOW)
        hz = program.hz or USUAL_HZ
        mode = unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS
        super().__init__(program.path, board, unicorn.UC_ARCH_ARM, mode, hz * UNITS, MODELS[program.mcu])
        self.a = a
        t = self.record
        t.each, t.byte, t.flags, t.mask, t.on = EACH, BYTE, a.UC_ARM_REG_PRIMASK, 1, 0
        t.watched = program.irq is not None
        self._seen = self._registers("control sp xpsr r0 r1 r2 r3 r12 lr")
        self._entry = self._registers("sp ipsr lr pc")
        self._mode = self._registers("ipsr")
        self._exit = self._registers("sp xpsr r0 r1 r2 r3 r12 lr pc")
        self._masks = self._registers("primask basepri pc")
        self._map(program.windows)
        self.nvic = Nvic(lambda: int(t.cycles) // UNITS, program.irq)
        self.nvic.vectors = self._load()
        self.semihosting = Semihosting(self)
        self.uc.hook_add(unicorn.UC_HOOK_INTR, self._exception)
        self._raised = 0
        if program.gdb:
            self.gdb = Server(self, CortexRegisters(self), program.gdb)
        self._update()

    # --- registers and memory ---

    def get(self, name: str) -> int:
        """A register, for example "r0"."""
        return int(self.uc.reg_read(getattr(self.a, f"UC_ARM_REG_{name.upper()}")))

    def set(self, **values: int) -> None:
        """Registers."""
        for name, value in values.items():
            self.uc.reg_write(getattr(self.a, f"UC_ARM_REG_{name.upper()}"), value)

    def word(self, address: int) -> int:
        """32 bits of memory."""
        return int.from_bytes(self.uc.mem_read(address, 4), "little")

    def _map(self, windows: tuple[Window, ...]) -> None:
        import unicorn

        self._windows_of_board = windows
        taken = {page for w in windows for page in range(w.address & ~0xFFF, w.end, PAGE)}
        for w in windows:
            if w.end > 1 << 32 or PRIVATE <= w.address < PRIVATE + 0x100000:
                raise ArgumentError(
                    f"window {w}: a Cortex-M has no memory for it there; its devices are at 40000000h and up."
                )
            for begin, size in REGIONS.items():
                if begin <= w.address < begin + size and begin < 0x60000000:
                    raise ArgumentError(f"window {w}: real memory is there (of {begin:X}h to {begin + size - 1:X}h).")
        for begin, size in REGIONS.items():
            if not any(begin <= page < begin + size for page in taken):
                fixed = begin in FLASH and not self._elf.is_writable(begin, size)
                self.uc.mem_map(
                    begin, size, unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC if fixed else unicorn.UC_PROT_ALL
                )
        self.map_windows(windows)
        self.uc.mmio_map(PRIVATE, 0x100000, self._read_private, None, self._write_private, None)

    def _load(self) -> int:
        """Content to memory; where the vectors are. The first word of the flash is the stack, the second the entry."""
        import unicorn

        for segment in self._elf.segments:
            try:
                self.uc.mem_write(segment.at, segment.content)
            except unicorn.UcError:
                regions = ", ".join(f"{b:X}h to {b + n - 1:X}h" for b, n in REGIONS.items())
                raise LibraryError(
                    f"{self.path} has content for {segment.at:X}h, where this machine has no memory. Memory is {regions}."
                ) from None
        if not self._elf.segments:
            raise LibraryError(f"{self.path} has nothing to load.")
        names = ("__isr_vector", "__Vectors", "g_pfnVectors", "_vectors", "vectors", "vector_table", "__vectors")
        found = [self._elf.symbols[n] for n in names if n in self._elf.symbols]
        return found[0] if found else min(s.at for s in self._elf.segments)

    # --- exceptions ---

    def main(self) -> int:
        """See stage.board.thread_runner."""
        vectors = self.nvic.vectors
        self.set(msp=self.word(vectors), sp=self.word(vectors), lr=0xFFFFFFFF, xpsr=_THUMB)
        self._pc = self.word(vectors + 4) & ~1
        self.set(pc=self._pc | 1)
        return super().main()

    def where_to_go_on(self) -> int:
        return self._pc | 1

    def address(self) -> int:
        return self._pc

    def go_to(self, address: int) -> None:
        """A debugger sets the program counter."""
        self._pc = address & ~1

    def halted(self) -> None:
        self._pc = self.get("pc") & ~1

    def place(self) -> str:
        return self._elf.where(self.get("pc") & ~1)

    def _exception(self, _uc: Any, number: int, _user: Any) -> None:
        self._raised = number
        self.uc.emu_stop()

    def stopped(self) -> None:
        number, self._raised = self._raised, 0
        primask, basepri, pc = self._masks.get()
        self._pc = pc & ~1
        t = self.record
        if number == _EXIT:
            self._leave(self._pc)
        elif number == _BREAKPOINT:
            if bytes(self.uc.mem_read(self._pc, 2)) != _SEMIHOSTING:
                raise self.wrong("a breakpoint")
            self.semihosting.serve()
            self._pc += 2
        elif number == _SVC:
            self._enter(11)
        elif number:
            self._fault(number)
        elif t.cycles < t.alarm and not self.nvic.waiting() and bytes(self.uc.mem_read(self._pc - 2, 2)) in _WFI:
            if not t.watched and not self.nvic.ticks():
                raise self.wrong("it sleeps for ever: no interrupt is on that could wake it")
            wait.c(t.own)
        if t.cycles >= t.alarm:
            self.nvic.tick()
        self.nvic.level = bool(t.raised)
        while (taken := self.nvic.next(primask, basepri)) is not None:
            self._enter(taken)
        self._update()

    def _fault(self, number: int) -> None:
        raise self.wrong(self._in_words(number))

    def _fault_in_words(self, error: Any) -> str:
        invalid = error.errno == INVALID_INSTRUCTION
        return self._in_words(_UNDEFINED) if invalid else super()._fault_in_words(error)

    def _in_words(self, number: int) -> str:
        """An exception of Unicorn's."""
        if number == _UNDEFINED and not self.get("xpsr") & _THUMB:
            number = _NO_THUMB
        said = _EXCEPTIONS.get(number, f"exception {number} of Unicorn")
        window = next((w for w in self._windows_of_board if w.address <= self._pc < w.end), None)
        if number == _NO_CODE and window is not None:
            said = f"it jumps into the window {window}, where the chips are and no code"
        if number in (_NO_CODE, _NO_THUMB):
            said += f" (lr is {self._elf.where(self.get('lr') & ~1)})"
        return said

    def _enter(self, number: int) -> None:
        """The frame goes to the stack, the routine begins."""
        routine = self.word(self.nvic.vectors + 4 * number)
        if not routine & 1:
            raise self.wrong(f"exception {number} comes, and its vector is {routine:X}h, which is no routine")
        handler = bool(self.nvic.before())
        control, sp, xpsr, *words = self._seen.get()
        process = not handler and control & 2
        padded = sp & 4
        begin = (sp - padded - _FRAME.size) & 0xFFFFFFFF
        frame = _FRAME.pack(*words, self._pc, xpsr | _THUMB | (0x200 if padded else 0))
        self.uc.mem_write(begin, frame)
        back = _RETURN | (0x11 if handler else 0x1D if process else 0x19)
        self._entry.set(begin, number, back, routine)
        self._pc = routine & ~1
        self.nvic.entered(number)

    def _leave(self, value: int) -> None:
        """A jump to EXC_RETURN."""
        self.nvic.left(self.nvic.before())
        self._mode.set(0 if value & 8 else self.nvic.before())
        if value & 8:
            control = self.get("control")
            if bool(control & 2) != (value & 0xC == 0xC):
                self.set(control=control ^ 2)
        sp = self.get("sp")
        *words, pc, xpsr = _FRAME.unpack(self.uc.mem_read(sp, _FRAME.size))
        xpsr_now = xpsr & ~0x3FF | (0 if value & 8 else self.nvic.before())
        self._pc = pc & ~1
        self._exit.set(sp + _FRAME.size + (4 if xpsr & 0x200 else 0), xpsr_now, *words, self._pc | 1)

    def _registers(self, names: str) -> Registers:
        return Registers(self._lib, self.handle, [getattr(self.a, f"UC_ARM_REG_{n.upper()}") for n in names.split()])

    # --- its own devices ---

    def _update(self) -> None:
        """What the compiled loop looks at."""
        t = self.record
        t.alarm = self.nvic.alarm() * UNITS
        t.line, t.wanted = self.nvic.line_may_come(), self.nvic.waiting()
        t.due = t.cycles

    def _read_private(self, _uc: Any, offset: int, size: int, _user: Any) -> int:
        value = self.nvic.read(offset & ~3) >> 8 * (offset & 3)
        return value & (1 << 8 * size) - 1

    def _write_private(self, _uc: Any, offset: int, size: int, value: int, _user: Any) -> None:
        if offset < 0x80:  # ITM, the first stimulus port
            self.say(value.to_bytes(size, "little").decode("latin1"))
        elif self.nvic.write(offset & ~3, value << 8 * (offset & 3), size, offset & 3):
            self.fault = "it has asked for a reset (AIRCR)"
            self.uc.emu_stop()
        self._update()


_OPEN, _CLOSE, _CHAR, _TEXT, _WRITE, _IS_TTY, _LENGTH = 0x01, 0x02, 0x03, 0x04, 0x05, 0x09, 0x0C
_CLOCK, _TIME, _ERROR, _COMMAND_LINE, _HEAP, _END, _END_WITH = 0x10, 0x11, 0x13, 0x15, 0x16, 0x18, 0x20
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
        elif what == _END:
            cpu.end(0 if about == APPLICATION_ENDS else 1)
        elif what == _END_WITH:
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
