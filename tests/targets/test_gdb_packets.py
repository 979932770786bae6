"""What a debugger is answered packet by packet, without a processor; and what programs of processors are loaded and entered as."""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from types import SimpleNamespace

import pytest

from stage.board import LibraryError
from stage.board.memory_mapped_ports import MemoryWindow
from stage.errors import ArgumentError
from stage.targets.cortex_m import Cortex
from stage.targets.elf import check_avr
from stage.targets.gdb_server import DebugServer, make_8086_registers
from stage.targets.pc_8086 import PREFIX_SEGMENT, Pc
from stage.targets.simavr import find_jump_target


class ThreeRegisters:
    """Three registers of 4, 2 and 10 bytes."""

    sizes = (4, 2, 10)
    description = "abcdef"

    def __init__(self):
        self.values = [0x12345678, -2, 1 << 79]

    def read(self, n):
        return self.values[n]

    def write(self, n, value):
        self.values[n] = value


class Engine:
    """64 bytes of memory at 100h, a window behind them; `done`: what was asked of it."""

    error = KeyError

    def __init__(self):
        self.done, self.memory = [], bytearray(range(64))
        self.uc = SimpleNamespace(
            mem_read=lambda at, size: self.memory[at - 0x100 : at - 0x100 + size], mem_write=self._write,
            hook_del=lambda hook: self.done.append(("hook_del", hook)), emu_stop=lambda: self.done.append("stop"),
        )  # fmt: skip

    def _write(self, at, content):
        self.memory[at - 0x100 : at - 0x100 + len(content)] = content

    def overlaps_window(self, at, size):
        return at + size > 0x140

    def hook_address(self, at, function):
        self.done.append(("watch", at))
        return at + 1

    def uncount_instruction(self, size):
        self.done.append(("uncount", size))

    def get_program_counter(self):
        return 0x110

    def end(self, code):
        self.done.append(("end", code))


@pytest.fixture
def gdb():
    """A server with a debugger at its other end."""
    ours, theirs = socket.socketpair()
    server = DebugServer(Engine(), ThreeRegisters(), 0)
    server._socket = ours
    theirs.settimeout(5)
    with theirs:
        yield SimpleNamespace(
            server=server, engine=server._engine, seen=server._registers, wire=theirs, ask=server._execute_command
        )
    ours.close()


def packet(text):
    return f"${text}#{sum(text.encode()) & 0xFF:02x}".encode()


@pytest.mark.parametrize(
    ("requested", "answer"),
    [("0,3", "mabc"), ("3,3", "ldef"), ("3,2", "mde"), ("0,6", "labcdef"), ("0,ff", "labcdef"), ("6,4", "l")],
)
def test_a_description_comes_in_parts_of_which_the_last_says_so(gdb, requested, answer):
    assert gdb.ask(f"qXfer:features:read:target.xml:{requested}") == answer


def test_registers_come_and_go_with_their_lowest_byte_first(gdb):
    high = "00" * 9 + "80"
    assert gdb.ask("g") == "78563412" + "feff" + high
    assert [gdb.ask("p0"), gdb.ask("p1"), gdb.ask("p2")] == ["78563412", "feff", high]
    assert gdb.ask("G" + "01020304" + "0506" + "0700000000000000000a") == "OK"
    assert gdb.seen.values == [0x04030201, 0x0605, 0x0A << 72 | 7]
    assert gdb.ask("P1=3412") == "OK"
    assert gdb.seen.values[1] == 0x1234
    for wrong in ("p3", "p", "P1", "Pzz=00", "mzz,1", "m100", "M100:00"):
        assert gdb.ask(wrong).startswith("E"), wrong


def test_memory_is_read_and_written_and_windows_are_not(gdb):
    assert gdb.ask("m101,3") == "010203"
    assert gdb.ask("M101,2:aabb") == "OK"
    assert gdb.ask("m100,4") == "00aabb03"
    assert gdb.ask("m13f,1") == "3f"
    before = bytes(gdb.engine.memory)
    for wrong in ("m13f,2", "M13f,2:0000", "M140,1:00"):
        assert gdb.ask(wrong).startswith("E"), wrong
    assert bytes(gdb.engine.memory) == before


def test_breakpoints_of_code_are_set_once_and_others_are_not_known(gdb):
    for kind in "234":
        assert gdb.ask(f"Z{kind},110,2") == gdb.ask(f"z{kind},110,2") == ""
    assert [gdb.ask("Z0,110,2"), gdb.ask("Z1,110,2"), gdb.ask("Z0,120,2")] == ["OK"] * 3
    assert gdb.engine.done == [("watch", 0x110), ("watch", 0x120)]
    assert [gdb.ask("z0,110,2"), gdb.ask("z0,110,2")] == ["OK"] * 2
    assert gdb.engine.done[2:] == [("hook_del", 0x111)]
    gdb.server._halt_at_breakpoint(None, 0x110, 2, None)
    assert len(gdb.engine.done) == 3, "it is there no more"
    gdb.server.is_halted, gdb.server.is_single_step = False, True
    gdb.server._halt_at_breakpoint(None, 0x120, 2, None)
    assert gdb.engine.done[3:] == [("uncount", 2), "stop"]
    assert (gdb.server.is_halted, gdb.server.is_single_step, gdb.ask("?")) == (True, False, "S05")
    assert gdb.ask("D") is None
    assert gdb.engine.done[5:] == [("hook_del", 0x121)], "who goes takes them along"
    assert gdb.wire.recv(100) == packet("OK")


@pytest.mark.parametrize(
    ("requested", "answer"),
    [("qC", "QC1"), ("qAttached", "1"), ("qfThreadInfo", "m1"), ("qsThreadInfo", "l"), ("vCont?", "vCont;c;C;s;S"), ("Hg0", "OK"),
     ("T1", "OK"), ("qOffsets", ""), ("vMustReplyEmpty", ""), ("QStartNoAckMode", "OK"), ("X0,0:", "")],
)  # fmt: skip
def test_known_queries_are_answered_and_unknown_ones_get_an_empty_reply(gdb, requested, answer):
    assert gdb.ask(requested) == answer


@pytest.mark.parametrize(("requested", "steps"), [("c", False), ("s", True), ("vCont;c", False), ("vCont;s:1", True)])
def test_a_program_continues_or_makes_one_step(gdb, requested, steps):
    assert gdb.ask(requested) is None
    assert (gdb.server.is_halted, gdb.server.is_single_step) == (False, steps)


def test_packets_are_acknowledged_until_the_debugger_disables_it(gdb):
    gdb.wire.sendall(b"+" + packet("qC") + packet("QStartNoAckMode") + packet("qAttached") + packet("c"))
    gdb.server._answer_commands()
    assert gdb.wire.recv(1000) == b"+" + packet("QC1") + b"+" + packet("OK") + packet("1")
    assert not gdb.server.is_halted


@pytest.mark.parametrize(("code", "message"), [(0, "W00"), (3, "W03"), (255, "Wff"), (-1, "Wff"), (259, "W03")])
def test_the_end_of_a_program_is_reported_with_a_byte(gdb, code, message):
    gdb.server.report_end(code)
    assert gdb.wire.recv(100) == packet(message)
    assert gdb.wire.recv(100) == b"", "and the connection is over"


def test_the_kill_packet_ends_the_program(gdb):
    assert gdb.ask("k") is None
    assert gdb.engine.done == [("end", 0)]


def test_a_pc_shows_registers_of_floating_point_that_it_does_not_have():
    requested = []
    cpu = SimpleNamespace(
        get_program_counter=lambda: 0x12345,
        get_register=lambda name: len(name),
        set_registers=lambda **v: requested.append(v),
        set_program_counter=requested.append,
    )
    observed = make_8086_registers(cpu)
    assert [observed.read(n) for n in range(len(observed.sizes))] == [3] * 8 + [0x12345, 6] + [2] * 6 + [0] * 16
    for n in (0, 8, 15, 16, 31):
        observed.write(n, 7)
    assert requested == [{"eax": 7}, 7, {"gs": 7}]
    assert observed.sizes == (4,) * 16 + (10,) * 8 + (4,) * 8


# --- programs ---


@pytest.mark.parametrize(("last", "pages", "size"), [(0, 2, 1024), (1, 2, 513), (511, 1, 511)])
def test_an_exe_is_loaded_to_its_last_byte(last, pages, size):
    """its head says how many bytes its last page has, and 0 is all of them"""
    done = []
    pc = Pc.__new__(Pc)
    pc.write, pc.set_registers = lambda *argument: done.append(argument), lambda **values: done.append(values)
    head = b"MZ" + struct.pack("<12H", last, pages, 0, 2, 0, 0, 0x11, 0x200, 0, 0x33, 0x22, 0x1C) + b"\0" * 6
    content = head + bytes(k % 251 for k in range(size - len(head)))
    pc._load_exe(Path("x.exe"), content)
    begin = PREFIX_SEGMENT + 0x10
    assert done[0] == (begin, 0, content[32:])
    assert (done[1]["cs"], done[1]["ip"], done[1]["ss"], done[1]["sp"]) == (begin + 0x22, 0x33, begin + 0x11, 0x200)
    with pytest.raises(LibraryError, match="is cut off"):
        pc._load_exe(Path("x.exe"), content[:-1])


@pytest.mark.parametrize(
    ("handler", "control", "sp", "back", "begin"),
    [(0, 0, 0x1000, 0xFFFFFFF9, 0xFE0), (0, 2, 0x1000, 0xFFFFFFFD, 0xFE0), (15, 0, 0x1000, 0xFFFFFFF1, 0xFE0),
     (15, 2, 0x1004, 0xFFFFFFF1, 0xFE0), (0, 1, 0x1004, 0xFFFFFFF9, 0xFE0)],
)  # fmt: skip
def test_a_routine_returns_to_the_stack_and_the_mode_that_it_has_come_from(handler, control, sp, back, begin):
    """thread on the main stack, on the process's; a handler; a stack that is not at a multiple of eight"""
    set_, frames, entered = [], [], []
    cpu = Cortex.__new__(Cortex)
    cpu.read_word = {0x40 + 4 * 16: 0x201}.__getitem__
    cpu.nvic = SimpleNamespace(vectors=0x40, get_active_exception=lambda: handler, enter_exception=entered.append)
    cpu._interrupted = SimpleNamespace(read_all=lambda: [control, sp, 0x40000000, 1, 2, 3, 4, 5, 6])
    cpu._entry = SimpleNamespace(write_all=lambda *argument: set_.append(argument))
    cpu.uc, cpu._pc = (
        SimpleNamespace(mem_write=lambda at, frame: frames.append((at, struct.unpack("<8I", frame)))),
        0x124,
    )
    cpu._enter_exception(16)
    assert set_ == [(begin, 16, back, 0x201)]
    assert frames == [(begin, (1, 2, 3, 4, 5, 6, 0x124, 0x41000000 | (0x200 if sp & 4 else 0)))]
    assert (entered, cpu._pc) == ([16], 0x200)


@pytest.mark.parametrize("window", [(0xE0000000, 0, 1), (0xE00FFFFF, 0, 1), (0xFFFFFFFF, 0, 2)])
def test_a_window_on_private_registers_or_beyond_memory_is_refused(window):
    pytest.importorskip("unicorn")
    with pytest.raises(ArgumentError, match="a Cortex-M has no memory for it there"):
        Cortex.__new__(Cortex)._map_memory((MemoryWindow(*window),))


@pytest.mark.parametrize(
    ("name", "mcu", "runs"),
    [("atmega328", "atmega328p", True), ("atmega328p", "atmega328", True), ("atmega644pa", "atmega644p", True),
     ("atmega328p", "atmega644p", False), ("atmega640", "atmega328p", True)],
)  # fmt: skip
def test_a_program_of_a_variant_runs_and_one_of_another_processor_does_not(name, mcu, runs):
    """of the same architecture; one whose name is none that is known is taken by its architecture"""
    message = bytes([1, len(name) + 1]) + name.encode() + b"\0\0"
    elf = SimpleNamespace(path=Path("x.elf"), flags=5, segments=[], read_section={".mmcu": message}.get, device_name="")
    if runs:
        check_avr(elf, mcu, "avr-gcc")
    else:
        with pytest.raises(LibraryError, match=f"was built for {name} .*Run it with --mcu {name}"):
            check_avr(elf, mcu, "avr-gcc")


@pytest.mark.parametrize(
    ("words", "at", "flash", "leads"),
    [((0xCFFF,), 0, 0x8000, 0), ((0xC000,), 0x10, 0x8000, 0x12), ((0xC7FF,), 0, 0x8000, 0x1000), ((0xC800,), 0x1000, 0x8000, 2),
     ((0xCFFE,), 0, 0x2000, 0x1FFE), ((0x940C, 0x1234), 0, 0x40000, 0x2468), ((0x940D, 0x0001), 4, 0x40000, 0x20002),
     ((0x941C, 0), 0, 0x400000, 0x40000), ((0x940E, 0x1234), 0, 0x40000, -1), ((0,), 0, 0x8000, -1)],
)  # fmt: skip
def test_a_jump_of_an_avr_leads_forth_and_back_and_round_its_flash(words, at, flash, leads):
    """rjmp by -1, 0, 2047 and -2048 words; jmp of 16, 17 and 18 bits; call and nop are none"""
    code = bytes(at) + struct.pack(f"<{len(words)}H", *words)
    assert find_jump_target(code, at, flash) == leads
