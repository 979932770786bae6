"""Read ELF programs of other processors by pyelftools: segments, symbols, and the processor for which they were built.

An AVR program has its architecture in the ELF flags, and its processor's name where avr-gcc
(`.note.gnu.avr.deviceinfo`) or simavr's header (`.mmcu`) stored it. A Cortex-M program has Arm's build attributes
(`.ARM.attributes`).
"""

from __future__ import annotations

import re
import shutil
from bisect import bisect_right
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from stage.board.errors import LibraryError
from stage.board.firmware_library import ELF_HEAD_SIZE, MACHINES, read_elf_head
from stage.errors import add_article
from stage.support.foreign_files import read_bytes
from stage.support.subprocesses import run_program
from stage.targets.supported_processors import AVRS

AVR, ARM = 83, 40
MAX_FILE_BYTES = 1 << 28
"""Largest size of a program file, bytes."""
ADDR2LINE_COMMANDS = ("avr-addr2line", "arm-none-eabi-addr2line", "llvm-addr2line", "addr2line")
_EXECUTABLE_TYPE = 2
_FILE_TYPE_NAMES = {1: "an object file", 3: "a shared library", 4: "a core dump"}
_WRITABLE, _ALLOCATED = 1, 2
_RESERVED_SECTIONS_BEGIN = 0xFF00  # from this section on
_ARCHITECTURE_MASK = 0x7F  # of the flags
_MAX_UNKNOWN_ARCHITECTURE = 2  # and below: assembled without -mmcu
_NAME_TAG = 1  # of AVR_MCU(...)
_ATTINY_PREFIX = "attiny"
V7, V6M, V6SM, V7EM, V8BASE, V8MAIN, V81MAIN = 10, 11, 12, 13, 16, 17, 21
_ARM_ARCHITECTURE_NAMES = {
    V7: "v7-M (Cortex-M3)", V6M: "v6-M (Cortex-M0)", V6SM: "v6-M (Cortex-M0)", V7EM: "v7E-M (Cortex-M4, M7)",
    V8BASE: "v8-M (Cortex-M23)", V8MAIN: "v8-M (Cortex-M33)", V81MAIN: "v8.1-M (Cortex-M55)",
}  # fmt: skip
_ARM_COMPATIBLE_ARCHITECTURES = {
    "cortex-m0": (V6M, V6SM),
    "cortex-m3": (V6M, V6SM, V7),
    "cortex-m4": (V6M, V6SM, V7, V7EM),
}
_DAMAGED_FILE_ERRORS = (ValueError, LookupError, TypeError, AttributeError, AssertionError, OverflowError)
"""Exceptions of pyelftools for damaged files, besides its own errors."""


class Segment(NamedTuple):
    """Segment of an ELF program: a part of its file that is loaded into memory.

    Attributes:
        at: Address at which it is loaded.
        used_at: Address at which the program uses it.
        content: Bytes of the segment.
    """

    at: int
    used_at: int
    content: bytes


def read_machine_name(path: Path) -> str:
    """Return the name of the machine for which an ELF file was built, or "" for other files. Raises FileError."""
    head = read_elf_head(read_bytes(path, "program", MAX_FILE_BYTES)[:ELF_HEAD_SIZE])
    return MACHINES.get(head[1], f"machine {head[1]}") if head else ""


class Elf:
    """ELF program for a processor of 32 bits or less.

    Args:
        path: The file.
        machine: ELF machine number of the processor, AVR or ARM.
        mcu: Name of the processor, for messages.
        how: Command that builds a program, for messages.

    Attributes:
        flags, entry: Fields of the ELF header.
        segments: Segments to load.
        attributes: Arm's build attributes by tag name.
        device_name: Name of the processor as avr-gcc has stored it, or "".
        symbols: Addresses by symbol name.

    Raises:
        FileError: The file does not exist.
        LibraryError: The file is no program, or a program for another machine.
    """

    def __init__(self, path: Path, machine: int, mcu: str, how: str):
        from elftools.common.exceptions import ELFError
        from elftools.elf.elffile import ELFFile

        self.path, content = path, read_bytes(path, "program", MAX_FILE_BYTES)
        machine_name = read_machine_name(path)
        if not machine_name:
            raise LibraryError(f"{path} is no ELF file: {mcu} runs what its linker makes, for example by {how}.")
        if machine_name != MACHINES[machine]:
            raise LibraryError(
                f"{path} was built for {machine_name}, and {mcu} is an {MACHINES[machine]}. Build it by {how}."
            )
        kind, _ = read_elf_head(content[:ELF_HEAD_SIZE]) or (0, 0)
        if kind != _EXECUTABLE_TYPE:
            raise LibraryError(
                f"{path} is {_FILE_TYPE_NAMES.get(kind, 'no program')}, not a program. Link it by {how}."
            )
        errors = (ELFError, *_DAMAGED_FILE_ERRORS)
        try:
            self._file = ELFFile(BytesIO(content))
            self.flags, self.entry = int(self._file.header.e_flags), int(self._file.header.e_entry)
            self._sections: list[Any] = list(self._file.iter_sections())
            self.segments = self._read_segments()
            self.symbols = self._read_symbols(thumb=machine == ARM)
            self.attributes: dict[str, Any] = {}
            with suppress(*errors):  # damaged ones tell nothing
                self.attributes = self._read_attributes()
            self.device_name = self._read_device_name()
        except errors:
            raise LibraryError(f"{path} is cut off or damaged: its tables point behind its end.") from None

    def _find_section(self, name: str) -> Any:
        """Return the section with a name, or None."""
        return next((section for section in self._sections if section.name == name), None)

    def read_section(self, name: str) -> bytes:
        """Return the content of a section, or b"" if the file has none of this name.

        Args:
            name: Name of the section, for example ".mmcu".
        """
        section = self._find_section(name)
        return b"" if section is None or section["sh_type"] == "SHT_NOBITS" else bytes(section.data())

    def is_writable(self, begin: int, size: int) -> bool:
        """Tell whether the program has variables in a range of addresses.

        Args:
            begin: First address.
            size: Number of bytes.
        """
        wanted = _WRITABLE | _ALLOCATED
        return any(
            s["sh_flags"] & wanted == wanted and begin <= s["sh_addr"] < begin + size and s["sh_size"]
            for s in self._sections
        )

    def describe_address(self, address: int) -> str:
        """Return an address in hexadecimal with its symbol and, if known, its source file and line."""
        words = f"{address:04X}h"
        k = bisect_right(self._functions, (address, chr(0x10FFFF))) - 1
        if k >= 0:
            begin, name = self._functions[k]
            line = self._find_source_line(address)
            words += f" ({name}{f'+{address - begin:X}h' if address > begin else ''}{f', {line}' if line else ''})"
        return words

    def _find_source_line(self, address: int) -> str:
        """Return the source file and line of an address, found by addr2line, or ""."""
        for tool in filter(shutil.which, ADDR2LINE_COMMANDS):
            done = run_program([tool, "-e", str(self.path), hex(address)])
            line = done.stdout.strip().split(" (")[0]
            if done.returncode == 0 and line and not line.startswith("??") and not line.endswith((":?", ":0")):
                return Path(line).name
        return ""

    def _read_segments(self) -> list[Segment]:
        """Return the segments to load, without the ELF header that a linker may have put into the first one."""
        contents = [s for s in self._sections if s["sh_type"] == "SHT_PROGBITS" and s["sh_flags"] & _ALLOCATED]
        first = min((s["sh_offset"] for s in contents), default=0)
        segments = []
        for s in self._file.iter_segments("PT_LOAD"):
            skipped = first if s["p_offset"] == 0 else 0
            if s["p_filesz"] > skipped:
                segments.append(Segment(s["p_paddr"] + skipped, s["p_vaddr"] + skipped, bytes(s.data()[skipped:])))
        return segments

    def _read_symbols(self, thumb: bool) -> dict[str, int]:
        """Return the values of symbols by name, and list the functions by address; with `thumb`, without bit 0 in that list."""
        symbols: dict[str, int] = {}
        self._functions: list[tuple[int, str]] = []
        for table in (s for s in self._sections if s["sh_type"] == "SHT_SYMTAB"):
            for symbol in table.iter_symbols():
                section, name, value = symbol["st_shndx"], symbol.name, int(symbol["st_value"])
                if not name or section == "SHN_UNDEF":
                    continue
                symbols[name] = value
                is_code = symbol["st_info"]["type"] in ("STT_NOTYPE", "STT_FUNC")
                if is_code and isinstance(section, int) and section < _RESERVED_SECTIONS_BEGIN and name[0] != "$":
                    self._functions.append((value & ~1 if thumb else value, name))
        self._functions.sort()
        return symbols

    def _read_attributes(self) -> dict[str, Any]:
        """Return Arm's build attributes of the whole file, by tag name."""
        section = self._find_section(".ARM.attributes")
        if section is None or section["sh_type"] != "SHT_ARM_ATTRIBUTES":
            return {}
        public = (sub for sub in section.iter_subsections() if sub.header["vendor_name"] == "aeabi")
        parts = (part for sub in public for part in sub.iter_subsubsections() if part.header.tag == "TAG_FILE")
        return {attribute.tag: attribute.value for part in parts for attribute in part.iter_attributes()}

    def _read_device_name(self) -> str:
        """Return the processor's name as stored by avr-gcc, or ""."""
        section = self._find_section(".note.gnu.avr.deviceinfo")
        for note in section.iter_notes() if section is not None else ():
            record = bytes(note["n_descdata"])
            names_at, offset = 32, int.from_bytes(record[28:32], "little")  # behind six memory sizes and two words
            if len(record) > names_at:
                return record[names_at + offset :].split(b"\0")[0].decode("ascii", "replace").lower()
        return ""


# --- AVR ---


def get_avr_architecture(mcu: str) -> int:
    """Return the number of an AVR's architecture in avr-gcc; the flags of its ELF files contain the number."""
    if mcu.startswith(_ATTINY_PREFIX):
        return 25
    if mcu == "at90usb162":
        return 35
    if mcu == "atmega2560":
        return 6
    if mcu.startswith("atmega128"):
        return 51
    return 4 if re.fullmatch(r"atmega(8l?|48p?a?|88p?a?)", mcu) else 5


def check_avr(elf: Elf, mcu: str, option: str) -> None:
    """Check that a program was built for this AVR, or for one that runs the same programs.

    Args:
        elf: The program.
        mcu: Name of the AVR.
        option: Command that builds a program, for the message.

    Raises:
        LibraryError: The program was built for another AVR.
    """
    name, number = read_avr_name(elf), elf.flags & _ARCHITECTURE_MASK
    wanted = get_avr_architecture(mcu)
    other_name = name in AVRS and _strip_variant_letters(name) != _strip_variant_letters(mcu)
    if number > _MAX_UNKNOWN_ARCHITECTURE and (number != wanted or other_name):
        target = f"{name} (architecture avr{number})" if name else f"an AVR of the architecture avr{number}"
        hint = f"Run it with --mcu {name}, or build it" if name in AVRS else "Build it"
        raise LibraryError(f"{elf.path} was built for {target}, and {mcu} is an avr{wanted}. {hint} by {option}.")


def _strip_variant_letters(name: str) -> str:
    """Return a processor's name without the letters of variants that run the same programs."""
    return re.sub(r"(p|a|pa|l)$", "", name)


def read_avr_name(elf: Elf) -> str:
    """Return the name of the processor for which a program was built, for example atmega2560, or "" if the file has none."""
    return read_mmcu(elf).get(_NAME_TAG, b"").split(b"\0")[0].decode("ascii", "replace").lower() or elf.device_name


def read_mmcu(elf: Elf) -> dict[int, bytes]:
    """Return the values, by tag, that the macro AVR_MCU(...) of simavr's header has stored in the section .mmcu."""
    contents = [s.content for s in elf.segments if 0x910000 <= s.used_at < 0x920000]
    content = elf.read_section(".mmcu") or (contents[0] if contents else b"")
    tags: dict[int, bytes] = {}
    at = 0
    while at + 2 <= len(content) and content[at]:
        length = content[at + 1]
        tags.setdefault(content[at], content[at + 2 : at + 2 + length])
        at += 2 + length
    return tags


# --- Cortex-M ---


def check_arm(elf: Elf, mcu: str, option: str) -> None:
    """Check that a Cortex-M has all instructions that a program was built for.

    Args:
        elf: The program.
        mcu: Name of the processor.
        option: Command that builds a program, for the message; it contains {mcu}.

    Raises:
        LibraryError: The program needs another processor or a floating-point unit.
    """
    tags = elf.attributes
    arch, profile = tags.get("TAG_CPU_ARCH", 0), chr(tags.get("TAG_CPU_ARCH_PROFILE", ord("M")))
    floats = tags.get("TAG_FP_ARCH")
    target = ""
    if arch >= V7 and profile in "AR":
        target = f"a Cortex-{profile}"
    elif arch in _ARM_ARCHITECTURE_NAMES and arch not in _ARM_COMPATIBLE_ARCHITECTURES[mcu]:
        target = _ARM_ARCHITECTURE_NAMES[arch]
    elif mcu != "cortex-m4" and (floats or tags.get("TAG_ABI_VFP_ARGS")):
        target = "a floating-point unit"
    if not target:
        return
    runs = [
        name
        for name in _ARM_COMPATIBLE_ARCHITECTURES
        if arch in _ARM_COMPATIBLE_ARCHITECTURES[name] and (name == "cortex-m4" or not floats)
    ]
    hint = f"Run it with --mcu {runs[0]}, or build it" if profile == "M" and runs else "Build it"
    raise LibraryError(
        f"{elf.path} was built for {target}, and this is {add_article(mcu)}. {hint} by {option.format(mcu=mcu)}."
    )
