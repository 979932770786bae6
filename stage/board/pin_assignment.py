"""`parse_pins`: which pins of a microcontroller, or signals of a capture, are the STEP/DIR lines and the switches of axes, as text.

    x.step=D2,x.dir=D5,x.enable=!B0,x.limit=!B1

A `!` in front of a pin inverts it: the line is asserted while the pin is low. The names of presets stand for the wiring of common
boards. Lines that the microcontroller drives: step, dir, enable. Lines that it reads: limit (either end limit), limit_plus,
limit_minus, origin, probe.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from stage.chips import Chip
from stage.chips.stepdir.line_names import DRIVEN, READ
from stage.errors import ArgumentError, unknown_name_error

SHARED = ("enable", *READ)
"""Lines of several axes that may be on one pin."""
NO_PIN = "none"
"""What an entry says in place of a pin to take a line out of a preset."""
FORM = "x.step=D2,x.dir=D5,x.enable=!B0,x.limit=!B1"
PRESETS = {
    "grbl": "x.step=D2,y.step=D3,z.step=D4,x.dir=D5,y.dir=D6,z.dir=D7,x.enable=!B0,y.enable=!B0,z.enable=!B0,"
    "x.limit=!B1,y.limit=!B2,z.limit=!B4,x.probe=!C5,y.probe=!C5,z.probe=!C5",
    "cnc-shield-v3": "x.step=D2,y.step=D3,z.step=D4,x.dir=D5,y.dir=D6,z.dir=D7,x.enable=!B0,y.enable=!B0,z.enable=!B0,"
    "x.limit=!B1,y.limit=!B2,z.limit=!B3",
    "ramps": "x.step=F0,x.dir=!F1,x.enable=!D7,y.step=F6,y.dir=F7,y.enable=!F2,z.step=L3,z.dir=!L1,z.enable=!K0,"
    "x.limit_minus=E5,x.limit_plus=E4,y.limit_minus=J1,y.limit_plus=J0,z.limit_minus=D3,z.limit_plus=D2",
}  # fmt: skip
"""Wiring of boards by name: grbl 1.1 on an Arduino Uno, as its cpu_map.h has it (CNC Shield V3.10 and later); the CNC Shield V3.00,
whose limit of z is at another pin; RAMPS 1.4 on an ATmega2560, with motors and normally closed switches as the stock configurations
of Marlin and Klipper expect them: DIR is high for plus, but on y, and a switch opens its pin to high."""
_ENTRY = re.compile(r"(?P<axis>[^.=]+)\.(?P<line>[a-z_]+)=(?P<invert>!?)(?P<pin>[^\s,=!]+)")


class PinLine(NamedTuple):
    """One line of an axis at a pin.

    Attributes:
        axis: Name of the axis.
        line: Name of the line, of DRIVEN or READ.
        pin: Name of the pin, or of the signal of a capture.
        inverted: Whether the line is asserted while the pin is low.
    """

    axis: str
    line: str
    pin: str
    inverted: bool

    def __str__(self) -> str:
        return f"{self.axis}.{self.line}={'!' if self.inverted else ''}{self.pin}"

    def get_mask(self, chip: Chip) -> int:
        """Return the bits of a chip's input pins that the line stands for."""
        return sum(chip.INPUTS[name] for name in (DRIVEN | READ)[self.line])


def parse_pins(texts: str | Iterable[str], chips: Mapping[str, Chip], fold_case: bool = False) -> tuple[PinLine, ...]:
    """Parse the lines of axes at pins.

    Args:
        texts: One text or several: entries joined by commas, or names of PRESETS, of which the axes that the stage has count.
        chips: Chip of each axis by the axis' name.
        fold_case: Whether d2 is D2, as at a processor; signals of a capture keep their case.

    Returns:
        The lines in the order of the text; an entry takes the place of that of a preset before it.

    Raises:
        ArgumentError: Another form, an unknown axis or line, an axis whose chip has no such line, or a pin that is used twice.
    """
    lines: dict[tuple[str, str], PinLine] = {}
    for entry in (part.strip() for text in ([texts] if isinstance(texts, str) else texts) for part in text.split(",")):
        preset = [_parse_entry(part) for part in PRESETS[entry].split(",")] if entry in PRESETS else []
        present = [line for line in preset if line.axis in chips]
        if preset and not present:
            axes = dict.fromkeys(line.axis for line in preset)
            raise ArgumentError(
                f"--pins {entry}: it wires the axes {', '.join(axes)}, and the stage has {', '.join(chips)}. Write its lines out: "
                f"{FORM}."
            )
        lines |= {(line.axis, line.line): line for line in present or [_parse_entry(entry)]}
    lines = {key: line for key, line in lines.items() if line.pin != NO_PIN}
    if fold_case:
        lines = {key: line._replace(pin=line.pin.upper()) for key, line in lines.items()}
    for line in lines.values():
        _check_pin_line(line, chips)
    _check_pins(lines.values())
    return tuple(lines.values())


def _parse_entry(entry: str) -> PinLine:
    match = _ENTRY.fullmatch(entry)
    if match is None:
        presets = ", ".join(PRESETS)
        raise ArgumentError(f"--pins {entry!r}: write {FORM}, or one of {presets}.")
    if match["line"] not in DRIVEN | READ:
        raise ArgumentError(f"--pins {entry!r}: {unknown_name_error('line', match['line'], DRIVEN | READ)}")
    return PinLine(match["axis"], match["line"], match["pin"], bool(match["invert"]))


def _check_pin_line(line: PinLine, chips: Mapping[str, Chip]) -> None:
    """Raise ArgumentError for an axis that does not exist or whose chip has no such pin."""
    if line.axis not in chips:
        raise ArgumentError(f"--pins {line}: {unknown_name_error('axis', line.axis, chips)}")
    chip = chips[line.axis]
    if any(name not in chip.INPUTS for name in ("step", *(DRIVEN | READ)[line.line])):
        raise ArgumentError(
            f"--pins {line}: axis {line.axis} has a {type(chip).__name__}, which makes its own steps. Make it a STEP/DIR axis: "
            f"--chips stepdir."
        )


def _check_pins(lines: Iterable[PinLine]) -> None:
    """Raise ArgumentError for a pin that stands for two lines that cannot share it."""
    users: dict[str, PinLine] = {}
    for line in lines:
        other = users.setdefault(line.pin, line)
        is_shared = line.line in SHARED and (line.line, line.inverted) == (other.line, other.inverted)
        if other is not line and not is_shared:
            raise ArgumentError(
                f"--pins: pin {line.pin} is used twice, by {other} and {line}. Give each line its own pin."
            )


def describe_silent_steps(silent: Sequence[str], others: Sequence[str], n_steps: int) -> tuple[str, ...]:
    """Return sentences about STEP pins that a program has never changed.

    Args:
        silent: These pins, as "x.step = D2".
        others: Pins without a line that the program toggled.
        n_steps: Number of all STEP pins.
    """
    if others:
        advice = f"never changed; the program toggles {', '.join(others)}. Name its STEP pin in --pins."
        return tuple(f"{name} {advice}" for name in silent)
    if silent and len(silent) == n_steps:
        return (f"The program has made no step: {', '.join(silent)} never changed, nor did other pins.",)
    return ()
