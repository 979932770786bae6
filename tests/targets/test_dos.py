"""Each service of DOS and BIOS gives the registers that a program expects, of registers as they may be."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import pytest

from stage.targets.dos_and_bios_services import Dos
from stage.targets.pc_timer import CLOCK_HZ, MAX_RELOAD

CARRY, ZERO = 1, 0x40


class PC:
    """A stand-in of a PC with registers and memory that records the calls of the emulated DOS."""

    prefix = 0x1000

    def __init__(self, **registers: int):
        self.words = {**dict.fromkeys(("ax", "bx", "cx", "dx", "ds", "es"), 0), "eflags": 2}
        self.set_registers(**registers)
        self.memory = bytearray(1 << 20)
        self.printed, self.exit_code, self.fault, self.watched = "", None, "", 0
        self.record = SimpleNamespace(cycles=0, hz=4_772_727, due=None)
        self.stopped = False

    def get_register(self, name):
        if name[1] in "hl":
            return self.words[name[0] + "x"] >> (8 if name[1] == "h" else 0) & 0xFF
        return self.words[name]

    def set_registers(self, **values):
        for name, value in values.items():
            assert 0 <= value < (1 << (8 if name[1] in "hl" else 32 if name == "eflags" else 16)), (name, value)
            if name[1] in "hl":
                shift = 8 if name[1] == "h" else 0
                word = self.words[name[0] + "x"]
                self.words[name[0] + "x"] = word & ~(0xFF << shift) | value << shift
            else:
                self.words[name] = value

    def read(self, segment, offset, size):
        at = (segment << 4) + offset
        return bytes(self.memory[at : at + size])

    def write(self, segment, offset, content):
        at = (segment << 4) + offset
        self.memory[at : at + len(content)] = content

    def fail(self, fault):
        self.fault, self.stopped = fault, True

    def read_vector(self, n):
        return struct.unpack("<HH", self.read(0, 4 * n, 4))

    def schedule_timer_interrupt(self):
        self.watched += 1

    def log_text(self, text):
        self.printed += text

    def end(self, code):
        self.exit_code = code

    def serve(self, number, **registers):
        self.set_registers(**registers)
        before = dict(self.words)
        Dos(self).execute_interrupt(number)
        return {name: value for name, value in self.words.items() if value != before[name]}


def test_programs_end_with_their_code():
    """INT 20h; INT 21h with AH = 0, 31h, 4Ch"""
    for number, ah, code in ((0x20, 0x4C, 0), (0x21, 0, 0), (0x21, 0x31, 7), (0x21, 0x4C, 7)):
        pc = PC(ax=ah << 8 | 7)
        assert (pc.serve(number), pc.exit_code) == ({}, code)


def test_text_is_printed_by_character_up_to_a_dollar_sign_and_by_length():
    """AH = 2, 6 and 9, 40h to handles 1, 2 and 3; INT 10h with AH = 0Eh"""
    pc = PC()
    pc.write(0x2000, 0x123, b"caf\x82$never")
    for number, registers in ((0x21, {"ax": 0x0200, "dx": 0xFF41}), (0x21, {"ax": 0x0200, "dx": 0x12FF}),
                              (0x21, {"ax": 0x06FF, "dx": 0x3142}), (0x10, {"ax": 0x0E43}),
                              (0x21, {"ax": 0x0900, "dx": 0x123, "ds": 0x2000})):  # fmt: skip
        assert pc.serve(number, **registers) is not None
    assert pc.printed == "A\xffBCcafé"
    pc.serve(0x10, ax=0x0243)
    assert pc.printed == "A\xffBCcafé", "the cursor is moved, and nothing said"
    for handle in (1, 2):
        assert pc.serve(0x21, ax=0x4000, bx=handle, cx=5, dx=0x123, eflags=2 | CARRY) == {"ax": 5, "eflags": 2}
    assert pc.printed.endswith("café$café$")
    assert pc.serve(0x21, ax=0x4000, bx=3, eflags=2) == {"ax": 6, "eflags": 2 | CARRY}, "no such handle"
    assert pc.printed.endswith("café$café$")


def test_the_keyboard_has_no_input():
    """AH = 6 with DL = FFh, 0Bh; INT 16h"""
    assert PC(ax=0x0655, dx=0x12FF).serve(0x21) == {"ax": 0x0600, "eflags": 2 | ZERO}
    assert PC(ax=0x0B55).serve(0x21) == {"ax": 0x0B00}
    for ah in (1, 0x11):
        assert PC(ax=ah << 8 | 5).serve(0x16) == {"eflags": 2 | ZERO}
    assert PC(ax=0x0255).serve(0x16) == {"ax": 0x0200}, "no shift key is down"
    for number, ah in ((0x16, 0), (0x16, 0x10), *((0x21, ah) for ah in (1, 7, 8, 0x0A, 0x3F))):
        pc = PC(ax=ah << 8)
        assert (pc.serve(number), pc.stopped) == ({}, True)
        assert pc.fault.startswith("it waits for a key"), ah


def test_vectors_are_set_and_read_back():
    pc = PC(ax=0x251C, dx=0x1234, ds=0x5678)
    assert (pc.serve(0x21), pc.read_vector(0x1C), pc.watched) == ({}, (0x1234, 0x5678), 1)
    assert pc.serve(0x21, ax=0x351C) == {"bx": 0x1234, "es": 0x5678}


def test_time_follows_the_cycles_of_the_processor():
    """25 h, 1 min, 2.03 s after the start; INT 1Ah, a delay of 65,537 us"""
    pc = PC(ax=0x2C00)
    seconds = 25 * 3600 + 62.034
    pc.record.cycles = round(seconds * pc.record.hz)
    pc.serve(0x21)
    assert [pc.get_register(name) for name in ("ch", "cl", "dh", "dl")] == [1, 1, 2, 3]
    assert pc.serve(0x21, ax=0x2A00) == {"ax": 0x2A06, "cx": 1995, "dx": 0x0701}
    pc.serve(0x1A, ax=0x0055)
    ticks = int(seconds * CLOCK_HZ / MAX_RELOAD)
    assert [pc.get_register(name) for name in ("cx", "dx", "al")] == [ticks >> 16, ticks & 0xFFFF, 0]
    assert ticks >> 16 == 25 * 3600 * CLOCK_HZ // MAX_RELOAD >> 16 > 0
    assert pc.serve(0x1A, ax=0x0155) == {}, "the clock is not set"
    for cx, dx in ((0, 3), (2, 0), (1, 0xFFFF)):
        before = pc.record.cycles
        pc.serve(0x15, ax=0x8600, cx=cx, dx=dx)
        assert pc.record.cycles - before == (cx * 65536 + dx) * pc.record.hz // 1_000_000 == pc.record.due - before
    before = pc.record.cycles
    assert pc.serve(0x15, ax=0x8600, cx=1, dx=1, eflags=2 | CARRY) == {"eflags": 2}
    assert pc.record.cycles - before == 65537 * pc.record.hz // 1_000_000
    assert (pc.record.due, pc.get_register("eflags")) == (pc.record.cycles, 2)
    before = pc.record.cycles
    pc.serve(0x15, ax=0x8700)
    assert pc.record.cycles == before


@pytest.mark.parametrize(
    ("number", "ax", "bx", "changes"),
    [
        (0x11, 0x1111, 0, {"ax": 0x20}), (0x12, 0x1111, 0, {"ax": 640}), (0x13, 0x1111, 0, {}),
        (0x21, 0x30FF, 9, {"ax": 5, "bx": 0, "cx": 0}), (0x21, 0x4400, 2, {"dx": 0x80D3, "eflags": 2}),
        (0x21, 0x4400, 3, {"dx": 0, "eflags": 2}), (0x21, 0x4800, 9, {"ax": 8, "bx": 0}),
        *((0x21, ah << 8, 9, {"eflags": 2}) for ah in (0x49, 0x4A, 0x3E, 0x33, 0x0E, 0x1A)),
        *((0x21, ah << 8, 9, {"bx": 0x1000}) for ah in (0x51, 0x62)),
        *((0x21, ah << 8 | 3, 9, {"ax": 2}) for ah in (0x3C, 0x3D, 0x43, 0x4E)),
    ],
)  # fmt: skip
def test_supported_options_work_and_others_are_refused(number, ax, bx, changes):
    """with carry set before: equipment, memory, version, device information, files that there are not"""
    assert PC(ax=ax, bx=bx, cx=9, dx=9, eflags=2 | CARRY).serve(number) == changes


def test_refusals_set_carry_and_an_unknown_function_ends_the_program():
    assert PC(ax=0x3D00).serve(0x21) == {"ax": 2, "eflags": 2 | CARRY}
    pc = PC(ax=0x5F00)
    assert (pc.serve(0x21), pc.stopped, "function 5Fh" in pc.fault) == ({}, True, True)
