"""Firmware libraries: building one from sources, checking that a file is one, and `Library`, which loads it."""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import re
import shutil
import struct
import sys
import tempfile
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.board import compiled_object_cache, platforms
from stage.board.bus.host_requests import REQUEST, restore_float_mode, set_usual_float_mode
from stage.board.errors import CompileError, CompilerWarning, LibraryError, NoCompilerError
from stage.board.firmware_pins import (
    PIN_READS,
    PIN_USE,
    SERIAL_USE,
    FirmwarePinUse,
    check_board_pins,
    find_firmware_wiring_findings,
    find_sends_with_transmitter_off,
    make_line_table,
)
from stage.board.pin_assignment import EMPTY_WIRING, PinWiring
from stage.board.temporary_folders import TemporaryFolder
from stage.errors import ArgumentError, escape
from stage.support.argument_checks import explain_arguments
from stage.support.files import FileError, refuse_irregular
from stage.support.subprocesses import run_program

if TYPE_CHECKING:
    from stage.board.host_record_link import Link
    from stage.board.pin_assignment import WiringFinding

ABI = 1
SOURCE_SUFFIXES = (".c", ".cc", ".cpp", ".cxx", *platforms.SKETCHES)
ENTRY = "pulsestage_main"
NO_LIMIT = (1 << 63) - 1  # basic blocks between two requests of a meter
BIND_FLAGS = ("-Wl,-Bsymbolic",) if sys.platform == "linux" else ()
"""Calls within the firmware go to its own functions, whatever their names."""
LINK_FLAGS = ("-lm", "-Wl,-z,defs") if sys.platform == "linux" else ()
"""Flags with which the linker reports functions that are missing."""
LINK_HINT = (
    "\nAdd the source or library that has it. A function of a platform may not be emulated (docs/porting.md); one in C that C++ "
    'calls is declared extern "C".'
)
_UNDEFINED = re.compile(r"undefined (?:reference to|symbol:?) [`'\"]?(.+?)['\"]?$", re.M)
_LINKER_ERROR = re.compile(r"^collect2: |ld returned \d|linker command failed", re.M)
_GCC_FLAG = "-fno-gnu-unique"
_REPORT_FLAGS = (
    ("-fsanitize=thread", "--param=tsan-distinguish-volatile=1", "-Wno-tsan"),
    ("-fsanitize=thread", "-mllvm", "-tsan-distinguish-volatile=1"),
)
"""Flags of GCC and of Clang with which compiled C calls functions before each access to memory, and before volatile ones others."""
METER_SOURCE = Path(__file__).parent / "meter.c"
"""Source of the counter of basic blocks, for firmware whose computing takes time."""
MACHINES = {
    2: "SPARC", 3: "x86 (32 bit)", 4: "68000", 8: "MIPS", 20: "PowerPC", 40: "ARM (32 bit)", 42: "SuperH", 62: "x86-64", 83: "AVR",
    94: "Xtensa", 105: "MSP430", 183: "aarch64", 243: "RISC-V",
}  # fmt: skip
"""Machines by e_machine of an ELF file."""
ELF_HEAD_SIZE = 20
MACHINE_NAMES = {"x86_64": "x86-64", "AMD64": "x86-64", "arm64": "aarch64"}


def _demangle(message: str) -> str:
    """Replace mangled names of C++ functions in a message by readable ones, if c++filt is installed."""
    for name in dict.fromkeys(re.findall(r"\b_Z\w+", message)) if shutil.which("c++filt") else ():
        message = message.replace(name, run_program(["c++filt", name]).stdout.strip() or name)
    return message


class BusStruct(ctypes.Structure):
    """The struct pulsestage_bus of pulsestage.h, by which firmware makes its requests."""

    _fields_ = (("abi", ctypes.c_uint32), ("size", ctypes.c_uint32), ("host", ctypes.c_void_p), ("request", REQUEST))


def get_include_folder() -> Path:
    """Return the folder of pulsestage.h."""
    return Path(__file__).parent


def format_build_command(path: Any = "driver.so") -> str:
    """Return the command that builds a library."""
    suffix = ".dylib" if platform.system() == "Darwin" else ".dll" if platform.system() == "Windows" else ".so"
    if Path(path).suffix == ".rs":
        return f"rustc --edition 2024 --crate-type cdylib {path} -o {Path(path).stem}{suffix}"
    if Path(path).suffix == ".zig":
        return f"zig build-lib -dynamic -O ReleaseSafe {path}"
    return f'cc -shared -fPIC -I"$(stage include)" {Path(path).stem}.c -o {Path(path).stem}{suffix}'


def find_compiler(source: str | Path = "x.c") -> str:
    """Return the compiler for a source: $CC or cc for C, $CXX or c++ for C++. Raises NoCompilerError."""
    variable, usual = (
        ("CC", ("cc", "gcc", "clang")) if Path(source).suffix == ".c" else ("CXX", ("c++", "g++", "clang++"))
    )
    for name in (os.environ.get(variable, ""), *usual):
        if name and shutil.which(name.split()[0]):
            return name
    raise NoCompilerError(
        f"no compiler for {source}: none of {', '.join(usual)} is on the PATH, and ${variable} is not set."
    )


@explain_arguments
def build(
    sources: str | os.PathLike | Sequence[str | os.PathLike],
    output: str | os.PathLike | None = None,
    flags: Sequence[str] = (),
    platform: str | None = None,
    metered: bool = False,
    libraries: Sequence[str | os.PathLike] = (),
) -> Path:
    """Build a firmware library from C or C++ sources.

    C sources are compiled as C, even together with C++ sources. Messages of the compiler or linker about a library that was built
    become a CompilerWarning.

    Args:
        sources: One source, or a sequence.
        output: Path of the library; default: a file in a folder for temporary files.
        flags: Flags for the compiler, after -O2 -g and the sources, so that libraries can be among them.
        platform: Platform for which the sources were written, see stage.board.platforms.
        metered: Whether the library counts its basic blocks, for NativeHost(cost=...).
        libraries: Folders of Arduino libraries that a sketch uses.

    Returns:
        The path of the library.

    Raises:
        FileError: A source is missing.
        NoCompilerError: There is no compiler.
        CompileError: A source does not compile, or a function is missing; with the messages of the compiler or linker.
        ArgumentError: There is nothing to build, or the output is a source.
    """
    files = [Path(s) for s in ([sources] if isinstance(sources, str | os.PathLike) else sources)]
    if not files:
        raise ArgumentError("nothing to build: give at least one source.")
    for file in files:
        refuse_irregular(file, "source")
        if not file.is_file():
            raise FileError(f"{file}: there is no such source.")
    if output is not None and Path(output).suffix in (*SOURCE_SUFFIXES, ".h", ".hpp", ".o"):
        raise ArgumentError(
            f"output {os.fspath(output)}: a library is written there, and this is the name of a source. Several sources are one "
            "list: build([a, b]); the output ends in .so."
        )
    target = platforms.find_platform(platform, files, libraries)
    files = platforms.add_sketch_files(files)
    library = Path(output) if output else Path(tempfile.mkdtemp(prefix="pulsestage-")) / f"{files[0].stem}.so"
    with tempfile.TemporaryDirectory(prefix="pulsestage-") as folder:
        if metered:
            meter = f"{folder}/meter.o"
            _compile(
                METER_SOURCE,
                [
                    *find_compiler().split(),
                    "-c",
                    "-fPIC",
                    "-O2",
                    f"-I{get_include_folder()}",
                    str(METER_SOURCE),
                    "-o",
                    meter,
                ],
            )
            flags = ("-fsanitize-coverage=trace-pc", meter, *flags)
        recipe = platforms.make_recipe(
            target,
            files,
            Path(folder),
            lambda source, more: _preprocess(source, more, flags),
            flags,
            _find_report_flags(tuple(flags)) if target is not None and target.c_registers else (),
        )
        common = ["-fPIC", "-O2", "-g", *recipe.flags, f"-I{get_include_folder()}"]
        messages, objects = [_describe_unreported(source, flags) for source in recipe.unreported], []
        for k, source in enumerate(recipe.c_files):
            objects.append(f"{folder}/{k}-{source.stem}.o")
            command = [
                *find_compiler().split(), "-c", *common, *recipe.c_flags, *_select_c_flags(flags), str(source), "-o", objects[-1],
            ]  # fmt: skip
            messages.append(_compile(recipe.originals.get(source, source), command, target))
        name = find_compiler("x.cpp" if recipe.cplusplus else "x.c")
        more = [*common, *recipe.cplusplus_flags]
        more += _list_cplusplus_flags(name, recipe.is_like_c, tuple(flags)) if recipe.cplusplus else ()
        if recipe.registers is not None:
            objects.append(_compile_registers(recipe.registers, name, recipe.flags, flags, Path(folder)))
        sources_to_link: Sequence[str] = recipe.files
        if recipe.cplusplus and compiled_object_cache.can_cache(flags):
            command = [*name.split(), "-c", *more, *_select_compiler_flags(flags)]
            compiled = _compile_cplusplus(recipe.files, name, command, Path(folder), files[0], target)
            sources_to_link = [str(path) for path, _ in compiled]
            messages += [message for _, message in compiled]
        command = [
            *name.split(), "-shared", *more, *BIND_FLAGS, *sources_to_link, *objects, *flags, "-o", str(library),
        ]  # fmt: skip
        messages.append(_link(files, command, target))
        if warning := "\n".join(filter(None, messages)):
            warnings.warn(escape(f"{files[0]}: the compiler warns:\n{warning}"), CompilerWarning, stacklevel=2)
    return library


def _compile_cplusplus(
    sources: Sequence[str],
    compiler: str,
    command: list[str],
    folder: Path,
    main: Path,
    platform: platforms.Platform | None,
) -> list[tuple[Path, str]]:
    """Compile sources in C++ that have changed since they were compiled last, several at a time.

    Args:
        sources: The sources.
        compiler: The compiler as it is called, without options.
        command: Compiler with its options.
        folder: Folder for temporary files.
        main: Source that errors name.
        platform: Platform of the sources.

    Returns:
        Object file and messages of the compiler of each source.
    """
    cache = compiled_object_cache.CompiledObjectCache(folder, compiler)

    def compile_source(numbered: tuple[int, str]) -> tuple[Path, str]:
        k, source = numbered
        output = folder / f"{k}-{Path(source).stem}.cpp.o"
        options = _select_platform_flags(command) if Path(source).is_relative_to(platforms.FOLDER) else command
        return cache.compile(Path(source), [*options, source], output, lambda full: _compile(main, full, platform))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(compile_source, enumerate(sources)))


def _compile_registers(
    source: Path, compiler: str, platform_flags: Sequence[str], flags: Sequence[str], folder: Path
) -> str:
    """Compile the source of the registers for programs in C, without what the user's flags add to code, such as a meter.

    Args:
        source: The source.
        compiler: The compiler for C++.
        platform_flags: Flags of the platform.
        flags: Flags of the user, of which definitions and those of the processor are used.
        folder: Folder for temporary files.

    Returns:
        The object file.
    """
    selected = [flag for flag in flags if flag[:2] in ("-D", "-U", "-m")]
    command = [
        *compiler.split(), "-c", "-fPIC", "-O2", "-g", *_list_flags_for_statics(compiler), *platform_flags,
        f"-I{get_include_folder()}", *selected,
    ]  # fmt: skip
    ((output, _),) = _compile_cplusplus([str(source)], compiler, command, folder, source, None)
    return str(output)


_USER_CHOICES = re.compile(r"-I(?=.)|-O|-g(?!nu)|-std=|-w$|-W(?![lpa],)")
"""Flags that are about the user's sources: folders, optimization, language and warnings."""


def _select_platform_flags(command: Sequence[str]) -> list[str]:
    """Return a command without what is about the user's sources, so that a platform's source is compiled once for all."""
    package_folder = f"-I{get_include_folder()}"
    folders = {k + n for k, flag in enumerate(command) if flag == "-iquote" for n in (0, 1)}
    selected = [
        flag
        for k, flag in enumerate(command)
        if k not in folders and (flag.startswith(package_folder) or not _USER_CHOICES.match(flag))
    ]
    return [*selected, "-O2", "-g"]


def _compile(source: Path, command: list[str], platform: platforms.Platform | None = None) -> str:
    """Run a compiler and return its messages. Raises CompileError."""
    has_failed, message = _run_compiler(command)
    if has_failed:
        raise _make_compile_error(source, command, message, platform)
    return message


def _link(sources: Sequence[Path], command: list[str], platform: platforms.Platform | None) -> str:
    """Compile and link a library of firmware or of a device, and return the messages.

    Raises:
        CompileError: A source does not compile, or a function is missing that no library of this process has either. The loader
            would report the function without the place that calls it.
    """
    has_failed, message = _run_compiler([*command, *LINK_FLAGS])
    absent = [name for name in _UNDEFINED.findall(message) if not _is_loaded(name)]
    if has_failed and _UNDEFINED.search(message) and not absent:
        has_failed, message = _run_compiler(command)
    if has_failed and _LINKER_ERROR.search(message):
        names = ", ".join(map(str, sources))
        message = _demangle(message)
        hint = _suggest_files(list(map(_demangle, absent)), sources, platform) or LINK_HINT * bool(absent)
        raise CompileError(f"{names}: the linker fails ({command[0]}):\n{message}{hint}", message)
    if has_failed:
        raise _make_compile_error(sources[0], command, message, platform)
    return message


def _suggest_files(names: Sequence[str], sources: Sequence[Path], platform: platforms.Platform | None) -> str:
    """Name the files that define missing functions and are not compiled, beside the sources and in the folders of libraries.

    Args:
        names: Names of the functions as the linker has them.
        sources: Sources that are compiled.
        platform: Platform of the sources, with its libraries.
    """
    libraries = platform.libraries if platform is not None else ()
    compiled = {file.resolve() for file in (*sources, *(file for library in libraries for file in library.sources))}
    files = [file for folder in dict.fromkeys(source.parent for source in sources) for file in sorted(folder.iterdir())]
    files += [file for library in libraries for file in sorted(library.folder.rglob("*"))]
    texts = {
        file: file.read_text(**platforms.ENCODING)
        for file in files
        if file.suffix in SOURCE_SUFFIXES and file.is_file() and file.resolve() not in compiled
    }
    lines = []
    for name in dict.fromkeys(names):
        word = re.escape(re.split(r"[(<]", name)[0])
        definition = next(
            (file for file, text in texts.items() if re.search(rf"(?<!\w){word}\s*\([^;{{}}]*\)[^;{{}}]*{{", text)),
            None,
        )
        lines += [f"\n{name} is in {definition}: give this file as well."] if definition else []
    return "".join(lines)


def _make_compile_error(
    source: Path, command: list[str], message: str, platform: platforms.Platform | None
) -> CompileError:
    """Make the error of a source that does not compile."""
    return CompileError(
        f"{source} does not compile ({command[0]}):\n{message}{platforms.suggest_platform(platform, message)}", message
    )


def _run_compiler(command: list[str]) -> tuple[bool, str]:
    """Run a compiler; return whether it has failed, and its messages about the sources."""
    done = run_program(command)
    return done.returncode != 0, platforms.remove_wrappers((done.stderr + done.stdout).strip())


def _is_loaded(symbol: str) -> bool:
    """Return whether this process or a preloaded sanitizer has a symbol that a library lacks."""
    return bool(re.match("__(?:[a-z]{1,2}san_|sanitizer_)", symbol)) or hasattr(ctypes.CDLL(None), symbol)


def _preprocess(source: Path, platform_flags: Sequence[str], flags: Sequence[str]) -> str:
    """Return the preprocessed text of a C source, in which registers can be memory, and the errors of the preprocessor."""
    command = [
        *find_compiler().split(), "-E", *platform_flags, f"-D{platforms.REGISTERS_IN_C}", f"-I{get_include_folder()}",
        *_select_c_flags(flags), str(source),
    ]  # fmt: skip
    result = run_program(command)
    return result.stderr + result.stdout


def _find_report_flags(flags: tuple[str, ...]) -> tuple[str, ...]:
    """Return the flags with which the C compiler reports accesses to memory; empty if it cannot, with these flags of the user."""
    return _try_report_flags(
        find_compiler(), tuple(flag for flag in _select_c_flags(flags) if flag[:2] in ("-f", "-m"))
    )


@functools.cache
def _try_report_flags(compiler: str, flags: tuple[str, ...]) -> tuple[str, ...]:
    """Return the first of `_REPORT_FLAGS` with which a compiler reports a volatile access, or an empty tuple."""
    with tempfile.TemporaryDirectory(prefix="pulsestage-") as folder:
        source, output = Path(folder, "probe.c"), Path(folder, "probe.o")
        source.write_text("int probe(volatile int *at) { return *at; }\n", encoding="utf-8")
        for candidate in _REPORT_FLAGS:
            result = run_program([*compiler.split(), "-c", *candidate, *flags, str(source), "-o", str(output)])
            if result.returncode == 0 and b"__tsan_volatile_read4" in output.read_bytes():
                return candidate
    return ()


def _describe_unreported(source: Path, flags: Sequence[str]) -> str:
    """Return the message about a C source that is compiled as C++ because the compiler does not report its accesses."""
    blocked = [flag for flag in flags if re.match(r"-fsanitize=|-flto", flag)]
    reason = f" with {' '.join(blocked)}" if blocked and _find_report_flags(()) else ""
    return (
        f"{source}: compiled as C++, because {find_compiler()}{reason} does not report accesses to registers. gcc 11 and later do, "
        "without -flto and the sanitizers address, leak and thread; in C++, names such as `new` and `class` do not compile."
    )


def _select_c_flags(flags: Sequence[str]) -> list[str]:
    """Return the flags without those that the compilation of a single C source does not accept: files, libraries, and C++ flags."""
    return [
        flag
        for flag in flags
        if not re.match(r"-l|-L|-Wl,|-std=(?:c|gnu)\+\+|[^-].*\.(?:o|a|so[.\d]*|dylib|c|cc|cpp|cxx)$", flag)
    ]


def _select_compiler_flags(flags: Sequence[str]) -> list[str]:
    """Return the flags for sources in C++: without those of the linker, without files, and without the standard of C."""
    return [
        *(flag for flag in flags if re.match(r"-std=(?:c|gnu)\+\+", flag)),
        *(f for f in _select_c_flags(flags) if f[:5] != "-std="),
    ]


def _list_cplusplus_flags(compiler: str, is_like_c: bool, flags: tuple[str, ...]) -> list[str]:
    """Return the flags that a compilation as C++ needs in addition.

    Args:
        compiler: The compiler.
        is_like_c: Whether C is compiled as C++. An endless loop, and a function without a return whose value nobody uses, then keep
            their meaning in C.
        flags: Flags of the user.
    """
    selected = [*_list_flags_for_statics(compiler)]
    if is_like_c and not any(flag.startswith("-fsanitize") for flag in flags):
        selected += ["-fno-finite-loops"]
        if _GCC_FLAG in selected:  # these make it leave the end of such a function as it is, and need no library
            selected += ["-fsanitize=unreachable", "-fno-sanitize=return", "-fsanitize-undefined-trap-on-error"]
        else:
            selected += ["-fno-strict-return"]
    return selected


@functools.cache
def _list_flags_for_statics(compiler: str) -> tuple[str, ...]:
    """Return the flag with which GCC gives every copy of a library its own static variables; empty for other compilers.

    Without it, static variables of inline functions and templates are shared among all copies in a process, even of different runs.
    """
    return (_GCC_FLAG,) if "Free Software Foundation" in compiled_object_cache.describe_compiler(compiler) else ()


def _list_files(firmware: str | os.PathLike | Sequence[str | os.PathLike]) -> list[str | os.PathLike]:
    """Return a single path or a sequence of paths as a list."""
    files = [firmware] if isinstance(firmware, str | os.PathLike) else firmware
    if not (isinstance(files, Sequence) and files and all(isinstance(file, str | os.PathLike) for file in files)):
        raise ArgumentError(f"firmware={firmware!r}: give the path of a library or of a source, or a list of sources.")
    return list(files)


def are_sources(firmware: str | os.PathLike | Sequence[str | os.PathLike]) -> bool:
    """Return whether `firmware` consists of sources that must be built first."""
    return all(str(file).endswith(SOURCE_SUFFIXES) for file in _list_files(firmware))


def find_or_build_library(
    firmware: str | os.PathLike | Sequence[str | os.PathLike],
    flags: Sequence[str] = (),
    platform: str | None = None,
    folder: Path | None = None,
    metered: bool = False,
    libraries: Sequence[str | os.PathLike] = (),
) -> Path:
    """Return the library that `firmware` names, or build it from sources.

    Args:
        firmware: A library, or sources.
        flags: Flags for the compiler.
        platform: Platform for which the sources were written.
        folder: Folder in which the library is built.
        metered: Whether the library counts its basic blocks.
        libraries: Folders of Arduino libraries that a sketch uses.

    Raises:
        ArgumentError: There is more than one library, or a platform for a library; other errors are those of `build` and
            `check_library`.
    """
    firmware_files = _list_files(firmware)
    if are_sources(firmware_files):
        output = folder / f"{Path(firmware_files[0]).stem}.so" if folder else None
        return check_library(build(firmware_files, output, flags, platform, metered, libraries))
    if libraries:
        raise ArgumentError(
            f"library {os.fspath(libraries[0])}: it is compiled with the sources of a sketch, and {firmware_files[0]} is built "
            "already. Give the sketch in its place."
        )
    if platform is not None:
        raise ArgumentError(
            f"platform={platform!r}: it says how sources are built, and {firmware_files[0]} is built already."
        )
    if len(firmware_files) > 1:
        raise ArgumentError(
            f"{', '.join(map(str, firmware_files))}: give one library, or sources only ({', '.join(SOURCE_SUFFIXES)})."
        )
    return check_library(firmware_files[0])


def check_library(path: str | os.PathLike) -> Path:
    """Check that a file is a library for this machine, and return its path.

    Raises:
        FileError: There is no such file.
        LibraryError: The file is no library, or one for another machine.
    """
    file = Path(path)
    if file.is_dir():
        raise FileError(f"{file} is a folder. Name a library, or the sources of one: {format_build_command()}")
    refuse_irregular(file, "library")
    if not file.is_file():
        raise FileError(f"{file}: there is no such library. Build it: {format_build_command(file)}")
    with file.open("rb") as f:
        head = read_elf_head(f.read(ELF_HEAD_SIZE))
    this_machine = MACHINE_NAMES.get(platform.machine(), platform.machine())
    if head is not None:
        kind, machine = head
        target = MACHINES.get(machine, f"machine {machine}")
        if platform.system() == "Linux" and target != this_machine:
            raise LibraryError(
                f"{file} was built for {target}, and this is {this_machine}. Build it here: {format_build_command(file)}"
                f"{_suggest_emulator(machine)}"
            )
        if kind != 3:
            what = {1: "an object file", 2: "a program", 4: "a core dump"}.get(kind, "no library")
            raise LibraryError(f"{file} is {what}, not a shared library. Build it so: {format_build_command(file)}")
    elif platform.system() == "Linux":
        raise LibraryError(
            f"{file} is no shared library of this machine ({this_machine}, ELF). Build it so: {format_build_command(file)}"
        )
    return file


def read_elf_head(head: bytes) -> tuple[int, int] | None:
    """Read e_type and e_machine from the first 20 bytes of a file; None if the file is no ELF file.

    These two numbers are all that is needed, so the project does not depend on pyelftools for them.
    """
    if head[:4] != b"\x7fELF" or len(head) < ELF_HEAD_SIZE:
        return None
    kind, machine = struct.unpack("<HH" if head[5] == 1 else ">HH", head[16:20])
    return kind, machine


def _suggest_emulator(machine: int) -> str:
    """Return a sentence that suggests emulation for a program of another machine, if it can be emulated; else ""."""
    mcu = {83: "atmega2560", 40: "cortex-m3"}.get(machine)
    return f" Or run it as it is, on an emulated processor: --mcu {mcu} (docs/targets.md)." if mcu else ""


def list_sanitizers(path: str | os.PathLike) -> list[str]:
    """Return the run-time libraries of the sanitizers with which a library was built.

    They must be loaded before all other libraries.
    """
    try:
        content = Path(path).read_bytes()
    except OSError:
        return []
    return sorted({name.decode() for name in re.findall(rb"lib(?:a|t|ub)san\.so[.\d]*", content)})


def _choose_load_mode(path: Path) -> int:
    """Return the mode in which a library is loaded.

    Normally its own symbols have priority, so that the firmware's `wait` or `pause` is not the system's. Sanitizers do not allow
    that.
    """
    deep = 0 if list_sanitizers(path) else getattr(os, "RTLD_DEEPBIND", 0)
    return deep | getattr(os, "RTLD_NOW", 0) | getattr(os, "RTLD_LOCAL", 0)


def _check_sanitizers(path: Path) -> None:
    """Raise LibraryError if a sanitizer would end this process because it was not loaded first."""
    first = [name for name in list_sanitizers(path) if not name.startswith("libubsan")]
    if first and not any(hasattr(ctypes.CDLL(None), f"__{name[3:7]}_init") for name in first):
        raise LibraryError(
            f"{path} was built with a sanitizer, whose {first[0]} has to be loaded before all else: run it in a process of its own "
            f"(isolated=True, the default), or start this program with LD_PRELOAD={first[0]}."
        )


class Library:
    """Firmware in a library of this machine, loaded by ctypes.

    Each object loads its own copy of the file, so that the variables have their initial values. The copy stays until `close`,
    because debuggers look for symbols in it.

    Args:
        path: The library.
        link: Link of the board that receives the requests.
        cost: Picoseconds that each basic block takes; 0: basic blocks are not counted.
        wiring: Lines of axes at its pins.

    Attributes:
        copy: The file that is loaded.
        handle: Handle of the loader.
        bus: The struct by which the firmware makes its requests.

    Raises:
        LibraryError: The file cannot be loaded, is no firmware, or does not count its basic blocks.
    """

    def __init__(self, path: Path, link: Link, cost: int = 0, wiring: PinWiring = EMPTY_WIRING):
        self.path, self._link, self._cost, self._wiring = path, link, cost, wiring
        self._lines = wiring.lines
        self._pin_use: np.ndarray | None = None
        self._board_pins: Sequence[int] = ()
        self._pin_reads, self._serial_use = np.full(1, 1, PIN_READS), np.zeros(1, SERIAL_USE)
        _check_sanitizers(path)
        self._scratch = TemporaryFolder()
        self.copy = Path(shutil.copy(path, self._scratch.path / path.name))
        mode = set_usual_float_mode.c()
        try:
            self._library = ctypes.CDLL(str(self.copy), mode=_choose_load_mode(path))
        except (OSError, UnicodeDecodeError) as error:  # ctypes decodes what the loader says as UTF-8
            self._scratch.close()
            text = error.object.decode(errors="replace") if isinstance(error, UnicodeDecodeError) else str(error)
            message = _demangle(text.replace(str(self.copy), str(path)).removeprefix(f"{path}: "))
            raise LibraryError(
                f"{path} cannot be loaded: {message}. Link what it needs into it, or add a source that has it (a function of a "
                f"platform that is not emulated: docs/porting.md); it is built so: {format_build_command(path)}"
            ) from None
        finally:
            restore_float_mode.c(mode)  # one that was built with -ffast-math changes it as it is loaded
        self.handle: int = self._library._handle  # ctypes shows it nowhere else
        abi = self._find_variable(ctypes.c_uint32, "pulsestage_abi").value
        if abi != ABI:
            raise LibraryError(
                f"{path} was built with pulsestage.h of version {abi}, and this is version {ABI}: build it again."
            )
        self.bus = BusStruct(ABI, ctypes.sizeof(BusStruct), link.pointer, link.request)
        self._find_variable(ctypes.c_void_p, "pulsestage_bus").value = ctypes.addressof(self.bus)
        if not hasattr(self._library, ENTRY):
            raise LibraryError(
                f"{path} has no entry point {ENTRY}: begin the firmware with `PULSESTAGE_MAIN {{ ... return 0; }}`, which "
                f"pulsestage.h defines, and build it so: {format_build_command(path)}"
            )
        self._set_meter(NO_LIMIT)
        self._connect_lines()

    def main(self) -> int:
        """Call the entry point in this thread. Basic blocks that run while the library is loaded and unloaded take no time."""
        h = self._link.record
        h["cost"], h["rest"] = self._cost, 0
        h["meter"] = self._set_meter(max(int(h["bus"]) * 1000 // self._cost, 1) if self._cost else NO_LIMIT)
        code = int(self._library[ENTRY]())
        self._set_meter(NO_LIMIT)
        return code

    def close(self) -> None:
        """Unload the library."""
        if self._pin_use is not None:
            # for `find_wiring_findings`
            tables = (self._pin_use, self._pin_reads, self._serial_use)
            self._pin_use, self._pin_reads, self._serial_use = (table.copy() for table in tables)
        if platform.system() != "Windows":
            import _ctypes

            _ctypes.dlclose(self.handle)
        self._scratch.close()

    def _set_meter(self, interval: int) -> int:
        """Let the firmware make a request every `interval` basic blocks; return the address of its counter, or 0 if it has none."""
        if not self._cost:
            return 0
        try:
            words = (ctypes.c_int64 * 2).in_dll(self._library, "pulsestage_meter")
        except ValueError:
            raise LibraryError(
                f"{self.path} does not count what it computes, so cost= (--cost) has nothing to go by: give the sources in place "
                f"of the library, or build it with -fsanitize-coverage=trace-pc, and with an object of {METER_SOURCE} "
                f"that is compiled "
                "without."
            ) from None
        words[0], words[1] = 0, interval
        return ctypes.addressof(words)

    def _connect_lines(self) -> None:
        """Let the pins of the firmware drive and read lines of axes."""
        self._link.irqs["watched"] = 0
        self._table = make_line_table(self._lines, self._link.stage)
        try:
            table = (ctypes.c_int64 * 2).in_dll(self._library, "pulsestage_pins")
            use = (ctypes.c_uint8 * PIN_USE.itemsize).in_dll(self._library, "pulsestage_pin_use")
        except ValueError:
            if not self._lines:
                return
            raise LibraryError(
                f"{self.path} has no pins for --pins {self._lines[0]}: it was built with an older pulsestage.h. Build it again: "
                f"{format_build_command(self.path)}"
            ) from None
        if hasattr(self._library, "pulsestage_board_pins"):  # a sketch for an Arduino
            board_pins = (ctypes.c_uint8 * 71).in_dll(self._library, "pulsestage_board_pins")
            self._board_pins = board_pins[1 : 1 + board_pins[0]]
            check_board_pins(self._lines, self._board_pins)
        if any("step" in chip.INPUTS for chip in self._link.stage.chips):
            table[0], table[1] = self._table.ctypes.data, len(self._table)
        self._pin_use = np.ctypeslib.as_array(use).view(PIN_USE)
        self._pin_reads = self._view_variable("pulsestage_pin_reads", self._pin_reads)
        self._serial_use = self._view_variable("pulsestage_serial_use", self._serial_use)

    def _view_variable(self, name: str, default: np.ndarray) -> np.ndarray:
        """Return a variable of the library as an array like `default`, or `default` for a library of an older pulsestage.h."""
        if not hasattr(self._library, name):
            return default
        content = (ctypes.c_uint8 * default.nbytes).in_dll(self._library, name)
        return np.ctypeslib.as_array(content).view(default.dtype)

    def find_wiring_findings(self) -> tuple[WiringFinding, ...]:
        """Return the signs that lines of axes are at the wrong pins of the firmware."""
        if self._pin_use is None:
            return ()
        silent = find_sends_with_transmitter_off(self._serial_use[0])
        if not (self._lines or self._pin_use.view("u1").any()):
            return silent
        use = FirmwarePinUse(self._pin_use[0], self._pin_reads[0], tuple(self._board_pins))
        return find_firmware_wiring_findings(self._table, self._wiring, use, self._link.stage) + silent

    def _find_variable(self, c_type: Any, name: str) -> Any:
        """Return an exported variable of the library. Raises LibraryError if it has none of this name."""
        try:
            return c_type.in_dll(self._library, name)
        except ValueError:
            raise LibraryError(
                f"{self.path} has no {name}: it was not built with pulsestage.h, so nobody knows whether its {ENTRY} is meant. "
                "Write `#include <pulsestage.h>` and `PULSESTAGE_MAIN { ... }`, and build it so: "
                f"{format_build_command(self.path)}"
            ) from None
