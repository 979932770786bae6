"""The pins that are an AVR's bus, as they are given:

    data=A,address=C:0-1,cs=B0,wr=G0,rd=G1,irq=D0

data: a port, eight data lines. address: address lines, the lowest first (`C:0-1`, `C0`, or several joined by +). cs, wr, rd: the
strobes, active low; without cs the board is always selected. irq: the pin that the interrupt line pulls low. base: the board's port
at address 0 (default: the board's first).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from stage.errors import ArgumentError, unknown
from stage.targets.avr import PORTS

FORM = "data=A,address=C:0-1,cs=B0,wr=G0,rd=G1,irq=D0"
KEYS = ("data", "address", "cs", "wr", "rd", "irq", "base")
Pin = tuple[int, int]
_ONE = re.compile(r"([A-HJ-L])([0-7])")
_RANGE = re.compile(r"([A-HJ-L]):([0-7])-([0-7])")


class Pins(NamedTuple):
    """The bus. A pin: its port's number in PORTS, its bit."""

    data: int
    address: tuple[Pin, ...]
    cs: Pin | None
    wr: Pin
    rd: Pin
    irq: Pin | None
    base: int | None


def pins(given: str | Sequence[str]) -> Pins:
    """Raises ArgumentError: another form, a pin that is used twice."""
    texts = [given] if isinstance(given, str) else list(given)
    if len(texts) != 1:
        raise ArgumentError(
            f"--map: an AVR's bus is its pins; say once which: --map {FORM} (given: {', '.join(texts) or 'none'})."
        )
    text = texts[0]
    found: dict[str, str] = {}
    for part in text.split(","):
        key, equals, value = part.strip().partition("=")
        if key not in KEYS:
            raise ArgumentError(f"--map {text!r}: write {FORM}. {unknown('part', key, KEYS)}")
        if not equals or key in found:
            raise ArgumentError(f"--map {text!r}: {key} is given {'twice' if key in found else 'without a value'}.")
        found[key] = value.strip().upper()
    for key in ("data", "wr", "rd"):
        if key not in found:
            raise ArgumentError(f"--map {text!r}: it has no {key}=; write {FORM}.")
    if found["data"] not in PORTS or len(found["data"]) != 1:
        raise ArgumentError(f"--map {text!r}: data={found['data']} is no port; ports are {', '.join(PORTS)}.")
    one = {key: _pin(text, key, found[key]) for key in ("cs", "wr", "rd", "irq") if key in found}
    address = _address(text, found["address"]) if "address" in found else ()
    data = PORTS.index(found["data"])
    seen: set[Pin] = set()
    for pin in (*address, *one.values(), *((data, k) for k in range(8))):
        if pin in seen:
            raise ArgumentError(f"--map {text!r}: pin {PORTS[pin[0]]}{pin[1]} is used twice.")
        seen.add(pin)
    try:
        base = int(found["base"], 0) if "base" in found else None
    except ValueError:
        raise ArgumentError(f"--map {text!r}: base={found['base']} is no port, for example base=0x300.") from None
    return Pins(data, address, one.get("cs"), one["wr"], one["rd"], one.get("irq"), base)


def _pin(text: str, key: str, value: str) -> Pin:
    match = _ONE.fullmatch(value)
    if match is None:
        raise ArgumentError(f"--map {text!r}: {key}={value} is no pin, for example {key}=B0.")
    return PORTS.index(match[1]), int(match[2])


def _address(text: str, value: str) -> tuple[Pin, ...]:
    found: list[Pin] = []
    for part in value.split("+"):
        match = _RANGE.fullmatch(part)
        if match is None:
            found.append(_pin(text, "address", part))
            continue
        low, high = int(match[2]), int(match[3])
        if low > high:
            raise ArgumentError(f"--map {text!r}: address={part} runs backwards; the lowest pin comes first.")
        found += [(PORTS.index(match[1]), k) for k in range(low, high + 1)]
    return tuple(found)
