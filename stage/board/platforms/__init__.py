"""Platforms that a driver was written for: headers under the platform's own names, and where its program begins.

With `platform="vxworks"` the folder of that platform stands before all others in the include path, so that the driver's own
`#include <vxWorks.h>` finds ours; port functions become cycles of the board, delays and ticks its time, the platform's interrupt
functions its interrupt line. A program is given its entry, see `entry.c` there, unless it has PULSESTAGE_MAIN itself.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from pathlib import Path

from stage.board.platforms.arduino_library_folder import ArduinoLibrary, read_arduino_library, suggest_dependencies
from stage.board.platforms.arduino_sketch_to_cpp import SKETCHES, list_sketch_files, translate_sketch
from stage.errors import ArgumentError, unknown_name_error

FOLDER = Path(__file__).parent
WRAPPER_SUFFIX = ".pulsestage.cpp"
"""Ending of files that are made to compile C as C++."""
CPLUSPLUS_HEADER_MESSAGE = "is C++ here"
"""Error message of a header that has to be compiled as C++."""
REGISTERS_IN_C = "PULSESTAGE_REGISTERS_IN_C"
"""Macro with which headers of registers can be included in C: the compiler reports each access to memory."""
_REGISTER_HEADER = "avr/registers_.h"
_BOARD_WORDS = re.compile(r"\bps_\w+\s*\(|\bPULSESTAGE_MAIN\b")
"""Names of pulsestage.h, which the headers of registers include in C++, and which programs in C may expect from them."""
_CPLUSPLUS_WORDS = re.compile(r"\bPinBus\b|\bpulsestage::")
_BLANK = r"(?:\s|//[^\n]*\n|/\*.*?\*/)*"
_ENDLESS_LOOP = re.compile(
    r'"(?:\\.|[^"\\\n])*"|'
    r"'(?:\\.|[^'\\\n])*'|//[^\n]*|/\*.*?\*/|"
    r"\b(for\s*\(\s*;\s*;\s*\)|while\s*\(\s*(?:1|true)\s*\))" + rf"{_BLANK}(?:;|\{{{_BLANK}(?:;{_BLANK})?\}})",
    re.DOTALL,
)
"""Strings and comments, which stay, and endless loops with nothing in them, whose heads are group 1."""
_DO_BODY = re.compile(r"(?:\}|\bdo\b[^;{}]*;)\s*$")
"""End of the body of a do loop, after which `while` does not begin a loop; or of a block, which looks the same."""
ENCODING = {"encoding": "utf-8", "errors": "surrogateescape"}
"""Encoding in which sources are read and written: those of other encodings keep their bytes."""


@dataclass(frozen=True)
class Platform:
    """A platform, such as Arduino, that firmware sources were written for.

    Attributes:
        name: Its name.
        title: What it is, in a line.
        begins: The functions that a program begins with.
        entry: The source that calls the program.
        folders: Folders of headers, the first in front.
        has_cplusplus_headers: Whether sources in C that include some of its headers are compiled as C++.
        c_registers: Source that is compiled with programs in C that include headers of registers.
        flags: For the compiler.
        sources: Sources that are compiled with each program.
        defaults: A folder of headers for programs that do not have them.
        external: A header of the system itself, and what to do where it is missing.
        libraries: Libraries that are compiled with the program.
    """

    name: str
    title: str
    begins: tuple[str, ...]
    entry: str
    folders: tuple[str, ...]
    has_cplusplus_headers: bool = False
    c_registers: str = ""
    flags: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    defaults: str = ""
    external: tuple[str, str] = ("", "")
    libraries: tuple[ArduinoLibrary, ...] = ()


_AVR_SOURCES = ("avr/pinbus.cpp", "avr/timers.cpp")
_AVR_FLAGS = ("-D__AVR_ATmega328P__", "-D__flash=")
"""Definitions of avr-gcc: the processor, and no other memory for constants."""
PLATFORMS: dict[str, Platform] = {
    p.name: p
    for p in (
        Platform("arduino", "an Arduino sketch: setup and loop, pins, Serial", ("setup", "loop"), "arduino/entry.cpp",
                 ("arduino", "avr"), has_cplusplus_headers=True, c_registers="avr/registers.cpp", flags=(
                     "-DPULSESTAGE_ARDUINO", "-DARDUINO=10819", "-DF_CPU=16000000L", "-DARDUINO_ARCH_AVR", "-DARDUINO_AVR_UNO",
                     *_AVR_FLAGS,
                 ), sources=(*_AVR_SOURCES, "arduino/HardwareSerial.cpp", "arduino/WString.cpp")),
        Platform("avr", "a program for an AVR: avr/io.h, avr/interrupt.h, util/delay.h", ("main",), "avr/entry.cpp", ("avr",),
                 has_cplusplus_headers=True, c_registers="avr/registers.cpp", flags=_AVR_FLAGS, sources=_AVR_SOURCES),
        Platform("vxworks", "a VxWorks driver: sysLib, taskLib, semLib, intLib, logLib", ("usrAppInit",), "vxworks/entry.c",
                 ("vxworks",)),
        Platform("dos", "a DOS program of Borland, Microsoft or Watcom C: dos.h, conio.h", ("main",), "dos/entry.c", ("dos",),
                 flags=("-include", "pulsestage_dos.h")),
        Platform("freertos", "a program on FreeRTOS, whose sources are given with it", ("main",), "freertos/entry.c", ("freertos",),
                 sources=("freertos/port.c",), defaults="freertos/defaults", external=(
                     "FreeRTOS.h",
                     "it is in FreeRTOS' own sources, which are not here: give them with the program, "
                     'F/tasks.c F/list.c F/queue.c --cflags="-IF/include" where F is the folder of FreeRTOS-Kernel',
                 )),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """The way in which firmware sources are compiled: the files and the flags for each language.

    Attributes:
        files: Sources for the compiler that links the library: C, or C++ if `cplusplus`.
        c_files: Sources in C beside C++, compiled before.
        flags: For all of them.
        c_flags: For C only.
        cplusplus_flags: For C++ only.
        is_like_c: Whether C++ includes sources in C.
        registers: Source of the registers for programs in C, if there are some.
        unreported: Sources in C that are compiled as C++ because the compiler does not report accesses to registers.
        originals: The sources by the files in C that were made from them.
    """

    files: tuple[str, ...]
    c_files: tuple[Path, ...] = ()
    flags: tuple[str, ...] = ()
    c_flags: tuple[str, ...] = ()
    cplusplus_flags: tuple[str, ...] = ()
    cplusplus: bool = False
    is_like_c: bool = False
    registers: Path | None = None
    unreported: tuple[Path, ...] = ()
    originals: Mapping[Path, Path] = field(default_factory=dict)


class CSource(Enum):
    """The kinds of sources in C."""

    PLAIN = auto()
    WITH_REGISTERS = auto()
    CPLUSPLUS = auto()
    """It includes headers that are C++ here, or uses their classes."""


def find_platform(
    name: str | None, sources: Sequence[Path], folders: Sequence[str | os.PathLike] = ()
) -> Platform | None:
    """Return the platform of that name, or that of a sketch, with the Arduino libraries of these folders; None for sources of none.

    Raises:
        ArgumentError: There is no such platform, or a sketch or a library is of another one.
        FileError: There is no such folder.
    """
    libraries = tuple(map(read_arduino_library, folders))
    sketches = [source for source in sources if source.suffix in SKETCHES]
    if name is None:
        if not (sketches or libraries):
            return None
        name = "arduino"
    if name not in PLATFORMS:
        raise unknown_name_error("platform", name, PLATFORMS)
    if sketches and name != "arduino":
        raise ArgumentError(f"{sketches[0].name}: a sketch is of the platform arduino, not {name}.")
    if libraries and name != "arduino":
        raise ArgumentError(f"library {libraries[0].name}: a library is of the platform arduino, not {name}.")
    return replace(PLATFORMS[name], libraries=libraries)


def add_sketch_files(sources: Sequence[Path]) -> list[Path]:
    """Return the sources, with the other sources in the folder of a sketch, as the Arduino tools take them."""
    return list(dict.fromkeys(file for source in sources for file in list_sketch_files(source)))


def make_recipe(
    platform: Platform | None,
    sources: Sequence[Path],
    folder: Path,
    preprocess: Callable[[Path, Sequence[str]], str] = lambda source, flags: "",
    user_flags: Sequence[str] = (),
    report_flags: Sequence[str] = (),
) -> Recipe:
    """Choose how sources are compiled: C as C, unless it includes headers of its platform that are C++ here.

    Args:
        platform: What they were written for, if they were for one.
        sources: In C, C++, or sketches.
        folder: Where translated sketches are written, and C++ that includes sources in C.
        preprocess: Function that returns the preprocessed text of a source in C, with the errors, for these flags.
        user_flags: Flags of the user, whose definitions take the place of the platform's.
        report_flags: Flags with which the C compiler reports each access to memory; empty if it cannot.

    Raises:
        ArgumentError: The function is missing that the program begins with.
    """
    if platform is None:
        return _make_recipe_by_language(sources)
    texts = {source: source.read_text(**ENCODING) for source in sources}
    sketches = [source for source in sources if source.suffix in SKETCHES]
    files = [source for source in sources if source.suffix not in SKETCHES]
    flags = [*_replace_definitions(platform.flags, user_flags), *(f"-I{FOLDER / name}" for name in platform.folders)]
    flags += ["-idirafter", str(FOLDER / platform.defaults)] if platform.defaults else []
    flags += [f"-I{path}" for library in platform.libraries for path in library.include_folders]
    if platform.name == "arduino":  # a file of the package would be Arduino.h itself where names have no case
        (folder / "arduino.h").write_text("#include <Arduino.h>\n", encoding="utf-8")
        flags += ["-idirafter", str(folder)]
    if sketches:
        sketch = folder / f"{sketches[0].stem}.ino.cpp"
        translated = translate_sketch({source: texts[source] for source in sketches})
        sketch.write_text(_ENDLESS_LOOP.sub(_replace_endless_loop, translated), **ENCODING)
        files.insert(0, sketch)
        flags.append(f"-I{sketches[0].parent}")
    text = "\n".join(texts.values())
    if "PULSESTAGE_MAIN" not in text and "pulsestage_main" not in text:
        files.append(FOLDER / platform.entry)
        for name in platform.begins:
            if not re.search(rf"\b{name}\s*\(", text):
                raise ArgumentError(
                    f"{', '.join(s.name for s in sources)}: no function {name}, and there a program of the platform "
                    f"{platform.name} begins. Add the source that has it, or one of yours with PULSESTAGE_MAIN {{ ... }}."
                )
        if re.search(r"^[^\S\n]*void[^\S\n]+(?:main|usrAppInit)[^\S\n]*\(", text, re.M):
            flags.append("-DPULSESTAGE_VOID_MAIN")
    files += [FOLDER / name for name in platform.sources]
    files += [file for library in platform.libraries for file in library.sources]
    if not platform.has_cplusplus_headers:
        return _make_recipe_by_language(files, flags)
    return _make_register_recipe(platform, files, flags, folder, preprocess, report_flags)


def _make_register_recipe(
    platform: Platform,
    files: Sequence[Path],
    flags: Sequence[str],
    folder: Path,
    preprocess: Callable[[Path, Sequence[str]], str],
    report_flags: Sequence[str],
) -> Recipe:
    """Choose how sources of a platform with registers are compiled. The arguments are those of `make_recipe`."""
    kinds = {file: _classify_c_source(preprocess(file, flags)) for file in files if file.suffix == ".c"}
    with_registers = [file for file, kind in kinds.items() if kind is CSource.WITH_REGISTERS]
    unreported = [] if report_flags else with_registers
    sources: list[Path] = []
    changed: dict[Path, Path] = {}
    for k, file in enumerate(files):
        sources.append(file)
        if kinds.get(file) is CSource.CPLUSPLUS or file in unreported:
            sources[-1] = _write_c_wrapper(file, folder / f"{k}-{file.name}{WRAPPER_SUFFIX}")
        elif file in with_registers:
            sources[-1] = _adapt_c(file, folder / f"{k}-{file.name}")
        if sources[-1] != file:
            changed[sources[-1]] = file
    flags = [
        *flags,
        *(text for f in dict.fromkeys(file.parent for file in changed.values()) for text in ("-iquote", str(f))),
    ]
    reports = bool(with_registers and report_flags)
    return replace(
        _make_recipe_by_language(sources, flags),
        c_flags=(f"-D{REGISTERS_IN_C}", *report_flags) if reports else (),
        cplusplus_flags=("-fpermissive",),
        is_like_c=any(file.name.endswith(WRAPPER_SUFFIX) for file in changed),
        registers=FOLDER / platform.c_registers if reports else None,
        unreported=tuple(unreported),
        originals=changed,
    )


def _classify_c_source(preprocessed: str) -> CSource:
    """Return the kind of a source in C by its preprocessed text with the errors of the preprocessor."""
    if CPLUSPLUS_HEADER_MESSAGE in preprocessed or _CPLUSPLUS_WORDS.search(preprocessed):
        return CSource.CPLUSPLUS
    return CSource.WITH_REGISTERS if _REGISTER_HEADER in preprocessed else CSource.PLAIN


def _replace_definitions(flags: Sequence[str], user_flags: Sequence[str]) -> list[str]:
    """Leave out the definitions of a platform that the user's flags make, and its board and processor if they name others."""
    names, added = {flag[2:].partition("=")[0] for flag in user_flags if flag[:2] in ("-D", "-U")}, []
    if any(name.startswith("ARDUINO_AVR_") for name in names):
        names.add("ARDUINO_AVR_UNO")
    if any(name.startswith("__AVR_AT") for name in names):
        names.add("__AVR_ATmega328P__")
    elif "ARDUINO_AVR_MEGA2560" in names:
        names.add("__AVR_ATmega328P__")
        added = ["-D__AVR_ATmega2560__"]
    return [flag for flag in flags if not (flag.startswith("-D") and flag[2:].partition("=")[0] in names)] + added


def _make_recipe_by_language(files: Sequence[Path], flags: Sequence[str] = ()) -> Recipe:
    """Return the recipe that compiles each source file in its own language, C or C++."""
    in_c = tuple(file for file in files if file.suffix == ".c")
    others = tuple(str(file) for file in files if file.suffix != ".c")
    if not others:
        return Recipe(tuple(map(str, in_c)), flags=tuple(flags))
    return Recipe(others, in_c, tuple(flags), cplusplus=True)


def remove_wrappers(message: str) -> str:
    """Remove the lines of a compiler about the files that include sources in C."""
    return re.sub(rf"^In file included from [^\n]*{re.escape(WRAPPER_SUFFIX)}:\d+:\n", "", message, flags=re.M)


def _write_c_wrapper(source: Path, wrapper: Path) -> Path:
    """Write a file in C++ that is a source in C: other sources in C find its functions under their own names."""
    content = _add_waits(source) or f'#include "{source.resolve()}"'
    wrapper.write_text(f'extern "C" {{\n{content}\n}}\n', **ENCODING)
    return wrapper


def _adapt_c(source: Path, copy: Path) -> Path:
    """Return a source in C, or a copy with waits in endless loops and, if it has names of pulsestage.h, with that header."""
    text = source.read_text(**ENCODING)
    header = "#include <pulsestage.h>\n" if _BOARD_WORDS.search(text) else ""
    content = _add_waits(source)
    if not (header or content):
        return source
    copy.write_text(header + (content or f'#line 1 "{source.resolve()}"\n{text}'), **ENCODING)
    return copy


def _add_waits(source: Path) -> str:
    """Return the text of a source in C whose endless loops with nothing in them, at the end of many programs, let time pass.

    The text is empty if there are no such loops.
    """
    text = source.read_text(**ENCODING)
    waiting = _ENDLESS_LOOP.sub(_replace_endless_loop, text)
    return "" if waiting == text else f'#line 1 "{source.resolve()}"\n{waiting}'


def _replace_endless_loop(match: re.Match[str]) -> str:
    """Return the text of an endless loop that waits for interrupts, in as many lines; the end of a do loop stays unchanged."""
    head = match[1]
    if head is None or (head.startswith("while") and _DO_BODY.search(match.string, 0, match.start())):
        return match[0]
    return f"{head} PULSESTAGE_IDLE();" + "\n" * match[0][len(head) :].count("\n")


def suggest_platform(platform: Platform | None, message: str) -> str:
    """Say what to do about a header that the compiler has not found; "" if its message is about something else."""
    missing = re.search(r"fatal error:? '?([\w/.]+)'?(?:: No such file| file not found)", message)
    if missing is None:
        return ""
    header = missing[1]
    if platform is not None and header == platform.external[0]:
        return f"\n{header}: {platform.external[1]}."
    if platform is not None and (dependencies := suggest_dependencies(platform.libraries)):
        return dependencies
    if platform is not None:
        return f"\n{header} is not among what is emulated of the platform {platform.name}: docs/porting.md."
    names = [p.name for p in PLATFORMS.values() if any((FOLDER / folder / header).is_file() for folder in p.folders)]
    if not names:
        return ""
    return (
        f"\n{header} is of the platform {' or '.join(names)}: --platform {names[-1]} on the command line, "
        f"platform={names[-1]!r} in Python."
    )
