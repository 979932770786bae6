"""The data register flag of an AVR's UARTs, compiled.

simavr 1.6 clears UDREn when a program switches its transmitter off, and never sets it again. The data sheet has the
flag set while the transmit buffer is empty.
"""

from __future__ import annotations

from stage.native import array_at, declare_address_call, exported, record
from stage.targets.avr_timers import SIMAVR_ACCESS, call_for_vector, read_bits, read_register_byte, write_register_byte

TRANSMITTER = record([(name, "i8") for name in "simavr function parameter transmitter vector flag flag_mask".split()])
"""simavr             address of the SIMAVR record
    function, parameter  simavr's function that writes UCSRnB
    transmitter        the register bit TXENn
    vector, flag       address of the avr_int_vector_t of UDREn; its register and bit
"""
_write_register = declare_address_call(None, "i8", "i4", "i4", "i8")


@exported(None, "i8", "i4", "i4", TRANSMITTER)
def write_transmitter_enable(avr, register, value, row):
    """Handle a write of the AVR's UCSRnB, and set UDREn when the program switches the transmitter off."""
    simavr = array_at(row.simavr, 1, SIMAVR_ACCESS)[0]
    was_enabled = read_bits(simavr, row.transmitter)
    _write_register(row.function, (avr, register & 0xFFFF, value & 0xFF, row.parameter))
    is_enabled = read_bits(simavr, row.transmitter)
    if was_enabled and not is_enabled:
        write_register_byte(simavr, row.flag, read_register_byte(simavr, row.flag) | row.flag_mask)
    elif is_enabled and not was_enabled:
        call_for_vector(simavr.raise_interrupt, (avr, row.vector))
