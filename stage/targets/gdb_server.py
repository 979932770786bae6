"""Server of GDB's remote serial protocol for a processor on Unicorn, at a TCP port of this machine.

The program halts before its first instruction until the debugger continues it. Simulated time passes only in
instructions, so it stands while the program halts. Breakpoints are found by address and do not change memory. The
server does not show memory of the board's windows, where a read would be a bus cycle.
"""

from __future__ import annotations

import re
import select
import socket
import sys
import threading
from collections.abc import Callable
from typing import Any

TRAP, INTERRUPT, SEGMENTATION = 5, 2, 11
CTRL_C = "\x03"
POLL_INTERVAL_S = 0.1
MAX_READ_BYTES = 0x2000
_ERROR_REPLY = "E14"
_REPLIES = {"vCont?": "vCont;c;C;s;S", "qAttached": "1", "qC": "QC1", "qfThreadInfo": "m1", "qsThreadInfo": "l"}


class DebugRegisters:
    """Registers of a processor, numbered as GDB numbers them.

    Args:
        cpu: A UnicornProcessor; its `set_program_counter` sets the program counter.
        architecture: Name of the architecture in GDB.
        feature: Name of the register set in GDB.
        names: Names of the 32-bit registers, in GDB's order.
        kinds: GDB types of some registers, by name; the others have the type `kind`.
        pc: Name of the program counter.
        kind: A type, or "".
        absent: Further registers that GDB requires and that read as 0: (name, bits, type).

    Attributes:
        sizes: Size of each register in bytes.
        description: Description of the registers in XML.
    """

    def __init__(
        self, cpu: Any, architecture: str, feature: str, names: list[str], kinds: dict[str, str], pc: str, kind: str = "",
        absent: tuple[tuple[str, int, str], ...] = (),
    ):  # fmt: skip
        self._cpu, self._names, self._pc = cpu, names, pc
        rows = [*((name, 32, kinds.get(name, kind)) for name in names), *absent]
        self.sizes = tuple(bits // 8 for _, bits, _ in rows)
        xml = "".join(
            f'<reg name="{name}" bitsize="{bits}"{f" type={chr(34)}{type_}{chr(34)}" if type_ else ""}/>'
            for name, bits, type_ in rows
        )
        self.description = (
            '<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd"><target version="1.0"><architecture>'
            f'{architecture}</architecture><feature name="{feature}">{xml}</feature></target>'
        )

    def read(self, number: int) -> int:
        """Read a register.

        Args:
            number: Number of the register in GDB's order.

        Returns:
            Value of the register; 0 for one that the processor does not have.
        """
        if number >= len(self._names):
            return 0
        return int(
            self._cpu.get_program_counter()
            if self._names[number] == self._pc
            else self._cpu.get_register(self._names[number])
        )

    def write(self, number: int, value: int) -> None:
        """Write a register, unless the processor does not have it.

        Args:
            number: Number of the register in GDB's order.
            value: The new value.
        """
        if number >= len(self._names):
            return
        if self._names[number] == self._pc:
            self._cpu.set_program_counter(value)
        else:
            self._cpu.set_registers(**{self._names[number]: value})


def make_cortex_registers(cpu: Any) -> DebugRegisters:
    """Create the registers of a Cortex-M."""
    names = [*(f"r{n}" for n in range(13)), "sp", "lr", "pc", "xpsr"]
    return DebugRegisters(cpu, "arm", "org.gnu.gdb.arm.m-profile", names, {"sp": "data_ptr", "pc": "code_ptr"}, "pc")


def make_8086_registers(cpu: Any) -> DebugRegisters:
    """Create the registers of an 8086; eip is the linear address 16 * cs + ip, in which GDB counts memory, too."""
    floats = tuple((f"st{n}", 80, "i387_ext") for n in range(8))
    controls = tuple((f"f{name}", 32, "int") for name in "ctrl stat tag iseg ioff oseg ooff op".split())
    names = "eax ecx edx ebx esp ebp esi edi eip eflags cs ss ds es fs gs".split()
    kinds = {"eip": "code_ptr", "esp": "data_ptr"}
    return DebugRegisters(cpu, "i8086", "org.gnu.gdb.i386.core", names, kinds, "eip", "int", floats + controls)


class DebugServer:
    """GDB server of a processor on Unicorn; one debugger may connect in each run.

    Args:
        engine: The UnicornProcessor to debug.
        registers: Registers of the processor.
        port: TCP port.

    Attributes:
        is_halted: Whether the program is halted until the debugger continues it.
        is_single_step: Whether the program executes one instruction only, and halts again.
    """

    def __init__(self, engine: Any, registers: DebugRegisters, port: int):
        self._engine, self._registers, self._port = engine, registers, port
        self._socket: socket.socket | None = None
        self._received = b""
        self._acknowledges = True
        self._breakpoints: dict[int, int] = {}
        self._skipped: int | None = None  # breakpoint at which the program was halted, and from which it continues
        self._runs = threading.Event()
        self.is_halted, self.is_single_step, self._reported = True, False, True
        self._signal = TRAP
        self._commands: dict[str, Callable[[str], str]] = {
            "g": self._read_all_registers, "G": self._write_all_registers, "p": self._read_register, "P": self._write_register,
            "m": self._read_memory, "M": self._write_memory, "Z": self._set_breakpoint, "z": self._clear_breakpoint,
        }  # fmt: skip

    # --- calls of the engine ---

    def prepare_processor_run(self) -> None:
        """Wait for a debugger before the first run, and answer its commands while the program is halted."""
        if self._socket is None and self._port:
            self._accept_debugger()
        if self.is_halted:
            self._answer_commands()
        if self._socket is not None:
            address = self._engine.get_program_counter()
            self._skipped = address if address in self._breakpoints else None
            self._runs.set()

    def finish_processor_run(self) -> bool:
        """Handle a stop of the processor.

        Returns:
            Whether the debugger has stopped the processor, so that the caller need not look for another reason.
        """
        self._runs.clear()
        if self.is_single_step:
            self.is_single_step, self.is_halted, self._signal = False, True, TRAP
            return False
        return self.is_halted

    def report_failure(self) -> None:
        """Tell the debugger that the program cannot continue, and let it examine the program."""
        self._runs.clear()
        if self._socket is not None:
            self.is_halted, self._reported, self._signal = True, False, SEGMENTATION
            self._answer_commands()

    def report_end(self, code: int) -> None:
        """Tell the debugger that the program has ended, and close the connection.

        Args:
            code: Exit code of the program.
        """
        self._runs.clear()
        if self._socket is not None:
            self._send_packet(f"W{code & 0xFF:02x}")
            self._close_connection()

    # --- the connection ---

    def _accept_debugger(self) -> None:
        """Wait for a debugger to connect, and watch its connection for Ctrl-C."""
        with socket.create_server(("127.0.0.1", self._port)) as server:
            print(f"GDB: target remote 127.0.0.1:{self._port}", file=sys.stderr, flush=True)
            self._socket, _ = server.accept()
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._port = 0  # one debugger a run
        threading.Thread(target=self._watch_for_ctrl_c, args=(self._socket,), daemon=True).start()

    def _watch_for_ctrl_c(self, connection: socket.socket) -> None:
        """Stop the program when the debugger sends Ctrl-C or disconnects."""
        while self._socket is connection:
            if not self._runs.wait(POLL_INTERVAL_S):
                continue
            try:
                readable, _, _ = select.select([connection], [], [], POLL_INTERVAL_S)
                if readable and self._runs.is_set():
                    self._runs.clear()
                    self._halt(INTERRUPT)
            except (OSError, ValueError):
                return

    def _halt(self, signal: int) -> None:
        """Stop the processor, and halt the program for the debugger with a signal number."""
        self.is_halted, self._reported, self._signal = True, False, signal
        self._engine.uc.emu_stop()

    def _close_connection(self) -> None:
        """Close the debugger's connection, remove all breakpoints, and let the program continue."""
        if self._socket is not None:
            self._socket.close()
        self._socket, self.is_halted = None, False
        for address in list(self._breakpoints):
            self._remove_breakpoint(address)

    def _send_packet(self, text: str) -> None:
        """Send a packet with a text to the debugger."""
        if self._socket is not None:
            try:
                self._socket.sendall(f"${text}#{sum(text.encode()) & 0xFF:02x}".encode())
            except OSError:
                self._close_connection()

    def _receive_command(self) -> str | None:
        """Return the next command of GDB, CTRL_C, or None if the debugger has disconnected."""
        while self._socket is not None:
            self._received = self._received.lstrip(b"+-")
            if self._received.startswith(CTRL_C.encode()):
                self._received = self._received[1:]
                return CTRL_C
            if packet := re.match(rb"\$([^#]*)#..", self._received, re.S):
                self._received = self._received[packet.end() :]
                if self._acknowledges:
                    self._socket.sendall(b"+")
                return packet[1].decode("latin1")
            try:
                more = self._socket.recv(0x10000)
            except OSError:
                more = b""
            if not more:
                self._close_connection()
            self._received += more
        return None

    def _answer_commands(self) -> None:
        """Report the halt, and answer commands while the program is halted."""
        if not self._reported:
            self._send_packet(f"S{self._signal:02x}")
            self._reported = True
        while self.is_halted and (command := self._receive_command()) is not None:
            if command != CTRL_C and (reply := self._execute_command(command)) is not None:
                self._send_packet(reply)

    # --- commands ---

    def _execute_command(self, command: str) -> str | None:
        """Execute a command of GDB and return the reply, or None if there is no reply or it follows later."""
        kind, rest = command[:1], command[1:]
        if kind in "cs" or command.startswith("vCont;"):
            one = kind == "s" or command.startswith("vCont;s")
            self.is_halted, self.is_single_step, self._reported = False, one, False
            return None
        if kind == "k":
            self._close_connection()
            self._engine.end(0)
            return None
        if kind == "D":
            self._send_packet("OK")
            self._close_connection()
            return None
        if kind in "qQvH?T":
            return self._answer_query(command)
        try:
            return self._commands[kind](rest) if kind in self._commands else ""
        except (ValueError, IndexError, self._engine.error):
            return _ERROR_REPLY

    def _answer_query(self, command: str) -> str:
        """Return the reply to a query of GDB (q, Q, v, H, T) or to a question for the last signal (?)."""
        if command.startswith("qXfer:features:read:target.xml:"):
            at, size = _parse_range(command.rsplit(":", 1)[1])
            description = self._registers.description
            return ("m" if at + size < len(description) else "l") + description[at : at + size]
        if command == "QStartNoAckMode":
            self._acknowledges = False
            return "OK"
        if command.startswith("qSupported"):
            return f"PacketSize={MAX_READ_BYTES * 2:x};QStartNoAckMode+;qXfer:features:read+;vContSupported+"
        if command == "?":
            return f"S{self._signal:02x}"
        return _REPLIES.get(command, "OK" if command[0] in "HT" else "")

    def _read_all_registers(self, _rest: str) -> str:
        """Return all registers of the processor in hexadecimal (GDB command g)."""
        return "".join(self._format_register(n) for n in range(len(self._registers.sizes)))

    def _write_all_registers(self, rest: str) -> str:
        """Write all registers of the processor (GDB command G)."""
        for n, size in enumerate(self._registers.sizes):
            self._registers.write(n, int.from_bytes(bytes.fromhex(rest[: 2 * size]), "little"))
            rest = rest[2 * size :]
        return "OK"

    def _read_register(self, rest: str) -> str:
        """Return a register of the processor in hexadecimal (GDB command p)."""
        return self._format_register(int(rest, 16))

    def _write_register(self, rest: str) -> str:
        """Write a register of the processor (GDB command P)."""
        number, value = rest.split("=")
        self._registers.write(int(number, 16), int.from_bytes(bytes.fromhex(value), "little"))
        return "OK"

    def _format_register(self, n: int) -> str:
        """Return a register in hexadecimal, the lowest byte first."""
        size = self._registers.sizes[n]
        return (self._registers.read(n) & (1 << 8 * size) - 1).to_bytes(size, "little").hex()

    def _read_memory(self, rest: str) -> str:
        """Return memory in hexadecimal (GDB command m), or an error for a memory window of the board."""
        at, size = _parse_range(rest)
        if self._engine.overlaps_window(at, size):
            return _ERROR_REPLY
        return bytes(self._engine.uc.mem_read(at, min(size, MAX_READ_BYTES))).hex()

    def _write_memory(self, rest: str) -> str:
        """Write memory (GDB command M), or return an error for a memory window of the board."""
        where, content = rest.split(":")
        at, size = _parse_range(where)
        if self._engine.overlaps_window(at, size):
            return _ERROR_REPLY
        self._engine.uc.mem_write(at, bytes.fromhex(content))
        return "OK"

    def _set_breakpoint(self, rest: str) -> str:
        """Set a breakpoint (GDB command Z)."""
        kind, address = rest.split(",")[:2]
        at = int(address, 16)
        if kind not in "01":
            return ""
        if at not in self._breakpoints:
            self._breakpoints[at] = self._engine.hook_address(at, self._halt_at_breakpoint)
        return "OK"

    def _clear_breakpoint(self, rest: str) -> str:
        """Clear a breakpoint (GDB command z)."""
        kind, address = rest.split(",")[:2]
        if kind not in "01":
            return ""
        self._remove_breakpoint(int(address, 16))
        return "OK"

    def _remove_breakpoint(self, address: int) -> None:
        """Remove the breakpoint at an address, if there is one."""
        if address in self._breakpoints:
            self._engine.uc.hook_del(self._breakpoints.pop(address))

    def _halt_at_breakpoint(self, _uc: Any, address: int, size: int, _user: Any) -> None:
        """Halt the program before the instruction at a breakpoint, unless the program continues from there."""
        skipped, self._skipped = self._skipped, None
        if address == skipped or address not in self._breakpoints:
            return
        self._engine.uncount_instruction(size)
        self.is_single_step = False
        self._halt(TRAP)


def _parse_range(text: str) -> tuple[int, int]:
    """Return address and size in a text of GDB such as "1000,20", both in hexadecimal."""
    at, size = (int(part, 16) for part in text.split(","))
    return at, size
