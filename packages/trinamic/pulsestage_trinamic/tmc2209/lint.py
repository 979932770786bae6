"""Diagnostics of a TMC2209 axis: writes of registers that do not do what they seem to. UART datagrams are checked when they act."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pulsestage_trinamic.tmc2209 import maps, state
from stage.chips.diagnostics import Finding, Rule
from stage.chips.stepdir.lint import lint_write as lint_step_timer

NO_REGISTER = Rule("tmc2209-no-register", "section 5")
READ_ONLY = Rule("tmc2209-read-only", "section 5")
MRES_UNUSED = Rule("tmc2209-mres-unused", "section 5.5.1")
DEDGE_FILTERED = Rule("tmc2209-dedge-filter", "section 5.5.1")
NOT_MODELED = Rule("tmc2209-not-modeled", "tmc2209_sheet.md", once=True)
SENDDELAY_ZERO = Rule("tmc2209-senddelay", "section 5.1, SLAVECONF", once=True)
MRES, SENDDELAY = maps.MAP.mask("CHOPCONF", "mres"), maps.MAP.field("SLAVECONF", "senddelay")
MULTISTEP_FILTER = maps.MAP.mask("GCONF", "multistep_filt")


def lint_write(c: Any, address: int, value: int) -> Iterator[Finding]:
    """Yield every rule that a bus write breaks.

    Args:
        c: State before the write.
        address: Bus address.
        value: Datum.
    """
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


def _lint_register(c: Any, number: int, value: int) -> Iterator[Finding]:
    changed, gconf = value ^ int(c["registers"][number]), int(c["registers"][state.GCONF])
    if number == state.CHOPCONF and changed & value & state.DEDGE and gconf & MULTISTEP_FILTER:
        yield DEDGE_FILTERED, "DEDGE needs GCONF.multistep_filt to be 0, and it is 1 after a reset"
    if number == state.CHOPCONF and changed & MRES and not gconf & state.MSTEP_REG_SELECT:
        yield MRES_UNUSED, "MRES has no effect while GCONF.mstep_reg_select is 0: MS1 and MS2 select the microsteps"
    if number == state.GCONF and value & maps.MAP.mask("GCONF", "internal_rsense"):
        yield NOT_MODELED, "internal sense resistors are not modeled: the current stays that of the external ones"
