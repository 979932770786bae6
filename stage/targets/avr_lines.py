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
from stage.targets.avr_bus import DIRECTION_ALL, PIN_ALL

_PIN = re.compile(r"([A-HJ-L])([0-7])")
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
        axes, chips = board.stage.axes, list(board.stage.chips)
        driven, read = [], []
        for line in lines:
            port, bit = parse_avr_pin(line)
            chip = axes[line.axis].chip
            mask, number = line.get_mask(chip), chips.index(chip)
            if line.line in DRIVEN:
                released = mask if line.line in PULLED_UP else 0
                driven.append((port, bit, number, mask, line.inverted, released))
            else:
                read.append((avr.find_irq(port, bit), number, mask, line.inverted, -1))
        self._driven = np.array(driven, avr_core.DRIVEN_LINE)
        self._read = np.array(read, avr_core.READ_LINE)
        self._row = np.zeros(1, avr_core.LINES)
        row = self._row[0]
        row.avr, row.n_driven, row.n_read = avr.record.own, len(driven), len(read)
        row.driven, row.read = self._driven.ctypes.data, self._read.ctypes.data
        avr.record.lines = self._row.ctypes.data
        ports = sorted({port for port, *_ in driven})
        self._ports = np.array([(self._row.ctypes.data, port, 0, 0) for port in ports], avr_core.LINE_PORT)
        self._functions = avr_core.drive_line_levels.pointer, avr_core.drive_line_directions.pointer
        for k, port in enumerate(ports):
            for number, function in zip((PIN_ALL, DIRECTION_ALL), self._functions, strict=True):
                avr.notify(avr.find_irq(port, number), function, self._ports[k : k + 1])
        self._show_levels(avr)

    def _show_levels(self, avr: Any) -> None:
        """Raise the levels of the switches before the program starts: after a reset simavr reads low pins."""
        for row in self._read:
            row["level"] = int(row["inverted"])
            avr.raise_irq(int(row["irq"]), int(row["level"]))


def parse_avr_pin(line: PinLine) -> tuple[int, int]:
    """Return port and bit of a line's pin, as (1, 0) for B0.

    Raises:
        ArgumentError: It is no pin of an AVR.
    """
    match = _PIN.fullmatch(line.pin)
    if match is None:
        raise ArgumentError(f"--pins {line}: {line.pin} is no pin of an AVR; pins are B0, D5 ...")
    return avr_core.PORTS.index(match[1]), int(match[2])
