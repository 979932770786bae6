"""AVR programs on simavr, whose library is opened at run time: it is under the GPL, no part of this package, and not linked to it.

simavr's functions are used, not its structures, which change between versions. Three numbers have none: clock, state and program
counter; they are found next to the addresses of functions that simavr puts beside them.
"""

from __future__ import annotations

import ctypes
import re
import struct
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stage.board.board import Board
from stage.board.bus import requests
from stage.board.crash_report import IS_SUPPORTED
from stage.board.errors import HostError, LibraryError
from stage.errors import StageError
from stage.native import address_of, array_at
from stage.targets import avr as hot
from stage.targets.elf import AVR, Elf, check_avr, read_mmcu
from stage.targets.mcus import simavr
from stage.targets.pins import Pins

HOW = "avr-gcc -mmcu={mcu} -Os -g firmware.c -o firmware.elf"
USUAL_HZ = 16_000_000
QUANTUM, LATENCY = 50e-6, 2e-6
"""s between two looks at the clock; with an interrupt line, between two looks at that."""
EEPROM, MEMORY = 0x810000, 0x800000
TEXT = 256  # bytes of a line over UART
PIN_ALL, DIRECTION_ALL = 8, 9
UART_OUTPUT = 1
STOPPED, DONE, CRASHED = 1, 6, 7
_BEGIN_HZ = 1_000_000  # what simavr begins with
_LOOKED_AT = 512  # bytes at the begin of an avr_t
_PC_BEHIND_SLEEP = 36
_ERROR = 2
_CLOCK_TAG = 2
_ENDS = ("Invalid Opcode", "WATCHDOG: timer fired", "Resetting")
"""Messages after which simavr goes on, and a run does not."""
_WORDS = (
    ("Invalid Opcode", "an instruction that this AVR does not have"),
    ("Invalid write", "a wild write"),
    ("Invalid read", "a wild read"),
    ("interrupts off", "it sleeps for ever, with interrupts off"),
    ("WATCHDOG: timer fired", "the watchdog has come: nobody reset it in time"),
    ("sadly_crashed", "the program counter has left the code"),
)
NO_WAKE = "it sleeps for ever: no interrupt is enabled that could wake it"
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_PC = re.compile(r"PC=([0-9a-f]{4,})|\*\*\* ([0-9a-f]{4,}):")
_LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p)
_NOTHING = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint32)
_BIND = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_uint32)
_MALLOC = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t)
_CALLOC = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
_ADDRESSES = 1 << 24  # bytes that an address of an AVR reaches, with RAMPZ before Z


class _Eeprom(ctypes.Structure):
    """avr_eeprom_desc_t."""

    _fields_ = (("content", ctypes.c_char_p), ("offset", ctypes.c_uint16), ("size", ctypes.c_uint32))


def _ioctl(text: str) -> int:
    return int.from_bytes(text.encode(), "big")


@dataclass(frozen=True)
class AvrProgram:
    """An ELF program for an AVR. hz: its clock, or None: what its .mmcu section says, or 16 MHz. gdb: TCP port of a GDB server."""

    path: Path
    mcu: str
    pins: Pins
    hz: int | None
    gdb: int | None

    def load(self, board: Board, isolated: bool) -> LoadedAvr:
        """See stage.board.thread_runner. Raises NoEmulatorError, LibraryError, FileError."""
        return LoadedAvr(self, board, isolated)


class _Library:
    """simavr, whose messages come to us. In a process of its own also its output, its memory and its server for GDB are changed."""

    one: _Library | None = None

    def __init__(self, isolated: bool) -> None:
        self.c = simavr()
        self.said: list[tuple[int, str]] = []
        self.runs: Any = None  # the AVR record of what runs
        self.gdb_port = 0
        self._reserves = {"malloc": 0, "calloc": 0}
        libc = ctypes.CDLL(None)
        libc.calloc.restype, libc.calloc.argtypes = ctypes.c_void_p, (ctypes.c_size_t, ctypes.c_size_t)
        room = ctypes.create_string_buffer(1024)

        def logged(_avr: int, level: int, text: bytes, arguments: int) -> None:
            libc.vsnprintf(room, len(room), text, ctypes.c_void_p(arguments))
            said = _COLOUR.sub("", room.value.decode(errors="replace")).strip()
            self.said.append((level, said))
            if self.runs is not None and any(key in said for key in _ENDS):
                self.runs.ended = 1

        def bind(socket: int, address: int, size: int) -> int:
            """simavr's server listens on all interfaces, and its port is in a structure."""
            family = ctypes.string_at(address, 2)
            given = family + struct.pack("!H", self.gdb_port) + bytes((127, 0, 0, 1)) + bytes(8)
            return int(libc.bind(socket, given, size))

        def reserved(name: str, size: int) -> int | None:
            room, self._reserves[name] = self._reserves[name], 0
            return libc.calloc(1, size + room)

        self._logger, self.no_op = _LOGGER(logged), _NOTHING(lambda _: 0)
        self.is_redirected = isolated and IS_SUPPORTED
        if self.is_redirected:
            from stage.board.isolation.traps import redirect_calls

            self._functions = {
                **dict.fromkeys(("printf", "__printf_chk", "puts", "putchar"), self.no_op), "bind": _BIND(bind),
                "malloc": _MALLOC(lambda size: reserved("malloc", size)),
                "calloc": _CALLOC(lambda count, size: reserved("calloc", count * size)),
            }  # fmt: skip
            redirect_calls(self.c._handle, self._functions)
        self.c["avr_global_logger_set"](self._logger)
        self.make, self.getirq = self.c["avr_make_mcu_by_name"], self.c["avr_io_getirq"]
        self.make.restype = self.getirq.restype = ctypes.c_void_p

    def init(self, avr: int) -> None:
        """avr_init, with room behind the flash and the RAM, which it allocates first: simavr says that a write is wild, and then
        does it, to whatever lies there."""
        self._reserves = dict.fromkeys(self._reserves, _ADDRESSES)
        self.c["avr_init"](ctypes.c_void_p(avr))
        self._reserves = dict.fromkeys(self._reserves, 0)

    def address(self, name: str) -> int:
        return ctypes.cast(self.c[name], ctypes.c_void_p).value or 0


def _library(isolated: bool) -> _Library:
    if _Library.one is None:
        _Library.one = _Library(isolated)
    return _Library.one


class LoadedAvr:
    """See stage.board.thread_runner."""

    def __init__(self, program: AvrProgram, board: Board, isolated: bool):
        self.path, self._board, self._gdb = program.path, board, program.gdb
        how = HOW.format(mcu=program.mcu)
        self._elf = Elf(program.path, AVR, program.mcu, how)
        check_avr(self._elf, program.mcu, how)
        self._simavr = _library(isolated)
        if program.gdb and not self._simavr.is_redirected:
            raise StageError(
                f"gdb={program.gdb}: the server of simavr needs a process of its own on 64-bit Linux (isolated=True)."
            )
        self._simavr.said.clear()
        self._avr = self._simavr.make(program.mcu.encode())
        if not self._avr:
            raise StageError(f"this version of simavr does not know the {program.mcu}.")
        self._simavr.init(self._avr)
        hz = program.hz or self._clock_of_elf() or USUAL_HZ
        self._pc = self._find(hz)
        self._vectors = Vectors(self._simavr.c, self._avr, _flash_of(self._avr))
        self._load_content()
        self._c("avr_reset")
        self._connect(program.pins, hz)

    def _c(self, name: str, *given: Any) -> Any:
        return self._simavr.c[name](ctypes.c_void_p(self._avr), *given)

    def _clock_of_elf(self) -> int:
        """Hz by AVR_MCU(...) of simavr's header, or 0."""
        return int.from_bytes(read_mmcu(self._elf).get(_CLOCK_TAG, b"")[:4], "little")

    def _find(self, hz: int) -> int:
        """Set the clock; where the program counter lies, or 0."""
        head: Any = array_at(self._avr, _LOOKED_AT, np.dtype("u1"))
        words, pointers = head.view("<u4"), head.view("<u8")
        clock = [k for k in range(8, 40) if words[k] == _BEGIN_HZ]
        sleep = [k for k in range(len(pointers)) if pointers[k] == self._simavr.address("avr_callback_sleep_raw")]
        if len(clock) != 1 or len(sleep) != 1:
            raise StageError(
                "this version of simavr is not known (its avr_t is laid out in another way): 1.6 and 1.7 are."
            )
        words[clock[0]] = hz
        pointers[sleep[0]] = ctypes.cast(self._simavr.no_op, ctypes.c_void_p).value  # it would sleep in real time
        self._state = words[clock[0] - 1 : clock[0]]
        self._state_at = int(self._avr) + 4 * (clock[0] - 1)
        return int(self._avr) + sleep[0] * 8 + _PC_BEHIND_SLEEP

    def _load_content(self) -> None:
        room, begin = _flash_of(self._avr), b""
        for segment in self._elf.segments:
            if segment.used_at >= EEPROM + 0x10000:
                continue  # fuses, and what is said to simavr
            content = segment.content
            if segment.used_at >= EEPROM:
                given = _Eeprom(content, segment.used_at - EEPROM, len(content))
                self._c("avr_ioctl", _ioctl("eesp"), ctypes.byref(given))
            elif segment.at + len(content) > room:
                raise LibraryError(
                    f"{self.path} has code up to {segment.at + len(content):X}h, and the flash ends at {room:X}h: it was linked "
                    "for another AVR?"
                )
            else:
                self._c("avr_loadcode", content, len(content), segment.at)
                begin = begin if segment.at else content
        self._no_routine = self._vectors.guard(begin)

    def _connect(self, pins: Pins, hz: int) -> None:
        """The pins are the board's bus."""
        link, library = self._board.link, self._simavr
        ports = len(hot.PORTS)
        self._levels, self._outputs = np.zeros(ports, "i8"), np.zeros(ports, "i8")
        self._pins = np.array([p or (hot.NO_PIN, 0) for p in (pins.cs, pins.wr, pins.rd, *pins.address)], hot.PIN)
        self._data = np.array([self._irq(pins.data, bit) for bit in range(8)], "i8")
        self._fight = ctypes.create_string_buffer(
            f"port {hot.PORTS[pins.data]} has output pins while /RD is low: AVR and board both drive the data lines".encode()
        )
        self._row = np.zeros(1, hot.AVR)
        t = self.record = self._row[0]
        t.own, t.avr, t.host, t.request = self._row.ctypes.data, self._avr, link.pointer, requests.request.address
        for name in ("run", "raise_irq"):
            t[name] = library.address(f"avr_{name}")
        t.status, t.look = library.address("avr_cycle_timer_status"), library.address("avr_core_watch_read")
        t.hz, t.watched, t.pc = hz, pins.irq is not None, self._pc
        t.quantum = max(1, round((LATENCY if pins.irq else QUANTUM) * hz))
        t.stop = self._elf.symbols.get("__stop_program", self._elf.symbols.get("_exit", -1))
        t.line_irq = self._irq(*pins.irq) if pins.irq else 0
        t.select, t.write, t.read, t.addresses = (self._pins.ctypes.data + k * hot.PIN.itemsize for k in range(4))
        t.n_addresses, t.data_port, t.data_irqs = len(pins.address), pins.data, self._data.ctypes.data
        t.first = min(place.first for place in self._board.places) if pins.base is None else pins.base
        t.levels, t.outputs, t.fight = (
            self._levels.ctypes.data,
            self._outputs.ctypes.data,
            ctypes.addressof(self._fight),
        )
        t.was_write, t.state, t.is_enabled = 1, self._state_at, library.address("avr_is_interrupt_enabled")
        t.vectors, t.n_vectors = self._vectors.addresses.ctypes.data, len(self._vectors.addresses)
        self._functions = [hot.levels_changed.pointer, hot.outputs_changed.pointer, hot.tick.pointer, hot.sent.pointer]
        t.timer = ctypes.cast(self._functions[2], ctypes.c_void_p).value
        used = sorted({pins.data, *(p[0] for p in (pins.cs, pins.wr, pins.rd, *pins.address) if p)})
        self._ports = np.array([(t.own, port) for port in used], hot.PORT)
        for k, port in enumerate(used):
            for number, function in ((PIN_ALL, self._functions[0]), (DIRECTION_ALL, self._functions[1])):
                self._notify(self._irq(port, number), function, self._ports[k : k + 1])
        if pins.irq:
            library.c["avr_raise_irq"](ctypes.c_void_p(int(t.line_irq)), 1)
        self._hear()

    def _irq(self, port: int, number: int) -> int:
        found = self._simavr.getirq(ctypes.c_void_p(self._avr), _ioctl("iog" + hot.PORTS[port]), number)
        if not found:
            raise StageError(f"--map: this AVR has no port {hot.PORTS[port]}.")
        return int(found)

    def _notify(self, irq: int, function: Any, row: np.ndarray) -> None:
        self._simavr.c["avr_irq_register_notify"](
            ctypes.c_void_p(irq), ctypes.cast(function, ctypes.c_void_p), ctypes.c_void_p(address_of(row))
        )

    def _hear(self) -> None:
        """What the program sends over its serial lines is the log."""
        self._texts, self._serials = [], []
        for name in "0123":
            irq = self._simavr.getirq(ctypes.c_void_p(self._avr), _ioctl("uar" + name), UART_OUTPUT)
            if irq:
                flags = ctypes.c_uint32(0)
                self._c("avr_ioctl", _ioctl("uas" + name), ctypes.byref(flags))
                text = ctypes.create_string_buffer(TEXT)
                row = np.array([(self.record.own, ctypes.addressof(text), TEXT, 0)], hot.SERIAL)
                self._texts.append(text)
                self._serials.append(row)
                self._notify(irq, self._functions[3], row)

    # --- it runs ---

    def main(self) -> int:
        """See stage.board.thread_runner."""
        t = self.record
        t.begin = self._board.stage.now
        t.when = t.quantum
        self._c(
            "avr_cycle_timer_register", ctypes.c_uint64(int(t.quantum)), self._functions[2], ctypes.c_void_p(int(t.own))
        )
        if self._gdb:
            self._simavr.gdb_port = self._gdb
            self._state[0] = STOPPED
            print(f"GDB: target remote 127.0.0.1:{self._gdb}", file=sys.stderr, flush=True)
            self._c("avr_gdb_init")
        self._simavr.runs = t
        hot.run.c(t.own)
        self._simavr.runs = None
        if t.asleep == hot.NOTHING_WAKES:
            self._simavr.said.append((_ERROR, NO_WAKE))
        elif t.ended and not any(key in text for _, text in self._simavr.said for key in _ENDS):
            return int(np.int64(t.code).astype(np.int16))
        raise HostError(self._what())

    def _what(self) -> str:
        """What has ended it."""
        errors = [text for level, text in self._simavr.said if level <= _ERROR or any(key in text for key, _ in _WORDS)]
        said = errors[-1] if errors else "simavr has stopped it"
        pc = int(array_at(self._pc, 1, np.dtype("u4"))[0])
        for text in errors:
            if found := _PC.search(text):
                pc, said = int(found[1] or found[2], 16), text
                break
        if pc == self._no_routine:
            words = "no routine in the program: it would begin again with its memory as it is"
            return self._error(f"{self._vectors.come()} has come and has {words}", self._vectors.interrupted())
        for key, words in _WORDS:
            if key in said:
                said = f"{words} ({said})"
        return self._error(said, pc)

    def _error(self, said: str, pc: int) -> str:
        board = self._board
        return (
            f"{self.path.name}: {said}, at {self._elf.where(pc)}; at {board.stage.time:.6f} s, after {board.cycles:,} bus cycles. "
            f"{board.trace.ending(12)}"
        )

    def close(self) -> None:
        """See stage.board.thread_runner."""
        if self._avr:
            self._c("avr_terminate")
            self._avr = 0


def _flash_of(avr: int) -> int:
    """Bytes of flash."""
    return int(array_at(avr + 12, 1, np.dtype("u4"))[0]) + 1


NO_INSTRUCTION = b"\x07\x00"
_JMP, _RJMP = 0x940C, 0xC000
_BEFORE = (16, 24)
"""Bytes of an avr_int_vector_t in front of its IRQs: simavr 1.6 and 1.7 by the size of a regbit. The first is its number."""
_MOST = 128
_IRQ, _VALUE = 40, 20
"""Bytes of an avr_irq_t, and where the value stands in it."""
_STACK_POINTER = 0x5D
_ONE_WORD = 8192
"""Up to this size of the flash (bytes) a vector is one word."""
_THREE_BYTES = 0x20000
"""Above this size a return address has three bytes."""


class Vectors:
    """c: simavr's library; avr: the avr_t; flash: its bytes of flash.

    Attributes: addresses: of the avr_int_vector_t of each interrupt; none where this version of simavr is not known.
    """

    def __init__(self, c: Any, avr: int, flash: int):
        self._c, self._avr, self._flash = c, avr, flash
        get = c["avr_get_interrupt_irq"]
        get.restype = ctypes.c_void_p
        irqs = {n: at for n in range(1, _MOST) if (at := get(ctypes.c_void_p(avr), ctypes.c_uint8(n)))}
        self.addresses = np.zeros(0, "i8")
        self._running = {n: at + _IRQ + _VALUE for n, at in irqs.items()}
        for before in _BEFORE:
            if all(array_at(at - before, 1, np.dtype("u1"))[0] == n for n, at in irqs.items()):
                self.addresses = np.array([at - before for at in irqs.values()], "i8")
                break

    def guard(self, code: bytes) -> int:
        """The address to which the vectors without routines lead, in code that begins at 0; -1 if there is none. From now on the
        instruction there ends the run."""
        size = 2 if self._flash <= _ONE_WORD else 4
        targets = {_target(code, n * size, self._flash) for n in self._running}
        for place in sorted(targets):
            if place > 0 and _target(code, place, self._flash) == 0:
                self._c["avr_loadcode"](ctypes.c_void_p(self._avr), NO_INSTRUCTION, 2, place)
                return place
        return -1

    def come(self) -> str:
        """The interrupt whose routine is to run, by its name in avr-libc; "" if it is not known."""
        found = [n for n, at in self._running.items() if array_at(at, 1, np.dtype("u4"))[0]]
        return f"interrupt {found[0]} (__vector_{found[0]})" if found else "an interrupt"

    def interrupted(self) -> int:
        """The address that the routine would return to."""
        look = self._c["avr_core_watch_read"]

        def byte(at: int) -> int:
            return int(look(ctypes.c_void_p(self._avr), ctypes.c_uint16(at))) & 0xFF

        stack = byte(_STACK_POINTER) | byte(_STACK_POINTER + 1) << 8
        size = 3 if self._flash > _THREE_BYTES else 2
        return 2 * sum(byte(stack + 1 + k) << 8 * (size - 1 - k) for k in range(size))


def _target(code: bytes, at: int, flash: int) -> int:
    """Where the jump at an address leads, or -1 if there is none."""
    words = np.frombuffer(code[at : at + 4].ljust(4, b"\0"), "<u2")
    if words[0] & 0xFE0E == _JMP:
        return 2 * (int(words[0] & 0x01F0) << 13 | int(words[0] & 1) << 16 | int(words[1]))
    if words[0] & 0xF000 == _RJMP:
        distance = int(words[0] & 0xFFF)
        return (at + 2 + 2 * (distance - (distance >> 11 << 12))) % flash
    return -1
