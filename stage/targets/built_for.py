"""Which processor of its family a program was built for, as far as its file tells: refused where another is to run it.

An AVR's file has its architecture in the ELF flags; its name, where avr-gcc (`.note.gnu.avr.deviceinfo`) or simavr's header
(`.mmcu`) has written it. A Cortex-M's has the build attributes of Arm (`.ARM.attributes`).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from stage.board.errors import LibraryError
from stage.errors import a_or_an
from stage.targets.elf import Elf
from stage.targets.mcus import AVRS

_ARCHITECTURE = 0x7F
_UNTOLD = 2  # and below: assembled without -mmcu
_NAME = 1  # of AVR_MCU(...)
_NOTE = struct.Struct("<III")
_SMALL = "attiny"
_ARCH, _PROFILE, _FLOATS, _ARGUMENTS = 6, 7, 10, 28
_TEXTS = (4, 5, 65, 67)
_COMPATIBILITY = 32
V7, V6M, V6SM, V7EM, V8BASE, V8MAIN, V81MAIN = 10, 11, 12, 13, 16, 17, 21
_ARM_NAMES = {
    V7: "v7-M (Cortex-M3)", V6M: "v6-M (Cortex-M0)", V6SM: "v6-M (Cortex-M0)", V7EM: "v7E-M (Cortex-M4, M7)",
    V8BASE: "v8-M (Cortex-M23)", V8MAIN: "v8-M (Cortex-M33)", V81MAIN: "v8.1-M (Cortex-M55)",
}  # fmt: skip
_ARM_RUNS = {
    "cortex-m0": (V6M, V6SM),
    "cortex-m3": (V6M, V6SM, V7),
    "cortex-m4": (V6M, V6SM, V7, V7EM),
}


def avr_architecture(mcu: str) -> int:
    """The number of avr-gcc's architecture, as it stands in the ELF flags."""
    if mcu.startswith(_SMALL):
        return 25
    if mcu == "at90usb162":
        return 35
    if mcu == "atmega2560":
        return 6
    if mcu.startswith("atmega128"):
        return 51
    return 4 if re.fullmatch(r"atmega(8l?|48p?a?|88p?a?)", mcu) else 5


def check_avr(elf: Elf, mcu: str, how: str) -> None:
    """Raises LibraryError: the program is for another AVR."""
    name, number = avr_name(elf), elf.flags & _ARCHITECTURE
    wanted = avr_architecture(mcu)
    other_name = name in AVRS and _family(name) != _family(mcu)
    if number > _UNTOLD and (number != wanted or other_name):
        said = f"{name} (architecture avr{number})" if name else f"an AVR of the architecture avr{number}"
        ways = f"Run it with --mcu {name}, or build it" if name in AVRS else "Build it"
        raise LibraryError(f"{elf.path} was built for {said}, and {mcu} is an avr{wanted}. {ways} by {how}.")


def _family(name: str) -> str:
    """Without the letters of variants that run the same programs."""
    return re.sub(r"(p|a|pa|l)$", "", name)


def avr_name(elf: Elf) -> str:
    """The name of the processor, for example atmega2560; "" where nobody has written it."""
    return said_to_simavr(elf).get(_NAME, b"").split(b"\0")[0].decode("ascii", "replace").lower() or _of_note(elf)


def said_to_simavr(elf: Elf) -> dict[int, bytes]:
    """What AVR_MCU(...) of simavr's header has put into the section .mmcu, by its tags."""
    kept = [s.content for s in elf.segments if 0x910000 <= s.used_at < 0x920000]
    content = elf.section(".mmcu") or (kept[0] if kept else b"")
    found: dict[int, bytes] = {}
    at = 0
    while at + 2 <= len(content) and content[at]:
        length = content[at + 1]
        found.setdefault(content[at], content[at + 2 : at + 2 + length])
        at += 2 + length
    return found


def _of_note(elf: Elf) -> str:
    content = elf.section(".note.gnu.avr.deviceinfo")
    if len(content) < _NOTE.size:
        return ""
    name_size, size, _ = _NOTE.unpack_from(content)
    begin = _NOTE.size + (name_size + 3 & ~3)
    record = content[begin : begin + size]
    if len(record) < 36:
        return ""
    names_at = 32  # behind six sizes of memories: the offsets of names, how many bytes they have
    words = struct.unpack_from("<2I", record, 24)
    return record[names_at + words[1] :].split(b"\0")[0].decode("ascii", "replace").lower()


def check_arm(elf: Elf, mcu: str, how: str) -> None:
    """Raises LibraryError: the program has instructions that this Cortex-M does not have."""
    told = arm_attributes(elf)
    arch, profile = told.get(_ARCH, 0), chr(told.get(_PROFILE, ord("M")))
    said = ""
    if arch >= V7 and profile in "AR":
        said = f"a Cortex-{profile}"
    elif arch in _ARM_NAMES and arch not in _ARM_RUNS[mcu]:
        said = _ARM_NAMES[arch]
    elif mcu != "cortex-m4" and (told.get(_FLOATS) or told.get(_ARGUMENTS)):
        said = "a floating-point unit"
    if not said:
        return
    runs = [name for name in _ARM_RUNS if arch in _ARM_RUNS[name] and (name == "cortex-m4" or not told.get(_FLOATS))]
    ways = f"Run it with --mcu {runs[0]}, or build it" if profile == "M" and runs else "Build it"
    raise LibraryError(f"{elf.path} was built for {said}, and this is {a_or_an(mcu)}. {ways} by {how.format(mcu=mcu)}.")


def arm_attributes(elf: Elf) -> dict[int, int]:
    """The build attributes of the whole file, those that are numbers, by tag."""
    content = elf.section(".ARM.attributes")
    found: dict[int, int] = {}
    if content[:1] != b"A" or len(content) < 5:
        return found
    try:
        vendor_ends = content.index(b"\0", 5)
        if content[5:vendor_ends] == b"aeabi" and content[vendor_ends + 1] == 1:
            size = struct.unpack_from("<I", content, vendor_ends + 2)[0]
            found.update(_numbers(content[vendor_ends + 6 : vendor_ends + 1 + size]))
    except (ValueError, IndexError, struct.error):
        pass  # what is damaged tells nothing
    return found


def _numbers(content: bytes) -> Iterator[tuple[int, int]]:
    at = 0
    while at < len(content):
        tag, at = _uleb(content, at)
        is_text = tag in _TEXTS or (tag > _COMPATIBILITY and tag % 2 == 1)
        if not is_text:
            value, at = _uleb(content, at)
            yield tag, value
        if is_text or tag == _COMPATIBILITY:
            at = content.index(b"\0", at) + 1


def _uleb(content: bytes, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte = content[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not byte & 0x80:
            return value, at
