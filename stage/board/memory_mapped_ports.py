"""Windows: ports of a board at addresses, for firmware whose chips are memory-mapped.

    --map 0x40021000=0x300+0x40            40h ports, from 300h on, at 40021000h and up
    MemoryWindow(0x40021000, 0x300, 0x40)        the same in Python

An access of 8, 16 or 32 bits at `address + n` is a bus cycle at `port + n`.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NamedTuple

from stage.board.bus_layouts import MAX_PORTS
from stage.board.crash_report import IS_SUPPORTED
from stage.errors import ArgumentError

FORM = "ADDRESS=PORT+LENGTH, for example 0x40021000=0x300+0x40"
ADDRESS_LIMIT = 1 << 47
PROXY_HINT = "use the registers of pulsestage_mmio.hpp, or macros: docs/memory_mapped.md"
_NUMBER = r"(0[xX][0-9a-fA-F]+|[0-9]+)"
_TEXT = re.compile(rf"\s*{_NUMBER}\s*=\s*{_NUMBER}\s*\+\s*{_NUMBER}\s*")


class MemoryWindow(NamedTuple):
    """Range of addresses that maps to ports of a board.

    Attributes:
        address: First address.
        port: First port.
        length: Number of ports, one byte each.
    """

    address: int
    port: int
    length: int

    @property
    def end(self) -> int:
        """First address after the window."""
        return self.address + self.length

    def __str__(self) -> str:
        return f"{self.address:#x}={self.port:#x}+{self.length:#x}"


Windows = str | tuple[int, int, int] | Iterable[str | tuple[int, int, int]]


def is_supported() -> bool:
    """Return whether firmware can have windows on this system: Linux on x86-64."""
    return IS_SUPPORTED and platform.machine() == "x86_64"


def explain_missing_windows(isolated: bool) -> str:
    """Return a sentence that explains why windows are not available here.

    Args:
        isolated: Whether the firmware runs in a separate process.
    """
    if is_supported() and not isolated:
        return (
            f"windows of memory-mapped registers need a process of the firmware's own: isolated=True, the default; "
            f"or {PROXY_HINT}."
        )
    where = f"{platform.system()} on {platform.machine()}"
    return f"windows of memory-mapped registers need Linux on x86-64, and this is {where}: {PROXY_HINT}."


def parse_windows(windows: Windows = ()) -> tuple[MemoryWindow, ...]:
    """Parse one or several windows of memory-mapped registers.

    Args:
        windows: A MemoryWindow, a tuple (address, port, length), a text `ADDRESS=PORT+LENGTH` with decimal or hexadecimal
            (0x) numbers, or several of these.

    Returns:
        The windows, sorted by address.

    Raises:
        ArgumentError: A window has another form, ports that do not exist, or an overlap with another window.
    """
    if isinstance(windows, str) or (isinstance(windows, tuple) and len(windows) == 3 and isinstance(windows[0], int)):
        windows = (windows,)
    try:
        parsed = sorted(_check_window(MemoryWindow(*_parse_numbers(one))) for one in windows)
    except TypeError:
        raise ArgumentError(
            f"map={windows!r}: a window is a MemoryWindow(address, port, length), or text: {FORM}."
        ) from None
    for one, other in pairwise(parsed):
        if other.address < one.end:
            raise ArgumentError(f"windows {one} and {other} overlap: an address can lead to one port only.")
    return tuple(parsed)


def _parse_numbers(one: Any) -> Iterable[int]:
    """Return the address, the port and the length of a window."""
    if not isinstance(one, str):
        if isinstance(one, bool) or len(one) != 3 or not all(type(n) is int for n in one):
            raise TypeError
        return one
    match = _TEXT.fullmatch(one)
    if match is None:
        raise ArgumentError(f"--map {one!r}: write {FORM}.")
    return (int(n, 16) if n[:2] in ("0x", "0X") else int(n) for n in match.groups())


def _check_window(window: MemoryWindow) -> MemoryWindow:
    """Return the window. Raises ArgumentError for ports or addresses that do not exist."""
    if window.length < 1:
        raise ArgumentError(f"window {window}: its length is 1 port or more.")
    if window.port < 0 or window.port + window.length > MAX_PORTS:
        raise ArgumentError(
            f"window {window}: its ports end at {window.port + window.length - 1:X}h, and ports are 0 to {MAX_PORTS - 1:X}h."
        )
    if window.address < 0 or window.end > ADDRESS_LIMIT:
        raise ArgumentError(f"window {window}: addresses are 0 to {ADDRESS_LIMIT - 1:X}h.")
    return window
