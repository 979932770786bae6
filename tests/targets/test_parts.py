"""Parts of emulated processors by themselves, without an emulator: interrupts, timers, semihosting, ELF files, a PC's ports."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stage.board import LibraryError
from stage.errors import ArgumentError
from stage.targets import avr_clock_and_pins, avr_serial, supported_processors
from stage.targets.avr_bus_wiring import parse_bus_pins
from stage.targets.avr_clock_and_pins import PORT_LETTERS
from stage.targets.cortex_m import APPLICATION_EXIT, Semihosting
from stage.targets.elf import ARM, AVR, Elf, read_machine_name
from stage.targets.nvic import FIRST, NEVER, PENDSV, SVC, SYSTICK, Nvic
from stage.targets.pc_8086 import Pc
from stage.targets.pc_timer import MAX_RELOAD, PcTimer, TimerChannel
from stage.targets.unicorn_processor import UnicornProcessor

DATA = Path(__file__).parent / "data"

# --- Cortex-M: interrupts ---


def test_enable_pending_and_active_bits_of_every_word():
    """IRQ 0, 31, 32 and 239; each is cleared alone"""
    n = Nvic(lambda: 0, None)
    for at, bits in ((0xE100, 0x80000001), (0xE104, 1), (0xE100 + 28, 1 << 15)):
        n.write(at, bits, 4, 0)
        n.write(at + 0x100, bits, 4, 0)  # pending, too
    words = (0xE100, 0xE104, 0xE108, 0xE100 + 28)
    for more in (0, 0x80, 0x100, 0x180):
        assert [n.read(at + more) for at in words] == [0x80000001, 1, 0, 1 << 15], hex(more)
    for irq in (0, 31, 32, 239):
        assert n.find_next_exception(0, 0) == FIRST + irq
        n.enter_exception(FIRST + irq)
        assert [n.read(at + 0x200) for at in words] == [
            sum(1 << irq - 32 * k for k in range(8) if 32 * k <= irq < 32 * k + 32 and at == 0xE100 + 4 * k)
            for at in words
        ], irq
        n.leave_exception(FIRST + irq)
    n.write(0xE180, 1, 4, 0)
    assert [n.read(at) for at in words] == [0x80000000, 1, 0, 1 << 15]
    n.write(0xE200, 0x80000003, 4, 0)
    n.write(0xE280, 2, 4, 0)
    assert n.read(0xE200) == 0x80000001
    assert n.find_next_exception(0, 0) == FIRST + 31, "IRQ 0 is pending and not enabled"
    assert n.read(0xE320) == 0, "behind the active bits"


def test_priorities_are_bytes_of_their_words():
    n = Nvic(lambda: 0, None)
    n.write(0xE400, 0x44332211, 4, 0)
    n.write(0xE404, 0x9900, 1, 1)
    n.write(0xE400 + 236, 0x77000000, 1, 3)  # IRQ 239
    n.write(0xED1C, 0xAA000000, 1, 3)  # SVC
    n.write(0xED20, 0xC0B00000, 2, 2)  # PendSV, SysTick
    assert [n.read(at) for at in (0xE400, 0xE404, 0xE400 + 236, 0xED18, 0xED1C, 0xED20, 0xED24)] == [
        0x44332211, 0x9900, 0x77000000, 0, 0xAA000000, 0xC0B00000, 0,
    ]  # fmt: skip
    n.write(0xED24, 0x11, 4, 0)
    n.write(0xE400 + 240, 0x11, 4, 0)
    assert (n.read(0xED24), n.read(0xED20), n.read(0xE4F0), n.read(0xE400 + 236)) == (
        0x11,
        0xC0B00000,
        0x11,
        0x77000000,
    )


@pytest.mark.parametrize(("custom", "running", "comes"), [(0x20, 0x40, True), (0x40, 0x40, False), (0x60, 0x40, False)])
def test_the_boards_line_comes_into_what_is_of_a_lower_priority_alone(custom, running, comes):
    """IRQ 3 is the board's; the routine of IRQ 4 runs"""
    n = Nvic(lambda: 0, 3)
    n.write(0xE100, 0x18, 4, 0)
    n.write(0xE400, custom << 24, 4, 0)
    n.write(0xE404, running, 4, 0)
    n.enter_exception(FIRST + 4)
    n.level = True
    assert n.can_line_interrupt() == comes
    assert n.find_next_exception(0, 0) == (FIRST + 3 if comes else None)


def test_the_remaining_private_registers_hold_their_values():
    now = [(1 << 32) + 7]
    n = Nvic(lambda: now[0], 3)
    assert [n.read(at) for at in (0x1004, 0, 0xED00, 0xED0C, 0xE01C, 0xED10, 0xED08)] == [
        7, 1, 0x412FC231, 0xFA050000, 0, 0, 0,
    ]  # fmt: skip
    assert not n.write(0xED08, 0x200001FF, 4, 0)
    assert (n.vectors, n.read(0xED08)) == (0x20000180, 0x20000180)
    assert [n.write(0xED0C, value, 4, 0) for value in (0x05FA0004, 0x05FA0000, 0x05FA0003)] == [True, False, False]
    n.write(0xED10, 4, 4, 0)
    assert n.read(0xED10) == 4
    assert n.read(0xED04) == 0
    n.write(0xED04, 1 << 28 | 1 << 26, 4, 0)
    assert n.read(0xED04) == 1 << 28 | 1 << 26
    assert n.find_next_exception(0, 0) == PENDSV, "of equal priority the lower number"
    n.write(0xED04, 1 << 27, 4, 0)
    assert (n.read(0xED04), n.find_next_exception(0, 0)) == (1 << 26, SYSTICK)
    n.write(0xED04, 1 << 25, 4, 0)
    assert (n.read(0xED04), n.find_next_exception(0, 0)) == (0, None)


def test_pending_interrupts_are_filtered_by_masks_base_priority_and_running_priority():
    n = Nvic(lambda: 0, 3)
    line = FIRST + 3
    n.level = True
    assert (n.find_next_exception(0, 0), n.can_line_interrupt(), n.has_waiting_exception()) == (None, False, False), (
        "the line is not enabled"
    )
    n.write(0xE100, 1 << 3 | 1 << 4, 4, 0)
    n.write(0xE400, 0x40 << 24, 1, 3)
    assert (n.find_next_exception(0, 0), n.can_line_interrupt(), n.has_waiting_exception()) == (line, True, False)
    assert [n.find_next_exception(*masks) for masks in ((1, 0), (0, 0x40), (0, 0x41), (0, 0x30), (0xFE, 0))] == [
        None, None, line, None, line,
    ]  # fmt: skip
    n.enter_exception(line)
    assert (n.find_next_exception(0, 0), n.can_line_interrupt()) == (None, False), "it runs"
    n.write(0xE404, 0x40, 1, 0)
    n.write(0xE200, 1 << 4, 4, 0)
    assert (n.find_next_exception(0, 0), n.has_waiting_exception()) == (None, False), "of the same priority"
    n.write(0xE404, 0x3F, 1, 0)
    assert (n.find_next_exception(0, 0), n.find_next_exception(1, 0), n.has_waiting_exception()) == (
        FIRST + 4,
        None,
        True,
    )
    n.write(0xE180, 1 << 4, 4, 0)
    assert (n.find_next_exception(0, 0), n.has_waiting_exception()) == (None, False), "pending, not enabled"
    n.write(0xED04, 1 << 28, 4, 0)
    assert (n.find_next_exception(0, 0), n.has_waiting_exception()) == (PENDSV, True)
    n.leave_exception(SVC)
    assert n.get_active_exception() == line, "what does not run does not end"
    n.leave_exception(line)
    assert n.get_active_exception() == 0


def test_an_asserted_line_does_not_interrupt_its_routine():
    n = Nvic(lambda: 0, 3)
    line = FIRST + 3
    n.write(0xE100, 1 << 3, 4, 0), n.write(0xE400, 0x40 << 24, 1, 3)
    n.level = True
    assert n.find_next_exception(0, 0) == line
    n.enter_exception(line)
    n.write(0xE400, 0x20 << 24, 1, 3)
    n._active.append(FIRST + 9)  # of a priority of its own
    n.write(0xE408, 0x80 << 8, 1, 1)
    n.leave_exception(line), n.enter_exception(line), n.write(0xE400, 0x10 << 24, 1, 3)
    assert n.find_next_exception(0, 0) is None
    n.leave_exception(line)
    assert n.find_next_exception(0, 0) == line


def test_systick_with_its_control_its_value_and_its_flag():
    now = [1000]
    n = Nvic(lambda: now[0], None)
    n.write(0xE010, 0xFFFF8, 4, 0)
    assert (n.read(0xE010), n.read(0xE018), n.is_systick_running(), n.find_next_systick_cycle()) == (0, 0, False, NEVER)
    n.write(0xE010, 3, 4, 0)  # it counts, and has nothing to count
    assert (n.is_systick_running(), n.find_next_systick_cycle(), n.read(0xE010)) == (False, NEVER, 3)
    n.pend_systick()
    assert n.find_next_exception(0, 0) is None
    n.write(0xE014, 0xFF000063, 4, 0)
    assert n.read(0xE014) == 99
    n.write(0xE018, 5, 4, 0)
    now[0] += 30
    assert (n.read(0xE018), n.find_next_systick_cycle()) == (69, 1100)
    n.write(0xE010, 3, 4, 0)  # already on: it goes on
    assert n.read(0xE018) == 69
    now[0] += 70
    assert (n.read(0xE018), n.find_next_systick_cycle(), n.read(0xE010), n.read(0xE010)) == (99, 1200, 3 | 1 << 16, 3)
    now[0] += 250
    assert n.read(0xE010) == 3 | 1 << 16
    n.write(0xE018, 0, 4, 0)  # from here on
    assert (n.read(0xE018), n.read(0xE010)) == (99, 3)
    now[0] += 100
    n.write(0xE010, 1, 4, 0)  # no interrupt
    assert (n.is_systick_running(), n.read(0xE010)) == (False, 1 | 1 << 16)
    n.write(0xE010, 2, 4, 0)
    now[0] += 500
    assert (n.read(0xE018), n.read(0xE010)) == (0, 2)
    n.write(0xE010, 3, 4, 0)
    assert (n.read(0xE018), n.find_next_systick_cycle(), n.read(0xE010)) == (99, now[0] + 100, 3)


# --- a PC: timer and ports ---


def test_counters_and_outputs_of_the_8253_by_mode():
    """modes 0, 2 and 3 with 10 and with 9, loaded at 100"""
    for mode, reload, counts, outputs in (
        (0, 10, [10, 9, 1, 0, 0xFFFF, 0xFFFE], [0, 0, 0, 1, 1, 1]),
        (2, 10, [10, 9, 1, 10, 9, 8], [1, 1, 0, 1, 1, 1]),
        (3, 10, [10, 8, 2, 10, 8, 6], [1, 1, 0, 1, 1, 1]),
        (6, 10, [10, 9, 1, 10, 9, 8], [1, 1, 0, 1, 1, 1]),
    ):
        c = TimerChannel(mode=mode, reload=reload, started=100)
        at = [100, 101, 109, 110, 111, 112]
        assert [c.compute_count(t) for t in at] == counts, mode
        assert [int(c.compute_output(t)) for t in at] == outputs, mode
    c = TimerChannel(mode=3, reload=9, started=0)
    assert [int(c.compute_output(t)) for t in range(9)] == [1, 1, 1, 1, 1, 0, 0, 0, 0]
    c = TimerChannel(mode=3, reload=10, started=0)
    assert [int(c.compute_output(t)) for t in range(10)] == [1] * 5 + [0] * 5
    for at in range(30):
        three, seven = (TimerChannel(mode=mode, reload=9) for mode in (3, 7))
        assert (three.compute_count(at), three.compute_output(at)) == (
            seven.compute_count(at),
            seven.compute_output(at),
        )
    assert all(TimerChannel(mode=3, reload=9).compute_count(t) % 2 == 0 for t in range(20))
    assert TimerChannel(mode=2, reload=MAX_RELOAD).compute_count(0) == 0, "10000h in 16 bits"
    assert TimerChannel(mode=0, reload=MAX_RELOAD).compute_count(0) == 0


def test_the_bytes_of_a_counter_come_as_its_access_says():
    now = [0]
    t = PcTimer(lambda: now[0])
    for port, value in ((0x43, 0x14), (0x40, 0x80)):  # channel 0: the low byte alone, mode 2
        t.write(port, value)
    now[0] = 0x10
    assert (t.read(0x40), t.read(0x40), t.find_next_zero()) == (0x70, 0x70, 0x80)
    for port, value in ((0x43, 0x64), (0x41, 0x12)):  # channel 1: the high byte alone
        t.write(port, value)
    now[0] += 0x10
    assert (t.read(0x41), t.channels[1].reload) == (0x11, 0x1200)
    t.write(0x43, 0x40)
    now[0] += 0x400
    assert (t.read(0x41), t.read(0x41)) == (0x11, 0x0D), "as it was latched, once"
    for port, value in ((0x43, 0xB4), (0x42, 0), (0x42, 0)):
        t.write(port, value)
    assert t.channels[2].reload == MAX_RELOAD
    t.write(0x42, 0x34)  # half of it, and then another control word
    t.write(0x43, 0xB0)
    t.write(0x42, 0x01), t.write(0x42, 0x02)
    assert (t.channels[2].reload, t.channels[2].mode) == (0x201, 0)
    assert t.read(0x42) == 1
    t.write(0x43, 0xB0)
    t.write(0x42, 0x05), t.write(0x42, 0x02)
    assert (t.read(0x42), t.read(0x42)) == (5, 2), "a control word begins with the low byte"
    t.write(0x43, 0x80)
    t.write(0x43, 0xB0)
    now[0] += 1
    assert (t.read(0x42), t.read(0x42)) == (4, 2), "and forgets what was latched"
    assert t.read(0x43) == 0xFF
    before = [vars(c).copy() for c in t.channels]
    t.write(0x43, 0xD4)  # of a channel that there is not
    assert [vars(c) for c in t.channels] == before
    t.write(0x43, 0x34)
    t.write(0x40, 0), t.write(0x40, 1)
    now[0] += 256
    t.write(0x43, 0)
    now[0] += 77
    assert (t.read(0x40), t.read(0x40)) == (0, 1)


def test_the_gate_of_channel_2_starts_it_and_the_refresh_toggles():
    now = [0]
    t = PcTimer(lambda: now[0])
    for port, value in ((0x43, 0xB0), (0x42, 100), (0x42, 0)):
        t.write(port, value)
    now[0] = 72
    t.write(0x61, 0xFF)
    assert t.read(0x61) == 3
    now[0] = 72 + 99
    t.write(0x61, 3)  # open already
    assert t.read(0x61) == 3 | 1 << 4
    now[0] += 1
    t.write(0x61, 2)
    assert t.read(0x61) == 2 | 1 << 4 | 1 << 5
    now[0] = 1000
    t.write(0x61, 2)
    assert t.read(0x61) & 0x2F == 0x22, "a gate that stays closed does not restart the channel"
    t.write(0x61, 1)
    assert t.read(0x61) & 0x2F == 1
    now[0] += 100
    assert t.read(0x61) & 0x2F == 0x21


class Bare(Pc):
    """A PC's ports and interrupts; nothing behind them."""

    def __init__(self, irq=5):
        self.cycles = [0]
        self.record = SimpleNamespace(
            cycles=0, hz=4_772_727, due=1, device_waits=0, line=0, raised=0, alarm=NEVER, own=0
        )
        self._irq, self._masked, self._in_service, self._tick_pending = irq, 0, 0, 0
        self.timers = PcTimer(lambda: self.cycles[0])
        self.words = {"eflags": 0x302, "sp": 0x100, "ss": 0x50, "cs": 0x1000, "ip": 0x123}
        self.memory = bytearray(1 << 20)
        self._board = SimpleNamespace(ports={0x50: "a device"})
        self.accesses, self.fault = [], ""

    def get_register(self, name):
        return self.words[name]

    def set_registers(self, **values):
        self.words |= values

    def read(self, segment, offset, size):
        return bytes(self.memory[(segment << 4) + offset :][:size])

    def write(self, segment, offset, content):
        at = (segment << 4) + offset
        self.memory[at : at + len(content)] = content

    def schedule_timer_interrupt(self):
        self.watched = True

    def _make_board_cycle(self, port, size, value):
        self.accesses.append((port, size, value))
        return 0x77


def test_ports_below_100h_are_the_board_s_where_it_has_some_and_else_the_pc_s():
    pc = Bare()
    assert [pc._access_internal_port(0, port, 1, -1) for port in (0x50, 0x3F, 0x44, 0x60, 0x22, 0x1F)] == [0x77] * 6
    assert pc.accesses == [(port, 1, -1) for port in (0x50, 0x3F, 0x44, 0x60, 0x22, 0x1F)]
    pc.accesses.clear()
    pc._access_internal_port(0, 0x50, 2, 0x1234)
    assert pc.accesses == [(0x50, 2, 0x1234)], "a word of the board is one cycle"
    pc.accesses.clear()
    pc._access_internal_port(0, 0x21, 1, 0x5A)
    assert pc._access_internal_port(0, 0x21, 1, -1) == 0x5A
    pc._access_internal_port(0, 0x21, 2, 0x3C00)
    assert pc._access_internal_port(0, 0x21, 1, -1) == 0, "a word is two bytes, the low one first"
    assert pc.accesses == [(0x22, 1, 0x3C)]
    assert pc._access_internal_port(0, 0x20, 2, -1) == 0
    assert pc._access_internal_port(0, 0x21, 2, -1) == 0x7700
    for port, value in ((0x43, 0x34), (0x40, 0x10), (0x40, 0x20)):
        pc._access_internal_port(0, port, 1, value)
    assert pc.watched
    assert (
        pc.timers.channels[0].reload,
        pc._access_internal_port(0, 0x40, 1, -1),
        pc._access_internal_port(0, 0x40, 1, -1),
    ) == (
        0x2010,
        0x10,
        0x20,
    )
    pc._access_internal_port(0, 0x61, 1, 3)
    assert pc._access_internal_port(0, 0x61, 1, -1) & 3 == 3
    pc.uc = SimpleNamespace(emu_stop=lambda: setattr(pc, "stands", True))
    pc._make_board_cycle = None
    assert (pc._access_internal_port(0, 0x50, 1, -1), pc.stands, "callable" in pc.fault) == (0xFF, True, True)


def test_the_controller_serves_by_priority_until_the_end_of_interrupt():
    pc = Bare()
    r = pc.record
    pc._update_line_mask()
    assert (bool(r.line), r.due) == (True, 0)
    for number in (8, 13):
        pc.write(0, 4 * number, struct.pack("<HH", 0x10 * number, 0x2000))
    r.raised = 1
    pc._enter_pending_interrupt()
    assert (pc.words["cs"], pc.words["ip"], pc.words["sp"], r.raised, bool(r.line)) == (0x2000, 0xD0, 0xFA, 0, False)
    assert pc.words["eflags"] == 0x2, "neither interrupts nor single steps in its routine"
    assert struct.unpack("<HHH", pc.read(0x50, 0xFA, 6)) == (0x123, 0x1000, 0x302)
    pc._access_internal_port(0, 0x20, 1, 0x20)
    assert (pc._in_service, bool(r.line)) == (0, True)
    pc._in_service = 0b100001
    pc._access_internal_port(0, 0x20, 1, 0x20)
    assert pc._in_service == 0b100000, "the highest"
    pc._access_internal_port(0, 0x20, 1, 0x65)  # of 5 alone
    assert pc._in_service == 0
    pc._in_service = 0b100001
    pc._access_internal_port(0, 0x20, 1, 0x65)
    assert pc._in_service == 1
    pc._access_internal_port(0, 0x20, 1, 0x0B)
    assert pc._in_service == 1, "no end of interrupt"
    pc._access_internal_port(0, 0x20, 1, 0x60)
    pc._access_internal_port(0, 0x21, 1, 0x20)
    assert not r.line
    pc._access_internal_port(0, 0x21, 1, 0xDF)
    assert r.line
    for lower, may in ((1 << 6, True), (1 << 5, False), (1 << 4, False), (1, False)):
        pc._in_service = lower
        pc._update_line_mask()
        assert bool(r.line) == may, lower


def test_a_tick_comes_when_interrupts_are_on_and_it_is_neither_masked_nor_served():
    for flags, masked, served, comes, wanted in (
        (0x202, 0, 0, True, 0), (0x002, 0, 0, False, 1), (0x202, 1, 0, False, 0), (0x202, 0, 1, False, 0),
    ):  # fmt: skip
        pc = Bare()
        pc.words["eflags"], pc._masked, pc._in_service = flags, masked, served
        pc._pend_timer_interrupt()
        pc._enter_pending_interrupt()
        assert (pc.words["sp"] == 0xFA, int(pc.record.device_waits)) == (comes, wanted), (flags, masked, served)
        pc._masked = 0
        pc.words["eflags"] = flags
        pc._access_internal_port(0, 0x20, 1, 0x60)  # its end
        assert int(pc.record.device_waits) == (not comes), (flags, masked, served)
    pc = Bare(irq=None)
    pc.record.raised = pc.record.line = 1
    pc._enter_pending_interrupt()
    assert pc.words["sp"] == 0x100, "no wire, no interrupt"
    pc = Bare()
    pc.words["sp"] = 2
    pc._enter_interrupt(8)
    assert pc.words["sp"] == 0xFFFC


# --- Arm: semihosting; ELF files ---


class Cpu:
    """Registers and memory."""

    def __init__(self):
        self.r0 = self.r1 = 0
        self.memory = bytearray(1 << 16)
        self.uc = SimpleNamespace(mem_read=lambda at, size: self.memory[at : at + size])
        self.record = SimpleNamespace(cycles=250, hz=100)
        self.printed, self.code = "", None

    def get_register(self, name):
        return getattr(self, name)

    def set_registers(self, r0):
        self.r0 = r0

    def read_word(self, at):
        return int.from_bytes(self.memory[at : at + 4], "little")

    def log_text(self, text):
        self.printed += text

    def end(self, code):
        self.code = code

    def request(self, what, about=0):
        self.r0, self.r1 = what, about
        Semihosting(self).execute_request()
        return self.r0


def test_semihosting_prints_reads_the_clock_and_ends():
    cpu = Cpu()
    cpu.memory[0x100:0x120] = struct.pack("<4I", 1, 0x200, 5, 0).ljust(32, b"\0")
    cpu.memory[0x200:0x220] = b"a text of more than 16 by\xe9s\0xyz"
    assert [cpu.request(3, 0x201), cpu.printed] == [0, " "]
    cpu.printed = ""
    assert [cpu.request(4, 0x200), cpu.printed] == [0, "a text of more than 16 byés"]
    cpu.printed = ""
    assert [cpu.request(5, 0x100), cpu.printed] == [0, "a tex"]
    cpu.printed, cpu.memory[0x108:0x10C] = "", struct.pack("<I", 9000)
    cpu.request(5, 0x100)
    assert len(cpu.printed) == 4096
    cpu.printed, cpu.memory[0x1000:0x8000] = "", b"z" * 0x7000
    cpu.request(4, 0x1000)
    assert len(cpu.printed) == 4096, "a text without an end"
    assert [cpu.request(what) for what in (1, 9, 0x10, 0x11, 2, 0x0C, 0x13, 0x16, 0x15, 0x77)] == [
        1, 1, 250, 2, 0, 0, 0, 0, 0xFFFFFFFF, 0xFFFFFFFF,
    ]  # fmt: skip
    assert cpu.code is None
    for what, about, code in ((0x18, APPLICATION_EXIT, 0), (0x18, 0x20023, 1)):
        cpu.request(what, about)
        assert cpu.code == code
    for argument in (0, 3, -1, -(1 << 31)):
        cpu.memory[0x304:0x308] = struct.pack("<i", argument)
        cpu.request(0x20, 0x300)
        assert cpu.code == argument


def elf(kind=2, machine=ARM, segments=(), head=64, byte_order=1) -> bytes:
    """A file without sections."""
    start = bytes((0x7F, 0x45, 0x4C, 0x46, 1, byte_order, 1)).ljust(16, b"\0")
    built = struct.pack("<16sHHIIIIIHHHHHH", start, kind, machine, 1, 0x101, 52, 0, 0, 52, 32, len(segments), 40, 0, 0)
    return built + b"".join(struct.pack("<8I", *s, 0, 0)[:32] for s in segments)


def test_an_elf_file_says_its_machine_and_what_is_loaded(tmp_path):
    file = tmp_path / "it.elf"
    for content, machine in ((elf(), "ARM (32 bit)"), (elf(machine=999), "machine 999"), (b"\x7fELF", ""), (b"x" * 99, ""),
                             (b"\x7fELF\x01\x02\x01".ljust(18, b"\0") + b"\0\x04", "68000"), (elf()[:19], "")):  # fmt: skip
        file.write_bytes(content)
        assert read_machine_name(file) == machine
    rows = ((1, 148, 0x8000, 0x4000, 4, 4), (1, 152, 0x9000, 0x5000, 0, 9), (4, 148, 0xA000, 0x6000, 4, 4))
    file.write_bytes(elf(segments=rows) + b"code")
    matches = Elf(file, ARM, "cortex-m3", "a linker").segments
    assert [tuple(s) for s in matches] == [(0x4000, 0x8000, b"code")], "neither what is empty nor what is no LOAD"
    for content, pattern in (
        (elf()[:51], "is cut off or damaged"), (elf(kind=1), "is an object file, not a program"), (elf(kind=7), "no program"),
        (elf(segments=rows)[:100], "its tables point behind its end"), (elf(machine=AVR), "was built for AVR"), (b"x", "is no ELF"),
    ):  # fmt: skip
        file.write_bytes(content)
        with pytest.raises(LibraryError, match=pattern):
            Elf(file, ARM, "cortex-m3", "a linker")
    file.write_bytes(elf())
    assert Elf(file, ARM, "cortex-m3", "a linker").describe_address(0x1234) == "1234h"


# --- an engine without its processor ---


def test_memory_that_holds_windows_is_known_to_the_byte():
    engine = SimpleNamespace(window_pages=[0x1000, 0x5000])
    inside = {
        at: UnicornProcessor.overlaps_window(engine, at, 2) for at in (0xFFE, 0xFFF, 0x1FFF, 0x2000, 0x4FFF, 0x6000)
    }
    assert inside == {0xFFE: False, 0xFFF: True, 0x1FFF: True, 0x2000: False, 0x4FFF: True, 0x6000: False}


def test_a_line_without_an_end_is_printed_in_pieces():
    class Says(UnicornProcessor):
        def __init__(self):
            self._line, self.printed = "", []

        def _log_line(self, line):
            self.printed.append(line)

    engine = Says()
    engine.log_text("one\r\ntwo ")
    assert engine.printed == ["one"]
    engine.log_text("x" * 1000)
    assert engine.printed == ["one", "two " + "x" * 1000]
    engine.flush_log_line()
    assert len(engine.printed) == 2


def test_processor_names_are_case_insensitive():
    assert [supported_processors.check_mcu(name) for name in ("ATmega2560", "Cortex-M3")] == ["atmega2560", "cortex-m3"]


# --- the pins of an AVR ---


def test_carriage_returns_of_a_serial_line_are_not_in_its_text():
    processor, text, line = np.zeros(1, avr_clock_and_pins.AVR), np.zeros(80, "u1"), np.zeros(1, avr_serial.UART)
    line[0].avr, line[0].text, line[0].room = processor.ctypes.data, text.ctypes.data, 80
    for byte in b"a\rb":
        avr_serial.handle_sent_byte(0, byte, line)
    assert (line[0].length, bytes(text[:3])) == (2, b"ab\0")


@pytest.mark.parametrize("data", ["AB", "I", "", "A0"])
def test_the_data_lines_are_one_port(data):
    with pytest.raises(ArgumentError, match=f"data={data} is no port; ports are A, B, "):
        parse_bus_pins(f"data={data},wr=G0,rd=G1")


def test_a_range_of_one_pin_is_that_pin():
    one, same = (parse_bus_pins(f"data=A,address={address},wr=G0,rd=G1") for address in ("C:3-3", "C3"))
    assert one == same
    assert one.address == ((PORT_LETTERS.index("C"), 3),)
    assert parse_bus_pins("data=A,address=C:0-1+D7,wr=G0,rd=G1").address == ((2, 0), (2, 1), (3, 7))
