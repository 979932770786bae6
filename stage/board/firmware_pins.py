"""Lines of STEP/DIR axes at the pins of firmware in C and of Arduino sketches: `struct pulsestage_line` of pulsestage.h."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from stage.board.pin_assignment import (
    DRIVEN,
    UART_LINE,
    PinLine,
    PinUse,
    WiringFinding,
    find_wiring_findings,
    parse_pins,
)
from stage.errors import ArgumentError
from stage.sim.stage import Stage

LINE = np.dtype(
    [("chip", "i8"), ("pins", "i8")]
    + [(name, "i4") for name in ("pin", "is_number", "inverted", "driven", "released", "place")]
)
PORTS = "ABCDEFGHIJKLMNOP"
LAST_PIN = 255
PIN_USE = np.dtype(
    [("rises", "u4", (LAST_PIN + 1,)), ("pull_ups", "u4", (LAST_PIN + 1,)), ("has_ports", "i4"), ("refusal", "S128")]
)
"""`struct pulsestage_pin_use` of pulsestage.h."""
PIN_READS = np.dtype([("refusals", "i4"), ("reads", "u1", (LAST_PIN + 1,))])
"""`struct pulsestage_pin_reads` of pulsestage.h."""
PULLED = ("enable",)
"""Lines that stay asserted while their pin is no output, as the power stage's own resistor keeps them."""
SWITCHES = ("limit", "limit_plus", "limit_minus", "origin")
"""Lines that stand for switches of the stage."""
DIAGNOSES = ("diag", "diag0", "diag1")
"""Outputs of power stages that tell of a stall or a fault."""
_PORT_PIN = re.compile(rf"([{PORTS}])([0-7])")


def parse_firmware_pins(texts: str | Iterable[str], stage: Stage) -> tuple[PinLine, ...]:
    """Parse the lines of a stage's axes at pins of firmware: pin numbers (2) or bits of ports (D2).

    Raises:
        ArgumentError: See `parse_pins`; also for another form of a pin's name.
    """
    lines = parse_pins(texts, {name: axis.chip for name, axis in stage.axes.items()})
    for line in lines:
        if line.line != UART_LINE:
            _parse_pin(line)
    return lines


def _parse_pin(line: PinLine) -> tuple[int, bool]:
    """Return the number of a line's pin, and whether it was written as a number. Raises ArgumentError."""
    pin = line.pin.upper()
    if pin.isdecimal() and int(pin) <= LAST_PIN:
        return int(pin), True
    if match := _PORT_PIN.fullmatch(pin):
        return PORTS.index(match[1]) * 8 + int(match[2]), False
    raise ArgumentError(
        f"--pins {line}: {line.pin} is no pin of firmware; pins are numbers, 0 to {LAST_PIN}, or bits of ports, A0 to P7."
    )


def check_board_pins(lines: Sequence[PinLine], board_pins: Sequence[int]) -> None:
    """Check that the Arduino of a sketch has the pins of the lines.

    Args:
        lines: The lines.
        board_pins: For each number of a pin its bit of the ports; port A's bit 0 is 0.

    Raises:
        ArgumentError: The board has no such pin.
    """
    for line in lines:
        pin, is_number = _parse_pin(line)
        if pin < len(board_pins) if is_number else pin in board_pins:
            continue
        board = "Arduino Uno" if len(board_pins) == 20 else "Arduino Mega 2560"
        analog = re.fullmatch(r"A([0-5])", line.pin.upper())
        hint = ""
        if analog and len(board_pins) == 20:
            bit = int(analog[1])
            hint = f" {line.pin} is bit {bit} of port A; the analog input of this name is C{bit} or {14 + bit}."
        ports = sorted({PORTS[place // 8] for place in board_pins})
        raise ArgumentError(
            f"--pins {line}: the {board} has no pin {line.pin}; its pins are 0 to {len(board_pins) - 1}, which are bits of "
            f"the ports {', '.join(ports)}.{hint}"
        )


def make_line_table(lines: Sequence[PinLine], stage: Stage) -> np.ndarray:
    """Return the LINE records of the lines, sorted by chip."""
    table = np.zeros(len(lines), LINE)
    for place, (row, line) in enumerate(zip(table, lines, strict=True)):
        chip = stage.axes[line.axis].chip
        row["chip"], row["pins"] = list(stage.chips).index(chip), line.get_mask(chip)
        row["pin"], row["is_number"] = _parse_pin(line)
        row["inverted"], row["driven"], row["released"] = line.inverted, line.line in DRIVEN, line.line in PULLED
        row["place"] = place
    return np.sort(table, order="chip", kind="stable")


def find_firmware_wiring_findings(
    table: np.ndarray, lines: Sequence[PinLine], use: Any, reads: Any, stage: Stage
) -> tuple[WiringFinding, ...]:
    """Return the signs that lines of axes are at the wrong pins of the firmware.

    Args:
        table: LINE records as the firmware has them.
        lines: The lines, in the order of `table`.
        use: PIN_USE record of the firmware.
        reads: PIN_READS record of the firmware.
        stage: Stage with the axes.
    """
    refusal, times = use["refusal"].decode(errors="replace"), int(reads["refusals"])
    again = f", the first of {times:,} such calls" if times > 1 else ""
    refused = (WiringFinding("", f"{refusal}{again}."),) if refusal else ()
    driven = sorted(table[table["driven"] != 0], key=lambda row: int(row["place"]))
    uses = [
        PinUse(lines[row["place"]], int(use["rises"][row["pin"]]), int(use["pull_ups"][row["pin"]])) for row in driven
    ]
    has_numbers = bool(table["is_number"].any()) if len(table) else not use["has_ports"]
    others = {
        _name_pin(pin, has_numbers, bool(use["has_ports"])): int(use["rises"][pin])
        for pin in np.flatnonzero(use["rises"]).tolist()
        if pin not in table["pin"] and (has_numbers or pin < 8 * len(PORTS))
    }
    findings = find_wiring_findings(uses, others, {name: axis.chip for name, axis in stage.axes.items()})
    return refused + findings + tuple(_find_unread_switches(table, lines, reads["reads"], stage))


def _name_pin(pin: int, has_numbers: bool, has_ports: bool) -> str:
    """Return the name of a pin in messages: its number, or its bit of a port, in C with the number that a program uses.

    Args:
        pin: Number of the pin.
        has_numbers: Whether --pins has numbers.
        has_ports: Whether the program itself has ports.
    """
    name = f"{PORTS[pin // 8]}{pin % 8}"
    return str(pin) if has_numbers else name if has_ports else f"{name} (pin {pin})"


def _find_unread_switches(
    table: np.ndarray, lines: Sequence[PinLine], reads: np.ndarray, stage: Stage
) -> Iterable[WiringFinding]:
    """Yield a remark about each asserted switch, and each stall output, of an axis with lost steps that the program never read.

    Args:
        table: LINE records as the firmware has them.
        lines: The lines, in the order of `table`.
        reads: Whether the program has read each pin.
        stage: Stage with the axes.
    """
    for row in sorted(table, key=lambda row: int(row["place"])):
        line = lines[row["place"]]
        axis = stage.axes[line.axis]
        is_at_switch = line.line in SWITCHES and axis.chip.input_word(axis.chip_axis) & line.get_mask(axis.chip)
        if (is_at_switch or line.line in DIAGNOSES) and axis.lost_steps and not reads[row["pin"]]:
            where = " at a switch" if is_at_switch else ""
            text = (
                f"{line.axis} has lost steps{where}, and the program never read {line.axis}.{line.line} = {line.pin}: does it "
                f"read the {'switch' if is_at_switch else 'output'} at another pin?"
            )
            yield WiringFinding(line.axis, text, is_problem=False)
