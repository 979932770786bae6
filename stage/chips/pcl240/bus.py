"""Effects of bus writes, values of bus reads, and the output pins of the PCL-240 family, compiled. All acts between two ticks."""

from __future__ import annotations

from stage.chips.pcl240 import state
from stage.chips.pcl240.maps import CONTROL, OPERATE, SELECT
from stage.chips.pcl240.ramp import correct_fh, find_goal_speed, read_selected_speed
from stage.native import hot


@hot
def is_blocked(c):
    """Return whether a limit switch of the direction is asserted, or ORG during an origin return."""
    return c.active_inputs & (state.EL_MINUS if c.minus else state.EL_PLUS) or (
        c.origin_return and c.active_inputs & state.ORG
    )


@hot
def _execute_operating_command(c, value):
    """Execute a command of group 00: start, stop, or change of speed."""
    c.int_at_stop = 1 if value & state.INT_AT_STOP else 0
    if not c.int_at_stop:
        c.irq = 0
    starts, stops, ramps = value & state.START, value & state.STOP, 1 if value & state.RAMP else 0
    if stops and not starts:
        if c.running:
            state.stop_run(c)
        c.armed = 1
        if c.extended:
            c.reg[6] = 0
    elif stops and c.running:
        if not ramps and not c.uses_ramps:
            state.stop_run(c)
        else:
            c.uses_ramps = c.stopping = 1
            if c.speed <= c.reg[1]:
                state.stop_run(c)
    elif starts and not stops:
        if c.running:
            c.uses_ramps, c.speed_select, c.stopping = ramps, value & state.SPEED, 0
        elif c.armed and not c.finishing and not is_blocked(c) and not (c.preset and c.reg[0] == 0):
            c.uses_ramps, c.speed_select, c.stopping = ramps, value & state.SPEED, 0
            state.begin_run(c)
            correct_fh(c)
            c.speed = c.reg[1] if c.uses_ramps else read_selected_speed(c)
            c.running = 1


@hot
def _store_register(c, k, value):
    """Store the writable bits of a register.

    Args:
        c: State of the chip.
        k: Index of the register.
        value: Its new value.
    """
    c.reg[k] = c.reg[k] & ~c.writable_bits[k] | value & c.writable_bits[k]
    if k in (7, state.R12, state.R13):
        state.read_pins(c)
    if c.running and (k in (1, 4, 5, state.R14, state.R15)):
        c.automatic_off = 1


@hot
def _write_data(c, address, value):
    """Store a byte that was written to address 1, 2 or 3.

    Args:
        c: State of the chip.
        address: Bus address.
        value: The byte.
    """
    if c.collective:  # the upper bytes wait for the lowest one
        if address == 3:
            c.high_byte = value
        elif address == 2:
            c.middle_byte = value
        else:
            _store_register(c, c.selected_register, c.high_byte << 16 | c.middle_byte << 8 | value)
        return
    shift = 8 * (address - 1)
    _store_register(c, c.selected_register, c.reg[c.selected_register] & ~(0xFF << shift) | value << shift)


@hot
def write_byte(c, address, value):
    """Make a bus write cycle.

    Args:
        c: State of the chip.
        address: Bus address.
        value: The byte.
    """
    address &= 3
    value &= 0xFF
    c.quiet_until = 0
    if address:
        _write_data(c, address, value)
        return
    group = value & state.GROUP
    if group == OPERATE:
        _execute_operating_command(c, value)
    elif group == CONTROL:
        c.origin_return, c.sd_enable = 1 if value & state.ORIGIN else 0, 1 if value & state.SD else 0
        c.preset, c.minus = 1 if value & state.PRESET else 0, 1 if value & state.MINUS else 0
        if c.extended:
            c.automatic_ramp_down, c.counts_position = (
                1 if value & state.AUTOMATIC else 0,
                1 if value & state.POSITION else 0,
            )
    elif group == SELECT:
        c.selected_register = value & state.REGISTER
        if c.extended:
            c.selected_register += state.R10 if value & state.SECOND_EIGHT else 0
            c.collective = 1 if value & state.COLLECTIVE else 0
    else:
        c.output_mode = value & state.OUTPUT_BITS


@hot
def read_register(c, k):
    """Return what a register reads. Only the MS has the EZ monitor in R17.

    Args:
        c: State of the chip.
        k: Index of the register.
    """
    if k == state.R17 and c.s_curves:
        count = c.ez_left if c.ez_started else c.reg[state.R13] >> state.EZ_COUNT & state.MAX_EZ_COUNT
        return c.reg[state.R17] | count << state.EZ_COUNT | (state.EZ_SIGNAL if c.active_inputs & state.EZ else 0)
    return c.reg[k]


@hot
def compute_outputs(c):
    """Compute the output pins, bits of OUTPUTS. A set bit means asserted; active-low pins are then low."""
    word = 0 if c.running or c.finishing else state.HOLD
    goal = find_goal_speed(c)
    if not c.running or not c.uses_ramps:
        word |= state.FKEEP
    elif c.speed == goal:
        word |= state.FDOWN if c.clock < c.fdown_end else state.FKEEP
    elif c.speed < goal:
        word |= state.FUP
    else:
        word |= state.FDOWN
    if c.output_mode & state.INDEPENDENT:
        if c.pout_low:
            word |= state.PDIR if c.minus else state.POUT
    else:
        word |= (state.POUT if c.pout_low else 0) | (state.PDIR if c.minus else 0)
    if c.reg[0] < c.reg[6]:
        word |= state.LT
    if c.reg[0] == 0:
        word |= state.ZERO
    if c.output_mode & state.OTS_LEVEL:
        word |= state.OTS
    if c.irq:
        word |= state.IRQ
    return word


@hot
def _compute_status(c):
    """Compute the status byte."""
    word = compute_outputs(c)
    status = 0 if word & state.IRQ else state.S_NO_INT
    if not word & state.HOLD:
        status |= state.S_OPERATING
    if word & state.FKEEP:
        status |= state.S_FKEEP
    if word & state.LT:
        status |= state.S_LT
    if word & state.ZERO:
        status |= state.S_ZERO
    if c.active_inputs & (state.SD_MINUS if c.minus else state.SD_PLUS):
        status |= state.S_SD
    if c.active_inputs & state.ORG:
        status |= state.S_ORG
    if c.active_inputs & state.INS:
        status |= state.S_INS
    return status


@hot
def read_byte(c, address):
    """Make a bus read cycle. In collective mode a read of the high byte latches all bytes.

    Args:
        c: State of the chip.
        address: Bus address.
    """
    address &= 3
    if not address:
        return _compute_status(c)
    word = read_register(c, c.selected_register) if c.extended and c.output_mode & state.EXTENSION else c.reg[0]
    if c.collective:
        if address == 3:
            c.read_latch = word
        word = c.read_latch
    return word >> 8 * (address - 1) & 0xFF
