"""Lines of STEP/DIR axes at the pins of firmware in C and of Arduino sketches: `struct pulsestage_line` of pulsestage.h."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from stage.board.bus.serial_core import SERIAL_LINE_COUNT
from stage.board.pin_assignment import (
    DRIVEN_LINE_PINS,
    UART_LINE,
    PinLine,
    PinUse,
    PinWiring,
    WiringFinding,
    find_wiring_findings,
    name_serial_line,
    parse_wiring,
)
from stage.chips.stepdir.line_names import POWER_STAGE_OUTPUTS
from stage.errors import ArgumentError
from stage.sim.stage import Stage

PIN_LINE = np.dtype(
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
LINE_READ, PIN_READ, PORT_READ = 1, 2, 4
"""Bits of `reads`: the pin has a line; it has none; it has none and was read with the other pins of its port."""
FIRST_SOFTWARE_SERIAL = 4
"""First line of SoftwareSerial."""
SERIAL_USE = np.dtype([("unsent", "u4", (SERIAL_LINE_COUNT,))])
"""`struct pulsestage_serial_use` of pulsestage.h."""
PULLED_LINES = ("enable",)
"""Lines that stay asserted while their pin is no output, as the power stage's own resistor keeps them."""
SWITCHES = ("limit", "limit_plus", "limit_minus", "origin")
"""Lines that stand for switches of the stage."""
DIAGNOSES = ("diag", "diag0", "diag1")
"""Outputs of power stages that tell of a stall or a fault."""
_PORT_PIN = re.compile(rf"([{PORTS}])([0-7])")


class FirmwarePinUse(NamedTuple):
    """Pins that firmware has read and driven, as counted while it ran.

    Attributes:
        pins: PIN_USE record.
        reads: PIN_READS record.
        board_pins: Bit of the ports of each numbered pin of a sketch's board; empty for C.
    """

    pins: Any
    reads: Any
    board_pins: Sequence[int] = ()


def parse_firmware_pins(texts: str | Iterable[str], stage: Stage) -> PinWiring:
    """Parse the lines of a stage's axes at pins of firmware: pin numbers (2) or bits of ports (D2).

    Raises:
        ArgumentError: See `parse_pins`; also for another form of a pin's name.
    """
    wiring = parse_wiring(texts, {name: axis.chip for name, axis in stage.axes.items()})
    for line in wiring.lines:
        _parse_pin(line)
    return wiring


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
    """Return the PIN_LINE records of the lines of axes that are connected to firmware pins, sorted by chip."""
    table = np.zeros(len(lines), PIN_LINE)
    for place, (row, line) in enumerate(zip(table, lines, strict=True)):
        chip = stage.axes[line.axis].chip
        row["chip"], row["pins"] = list(stage.chips).index(chip), line.get_mask(chip)
        row["pin"], row["is_number"] = _parse_pin(line)
        row["inverted"], row["driven"], row["released"] = (
            line.inverted,
            line.line in DRIVEN_LINE_PINS,
            line.line in PULLED_LINES,
        )
        row["place"] = place
    return np.sort(table, order="chip", kind="stable")


def find_firmware_wiring_findings(
    table: np.ndarray, wiring: PinWiring, firmware: FirmwarePinUse, stage: Stage
) -> tuple[WiringFinding, ...]:
    """Return the signs that lines of axes are at the wrong pins of the firmware.

    Args:
        table: PIN_LINE records as the firmware has them, in the order of the wiring's lines.
        wiring: Lines of axes at its pins.
        firmware: Its use of pins.
        stage: Stage with the axes.
    """
    lines, use, reads = wiring.lines, firmware.pins, firmware.reads
    refusal, times = use["refusal"].decode(errors="replace"), int(reads["refusals"])
    again = f", the first of {times:,} such calls" if times > 1 else ""
    refused: tuple[WiringFinding, ...] = (WiringFinding("", f"{refusal}{again}."),) if refusal else ()
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
    refused += tuple(_find_useless_outputs(table, lines, reads["reads"], stage))
    unconnected = _find_unconnected_outputs(table, wiring, firmware, stage)
    return refused + findings + tuple(_find_unread_switches(table, lines, reads["reads"], stage)) + tuple(unconnected)


def _find_unconnected_outputs(
    table: np.ndarray, wiring: PinWiring, firmware: FirmwarePinUse, stage: Stage
) -> Iterable[WiringFinding]:
    """Yield a finding for each axis whose power stage has outputs at no pin, while the program reads pins that nothing drives.

    It is a problem if a host has set up such an output. Arguments are those of `find_firmware_wiring_findings`.
    """
    names = _name_undriven_inputs(table, firmware)
    outputs: dict[str, list[str]] = {}
    for axis, output in wiring.unconnected:
        if output != UART_LINE:
            outputs.setdefault(axis, []).append(output)
    for axis, unconnected in outputs.items() if names else ():
        chip: Any = stage.axes[axis].chip
        configured = [name for name in chip.list_configured_outputs() if name in unconnected]
        name = f"{axis}.{(configured or unconnected)[0]}"
        example = next((text.split()[0] for text in names if not text.startswith("port")), "9")
        text = f"The program reads {', '.join(names)}, where --pins has no line, so that nothing changes it"
        if configured:
            text += (
                f"; it has set up {name}, which has no pin: write {name}={example}, or {name}=none if nothing reads it."
            )
        else:
            text += f". If it reads {' or '.join(f'{axis}.{output}' for output in unconnected)} there, write {name}={example}."
        yield WiringFinding(axis, text, bool(configured))


def _find_useless_outputs(
    table: np.ndarray, lines: Sequence[PinLine], reads: np.ndarray, stage: Stage
) -> Iterable[WiringFinding]:
    """Yield a problem for each output of a power stage that the program reads and that cannot show what it is read for.

    Arguments are those of `_find_unread_switches`.
    """
    for row in sorted(table, key=lambda row: int(row["place"])):
        line = lines[row["place"]]
        chip: Any = stage.axes[line.axis].chip
        if (
            line.line in POWER_STAGE_OUTPUTS
            and reads[row["pin"]]
            and (reason := chip.explain_output_mistake(line.line))
        ):
            yield WiringFinding(line.axis, f"The program reads {line.axis}.{line.line} = {line.pin}, and {reason}.")


def _name_undriven_inputs(table: np.ndarray, firmware: FirmwarePinUse) -> list[str]:
    """Return the names of the pins and ports that a program reads where no line is; see `find_firmware_wiring_findings`."""
    reads, has_ports = firmware.reads["reads"], bool(firmware.pins["has_ports"])
    numbers = {bit: number for number, bit in reversed(list(enumerate(firmware.board_pins)))}
    pins = [pin for pin in np.flatnonzero(reads & PIN_READ).tolist() if pin not in table["pin"]]
    ports = dict.fromkeys(PORTS[pin // 8] for pin in np.flatnonzero(reads & PORT_READ).tolist() if pin not in pins)
    names = [
        f"{numbers[pin]} ({_name_pin(pin, False, True)})"
        if pin in numbers
        else _name_pin(pin, not has_ports, has_ports)
        for pin in pins
    ]
    return names + [f"port {port}" for port in ports]


def find_sends_with_transmitter_off(use: Any) -> tuple[WiringFinding, ...]:
    """Return the serial lines over which a program has sent bytes while its transmitter was off.

    Args:
        use: SERIAL_USE record of the firmware. What it sends over line 0 is in the log in any case, so that is a remark.
    """
    findings = []
    for number in np.flatnonzero(use["unsent"]).tolist():
        name = name_serial_line(number)
        in_c = f", or in C for an AVR set TXEN{number} in UCSR{number}B" if number < FIRST_SOFTWARE_SERIAL else ""
        text = (
            f"The program sent {int(use['unsent'][number]):,} bytes over {name} while its transmitter was off, so that none left "
            f"the pin: call {name}.begin before{in_c}."
        )
        findings.append(WiringFinding("", text, is_problem=number > 0))
    return tuple(findings)


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
        table: PIN_LINE records as the firmware has them.
        lines: The lines, in the order of `table`.
        reads: How the program has read each pin.
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
