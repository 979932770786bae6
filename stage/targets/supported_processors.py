"""Processors that can be emulated, the emulator of each, and what the emulator needs."""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
from difflib import get_close_matches
from functools import cache

from stage.errors import ArgumentError, StageError
from stage.support.extras import format_install_command

AVRS = (
    "at90usb162 atmega128 atmega1280 atmega1281 atmega1284 atmega1284p atmega128rfa1 atmega128rfr2 atmega16 atmega164 atmega164p "
    "atmega164pa atmega168 atmega168p atmega168pa atmega16m1 atmega2560 atmega32 atmega324 atmega324a atmega324p atmega324pa "
    "atmega328 atmega328p atmega32u4 atmega48 atmega48p atmega48pa atmega644 atmega644p atmega8 atmega88 atmega88p atmega88pa "
    "atmega8l attiny13 attiny13a attiny2313 attiny2313a attiny24 attiny25 attiny4313 attiny44 attiny45 attiny84 attiny85"
).split()
"""Names of the supported AVRs, as simavr spells them."""
CORTEX_NAMES = ("cortex-m0", "cortex-m3", "cortex-m4")
X86_NAMES = ("8086",)
SIMAVR_REQUIREMENT = "simavr (Debian: apt install libsimavr2)"
PYELFTOOLS_REQUIREMENT = f"pyelftools ({format_install_command('targets')})"
UNICORN_REQUIREMENT = f"Unicorn ({format_install_command('targets')})"
_SIMAVR_FILES = ("libsimavr.so.2", "libsimavr.so.1", "libsimavr.so", "libsimavr.dylib")


class NoEmulatorError(StageError):
    """Error for an emulator that is not installed."""


@cache
def load_simavr() -> ctypes.CDLL:
    """Load the library of simavr. Raises NoEmulatorError if simavr or pyelftools is missing."""
    if importlib.util.find_spec("elftools") is None:
        raise NoEmulatorError(f"there is no {PYELFTOOLS_REQUIREMENT}: install it.")
    for name in (*_SIMAVR_FILES, ctypes.util.find_library("simavr")):
        if name:
            try:
                return ctypes.CDLL(name)
            except OSError:
                continue
    raise NoEmulatorError(f"there is no {SIMAVR_REQUIREMENT}: install it.")


def has_simavr() -> bool:
    """Tell whether simavr can be loaded."""
    try:
        return bool(load_simavr())
    except NoEmulatorError:
        return False


def has_unicorn() -> bool:
    """Tell whether Unicorn is installed."""
    return all(importlib.util.find_spec(name) is not None for name in ("unicorn", "elftools"))


def check_unicorn() -> None:
    """Raise NoEmulatorError if Unicorn is not installed."""
    if not has_unicorn():
        raise NoEmulatorError(f"there is no {UNICORN_REQUIREMENT}: install it.")


def check_mcu(mcu: str) -> str:
    """Return the name of a processor in lower case.

    Args:
        mcu: Name in any case.

    Raises:
        ArgumentError: The processor is unknown; the message lists the known ones.
    """
    name = str(mcu).lower()
    if name in AVRS or name in CORTEX_NAMES or name in X86_NAMES:
        return name
    near = get_close_matches(name, [*AVRS, *CORTEX_NAMES, *X86_NAMES], 1)
    rows = [
        f"by {SIMAVR_REQUIREMENT}{'' if has_simavr() else ', which is not here'}: {', '.join(AVRS)}",
        f"by {UNICORN_REQUIREMENT}{'' if has_unicorn() else ', which is not here'}: {', '.join((*CORTEX_NAMES, *X86_NAMES))}",
    ]
    hint = f" Is it {near[0]}?" if near else ""
    raise ArgumentError(f"mcu {mcu!r} is not known.{hint} Known are\n  {rows[0]}\n  {rows[1]}")
