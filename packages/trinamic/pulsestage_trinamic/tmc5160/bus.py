"""Compiled bus interface of the TMC5160: registers, SPI datagrams and status flags.

Addresses 0 to 7Fh are the registers, for hosts that do not simulate SPI. A host with SPI uses three more:

    80h   chip select: writing 0 begins a datagram, writing 1 ends it
    81h   a written byte is sent on SDI; a read then returns the byte that arrived on SDO at the same time
    82h   40 written bits are a whole datagram; a read then returns its answer

A read of 83h returns SPI_STATUS, and a read of 84h returns 1 while a drive is in progress, both without a datagram.
"""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage
from pulsestage_trinamic.tmc5160 import (
    encoder,
    maps,
    microstep_sequencer,
    power_stage,
    ramp,
    speed_thresholds,
    stallguard,
    state,
)
from stage.native import hot

VERSION = 0x30 << 24
ADDRESS_BITS = 0x7F  # of the first byte of a datagram
NO_ANSWER = -1  # no datagram came before: the answer is the status when the next one begins


@hot
def power_up(c):
    """Set the power-up values of the data sheet, but keep the clock, the pins and the position of the field."""
    clock, hz, rsense, inputs, net = c.clock, c.hz, c.rsense, c.inputs, c.net
    c.fresh = 1
    c.x = c.target = c.q = c.dir = c.ph = c.brk = c.zw = 0
    c.events, c.reached = state.EVENT_POS, 1
    c.left = c.right = c.latched = 0
    c.enc = c.part = c.enc_pins = c.enc_met = c.enc_latch = c.enc_flags = 0
    c.mscnt = c.toggle = c.last_direction = c.current = c.cs = c.speeds = c.cooling = 0
    c.last, c.falls = clock, state.NEVER
    c.sg = c.stall = c.total = c.summed = c.count = c.full = 0
    c.lam, c.emf = 0, 1024
    c.load_of, c.load_n, c.load_sum, c.emf_sum = -1, 0, 0, 0
    c.gstat, c.shorts, c.hot, c.powered = 1, 0, 0, 0
    c.csn, c.shift, c.bits, c.out, c.heard = 1, 0, 0, 0, 0
    c.risen = c.shifted = -state.NEVER
    for k in range(maps.REGISTERS):
        c.reg[k] = maps.RESET_VALUES[k]
    c.clock, c.hz, c.rsense, c.inputs, c.net = clock, hz, rsense, inputs, net
    encoder.initialize_levels(c)
    c.answer = NO_ANSWER


# --- flags ---


@hot
def _is_stop_event(c, switch, direction):
    """Return whether a closed switch stops a motion in this direction (event_stop_l, event_stop_r)."""
    s = c.dir if c.dir else ramp.find_requested_direction(c)
    return s == direction and c.reg[state.SW_MODE] & (state.STOP_L if direction < 0 else state.STOP_R) and switch


@hot
def compute_ramp_stat(c):
    word = c.events | (state.STATUS_L if c.left else 0) | (state.STATUS_R if c.right else 0)
    word |= (state.EVENT_L if _is_stop_event(c, c.left, -1) else 0) | (
        state.EVENT_R if _is_stop_event(c, c.right, 1) else 0
    )
    word |= state.VELOCITY_REACHED if c.q >> state.SPEED_SHIFT == c.reg[state.VMAX] else 0
    word |= (state.POSITION_REACHED if c.reached else 0) | (0 if c.q else state.VZERO) | (state.ZEROWAIT if c.zw else 0)
    return word | (state.STATUS_SG if c.stall and speed_thresholds.is_stall_stop_possible(c) else 0)


@hot
def compute_drv_status(c):
    """Return DRV_STATUS, the TMC5160's register of driver flags, current scale and StallGuard result."""
    word = c.sg | c.cs << 16 | c.stall << 24
    word |= 1 << 14 if speed_thresholds.is_stealth_chop_active(c) else 0
    word |= 1 << 15 if c.speeds & state.HIGH and c.reg[state.CHOPCONF] & state.VHIGHFS else 0
    word |= (c.shorts >> 8 & 3) << 27 | (c.shorts >> 10 & 3) << 12
    word |= (1 << 25 if c.hot else 0) | (1 << 26 if c.inputs & state.OTPW else 0)
    word |= (c.inputs >> 14 & 3) << 29
    return word | (1 << 31 if power_stage.is_at_standstill(c) else 0)


@hot
def compute_spi_status(c):
    word = compute_ramp_stat(c)
    driver = compute_drv_status(c)
    return (
        (word & 1) << 6 | (word >> 1 & 1) << 7 | (word >> 9 & 1) << 5 | (word >> 8 & 1) << 4
        | (driver >> 31) << 3 | (driver >> 24 & 1) << 2 | (c.gstat >> 1 & 1) << 1 | c.gstat & 1
    )  # fmt: skip


@hot
def is_drive_in_progress(c):
    """Return whether a drive is in progress or begins at the next clock."""
    return 1 if c.dir or (not speed_thresholds.is_emergency_stop_active(c) and ramp.starts_at_next_clock(c)) else 0


@hot
def compute_output_pins(c):
    """Return the levels of DIAG0 and DIAG1 as bits of OUTPUTS, where 1 is active."""
    if c.reg[state.GCONF] & state.DIAG0_STEP:
        word = state.DIAG0 if c.toggle else 0
    else:
        events = compute_ramp_stat(c) & (state.EVENT_POS | state.EVENT_L | state.EVENT_R | state.EVENT_SG)
        word = state.DIAG0 if events or c.enc_flags else 0
    if c.reg[state.GCONF] & state.DIAG1_DIR:
        return word | (state.DIAG1 if c.last_direction < 0 else 0)
    return word | (state.DIAG1 if c.x == state.to_signed32(c.reg[state.X_COMPARE]) else 0)


@hot
def update_position_reached(c):
    """Update the TMC5160's flag position_reached and its event."""
    now = 1 if c.x == c.target else 0
    if now and not c.reached:
        c.events |= state.EVENT_POS
    c.reached = now


# --- registers ---


@hot
def get_register_value(c, address):
    """Return the value of a TMC5160 register, including registers that a host cannot read."""
    if address == state.GSTAT:
        return c.gstat
    if address == state.IOIN:
        return VERSION | c.inputs & state.IOIN_PINS
    if address == state.TSTEP:
        return speed_thresholds.compute_tstep(c, c.q)
    if address == state.XACTUAL:
        return c.x & maps.M32
    if address == state.XTARGET:
        return c.target & maps.M32
    if address == state.VACTUAL:
        return c.dir * (c.q >> state.SPEED_SHIFT) & 0xFFFFFF
    if address == state.RAMP_STAT:
        return compute_ramp_stat(c)
    if address == state.XLATCH:
        return c.latched & maps.M32
    if address == state.X_ENC:
        return c.enc & maps.M32
    if address == state.ENC_STATUS:
        return c.enc_flags
    if address == state.ENC_LATCH:
        return c.enc_latch & maps.M32
    if address == state.MSCNT:
        return c.mscnt
    if address == state.MSCURACT:
        return microstep_sequencer.compute_current_word(c.mscnt)
    if address == state.DRV_STATUS:
        return compute_drv_status(c)
    if address == state.PWM_AUTO:
        return c.reg[state.PWMCONF] & 0xFF | (c.reg[state.PWMCONF] >> 8 & 0xFF) << 16
    return c.reg[address]


@hot
def read_register(c, address):
    return get_register_value(c, address) if maps.IS_READABLE[address] else 0


@hot
def write_register(c, address, value):
    """Write a register of the TMC5160. The value takes effect at the next clock; the flags of the position change at once."""
    value &= maps.STORED_BITS[address]
    if maps.STORED_BITS[address] == 0:
        return
    c.fresh = 1
    if address == state.XACTUAL:
        c.x = state.to_signed32(value)
        c.brk = 0
    elif address == state.XTARGET:
        c.target = state.to_signed32(value)
        c.brk = 0
    elif address == state.GSTAT:
        c.gstat &= ~value
    elif address == state.RAMP_STAT:
        c.events &= ~(value & state.WRITE_TO_CLEAR_EVENTS)
    elif address == state.ENC_STATUS:
        c.enc_flags &= ~value
    elif address == state.X_ENC:
        c.enc, c.part = state.to_signed32(value), 0
    else:
        if address == state.COOLCONF and (value ^ c.reg[address]) & state.SFILT:
            c.total = c.summed = 0
        c.reg[address] = value
        if address == state.RAMPMODE:
            c.brk = 0
        elif address == state.IHOLD_IRUN:
            common_power_stage.apply_current_register(c, c.reg[state.IHOLD_IRUN])
    if address == state.CHOPCONF and value & 15 == 0:
        c.shorts = 0
    stallguard.update_stallguard_and_coolstep(c)
    update_position_reached(c)


# --- SPI ---


@hot
def compute_next_answer(c):
    """Return the 40 bits that the TMC5160 sends during the next SPI datagram."""
    return compute_spi_status(c) << 32 if c.answer == NO_ANSWER else c.answer


@hot
def _execute_datagram(c, datagram):
    """Execute a whole SPI datagram, and prepare the answer to the next one."""
    address = datagram >> 32 & ADDRESS_BITS
    datum = datagram & maps.M32
    if datagram >> 39 & 1:
        write_register(c, address, datum)
    else:
        datum = read_register(c, address)
    c.answer = compute_spi_status(c) << 32 | datum


@hot
def make_write_cycle(c, address, value):
    """Make one write cycle on the bus of the TMC5160."""
    if address < maps.REGISTERS:
        write_register(c, address, value & maps.M32)
    elif address == maps.SPI_CS:
        set_chip_select(c, value & 1)
    elif address == maps.SPI_BYTE and not c.csn:
        c.out = c.shift >> 32
        c.shift = (c.shift << 8 | value & 0xFF) & maps.M40
        c.bits += 8
        c.shifted = c.clock
    elif address == maps.SPI_DATAGRAM:
        c.heard = compute_next_answer(c)
        _execute_datagram(c, value & maps.M40)


@hot
def set_chip_select(c, level):
    """Set the level of CSN, the chip select pin of SPI."""
    if c.csn and not level:
        c.shift, c.bits = compute_next_answer(c), 0
    elif level and not c.csn:
        c.risen = c.clock
        if c.bits >= 40:
            _execute_datagram(c, c.shift)
    c.csn = level


@hot
def peek_read_cycle(c, address):
    """Return the value that a read cycle would find, without its side effects."""
    if address < maps.REGISTERS:
        return read_register(c, address)
    if address == maps.SPI_CS:
        return c.csn
    if address == maps.SPI_BYTE:
        return c.out
    if address == maps.SPI_DATAGRAM:
        return c.heard
    if address == maps.SPI_STATE:
        return compute_spi_status(c)
    return is_drive_in_progress(c) if address == maps.MOTION else 0
