"""Devices as text, for command-line options: KIND:PORT[:AXIS[:COUNTS]], or SOURCE.c:PORT[+PORTS].

hctl2016:0x320:x              on axis x, an encoder of 2000 counts per turn of the motor
ls7166:0x330:y:4000           4000 counts per turn
uart:0x3F8   latch:0x378   adc.c:0x340+4
"""

from __future__ import annotations

from stage.board import firmware_library
from stage.board.devices.device import Device, Encoder
from stage.board.devices.hctl2016 import HCTL2000, HCTL2016, HCTL2020
from stage.board.devices.ls7166 import LS7166
from stage.board.devices.output_latch import OutputLatch
from stage.board.devices.uart import UART
from stage.board.devices.user_devices import CDevice
from stage.errors import ArgumentError, add_article, find_similar_names

COUNTS_PER_TURN = 2000
COUNTERS: dict[str, type] = {d.KIND: d for d in (HCTL2000, HCTL2016, HCTL2020, LS7166)}
OTHERS: dict[str, type] = {d.KIND: d for d in (OutputLatch, UART)}
KNOWN = (*COUNTERS, *OTHERS)
FORM = f"KIND:PORT[:AXIS[:COUNTS]], of the kinds {', '.join(COUNTERS)} (with AXIS), {', '.join(OTHERS)}; or SOURCE.c:PORT[+PORTS]"


def make_device(text: str) -> tuple[Device, list[int]]:
    """Create the device that a text describes; return the device and its ports.

    Args:
        text: KIND:PORT[:AXIS[:COUNTS]], or SOURCE.c:PORT[+PORTS].

    Raises:
        ArgumentError: The text has another form.
        LibraryError, CompileError, NoCompilerError, FileError: See CDevice.
    """
    if isinstance(text, Device):
        raise ArgumentError(
            f"device {text!r}: texts name devices here; an object goes on the bus by board.attach_device(device, ports)."
        )
    if not isinstance(text, str) or ":" not in text:
        raise ArgumentError(f"device {text!r}: write {FORM}. For example hctl2016:0x320:x")
    kind, *rest = text.split(":")
    if firmware_library.are_sources(kind) or kind.endswith((".so", ".dylib", ".dll")):
        if len(rest) != 1:
            raise ArgumentError(f"device {text!r}: write SOURCE.c:PORT[+PORTS], for example adc.c:0x340+4")
        port, _, ports = rest[0].partition("+")
        first, n = _parse_port(text, port), _parse_port(text, ports or "1")
        return CDevice(kind), list(range(first, first + n))
    if kind not in KNOWN:
        near = find_similar_names(kind, KNOWN)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ArgumentError(f"device {text!r}: unknown kind {kind!r}; known are {', '.join(KNOWN)}.{hint}")
    first = _parse_port(text, rest[0])
    device = _make_counter(text, kind, rest) if kind in COUNTERS else _make_device_without_axis(text, kind, rest)
    return device, list(range(first, first + device.PORTS))


def _make_device_without_axis(text: str, kind: str, rest: list[str]) -> Device:
    """Create a latch or a UART. Raises ArgumentError if the text names an axis."""
    if len(rest) > 1:
        raise ArgumentError(f"device {text!r}: {add_article(kind)} is on no axis. Write {kind}:{rest[0]}")
    return OTHERS[kind]()


def _make_counter(text: str, kind: str, rest: list[str]) -> Device:
    """Create an encoder counter for the axis that the text names."""
    if not 2 <= len(rest) <= 3:
        raise ArgumentError(
            f"device {text!r}: {add_article(kind)} counts an encoder on an axis. Write {kind}:{rest[0]}:x"
        )
    try:
        counts = float(rest[2]) if len(rest) == 3 else COUNTS_PER_TURN
    except ValueError:
        raise ArgumentError(
            f"device {text!r}: {rest[2]!r} is no number of counts a turn of the motor. Write for example "
            f"{kind}:{rest[0]}:{rest[1]}:4000"
        ) from None
    return COUNTERS[kind](Encoder(rest[1], per_turn=counts))


def _parse_port(text: str, number: str) -> int:
    """Return the port number. Raises ArgumentError, which quotes the whole text of the device, if it is no number."""
    try:
        return int(number, 0)
    except ValueError:
        raise ArgumentError(f"device {text!r}: {number!r} is no port, as 0x320 or 800.") from None
