"""Scripts of register accesses for the timers of an ATmega328P: as assembler, and on a slow reference.

A script is a list of steps: `write(register, value)`, `read(register)`, `wait(cycles)`. `assemble` makes a program of it
in which each step takes a known number of cycles; `run_on_reference` returns what its reads must give. The reference follows the
data sheet clock by clock: a prescaler that runs from the reset on, a counter, compare units that set their flag one
timer clock after the match, a write of the count that suppresses the next match, TEMP.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass, field
from pathlib import Path

Step = tuple[str, int, int]
RESULTS = 0x120  # address of the values read
N_VECTORS = 26
_BEGIN_CYCLES = 3 + 2
"""Cycles of the jump at the reset vector, and of loading X."""
_ACCESS_CYCLES = {"write": 2, "read": 1}
"""Cycles from the begin of a step to that of its access, which takes one."""
_STEP_CYCLES = {"write": 3, "read": 4}
(TIFR0, TIFR1, TIFR2) = (0x35, 0x36, 0x37)
(TIMSK0, TIMSK1, TIMSK2) = (0x6E, 0x6F, 0x70)
PINB, PIND = 0x23, 0x29
TOV, OCFA, OCFB, ICF = 1, 2, 4, 0x20


def write(register: int, value: int) -> Step:
    return "write", register, value


def read(register: int) -> Step:
    return "read", register, 0


def wait(cycles: int) -> Step:
    return "wait", cycles, 0


@dataclass(frozen=True)
class Registers:
    """Registers of a timer: low bytes; the high byte of a 16-bit register is at the next address.

    Attributes:
        number: Number of the timer.
        a: TCCRnA.
        b: TCCRnB.
        count: TCNTn.
        compare: OCRnA and OCRnB.
        flags: TIFRn.
        enables: TIMSKn.
        vectors: Numbers of the interrupts of compare units A and B and of the overflow.
        strobes: Register with the FOC bits.
        output_register: PIN register of the output of unit A; the DDR register follows it.
        output: Bit of that output.
        shifts: Logarithm of the prescaler for each number of a clock.
        icr: ICRn; 0: there is none.
    """

    number: int
    a: int
    b: int
    count: int
    compare: tuple[int, int]
    flags: int
    enables: int
    vectors: tuple[int, int, int]
    strobes: int
    output_register: int
    output: int
    shifts: tuple[int, ...]
    icr: int = 0

    @property
    def is_wide(self) -> bool:
        return self.number == 1

    @property
    def max(self) -> int:
        return 0xFFFF if self.is_wide else 0xFF

    def write_word(self, register: int, value: int) -> list[Step]:
        high = [write(register + 1, value >> 8)] if self.is_wide else []
        return [*high, write(register, value & 0xFF)]

    def read_count(self) -> list[Step]:
        return [read(self.count), *([read(self.count + 1)] if self.is_wide else [])]

    def select(self, ctc: bool, clock: int, output_mode: int = 0) -> list[Step]:
        """Select normal or CTC mode, the mode of output A (1: toggle, 2: clear, 3: set) and the clock (0: stopped)."""
        if self.is_wide:
            return [write(self.a, output_mode << 6), write(self.b, (8 if ctc else 0) | clock)]
        return [write(self.a, output_mode << 6 | (2 if ctc else 0)), write(self.b, clock)]


_FAST, _SLOW = (0, 0, 3, 6, 8, 10), (0, 0, 3, 5, 6, 7, 8, 10)
TIMERS = (
    Registers(0, 0x44, 0x45, 0x46, (0x47, 0x48), TIFR0, TIMSK0, (14, 15, 16), 0x45, PIND, 6, _FAST),
    Registers(1, 0x80, 0x81, 0x84, (0x88, 0x8A), TIFR1, TIMSK1, (11, 12, 13), 0x82, PINB, 1, _FAST, icr=0x86),
    Registers(2, 0xB0, 0xB1, 0xB2, (0xB3, 0xB4), TIFR2, TIMSK2, (7, 8, 9), 0xB1, PINB, 3, _SLOW),
)


def align_accesses(script: list[Step]) -> list[Step]:
    """Return a script like another one whose timers run at an eighth of the clock, and whose accesses are between their clocks.

    It gives the same on emulators that differ in the cycle of an access.
    """
    slow, time = [], _BEGIN_CYCLES
    for name, a, b in script:
        if name == "wait":
            slow.append(wait(8 * a))
            time += 8 * a
            continue
        is_clock = name == "write" and a in {r.b for r in TIMERS} and b & 7 == 1
        pause = (4 - time - _ACCESS_CYCLES[name]) % 8
        slow += [wait(pause), (name, a, b + 1 if is_clock else b)]
        time += pause + _STEP_CYCLES[name]
    return slow


# --- as a program ---


def assemble(script: list[Step], path: Path, vector: int = 0, routine: str = "inc r20") -> tuple[Path, int]:
    """Build a program of a script.

    Args:
        script: The steps.
        path: Path of the ELF without suffix.
        vector: Number of an interrupt that the program enables; 0: none.
        routine: First instruction of its routine, which may change r20, the last of the results.

    Returns:
        The path of the ELF, and the number of results.
    """
    lines = ["    .global main", "main:"]
    lines += [f"    jmp {'routine' if n == vector and n else 'start'}" for n in range(N_VECTORS)]
    lines += ["routine:", f"    {routine}", "    reti", "start:"]
    lines += [f"    ldi r26, {RESULTS & 0xFF}", f"    ldi r27, {RESULTS >> 8}"]
    lines += ["    sei"] if vector else []
    for name, a, b in script:
        if name == "write":
            lines += [f"    ldi r16, {b}", f"    sts {a}, r16"]
        elif name == "read":
            lines += [f"    lds r16, {a}", "    st X+, r16"]
        else:
            lines += _wait(a)
    lines += ["    cli", "    st X+, r20", "done:", "    rjmp done", ""]
    source = path.with_suffix(".S")
    source.write_text("\n".join(lines))
    elf = path.with_suffix(".elf")
    subprocess.run(["avr-gcc", "-mmcu=atmega328p", "-nostdlib", source, "-o", elf], check=True)
    return elf, sum(name == "read" for name, _, _ in script) + 1


def _wait(cycles: int) -> list[str]:
    """Return instructions that take a number of cycles, up to 262,000."""
    if cycles < 12:
        return ["    nop"] * cycles
    rounds, rest = divmod(cycles - 1, 4)
    return [
        f"    ldi r24, {rounds & 0xFF}", f"    ldi r25, {rounds >> 8}", "1:  sbiw r24, 1", "    brne 1b", *["    nop"] * rest
    ]  # fmt: skip


# --- on the reference ---


@dataclass
class ReferenceTimer:
    """A timer, clock by clock."""

    registers: Registers
    a: int = 0
    b: int = 0
    count: int = 0
    compare: list[int] = field(default_factory=lambda: [0, 0])
    icr: int = 0
    temp: int = 0
    flags: int = 0
    is_blocked: bool = False
    output: int = 0

    @property
    def max(self) -> int:
        return self.registers.max

    @property
    def top(self) -> int:
        if self.registers.is_wide:
            mode = (self.b >> 3 & 3) << 2 | self.a & 3
            return {4: self.compare[0], 12: self.icr}.get(mode, self.max)
        return self.compare[0] if self.a & 3 == 2 else self.max

    @property
    def is_top_icr(self) -> bool:
        return self.registers.is_wide and self.b >> 3 & 3 == 3

    def pass_clock(self, time: int) -> None:
        """Pass the edge of the system clock at a time (cycles since the reset)."""
        clock = self.b & 7
        if clock == 0 or time % (1 << self.registers.shifts[clock]):
            return
        count, raised = self.count, 0
        if not self.is_blocked:
            raised |= OCFA if count == self.compare[0] else 0
            raised |= OCFB if count == self.compare[1] else 0
            raised |= ICF if self.is_top_icr and count == self.icr else 0
        raised |= TOV if count == self.max else 0
        is_end = count == self.max or (count == self.top and not self.is_blocked)
        self.count, self.is_blocked = 0 if is_end else count + 1, False
        self.flags |= raised
        if raised & OCFA:
            self.match_output()

    def match_output(self) -> None:
        """Change output A as its mode says."""
        self.output = (self.output, 1 - self.output, 0, 1)[self.a >> 6]

    def read(self, register: int) -> int:
        r = self.registers
        if r.is_wide and register in (r.count, r.icr):
            value = self.count if register == r.count else self.icr
            self.temp = value >> 8
            return value & 0xFF
        if r.is_wide and register in (r.count + 1, r.icr + 1):
            return self.temp
        for k, low in enumerate(r.compare):
            if register in (low, low + 1) and (r.is_wide or register == low):
                return self.compare[k] >> 8 * (register - low) & 0xFF
        if register == r.output_register:
            return self.output << r.output
        return {r.count: self.count, r.flags: self.flags, r.a: self.a, r.b: self.b, r.strobes: self.b}[register]

    def write(self, register: int, value: int) -> None:
        r = self.registers
        word = self.temp << 8 | value if r.is_wide else value
        if r.is_wide and register in (r.count + 1, r.icr + 1, r.compare[0] + 1, r.compare[1] + 1):
            self.temp = value
        elif register == r.count:
            self.count, self.is_blocked = word, True
        elif register in r.compare:
            self.compare[r.compare.index(register)] = word
        elif r.is_wide and register == r.icr:
            self.icr = word
        elif register == r.flags:
            self.flags &= ~value
        elif register == r.a:
            self.a = value
        elif register == r.b:
            self.b = value if r.is_wide else value & 0x3F
        if register == r.strobes and value & 0x80:
            self.match_output()


def run_on_reference(script: list[Step], timer: Registers) -> list[int]:
    """Return what a script's reads of a timer's registers and of its output give."""
    reference, values, time = ReferenceTimer(timer), [], 0

    def pass_cycles(cycles: int) -> None:
        nonlocal time
        for _ in range(cycles):
            time += 1
            reference.pass_clock(time)

    pass_cycles(_BEGIN_CYCLES)
    for name, a, b in script:
        if name == "wait":
            pass_cycles(a)
            continue
        pass_cycles(_ACCESS_CYCLES[name])
        if name == "read":
            values.append(reference.read(a))
        pass_cycles(1)
        if name == "write":
            reference.write(a, b)
        pass_cycles(_STEP_CYCLES[name] - _ACCESS_CYCLES[name] - 1)
    return values
