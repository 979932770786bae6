"""What is in an ELF file: its machine, what is to be loaded, its symbols."""

from __future__ import annotations

import shutil
import struct
from bisect import bisect_right
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from stage.board.errors import LibraryError
from stage.files import FileError, refuse_irregular
from stage.foreign_files import read_bytes
from stage.processes import run_program

AVR, ARM = 83, 40
LARGEST = 1 << 28
"""Bytes of a program."""
MACHINES = {
    2: "SPARC", 3: "x86 (32 bit)", 4: "68000", 8: "MIPS", 20: "PowerPC", AVR: "AVR", ARM: "ARM (32 bit)", 42: "SuperH",
    62: "x86-64", 94: "Xtensa", 105: "MSP430", 183: "aarch64", 243: "RISC-V",
}  # fmt: skip
PROGRAM, LOAD, CONTENT, SYMBOLS, FUNCTION, NOTHING = 2, 1, 1, 2, 2, 8
WRITABLE, ALLOCATED = 1, 2
_HEAD = struct.Struct("<16sHHIIIIIHHHHHH")
_SEGMENT = struct.Struct("<IIIIIIII")
_SECTION = struct.Struct("<IIIIIIIIII")
_SYMBOL = struct.Struct("<IIIBBH")
ADDR2LINE = ("avr-addr2line", "arm-none-eabi-addr2line", "llvm-addr2line", "addr2line")


class Segment(NamedTuple):
    """Content that is loaded at an address of the memory that keeps it (`at`), for use at `used_at`."""

    at: int
    used_at: int
    content: bytes


def machine_of(path: Path) -> str:
    """The machine that a file is for, in words; "" if it is no ELF file. Raises FileError."""
    head = _read(path)[:20]
    if head[:4] != b"\x7fELF" or len(head) < 20:
        return ""
    number = struct.unpack("<H" if head[5] == 1 else ">H", head[18:20])[0]
    return MACHINES.get(number, f"machine {number}")


class Elf:
    """A program of a machine of 32 bits or less, little-endian.

    Raises FileError: there is no such file; LibraryError: no program, or one for another machine.
    """

    def __init__(self, path: Path, machine: int, mcu: str, how: str):
        self.path, self._content = path, _read(path)
        self._state = 1 if machine == ARM else 0  # of Thumb, in the address of a function
        found, content = machine_of(path), self._content
        if not found:
            raise LibraryError(f"{path} is no ELF file: {mcu} runs what its linker makes, for example by {how}.")
        if found != MACHINES[machine]:
            raise LibraryError(f"{path} was built for {found}, and {mcu} is an {MACHINES[machine]}. Build it by {how}.")
        if len(content) < _HEAD.size:
            raise LibraryError(f"{path} is cut off: it has {len(content)} bytes.")
        (
            _,
            kind,
            _,
            _,
            self.entry,
            self._segments_at,
            self._sections_at,
            self.flags,
            _,
            _,
            n_segments,
            _,
            n_sections,
            names,
        ) = _HEAD.unpack_from(content)
        if kind != PROGRAM:
            what = {1: "an object file", 3: "a shared library", 4: "a core dump"}.get(kind, "no program")
            raise LibraryError(f"{path} is {what}, not a program. Link it by {how}.")
        try:
            tables = [_SECTION.unpack_from(content, self._sections_at + k * _SECTION.size) for k in range(n_sections)]
            self._tables, self._names_at = tables, tables[names][4] if names < len(tables) else 0
            self.segments = self._segments(n_segments, tables)
            self.symbols = self._symbols(tables)
        except (struct.error, IndexError, ValueError):  # a text without an end, or not in UTF-8
            raise LibraryError(f"{path} is cut off or damaged: its tables point behind its end.") from None

    def section(self, name: str) -> bytes:
        """What is in the section of that name; b"" if there is none."""
        for name_at, kind, _, _, at, size, *_ in self._tables:
            begin = self._names_at + name_at
            if kind != NOTHING and self._content[begin : begin + len(name) + 1] == name.encode() + b"\0":
                return self._content[at : at + size]
        return b""

    def writable(self, begin: int, size: int) -> bool:
        """The linker has put variables into that memory."""
        return any(
            flags & ALLOCATED and flags & WRITABLE and begin <= address < begin + size and length
            for _, _, flags, address, _, length, *_ in self._tables
        )

    def _segments(self, n: int, tables: list[tuple[int, ...]]) -> list[Segment]:
        """What is loaded; without the file's head, which linkers put into the first where there is room."""
        found, first = (
            [],
            min((at for _, kind, flags, _, at, *_ in tables if kind == CONTENT and flags & ALLOCATED), default=0),
        )
        for k in range(n):
            kind, at, used_at, kept_at, size, *_ = _SEGMENT.unpack_from(
                self._content, self._segments_at + k * _SEGMENT.size
            )
            if at == 0 and first:
                at, used_at, kept_at, size = first, used_at + first, kept_at + first, size - first
            if kind == LOAD and size > 0:
                found.append(Segment(kept_at, used_at, self._content[at : at + size]))
        return found

    def _symbols(self, tables: list[tuple[int, ...]]) -> dict[str, int]:
        found: dict[str, int] = {}
        self._functions: list[tuple[int, str]] = []
        for _, kind, _, _, at, size, link, *_ in tables:
            if kind != SYMBOLS:
                continue
            names = tables[link][4]
            for place in range(at, at + size, _SYMBOL.size):
                name_at, value, _, info, _, section = _SYMBOL.unpack_from(self._content, place)
                begin = names + name_at
                name = self._content[begin : self._content.index(b"\0", begin)].decode(errors="replace")
                if not name or not section:
                    continue
                found[name] = value
                if info & 15 in (0, FUNCTION) and 0 < section < 0xFF00 and name[0] != "$":
                    self._functions.append((value & ~self._state, name))
        self._functions.sort()
        return found

    @cached_property
    def _starts(self) -> list[int]:
        return [value for value, _ in self._functions]

    def where(self, address: int) -> str:
        """An address in words: with its symbol, and file and line if the file has them."""
        said = f"{address:04X}h"
        k = bisect_right(self._starts, address) - 1
        if k >= 0:
            begin, name = self._functions[k]
            said += f" ({name}{f'+{address - begin:X}h' if address > begin else ''}"
            line = self._line(address)
            said += f", {line})" if line else ")"
        return said

    def _line(self, address: int) -> str:
        for tool in ADDR2LINE:
            if shutil.which(tool):
                done = run_program([tool, "-e", str(self.path), hex(address)])
                line = done.stdout.strip().split(" (")[0]
                if done.returncode == 0 and line and not line.startswith("??") and not line.endswith((":?", ":0")):
                    return Path(line).name
        return ""


def _read(path: Path) -> bytes:
    refuse_irregular(path, "program")
    if not path.is_file():
        raise FileError(f"{path}: there is no such file.")
    return read_bytes(path, "program", LARGEST)
