"""`AvrLines`: STEP/DIR lines and switches of axes at the pins of an AVR."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stage.board.board import Board
from stage.board.pin_assignment import DRIVEN_LINE_PINS, PinLine, PinUse, WiringFinding, find_wiring_findings
from stage.chips.stepdir.line_names import POWER_STAGE_OUTPUTS
from stage.errors import ArgumentError
from stage.targets import avr_clock_and_pins
from stage.targets.avr_bus_wiring import DIRECTION_ALL, encode_ioctl_request

PORT_REGISTER_IRQ = 10
"""The simavr IRQ of a port's PORT register."""
_PIN_PATTERN = re.compile(r"([A-HJ-L])([0-7])")
_PULL_MASK_SHIFT = 7
"""Position of the mask in avr_ioport_external_t."""
PULLED_UP_LINES = ("enable",)
"""Lines that stay asserted while their pin is no output, as the power stage's own resistor keeps them."""
MISSING_PINS = {
    "atmega8 atmega48 atmega168 atmega328": "C7",
    "atmega1280 atmega2560": "G6 G7",
    "atmega1281": "G6 G7",
    "atmega32u4": "C0 C1 C2 C3 C4 C5 E0 E1 E3 E4 E5 E7 F2 F3",
}
"""Pins of ports that a family, named by how its names begin, has only in part. simavr has the whole ports."""
LineAtPin = tuple[int, int, PinLine]
"""A line, behind the port and the bit of its pin."""


class AvrLines:
    """STEP/DIR lines and switches of axes, connected to the pins of an AVR.

    Args:
        lines: The lines.
        avr: A LoadedAvr.
        board: The board.

    Raises:
        ArgumentError: This AVR does not have one of the pins, or a pin is part of its bus.
    """

    def __init__(self, lines: Sequence[PinLine], avr: Any, board: Board):
        self._axes, self._chips = board.stage.axes, list(board.stage.chips)
        places = [(*parse_avr_pin(line, avr.mcu), line) for line in lines]
        for port, bit, line in places:
            _check_pin_of_line(line, avr.has_port(port), (port, bit) in avr.bus_pins, avr.mcu)
        self._places, self._bus_pins = places, avr.bus_pins
        self._connect_driven_lines(sorted(place for place in places if place[2].line in DRIVEN_LINE_PINS), avr)
        self._connect_read_lines(sorted(place for place in places if place[2].line not in DRIVEN_LINE_PINS), avr)
        tables = (value for table in (self._ports, self._read) for value in (table.ctypes.data, len(table)))
        has_chip_outputs = any(line.line in POWER_STAGE_OUTPUTS for line in lines)
        self._row = np.array(
            [(*tables, avr.find_function_address("avr_ioctl"), has_chip_outputs, avr_clock_and_pins.NEVER)],
            avr_clock_and_pins.LINES,
        )
        avr.record.lines = self._row.ctypes.data

    def find_wiring_findings(self, pwm_outputs: Mapping[tuple[int, int], str]) -> tuple[WiringFinding, ...]:
        """Return the signs that lines of axes are at the wrong pins of the program, or at pins that it drives by PWM.

        Args:
            pwm_outputs: Timer and mode of the pins, as port and bit, that a timer drives by PWM.
        """
        ports = dict(zip(self._port_numbers, self._ports, strict=True))
        uses = [
            PinUse(line, int(ports[port]["rises"][bit]), int(ports[port]["pull_ups"][bit]))
            for port, bit, line in self._places
            if line.line in DRIVEN_LINE_PINS
        ]
        used = {(port, bit) for port, bit, _ in self._places} | self._bus_pins
        others = {
            f"{avr_clock_and_pins.PORT_LETTERS[port]}{bit}": int(row["rises"][bit])
            for port, row in ports.items()
            for bit in np.flatnonzero(row["rises"]).tolist()
            if (port, bit) not in used
        }
        findings = find_wiring_findings(uses, others, {name: axis.chip for name, axis in self._axes.items()})
        pwm = tuple(
            WiringFinding(
                line.axis,
                f"{line.axis}.{line.line} = {line.pin} is a PWM output of {pwm_outputs[port, bit]}, which this target does not "
                "drive. Make its edges in CTC mode or by the program.",
            )
            for port, bit, line in self._places
            if line.line in DRIVEN_LINE_PINS and (port, bit) in pwm_outputs and ports[port]["rises"][bit] <= 1
        )
        explained = {"", *(finding.axis for finding in pwm)} if pwm else set()
        return pwm + tuple(finding for finding in findings if finding.axis not in explained)

    def _find_chip_and_mask(self, line: PinLine) -> tuple[int, int]:
        """Return the number of a line's chip, and the bits of the chip's input pins."""
        chip = self._axes[line.axis].chip
        return self._chips.index(chip), line.get_mask(chip)

    def _connect_driven_lines(self, places: Sequence[LineAtPin], avr: Any) -> None:
        """Watch the pins of all ports, because pins without a line help to find a wrong wiring; see `find_wiring_problems`."""
        self._port_numbers = [port for port in range(len(avr_clock_and_pins.PORT_LETTERS)) if avr.has_port(port)]
        self._driven = [self._make_driven_rows([p for p in places if p[0] == port]) for port in self._port_numbers]
        self._ports = np.zeros(len(self._driven), avr_clock_and_pins.LINE_PORT)
        self._functions = (
            avr_clock_and_pins.drive_line_levels.pointer,
            avr_clock_and_pins.drive_line_directions.pointer,
        )
        for k, (port, rows) in enumerate(zip(self._port_numbers, self._driven, strict=True)):
            row = self._ports[k]
            row["avr"], row["lines"], row["n_lines"] = avr.record.own, rows.ctypes.data, len(rows)
            for number, function in zip((PORT_REGISTER_IRQ, DIRECTION_ALL), self._functions, strict=True):
                avr.register_callback(avr.find_irq(port, number), function, self._ports[k : k + 1])

    def _make_driven_rows(self, places: Sequence[LineAtPin]) -> np.ndarray:
        """Return the records (DRIVEN_LINE) of the lines that the pins of a port drive, grouped by chip."""
        rows = []
        for _, bit, line in places:
            chip, mask = self._find_chip_and_mask(line)
            rows.append((chip, bit, mask, line.inverted, mask if line.line in PULLED_UP_LINES else 0))
        rows.sort()
        ends = [*(rows[k][0] != rows[k + 1][0] for k in range(len(rows) - 1)), True][: len(rows)]
        return np.array(
            [(bit, chip, *rest, end) for (chip, bit, *rest), end in zip(rows, ends, strict=True)],
            avr_clock_and_pins.DRIVEN_LINE,
        )

    def _connect_read_lines(self, places: Sequence[LineAtPin], avr: Any) -> None:
        """Connect the lines that the program reads, such as switches, to their pins."""
        ports = sorted({port for port, _, _ in places})
        self._pulled = np.zeros(len(ports), avr_clock_and_pins.PULLED_PORT)
        self._read = np.zeros(len(places), avr_clock_and_pins.READ_LINE)
        addresses = {port: self._pulled[k:].ctypes.data for k, port in enumerate(ports)}
        for k, (port, bit, line) in enumerate(places):
            last = k + 1 == len(places) or places[k + 1][:2] != (port, bit)
            place, inverted = (avr.find_irq(port, bit), addresses[port], bit), line.inverted
            self._read[k] = (*place, *self._find_chip_and_mask(line), inverted, inverted, last)
            pulled = self._pulled[ports.index(port)]
            pulled["request"] = encode_ioctl_request("iop" + avr_clock_and_pins.PORT_LETTERS[port])
            pulled["pulls"] |= 1 << (_PULL_MASK_SHIFT + bit) | inverted << (avr_clock_and_pins.PULL_LEVELS_SHIFT + bit)
        for port, pulled in zip(ports, self._pulled, strict=True):
            avr.call_avr_ioctl(int(pulled["request"]), addresses[port])
        for row in self._read:
            avr.raise_irq(int(row["irq"]), int(row["level"]))


def parse_avr_pin(line: PinLine, mcu: str) -> tuple[int, int]:
    """Return port and bit of a line's pin, for example (1, 0) for B0.

    Raises:
        ArgumentError: The pin is not one of an AVR, or this AVR does not have it.
    """
    match = _PIN_PATTERN.fullmatch(line.pin)
    if match is None:
        raise ArgumentError(f"--pins {line}: {line.pin} is no pin of an AVR; pins are B0, D5 ...")
    for families, pins in MISSING_PINS.items():
        if mcu.startswith(tuple(families.split())) and line.pin in pins.split():
            raise ArgumentError(f"--pins {line}: the {mcu} has no pin {line.pin}; port {match[1]} has others.")
    return avr_clock_and_pins.PORT_LETTERS.index(match[1]), int(match[2])


def _check_pin_of_line(line: PinLine, has_port: bool, is_of_bus: bool, mcu: str) -> None:
    """Raise ArgumentError if the pin of a line does not exist on the AVR `mcu`, or is part of its bus."""
    if not has_port:
        raise ArgumentError(f"--pins {line}: the {mcu} has no port {line.pin[0]}; take a pin that it has.")
    if is_of_bus:
        raise ArgumentError(f"--pins {line}: pin {line.pin} is used twice, also by --map. Give each line its own pin.")
