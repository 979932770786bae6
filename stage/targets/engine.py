"""A processor on Unicorn: opened, run until it ends, its errors in words. The rest of each is in cortex.py and pc.py."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from stage.board.board import Board
from stage.board.bus import host_record, requests
from stage.board.errors import HostError
from stage.native import address_of
from stage.targets import machine
from stage.targets.gdb import Server

_CODE, _INSN = 4, 2
_IN, _OUT = 218, 500  # of x86, as Unicorn numbers them
_TEXT = 1000
NEVER = 1 << 62
LATENCY = 2e-6
INVALID_INSTRUCTION = 10
INVALID = {
    6: "it reads memory that is not there", 7: "it writes memory that is not there", 8: "it runs where there is no memory",
    INVALID_INSTRUCTION: "an instruction that this processor does not have", 12: "it writes to the flash",
    13: "it reads memory that cannot be read", 14: "it runs where no code may be",
    21: "an exception that nobody handles",
}  # fmt: skip
"""uc_err, as far as a program is at fault."""
_OF_MEMORY = (6, 7, 8, 12, 13, 14)


class _Record(ctypes.Structure):
    """A MACHINE record, as Python reads and writes it at once."""

    _fields_ = tuple((name, ctypes.c_int64) for name in machine.MACHINE.names or ())


class Registers:
    """Several registers of a processor, read and written in one call."""

    def __init__(self, lib: Any, handle: Any, numbers: list[int]):
        n = len(numbers)
        self._lib, self._handle, self._n = lib, handle, n
        self._numbers, self._values = (ctypes.c_int * n)(*numbers), (ctypes.c_uint64 * n)()
        begin = ctypes.addressof(self._values)
        self._pointers = (ctypes.c_void_p * n)(*(begin + 8 * k for k in range(n)))

    def get(self) -> list[int]:
        """What is in them."""
        self._lib.uc_reg_read_batch(self._handle, self._numbers, self._pointers, self._n)
        return [value & 0xFFFFFFFF for value in self._values]

    def set(self, *values: int) -> None:
        """In their order."""
        self._values[:] = list(values)
        self._lib.uc_reg_write_batch(self._handle, self._numbers, self._pointers, self._n)


class Engine:
    """Attributes: uc: Unicorn's object; record: the MACHINE record; ended: set when the program has ended, with `code`."""

    def __init__(self, path: Any, board: Board, arch: int, mode: int, hz: int, model: int | None = None):
        import unicorn
        from unicorn.unicorn_py3.unicorn import uclib

        self.path, self._board = path, board
        self.uc: Any = unicorn.Uc(arch, mode)
        self._lib = uclib
        if model is not None:  # before anything else
            self.uc.ctl_set_cpu_model(model)
        self._row = np.zeros(1, machine.MACHINE)
        self._flags = np.zeros(1, "i8")
        t = self.record = _Record.from_buffer(self._row.data)
        link = board.link
        t.own, t.uc, t.host, t.request = (
            self._row.ctypes.data,
            self.handle.value,
            link.pointer,
            requests.request.address,
        )
        t.stop, t.reg_read = (self._address(self._lib[name]) for name in ("uc_emu_stop", "uc_reg_read"))
        t.flags_at, t.hz, t.alarm = self._flags.ctypes.data, hz, NEVER
        t.quantum = max(1, round(LATENCY * hz))
        self.ended, self.code = False, 0
        self.error: type[Exception] = unicorn.UcError
        self.gdb: Server | None = None
        self.window_pages: list[int] = []
        self.fault = ""
        self._kept: list[Any] = []
        self._line = ""
        self.hook(_CODE, machine.instruction.pointer)
        self._touched: int | None = None
        self.uc.hook_add(unicorn.UC_HOOK_MEM_INVALID, self._touches)

    @property
    def handle(self) -> Any:
        """Unicorn's, for C."""
        return self.uc._uch

    @staticmethod
    def _address(function: Any) -> int:
        return ctypes.cast(function, ctypes.c_void_p).value or 0

    def hook(self, kind: int, function: Any, instruction: int = 0) -> None:
        """Unicorn calls a compiled function, with the MACHINE record."""
        number = ctypes.c_size_t()
        self._kept.append(function)
        failed = self._lib.uc_hook_add(
            self.handle, ctypes.byref(number), kind, ctypes.cast(function, ctypes.c_void_p), ctypes.c_void_p(self.record.own),
            ctypes.c_uint64(1), ctypes.c_uint64(0), ctypes.c_int(instruction),
        )  # fmt: skip
        if failed:
            raise HostError(f"Unicorn refuses a hook ({failed}).")

    def ports(self, rare: Any, below: int) -> None:
        """IN and OUT reach the board; for ports below that number a function of ctypes is called."""
        self._kept.append(rare)
        self.record.rare, self.record.rare_ports = self._address(rare), below
        self.hook(_INSN, machine.port_in.pointer, _IN)
        self.hook(_INSN, machine.port_out.pointer, _OUT)

    def map_windows(self, windows: Any) -> None:
        """Memory in which the board's windows lie, in whole pages."""
        self._windows = np.array([tuple(w) for w in windows] or [(0, 0, 0)], machine.WINDOW)
        self.record.windows, self.record.n_windows = self._windows.ctypes.data, len(windows)
        self._pages = np.zeros(0, machine.PAGE)
        pages = self.window_pages = sorted({page for w in windows for page in range(w.address & ~0xFFF, w.end, 0x1000)})
        self._pages = np.array([(self.record.own, page) for page in pages], machine.PAGE)
        read, write = machine.window_read.pointer, machine.window_written.pointer
        for k, page in enumerate(pages):
            user = ctypes.c_void_p(address_of(self._pages[k : k + 1]))
            failed = self._lib.uc_mmio_map(
                self.handle, ctypes.c_uint64(page), ctypes.c_size_t(0x1000), ctypes.cast(read, ctypes.c_void_p), user,
                ctypes.cast(write, ctypes.c_void_p), user,
            )  # fmt: skip
            if failed:
                raise HostError(f"Unicorn cannot map the window at {page:X}h ({failed}).")

    # --- the log ---

    def say(self, text: str) -> None:
        """The program prints."""
        *lines, self._line = (self._line + text.replace("\r", "")).split("\n")
        for line in lines:
            self._note(line)
        if len(self._line) > _TEXT:
            self.flush()

    def flush(self) -> None:
        """What has been printed and no line end followed."""
        if self._line:
            self._note(self._line)
        self._line = ""

    def _note(self, line: str) -> None:
        text = ctypes.create_string_buffer(line.encode())
        machine.looked.c(self.record.own)
        self._board.link.request(self._board.link.pointer, host_record.LOG, ctypes.addressof(text), 0)

    # --- for a debugger ---

    def watch(self, address: int, function: Any) -> int:
        """Unicorn calls the function before the instruction at an address. Returns a number for hook_del."""
        return int(self.uc.hook_add(_CODE, function, begin=address, end=address))

    def not_run(self, size: int) -> None:
        """The instruction that has been counted is not run now."""
        self.record.cycles -= self.record.each + self.record.byte * size

    def in_window(self, at: int, size: int) -> bool:
        """Some of these bytes lie in memory that holds the board's windows."""
        return any(page < at + size and at < page + 0x1000 for page in self.window_pages)

    def address(self) -> int:
        """The program counter, as the memory's addresses are."""
        return self.where_to_go_on()

    def halted(self) -> None:
        """A debugger has stopped it."""

    # --- it runs ---

    def main(self) -> int:
        """See stage.board.thread_runner."""
        import unicorn

        self.record.begin = self._board.stage.now
        self.ended = False
        try:
            while not self.ended:
                self._go_on(unicorn.UcError)
        except HostError:
            if self.gdb is not None:
                self.gdb.failed()
            raise
        if self.gdb is not None:
            self.gdb.ended(self.code)
        self.flush()
        machine.looked.c(self.record.own)
        return self.code

    def _go_on(self, wrong: type[Exception]) -> None:
        """Up to the next instruction at which something is to be done."""
        gdb = self.gdb
        if gdb is not None:
            gdb.before()
        if not self.ended:
            try:
                self.uc.emu_start(self.where_to_go_on(), 0xFFFFFFFF, 0, 1 if gdb is not None and gdb.steps else 0)
            except wrong as error:
                if not self.ended and not self.fault:
                    raise self.wrong(self._fault_in_words(error)) from None
            debugged = gdb is not None and gdb.after()
            if self.record.outside:
                raise self.wrong(f"it touches address {int(self.record.outside) - 1:X}h, which no window has")
            if self.fault:
                raise self.wrong(self.fault)
            if debugged:
                self.halted()
            elif not self.ended:
                try:
                    self.stopped()
                except wrong:  # an exception's frame, a text to print
                    raise self.wrong("its stack, or what it asks for, lies where there is no memory") from None

    def _touches(self, uc: Any, access: int, address: int, size: int, value: int, data: Any) -> bool:
        """Unicorn calls it at an access to memory that is not there; it then ends the run."""
        self._touched = address
        return False

    def _fault_in_words(self, error: Any) -> str:
        said = INVALID.get(error.errno, f"Unicorn says {error}")
        return (
            f"{said}, address {self._touched:X}h" if error.errno in _OF_MEMORY and self._touched is not None else said
        )

    def where_to_go_on(self) -> int:
        """The address for uc_emu_start."""
        raise NotImplementedError

    def stopped(self) -> None:
        """Unicorn has stopped: an interrupt, an alarm, or a wait for one."""
        raise NotImplementedError

    def place(self) -> str:
        """The program counter in words."""
        raise NotImplementedError

    def end(self, code: int) -> None:
        """The program has ended."""
        self.ended, self.code = True, code
        self.uc.emu_stop()

    def wrong(self, what: str) -> HostError:
        """The error of a program that cannot go on."""
        board = self._board
        self.flush()
        machine.looked.c(self.record.own)
        return HostError(
            f"{self.path.name}: {what}, at {self.place()}; at {board.stage.time:.6f} s, after {board.cycles:,} bus cycles. Its "
            f"last bus cycles:\n{board.trace.text(12)}"
        )

    def close(self) -> None:
        """See stage.board.thread_runner."""
