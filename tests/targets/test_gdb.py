"""A debugger at processors on Unicorn: packets of GDB's remote protocol, and GDB itself where it is installed."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.target_boards import board_of

from stage.board import HostError
from stage.errors import ArgumentError
from stage.targets import TargetHost, supported_processors
from stage.targets.elf import ARM, Elf

DATA = Path(__file__).parent / "data"
WINDOW = "0x40021000=0x300+0x40"
FUNCTIONS = Elf(DATA / "faults.m3.elf", ARM, "", "").symbols
PC, SP = 15, 13
pytestmark = pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)


class Client:
    """A debugger that says what it is told."""

    def __init__(self, port: int):
        for _ in range(400):
            try:
                self.socket = socket.create_connection(("127.0.0.1", port), timeout=20)
                break
            except ConnectionRefusedError:
                time.sleep(0.02)
        self.got = b""

    def send(self, text: str) -> None:
        self.socket.sendall(f"${text}#{sum(text.encode()) & 0xFF:02x}".encode())

    def answer(self) -> str:
        while not (matches := re.search(rb"\$([^#]*)#..", self.got)):
            more = self.socket.recv(4096)
            assert more, "it has gone"
            self.got += more
        self.got = self.got[matches.end() :]
        self.socket.sendall(b"+")
        return matches[1].decode()

    def __call__(self, text: str) -> str:
        self.send(text)
        return self.answer()

    def register(self, n: int) -> int:
        return int.from_bytes(bytes.fromhex(self(f"p{n:x}")), "little")


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextmanager
def debugged(case: int, name: str = "faults.m3.elf", mcu: str = "cortex-m3", maps=(WINDOW,)):
    """The host, its debugger, and what it ends with."""
    port = free_port()
    h = TargetHost(DATA / name, board_of(case), mcu=mcu, map=maps, isolated=False, gdb=port)
    ends: list[object] = []

    def run() -> None:
        try:
            ends.append(h.run(timeout=1))
        except HostError as error:
            ends.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield h, Client(port), ends
    thread.join(20)
    assert not thread.is_alive()


def test_a_breakpoint_halts_it_and_the_run_is_the_same():
    reference = TargetHost(DATA / "faults.m3.elf", board_of(9), mcu="cortex-m3", map=WINDOW, isolated=False)
    at_end = reference.run().seconds
    with debugged(9) as (h, gdb, ends):
        assert gdb("?") == "S05"
        begin = h.board.stage.now
        assert "qXfer:features:read+" in gdb("qSupported:swbreak+")
        assert "org.gnu.gdb.arm.m-profile" in gdb("qXfer:features:read:target.xml:0,1000")
        assert gdb.register(PC) == FUNCTIONS["reset"] & ~1
        assert gdb(f"Z0,{FUNCTIONS['application'] & ~1:x},2") == "OK"
        assert gdb("c") == "S05"
        assert gdb.register(PC) == FUNCTIONS["application"] & ~1
        halted = h.board.stage.now
        time.sleep(0.05)
        assert h.board.stage.now == halted >= begin
        assert h.board.cycles == 12, "only those of the test"
        assert gdb("vCont;c") == "W09"
    assert (ends[0].code, ends[0].seconds) == (9, at_end)


def test_steps_registers_and_memory():
    with debugged(9) as (h, gdb, ends):
        flash = gdb(f"m{FUNCTIONS['reset'] & ~1:x},4")
        assert bytes.fromhex(flash) in (DATA / "faults.m3.elf").read_bytes()
        pc = gdb.register(PC)
        assert gdb("s") == "S05"
        assert gdb.register(PC) in (pc + 2, pc + 4)
        assert gdb("vCont;s:1") == "S05"
        assert gdb("P3=78563412") == "OK"
        assert gdb.register(3) == 0x12345678
        everything = gdb("g")
        assert len(everything) == 17 * 8
        assert everything[24:32] == "78563412"
        assert gdb("G" + everything) == "OK"
        assert gdb("M20000100,4:01020304") == "OK"
        assert gdb("m20000100,4") == "01020304"
        assert gdb("M40021000,1:05") == "E14", "a bus cycle, too"
        assert gdb("m50000000,4") == gdb("m40021000,1") == gdb("mx") == "E14", "no memory; a bus cycle; no number"
        assert gdb("Z2,20000000,4") == gdb("vMustReplyEmpty") == "", "watchpoints are not here"
        assert h.board.cycles == 12
        gdb.send("k")
    assert ends[0].code == 0


def test_a_port_that_is_in_use_is_refused_before_anything_runs():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ArgumentError, match=rf"gdb={port}: Address already in use\. Choose another port"):
            TargetHost(DATA / "faults.com", board_of(), mcu="8086", gdb=port)


def test_a_debugger_interrupts_a_loop_and_inspects_a_fault():
    with debugged(8) as (_, gdb, ends):
        gdb.send("c")
        time.sleep(0.05)
        gdb.socket.sendall(b"\x03")
        assert gdb.answer() == "S02"
        wild = FUNCTIONS["wild_write"] | 1
        assert gdb(f"Pf={wild.to_bytes(4, 'little').hex()}") == "OK"
        assert gdb("c") == "S0b"
        assert FUNCTIONS["wild_write"] & ~1 <= gdb.register(PC) < (FUNCTIONS["wild_write"] & ~1) + 16
        assert gdb("D") == "OK"
    assert re.search(r"it writes memory that is not there, .*wild_write", str(ends[0]))


def test_a_debugger_that_disconnects_removes_its_breakpoints():
    with debugged(9) as (_, gdb, ends):
        assert gdb(f"Z0,{FUNCTIONS['application'] & ~1:x},2") == "OK"
        assert gdb("D") == "OK"
    assert ends[0].code == 9


def test_a_program_of_dos_is_at_linear_addresses():
    with debugged(9, "faults.com", "8086", ()) as (_, gdb, ends):
        assert "i8086" in gdb("qXfer:features:read:target.xml:0,1000")
        at = gdb.register(8)
        assert at == 0x10100
        image = (DATA / "faults.com").read_bytes()
        assert gdb(f"m{at:x},8") == image[:8].hex()
        assert gdb("s") == "S05"
        after = gdb.register(8)
        assert after != at
        assert gdb(f"P8={at.to_bytes(4, 'little').hex()}") == "OK"
        assert gdb(f"Z1,{after:x},1") == "OK"
        assert gdb("c") == "S05"
        assert gdb.register(8) == after
        assert gdb(f"z1,{after:x},1") == "OK"
        gdb.socket.close()  # it goes on without
    assert ends[0].code == 9


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gdb-multiarch") is None, reason="there is no gdb-multiarch")
@pytest.mark.parametrize(
    ("name", "mcu", "maps", "symbol"),
    [("faults.m3.elf", "cortex-m3", (WINDOW,), "application"), ("faults.com", "8086", (), None)],
)
def test_gdb_debugs_a_program(name, mcu, maps, symbol):
    port, ends = free_port(), []
    h = TargetHost(DATA / name, board_of(9), mcu=mcu, map=maps, isolated=False, gdb=port)
    thread = threading.Thread(target=lambda: ends.append(h.run(timeout=1)), daemon=True)
    thread.start()
    time.sleep(0.5)
    requested = ["set confirm off", f"target remote 127.0.0.1:{port}", "stepi", "info registers"]
    requested += [f"break *{FUNCTIONS[symbol] & ~1}", "continue", "x/i $pc", "delete"] if symbol else ["x/2i $pc"]
    command = ["gdb-multiarch", "-nx", "-batch", *(part for text in [*requested, "continue"] for part in ("-ex", text))]
    done = subprocess.run(
        [*command, *([DATA / name] if symbol else [])], capture_output=True, text=True, timeout=60, check=False
    )
    thread.join(20)
    assert ends[-1].code == 9
    assert (f"<{symbol}>" if symbol else "eflags") in done.stdout
    assert "exited with code 011" in done.stdout
