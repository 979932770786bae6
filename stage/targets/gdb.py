"""A server for GDB (its remote serial protocol) of a processor on Unicorn, at a TCP port of this machine.

The program halts before its first instruction until a debugger says c. The time of the stage stands while it halts, since it passes
in instructions only. Breakpoints are looked at by address and leave the memory as it is. Memory of the board's windows is not
shown: a read there would be a bus cycle.
"""

from __future__ import annotations

import re
import select
import socket
import sys
import threading
from typing import Any, Protocol

TRAP, INTERRUPT, SEGMENTATION = 5, 2, 11
_ERROR = "E14"
_POLL = 0.1  # s
_LONGEST = 0x2000


class Debugged(Protocol):
    """What a debugger sees of a processor. sizes: bytes of each register, in the order of `description`."""

    sizes: tuple[int, ...]
    description: str

    def value(self, n: int) -> int:
        """Of register n."""

    def change(self, n: int, value: int) -> None:
        """Of register n."""


class Server:
    """engine: see stage.targets.engine; seen: its registers.

    Attributes: halted: it stands still until the debugger lets it go; steps: it goes on for one instruction.
    """

    def __init__(self, engine: Any, seen: Debugged, port: int):
        self._engine, self._seen, self._port = engine, seen, port
        self._socket: socket.socket | None = None
        self._got = b""
        self._acknowledges = True
        self._breakpoints: dict[int, int] = {}
        self._over: int | None = None  # the breakpoint from which it goes on
        self._runs = threading.Event()
        self.halted, self.steps, self._told = True, False, True
        self._signal = TRAP

    # --- the engine calls ---

    def before(self) -> None:
        """Before it goes on: as long as it halts, the debugger is served."""
        if self._socket is None and self._port:
            self._accept()
        if self.halted:
            self._serve()
        if self._socket is not None:
            self._over = self._engine.address() if self._engine.address() in self._breakpoints else None
            self._runs.set()

    def after(self) -> bool:
        """It has stopped; True if the debugger wanted that, and the processor has nothing else to do."""
        self._runs.clear()
        if self.steps:
            self.steps, self.halted, self._signal = False, True, TRAP
            return False
        return self.halted

    def failed(self) -> None:
        """The program cannot go on: the debugger may look at it."""
        self._runs.clear()
        if self._socket is not None:
            self.halted, self._told, self._signal = True, False, SEGMENTATION
            self._serve()

    def ended(self, code: int) -> None:
        """The program has returned."""
        self._runs.clear()
        if self._socket is not None:
            self._send(f"W{code & 0xFF:02x}")
            self._close()

    # --- the connection ---

    def _accept(self) -> None:
        with socket.create_server(("127.0.0.1", self._port)) as server:
            print(f"GDB: target remote 127.0.0.1:{self._port}", file=sys.stderr, flush=True)
            self._socket, _ = server.accept()
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._port = 0  # one debugger a run
        threading.Thread(target=self._watch, args=(self._socket,), daemon=True).start()

    def _watch(self, connection: socket.socket) -> None:
        """While the program runs: Ctrl-C of the debugger, or its end, stops it."""
        while self._socket is connection:
            if not self._runs.wait(_POLL):
                continue
            try:
                ready, _, _ = select.select([connection], [], [], _POLL)
                if ready and self._runs.is_set():
                    self._runs.clear()
                    self._halt(INTERRUPT)
            except (OSError, ValueError):
                return

    def _halt(self, signal: int) -> None:
        self.halted, self._told, self._signal = True, False, signal
        self._engine.uc.emu_stop()

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self.halted = None, False
        for address in list(self._breakpoints):
            self._remove(address)

    def _send(self, text: str) -> None:
        if self._socket is not None:
            try:
                self._socket.sendall(f"${text}#{sum(text.encode()) & 0xFF:02x}".encode())
            except OSError:
                self._close()

    def _packet(self) -> str | None:
        """The next command; "\\x03" for Ctrl-C; None when the debugger has gone."""
        while self._socket is not None:
            self._got = self._got.lstrip(b"+-")
            if self._got[:1] == b"\x03":
                self._got = self._got[1:]
                return "\x03"
            if found := re.match(rb"\$([^#]*)#..", self._got, re.S):
                self._got = self._got[found.end() :]
                if self._acknowledges:
                    self._socket.sendall(b"+")
                return found[1].decode("latin1")
            try:
                more = self._socket.recv(0x10000)
            except OSError:
                more = b""
            if not more:
                self._close()
            self._got += more
        return None

    def _serve(self) -> None:
        if not self._told:
            self._send(f"S{self._signal:02x}")
            self._told = True
        while self.halted and (command := self._packet()) is not None:
            if command == "\x03":
                continue
            answer = self._answer(command)
            if answer is not None:
                self._send(answer)

    # --- commands ---

    def _answer(self, command: str) -> str | None:
        """What is sent back; None: nothing, or later."""
        kind, rest = command[:1], command[1:]
        if kind in "cs" or command.startswith("vCont;"):
            self._go_on(kind == "s" or command.startswith("vCont;s"))
            return None
        if kind == "k":
            self._close()
            self._engine.end(0)
            return None
        if kind == "D":
            self._send("OK")
            self._close()
            return None
        if kind in "qQvH?T":
            return self._general(command)
        try:
            return getattr(self, f"_{_NAMES[kind]}")(rest) if kind in _NAMES else ""
        except (ValueError, IndexError, self._engine.error):
            return _ERROR

    def _general(self, command: str) -> str:
        if command.startswith("qXfer:features:read:target.xml:"):
            at, size = (int(part, 16) for part in command.rsplit(":", 1)[1].split(","))
            part = self._seen.description[at : at + size]
            return ("m" if at + size < len(self._seen.description) else "l") + part
        if command == "QStartNoAckMode":
            self._acknowledges = False
            return "OK"
        if command.startswith("qSupported"):
            return f"PacketSize={_LONGEST * 2:x};QStartNoAckMode+;qXfer:features:read+;vContSupported+"
        known = {
            "?": f"S{self._signal:02x}",
            "vCont?": "vCont;c;C;s;S",
            "qAttached": "1",
            "qC": "QC1",
            "qfThreadInfo": "m1",
        }
        return known.get(command, "l" if command == "qsThreadInfo" else "OK" if command[0] in "HT" else "")

    def _go_on(self, one: bool) -> None:
        self.halted, self.steps, self._told = False, one, False

    def _all(self, _rest: str) -> str:
        return "".join(self._hex(n) for n in range(len(self._seen.sizes)))

    def _set_all(self, rest: str) -> str:
        for n, size in enumerate(self._seen.sizes):
            self._seen.change(n, int.from_bytes(bytes.fromhex(rest[: 2 * size]), "little"))
            rest = rest[2 * size :]
        return "OK"

    def _one(self, rest: str) -> str:
        return self._hex(int(rest, 16))

    def _set_one(self, rest: str) -> str:
        number, value = rest.split("=")
        self._seen.change(int(number, 16), int.from_bytes(bytes.fromhex(value), "little"))
        return "OK"

    def _hex(self, n: int) -> str:
        size = self._seen.sizes[n]
        return (self._seen.value(n) & (1 << 8 * size) - 1).to_bytes(size, "little").hex()

    def _memory(self, rest: str) -> str:
        at, size = (int(part, 16) for part in rest.split(","))
        if self._engine.in_window(at, size):
            return _ERROR
        return bytes(self._engine.uc.mem_read(at, min(size, _LONGEST))).hex()

    def _set_memory(self, rest: str) -> str:
        where, content = rest.split(":")
        at, size = (int(part, 16) for part in where.split(","))
        if self._engine.in_window(at, size):
            return _ERROR
        self._engine.uc.mem_write(at, bytes.fromhex(content))
        return "OK"

    def _break(self, rest: str) -> str:
        kind, address = rest.split(",")[:2]
        at = int(address, 16)
        if kind not in "01":
            return ""
        if at not in self._breakpoints:
            self._breakpoints[at] = self._engine.watch(at, self._reached)
        return "OK"

    def _no_break(self, rest: str) -> str:
        kind, address = rest.split(",")[:2]
        if kind not in "01":
            return ""
        self._remove(int(address, 16))
        return "OK"

    def _remove(self, address: int) -> None:
        if address in self._breakpoints:
            self._engine.uc.hook_del(self._breakpoints.pop(address))

    def _reached(self, _uc: Any, address: int, size: int, _user: Any) -> None:
        """Unicorn calls it before the instruction at a breakpoint."""
        over, self._over = self._over, None
        if address == over or address not in self._breakpoints:
            return
        self._engine.not_run(size)
        self.steps = False
        self._halt(TRAP)


_NAMES = {
    "g": "all", "G": "set_all", "p": "one", "P": "set_one", "m": "memory", "M": "set_memory", "Z": "break", "z": "no_break",
}  # fmt: skip


def description(architecture: str, feature: str, registers: list[tuple[str, int, str]]) -> str:
    """The registers as GDB wants to be told: (name, bits, type or "")."""
    rows = "".join(
        f'<reg name="{name}" bitsize="{bits}"{f" type={chr(34)}{kind}{chr(34)}" if kind else ""}/>'
        for name, bits, kind in registers
    )
    return (
        f'<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd"><target version="1.0"><architecture>{architecture}'
        f'</architecture><feature name="{feature}">{rows}</feature></target>'
    )


_PC = 15
_CORTEX = [*(f"r{n}" for n in range(13)), "sp", "lr", "pc", "xpsr"]
_I8086 = "eax ecx edx ebx esp ebp esi edi eip eflags cs ss ds es fs gs".split()
_FLOATS = [(f"st{n}", 80, "i387_ext") for n in range(8)]
_OF_FLOATS = [(f"f{name}", 32, "int") for name in "ctrl stat tag iseg ioff oseg ooff op".split()]
_IP = _I8086.index("eip")


class CortexRegisters:
    """cpu: see stage.targets.cortex."""

    sizes = (4,) * len(_CORTEX)
    description = description(
        "arm",
        "org.gnu.gdb.arm.m-profile",
        [(name, 32, {"sp": "data_ptr", "pc": "code_ptr"}.get(name, "")) for name in _CORTEX],
    )

    def __init__(self, cpu: Any):
        self._cpu = cpu

    def value(self, n: int) -> int:
        """Of register n."""
        return int(self._cpu.address() if n == _PC else self._cpu.get(_CORTEX[n]))

    def change(self, n: int, value: int) -> None:
        """Of register n."""
        if n == _PC:
            self._cpu.go_to(value)
        else:
            self._cpu.set(**{_CORTEX[n]: value})


class PcRegisters:
    """eip is the linear address, 16 * cs + ip, as the memory's addresses are. cpu: see stage.targets.pc."""

    sizes = (4,) * len(_I8086) + (10,) * len(_FLOATS) + (4,) * len(_OF_FLOATS)
    description = description(
        "i8086",
        "org.gnu.gdb.i386.core",
        [
            *((name, 32, {"eip": "code_ptr", "esp": "data_ptr"}.get(name, "int")) for name in _I8086),
            *_FLOATS,
            *_OF_FLOATS,
        ],
    )

    def __init__(self, cpu: Any):
        self._cpu = cpu

    def value(self, n: int) -> int:
        """Of register n."""
        if n >= len(_I8086):
            return 0
        return int(self._cpu.address() if n == _IP else self._cpu.get(_I8086[n]))

    def change(self, n: int, value: int) -> None:
        """Of register n."""
        if n == _IP:
            self._cpu.go_to(value)
        elif n < len(_I8086):
            self._cpu.set(**{_I8086[n]: value})
