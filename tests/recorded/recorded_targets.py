"""Emulated processors without their emulators: x86 code that reaches windows, NVIC, 8253, DOS, ELF files, debuggers."""

import ctypes
import struct
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from recorded.player import Draw
from recorded.recorded_stage import go, make
from recorded.recorded_texts import tried
from recorded.store import digits

from stage.board import Board, bus, mapping
from stage.board.x86 import records, trap
from stage.board.x86.table import GROUP, GROUP_DONE, GROUPS, TABLE
from stage.chips import PCL240K
from stage.targets import avr, avr_vectors, built_for, elf, gdb, host, machine, pins
from stage.targets.dos import Dos
from stage.targets.engine import NEVER
from stage.targets.gdb_registers import CortexRegisters, PcRegisters
from stage.targets.nvic import Nvic
from stage.targets.pc import Pc
from stage.targets.semihosting import Semihosting
from stage.targets.timer import Timers

# --- x86 ---

AT, SIZE = 0x1A5A_0000_0000, 1 << 16
CODE, DATA, TOP, WINDOW = AT, AT + 0x4000, AT + 0x9080, 0x4000_0000
PLACES = [13, 14, 12, 11, 15, 10, 9, 8, *range(8)]
"""Of rax rcx rdx rbx rsp rbp rsi rdi r8 ... among the saved registers."""


class Processor:
    """Registers and memory at an address that is always the same, a window of 40h ports, and what is asked of its bus."""

    def __init__(self):
        libc = ctypes.CDLL(None)
        libc.mmap.restype = ctypes.c_void_p
        at = libc.mmap(ctypes.c_void_p(AT), ctypes.c_size_t(SIZE), 3, 0x22 | 0x100000, -1, ctypes.c_long(0))
        if at != AT:
            pytest.skip("its memory is in use")
        self.free = lambda: libc.munmap(ctypes.c_void_p(AT), ctypes.c_size_t(SIZE))
        self.memory = np.frombuffer((ctypes.c_uint8 * SIZE).from_address(AT), np.uint8)
        self.asked, self.d = [], Draw("x86")
        call = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int32, ctypes.c_int64, ctypes.c_int64)
        self.call = call(self.request)
        self.spans = np.zeros(records.SPANS, records.SPAN)
        for k, row in enumerate(
            (
                (WINDOW, WINDOW + 0x40, records.WINDOW, 0x300, 7),
                (WINDOW, WINDOW + 0x1000, records.PAGE, 0, 7),
                (DATA, DATA + 0x2000, records.READ | records.WRITE, 0, 7),
                (DATA + 0x2000, DATA + 0x3000, records.READ, 0, 7),
            )
        ):
            self.spans[k] = row
        self.space, self.step = np.zeros(1, records.SPACE), np.zeros(1, records.STEP)
        self.context, self.info = np.zeros(64, np.int64), np.zeros(8, np.int64)
        self.space["request"] = ctypes.cast(self.call, ctypes.c_void_p).value
        self.space["opcodes"], self.space["spans"] = TABLE.ctypes.data, self.spans.ctypes.data
        self.regs = self.context[5:28]

    def request(self, of, what, a, b):
        self.asked.append([of, what, a if what not in (16, 17) else 0, b])
        return self.d.of(0, -1, 0x7F, 0x80, 0x8000, 0x1234_5678, -0x7654_3211)

    def run(self, code, go_on=False):
        """What has changed after the instruction, and after those behind it."""
        self.memory[: len(code) + 32] = list(code) + [0xCC] * 32
        self.spans[4] = (CODE, CODE + 0x100, records.CODE | records.READ, 0, 7) if go_on else 0
        self.regs[16], self.info[2] = CODE, WINDOW
        before, data = self.regs.copy(), self.memory[0x4000:].copy()
        self.asked.clear()
        trap.on_fault.c(
            11, self.info.ctypes.data, self.context.ctypes.data, self.space.ctypes.data, self.step.ctypes.data
        )
        regs = {int(k): int(self.regs[k]) for k in np.flatnonzero(self.regs != before)}
        touched = np.flatnonzero(self.memory[0x4000:] != data)
        bytes_ = [[int(k), int(self.memory[0x4000 + k])] for k in touched[:40]]
        return [int(self.step["status"][0]), regs, bytes_, list(self.asked)]


def registers_of(d):
    """Random, some of them addresses of memory, of its ends, of the window and of its end."""
    words = [d.of(d.between(-(1 << 63), (1 << 63) - 1), d.between(-300, 300), 0, -1, 1 << 31, 0x80) for _ in range(16)]
    words[4] = TOP
    for n, place in ((6, DATA + 0x100), (7, WINDOW + 8), (3, WINDOW + 0x3E), (5, DATA + 0x1FFC), (2, DATA + 0x2010)):
        words[n] = place + (0 if n != 6 else d.between(0, 3))
    return words


def instruction(d, opcode, op):
    prefixes = b"".join(d.of(b"", b"", b"\x66", b"", prefix) for prefix in (b"\xf3", b"\x67", b"\xf0", b"\x2e")[:2])
    rex = d.of(b"", b"", bytes([0x48]), bytes([0x40 + d.between(0, 15)]))
    code = prefixes + rex + (b"\x0f" if opcode & 0x100 else b"") + bytes([opcode & 0xFF])
    if opcode & ~3 == 0xA0:
        return code + struct.pack("<q", d.of(WINDOW + 4, WINDOW + 0x3D, DATA + 8, DATA + 0x2008, DATA - 4))
    if op["modrm"]:
        mode, rm = d.of((1, 6), (1, 7), (1, 3), (2, 6), (0, 7), (3, d.between(0, 7)), (1, 4), (0, 4), (1, 5), (0, 2))
        code += bytes([mode << 6 | d.between(0, 7) << 3 | rm])
        if mode != 3 and rm == 4:
            code += bytes([d.of(0x26, 0x27, 0x66, 0x06, 0x25, 0x64)])
        code += bytes([d.of(0, 4, 0xFC, 0x10, 0x38)]) if mode == 1 else b""
        code += struct.pack("<i", d.of(0, 8, -4)) if mode == 2 else b""
    return code + bytes(d.of(d.between(0, 255), 3, 0xFF) for _ in range(8))


def x86(part):
    """Every instruction of the table with random operands, in registers, in memory and in the window."""
    if not mapping.HERE:
        pytest.skip("windows need Linux on x86-64")
    p, d, found = Processor(), Draw(f"x86 {part}"), []
    opcodes = [k for k in range(GROUPS) if TABLE[k]["known"]][part::4]
    for opcode in opcodes:
        said = []
        for _ in range(24 if GROUP <= TABLE[opcode]["what"] < GROUP_DONE else 7):
            for n, word in enumerate(registers_of(d)):
                p.regs[PLACES[n]] = word
            p.regs[17] = d.of(0x202, 0xAD7, 0x203, 0x2C6, 0x8D5, d.between(0, 0xFFF) & ~0x400, 0x602)
            if opcode in (0xA4, 0xA5, 0xAA, 0xAB):
                p.regs[14] = d.between(-1, 4)
            p.memory[0x4000:] = (np.arange(SIZE - 0x4000) * 37 + d.between(0, 255)) & 0xFF
            said.append(p.run(instruction(d, opcode, TABLE[opcode])))
        found.append(
            f"{opcode:X} {digits(repr(said), 4)} {[s[0] for s in said].count(0)} {sum(len(s[3]) for s in said)}"
        )
    p.free()
    return {line.split()[0]: line.split(maxsplit=1)[1] for line in found}


def x86_in_a_row():
    """Instructions behind an access go on in the handler, calls of the bus too; others go back to the processor."""
    if not mapping.HERE:
        pytest.skip("windows need Linux on x86-64")
    p, found = Processor(), {}
    for name, code in {
        "poll": "8a07 84c0 75fa 90",
        "loop": "8807 fec8 75fa 8a47 01 0f0b",
        "far": "8a07 48ffc9 75fb 8a07",
        "call": "8a07 41ffd7 8907",
        "beyond": "8a07 8b4340",
        "string": "8a07 f3a4 aa",
        "stack": "8a07 50 53 59 c9",
        "left": "8a07 0fa2",
        "not ours": "0fa2",
        "word": "668b07 668907",
        "eight": "488b07 488907",
        "locked": "f0ff07 f0ff06",
        "end": "488b43 fa",
        "end of word": "8b03",
    }.items():
        for n, word in enumerate(registers_of(Draw(name))):
            p.regs[PLACES[n]] = word
        p.regs[7], p.regs[PLACES[1]], p.regs[17] = int(p.space["request"][0]), 300, 0x202
        p.memory[0x4000:] = np.arange(SIZE - 0x4000) & 0xFF
        status, regs, touched, asked = p.run(bytes.fromhex(code), go_on=True)
        own = int(p.space["request"][0])
        regs = {k: v for k, v in regs.items() if v != own}
        found[name] = [status, regs, touched if name not in ("call", "stack") else len(touched), asked[:9], len(asked)]
    found["faults"] = int(p.space["faults"][0])
    p.info[2] = WINDOW + 0x1000
    p.space["previous"] = 5
    call = partial(
        trap.on_fault.c, 11, p.info.ctypes.data, p.context.ctypes.data, p.space.ctypes.data, p.step.ctypes.data
    )
    found["others"] = [call(), int(p.space["faults"][0])]
    p.info[2] = p.regs[16] = WINDOW
    found["jumped"] = [call(), int(p.space["faults"][0])]
    p.free()
    return found


# --- Cortex-M ---


def nvic():
    """Random writes and reads of its registers, exceptions that come and go, SysTick."""
    found = {}
    for irq in (3, None, 70):
        d, now, said = Draw(f"nvic {irq}"), [0], []
        n = Nvic(lambda now=now: now[0], irq)
        n.vectors = 0x8000000
        for _ in range(900):
            at = d.of(
                0xE010,
                0xE014,
                0xE018,
                0xE01C,
                0xED04,
                0xED08,
                0xED00,
                0x1004,
                0x1000,
                0x0,
                0xED24,
                0xED0C,
                *(base + 4 * d.between(0, 3) for base in (0xE100, 0xE180, 0xE200, 0xE280, 0xE300, 0xE400, 0xED18)),
                0xE400 + 4 * d.between(16, 60),
                0xE120,
                0xE1FC,
            )
            what = d.between(0, 9)
            if what < 4:
                value = d.of(0, 7, 3, 1, 0x40, 0x80404000, 0xFFFFFFFF, 1 << d.between(0, 31), d.between(0, 500))
                size, byte = (4, 0) if d.chance(0.7) else d.of((1, 0), (1, 3), (2, 2))
                if at != 0xED0C or d.chance(0.2):
                    said.append(n.write(at, value, size, byte))
            elif what < 7:
                said.append([at, n.read(at)])
            elif what == 7:
                now[0] += d.between(1, 400)
                n.level = d.chance(0.4)
                if d.chance(0.5):
                    n.tick()
            else:
                taken = n.next(d.of(0, 0, 0, 1), d.of(0, 0, 0x40))
                if taken is not None and d.chance(0.8):
                    n.entered(taken)
                elif d.chance(0.6):
                    n.left(n.before())
                said.append([taken, n.before()])
            said.append([n.waiting(), n.line_may_come(), n.ticks(), n.alarm()])
        found[str(irq)] = [digits(repr(said[k : k + 50])) for k in range(0, len(said), 50)]
    return found


class Cpu:
    """What semihosting asks of a processor."""

    def __init__(self):
        self.memory, self.registers = bytearray(1 << 14), {"r0": 0, "r1": 0}
        self.uc = SimpleNamespace(mem_read=lambda at, size: self.memory[at : at + size])
        self.record = SimpleNamespace(cycles=123_456_789, hz=7_200_000)
        self.said = []

    def get(self, name):
        return self.registers[name]

    def set(self, **values):
        self.registers |= values

    def word(self, at):
        return int.from_bytes(self.memory[at : at + 4], "little")

    def say(self, text):
        self.said.append(text)

    def end(self, code):
        self.said.append(f"ends {code}")


def semihosting():
    cpu, found = Cpu(), {}
    cpu.memory[0x100:0x130] = b"0123456789abcdef" * 2 + b"end\0 and more..."
    cpu.memory[0x200:0x20C] = struct.pack("<3I", 1, 0x104, 9)
    cpu.memory[0x300:0x30C] = struct.pack("<3I", 1, 0x0, 9000)
    cpu.memory[0x400:0x408] = struct.pack("<2I", 0x20026, 0xFFFFFFFE)
    cpu.memory[0x1000:0x3000] = b"x" * 0x2000
    for what in range(0x25):
        for about in (0x100, 0x200, 0x300, 0x400, 0x20026, 0x1000):
            cpu.registers = {"r0": what, "r1": about if about < 1 << 14 or what == 0x18 else 0}
            cpu.said.clear()
            Semihosting(cpu).serve()
            said = [cpu.registers["r0"], *(t if len(t) < 50 else f"{len(t)} {digits(t)}" for t in cpu.said)]
            if said != [0xFFFFFFFF]:
                found[f"{what:X} {about:X}"] = said
    return found


# --- a PC ---


def counters():
    """8253: random modes, counts, latches; outputs and the next tick."""
    d, now, said = Draw("8253"), [0], []
    t = Timers(lambda: now[0])
    for _ in range(1500):
        port = d.of(0x40, 0x41, 0x42, 0x43, 0x61)
        if d.chance(0.45):
            value = d.of(
                d.between(0, 255), *(0x10 * k | m for k in (1, 2, 3, 7, 11) for m in (0, 4, 6, 12)), 0x00, 0x80, 0
            )
            said.append(t.write(port, value))
        else:
            said.append([port, t.read(port)])
        now[0] += d.of(0, 1, 2, d.between(0, 300), d.between(0, 70_000))
        said.append([t.next_tick() - now[0], [c.output(now[0]) for c in t.channels]])
    return {"said": [digits(repr(said[k : k + 60])) for k in range(0, len(said), 60)]}


class Words:
    """Registers and memory of an 8086."""

    prefix = 0x1000
    ROOM = 0x30000

    def __init__(self, d):
        names = ("ax", "bx", "cx", "dx", "ds", "es", "ss", "sp", "cs", "ip")
        self.words = {name: d.between(0, 0xFFFF) & 0x1FFF for name in names} | {"eflags": d.between(0, 0xFFF)}
        self.memory = bytearray(self.ROOM)
        self.said, self.fault, self.record = [], "", SimpleNamespace(cycles=98_765_432_100, hz=4_772_727, due=None)
        self.uc = SimpleNamespace(emu_stop=lambda: self.said.append("stops"))

    def get(self, name):
        if name[1] in "hl":
            return self.words[name[0] + "x"] >> (8 if name[1] == "h" else 0) & 0xFF
        return self.words[name]

    def set(self, **values):
        for name, value in values.items():
            if name[1] in "hl" and name not in ("eflags",):
                word, shift = self.words[name[0] + "x"], 8 if name[1] == "h" else 0
                self.words[name[0] + "x"] = word & ~(0xFF << shift) | value << shift
            else:
                self.words[name] = value

    def read(self, segment, offset, size):
        return bytes(self.memory[(segment << 4) + (offset & 0xFFFF) :][:size])

    def write(self, segment, offset, content):
        at = (segment << 4) + (offset & 0xFFFF)
        self.memory[at : at + len(content)] = content

    def vector(self, n):
        return struct.unpack("<HH", self.read(0, 4 * n, 4))

    def watch_timer(self):
        self.said.append("watches")

    def say(self, text):
        self.said.append(text if len(text) < 40 else f"{len(text)} {digits(text)}")

    def end(self, code):
        self.said.append(f"ends {code}")


def dos():
    """Each function of each interrupt: registers, text, memory."""
    found = {}
    for number in (0x20, 0x21, 0x10, 0x15, 0x16, 0x1A, 0x11, 0x12, 0x33):
        for ah in range(0x70 if number == 0x21 else 0x14) if number != 0x15 else (0x85, 0x86):
            said = []
            for k in range(3):
                d = Draw(f"{number} {ah} {k}")
                pc = Words(d)
                pc.words["ax"] = ah << 8 | d.of(d.between(0, 255), 0x5C)
                pc.words["bx"] = d.between(0, 4)
                pc.words["dx"] = d.of(0x2FF, 0x240, d.between(0, 0x1FFF))
                pc.memory[:] = bytes(range(32, 96)) * (len(pc.memory) // 64)
                pc.memory[0:1024] = b"\x12\x34\x56\x78" * 256
                before, memory = dict(pc.words), bytes(pc.memory[:1024])
                Dos(pc).serve(number)
                changed = {n: v for n, v in pc.words.items() if v != before[n]}
                said.append(
                    [changed, pc.said, pc.fault, bytes(pc.memory[:1024]) == memory, pc.record.cycles, pc.record.due]
                )
            found[f"{number:X} {ah:X}"] = digits(repr(said), 3)
    return found


class Bare(Words, Pc):
    """A PC's ports and interrupts; nothing behind them."""

    ROOM = 1 << 21

    def __init__(self, d, irq):
        Words.__init__(self, d)
        self.now = 0
        self.record = SimpleNamespace(cycles=0, hz=4_772_727, due=1, wanted=0, line=0, raised=0, alarm=NEVER, own=0)
        self._irq, self._masked, self._in_service, self._ticks_at = irq, 0, 0, 0
        self.timers = Timers(lambda: self.now)
        self._board = SimpleNamespace(ports={0x50: "a device", 0x51: "a device", 0x43: "another"})
        self.asked, self.fault, self._call = [], "", None
        self._bios()

    def watch_timer(self):
        Pc.watch_timer(self)

    def _on_board(self, port, size, value):
        self.asked.append([port, size, value])
        if value == 0x99:
            raise ValueError("the board says no")
        return 0x7A77 & (0xFF if size == 1 else 0xFFFF)


def controller(irq):
    """Ports of the PC, its interrupt controller and its ticks in random order."""
    d, said = Draw(f"pc {irq}"), []
    pc = Bare(d, irq)
    pc.words |= {"sp": 0x800, "ss": 0x900, "cs": 0x1000, "ip": 0x120}
    for _ in range(700):
        what = d.between(0, 9)
        if what < 4:
            port = d.of(0x20, 0x21, 0x21, 0x40, 0x43, 0x61, 0x50, 0x51, 0x60, 0x3F, 0x44, 0x4F)
            value = d.of(-1, -1, d.between(0, 255), 0x20, 0x60 + d.between(0, 7), 0, 0x99, 0xFF)
            said.append([port, pc._rare(0, port, d.of(1, 1, 1, 2), value)])
        elif what == 4:
            pc.record.raised, pc.record.line = int(d.chance(0.5)), int(d.chance(0.5))
        elif what == 5:
            pc._tick()
        elif what == 6:
            pc.words["eflags"] = d.of(0x2, 0x202, 0x302)
        elif what == 7:
            pc._serve_line()
        elif what == 8:
            n = d.of(0x08, 0x1C, 0x0D, 0x60)
            pc.write(0, 4 * n, struct.pack("<HH", d.of(0x100 + n, 0x1234), d.of(0xF000, 0x2000)))
        else:
            number = d.of(0x60, 0x21, 0, 6, 13, 3)
            pc.dos = SimpleNamespace(serve=lambda n: said.append(["dos", n]))
            pc._interrupt(None, number, None)
            if pc._call is not None:
                pc.stopped()
        pc.words["sp"], pc.now = pc.words["sp"] & 0xFFF | 0x800, pc.now + d.between(0, 4000)
        pc.record.cycles = pc.now * 4
        said.append(
            [{k: int(v) for k, v in vars(pc.record).items()}, pc._masked, pc._in_service, pc._ticks_at, pc.fault]
        )
        said.append([pc.words[n] for n in ("cs", "ip", "sp", "eflags")])
        pc.fault = ""
    return {
        "said": [digits(repr(said[k : k + 70])) for k in range(0, len(said), 70)],
        "asked": digits(repr(pc.asked)),
        "stack": digits(bytes(pc.memory[0x9000:0xA000])),
        "place": Pc.place(pc),
        "at": pc.where_to_go_on(),
        "bios": digits(bytes(pc.memory[:1024] + pc.memory[0xF0000:0xF0400])),
    }


def loaded(folder):
    """A .COM, and .EXE files of all sizes of the last page: what is where, and what is refused."""
    found = {}
    for name, content in (
        ("a.com", b"\x90" * 5),
        ("b.com", b""),
        ("c.com", b"\x90" * 0xFE01),
        ("d.com", b"\x90" * 0xFE00),
        ("e.asm", b"\x90"),
        ("f.exe", b"MZ" + b"\0" * 9),
        ("g.exe", exe(700, 700 % 512, [(2, 0), (4, 1)])),
        ("h.exe", exe(1024, 0, [])),
        ("i.exe", exe(1024, 0, [(0xFFFF, 0)])),
        ("j.exe", exe(1024, 1, [], cut=1)),
        ("k.exe", exe(512, 0, [(1, 1)], cut=30)),
        ("l.com", b"\x7fELF" + bytes([1, 1]) + b"\0" * 12 + b"\x28\0" + b"\0" * 9),
        ("m.EXE", exe(600, 600 % 512, [(0, 2)], magic=b"ZM")),
    ):
        Path(name).write_bytes(content)
        pc = Bare(Draw(name), 5)
        pc.memory[0x10000:] = b"\0" * len(pc.memory[0x10000:])
        said = tried(pc._load, Path(name))
        found[name] = [said, pc.words, digits(bytes(pc.memory[0x10000:0x30000]))] if said is None else said
    found["none"] = tried(pc._load, Path("none.com"))
    return found


def exe(size, last, relocations, cut=0, magic=b"MZ"):
    """An .EXE of so many bytes in all, with a head of 64 bytes."""
    pages = -(-size // 512)
    head = struct.pack("<13H", last, pages, len(relocations), 4, 0, 0xFFFF, 0x12, 0x345, 0, 7, 3, 0x1C, 0)
    table = b"".join(struct.pack("<HH", *r) for r in relocations)
    whole = (magic + head).ljust(0x1C, b"\0")[:0x1C] + table
    return (whole.ljust(64, b"\0") + bytes(k & 0xFF for k in range(size - 64)))[: size - cut]


# --- files ---

ARM, AVR = elf.ARM, elf.AVR


def made_elf(number, kind=2, flags=0, symbols=(), sections=(), segments=((0x100, b"\1\2\3\4"),)):
    """A little ELF file of 32 bits."""
    names = b"\0" + b"\0".join(n.encode() for n, *_ in symbols) + b"\0"
    at, content, rows = 52 + 32 * len(segments), b"", []
    heads = b""
    for address, data in segments:
        heads += struct.pack("<8I", 1, at + len(content), address, address + 0x1000, len(data), len(data), 5, 4)
        content += data
    strings, place = b"\0", 1
    rows.append((0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    table, offset = b"", 1
    for name, value, info, section in symbols:
        table += struct.pack("<IIIBBH", offset, value, 4, info, 0, section)
        offset += len(name) + 1
    some = [(".symtab", 2, 0, 0, table, 2), (".strtab", 3, 0, 0, names, 0)]
    some += [(name, kind_, f, a, data, 0) for name, kind_, f, a, data in sections]
    for name, kind_, f, a, data, link in some:
        rows.append((place, kind_, f, a, at + len(content), len(data), link, 0, 1, 0))
        strings += name.encode() + b"\0"
        place += len(name) + 1
        content += data
    rows.append((place, 3, 0, 0, at + len(content), len(strings) + 10, 0, 0, 1, 0))
    content += strings + b".shstrtab\0"
    tables = b"".join(struct.pack("<10I", *row) for row in rows)
    head = struct.pack(
        "<16sHHIIIIIHHHHHH",
        b"\x7fELF\1\1\1".ljust(16, b"\0"),
        kind,
        number,
        1,
        0x99,
        52,
        at + len(content),
        flags,
        52,
        32,
        len(segments),
        40,
        len(rows),
        len(rows) - 1,
    )
    return head + heads + content + tables


SYMBOLS = (
    ("main", 0x101, 2, 1),
    ("loop", 0x120, 18, 1),
    ("$t", 0x100, 0, 1),
    ("data", 0x200, 1, 2),
    ("label", 0x131, 0, 1),
    ("other", 0x140, 2, 0),
    ("absolute", 0x150, 2, 0xFFF1),
    ("last", 0x160, 2, 0xFEFF),
)
SECTIONS = (
    (".text", 1, 6, 0x100, b"abcd"),
    (".data", 1, 3, 0x20000000, b"xy"),
    (".bss", 8, 3, 0x30000000, b"zz"),
    (".note", 7, 2, 0, b"n"),
)


def elves(folder):
    """What is in ELF files; those that are cut off anywhere; kinds and machines that are none."""
    found = {}
    for number in (ARM, AVR):
        whole = made_elf(
            number,
            flags=0x85,
            symbols=SYMBOLS,
            sections=SECTIONS,
            segments=((0x100, b"abcd"), (0x20000000, b"xy"), (5, b"")),
        )
        Path("a.elf").write_bytes(whole)
        e = elf.Elf(Path("a.elf"), number, "mcu", "gcc")
        found[f"{number}"] = [
            e.symbols,
            e._functions,
            e._starts,
            [[s.at, s.used_at, s.content.decode()] for s in e.segments],
            e.flags,
            e.entry,
            [e.section(n).decode() for n in (".text", ".data", ".bss", ".note", ".none", ".tex")],
            [
                e.writable(*at)
                for at in (
                    (0x100, 4),
                    (0x20000000, 1),
                    (0x1FFFFFFF, 1),
                    (0x1FFFFFFF, 2),
                    (0x30000000, 1),
                    (0x20000001, 9),
                )
            ],
        ]
        said = []
        for end in (*range(0, 100, 7), *range(100, len(whole), 23)):
            Path("c.elf").write_bytes(whole[:end])
            cut = tried(elf.Elf, Path("c.elf"), number, "mcu", "gcc")
            said.append(cut if isinstance(cut, str) else [len(cut.symbols), len(cut.segments)])
        found[f"{number} cut"] = said
    for kind in range(6):
        Path("k.elf").write_bytes(made_elf(ARM, kind))
        found[f"kind {kind}"] = (
            str(type(tried(elf.Elf, Path("k.elf"), ARM, "m3", "gcc")))
            if kind == 2
            else tried(elf.Elf, Path("k.elf"), ARM, "m3", "gcc")
        )
    for number in (2, 3, 4, 8, 20, 40, 42, 62, 83, 94, 105, 183, 243, 999):
        Path("m.elf").write_bytes(made_elf(number))
        found[f"machine {number}"] = [
            elf.machine_of(Path("m.elf")),
            str(tried(elf.Elf, Path("m.elf"), AVR, "atmega8", "gcc")).split(" object")[0],
        ]
    big = bytearray(made_elf(ARM))
    big[5], big[18:20] = 2, b"\0\x28"
    Path("b.elf").write_bytes(big)
    found["big-endian"] = elf.machine_of(Path("b.elf"))
    found["none"] = tried(elf.machine_of, Path("none.elf"))
    return {k: v for k, v in found.items() if not k.startswith("kind 2")}


class File:
    """An ELF file in name only."""

    path = "p.elf"

    def __init__(self, flags=0, segments=(), **sections):
        self.flags, self.segments, self.sections = flags, list(segments), sections

    def section(self, name):
        return self.sections.get(name[1:].replace(".", "_"), b"")


def device_info(name):
    names = b"\0one\0" + name + b"\0"
    record = struct.pack("<8I", 1, 2, 3, 4, 5, 6, 8, 5) + names
    return struct.pack("<III", 4, len(record), 1) + b"AVR\0" + record


def attributes(*pairs):
    body = b"".join(bytes(p) for p in pairs)
    sub = b"\1" + struct.pack("<I", 5 + len(body)) + body
    return b"A" + struct.pack("<I", 4 + 6 + len(sub)) + b"aeabi\0" + sub


def built():
    """Programs of each architecture for each processor; names that are written in them; attributes of Arm, damaged ones too."""
    found = {}
    names = (
        "atmega2560",
        "atmega328p",
        "atmega328",
        "atmega8",
        "atmega8l",
        "attiny85",
        "at90usb162",
        "atmega128",
        "atmega48pa",
        "atmega1284p",
    )
    for mcu in names:
        said = [tried(built_for.check_avr, File(0x80 | arch), mcu, "gcc") for arch in (0, 2, 3, 4, 5, 6, 25, 35, 51)]
        said += [
            tried(
                built_for.check_avr,
                File(built_for.avr_architecture(mcu), mmcu=b"\1" + bytes([len(n)]) + n + b"\0\0"),
                mcu,
                "gcc",
            )
            for n in (b"atmega328p\0", b"ATMEGA8", b"atmega48p", b"strange", b"")
        ]
        found[mcu] = [built_for.avr_architecture(mcu), *said]
    for name in (b"ATmega328P", b"", b"attiny85"):
        note = device_info(name)
        found[f"note {name}"] = [
            built_for.avr_name(File(note_gnu_avr_deviceinfo=note[:end]))
            for end in (len(note), len(note) - 3, 50, 15, 8)
        ]
    tags = b"\x02\x04\x40\x42\x0f\x00\x01\x03at8\x02\x01\x09\x00\x07\x01x"
    found["tags"] = {k: v.hex() for k, v in built_for.said_to_simavr(File(mmcu=tags)).items()}
    kept = [elf.Segment(at, at, tags) for at in (0x90FFFF, 0x910000, 0x920000)]
    found["kept"] = [len(built_for.said_to_simavr(File(segments=[s]))) for s in kept]
    for mcu in ("cortex-m0", "cortex-m3", "cortex-m4"):
        found[mcu] = [
            tried(
                built_for.check_arm,
                File(ARM_attributes=attributes((6, arch), (7, ord(profile)), (10, floats), (28, given))),
                mcu,
                "gcc {mcu}",
            )
            for arch in (9, 10, 11, 12, 13, 16, 17, 21)
            for profile in "MAR"
            for floats, given in ((0, 0), (3, 0), (0, 1))
            if profile == "M" or not floats + given
        ]
    whole = attributes(
        (6, 13), (5, *b"name", 0), (32, 1, *b"gnu", 0), (67, *b"2.09", 0), (34, 0x81, 1), (65, 0x41, 0), (10, 4)
    )
    found["attributes"] = [
        built_for.arm_attributes(File(ARM_attributes=whole[:end])) for end in range(0, len(whole) + 1, 3)
    ]
    found["others"] = [
        built_for.arm_attributes(File(ARM_attributes=w)) for w in (b"B" + whole[1:], whole.replace(b"aeabi", b"other"))
    ]
    d, code = Draw("avr"), bytes(Draw("code").between(0, 255) for _ in range(1))
    jumps = [
        bytes(
            [d.between(0, 255), d.of(0x94, 0x95, 0xC0, 0xCF, d.between(0, 255)), d.between(0, 255), d.between(0, 255)]
        )
        for _ in range(120)
    ]
    code = b"".join(bytes([j[0] & 0xF1 | 0x0C, *j[1:]]) if j[1] in (0x94, 0x95) else j for j in jumps)
    found["jumps"] = [avr_vectors._target(code, at, flash) for at in range(0, len(code), 2) for flash in (8192,)]
    found["jumps of more"] = [avr_vectors._target(code, at, 0x40000) for at in range(0, len(code), 14)]
    return found


MAPS = (
    "data=A,address=C:0-1,cs=B0,wr=G0,rd=G1,irq=D0",
    "data=a, address=C0+D:2-4+E7 ,wr=g0,rd=g1,base=0x340",
    "data=A,wr=G0,rd=G1",
    "data=A,wr=G0",
    "data=A,wr=G0,rd=G0",
    "data=A,wr=A7,rd=G1",
    "data=AB,wr=G0,rd=G1",
    "data=I,wr=G0,rd=G1",
    "data=A,wr=G8,rd=G1",
    "data=A,wr=G0,rd=G1,address=C:3-1",
    "data=A,wr=G0,rd=G1,address=C:1",
    "data=A,wr=G0,rd=G1,base=x",
    "data=A,data=B",
    "datum=A",
    "data",
    "",
    "data=L,wr=K0,rd=J7,cs=L0",
    "data=A,wr=G0,rd=G1,base=-1",
)


def maps():
    """Pins, windows and interrupts, as they are given."""
    found = {text: tried(pins.pins, text) for text in MAPS}
    found["two"] = [tried(pins.pins, MAPS[:2]), tried(pins.pins, []), tried(pins.pins, MAPS[:1])]
    window = "0x40021000=0x300+0x40"
    for given in (
        [window],
        [window, "irq=6"],
        ["irq=239", window],
        ["irq=240", window],
        ["irq=6", "irq=7", window],
        ["irq=6"],
        [],
        ["irq = x", window],
        [window, "0x40021010=0x400+1"],
    ):
        found[f"cortex {given}"] = tried(host._windows_and_irq, given)
    for given in ([], ["irq=5"], ["irq=2"], [" irq = 7 "], ["irq=1"], ["irq=8"], ["irq=5", "irq=5"], ["x"]):
        found[f"pc {given}"] = tried(host._irq, given)
    return found


# --- the bus, compiled ---


class Emulated:
    """The functions that an emulator has, as much of them as the compiled parts call."""

    def __init__(self, chips=PCL240K):
        self.stage = make("xy", chips, bus_cycle=2e-6)
        self.board, self.said, self.kept = Board(self.stage), [], []
        self.cycles = self.flags = 0

    def function(self, call, result, *kinds):
        self.kept.append(ctypes.CFUNCTYPE(result, *kinds)(call))
        return ctypes.cast(self.kept[-1], ctypes.c_void_p).value

    def record(self, dtype, hz, **values):
        row = np.zeros(1, dtype)
        self.kept.append(row)
        row["own"], row["host"], row["request"], row["hz"] = (
            row.ctypes.data,
            self.board.link.pointer,
            bus.request.address,
            hz,
        )
        for name, value in values.items():
            row[name] = value
        return row


I8 = ctypes.c_int64


def unicorn_side():
    """Instructions, ports and windows of a processor: time, waits, looks at the line, what lies outside."""
    e, d = Emulated(), Draw("machine")
    device = e.board.device(0x380)
    windows = np.array([(0x40000000, 0x300, 8), (0x40000100, 0x304, 3)], machine.WINDOW)

    def reg_read(uc, flags, at):
        ctypes.c_int64.from_address(at).value = e.flags
        return 0

    flags = np.zeros(1, np.int64)
    row = e.record(
        machine.MACHINE,
        1_000_003,
        each=3,
        byte=2,
        quantum=40,
        alarm=5000,
        flags=9,
        mask=3,
        on=2,
        flags_at=flags.ctypes.data,
        uc=77,
        stop=e.function(lambda uc: e.said.append("stops") or 0, ctypes.c_int32, I8),
        reg_read=e.function(reg_read, ctypes.c_int32, I8, ctypes.c_int32, I8),
        windows=windows.ctypes.data,
        n_windows=2,
        watched=1,
        line=1,
        rare_ports=0x60,
        begin=1000,
        rare=e.function(
            lambda own, port, size, value: e.said.append(["rare", port, size, value]) or 5, I8, I8, I8, I8, I8
        ),
    )
    page, own = np.zeros(1, machine.PAGE), row.ctypes.data
    page["machine"], page["address"] = own, 0x40000000
    at, link = page.ctypes.data, e.board.link
    link.begin()
    go(e.stage.axes["x"], 300)
    for _ in range(260):
        what = d.between(0, 10)
        if what < 4:
            machine.instruction.c(0, 0, d.between(1, 6), own)
        elif what == 4:
            e.said.append(int(machine.port_in.c(0, d.of(0x300, 0x301, 0x5F, 0x60, 0x304), d.of(1, 2, 4), own)))
        elif what == 5:
            machine.port_out.c(0, d.of(0x301, 0x302, 0x5F, 0x400), d.of(1, 2, 4), d.of(-1, 0x12345678, 0x8001), own)
        elif what < 8:
            e.said.append(
                int(machine.window_read.c(0, d.of(0, 1, 4, 7, 0x100, 0x102, 0x103, 0x200), d.of(1, 2, 4), at))
            )
        elif what == 8:
            machine.window_written.c(0, d.of(1, 4, 6, 0x101, 0x102, 0x8), d.of(1, 2, 4), d.of(0xA5, -2, 0x1234), at)
        elif what == 9:
            e.flags, row["edge"] = d.of(2, 3, 6), d.between(0, 1)
            row["wanted"] = int(d.chance(0.2))
            row["alarm"] = int(row["cycles"][0]) + d.between(0, 500)
            device.pull(d.chance(0.5))
        else:
            e.said.append(["look", int(machine.looked.c(own))])
        shown = {n: int(row[n][0]) for n in ("cycles", "due", "raised", "before", "waits", "outside")}
        e.said.append([shown, int(link.record["cycles"]), e.stage.now + int(link.record["ahead"])])
        row["outside"] = 0
    e.flags, row["wanted"], row["alarm"] = 2, 0, int(row["cycles"][0]) + 777
    machine.wait.c(own)
    link.end()
    e.said.append([int(row[n][0]) for n in ("cycles", "due", "waits")])
    return {"said": list(map(repr, e.said)), "trace": e.board.trace.text(), "ns": e.stage.now}


def simavr_side():
    """Pins of an AVR that change in random order: cycles, addresses, who drives the data; ticks, sleep, its end, serial lines."""
    e, d = Emulated(), Draw("avr side")
    device = e.board.device(0x380)
    pin = np.array([(1, 0), (6, 0), (6, 1), (2, 0), (2, 1), (3, 7)], avr.PIN)
    levels, outputs, irqs = np.zeros(11, "i8"), np.zeros(11, "i8"), np.arange(100, 108)
    state, pc, vectors = np.zeros(1, "u4"), np.zeros(1, "u4"), np.array([11, 12], "i8")
    fight = ctypes.create_string_buffer(b"both drive")
    size, c32 = avr.PIN.itemsize, ctypes.c_int32
    enabled, ended = [0], [7]
    row = e.record(
        avr.AVR,
        16_000_000,
        avr=5,
        watched=1,
        quantum=320,
        stop=0x80,
        line_irq=99,
        data_port=0,
        n_addresses=3,
        first=0x300,
        was_write=1,
        run=e.function(lambda a: ended.pop() if ended else 0, c32, I8),
        status=e.function(lambda a, t, o: 100 - e.cycles, I8, I8, I8, I8),
        raise_irq=e.function(lambda irq, value: e.said.append(f"irq {irq} {value}"), None, I8, c32),
        look=e.function(lambda a, r: {24: 0x134, 25: 0x1FE}[r], c32, I8, c32),
        pc=pc.ctypes.data,
        when=320,
        levels=levels.ctypes.data,
        outputs=outputs.ctypes.data,
        data_irqs=irqs.ctypes.data,
        fight=ctypes.addressof(fight),
        timer=3,
        is_enabled=e.function(lambda a, v: enabled[0] if v == 12 else 0, c32, I8, I8),
        vectors=vectors.ctypes.data,
        n_vectors=2,
        state=state.ctypes.data,
        **{n: pin.ctypes.data + k * size for k, n in enumerate(("select", "write", "read", "addresses"))},
    )
    own, link = row.ctypes.data, e.board.link
    text = ctypes.create_string_buffer(16)
    serial = np.array([(own, ctypes.addressof(text), 16, 0)], avr.SERIAL)
    ports = np.array([(own, k) for k in range(11)], avr.PORT)
    link.begin()
    for k in range(500):
        port = d.of(0, 1, 1, 2, 3, 6, 6, 6)
        e.cycles = d.between(0, 100)
        what = d.between(0, 19)
        if what < 13:
            avr.levels_changed.c(
                0, d.of(0, 1, 2, 3, 0xFF, d.between(0, 255)), ports.ctypes.data + port * ports.itemsize
            )
        elif what < 15:
            value = d.of(0xFF, 0xFF, 0) if port else d.of(0, 0, 0x80)
            avr.outputs_changed.c(0, value, ports.ctypes.data + port * ports.itemsize)
        elif what < 17:
            avr.sent.c(0, d.of(10, 13, *b"text of a line"), serial.ctypes.data)
        elif what == 17:
            device.pull(d.chance(0.5))
            state[0], enabled[0] = d.of(2, 3), d.between(0, 1)
        elif what == 18:
            e.said.append(int(avr.tick.c(0, int(row["when"][0]), own)))
            pc[0] = 0x80 if k > 480 else 0x82
            if k < 480:
                row["ended"] = 0
        shown = [
            int(row[n][0])
            for n in ("was_selected", "was_write", "reading", "fights", "waits", "line", "ended", "code", "asleep")
        ]
        e.said.append([shown, int(link.record["cycles"]), e.stage.now + int(link.record["ahead"])])
    row["ended"] = 0
    e.said.append([int(avr.run.c(own)), ended])
    row["n_vectors"], row["asleep"], state[0] = 0, 0, 3
    e.said.append([int(avr.tick.c(0, int(row["when"][0]), own)), int(row["asleep"][0])])
    link.end()
    return {"said": list(map(repr, e.said)), "trace": e.board.trace.text(), "log": e.board.log, "ns": e.stage.now}


# --- a debugger ---


class Engine:
    """256 bytes of memory, a window in their middle."""

    error = KeyError

    def __init__(self):
        self.done, self.memory = [], bytearray(range(256))
        self.uc = SimpleNamespace(
            mem_read=lambda at, size: self.memory[at : at + size],
            emu_stop=lambda: self.done.append("stop"),
            mem_write=lambda at, content: self.memory.__setitem__(slice(at, at + len(content)), content),
            hook_del=lambda hook: self.done.append(f"del {hook:X}"),
        )

    def in_window(self, at, size):
        return at < 0x90 and at + size > 0x80

    def watch(self, at, function):
        self.done.append(f"watch {at:X}")
        return at + 1

    def not_run(self, size):
        self.done.append(f"not run {size}")

    def address(self):
        return 0x44

    def end(self, code):
        self.done.append(f"end {code}")


class Registers:
    """Of a Cortex-M or a PC: names and numbers."""

    def __init__(self):
        self.values, self.at = {}, 0x1234

    def get(self, name):
        return self.values.get(name, sum(name.encode()) * 0x1010101)

    def set(self, **values):
        self.values |= values

    def address(self):
        return self.at

    def go_to(self, at):
        self.at = at


PACKETS = (
    "qSupported:x",
    "QStartNoAckMode",
    "qXfer:features:read:target.xml:0,40",
    "qXfer:features:read:target.xml:10,ffff",
    "?",
    "vCont?",
    "g",
    "p0",
    "pf",
    "p10",
    "p11",
    "p1f",
    "p20",
    "P0=78563412",
    "Pf=00100000",
    "P10=01000000",
    "g",
    "m10,8",
    "m7f,1",
    "m7f,2",
    "m90,1",
    "m8f,1",
    "mzz",
    "m0,100",
    "M10,2:aabb",
    "M8f,1:00",
    "m10,4",
    "Z0,44,2",
    "Z1,50,2",
    "Z0,44,2",
    "Z2,44,2",
    "z0,44,2",
    "z3,50,2",
    "z0,99,2",
    "Z0,60,4",
    "vCont;s:1",
    "?",
    "c",
    "s",
    "vCont;c",
    "Hc0",
    "T1",
    "qC",
    "qfThreadInfo",
    "qsThreadInfo",
    "qAttached",
    "x",
    "X1,1:a",
    "G" + "01000000" * 17,
    "g",
    "D",
    "k",
)


def debugger(kind):
    """Packets one after the other, and what is done for each."""

    class Wire:
        sent = b""

        def sendall(self, content):
            self.sent += content

        def close(self):
            self.sent += b"closed"

    engine, seen, found = Engine(), Registers(), {}
    server = gdb.Server(engine, kind(seen), 0)
    for k, text in enumerate(PACKETS):
        if server._socket is None:
            server._socket = Wire()
        server._socket.sent = b""
        wire = server._socket
        answer = server._answer(text)
        if text in ("c", "vCont;c", "s"):
            server._reached(None, 0x50, 2, None)
            server._over = 0x60
            server._reached(None, 0x60, 2, None)
            server._reached(None, 0x60, 2, None)
            if text == "s":
                engine.done.append(str(server.after()))
            server._told = False
            server.halted = server.halted and text != "vCont;c"
        done, engine.done[:] = list(engine.done), []
        short = answer if answer is None or len(answer) < 80 else f"{len(answer)} {digits(answer, 3)}"
        sent = wire.sent.decode()
        found[f"{k} {text[:40]}"] = [
            short,
            sent,
            done,
            server.halted,
            server.steps,
            server._signal,
            sorted(server._breakpoints),
        ]
    server._socket = Wire()
    server._got = b"+-\x03$m10,1#00$g"
    found["packets"] = [server._packet(), server._packet(), server._got.decode()]
    server.ended(0x1FE)
    found["ended"] = [server.halted, seen.at, seen.values]
    return found


FILES = {
    "targets_x86": {**{f"x86 {part}": partial(x86, part) for part in range(4)}, "in a row": x86_in_a_row},
    "targets": {
        "nvic": nvic,
        "semihosting": semihosting,
        "counters": counters,
        "dos": dos,
        **{f"controller {irq}": partial(controller, irq) for irq in (5, None, 2)},
        "loaded": loaded,
        "elves": elves,
        "built": built,
        "maps": maps,
        "unicorn": unicorn_side,
        "simavr": simavr_side,
        **{f"debugger {k.__name__}": partial(debugger, k) for k in (CortexRegisters, PcRegisters)},
    },
}
