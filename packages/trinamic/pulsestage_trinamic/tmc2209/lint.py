"""Diagnostics of a TMC2209 axis: writes of registers that do not do what they seem to, and datagrams that do nothing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pulsestage_trinamic.tmc2209 import maps, state
from stage.chips.stepdir import STEPDIR
from stage.chips.stepdir.lint import lint_write as lint_step_timer
from stage.chips.write_diagnostics import Finding, Rule

NO_REGISTER = Rule("tmc2209-no-register", "section 5")
READ_ONLY = Rule("tmc2209-read-only", "section 5")
MRES_UNUSED = Rule("tmc2209-mres-unused", "section 5.5.1", once=True)
MRES_TEXT = "MRES has no effect while GCONF.mstep_reg_select is 0: MS1 and MS2 select the microsteps"
DEDGE_FILTERED = Rule("tmc2209-dedge-filter", "section 5.5.1")
NOT_MODELED = Rule("tmc2209-not-modeled", "tmc2209_sheet.md", once=True)
VELOCITY_ON = Rule("tmc2209-vactual", "section 5.2, VACTUAL")


def _make_uart_rule(name: str, section: str) -> Rule:
    return Rule(f"tmc2209-uart-{name}", f"section {section}", once=True)


UART_RULES = {
    state.BAD_RATE: (_make_uart_rule("rate", "4.3"), "the chip does not understand a bit time of {} ns"),
    state.BAD_SYNC: (
        _make_uart_rule("sync", "4.1"),
        "a datagram begins with 05h, and {} came: text for a log, or a datagram that was cut off, is at this line",
    ),
    state.BAD_CRC: (_make_uart_rule("crc", "4.2"), "wrong CRC of a datagram that {}"),
    state.NO_REGISTER: (_make_uart_rule("register", "5"), "a write by UART to {:02X}h, where is no register"),
    state.READ_ONLY: (_make_uart_rule("read-only", "5"), "a write by UART to {:02X}h, which can only be read"),
}
"""Rules that datagrams break, and messages about them."""
OTHER_ADDRESS_RULE = _make_uart_rule("address", "4.1")
IGNORED_DATAGRAM_KIND_BY_RULE_KEY = {rule.key: kind for kind, (rule, _) in UART_RULES.items()} | {
    OTHER_ADDRESS_RULE.key: state.OTHER_ADDRESS
}
"""Kinds of datagrams that do nothing, by the keys of their rules."""
REGISTER_NAMES = {r.number: r.name for r in maps.DRIVER_REGISTERS}
MICROSTEPS_OF_ADDRESS = (8, 32, 64, 16)
PDN_ENABLED = Rule("tmc2209-pdn-disable", "section 4.1", once=True)
NO_STALL_OUTPUT = Rule("tmc2209-no-stall-output", "section 11", once=True)
SENDDELAY_ZERO = Rule("tmc2209-senddelay", "section 5.1, SLAVECONF", once=True)
MRES, SENDDELAY = maps.MAP.mask("CHOPCONF", "mres"), maps.MAP.field("SLAVECONF", "senddelay")
WRITE_BIT = 0x80
MULTISTEP_FILTER = maps.MAP.mask("GCONF", "multistep_filt")


def lint_write(c: Any, address: int, value: int) -> Iterator[Finding]:
    """Yield every rule that a bus write breaks.

    Args:
        c: State before the write.
        address: Bus address.
        value: Datum.
    """
    begins_to_move = STEPDIR.find_selected_direction(address, value) is not None
    if begins_to_move and c["registers"][state.VACTUAL]:
        yield VELOCITY_ON, "the chip ignores STEP: VACTUAL is not 0, so it makes its own steps"
    if address < maps.UART_BYTE:
        yield from lint_step_timer(c, address, value)
    if address == maps.UART_OTHER and int(c["registers"][state.SLAVECONF]) >> SENDDELAY.low < 2:
        yield SENDDELAY_ZERO, "several chips on one wire need a SENDDELAY of 2 or more in SLAVECONF of each"
    if address < maps.REGISTER_BASE:
        return
    number = address - maps.REGISTER_BASE
    if number in maps.WRITABLE_REGISTERS:
        yield from _lint_register(c, number, value)
    elif number in maps.READABLE_REGISTERS:
        yield READ_ONLY, f"{maps.READABLE_REGISTERS[number].name} can only be read"
    else:
        yield NO_REGISTER, f"there is no register at {number:02X}h"


def find_uart_findings(c: Any, address: int) -> Iterator[tuple[int, Finding]]:
    """Yield clock, rule and message of what a host has done wrong so far, as the state shows it.

    Args:
        c: State of the chip.
        address: UART address of the chip.
    """
    clock, gconf = int(c["clock"]), int(c["registers"][state.GCONF])
    for kind, (rule, text) in UART_RULES.items():
        if c["mistakes"][kind]:
            detail = int(c["mistake_detail"][kind])
            values = {state.BAD_SYNC: _describe_byte, state.BAD_CRC: _describe_access}
            yield int(c["mistake_clock"][kind]), (rule, text.format(values.get(kind, int)(detail)))
    if c["mistakes"][state.OTHER_ADDRESS] and not (c["datagrams"] or c["others"]):
        other = int(c["mistake_detail"][state.OTHER_ADDRESS])
        cure = f" or the Drive {MICROSTEPS_OF_ADDRESS[other]} microsteps" if other < len(MICROSTEPS_OF_ADDRESS) else ""
        message = (
            f"datagrams came for address {other}, and none for that of this chip, {address} (MS1 + 2 MS2): give the program "
            f"address {address}{cure}"
        )
        yield int(c["mistake_clock"][state.OTHER_ADDRESS]), (OTHER_ADDRESS_RULE, message)
    if c["datagrams"] and not gconf & state.PDN_DISABLE:
        yield clock, (PDN_ENABLED, "with the UART in use the current does not fall to IHOLD: set GCONF.pdn_disable")
    if int(c["registers"][state.CHOPCONF]) & MRES and not gconf & state.MSTEP_REG_SELECT:
        yield clock, (MRES_UNUSED, MRES_TEXT)
    if c["registers"][state.SGTHRS] and c["moves"]:
        is_spread = bool(gconf & state.EN_SPREADCYCLE) != bool(int(c["inputs"]) & state.SPREAD)
        if is_spread or not c["registers"][state.TCOOLTHRS]:
            cause = "SpreadCycle is selected" if is_spread else "TCOOLTHRS is 0"
            yield clock, (NO_STALL_OUTPUT, f"SGTHRS is set, and DIAG never shows a stall: {cause}")


def _describe_byte(byte: int) -> str:
    """Return a byte of a host as a hexadecimal number, with the character that it stands for in a text."""
    return f"{byte:02X}h" + (f" ({chr(byte)!r})" if 32 <= byte < 127 else "")


def _describe_access(register: int) -> str:
    """Return what a datagram does with a register, whose number has the bit of a write."""
    number = register & 0x7F
    name = REGISTER_NAMES.get(number, "no register")
    return f"{'writes' if register & WRITE_BIT else 'reads'} {number:02X}h ({name})"


def _lint_register(c: Any, number: int, value: int) -> Iterator[Finding]:
    changed, gconf = value ^ int(c["registers"][number]), int(c["registers"][state.GCONF])
    if number == state.CHOPCONF and changed & value & state.DEDGE and gconf & MULTISTEP_FILTER:
        yield DEDGE_FILTERED, "DEDGE needs GCONF.multistep_filt to be 0, and it is 1 after a reset"
    if number == state.CHOPCONF and changed & MRES and not gconf & state.MSTEP_REG_SELECT:
        yield MRES_UNUSED, MRES_TEXT
    if number == state.GCONF and value & maps.MAP.mask("GCONF", "internal_rsense"):
        yield NOT_MODELED, "internal sense resistors are not modeled: the current stays that of the external ones"
