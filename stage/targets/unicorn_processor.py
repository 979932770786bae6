"""`UnicornProcessor`: base class of processors on Unicorn, with registers, log and error messages (cortex_m.py, pc_8086.py)."""

from __future__ import annotations

import ctypes
from typing import Any, ClassVar

import numpy as np

from stage.board.board import Board
from stage.board.bus import host_record, host_requests
from stage.board.errors import HostError
from stage.native import address_of, get_function_address
from stage.targets import processor_clock_and_bus_cycles
from stage.targets.gdb_server import DebugServer

_CODE, _INSN = 4, 2  # kinds of hooks
_IN, _OUT = 218, 500  # of x86, as Unicorn numbers them
MAX_LINE_LENGTH = 1000  # characters
PAGE_SIZE = 0x1000
NEVER = 1 << 62
QUANTUM_S = 2e-6
INVALID_INSTRUCTION = 10
ERROR_MESSAGES = {
    6: "it reads memory that is not there", 7: "it writes memory that is not there", 8: "it runs where there is no memory",
    INVALID_INSTRUCTION: "an instruction that this processor does not have", 12: "it writes to the flash",
    13: "it reads memory that cannot be read", 14: "it runs where no code may be",
    21: "an exception that nobody handles",
}  # fmt: skip
"""Messages for errors of a program, by uc_err."""
_MEMORY_ERRORS = (6, 7, 8, 12, 13, 14)


class _ProcessorRecord(ctypes.Structure):
    """UNICORN_PROCESSOR record as a ctypes structure, whose fields Python accesses faster than those of a NumPy record."""

    _fields_ = tuple((name, ctypes.c_int64) for name in processor_clock_and_bus_cycles.UNICORN_PROCESSOR.names or ())


class Registers:
    """Group of registers of an emulated processor that are read and written in one call."""

    def __init__(self, lib: Any, handle: Any, numbers: list[int]):
        n = len(numbers)
        self._lib, self._handle, self._n = lib, handle, n
        self._numbers, self._values = (ctypes.c_int * n)(*numbers), (ctypes.c_uint64 * n)()
        begin = ctypes.addressof(self._values)
        self._pointers = (ctypes.c_void_p * n)(*(begin + 8 * k for k in range(n)))

    def read_all(self) -> list[int]:
        """Return the values of the registers of this group."""
        self._lib.uc_reg_read_batch(self._handle, self._numbers, self._pointers, self._n)
        return [value & 0xFFFFFFFF for value in self._values]

    def write_all(self, *values: int) -> None:
        """Set the registers of this group, in their order."""
        self._values[:] = list(values)
        self._lib.uc_reg_write_batch(self._handle, self._numbers, self._pointers, self._n)


class UnicornProcessor:
    """Processor on Unicorn with a program.

    Args:
        path: The program file.
        board: Board that the program drives.
        arch, mode: Architecture and mode in Unicorn.
        hz: Clock of the processor, Hz.
        model: Model number in Unicorn, or None.

    Attributes:
        uc: Unicorn's object.
        record: UNICORN_PROCESSOR record.
        ended: Whether the program has ended.
        code: Exit code of the program, once it has ended.
        fault: Error message that a callback of Unicorn has set by `fail`, or "".
        gdb: Server for a debugger, or None.
    """

    REGISTER_PREFIX: ClassVar[str]

    def __init__(self, path: Any, board: Board, arch: int, mode: int, hz: int, model: int | None = None):
        import unicorn
        from unicorn import arm_const, x86_const
        from unicorn.unicorn_py3.unicorn import uclib

        self.path, self._board = path, board
        self.uc: Any = unicorn.Uc(arch, mode)
        self._lib, self._constants = uclib, {**vars(arm_const), **vars(x86_const)}
        if model is not None:  # before anything else
            self.uc.ctl_set_cpu_model(model)
        self._row = np.zeros(1, processor_clock_and_bus_cycles.UNICORN_PROCESSOR)
        self._flags = np.zeros(1, "i8")
        t = self.record = _ProcessorRecord.from_buffer(self._row.data)
        link = board.link
        t.own, t.uc, t.host, t.request = (
            self._row.ctypes.data,
            self.handle.value,
            link.pointer,
            host_requests.request.address,
        )
        t.stop, t.reg_read = (get_function_address(self._lib[name]) for name in ("uc_emu_stop", "uc_reg_read"))
        t.flags_at, t.hz, t.alarm = self._flags.ctypes.data, hz, NEVER
        t.quantum = max(1, round(QUANTUM_S * hz))
        self.ended, self.code = False, 0
        self.error: type[Exception] = unicorn.UcError
        self.gdb: DebugServer | None = None
        self.window_pages: list[int] = []
        self.fault = ""
        self._functions: list[Any] = []
        self._line = ""
        self.add_hook(_CODE, processor_clock_and_bus_cycles.count_instruction.pointer)
        self._invalid_address: int | None = None
        self.uc.hook_add(unicorn.UC_HOOK_MEM_INVALID, self._store_invalid_address)

    @property
    def handle(self) -> Any:
        """Handle of the processor in Unicorn's C interface."""
        return self.uc._uch

    # --- registers ---

    def find_register_number(self, name: str) -> int:
        """Return the number of a register, for example "r0"."""
        return int(self._constants[self.REGISTER_PREFIX + name.upper()])

    def get_register(self, name: str) -> int:
        """Return the value of a register of the emulated processor."""
        return int(self.uc.reg_read(self.find_register_number(name)))

    def set_registers(self, **values: int) -> None:
        """Set registers of the emulated processor by name."""
        for name, value in values.items():
            self.uc.reg_write(self.find_register_number(name), value)

    # --- calls of Unicorn ---

    def add_hook(self, kind: int, function: Any, instruction: int = 0) -> None:
        """Register a compiled function that Unicorn calls with the UNICORN_PROCESSOR record of processor_clock_and_bus_cycles.py.

        Args:
            kind: Kind of the hook in Unicorn.
            function: The function.
            instruction: Number of the instruction, for hooks of one instruction.
        """
        number = ctypes.c_size_t()
        self._functions.append(function)
        failed = self._lib.uc_hook_add(
            self.handle, ctypes.byref(number), kind, ctypes.cast(function, ctypes.c_void_p), ctypes.c_void_p(self.record.own),
            ctypes.c_uint64(1), ctypes.c_uint64(0), ctypes.c_int(instruction),
        )  # fmt: skip
        if failed:
            raise HostError(f"Unicorn refuses a hook ({failed}).")

    def hook_ports(self, function: Any, below: int) -> None:
        """Connect the instructions IN and OUT to the board, and the lowest ports to a function.

        Args:
            function: The ctypes function for the processor's own ports: (record, port, size, value or -1) -> value.
            below: Number of ports, from 0 on, that belong to the processor itself.
        """
        self._functions.append(function)
        self.record.internal_port, self.record.n_internal_ports = get_function_address(function), below
        self.add_hook(_INSN, processor_clock_and_bus_cycles.execute_in.pointer, _IN)
        self.add_hook(_INSN, processor_clock_and_bus_cycles.execute_out.pointer, _OUT)

    def map_windows(self, windows: Any) -> None:
        """Map the pages of memory in which memory windows of the board lie."""
        self._windows = np.array(
            [tuple(w) for w in windows] or [(0, 0, 0)], processor_clock_and_bus_cycles.MEMORY_WINDOW
        )
        self.record.windows, self.record.n_windows = self._windows.ctypes.data, len(windows)
        self.window_pages = sorted({page for w in windows for page in range(w.address & -PAGE_SIZE, w.end, PAGE_SIZE)})
        self._pages = np.array(
            [(self.record.own, page) for page in self.window_pages], processor_clock_and_bus_cycles.PAGE
        )
        read, write = (
            processor_clock_and_bus_cycles.load_from_window.pointer,
            processor_clock_and_bus_cycles.store_to_window.pointer,
        )
        for k, page in enumerate(self.window_pages):
            user = ctypes.c_void_p(address_of(self._pages[k : k + 1]))
            failed = self._lib.uc_mmio_map(
                self.handle, ctypes.c_uint64(page), ctypes.c_size_t(PAGE_SIZE), ctypes.cast(read, ctypes.c_void_p), user,
                ctypes.cast(write, ctypes.c_void_p), user,
            )  # fmt: skip
            if failed:
                raise HostError(f"Unicorn cannot map the window at {page:X}h ({failed}).")

    # --- the log ---

    def log_text(self, text: str) -> None:
        """Add text that the program prints to the board's log, line by line.

        Args:
            text: Any part of a line, or several lines. The last line waits for its end.
        """
        *lines, self._line = (self._line + text.replace("\r", "")).split("\n")
        for line in lines:
            self._log_line(line)
        if len(self._line) > MAX_LINE_LENGTH:
            self.flush_log_line()

    def flush_log_line(self) -> None:
        """Add the line that the program has not ended yet to the log."""
        if self._line:
            self._log_line(self._line)
        self._line = ""

    def _log_line(self, line: str) -> None:
        """Add a line of the program's output to the board's log."""
        text = ctypes.create_string_buffer(line.encode())
        processor_clock_and_bus_cycles.poll_from_python.c(self.record.own)
        self._board.link.request(self._board.link.pointer, host_record.LOG, ctypes.addressof(text), 0)

    # --- for a debugger ---

    def hook_address(self, address: int, function: Any) -> int:
        """Register a function that Unicorn calls before the instruction at an address.

        Args:
            address: Linear address of the instruction.
            function: Function of Unicorn's object, the address, the size of the instruction and user data.

        Returns:
            Number of the hook, which `hook_del` of Unicorn takes.
        """
        return int(self.uc.hook_add(_CODE, function, begin=address, end=address))

    def uncount_instruction(self, size: int) -> None:
        """Subtract the cycles of a counted instruction of `size` bytes that does not run."""
        self.record.cycles -= self.record.each + self.record.byte * size

    def overlaps_window(self, at: int, size: int) -> bool:
        """Tell whether a range of bytes overlaps pages with windows of the board.

        Args:
            at: Address of the first byte.
            size: Number of bytes.
        """
        return any(page < at + size and at < page + PAGE_SIZE for page in self.window_pages)

    def get_program_counter(self) -> int:
        """Return the program counter as a linear address."""
        return self.get_start_address()

    def handle_debugger_stop(self) -> None:
        """Update the state after a debugger has stopped the processor. The base class does nothing."""

    # --- it runs ---

    def main(self) -> int:
        """Run the program to its end; return its exit code."""
        self.record.begin = self._board.stage.now
        self.ended = False
        try:
            while not self.ended:
                self._run_to_stop()
        except HostError:
            if self.gdb is not None:
                self.gdb.report_failure()
            raise
        if self.gdb is not None:
            self.gdb.report_end(self.code)
        self.flush_log_line()
        processor_clock_and_bus_cycles.poll_from_python.c(self.record.own)
        return self.code

    def _run_to_stop(self) -> None:
        """Run the program until Unicorn stops, and handle the reason for the stop."""
        gdb = self.gdb
        if gdb is not None:
            gdb.prepare_processor_run()
        if self.ended:
            return
        try:
            self.uc.emu_start(
                self.get_start_address(), 0xFFFFFFFF, 0, 1 if gdb is not None and gdb.is_single_step else 0
            )
        except self.error as error:
            if not self.ended and not self.fault:
                raise self.make_error(self._describe_fault(error)) from None
        debugged = gdb is not None and gdb.finish_processor_run()
        if self.record.outside:
            raise self.make_error(f"it touches address {int(self.record.outside) - 1:X}h, which no window has")
        if self.fault:
            raise self.make_error(self.fault)
        if debugged:
            self.handle_debugger_stop()
        elif not self.ended:
            try:
                self.handle_stop()
            except self.error:  # an exception's frame, a text to print
                raise self.make_error("its stack, or what it asks for, lies where there is no memory") from None

    def _store_invalid_address(self, uc: Any, access: int, address: int, size: int, value: int, data: Any) -> bool:
        """Store the address of an access to unmapped memory, which ends the run."""
        self._invalid_address = address
        return False

    def _describe_fault(self, error: Any) -> str:
        """Describe an error of Unicorn for an error message."""
        words = ERROR_MESSAGES.get(error.errno, f"Unicorn says {error}")
        by_address = error.errno in _MEMORY_ERRORS and self._invalid_address is not None
        return f"{words}, address {self._invalid_address:X}h" if by_address else words

    def fail(self, fault: str) -> None:
        """Stop Unicorn and let `main` raise an error; a callback of Unicorn cannot raise one itself.

        Args:
            fault: What the program did, for the error message.
        """
        self.fault = fault
        self.uc.emu_stop()

    def get_start_address(self) -> int:
        """Return the address at which Unicorn continues."""
        raise NotImplementedError

    def handle_stop(self) -> None:
        """Handle the reason for which Unicorn stopped: an interrupt, an alarm, or an instruction that waits for an interrupt."""
        raise NotImplementedError

    def describe_location(self) -> str:
        """Describe the program counter, for an error message."""
        raise NotImplementedError

    def end(self, code: int) -> None:
        """End the program that runs on the emulated processor.

        Args:
            code: Exit code of the program.
        """
        self.ended, self.code = True, code
        self.uc.emu_stop()

    def make_error(self, what: str) -> HostError:
        """Create the error of a program that cannot continue, with its location and its last bus cycles.

        Args:
            what: What the program did, for the error message.
        """
        board = self._board
        self.flush_log_line()
        processor_clock_and_bus_cycles.poll_from_python.c(self.record.own)
        return HostError(
            f"{self.path.name}: {what}, at {self.describe_location()}; at {board.stage.time:.6f} s, after "
            f"{board.cycles:,} bus cycles. {board.trace.format_ending(12)}"
        )

    def close(self) -> None:
        """Do nothing; Unicorn frees its memory together with its object."""
