"""Bus cycles of the PCL-240 family, compiled: effects of writes, values of reads, and the output pins.

A bus cycle takes effect between two ticks of the reference clock.
"""

from __future__ import annotations

from stage.chips.pcl240 import state
from stage.chips.pcl240.maps import CONTROL, OPERATE, SELECT
from stage.chips.pcl240.ramp import correct_fh, find_goal_speed, read_selected_speed
from stage.native import hot


@hot
def is_blocked(chip):
    """Return whether a limit switch of the move's direction is asserted, or ORG during an origin return."""
    return chip.active_inputs & (state.EL_MINUS if chip.minus else state.EL_PLUS) or (
        chip.origin_return and chip.active_inputs & state.ORG
    )


@hot
def _execute_operating_command(chip, value):
    """Execute an operating command of the PCL-240 (group 00): start, stop, or change of speed."""
    chip.int_at_stop = 1 if value & state.INT_AT_STOP else 0
    if not chip.int_at_stop:
        chip.irq = 0
    starts, stops, ramps = value & state.START, value & state.STOP, 1 if value & state.RAMP else 0
    if stops and not starts:
        if chip.running:
            state.stop_run(chip)
        chip.armed = 1
        if chip.extended:
            chip.reg[6] = 0
    elif stops and chip.running:
        if not ramps and not chip.uses_ramps:
            state.stop_run(chip)
        else:
            chip.uses_ramps = chip.stopping = 1
            if chip.speed <= chip.reg[1]:
                state.stop_run(chip)
    elif starts and not stops:
        if chip.running:
            chip.uses_ramps, chip.speed_select, chip.stopping = ramps, value & state.SPEED, 0
        elif chip.armed and not chip.finishing and not is_blocked(chip) and not (chip.preset and chip.reg[0] == 0):
            chip.uses_ramps, chip.speed_select, chip.stopping = ramps, value & state.SPEED, 0
            state.clear_run_state(chip)
            correct_fh(chip)
            chip.speed = chip.reg[1] if chip.uses_ramps else read_selected_speed(chip)
            chip.running = 1


@hot
def _store_register(chip, register_number, value):
    """Store the writable bits of a register of the PCL-240.

    Args:
        chip: State of the chip.
        register_number: Index of the register.
        value: Its new value.
    """
    chip.reg[register_number] = (
        chip.reg[register_number] & ~chip.writable_bits[register_number] | value & chip.writable_bits[register_number]
    )
    if register_number in (7, state.R12, state.R13):
        state.update_active_inputs(chip)
    if chip.running and (register_number in (1, 4, 5, state.R14, state.R15)):
        chip.automatic_off = 1


@hot
def _write_data(chip, address, value):
    """Store a byte that was written to bus address 1, 2 or 3, a byte of the selected register.

    Args:
        chip: State of the chip.
        address: Bus address.
        value: The byte.
    """
    if chip.collective:  # the upper bytes wait for the lowest one
        if address == 3:
            chip.high_byte = value
        elif address == 2:
            chip.middle_byte = value
        else:
            _store_register(chip, chip.selected_register, chip.high_byte << 16 | chip.middle_byte << 8 | value)
        return
    shift = 8 * (address - 1)
    _store_register(chip, chip.selected_register, chip.reg[chip.selected_register] & ~(0xFF << shift) | value << shift)


@hot
def write_byte(chip, address, value):
    """Make a bus write cycle.

    Args:
        chip: State of the chip.
        address: Bus address.
        value: The byte.
    """
    address &= 3
    value &= 0xFF
    chip.quiet_until = 0
    if address:
        _write_data(chip, address, value)
        return
    group = value & state.GROUP
    if group == OPERATE:
        _execute_operating_command(chip, value)
    elif group == CONTROL:
        chip.origin_return, chip.sd_enable = 1 if value & state.ORIGIN else 0, 1 if value & state.SD else 0
        chip.preset, chip.minus = 1 if value & state.PRESET else 0, 1 if value & state.MINUS else 0
        if chip.extended:
            chip.automatic_ramp_down = 1 if value & state.AUTOMATIC else 0
            chip.counts_position = 1 if value & state.POSITION else 0
    elif group == SELECT:
        chip.selected_register = value & state.REGISTER
        if chip.extended:
            chip.selected_register += state.R10 if value & state.SECOND_EIGHT else 0
            chip.collective = 1 if value & state.COLLECTIVE else 0
    else:
        chip.output_mode = value & state.OUTPUT_BITS


@hot
def read_register(chip, register_number):
    """Return the value that a read of a register returns. Only the MS has the EZ monitor in R17.

    Args:
        chip: State of the chip.
        register_number: Index of the register.
    """
    if register_number == state.R17 and chip.s_curves:
        count = chip.ez_left if chip.ez_started else chip.reg[state.R13] >> state.EZ_COUNT & state.MAX_EZ_COUNT
        return chip.reg[state.R17] | count << state.EZ_COUNT | (state.EZ_SIGNAL if chip.active_inputs & state.EZ else 0)
    return chip.reg[register_number]


@hot
def compute_outputs(chip):
    """Compute the output pins of the PCL-240, bits of OUTPUTS. A set bit means asserted; active-low pins are then low."""
    word = 0 if chip.running or chip.finishing else state.HOLD
    goal = find_goal_speed(chip)
    if not chip.running or not chip.uses_ramps:
        word |= state.FKEEP
    elif chip.speed == goal:
        word |= state.FDOWN if chip.clock < chip.fdown_end else state.FKEEP
    elif chip.speed < goal:
        word |= state.FUP
    else:
        word |= state.FDOWN
    if chip.output_mode & state.INDEPENDENT:
        if chip.pout_low:
            word |= state.PDIR if chip.minus else state.POUT
    else:
        word |= (state.POUT if chip.pout_low else 0) | (state.PDIR if chip.minus else 0)
    if chip.reg[0] < chip.reg[6]:
        word |= state.LT
    if chip.reg[0] == 0:
        word |= state.ZERO
    if chip.output_mode & state.OTS_LEVEL:
        word |= state.OTS
    if chip.irq:
        word |= state.IRQ
    return word


@hot
def _compute_status(chip):
    """Compute the status byte of the PCL-240."""
    word = compute_outputs(chip)
    status = 0 if word & state.IRQ else state.S_NO_INT
    if not word & state.HOLD:
        status |= state.S_OPERATING
    if word & state.FKEEP:
        status |= state.S_FKEEP
    if word & state.LT:
        status |= state.S_LT
    if word & state.ZERO:
        status |= state.S_ZERO
    if chip.active_inputs & (state.SD_MINUS if chip.minus else state.SD_PLUS):
        status |= state.S_SD
    if chip.active_inputs & state.ORG:
        status |= state.S_ORG
    if chip.active_inputs & state.INS:
        status |= state.S_INS
    return status


@hot
def read_byte(chip, address):
    """Make a bus read cycle. In collective mode a read of the high byte latches all bytes.

    Args:
        chip: State of the chip.
        address: Bus address.
    """
    address &= 3
    if not address:
        return _compute_status(chip)
    word = (
        read_register(chip, chip.selected_register)
        if chip.extended and chip.output_mode & state.EXTENSION
        else chip.reg[0]
    )
    if chip.collective:
        if address == 3:
            chip.read_latch = word
        word = chip.read_latch
    return word >> 8 * (address - 1) & 0xFF
