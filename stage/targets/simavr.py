"""AVR programs on simavr. The library of simavr, which is under the GPL, is opened at run time; it is neither part of this package
nor linked.

The module uses simavr's functions. Values without a function, such as clock and program counter, are read from simavr's structures:
`simavr_structure_offsets` knows their offsets, and refuses a version of simavr with other offsets.
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
from stage.board.bus import host_requests
from stage.board.crash_report import IS_SUPPORTED
from stage.board.errors import HostError, LibraryError
from stage.board.pin_assignment import PinLine, WiringFinding
from stage.errors import StageError
from stage.native import address_of, array_at, get_function_address
from stage.targets import avr_clock_and_pins, avr_uart, simavr_structure_offsets, supported_processors
from stage.targets.avr_bus_wiring import AvrBus, BusPins, encode_ioctl_request
from stage.targets.avr_step_dir_pins import AvrLines
from stage.targets.avr_uart import AvrUart
from stage.targets.elf import AVR, Elf, check_avr, read_mmcu
from stage.targets.simavr_register_handlers import SimavrRegisterHandlers

BUILD_COMMAND = "avr-gcc -mmcu={mcu} -Os -g firmware.c -o firmware.elf"
DEFAULT_HZ = 16_000_000
QUANTUM_S, SWITCH_QUANTUM_S, LINE_QUANTUM_S = 50e-6, 10e-6, 2e-6
"""Time between two ticks; with an interrupt line, which is polled in each."""
UNCHECKED_RUN_CYCLES = 100
EXTERNAL_INTERRUPT_COUNT = 8
ANALOG_INPUT_COUNT = 8
EEPROM, MEMORY = 0x810000, 0x800000
STOPPED, DONE, CRASHED = 1, 6, 7
_ANALOG_MODES, _ANALOG_INPUT, _INPUT_NUMBER = 64, 2, 19
"""The multiplexer of the ADC as avr_adc_mux_t: its modes; the mode of a single input, and where its number stands."""
_ERROR_LOG_LEVEL = 2
_CLOCK_TAG = 2
_FATAL_MESSAGES = ("Invalid Opcode", "WATCHDOG: timer fired", "Resetting")
"""Parts of messages after which simavr goes on, and a run does not."""
_MESSAGE_EXPLANATIONS = (
    ("Invalid Opcode", "an instruction that this AVR does not have"),
    ("Invalid write", "a wild write"),
    ("Invalid read", "a wild read"),
    ("interrupts off", "it sleeps for ever, with interrupts off"),
    ("WATCHDOG: timer fired", "the watchdog has come: nobody reset it in time"),
    ("sadly_crashed", "the program counter has left the code"),
)
SLEEPS_FOR_EVER = "it sleeps for ever: no interrupt is enabled that could wake it"
_COLOR_PATTERN = re.compile(r"\x1b\[[0-9;]*m")
_PC_PATTERN = re.compile(r"PC=([0-9a-f]{4,})|\*\*\* ([0-9a-f]{4,}):")
_LOG_FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p)
_NO_OP_FUNCTION_TYPE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint32)
_BIND_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_uint32)
_MALLOC_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t)
_CALLOC_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
_ADDRESS_SPACE = 1 << 24  # bytes that an address of an AVR reaches, with RAMPZ before Z


class _Eeprom(ctypes.Structure):
    """Structure avr_eeprom_desc_t of simavr."""

    _fields_ = (("content", ctypes.c_char_p), ("offset", ctypes.c_uint16), ("size", ctypes.c_uint32))


@dataclass(frozen=True)
class AvrProgram:
    """ELF program for an AVR.

    Attributes:
        path: The file.
        mcu: Name of the AVR.
        pins: Pins of its bus; None: it has no bus.
        lines: STEP/DIR and switch lines of axes that are connected to its pins.
        hz: Clock, Hz; None: that of the program's .mmcu section, or 16 MHz.
        gdb: TCP port of a GDB server, or None.
    """

    path: Path
    mcu: str
    pins: BusPins | None
    lines: tuple[PinLine, ...]
    hz: int | None
    gdb: int | None

    def load(self, board: Board, isolated: bool) -> LoadedAvr:
        """Load a copy of the program. Raises NoEmulatorError, LibraryError or FileError."""
        return LoadedAvr(self, board, isolated)


class _Library:
    """Library of simavr, loaded once in a process, whose messages go to this module.

    In the process of an isolated firmware, its output, memory allocation and GDB server are redirected, too.

    Attributes:
        instance: The only object of this class, or None before the first use.
        library: The library as a ctypes object.
        messages: Level and text of each message.
        running_record: AVR record of the running program, or None.
        run_cycles: simavr's run_cycle_count and run_cycle_limit: the cycles that it runs without a check.
        gdb_port: TCP port of simavr's GDB server.
    """

    instance: _Library | None = None

    def __init__(self, isolated: bool) -> None:
        self.library = supported_processors.load_simavr()
        self.messages: list[tuple[int, str]] = []
        self.running_record: Any = None
        self.run_cycles = np.zeros(2, "u8")
        self.gdb_port = 0
        self._reserves = {"malloc": 0, "calloc": 0}
        self._libc = libc = ctypes.CDLL(None)
        libc.calloc.restype, libc.calloc.argtypes = ctypes.c_void_p, (ctypes.c_size_t, ctypes.c_size_t)
        self._text = ctypes.create_string_buffer(1024)
        self._logger, self.no_op = _LOG_FUNCTION(self._store_message), _NO_OP_FUNCTION_TYPE(lambda _: 0)
        self.is_redirected = isolated and IS_SUPPORTED
        if self.is_redirected:
            from stage.board.isolation.traps import redirect_calls

            self._functions = {
                **dict.fromkeys(("printf", "__printf_chk", "puts", "putchar"), self.no_op),
                "bind": _BIND_FUNCTION(self._bind_gdb_server),
                "malloc": _MALLOC_FUNCTION(lambda size: self._allocate_with_reserve("malloc", size)),
                "calloc": _CALLOC_FUNCTION(lambda count, size: self._allocate_with_reserve("calloc", count * size)),
            }  # fmt: skip
            redirect_calls(self.library._handle, self._functions)
        self.library["avr_global_logger_set"](self._logger)
        self.make_avr, self.get_irq = self.library["avr_make_mcu_by_name"], self.library["avr_io_getirq"]
        self.make_avr.restype = self.get_irq.restype = ctypes.c_void_p

    def _store_message(self, _avr: int, level: int, text: bytes, arguments: int) -> None:
        """Store a message of simavr. simavr calls this."""
        self._libc.vsnprintf(self._text, len(self._text), text, ctypes.c_void_p(arguments))
        message = _COLOR_PATTERN.sub("", self._text.value.decode(errors="replace")).strip()
        self.messages.append((level, message))
        if self.running_record is not None and any(key in message for key in _FATAL_MESSAGES):
            self.running_record.ended = 1
            self.run_cycles[0] = 0  # no further instruction

    def _bind_gdb_server(self, socket: int, address: int, size: int) -> int:
        """Bind simavr's GDB server, which would listen on all interfaces, to 127.0.0.1 and the chosen port."""
        ours = ctypes.string_at(address, 2) + struct.pack("!H", self.gdb_port) + bytes((127, 0, 0, 1)) + bytes(8)
        return int(self._libc.bind(socket, ours, size))

    def _allocate_with_reserve(self, name: str, size: int) -> int | None:
        """Allocate memory for simavr by its function `name`, with reserve space behind it."""
        room, self._reserves[name] = self._reserves[name], 0
        return self._libc.calloc(1, size + room)

    def init_avr(self, avr: int) -> None:
        """Call avr_init, and allocate flash and RAM with reserve space behind them.

        simavr reports a write beyond the end of a memory, but executes it nevertheless.

        Args:
            avr: Address of the avr_t.
        """
        self._reserves = dict.fromkeys(self._reserves, _ADDRESS_SPACE)
        self.library["avr_init"](ctypes.c_void_p(avr))
        self._reserves = dict.fromkeys(self._reserves, 0)

    def get_size(self, avr: int) -> int:
        """Return the size of the memory that simavr has allocated for an avr_t and its peripherals, bytes; 0 if unknown."""
        if not hasattr(self._libc, "malloc_usable_size"):
            return 0
        self._libc.malloc_usable_size.restype = ctypes.c_size_t
        return int(self._libc.malloc_usable_size(ctypes.c_void_p(avr)))

    def find_function_address(self, name: str) -> int:
        """Return the address of a function of the library by its name."""
        return get_function_address(self.library[name])


def _open_library(isolated: bool) -> _Library:
    """Return the library of simavr; open it at the first call."""
    if _Library.instance is None:
        _Library.instance = _Library(isolated)
    return _Library.instance


class LoadedAvr:
    """AVR program loaded into simavr.

    Attributes:
        record: AVR record of the processor.
        mcu: Name of the processor.
        bus_pins: Port and bit of each pin of its bus.
    """

    def __init__(self, program: AvrProgram, board: Board, isolated: bool):
        self.mcu, self.bus_pins = program.mcu, program.pins.list_all() if program.pins else set()
        self.path, self._board, self._gdb = program.path, board, program.gdb
        how = BUILD_COMMAND.format(mcu=program.mcu)
        self._elf = Elf(program.path, AVR, program.mcu, how)
        check_avr(self._elf, program.mcu, how)
        self._simavr = _open_library(isolated)
        if program.gdb and not self._simavr.is_redirected:
            raise StageError(
                f"gdb={program.gdb}: the server of simavr needs a process of its own on 64-bit Linux (isolated=True)."
            )
        self._simavr.messages.clear()
        simavr_structure_offsets.check_layout(self._simavr.library)
        self._avr = self._simavr.make_avr(program.mcu.encode())
        if not self._avr:
            raise StageError(f"this version of simavr does not know the {program.mcu}.")
        self._simavr.init_avr(self._avr)
        hz = program.hz or self._read_clock() or DEFAULT_HZ
        self._set_clock(hz)
        self._vectors = InterruptVectors(self._simavr.library, self._avr, _read_flash_size(self._avr))
        self._disconnect_upper_analog_inputs()
        self._load_segments()
        self._call_library("avr_reset")
        self._overlay = SimavrRegisterHandlers(self._simavr.library, self._avr)
        self._has_lines = bool(program.lines)
        irq = program.pins.irq if program.pins else None
        self._make_record(irq, hz)
        self._bus = AvrBus(program.pins, self, board) if program.pins else None
        if irq:
            self.raise_irq(int(self.record.line_irq), 1)
        self._skip_needless_checks()
        drives_lines = any("step" in chip.INPUTS for chip in board.stage.chips)
        self._lines = AvrLines(program.lines, self, board) if drives_lines else None
        self._connect_uarts_to_log_and_board()

    def _call_library(self, name: str, *arguments: Any) -> Any:
        """Call a function of simavr for this AVR."""
        return self._simavr.library[name](ctypes.c_void_p(self._avr), *arguments)

    def _read_clock(self) -> int:
        """Return the clock from AVR_MCU(...) of simavr's header, Hz, or 0."""
        return int.from_bytes(read_mmcu(self._elf).get(_CLOCK_TAG, b"")[:4], "little")

    def _set_clock(self, hz: int) -> None:
        """Set the clock in Hz, keep simavr from sleeping in real time, and find the fields of the avr_t that this class reads."""
        row = simavr_structure_offsets.view_structure(self._avr, simavr_structure_offsets.AVR_T)
        row["hz"], row["sleep"] = hz, get_function_address(self._simavr.no_op)
        at = {
            name: self._avr + simavr_structure_offsets.get_offset(simavr_structure_offsets.AVR_T, name)
            for name in row.dtype.names
        }
        self._pc, self._state_at, self._wait_at = at["pc"], at["state"], at["interrupt_wait"]
        self._state = array_at(self._state_at, 1, np.dtype("u4"))
        self._run_cycles = array_at(at["cycles_left"], 2, np.dtype("u8"))

    def _skip_needless_checks(self) -> None:
        """Turn off checks that simavr would make after each instruction without any effect.

        Between two timer events, simavr then runs UNCHECKED_RUN_CYCLES instructions without a check,
        unless GDB needs one after each. A low
        pin of an
        external interrupt, which simavr would poll in each cycle even if the interrupt is disabled, interrupts at its edge. Only
        the
        interrupt line of the board, which is high at this moment, remains level-sensitive.
        """
        if not self._gdb:
            self._run_cycles[1] = UNCHECKED_RUN_CYCLES
        for number in range(EXTERNAL_INTERRUPT_COUNT):
            irq = self._simavr.get_irq(ctypes.c_void_p(self._avr), encode_ioctl_request("int "), number)
            if irq and not array_at(int(irq) + _VALUE, 1, np.dtype("u4"))[0]:
                self._call_library("avr_extint_set_strict_lvl_trig", ctypes.c_uint8(number), ctypes.c_uint8(0))

    def _disconnect_upper_analog_inputs(self) -> None:
        """Let the analog inputs from 8 on read 0, like the others. simavr has values for only eight, and would read beyond them."""
        words: Any = array_at(self._avr, self._simavr.get_size(self._avr) // 8, np.dtype("u8"))
        inputs = (_ANALOG_INPUT | np.arange(ANALOG_INPUT_COUNT) << _INPUT_NUMBER).astype("u8")
        for at in np.flatnonzero(words == inputs[0]):
            modes = words[at : at + _ANALOG_MODES]
            if np.array_equal(modes[:ANALOG_INPUT_COUNT], inputs):
                modes[(modes & ((1 << _INPUT_NUMBER) - 1) == _ANALOG_INPUT) & (modes > inputs[-1])] = 0

    def _load_segments(self) -> None:
        """Load the program's segments into flash, RAM and EEPROM."""
        room, begin = _read_flash_size(self._avr), b""
        for segment in self._elf.segments:
            if segment.used_at >= EEPROM + 0x10000:
                continue  # fuses, and messages to simavr
            content = segment.content
            if segment.used_at >= EEPROM:
                description = _Eeprom(content, segment.used_at - EEPROM, len(content))
                self._call_library("avr_ioctl", encode_ioctl_request("eesp"), ctypes.byref(description))
            elif segment.at + len(content) > room:
                raise LibraryError(
                    f"{self.path} has code up to {segment.at + len(content):X}h, and the flash ends at {room:X}h: it was linked "
                    "for another AVR?"
                )
            else:
                self._call_library("avr_loadcode", content, len(content), segment.at)
                begin = begin if segment.at else content
        self._missing_routine_at = self._vectors.end_run_at_missing_routines(begin)

    def _make_record(self, irq: tuple[int, int] | None, hz: int) -> None:
        """Create the AVR record. `irq` is the pin of the interrupt line, or None."""
        link, library = self._board.link, self._simavr
        self._row = np.zeros(1, avr_clock_and_pins.AVR)
        t = self.record = self._row[0]
        t.own, t.avr, t.host, t.request = self._row.ctypes.data, self._avr, link.pointer, host_requests.request.address
        t.run, t.raise_irq = library.find_function_address("avr_run"), library.find_function_address("avr_raise_irq")
        t.status, t.read_memory = (
            library.find_function_address("avr_cycle_timer_status"),
            library.find_function_address("avr_core_watch_read"),
        )
        t.hz, t.watched, t.pc = hz, irq is not None, self._pc
        quantum_s = LINE_QUANTUM_S if irq else SWITCH_QUANTUM_S if self._has_lines else QUANTUM_S
        t.quantum = max(1, round(quantum_s * hz))
        t.stop = self._elf.symbols.get("__stop_program", self._elf.symbols.get("_exit", -1))
        t.line_irq = self.find_irq(*irq) if irq else 0
        t.state, t.is_enabled = self._state_at, library.find_function_address("avr_is_interrupt_enabled")
        t.interrupt_wait = self._wait_at
        t.has_pending = library.find_function_address("avr_has_pending_interrupts")
        t.vectors, t.n_vectors = self._vectors.addresses.ctypes.data, len(self._vectors.addresses)
        self._tick = avr_clock_and_pins.end_quantum.pointer
        t.timer = get_function_address(self._tick)

    def find_irq(self, port: int, number: int) -> int:
        """Return a simavr IRQ of a port.

        Args:
            port: Number of the port in PORTS.
            number: A pin, 0 to 7, or PIN_ALL, DIRECTION_ALL or PORT_REGISTER_IRQ.

        Raises:
            StageError: This AVR has no such port.
        """
        irq = self._get_port_irq(port, number)
        if not irq:
            raise StageError(f"--map: this AVR has no port {avr_clock_and_pins.PORT_LETTERS[port]}.")
        return int(irq)

    def has_port(self, port: int) -> bool:
        """Return whether this AVR has an I/O port, by its number in PORTS."""
        return bool(self._get_port_irq(port, 0))

    def _get_port_irq(self, port: int, number: int) -> int | None:
        """Return a simavr IRQ of a port, or None if this AVR has no such port."""
        return self._simavr.get_irq(
            ctypes.c_void_p(self._avr), encode_ioctl_request("iog" + avr_clock_and_pins.PORT_LETTERS[port]), number
        )

    def find_function_address(self, name: str) -> int:
        """Return the address of a function of simavr."""
        return self._simavr.find_function_address(name)

    def call_avr_ioctl(self, request: int, parameter_address: int) -> None:
        """Call simavr's avr_ioctl.

        Args:
            request: Number of the request, see `encode_ioctl_request`.
            parameter_address: Address of the structure that the request reads or fills.
        """
        self._call_library("avr_ioctl", request, ctypes.c_void_p(parameter_address))

    def raise_irq(self, irq: int, level: int) -> None:
        """Set the level of a simavr IRQ."""
        self._simavr.library["avr_raise_irq"](ctypes.c_void_p(irq), level)

    def register_callback(self, irq: int, function: Any, row: np.ndarray) -> None:
        """Register a compiled function that simavr calls when an IRQ changes.

        Args:
            irq: The simavr IRQ.
            function: Pointer to the compiled function.
            row: Array of one record that the function gets.
        """
        self._simavr.library["avr_irq_register_notify"](
            ctypes.c_void_p(irq), ctypes.cast(function, ctypes.c_void_p), ctypes.c_void_p(address_of(row))
        )

    def _connect_uarts_to_log_and_board(self) -> None:
        """Connect the serial lines of the program to the log and to the board."""
        self._uarts: list[AvrUart] = []
        for name in avr_uart.UART_NAMES:
            irqs = self._simavr.get_irq(ctypes.c_void_p(self._avr), encode_ioctl_request("uar" + name), 0)
            if irqs:
                self._call_library("avr_ioctl", encode_ioctl_request("uas" + name), ctypes.byref(ctypes.c_uint32(0)))
                self._uarts.append(AvrUart(name, self, int(irqs), self._board, len(self._uarts)))

    def schedule_call(self, cycles: int, function: Any, address: int) -> None:
        """Let simavr call a compiled function after a number of cycles.

        Args:
            cycles: Number of cycles from now.
            function: Pointer to the function, which returns the cycle of its next call or 0.
            address: Address of the record that the function gets.
        """
        self._call_library("avr_cycle_timer_register", ctypes.c_uint64(cycles), function, ctypes.c_void_p(address))

    # --- it runs ---

    def main(self) -> int:
        """Run the program to its end; return its exit code."""
        t, library = self.record, self._simavr
        t.begin = self._board.stage.now
        t.when = t.quantum
        self.schedule_call(int(t.quantum), self._tick, int(t.own))
        for uart in self._uarts:
            uart.start_receiving()
        if self._gdb:
            library.gdb_port = self._gdb
            self._state[0] = STOPPED
            print(f"GDB: target remote 127.0.0.1:{self._gdb}", file=sys.stderr, flush=True)
            self._call_library("avr_gdb_init")
        library.running_record, library.run_cycles = t, self._run_cycles
        avr_clock_and_pins.run.c(t.own)
        library.running_record = None
        for uart in self._uarts:
            uart.flush_sent_bytes()
        if t.asleep == avr_clock_and_pins.NO_RESUMING_INTERRUPT:
            library.messages.append((_ERROR_LOG_LEVEL, SLEEPS_FOR_EVER))
        elif t.ended and not any(key in text for _, text in library.messages for key in _FATAL_MESSAGES):
            return int(np.int64(t.code).astype(np.int16))
        raise HostError(self._explain_end())

    def _explain_end(self) -> str:
        """Explain why the program cannot continue."""
        errors = [
            text
            for level, text in self._simavr.messages
            if level <= _ERROR_LOG_LEVEL or any(key in text for key, _ in _MESSAGE_EXPLANATIONS)
        ]
        message = errors[-1] if errors else "simavr has stopped it"
        pc = int(array_at(self._pc, 1, np.dtype("u4"))[0])
        for text in errors:
            if match := _PC_PATTERN.search(text):
                pc, message = int(match[1] or match[2], 16), text
                break
        if pc == self._missing_routine_at:
            pc = self._vectors.read_return_address()
            name = self._vectors.describe_running_interrupt()
            message = (
                f"{name} has come and has no routine in the program: it would begin again with its memory as it is"
            )
        for key, words in _MESSAGE_EXPLANATIONS:
            if key in message:
                message = f"{words} ({message})"
        board = self._board
        return (
            f"{self.path.name}: {message}, at {self._elf.describe_address(pc)}; at {board.stage.time:.6f} s, after "
            f"{board.cycles:,} bus cycles. {board.trace.format_ending(12)}"
        )

    def find_wiring_findings(self) -> tuple[WiringFinding, ...]:
        """Return the signs that lines of axes are at the wrong pins of the program."""
        return self._lines.find_wiring_findings(self._overlay.find_pwm_outputs()) if self._lines else ()

    def close(self) -> None:
        """Free the avr_t."""
        if self._avr:
            self._call_library("avr_terminate")
            self._avr = 0


def _read_flash_size(avr: int) -> int:
    """Return the size of an avr_t's flash in bytes."""
    return int(array_at(avr + 12, 1, np.dtype("u4"))[0]) + 1


INVALID_OPCODE = b"\x07\x00"
_JMP, _RJMP = 0x940C, 0xC000
_VECTOR_HEADER_SIZES = (16, 24)
"""Bytes of an avr_int_vector_t in front of its IRQs: simavr 1.6 and 1.7 by the size of a regbit. The first is its number."""
_MAX_VECTORS = 128
_IRQ, _VALUE = 40, 20
"""Bytes of an avr_irq_t, and where the value stands in it."""
_STACK_POINTER_ADDRESS = 0x5D
_MAX_ONE_WORD_VECTOR_FLASH = 8192
"""Up to this size of the flash (bytes) a vector is one word."""
_THREE_BYTE_FLASH = 0x20000
"""Above this size a return address has three bytes."""


class InterruptVectors:
    """Interrupt vectors of an AVR.

    Args:
        c: Library of simavr.
        avr: Address of the avr_t.
        flash: Size of the flash in bytes.

    Attributes:
        addresses: Address of the avr_int_vector_t of each interrupt; empty for an unknown version of simavr.
    """

    def __init__(self, c: Any, avr: int, flash: int):
        self._library, self._avr, self._flash = c, avr, flash
        get = c["avr_get_interrupt_irq"]
        get.restype = ctypes.c_void_p
        irqs = {n: at for n in range(1, _MAX_VECTORS) if (at := get(ctypes.c_void_p(avr), ctypes.c_uint8(n)))}
        self.addresses = np.zeros(0, "i8")
        self._running = {n: at + _IRQ + _VALUE for n, at in irqs.items()}
        for before in _VECTOR_HEADER_SIZES:
            if all(array_at(at - before, 1, np.dtype("u1"))[0] == n for n, at in irqs.items()):
                self.addresses = np.array([at - before for at in irqs.values()], "i8")
                break

    def end_run_at_missing_routines(self, code: bytes) -> int:
        """Make the run end where the program has no routine for an interrupt.

        Vectors of such interrupts lead to a jump to address 0, which would restart the program. An invalid instruction replaces
        that jump.

        Args:
            code: The program, from address 0 on.

        Returns:
            Address to which vectors without routines lead, or -1 if there is none.
        """
        size = 2 if self._flash <= _MAX_ONE_WORD_VECTOR_FLASH else 4
        targets = {find_jump_target(code, n * size, self._flash) for n in self._running}
        for place in sorted(targets):
            if place > 0 and find_jump_target(code, place, self._flash) == 0:
                self._library["avr_loadcode"](ctypes.c_void_p(self._avr), INVALID_OPCODE, 2, place)
                return place
        return -1

    def describe_running_interrupt(self) -> str:
        """Return the number of the interrupt whose routine is about to run, with the routine's name in avr-libc."""
        numbers = [n for n, at in self._running.items() if array_at(at, 1, np.dtype("u4"))[0]]
        return f"interrupt {numbers[0]} (__vector_{numbers[0]})" if numbers else "an interrupt"

    def read_return_address(self) -> int:
        """Return the address to which the interrupt routine would return."""
        read = self._library["avr_core_watch_read"]

        def read_byte(at: int) -> int:
            return int(read(ctypes.c_void_p(self._avr), ctypes.c_uint16(at))) & 0xFF

        stack = read_byte(_STACK_POINTER_ADDRESS) | read_byte(_STACK_POINTER_ADDRESS + 1) << 8
        size = 3 if self._flash > _THREE_BYTE_FLASH else 2
        return 2 * sum(read_byte(stack + 1 + k) << 8 * (size - 1 - k) for k in range(size))


def find_jump_target(code: bytes, at: int, flash: int) -> int:
    """Return the target of a jump instruction, or -1 if the instruction is no jump.

    Args:
        code: The program, from address 0 on.
        at: Address of the instruction.
        flash: Size of the flash in bytes, at whose end a relative jump wraps.
    """
    words = np.frombuffer(code[at : at + 4].ljust(4, b"\0"), "<u2")
    if words[0] & 0xFE0E == _JMP:
        return 2 * (int(words[0] & 0x01F0) << 13 | int(words[0] & 1) << 16 | int(words[1]))
    if words[0] & 0xF000 == _RJMP:
        distance = int(words[0] & 0xFFF)
        return (at + 2 + 2 * (distance - (distance >> 11 << 12))) % flash
    return -1
