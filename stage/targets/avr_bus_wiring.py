"""Pins of an AVR that form its bus: their description as text, and their connection to the board.

A description looks like this:

    data=A,address=C:0-1,cs=B0,wr=G0,rd=G1,irq=D0

data: port of the eight data lines. address: address lines, lowest first (`C:0-1`, `C0`, or several joined by +). cs,
wr, rd: strobes, active low; without cs the board is always selected. irq: pin that the interrupt line pulls low. base:
port of the board at address 0 (default: first port of the board).
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from stage.board.board import Board
from stage.errors import ArgumentError, unknown_name_error
from stage.targets import avr_clock_and_pins
from stage.targets.avr_clock_and_pins import PORT_LETTERS

BUS_PINS_EXAMPLE = "data=A,address=C:0-1,cs=B0,wr=G0,rd=G1,irq=D0"
BUS_PIN_KEYS = ("data", "address", "cs", "wr", "rd", "irq", "base")
PIN_ALL, DIRECTION_ALL = 8, 9
"""The simavr IRQs of a port's levels and directions."""
Pin = tuple[int, int]
_PIN_PATTERN = re.compile(r"([A-HJ-L])([0-7])")
_PIN_RANGE_PATTERN = re.compile(r"([A-HJ-L]):([0-7])-([0-7])")


def encode_ioctl_request(text: str) -> int:
    """Return the number of a request to simavr's function avr_ioctl, given by its four letters, for example "iogA"."""
    return int.from_bytes(text.encode(), "big")


class BusPins(NamedTuple):
    """Pins of an AVR that form its bus. Each pin is a pair: the number of its port in PORTS, and its bit."""

    data: int
    address: tuple[Pin, ...]
    cs: Pin | None
    wr: Pin
    rd: Pin
    irq: Pin | None
    base: int | None

    def list_all(self) -> set[Pin]:
        """Return all pins of the AVR that form its bus."""
        pins = (*self.address, self.cs, self.wr, self.rd, self.irq)
        return {pin for pin in pins if pin} | {(self.data, bit) for bit in range(8)}


class AvrBus:
    """Connection of an AVR's pins to the board.

    Args:
        pins: Pins of the bus.
        avr: A LoadedAvr.
        board: The board.
    """

    def __init__(self, pins: BusPins, avr: Any, board: Board):
        n = len(PORT_LETTERS)
        self._levels, self._outputs = np.zeros(n, "i8"), np.zeros(n, "i8")
        none = (avr_clock_and_pins.NO_PIN, 0)
        self._pins = np.array([p or none for p in (pins.cs, pins.wr, pins.rd, *pins.address)], avr_clock_and_pins.PIN)
        self._data = np.array([avr.find_irq(pins.data, bit) for bit in range(8)], "i8")
        self._warning = ctypes.create_string_buffer(
            f"port {PORT_LETTERS[pins.data]} has output pins while /RD is low: AVR and board both drive the data lines".encode()
        )
        self._row = np.zeros(1, avr_clock_and_pins.BUS)
        b = self._row[0]
        b.avr, b.warning = avr.record.own, ctypes.addressof(self._warning)
        b.select, b.write, b.read, b.addresses = (
            self._pins.ctypes.data + k * avr_clock_and_pins.PIN.itemsize for k in range(4)
        )
        b.n_addresses, b.data_port, b.data_irqs = len(pins.address), pins.data, self._data.ctypes.data
        b.first = min(place.first for place in board.places) if pins.base is None else pins.base
        b.levels, b.outputs, b.was_write = self._levels.ctypes.data, self._outputs.ctypes.data, 1
        used = sorted({pins.data, *(p[0] for p in (pins.cs, pins.wr, pins.rd, *pins.address) if p)})
        self._ports = np.array([(self._row.ctypes.data, port) for port in used], avr_clock_and_pins.BUS_PORT)
        self._functions = (
            avr_clock_and_pins.store_port_levels.pointer,
            avr_clock_and_pins.store_port_directions.pointer,
        )
        for k, port in enumerate(used):
            for number, function in zip((PIN_ALL, DIRECTION_ALL), self._functions, strict=True):
                avr.register_callback(avr.find_irq(port, number), function, self._ports[k : k + 1])


def parse_bus_pins(texts: str | Sequence[str]) -> BusPins:
    """Parse the description of the pins that form an AVR's bus.

    Args:
        texts: One description in the form of this module's docstring, for example BUS_PINS_EXAMPLE.

    Raises:
        ArgumentError: The text has another form, or uses a pin twice.
    """
    texts = [texts] if isinstance(texts, str) else list(texts)
    if len(texts) != 1:
        raise ArgumentError(
            f"--map: an AVR's bus is its pins; say once which: --map {BUS_PINS_EXAMPLE} (given: "
            f"{', '.join(texts) or 'none'}). STEP/DIR axes "
            "have no bus: --pins grbl, for example."
        )
    text = texts[0]
    parts = _split_description(text)
    if parts["data"] not in PORT_LETTERS or len(parts["data"]) != 1:
        raise ArgumentError(f"--map {text!r}: data={parts['data']} is no port; ports are {', '.join(PORT_LETTERS)}.")
    single = {key: _parse_pin(text, key, parts[key]) for key in ("cs", "wr", "rd", "irq") if key in parts}
    address = _parse_address_pins(text, parts["address"]) if "address" in parts else ()
    data = PORT_LETTERS.index(parts["data"])
    used: set[Pin] = set()
    for pin in (*address, *single.values(), *((data, k) for k in range(8))):
        if pin in used:
            raise ArgumentError(f"--map {text!r}: pin {PORT_LETTERS[pin[0]]}{pin[1]} is used twice.")
        used.add(pin)
    try:
        base = int(parts["base"], 0) if "base" in parts else None
    except ValueError:
        raise ArgumentError(f"--map {text!r}: base={parts['base']} is no port, for example base=0x300.") from None
    return BusPins(data, address, single.get("cs"), single["wr"], single["rd"], single.get("irq"), base)


def _split_description(text: str) -> dict[str, str]:
    """Split the description of an AVR's bus into values by key."""
    parts: dict[str, str] = {}
    for part in text.split(","):
        key, equals, value = part.strip().partition("=")
        if key not in BUS_PIN_KEYS:
            raise ArgumentError(
                f"--map {text!r}: write {BUS_PINS_EXAMPLE}. {unknown_name_error('part', key, BUS_PIN_KEYS)}"
            )
        if not equals or key in parts:
            raise ArgumentError(f"--map {text!r}: {key} is given {'twice' if key in parts else 'without a value'}.")
        parts[key] = value.strip().upper()
    for key in ("data", "wr", "rd"):
        if key not in parts:
            raise ArgumentError(f"--map {text!r}: it has no {key}=; write {BUS_PINS_EXAMPLE}.")
    return parts


def _parse_pin(text: str, key: str, value: str) -> Pin:
    """Return the pin in a value such as B0; `text` and `key` are for the error message."""
    match = _PIN_PATTERN.fullmatch(value)
    if match is None:
        raise ArgumentError(f"--map {text!r}: {key}={value} is no pin, for example {key}=B0.")
    return PORT_LETTERS.index(match[1]), int(match[2])


def _parse_address_pins(text: str, value: str) -> tuple[Pin, ...]:
    """Return the address pins, lowest first, in a value such as C:0-1+D4; `text` is for the error message."""
    pins: list[Pin] = []
    for part in value.split("+"):
        match = _PIN_RANGE_PATTERN.fullmatch(part)
        if match is None:
            pins.append(_parse_pin(text, "address", part))
            continue
        low, high = int(match[2]), int(match[3])
        if low > high:
            raise ArgumentError(f"--map {text!r}: address={part} runs backwards; the lowest pin comes first.")
        pins += [(PORT_LETTERS.index(match[1]), k) for k in range(low, high + 1)]
    return tuple(pins)
