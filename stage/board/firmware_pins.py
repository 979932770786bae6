"""Lines of STEP/DIR axes at the pins of firmware in C and of Arduino sketches: `struct pulsestage_line` of pulsestage.h."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from stage.board.pin_assignment import DRIVEN, PinLine, describe_silent_steps, parse_pins
from stage.errors import ArgumentError
from stage.sim.stage import Stage

LINE = np.dtype(
    [("chip", "i8"), ("pins", "i8")]
    + [(name, "i4") for name in ("pin", "is_number", "inverted", "driven", "released", "place")]
)
PORTS = "ABCDEFGHIJKLMNOP"
LAST_PIN = 255
PIN_WORDS = 4 * 256 // 32
"""Words of `levels`, `outputs`, `once` and `often` in struct pulsestage_pins."""
PULLED = ("enable",)
"""Lines that stay asserted while their pin is no output, as the power stage's own resistor keeps them."""
_PORT_PIN = re.compile(rf"([{PORTS}])([0-7])")


def parse_firmware_pins(texts: str | Iterable[str], stage: Stage) -> tuple[PinLine, ...]:
    """Parse the lines of a stage's axes at pins: numbers, 2, or bits of ports, D2.

    Raises:
        ArgumentError: See `parse_pins`; also for another name of a pin.
    """
    lines = parse_pins(texts, {name: axis.chip for name, axis in stage.axes.items()})
    for line in lines:
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


def make_line_table(lines: Sequence[PinLine], stage: Stage) -> np.ndarray:
    """Return LINE records, sorted by chip."""
    table = np.zeros(len(lines), LINE)
    for place, (row, line) in enumerate(zip(table, lines, strict=True)):
        chip = stage.axes[line.axis].chip
        row["chip"], row["pins"] = list(stage.chips).index(chip), line.get_mask(chip)
        row["pin"], row["is_number"] = _parse_pin(line)
        row["inverted"], row["driven"], row["released"] = line.inverted, line.line in DRIVEN, line.line in PULLED
        row["place"] = place
    return np.sort(table, order="chip", kind="stable")


def find_wiring_problems(table: np.ndarray, lines: Sequence[PinLine], words: np.ndarray) -> tuple[str, ...]:
    """Return sentences about STEP pins that firmware has never driven high.

    Args:
        table: LINE records as the firmware has them.
        lines: The lines, by their place.
        words: PIN_WORDS words of the firmware's struct pulsestage_pins.
    """
    once, often = (
        set(np.flatnonzero(np.unpackbits(part.view(np.uint8), bitorder="little")).tolist())
        for part in np.split(words, 4)[2:]
    )
    steps = [row for row in table if lines[row["place"]].line == "step"]
    silent = [lines[row["place"]] for row in steps if int(row["pin"]) not in once]
    has_numbers = bool(table["is_number"].any())
    others = [
        str(pin) if has_numbers else f"{PORTS[pin // 8]}{pin % 8}"
        for pin in sorted(often - set(table["pin"].tolist()))
        if has_numbers or pin < 8 * len(PORTS)
    ]
    return describe_silent_steps([f"{line.axis}.step = {line.pin}" for line in silent], others, len(steps))
