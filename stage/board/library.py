"""What a firmware library must be, how to build one, and what to say if it is none."""

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
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stage.board import platforms
from stage.board.bus.requests import REQUEST, compute_as_before, compute_as_usual
from stage.board.errors import CompileError, CompilerWarning, LibraryError, NoCompilerError
from stage.board.scratch import Scratch
from stage.errors import ArgumentError, escape
from stage.support.arguments import told
from stage.support.files import FileError, refuse_irregular
from stage.support.processes import run_program

if TYPE_CHECKING:
    from stage.board.link import Link

ABI = 1
SOURCES = (".c", ".cc", ".cpp", ".cxx", ".ino")
ENTRY = "pulsestage_main"
NEVER = (1 << 63) - 1  # of what a meter counts
OWN_FIRST = ("-Wl,-Bsymbolic",) if sys.platform == "linux" else ()
"""Calls within the firmware go to its own functions, whatever their names."""
COMPLETE = ("-lm", "-Wl,-z,defs") if sys.platform == "linux" else ()
"""What no library is to lack, for the linker."""
HINT = (
    "\nAdd the source or library that has it. A function of a platform may not be emulated (docs/porting.md); one in C that C++ "
    'calls is declared extern "C".'
)
_UNDEFINED = re.compile(r"undefined (?:reference to|symbol:?) [`'\"]?(.+?)['\"]?$", re.M)
_OF_LINKER = re.compile(r"^collect2: |ld returned \d|linker command failed", re.M)
_OF_GCC = "-fno-gnu-unique"
METER = Path(__file__).parent / "meter.c"
"""What counts the basic blocks of firmware whose computing takes time."""
MACHINES = {
    2: "SPARC", 3: "x86 (32 bit)", 4: "68000", 8: "MIPS", 20: "PowerPC", 40: "ARM (32 bit)", 42: "SuperH", 62: "x86-64", 83: "AVR",
    94: "Xtensa", 105: "MSP430", 183: "aarch64", 243: "RISC-V",
}  # fmt: skip
"""By e_machine of an ELF file."""
ELF_HEAD_SIZE = 20
_OURS = {"x86_64": "x86-64", "AMD64": "x86-64", "arm64": "aarch64"}


def _demangle(message: str) -> str:
    """Write names of C++ functions as their source has them, where there is c++filt."""
    for name in dict.fromkeys(re.findall(r"\b_Z\w+", message)) if shutil.which("c++filt") else ():
        message = message.replace(name, run_program(["c++filt", name]).stdout.strip() or name)
    return message


class BusStruct(ctypes.Structure):
    """struct pulsestage_bus of pulsestage.h."""

    _fields_ = (("abi", ctypes.c_uint32), ("size", ctypes.c_uint32), ("host", ctypes.c_void_p), ("request", REQUEST))


def include() -> Path:
    """The folder of pulsestage.h."""
    return Path(__file__).parent


def how_to_build(path: Any = "driver.so") -> str:
    """The command that builds a library."""
    suffix = ".dylib" if platform.system() == "Darwin" else ".dll" if platform.system() == "Windows" else ".so"
    if Path(path).suffix == ".rs":
        return f"rustc --edition 2024 --crate-type cdylib {path} -o {Path(path).stem}{suffix}"
    if Path(path).suffix == ".zig":
        return f"zig build-lib -dynamic -O ReleaseSafe {path}"
    return f'cc -shared -fPIC -I"$(stage include)" {Path(path).stem}.c -o {Path(path).stem}{suffix}'


def compiler(source: str | Path = "x.c") -> str:
    """The compiler for a source: $CC or cc, of C++ $CXX or c++. Raises NoCompilerError."""
    variable, usual = (
        ("CC", ("cc", "gcc", "clang")) if Path(source).suffix == ".c" else ("CXX", ("c++", "g++", "clang++"))
    )
    for name in (os.environ.get(variable, ""), *usual):
        if name and shutil.which(name.split()[0]):
            return name
    raise NoCompilerError(
        f"no compiler for {source}: none of {', '.join(usual)} is on the PATH, and ${variable} is not set."
    )


@told
def build(
    sources: str | os.PathLike | Sequence[str | os.PathLike],
    output: str | os.PathLike | None = None,
    flags: Sequence[str] = (),
    platform: str | None = None,
    metered: bool = False,
) -> Path:
    """Build a firmware library from C or C++ sources.

    C is compiled as C, also beside C++. What the compiler and linker say of a library that they have built is a CompilerWarning.

    Args:
        sources: One source, or a sequence.
        output: The library; default: a file in a folder for temporary files.
        flags: For the compiler, after -O2 -g and the sources, so that libraries can be among them.
        platform: What the sources were written for, see stage.board.platforms.
        metered: Whether the library counts its basic blocks, for NativeHost(cost=...).

    Returns:
        The path of the library.

    Raises:
        FileError: A source is missing.
        NoCompilerError: There is no compiler.
        CompileError: A source does not compile, or a function is missing; with what the compiler or linker said.
        ArgumentError: Nothing to build, or an output that is a source.
    """
    files = [Path(s) for s in ([sources] if isinstance(sources, str | os.PathLike) else sources)]
    if not files:
        raise ArgumentError("nothing to build: give at least one source.")
    for file in files:
        refuse_irregular(file, "source")
        if not file.is_file():
            raise FileError(f"{file}: there is no such source.")
    if output is not None and Path(output).suffix in (*SOURCES, ".h", ".hpp", ".o"):
        raise ArgumentError(
            f"output {os.fspath(output)}: a library is written there, and this is the name of a source. Several sources are one "
            "list: build([a, b]); the output ends in .so."
        )
    of = platforms.platform_of(platform, files)
    files = platforms.whole(files)
    made = Path(output) if output else Path(tempfile.mkdtemp(prefix="pulsestage-")) / f"{files[0].stem}.so"
    with tempfile.TemporaryDirectory(prefix="pulsestage-") as folder:
        meter = Path(folder) / "meter.o"
        if metered:
            flags = ("-fsanitize-coverage=trace-pc", str(meter), *flags)
            _compile(
                METER, [*compiler(METER).split(), "-c", "-fPIC", "-O2", f"-I{include()}", str(METER), "-o", str(meter)]
            )
        recipe = platforms.recipe(
            of,
            files,
            Path(folder),
            lambda source, platform_flags: _needs_cplusplus(source, platform_flags, flags, folder),
        )
        common = ["-fPIC", "-O2", "-g", *recipe.flags, f"-I{include()}"]
        messages, objects = [], []
        for k, source in enumerate(recipe.c_files):
            objects.append(f"{folder}/{k}-{source.stem}.o")
            command = [*compiler("x.c").split(), "-c", *common, *_flags_of_c(flags), str(source), "-o", objects[-1]]
            messages.append(_compile(source, command, of))
        name = compiler("x.cpp" if recipe.cplusplus else "x.c")
        command = [
            *name.split(), "-shared", *common, *OWN_FIRST, *recipe.cplusplus_flags,
            *(_flags_of_cplusplus(name, recipe.is_like_c, tuple(flags)) if recipe.cplusplus else ()),
            *recipe.files, *objects, *flags, "-o", str(made),
        ]  # fmt: skip
        messages.append(_link(files, command, of))
        if warning := "\n".join(filter(None, messages)):
            warnings.warn(escape(f"{files[0]}: the compiler warns:\n{warning}"), CompilerWarning, stacklevel=2)
    return made


def _compile(source: Path, command: list[str], platform: platforms.Platform | None = None) -> str:
    """Run a compiler; return what it said. Raises CompileError."""
    has_failed, message = _run(command)
    if has_failed:
        raise _refuse(source, command, message, platform)
    return message


def _link(sources: Sequence[Path], command: list[str], platform: platforms.Platform | None) -> str:
    """Compile and link a library; return what was said. Raises CompileError, also for a function that no source has and no library
    of this process: the loader would name it without the place that calls it."""
    has_failed, message = _run([*command, *COMPLETE])
    absent = [name for name in _UNDEFINED.findall(message) if not _is_loaded(name)]
    if has_failed and _UNDEFINED.search(message) and not absent:
        has_failed, message = _run(command)
    if has_failed and _OF_LINKER.search(message):
        names = ", ".join(map(str, sources))
        raise CompileError(f"{names}: the linker fails ({command[0]}):\n{message}{HINT * bool(absent)}", message)
    if has_failed:
        raise _refuse(sources[0], command, message, platform)
    return message


def _refuse(source: Path, command: list[str], message: str, platform: platforms.Platform | None) -> CompileError:
    """Make the error of a source that does not compile."""
    return CompileError(
        f"{source} does not compile ({command[0]}):\n{message}{platforms.hint(platform, message)}", message
    )


def _run(command: list[str]) -> tuple[bool, str]:
    """Run a compiler; return whether it has failed, and what it said of the sources."""
    done = run_program(command)
    return done.returncode != 0, platforms.leave_wrappers_out((done.stderr + done.stdout).strip())


def _is_loaded(symbol: str) -> bool:
    """Tell whether a symbol that a library lacks is found when it is loaded: in this process, or in a sanitizer loaded first."""
    return bool(re.match("__(?:[a-z]{1,2}san_|sanitizer_)", symbol)) or hasattr(ctypes.CDLL(None), symbol)


def _needs_cplusplus(source: Path, platform_flags: Sequence[str], flags: Sequence[str], folder: str) -> bool:
    """Tell whether a source in C includes a header of its platform that is C++ here."""
    arguments = [
        "-E",
        *platform_flags,
        f"-I{include()}",
        *_flags_of_c(flags),
        str(source),
        "-o",
        f"{folder}/preprocessed",
    ]
    command = [*compiler("x.c").split(), *arguments]
    return platforms.IS_CPLUSPLUS in run_program(command).stderr


def _flags_of_c(flags: Sequence[str]) -> list[str]:
    """Leave out what a compilation of one source in C does not take: files, libraries, and what is said of C++."""
    return [
        flag
        for flag in flags
        if not re.match(r"-l|-L|-Wl,|-std=(?:c|gnu)\+\+|[^-].*\.(?:o|a|so[.\d]*|dylib|c|cc|cpp|cxx)$", flag)
    ]


def _flags_of_cplusplus(compiler: str, is_like_c: bool, flags: tuple[str, ...]) -> list[str]:
    """Return flags that C++ needs. is_like_c: C is compiled as C++, in which a loop without end, and a function without a return
    whose value nobody takes, mean what they do in C."""
    selected = [*_own_statics(compiler)]
    if is_like_c and not any(flag.startswith("-fsanitize") for flag in flags):
        selected += ["-fno-finite-loops"]
        if selected[0] == _OF_GCC:  # what makes it leave the end of such a function as it is, and needs no library
            selected += ["-fsanitize=unreachable", "-fno-sanitize=return", "-fsanitize-undefined-trap-on-error"]
        else:
            selected += ["-fno-strict-return"]
    return selected


@functools.cache
def _own_statics(compiler: str) -> tuple[str, ...]:
    """GCC makes static variables of inline functions and templates one for all copies of a library in a process, even of different
    runs. Other compilers do not, and do not know the flag."""
    message = run_program([*compiler.split(), "--version"]).stdout
    return (_OF_GCC,) if "Free Software Foundation" in message else ()


def _listed(firmware: str | os.PathLike | Sequence[str | os.PathLike]) -> list[str | os.PathLike]:
    files = [firmware] if isinstance(firmware, str | os.PathLike) else firmware
    if not (isinstance(files, Sequence) and files and all(isinstance(file, str | os.PathLike) for file in files)):
        raise ArgumentError(f"firmware={firmware!r}: give the path of a library or of a source, or a list of sources.")
    return list(files)


def are_sources(firmware: str | os.PathLike | Sequence[str | os.PathLike]) -> bool:
    """Whether this is to be built first."""
    return all(str(file).endswith(SOURCES) for file in _listed(firmware))


def ready(
    firmware: str | os.PathLike | Sequence[str | os.PathLike],
    flags: Sequence[str] = (),
    platform: str | None = None,
    folder: Path | None = None,
    metered: bool = False,
) -> Path:
    """The library that `firmware` is, or that is built from it, in `folder`. Raises as `build` and `check`."""
    firmware_files = _listed(firmware)
    if are_sources(firmware_files):
        output = folder / f"{Path(firmware_files[0]).stem}.so" if folder else None
        return check(build(firmware_files, output, flags, platform=platform, metered=metered))
    if platform is not None:
        raise ArgumentError(
            f"platform={platform!r}: it says how sources are built, and {firmware_files[0]} is built already."
        )
    if len(firmware_files) > 1:
        raise ArgumentError(
            f"{', '.join(map(str, firmware_files))}: give one library, or sources only ({', '.join(SOURCES)})."
        )
    return check(firmware_files[0])


def check(path: str | os.PathLike) -> Path:
    """The path if there is a library for this machine. Raises LibraryError or FileError."""
    file = Path(path)
    if file.is_dir():
        raise FileError(f"{file} is a folder. Name a library, or the sources of one: {how_to_build()}")
    refuse_irregular(file, "library")
    if not file.is_file():
        raise FileError(f"{file}: there is no such library. Build it: {how_to_build(file)}")
    with file.open("rb") as f:
        head = read_elf_head(f.read(ELF_HEAD_SIZE))
    ours = _OURS.get(platform.machine(), platform.machine())
    if head is not None:
        kind, machine = head
        theirs = MACHINES.get(machine, f"machine {machine}")
        if platform.system() == "Linux" and theirs != ours:
            raise LibraryError(
                f"{file} was built for {theirs}, and this is {ours}. Build it here: {how_to_build(file)}{_emulated(machine)}"
            )
        if kind != 3:
            what = {1: "an object file", 2: "a program", 4: "a core dump"}.get(kind, "no library")
            raise LibraryError(f"{file} is {what}, not a shared library. Build it so: {how_to_build(file)}")
    elif platform.system() == "Linux":
        raise LibraryError(
            f"{file} is no shared library of this machine ({ours}, ELF). Build it so: {how_to_build(file)}"
        )
    return file


def read_elf_head(head: bytes) -> tuple[int, int] | None:
    """Read e_type and e_machine from the first 20 bytes of a file; None for no ELF file.

    Firmware of this machine needs these two numbers only, which are no reason for a dependency on pyelftools.
    """
    if head[:4] != b"\x7fELF" or len(head) < ELF_HEAD_SIZE:
        return None
    kind, machine = struct.unpack("<HH" if head[5] == 1 else ">HH", head[16:20])
    return kind, machine


def _emulated(machine: int) -> str:
    """What to do with a program of another machine that can be emulated."""
    mcu = {83: "atmega2560", 40: "cortex-m3"}.get(machine)
    return f" Or run it as it is, on an emulated processor: --mcu {mcu} (docs/targets.md)." if mcu else ""


def sanitizers(path: str | os.PathLike) -> list[str]:
    """The run-time libraries of sanitizers that a library was built with: they have to be loaded before all others."""
    try:
        content = Path(path).read_bytes()
    except OSError:
        return []
    return sorted({name.decode() for name in re.findall(rb"lib(?:a|t|ub)san\.so[.\d]*", content)})


def _mode(path: Path) -> int:
    """How a library is loaded: its own symbols win, so that a `wait` or `pause` of the firmware is not the system's. Sanitizers do
    not allow that."""
    own = 0 if sanitizers(path) else getattr(os, "RTLD_DEEPBIND", 0)
    return own | getattr(os, "RTLD_NOW", 0) | getattr(os, "RTLD_LOCAL", 0)


def _check_sanitizers(path: Path) -> None:
    """Raises LibraryError where a sanitizer would end this process, since it was not loaded first."""
    first = [name for name in sanitizers(path) if not name.startswith("libubsan")]
    if first and not any(hasattr(ctypes.CDLL(None), f"__{name[3:7]}_init") for name in first):
        raise LibraryError(
            f"{path} was built with a sanitizer, whose {first[0]} has to be loaded before all else: run it in a process of its own "
            f"(isolated=True, the default), or start this program with LD_PRELOAD={first[0]}."
        )


class Library:
    """Firmware in a library of this machine, loaded by ctypes.

    Each object has a copy of its own, so that its variables begin as they were compiled. The file of the copy stays until `close`:
    debuggers look for symbols there.

    Args:
        path: The library.
        link: The board's, to which its requests go.
        cost: Picoseconds that each of its basic blocks takes; 0: it does not count them.

    Attributes:
        copy: The file that is loaded.
        handle: What the loader calls it.
        bus: The struct that it makes its requests by.

    Raises:
        LibraryError: It cannot be loaded, is no firmware, or does not count its basic blocks.
    """

    def __init__(self, path: Path, link: Link, cost: int = 0):
        self.path, self._link, self._cost = path, link, cost
        _check_sanitizers(path)
        self._scratch = Scratch()
        self.copy = Path(shutil.copy(path, self._scratch.path / path.name))
        mode = compute_as_usual.c()
        try:
            self._library = ctypes.CDLL(str(self.copy), mode=_mode(path))
        except (OSError, UnicodeDecodeError) as error:  # ctypes decodes what the loader says as UTF-8
            self._scratch.close()
            whole = error.object.decode(errors="replace") if isinstance(error, UnicodeDecodeError) else str(error)
            message = _demangle(whole.replace(str(self.copy), str(path)).removeprefix(f"{path}: "))
            raise LibraryError(
                f"{path} cannot be loaded: {message}. Link what it needs into it, or add a source that has it (a function of a "
                f"platform that is not emulated: docs/porting.md); it is built so: {how_to_build(path)}"
            ) from None
        finally:
            compute_as_before.c(mode)  # one that was built with -ffast-math changes it as it is loaded
        self.handle: int = self._library._handle  # ctypes shows it nowhere else
        abi = self._variable(ctypes.c_uint32, "pulsestage_abi").value
        if abi != ABI:
            raise LibraryError(
                f"{path} was built with pulsestage.h of version {abi}, and this is version {ABI}: build it again."
            )
        self.bus = BusStruct(ABI, ctypes.sizeof(BusStruct), link.pointer, link.request)
        self._variable(ctypes.c_void_p, "pulsestage_bus").value = ctypes.addressof(self.bus)
        if not hasattr(self._library, ENTRY):
            raise LibraryError(
                f"{path} has no entry point {ENTRY}: begin the firmware with `PULSESTAGE_MAIN {{ ... return 0; }}`, which "
                f"pulsestage.h defines, and build it so: {how_to_build(path)}"
            )
        self._set_meter(NEVER)

    def main(self) -> int:
        """Call its entry in this thread. What it counts while it is loaded and unloaded takes no time."""
        h = self._link.record
        h["cost"], h["rest"] = self._cost, 0
        h["meter"] = self._set_meter(max(int(h["bus"]) * 1000 // self._cost, 1) if self._cost else NEVER)
        code = int(self._library[ENTRY]())
        self._set_meter(NEVER)
        return code

    def close(self) -> None:
        """Unload it."""
        if platform.system() != "Windows":
            import _ctypes

            _ctypes.dlclose(self.handle)
        self._scratch.close()

    def _set_meter(self, interval: int) -> int:
        """Have the firmware make a request every `interval` basic blocks. Return where it counts them, or 0 if it need not."""
        if not self._cost:
            return 0
        try:
            words = (ctypes.c_int64 * 2).in_dll(self._library, "pulsestage_meter")
        except ValueError:
            raise LibraryError(
                f"{self.path} does not count what it computes, so cost= (--cost) has nothing to go by: give the sources in place "
                f"of the library, or build it with -fsanitize-coverage=trace-pc, and with an object of {METER} that is compiled "
                "without."
            ) from None
        words[0], words[1] = 0, interval
        return ctypes.addressof(words)

    def _variable(self, kind: Any, name: str) -> Any:
        try:
            return kind.in_dll(self._library, name)
        except ValueError:
            raise LibraryError(
                f"{self.path} has no {name}: it was not built with pulsestage.h, so nobody knows whether its {ENTRY} is meant. "
                f"Write `#include <pulsestage.h>` and `PULSESTAGE_MAIN {{ ... }}`, and build it so: {how_to_build(self.path)}"
            ) from None
