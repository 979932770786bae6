"""`parse_pins`: which pins of a microcontroller, or signals of a capture, are the STEP/DIR lines and the switches of axes, as text.

    x.step=D2,x.dir=D5,x.enable=!B0,x.limit=!B1,x.uart=Serial1

A `!` in front of a pin inverts it: the line is asserted while the pin is low. The names of presets stand for the wiring of common
boards. Lines that the microcontroller drives: step, dir, enable. Lines that it reads: limit (either end limit), limit_plus,
limit_minus, origin, probe, and the outputs diag and index of power stages that have them. `uart` connects the UART of a power
stage to a serial line of the microcontroller; axes at one line share one wire.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from stage.chips import Chip
from stage.chips.stepdir.line_names import DRIVEN_LINE_PINS, POWER_STAGE_OUTPUTS, READ_LINE_PINS, has_line
from stage.errors import ArgumentError, unknown_name_error

UART_LINE = "uart"
SERIAL_LINES = {
    "Serial": 0, "Serial1": 1, "Serial2": 2, "Serial3": 3,
    "SoftwareSerial": 4, "SoftwareSerial2": 5, "SoftwareSerial3": 6, "SoftwareSerial4": 7,
}  # fmt: skip
"""Serial lines of a microcontroller by the names of Arduino, and their numbers; SoftwareSerial to SoftwareSerial4 are the first
objects of a sketch in their order."""
SHAREABLE_LINES = ("enable", UART_LINE, *READ_LINE_PINS)
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
MIN_RISES = 16
"""Rising edges of one full step with the usual microsteps."""
_ENTRY = re.compile(r"(?P<axis>[^.=]+)\.(?P<line>[A-Za-z_]+)=(?P<invert>!?)(?P<pin>[^\s,=!]+)")


class PinLine(NamedTuple):
    """Line of an axis, and the pin to which it is connected.

    Attributes:
        axis: Name of the axis.
        line: Name of the line, of DRIVEN or READ.
        pin: Name of the pin, or of the signal of a capture.
        inverted: Whether the line is asserted while the pin is low.
        is_preset: Whether the line comes from the name of a board in PRESETS.
    """

    axis: str
    line: str
    pin: str
    inverted: bool
    is_preset: bool = False

    def __str__(self) -> str:
        return f"{self.axis}.{self.line}={'!' if self.inverted else ''}{self.pin}"

    def get_mask(self, chip: Chip) -> int:
        """Return the bits that the line has among the input pins of a chip."""
        return sum(chip.INPUTS[name] for name in (DRIVEN_LINE_PINS | READ_LINE_PINS)[self.line])


def parse_pins(texts: str | Iterable[str], chips: Mapping[str, Chip], fold_case: bool = False) -> tuple[PinLine, ...]:
    """Parse texts that connect lines of axes to pins.

    Args:
        texts: One text or several: entries joined by commas, or names of PRESETS. Lines of a preset for axes that the stage does
            not have are ignored.
        chips: Chip of each axis by the axis' name.
        fold_case: Whether d2 equals D2, as for the pins of a processor; signals of a capture keep their case.

    Returns:
        The lines in the order of the text. An entry replaces that of a preset before it.

    Raises:
        ArgumentError: Another form, an unknown axis or line, an axis whose chip has no such line, a line or a pin that is used
            twice, or a DIR line without a STEP line.
    """
    lines: dict[tuple[str, str], PinLine] = {}
    for entry in (part.strip() for text in ([texts] if isinstance(texts, str) else texts) for part in text.split(",")):
        parts = PRESETS[entry].split(",") if entry in PRESETS else []
        preset = [_parse_entry(part)._replace(is_preset=True) for part in parts]
        present = [line for line in preset if line.axis in chips]
        if preset and not present:
            axes = dict.fromkeys(line.axis for line in preset)
            raise ArgumentError(
                f"--pins {entry}: it wires the axes {', '.join(axes)}, and the stage has {', '.join(chips)}. Write its lines out: "
                f"{FORM}."
            )
        for line in present or [_parse_entry(entry)]:
            _check_replaced_line(lines.get((line.axis, line.line)), line)
            lines[line.axis, line.line] = line
    _check_direction_lines(lines)
    lines = {key: line for key, line in lines.items() if line.pin != NO_PIN}
    if fold_case:
        lines = {
            key: line if line.line == UART_LINE else line._replace(pin=line.pin.upper()) for key, line in lines.items()
        }
    for line in lines.values():
        _check_pin_line(line, chips)
    _check_pins(lines.values())
    return tuple(lines.values())


def name_serial_line(number: int) -> str:
    """Return the name of a serial line, as --pins has it."""
    return next(name for name, of_name in SERIAL_LINES.items() if of_name == number)


def find_unconnected_outputs(
    texts: Iterable[str], lines: Iterable[PinLine], chips: Mapping[str, Chip]
) -> tuple[tuple[str, str], ...]:
    """Find outputs of power stages and UARTs of chips that no pin is assigned to.

    An output that a text leaves open on purpose, as x.diag=none does, is not among them.

    Args:
        texts: The texts that `parse_pins` has parsed.
        lines: Its result.
        chips: Chip of each axis by the axis' name.

    Returns:
        Names of the axis and the line of each. Axes without any line are left out.
    """
    entries = {part.strip() for text in texts for part in text.split(",")}
    connected = {(line.axis, line.line) for line in lines}
    return tuple(
        (axis, name)
        for axis in dict.fromkeys(axis for axis, _ in connected)
        for name in (*POWER_STAGE_OUTPUTS, UART_LINE)
        if (name in chips[axis].INPUTS or (name == UART_LINE and getattr(chips[axis], "uart", None) is not None))
        and (axis, name) not in connected
        and f"{axis}.{name}={NO_PIN}" not in entries
    )


def _parse_entry(entry: str) -> PinLine:
    """Parse one entry, AXIS.LINE=PIN. Raises ArgumentError for another form."""
    match = _ENTRY.fullmatch(entry)
    if match is None:
        presets = ", ".join(PRESETS)
        raise ArgumentError(f"--pins {entry!r}: write {FORM}, or one of {presets}.")
    if match["line"] == UART_LINE:
        return _parse_uart_entry(match)
    if match["line"] not in DRIVEN_LINE_PINS | READ_LINE_PINS:
        names = (*DRIVEN_LINE_PINS, *READ_LINE_PINS, UART_LINE)
        raise ArgumentError(f"--pins {entry!r}: {unknown_name_error('line', match['line'], names)}")
    return PinLine(match["axis"], match["line"], match["pin"], bool(match["invert"]))


def _parse_uart_entry(match: re.Match[str]) -> PinLine:
    """Return the line of an entry such as x.uart=Serial1. Raises ArgumentError if it names no serial line."""
    name = next((name for name in SERIAL_LINES if name.lower() == match["pin"].lower()), None)
    if match["invert"] or (name is None and match["pin"] != NO_PIN):
        raise ArgumentError(
            f"--pins {match[0]!r}: a UART is at a serial line, {', '.join(SERIAL_LINES)}, or {NO_PIN}: {match['axis']}.uart=Serial."
        )
    return PinLine(match["axis"], UART_LINE, name or NO_PIN, False)


def _check_replaced_line(old: PinLine | None, new: PinLine) -> None:
    """Raise ArgumentError if two entries connect one line to different pins, and neither comes from a preset."""
    if old is not None and not (old.is_preset or new.is_preset or old.pin == NO_PIN) and old != new:
        raise ArgumentError(f"--pins: {old} and {new} are the same line. Give it one pin.")


def _check_direction_lines(lines: Mapping[tuple[str, str], PinLine]) -> None:
    """Raise ArgumentError for an axis with a DIR line and no STEP line."""
    for (axis, name), line in lines.items():
        if name == "dir" and (axis, "step") not in lines:
            raise ArgumentError(
                f"--pins {line}: nothing makes steps of {axis}. Name its STEP pin, too: {axis}.step=D2."
            )


def _check_pin_line(line: PinLine, chips: Mapping[str, Chip]) -> None:
    """Raise ArgumentError for an axis that does not exist or whose chip has no such pin."""
    if line.axis not in chips:
        raise ArgumentError(f"--pins {line}: {unknown_name_error('axis', line.axis, chips)}")
    chip = chips[line.axis]
    has = getattr(chip, "uart", None) is not None if line.line == UART_LINE else has_line(chip, line.line)
    if "step" in chip.INPUTS and not has:
        kind = "" if line.line == UART_LINE else "output "
        raise ArgumentError(
            f"--pins {line}: the power stage of axis {line.axis} has no {kind}{line.line}. Choose one that has it "
            "(stage list power-stages), or leave the line out."
        )
    if not has:
        raise ArgumentError(
            f"--pins {line}: axis {line.axis} has a {type(chip).__name__}, which makes its own steps. Make it a STEP/DIR axis: "
            f"--chips stepdir."
        )


def _check_pins(lines: Iterable[PinLine]) -> None:
    """Raise ArgumentError if a pin is assigned to two lines of axes that cannot share it."""
    users: dict[str, PinLine] = {}
    for line in lines:
        other = users.setdefault(line.pin, line)
        is_shared = line.line in SHAREABLE_LINES and (line.line, line.inverted) == (other.line, other.inverted)
        if other is not line and not is_shared:
            raise ArgumentError(
                f"--pins: pin {line.pin} is used twice, by {other} and {line}. Give each line its own pin."
            )


class PinWiring(NamedTuple):
    """Lines of axes at pins and serial lines of a microcontroller.

    Attributes:
        lines: Lines at pins.
        uarts: Number of each serial line with UARTs, and the names of their axes.
        unconnected: Axis and name of each output of a power stage and each UART, of axes with lines, that is at no pin; without
            those that the user has taken out, as x.diag=none does.
    """

    lines: tuple[PinLine, ...] = ()
    uarts: tuple[tuple[int, tuple[str, ...]], ...] = ()
    unconnected: tuple[tuple[str, str], ...] = ()


EMPTY_WIRING = PinWiring()


def parse_wiring(texts: str | Iterable[str], chips: Mapping[str, Chip], fold_case: bool = False) -> PinWiring:
    """Parse texts that connect lines of axes to pins, and UARTs to serial lines. Arguments and errors are those of `parse_pins`."""
    entries = [texts] if isinstance(texts, str) else list(texts)
    lines = parse_pins(entries, chips, fold_case)
    uarts: dict[int, tuple[str, ...]] = {}
    for line in lines:
        if line.line == UART_LINE:
            number = SERIAL_LINES[line.pin]
            uarts[number] = (*uarts.get(number, ()), line.axis)
    at_pins = tuple(line for line in lines if line.line != UART_LINE)
    return PinWiring(at_pins, tuple(uarts.items()), find_unconnected_outputs(entries, lines, chips))


class WiringFinding(NamedTuple):
    """Sign that lines of axes are at the wrong pins.

    Attributes:
        axis: Name of the axis; "" if the finding is about all axes.
        text: The finding in one sentence.
        is_problem: Whether the wiring is certainly wrong. Otherwise the program may be right, for example if it never moves this
            axis.
    """

    axis: str
    text: str
    is_problem: bool = True


class PinUse(NamedTuple):
    """Use of the pin to which an axis' line is connected, by a program.

    Attributes:
        line: The line.
        rises: Number of times that the pin rose as an output.
        pull_ups: Number of times that the program set the pin high while it was an input, since it was last made an output.
    """

    line: PinLine
    rises: int
    pull_ups: int

    def __str__(self) -> str:
        return f"{self.line.axis}.{self.line.line} = {self.line.pin}"


def find_wiring_findings(
    uses: Sequence[PinUse], others: Mapping[str, int], chips: Mapping[str, Chip]
) -> tuple[WiringFinding, ...]:
    """Return the signs that lines of axes are connected to the wrong pins of a program.

    A pin for a lamp or a relay has few edges, and a STEP pin has many. So a pin without a line counts as a STEP pin in the wrong
    place if it rose MIN_RISES times as often as the line that it is compared with.

    Args:
        uses: Use of each line that the program drives.
        others: Number of times that pins without a line rose, by name.
        chips: Chip of each axis by the axis' name.
    """
    others = {pin: rises for pin, rises in others.items() if rises > 1}
    steps = [use for use in uses if use.line.line == "step"]
    if not steps:
        return _find_unconnected_pins(others, chips)
    by_axis = [
        _find_step_finding(use, uses, others, chips[use.line.axis]) or _find_direction_finding(use, uses, others)
        for use in steps
    ]
    findings = tuple(finding for finding in by_axis if finding)
    if not findings and not any(use.rises for use in steps):
        text = f"The program has made no step: {', '.join(map(str, steps))} never changed, nor did other pins."
        return (WiringFinding("", text, is_problem=False),)
    return findings


def _find_unconnected_pins(others: Mapping[str, int], chips: Mapping[str, Chip]) -> tuple[WiringFinding, ...]:
    """Return a finding about pins that a program drives if --pins names no STEP line and no axis has moved."""
    if not others or any(chip.net(k) for chip in chips.values() for k in range(chip.AXES)):
        return ()
    axes = [name for name, chip in chips.items() if "step" in chip.INPUTS]
    option = "" if axes else "--chips stepdir "
    busiest = max(others, key=lambda pin: others[pin])
    text = (
        f"The program toggles {', '.join(others)}, and no STEP/DIR axis is connected to its pins: write {option}--pins "
        f"{[*axes, *chips][0]}.step={busiest.split()[0]} and so on (docs/step_dir.md)."
    )
    return (WiringFinding("", text, others[busiest] >= MIN_RISES),)


def _find_step_finding(
    step: PinUse, uses: Sequence[PinUse], others: Mapping[str, int], chip: Chip
) -> WiringFinding | None:
    """Return the finding about the STEP line of an axis, or None. The other arguments are those of `find_wiring_findings`."""
    axis, needed = step.line.axis, MIN_RISES * max(step.rises, 1)
    is_moving = any(use.rises for use in uses if use.line.line == "step" and use is not step)
    is_problem = not (step.line.is_preset and is_moving)
    if not step.rises and step.pull_ups > 1:
        return WiringFinding(axis, _describe_input(step), is_problem)
    other_lines = [use for use in uses if use.line.axis == axis and use is not step]
    busiest = max(other_lines, key=lambda use: use.rises, default=step)
    if busiest.rises >= max(needed, *others.values(), 0):
        return WiringFinding(
            axis, f"{busiest} rose {busiest.rises:,} times, and {step} {step.rises}: exchange their pins."
        )
    likely = {pin: rises for pin, rises in others.items() if rises >= needed}
    if likely or (others and not step.rises):
        count = f"changed only {step.rises} times" if step.rises else "never changed"
        pins = ", ".join(likely or others)
        if not (is_problem and likely):
            text = (
                f"{step} {count}. The program also toggles {pins}: if one of them is the STEP pin of {axis}, name it in --pins; "
                "if not, nothing is wrong."
            )
            return WiringFinding(axis, text, is_problem=False)
        text = (
            f"{step} {count}; the program toggles {pins}. Name its STEP pin in --pins, or {axis}.step=none if nothing moves "
            f"{axis}."
        )
        return WiringFinding(axis, text)
    if is_moving and not (step.rises or step.line.is_preset):
        text = f"{step} never changed. If nothing moves {axis}, leave its lines out of --pins."
        return WiringFinding(axis, text, is_problem=False)
    return _find_ignored_steps(step, other_lines, chip)


def _describe_input(use: PinUse) -> str:
    """Describe, as a sentence, a line of an axis at a pin that the program sets high, but leaves an input."""
    return f"{use} is an input: the program sets it high, but does not make it an output, as pinMode does."


def _find_direction_finding(step: PinUse, uses: Sequence[PinUse], others: Mapping[str, int]) -> WiringFinding | None:
    """Return the finding about the DIR line of an axis that makes steps, or None.

    A direction that never changes is legal, so that another pin that the program toggles is only remarked upon.

    Args:
        step: STEP line of the axis.
        uses: Use of each line that the program drives.
        others: Number of times that pins without a line rose, by name.
    """
    axis = step.line.axis
    direction = next((use for use in uses if (use.line.axis, use.line.line) == (axis, "dir")), None)
    if not step.rises or (direction and direction.rises):
        return None
    if direction and direction.pull_ups:
        return WiringFinding(axis, _describe_input(direction))
    if not others or (direction or step).line.is_preset:
        return None
    pins, name = ", ".join(others), f"{axis}.dir={next(iter(others)).split()[0]}"
    observation = f"{direction} never changed" if direction else f"{axis} has no DIR line"
    text = (
        f"{observation}, so that {axis} moves one way only; the program also toggles {pins}. If one of them is its DIR pin, name "
        f"it in --pins: {name}."
    )
    return WiringFinding(axis, text, is_problem=False)


def _find_ignored_steps(step: PinUse, other_lines: Sequence[PinUse], chip: Chip) -> WiringFinding | None:
    """Return the finding about steps that a disabled power stage has ignored, or None.

    One ignored edge may be a level that the program sets at its start.

    Args:
        step: STEP line of the axis.
        other_lines: Its other lines that the program drives.
        chip: Its chip.
    """
    accepted, ignored = int(chip.state["accepted"]), int(chip.state["ignored"])
    if not step.rises or not ignored:
        return None
    enable = next((str(use) for use in other_lines if use.line.line == "enable"), "ENABLE")
    if accepted:
        text = (
            f"The power stage of {step.line.axis} ignored {ignored:,} of {accepted + ignored:,} steps, because {enable} kept it "
            "disabled."
        )
    else:
        text = f"{step} rose {step.rises:,} times and made no step: {enable} kept the power stage disabled. Is its polarity right?"
    return WiringFinding(step.line.axis, text, ignored > 1)
