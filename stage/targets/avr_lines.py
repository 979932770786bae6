"""`AvrLines`: STEP/DIR lines and switches of axes at the pins of an AVR."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from stage.board.board import Board
from stage.board.pins import DRIVEN, PinLine
from stage.errors import ArgumentError
from stage.targets import avr_core
from stage.targets.avr_bus import DIRECTION_ALL, encode_request

PORT_REGISTER = 10
"""The simavr IRQ of a port's PORT register."""
_PIN = re.compile(r"([A-HJ-L])([0-7])")
_PULL_MASK = 7
"""Position of the mask in avr_ioport_external_t."""
PULLED_UP = ("enable",)
"""Lines that stay asserted while their pin is no output, as the power stage's own resistor keeps them."""


class AvrLines:
    """Lines of axes, connected to the pins of an AVR.

    Args:
        lines: The lines.
        avr: A LoadedAvr.
        board: The board.

    Raises:
        ArgumentError: A pin that no AVR has.
    """

    def __init__(self, lines: Sequence[PinLine], avr: Any, board: Board):
        self._axes, self._chips = board.stage.axes, list(board.stage.chips)
        places = [(*parse_avr_pin(line), line) for line in lines]
        self._connect_driven_lines(sorted(place for place in places if place[2].line in DRIVEN), avr)
        self._connect_read_lines(sorted(place for place in places if place[2].line not in DRIVEN), avr)
        tables = (value for table in (self._ports, self._read) for value in (table.ctypes.data, len(table)))
        self._row = np.array([(*tables, avr.find_function_address("avr_ioctl"))], avr_core.LINES)
        avr.record.lines = self._row.ctypes.data

    def _find_chip(self, line: PinLine) -> tuple[int, int]:
        """Return the number of a line's chip, and the bits of the chip's input pins."""
        chip = self._axes[line.axis].chip
        return self._chips.index(chip), line.get_mask(chip)

    def _connect_driven_lines(self, places: Sequence[tuple[int, int, PinLine]], avr: Any) -> None:
        ports = sorted({port for port, _, _ in places})
        self._driven = [self._make_driven_rows([place for place in places if place[0] == port]) for port in ports]
        self._ports = np.zeros(len(ports), avr_core.LINE_PORT)
        self._functions = avr_core.drive_line_levels.pointer, avr_core.drive_line_directions.pointer
        for k, (port, rows) in enumerate(zip(ports, self._driven, strict=True)):
            self._ports[k] = (avr.record.own, rows.ctypes.data, len(rows), 0, 0)
            for number, function in zip((PORT_REGISTER, DIRECTION_ALL), self._functions, strict=True):
                avr.notify(avr.find_irq(port, number), function, self._ports[k : k + 1])

    def _make_driven_rows(self, places: Sequence[tuple[int, int, PinLine]]) -> np.ndarray:
        """Return the DRIVEN_LINE records of a port, those of a chip one after the other."""
        rows = []
        for _, bit, line in places:
            chip, mask = self._find_chip(line)
            rows.append((chip, bit, mask, line.inverted, mask if line.line in PULLED_UP else 0))
        rows.sort()
        ends = [*(rows[k][0] != rows[k + 1][0] for k in range(len(rows) - 1)), True]
        return np.array(
            [(bit, chip, *rest, end) for (chip, bit, *rest), end in zip(rows, ends, strict=True)], avr_core.DRIVEN_LINE
        )

    def _connect_read_lines(self, places: Sequence[tuple[int, int, PinLine]], avr: Any) -> None:
        ports = sorted({port for port, _, _ in places})
        self._pulled = np.zeros(len(ports), avr_core.PULLED_PORT)
        self._read = np.zeros(len(places), avr_core.READ_LINE)
        addresses = {port: self._pulled[k:].ctypes.data for k, port in enumerate(ports)}
        for k, (port, bit, line) in enumerate(places):
            last = k + 1 == len(places) or places[k + 1][:2] != (port, bit)
            place, inverted = (avr.find_irq(port, bit), addresses[port], bit), line.inverted
            self._read[k] = (*place, *self._find_chip(line), inverted, inverted, last)
            pulled = self._pulled[ports.index(port)]
            pulled["request"] = encode_request("iop" + avr_core.PORTS[port])
            pulled["pulls"] |= 1 << (_PULL_MASK + bit) | inverted << (avr_core.PULL_VALUE + bit)
        for port, pulled in zip(ports, self._pulled, strict=True):
            avr.control_port(int(pulled["request"]), addresses[port])
        for row in self._read:
            avr.raise_irq(int(row["irq"]), int(row["level"]))


def parse_avr_pin(line: PinLine) -> tuple[int, int]:
    """Return port and bit of a line's pin, as (1, 0) for B0.

    Raises:
        ArgumentError: It is no pin of an AVR.
    """
    match = _PIN.fullmatch(line.pin.upper())
    if match is None:
        raise ArgumentError(f"--pins {line}: {line.pin} is no pin of an AVR; pins are B0, D5 ...")
    return avr_core.PORTS.index(match[1]), int(match[2])
